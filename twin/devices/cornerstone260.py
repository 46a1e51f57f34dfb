"""An Oriel Cornerstone 260: grating drive, shutter, filter wheel and slits behind lines of ASCII.

While something moves it hears but does not answer, as the classic unit does: what it has heard it does afterwards, in
order. Only ABORT is heard at once; it stops what moves, and what waited behind comes next. Echo, byte for byte, and handshake
mode as on RS232 (MCS260 p. 50 and 51). Assumed where the manual is silent (to be confirmed on hardware): the echo of what
waits comes when it is its turn; a reply begins one character's time after the echo; an aborted statement ends like any other,
with its status in handshake mode; filters, slits and gratings take their time, the wheel from one position to the next, and
an aborted wheel stops at the nearest. Slits and gratings pass all light.
"""

import re
from collections import deque
from dataclasses import dataclass, replace

from goniotwin.protocols.cornerstone import (
    ERROR_SINCE_LAST_READ,
    FROM_DEVICE,
    MAX_LINE,
    NO_ERROR,
    ErrorCode,
    Statement,
    StatementError,
)
from goniotwin.twin.devices.cornerstone_statements import (
    IDENTITY,
    GratingData,
    StatementRefused,
    Statements,
    UnitState,
    status_text,
)
from goniotwin.twin.plant import Plant

LATENCY_S = 2.0e-3
BITS_A_CHARACTER = 10.0
WAITING_AT_MOST = 64
LINE_FEED = b"\n"


@dataclass(frozen=True)
class Turn:
    """A statement that has been given its turn: its line as it was heard, from when on, and the state before it."""

    line: bytes
    start: float
    before: UnitState


class Cornerstone260:
    """The device's firmware on one serial line."""

    def __init__(self, plant: Plant, identity: str = IDENTITY) -> None:
        self._plant = plant
        self._drive = plant.model.monochromator
        self._statements = Statements(plant, self._drive, identity)
        self.baudrate = self._drive.baudrate
        self.outbox: deque[tuple[float, bytes]] = deque()
        self._character_s = BITS_A_CHARACTER / self._drive.baudrate
        self._pending = b""
        self._unechoed = b""
        self._echoed = 0.0
        self._busy_until = 0.0
        self._turns: deque[Turn] = deque(maxlen=WAITING_AT_MOST)
        gratings = tuple(GratingData(lines, label) for lines, label in self._drive.gratings)
        labels = tuple(f"FILTER{k + 1}" for k in range(self._drive.filters))
        self.state = UnitState(gratings, labels, gpib_address=self._drive.gpib_address)
        """What the unit keeps between two statements."""

    def receive(self, data: bytes, t: float) -> None:
        """Bytes of which the last has arrived at `t`."""
        for piece in _pieces(data):
            self._unechoed += piece
            # Of an endless line as much is kept as `decode` needs to see that it is too long.
            self._pending = (self._pending + piece.removesuffix(LINE_FEED))[: MAX_LINE + 2]
            self._echo(max(t, self._busy_until))
            if piece.endswith(LINE_FEED):
                line, self._pending = self._pending + LINE_FEED, b""
                self._hear(line, t)

    def _hear(self, line: bytes, t: float) -> None:
        if line.strip().upper() == b"ABORT" and t < self._busy_until:
            self._abort(line, t)
        elif line.strip():
            self._take_turn(line, t)

    def reset(self, t: float) -> None:
        """The power went away and came back: everything rests, volatile settings are forgotten, the shutter is closed."""
        self._take_back(t)
        self.outbox.clear()
        self._pending = self._unechoed = b""
        self._busy_until = t
        self.state = self.state.after_power_on()
        self._plant.shutter_open.set(t, False)
        self._plant.wheel.set(t, 1.0)

    def _echo(self, t: float) -> None:
        heard, self._unechoed = self._unechoed, b""
        if heard and self._drive.echo:
            self.outbox.append((t, heard))
            self._echoed = t + len(heard) * self._character_s

    def _take_turn(self, line: bytes, t: float) -> None:
        start = max(t, self._busy_until)
        self._turns.append(Turn(line, start, self.state))
        self._perform(line, start + LATENCY_S)

    def _perform(self, line: bytes, t: float) -> None:
        answer: str | None = None
        done = t
        try:
            result = self._statements.perform(self.state, Statement.decode(line.rstrip(b"\r\n")), t)
            self.state, done, answer = result.state, result.t, result.answer
        except StatementError:
            self._fail(ErrorCode.NOT_UNDERSTOOD)
        except StatementRefused as refused:
            self._fail(refused.error)
        if answer is not None:
            self._reply(t, answer)
        self._busy_until = done
        self._end_statement(done)

    def _end_statement(self, t: float) -> None:
        if self.state.handshake:
            self._reply(t, status_text(self._drive, self.state.status))
            self.state = replace(self.state, status=NO_ERROR)  # sent is read

    def _reply(self, t: float, text: str) -> None:
        """A line of a reply at `t`, but not before one character's time after the echo."""
        self.outbox.append((max(t, self._echoed + self._character_s), text.encode("ascii") + FROM_DEVICE))

    def _fail(self, error: ErrorCode) -> None:
        self.state = replace(self.state, error=error, status=ERROR_SINCE_LAST_READ)

    def _abort(self, line: bytes, t: float) -> None:
        waiting = self._take_back(t)
        self._busy_until = t
        self._end_statement(t)  # of what has been aborted
        for each in (line, *waiting):
            self._unechoed = each
            self._echo(max(t, self._busy_until))
            self._take_turn(each, t)

    def _take_back(self, t: float) -> list[bytes]:
        """Everything stops at `t`; returns the statements whose turn has not come, and undoes what they would have done."""
        waiting = [turn for turn in self._turns if turn.start > t]
        if waiting:
            self.state = waiting[0].before
        while self.outbox and self.outbox[-1][0] > t:
            self.outbox.pop()
        self._echoed = min(self._echoed, t)  # an echo that was to come later does not come
        self._turns.clear()
        self._plant.wavelength_nm.stop(t)
        self._plant.wheel.set(t, float(self._plant.filter_position(t)))
        self._plant.shutter_open.set(t, self._plant.shutter_open.at(t))
        return [turn.line for turn in waiting]


def _pieces(data: bytes) -> list[bytes]:
    """Cut after each line's end: LF, or CR LF. CR alone ends none."""
    return re.findall(rb"[^\n]*\n|[^\n]+", data)
