"""Light after its first scattering: mirrors, frames and the sample again, until it leaves or is absorbed.

Few paths get here, so each is traced separately and in double precision. Mirrors reflect on their front and absorb on their
back; their mounts absorb. Frames keep a share of the paths equal to their reflectance, with unchanged weight. The sample
scatters by its lobes. After three interactions a path survives with a probability equal to the sample's factor, and keeps its
weight (Russian roulette).
"""

import math
from typing import NamedTuple

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.packed_lobes import Lobes, scatter_at_sample
from goniotwin.twin.optics.forward.scoring import Targets, score_segment
from goniotwin.twin.optics.forward.spread import Spread, spread_segment
from goniotwin.twin.optics.geometry.mirrors import distance_to
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.montecarlo import uniform

UPPER, SHEET, LOWER, NOTHING = range(3, 7)
"""Surfaces in addition to the mirrors 0 to 2."""
ROULETTE = 3
"""Number of interactions after which paths are ended at random."""
NUMBERS = 8
"""Random numbers of a path for each interaction."""
# A surface nearer than this, in mm, is the one that the ray has just left.
NEAR = 1e-6


class Surfaces(NamedTuple):
    """Surfaces that light can meet, in the sample's frame, mm.

    `mirrors` (3, 4, 3), their half side, and that with the mount; scattered light meets mirrors with `obstruction` only.
    `reflectance` (91,) of the mirrors at incidences of 0 to 90 deg; half sides of hole and frames, the gap and the frames'
    reflectance; at most `most` interactions of a path.
    """

    mirrors: Floats
    mirror_half: float
    blocking_half: float
    obstruction: bool
    reflectance: Floats
    hole_half: float
    frame_half: float
    gap: float
    frame_reflectance: float
    most: int


@kernel()
def next_surface(surfaces: Surfaces, px: float, py: float, pz: float, dx: float, dy: float, dz: float) -> tuple[int, float]:
    """First surface on a ray, and its distance."""
    surface, nearest = NOTHING, math.inf
    if surfaces.obstruction:
        for m in range(3):
            distance = distance_to(surfaces.mirrors, m, surfaces.blocking_half, px, py, pz, dx, dy, dz)
            if NEAR < distance < nearest:
                surface, nearest = m, distance
    # Without a gap all three are in one plane, and the light meets the frame on its own side first.
    for turn in range(3):
        sheet = turn if dz < 0.0 else 2 - turn
        distance = (surfaces.gap * (1 - sheet) - pz) / dz
        if not NEAR < distance < nearest:
            continue
        out = max(abs(px + distance * dx), abs(py + distance * dy))
        if out <= surfaces.frame_half and (sheet == 1 or out > surfaces.hole_half):
            surface, nearest = UPPER + sheet, distance
    return surface, nearest


@kernel()
def is_on_mount(surfaces: Surfaces, m: int, px: float, py: float, pz: float) -> bool:
    """Whether a point in the plane of mirror m is beyond the mirror's edges."""
    x, y, z = px - surfaces.mirrors[m, 0, 0], py - surfaces.mirrors[m, 0, 1], pz - surfaces.mirrors[m, 0, 2]
    u = x * surfaces.mirrors[m, 2, 0] + y * surfaces.mirrors[m, 2, 1] + z * surfaces.mirrors[m, 2, 2]
    v = x * surfaces.mirrors[m, 3, 0] + y * surfaces.mirrors[m, 3, 1] + z * surfaces.mirrors[m, 3, 2]
    return bool(max(abs(u), abs(v)) > surfaces.mirror_half)


@kernel()
def cosine_direction(up: bool, u: float, v: float) -> tuple[float, float, float]:
    """Direction by Lambert's law, above or below."""
    radius, turn, height = math.sqrt(u), 2.0 * math.pi * v, math.sqrt(1.0 - u)
    return radius * math.cos(turn), radius * math.sin(turn), height if up else -height


@kernel()
def interpolate_degrees(table: Floats, cosine: float) -> float:
    """Linear interpolation in a table over whole degrees of incidence, 0 to 90."""
    degrees = math.degrees(math.acos(min(1.0, cosine)))
    i = min(int(degrees), table.size - 2)
    return table[i] + (degrees - i) * (table[i + 1] - table[i])  # type: ignore[no-any-return]


@kernel()
def trace_bounces(
    surfaces: Surfaces,
    lobes: Lobes,
    targets: Targets,
    spread: Spread,
    key: np.uint64,
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    weight: float,
    sums: Floats,
) -> None:
    """Trace a path from p along d after its first scattering; what it meets there is already scored (`score`)."""
    interactions, mirrored = 1, False
    while True:
        surface, nearest = next_surface(surfaces, px, py, pz, dx, dy, dz)
        if interactions > 1:
            score_segment(targets, px, py, pz, dx, dy, dz, nearest, weight, sums)
            # The map does not include the mirrors: obstruction is applied where the map is used, and light that returns over
            # the mirrors to the lamp is as narrow as the beam.
            if spread.wanted and not mirrored:
                spread_segment(spread, px, py, pz, dx, dy, dz, surface >= UPPER and surface != NOTHING, weight, sums)
        if surface == NOTHING or interactions >= surfaces.most:
            return
        px, py, pz = px + nearest * dx, py + nearest * dy, pz + nearest * dz
        counter, mirrored = NUMBERS * interactions, surface < UPPER
        if mirrored:
            nx, ny, nz = surfaces.mirrors[surface, 1, 0], surfaces.mirrors[surface, 1, 1], surfaces.mirrors[surface, 1, 2]
            along = dx * nx + dy * ny + dz * nz
            if along >= 0.0 or is_on_mount(surfaces, surface, px, py, pz):
                return
            weight *= interpolate_degrees(surfaces.reflectance, -along)
            dx, dy, dz = dx - 2.0 * along * nx, dy - 2.0 * along * ny, dz - 2.0 * along * nz
        elif surface == SHEET:
            pz = 0.0
            dx, dy, dz, factor = scatter_at_sample(lobes, dx, dy, dz, key, counter)
            if interactions >= ROULETTE and factor < 1.0:
                if uniform(key, counter + 4) >= factor:
                    return
            else:
                weight *= factor
        else:
            pz = surfaces.gap * (1 + UPPER - surface)
            if uniform(key, counter) >= surfaces.frame_reflectance:
                return
            dx, dy, dz = cosine_direction(dz < 0.0, uniform(key, counter + 1), uniform(key, counter + 2))
        if not weight > 0.0:
            return
        interactions += 1
