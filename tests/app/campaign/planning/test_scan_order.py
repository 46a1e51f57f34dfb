"""Scan order: every loop order has every point once, none is below the lower bound, and the fastest is taken."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.geometry.collision import crosses_beam
from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.loop_order import LoopOrder, loop_sequence, moving_seconds
from goniotwin.app.campaign.planning.lower_bound import moving_lower_bound_s
from goniotwin.app.campaign.planning.scan_grid import FILTER, WAVELENGTH, ScanGrid
from goniotwin.app.campaign.planning.scan_order import fastest_scan_order
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.rig import AXES, RigFile, arc_clearance, axis_settings, parse_rig
from goniotwin.arrays import Floats
from goniotwin.drivers import AxisSettings
from tests.conftest import RIG, tmcl_exchange_s

TEXT = RIG.read_text(encoding="utf-8")
PLAIN = parse_rig(TEXT, RIG.parent, "plain").file
BACKLASH = parse_rig(
    TEXT.replace("lower_deg = 0.0", "lower_deg = -5.0\nbacklash_deg = 0.2").replace(
        "encoder = false", 'encoder = false\nbacklash_deg = 0.1\napproach_from = "above"', 1
    ),
    RIG.parent,
    "with backlash",
).file
FILTERS = parse_rig(
    TEXT.replace(
        "[photodiodes]\n",
        "".join(
            f'[[monochromator.filters]]\nposition = {position}\nname = "x"\nfrom_nm = {low}\nto_nm = {high}\n'
            for position, low, high in ((2, 380, 405), (6, 405, 500), (3, 500, 600), (1, 600, 780))
        )
        + "[photodiodes]\n",
        1,
    ),
    RIG.parent,
    "with filters",
).file
"""The third filter is nearer to the first than the second one is."""


def schedule(**keys: object) -> ScheduleFile:
    return ScheduleFile.model_validate(
        {
            "name": "n",
            "samples": ["a"],
            "etalon": "e",
            "sigma_deg": [0.0],
            "beta_deg": [0.0],
            "wavelength_nm": [550.0],
            "gains_v_per_a": [1e8],
            **keys,
        }
    )


def pose_product(*axes: list[float]) -> Floats:
    return np.array(list(itertools.product(*axes)))


@st.composite
def scan_grids(draw: st.DrawFn, most: int = 40) -> ScanGrid:
    """Some poses of a small grid, at one to three wavelengths."""

    def values(highest: float, count: int) -> st.SearchStrategy[list[float]]:
        return st.lists(st.integers(0, round(10 * highest)).map(lambda k: k / 10), min_size=1, max_size=count, unique=True)

    poses = pose_product(*(draw(values(highest, count)) for highest, count in ((90.0, 2), (85.0, 3), (180.0, 4), (5.0, 4))))
    chosen = draw(st.lists(st.integers(0, len(poses) - 1), min_size=1, max_size=most, unique=True))
    wavelengths = draw(st.lists(st.sampled_from([400.0, 410.0, 550.0, 700.0]), min_size=1, max_size=3, unique=True))
    return ScanGrid(poses[chosen], np.array(wavelengths))


def with_filters(grid: ScanGrid, moves: Moves) -> ScanGrid:
    """The grid with the filters of a rig."""
    return ScanGrid(grid.poses, grid.wavelengths_nm, moves.wheel.numbers(grid.wavelengths_nm))


@st.composite
def loop_orders(draw: st.DrawFn, grid: ScanGrid) -> LoopOrder:
    columns = tuple(draw(st.permutations((*grid.varying_columns, FILTER) if grid.has_filter_groups else grid.varying_columns)))
    return LoopOrder(columns, tuple(draw(st.booleans()) for _ in columns))


rigs = st.sampled_from([PLAIN, BACKLASH, FILTERS])


@settings(deadline=None)
@given(data=st.data(), grid=scan_grids(), rig=rigs)
def test_a_loop_order_has_every_point_once_and_obeys_the_bound(data: st.DataObject, grid: ScanGrid, rig: RigFile) -> None:
    moves = Moves(rig)
    grid = with_filters(grid, moves)
    order = loop_sequence(grid, data.draw(loop_orders(grid)), moves)
    assert sorted(order.tolist()) == list(range(len(grid)))
    least = moving_lower_bound_s(grid, moves)
    assert least <= moving_seconds(moves, arc_clearance(rig), grid.points[order]) + 1e-9
    shuffled = data.draw(st.permutations(range(len(grid))))
    assert least <= moving_seconds(moves, arc_clearance(rig), grid.points[list(shuffled)]) + 1e-9


@pytest.mark.parametrize("most", [5, pytest.param(6, marks=pytest.mark.long)])
@settings(deadline=None)
@given(grid=scan_grids(most=6), rig=rigs)
def test_no_permutation_is_below_the_bound(most: int, grid: ScanGrid, rig: RigFile) -> None:
    if len(grid) > most:
        return
    moves = Moves(rig)
    grid = with_filters(grid, moves)
    least = moving_lower_bound_s(grid, moves)
    for order in itertools.permutations(range(len(grid))):
        assert least <= moving_seconds(moves, arc_clearance(rig), grid.points[list(order)]) + 1e-9


@settings(deadline=None)
@given(grid=scan_grids(), rig=rigs)
def test_no_candidate_is_faster_than_the_order_taken(grid: ScanGrid, rig: RigFile) -> None:
    moves = Moves(rig)
    grid = with_filters(grid, moves)
    order = fastest_scan_order(grid, schedule(), moves, arc_clearance(rig))
    assert sorted(order.sequence.tolist()) == list(range(len(grid)))
    assert order.seconds <= min(order.candidates.values())
    assert all(order.seconds <= other.seconds for other in order.choices)
    stated = fastest_scan_order(grid, schedule(back_and_forth=False), moves, arc_clearance(rig))
    assert stated.seconds == min(stated.candidates.values()), "a loop order"
    assert order.seconds == pytest.approx(moving_seconds(moves, arc_clearance(rig), grid.points[order.sequence]))


def test_the_order_of_an_even_grid_reaches_the_bound() -> None:
    grid = ScanGrid(
        pose_product([0.0], [0.0, 30.0, 60.0], [0.0, 5.0, 10.0, 15.0], [0.0, 0.5, 1.0]), np.arange(400.0, 500.0, 10.0)
    )
    moves = Moves(PLAIN)
    order = fastest_scan_order(grid, schedule(), moves, arc_clearance(PLAIN))
    assert order.loop_order == LoopOrder((1, 2, 3, 4), (True,) * 4)
    assert order.seconds == pytest.approx(moving_lower_bound_s(grid, moves))


def test_the_order_of_uneven_steps_nearly_reaches_the_bound() -> None:
    """The best loop order takes 109.9 s: it makes the long move from beta 0 to 170 as often as the short steps beyond."""
    betas = [0.0, 90.0, 170.0, 175.0, 178.0, 180.0]
    grid = ScanGrid(pose_product([0.0], [20.0, 40.0, 60.0], betas, [0.0, 2.0]), np.array([450.0, 460.0, 650.0]))
    moves = Moves(PLAIN)
    order = fastest_scan_order(grid, schedule(), moves, arc_clearance(PLAIN))
    assert order.improved
    assert order.seconds <= 1.001 * moving_lower_bound_s(grid, moves) < 0.9 * order.candidates[order.loop_order]


def test_poses_beside_the_grid_are_inserted_where_they_cost_least() -> None:
    """Five extra poses at another gamma or shift: the best loop order takes 51.2 s; a search of all exchanges found 45.8 s."""
    full = pose_product([0.0], [20.0, 40.0], [0.0, 60.0, 120.0, 180.0], [0.0])
    beside = np.array([[0.0, 20.0, 0.0, 5.0], [0.0, 40.0, 0.0, 5.0]])
    mirrored = np.array([[90.0, 20.0, 0.0, 0.0], [90.0, 20.0, 180.0, 0.0], [90.0, 40.0, 300.0, 0.0]])
    grid = ScanGrid(np.concatenate([full, beside, mirrored]), np.array([450.0, 550.0]))
    moves = Moves(PLAIN)
    order = fastest_scan_order(grid, schedule(), moves, arc_clearance(PLAIN))
    assert order.seconds <= 1.03 * moving_lower_bound_s(grid, moves)
    assert order.sequence.tolist() == fastest_scan_order(grid, schedule(), moves, arc_clearance(PLAIN)).sequence.tolist()


def test_the_path_search_finds_an_order_without_collision_where_no_loop_order_has_one() -> None:
    """Shift 5 at beta 0 and 300, on both sides of the beam, which is crossed at shift 0 only: poses like those of [overlap]."""
    betas = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0]
    poses = np.concatenate(
        [pose_product([0.0, 90.0], [20.0, 60.0], betas, [0.0]), pose_product([0.0, 90.0], [20.0, 60.0], [0.0, 300.0], [5.0])]
    )
    grid = ScanGrid(poses, np.array([550.0]))
    drift = {"every_s": 60.0, "sigma_deg": 60.0, "beta_deg": 180.0, "wavelength_nm": 450.0}
    order = fastest_scan_order(grid, schedule(drift=drift), Moves(PLAIN), arc_clearance(PLAIN))
    assert order.seconds < float("inf")
    assert not crosses_beam(arc_clearance(PLAIN), grid.points[order.sequence]).any()
    check = np.array([[0.0, 60.0, 180.0, 0.0, 450.0]])
    ends = np.concatenate([check, grid.points[order.sequence][[0, -1]], check])
    assert not crosses_beam(arc_clearance(PLAIN), ends)[[0, 2]].any(), "moves from the drift check and to it"


def test_with_backlash_a_long_loop_always_has_the_same_direction() -> None:
    moves = Moves(BACKLASH)
    grid = ScanGrid(pose_product([0.0], [30.0], [0.0, 5.0], np.arange(0.0, 5.0, 0.5).tolist()), np.array([550.0]))
    order = fastest_scan_order(grid, schedule(), moves, arc_clearance(BACKLASH))
    shift = grid.points[order.sequence][:10, 3]
    assert order.loop_order == LoopOrder((2, 3), (True, False))
    assert np.all(np.diff(shift) < 0.0), "this axis must approach from above"


def test_a_gap_between_filters_costs_as_much_as_the_cheapest_filter_change_over_it() -> None:
    """At 400, 410 and 550 nm the wheel is at 2, 6 and 3: with the gaps between neighbours, 4 and 3 s, no order would be as
    fast as the one that goes by way of 550 nm.
    """
    moves = Moves(FILTERS)
    grid = with_filters(ScanGrid(pose_product([0.0], [30.0], [0.0], [0.0]), np.array([400.0, 410.0, 550.0])), moves)
    least = moving_lower_bound_s(grid, moves)
    fastest = min(
        moving_seconds(moves, arc_clearance(FILTERS), grid.points[list(order)]) for order in itertools.permutations(range(3))
    )
    assert 1.0 + 3.0 < fastest < 3.0 + 4.0
    assert least <= fastest
    assert least > 1.0 + 1.0  # two changes, of a position at least


def test_the_order_is_filter_by_filter_where_that_is_faster() -> None:
    moves = Moves(FILTERS)
    shifts = np.arange(0.0, 5.0, 0.5).tolist()
    grid = with_filters(
        ScanGrid(pose_product([0.0], [30.0], [0.0], shifts), np.array([510.0, 550.0, 590.0, 610.0, 650.0])), moves
    )
    order = fastest_scan_order(grid, schedule(), moves, arc_clearance(FILTERS))
    assert order.loop_order.columns == (FILTER, 3, WAVELENGTH)
    wavelengths = grid.points[order.sequence][:, WAVELENGTH]
    assert (np.diff(moves.wheel.numbers(wavelengths)) != 0).sum() == 1
    assert order.seconds <= 1.02 * moving_lower_bound_s(grid, moves)
    plain = fastest_scan_order(ScanGrid(grid.poses, grid.wavelengths_nm), schedule(), moves, arc_clearance(FILTERS))
    assert min(order.candidates.values()) < 0.9 * min(plain.candidates.values())
    stated = schedule(order=["wavelength", "shift", "beta", "gamma", "sigma"])
    assert fastest_scan_order(grid, stated, moves, arc_clearance(FILTERS)).loop_order.columns == (3, WAVELENGTH)


def test_an_order_set_by_the_schedule_is_kept() -> None:
    grid = ScanGrid(pose_product([0.0], [0.0, 30.0], [0.0, 5.0], [0.0, 1.0]), np.array([500.0, 600.0]))
    stated = schedule(order=["shift", "beta", "gamma", "sigma", "wavelength"], back_and_forth=False)
    points = grid.points[fastest_scan_order(grid, stated, Moves(PLAIN), arc_clearance(PLAIN)).sequence]
    assert points[:, [4, 1, 2, 3]].tolist() == pose_product([500.0, 600.0], [0.0, 30.0], [0.0, 5.0], [0.0, 1.0]).tolist()


def test_an_order_with_a_collision_is_not_taken() -> None:
    """The move from beta 250 to 290 needs shift 0: the loop over the shift must end there, so it starts at 4."""
    grid = ScanGrid(pose_product([0.0], [30.0], [250.0, 290.0], [0.0, 4.0]), np.array([550.0]))
    points = grid.points[fastest_scan_order(grid, schedule(), Moves(PLAIN), arc_clearance(PLAIN)).sequence]
    assert points[:, [2, 3]].tolist() == [[250.0, 4.0], [250.0, 0.0], [290.0, 0.0], [290.0, 4.0]]
    never_low = ScanGrid(pose_product([0.0], [30.0], [250.0, 290.0], [3.0, 4.0]), np.array([550.0]))
    assert fastest_scan_order(never_low, schedule(), Moves(PLAIN), arc_clearance(PLAIN)).seconds == float("inf")


@settings(deadline=None)
@given(
    points=st.lists(st.tuples(st.integers(0, 72), st.integers(0, 10)), min_size=2, max_size=20).map(
        lambda pairs: np.array([(0.0, 30.0, 5.0 * beta, 0.5 * shift, 550.0) for beta, shift in pairs])
    )
)
def test_collisions_of_arrays_of_moves_are_those_of_the_interlock(points: Floats) -> None:
    clearance = arc_clearance(PLAIN)
    forbidden = [clearance.collision((a[2], b[2]), (a[3], b[3])) is not None for a, b in itertools.pairwise(points)]
    assert crosses_beam(clearance, points).tolist() == forbidden


@settings(deadline=None)
@given(
    axis=st.integers(0, 3),
    here=st.floats(-5.0, 180.0),
    there=st.floats(-5.0, 180.0),
    rig=rigs,
)
def test_a_move_takes_the_time_of_its_ramps(axis: int, here: float, there: float, rig: RigFile) -> None:
    """Besides the ramps, each leg takes the same time for any distance."""
    settings_, exchange_s = axis_settings(rig)[AXES[axis]], tmcl_exchange_s(rig)
    assert isinstance(settings_, AxisSettings)
    moves = Moves(rig)
    before, after = np.zeros((2, 1, 5))
    before[0, axis], after[0, axis] = here, there
    took = float(moves.seconds(before, after)[0])
    if here == there:
        assert took == 0.0
        return
    legs = settings_.legs(here, there)
    ramps = sum(float(settings_.ramp_seconds(b - a)) for a, b in itertools.pairwise((here, *legs)))
    beside = took - ramps - settings_.settling_s
    assert beside == pytest.approx(len(legs) * 0.002 + (5 + 2 * (len(legs) - 1)) * exchange_s, abs=1e-9)
