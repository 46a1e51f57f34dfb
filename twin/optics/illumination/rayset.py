"""Raysets: rays that leave the output condenser, recorded once and replayed as a source (paper, section 3.3)."""

import math
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics.illumination.adjoint import emission_per_mm3_sr
from goniotwin.twin.optics.illumination.elements import along_axes, bend, lit_length, to_plane
from goniotwin.twin.optics.illumination.unit import OUTPUT, SLIT, IlluminationUnit
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.montecarlo import check_seed, item_key, scramble, uniform

U64 = np.uint64
COLUMNS = {"positions_mm": 3, "directions": 3, "wavelength_nm": 0, "flux": 0}
# Positions are computed on the plane: a larger distance means a rayset of another kind.
PLANE_TOLERANCE_MM = 1e-6


@dataclass(frozen=True, eq=False)
class Rayset:
    """Rays that leave an illumination unit, simulated, in the unit's frame (y along the light, origin the exit pupil).

    `positions_mm` (n, 3) are the points on the plane y = `plane_mm`. `directions` (n, 3) point along the light and need not be
    unit vectors. `wavelength_nm` (n,) is one for each ray, `flux` (n,) the flux of each, in `unit` (W or lm); a ray that the
    unit vignettes has none. `geometry` is the fingerprint of the `IlluminationUnit`, `emitted_flux` its arc's flux into all
    directions at the passing wavelengths, `seed` the seed of the rays.

    The arrays are copied and read-only. Raises ValueError, with the ray's number, for NaN, wrong shapes, a direction of length
    zero or against the light, negative flux, an invalid wavelength, a ray off the plane; and for more flux than was emitted.
    """

    positions_mm: Floats
    directions: Floats
    wavelength_nm: Floats
    flux: Floats
    unit: str
    plane_mm: float
    geometry: str
    emitted_flux: float
    seed: int

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.flux))
        if count < 1:
            raise ValueError("a rayset without rays: give at least one")
        for name, width in COLUMNS.items():
            column = np.array(getattr(self, name), dtype=np.float64)
            wanted = (count, width) if width else (count,)
            if column.shape != wanted:
                raise ValueError(f"{name} has the shape {column.shape}: {count} rays need {wanted}")
            self._refuse(~np.all(np.isfinite(column.reshape(count, -1)), axis=1), name, "is not finite")
            column.flags.writeable = False
            object.__setattr__(self, name, column)
        length = np.sqrt(np.einsum("ij,ij->i", self.directions, self.directions))
        self._refuse(~(np.isfinite(length) & (length > 0.0)), "directions", "has no length")
        self._refuse(self.directions[:, 1] <= 0.0, "directions", "does not go along the light (y above 0)")
        self._refuse(self.wavelength_nm <= 0.0, "wavelength_nm", "is no wavelength")
        self._refuse(self.flux < 0.0, "flux", "is negative")
        if self.unit not in ("W", "lm"):
            raise ValueError(f"unit is {self.unit!r}: give W or lm")
        if not math.isfinite(self.plane_mm):
            raise ValueError(f"plane_mm is {self.plane_mm!r}: give the plane's position along y")
        off = np.abs(self.positions_mm[:, 1] - self.plane_mm) > PLANE_TOLERANCE_MM
        self._refuse(off, "positions_mm", f"is not on the plane y = {self.plane_mm:g} mm")
        if not (math.isfinite(self.emitted_flux) and self.emitted_flux > 0.0):
            raise ValueError(f"emitted_flux is {self.emitted_flux!r}: give a positive, finite number")
        if self.total_flux > self.emitted_flux:
            raise ValueError(f"the rays carry {self.total_flux:.4g} {self.unit}, of {self.emitted_flux:.4g} emitted")
        if not self.geometry:
            raise ValueError("geometry is empty: give the illumination unit's fingerprint")
        check_seed(self.seed)

    def _refuse(self, wrong: Flags, name: str, what: str) -> None:
        if np.any(wrong):
            ray = int(np.argmax(wrong))
            raise ValueError(f"ray {ray}: {name} {getattr(self, name)[ray]} {what}")

    @property
    def total_flux(self) -> float:
        """Flux that leaves the output condenser, in `unit`."""
        return float(self.flux.sum())

    @property
    def total_flux_error(self) -> float:
        """Standard error of the total flux as an estimate for the unit; NaN for a single ray."""
        count = self.flux.size
        return float(self.flux.std(ddof=1) * math.sqrt(count)) if count > 1 else math.nan


