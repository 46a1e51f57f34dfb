"""pyserial's door: `serial.serial_for_url("twin://virtual/axes")`, once this package is among its handlers.

A byte takes ten bits' time at the line's baud rate in each direction. Waiting for an answer moves a virtual clock on to
where the answer's last byte arrives.
"""

from bisect import bisect_right
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
        self._received, self._times = bytearray(), list[float]()
        self._sent_until = self._received_until = 0.0
        self._reconfigure_port()
        self.is_open = True

    def close(self) -> None:
        """Nothing is sent by closing."""
        self.is_open = False

    def _reconfigure_port(self, force_update: bool = False) -> None:
        """Any setting is taken; a wrong baud rate makes the device hear nothing that it understands."""
        del force_update
        self._byte_s = BITS_A_BYTE / float(self.baudrate)

    @property
    def in_waiting(self) -> int:
        """How many bytes have arrived."""
        now = self._clock.now()
        self._listen(now)
        return bisect_right(self._times, now)

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
        now = self._clock.now()
        timeout = self.timeout
        deadline = float("inf") if timeout is None else now + timeout
        while True:
            change = self._next_change(now)
            enough = self._listen(now, size)
            while (ready := self._next_ready()) < change and ready <= deadline and ready <= enough:
                enough = self._listen(ready, size)
            wake = min(enough, deadline, change)
            if wake == float("inf"):
                raise SerialException(f"{self.port}: waiting without a timeout for bytes that nothing will send")
            self._clock.sleep_until(wake)
            now = self._clock.now()
            if wake in (enough, deadline):
                break
        return self._take(min(size, bisect_right(self._times, now)))

    def reset_input_buffer(self) -> None:
        """What has arrived is thrown away; what is still on its way is not."""
        self._take(self.in_waiting)

    def reset_output_buffer(self) -> None:
        """Nothing waits here."""

    def flush(self) -> None:
        """Waits until everything written has been sent."""
        self._clock.sleep_until(self._sent_until)

    def _take(self, size: int) -> bytes:
        taken = bytes(self._received[:size])
        del self._received[:size], self._times[:size]
        return taken

    def _listen(self, until: float, size: int = 1) -> float:
        """Puts on the line what the device will have begun to send by a time; when `size` bytes will then have arrived."""
        outbox = self._device.outbox
        while outbox and outbox[0][0] <= until:
            ready, data = outbox.popleft()
            times = list(accumulate(repeat(self._byte_s, len(data)), initial=max(ready, self._received_until)))
            self._received_until = times[-1]
            self._received += data
            self._times += times[1:]
        return self._times[size - 1] if len(self._times) >= size else float("inf")

    def _next_ready(self) -> float:
        """When the device begins to send what it has not begun to send."""
        outbox = self._device.outbox
        return outbox[0][0] if outbox else float("inf")

    def _next_change(self, now: float) -> float:
        """When an event may change what the device does."""
        if isinstance(self._clock, VirtualClock):
            return self._clock.next_event()
        # In real time another thread may make the device speak at any moment.
        return now + POLL_S
