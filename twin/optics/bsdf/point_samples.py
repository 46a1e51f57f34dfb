"""Samples given by values at scattered directions, as from an adaptive measurement: resampled to a regular table.

The table's theta are those of the points (their quantiles if there are more than THETA_LIST), with steps of at most 5 deg
between; its phi are 5 deg apart. The value at each of these nodes is that of a plane through the points around it: the nearest
point in each of eight sectors around the node, within twice the stated gap, with the weight distance^-4. The plane's value is
limited to the range of these points' values. So the resampling reproduces a point at a node, follows a slope, has no overshoot,
and misses structure between points. A node above the horizon that is farther than the gap from every point is a hole, and an
error. Nodes below the horizon have the value at the horizon above them.
"""

import math
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.bsdf.analytic_samples import Side
from goniotwin.twin.optics.bsdf.scatterer import Scatterer
from goniotwin.twin.optics.bsdf.table_samples import Symmetry, table_sample
from goniotwin.twin.optics.geometry.coordinates import (
    arc_direction,
    from_specular,
    mirror_in_plane_of_incidence,
    round_deg,
    to_specular,
)
from goniotwin.twin.optics.kernel import kernel

THETA_LIST = 150
STEP_DEG = 5.0
SECTORS = 8


def scattered_points(
    sigma_deg: npt.ArrayLike,
    theta_deg: npt.ArrayLike,
    phi_deg: npt.ArrayLike,
    values: npt.ArrayLike,
    name: str = "scattered points",
    psi_deg: npt.ArrayLike | None = None,
    symmetry: Symmetry = "none",
    spherical: bool = False,
    mirrored: bool = False,
    gap_deg: float = 10.0,
    side: Side = "front",
    transmits: bool = False,
) -> Scatterer:
    """Sample given by values (n,) in 1/sr at n points, angles in deg, in any order; see the module for the resampling.

    theta and phi are specular coordinates or, with `spherical`, the zenith angle (0 to 90) and the azimuth about the normal,
    with the light at azimuth psi, or 0. The incidences sigma (and psi, for an anisotropic sample) are a regular grid: each pair
    of occurring values has its own points. `mirrored` uses each point on both sides of the plane of incidence. Over sigma and
    psi the interpolation is that of `table_sample`; `symmetry`, `side` and `transmits` have the same meaning there. Coordinates
    are canonical.

    Raises ValueError, naming the argument and the place, for lists of different lengths, angles out of range, values that are
    negative, infinite or missing, two points in one direction, an incidence without points, and a hole.
    """
    lists = {"sigma_deg": sigma_deg, "theta_deg": theta_deg, "phi_deg": phi_deg, "values": values}
    if psi_deg is not None:
        lists["psi_deg"] = psi_deg
    points = _points(lists, 90.0 if spherical else 180.0)
    if not (math.isfinite(gap_deg) and 0.0 < gap_deg <= 90.0):
        raise ValueError(f"gap_deg is {gap_deg!r}: give an angle above 0, at most 90 deg")
    sigma, psi = round_deg(points["sigma_deg"]), round_deg(points.get("psi_deg", np.zeros(1)))
    psi = np.broadcast_to(psi, sigma.shape)
    if spherical:
        directions = arc_direction(points["theta_deg"], points["phi_deg"] - psi)
    else:
        directions = from_specular(sigma, points["theta_deg"], points["phi_deg"])
    theta = theta_list(to_specular(sigma, directions)[0], 90.0 + float(sigma.max()))
    phi = np.arange(0.0, (180.0 if mirrored else 360.0) + 0.5 * STEP_DEG, STEP_DEG)
    sigmas, psis = np.unique(sigma), np.unique(psi)
    table = np.empty((psis.size, sigmas.size, phi.size, theta.size))
    for n, m in np.ndindex(psis.size, sigmas.size):
        place = f"sigma {sigmas[m]:g}" + (f", psi {psis[n]:g}" if psi_deg is not None else "")
        members = np.flatnonzero((psi == psis[n]) & (sigma == sigmas[m]))
        if not members.size:
            raise ValueError(f"there is no point at {place}, although both angles occur: measure it, or leave one of them out")
        _refuse_duplicates(members, directions[members], place)
        known, value = directions[members], points["values"][members]
        if mirrored:
            off = np.abs(known[:, 1]) > 1e-9
            known, value = (
                np.concatenate([known, mirror_in_plane_of_incidence(known[off])]),
                np.concatenate([value, value[off]]),
            )
        nodes = from_specular(sigmas[m], theta, phi[:, None])
        resampled = plane_through_points(_raise_to_horizon(nodes.reshape(-1, 3)), known, value, math.radians(2.0 * gap_deg))
        distance = np.where(nodes[..., 2] > 0.0, np.degrees(resampled[:, 1]).reshape(nodes.shape[:-1]), 0.0)
        if distance.max() > gap_deg:
            j, k = np.unravel_index(int(np.argmax(distance)), distance.shape)
            hole = f"values has a hole at {place}, theta {theta[k]:g}, phi {phi[j]:g}"
            raise ValueError(f"{hole}: no point within {gap_deg:g} deg of it; measure there, or allow a larger gap_deg")
        table[n, m] = resampled[:, 0].reshape(nodes.shape[:-1])
    blocks, turns = (table[0], None) if psi_deg is None else (table, psis)
    return table_sample(sigmas, phi, theta, blocks, name, turns, symmetry, side, transmits)


