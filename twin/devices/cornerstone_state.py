"""What a Cornerstone 260 knows of itself: gratings with their calibration, labels, slits, units, status and error."""

from dataclasses import dataclass, field, replace

from goniotwin.protocols.cornerstone import NO_ERROR, Error, Unit

SLITS = 3


@dataclass(frozen=True)
class GratingData:
    """A grating's calibration: the wavelength shown is that of its steps times `factor` plus `zero_nm`."""

    lines_per_mm: int
    label: str
    zero_nm: float = 0.0
    factor: float = 1.0

    def shown_nm(self, true_nm: float) -> float:
        """What the unit believes the wavelength to be."""
        return true_nm * self.factor + self.zero_nm

    def true_nm(self, shown_nm: float) -> float:
        """The other way round."""
        return (shown_nm - self.zero_nm) / self.factor


@dataclass(frozen=True)
class State:
    """Immutable, so that what an ABORT takes back can be taken back."""

    gratings: tuple[GratingData, ...]
    filter_labels: tuple[str, ...]
    grating: int = 1
    outport: int = 1
    slits_um: tuple[float, ...] = (200.0,) * SLITS
    bandpass_nm: float = 5.0
    unit: Unit = Unit.NM
    handshake: bool = False
    status: int = NO_ERROR
    error: Error = field(default=Error.NONE)

    @property
    def current(self) -> GratingData:
        """The grating in the beam."""
        return self.gratings[self.grating - 1]

    def with_grating(self, number: int, **changes: object) -> "State":
        """A grating's data changed."""
        changed = list(self.gratings)
        changed[number - 1] = replace(changed[number - 1], **changes)  # type: ignore[arg-type]
        return replace(self, gratings=tuple(changed))

    def after_power_on(self) -> "State":
        """What is kept without power: calibration and labels."""
        return State(self.gratings, self.filter_labels)
