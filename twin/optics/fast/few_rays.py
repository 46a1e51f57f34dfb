"""The mirrors' shadow by numpy: for some hundred directions, which take less time than loading numba for its kernel.

Of the nominal instrument, where detectors look at the middle of the sample.
"""

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.bundle import aperture_sizes, ray_bundle
from goniotwin.twin.optics.geometry.instrument import Instrument
from goniotwin.twin.optics.geometry.nominal import nominal_scene

FEW_RAYS = 300_000
"""Number of rays that numpy follows in less time than it takes to load numba."""


def visible_fraction_of_few(
    instrument: Instrument, sigma_deg: float, directions: npt.ArrayLike, rays: int, gamma_deg: float
) -> Floats:
    """`visible_fraction` of some hundred directions.

    From FEW_RAYS rays on, and for an instrument with deviations or a sensor, it is `visible_fraction` itself. Equal up to
    rounding. Raises ValueError as that does.
    """
    if rays * np.size(directions) > 3 * FEW_RAYS or instrument.deviations or instrument.sensor is not None:
        # Loads 343 modules, numba and importlib.metadata among them: 0.2 s, which `check` does without.
        from goniotwin.twin.optics.fast.obstruction import visible_fraction

        return visible_fraction(instrument, sigma_deg, directions, rays, gamma_deg)
    mirrors, axes = nominal_scene(instrument, sigma_deg, gamma_deg, directions)
    return _visible_shares(instrument, mirrors, axes, rays)


def _visible_shares(instrument: Instrument, mirrors: Floats, axes: Floats, rays: int) -> Floats:
    """Shares (n,) as those of `fast.obstruction.visible_shares`, of detectors that look along -`axes` (n, 3), all at once."""
    radius, hole, sine = aperture_sizes(instrument).tolist()
    half, distance = 0.5 * instrument.blocking_side_mm, instrument.arc_radius_mm
    bundle = ray_bundle(rays, sine)
    dx, dy, dz = axes.T[..., None]
    level = np.hypot(dx, dy)
    with np.errstate(invalid="ignore"):
        cos, sin = np.where(level > 0.0, dx / level, 1.0), np.where(level > 0.0, dy / level, 0.0)
    e1x, e1y, e1z, e2x, e2y = dz * cos, dz * sin, -level, -sin, cos  # away from the normal, and level
    total, free = np.zeros(len(axes)), np.zeros(len(axes))
    for sign in (1.0, -1.0):
        along, (hole_u, hole_v), (p, q) = bundle[0], sign * bundle[1:3], sign * bundle[5:]
        with np.errstate(divide="ignore", invalid="ignore"):  # a detector in the sample's plane
            # A point (u, v) of the hole meets the detector's plane at (au u + av v + a0, bu u + bv v + b0).
            a0, au, av = distance * p, e1x - p * dx, e1y - p * dy
            b0, bu, bv = distance * q, e2x - q * dx, e2y - q * dy
            square, area = au * au + bu * bu, au * bv - av * bu
            middle, reach = (bu * a0 - au * b0) / area, radius * np.sqrt(square) / np.abs(area)
            low, high = np.fmax(middle - reach, -hole), np.fmin(middle + reach, hole)
            v, share_v = 0.5 * (low + high + (high - low) * hole_v), high - low
            a1, b1 = a0 + av * v, b0 + bv * v
            inside = np.fmax(radius * radius * square - (a1 * bu - b1 * au) ** 2, 0.0)
            middle, reach = -(a1 * au + b1 * bu) / square, np.sqrt(inside) / square
            low, high = np.fmax(middle - reach, -hole), np.fmin(middle + reach, hole)
            u, share_u = 0.5 * (low + high + (high - low) * hole_u), high - low
            w = np.stack([along * (dx + p * e1x + q * e2x), along * (dy + p * e1y + q * e2y), along * (dz + p * e1z)])
            weight = np.where((share_v > 0.0) & (w[2] * dz > 0.0) & (share_u > 0.0), np.abs(area) * share_v * share_u, 0.0)
            length = (distance - u * dx - v * dy) * along * (1.0 + p * p + q * q)
            hidden = [_is_blocked(mirror, half, np.stack([u, v, np.zeros_like(u)]), w, length) for mirror in mirrors]
        total += weight.sum(axis=1)
        free += np.where(np.any(hidden, axis=0), 0.0, weight).sum(axis=1)
    return np.divide(free, total, out=np.zeros(len(total)), where=total > 0.0)


def _is_blocked(mirror: Floats, half: float, start: Floats, w: Floats, length: Floats) -> npt.NDArray[np.bool_]:
    """Whether rays from `start` along unit vectors `w` (3, n, rays) meet a square of half side `half` before their end."""
    centre, normal, along, across = mirror
    ahead = centre[:, None, None] - start
    distance = np.tensordot(normal, ahead, 1) / np.tensordot(normal, w, 1)
    place = distance * w - ahead
    inside = (np.abs(np.tensordot(along, place, 1)) <= half) & (np.abs(np.tensordot(across, place, 1)) <= half)
    return np.asarray((distance > 0.0) & (distance < length) & inside)
