"""The BSDF on a grid of specular coordinates: what all table formats hold, whatever their units and keywords."""

from dataclasses import dataclass, field

import numpy as np

from goniotwin.app.formats.numerals import ascending_array, finite_array
from goniotwin.arrays import Floats


@dataclass(frozen=True, eq=False)
class BsdfTable:
    """A BSDF in 1/sr, `values` [wavelength, psi, sigma, phi, theta]; angles in degrees, each list ascending.

    phi ends at 180 where the other half is the mirror image in the plane of incidence. `psi_deg`, the azimuth of the light, is
    [0] for an isotropic sample. `wavelengths_nm` is None for a grey table. `u` are the standard uncertainties of the values, if
    known. `generated` values are simulated. Raises ValueError where these do not fit together.
    """

    sigma_deg: Floats
    phi_deg: Floats
    theta_deg: Floats
    values: Floats
    wavelengths_nm: tuple[float, ...] | None = None
    psi_deg: Floats = field(default_factory=lambda: np.zeros(1))
    transmitted: bool = False
    generated: bool = False
    comments: tuple[str, ...] = ()
    u: Floats | None = None

    def __post_init__(self) -> None:
        """Check the fields, and copy the arrays."""
        keep = object.__setattr__
        lists = [("psi", 360.0), ("sigma", 90.0), ("phi", 360.0), ("theta", 180.0)]
        for name, end in lists:
            keep(self, f"{name}_deg", ascending_array(name, getattr(self, f"{name}_deg"), 0.0, end))
        if self.wavelengths_nm is not None:
            keep(self, "wavelengths_nm", tuple(ascending_array("wavelengths", self.wavelengths_nm, 1e-3, 1e9).tolist()))
        shape = (len(self.wavelengths_nm or (None,)), *(getattr(self, f"{name}_deg").size for name, _ in lists))
        keep(self, "comments", tuple(self.comments))
        keep(self, "values", finite_array("values", self.values, shape))
        if self.u is not None:
            keep(self, "u", finite_array("uncertainties", self.u, shape))
