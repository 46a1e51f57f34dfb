"""Every fault of the failing wire at every step of a campaign: it ends in the right state, with right data."""

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
from tests.app.campaign.running.faulty_campaign import FAULTS, POLICIES, Wires, failing_plan, run_with, wrong

KINDS = [(wire, rtu, fault) for (wire, rtu), faults in FAULTS.items() for fault in faults]
QUICK = KINDS[::2]
LONG = 8
Undisturbed = dict[bool, tuple[RunResult, dict[str, int]]]


@cache
def plan_of(rtu: bool, tables: str = POLICIES) -> Plan:
    return failing_plan(rtu, tables)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[bool, tuple[RunResult, dict[str, int]]]:
    """By whether the photodiodes are on a serial line: the run, and how many exchanges each wire has had."""
    found = {}
    for rtu in (False, True):
        run, wires = run_with(plan_of(rtu), tmp_path_factory.mktemp("well") / "a.journal", {})
        assert run.state is State.DONE
        found[rtu] = (run, {wire: misfortune.exchanges for wire, misfortune in wires.misfortunes.items()})
    return found


def right(run: RunResult, well: RunResult, told: str, *, homed: bool) -> None:
    """Each row that is there is as in the undisturbed run, or flagged and empty."""
    by_number = {each.row.number: each for each in well.rows}
    for each in run.rows:
        assert wrong(each, by_number[each.row.number], homed=homed) == "", f"{told}: {each.row.identity}"


def single_fault(wire: str, rtu: bool, fault: Fault, seed: int, undisturbed: Undisturbed, path: Path) -> RunResult:
    well, exchanges = undisturbed[rtu]
    at = int(np.random.default_rng([seed, KINDS.index((wire, rtu, fault))]).integers(exchanges[wire]))
    run, wires = run_with(plan_of(rtu), path, {wire: ScriptedFaults([Fault.NONE] * at + [fault], seed)})
    told = f"{fault} at exchange {at} of {exchanges[wire]} on {wire}"
    assert wires.misfortunes[wire].met == [fault], told
    assert run.state is State.DONE, (told, run.faults, run.events)
    assert [each.row.number for each in run.rows] == [each.row.number for each in well.rows], told
    right(run, well, told, homed=wire == "axes")
    return run


def named(kinds: list[tuple[str, bool, Fault]]) -> pytest.MarkDecorator:
    ids = [f"{wire}{' rtu' if rtu else ''}: {fault}" for wire, rtu, fault in kinds]
    return pytest.mark.parametrize(("wire", "rtu", "fault"), kinds, ids=ids)


