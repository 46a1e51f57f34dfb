"""Obstruction: directions that the mirrors hide from a detector.

The mirror unit is between sample and arc. Mirror 3 hides a zone about the retro-direction, which at sigma = 0 is the
specular direction; mirror 2 hides a zone 45 deg from it (optics.md, section 3). This is a property of the instrument:
campaigns are planned around it. The hidden directions are known before a campaign as a map over the arc's angles.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.aperture import place_detectors
from goniotwin.twin.optics.fast.bundle import aperture_sizes, ray_bundle
from goniotwin.twin.optics.fast.detector_block import (
    AWAY,
    LANES,
    LEVEL,
    Block,
    empty_block,
)
from goniotwin.twin.optics.fast.ray_bundle import fill_ends, hide_ends
from goniotwin.twin.optics.geometry.coordinates import arc_direction
from goniotwin.twin.optics.geometry.instrument import Instrument
from goniotwin.twin.optics.geometry.scene import scene_at
from goniotwin.twin.optics.kernel import kernel

FREE, PARTLY, HIDDEN = 0, 1, 2


@kernel()
def mirrors_near(block: Block, k: int, mirrors: Floats, half: float, sizes: Floats, near: Floats) -> bool:
    """Set near[m] to 1 where mirror m may hide some of the bundle of detector k, and else to 0; whether any does.

    It may if it reaches into the tube about the line from the sample's centre to the detector's, as wide as hole and disc. A
    sphere about the mirror takes its place: for most detectors no ray has to be traced.
    """
    width, position, some = max(sizes[0], math.sqrt(2.0) * sizes[1]), block.position, False
    for m in range(3):
        along, square, length = 0.0, 0.0, 0.0
        for c in range(3):
            along += mirrors[m, 0, c] * position[c, k]
            square += mirrors[m, 0, c] * mirrors[m, 0, c]
            length += position[c, k] * position[c, k]
        foot = min(1.0, max(0.0, along / length))
        hides = square - 2.0 * foot * along + foot * foot * length < (width + math.sqrt(2.0) * half) ** 2
        near[m], some = 1.0 if hides else 0.0, some or hides
    return some


@kernel()
def find_shadow(block: Block, k: int, mirrors: Floats, near: Floats, half: float, sizes: Floats) -> int:
    """FREE, HIDDEN, or PARTLY where the near mirrors block some of the rays of detector k, or where that is uncertain.

    Hole and disc are convex, so the section of the rays in a mirror's plane is the hull of the lines between the hole's corners
    and those of a square about the disc. With all lines within the mirror the detector is hidden; with all of them beyond one
    side it is free.
    """
    away, level, centre = block.axes[AWAY, :, k], block.axes[LEVEL, :, k], block.position[:, k]
    result = FREE
    for m in range(3):
        if near[m] == 0.0:
            continue
        low_u, high_u, low_v, high_v = math.inf, -math.inf, math.inf, -math.inf
        first, last = math.inf, -math.inf
        for corner in range(16):
            px, py = (1.0 if corner & 1 else -1.0) * sizes[1], (1.0 if corner & 2 else -1.0) * sizes[1]
            s, t = (1.0 if corner & 4 else -1.0) * sizes[0], (1.0 if corner & 8 else -1.0) * sizes[0]
            wx = centre[0] + s * away[0] + t * level[0] - px
            wy = centre[1] + s * away[1] + t * level[1] - py
            wz = centre[2] + s * away[2]
            cx, cy, cz = mirrors[m, 0, 0] - px, mirrors[m, 0, 1] - py, mirrors[m, 0, 2]
            slope = wx * mirrors[m, 1, 0] + wy * mirrors[m, 1, 1] + wz * mirrors[m, 1, 2]
            share = (cx * mirrors[m, 1, 0] + cy * mirrors[m, 1, 1] + cz * mirrors[m, 1, 2]) / slope
            first, last = min(first, share), max(last, share)
            x, y, z = share * wx - cx, share * wy - cy, share * wz - cz
            u = x * mirrors[m, 2, 0] + y * mirrors[m, 2, 1] + z * mirrors[m, 2, 2]
            v = x * mirrors[m, 3, 0] + y * mirrors[m, 3, 1] + z * mirrors[m, 3, 2]
            low_u, high_u, low_v, high_v = min(low_u, u), max(high_u, u), min(low_v, v), max(high_v, v)
        if first > 0.0 and last < 1.0:  # every line meets the plane between sample and detector
            if high_u < half and low_u > -half and high_v < half and low_v > -half:
                return HIDDEN
            if low_u > half or high_u < -half or low_v > half or high_v < -half:
                continue
        elif last < 0.0 or first > 1.0:
            continue
        result = PARTLY
    return result


@kernel(nogil=True)
def visible_shares(
    block: Block, centres: Floats, directions: Floats, bundle: Floats, quarter: int, sizes: Floats, mirrors: Floats, half: float
) -> Floats:
    """Share (n,) of rays that no mirror blocks, for detectors at `centres` that look along -`directions`.

    Of the first `quarter` rays of a bundle and those that come with them.
    """
    result, near, edges = np.zeros(directions.shape[0]), np.zeros(3), np.empty((0, 3, 3))
    for n in range(result.size):
        k, total, free = n % LANES, 0.0, 0.0
        if k == 0:
            last = min(n + LANES, result.size)
            place_detectors(block, centres[n:last], directions[n:last])
        mirrors_near(block, k, mirrors, half, sizes, near)
        for first in range(0, quarter, LANES):
            count = min(LANES, quarter - first)
            for sign in (1.0, -1.0):
                fill_ends(block, k, bundle, first, count, sign, sizes, -sizes[1], sizes[1], edges, 1.0)
                for i in range(count):
                    total += block.end_weight[i]
                hide_ends(block, mirrors, near, half, count)
                for i in range(count):
                    free += block.end_weight[i]
        result[n] = free / total if total > 0.0 else 0.0
    return result


def visible_fraction(
    instrument: Instrument, sigma_deg: float, directions: npt.ArrayLike, rays: int = 256, gamma_deg: float = 0.0
) -> Floats:
    """Share (n,) of each detector's rays from the illuminated spot that no mirror blocks, for `directions` (n, 3).

    Independent of the instrument's `obstruction`. 0 for a detector in the sample's plane, which receives nothing. From `rays`
    deterministic rays per detector; for a sensor that is not a simple detector, from all rays that could pass. Raises
    ValueError for a wrong shape or a vector of length zero.
    """
    scene = scene_at(instrument, sigma_deg, gamma_deg)
    if instrument.sensor is not None:
        instrument = replace(instrument, sensor=None, field_deg=instrument.sensor.widest_deg)
    centres, axes = scene.detectors(instrument, directions)
    sizes, half = aperture_sizes(instrument), 0.5 * instrument.blocking_side_mm
    bundle = ray_bundle(rays, float(sizes[2]))
    return np.asarray(visible_shares(empty_block(), centres, axes, bundle, rays // 4, sizes, scene.mirrors, half))


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """Share `visible` (polar, azimuth) of a detector's rays that no mirror blocks, over angles in deg.

    `obstruction` is the instrument's: without it the estimators ignore the shadow.
    """

    sigma_deg: float
    polar_deg: Floats
    azimuth_deg: Floats
    visible: Floats
    lower: bool
    obstruction: bool


def shadow_map(
    instrument: Instrument, sigma_deg: float, step_deg: float = 1.0, *, lower: bool = False, gamma_deg: float = 0.0
) -> ShadowMap:
    """Shadow of the mirrors, for polar angles of 0 to 90 deg and azimuths of 0 to 360 deg in steps of `step_deg`.

    For the upper or the lower arc. Raises ValueError for a step that does not divide 90 deg or is below 0.1 deg, the least of
    every axis.
    """
    count = round(90.0 / step_deg) if step_deg >= 0.1 else 0
    if count == 0 or abs(count * step_deg - 90.0) > 1e-9:
        raise ValueError(f"step_deg is {step_deg!r}: give one that divides 90 deg, at least 0.1")
    polar, azimuth = np.linspace(0.0, 90.0, count + 1), np.linspace(0.0, 360.0, 4 * count + 1)
    directions = arc_direction(polar[:, None], azimuth[None, :-1], lower)
    visible = visible_fraction(instrument, sigma_deg, directions.reshape(-1, 3), gamma_deg=gamma_deg)
    turn = visible.reshape(directions.shape[:2])
    whole = np.concatenate([turn, turn[:, :1]], axis=1)  # 360 deg is 0 deg
    return ShadowMap(sigma_deg, polar, azimuth, whole, lower, instrument.obstruction)
