"""pyserial's door: `serial.serial_for_url("twin://virtual/axes")`, once this package is among its handlers.

A byte takes ten bits' time at the line's baud rate in each direction. Waiting for an answer moves a virtual clock on to
where the answer's last byte arrives.
"""

from collections import deque
from contextlib import AbstractContextManager, nullcontext
from itertools import accumulate, repeat

from serial.serialutil import PortNotOpenError, SerialBase, SerialException

from goniotwin.protocols.clock import Clock, VirtualClock
from goniotwin.twin.devices.line import BITS_A_BYTE, SerialDevice
from goniotwin.twin.doors.registry import NoSuchTwin, find, missing

POLL_S = 0.002


class Serial(SerialBase):
    """A serial port whose other end is a twin device."""

    def open(self) -> None:
        """Finds the device of the address. Raises SerialException where there is none."""
        if self.is_open:
            raise SerialException(f"{self.port} is open already")
        try:
            rig, name = find(str(self.port))
            if name not in rig.serial:
                raise missing(str(self.port), {**rig.serial})
        except NoSuchTwin as error:
            raise SerialException(str(error)) from None
        self.connect_to(rig.serial[name], rig.clock, rig.lock)

    def connect_to(self, device: SerialDevice, clock: Clock, lock: AbstractContextManager[object] | None = None) -> None:
        """The port is open to a device; `lock` is held while it is brought bytes."""
        self._clock = clock
        self._device = device
        self._lock = lock if lock is not None else nullcontext()
        self._arriving: deque[tuple[float, int]] = deque()
        self._sent_until = self._received_until = 0.0
        self.is_open = True

    def close(self) -> None:
        """Nothing is sent by closing."""
        self.is_open = False

    def _reconfigure_port(self, force_update: bool = False) -> None:
        """Any setting is taken; a wrong baud rate makes the device hear nothing that it understands."""

    @property
    def in_waiting(self) -> int:
        """How many bytes have arrived."""
        self._listen()
        now = self._clock.now()
        return sum(1 for t, _ in self._arriving if t <= now)

    def write(self, data: object, /) -> int | None:
        """Sends; returns at once, as a port with a buffer does."""
        if not self.is_open:
            raise PortNotOpenError()
        frame = bytes(data)  # type: ignore[call-overload]
        self._sent_until = max(self._clock.now(), self._sent_until) + len(frame) * self._byte_s
        self._listen(self._sent_until)
        if self.baudrate == self._device.baudrate:
            with self._lock:
                self._device.receive(frame, self._sent_until)
        return len(frame)

    def read(self, size: int = 1, /) -> bytes:
        """Waits until `size` bytes have arrived or the timeout is over; returns what has arrived."""
        if not self.is_open:
            raise PortNotOpenError()
        deadline = float("inf") if self.timeout is None else self._clock.now() + self.timeout
        while True:
            self._listen()
            enough = self._arriving[size - 1][0] if len(self._arriving) >= size else float("inf")
            wake = min(enough, deadline, self._next_change())
            if wake == float("inf"):
                raise SerialException(f"{self.port}: waiting without a timeout for bytes that nothing will send")
            self._clock.sleep_until(wake)
            if wake in (enough, deadline):
                break
        now = self._clock.now()
        there = min(size, len(self._arriving))
        while there and self._arriving[there - 1][0] > now:
            there -= 1
        return bytes([self._arriving.popleft()[1] for _ in range(there)])

    def reset_input_buffer(self) -> None:
        """What has arrived is thrown away; what is still on its way is not."""
        self._listen()
        now = self._clock.now()
        while self._arriving and self._arriving[0][0] <= now:
            self._arriving.popleft()

    def reset_output_buffer(self) -> None:
        """Nothing waits here."""

    def flush(self) -> None:
        """Waits until everything written has been sent."""
        self._clock.sleep_until(self._sent_until)

    @property
    def _byte_s(self) -> float:
        return BITS_A_BYTE / float(self.baudrate)

    def _listen(self, until: float | None = None) -> None:
        """Puts on the line what the device has begun to send by now (or will have begun by `until`)."""
        horizon = self._clock.now() if until is None else until
        outbox = self._device.outbox
        while outbox and outbox[0][0] <= horizon:
            ready, data = outbox.popleft()
            times = list(accumulate(repeat(self._byte_s, len(data)), initial=max(ready, self._received_until)))
            self._arriving.extend(zip(times[1:], data, strict=True))
            self._received_until = times[-1]

    def _next_change(self) -> float:
        """When the device may begin to send, or an event may change what it does."""
        outbox = self._device.outbox
        change = outbox[0][0] if outbox else float("inf")
        if isinstance(self._clock, VirtualClock):
            return min(change, self._clock.next_event())
        # In real time another thread may make the device speak at any moment.
        return min(change, self._clock.now() + POLL_S)
