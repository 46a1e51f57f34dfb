"""Scattered values onto the grid of a table: the one interpolation of `specular_grid`, for all measurements.

Values whose directions are a grid of polar angles and azimuths, as a goniophotometer has them, are interpolated in it. Those
that are the nodes of a table stay where they are. Others, as of an adaptive measurement, get at each node the plane through the
values around it (`plane_through_points` of the optics).
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.formats.content import CHECK, FILLED, ISOTROPIC, UNTRUSTED, ScatteredBsdf, flagged
from goniotwin.app.formats.coverage import is_one_sided
from goniotwin.app.formats.holes import Fill
from goniotwin.app.formats.specular_grid import (
    PolarGrid,
    SpecularCut,
    continued,
    count_nodes,
    grid_of_points,
    resample,
    specular_table,
)
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import arc_direction, from_specular, to_specular
from goniotwin.twin.optics.bsdf.point_samples import plane_through_points, theta_list
from goniotwin.twin.optics.geometry.coordinates import (
    HALF_TURN_DEG,
    TOLERANCE_DEG,
    TURN_DEG,
    fold_azimuth,
    mirror_in_plane_of_incidence,
    round_deg,
)

FINEST_DEG = 0.1
PHI_STEP_DEG = 5.0
USUAL = {name: k for k, name in enumerate(("red", "green", "blue", "X", "Y", "Z"))}
"""The order of colours in tables; others are in that of the values."""
NEAR_DEG = 3.0
"""Between directions no further apart than this there is always interpolation."""
UNLIKE = 0.05
"""Mirror images that differ by more, as a share of the largest value of their light, are no noise: a comment states it."""
LEAST_FILLED = 0.3
"""Share of the nodes that have values (`count_nodes`) of directions that are on a grid of which a table is made as they are."""
THETA_DECIMALS, PHI_DECIMALS = 4, 3
"""Of the nodes of a table, whose directions are in a file with nine digits: near theta 0, phi has few of them."""
MOST_SIGMAS = 46
"""Incidences of a table. Values at more of them, as at random, are put to the nearest of so many, about their own specular
direction."""


@dataclass(frozen=True, eq=False)
class _Values:
    """Trusted values (n,) with the indices of their channel, psi and sigma; azimuths are from the light's.

    The errors of `own` are independent, `shared` is what values share; both are standard uncertainties.
    """

    channel: Ints
    psi: Ints
    sigma: Ints
    sigma_deg: Floats
    polar_deg: Floats
    azimuth_deg: Floats
    values: Floats
    own: Floats
    shared: Floats

    def where(self, chosen: Flags) -> "_Values":
        """Some of the values."""
        return _Values(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def grid_table(
    values: ScatteredBsdf,
    *,
    fill: Fill = "hold",
    comments: Sequence[str] = (),
    done: str = "measured",
) -> BsdfTable:
    """The table of the scattered values of one sample, side and light; `comments` come first in its own.

    Values that are not to be trusted, or were measured only to check a symmetry, are omitted. theta goes from 0 to 180 in the
    finest step of the polar angles; phi is 0 and 180 where only the plane of incidence was measured. What is isotropic is taken
    as symmetric about the plane of incidence. With a `widest_gap_deg` directions are on a grid, and there is no interpolation
    between any that are further apart; without it both follows from the values. Raises ValueError, in words, for values of
    which there is no table.
    """
    if (others := flagged(values.flags, {CHECK, FILLED})).any():
        values = values.where(~others)
    names, channel, wavelengths, colours = _channels(values)
    psi, psi_index = _psi(values)
    sigma, sigma_index = _sigma(values)
    trusted = np.isfinite(values.values) & ~flagged(values.flags, UNTRUSTED)
    _refuse_absent(names, channel, sigma, sigma_index, psi, psi_index, trusted)
    u = np.where(np.isfinite(values.u), values.u, np.abs(values.values))  # nothing is known of such a value
    shared = np.minimum(values.u_shared, u)
    points = _Values(
        channel,
        psi_index,
        sigma_index,
        values.sigma_deg,
        values.polar_deg,
        values.azimuth_deg - values.psi_deg,
        values.values,
        np.sqrt(np.maximum(u**2 - shared**2, 0.0)),
        shared,
    ).where(trusted)
    half = is_one_sided(points.azimuth_deg[round_deg(points.polar_deg) > 0.0])
    mirrored = values.isotropic or half
    if values.isotropic and not half:
        comments = [*comments, ISOTROPIC]
    elif not values.isotropic and half and not _in_plane(points).all():
        comments = [*comments, "the azimuths of one half were measured; the other half is taken as their mirror image"]
    if not values.isotropic and psi.size == 1:
        at = f"{float(np.mod(values.psi_deg[0], TURN_DEG)):.9g}"
        comments = [*comments, f"measured at psi {at} alone, of a sample that is not isotropic: taken the same at every psi"]
    if (widest_gap_deg := values.widest_gap_deg) is not None:
        between = f"nodes between measured directions more than {widest_gap_deg:g} deg apart count as not measured"
        comments = [*comments, between]
    if mirrored and (unlike := _unlike_halves(points)) > UNLIKE:
        alike = "the sample is taken as symmetric about the plane of incidence: values are means of mirror images"
        comments = [*comments, f"{alike}, which differ by up to {unlike:.2g} of the largest value of their light"]
    cut = _Cuts(points, sigma, psi, mirrored, widest_gap_deg)
    cuts = [[cut(c, p, s) for s in range(sigma.size)] for c in range(len(names)) for p in range(psi.size)]
    table = specular_table(
        sigma,
        cut.phi,
        cut.theta,
        cuts,
        wavelengths,
        psi_deg=psi,
        colours=colours,
        transmitted=bool(values.transmitted[0]),
        back=bool(values.back[0]),
        generated=values.generated,
        sample=values.sample,
        comments=comments,
        done=done,
        fill=fill,
    )
    return table if np.isfinite(values.u).any() else replace(table, u=None)


def _unlike_halves(points: _Values) -> float:
    """The largest difference between values and those at their mirror images, as a share of the largest value of that light."""
    azimuth = np.mod(points.azimuth_deg, TURN_DEG)
    light = points.channel * (points.sigma.max() + 1) + points.sigma
    place = np.rint(np.stack([points.polar_deg, fold_azimuth(azimuth)]) * 1e3).astype(np.int64)  # of 0.001 deg
    first, index = np.unique((light * 90_001 + place[0]) * 180_001 + place[1], return_index=True, return_inverse=True)[1:]
    means = []
    for side in ((azimuth > 0.0) & (azimuth < HALF_TURN_DEG), azimuth > HALF_TURN_DEG):
        count, total = (np.bincount(index[side], weight, first.size) for weight in (None, points.values[side]))
        means.append(np.divide(total, count, out=np.full(first.size, np.nan), where=count > 0))
    largest = np.zeros(int(light.max()) + 1)
    np.maximum.at(largest, light, np.abs(points.values))
    unlike = np.abs(means[0] - means[1])
    compared = np.isfinite(unlike) & (largest[light[first]] > 0.0)
    return float(np.max(unlike[compared] / largest[light[first]][compared], initial=0.0))


def _channels(values: ScatteredBsdf) -> tuple[tuple[str, ...], Ints, tuple[float, ...] | None, tuple[str, ...]]:
    """The channels in words, the index of each value's, and the wavelengths or the colours of a table."""
    if (values.channel != "").any():
        colours = tuple(sorted(dict.fromkeys(values.channel.tolist()), key=lambda name: USUAL.get(name, len(USUAL))))
        order = {name: k for k, name in enumerate(colours)}
        return colours, np.array([order[name] for name in values.channel.tolist()]), None, colours
    grey = np.isnan(values.wavelength_nm)
    if grey.any() and not grey.all():
        raise ValueError("some of its values have a wavelength, and some have none")
    if grey.all():
        return ("",), np.zeros(values.size, dtype=np.int64), None, ()
    wavelengths, index = np.unique(values.wavelength_nm, return_inverse=True)
    return tuple(f"{each:g} nm" for each in wavelengths), index, tuple(wavelengths.tolist()), ()


