"""The BSDF on a grid of specular coordinates: what all table formats hold, whatever their units and keywords."""

from dataclasses import dataclass, field

import numpy as np

from goniotwin.app.formats.numerals import ascending_array, finite_array
from goniotwin.arrays import Flags, Floats, ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class BsdfTable(ReadOnlyArrays):
    """A BSDF in 1/sr, `values` [wavelength, psi, sigma, phi, theta]; angles in degrees, each list ascending.

    phi ends at 180 where the other half is the mirror image in the plane of incidence. `psi_deg`, the azimuth of the light, is
    [0] for an isotropic sample. `wavelengths_nm` is None for a grey table, and for one of `colours`, which are named instead.
    `u` are the standard uncertainties of the values, if known, and `known` marks the values that were measured: a table has a
    number at every node. None: all of them. `back`: lit on the back. `generated` values are simulated. Raises ValueError where
    these do not fit together.
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
    colours: tuple[str, ...] = ()
    known: Flags | None = None
    back: bool = False
    sample: str = ""

    def __post_init__(self) -> None:
        """Check the fields, and copy the arrays, which cannot be written then."""
        keep = object.__setattr__
        lists = [("psi", 360.0), ("sigma", 90.0), ("phi", 360.0), ("theta", 180.0)]
        for name, end in lists:
            keep(self, f"{name}_deg", ascending_array(name, getattr(self, f"{name}_deg"), 0.0, end))
        if self.wavelengths_nm is not None:
            keep(self, "wavelengths_nm", tuple(ascending_array("wavelengths", self.wavelengths_nm, 1e-3, 1e9).tolist()))
        shape = (len(self.wavelengths_nm or self.colours or (None,)), *(getattr(self, f"{name}_deg").size for name, _ in lists))
        keep(self, "comments", tuple(self.comments))
        keep(self, "values", finite_array("values", self.values, shape))
        if self.known is not None and self.known.shape != shape:
            raise ValueError(f"known has the shape {self.known.shape}, not {shape}")
        if self.u is not None:
            keep(self, "u", finite_array("uncertainties", self.u, shape))
        super().__post_init__()
