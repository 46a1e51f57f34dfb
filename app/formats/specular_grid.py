"""Resampling onto specular coordinates (paper, formulas 2 to 4, corrected), for measured and simulated tables alike.

Values over polar angle and azimuth are interpolated by a monotone cubic (Fritsch, Butland 1984) in azimuth, then in polar
angle: it passes through the given values, does not overshoot, and follows a lobe that is only a few steps wide far better than
a linear interpolation. A table needs a number at every node: other nodes get a continued value, and are marked as not known.

The result is nonlinear in the values, but homogeneous of degree 1: by Euler's theorem it is the sum of the values, each times
its derivative. So the derivatives are the weights of the value and of its uncertainty (GUM, formula 10 for independent errors,
formula 16 with a correlation of 1 for those that values share).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.formats.coverage import repeated
from goniotwin.app.formats.holes import ABOUT_FILL, Fill, fill_holes, refuse_holes, unmeasured_share
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import (
    HALF_TURN_DEG,
    TOLERANCE_DEG,
    TURN_DEG,
    fold_azimuth,
    mirror_in_plane_of_incidence,
    round_deg,
    wrap_azimuth,
    zenith_and_azimuth,
)

ABOUT_SHARE = "share of the light that was not "
MAX_LISTED_RANGES = 2000
"""Ranges listed in the comments of a table."""


@dataclass(frozen=True, eq=False)
class PolarGrid:
    """Values (p, a) over polar angles (p,) and azimuths (a,) of observation, deg, with two standard uncertainties (p, a).

    The errors of `u` are independent, those of `shared` have one cause, and all values have them with the same sign. NaN where
    there is no value. With `mirrored` the azimuths are within 0 to 180, and the other half is the mirror image in the plane of
    incidence. At polar angle 0 all azimuths are one direction, with one value.
    """

    polar_deg: Floats
    azimuth_deg: Floats
    values: Floats
    u: Floats
    shared: Floats
    mirrored: bool


@dataclass(frozen=True, eq=False)
class SpecularCut:
    """Values and standard uncertainties (phi, theta) at one sigma; `known` where interpolated, false where continued.

    The uncertainty of a continued value is at least the value itself, and at least that of the values that it continues.
    """

    values: Floats
    u: Floats
    known: Flags


def grid_of_points(
    polar_deg: Floats, azimuth_deg: Floats, values: Floats, u_values: Floats, u_shared: Floats, *, mirrored: bool = True
) -> PolarGrid:
    """The grid of scattered points (n,), with the mean of the values of one direction; `mirrored`: see `PolarGrid`."""
    rows, i = np.unique(round_deg(polar_deg), return_inverse=True)
    azimuth = fold_azimuth(azimuth_deg) if mirrored else np.mod(round_deg(azimuth_deg), TURN_DEG)
    columns, j = np.unique(round_deg(azimuth), return_inverse=True)
    count, total, variance, shared = (np.zeros((rows.size, columns.size)) for _ in range(4))
    for table, added in ((count, 1.0), (total, values), (variance, u_values**2), (shared, u_shared)):
        np.add.at(table, (i, j), added)
        if rows[0] == 0.0:
            table[0] = table[0].sum()
    with np.errstate(invalid="ignore"):
        means, u, common = total / count, np.sqrt(variance) / count, shared / count
    return PolarGrid(rows, columns, means, np.asarray(u), common, mirrored)


def count_nodes(polar_deg: Floats, azimuth_deg: Floats) -> tuple[int, int]:
    """How many nodes the rings and half planes of directions (n,) have, without the pole, and how many of them have a value.

    The angles are rounded and folded. Of a grid most nodes have one, of directions at random few.
    """
    off_pole = polar_deg > 0.0
    rows, row = np.unique(polar_deg[off_pole], return_inverse=True)
    columns, column = np.unique(azimuth_deg[off_pole], return_inverse=True)
    return rows.size * columns.size, np.unique(row.ravel() * columns.size + column.ravel()).size


def resample(
    grid: PolarGrid,
    sigma_deg: float,
    phi_deg: Floats,
    theta_deg: Floats,
    *,
    back: bool = False,
    widest_gap_deg: float = math.inf,
) -> SpecularCut:
    """Interpolate to the nodes (phi, theta) about the specular direction of sigma.

    Nodes between directions further apart than `widest_gap_deg` are interpolated, and count as not known. Those without values
    around (obstructed, below the horizon, beyond the last polar angle) are continued along theta: linear between other nodes,
    held beyond them; a row without any is the mean of the others, a table without any is 0. For light on the `back`, sigma, phi
    and theta are those of the sample turned about x: azimuths change their sign.
    """
    directions = from_specular(sigma_deg, theta_deg[None, :], phi_deg[:, None])
    polar, azimuth = zenith_and_azimuth(mirror_in_plane_of_incidence(directions) if back else directions)
    if grid.mirrored:
        azimuth = fold_azimuth(azimuth)
    pole = polar < TOLERANCE_DEG  # any azimuth is the same direction there
    azimuth = np.where(pole, grid.azimuth_deg[0], azimuth)
    # Row by row, to bound memory: there are sixteen values to a node.
    rows_found = [interpolate(grid, *row) for row in zip(polar, azimuth, strict=True)]
    values, u = np.array(rows_found).swapaxes(0, 1)
    apart = np.where(pole, 0.0, np.sin(np.radians(polar)) * _gap(grid.azimuth_deg, azimuth))
    between = np.maximum(apart, _gap(grid.polar_deg, polar)) > widest_gap_deg + TOLERANCE_DEG
    cut = continued(theta_deg, values, u)
    return SpecularCut(cut.values, np.where(between, np.maximum(cut.u, np.abs(cut.values)), cut.u), cut.known & ~between)


def continued(theta_deg: Floats, values: Floats, u: Floats) -> SpecularCut:
    """The cut of values (phi, theta), NaN where not known, continued along theta as `resample` states."""
    values, known = values.copy(), np.isfinite(values)
    u = np.where(np.isfinite(u), u, np.abs(values))
    rows = known.any(axis=1)
    for table in (values, u):
        for k in np.flatnonzero(rows):
            table[k, ~known[k]] = np.interp(theta_deg[~known[k]], theta_deg[known[k]], table[k, known[k]])
        table[~rows] = table[rows].mean(axis=0) if rows.any() else 0.0
    return SpecularCut(values, np.where(known, u, np.maximum(u, np.abs(values))), known)


def interpolate(grid: PolarGrid, polar_deg: Floats, azimuth_deg: Floats) -> tuple[Floats, Floats]:
    """Values and standard uncertainties (...) at polar angles and azimuths (...).

    NaN beyond an axis, and where one of the four values around is missing; further neighbours may be missing.
    """
    rows, row_steps, place, beyond = _neighbours(grid.polar_deg, polar_deg)
    azimuths = np.broadcast_to(azimuth_deg, rows.shape).copy()
    if grid.polar_deg[0] == 0.0 and grid.polar_deg.size > 1:
        # The row before the pole is the next one, on the pole's other side.
        first = rows[1] == 0
        rows[0], row_steps[0] = np.where(first, 1, rows[0]), np.where(first, grid.polar_deg[1], row_steps[0])
        across = np.abs(HALF_TURN_DEG - azimuth_deg) if grid.mirrored else wrap_azimuth(azimuth_deg + HALF_TURN_DEG)
        azimuths[0] = np.where(first, across, azimuths[0])
    columns, column_steps, column_place, outside = _neighbours(grid.azimuth_deg, azimuths, grid.mirrored)
    here = np.broadcast_to(rows, columns.shape)
    missing = (here < 0) | (columns < 0) | outside
    values = np.where(missing, np.nan, grid.values[here, columns])
    weights = _weights(values, column_steps, column_place)
    along = _weights(_weighted_sum(weights, values), row_steps, place)
    weights *= along
    result = _weighted_sum(weights.reshape(-1, *polar_deg.shape), values.reshape(-1, *polar_deg.shape))
    # At the pole all columns are one value.
    source = np.where((here == 0) & (grid.polar_deg[0] == 0.0), 0, here * grid.azimuth_deg.size + columns)
    u = _uncertainty(weights, source, np.where(missing, np.nan, grid.u[here, columns]), polar_deg.shape)
    shared = np.where(missing, np.nan, grid.shared[here, columns])
    of_all = _weighted_sum(weights.reshape(-1, *polar_deg.shape), shared.reshape(-1, *polar_deg.shape))
    return np.where(beyond, np.nan, result), np.where(beyond, np.nan, np.hypot(u, of_all))


def _neighbours(axis: Floats, at: Floats, mirrored: bool | None = None) -> tuple[Ints, Floats, Floats, Flags]:
    """The four nodes (4, ...) around each place, -1 where there is none, and the three steps (3, ...) between them.

    Also the position between the second and the third node, 0 to 1, and whether the place is outside the axis. An axis of
    azimuths goes on beyond 0 and 180 if it is `mirrored`, and beyond 0 and 360 if it is not.
    """
    last = axis.size - 1
    index = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, max(last - 1, 0))
    nodes = index + np.arange(-1, 3).reshape(4, *(1,) * index.ndim)
    nodes[nodes > last] = -1
    step = np.diff(axis, prepend=np.nan, append=np.nan)  # step[k] is before node k
    steps = step[np.clip(index + np.arange(3).reshape(3, *(1,) * index.ndim), 0, last + 1)]
    if mirrored is not None and last > 0:
        round_trip = not mirrored and axis[0] == 0.0 and axis[-1] == 360.0
        if round_trip or (mirrored and axis[0] == 0.0):
            nodes[0] = np.where(index == 0, last - 1 if round_trip else 1, nodes[0])
            steps[0] = np.where(index == 0, step[last if round_trip else 1], steps[0])
        if round_trip or (mirrored and axis[-1] == 180.0):
            nodes[3] = np.where(index == last - 1, 1 if round_trip else last - 1, nodes[3])
            steps[2] = np.where(index == last - 1, step[1 if round_trip else last], steps[2])
    with np.errstate(invalid="ignore"):
        place = np.where(last > 0, (at - axis[index]) / steps[1], 0.0)
    place = np.where(place < 1e-6, 0.0, np.where(place > 1.0 - 1e-6, 1.0, place))
    return nodes, steps, place, (at < axis[0] - TOLERANCE_DEG) | (at > axis[-1] + TOLERANCE_DEG)


def _weights(values: Floats, steps: Floats, place: Floats) -> Floats:
    """Derivatives (4, ...) of the monotone cubic between the second and the third of four values (4, ...) by each of them.

    The first and the last value may be NaN; their weight is then 0.
    """
    secants = np.diff(values, axis=0) / steps
    start = _slope_weights(secants[0], secants[1], steps[0], steps[1])
    end = _slope_weights(secants[1], secants[2], steps[1], steps[2])
    rest = 1.0 - place
    at_start, at_end = steps[1] * place * rest**2, -steps[1] * place**2 * rest
    by_secant = (at_start * start[0], at_start * start[1] + at_end * end[0], at_end * end[1])
    first, middle, third = (np.where(by == 0.0, 0.0, by / step) for by, step in zip(by_secant, steps, strict=True))
    left, right = rest**2 * (1.0 + 2.0 * place) + first - middle, place**2 * (3.0 - 2.0 * place) + middle - third
    weights = np.stack([-first, left, right, third])
    for node, at in ((1, place == 0.0), (2, place == 1.0)):  # on a node no other value counts, so it may be missing
        weights = np.where(at, np.eye(4)[node].reshape(4, *(1,) * place.ndim), weights)
    return weights


def _slope_weights(first: Floats, second: Floats, step_first: Floats, step_second: Floats) -> tuple[Floats, Floats]:
    """Derivatives of the slope at a node by the secants before and after it.

    The slope is their weighted harmonic mean (Fritsch, Butland 1984), 0 at an extremum; or the only secant there is.
    """
    no_first, no_second = np.isnan(first), np.isnan(second)
    one, two = np.where(no_first, second, first), np.where(no_second, first, second)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore", under="ignore"):
        share = np.where(no_first | no_second, 0.5, (2.0 * step_second + step_first) / (3.0 * (step_first + step_second)))
        monotone = one * two > 0.0
        by_one = np.where(monotone, share / (share + (1.0 - share) * one / two) ** 2, 0.0)
        by_two = np.where(monotone, (1.0 - share) / (share * two / one + (1.0 - share)) ** 2, 0.0)
    both = by_one + by_two
    return (
        np.where(no_first, 0.0, np.where(no_second, both, by_one)),
        np.where(no_second, 0.0, np.where(no_first, both, by_two)),
    )


def _weighted_sum(weights: Floats, values: Floats) -> Floats:
    """The sum over the first axis; a value without weight may be missing."""
    total: Floats = np.where(weights == 0.0, 0.0, weights * values).sum(axis=0)
    return total


def _uncertainty(weights: Floats, source: Ints, u: Floats, shape: tuple[int, ...]) -> Floats:
    """Standard uncertainty of weighted sums over the first two axes; one `source` may be there twice, beyond a mirror."""
    flat_weights, flat_source, flat_u = (each.reshape(-1, *shape) for each in (weights, source, u))
    variance = np.zeros(shape)
    for weight, here, each in zip(flat_weights, flat_source, flat_u, strict=True):
        total = np.where(flat_source == here, flat_weights, 0.0).sum(axis=0)
        variance += np.where(weight == 0.0, 0.0, weight * total * each**2)
    return np.sqrt(variance)


def _gap(axis: Floats, at: Floats) -> Floats:
    """Distance of the two nodes around a place; 0 where it lies on one of them."""
    _, steps, place, _ = _neighbours(axis, at)
    gap: Floats = np.where((place > 0.0) & (place < 1.0), steps[1], 0.0)
    return gap


def specular_table(
    sigma_deg: Floats,
    phi_deg: Floats,
    theta_deg: Floats,
    cuts: Sequence[Sequence[SpecularCut]],
    wavelengths_nm: tuple[float, ...] | None,
    *,
    transmitted: bool,
    generated: bool,
    comments: Sequence[str],
    done: str,
    psi_deg: Floats | None = None,
    colours: tuple[str, ...] = (),
    back: bool = False,
    sample: str = "",
    fill: Fill = "hold",
) -> BsdfTable:
    """The table of cuts by channel, psi (the faster) and sigma; values in 1/sr.

    Nodes that are not known are filled, see `holes`; comments list them, and the share of the light that is in them. The first
    and the last sigma are repeated to 0 and 90 deg, because readers extrapolate. `done` is "measured" or "simulated". Where
    nothing is known, and all values around are exactly 0, the uncertainty is the largest of the table, or that of a table
    without any: the BSDF of an ideal diffuser. Raises ValueError for holes that are to be refused.
    """
    psi = np.zeros(1) if psi_deg is None else psi_deg
    values, u, known = (
        np.array([[getattr(cut, name) for cut in of_light] for of_light in cuts]) for name in ("values", "u", "known")
    )
    values, u, known = (each.reshape(-1, psi.size, *each.shape[1:]) for each in (values, u, known))
    if fill == "refuse":
        refuse_holes(sigma_deg, phi_deg, theta_deg, values, known)
    values = fill_holes(theta_deg, sigma_deg, values, known, fill)
    channels = colours if wavelengths_nm is None else tuple(f"{wavelength:g} nm" for wavelength in wavelengths_nm)
    shares = unmeasured_share(sigma_deg, phi_deg, theta_deg, values, known)
    about = [
        *comments,
        *share_lines(shares, sigma_deg, channels, psi, done),
        *_continued_nodes(sigma_deg, phi_deg, theta_deg, known, channels, psi, done, fill),
    ]
    table = BsdfTable(
        sigma_deg,
        phi_deg,
        theta_deg,
        values,
        wavelengths_nm,
        psi,
        transmitted=transmitted,
        generated=generated,
        comments=tuple(about),
        u=u,
        known=known,
        colours=colours,
        back=back,
        sample=sample,
    )
    for end in (0.0, 90.0):
        table = repeated(table, "sigma_deg", end)
    assert table.known is not None
    assert table.u is not None
    u = np.where(table.known, table.u, np.maximum(table.u, np.abs(table.values)))
    return replace(table, u=np.where(table.known | (u > 0.0), u, float(u.max()) or 1.0 / np.pi))


def share_lines(shares: Floats, sigma_deg: Floats, channels: Sequence[str], psi_deg: Floats, done: str) -> list[str]:
    """Comments on the share of the light [channel, psi, sigma] that was not measured."""
    return [
        f"{ABOUT_SHARE}{done}: {_light(channels, psi_deg, c, p)}"
        + ", ".join(f"{100.0 * share:.3g} % at sigma {sigma:g}" for sigma, share in zip(sigma_deg, shares[c, p], strict=True))
        for c, p in np.ndindex(*shares.shape[:2])
    ]


def _light(channels: Sequence[str], psi_deg: Floats, channel: int, psi: int) -> str:
    """The channel and psi, for the beginning of a comment, where a table has several."""
    words = [channels[channel]] if len(channels) > 1 else []
    words += [f"psi {psi_deg[psi]:g}"] if psi_deg.size > 1 else []
    return "".join(f"{word}, " for word in words)


def _continued_nodes(
    sigma_deg: Floats,
    phi_deg: Floats,
    theta_deg: Floats,
    known: Flags,
    channels: Sequence[str],
    psi_deg: Floats,
    done: str,
    fill: Fill,
) -> list[str]:
    """Comments on the nodes of (channel, psi, sigma, phi, theta) that are not known; for each channel, if they differ."""
    lines = [
        f"{done} at sigma {', '.join(f'{sigma:g}' for sigma in sigma_deg)} deg only; the first and the last table are repeated "
        "to sigma 0 and 90",
        f"nodes without {done} values around them (blocked by the mirror unit, beyond the last polar angle, below the horizon) "
        "are",
        *ABOUT_FILL[fill],
        "the standard uncertainty of these and of the repeated values is at least the value itself, and at least that of the "
        "values they continue; in degrees:",
    ]
    if bool((known == known[:1]).all()):
        known, channels = known[:1], channels[:1]
    gaps = [
        f"{_light(channels, psi_deg, c, p)}sigma {sigma_deg[s]:g}, phi {phi:g}: theta {theta_deg[start]:g} to "
        f"{theta_deg[stop - 1]:g}"
        for c, p, s in np.ndindex(*known.shape[:3])
        for phi, row in zip(phi_deg, known[c, p, s], strict=True)
        for start, stop in np.flatnonzero(np.diff(~row, prepend=False, append=False)).reshape(-1, 2)
    ]
    more = [f"and {len(gaps) - MAX_LISTED_RANGES} more such ranges"] if len(gaps) > MAX_LISTED_RANGES else []
    return [*lines, *gaps[:MAX_LISTED_RANGES], *more]
