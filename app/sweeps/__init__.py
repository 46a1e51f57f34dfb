"""Sweeps: long computations in numbered chunks, on this computer or on others, that can be interrupted at any time.

A sweep is a `Specification` and a function `work(specification, chunk)` that gives the arrays of a chunk and depends on these
two alone. A `Runner` computes chunks in any order: here, in processes, or on the workers of a Dask cluster. `run_sweep` writes
each finished chunk to a file of its own; the results are reduced from these files in the order of the chunks. So they are the
same bytes for any runner, and interruption, progress and resuming need nothing from the runner.
"""
