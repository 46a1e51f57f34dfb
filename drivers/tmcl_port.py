"""The bytes of a TMCL line: frames out, frames in, never waiting longer than told, and never deaf for longer than a slice."""

from collections.abc import Callable, Sequence

from serial import Serial

from drivers.tap import FROM_DEVICE, TO_DEVICE, Tap
from protocols.clock import Clock
from protocols.tmcl import FRAME_BYTES, HOST_ADDRESS, FrameError, Reply, Request, Status, split

SLICE_S = 0.01
FRAME_S_BITS = FRAME_BYTES * 10.0
MOST_STALE = 4096
GiveUp = Callable[[], bool]
Targets = Sequence[tuple[str, Request]]


class TmclPort:
    """An open port whose reads last a slice, so that whoever has to go first need not wait for a timeout."""

    def __init__(self, port: Serial, clock: Clock, tap: Tap, timeout_s: float) -> None:
        self._port = port
        self._clock = clock
        self._tap = tap
        self._rest = b""
        self._timeout_s = timeout_s
        port.write_timeout = timeout_s
        self._forget_stale()

    def close(self) -> None:
        """Gives it back."""
        self._port.close()

    def send(self, frame: bytes) -> None:
        """Throws away what has come unasked, and writes. Raises SerialException or OSError."""
        self._forget_stale()
        self._tap(TO_DEVICE, frame)
        self._port.write(frame)

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
            frame = request.encode()
            self._tap(TO_DEVICE, frame)
            self._port.write(frame)
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
        data = self._port.read(size)
        if give_up() and not data:
            return False
        if data:
            self._tap(FROM_DEVICE, data)
            self._rest += data
        return True

    def _forget_stale(self) -> None:
        self._rest = b""
        for _ in range(MOST_STALE):
            waiting = self._port.in_waiting
            if not waiting:
                return
            self._tap(FROM_DEVICE, self._port.read(waiting))


def _answers(frame: bytes, request: Request) -> bool:
    try:
        reply = Reply.decode(frame)
    except FrameError:
        return False
    return (reply.host, reply.address, reply.command) == (HOST_ADDRESS, request.address, request.command) and (
        reply.status == Status.OK
    )


