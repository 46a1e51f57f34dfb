"""A USB instrument behind a bus that fails: it stands in for the instrument on the virtual bus.

    rig.usb["monitor"] = FaultyUsb(rig.usb["monitor"], FaultPlan(seed, ON_USB), rig.clock)

What fails is an exchange: what the host writes to bulk OUT, and what comes back until it writes again. A payload is never
damaged in silence, because the bus has checksums of its own and repeats by itself; what is damaged (CORRUPTED) is a header,
as a driver's or a hub's error would.
"""

from goniotwin.mocks.faults import Fault, FaultPlan, corrupt, truncate
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.usbtmc import HEADER_BYTES
from goniotwin.twin.devices.usb_standard import BULK_IN, BULK_OUT
from goniotwin.twin.devices.usbtmc import UsbTmcDevice


class FaultyUsb(UsbTmcDevice):
    """`device`'s instrument on a bad bus.

    A late answer is `late_s` too late; unplugged, it is back after `away_s`. LOST is a packet without its bytes, NAK an answer
    that never comes, RESET an instrument that starts anew while its interface stays.
    """

    def __init__(
        self, device: UsbTmcDevice, misfortune: FaultPlan, clock: Clock, late_s: float = 1.5, away_s: float = 0.3
    ) -> None:
        self._misfortune = misfortune
        self._clock = clock
        self._late_s = late_s
        self._away_s = away_s
        self._fault = Fault.NONE
        super().__init__(device.instrument, device.latency_s, keeps_fifo=device.keeps_fifo, clear_s=device.clear_s)

    @property
    def misfortune(self) -> FaultPlan:
        """The source of the faults. A new one starts with a bus without faults."""
        return self._misfortune

    @misfortune.setter
    def misfortune(self, misfortune: FaultPlan) -> None:
        self._misfortune = misfortune
        self._fault = Fault.NONE

    def bulk_out(self, data: bytes, t: float) -> None:
        """Pass the host's write to the device, unless it is lost. Raises Stall."""
        self._fault = self._misfortune.next()
        match self._fault:
            case Fault.UNHEARD | Fault.HANG:
                return
            case Fault.STALL:
                self.halt(BULK_IN if self._draw(36, 2) else BULK_OUT)
            case Fault.RESET:
                self.instrument.power_cycle(t)
                self.reset()
            case Fault.UNPLUGGED:
                if self._draw(37, 2):
                    super().bulk_out(data, t)
                self.unplug()
                self._clock.at(self._clock.now() + self._away_s, self.replug)
                return
        super().bulk_out(data, t)

    def bulk_in_ready(self) -> float | None:
        """Time at which data can be read; None if never."""
        ready = super().bulk_in_ready()
        if ready is None or self._fault in (Fault.NAK, Fault.HANG):
            return None
        return ready + self._late_s if self._fault is Fault.LATE else ready

    def bulk_in(self, size: int | None = None) -> bytes:
        """Data for the host, with the fault of this exchange."""
        data = super().bulk_in(size)
        match self._fault:
            case Fault.LOST:
                return b""
            case Fault.TRUNCATED:
                return truncate(data, self._misfortune)
            case Fault.CORRUPTED:
                return corrupt(data[:HEADER_BYTES], self._misfortune) + data[HEADER_BYTES:]
        return data

    def _draw(self, bit: int, below: int) -> int:
        return self._misfortune.draw(self._misfortune.exchanges + (1 << bit), below)
