"""Every fault of every wire in a campaign: the run ends in the right state, with right data."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import SKIPPED
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Event, RowCommitted, State, StateChanged
from goniotwin.mocks.faults import Fault, FaultPlan, ScriptedFaults
from tests.app.campaign.campaign_bench import RunResult
from tests.app.campaign.running.faulty_campaign import FAULTS, POLICIES, Wires, faulty_plan, row_difference, run_with_faults

pytestmark = pytest.mark.xdist_group("wire faults")

KINDS = [(wire, rtu, fault) for (wire, rtu), faults in FAULTS.items() for fault in faults]
SEEDS = 9
Undisturbed = dict[bool, tuple[RunResult, dict[str, int]]]


@cache
def plan_of(rtu: bool, tables: str = POLICIES) -> Plan:
    return faulty_plan(rtu, tables)


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, tuple[RunResult, dict[str, int]]]:
    """By whether the photodiodes are on a serial line: the run, and the number of exchanges of each wire."""
    found = {}
    for rtu in (False, True):
        run, wires = run_with_faults(plan_of(rtu), tmp_path_factory.mktemp("undisturbed") / "a.journal", {})
        assert run.state is State.DONE
        found[rtu] = (run, {wire: fault_plan.exchanges for wire, fault_plan in wires.fault_plans.items()})
    return found


def check_rows(run: RunResult, expected: RunResult, context: str, *, homed: bool) -> None:
    """Check that each committed row is as in the undisturbed run, or skipped and empty."""
    by_number = {each.row.number: each for each in expected.rows}
    for each in run.rows:
        assert row_difference(each, by_number[each.row.number], homed=homed) == "", f"{context}: {each.row.identity}"


def run_with_one_fault(wire: str, rtu: bool, fault: Fault, seed: int, undisturbed: Undisturbed, path: Path) -> RunResult:
    expected, exchanges = undisturbed[rtu]
    at = int(np.random.default_rng([seed, KINDS.index((wire, rtu, fault))]).integers(exchanges[wire]))
    run, wires = run_with_faults(plan_of(rtu), path, {wire: ScriptedFaults([Fault.NONE] * at + [fault], seed)})
    context = f"{fault} at exchange {at} of {exchanges[wire]} on {wire}"
    assert wires.fault_plans[wire].met == [fault], context
    assert run.state is State.DONE, (context, run.faults, run.events)
    assert [each.row.number for each in run.rows] == [each.row.number for each in expected.rows], context
    check_rows(run, expected, context, homed=wire == "axes")
    return run


def parametrize_kinds(kinds: list[tuple[str, bool, Fault]]) -> pytest.MarkDecorator:
    ids = [f"{wire}{' rtu' if rtu else ''}: {fault}" for wire, rtu, fault in kinds]
    return pytest.mark.parametrize(("wire", "rtu", "fault"), kinds, ids=ids)


@parametrize_kinds(KINDS[::8])
def test_one_fault_changes_no_row(wire: str, rtu: bool, fault: Fault, undisturbed: Undisturbed, tmp_path: Path) -> None:
    run_with_one_fault(wire, rtu, fault, 0, undisturbed, tmp_path / "a.journal")


@pytest.mark.long
@parametrize_kinds(KINDS)
def test_one_fault_at_many_places_changes_no_row(
    wire: str, rtu: bool, fault: Fault, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    """540 campaigns."""
    for seed in range(SEEDS):
        run_with_one_fault(wire, rtu, fault, seed, undisturbed, tmp_path / f"{seed}.journal")


def test_a_reset_of_a_device_is_a_fault_in_the_journal(undisturbed: Undisturbed, tmp_path: Path) -> None:
    """After a reset the row is measured again, and the journal has the reason."""
    for wire in ("axes", "mono", "monitor", "adc"):
        run = run_with_one_fault(wire, False, Fault.RESET, 3, undisturbed, tmp_path / f"{wire}.journal")
        faults = [text for kind, text in run.events if kind == "fault"]
        assert faults, wire
        assert all("(a" in text for text in faults)  # "(at ROW: ...)" or "(after a fault at ROW)"


DEAD = [(wire, rtu) for wire, rtu in FAULTS]


@pytest.mark.parametrize(("wire", "rtu"), DEAD)
def test_a_dead_wire_stops_the_run_and_committed_rows_are_right(
    wire: str, rtu: bool, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    expected, exchanges = undisturbed[rtu]
    path = tmp_path / "a.journal"
    run, _ = run_with_faults(
        plan_of(rtu), path, {wire: ScriptedFaults([Fault.NONE] * (exchanges[wire] // 2) + [Fault.HANG] * 100_000)}
    )
    assert run.state is State.FAILED
    assert 0 < len(run.rows) < len(expected.rows)
    check_rows(run, expected, wire, homed=False)
    assert run.faults
    assert any(kind == "fault" and run.faults[0] in text for kind, text in run.events)


def test_with_skip_a_dead_wire_gives_flagged_rows_without_values(undisturbed: Undisturbed, tmp_path: Path) -> None:
    expected, exchanges = undisturbed[False]
    plan = plan_of(False, POLICIES.replace("attempts = 6", 'attempts = 2\nthen = "skip"'))
    fault_plan = ScriptedFaults([Fault.NONE] * (exchanges["monitor"] // 2) + [Fault.HANG] * 100_000)
    run, _ = run_with_faults(plan, tmp_path / "a.journal", {"monitor": fault_plan})
    assert run.state is State.DONE
    assert len(run.rows) == len(expected.rows)
    skipped = [each for each in run.rows if each.data.flags == (SKIPPED,)]
    assert 0 < len(skipped) < len(run.rows)
    check_rows(run, expected, "monitor", homed=False)


def test_a_mount_is_never_skipped_because_the_next_rows_would_have_the_wrong_sample(tmp_path: Path) -> None:
    """The shutter cannot be closed for the mount, so that the operator is not asked to mount."""
    plan = plan_of(False, POLICIES.replace("attempts = 6", 'attempts = 2\nthen = "skip"'))
    dead = ScriptedFaults([Fault.HANG] * 100_000)
    wires: list[Wires] = []

    def hang_after_a_reading(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.kind == "measure" and not dead.exchanges:
            wires[0].set_fault_plan("mono", dead)

    run, _ = run_with_faults(plan, tmp_path / "a.journal", {}, [hang_after_a_reading], use_wires=wires.append)
    assert run.state is State.FAILED
    assert {each.row.sample for each in run.rows} == {"etalon"}
    assert len([each for each in run.rows if each.row.kind == "mount"]) == 1


def test_a_stop_during_a_recovery_stops_all_axes(undisturbed: Undisturbed, tmp_path: Path) -> None:
    """The controller of the axes was reset, and the axes are homing at the time of the stop."""
    _, exchanges = undisturbed[False]
    engines: list[Engine] = []
    moving: list[bool] = []
    wires: list[Wires] = []

    def stop() -> None:
        plant, now = wires[0].virtual.plant, wires[0].virtual.clock.now()
        moving.append(any(shaft.drive(now).trajectory.velocity(now) != 0.0 for shaft in plant.shafts.values()))
        engines[0].stop()

    def listen(event: Event) -> None:
        if event == StateChanged(State.RECOVERING, getattr(event, "reason", "")):
            clock = wires[0].virtual.clock
            clock.at(clock.now() + 3.0, stop)

    script = ScriptedFaults([Fault.NONE] * (exchanges["axes"] // 2) + [Fault.RESET])
    run, _ = run_with_faults(plan_of(False), tmp_path / "a.journal", {"axes": script}, [listen], engines.append, wires.append)
    assert run.state is State.IDLE
    assert moving == [True]
    plant, now = wires[0].virtual.plant, wires[0].virtual.clock.now()
    for shaft in plant.shafts.values():  # until the end of their ramps
        assert shaft.angle_deg(now + 5.0) == shaft.angle_deg(now + 1000.0)


def test_a_pause_closes_the_shutter_although_the_wire_fails(undisturbed: Undisturbed, tmp_path: Path) -> None:
    engines: list[Engine] = []
    wires: list[Wires] = []
    paused: list[bool] = []

    def listen(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.kind == "measure" and not paused:
            engines[0].pause()
            wires[0].set_fault_plan("mono", ScriptedFaults([Fault.UNHEARD]))
        if event == StateChanged(State.PAUSED):
            virtual = wires[0].virtual
            paused.append(virtual.plant.shutter_open.at(virtual.clock.now()))
            engines[0].resume()

    run, _ = run_with_faults(plan_of(False), tmp_path / "a.journal", {}, [listen], engines.append, wires.append)
    assert paused == [False]
    assert any("the pause" in text for kind, text in run.events if kind == "fault")
    assert run.state is State.DONE
    expected, _ = undisturbed[False]
    assert len(run.rows) == len(expected.rows)
    check_rows(run, expected, "pause", homed=False)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 31))])
def test_with_random_faults_on_all_wires_no_value_is_wrong(seed: int, undisturbed: Undisturbed, tmp_path: Path) -> None:
    """One exchange in a hundred fails, on every wire: retries, homing and restored settings keep all values right."""
    rtu = bool(seed % 2)
    expected, _ = undisturbed[rtu]
    kinds = {wire: faults for (wire, over_rtu), faults in FAULTS.items() if wire != "adc" or over_rtu is rtu}
    storms = {wire: FaultPlan(seed, faults, 0.01) for wire, faults in kinds.items()}
    run, _ = run_with_faults(plan_of(rtu), tmp_path / "a.journal", storms)
    assert run.state in (State.DONE, State.FAILED)
    if run.state is State.DONE:
        assert len(run.rows) == len(expected.rows)
    else:
        assert run.faults
    check_rows(run, expected, f"seed {seed}", homed=True)
