"""Illumination of the sample by backward rays: from the square at the sample over the exit pupil to the arc.

Every ray ends in the arc or beside it. Its weight is its length within the arc's cylinder, directly and by the reflector: the
radiance of an optically thin arc is proportional to that length. So nearly all rays contribute, with similar weights.

Also figure 8 of the paper as data: uniformity and divergence of the illumination.
"""

import math
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.illumination.beam import Illumination, check_square, mean_and_error, widest_angle
from goniotwin.twin.optics.illumination.elements import field_ray
from goniotwin.twin.optics.illumination.unit import IlluminationUnit
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.montecarlo import check_seed, circle_point, item_key, run_until, scramble, uniform

U64 = np.uint64
# Few enough to be fast, and enough for an estimate of their standard deviation.
FIRST_RAYS = 512
DARK_RAYS = 1 << 18
MOST_RAYS = 1 << 30
# Width of the map relative to the field: it shows the slit's image with its edges.
MARGIN = 2.0
# Least number of rays of a cell of the map: its error is then below 1 %.
CELL_RAYS = 256
# Rays that are computed at once, without a branch or a call, so that the loops over them are vectorised. Their rows: the point
# (x, z) of the square and (u, v) of the exit pupil, mm, weight in 1/mm, tangent of the angle to the axis.
TILE = 64
X, Z, U, V, WEIGHT, TANGENT = (row * TILE for row in range(6))
ROWS = 6


@kernel()
def _draw(tile: Floats, first: int, count: int, key: np.uint64, radius: float, side: float, cells: int) -> None:
    """Fill X, Z, U, V for `count` rays from `first` on. Consecutive rays go to consecutive cells: all have the same number."""
    cell = first % (cells * cells)
    i, j = cell // cells, cell % cells
    for n in range(count):
        tile[n + X], tile[n + Z] = i, j
        j += 1
        if j == cells:
            i, j = (i + 1 if i + 1 < cells else 0), 0
    for n in range(count):
        own = item_key(key, first + n)
        tile[n + X] = ((tile[n + X] + uniform(own, 0)) / cells - 0.5) * side
        tile[n + Z] = ((tile[n + Z] + uniform(own, 1)) / cells - 0.5) * side
        reach = radius * math.sqrt(uniform(own, 2))
        cos, sin = circle_point(uniform(own, 3))
        tile[n + U], tile[n + V] = reach * cos, reach * sin


@kernel()
def weigh_tile(tile: Floats, count: int, frames: Floats, sizes: Floats) -> None:
    """Fill WEIGHT and TANGENT: each ray from (U, V) of the exit pupil to (X, Z) of the square, back to the arc."""
    for n in range(count):
        weight, s, t, tangent = field_ray(frames, sizes, tile[n + U], tile[n + V], tile[n + X], tile[n + Z])
        passes = (abs(s) <= sizes[8]) & (abs(t) <= sizes[9])
        tile[n + TANGENT] = tangent
        tile[n + WEIGHT] = weight if passes else 0.0


@kernel(nogil=True)
def _trace(
    first: int,
    last: int,
    seed: np.uint64,
    frames: Floats,
    sizes: Floats,
    side: float,
    cells: int,
    bins: int,
    widest: float,
) -> Floats:
    """Sums (2, cells^2 + bins) of the weights, in 1/mm, and of their squares over rays first..last-1."""
    sums, tile, places = np.zeros((2, cells * cells + bins)), np.empty(ROWS * TILE), cells * cells
    start, scale, cell = scramble(U64(seed)), bins / widest, first % places
    for ray in range(first, last, TILE):
        count = min(TILE, last - ray)
        _draw(tile, ray, count, start, sizes[7], side, cells)
        weigh_tile(tile, count, frames, sizes)
        for n in range(count):
            weight, place = tile[n + WEIGHT], places + min(bins - 1, int(math.atan(tile[n + TANGENT]) * scale))
            sums[0, cell] += weight
            sums[1, cell] += weight * weight
            sums[0, place] += weight
            sums[1, place] += weight * weight
            cell = cell + 1 if cell + 1 < places else 0
    return sums


def emission_per_mm3_sr(unit: IlluminationUnit) -> float:
    """Emission of the arc at the passing wavelengths: radiance per length within it, in the lamp's unit / (mm^3 sr)."""
    return unit.band_flux / (4.0 * math.pi * unit.arc_volume_mm3)


