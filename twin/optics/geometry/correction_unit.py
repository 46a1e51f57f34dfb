"""The correction unit: a beam splitter, whose weak arm goes to the monitor photodiode."""

import math
from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Split:
    """What a splitter makes of a flux, in the flux' own unit; what is in neither was absorbed."""

    monitor: float
    onwards: float


@dataclass(frozen=True)
class CorrectionUnit:
    """The beam splitter behind the output condenser (paper, section 2, which gives no numbers: these are assumed).

    Shares of the flux: `monitor_share` goes to the monitor, `absorptance` is lost, the rest goes on to the mirrors,
    alike for all wavelengths, places, angles and polarisations. The monitor takes the whole beam, and so sees the lamp's
    changes but not what only moves the light across the sample. Raises ValueError, naming the field, for shares that are
    none or are more than 1 together.
    """

    monitor_share: float = 0.08
    absorptance: float = 0.01

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"{entry.name} is {value!r}: give a share from 0 to 1")
        if self.monitor_share + self.absorptance > 1.0:
            raise ValueError(f"monitor_share and absorptance are {self.monitor_share + self.absorptance:g} together: at most 1")

    @property
    def onwards_share(self) -> float:
        """Of the flux, what goes on to the mirrors."""
        return 1.0 - self.monitor_share - self.absorptance

    def split(self, leaving_flux: float) -> Split:
        """What monitor and mirrors get of the flux that leaves the output condenser (`Rayset.total_flux`), in its unit.

        Raises ValueError unless that is finite and not negative.
        """
        if not (math.isfinite(leaving_flux) and leaving_flux >= 0.0):
            raise ValueError(f"leaving_flux is {leaving_flux!r}: give a finite flux of at least 0")
        return Split(self.monitor_share * leaving_flux, self.onwards_share * leaving_flux)
