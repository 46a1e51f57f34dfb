"""What the operator believes of the monochromator, and how long what it does takes by that."""

from dataclasses import dataclass, field

from goniotwin.drivers.monochromator.order_filters import FilterWheel

UNIT_THINKS_S = 2.0e-3


@dataclass(frozen=True)
class MonochromatorSettings:
    """What the operator believes of the monochromator; `tolerance_nm` is how far from its target a grating may rest.

    `filter_s` is how long the filter wheel takes from a position to the next; `wheel` is what stands in it.
    """

    baudrate: int = 9600
    lowest_nm: float = 380.0
    highest_nm: float = 780.0
    slew_nm_per_s: float = 175.0
    slew_settle_s: float = 0.1
    shutter_s: float = 0.15
    filter_s: float = 1.0
    grating_s: float = 8.0
    slit_um_per_s: float = 500.0
    tolerance_nm: float = 0.05
    wheel: FilterWheel = field(default_factory=FilterWheel)

    def slew_seconds(self, way_nm: float) -> float:
        """How long a change of wavelength takes."""
        return abs(way_nm) / self.slew_nm_per_s + self.slew_settle_s if way_nm else 0.0

    def statement_seconds(self, text: str) -> float:
        """How long a statement, its echo and the status after it are on the wire."""
        return 10.0 * (2 * len(text) + len("\n\r\n00\r\n")) / self.baudrate

    def question_seconds(self, text: str, answer: str) -> float:
        """How long a question takes, with echo, answer and status."""
        return self.statement_seconds(text) + 10.0 * len(answer + "\r\n") / self.baudrate + UNIT_THINKS_S
