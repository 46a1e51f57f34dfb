"""Illumination of the sample by forward rays: from the arc's volume over every element to the sample's plane.

It uses neither chords nor the exit pupil's position, so that it is an independent check of the adjoint estimator. A ray's
random numbers are a function of seed and ray.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.illumination.beam import Illumination, check_square, mean_and_error, widest_angle
from goniotwin.twin.optics.illumination.elements import bend, reflect_at_sphere, to_plane
from goniotwin.twin.optics.illumination.unit import ARC, INPUT, OUTPUT, REFLECTOR, SLIT, IlluminationUnit
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.montecarlo import check_seed, item_key, run_until, scramble, uniform

U64 = np.uint64
FIRST_RAYS = 1 << 18
DARK_RAYS = 1 << 22
MOST_RAYS = 1 << 34


@kernel(nogil=True)
def _trace(
    first: int,
    last: int,
    seed: np.uint64,
    frames: Floats,
    sizes: Floats,
    aim: Floats,
    across: Floats,
    side: float,
    cells: int,
    bins: int,
    widest: float,
) -> Floats:
    """Sums (2, cells^2 + bins) of the weights and of their squares over rays first..last-1."""
    sums = np.zeros((2, cells * cells + bins))
    start = scramble(U64(seed))
    for ray in range(first, last):
        key = item_key(start, ray)
        # Uniform in the arc; within a cone towards the condenser, or the opposite cone towards the reflector.
        cosine = 1.0 - uniform(key, 0) * aim[3]
        backwards = uniform(key, 1) < 0.5
        radius, turn = math.sqrt(max(0.0, 1.0 - cosine * cosine)), 2.0 * math.pi * uniform(key, 2)
        p, q = radius * math.cos(turn), radius * math.sin(turn)
        radius, turn = sizes[0] * math.sqrt(uniform(key, 3)), 2.0 * math.pi * uniform(key, 4)
        a, b, height = radius * math.cos(turn), radius * math.sin(turn), sizes[1] * (2.0 * uniform(key, 5) - 1.0)
        x = frames[ARC, 0, 0] + a * frames[ARC, 1, 0] + b * frames[ARC, 2, 0] + height * frames[ARC, 3, 0]
        y = frames[ARC, 0, 1] + a * frames[ARC, 1, 1] + b * frames[ARC, 2, 1] + height * frames[ARC, 3, 1]
        z = frames[ARC, 0, 2] + a * frames[ARC, 1, 2] + b * frames[ARC, 2, 2] + height * frames[ARC, 3, 2]
        sign = -1.0 if backwards else 1.0
        wx = sign * (cosine * aim[0] + p * across[0, 0] + q * across[1, 0])
        wy = sign * (cosine * aim[1] + p * across[0, 1] + q * across[1, 1])
        wz = sign * (cosine * aim[2] + p * across[0, 2] + q * across[1, 2])
        weight = sizes[10]
        if backwards:
            weight = sizes[11]
            on, (x, y, z), (wx, wy, wz) = reflect_at_sphere(frames, REFLECTOR, sizes[2], sizes[3], x, y, z, wx, wy, wz)
            if not on:
                continue
        x, y, z, u, v = to_plane(frames, INPUT, x, y, z, wx, wy, wz)
        if not u * u + v * v <= sizes[5] * sizes[5]:
            continue
        wx, wy, wz, _ = bend(frames, INPUT, u, v, 1.0 / sizes[4], wx, wy, wz)
        x, y, z, u, v = to_plane(frames, SLIT, x, y, z, wx, wy, wz)
        if not (abs(u) <= sizes[8] and abs(v) <= sizes[9]):
            continue
        x, y, z, u, v = to_plane(frames, OUTPUT, x, y, z, wx, wy, wz)
        if not u * u + v * v <= sizes[7] * sizes[7]:
            continue
        wx, wy, wz, _ = bend(frames, OUTPUT, u, v, 1.0 / sizes[6], wx, wy, wz)
        step = (sizes[12] - y) / wy
        i = math.floor(((x + step * wx) / side + 0.5) * cells)
        j = math.floor(((z + step * wz) / side + 0.5) * cells)
        if not (0 <= i < cells and 0 <= j < cells):
            continue
        place = cells * cells + min(bins - 1, int(math.atan(math.hypot(wx, wz) / wy) / widest * bins))
        sums[0, i * cells + j] += weight
        sums[1, i * cells + j] += weight * weight
        sums[0, place] += weight
        sums[1, place] += weight * weight
    return sums


def _aim(unit: IlluminationUnit) -> tuple[Floats, Floats]:
    """Cone of directions that contains all that can reach the input condenser, directly or by the reflector.

    Axis of the cone and 1 - cosine of its half-angle, (4,), and two unit vectors across, (2, 3). A line reaches the condenser
    only from within the ball about the reflector's centre that holds the arc, because reflection keeps its distance from there.
    Reflection turns the line by at most twice the angle under which the sphere sees that ball's radius. Rays in other
    directions need not be traced; their share is in the weight.
    """
    frames, radius = unit.frames, unit.reflector_radius_mm
    centre = frames[REFLECTOR, 0] + radius * frames[REFLECTOR, 2]
    arc = math.hypot(unit.arc_radius_mm, 0.5 * unit.arc_length_mm) + float(np.linalg.norm(frames[ARC, 0] - centre))
    axis = frames[INPUT, 0] - centre
    distance = float(np.linalg.norm(axis))
    reach = (unit.input_condenser_radius_mm + arc) / distance
    angle = math.pi
    if reach < 1.0 and arc < radius:
        angle = math.asin(reach) + 2.0 * math.asin(arc / radius)
    axis /= distance
    side = np.cross(axis, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    return np.append(axis, 1.0 - math.cos(min(angle, 0.5 * math.pi))), np.array([side, np.cross(side, axis)])


def forward_illumination(
    unit: IlluminationUnit,
    *,
    rays: int | None = None,
    relative_error: float | None = None,
    cells: int = 5,
    bins: int = 40,
    side_mm: float | None = None,
    seed: int = 0,
) -> Illumination:
    """Illumination of the square of `side_mm` (the unit's `field_side_mm`) across the axis at the sample.

    Rays start uniformly in the arc's volume, in the directions of which some can reach the input condenser (all others cannot,
    and are only counted). They must pass every opening at its actual position. Give `rays` or, instead, the `relative_error` of
    the flux. The map has `cells` x `cells`, the divergence `bins`. Errors are those of the mean of the weights, zeros included.
    Bit-identical for any number of threads. Raises ValueError for fewer than 2 rays, a negative seed, a map without cells, and
    an error that needs more than 2^34 rays.
    """
    side = check_square(unit, side_mm, cells, bins)
    check_seed(seed)
    frames, sizes, widest = unit.frames, unit.sizes, widest_angle(unit, side)
    aim, across = _aim(unit)
    # Both cones together: a share 1 - cos of all directions.
    scale = unit.band_flux * float(aim[3])

    def trace(first: int, last: int) -> Floats:
        sums: Floats = _trace(first, last, U64(seed), frames, sizes, aim, across, side, cells, bins, widest)
        return sums

    def estimate(sums: Floats, count: int) -> tuple[float, float, Illumination]:
        mean, error = mean_and_error(sums, count)
        # A ray is in one cell at most: so the sums over all cells are those of one weight.
        whole, whole_error = mean_and_error(sums[:, : cells * cells].sum(axis=1, keepdims=True), count)
        cell_m2 = (side / cells * 1e-3) ** 2
        result = Illumination(
            flux=float(whole[0]) * scale,
            flux_error=float(whole_error[0]) * scale,
            unit=unit.lamp.unit,
            emitted_flux=unit.band_flux,
            rays=count,
            side_mm=side,
            irradiance=mean[: cells * cells].reshape(cells, cells) * (scale / cell_m2),
            irradiance_error=error[: cells * cells].reshape(cells, cells) * (scale / cell_m2),
            angle_edges_deg=np.degrees(np.linspace(0.0, widest, bins + 1)),
            angular_flux=mean[cells * cells :] * scale,
            angular_flux_error=error[cells * cells :] * scale,
        )
        return result.flux, result.flux_error, result

    return run_until(trace, estimate, rays, relative_error, FIRST_RAYS, DARK_RAYS, MOST_RAYS)
