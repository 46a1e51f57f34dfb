"""What a mirror reflects: a share, or a table over wavelength and angle of incidence."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats

NOMINAL_DEG = 45.0
"""The beam's axis meets each of the three mirrors at this angle."""
NOMINAL_NM = 555.0


@dataclass(frozen=True, eq=False)
class Reflectance:
    """Values (w, a) between 0 and 1 over wavelengths (w,) in nm and angles of incidence (a,) in deg, both ascending.

    Linear between them; the first and last of each list hold outside. A list of one is no dependence. Raises ValueError,
    naming the argument, for lists that do not ascend, a wrong shape, or values that no mirror has.
    """

    wavelength_nm: Floats
    angle_deg: Floats
    values: Floats

    def __post_init__(self) -> None:
        lists = {}
        for name in ("wavelength_nm", "angle_deg", "values"):
            lists[name] = np.array(getattr(self, name), dtype=np.float64)
            lists[name].flags.writeable = False
            object.__setattr__(self, name, lists[name])
        for name, last in (("wavelength_nm", np.inf), ("angle_deg", 90.0)):
            axis = lists[name]
            if axis.ndim != 1 or not axis.size or not np.all(np.isfinite(axis)) or np.any(np.diff(axis) <= 0.0):
                raise ValueError(f"{name} is {axis.tolist()}: give an ascending list of finite numbers")
            if axis[0] < 0.0 or axis[-1] > last:
                raise ValueError(f"{name} runs from {axis[0]:g} to {axis[-1]:g}: keep it within 0 and {last:g}")
        shape = (lists["wavelength_nm"].size, lists["angle_deg"].size)
        if self.values.shape != shape:
            raise ValueError(f"values has the shape {self.values.shape}: wavelengths and angles make it {shape}")
        if not np.all((self.values > 0.0) & (self.values <= 1.0)):
            raise ValueError("values has one that is not above 0 and at most 1: a mirror reflects a share of the light")

    def at(self, wavelength_nm: float | None, angle_deg: npt.ArrayLike) -> Floats:
        """Shares (...) at one wavelength and angles (...). Raises ValueError without the wavelength, where it matters."""
        if self.wavelength_nm.size == 1:
            row = self.values[0]
        elif wavelength_nm is None:
            raise ValueError("wavelength_nm is missing: the mirrors' reflectance depends on it; say at which it is asked")
        else:
            row = np.array([np.interp(wavelength_nm, self.wavelength_nm, column) for column in self.values.T])
        return np.asarray(np.interp(np.asarray(angle_deg, dtype=np.float64), self.angle_deg, row))


def share_reflected(reflectance: "float | Reflectance", wavelength_nm: float | None, angle_deg: npt.ArrayLike) -> Floats:
    """Share (...) of unpolarised light that a mirror reflects at angles (...) of incidence, whatever tells it.

    Raises ValueError where a table over the wavelength is not told it.
    """
    if isinstance(reflectance, Reflectance):
        return reflectance.at(wavelength_nm, angle_deg)
    return np.full(np.shape(angle_deg), float(reflectance))


def nominal(reflectance: "float | Reflectance") -> float:
    """At 45 deg and 555 nm."""
    return float(share_reflected(reflectance, NOMINAL_NM, NOMINAL_DEG))
