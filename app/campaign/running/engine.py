"""The engine: brings a plan's rows to the rig one after the other, and each to the journal before the next begins.

Plain Python for one thread; pause, resume and stop may come from any other. It knows no window and no plot.
"""

import contextlib
import threading
from collections.abc import Callable, Sequence
from functools import partial
from itertools import accumulate
from typing import TypeVar

from goniotwin.app.campaign.journal.record import RowData
from goniotwin.app.campaign.journal.writing import Journal, JournalError, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import SKIPPED, Row
from goniotwin.app.campaign.running.events import Event, Listener, Positions, RowCommitted, RowStarted, State, StateChanged
from goniotwin.app.campaign.running.operator import Operator
from goniotwin.app.campaign.running.recovery import POLICY_TEXT, FaultPolicies, Recovery
from goniotwin.app.campaign.running.rows import RowExecutor
from goniotwin.app.campaign.running.stop_conditions import StopConditions
from goniotwin.app.campaign.running.stop_request import Stopped, StopRequest
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES
from goniotwin.drivers import DeviceError, Rig, Until

T = TypeVar("T")


class EndedBySchedule(Exception):
    """The run ends here as the schedule says, in good order."""


class Engine:
    """Runs a plan once.

    `positions_every_s` has the axes asked for their positions so often while they move, for people who watch; 0 never,
    so that nothing but the rows is on the wires. `work` are the rows that are left, where some are done already.
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
    ) -> None:
        self._rig = rig
        self._clock = rig.clock
        self._plan = plan
        self._journal = journal
        self._operator = operator
        self._listeners = list(listeners or [])
        self._positions_every_s = positions_every_s
        self._positions_due = 0.0
        self.faults: list[str] = []
        self.ended_by_schedule = ""
        self._state = State.IDLE
        self._changed = threading.Condition()
        self._pause = False
        self._halt = StopRequest(rig)
        self._performer = RowExecutor(rig, operator, self._halt, self._between, self._note)
        self._recovery = Recovery(rig, self._halt, self._performer.wait)
        self._endings = StopConditions(plan.schedule.file, plan.rig.file)
        self._work = plan.rows if work is None else work
        left = list(accumulate((row.seconds for row in reversed(self._work)), initial=0.0))
        self._seconds_left = left[::-1]

    @property
    def state(self) -> State:
        """What it is at."""
        return self._state

    def run(self) -> State:
        """Carries the plan out; returns done, failed, or idle where it was stopped. Blocks.

        Raises UserError, before anything has happened, where the journal of a campaign to be gone on with is damaged.
        """
        outcome, reason, session = State.DONE, "", 0
        self._recall()
        self._enter(State.RUNNING)
        try:
            session = self._journal.begin_session(self._clock.now(), self._plan.rig.text, software_versions())
            self._reference()
            self._do_rows()
            self._under_policies("the end", self._close_shutter)
        except (Stopped, KeyboardInterrupt):
            outcome, reason = State.IDLE, "stopped"
        except EndedBySchedule as ended:
            outcome, reason = State.IDLE, str(ended)
            self.ended_by_schedule = reason
        except (JournalError, UserError) as error:
            outcome, reason = State.FAILED, str(error)
        except DeviceError as error:
            if self._halt.said:  # the stop frames came between a question and its answer
                outcome, reason = State.IDLE, "stopped"
            else:
                outcome, reason = State.FAILED, str(error)
        except BaseException as error:
            # A mistake of ours, or of whoever mounts samples: the axes come to rest all the same, and it is told.
            self._wind_up(session, State.FAILED, f"{type(error).__name__}: {error}")
            self._enter(State.FAILED, str(error))
            raise
        self._wind_up(session, outcome, reason)
        self._enter(outcome, reason)
        return outcome

    def pause(self) -> None:
        """From the next row on it waits, with the shutter closed. From any thread."""
        with self._changed:
            if self._state in (State.RUNNING, State.RECOVERING):
                self._pause = True
                self._enter(State.PAUSING)

    def resume(self) -> None:
        """It goes on where it paused. From any thread."""
        with self._changed:
            self._pause = False
            if self._state is State.PAUSING:
                self._enter(State.RUNNING)
            self._changed.notify_all()

    def stop(self) -> list[DeviceError]:
        """The axes come to rest now, and nothing else moves; returns what could not be told to its axis. From any thread."""
        failures = self._halt.say()
        with self._changed:
            if self._state in (State.RUNNING, State.RECOVERING, State.PAUSING, State.PAUSED):
                self._enter(State.STOPPING)
            self._changed.notify_all()
        return failures

    def _recall(self) -> None:
        """What earlier sessions have measured, for what is compared with it."""
        if self._work is self._plan.rows:
            return
        for each in self._journal.rows():
            self._endings.recall(each.row, each.data)
            if each.row.kind == "dark":
                self._performer.remember(each.data)

    def _reference(self) -> None:
        """Where a campaign is gone on with, axes that have lost themselves meanwhile look for their reference first."""
        lost = [] if self._work is self._plan.rows else self._recovery.lost_axes
        for axis in lost:
            self._note("home", f"{axis.name}: {axis.unreferenced_reason}")
            self._under_policies(f"homing {axis.name}", partial(self._recovery.home, axis))

    def _do_rows(self) -> None:
        before, planned = 0, len(self._plan.rows)
        if self._work is not self._plan.rows:
            added = [row for row in self._work if row.number >= planned]
            before = planned - (len(self._work) - len(added))
            self._journal.add_rows(added)
        self._endings.begun_s = self._clock.now()
        for k, row in enumerate(self._work, 1):
            self._gate()
            self._tell(RowStarted(row))
            data = self._done(row)
            self._journal.commit(row, data)
            self._tell(RowCommitted(row, data, before + k, before + len(self._work), self._seconds_left[k]))
            said = self._endings.look(row, data)
            if said is not None:
                self._note(*said)
                if said[0] == "stop" and k < len(self._work):
                    self._under_policies("the end", self._close_shutter)
                    raise EndedBySchedule(said[1])

    def _done(self, row: Row) -> RowData:
        """The row, or what is committed in its place where it is skipped. Raises DeviceError where the run is to stop."""
        begun = self._clock.now()
        # Without what is to be mounted the rows after it would be another sample's: that is never left out.
        mounts = row.kind == "mount"

        def performed() -> RowData:
            if not mounts:
                self._recovery.again()
            return self._performer.perform(row)

        data = self._under_policies(row.identity, performed, skippable=not mounts)
        if data is None:
            return RowData(begun, self._clock.now(), None, (), (SKIPPED,))
        self._tell_positions(data)
        return data

    def _under_policies(self, what: str, action: Callable[[], T], *, skippable: bool = False) -> T | None:
        """Does something as often as its faults' policies have it done again; None where they have it left out.

        Raises DeviceError where the run is to stop, or what is not `skippable` would be left out.
        """
        policies = FaultPolicies(self._plan.schedule.file.faults)
        while True:
            try:
                return action()
            except DeviceError as error:
                self._halt.heed()
                policy = policies.about(error)
                if policy == "stop" or (policy == "skip" and not skippable):
                    raise
                self._note("fault", f"{error} (at {what}: {POLICY_TEXT[policy]})")
                self._enter_unless_pausing(State.RECOVERING, str(error))
                self._performer.forget()
                if policy == "ask" and not self._mended(f"{what}: {error}"):
                    raise
                for failure in self._recovery.rest() if policy == "retry" else self._recovery.reconnect(error.device):
                    self._note("fault", f"{failure} (after a fault at {what})")
                if policy == "skip":
                    return None
                self._performer.wait(Until(self._clock, self._clock.now() + policies.wait_s))
                self._enter_unless_pausing(State.RUNNING)

    def _mended(self, fault: str) -> bool:
        """Whether somebody has mended it; meanwhile the shutter is closed, if that can be."""
        with contextlib.suppress(DeviceError):
            self._performer.shutter(opened=False)
        mended = self._operator.mend(fault)
        self._performer.forget()
        return mended

    def _wind_up(self, session: int, outcome: State, reason: str) -> None:
        """Axes at rest where the plan did not end by itself; what went wrong into the journal, if that can be written."""
        now = self._clock.now()
        failures = [] if outcome is State.DONE else [str(failure) for failure in self._rig.stop()]
        self.faults = ([reason] if outcome is State.FAILED else []) + failures
        for fault in self.faults:
            self._told(now, fault)
        if outcome is State.FAILED and not self._halt.said:
            try:
                self._close_shutter()
            except DeviceError as error:
                self.faults.append(f"{error}; close the shutter by hand")
                self._told(now, self.faults[-1])
            except (Stopped, KeyboardInterrupt):
                pass  # nothing moves any more
        with contextlib.suppress(JournalError):
            ended = {State.DONE: "done", State.FAILED: "failed"}.get(outcome, "stopped")
            self._journal.end_session(session, now, ended)

    def _told(self, t: float, fault: str) -> None:
        with contextlib.suppress(JournalError):
            self._journal.event(t, "fault", fault)

    def _gate(self) -> None:
        """Between rows: where a pause takes effect."""
        self._halt.heed()
        if not self._pause:
            self._enter_unless_pausing(State.RUNNING)
            return
        self._under_policies("the pause", self._close_shutter)
        with self._changed:
            if not self._halt.said:
                self._enter(State.PAUSED)
            self._changed.wait_for(lambda: self._halt.said or not self._pause)
        self._halt.heed()
        self._enter(State.RUNNING)

    def _close_shutter(self) -> None:
        """A plan ends with a dark, so it is closed already; where it is not, the lamp should not bleach the sample."""
        if self._performer.shutter_may_be_open:
            self._performer.shutter(opened=False)

    def _between(self) -> None:
        self._halt.heed()
        now = self._clock.now()
        if self._positions_every_s and now >= self._positions_due:
            self._positions_due = now + self._positions_every_s
            self._tell(Positions({name: axis.position_deg() for name, axis in self._rig.axes.items()}))

    def _tell_positions(self, data: RowData) -> None:
        where = data.positions
        if self._positions_every_s and where is not None:
            self._tell(Positions({name: value for name in AXES if (value := where[name]) is not None}))

    def _enter(self, state: State, reason: str = "") -> None:
        with self._changed:
            self._state = state
        self._tell(StateChanged(state, reason))

    def _enter_unless_pausing(self, state: State, reason: str = "") -> None:
        """A pause that has been asked for is not forgotten over a fault."""
        with self._changed:
            if self._state is not state and self._state in (State.RUNNING, State.RECOVERING):
                self._enter(state, reason)

    def _note(self, kind: str, text: str) -> None:
        self._journal.event(self._clock.now(), kind, text)

    def _tell(self, event: Event) -> None:
        """A listener that fails is dropped and named in the journal: what it shows is lost, the run is not."""
        for listener in list(self._listeners):
            try:
                listener(event)
            except Exception as error:  # noqa: BLE001  (whatever a plot or a file throws)
                self._listeners.remove(listener)
                with contextlib.suppress(JournalError):
                    self._journal.event(self._clock.now(), "listener", f"{type(error).__name__}: {error}")
