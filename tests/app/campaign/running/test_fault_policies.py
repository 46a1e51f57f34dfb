"""Policies for faults: each fault is handled as the schedule defines, is in the journal, and adds no value."""

import io
from collections.abc import Callable
from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import resume_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.row import SKIPPED
from goniotwin.app.campaign.running.events import Event, EventLogged, RowCommitted, RowStarted, SafetyOrder, State, StateChanged
from goniotwin.app.campaign.running.operator import HumanOperator
from goniotwin.app.campaign.running.question import Answer, UnreferencedAxis
from goniotwin.app.campaign.running.recovery import FaultPolicies, fault_kind
from goniotwin.app.campaign.running.stop import Stopped
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.cli.work.terminal import ask_operator
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, read_rig
from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, LimitError, NoAnswer, Pending, Refused
from goniotwin.drivers.errors import Interrupted, Taken, Unreferenced
from tests.app.campaign.campaign_bench import QUIET, RunResult, planned_values, run_plan, run_until
from tests.conftest import SMALL, Writer

ROW = 3
MakePlan = Callable[[str], Plan]


@pytest.fixture
def make(write_rig: Writer, write_schedule: Writer) -> MakePlan:
    def plan(tables: str) -> Plan:
        return make_plan(read_schedule(write_schedule(text=SMALL + tables)), read_rig(write_rig(*QUIET)))

    return plan


class Silence:
    """Silence of the third photodiode module in one row, `times` times."""

    def __init__(self, times: int, row: int = ROW) -> None:
        self._times = times
        self._row = row
        self.opened: OpenRig | None = None
        self.events: list[Event] = []

    def prepare(self, opened: OpenRig) -> None:
        self.opened = opened

    def listen(self, event: Event) -> None:
        self.events.append(event)
        assert self.opened is not None
        assert self.opened.virtual is not None
        module = self.opened.virtual.modbus["adc-2"]
        if isinstance(event, RowStarted) and event.row.number == self._row and self._times:
            module.units = (9,)
        if isinstance(event, StateChanged) and event.state is State.RECOVERING:
            self._times -= 1
            if self._times <= 0:
                module.units = (1,)
        if isinstance(event, RowCommitted):
            module.units = (1,)

    @property
    def states(self) -> list[State]:
        return [event.state for event in self.events if isinstance(event, StateChanged)]


def run_with_silence(plan: Plan, path: Path, silence: Silence, operator: "FaultOperator | None" = None) -> RunResult:
    return run_plan(plan, path, silence.prepare, operator, [silence.listen])


class FaultOperator:
    """Operator of a virtual rig, with one answer to every fault."""

    def __init__(self, silence: Silence, answer: Answer) -> None:
        self._silence = silence
        self._answer = answer
        self.faults: list[str] = []
        self.shutter: list[bool] = []

    def mount(self, sample: str) -> None:
        opened = self._silence.opened
        assert opened is not None
        assert opened.virtual is not None
        opened.virtual.mount(sample)

    def resolve_fault(
        self, fault: str, /, *, skippable: bool, device: str = "", axis: UnreferencedAxis | None = None
    ) -> Answer:
        assert skippable
        self.faults.append(fault)
        opened = self._silence.opened
        assert opened is not None
        assert opened.virtual is not None
        self.shutter.append(opened.virtual.plant.shutter_open.at(opened.rig.clock.now()))
        return self._answer


