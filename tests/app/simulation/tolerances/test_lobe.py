"""The responses of the instrument to deviations: numbers of an independent prototype, and closed forms of the geometry."""

import itertools
import math

import numpy as np
import pytest

from goniotwin.app.simulation.corner_search import rms_percent
from goniotwin.app.simulation.tolerances.beam_on_sample import BeamOnSample
from goniotwin.app.simulation.tolerances.lobe import GaussianLobe, LobeSurrogate, Recentred
from goniotwin.app.simulation.tolerances.stages import all_combinations, reduce_limits, worst_combination
from goniotwin.app.simulation.tolerances.study import (
    DeviationsTable,
    GaussianTable,
    InstrumentTable,
    Parameter,
    levels_of_parameters,
    limits_of,
    parameters_of,
    read_study,
)
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, Pose, gaussian, luminance_factors
from tests.conftest import REPOSITORY

TABLE2 = read_study(REPOSITORY / "examples" / "tolerances" / "table2.toml")
CRITERION = GaussianTable(kind="gaussian")
RIG = ("mirror_1", "mirror_2", "mirror_3", "sample", "arc")


def lobe_of(table: InstrumentTable = TABLE2.instrument) -> GaussianLobe:
    """The twelve tilts of Table 2."""
    instrument = table.instrument()
    return GaussianLobe(instrument, CRITERION, parameters_of(TABLE2.deviations, instrument))


@pytest.mark.parametrize(("collimated", "worst_percent", "common_deg"), [(False, 15.27, 0.0162), (True, 20.2, 0.0122)])
def test_the_worst_corner_and_the_common_tolerance_are_those_of_an_independent_prototype(
    collimated: bool, worst_percent: float, common_deg: float
) -> None:
    lobe = lobe_of(InstrumentTable(collimated=collimated))
    limits = limits_of(lobe.parameters)
    worst = worst_combination(lobe, limits)
    assert worst.percent == pytest.approx(worst_percent, abs=0.05)
    reduced = reduce_limits(lobe, limits, 5.0, worst)
    assert 0.05 * reduced.factor == pytest.approx(common_deg, abs=0.0001)
    assert reduced.worst.percent == pytest.approx(5.0, abs=1e-6)


def test_a_combination_has_the_value_of_the_instrument_with_these_deviations() -> None:
    lobe = lobe_of()
    values = 0.05 * np.random.Generator(np.random.Philox(1)).uniform(-1.0, 1.0, (3, 12))
    poses = [Pose(each.sigma_deg, each.axes) for each in lobe.directions]
    sample = gaussian(5.0, peak=1.0 / math.pi)
    for found, combination in zip(lobe.factors(values), values, strict=True):
        (expected,) = luminance_factors(lobe.with_deviations(combination), poses, sample)
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_the_peak_and_the_incidence_move_as_the_mirrors_laws_require() -> None:
    """Degrees per degree at sigma 30: a mirror turns the light by 2 cos 45 times its share of the path from the pupil."""
    lobe = lobe_of()
    beam, step = BeamOnSample(lobe, 30.0), 0.005
    moved = step * np.eye(12)
    peak = (lobe.peaks(lobe.factors(moved))[0] - lobe.peaks(lobe.factors(-moved))[0])[:, 0, 0] / (2.0 * step)
    incidence = (beam.incidence_deg(moved) - beam.incidence_deg(-moved)) / (2.0 * step)
    turned = {each.title: abs(value) for each, value in zip(lobe.parameters, peak, strict=True)}
    lit = {each.title: abs(value) for each, value in zip(lobe.parameters, incidence, strict=True)}
    mirrors = [math.sqrt(2.0) * share for share in (0.25, 0.5, 0.75)]
    assert [turned[f"mirror {k} ry"] for k in (1, 2, 3)] == pytest.approx(mirrors, abs=0.002)
    assert [lit[f"mirror {k} ry"] for k in (1, 2, 3)] == pytest.approx(mirrors, abs=1e-4)
    assert (turned["sample ry"], lit["sample ry"]) == pytest.approx((2.0, 1.0), abs=0.001)
    assert (turned["arc ry"], lit["arc ry"]) == pytest.approx((1.0, 0.0), abs=0.001)
    assert (lit["beam rz"], lit["beam rx"]) == pytest.approx((math.cos(math.radians(30.0)), 0.5), abs=1e-4)
    for name in ("mirror 1 rx", "mirror 2 rx", "mirror 3 rx", "sample rx", "arc rx"):
        assert turned[name] < 0.01, name


