"""Serial port of a TMCL line: frames out and in, with a deadline for every wait.

A read lasts one slice at most, so that a stop gets the line soon. A port that failed (its plug was pulled) is closed at
once, and opened again for the next frame.
"""

import contextlib
import math
from collections import deque
from collections.abc import Callable, Generator, Sequence

from serial import Serial, SerialException

from goniotwin.drivers.motion.stop import StopPhase, StopWait
from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import FRAME_BYTES, HOST_ADDRESS, CommandFrame, FrameError, ReplyFrame, ReplyStatus

SLICE_S = 0.01
FRAME_S_BITS = FRAME_BYTES * 10.0
MODULE_LATENCY_S = 3.0e-4
MOST_STALE = 4096
PORT_FAULTS = (SerialException, OSError)
GiveUp = Callable[[], bool]
Targets = Sequence[tuple[str, CommandFrame]]
Unconfirmed = Generator[StopPhase, None, list[tuple[str, CommandFrame]]]
"""Steps of at most a slice each; the result are the requests without reply."""


def exchange_seconds(baudrate: int) -> float:
    """Typical duration of an exchange, s: a request, the response time of a module, a reply."""
    return 2.0 * FRAME_S_BITS / baudrate + MODULE_LATENCY_S


class TmclPort:
    """A port that is opened at once and reads in slices. Raises SerialException, OSError or ValueError.

    A reopening of the port is appended to `events`. `late_s` is by how much this computer was late, s, since the last request.
    """

    def __init__(self, open_port: Callable[[], Serial], clock: Clock, tap: Tap, timeout_s: float, events: deque[str]) -> None:
        self._open_port = open_port
        self._clock = clock
        self._tap = tap
        self._rest = b""
        self._taken_late = -math.inf  # the deadline after which was read once more
        self.late_s = 0.0
        self._timeout_s = timeout_s
        self._events = events
        self._port: Serial | None = self._open_port()
        self._port.write_timeout = timeout_s
        self._discard_received()

    def close(self) -> None:
        """Close the port."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*PORT_FAULTS):
                port.close()

    def send(self, frame: bytes) -> None:
        """Discard what was received unrequested, and write a frame. Raises SerialException or OSError."""
        self._discard_received()
        self.late_s = 0.0
        self._write(frame)

    def frame(self, deadline: float, give_up: GiveUp) -> bytes | None:
        """The next nine bytes; None if they do not come by the deadline, or if `give_up` is true."""
        while len(self._rest) < FRAME_BYTES:
            if not self._receive(FRAME_BYTES - len(self._rest), deadline, give_up):
                return None
        frame, self._rest = self._rest[:FRAME_BYTES], self._rest[FRAME_BYTES:]
        return frame

    def await_bytes(self, expected: bytes, deadline: float, give_up: GiveUp) -> bool:
        """True if certain bytes come by the deadline, anywhere in the stream; all that was received is then discarded."""
        while expected not in self._rest:
            self._rest = self._rest[-MOST_STALE:]
            if not self._receive(FRAME_BYTES, deadline, give_up):
                return False
        self._rest = b""
        return True

    def send_all(self, targets: Targets, patience_s: float, timeout_s: float) -> Unconfirmed:
        """Send requests one after the other, in steps; return those without reply. Raises SerialException or OSError.

        It waits `patience_s` for each reply, and at the end `timeout_s` for all missing replies together.
        """
        if self._port is None:
            yield StopPhase.BLOCKING
        self._discard_received()
        missing: list[tuple[str, CommandFrame]] = []
        for name, request in targets:
            self._write(request.encode())
            yield from self._await_reply(name, request, self._clock.now() + patience_s, missing)
        deadline = self._clock.now() + timeout_s
        silent: list[tuple[str, CommandFrame]] = []
        for name, request in missing:
            yield from self._await_reply(name, request, deadline, silent)
        return silent

    def describe_missing(self, started: float) -> str:
        """What was received instead of a reply, for an error message."""
        waited = self._clock.now() - started
        return f"{len(self._rest)} of {FRAME_BYTES} bytes within {waited:.3f} s"

    def _await_reply(
        self, name: str, request: CommandFrame, deadline: float, missing: list[tuple[str, CommandFrame]]
    ) -> StopWait:
        """Wait for the reply to a request, at any place of the stream: anything may come before it.

        A request without reply by the deadline is appended to `missing`.
        """
        compared = 0
        while True:
            for place in range(compared, len(self._rest) - FRAME_BYTES + 1):
                if _confirms(self._rest[place : place + FRAME_BYTES], request):
                    self._rest = self._rest[place + FRAME_BYTES :]
                    return
            self._rest = self._rest[-MOST_STALE:]
            compared = max(0, len(self._rest) - FRAME_BYTES + 1)
            yield StopPhase.SENDING
            if not self._receive(FRAME_BYTES, deadline, lambda: False):
                missing.append((name, request))
                return

    def _receive(self, size: int, deadline: float, give_up: GiveUp) -> bool:
        """Append what comes within a slice to `_rest`; False if it is time to give up.

        After the deadline it takes once what is there: a computer that was late finds a reply that came in time.
        """
        if give_up():
            return False
        now = self._clock.now()
        if now >= deadline - 1e-9:
            waiting = 0 if self._taken_late == deadline else self._waiting()
            if not waiting:
                return False
            self._taken_late, size = deadline, max(size, min(waiting, MOST_STALE))
        data = self._read(size, now)
        if data:
            self._tap(FROM_DEVICE, data)
            self._rest += data
        return bool(data) or not give_up()

    def _discard_received(self) -> None:
        """Discard what is there, for a slice at most and then once more: a line may never fall silent."""
        self._rest = b""
        started, over = None, False
        while not over and (waiting := self._waiting()):
            now = self._clock.now()
            started = now if started is None else started
            over = now >= started + SLICE_S
            self._tap(FROM_DEVICE, self._read(waiting, now))

    def _waiting(self) -> int:
        """Number of bytes that are there."""
        try:
            return int(self._ready().in_waiting)
        except PORT_FAULTS:
            self.close()
            raise

    def _read(self, size: int, started: float) -> bytes:
        try:
            data = bytes(self._ready().read(size))
        except PORT_FAULTS:
            self.close()
            raise
        self.late_s = max(self.late_s, self._clock.now() - started - SLICE_S)
        return data

    def _write(self, frame: bytes) -> None:
        self._tap(TO_DEVICE, frame)
        try:
            self._ready().write(frame)
        except PORT_FAULTS:
            self.close()
            raise

    def _ready(self) -> Serial:
        if self._port is None:
            self._port = self._open_port()
            self._port.write_timeout = self._timeout_s
            self._events.append("port reopened")
        return self._port


def _confirms(frame: bytes, request: CommandFrame) -> bool:
    try:
        reply = ReplyFrame.decode(frame)
    except FrameError:
        return False
    return (reply.host, reply.address, reply.command) == (HOST_ADDRESS, request.address, request.command) and (
        reply.status == ReplyStatus.OK
    )