@pytest.mark.parametrize("policy", ["retry", "reconnect"])
def test_a_retried_row_has_the_data_of_an_undisturbed_run(policy: str, make: MakePlan, tmp_path: Path) -> None:
    plan = make(f'\n[faults]\nwire = "{policy}"\n')
    run_plan(plan, tmp_path / "whole.journal")
    silence = Silence(2)
    run = run_with_silence(plan, tmp_path / "a.journal", silence)
    assert run.state is State.DONE
    assert planned_values(tmp_path / "a.journal") == planned_values(tmp_path / "whole.journal")
    texts = [text for kind, text in run.events if kind == "fault"]
    assert (
        len(
            [
                text
                for text in texts
                if "Photodiodes module 2 (ADAM-6017) is not responding" in text and plan.rows[ROW].identity in text
            ]
        )
        >= 2
    )
    recovered = [State.RECOVERING, State.RUNNING]
    assert silence.states == [State.RUNNING, *recovered, *recovered, State.DONE]
    assert run.faults == []


def test_after_the_last_attempt_the_policy_then_applies(make: MakePlan, tmp_path: Path) -> None:
    stopped = run_with_silence(make("\n[faults]\nattempts = 2\n"), tmp_path / "stop.journal", Silence(9))
    assert (stopped.state, len(stopped.rows)) == (State.FAILED, ROW)
    assert stopped.faults[0].startswith("Photodiodes module 2 (ADAM-6017) is not responding: ")
    skipped = run_with_silence(make('\n[faults]\nattempts = 2\nthen = "skip"\n'), tmp_path / "skip.journal", Silence(9))
    assert skipped.state is State.DONE
    assert [each.row.number for each in skipped.rows if each.data.flags] == [ROW]
    assert skipped.rows[ROW].data.flags == (SKIPPED,)
    assert skipped.rows[ROW].data.readings == ()


def test_a_skipped_row_is_not_in_the_bsdf(make: MakePlan, tmp_path: Path) -> None:
    plan = make('\n[faults]\nwire = "skip"\n')
    row = next(row.number for row in plan.rows if row.kind == "measure" and row.sample == "gaussian-5")
    run_with_silence(plan, tmp_path / "a.journal", Silence(9, row))
    with Journal.open(tmp_path / "a.journal") as journal:
        points = reduce_journal(journal).samples["gaussian-5"]
    skipped = plan.rows[row].pose
    assert skipped is not None
    assert set(points.shift_deg) == {0.0, 1.0} - {skipped[3]}


@pytest.mark.parametrize(
    ("answer", "state", "flags"),
    [(Answer.RETRY, State.DONE, ()), (Answer.SKIP, State.DONE, (SKIPPED,)), (Answer.STOP, State.FAILED, None)],
)
def test_with_ask_the_operator_decides(
    make: MakePlan, tmp_path: Path, answer: Answer, state: State, flags: tuple[str, ...] | None
) -> None:
    silence = Silence(1)
    operator = FaultOperator(silence, answer)
    run = run_with_silence(make('\n[faults]\nwire = "ask"\n'), tmp_path / "a.journal", silence, operator)
    assert run.state is state
    assert len(operator.faults) == 1
    assert operator.shutter == [False]
    assert operator.faults[0].endswith(": Photodiodes module 2 (ADAM-6017) is not responding: check address, cable and power")
    assert [each.data.flags for each in run.rows[ROW:]][:1] == ([] if flags is None else [flags])
    assert any(kind == "answer" and text.startswith(answer) for kind, text in run.events)


@pytest.mark.parametrize(("waited_s", "darks"), [(30.0, 0), (300.0, 1)])
def test_after_a_long_question_a_dark_reading_is_taken_before_the_row(
    make: MakePlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, waited_s: float, darks: int
) -> None:
    """The dark reading may be 60 s old, and the question was open for longer."""
    silence = Silence(1)
    operator = FaultOperator(silence, Answer.RETRY)
    ask = operator.resolve_fault

    def ask_for_long(fault: str, /, *, skippable: bool, device: str = "", axis: UnreferencedAxis | None = None) -> Answer:
        assert silence.opened is not None
        clock = silence.opened.rig.clock
        clock.sleep_until(clock.now() + waited_s)
        return ask(fault, skippable=skippable, device=device, axis=axis)

    monkeypatch.setattr(operator, "resolve_fault", ask_for_long)
    plan = make('\n[faults]\nwire = "ask"\n')
    run = run_with_silence(plan, tmp_path / "a.journal", silence, operator)
    assert run.state is State.DONE
    renewed = [len(plan.rows)] * darks
    assert [each.row.number for each in run.rows] == [*range(ROW), *renewed, *range(ROW, len(plan.rows))]
    assert all(each.row.kind == "dark" for each in run.rows if each.row.unplanned)
    assert len(operator.faults) == 1


