"""Scattering samples: the ideal diffuser, the paper's Gaussian, and tables.

Values are BSDF in 1/sr; a luminance factor (what formula 1 of the paper calls BSDF) is pi times that.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from twin.optics.bsdf import GAUSSIAN, LAMBERTIAN, TABLE, evaluate_all
from twin.optics.frames import Floats, from_specular, light_direction

Form = Literal["one_over_e", "half_width"]
Quantity = Literal["luminance", "intensity"]

GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(8)


def _frozen(values: npt.ArrayLike) -> Floats:
    result = np.array(values, dtype=np.float64, order="C")
    result.flags.writeable = False
    return result


@dataclass(frozen=True, eq=False)
class Scatterer:
    """A sample. Made by `lambertian`, `gaussian` or `tabulated`; see twin.optics.bsdf for the parameters of each kind.

    The table has the shape (sigma, phi, theta) in 1/sr, its axes are in degrees; models without a table have one of one
    zero.
    """

    name: str
    kind: int
    params: Floats
    sigma_deg: Floats = field(default_factory=lambda: _frozen([0.0]))
    phi_deg: Floats = field(default_factory=lambda: _frozen([0.0]))
    theta_deg: Floats = field(default_factory=lambda: _frozen([0.0]))
    values: Floats = field(default_factory=lambda: _frozen([[[0.0]]]))

    @cached_property
    def kernel_arguments(self) -> tuple[int, Floats, Floats, Floats, Floats, Floats]:
        """What the kernels take: kind, params, sigma, phi, theta, and the values with their slopes over sigma."""
        table = _frozen([self.values, _slopes(self.sigma_deg, self.values)])
        return self.kind, self.params, self.sigma_deg, self.phi_deg, self.theta_deg, table


def _slopes(sigma_deg: Floats, values: Floats) -> Floats:
    """Slopes over sigma of the monotone cubic through the values (Fritsch, Carlson 1980); none at the held ends.

    A measured table has few incidences. A kink at each, averaged over the beam's divergence, would be no property of
    the sample but a bias of the twin just where such a table is exact.
    """
    slopes = np.zeros_like(values)
    if sigma_deg.size < 3:
        return slopes
    step = np.diff(sigma_deg)[:, None, None]
    secant = np.diff(values, axis=0) / step
    before, after = secant[:-1], secant[1:]
    weight_before, weight_after = 2.0 * step[1:] + step[:-1], step[1:] + 2.0 * step[:-1]
    turning = before * after <= 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (weight_before + weight_after) / (weight_before / before + weight_after / after)
    slopes[1:-1] = np.where(turning, 0.0, mean)
    return slopes


def _positive(name: str, value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} is {value!r}: give a positive, finite number")
    return float(value)


def _share(name: str, value: float) -> float:
    if _positive(name, value) > 1.0:
        raise ValueError(f"{name} is {value!r}: a sample cannot give back more light than it gets, so at most 1")
    return float(value)


def lambertian(reflectance: float = 1.0) -> Scatterer:
    """The ideal diffuser: reflectance / pi in every direction. Raises ValueError unless 0 < reflectance <= 1."""
    value = _share("reflectance", reflectance) / math.pi
    return Scatterer(f"lambertian {reflectance:g}", LAMBERTIAN, _frozen([value, 0.0, 0.0, 0.0]))


def gaussian(
    width_deg: float,
    form: Form = "one_over_e",
    quantity: Quantity = "luminance",
    peak: float | None = None,
    reflectance: float | None = None,
) -> Scatterer:
    """A lobe about the mirror direction of the light: paper, formula 6.

    With theta the angle between the mirror direction and the observer, form "one_over_e" is I0 exp(-(theta / width)^2),
    the formula; "half_width" is I0 exp(-ln2 (theta / width)^2), the paper's words (half at the width). quantity
    "luminance" makes that the BSDF; "intensity" divides it by the cosine of the observer's zenith angle.

    I0 is `peak` in 1/sr, or follows from `reflectance`, the hemispherical reflectance at normal incidence; 0.9 if
    neither is given. Raises ValueError, naming the argument, for a width, peak or reflectance that is not positive and
    finite, an unknown form or quantity, or when both peak and reflectance are given.
    """
    width = math.radians(_positive("width_deg", width_deg))
    if form not in ("one_over_e", "half_width"):
        raise ValueError(f"form is {form!r}: give 'one_over_e' (formula 6) or 'half_width' (half at the width)")
    if quantity not in ("luminance", "intensity"):
        raise ValueError(f"quantity is {quantity!r}: give 'luminance' or 'intensity'")
    if peak is not None and reflectance is not None:
        raise ValueError("peak and reflectance are both given: give one of them, the other follows from it")
    exponent = (1.0 if form == "one_over_e" else math.log(2.0)) / width**2
    if peak is None:
        share = 0.9 if reflectance is None else _share("reflectance", reflectance)
        peak = share / _normal_reflectance(exponent, quantity)
    cut = -math.expm1(-exponent * math.pi**2)
    params = [_positive("peak", peak), exponent, float(quantity == "intensity"), cut]
    return Scatterer(f"gaussian {width_deg:g} deg {form} {quantity}", GAUSSIAN, _frozen(params))


def _panels(breaks: Floats) -> tuple[Floats, Floats]:
    """Gauss-Legendre nodes and weights between breaks (..., panels + 1), each of shape (..., panels * 8)."""
    half = 0.5 * np.diff(breaks, axis=-1)[..., None]
    nodes = breaks[..., :-1, None] + half * (GAUSS_NODES + 1.0)
    shape = (*breaks.shape[:-1], -1)
    return nodes.reshape(shape), (half * GAUSS_WEIGHTS).reshape(shape)


def _lobe_breaks(exponent: float) -> Floats:
    """Angles in rad between which a Gaussian is smooth enough for one panel, out to where it is below 1e-21."""
    widths = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0])
    return np.append(np.minimum(widths / math.sqrt(exponent), math.pi), math.pi)


def _normal_reflectance(exponent: float, quantity: Quantity) -> float:
    """Hemispherical reflectance at normal incidence of a Gaussian of peak 1."""
    theta, weight = _panels(np.minimum(_lobe_breaks(exponent), math.pi / 2))
    projected = np.cos(theta) if quantity == "luminance" else np.ones_like(theta)
    return float(2.0 * math.pi * np.sum(weight * np.exp(-exponent * theta**2) * projected * np.sin(theta)))


def _axis(name: str, values: npt.ArrayLike, last_deg: float) -> Floats:
    axis = _frozen(values)
    if axis.ndim != 1 or axis.size == 0:
        raise ValueError(f"{name} has the shape {axis.shape}: give a list of at least one angle")
    if not np.all(np.isfinite(axis)):
        raise ValueError(f"{name} has a value that is not finite: give every angle in degrees")
    if np.any(np.diff(axis) <= 0.0):
        raise ValueError(f"{name} is not ascending: sort it, and give each angle once")
    if axis[0] < 0.0 or axis[-1] > last_deg:
        raise ValueError(f"{name} runs from {axis[0]:g} to {axis[-1]:g}: keep it within 0 and {last_deg:g} deg")
    return axis


def tabulated(
    sigma_deg: npt.ArrayLike,
    phi_deg: npt.ArrayLike,
    theta_deg: npt.ArrayLike,
    values: npt.ArrayLike,
    name: str = "table",
) -> Scatterer:
    """An isotropic sample given by values (sigma, phi, theta) in 1/sr over specular coordinates in degrees.

    phi_deg runs from 0 to 180 (mirrored in the plane of incidence) or from 0 to 360, or is a single angle. Between the
    angles the value is linear in phi and theta and a monotone cubic in sigma, so without a kink at an incidence;
    outside of a list its first or last value holds, which is no extrapolation but no knowledge either. Raises
    ValueError, naming the argument, for axes that do not ascend or leave their range, for a wrong shape, and for values
    that are negative, infinite or missing.
    """
    sigma, theta = _axis("sigma_deg", sigma_deg, 90.0), _axis("theta_deg", theta_deg, 180.0)
    phi = _axis("phi_deg", phi_deg, 360.0)
    if phi.size > 1 and (phi[0] != 0.0 or phi[-1] not in (180.0, 360.0)):
        runs = f"{phi[0]:g} to {phi[-1]:g}"
        raise ValueError(f"phi_deg runs from {runs}: give 0 to 180 (symmetric) or 0 to 360, or one angle")
    table = _frozen(values)
    shape = (sigma.size, phi.size, theta.size)
    if table.shape != shape:
        raise ValueError(f"values has the shape {table.shape}: its axes (sigma, phi, theta) make it {shape}")
    wrong = np.argwhere(~np.isfinite(table) | (table < 0.0))
    if wrong.size:
        i, j, k = (int(index) for index in wrong[0])
        where = f"sigma {sigma[i]:g}, phi {phi[j]:g}, theta {theta[k]:g}"
        value = table[i, j, k]
        raise ValueError(f"values has {value} at {where}: fill the hole or cut the table: values are 1/sr, >= 0")
    return Scatterer(name, TABLE, _frozen([0.0, 0.0, 0.0, 0.0]), sigma, phi, theta, table)


def evaluate(scatterer: Scatterer, light: npt.ArrayLike, observer: npt.ArrayLike) -> Floats:
    """BSDF (...) in 1/sr for unit vectors towards `light` and `observer`, (..., 3) each, broadcast.

    Zero where the light or the observer is not in front of the sample.
    """
    towards_light, towards_observer = np.broadcast_arrays(np.asarray(light, float), np.asarray(observer, float))
    if towards_light.ndim == 0 or towards_light.shape[-1] != 3:
        raise ValueError(f"light and observer have the shape {towards_light.shape}: give vectors along the last axis")
    rows = [np.array(vectors, order="C").reshape(-1, 3) for vectors in (towards_light, towards_observer)]
    result: Floats = evaluate_all(*scatterer.kernel_arguments, *rows)
    return result.reshape(towards_light.shape[:-1])


def albedo(scatterer: Scatterer, sigma_deg: float) -> float:
    """Hemispherical reflectance for light at `sigma_deg` (0 to < 90), by quadrature in specular coordinates.

    Gauss-Legendre over theta between the breaks of the model and up to the horizon of each phi, the mean over phi.
    """
    if not 0.0 <= sigma_deg < 90.0:
        raise ValueError(f"sigma_deg is {sigma_deg!r}: give an angle of incidence of 0 to less than 90 deg")
    phi = (np.arange(720) + 0.5) * (2.0 * math.pi / 720)
    sigma = math.radians(sigma_deg)
    horizon = np.arctan2(math.cos(sigma), -math.sin(sigma) * np.cos(phi))
    if scatterer.kind == GAUSSIAN:
        inner = _lobe_breaks(scatterer.params[1])
    elif scatterer.kind == TABLE:
        inner = np.unique(np.concatenate([[0.0], np.radians(scatterer.theta_deg), [math.pi]]))
    else:
        inner = np.array([0.0, 0.25 * math.pi, 0.5 * math.pi, 0.75 * math.pi, math.pi])
    theta, weight = _panels(np.minimum(inner, horizon[:, None]))
    observer = from_specular(sigma_deg, np.degrees(theta), np.degrees(phi)[:, None])
    value = evaluate(scatterer, light_direction(sigma_deg), observer)
    total = np.sum(value * observer[..., 2] * np.sin(theta) * weight)
    return float(total * 2.0 * math.pi / phi.size)
