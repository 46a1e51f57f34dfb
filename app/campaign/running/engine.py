"""The engine: executes the rows of a plan one after the other, and commits each to the journal before the next starts.

Plain Python for one thread; pause, resume and stop may be called from any other. It knows no window and no plot.
"""

import contextlib
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import accumulate, islice
from typing import TypeVar

import numpy as np

from goniotwin.app.campaign.geometry.directions import scan_plane_deg
from goniotwin.app.campaign.journal.mounting import event_words
from goniotwin.app.campaign.journal.place import JournalError
from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import SKIPPED, WAKE_PREFIX, Row, RowData
from goniotwin.app.campaign.running.event_log import log_listeners
from goniotwin.app.campaign.running.events import (
    DeviceFailed,
    Event,
    EventLogged,
    Listener,
    Positions,
    RowCommitted,
    RowStarted,
    SafetyOrder,
    State,
    StateChanged,
    close_shutter_order,
    cut_power_order,
)
from goniotwin.app.campaign.running.operator import Operator
from goniotwin.app.campaign.running.question import Answer, PositionGiven
from goniotwin.app.campaign.running.recovery import POLICY_TEXT, FaultPolicies, Recovery
from goniotwin.app.campaign.running.rig_executor import RigExecutor
from goniotwin.app.campaign.running.sleep import NoSleepWatch, SleepWatch, StayAwake, watch_for
from goniotwin.app.campaign.running.stop import EndedByOperator, EndedBySchedule, StopConditions, Stopped, StopRequest
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES
from goniotwin.drivers import DeviceError, LimitError, Rig, Until
from goniotwin.drivers.errors import FaultText

T = TypeVar("T")
Cut = tuple[str, float, float, float]
"""Sample, gamma, sigma and scan plane, deg."""
REFERENCED_BY = (Answer.HOME, Answer.SET_POSITION)
"""Answers after which an axis is referenced again."""
SHUTTER_MAY_BE_OPEN = "the shutter may be open; close it by hand"


class _DarkIsOld(Exception):
    """A question about a row lasted so long that the dark reading is too old for it: the row begins anew."""


