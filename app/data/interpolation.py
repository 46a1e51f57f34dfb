"""Interpolation of a sample's values to any direction, with the uncertainty; and what it needs: values on a grid of directions.

In one light the values are on rings of one polar angle (an arc measures these), or on a grid about the specular direction
(tables have this): which one follows from the directions alone, whatever file has carried them, by the share of the nodes above
the horizon that have a value. Between them is the monotone cubic of `specular_grid`, the one of all tables. Where finer rings
or half planes were measured near a lobe alone, a node without a value gets one from its neighbours on the half plane and on the
ring. Nothing is interpolated over a direction that was blocked or saturated. Between two incidences at fixed theta and phi, and
between two wavelengths, the interpolation is linear.

The uncertainty is that of the values, what they share included, and an estimate of the interpolation's own error: the monotone
cubic is between the given values, as a linear interpolation is, and the difference of the two in a cell, over the polar angle
and over the azimuth, is the half-width of a rectangular distribution. Between two incidences or wavelengths it is that of a
parabola whose vertex is at one of them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from goniotwin.app.data.values import EQUAL, LightSetting, SampleData, neighbours
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import flagged
from goniotwin.app.formats.coverage import is_one_sided
from goniotwin.app.formats.specular_grid import PolarGrid, count_nodes, grid_of_points, interpolate
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import (
    TOLERANCE_DEG,
    TURN_DEG,
    fold_azimuth,
    round_deg,
    wrap_azimuth,
    zenith_and_azimuth,
)

WIDEST_DEG = 30.0
"""There is no interpolation between directions that are further apart."""
LEAST_COMPLETED = 0.05
"""Least share of a grid's nodes that have values (`count_nodes`): less than for a table, because the others are completed."""
MOST_NODES = 4_000_000
NODE_DEG, WIDEST_NODE_DEG = 1e-4, 0.02
"""Directions no further apart on the sphere, and in their angle, have one node: a file keeps nine digits of its own angles."""
ALIKE = 0.01
"""Where two frames have nearly the same share of their nodes, as in the plane of incidence, it is the one of the tables."""
WIDEST_OF_TURN = 1.5
"""Azimuths go round where their widest step is at most so many times that of them and their mirror images together."""
RECTANGULAR = math.sqrt(3.0)
"""A half-width over this is the standard uncertainty of a rectangular distribution."""
BARRIERS = frozenset({"shadowed", "clipped"})
"""Flags of directions that nothing is interpolated over: light may be there that was not seen, or more than was measured."""
QUARTERS = (0.25, 0.75)
"""Places in a cell, as shares, at which the difference of two interpolations is looked at besides the place itself."""
Frame = Literal["rings", "specular"]


@dataclass(frozen=True, eq=False)
class DirectionGrid:
    """Values of one light on a grid of polar angle and azimuth from the light's ("rings"), or theta and phi ("specular")."""

    frame: Frame
    grid: PolarGrid


def direction_grid(data: SampleData, light: LightSetting) -> DirectionGrid | None:
    """The trusted values of one light on a grid; None where there are none, or their directions are on no grid.

    A grid is made once, so that values can be asked for one by one.
    """
    if light not in data.grids:
        data.grids[light] = _direction_grid(data, light)
    found: DirectionGrid | None = data.grids[light]
    return found


def _direction_grid(data: SampleData, light: LightSetting) -> DirectionGrid | None:
    values, sigma = data.values, light.sigma_deg
    good = data.good[light.index]
    kept = good | flagged(np.asarray(values.flags)[light.index], BARRIERS)
    index, good = light.index[kept], good[kept]
    if not good.any():
        return None
    rings = nodes_of("rings", sigma, values.polar_deg[index], values.azimuth_deg[index] - light.psi_deg, values.isotropic)
    specular = nodes_of("specular", sigma, data.theta_deg[index], data.phi_deg[index], values.isotropic)
    found = specular if specular.filled >= rings.filled - ALIKE else rings
    if found.filled < LEAST_COMPLETED:
        return None
    node = np.unique(np.stack([found.polar_deg, found.azimuth_deg], axis=1), axis=0, return_inverse=True)[1].ravel()
    used = good | ~np.isin(node, node[good])  # a node with a trusted value is no barrier
    index, polar, azimuth = index[used], found.polar_deg[used], found.azimuth_deg[used]
    own, shared = own_and_shared(np.asarray(values.u)[index], np.asarray(values.u_shared)[index])
    trusted = np.where(good[used], values.values[index], np.inf)
    grid = grid_of_points(polar, azimuth, trusted, own, shared, mirrored=found.mirrored)
    barrier = np.isinf(grid.values)
    grid = replace(grid, values=np.where(barrier, np.nan, grid.values))
    return DirectionGrid(found.frame, _completed(grid, barrier))