def test_the_light_moves_on_the_sample_by_twice_the_tilt_times_the_path() -> None:
    lobe = lobe_of()
    place = BeamOnSample(lobe, 30.0).place_mm(0.05 * np.eye(12))
    shift = {each.title: math.hypot(*row) for each, row in zip(lobe.parameters, place, strict=True)}
    twice = 2.0 * math.radians(0.05)
    assert [shift[f"mirror {k} rx"] for k in (1, 2, 3)] == pytest.approx([twice * path for path in (600, 400, 200)], rel=1e-3)
    assert [shift[f"mirror {k} ry"] for k in (1, 2, 3)] == pytest.approx(
        [twice * path / math.sqrt(2.0) for path in (600, 400, 200)], rel=1e-3
    )
    assert max(shift[name] for name in ("sample rx", "sample ry", "arc rx", "arc ry", "beam rx", "beam rz")) < 1e-5


def test_the_light_misses_a_part_of_the_hole_as_far_as_it_is_shifted() -> None:
    """At normal incidence a shift of 2 mm, of which 1 mm is the margin, leaves 4 of 5 mm lit; six mirror tilts leave 0.72."""
    instrument = Instrument(obstruction=False)
    groups = [DeviationsTable(elements=["mirror_1", "mirror_2", "mirror_3"], angles=["rx", "ry"], limit_deg=0.05)]
    lobe = GaussianLobe(instrument, GaussianTable(kind="gaussian", sigma_deg=[0.0]), parameters_of(groups, instrument))
    beam = BeamOnSample(lobe, 0.0)
    tilt = math.degrees(2.0 / (2.0 * 600.0))
    assert beam.lit_share(np.diag([tilt, 0.0, 0.0, 0.0, 0.0, 0.0])[:1]) == pytest.approx([0.8], abs=1e-3)
    assert beam.lit_share(np.zeros((1, 6))) == pytest.approx([1.0], abs=1e-12)
    rig = BeamOnSample(lobe, 30.0)
    signs = np.array(list(itertools.product((-0.05, 0.05), repeat=6)))
    assert rig.lit_share(signs).min() == pytest.approx(0.72, abs=0.02)


def test_about_its_measured_peak_the_worst_corner_is_as_good_as_the_aligned_instrument() -> None:
    lobe = lobe_of()
    limits = limits_of(lobe.parameters)
    worst = worst_combination(lobe, limits).levels * limits
    aligned, at_worst = rms_percent(Recentred(lobe).residuals(np.stack([0.0 * worst, worst])))
    assert aligned == pytest.approx(0.61, abs=0.01)
    assert at_worst == pytest.approx(0.61, abs=0.01)


def test_the_measured_peak_of_a_lobe_has_a_place_across_the_plane_of_incidence() -> None:
    instrument = Instrument(obstruction=False)
    groups = [DeviationsTable(elements=["arc"], angles=["rx", "ry"], limit_deg=0.05)]
    criterion = GaussianTable(kind="gaussian", directions="lobe", step_deg=2.0, sigma_deg=[0.0])
    lobe = GaussianLobe(instrument, criterion, parameters_of(groups, instrument))
    places, heights = lobe.peaks(lobe.factors(np.array([[0.2, 0.0], [0.0, 0.2], [0.0, 0.0]])))
    np.testing.assert_allclose(np.hypot(*places[:2, 0].T), 0.2, atol=0.003)
    np.testing.assert_allclose(np.abs(places[0, 0] * places[1, 0]), 0.0, atol=0.002)
    np.testing.assert_allclose(heights, heights[2, 0], rtol=1e-3)


