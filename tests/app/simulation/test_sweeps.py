"""Simulations as sweeps: the forward estimator in batches, samples on random rigs; the same numbers as in one piece."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.estimate import BATCH, EstimatorSettings
from goniotwin.app.simulation.forward_sweep import TASK, ForwardSweep, simulate_in_chunks, trace_chunk
from goniotwin.app.simulation.rig_sweep import RigSweep, factors_of_chunk, simulate_rigs
from goniotwin.app.simulation.simulate import Task, simulate
from goniotwin.app.sweeps.chunk_files import ChunkFiles
from goniotwin.app.sweeps.content import as_data, from_data
from goniotwin.app.sweeps.runners import Here
from goniotwin.app.sweeps.specification import Specification, compute
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    RealSensor,
    Reflectance,
    anisotropic_gaussian,
    apply_spectrum,
    gaussian,
    lambertian,
    luminance_factor,
    sum_samples,
)
from goniotwin.twin.optics.geometry.coordinates import arc_direction

WIDE = Instrument(field_deg=20.0, detector_diameter_mm=60.0)
"""Few paths reach each detector."""
POLAR, AZIMUTH = np.array([0.0, 20.0, 40.0]), np.array([0.0, 90.0, 180.0])


def elsewhere(specification: Specification) -> Specification:
    """The specification as a worker on another computer has it."""
    return Specification(**json.loads(json.dumps(asdict(specification))))


def files_of(folder: Path, specification: Specification) -> ChunkFiles:
    return ChunkFiles(folder, specification, "--folder", "simulation")


def small_task(**changes: object) -> Task:
    settings = EstimatorSettings("forward", paths=10_000, seed=5)
    task = Task(lambertian(0.5), np.array([0.0, 30.0]), WIDE, settings, polar_deg=POLAR, azimuth_deg=AZIMUTH)
    return replace(task, **changes)  # type: ignore[arg-type]


TASKS = {
    "grey": small_task(),
    "two wavelengths and azimuths of the light": small_task(
        sample=apply_spectrum([450.0, 650.0], [0.2, 0.8], anisotropic_gaussian(20.0, 40.0)),
        sigma_deg=np.array([30.0]),
        psi_deg=np.array([0.0, 45.0, 180.0]),
        azimuth_deg=np.array([0.0, 90.0, 180.0, 270.0]),
    ),
    "stray light, the back": small_task(
        sample=lambertian(0.5, 0.3, "both"),
        back=True,
        transmitted=True,
        stray=True,
        instrument=replace(WIDE, deviations={"mirror_2": Deviation(rx_deg=0.1)}),
    ),
}


@pytest.mark.parametrize("name", [name if name == "grey" else pytest.param(name, marks=pytest.mark.long) for name in TASKS])
def test_a_simulation_in_chunks_has_the_numbers_of_one_in_one_piece(name: str, tmp_path: Path) -> None:
    three_batches = EstimatorSettings("forward", paths=2 * BATCH + 1808, seed=5)  # the last one of the rest
    task = replace(TASKS[name], estimator=three_batches)
    whole = simulate(task)
    sweep = ForwardSweep(task)
    assert sweep.sizes == [1 << 20, 1 << 20, 1808]
    files = files_of(tmp_path, sweep.specification)
    parts = simulate_in_chunks(sweep, files, Here())
    assert len(list(tmp_path.glob("chunk-*.npz"))) == sweep.chunks == 3 * len(sweep.traced)
    assert [each.ratio.factor.tobytes() for each in parts.at] == [each.ratio.factor.tobytes() for each in whole.at]
    assert [each.ratio.standard_error.tobytes() for each in parts.at] == [
        each.ratio.standard_error.tobytes() for each in whole.at
    ]
    last = sweep.chunks - 1
    kept = files.read(last)
    assert kept is not None
    again = compute(trace_chunk, elsewhere(sweep.specification), last)
    assert {key: each.tobytes() for key, each in again.arrays.items()} == {k: v.tobytes() for k, v in kept.arrays.items()}


def test_another_output_grid_has_the_same_batches_and_another_task_has_others() -> None:
    known = ForwardSweep(small_task()).specification.digest
    assert ForwardSweep(small_task(theta_deg=np.array([0.0, 5.0]))).specification.digest == known
    others = [
        small_task(sample=lambertian(0.6)),
        small_task(sigma_deg=np.array([0.0])),
        small_task(stray=True),
        small_task(instrument=replace(WIDE, obstruction=False)),
        small_task(polar_deg=np.array([0.0, 20.0])),
        small_task(estimator=EstimatorSettings("forward", paths=20_000, seed=5)),
        small_task(estimator=EstimatorSettings("forward", paths=10_000, seed=6)),
    ]
    assert len({known, *(ForwardSweep(each).specification.digest for each in others)}) == 1 + len(others)


def test_what_has_no_number_of_batches_is_refused() -> None:
    with pytest.raises(UserError, match=r"--folder: keeps the batches of the forward estimator; give --estimator forward"):
        ForwardSweep(small_task(estimator=EstimatorSettings()))
    with pytest.raises(UserError, match=r"--folder: --error has no number of batches; give --paths"):
        ForwardSweep(small_task(estimator=EstimatorSettings("forward", error_percent=1.0)))


def test_a_task_is_data_and_back() -> None:
    """Bit by bit, with arrays that kernels may not write to."""
    mirrors = Reflectance(np.array([400.0, 700.0]), np.array([0.0, 90.0]), np.full((2, 2), 0.1 + 0.2))
    task = small_task(
        sample=sum_samples(gaussian(5.0), lambertian(0.1)),
        instrument=Instrument(mirror_reflectance=mirrors, sensor=RealSensor(), deviations={"arc": Deviation(x_mm=1.0 / 3.0)}),
    )
    data = json.loads(json.dumps(as_data(task)))
    back = from_data(data, TASK)
    assert as_data(back) == data
    assert isinstance(back, Task)
    assert isinstance(back.instrument.mirror_reflectance, Reflectance)
    assert back.instrument.deviation("arc").x_mm == 1.0 / 3.0
    assert not back.sample.lobes[0].params.flags.writeable
    with pytest.raises(KeyError):
        from_data(data, TASK[1:])
    with pytest.raises(TypeError, match="a function is no data"):
        as_data({"work": small_task})


def rig_sweep(**changes: object) -> RigSweep:
    polar, azimuth = np.array([10.0, 25.0, 30.0, 35.0, 50.0]), np.full(5, 180.0)
    samples = gaussian(5.0), gaussian(15.0)
    sweep = RigSweep(samples, Instrument(), np.array([30.0]), polar, azimuth, 0.05, 0.1, 3)
    return replace(sweep, **changes)  # type: ignore[arg-type]


def test_rigs_are_drawn_by_their_number_and_simulated_as_by_the_estimator(tmp_path: Path) -> None:
    sweep = rig_sweep()
    results = simulate_rigs(sweep, 9, files_of(tmp_path, sweep.specification), Here())
    assert results.factors.shape == (10, 2, 1, 5)
    assert len(list(tmp_path.glob("chunk-*.npz"))) == 2  # 20 items, 16 a chunk
    directions = arc_direction(sweep.polar_deg, sweep.azimuth_deg, False)
    for rig in (0, 9):
        deviated = sweep.instrument_of(rig)
        assert (deviated.deviation("mirror_1") == Deviation()) == (rig == 0)
        alone = luminance_factor(deviated, 30.0, directions, sweep.samples[1])
        assert results.factors[rig, 1, 0] == pytest.approx(alone, rel=1e-12)
    narrow, wide = np.median(results.relative_rms, axis=0)[:, 0]
    assert 2.0 * wide < narrow < 0.2
    again = compute(factors_of_chunk, elsewhere(sweep.specification), 1)
    assert np.array_equal(again.arrays["factors"][:4], results.factors[8:].reshape(4, 1, 5))


def test_deviations_are_even_within_their_limits() -> None:
    """27 deviations of 400 rigs: the share of the limits, uniform in -1..1, by Kolmogorov and Smirnov's bound at 1e-4."""
    sweep = rig_sweep()
    limits = np.array([limit for _, _, limit in sweep.tolerances])
    assert limits.size == 27
    share = np.sort(np.concatenate([sweep.deviations(rig) / limits for rig in range(1, 401)]))
    expected = 2.0 * (np.arange(share.size) + 0.5) / share.size - 1.0
    assert 0.5 * np.abs(share - expected).max() < 2.23 / np.sqrt(share.size)
    assert not sweep.deviations(0).any()


def test_a_sweep_of_rigs_is_extended(tmp_path: Path) -> None:
    sweep = rig_sweep(samples=(gaussian(15.0),))
    files = files_of(tmp_path, sweep.specification)
    few = simulate_rigs(sweep, 3, files, Here())
    first = files.path(0).read_bytes()
    more = simulate_rigs(sweep, 20, files, Here())
    assert files.path(0).read_bytes() == first
    assert np.array_equal(more.factors[:4], few.factors)


def test_impossible_rigs_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"--tilt: -1 is out of range; give 0 to 1"):
        rig_sweep(tilt_deg=-1.0)
    with pytest.raises(UserError, match="has a spectrum, and rigs are simulated without"):
        rig_sweep(samples=(apply_spectrum([450.0, 650.0], [0.2, 0.8], lambertian()),))
    sweep = rig_sweep()
    with pytest.raises(UserError, match=r"--rigs: 0 is not possible; give 1 to"):
        simulate_rigs(sweep, 0, files_of(tmp_path, sweep.specification), Here())
