"""What a Lumicept .ddr or .ddt file holds: luminance factors over a grid of specular coordinates.

A luminance factor is v = pi * f with f in 1/sr, so a perfect white diffuser is 1 everywhere. The zero of phi is in the
plane of incidence, from the specular ray towards the normal. Programs that read these files extrapolate linearly
outside the lists, so a table should cover sigma 0..90 and theta 0..180 (at least 90 + the largest sigma).
"""

from dataclasses import dataclass

import numpy as np

from goniotwin.app.formats.grid import ascending, finite
from goniotwin.arrays import Floats

SOURCES = ("Measured", "Generated", "Edited", "Morphed")
SYMMETRIES = ("PlaneSymmetrical", "ASymmetrical", "ASymmetrical 4D")
END_OF = {"psi": 360.0, "sigma": 90.0, "phi": 360.0, "theta": 180.0}
"""Where the list of angles of each keyword may end, deg."""


@dataclass(frozen=True, eq=False)
class DdrTable:
    """Luminance factors (pi times the BSDF in 1/sr) in specular coordinates.

    `values` [channel, psi, sigma, phi, theta]; the lists of angles, deg, ascend. `channels` has a wavelength, nm, for
    each channel, ascending, or is (None,) for a black and white table. `psi_deg` is [0] unless "ASymmetrical 4D", and
    PlaneSymmetrical has phi 0..180. `comments` stand at the top of the file. Raises ValueError where these do not fit.
    """

    source: str
    symmetry: str
    psi_deg: Floats
    sigma_deg: Floats
    phi_deg: Floats
    theta_deg: Floats
    channels: tuple[float | None, ...]
    values: Floats
    comments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Checks, and copies the arrays."""
        if self.source not in SOURCES:
            raise ValueError(f"source is one of {SOURCES}, not {self.source!r}")
        if self.symmetry not in SYMMETRIES:
            raise ValueError(f"symmetry is one of {SYMMETRIES}, not {self.symmetry!r}")
        keep = object.__setattr__
        for name, end in END_OF.items():
            keep(self, f"{name}_deg", ascending(name, getattr(self, f"{name}_deg"), 0.0, end))
        if self.symmetry == "PlaneSymmetrical" and self.phi_deg[-1] > 180:
            raise ValueError(f"phi goes to {self.phi_deg[-1]:g} deg, but PlaneSymmetrical has 0 to 180 only")
        if self.symmetry != "ASymmetrical 4D" and self.psi_deg.tolist() != [0.0]:
            raise ValueError(f"psi is [0] unless the symmetry is ASymmetrical 4D, not {self.psi_deg.tolist()[:5]}")
        keep(self, "channels", tuple(self.channels))
        if self.channels != (None,):
            ascending("channels", [np.nan if nm is None else nm for nm in self.channels], 1e-3, 1e9)
        lists = (self.psi_deg, self.sigma_deg, self.phi_deg, self.theta_deg)
        shape = (len(self.channels), *(angles.size for angles in lists))
        keep(self, "values", finite("values", self.values, shape))
        keep(self, "comments", tuple(self.comments))


def bsdf(table: DdrTable) -> Floats:
    """The BSDF in 1/sr, [channel, psi, sigma, phi, theta]."""
    return table.values / np.pi