class Engine:
    """Runs a plan once.

    `work` are the rows to execute, where some rows of the plan are measured already. `positions_every_s` is the time between
    two Positions events while axes move; with 0 the positions are not read, and only the rows use the wires. `sleep_watch`
    notices a sleep of this computer; without it that of the rig's clock.
    `faults` are the faults with which the run ended; `ended_by_schedule` is the reason where a stop condition ended it.
    """

    def __init__(
        self,
        rig: Rig,
        plan: Plan,
        journal: Journal,
        operator: Operator,
        listeners: list[Listener] | None = None,
        positions_every_s: float = 0.0,
        work: Sequence[Row] | None = None,
        sleep_watch: SleepWatch | None = None,
    ) -> None:
        self._rig = rig
        self._clock = rig.clock
        self._plan = plan
        self._journal = journal
        self._operator = operator
        self._listeners = [*log_listeners(), *(listeners or [])]
        self._positions_every_s = positions_every_s
        self._positions_due = 0.0
        self.faults: list[str] = []
        self.ended_by_schedule = ""
        self._power_order_given = False
        self._ordering = threading.Lock()
        self._state = State.IDLE
        self._action = ""
        self._changed = threading.Condition()
        self._pause = False
        self._finish_cut = False
        self._cut: Cut | None = None
        self._stop_request = StopRequest(rig)
        self._executor = RigExecutor(rig, operator, self._stop_request, self._on_poll, self._log_event, on_light=self._notify)
        self._recovery = Recovery(rig, self._stop_request, self._executor.wait)
        self._sleep_watch = sleep_watch or watch_for(rig.clock)
        self._stay_awake = StayAwake()
        self._sleeps, self._dark_is_old = 0, False
        self._dark_s = math.inf
        self._stop_conditions = StopConditions(plan.schedule.file, plan.rig.file)
        self._resumed = work is not None and work is not plan.rows
        self._work = plan.rows if work is None else work
        left = list(accumulate((row.seconds for row in reversed(self._work)), initial=0.0))
        self._seconds_left = left[::-1]
        self._done = self._measured = 0

    @property
    def state(self) -> State:
        """The state of the engine."""
        return self._state

    @property
    def shutter_may_be_open(self) -> bool:
        """Whether the shutter is open or its state is unknown."""
        return self._executor.shutter_may_be_open

    @property
    def gain(self) -> int | None:
        """The gain of all amplifiers, by its index; None where it is not known."""
        return self._executor.gain

    @property
    def disconnected(self) -> tuple[str, ...]:
        """The devices that a fault has left without connection."""
        return self._recovery.disconnected

    def run(self) -> State:
        """Execute the rows; return DONE, FAILED, or IDLE after a stop. Blocks.

        Raises UserError before anything moves where the journal of a resumed campaign is damaged.
        """
        outcome, reason, session = State.DONE, FaultText(""), 0
        self._read_earlier_rows()
        self._enter(State.PAUSING if self._pause else State.RUNNING)
        try:
            session = self._journal.begin_session(self._clock.now(), self._plan.rig.text, software_versions())
            self._prevent_sleep()
            self._home_unreferenced()
            self._execute_rows()
            self._apply_policies("the end of the run", self._close_shutter)
        except (Stopped, KeyboardInterrupt):
            outcome, reason = State.IDLE, FaultText("stopped")
        except EndedByOperator as ended:
            outcome, reason = State.IDLE, FaultText(str(ended))
        except EndedBySchedule as ended:
            outcome, reason = State.IDLE, FaultText(str(ended))
            self.ended_by_schedule = str(ended)
        except (JournalError, UserError) as error:
            outcome, reason = State.FAILED, FaultText(str(error))
        except DeviceError as error:
            if self._stop_request.requested:  # the stop frames came between a request and its answer
                outcome, reason = State.IDLE, FaultText("stopped")
            else:
                outcome, reason = State.FAILED, self._rig.in_words(error)
        except BaseException as error:
            # An error of the program or of the operator's code: stop the axes and record it all the same.
            self._finish(session, State.FAILED, FaultText(f"{type(error).__name__}: {error}"))
            if self.shutter_may_be_open:
                error.add_note(SHUTTER_MAY_BE_OPEN)
            self._enter(State.FAILED, str(error))
            raise
        self._finish(session, outcome, reason)
        self._enter(outcome, reason.headline)
        return outcome

    def pause(self) -> None:
        """Pause before the next row, with the shutter closed; also before the first one. From any thread."""
        with self._changed:
            if self._state in (State.RUNNING, State.RECOVERING):
                self._pause = True
                self._enter(State.PAUSING)
            elif self._state is State.IDLE:
                self._pause = True

    def resume(self) -> None:
        """Continue after a pause. From any thread."""
        with self._changed:
            self._pause = False
            if self._state is State.PAUSING:
                self._enter(State.RUNNING)
            self._changed.notify_all()

    def finish_cut(self) -> None:
        """End the run in good order after the last row of the cut in progress. From any thread.

        A cut has one sample, sigma, gamma and scan plane, at all wavelengths. A run that is paused goes on to its end.
        """
        self._finish_cut = True
        self.resume()

    def stop(self) -> list[DeviceError]:
        """Stop all axes now and end the run; return the errors of axes that did not confirm. From any thread."""
        failures = self._stop_request.stop()
        with self._changed:
            if self._state in (State.RUNNING, State.RECOVERING, State.PAUSING, State.PAUSED):
                self._enter(State.STOPPING)
            self._changed.notify_all()
        self._give_power_order(failures)
        return failures

    def _read_earlier_rows(self) -> None:
        """Read the rows of earlier sessions, with which stop conditions and drift checks compare."""
        if not self._resumed:
            return
        for each in self._journal.rows():
            self._stop_conditions.add_earlier_row(each.row, each.data)
            self._executor.remember(each.row, each.data)

    def _home_unreferenced(self) -> None:
        """On resume, home unreferenced axes first; not to close the shutter alone."""
        axes = self._recovery.homeable_axes if self._resumed and self._work else []
        for axis in axes:
            self._log_event("home", f"{axis.name}: {axis.unreferenced_reason}", axis.name, "homing it")
            self._apply_policies(f"homing {axis.name}", partial(self._recovery.home, axis))

    def _execute_rows(self) -> None:
        planned = len(self._plan.rows)
        if self._resumed:
            unplanned = [row for row in self._work if row.number >= planned]
            self._measured = planned - (len(self._work) - len(unplanned))
            self._journal.add_rows(unplanned)
            first = next((row.number for row in self._work if row.number < planned), 0)
            measured = [row for row in self._plan.rows[:first] if row.kind == "measure"]
            self._cut = _cut_of(measured[-1]) if measured else None  # the interrupted one is in progress
        self._stop_conditions.session_start_s = self._clock.now()
        for k, row in enumerate(self._work, 1):
            self._wait_while_paused()
            self._end_after_cut(k)
            if row.kind == "mount":
                self._journal.checkpoint()  # a person may take an hour
            self._notify(RowStarted(row))
            data = self._execute_awake(row)
            self._done = k
            self._commit(row, data)
            event = self._stop_conditions.check(row, data)
            if event is not None:
                kind, text = event
                self._log_event(kind, text, row.identity, "the run ends" if kind == "stop" else "")
                if kind == "stop" and k < len(self._work):
                    self._apply_policies("the end of the run", self._close_shutter)
                    raise EndedBySchedule(text)

    def _end_after_cut(self, k: int) -> None:
        """Raise EndedByOperator before the k-th row, from 1, where that was requested and no row of the cut is left."""
        row = self._work[k - 1]
        if self._finish_cut:
            following = next((each for each in islice(self._work, k - 1, None) if each.kind == "measure"), None)
            if following is not None and _cut_of(following) != self._cut:
                self._apply_policies("the end of the run", self._close_shutter)
                raise EndedByOperator("ended after the cut, as requested")
        if row.kind == "measure":
            self._cut = _cut_of(row)

    def _execute_awake(self, row: Row) -> RowData:
        """Execute a row, after another dark reading where that is too old; repeat a row in which the computer slept."""
        self._slept()
        while True:
            if self._dark_is_old and row.kind in ("measure", "drift"):
                self._dark_is_old = False
                self._renew_dark(row.sample)
            sleeps = self._sleeps
            try:
                data = self._execute_row(row)
            except _DarkIsOld:
                continue
            self._slept()
            if self._sleeps == sleeps:
                self._dark_is_old = self._dark_is_old and row.kind != "dark"
            if self._sleeps == sleeps or row.kind == "mount":
                return data

    def _renew_dark(self, sample: str) -> None:
        """Take a dark reading as an unplanned row, if the plan has dark readings."""
        planned = next((row for row in self._plan.rows if row.kind == "dark"), None)
        if planned is not None:
            number = self._journal.last_number() + 1
            row = replace(planned, number=number, identity=f"{WAKE_PREFIX}{number}/{sample}/dark", sample=sample)
            self._journal.add_rows([row])
            self._notify(RowStarted(row))
            self._commit(row, self._execute_row(row))

    def _commit(self, row: Row, data: RowData) -> None:
        """Write a row to the journal, and notify the listeners."""
        self._journal.commit(row, data)
        if row.kind == "dark" and data.readings:
            self._dark_s = data.ended_s
        total = len(self._plan.rows)
        self._measured += row.number < total and SKIPPED not in data.flags
        self._notify(RowCommitted(row, data, self._measured, total, self._seconds_left[self._done]))

    def _slept(self) -> bool:
        """Whether the computer slept since the last call: devices and dark currents may be other than before."""
        seconds = self._sleep_watch.slept_s()
        if seconds:
            self._sleeps += 1
            self._dark_is_old = True
            self._executor.forget_settings(light=True)
            text = f"this computer slept for {seconds / 60.0:.1f} min; the row in progress and the dark reading are taken again"
            self._log_event("sleep", text)
        return seconds > 0.0

    def _note_wait(self) -> None:
        """A person was waited for: the dark reading may be older than the schedule allows by now."""
        if self._clock.now() - self._dark_s > self._plan.schedule.file.dark_every_s:
            self._dark_is_old = True

    def _prevent_sleep(self) -> None:
        """Keep the computer awake until the end of the run, unless the rig is in virtual time."""
        if not isinstance(self._sleep_watch, NoSleepWatch):
            reason = self._stay_awake.begin(f"measuring {self._plan.schedule.file.name}")
            if reason and not self._plan.rig.file.in_process:  # a virtual rig waits for a computer that sleeps
                self._log_event("sleep", f"this computer may go to sleep during the run: {reason}; switch its sleep off")

    def _execute_row(self, row: Row) -> RowData:
        """Execute a row; return its data, or empty data if it is skipped. Raises DeviceError where a fault stops the run."""
        started = self._clock.now()
        # A skipped mount would assign the rows after it to the wrong sample: a mount is never skipped.
        mounts = row.kind == "mount"

        def execute() -> RowData:
            if self._dark_is_old and row.kind in ("measure", "drift"):
                raise _DarkIsOld
            if not mounts:
                self._recovery.reconnect()
            return self._executor.execute(row)

        data = self._apply_policies(row.identity, execute, skippable=not mounts)
        if data is None:
            return RowData(started, self._clock.now(), None, (), (SKIPPED,))
        self._notify_positions(data)
        return data

    def _apply_policies(self, what: str, action: Callable[[], T], *, skippable: bool = False) -> T | None:
        """Perform an action, and after each fault follow its policy: retry, or return None where the action is skipped.

        Raises DeviceError where the policy is to stop the run, or to skip an action that is not `skippable`.
        """
        policies = FaultPolicies(self._plan.schedule.file.faults)
        self._action = what
        while True:
            try:
                return action()
            except DeviceError as error:
                self._stop_request.check()
                policy = policies.policy_for(error, slept=self._slept())
                self._notify(DeviceFailed(error))
                if policy == "stop" or (policy == "skip" and not skippable):
                    raise
                fault = self._rig.in_words(error)
                self._log_fault(fault, f"{fault} (at {what}: {POLICY_TEXT[policy]})", what, POLICY_TEXT[policy])
                self._enter_unless_pausing(State.RECOVERING, fault.headline)
                light = self._rig.monochromator
                self._executor.forget_settings(light=error.device in (light.name, *light.parts))
                answer = self._ask_operator(what, error, skippable=skippable) if policy == "ask" else None
                if answer is Answer.STOP:
                    raise
                if answer is Answer.PAUSE:
                    self._pause = True
                    self._wait_for_resume()
                if policy == "retry" or answer in REFERENCED_BY:  # the row finds what else is unreferenced
                    failures = self._recovery.wait_for_rest()
                else:
                    failures = self._recovery.recover(error.device, homing=answer is not Answer.SKIP)
                for failure in failures:
                    failed = self._rig.in_words(failure)
                    self._log_fault(failed, f"{failed} (after a fault at {what})", what)
                if policy == "skip" or answer is Answer.SKIP:
                    return None
                self._executor.wait(Until(self._clock, self._clock.now() + policies.wait_s))
                self._enter_unless_pausing(State.RUNNING)

    def _ask_operator(self, what: str, fault: DeviceError, *, skippable: bool) -> Answer:
        """Ask the operator to fix a fault, with the shutter closed, if necessary by hand.

        A fault that has left an axis unreferenced is asked about until the axis is referenced, or another answer is given.
        """
        try:
            self._executor.set_shutter(opened=False)
        except DeviceError as error:
            self._give_order(close_shutter_order(self._rig, error))
        self._journal.checkpoint()
        device, failure = self._rig.device(fault.device).name, ""
        while True:
            axis = self._recovery.unreferenced_axis(fault.device)
            # Without the remedy, which the answers are.
            happened = (
                self._rig.in_words(fault).headline if axis is None else f"{fault.device}: {fault.doing}: {fault.happened}"
            )
            text = f"{failure}{what}: {happened}"
            reply = self._operator.resolve_fault(text, skippable=skippable, device=device, axis=axis)
            self._note_wait()
            if reply is None:
                text = "no operator: the program itself operates this simulated rig"
                self._log_event("no operator", f"{text} (at {what}: the run ends)", what, "the run ends", text)
                return Answer.STOP
            answer, given = (Answer.SET_POSITION, reply) if isinstance(reply, PositionGiven) else (reply, None)
            given_text = f"{answer} to {given.angle_deg:.3f} deg" if given is not None else str(answer)
            self._log_event("answer", f"{given_text} (at {what})", what, "", f"Answer of the operator: {given_text}")
            self._executor.forget_settings()
            if answer not in REFERENCED_BY or axis is None:
                return answer
            try:
                if refusal := axis.refusal(given.angle_deg) if given is not None else "":
                    raise LimitError(axis.name, "set its position", refusal)
                self._recovery.reference(axis, reply)
            except DeviceError as error:
                self._stop_request.check()
                failed = self._rig.in_words(error)
                self._log_fault(failed, f"{failed} (at {what})", what)
                failure = f"{failed.headline}. Before: "
                self._recovery.wait_for_rest()  # counter and encoder are asked for with the next question
                continue
            return answer

    def _finish(self, session: int, outcome: State, reason: FaultText) -> None:
        """Stop the axes unless the plan is done, close the shutter, and record faults and end of session."""
        now = self._clock.now()
        try:
            self._bring_to_rest(now, outcome, reason)
        except KeyboardInterrupt:  # the first signal, in the middle of this: later ones are ignored
            self._bring_to_rest(now, outcome, reason)
        with contextlib.suppress(JournalError):
            ended = {State.DONE: "done", State.FAILED: "failed"}.get(outcome, "stopped")
            self._journal.end_session(session, now, ended)
        self._stay_awake.end()

    def _bring_to_rest(self, now: float, outcome: State, reason: FaultText) -> None:
        failures = [] if outcome is State.DONE else self._rig.stop()
        faults = [*([reason] if outcome is State.FAILED else []), *map(self._rig.in_words, failures)]
        self.faults = list(map(str, faults))
        for fault in faults:
            self._log_last_fault(now, fault)
        self._give_power_order(failures)
        try:
            if self._executor.close_shutter_after_stop():
                with contextlib.suppress(JournalError):
                    self._log_event("shutter", "closed after the stop", what="Shutter closed after the stop")
        except DeviceError as error:
            words = self._rig.in_words(error)
            fault = FaultText(f"{words.headline}; close the shutter by hand", words.detail)
            self.faults.append(str(fault))
            self._log_last_fault(now, fault)
            self._give_order(close_shutter_order(self._rig, error))

    def _log_fault(self, fault: FaultText, text: str, where: str, consequence: str = "") -> None:
        """Write a fault to the journal as `text`, and show its headline."""
        self._journal.event(self._clock.now(), "fault", text)
        self._notify(EventLogged("fault", fault.headline, where, consequence, fault.detail))

    def _log_last_fault(self, t: float, fault: FaultText) -> None:
        self._notify(EventLogged("fault", fault.headline, self._action, "the run ends", fault.detail))
        with contextlib.suppress(JournalError):
            self._journal.event(t, "fault", str(fault))

    def _give_power_order(self, failures: Sequence[DeviceError]) -> None:
        """Order to cut the power where a stop failed: once for a run, which is stopped by request and again at its end."""
        with self._ordering:
            if not self._power_order_given and (order := cut_power_order(self._rig, failures)) is not None:
                self._give_order(order)
                self._power_order_given = True

    def _give_order(self, order: SafetyOrder) -> None:
        """Give a safety order, and record it if possible. From any thread."""
        self._notify(order)
        with contextlib.suppress(JournalError):
            self._journal.event(self._clock.now(), "order", order.text)

    def _wait_while_paused(self) -> None:
        """Wait between two rows if a pause is requested. Raises Stopped."""
        self._stop_request.check()
        if not self._pause:
            self._enter_unless_pausing(State.RUNNING)
            return
        self._apply_policies("the pause", self._close_shutter)
        self._journal.checkpoint()
        self._wait_for_resume()

    def _wait_for_resume(self) -> None:
        """Wait until `resume` is called. Raises Stopped."""
        with self._changed:
            if not self._stop_request.requested:
                self._enter(State.PAUSED)
            self._changed.wait_for(lambda: self._stop_request.requested or not self._pause)
        self._stop_request.check()
        self._note_wait()
        self._enter(State.RUNNING)

    def _close_shutter(self) -> None:
        """Close the shutter unless it is known to be closed, so that the lamp does not bleach the sample."""
        if self._executor.shutter_may_be_open:
            self._executor.set_shutter(opened=False)

    def _on_poll(self) -> None:
        self._stop_request.check()
        now = self._clock.now()
        self._journal.tend(now)
        if self._positions_every_s and now >= self._positions_due:
            self._positions_due = now + self._positions_every_s
            self._notify(Positions({name: axis.position_deg() for name, axis in self._rig.axes.items()}))

    def _notify_positions(self, data: RowData) -> None:
        positions = data.positions
        if self._positions_every_s and positions is not None:
            encoders: dict[str, float | None] = {
                name: value for name in AXES if (value := positions.get(f"{name}_encoder")) is not None
            }
            self._notify(Positions({name: value for name in AXES if (value := positions[name]) is not None}, encoders))

    def _enter(self, state: State, reason: str = "") -> None:
        with self._changed:
            self._state = state
        self._notify(StateChanged(state, reason))

    def _enter_unless_pausing(self, state: State, reason: str = "") -> None:
        """Enter a state, but keep PAUSING: a fault does not cancel a requested pause."""
        with self._changed:
            if self._state is not state and self._state in (State.RUNNING, State.RECOVERING):
                self._enter(state, reason)

    def _log_event(self, kind: str, text: str, where: str = "", consequence: str = "", what: str = "") -> None:
        """Write an event to the journal, and show it; `what` is what of the text is neither place nor consequence."""
        self._journal.event(self._clock.now(), kind, text)
        self._notify(EventLogged(kind, what or event_words(kind, text).removeprefix(f"{where}: "), where, consequence))

    def _notify(self, event: Event) -> None:
        """Send an event to all listeners. A listener that fails is removed and named in the journal; the run continues."""
        for listener in list(self._listeners):
            try:
                listener(event)
            except Exception as error:  # noqa: BLE001  (a plot or a file may raise anything)
                self._listeners.remove(listener)
                with contextlib.suppress(JournalError):
                    self._journal.event(self._clock.now(), "listener", f"{type(error).__name__}: {error}")


def _cut_of(row: Row) -> Cut:
    assert row.pose is not None
    gamma, sigma, beta, _shift = row.pose
    return row.sample, gamma, sigma, _scan_plane_of(beta)


@lru_cache
def _scan_plane_of(beta_deg: float) -> float:
    return float(scan_plane_deg(np.array(beta_deg)))