def _points(lists: dict[str, npt.ArrayLike], last_theta_deg: float) -> dict[str, Floats]:
    points = {name: np.array(values, dtype=np.float64) for name, values in lists.items()}
    shape = points["values"].shape
    if len(shape) != 1 or shape[0] == 0:
        raise ValueError(f"values has the shape {shape}: give a list, one value per point")
    limits = {
        "sigma_deg": (0.0, 90.0),
        "theta_deg": (0.0, last_theta_deg),
        "phi_deg": (-360.0, 360.0),
        "psi_deg": (0.0, 360.0),
        "values": (0.0, math.inf),
    }
    for name, values in points.items():
        if values.shape != shape:
            raise ValueError(f"{name} has the shape {values.shape}, and values {shape}: give one of each per point")
        low, high = limits[name]
        wrong = np.flatnonzero(~(np.isfinite(values) & (values >= low) & (values <= high)))
        if wrong.size:
            remedy = "leave the point out: values are 1/sr, >= 0" if name == "values" else f"keep it in {low:g} to {high:g}"
            raise ValueError(f"{name}[{wrong[0]}] is {values[wrong[0]]}: {remedy}")
    return points


def _refuse_duplicates(indices: Ints, directions: Floats, place: str) -> None:
    _, first, which = np.unique(np.round(directions, 7) + 0.0, axis=0, return_index=True, return_inverse=True)
    repeated = np.flatnonzero(first[which.ravel()] != np.arange(indices.size))
    if repeated.size:
        pair = f"{indices[first[which.ravel()[repeated[0]]]]} and {indices[repeated[0]]}"
        raise ValueError(f"points {pair}, at {place}, have the same direction: give their mean once")


def theta_list(theta_deg: Floats, last_deg: float) -> Floats:
    """Angles for the resampling: those of the points, or their quantiles, and enough between and beyond."""
    own = np.unique(np.round(theta_deg, 2))
    if own.size > THETA_LIST:
        own = np.unique(np.round(np.quantile(theta_deg, np.linspace(0.0, 1.0, THETA_LIST)), 2))
    ends = np.unique(np.concatenate([[0.0], own, [last_deg]]))
    pieces = [np.linspace(a, b, math.ceil((b - a) / STEP_DEG) + 1)[:-1] for a, b in pairwise(ends.tolist())]
    return np.concatenate([*pieces, ends[-1:]])


def _raise_to_horizon(nodes: Floats) -> Floats:
    """The nodes, with those below the horizon moved up to it."""
    raised = nodes.copy()
    raised[:, 2] = np.maximum(nodes[:, 2], 0.0)
    length = np.sqrt(np.sum(raised**2, axis=1))[:, None]
    # Straight down has no horizon above it; any point of the horizon is right.
    return np.where(length > 1e-12, raised / np.maximum(length, 1e-12), [-1.0, 0.0, 0.0])


