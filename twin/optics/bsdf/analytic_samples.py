"""Samples given by a formula: ideal diffuser, the paper's Gaussian, regular (mirror) component.

Each acts for light from `side`: from the front, from the back, or the same from both.
"""

import math
from typing import Literal

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.lobes import GaussianQuantity, Lobe, freeze, normal_reflectance, parameters
from goniotwin.twin.optics.bsdf.models import GAUSSIAN, LAMBERTIAN, REGULAR
from goniotwin.twin.optics.bsdf.scatterer import Scatterer, move_to_side

Form = Literal["one_over_e", "half_width"]
Side = Literal["front", "back", "both"]
SIDES: dict[Side, tuple[int, ...]] = {"front": (1,), "back": (-1,), "both": (1, -1)}
NARROWEST_DEG = 0.01


def lobes_of_side(lobe: Lobe, side: Side, transmits: bool) -> tuple[Lobe, ...]:
    """Lobes for light from the given side or sides. Raises ValueError for an unknown side."""
    if side not in SIDES:
        raise ValueError(f"side is {side!r}: give 'front', 'back' or 'both', the side of the light")
    return tuple(move_to_side(lobe, incident, transmits) for incident in SIDES[side])


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} is {value!r}: give a positive, finite number")
    return float(value)


def _share(name: str, value: float) -> float:
    if _positive(name, value) > 1.0:
        raise ValueError(f"{name} is {value!r}: a sample cannot scatter more light than it receives; give at most 1")
    return float(value)


def lambertian(reflectance: float = 1.0, transmittance: float = 0.0, side: Side = "front") -> Scatterer:
    """Ideal diffuser: reflectance / pi in every direction, and transmittance / pi in those behind the sheet.

    The reflectance may be 0 if there is a transmittance. Raises ValueError for a share below 0 or above 1, for both at 0, and
    for a sum above 1.
    """
    if transmittance == 0.0:
        _share("reflectance", reflectance)
    elif reflectance != 0.0:
        _share("reflectance", reflectance)
        _share("transmittance", transmittance)
        if reflectance + transmittance > 1.0:
            total = f"reflectance {reflectance:g} and transmittance {transmittance:g} add up to more than 1"
            raise ValueError(f"{total}: a sample cannot scatter more light than it receives")
    else:
        _share("transmittance", transmittance)
    lobes: tuple[Lobe, ...] = ()
    for share, transmits in ((reflectance, False), (transmittance, True)):
        if share > 0.0:
            lobes += lobes_of_side(Lobe(LAMBERTIAN, parameters(share / math.pi)), side, transmits)
    passed = f" transmitting {transmittance:g}" if transmittance else ""
    return Scatterer(f"lambertian {reflectance:g}{passed}", lobes)


def gaussian(
    width_deg: float,
    form: Form = "one_over_e",
    quantity: GaussianQuantity = "luminance",
    peak: float | None = None,
    reflectance: float | None = None,
    transmits: bool = False,
    refraction: float = 1.0,
    side: Side = "front",
) -> Scatterer:
    """Lobe about the direction of specular reflection or of straight transmission: paper, formula 6.

    With theta the angle between that direction and the observer, form "one_over_e" is I0 exp(-(theta / width)^2), the formula;
    "half_width" is I0 exp(-ln2 (theta / width)^2), the paper's text (half at the width). With quantity "luminance" that is the
    BSDF; with "intensity" it is divided by the cosine of the observer's zenith angle.

    I0 is `peak` in 1/sr, or follows from `reflectance`, the hemispherical reflectance (or, if it transmits, the transmittance)
    at normal incidence; 0.9 if neither is given. A transmitted lobe goes straight through, as in a sheet with parallel sides.
    `refraction` other than 1, the index behind the sample over that in front of it, bends its axis: sin(theta_t) = sin(theta_i)
    / refraction; beyond total reflection nothing is transmitted.

    The luminance lobe with a refraction of 1 is reciprocal: it depends only on the angle between two directions. Raises
    ValueError, naming the argument, for a width, peak, reflectance or refraction that is not positive and finite; for a width
    below 0.01 deg, which no aperture resolves from a mirror; for an unknown form, quantity or side; if both peak and
    reflectance are given; and for a reflected lobe with refraction.
    """
    width = math.radians(_positive("width_deg", width_deg))
    if width_deg < NARROWEST_DEG:
        raise ValueError(f"width_deg is {width_deg!r}: give at least {NARROWEST_DEG:g}, or use a regular component")
    if form not in ("one_over_e", "half_width"):
        raise ValueError(f"form is {form!r}: give 'one_over_e' (formula 6) or 'half_width' (half at the width)")
    if quantity not in ("luminance", "intensity"):
        raise ValueError(f"quantity is {quantity!r}: give 'luminance' or 'intensity'")
    if peak is not None and reflectance is not None:
        raise ValueError("peak and reflectance are both given: give one of them; the other follows from it")
    ratio = _positive("refraction", refraction)
    if ratio != 1.0 and not transmits:
        raise ValueError(f"refraction is {refraction!r}: only a transmitted lobe is refracted; leave it at 1, or set transmits")
    exponent = (1.0 if form == "one_over_e" else math.log(2.0)) / width**2
    if peak is None:
        share = 0.9 if reflectance is None else _share("reflectance", reflectance)
        peak = share / normal_reflectance(exponent, quantity)
    cut = -math.expm1(-exponent * math.pi**2)
    params = parameters(_positive("peak", peak), exponent, float(quantity == "intensity"), cut, ratio)
    suffix = (" transmitted" if transmits else "") + (f" at {ratio:g}" if ratio != 1.0 else "")
    return Scatterer(
        f"gaussian {width_deg:g} deg {form} {quantity}{suffix}", lobes_of_side(Lobe(GAUSSIAN, params), side, transmits)
    )