def test_where_there_is_nobody_to_ask_no_answer_of_an_operator_is_recorded(make: MakePlan, tmp_path: Path) -> None:
    run = run_with_silence(make('\n[faults]\nwire = "ask"\n'), tmp_path / "a.journal", Silence(1))
    assert run.state is State.FAILED
    [text] = [text for kind, text in run.events if kind == "no operator"]
    assert text.startswith("no operator: the program itself operates this simulated rig (at ")
    assert not any(kind == "answer" for kind, _ in run.events)


def test_a_terminal_takes_the_beginning_of_an_answer_and_never_enter_alone(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n s\nSK\n"))
    operator = HumanOperator(ask_operator)
    assert operator.resolve_fault("row 3: monitor: no reply", skippable=True) is Answer.SKIP
    shown = capsys.readouterr().err
    assert shown.count("Type Retry or Skip row or Stop") == 2  # after Enter, and after what may be Skip row or Stop
    assert "Pause" not in shown
    with pytest.raises(UserError, match="standard input is closed"):
        operator.mount("paper")
    monkeypatch.setattr("sys.stdin", io.StringIO("st\n"))
    with pytest.raises(Stopped):
        operator.mount("paper")


def test_a_shutter_that_cannot_be_closed_for_the_operator_is_a_safety_order(make: MakePlan, tmp_path: Path) -> None:
    plan = make('\n[faults]\nwire = "ask"\n')
    silence = Silence(1)

    def prepare(opened: OpenRig) -> None:
        silence.prepare(opened)
        monochromator = opened.rig.monochromator
        start = monochromator.start_shutter

        def start_shutter(*, opened: bool) -> Pending:
            if not opened and any(isinstance(each, StateChanged) and each.reason for each in silence.events):
                raise NoAnswer("monochromator", "SHUTTER C", "no reply")
            return start(opened=opened)

        monochromator.start_shutter = start_shutter  # type: ignore[method-assign]

    run = run_plan(plan, tmp_path / "a.journal", prepare, FaultOperator(silence, Answer.STOP), [silence.listen])
    orders = [text for kind, text in run.events if kind == "order"]
    assert orders[0] == "Close the shutter by hand: it may be open; Monochromator (Cornerstone 260) is not responding"
    assert [each.text for each in silence.events if isinstance(each, SafetyOrder)] == orders
    fault = next(each for each in silence.events if isinstance(each, EventLogged) and each.kind == "fault")
    assert (fault.where, fault.consequence) == (plan.rows[ROW].identity, "ask the operator")
    assert fault.what == "Photodiodes module 2 (ADAM-6017) is not responding: check address, cable and power"
    assert fault.detail == "resynchronise after a fault: not responding"
    assert "; close the shutter by hand (" in run.faults[-1]


def test_without_a_table_of_policies_a_row_is_repeated_twice(make: MakePlan, tmp_path: Path) -> None:
    silence = Silence(2)
    run = run_with_silence(make(""), tmp_path / "a.journal", silence)
    assert run.state is State.DONE
    assert silence.states.count(State.RECOVERING) == 2


def test_without_a_table_of_policies_a_fault_that_stays_stops_the_run_and_closes_the_shutter(
    make: MakePlan, tmp_path: Path
) -> None:
    silence = Silence(9)
    open_at_the_end: list[bool] = []

    def look(event: Event) -> None:
        if isinstance(event, StateChanged) and event.state is State.FAILED:
            assert silence.opened is not None
            assert silence.opened.virtual is not None
            virtual = silence.opened.virtual
            open_at_the_end.append(virtual.plant.shutter_open.at(virtual.clock.now()))

    run = run_plan(make(""), tmp_path / "a.journal", silence.prepare, None, [silence.listen, look])
    assert run.state is State.FAILED
    assert silence.states.count(State.RECOVERING) == 2
    assert open_at_the_end == [False]


def test_a_number_of_skipped_rows_ends_the_run(make: MakePlan, tmp_path: Path) -> None:
    run = run_with_silence(make('\n[faults]\nwire = "skip"\n\n[stop]\nskipped_rows = 1\n'), tmp_path / "a.journal", Silence(9))
    assert (run.state, len(run.rows)) == (State.IDLE, ROW + 1)
    assert any(kind == "stop" and "1 rows of this session were skipped" in text for kind, text in run.events)


def test_the_time_limit_ends_the_run(make: MakePlan, tmp_path: Path) -> None:
    plan = make("\n[stop]\nlongest_s = 12\n")
    run = run_plan(plan, tmp_path / "a.journal")
    assert run.state is State.IDLE
    assert 0 < len(run.rows) < len(plan.rows)
    assert 12.0 <= run.rows[-1].data.ended_s < 12.0 + max(row.seconds for row in plan.rows)


def test_a_failing_lamp_ends_the_run(make: MakePlan, tmp_path: Path) -> None:
    def dim_lamp(opened: OpenRig) -> None:
        assert opened.virtual is not None
        plant = opened.virtual.plant
        opened.rig.clock.at(12.0, lambda: plant.set_lamp(12.0, level=0.4))

    run = run_plan(make("\n[stop]\nlamp_below = 0.5\n"), tmp_path / "a.journal", dim_lamp)
    assert run.state is State.IDLE
    assert any(kind == "stop" and "the lamp is at 40.0 %" in text for kind, text in run.events)


def test_after_a_resume_the_lamp_is_compared_with_its_first_value(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """The lamp loses a thirtieth of its light per second: half of it is left after 15 s; the run is stopped at 11.5 s."""
    rig = read_rig(write_rig(QUIET[0], ("drift_per_hour = 0.02", "drift_per_hour = -120.0")))
    plan = make_plan(read_schedule(write_schedule(text=SMALL + "\n[stop]\nlamp_below = 0.6\n")), rig)
    run_until(plan, tmp_path / "a.journal", 11.5)
    assert resume_campaign(tmp_path / "a.journal").state is State.IDLE
    with Journal.open(tmp_path / "a.journal") as journal:
        before, after = (each for each in journal.rows() if each.data.positions)
    assert after.data.readings[0].monitor_a < 0.6 * before.data.readings[0].monitor_a


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (NoAnswer("monitor", "read", "no answer"), "wire"),
        (BadAnswer("axes", "read", "checksum"), "wire"),
        (Forgotten("photodiodes module 1", "read", "reset"), "reset"),
        (Refused("monochromator", "go", "no"), "refused"),
        (LimitError("sigma", "go", "no"), "refused"),
        (Unreferenced("sigma", "go", "unreferenced"), "axis"),
        (DeviceError("beta", "go", "the axis has stalled"), "axis"),
        (DeviceError("monitor", "read", "overrange"), "refused"),
    ],
)
def test_each_error_has_a_kind(error: DeviceError, kind: str) -> None:
    assert fault_kind(error) == kind


def test_a_stop_is_never_overridden_by_a_policy(make: MakePlan) -> None:
    table = make('\n[faults]\nrefused = "retry"\n').schedule.file.faults
    assert FaultPolicies(table).policy_for(Interrupted("beta", "go", "not sent because a stop was requested")) == "stop"
    assert FaultPolicies(table).policy_for(Taken("axes", "go", "another program has taken the controller")) == "stop"
