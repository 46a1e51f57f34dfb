"""The engine: brings a plan's rows to the rig one after the other, and each to the journal before the next begins.

Plain Python for one thread; pause, resume and stop may come from any other. It knows no window and no plot.
"""

import contextlib
import threading
from itertools import accumulate

from app.campaign.events import Event, Listener, Positions, RowCommitted, RowStarted, State, StateChanged
from app.campaign.journal import Journal, JournalError, Reading, RowData
from app.campaign.operator import Operator
from app.campaign.plan import Plan
from app.campaign.row import Row
from app.errors import UserError
from app.rig import AXES
from drivers import DeviceError, Pending, Rig, Until, wait


class Stopped(Exception):
    """Somebody has said stop."""


class Engine:
    """Runs a plan once.

    `positions_every_s` has the axes asked for their positions so often while they move, for people who watch; 0 never,
    so that nothing but the rows is on the wires.
    """

    def __init__(
        self,
        rig: Rig,
        plan: Plan,
        journal: Journal,
        operator: Operator,
        listeners: list[Listener] | None = None,
        positions_every_s: float = 0.0,
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
        self._state = State.IDLE
        self._changed = threading.Condition()
        self._motion = threading.RLock()
        self._stop = False
        self._pause = False
        self._commanded: dict[str, float] = {}
        self._wavelength_nm: float | None = None
        self._shutter_open: bool | None = None
        self._gain: int | None = None
        left = list(accumulate((row.seconds for row in reversed(plan.rows)), initial=0.0))
        self._seconds_left = left[::-1]

    @property
    def state(self) -> State:
        """What it is at."""
        return self._state

    def run(self) -> State:
        """Carries the plan out; returns done, failed, or idle where it was stopped. Blocks."""
        self._enter(State.RUNNING)
        outcome, reason, session = State.DONE, "", 0
        try:
            session = self._journal.begin_session(self._clock.now())
            for row in self._plan.rows:
                self._gate()
                self._tell(RowStarted(row))
                data = self._perform(row)
                self._journal.commit(row, data)
                left = self._seconds_left[row.number + 1]
                self._tell(RowCommitted(row, data, row.number + 1, len(self._plan.rows), left))
            self._close_shutter_at_the_end()
        except (Stopped, KeyboardInterrupt):
            outcome, reason = State.IDLE, "stopped"
        except (JournalError, UserError) as error:
            outcome, reason = State.FAILED, str(error)
        except DeviceError as error:
            if self._stop:  # the stop frames came between a question and its answer
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

    def _wind_up(self, session: int, outcome: State, reason: str) -> None:
        """Axes at rest where the plan did not end by itself; what went wrong into the journal, if that can be written."""
        now = self._clock.now()
        failures = [] if outcome is State.DONE else [str(failure) for failure in self._rig.stop()]
        self.faults = ([reason] if outcome is State.FAILED else []) + failures
        with contextlib.suppress(JournalError):
            for fault in self.faults:
                self._journal.event(now, "fault", fault)
            ended = {State.DONE: "done", State.FAILED: "failed"}.get(outcome, "stopped")
            self._journal.end_session(session, now, ended)

    def pause(self) -> None:
        """From the next row on it waits, with the shutter closed. From any thread."""
        with self._changed:
            if self._state is State.RUNNING:
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
        self._stop = True
        failures = self._rig.stop()
        with self._motion:  # an axis that was being started meanwhile has been started by now, and is stopped here
            failures = self._rig.stop() or failures
        with self._changed:
            if self._state in (State.RUNNING, State.PAUSING, State.PAUSED):
                self._enter(State.STOPPING)
            self._changed.notify_all()
        return failures

    def _gate(self) -> None:
        """Between rows: where a pause takes effect."""
        self._heed()
        if not self._pause:
            return
        self._shutter(opened=False)
        with self._changed:
            if not self._stop:
                self._enter(State.PAUSED)
            self._changed.wait_for(lambda: self._stop or not self._pause)
        self._heed()
        self._enter(State.RUNNING)

    def _heed(self) -> None:
        if self._stop:
            raise Stopped

    def _perform(self, row: Row) -> RowData:
        started = self._clock.now()
        if row.kind == "mount":
            self._shutter(opened=False)
            self._operator.mount(row.sample)
            self._heed()
            return RowData(started, self._clock.now(), None, ())
        if row.kind == "dark":
            self._shutter(opened=False)
            readings = self._read(row)
            return RowData(started, self._clock.now(), None, readings)
        self._move(row)
        readings = self._read(row)
        positions = self._read_back()
        return RowData(started, self._clock.now(), positions, readings)

    def _move(self, row: Row) -> None:
        """Axes and wavelength to the row's pose, shutter open, everything at rest and settled."""
        assert row.pose is not None
        assert row.wavelength_nm is not None
        settling = 0.0
        moves: list[Pending] = []
        for name, target in zip(AXES, row.pose, strict=True):
            if self._commanded.get(name) != target:
                axis = self._rig.axes[name]
                with self._motion:
                    self._heed()
                    moves.append(self._rig.start(name, target))
                self._commanded[name] = target
                settling = max(settling, axis.settings.settling_s)
        if row.wavelength_nm != self._wavelength_nm:
            with self._motion:
                self._heed()
                moves.append(self._rig.monochromator.start_wavelength(row.wavelength_nm))
            self._wavelength_nm = row.wavelength_nm
        self._wait(*moves)
        self._shutter(opened=True)
        if settling:
            self._wait(Until(self._clock, self._clock.now() + settling))

    def _read(self, row: Row) -> tuple[Reading, ...]:
        """All photodiodes at each gain of the row, and the monitor over the same time."""
        photodiodes, monitor = self._rig.photodiodes, self._rig.monitor
        settings = photodiodes.settings
        taken = []
        for gain in row.gains:
            if gain != self._gain:
                self._wait(photodiodes.start_gain(gain))
                self._gain = gain
            readings = photodiodes.start_readings(row.readings)
            # A channel's first reading was converted up to a period ago: the monitor begins with it.
            self._wait(Until(self._clock, readings.started - settings.period_s))
            mean = monitor.start_mean(row.readings * settings.period_s)
            self._wait(readings, mean)
            taken.append(
                Reading(settings.gains_v_per_a[gain], readings.started, settings.period_s, mean.current_a, readings.counts)
            )
        return tuple(taken)

    def _read_back(self) -> dict[str, float | None]:
        """Counters and encoders of all axes, in degrees. Raises DeviceError where one is lost: there is no row of it then."""
        found: dict[str, float | None] = {}
        for name, axis in self._rig.axes.items():
            found[name], encoder = axis.read_back()
            if axis.settings.encoder:
                found[f"{name}_encoder"] = encoder
        if self._positions_every_s:
            self._tell(Positions({name: value for name in AXES if (value := found[name]) is not None}))
        return found

    def _shutter(self, *, opened: bool) -> None:
        if self._shutter_open is not opened:
            with self._motion:
                self._heed()
                started = self._rig.monochromator.start_shutter(opened=opened)
            self._wait(started)
            self._shutter_open = opened

    def _close_shutter_at_the_end(self) -> None:
        """The plan ends with a dark, so it is closed already; where it is not, the lamp should not bleach the sample."""
        if self._shutter_open:
            self._shutter(opened=False)

    def _wait(self, *started: Pending) -> None:
        wait(self._clock, started, self._between)
        self._heed()  # a stop may have come with the last answer

    def _between(self) -> None:
        self._heed()
        now = self._clock.now()
        if self._positions_every_s and now >= self._positions_due:
            self._positions_due = now + self._positions_every_s
            self._tell(Positions({name: axis.position_deg() for name, axis in self._rig.axes.items()}))

    def _enter(self, state: State, reason: str = "") -> None:
        with self._changed:
            self._state = state
        self._tell(StateChanged(state, reason))

    def _tell(self, event: Event) -> None:
        """A listener that fails is dropped and named in the journal: what it shows is lost, the run is not."""
        for listener in list(self._listeners):
            try:
                listener(event)
            except Exception as error:  # noqa: BLE001  (whatever a plot or a file throws)
                self._listeners.remove(listener)
                with contextlib.suppress(JournalError):
                    self._journal.event(self._clock.now(), "listener", f"{type(error).__name__}: {error}")
