"""Interpolation from the detectors' geocentric grid to specular coordinates (paper, formulas 2 to 4, corrected).

The interpolation is a monotone cubic in azimuth, then in polar angle: it passes through the detectors' values, does not
overshoot, and is far better than a linear one for a lobe that is only a few detectors wide.
"""

import itertools

import numpy as np

from goniotwin.app.simulation.detectors import Detectors
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import from_specular


def interpolate_to_specular(
    detectors: Detectors, values: Floats, sigma_deg: float, phi_deg: Floats, theta_deg: Floats, back: bool = False
) -> tuple[Floats, Flags]:
    """Values (phi, theta) from those of the detectors (n,), and flags (phi, theta) of nodes with detectors all around.

    The other nodes (obstructed, below the horizon, beyond the last polar angle) are continued along theta: linear between
    known nodes, held beyond them; a row without known nodes is the mean of the others, a table without any is 0.
    For light on the `back`, sigma, phi and theta are those of the sample turned about x: azimuths change their sign.
    """
    directions = from_specular(sigma_deg, theta_deg[None, :], phi_deg[:, None])
    polar = np.degrees(np.arctan2(np.hypot(directions[..., 0], directions[..., 1]), directions[..., 2]))
    azimuth = np.degrees(np.arctan2(-directions[..., 1] if back else directions[..., 1], directions[..., 0])) % 360.0
    if detectors.mirrored:
        azimuth = np.minimum(azimuth, 360.0 - azimuth)
    table = values.reshape(detectors.polar_deg.size, detectors.azimuth_deg.size)
    result = interpolate_cubic(detectors.polar_deg, detectors.azimuth_deg, table, polar, azimuth)
    known = np.isfinite(result)
    rows = known.any(axis=1)
    for k in np.flatnonzero(rows):
        here = known[k]
        result[k, ~here] = np.interp(theta_deg[~here], theta_deg[here], result[k, here])
    result[~rows] = result[rows].mean(axis=0) if rows.any() else 0.0
    return result, known


def interpolate_cubic(polar_axis: Floats, azimuth_axis: Floats, table: Floats, polar: Floats, azimuth: Floats) -> Floats:
    """Values (...) at polar and azimuth (...) from a table (p, a); NaN beyond an axis and where a corner is missing."""
    i, u, outside_i = _locate(polar_axis, polar)
    slopes = _slopes(azimuth_axis, table)
    rows = [np.clip(i + k, 0, polar_axis.size - 1) for k in (-1, 0, 1, 2)]
    before, left, right, after = (_in_azimuth(azimuth_axis, table, slopes, row, azimuth) for row in rows)
    angles = [polar_axis[row] for row in rows]
    if polar_axis[0] == 0.0:
        # The node before the pole is on its other side.
        beyond = np.abs(180.0 - azimuth) if azimuth_axis[-1] <= 180.0 else (azimuth + 180.0) % 360.0
        across = _in_azimuth(azimuth_axis, table, slopes, np.ones_like(i), beyond)
        before = np.where(i == 0, across, before)
        angles[0] = np.where(i == 0, -polar_axis[1], angles[0])
    steps = [next_one - one for one, next_one in itertools.pairwise(angles)]
    with np.errstate(invalid="ignore", divide="ignore"):
        first, middle, third = (left - before) / steps[0], (right - left) / steps[1], (after - right) / steps[2]
    start, end = _limited(first, middle, steps[0], steps[1]), _limited(middle, third, steps[1], steps[2])
    curved = _hermite(left, right, steps[1] * start, steps[1] * end, u)
    result = np.where(u == 0.0, left, np.where(u == 1.0, right, curved))
    missing: Floats = np.where(outside_i, np.nan, result)
    return missing


def _in_azimuth(axis: Floats, table: Floats, slopes: Floats, row: Ints, azimuth: Floats) -> Floats:
    """Values (...) of rows (...) of the table at azimuth (...)."""
    j, v, outside = _locate(axis, azimuth)
    width = axis[j + 1] - axis[j]
    left, right = table[row, j], table[row, j + 1]
    curved = _hermite(left, right, width * slopes[row, j], width * slopes[row, j + 1], v)
    # On a node the neighbour is not used, so it may be missing.
    value = np.where(v == 0.0, left, np.where(v == 1.0, right, curved))
    return np.where(outside, np.nan, value)


def _locate(axis: Floats, values: Floats) -> tuple[Ints, Floats, Flags]:
    """Index of the interval of each value, its fraction within the interval, and whether it is outside the axis."""
    index = np.clip(np.searchsorted(axis, values, side="right") - 1, 0, axis.size - 2)
    fraction = (values - axis[index]) / (axis[index + 1] - axis[index])
    outside = (fraction < -1e-6) | (fraction > 1.0 + 1e-6)
    fraction = np.where(fraction < 1e-6, 0.0, np.where(fraction > 1.0 - 1e-6, 1.0, fraction))
    return index, fraction, outside


def _slopes(axis: Floats, table: Floats) -> Floats:
    """Slopes (p, a) in azimuth at the nodes; beyond its ends the list is mirrored, or periodic."""
    step = np.diff(axis)
    secant = np.diff(table, axis=1) / step
    if axis[0] == 0.0 and axis[-1] == 180.0:
        ends = -secant[:, :1], step[:1], -secant[:, -1:], step[-1:]
    elif axis[0] == 0.0 and axis[-1] == 360.0:
        ends = secant[:, -1:], step[-1:], secant[:, :1], step[:1]
    else:
        edge = np.full((table.shape[0], 1), np.nan)
        ends = edge, step[:1], edge, step[-1:]
    first, second = np.hstack([ends[0], secant]), np.hstack([secant, ends[2]])
    return _limited(first, second, np.concatenate([ends[1], step]), np.concatenate([step, ends[3]]))


def _limited(first: Floats, second: Floats, step_first: Floats, step_second: Floats) -> Floats:
    """Slope between two secants: their harmonic mean (Fritsch, Butland 1984), 0 at an extremum; or the only secant."""
    one = np.where(np.isfinite(first), first, second)
    two = np.where(np.isfinite(second), second, first)
    near, far = 2.0 * step_second + step_first, step_second + 2.0 * step_first
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        mean = (near + far) / (near / one + far / two)
    slope: Floats = np.where(one * two > 0.0, mean, 0.0)
    return slope


def _hermite(left: Floats, right: Floats, start: Floats, end: Floats, fraction: Floats) -> Floats:
    rest = 1.0 - fraction
    ends = rest**2 * (1.0 + 2.0 * fraction) * left + fraction**2 * (3.0 - 2.0 * fraction) * right
    value: Floats = ends + fraction * rest * (rest * start - fraction * end)
    return value
