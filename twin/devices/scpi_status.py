"""A status group of SCPI: condition, transition filters, event register, enable mask."""


class StatusGroup:
    """Sixteen bits of which the highest is never used. Source: SCPI-99 volume 1, chapter 9."""

    def __init__(self) -> None:
        self.condition = 0
        self.event = 0
        self.preset()

    def preset(self) -> None:
        """STATus:PRESet: nothing enabled, events at rising edges."""
        self.enable = 0
        self.rising = 0x7FFF
        self.falling = 0

    def set(self, bit: int, on: bool) -> None:
        """A condition comes or goes; its edges become events as the filters say."""
        mask = 1 << bit
        if on and not self.condition & mask:
            self.event |= mask & self.rising
            self.condition |= mask
        elif not on and self.condition & mask:
            self.event |= mask & self.falling
            self.condition &= ~mask

    def read(self) -> int:
        """The event register, which reading clears."""
        event, self.event = self.event, 0
        return event

    @property
    def summary(self) -> bool:
        """Whether an enabled event has happened."""
        return bool(self.event & self.enable)