def adjoint_illumination(
    unit: IlluminationUnit,
    *,
    rays: int | None = None,
    relative_error: float | None = None,
    cells: int = 5,
    bins: int = 40,
    side_mm: float | None = None,
    seed: int = 0,
) -> Illumination:
    """Result of `forward_illumination`, by rays from the square to a point of the exit pupil and back to the arc.

    `rays` is rounded up so that each cell has the same number, at least 2. The flux' error is that of its cells together; all
    errors are standard errors of mean weights. Raises ValueError as `forward_illumination`; the limit is 2^30 rays.
    """
    side = check_square(unit, side_mm, cells, bins)
    check_seed(seed)
    frames, sizes, widest = unit.frames, unit.sizes, widest_angle(unit, side)
    places = cells * cells
    if rays is not None and rays >= 2:
        rays = places * max(2, math.ceil(rays / places))
    first_rays = places * max(2, math.ceil(FIRST_RAYS / places))
    cell_mm2 = (side / cells) ** 2
    # Flux per cell for a mean weight of 1.
    scale = emission_per_mm3_sr(unit) * math.pi * unit.exit_pupil_radius_mm**2 * cell_mm2

    def trace(first: int, last: int) -> Floats:
        sums: Floats = _trace(first, last, U64(seed), frames, sizes, side, cells, bins, widest)
        return sums

    def estimate(sums: Floats, count: int) -> tuple[float, float, Illumination]:
        mean, error = mean_and_error(sums[:, :places], count // places)
        ring, ring_error = mean_and_error(sums[:, places:], count)
        result = Illumination(
            flux=float(mean.sum()) * scale,
            flux_error=math.sqrt(float(np.sum(error**2))) * scale,
            unit=unit.lamp.unit,
            emitted_flux=unit.band_flux,
            rays=count,
            side_mm=side,
            irradiance=mean.reshape(cells, cells) * (scale / (cell_mm2 * 1e-6)),
            irradiance_error=error.reshape(cells, cells) * (scale / (cell_mm2 * 1e-6)),
            angle_edges_deg=np.degrees(np.linspace(0.0, widest, bins + 1)),
            angular_flux=ring * (scale * places),
            angular_flux_error=ring_error * (scale * places),
        )
        return result.flux, result.flux_error, result

    return run_until(trace, estimate, rays, relative_error, first_rays, DARK_RAYS, MOST_RAYS)


@dataclass(frozen=True, eq=False)
class IlluminationFigure:
    """Main output of the illumination unit (paper, figure 8), ready to be drawn.

    Map: `irradiance` [x, z] (n, n) and its standard errors in `unit`/m^2, over the cells between `edges_mm` (n + 1,) in both
    directions. Profile: `intensity` (bins,) and its standard errors in `unit`/sr over the angle `angle_deg` (bins,) to the
    axis, of the light in the central `field` alone; `field` also has its flux, uniformity and full width.
    """

    unit: str
    edges_mm: Floats
    irradiance: Floats
    irradiance_error: Floats
    angle_deg: Floats
    intensity: Floats
    intensity_error: Floats
    field: Illumination


def illumination_figure(
    unit: IlluminationUnit, cells: int = 40, bins: int = 40, relative_error: float = 0.001, seed: int = 0
) -> IlluminationFigure:
    """Data of the paper's figure 8. `cells` is the number across the map of twice the field; `relative_error` that of the flux.

    The lit square is the slit's image, 14 times larger: 7 mm for a field of 5 mm. The irradiance is uniform: without deviations
    to 0.1 % over the field and to 1 % over the square (the arc's chords), with sharp edges because the lenses are ideal. The
    exit pupil is not uniform: its rim is darker than its centre by a quarter (the cosines in front of the f/1 condenser), so
    that the beam is narrower than one from a uniform pupil. Raises ValueError as `adjoint_illumination`.
    """
    field = adjoint_illumination(unit, relative_error=relative_error, bins=bins, seed=seed)
    side = MARGIN * unit.field_side_mm
    wide = adjoint_illumination(
        unit, rays=max(field.rays, CELL_RAYS * cells * cells), cells=cells, bins=bins, side_mm=side, seed=seed
    )
    return IlluminationFigure(
        unit=field.unit,
        edges_mm=np.linspace(-0.5 * side, 0.5 * side, cells + 1),
        irradiance=wide.irradiance,
        irradiance_error=wide.irradiance_error,
        angle_deg=0.5 * (field.angle_edges_deg[1:] + field.angle_edges_deg[:-1]),
        intensity=field.intensity,
        intensity_error=field.angular_flux_error / field.solid_angles_sr,
        field=field,
    )