@dataclass(frozen=True, eq=False)
class Nodes:
    """The nodes at which directions (n,) are in a frame, and the share `filled` of all nodes above the horizon that have one.

    `azimuth_step_deg` is the widest step between half planes round the turn, their mirror images included where they count; 0
    where one half plane alone stands for all.
    """

    frame: Frame
    polar_deg: Floats
    azimuth_deg: Floats
    mirrored: bool
    filled: float
    azimuth_step_deg: float = 0.0


def nodes_of(frame: Frame, sigma_deg: float, polar_deg: Floats, azimuth_deg: Floats, isotropic: bool) -> Nodes:
    """Directions as nodes of a grid. Those at the pole are on the first half plane.

    The other half is the mirror image where there are directions on one alone, or, of an isotropic sample, far fewer on one.
    """
    polar = _joined(polar_deg, np.ones(polar_deg.size))
    polar[polar <= NODE_DEG] = 0.0
    off = polar > 0.0
    if not off.any():
        return Nodes(frame, polar, np.zeros(polar.size), mirrored=False, filled=1.0)
    wrapped = wrap_azimuth(azimuth_deg[off])
    wrapped = np.where(wrapped >= TURN_DEG - WIDEST_NODE_DEG, wrapped - TURN_DEG, wrapped)
    around = wrap_azimuth(_joined(wrapped, np.sin(np.radians(polar[off]))))
    step, both = _widest_step(around), _widest_step(np.concatenate([around, wrap_azimuth(-around)]))
    mirrored = (isotropic or is_one_sided(around)) and step > WIDEST_OF_TURN * both
    if mirrored:
        around, step = round_deg(fold_azimuth(around)), both
    azimuth = np.full(polar.size, around.min())
    azimuth[off] = around
    nodes, filled = count_nodes(polar, azimuth)
    if frame == "specular" and nodes <= MOST_NODES:  # a table has no values below the horizon
        rows, columns = np.unique(polar[off]), np.unique(around)
        nodes = int(np.sum(from_specular(sigma_deg, rows[:, None], columns)[..., 2] >= -math.radians(NODE_DEG)))
    if frame == "specular" and np.unique(around).size == 1:
        step = 0.0
    return Nodes(frame, polar, azimuth, mirrored, filled / nodes if nodes <= MOST_NODES else 0.0, step)


def _joined(angle_deg: Floats, sine: Floats) -> Floats:
    """Angles (n,) of which those that the digits of a file set apart are one number; `sine` is the length of a turn there."""
    order = np.argsort(angle_deg, kind="stable")
    angle, length = angle_deg[order], sine[order]
    apart = np.diff(angle)
    new = (apart * np.minimum(length[1:], length[:-1]) > NODE_DEG) | (apart > WIDEST_NODE_DEG)
    begin = np.concatenate([[0], 1 + np.flatnonzero(new)])
    node = np.cumsum(np.concatenate([[False], new]))
    means = np.bincount(node, angle * length**2) / np.bincount(node, length**2)
    wide = np.append(angle[begin[1:] - 1], angle[-1:]) - angle[begin] > WIDEST_NODE_DEG
    joined = np.empty(angle.size)
    joined[order] = round_deg(np.where(wide[node], angle, means[node]))  # directions at random may be close, one by one
    return joined


def _widest_step(azimuth_deg: Floats) -> float:
    """The widest step between azimuths (n,), round the whole turn."""
    there = np.unique(round_deg(azimuth_deg))
    return float(np.diff(there, append=there[0] + TURN_DEG).max())


def own_and_shared(u: Floats, u_shared: Floats) -> tuple[Floats, Floats]:
    """Standard uncertainties (n,): of each value alone, and shared by neighbours; all of it is shared where that is unknown."""
    shared = np.where(np.isfinite(u_shared) & (u_shared > 0.0), np.minimum(u_shared, u), u)
    return np.sqrt(np.maximum(u**2 - shared**2, 0.0)), shared


