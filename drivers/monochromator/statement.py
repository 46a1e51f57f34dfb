"""A statement of the monochromator that takes its time: sent, waited for without holding anybody up, and checked.

With handshake mode the status says that it is over; without, the answer to an `STB?` sent behind it. What got lost on the
way is found out by bringing the line into step and asking where the unit is: nothing is sent a second time. Where it is told
to ask first, it sends nothing at all if the unit is there already.
"""

from collections.abc import Callable

from goniotwin.drivers.errors import DeviceError, Interrupted, NoAnswer, Refused
from goniotwin.drivers.monochromator.line import ANSWER_S, NAME, CornerstoneWire
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.cornerstone import NO_ERROR, Error, Statement

POLL_S = 0.02
STATUS_MARGIN_S = 3.0e-3
OVERDUE_S = 2.0
LONGEST_S = 30.0
STB = Statement("STB", query=True)
ABORT = Statement("ABORT")
ALREADY_THERE = f"error {int(Error.ACCESSORY_ALREADY_THERE)},"


class Move:
    """Under way: `due` when to ask next; `before` is what was started earlier and nobody has waited for.

    `ask_first`, where there is one, asks the unit just before the statement is sent how many `seconds` it will take, in
    their place; None: it is there already.
    """

    def __init__(
        self,
        wire: CornerstoneWire,
        clock: Clock,
        statement: Statement,
        seconds: float,
        on_the_wire_s: float,
        confirmed: Callable[[], bool],
        before: "Move | None",
        stops: Callable[[], int],
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
        self._stops, self._since = stops, stops()
        self._lost = False
        self._failure: DeviceError | None = None
        self.done = self.aborted = self.asking = False
        self.due: float = before.due if before is not None else clock.now()
        if before is None:
            self._begin()

    def poll(self) -> bool:
        """Looks whether it is over, and checks that it led to where it should. Raises DeviceError where it did not.

        That as often as it is asked: what was started after it asks, too, and goes on.
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
        """Whether the unit moves, for this or for the one before, so that it answers no question."""
        if self._before is not None:
            return self._before.silent
        return not (self.done or self.asking)

    def _poll(self) -> bool:
        if self._before is not None:
            return self._wait_for_the_one_before()
        if self.aborted:
            raise DeviceError(NAME, str(self._statement), "it was aborted", "send it again")
        if not self._lost:
            try:
                status = self._status()
            except Refused:
                raise
            except DeviceError as error:
                self._lose(str(error))
                return False
            if status is None:
                if self._clock.now() > self._begun + self._seconds + OVERDUE_S:
                    self._lose(f"{self._statement}: no word within {self._seconds + OVERDUE_S:.3g} s")
                else:
                    self.due = self._clock.now() + POLL_S
                return False
            if status != NO_ERROR:
                self._explain()
        elif not self._found():
            return False
        return self._confirm()

    def _begin(self) -> None:
        self._wire.ready()  # which may take a second, where the line is out of step
        self._heed()
        if self._ask_first is not None and self._is_there(self._ask_first):
            self.done, self.due = True, self._clock.now()
            return
        self._wire.send(self._statement)
        if self._stops() != self._since:  # from another thread, in the very moment
            self._wire.send_now(ABORT)
        self._heed()
        self._begun = self._clock.now()
        self._expected = [self._statement] if self._wire.echoes else []
        self._asked = self._wire.handshake
        self.due = self._begun + self._seconds + self._on_the_wire_s

    def _is_there(self, ask_first: Callable[[], float | None]) -> bool:
        """Whether there is nothing to be sent. Raises DeviceError."""
        self.asking = True
        try:
            seconds = ask_first()
        finally:
            self.asking = False
        self._heed()
        self._seconds = seconds or 0.0
        return seconds is None

    def _heed(self) -> None:
        """Raises Interrupted where there has been a stop since this was started."""
        if self.aborted or self._stops() != self._since:
            self.done = True
            raise Interrupted(NAME, str(self._statement), "a stop has come first")

    def _wait_for_the_one_before(self) -> bool:
        before = self._before
        assert before is not None
        try:
            over = before.poll()
        except DeviceError as error:
            self._wire.said.append(str(error))
            over = True
        if over:
            self._before = None
            self._begin()
        else:
            self.due = before.due
        return False

    def _status(self) -> int | None:
        """The status, None while it has not come. Raises DeviceError for a line that should not be there."""
        lines = self._wire.listen()
        while lines and self._expected:
            self._wire.check_echo(self._expected.pop(0), lines.popleft())
        if not self._asked:
            # It answers this when it has arrived, and not before.
            self._wire.send(STB)
            self._asked = True
            if self._wire.echoes:
                self._expected.append(STB)
            return None
        if not lines or self._expected:
            return None
        status = self._wire.status_of(self._statement, lines.popleft())
        if lines:
            raise NoAnswer(NAME, str(self._statement), f"more than its status: {list(lines)}", "check cable and baud rate")
        return status

    def _explain(self) -> None:
        """Raises Refused with the unit's error, except where it says that it was there already."""
        self.done = True
        words = self._wire.last_error()
        if not words.startswith(ALREADY_THERE):
            raise Refused(NAME, str(self._statement), words)

    def _lose(self, what: str) -> None:
        """The unit's word got lost or damaged: from now on it is looked for."""
        self._lost = True
        self._wire.in_step = False
        self._wire.said.append(f"{what}; it is asked where it is")
        self.due = max(self._clock.now() + POLL_S, self._begun + self._seconds + self._on_the_wire_s)

    def _found(self) -> bool:
        """Whether it answers again; while it moves it cannot. Raises NoAnswer when it should have long since."""
        try:
            self._wire.ready()
        except NoAnswer:
            if self._clock.now() > self._begun + self._seconds + LONGEST_S:
                raise NoAnswer(
                    NAME, str(self._statement), f"not done after {self._seconds + LONGEST_S:.3g} s", "check the unit"
                ) from None
            self.due = self._clock.now() + ANSWER_S
            return False
        return True

    def _confirm(self) -> bool:
        self.asking = True
        try:
            if not self._confirmed():
                raise NoAnswer(
                    NAME, str(self._statement), "it is not where it was sent", "send it again, where that may happen twice"
                )
        finally:
            self.asking = False
        self.done = True
        return True