def regular(
    reflectance: npt.ArrayLike = 1.0,
    transmits: bool = False,
    side: Side = "front",
    sigma_deg: npt.ArrayLike | None = None,
) -> Scatterer:
    """Mirror or clear sheet: this share of the light continues in the specular direction, or straight through.

    `reflectance` is one share, or a list of shares over the angles of incidence `sigma_deg` (ascending, 0 to 90): a monotone
    cubic between them, constant beyond them. It has no finite BSDF: `evaluate` gives 0, its albedo is the share. Raises
    ValueError, naming the entry, for shares outside 0 to 1 and if all are 0.
    """
    shares = np.asarray(reflectance, dtype=np.float64)
    sigma: Floats = freeze([0.0])
    if sigma_deg is None:
        if shares.ndim:
            raise ValueError(f"reflectance has the shape {shares.shape}: give one number, or sigma_deg for a list")
        shares = shares.reshape(1)
    else:
        sigma = check_axis("sigma_deg", sigma_deg, 90.0)
        if shares.shape != sigma.shape:
            raise ValueError(f"reflectance has the shape {shares.shape}; with this sigma_deg give {sigma.shape}")
    wrong = np.flatnonzero(~((shares >= 0.0) & (shares <= 1.0)))
    if wrong.size:
        where = f" at sigma {sigma[wrong[0]]:g}" if sigma_deg is not None else ""
        raise ValueError(f"reflectance is {shares[wrong[0]]}{where}: give a share of the light, 0 to 1")
    if not np.any(shares > 0.0):
        raise ValueError("reflectance is 0: give a share above 0, or leave the component out")
    lobe = Lobe(REGULAR, parameters(shares[0]), sigma, values=freeze(shares.reshape(1, -1, 1, 1)))
    text = f"{shares[0]:g}" if shares.size == 1 else f"over {shares.size} incidences"
    return Scatterer(f"regular {text}{' transmitted' if transmits else ''}", lobes_of_side(lobe, side, transmits))


def check_axis(name: str, values: npt.ArrayLike, last_deg: float) -> Floats:
    """Check a list of angles: ascending, finite, within 0 and `last_deg`. Returns a copy. Raises ValueError that names it."""
    result = freeze(values)
    if result.ndim != 1 or result.size == 0:
        raise ValueError(f"{name} has the shape {result.shape}: give a list of at least one angle")
    if not np.all(np.isfinite(result)):
        raise ValueError(f"{name} has a value that is not finite: give every angle in degrees")
    if np.any(np.diff(result) <= 0.0):
        raise ValueError(f"{name} is not ascending: sort it and give each angle once")
    if result[0] < 0.0 or result[-1] > last_deg:
        raise ValueError(f"{name} runs from {result[0]:g} to {result[-1]:g}: keep it within 0 and {last_deg:g} deg")
    return result