def _completed(grid: PolarGrid, barrier: Flags) -> PolarGrid:
    """The grid with values between its own where a ring or a half plane has none; closed over 360 deg.

    Nothing is interpolated at a `barrier` (p, a), nor beyond it.

    A node between others of its half plane and others of its ring has the mean of the two interpolated values, the closer
    neighbours weigh more; the difference of the two is the half-width of a rectangular distribution.
    """
    tables = _joined_fills(_along_half_planes(grid, barrier), _along_rings(grid, barrier))
    values, u, shared, _ = _along_rings(replace(grid, values=tables[0], u=tables[1], shared=tables[2]), barrier)
    azimuth = grid.azimuth_deg
    if not grid.mirrored and azimuth.size > 1:
        # Two half planes more on each side, so that the interpolation goes on over 360 deg.
        azimuth = np.concatenate([azimuth[-2:] - TURN_DEG, azimuth, azimuth[:2] + TURN_DEG])
        values, u, shared = (np.concatenate([each[:, -2:], each, each[:, :2]], axis=1) for each in (values, u, shared))
    return replace(grid, azimuth_deg=azimuth, values=values, u=u, shared=shared)


Fill = tuple[Floats, Floats, Floats, Floats]
"""Values of a grid with those that an interpolation has filled, their own and their shared u, and how far apart, in deg, the
neighbours of a filled one are: 0 of a given value."""


def _along_half_planes(grid: PolarGrid, barrier: Flags) -> Fill:
    """The grid with its missing values interpolated over the polar angle."""
    values, u, shared, apart = _copied(grid)
    for k in np.flatnonzero(np.isnan(values).any(axis=0)).tolist():
        found = _along(grid.polar_deg, values[:, k], u[:, k], shared[:, k], barrier[:, k])
        values[:, k], u[:, k], shared[:, k], apart[:, k] = found
    return values, u, shared, apart


def _along_rings(grid: PolarGrid, barrier: Flags) -> Fill:
    """The grid with its missing values interpolated over the azimuth, round the whole turn."""
    values, u, shared, apart = _copied(grid)
    turns = (0.0,) if grid.mirrored else (-TURN_DEG, 0.0, TURN_DEG)
    around = np.concatenate([grid.azimuth_deg + turn for turn in turns])
    here = slice(0, grid.azimuth_deg.size) if grid.mirrored else slice(grid.azimuth_deg.size, 2 * grid.azimuth_deg.size)
    for k in np.flatnonzero(np.isnan(values).any(axis=1)).tolist():
        row, u_row, shared_row = (np.tile(each[k], len(turns)) for each in (values, u, shared))
        barriers = np.tile(barrier[k], len(turns))
        sine = float(np.sin(np.radians(grid.polar_deg[k])))
        values[k], u[k], shared[k], apart[k] = (each[here] for each in _along(around, row, u_row, shared_row, barriers, sine))
    return values, u, shared, apart


def _copied(grid: PolarGrid) -> Fill:
    return grid.values.copy(), grid.u.copy(), grid.shared.copy(), np.zeros(grid.values.shape)


def _joined_fills(one: Fill, other: Fill) -> tuple[Floats, Floats, Floats]:
    """Values, own and shared u with the mean of two interpolated values, weighted by the inverse squares of the distances."""
    values, u, shared = (each.copy() for each in one[:3])
    only = np.isnan(values)
    for table, found in zip((values, u, shared), other, strict=False):
        table[only] = found[only]
    both = np.isfinite(one[0]) & np.isfinite(other[0]) & (one[3] > 0.0)
    (a, _, s_a, near_a), (b, _, s_b, near_b) = ([each[both] for each in fill] for fill in (one, other))
    weight = near_b**2 / (near_a**2 + near_b**2)
    values[both] = weight * a + (1.0 - weight) * b
    error = np.maximum(weight, 1.0 - weight) * np.abs(a - b) / RECTANGULAR
    shared[both] = np.hypot(weight * s_a + (1.0 - weight) * s_b, error)
    return values, u, shared