@kernel()
def _plane(x: Floats, y: Floats, values: Floats, count: int) -> float:
    """Value at the origin of the weighted plane through points (x, y), limited to the range of the values."""
    w0, wx, wy, wv = 0.0, 0.0, 0.0, 0.0
    low, high = math.inf, -math.inf
    for i in range(count):
        weight = 1.0 / (x[i] * x[i] + y[i] * y[i]) ** 2
        w0, wx, wy, wv = w0 + weight, wx + weight * x[i], wy + weight * y[i], wv + weight * values[i]
        low, high = min(low, values[i]), max(high, values[i])
    mx, my, mv = wx / w0, wy / w0, wv / w0
    xx, xy, yy, xv, yv = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        a, b, c = x[i] - mx, y[i] - my, values[i] - mv
        weight = 1.0 / (x[i] * x[i] + y[i] * y[i]) ** 2 / w0
        xx, xy, yy, xv, yv = (
            xx + weight * a * a,
            xy + weight * a * b,
            yy + weight * b * b,
            xv + weight * a * c,
            yv + weight * b * c,
        )
    # Points on one line do not determine the slope across it: this term makes it zero.
    trace = xx + yy
    if trace <= 0.0:
        return mv
    xx, yy = xx + 1e-7 * trace, yy + 1e-7 * trace
    determinant = xx * yy - xy * xy
    slope_x, slope_y = (yy * xv - xy * yv) / determinant, (xx * yv - xy * xv) / determinant
    return min(high, max(low, mv - slope_x * mx - slope_y * my))


@kernel()
def plane_through_points(nodes: Floats, points: Floats, values: Floats, reach: float) -> Floats:
    """Value at each node (m, 3), and the angle in rad to the nearest of the points (n, 3)."""
    result = np.empty((nodes.shape[0], 2))
    best, x, y, v = np.empty(SECTORS), np.empty(SECTORS), np.empty(SECTORS), np.empty(SECTORS)
    for k in range(nodes.shape[0]):
        qx, qy, qz = nodes[k, 0], nodes[k, 1], nodes[k, 2]
        # Two axes across the node's direction; the first lies in the coordinate plane farther from it.
        if abs(qz) < 0.9:
            ax, ay, az = -qy, qx, 0.0
        else:
            ax, ay, az = 0.0, -qz, qy
        shrink = 1.0 / math.sqrt(ax * ax + ay * ay + az * az)
        ax, ay, az = ax * shrink, ay * shrink, az * shrink
        bx, by, bz = qy * az - qz * ay, qz * ax - qx * az, qx * ay - qy * ax
        best[:] = math.inf
        nearest, nearest_value = math.inf, 0.0
        for i in range(points.shape[0]):
            a = ax * points[i, 0] + ay * points[i, 1] + az * points[i, 2]
            b = bx * points[i, 0] + by * points[i, 1] + bz * points[i, 2]
            c = qx * points[i, 0] + qy * points[i, 1] + qz * points[i, 2]
            # Increases with the angle, and keeps its digits near the node.
            farness = a * a + b * b if c > 0.0 else 2.0 - a * a - b * b
            if farness < nearest:
                nearest, nearest_value = farness, values[i]
            sector = (1 if a > 0.0 else 0) + (2 if b > 0.0 else 0) + (4 if abs(a) > abs(b) else 0)
            if farness < best[sector]:
                best[sector], x[sector], y[sector], v[sector] = farness, a, b, values[i]
        result[k, 0], result[k, 1] = nearest_value, _angle(nearest)
        if 1e-7 < result[k, 1] <= reach:
            # The plane's coordinates are angles along the node's two axes.
            count = 0
            for sector in range(SECTORS):
                if best[sector] < math.inf and _angle(best[sector]) <= reach:
                    stretch = _angle(best[sector]) / math.sqrt(x[sector] ** 2 + y[sector] ** 2)
                    x[count], y[count], v[count] = stretch * x[sector], stretch * y[sector], v[sector]
                    count += 1
            result[k, 0] = _plane(x, y, v, count)
    return result


@kernel()
def _angle(farness: float) -> float:
    """Angle in rad from its squared sine s up to 90 deg, and from 2 - s beyond."""
    if farness <= 1.0:
        return math.asin(math.sqrt(farness))
    return math.pi - math.asin(math.sqrt(max(0.0, 2.0 - farness)))
