"""The bytes of a TMCL line: frames out, frames in, never waiting longer than told, and never deaf for longer than a slice.

A port that has failed (its plug was pulled) is given back at once, and opened again when next something is to be sent.
"""

import contextlib
from collections import deque
from collections.abc import Callable, Sequence

from serial import Serial, SerialException

from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import FRAME_BYTES, HOST_ADDRESS, FrameError, Reply, Request, Status, split

SLICE_S = 0.01
FRAME_S_BITS = FRAME_BYTES * 10.0
MOST_STALE = 4096
PORT_FAULTS = (SerialException, OSError)
GiveUp = Callable[[], bool]
Targets = Sequence[tuple[str, Request]]


class TmclPort:
    """A port whose reads last a slice, so that whoever has to go first need not wait for a timeout.

    It is opened at once. Raises SerialException, OSError or ValueError where that cannot be. That it has been opened again
    is added to `said`.
    """

    def __init__(self, open_port: Callable[[], Serial], clock: Clock, tap: Tap, timeout_s: float, said: deque[str]) -> None:
        self._open_port = open_port
        self._clock = clock
        self._tap = tap
        self._rest = b""
        self._timeout_s = timeout_s
        self._said = said
        self._port: Serial | None = self._open_port()
        self._port.write_timeout = timeout_s
        self._forget_stale()

    def close(self) -> None:
        """Gives it back."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*PORT_FAULTS):
                port.close()

    def send(self, frame: bytes) -> None:
        """Throws away what has come unasked, and writes. Raises SerialException or OSError."""
        self._forget_stale()
        self._write(frame)

    def frame(self, deadline: float, give_up: GiveUp) -> bytes | None:
        """The next nine bytes; None where they have not come by the deadline, or somebody has to go first."""
        while True:
            frames, rest = split(self._rest)
            if frames:
                self._rest = b"".join(frames[1:]) + rest
                return frames[0]
            if not self._hear(FRAME_BYTES - len(rest), deadline, give_up):
                return None

    def await_bytes(self, expected: bytes, deadline: float, give_up: GiveUp) -> bool:
        """Whether certain bytes come by the deadline, wherever in the stream; all before them and with them is forgotten."""
        while expected not in self._rest:
            self._rest = self._rest[-MOST_STALE:]
            if not self._hear(FRAME_BYTES, deadline, give_up):
                return False
        self._rest = b""
        return True

    def tell_all(self, targets: Targets, patience_s: float, timeout_s: float) -> list[tuple[str, Request]]:
        """Sends requests one after the other, waiting a little for each reply, and at the end longer for those that are
        missing. Returns those to which there is none. Raises SerialException or OSError."""
        self._forget_stale()
        missing: list[tuple[str, Request]] = []
        for name, request in targets:
            self._write(request.encode())
            if not self._await_reply(request, self._clock.now() + patience_s):
                missing.append((name, request))
        deadline = self._clock.now() + timeout_s
        return [(name, request) for name, request in missing if not self._await_reply(request, deadline)]

    def how_little(self, started: float) -> str:
        """For an error: what has come instead of an answer."""
        waited = self._clock.now() - started
        return f"{len(self._rest)} of {FRAME_BYTES} bytes within {waited:.3f} s"

    def _await_reply(self, request: Request, deadline: float) -> bool:
        """Looks for a reply at every place of the stream: what comes before it may be anything."""
        while True:
            for place in range(len(self._rest) - FRAME_BYTES + 1):
                if _answers(self._rest[place : place + FRAME_BYTES], request):
                    self._rest = self._rest[place + FRAME_BYTES :]
                    return True
            self._rest = self._rest[-MOST_STALE:]
            if not self._hear(FRAME_BYTES, deadline, lambda: False):
                return False

    def _hear(self, size: int, deadline: float, give_up: GiveUp) -> bool:
        """Puts what comes within a slice to the rest; False where it is time to give up."""
        if self._clock.now() >= deadline - 1e-9 or give_up():
            return False
        data = self._read(size)
        if give_up() and not data:
            return False
        if data:
            self._tap(FROM_DEVICE, data)
            self._rest += data
        return True

    def _forget_stale(self) -> None:
        self._rest = b""
        try:
            port = self._ready()
            for _ in range(MOST_STALE):
                waiting = port.in_waiting
                if not waiting:
                    return
                self._tap(FROM_DEVICE, port.read(waiting))
        except PORT_FAULTS:
            self.close()
            raise

    def _read(self, size: int) -> bytes:
        try:
            return bytes(self._ready().read(size))
        except PORT_FAULTS:
            self.close()
            raise

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
            self._said.append("the port has been opened again")
        return self._port


def _answers(frame: bytes, request: Request) -> bool:
    try:
        reply = Reply.decode(frame)
    except FrameError:
        return False
    return (reply.host, reply.address, reply.command) == (HOST_ADDRESS, request.address, request.command) and (
        reply.status == Status.OK
    )