def _along(axis: Floats, values: Floats, u: Floats, shared: Floats, barrier: Flags, scale: float = 1.0) -> Fill:
    """Values (n,) on one axis with those that are missing, NaN, between others no further apart than `WIDEST_DEG` / `scale`.

    Angles on the axis are `scale` times as long on the sphere. What is interpolated shares all of its uncertainty.
    """
    apart = np.zeros(values.size)
    missing = np.isnan(values)
    known = np.flatnonzero(~missing)
    if known.size < 2 or not missing.any():
        return values, u, shared, apart
    line = PolarGrid(axis[known], np.zeros(1), values[known, None], u[known, None], shared[known, None], mirrored=False)
    at, azimuth = axis[missing], np.zeros(int(missing.sum()))
    if axis[known[0]] == 0.0:
        # The first node is no pole here; no node before it counts.
        line = replace(line, polar_deg=line.polar_deg + 1.0)
        at = at + 1.0
    found, u_found = interpolate(line, at, azimuth)
    error = np.abs(found - _linear(line, at, azimuth)) / RECTANGULAR
    apart[missing] = scale * _step(line.polar_deg, at)
    before = np.searchsorted(known, np.flatnonzero(missing)).clip(1, known.size - 1)
    passed = np.cumsum(barrier)[known]
    unknown = (apart[missing] > WIDEST_DEG + TOLERANCE_DEG) | (passed[before] > passed[before - 1])
    found = np.where(unknown, np.nan, found)
    values, u, shared = values.copy(), u.copy(), shared.copy()
    values[missing], u[missing], shared[missing] = found, 0.0, np.hypot(u_found, error)
    return values, u, shared, apart


def _step(axis: Floats, at: Floats) -> Floats:
    """Distance of the two nodes around places (n,); 0 on a node, infinite beyond the axis."""
    if axis.size == 1:
        return np.where(np.abs(at - axis[0]) <= EQUAL, 0.0, np.inf)
    index, place = _cell(axis, at)
    inside = (at >= axis[0] - EQUAL) & (at <= axis[-1] + EQUAL)
    return np.where(inside, np.where((place > 0.0) & (place < 1.0), axis[index + 1] - axis[index], 0.0), np.inf)


def _cell(axis: Floats, at: Floats) -> tuple[Ints, Floats]:
    """The node before each place (n,), and the position between it and the next one, 0 to 1."""
    index = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, axis.size - 2)
    place = np.clip((at - axis[index]) / (axis[index + 1] - axis[index]), 0.0, 1.0)
    place = np.where(place < 1e-6, 0.0, np.where(place > 1.0 - 1e-6, 1.0, place))
    return index, place


def _linear(grid: PolarGrid, polar: Floats, azimuth: Floats) -> Floats:
    """Values (n,) by a linear interpolation over polar angle and azimuth."""

    def nodes(axis: Floats, at: Floats) -> list[tuple[Ints, Floats]]:
        if axis.size == 1:
            return [(np.zeros(at.size, dtype=np.int64), np.ones(at.size))]
        index, place = _cell(axis, at)
        return [(index, 1.0 - place), (index + 1, place)]

    total = np.zeros(polar.size)
    for row, by_row in nodes(grid.polar_deg, polar):
        for column, by_column in nodes(grid.azimuth_deg, azimuth):
            weight = by_row * by_column
            total += np.where(weight == 0.0, 0.0, weight * grid.values[row, column])
    return total


def values_on_grid(found: DirectionGrid, sigma_deg: float, theta_deg: Floats, phi_deg: Floats) -> tuple[Floats, Floats]:
    """Values (n,) in 1/sr and standard uncertainties at specular coordinates (n,).

    NaN where no values are around, and below the horizon.
    """
    grid = found.grid
    polar, azimuth = zenith_and_azimuth(from_specular(sigma_deg, theta_deg, phi_deg))
    above = polar <= 90.0 + TOLERANCE_DEG
    if found.frame == "specular":
        polar, azimuth = round_deg(theta_deg), round_deg(phi_deg)
    polar, azimuth = round_deg(polar), round_deg(fold_azimuth(azimuth) if grid.mirrored else wrap_azimuth(azimuth))
    one = grid.azimuth_deg.size == 1 and found.frame == "specular"  # a table of one phi is the same at all
    anywhere = (polar <= TOLERANCE_DEG) | one  # at the pole any azimuth is the same direction
    azimuth = np.where(anywhere, grid.azimuth_deg[0], _on_node(grid.azimuth_deg, azimuth, np.sin(np.radians(polar))))
    polar = _on_node(grid.polar_deg, polar, np.ones(polar.size))
    apart = np.where(anywhere, 0.0, _step(grid.azimuth_deg, azimuth))
    with np.errstate(invalid="ignore"):
        apart = np.where(apart == 0.0, 0.0, apart * np.sin(np.radians(polar)))
    near = above & (np.maximum(apart, _step(grid.polar_deg, polar)) <= WIDEST_DEG + TOLERANCE_DEG)
    values, u = np.full(polar.size, np.nan), np.full(polar.size, np.nan)
    if near.any():
        values[near], u_values = interpolate(grid, polar[near], azimuth[near])
        u[near] = np.hypot(u_values, _error(grid, polar[near], azimuth[near], values[near]) / RECTANGULAR)
    return values, u


