"""What becomes of light after its first scattering: mirrors, frames and the sample again, until it leaves or is absorbed.

Few paths come here, so each is traced by itself and in double precision. Mirrors reflect on their front and absorb on their
back, their mounts absorb; frames keep their share of the paths, with their whole weight; the sample scatters to its lobes.
After three interactions a path goes on with the share of its weight that the sample left it, and with its former weight.
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
"""Surfaces beside mirrors 0 to 2."""
ROULETTE = 3
NUMBERS = 8
"""Random numbers of a path for each interaction."""
# Nearer than this, in mm, a ray has only just left the surface.
NEAR = 1e-6


class Surfaces(NamedTuple):
    """What light can meet, in the sample's frame, mm: `mirrors` (3, 4, 3), their half side and that with the mount, of which
    there are none for scattered light without `obstruction`; their `reflectance` (91,) at incidences of 0 to 90 deg; half
    sides of hole and frames, the gap and the frames' reflectance; `most` interactions of a path.
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
def next_surface(
    stage: Surfaces, px: float, py: float, pz: float, dx: float, dy: float, dz: float
) -> tuple[int, float]:  # fmt: skip
    """The surface that a ray meets first, and how far away it is."""
    surface, nearest = NOTHING, math.inf
    if stage.obstruction:
        for m in range(3):
            distance = distance_to(stage.mirrors, m, stage.blocking_half, px, py, pz, dx, dy, dz)
            if NEAR < distance < nearest:
                surface, nearest = m, distance
    # Without a gap all three are in one plane, and what the light meets first is the frame on its own side.
    for turn in range(3):
        sheet = turn if dz < 0.0 else 2 - turn
        distance = (stage.gap * (1 - sheet) - pz) / dz
        if not NEAR < distance < nearest:
            continue
        out = max(abs(px + distance * dx), abs(py + distance * dy))
        if out <= stage.frame_half and (sheet == 1 or out > stage.hole_half):
            surface, nearest = UPPER + sheet, distance
    return surface, nearest


@kernel()
def is_on_mount(stage: Surfaces, m: int, px: float, py: float, pz: float) -> bool:
    """Whether a place in the plane of mirror m is beyond its edges."""
    x, y, z = px - stage.mirrors[m, 0, 0], py - stage.mirrors[m, 0, 1], pz - stage.mirrors[m, 0, 2]
    u = x * stage.mirrors[m, 2, 0] + y * stage.mirrors[m, 2, 1] + z * stage.mirrors[m, 2, 2]
    v = x * stage.mirrors[m, 3, 0] + y * stage.mirrors[m, 3, 1] + z * stage.mirrors[m, 3, 2]
    return bool(max(abs(u), abs(v)) > stage.mirror_half)


@kernel()
def cosine_direction(up: bool, u: float, v: float) -> tuple[float, float, float]:
    """A direction by Lambert's law, above or below."""
    radius, turn, height = math.sqrt(u), 2.0 * math.pi * v, math.sqrt(1.0 - u)
    return radius * math.cos(turn), radius * math.sin(turn), height if up else -height


@kernel()
def interpolate_degrees(table: Floats, cosine: float) -> float:
    """Of a table over whole degrees of incidence, 0 to 90, linear between."""
    place = math.degrees(math.acos(min(1.0, cosine)))
    i = min(int(place), table.size - 2)
    return table[i] + (place - i) * (table[i + 1] - table[i])  # type: ignore[no-any-return]


@kernel()
def trace_bounces(
    stage: Surfaces, lobes: Lobes, targets: Targets, spread: Spread, key: np.uint64, interactions: int, scored: bool,
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, weight: float, sums: Floats,
) -> None:  # fmt: skip
    """Follows a path from p along d, that has had `interactions`, and scores it; its first part unless that is `scored`."""
    mirrored = False
    while True:
        surface, nearest = next_surface(stage, px, py, pz, dx, dy, dz)
        if not scored:
            score_segment(targets, px, py, pz, dx, dy, dz, nearest, weight, sums)
            # The map has no mirrors in it: what they hide is hidden where it is used, and what goes back over them to the lamp
            # is as narrow as the beam.
            if spread.wanted and not mirrored:
                spread_segment(spread, px, py, pz, dx, dy, dz, surface >= UPPER and surface != NOTHING, weight, sums)
        scored = False
        if surface == NOTHING or interactions >= stage.most:
            return
        px, py, pz = px + nearest * dx, py + nearest * dy, pz + nearest * dz
        counter, mirrored = NUMBERS * interactions, surface < UPPER
        if mirrored:
            nx, ny, nz = stage.mirrors[surface, 1, 0], stage.mirrors[surface, 1, 1], stage.mirrors[surface, 1, 2]
            along = dx * nx + dy * ny + dz * nz
            if along >= 0.0 or is_on_mount(stage, surface, px, py, pz):
                return
            weight *= interpolate_degrees(stage.reflectance, -along)
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
            pz = stage.gap * (1 + UPPER - surface)
            if uniform(key, counter) >= stage.frame_reflectance:
                return
            dx, dy, dz = cosine_direction(dz < 0.0, uniform(key, counter + 1), uniform(key, counter + 2))
        if not weight > 0.0:
            return
        interactions += 1
