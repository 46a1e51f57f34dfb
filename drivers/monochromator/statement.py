"""A statement of the monochromator in progress: sent, polled until the unit is done, and checked.

With handshake mode the status shows that the unit is done; without it, the reply to an `STB?` sent behind the statement. If
either is lost, the line is resynchronised and the unit is queried: no statement is sent twice. With `ask_first` nothing is
sent if the unit is at its target already.
"""

from collections.abc import Callable

from goniotwin.drivers.errors import DeviceError, Interrupted, NoAnswer, Refused
from goniotwin.drivers.monochromator.line import CHECK_LINE, NAME, REPLY_S, CornerstoneLine
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.cornerstone import NO_ERROR, ErrorCode, Statement

POLL_S = 0.02
OVERDUE_S = 2.0
LONGEST_S = 30.0
STB = Statement("STB", query=True)
ABORT = Statement("ABORT")
ALREADY_THERE = f"error {int(ErrorCode.ACCESSORY_ALREADY_THERE)},"


class PendingStatement:
    """A statement that takes time. `due` is the time of the next poll; `before` is an earlier one still in progress.

    `ask_first`, if given, queries the unit just before the statement is sent. It returns the duration that replaces
    `seconds`, or None if the unit is at its target already. `confirmed` queries whether the unit is at its target.
    `stop_count` is the number of stop requests so far.
    """

    def __init__(
        self,
        wire: CornerstoneLine,
        clock: Clock,
        statement: Statement,
        seconds: float,
        on_the_wire_s: float,
        confirmed: Callable[[], bool],
        before: "PendingStatement | None",
        stop_count: Callable[[], int],
        ask_first: Callable[[], float | None] | None = None,
    ) -> None:
        self._wire = wire
        self._clock = clock
        self._statement = statement
        self._seconds = seconds
        self._on_the_wire_s = on_the_wire_s
        self._confirmed = confirmed
        self._before = before
        self._ask_first = ask_first
        self._stop_count, self._first_stop_count = stop_count, stop_count()
        self._lost = False
        self._failure: DeviceError | None = None
        self.done = self.aborted = self.querying = False
        self.due: float = before.due if before is not None else clock.now()
        if before is None:
            self._begin()

    def poll(self) -> bool:
        """True when the unit is done and at its target. Raises DeviceError if it failed.

        It may be called again after the end: a later statement polls it too.
        """
        if self._failure is not None:
            raise self._failure
        if self.done:
            return True
        try:
            return self._poll()
        except DeviceError as error:
            self.done, self._failure = True, error
            raise

    @property
    def silent(self) -> bool:
        """True while the unit moves, for this statement or the one before, and replies to no query."""
        if self._before is not None:
            return self._before.silent
        return not (self.done or self.querying)

    def _poll(self) -> bool:
        if self._before is not None:
            return self._poll_before()
        if self.aborted:
            raise DeviceError(NAME, f"finish {self._statement}", "it was aborted", "send it again")
        if not self._lost:
            try:
                status = self._status()
            except Refused:
                raise
            except DeviceError as error:
                self._note_lost(str(error))
                return False
            if status is None:
                if self._clock.now() > self._started + self._seconds + OVERDUE_S:
                    self._note_lost(f"{self._statement}: no status within {self._seconds + OVERDUE_S:.3g} s")
                else:
                    self.due = self._clock.now() + POLL_S
                return False
            if status != NO_ERROR:
                self._check_error()
        elif not self._resynchronised():
            return False
        return self._confirm()

    def _begin(self) -> None:
        self._wire.ready()  # may take a second if the line is out of step
        self._check_stop()
        if self._ask_first is not None and self._is_at_target(self._ask_first):
            self.done, self.due = True, self._clock.now()
            return
        self._wire.send(self._statement)
        if self._stop_count() != self._first_stop_count:  # requested by another thread during the write
            self._wire.send_now(ABORT)
        self._check_stop()
        self._started = self._clock.now()
        self._expected_echoes = [self._statement] if self._wire.echoes else []
        self._status_requested = self._wire.handshake
        self.due = self._started + self._seconds + self._on_the_wire_s

    def _is_at_target(self, ask_first: Callable[[], float | None]) -> bool:
        """True if nothing has to be sent. Raises DeviceError."""
        self.querying = True
        try:
            seconds = ask_first()
        finally:
            self.querying = False
        self._check_stop()
        self._seconds = seconds or 0.0
        return seconds is None

    def _check_stop(self) -> None:
        """Raise Interrupted if a stop was requested since the start."""
        if self.aborted or self._stop_count() != self._first_stop_count:
            self.done = True
            raise Interrupted(NAME, str(self._statement), "not sent because a stop was requested")

    def _poll_before(self) -> bool:
        before = self._before
        assert before is not None
        try:
            over = before.poll()
        except DeviceError as error:
            self._wire.events.append(str(error))
            over = True
        if over:
            self._before = None
            self._begin()
        else:
            self.due = before.due
        return False

    def _status(self) -> int | None:
        """The status; None until it is received. Raises DeviceError for an unexpected line."""
        lines = self._wire.receive()
        while lines and self._expected_echoes:
            self._wire.check_echo(self._expected_echoes.pop(0), lines.popleft())
        if not self._status_requested:
            # The unit replies to this query when it has arrived, and not before.
            self._wire.send(STB)
            self._status_requested = True
            if self._wire.echoes:
                self._expected_echoes.append(STB)
            return None
        if not lines or self._expected_echoes:
            return None
        status = self._wire.status_of(self._statement, lines.popleft())
        if lines:
            raise NoAnswer(NAME, str(self._statement), f"more lines than its status: {list(lines)}", CHECK_LINE)
        return status

    def _check_error(self) -> None:
        """Raise Refused with the unit's error, except for the error that it was at its target already."""
        self.done = True
        error = self._wire.last_error()
        if not error.startswith(ALREADY_THERE):
            raise self._wire.refused(self._statement, error)

    def _note_lost(self, what: str) -> None:
        """The status is lost or corrupted: resynchronise, then query the unit."""
        self._lost = True
        self._wire.in_step = False
        self._wire.events.append(f"{what}; its state is queried")
        self.due = max(self._clock.now() + POLL_S, self._started + self._seconds + self._on_the_wire_s)

    def _resynchronised(self) -> bool:
        """True if the unit replies again; it does not while it moves. Raises NoAnswer when it is long overdue."""
        try:
            self._wire.ready()
        except NoAnswer:
            if self._clock.now() > self._started + self._seconds + LONGEST_S:
                raise NoAnswer(
                    NAME, str(self._statement), f"not done after {self._seconds + LONGEST_S:.3g} s", "check the unit"
                ) from None
            self.due = self._clock.now() + REPLY_S
            return False
        return True

    def _confirm(self) -> bool:
        self.querying = True
        try:
            if not self._confirmed():
                raise NoAnswer(NAME, str(self._statement), "it is not at its target", "send it again, if it may be repeated")
        finally:
            self.querying = False
        self.done = True
        return True