def _on_node(axis: Floats, at: Floats, sine: Floats) -> Floats:
    """Places (n,) on an axis; one that the rounding of a direction's own angles has moved off a node is on it."""
    if axis.size == 1:
        return at
    after = np.clip(np.searchsorted(axis, at), 1, axis.size - 1)
    nearest = np.where(at - axis[after - 1] < axis[after] - at, axis[after - 1], axis[after])
    return np.where(np.abs(at - nearest) * sine <= 2.0 * TOLERANCE_DEG, nearest, at)


def _error(grid: PolarGrid, polar: Floats, azimuth: Floats, values: Floats) -> Floats:
    """The half-width (n,) of the interpolation's error: over the polar angle, and over the azimuth, added.

    It is the difference from a linear interpolation, or what that is elsewhere in the cell, if that is more: a lobe crosses the
    chord between its nodes, and is not known better there.
    """
    over_polar, over_azimuth = _differences(grid, polar, azimuth, values)
    for quarter in QUARTERS:
        if grid.polar_deg.size > 1:
            at, weight = _in_cell(grid.polar_deg, polar, quarter)
            over_polar = np.maximum(over_polar, weight * _differences(grid, at, azimuth)[0])
        if grid.azimuth_deg.size > 1:
            at, weight = _in_cell(grid.azimuth_deg, azimuth, quarter)
            over_azimuth = np.maximum(over_azimuth, weight * _differences(grid, polar, at)[1])
    return np.asarray(over_polar + over_azimuth)


def _differences(grid: PolarGrid, polar: Floats, azimuth: Floats, values: Floats | None = None) -> tuple[Floats, Floats]:
    """Differences (n,) of values from those that are linear over the polar angle, and of these from linear ones over both."""
    values = interpolate(grid, polar, azimuth)[0] if values is None else values
    half = values
    if grid.polar_deg.size > 1:
        index, place = _cell(grid.polar_deg, polar)
        before, after = (interpolate(grid, grid.polar_deg[k], azimuth)[0] for k in (index, index + 1))
        half = np.where(place < 1.0, (1.0 - place) * before, 0.0) + np.where(place > 0.0, place * after, 0.0)
    return np.abs(values - half), np.abs(half - _linear(grid, polar, azimuth))


def _in_cell(axis: Floats, at: Floats, share: float) -> tuple[Floats, Floats]:
    """The place at a share of the cell of each place (n,), and a weight that falls from 1 to 0 towards the nodes."""
    index, place = _cell(axis, at)
    inside = (place > 0.0) & (place < 1.0)
    there = np.where(inside, axis[index] + share * (axis[index + 1] - axis[index]), at)
    return there, np.where(inside, np.minimum(1.0, place * (1.0 - place) / (QUARTERS[0] * QUARTERS[1])), 0.0)


def interpolated(
    lights: Sequence[tuple[LightSetting, float]], data: SampleData, theta_deg: Floats, phi_deg: Floats
) -> tuple[Floats, Floats]:
    """Values (n,) and standard uncertainties at specular coordinates (n,), from one light or several with weights.

    NaN where no values are around.
    """
    total, u_total = np.zeros(theta_deg.size), np.zeros(theta_deg.size)
    error = np.zeros(theta_deg.size)
    known: list[Floats] = []
    for light, weight in lights:
        grid = direction_grid(data, light)
        none = np.full(theta_deg.size, np.nan)
        values, u = (none, none) if grid is None else values_on_grid(grid, light.sigma_deg, theta_deg, phi_deg)
        total += weight * values
        u_total += weight * u
        known.append(values)
    for (_, weight), values in zip(lights, known, strict=True):
        # Two lights with the weights w and 1 - w: f w (1 - w) of the difference from their mean, in each of them.
        error = np.maximum(error, weight * np.abs(values - total))
    return total, np.hypot(u_total, error / RECTANGULAR)