@kernel(nogil=True)
def _record(rays: int, seed: np.uint64, frames: Floats, sizes: Floats) -> Floats:
    """Rays (rays, 8): point on the plane y = 0 and direction after the lens, weight in 1/mm, a number in 0..1."""
    result = np.zeros((rays, 8))
    start = scramble(U64(seed))
    for ray in range(rays):
        key = item_key(start, ray)
        s, t = sizes[8] * (2.0 * uniform(key, 0) - 1.0), sizes[9] * (2.0 * uniform(key, 1) - 1.0)
        radius, turn = sizes[7] * math.sqrt(uniform(key, 2)), 2.0 * math.pi * uniform(key, 3)
        u, v = radius * math.cos(turn), radius * math.sin(turn)
        x = frames[SLIT, 0, 0] + s * frames[SLIT, 1, 0] + t * frames[SLIT, 3, 0]
        y = frames[SLIT, 0, 1] + s * frames[SLIT, 1, 1] + t * frames[SLIT, 3, 1]
        z = frames[SLIT, 0, 2] + s * frames[SLIT, 1, 2] + t * frames[SLIT, 3, 2]
        p = frames[OUTPUT, 0, 0] + u * frames[OUTPUT, 1, 0] + v * frames[OUTPUT, 3, 0] - x
        q = frames[OUTPUT, 0, 1] + u * frames[OUTPUT, 1, 1] + v * frames[OUTPUT, 3, 1] - y
        r = frames[OUTPUT, 0, 2] + u * frames[OUTPUT, 1, 2] + v * frames[OUTPUT, 3, 2] - z
        square = p * p + q * q + r * r
        shrink = 1.0 / math.sqrt(square)
        p, q, r = p * shrink, q * shrink, r * shrink
        leaving, arriving = along_axes(frames, SLIT, p, q, r)[1], along_axes(frames, OUTPUT, p, q, r)[1]
        result[ray, 6] = lit_length(frames, sizes, x, y, z, -p, -q, -r) * leaving * arriving / square
        x, y, z, u, v = to_plane(frames, OUTPUT, x, y, z, p, q, r)
        p, q, r, _ = bend(frames, OUTPUT, u, v, 1.0 / sizes[6], p, q, r)
        result[ray, 0], result[ray, 1], result[ray, 2] = x - y / q * p, 0.0, z - y / q * r
        result[ray, 3], result[ray, 4], result[ray, 5] = p, q, r
        result[ray, 7] = uniform(key, 4)
    return result


def record(unit: IlluminationUnit, rays: int, seed: int) -> Rayset:
    """Record `rays` rays that leave the output condenser, on the plane across the axis at the exit pupil (y = 0).

    Each goes from a uniform point of the slit to one of the exit pupil, and has the flux that the arc sends along it, found by
    backward tracing: so no ray is lost, and all have similar flux. They are weighted. Wavelengths are distributed as the flux
    that passes the monochromator. Raises ValueError for fewer than 2 rays, a negative seed, and if no wavelength of the lamp
    passes.
    """
    if rays < 2:
        raise ValueError(f"rays is {rays}: give at least 2")
    check_seed(seed)
    columns = _record(rays, U64(seed), unit.frames, unit.sizes)
    width, height = unit.opening_mm
    scale = emission_per_mm3_sr(unit) * width * height * math.pi * unit.exit_pupil_radius_mm**2 / rays
    return Rayset(
        positions_mm=columns[:, 0:3],
        directions=columns[:, 3:6],
        wavelength_nm=unit.passband.sample(unit.lamp, columns[:, 7]),
        flux=columns[:, 6] * scale,
        unit=unit.lamp.unit,
        plane_mm=0.0,
        geometry=unit.fingerprint,
        emitted_flux=unit.band_flux,
        seed=seed,
    )


@dataclass(frozen=True, eq=False)
class RaySource:
    """Rayset as an argument of the kernels, contiguous.

    `rays` (n, 6) are positions in mm and unit directions in the rig's frame; `flux` (n,) in `unit` and `wavelength_nm` (n,)
    belong to them.
    """

    rays: Floats
    flux: Floats
    wavelength_nm: Floats
    unit: str


def replay(
    rayset: Rayset,
    unit: IlluminationUnit,
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rotation: Floats | None = None,
) -> RaySource:
    """Replay a rayset as a source instead of the uniform exit pupil, with the unit's frame at its place in the rig's.

    `rotation` (3, 3) and `origin_mm` are those of `illumination_place(instrument)`; by default the frame remains the unit's.
    Raises ValueError if the rayset is of another unit: other dimensions, shares, lamp, wavelength or deviations make other
    rays.
    """
    if rayset.geometry != unit.fingerprint:
        raise ValueError(
            f"a rayset of another geometry: recorded for {rayset.geometry}, this illumination unit is {unit.fingerprint}; "
            "record it again"
        )
    turn = np.eye(3) if rotation is None else rotation
    length = np.sqrt(np.einsum("ij,ij->i", rayset.directions, rayset.directions))
    rays = np.hstack([rayset.positions_mm @ turn.T + np.array(origin_mm), rayset.directions / length[:, None] @ turn.T])
    return RaySource(np.ascontiguousarray(rays), rayset.flux, rayset.wavelength_nm, rayset.unit)