@named(QUICK)
def test_one_fault_anywhere_changes_nothing(
    wire: str, rtu: bool, fault: Fault, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    single_fault(wire, rtu, fault, 0, undisturbed, tmp_path / "a.journal")


@pytest.mark.long
@named(KINDS)
def test_one_fault_at_many_places_changes_nothing(
    wire: str, rtu: bool, fault: Fault, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    """480 campaigns."""
    for seed in range(1, LONG + 1):
        single_fault(wire, rtu, fault, seed, undisturbed, tmp_path / f"{seed}.journal")


def test_what_a_driver_cannot_mend_by_itself_is_a_fault_in_the_journal(undisturbed: Undisturbed, tmp_path: Path) -> None:
    """A reset is never mended in silence: the row is measured again, and why is told."""
    for wire in ("axes", "mono", "monitor", "adc"):
        run = single_fault(wire, False, Fault.RESET, 3, undisturbed, tmp_path / f"{wire}.journal")
        told = [text for kind, text in run.events if kind == "fault"]
        assert told, wire
        assert all("(a" in text for text in told)  # at, or after a fault at, which row


DEAD = [(wire, rtu) for wire, rtu in FAULTS]


@pytest.mark.parametrize(("wire", "rtu"), DEAD)
def test_a_wire_that_stays_dead_stops_the_run_and_what_is_committed_is_right(
    wire: str, rtu: bool, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    well, exchanges = undisturbed[rtu]
    path = tmp_path / "a.journal"
    run, _ = run_with(
        plan_of(rtu), path, {wire: ScriptedFaults([Fault.NONE] * (exchanges[wire] // 2) + [Fault.HANG] * 100_000)}
    )
    assert run.state is State.FAILED
    assert 0 < len(run.rows) < len(well.rows)
    right(run, well, wire, homed=False)
    assert run.faults
    assert any(kind == "fault" and run.faults[0] in text for kind, text in run.events)


def test_with_skip_a_dead_wire_yields_flagged_rows_without_a_value(undisturbed: Undisturbed, tmp_path: Path) -> None:
    well, exchanges = undisturbed[False]
    plan = plan_of(False, POLICIES.replace("attempts = 6", 'attempts = 2\nthen = "skip"'))
    misfortune = ScriptedFaults([Fault.NONE] * (exchanges["monitor"] // 2) + [Fault.HANG] * 100_000)
    run, _ = run_with(plan, tmp_path / "a.journal", {"monitor": misfortune})
    assert run.state is State.DONE
    assert len(run.rows) == len(well.rows)
    skipped = [each for each in run.rows if each.data.flags == (SKIPPED,)]
    assert 0 < len(skipped) < len(run.rows)
    right(run, well, "monitor", homed=False)


def test_a_mounting_is_never_skipped_for_what_follows_would_be_another_samples(
    undisturbed: Undisturbed, tmp_path: Path
) -> None:
    """The shutter cannot be closed for it, so that nobody is asked to mount."""
    _, exchanges = undisturbed[False]
    plan = plan_of(False, POLICIES.replace("attempts = 6", 'attempts = 2\nthen = "skip"'))
    script = ScriptedFaults([Fault.NONE] * (exchanges["mono"] // 2) + [Fault.HANG] * 100_000)
    run, _ = run_with(plan, tmp_path / "a.journal", {"mono": script})
    assert run.state is State.FAILED
    assert not [each for each in run.rows if each.row.kind == "mount" and each.row.sample != "etalon"]


def test_stop_works_in_the_middle_of_a_recovery_and_nothing_moves_on(undisturbed: Undisturbed, tmp_path: Path) -> None:
    """The axes' controller has reset itself, and they look for their references when somebody says stop."""
    _, exchanges = undisturbed[False]
    engines: list[Engine] = []
    moving: list[bool] = []
    wires: list[Wires] = []

    def stop() -> None:
        plant, now = wires[0].virtual.plant, wires[0].virtual.clock.now()
        moving.append(any(shaft.drive(now).trajectory.velocity(now) != 0.0 for shaft in plant.shafts.values()))
        engines[0].stop()

    def heed(event: Event) -> None:
        if event == StateChanged(State.RECOVERING, getattr(event, "reason", "")):
            clock = wires[0].virtual.clock
            clock.at(clock.now() + 3.0, stop)

    script = ScriptedFaults([Fault.NONE] * (exchanges["axes"] // 2) + [Fault.RESET])
    run, _ = run_with(plan_of(False), tmp_path / "a.journal", {"axes": script}, [heed], engines.append, wires.append)
    assert run.state is State.IDLE
    assert moving == [True]
    plant, now = wires[0].virtual.plant, wires[0].virtual.clock.now()
    for shaft in plant.shafts.values():  # over their ramps, and no further
        assert shaft.angle_deg(now + 5.0) == shaft.angle_deg(now + 1000.0)


def test_a_pause_closes_the_shutter_though_the_wire_fails(undisturbed: Undisturbed, tmp_path: Path) -> None:
    engines: list[Engine] = []
    wires: list[Wires] = []
    paused: list[bool] = []

    def heed(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.kind == "measure" and not paused:
            engines[0].pause()
            wires[0].suffer("mono", ScriptedFaults([Fault.UNHEARD]))
        if event == StateChanged(State.PAUSED):
            virtual = wires[0].virtual
            paused.append(virtual.plant.shutter_open.at(virtual.clock.now()))
            engines[0].resume()

    run, _ = run_with(plan_of(False), tmp_path / "a.journal", {}, [heed], engines.append, wires.append)
    assert paused == [False]
    assert any("the pause" in text for kind, text in run.events if kind == "fault")
    assert run.state is State.DONE
    well, _ = undisturbed[False]
    assert len(run.rows) == len(well.rows)
    right(run, well, "pause", homed=False)


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(2, 31))])
def test_on_wires_that_all_fail_now_and_then_no_value_is_wrong(seed: int, undisturbed: Undisturbed, tmp_path: Path) -> None:
    """One exchange in a hundred, on every wire at once: with retries, homing and restored settings the run ends as it must."""
    rtu = bool(seed % 2)
    well, _ = undisturbed[rtu]
    kinds = {wire: faults for (wire, over_rtu), faults in FAULTS.items() if wire != "adc" or over_rtu is rtu}
    storms = {wire: FaultPlan(seed, faults, 0.01) for wire, faults in kinds.items()}
    run, _ = run_with(plan_of(rtu), tmp_path / "a.journal", storms)
    assert run.state in (State.DONE, State.FAILED)
    if run.state is State.DONE:
        assert len(run.rows) == len(well.rows)
    else:
        assert run.faults
    right(run, well, f"seed {seed}", homed=True)