def lights_at(
    data: SampleData,
    place: str,
    *,
    sigma_deg: float | None,
    psi_deg: float | None,
    wavelength_nm: float | None,
    channel: str | None,
    transmitted: bool | None,
    back: bool | None,
    between: bool = True,
) -> list[tuple[LightSetting, float]]:
    """The light that is asked for, or those around it with their weights; what only one value is measured at need not be given.

    Without `between` it has to be one that is there. Raises UserError, with what is there.
    """
    lights: Sequence[LightSetting] = data.lights
    if not lights:
        raise UserError(f"{place} has no values")
    for name, wanted in (("channel", channel), ("transmitted", transmitted), ("back", back)):
        there = sorted({getattr(each, name) for each in lights})
        if wanted is None and len(there) > 1:
            raise UserError(f"{name}: is missing; {place} has {' and '.join(map(repr, there))}")
        if wanted is not None and wanted not in there:
            raise UserError(f"{name} {wanted!r}: {place} has no such values; it has {', '.join(map(repr, there))}")
        lights = [each for each in lights if wanted is None or getattr(each, name) == wanted]
    lights = [light for light, _ in _around(lights, "psi_deg", psi_deg, place, between=False)]
    found: list[tuple[LightSetting, float]] = []
    by_sigma = {light.sigma_deg: weight for light, weight in _around(lights, "sigma_deg", sigma_deg, place, between=between)}
    for sigma, weight in by_sigma.items():
        here = [each for each in lights if each.sigma_deg == sigma]
        found += [
            (light, weight * share) for light, share in _around(here, "wavelength_nm", wavelength_nm, place, between=between)
        ]
    return found


def _around(
    lights: Sequence[LightSetting], name: str, wanted: float | None, place: str, *, between: bool
) -> list[tuple[LightSetting, float]]:
    """Lights at a number, or at the two numbers around it, with weights; all lights at one number have its weight."""
    column = np.array([getattr(each, name) for each in lights])
    there = np.unique(column)
    if wanted is None or np.isnan(there).all():
        if there.size > 1:
            raise UserError(f"{name}: is missing; {place} has {', '.join(f'{each:g}' for each in there[:8].tolist())}")
        if wanted is not None:
            raise UserError(f"{name} {wanted:g}: {place} has values without a wavelength; leave it out")
        return [(each, 1.0) for each in lights]
    apart = np.abs(there - wanted)
    if name == "psi_deg":
        apart = np.minimum(np.mod(apart, TURN_DEG), TURN_DEG - np.mod(apart, TURN_DEG))
    if apart.min() <= EQUAL:
        weights = {float(there[int(np.argmin(apart))]): 1.0}
    elif not between or not there[0] < wanted < there[-1]:
        raise UserError(f"{name} {wanted:g}: {place} has no values there; {neighbours(column, wanted)}")
    else:
        k = int(np.searchsorted(there, wanted))
        share = float((wanted - there[k - 1]) / (there[k] - there[k - 1]))
        weights = {float(there[k - 1]): 1.0 - share, float(there[k]): share}
    return [(each, weights[getattr(each, name)]) for each in lights if getattr(each, name) in weights]


def nearest_directions(
    data: SampleData, lights: Sequence[LightSetting], theta_deg: float, phi_deg: float, count: int = 2
) -> str:
    """The trusted directions nearest to one, in words; and the barriers that are near."""
    index = np.concatenate([each.index for each in lights])
    if not data.good[index].any():
        return "there is no trusted value in this light"
    wanted = from_specular(0.0, theta_deg, phi_deg)
    apart = np.linalg.norm(from_specular(0.0, data.theta_deg[index], data.phi_deg[index]) - wanted, axis=1)
    near = index[np.argsort(apart, kind="stable")]
    good = near[data.good[near]][: 8 * count].tolist()
    found = dict.fromkeys(f"theta {data.theta_deg[k]:.4g}, phi {data.phi_deg[k]:.4g}" for k in good)
    flags = {each for text in data.values.flags[near[: 8 * count]].tolist() for each in text.split()} & BARRIERS
    barriers = f"nothing is interpolated beside {' and '.join(sorted(flags))} directions; " if flags else ""
    return f"{barriers}the nearest directions with a value are {' and '.join(list(found)[:count])}"