def _psi(values: ScatteredBsdf) -> tuple[Floats, Ints]:
    """The azimuths of the light, 0 alone for an isotropic sample, and the index of each value's."""
    psi, index = np.unique(np.mod(round_deg(values.psi_deg), TURN_DEG), return_inverse=True)
    return (np.zeros(1), np.zeros(values.size, dtype=np.int64)) if values.isotropic or psi.size == 1 else (psi, index)


def _sigma(values: ScatteredBsdf) -> tuple[Floats, Ints]:
    """The incidences, and the index of each value's."""
    _, first, index = np.unique(round_deg(values.sigma_deg), return_index=True, return_inverse=True)
    sigma = values.sigma_deg[first]
    if sigma.size > MOST_SIGMAS:
        sigma = np.linspace(sigma[0], sigma[-1], MOST_SIGMAS)
        index = np.rint((values.sigma_deg - sigma[0]) / (sigma[1] - sigma[0])).astype(np.int64)
    return sigma, index


def _refuse_absent(
    names: Sequence[str], channel: Ints, sigma_deg: Floats, sigma: Ints, psi_deg: Floats, psi: Ints, trusted: Flags
) -> None:
    """Raise ValueError for a set of channel, sigma and psi without a value; at normal incidence one psi is enough."""
    if not trusted.any():
        raise ValueError("no direction has a value")
    some = np.zeros((len(names), psi_deg.size, sigma_deg.size), dtype=bool)
    some[channel[trusted], psi[trusted], sigma[trusted]] = True
    normal = round_deg(sigma_deg) == 0.0
    some[:, :, normal] |= some[:, :, normal].any(axis=1, keepdims=True)
    for c, p, s in np.argwhere(~some).tolist():
        at = f"at {names[c]}, " if len(names) > 1 else "at "
        at += f"psi {psi_deg[p]:g}, " if psi_deg.size > 1 else ""
        raise ValueError(f"{at}sigma {sigma_deg[s]:g} no direction has a value")


