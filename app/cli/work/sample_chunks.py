"""The simulation of a sample by batches of paths that are kept in a folder."""

from pathlib import Path

from goniotwin.app.cli.output import RunnerOptions, error_console, print_note
from goniotwin.app.cli.work.progress import SweepProgress
from goniotwin.app.cli.work.sweeps import kept, runner_of
from goniotwin.app.simulation.forward_sweep import ForwardSweep, simulate_in_chunks
from goniotwin.app.simulation.simulate import Simulation, Task
from goniotwin.app.sweeps.chunk_files import ChunkFiles


def simulate_batches(task: Task, folder: Path, runner_options: RunnerOptions) -> Simulation:
    """Simulate the batches that the folder does not have. Raises UserError."""
    sweep = ForwardSweep(task)
    files = ChunkFiles(folder, sweep.specification, "--folder", "simulation", print_note)
    # A batch takes all cores of a computer: several processes trace no faster.
    with (
        runner_of((1, None) if runner_options == (None, None) else runner_options, sweep.chunks) as runner,
        kept(folder, "batches"),
        SweepProgress(error_console(), "simulating", sweep.chunks, "batches") as progress,
    ):
        return simulate_in_chunks(sweep, files, runner, progress)
