"""The forward estimator as a sweep: the batches of paths of a simulation, each a chunk, and the simulation made of them.

The batches, their random numbers and the order of their sums are those of the simulation in one piece, and so is its result.
"""

from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.estimate import (
    DEFAULT_PATHS,
    Batch,
    EstimatorSettings,
    MeasurementSetup,
    batch_sizes,
    trace_batch,
    traced_wavelengths,
)
from goniotwin.app.simulation.simulate import ReportProgress, Simulation, Task, check_task, simulate, traced_setups
from goniotwin.app.simulation.source import Source
from goniotwin.app.sweeps.chunk_files import ChunkFiles
from goniotwin.app.sweeps.content import as_data, from_data
from goniotwin.app.sweeps.runners import Runner
from goniotwin.app.sweeps.specification import Arrays, Specification
from goniotwin.app.sweeps.sweep import Report, run_sweep
from goniotwin.twin.optics import Deviation, Instrument, Lobe, RaySource, RealSensor, Reflectance, SampleFrames, Scatterer
from goniotwin.twin.optics.bsdf.scatterer import SpectralWeights

VERSION = 1
INSTRUMENT = (Instrument, Deviation, RealSensor, Reflectance)
SAMPLE = (Scatterer, Lobe, SpectralWeights)
TASK = (Task, EstimatorSettings, SampleFrames, Source, RaySource, *INSTRUMENT, *SAMPLE)
"""Classes of a task, which a specification may have."""


class ForwardSweep:
    """The chunks of a task: the batches of paths of each wavelength of each measurement, in the order of the simulation."""

    def __init__(self, task: Task) -> None:
        """Raises UserError for a task that is not possible, and for one without a number of batches."""
        check_task(task)
        if task.estimator.kind != "forward":
            raise UserError("--folder: keeps the batches of the forward estimator; give --estimator forward, or leave it out")
        if task.estimator.error_percent is not None:
            raise UserError("--folder: --error has no number of batches; give --paths")
        self.task = task

    @cached_property
    def specification(self) -> Specification:
        """The sweep. Not in it are names of files, and the output grid: it can be another one for the same batches."""
        source = None if self.task.source is None else replace(self.task.source, name="", geometry="")
        own = replace(self.task, sample=replace(self.task.sample, name=""), source=source, theta_deg=None, phi_deg=None)
        return Specification.of("simulation", VERSION, 1, self.task.estimator.seed, as_data(own))

    @cached_property
    def sizes(self) -> list[int]:
        """The paths of each batch of a wavelength of a measurement."""
        return batch_sizes(self.task.estimator.paths or DEFAULT_PATHS)

    @cached_property
    def traced(self) -> list[tuple[MeasurementSetup, float | None]]:
        """The measurements and wavelengths that are traced, so many batches each."""
        return [(setup, each) for setup in traced_setups(self.task) for each in traced_wavelengths(setup, self.task.sample)]

    @property
    def chunks(self) -> int:
        """The number of batches."""
        return len(self.traced) * len(self.sizes) if self.task.scatters else 0

    def batch(self, chunk: int) -> Batch:
        """Trace a batch. Raises UserError."""
        at, number = divmod(chunk, len(self.sizes))
        setup, wavelength = self.traced[at]
        return trace_batch(setup, self.task.sample, wavelength, self.task.estimator, number, self.sizes[number])

    def simulation(self, files: ChunkFiles, report: ReportProgress) -> Simulation:
        """The simulation of the batches in files. Raises UserError for one that is not there."""
        first = {
            (setup.sigma_deg, setup.gamma_deg, wavelength): k * len(self.sizes)
            for k, (setup, wavelength) in enumerate(self.traced)
        }

        def read(
            setup: MeasurementSetup,
            _sample: Scatterer,
            wavelength: float | None,
            _settings: EstimatorSettings,
            number: int,
            _size: int,
        ) -> Batch:
            chunk = first[setup.sigma_deg, setup.gamma_deg, wavelength] + number
            if (found := files.read(chunk)) is None:
                raise UserError(f"{files.path(chunk)}: is missing or damaged; run the same command again")
            return Batch(found.arrays["mean_m2sr"], found.arrays["error_m2sr"], int(found.arrays["paths"]))

        return simulate(self.task, report, read)


def simulate_in_chunks(
    sweep: ForwardSweep,
    files: ChunkFiles,
    runner: Runner,
    report: Report = lambda _done, _now: None,
    report_simulation: ReportProgress = lambda _fraction, _step: None,
) -> Simulation:
    """Simulate a task by the batches that are finished and those that a runner traces now. Raises UserError."""
    failures = run_sweep(trace_chunk, files, sweep.chunks, runner, report)
    for reason in failures.values():
        raise UserError(reason)
    return sweep.simulation(files, report_simulation)


def trace_chunk(specification: Specification, chunk: int) -> Arrays:
    """A batch: throughputs `mean_m2sr` (2, n) of sample and etalon, their standard errors `error_m2sr`, and `paths`."""
    batch = _sweep_of(specification).batch(chunk)
    return {"mean_m2sr": batch.mean, "error_m2sr": batch.error, "paths": np.array(batch.paths)}


@lru_cache(maxsize=1)
def _sweep_of(specification: Specification) -> ForwardSweep:
    """The sweep whose batches this process traces."""
    return ForwardSweep(from_data(specification.data, TASK))