def _in_plane(points: _Values) -> Flags:
    """The values in the plane of incidence."""
    azimuth = round_deg(fold_azimuth(points.azimuth_deg))
    return np.asarray((azimuth == 0.0) | (azimuth == HALF_TURN_DEG) | (round_deg(points.polar_deg) == 0.0))


class _Cuts:
    """The cut at each channel, psi and sigma of a table, over its lists `phi` and `theta`."""

    def __init__(
        self, points: _Values, sigma_deg: Floats, psi_deg: Floats, mirrored: bool, widest_gap_deg: float | None
    ) -> None:
        self._points, self._sigma, self._psi = points, sigma_deg, psi_deg
        self._mirrored, self._widest = mirrored, math.inf if widest_gap_deg is None else widest_gap_deg
        self._gap = self._widest
        whole = HALF_TURN_DEG if mirrored else TURN_DEG
        self.phi = np.array([0.0, whole]) if _in_plane(points).all() else np.arange(0.0, whole + 1e-9, PHI_STEP_DEG)
        theta, phi = self._about_specular(points)
        rings = self._filled(round_deg(points.polar_deg), round_deg(fold_azimuth(points.azimuth_deg)))
        about_specular = 0.0 if widest_gap_deg is not None else self._filled(theta, phi)
        if widest_gap_deg is not None or rings >= max(LEAST_FILLED, about_specular):
            self._cut: Callable[[_Values, float], SpecularCut] = self._of_rings
            polar = np.diff(np.unique(round_deg(points.polar_deg)))
            angles = round_deg(points.polar_deg), round_deg(fold_azimuth(points.azimuth_deg))
            usual = [self._usual_step(each) for each in angles]
            self._gap = max(NEAR_DEG, *usual) + TOLERANCE_DEG if widest_gap_deg is None else widest_gap_deg
            step = max(FINEST_DEG, float(polar.min())) if polar.size else PHI_STEP_DEG
            self.theta = np.linspace(0.0, HALF_TURN_DEG, 1 + math.ceil(HALF_TURN_DEG / step - 1e-6))
        elif about_specular >= LEAST_FILLED:
            self._cut = self._of_nodes
            self.theta = np.unique([0.0, *theta, HALF_TURN_DEG])
            self.phi = np.unique([0.0, *phi, whole])
        else:
            self._cut = self._of_planes
            sets = np.unique(np.stack([points.channel, points.psi, points.sigma]), axis=1).shape[1]
            spacing = math.degrees(math.sqrt((1.0 if mirrored else 2.0) * math.pi * sets / points.values.size))
            self._gap = max(NEAR_DEG, 2.0 * spacing)
            self.theta = theta_list(theta, HALF_TURN_DEG)

    def _filled(self, row_deg: Floats, column_deg: Floats) -> float:
        """The least share of the nodes (row, column) that have a value, of the sets of channel, psi and sigma."""
        shares = []
        for here in self._sets():
            nodes, filled = count_nodes(row_deg[here], column_deg[here])
            shares.append(filled / nodes if nodes else 1.0)
        return min(shares)

    def _usual_step(self, angle_deg: Floats) -> float:
        """The widest usual step between neighbouring angles of a set; at each psi they are at azimuths of their own."""
        steps = [np.diff(np.unique(angle_deg[here])) for here in self._sets()]
        return max((float(np.quantile(each, 0.95)) for each in steps if each.size), default=0.0)

    def _sets(self) -> list[Ints]:
        """The indices of the values of each channel, psi and sigma."""
        points = self._points
        _, which = np.unique(np.stack([points.channel, points.psi, points.sigma]), axis=1, return_inverse=True)
        order = np.argsort(which.ravel(), kind="stable")
        return np.split(order, np.flatnonzero(np.diff(which.ravel()[order])) + 1)

    def _about_specular(self, points: _Values) -> tuple[Floats, Floats]:
        """theta and phi, rounded so that equal ones are equal numbers."""
        theta, phi = to_specular(points.sigma_deg, arc_direction(points.polar_deg, points.azimuth_deg))
        phi = np.round(phi, PHI_DECIMALS)
        return np.round(theta, THETA_DECIMALS), fold_azimuth(phi) if self._mirrored else np.mod(phi, TURN_DEG)

    def __call__(self, channel: int, psi: int, sigma: int) -> SpecularCut:
        """One cut. Raises ValueError where no node has values around it."""
        points, sigma_deg = self._points, float(self._sigma[sigma])
        at_sigma = (points.channel == channel) & (points.sigma == sigma)
        here = points.where(at_sigma & (points.psi == psi))
        if here.values.size:
            cut = self._cut(here, sigma_deg)
        else:  # at normal incidence, in the frame of another psi
            here = points.where(at_sigma)
            cut = self._of_rings(replace(here, azimuth_deg=here.azimuth_deg + self._psi[here.psi] - self._psi[psi]), sigma_deg)
        if not cut.known.any() and math.isinf(self._widest):
            cut = self._of_nearest(here)
        if not cut.known.any():
            raise ValueError(f"at sigma {sigma_deg:g} no node of the grid has measured directions around it")
        return cut

    def _of_rings(self, here: _Values, sigma_deg: float) -> SpecularCut:
        """Values at polar angles and azimuths, interpolated."""
        grid = grid_of_points(here.polar_deg, here.azimuth_deg, here.values, here.own, here.shared, mirrored=self._mirrored)
        if not self._mirrored and grid.azimuth_deg[0] == 0.0:  # round the whole turn
            values, u, shared = (np.concatenate([each, each[:, :1]], axis=1) for each in (grid.values, grid.u, grid.shared))
            grid = PolarGrid(grid.polar_deg, np.append(grid.azimuth_deg, TURN_DEG), values, u, shared, mirrored=False)
        elif not self._mirrored:  # between the last half plane and the first
            values, u, shared = (
                np.concatenate([each[:, -2:], each, each[:, :2]], axis=1) for each in (grid.values, grid.u, grid.shared)
            )
            turn = grid.azimuth_deg
            azimuth = np.concatenate([turn[-2:] - TURN_DEG, turn, turn[:2] + TURN_DEG])
            grid = PolarGrid(grid.polar_deg, azimuth, values, u, shared, mirrored=False)
        return resample(grid, sigma_deg, self.phi, self.theta, widest_gap_deg=self._gap)

    def _of_nodes(self, here: _Values, _sigma_deg: float) -> SpecularCut:
        """Values that are the nodes of a table."""
        theta, phi = self._about_specular(here)
        grid = grid_of_points(theta, phi, here.values, here.own, here.shared, mirrored=self._mirrored)
        values, u = (np.full((self.phi.size, self.theta.size), np.nan) for _ in range(2))
        at = np.ix_(np.searchsorted(self.phi, grid.azimuth_deg), np.searchsorted(self.theta, grid.polar_deg))
        values[at], u[at] = grid.values.T, np.hypot(grid.u, grid.shared).T
        if not self._mirrored:
            values[-1], u[-1] = values[0], u[0]
        if grid.polar_deg[0] == 0.0:
            values[:, 0], u[:, 0] = grid.values[0, 0], np.hypot(grid.u, grid.shared)[0, 0]
        return continued(self.theta, values, u)

    def _of_nearest(self, here: _Values) -> SpecularCut:
        """A few values, each at the node nearest to it."""
        theta, phi = self._about_specular(here)
        row, column = (np.argmin(np.abs(axis - at[:, None]), axis=1) for axis, at in ((self.phi, phi), (self.theta, theta)))
        values, u = (np.full((self.phi.size, self.theta.size), np.nan) for _ in range(2))
        values[row, column], u[row, column] = here.values, np.hypot(here.own, here.shared)
        return continued(self.theta, values, u)

    def _of_planes(self, here: _Values, sigma_deg: float) -> SpecularCut:
        """Values anywhere, by the planes through those around."""
        theta, phi = to_specular(here.sigma_deg, arc_direction(here.polar_deg, here.azimuth_deg))
        directions, values, u = from_specular(sigma_deg, theta, phi), here.values, np.hypot(here.own, here.shared)
        if self._mirrored:
            off = np.abs(directions[:, 1]) > 1e-9
            directions = np.concatenate([directions, mirror_in_plane_of_incidence(directions[off])])
            values, u = np.concatenate([values, values[off]]), np.concatenate([u, u[off]])
        nodes = from_specular(sigma_deg, self.theta, self.phi[:, None])
        found, of_u = (
            plane_through_points(nodes.reshape(-1, 3), directions, each, math.radians(2.0 * self._gap)) for each in (values, u)
        )
        unknown = (np.degrees(found[:, 1]).reshape(nodes.shape[:-1]) > self._gap) | (nodes[..., 2] < 0.0)
        at_nodes, u_at_nodes = (np.where(unknown, np.nan, each[:, 0].reshape(unknown.shape)) for each in (found, of_u))
        return continued(self.theta, at_nodes, u_at_nodes)
