"""Lobe: one scattering model for one pair of sides of the sample, as an argument of the kernels.

Samples are made without numba: what evaluates them loads it.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.kinds import ANISOTROPIC, ELLIPTIC, GAUSSIAN, REGULAR, TABLE, WARD, WIDE
from goniotwin.twin.optics.geometry.coordinates import from_specular, light_direction

GaussianQuantity = Literal["luminance", "intensity"]

GAUSS_NODES, GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(8)
TAIL_WIDTHS = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0, 16.0, 30.0, 60.0, 120.0, 250.0, 500.0, 1000.0])
# Incidences of `Lobe.albedos`.
ALBEDO_SIGMA_DEG = (0.0, 20.0, 40.0, 60.0, 75.0, 85.0)


def freeze(values: npt.ArrayLike) -> Floats:
    """Read-only copy: kernels are compiled for such arrays, and lobes share them."""
    result = np.array(values, dtype=np.float64, order="C")
    result.flags.writeable = False
    return result


def parameters(*values: float) -> Floats:
    """The eight parameters of a lobe, padded with zeros."""
    return freeze([*values, *[0.0] * (8 - len(values))])


class KernelArguments(NamedTuple):
    """The model of one lobe, as the kernels take it."""

    kind: int
    params: Floats
    sigma_deg: Floats
    phi_deg: Floats
    theta_deg: Floats
    psi_deg: Floats
    table: Floats


@dataclass(frozen=True, eq=False)
class Lobe:
    """One model (see twin.optics.bsdf.models for `kind` and the eight `params`) from one side of the sample to one side.

    `incident` is 1 for light from the front and -1 for light from the back. `transmits`: the light passes through the sample. A
    table's `values` have the shape (psi, sigma, phi, theta) in 1/sr; its axes are in degrees and in canonical directions. The
    values of a REGULAR lobe have the shape (1, sigma, 1, 1). Models without a table have a table of one zero.
    """

    kind: int
    params: Floats
    sigma_deg: Floats = field(default_factory=lambda: freeze([0.0]))
    phi_deg: Floats = field(default_factory=lambda: freeze([0.0]))
    theta_deg: Floats = field(default_factory=lambda: freeze([0.0]))
    psi_deg: Floats = field(default_factory=lambda: freeze([0.0]))
    values: Floats = field(default_factory=lambda: freeze([[[[0.0]]]]))
    incident: int = 1
    transmits: bool = False

    @cached_property
    def kernel_arguments(self) -> KernelArguments:
        """Arguments of `bsdf`; the table has the values with their slopes over sigma."""
        table = np.empty((2 * self.values.shape[0], *self.values.shape[1:]))
        for n, block in enumerate(self.values):
            table[2 * n], table[2 * n + 1] = block, slopes(self.sigma_deg, block)
        return KernelArguments(
            self.kind,
            self.params,
            self.sigma_deg,
            self.phi_deg,
            self.theta_deg,
            self.psi_deg,
            freeze(table),
        )

    @cached_property
    def cells(self) -> Floats:
        """Argument of `sample` and `density` in place of the table: see `cell_shares`; one zero for models without a table."""
        if self.kind not in (TABLE, ANISOTROPIC):
            return freeze([[[0.0]]])
        # Loads 324 modules, numba and importlib.metadata among them: 0.2 s, which `check` does without.
        from goniotwin.twin.optics.bsdf.cells import cell_shares

        return freeze(cell_shares(self.sigma_deg, self.phi_deg, self.theta_deg, self.values))

    @cached_property
    def albedos(self) -> Floats:
        """Albedos at ALBEDO_SIGMA_DEG, with the plane of incidence along x."""
        return freeze([self.albedo(sigma) for sigma in ALBEDO_SIGMA_DEG])

    @property
    def mirrored(self) -> bool:
        """Whether the lobe is symmetric about every plane of incidence."""
        if self.kind in (ELLIPTIC, WARD):
            return bool(self.params[5] == (0.0 if self.kind == ELLIPTIC else self.params[1]))
        return bool(self.psi_deg.size <= 1 and self.phi_deg[-1] <= 180.0)

    @property
    def period_deg(self) -> float:
        """Smallest turn of the sample about its normal after which the lobe is the same, deg; 0 for an isotropic lobe."""
        if self.kind in (ELLIPTIC, WARD):
            return 0.0 if self.mirrored else 180.0
        return float(self.params[0]) if self.kind == ANISOTROPIC else 0.0

    def albedo(self, sigma_deg: float, azimuth_deg: float = 0.0) -> float:
        """Share of the light at canonical sigma (0 to < 90) and azimuth that the lobe scatters, by quadrature.

        Gauss-Legendre over theta between the breaks of the model and up to the horizon of each phi; mean over phi.
        """
        from goniotwin.twin.optics.bsdf.models import evaluate_all, refract, regular_share  # as in `cells`

        light = light_direction(sigma_deg)
        if self.kind == REGULAR:
            of = self.kernel_arguments
            return float(regular_share(of.params, of.sigma_deg, of.table, *map(float, light)))
        axis_deg = sigma_deg
        if self.kind == GAUSSIAN and self.params[4] != 1.0:
            x, _, z = refract(float(self.params[4]), *map(float, light))
            if z <= 0.0:
                return 0.0
            axis_deg = math.degrees(math.atan2(x, z))
        phi = (np.arange(720) + 0.5) * (2.0 * math.pi / 720)
        axis = math.radians(axis_deg)
        horizon = np.arctan2(math.cos(axis), -math.sin(axis) * np.cos(phi))
        theta, weight = panels(np.minimum(self._breaks(), horizon[:, None]))
        observer = from_specular(axis_deg, np.degrees(theta), np.degrees(phi)[:, None])
        rows = observer.reshape(-1, 3)
        lights = np.broadcast_to(light, rows.shape)
        if azimuth_deg != 0.0:
            rows, lights = rotate_about_z(azimuth_deg, rows), rotate_about_z(azimuth_deg, lights)
        value = evaluate_all(*self.kernel_arguments, 1, False, np.array(lights, order="C"), rows).reshape(theta.shape)
        total = np.sum(value * observer[..., 2] * np.sin(theta) * weight)
        return float(total * 2.0 * math.pi / phi.size)

    def _breaks(self) -> Floats:
        """Angles in rad; between two of them the lobe is smooth enough for one panel over theta."""
        if self.kind == GAUSSIAN:
            return lobe_breaks(self.params[1])
        if self.kind == ELLIPTIC:
            return np.union1d(lobe_breaks(self.params[1]), lobe_breaks(self.params[1] + self.params[5]))
        if self.kind == WARD:  # a slope of the half vector turns the direction by about twice its angle
            return np.union1d(lobe_breaks(0.25 * self.params[1]), lobe_breaks(0.25 * self.params[5]))
        if self.kind == WIDE:
            return np.append(np.minimum(TAIL_WIDTHS / math.sqrt(self.params[1]), math.pi), math.pi)
        if self.kind in (TABLE, ANISOTROPIC):
            return np.unique(np.concatenate([[0.0], np.radians(self.theta_deg), [math.pi]]))
        return np.array([0.0, 0.25 * math.pi, 0.5 * math.pi, 0.75 * math.pi, math.pi])


def rotate_about_z(angle_deg: float, vectors: Floats) -> Floats:
    """Vectors (..., 3) turned about z by `angle_deg`, counter-clockwise."""
    cos, sin = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)


def slopes(sigma_deg: Floats, values: Floats) -> Floats:
    """Slopes over sigma, the first axis, of the monotone cubic through the values (Fritsch, Carlson 1980).

    Zero at the ends. A measured table has few incidences. A kink at each, averaged over the beam's divergence, would not be a
    property of the sample but a bias of the twin at the very incidences where such a table is exact.
    """
    result = np.zeros_like(values)
    if sigma_deg.size < 3:
        return result
    step = np.diff(sigma_deg)[:, None, None]
    secant = np.diff(values, axis=0) / step
    before, after = secant[:-1], secant[1:]
    weight_before, weight_after = 2.0 * step[1:] + step[:-1], step[1:] + 2.0 * step[:-1]
    turning = before * after <= 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (weight_before + weight_after) / (weight_before / before + weight_after / after)
    result[1:-1] = np.where(turning, 0.0, mean)
    return result


def panels(breaks: Floats) -> tuple[Floats, Floats]:
    """Gauss-Legendre nodes and weights between breaks (..., panels + 1), each of shape (..., panels * 8)."""
    half = 0.5 * np.diff(breaks, axis=-1)[..., None]
    nodes = breaks[..., :-1, None] + half * (GAUSS_NODES + 1.0)
    shape = (*breaks.shape[:-1], -1)
    return nodes.reshape(shape), (half * GAUSS_WEIGHTS).reshape(shape)


def lobe_breaks(exponent: float) -> Floats:
    """Angles in rad, out to where the Gaussian is below 1e-21; between two of them it is smooth enough for one panel."""
    widths = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 7.0])
    return np.append(np.minimum(widths / math.sqrt(exponent), math.pi), math.pi)


def normal_reflectance(exponent: float, quantity: GaussianQuantity) -> float:
    """Albedo at normal incidence of a Gaussian of peak 1."""
    theta, weight = panels(np.minimum(lobe_breaks(exponent), math.pi / 2))
    projected = np.cos(theta) if quantity == "luminance" else np.ones_like(theta)
    return float(2.0 * math.pi * np.sum(weight * np.exp(-exponent * theta**2) * projected * np.sin(theta)))