def test_a_surrogate_of_all_combinations_states_its_measured_error_and_its_worst_is_exact() -> None:
    instrument = Instrument(obstruction=False, lit_everywhere=True)
    groups = [DeviationsTable(elements=["mirror_2", "sample", "arc"], angles=["rx", "ry"], limit_deg=0.05)]
    lobe = GaussianLobe(instrument, CRITERION, parameters_of(groups, instrument))
    levels, limits = levels_of_parameters(lobe.parameters), limits_of(lobe.parameters)
    exact = all_combinations(lobe, levels, (5.0,))
    found = all_combinations(lobe, levels, (5.0,), surrogate=LobeSurrogate(lobe, limits))
    assert exact.surrogate_error_percent is None
    assert found.surrogate_error_percent is not None
    assert 0.0 < found.surrogate_error_percent < 0.05
    # The stated error is a sample of the true one.
    assert np.abs(found.percent - exact.percent).max() < 3.0 * found.surrogate_error_percent
    assert found.worst_percent == exact.worst_percent
    np.testing.assert_array_equal(found.worst, exact.worst)


def drawn_lobe(random: np.random.Generator, most: int) -> tuple[GaussianLobe, tuple[Parameter, ...], Floats]:
    """A lobe with elements, sigma, width, distance of the pupil and limits at random; at most `most` deviations."""
    table = InstrumentTable(pupil_distance_mm=float(random.choice([700.0, 800.0, 1200.0, 5000.0])), mirror_side_mm=30.0)
    criterion = GaussianTable(
        kind="gaussian",
        sigma_deg=[float(random.choice([0.0, 15.0, 30.0, 45.0, 60.0]))],
        width_deg=float(random.choice([2.0, 3.0, 5.0, 10.0])),
        step_deg=1.0,
    )
    every = [(element, name) for element in (*RIG, "beam") for name in ("rx", "ry", "x", "z") if element != "beam"]
    every += [("beam", "rx"), ("beam", "rz")]
    count = int(random.integers(min(4, most), most + 1))
    groups = []
    for place in random.permutation(len(every))[:count]:
        element, name = every[place]
        turned = {"angles": [name], "limit_deg": float(random.uniform(0.01, 0.1))}
        shifted = {"shifts": [name], "limit_mm": float(random.uniform(0.05, 0.5))}
        group = DeviationsTable.model_validate({"elements": [element], **(turned if name[0] == "r" else shifted)})
        groups.append(group)
    instrument = table.instrument()
    parameters = parameters_of(groups, instrument)
    return GaussianLobe(instrument, criterion, parameters), parameters, limits_of(parameters)


def check_the_search(seed: int, most: int) -> None:
    lobe, parameters, limits = drawn_lobe(np.random.Generator(np.random.Philox(seed)), most)
    every = all_combinations(lobe, levels_of_parameters(parameters), (5.0,))
    found = worst_combination(lobe, limits)
    assert every.percent.size == 3 ** len(parameters)
    assert found.percent == pytest.approx(every.worst_percent, rel=1e-12)
    assert found.evaluated < 2000


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_worst_corner_by_search_is_that_of_the_enumeration(seed: int) -> None:
    check_the_search(seed, 4)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(100, 120))
def test_the_worst_corner_by_search_is_that_of_the_enumeration_of_up_to_12_deviations(seed: int) -> None:
    check_the_search(seed, 12)


@pytest.mark.long
def test_all_combinations_of_the_twelve_tilts_are_those_of_an_independent_prototype() -> None:
    for table, median, passed in ((InstrumentTable(), 3.9, 0.620), (InstrumentTable(collimated=True), 4.6, 0.536)):
        lobe = lobe_of(table)
        found = all_combinations(lobe, levels_of_parameters(lobe.parameters), (5.0,))
        assert found.percent.size == 531_441
        assert np.median(found.percent) == pytest.approx(median, abs=0.05)
        assert found.shares[0][0] == pytest.approx(passed, abs=0.002)
        assert found.worst_percent == worst_combination(lobe, limits_of(lobe.parameters)).percent
