"""A Trinamic motion module on its serial line: one exchange at a time, each answer checked before it is believed."""

import threading
from collections.abc import Callable

from serial import Serial, SerialException

from drivers.errors import BadAnswer, DeviceError, NoAnswer, Refused
from drivers.tap import FROM_DEVICE, TO_DEVICE, Tap, no_tap
from protocols.clock import Clock
from protocols.tmcl import FRAME_BYTES, HOST_ADDRESS, Command, FrameError, Reply, Request, Status

PortOpener = Callable[[int, float], Serial]
"""Opens a serial port: baud rate, timeout in s."""

TIMEOUT_S = 0.06
SLOW_LINE_TIMEOUT_S = 0.5
DISCARDED_FRAMES = 4
REPEATABLE = {Command.GAP, Command.GGP, Command.SAP, Command.SGP, Command.MST, Command.FIRMWARE_VERSION}


class TmclModule:
    """The wire to one motion module (or several on one bus, by their addresses).

    Exchanges come from the engine's thread and, for Stop, from any other; a lock keeps them apart, and none lasts
    longer than the timeout twice.
    """

    def __init__(self, open_port: PortOpener, clock: Clock, baudrate: int = 115200, tap: Tap = no_tap) -> None:
        self._open_port = open_port
        self._clock = clock
        self._baudrate = baudrate
        self._timeout_s = TIMEOUT_S if baudrate >= 57600 else SLOW_LINE_TIMEOUT_S
        self._tap = tap
        self._lock = threading.RLock()
        self._port: Serial | None = None

    def connect(self) -> int:
        """Opens the port and asks who is there; returns the module's number, such as 6214. Nothing moves.

        Raises DeviceError where the port cannot be opened or nobody answers.
        """
        with self._lock:
            self.close()
            try:
                self._port = self._open_port(self._baudrate, self._timeout_s)
            except (SerialException, OSError, ValueError) as error:
                raise DeviceError("axes", "open the port", str(error), "check the port in the rig file") from None
            self._port.reset_input_buffer()
            return self.exchange(Request(1, Command.FIRMWARE_VERSION, 1, 0)) >> 16

    def close(self) -> None:
        """Gives the port back. Nothing is sent."""
        with self._lock:
            if self._port is not None:
                self._port.close()
                self._port = None

    def exchange(self, request: Request) -> int:
        """Sends a request and returns the value of its reply.

        A request that may happen twice is repeated once after a fault. Raises NoAnswer, BadAnswer or Refused.
        """
        with self._lock:
            try:
                return self._once(request)
            except (NoAnswer, BadAnswer):
                if request.command not in REPEATABLE:
                    raise
                self._resynchronise()
                return self._once(request)

    def _once(self, request: Request) -> int:
        port = self._port
        if port is None:
            raise NoAnswer("axes", str(request), "the port is not open", "connect first")
        frame = request.encode()
        self._tap(TO_DEVICE, frame)
        try:
            port.write(frame)
            for _ in range(DISCARDED_FRAMES):
                answer = port.read(FRAME_BYTES)
                self._tap(FROM_DEVICE, answer)
                if len(answer) < FRAME_BYTES:
                    raise NoAnswer("axes", str(request), f"{len(answer)} of {FRAME_BYTES} bytes within {port.timeout} s")
                reply = self._checked(request, answer)
                if reply is not None:
                    return reply.value
        except (SerialException, OSError) as error:
            raise NoAnswer("axes", str(request), f"the port failed: {error}", "check cable and power") from None
        raise BadAnswer("axes", str(request), f"{DISCARDED_FRAMES} replies to other requests")

    def _checked(self, request: Request, answer: bytes) -> Reply | None:
        """The reply, or None for one that belongs to another request."""
        try:
            reply = Reply.decode(answer)
        except FrameError as error:
            raise BadAnswer("axes", str(request), str(error)) from None
        if reply.command != request.command or reply.host != HOST_ADDRESS:
            return None
        if reply.status != Status.OK:
            raise Refused("axes", str(request), f"the module answers: {reply}")
        return reply

    def _resynchronise(self) -> None:
        """Waits until what was on its way has arrived, and forgets it."""
        port = self._port
        if port is not None:
            self._clock.sleep_until(self._clock.now() + self._timeout_s)
            port.reset_input_buffer()


def explain(direction: str, data: bytes) -> str:
    """A frame in words, for transcripts."""
    try:
        return str(Request.decode(data) if direction == TO_DEVICE else Reply.decode(data))
    except FrameError as error:
        return str(error)
