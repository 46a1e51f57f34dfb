"""Arguments of the kernels for a forward run, made from instrument, sample and source; shares of paths of each stratum."""

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.analytic_samples import regular
from goniotwin.twin.optics.bsdf.kinds import GAUSSIAN, LAMBERTIAN
from goniotwin.twin.optics.bsdf.packed_lobes import ABOVE, Lobes, lobe_share, pack_lobes
from goniotwin.twin.optics.bsdf.scatterer import Scatterer
from goniotwin.twin.optics.forward.blocks import COSINE, FRAME, MODEL, REST, SHAPE, Strata
from goniotwin.twin.optics.forward.bounces import Surfaces
from goniotwin.twin.optics.forward.paths import BLOCK, MARGIN, Beam
from goniotwin.twin.optics.forward.scoring import Targets, make_sensor_targets, make_targets
from goniotwin.twin.optics.forward.spread import BINS, Spread
from goniotwin.twin.optics.geometry.instrument import Instrument, SampleFrames, reflected_share
from goniotwin.twin.optics.geometry.mirrors import pupil, reflect
from goniotwin.twin.optics.geometry.scene import Scene, scene_at
from goniotwin.twin.optics.illumination.rayset import RaySource
from goniotwin.twin.optics.illumination.slit_image import slit_image

SHAPE_SHARE = 0.875
"""Share of a Gaussian's paths that follow its shape."""
LEAST = 16
"""Least number of a block's paths in a stratum; all have a multiple of it, which suits vectorised loops."""
MM2_TO_M2 = 1e-6
OPEN_BEAM = regular(transmits=True, side="both")


def make_strata(pupil_radius_mm: float, beam: Beam, lobes: Lobes, frames: SampleFrames, beside: float, stray: bool) -> Strata:
    """Shares of a block's paths: each lobe by the light that it scatters; the frame receives `beside` times the hole's light.

    The frame never has more than half, and half for a map of `stray` light. Raises ValueError for too many lobes.
    """
    area = math.pi * pupil_radius_mm**2 * 4.0 * beam.hole_half**2
    hole_gain, frame_gain = MM2_TO_M2 * area * MARGIN**2, MM2_TO_M2 * area * (frames.lit**2 - 1.0)
    if beam.rays.shape[0]:
        hole_gain = frame_gain = float(beam.rays.shape[0])
    middle = beam.aim[0] - beam.pupil[0]
    for normal in beam.mirrors[:, 1]:
        middle = reflect(middle, normal)
    sine = min(1.0, float(np.hypot(middle[0], middle[1]) / np.linalg.norm(middle)))
    worth = [lobe_share(lobes, k, True, sine) for k in range(len(lobes.weights))]
    ways: list[tuple[int, int, float, float]] = []
    for k, share in enumerate(worth):
        if share <= 0.0 or lobes.models.heads[k, ABOVE] != 1:
            continue
        gain, kind = hole_gain * float(lobes.weights[k]), int(lobes.models.heads[k, 0])
        if kind == GAUSSIAN:
            ways += [(SHAPE, k, SHAPE_SHARE * share, gain), (REST, k, (1.0 - SHAPE_SHARE) * share, gain)]
        else:
            ways.append((COSINE if kind == LAMBERTIAN else MODEL, k, share, gain))
    on_frame = beside * frames.reflectance
    if on_frame > 0.0:
        total = sum(way[2] for way in ways)
        share = total if stray else min(on_frame, total)
        share = share if total > 0.0 else 1.0
        ways.append((FRAME, 0, share, frame_gain * frames.reflectance))
    counts = _counts([way[2] for way in ways])
    table, gains = np.zeros((len(ways), 3), dtype=np.int64), np.zeros((len(ways), 2))
    for i, (way, k, _, gain) in enumerate(ways):
        table[i] = way, k, counts[i]
        paths, share = counts[i], 0.0
        if way in (SHAPE, REST):
            shape = i if way == SHAPE else i - 1
            paths = counts[shape] + counts[shape + 1]
            share = counts[shape] / paths
        gains[i] = gain * BLOCK / paths, share
    return Strata(table, gains, frames.lit)


def _counts(shares: list[float]) -> list[int]:
    """Distribute a block's paths to strata in multiples of LEAST, at least LEAST each."""
    if not shares:
        return []
    if len(shares) > BLOCK // LEAST // 2:
        raise ValueError(f"the sample has {len(shares)} lobes at once: the forward estimator takes {BLOCK // LEAST // 4}")
    total = sum(shares)
    counts = [max(LEAST, LEAST * round(share / total * BLOCK / LEAST)) for share in shares]
    largest = counts.index(max(counts))
    counts[largest] += BLOCK - sum(counts)
    if counts[largest] < LEAST:
        counts = [LEAST * (BLOCK // LEAST // len(shares))] * len(shares)
        counts[0] += BLOCK - sum(counts)
    return counts


@dataclass(frozen=True, eq=False)
class Setting:
    """Arguments of the kernels (see their types).

    `detectors`: their number; `rows` of their sums; `longest`: greatest number of detectors in a cell. `radiance` and `unit`
    are those of `Estimate`.
    """

    scene: Scene
    beam: Beam
    strata: Strata
    lobes: Lobes
    surfaces: Surfaces
    targets: Targets
    spread: Spread
    longest: int
    detectors: int
    radiance: float
    unit: str | None

    @property
    def rows(self) -> int:
        """Number of rows of the sums."""
        return self.detectors + (BINS if self.spread.wanted else 0)


def set_up(
    instrument: Instrument,
    sigma_deg: float,
    directions: npt.ArrayLike,
    scatterer: Scatterer | None,
    gamma_deg: float,
    wavelength_nm: float | None,
    source: RaySource | None,
    max_interactions: int,
    frames: SampleFrames,
    spread: bool = False,
) -> Setting:
    """Setting of a run, see `forward_throughput`. With `spread` stray light is spread over a map."""
    sample = scatterer or OPEN_BEAM
    scene = scene_at(instrument, sigma_deg, gamma_deg)
    rows = np.asarray(directions, dtype=np.float64)
    centres, axes = scene.detectors(instrument, rows) if rows.size else (np.zeros((0, 3)), np.zeros((0, 3)))
    if instrument.sensor is None:
        detector_targets = make_targets(centres, axes, instrument.field_deg, instrument.detector_diameter_mm)
    else:
        detector_targets = make_sensor_targets(centres, axes, _along_the_arc(instrument, scene, rows), instrument.sensor)
    beam = _beam(instrument, scene, wavelength_nm, source, frames)
    weights = sample.weights(wavelength_nm)
    active = [k for k in range(len(sample.lobes)) if weights[k] > 0.0]
    active = active or [0]
    lobes = pack_lobes(tuple(sample.lobes[k] for k in active), weights[active], scene.incident)
    half_field = math.radians(0.5 * instrument.field_deg)
    radiance, unit = 1.0, None
    inside, outside = 1.0, frames.lit**2 - 1.0
    if source is not None:
        inside, outside = _landing(beam)
        radiance, unit = inside / _etendue(beam), source.unit
    return Setting(
        scene,
        beam,
        make_strata(instrument.pupil_radius_mm, beam, lobes, frames, outside / inside, spread),
        lobes,
        Surfaces(
            scene.mirrors,
            0.5 * instrument.mirror_side_mm,
            0.5 * instrument.blocking_side_mm,
            instrument.obstruction,
            reflected_share(instrument.mirror_reflectance, wavelength_nm, np.arange(91.0)),
            beam.hole_half,
            beam.frame_half,
            frames.gap_mm,
            frames.reflectance,
            max_interactions,
        ),
        detector_targets,
        Spread(spread, len(axes), instrument.arc_radius_mm, 0.5 * instrument.detector_diameter_mm, half_field),
        int(np.diff(detector_targets.starts).max()),
        len(axes),
        radiance,
        unit,
    )


def _along_the_arc(instrument: Instrument, scene: Scene, rows: Floats) -> Floats:
    """Unit vector (n, 3) in the sample's frame along the side of each detector's square that lies along the arc.

    It is the viewing direction of a sensor turned by a further 90 deg about its level side, so it includes every deviation.
    """
    if not rows.size:
        return np.zeros((0, 3))
    own = instrument.deviation("sensor")
    quarter = replace(own, rx_deg=0.0, ry_deg=own.ry_deg + 90.0)
    _, sides = scene.detectors(replace(instrument, deviations={**instrument.deviations, "sensor": quarter}), rows)
    return sides


def _beam(
    instrument: Instrument, scene: Scene, wavelength_nm: float | None, source: RaySource | None, frames: SampleFrames
) -> Beam:
    centre, axis_u, axis_v = pupil(instrument)
    normal, radius = np.cross(axis_v, axis_u), instrument.pupil_radius_mm
    own = np.array([centre - scene.origin, radius * axis_u, radius * axis_v, normal]) @ scene.to_sample.T
    hole = 0.5 * instrument.spot_side_mm
    aim = np.array([[0.0, 0.0, frames.gap_mm], [hole, 0.0, 0.0], [0.0, hole, 0.0]])
    for place, mirror_normal in scene.mirrors[::-1, :2]:
        aim[0] = reflect(aim[0] - place, mirror_normal) + place
        aim[1:] = [reflect(axis, mirror_normal) for axis in aim[1:]]
    rays, flux = np.zeros((0, 6)), np.zeros(0)
    if source is not None:
        rays = np.hstack([(source.rays[:, :3] - scene.origin) @ scene.to_sample.T, source.rays[:, 3:] @ scene.to_sample.T])
        flux = np.array(source.flux)
    return Beam(
        own,
        aim,
        np.array(scene.mirrors),
        _linear_reflectance(instrument, scene, wavelength_nm),
        0.5 * instrument.mirror_side_mm,
        hole,
        0.5 * frames.side_mm,
        frames.gap_mm,
        slit_image(instrument, scene, frames.gap_mm),
        rays,
        flux,
    )


def _linear_reflectance(instrument: Instrument, scene: Scene, wavelength_nm: float | None) -> Floats:
    """Reflectance of each mirror (3, 2), linear in the cosine over one degree on either side of the beam's axis."""
    angles = scene.mirror_angles_deg
    near, far = np.maximum(angles - 1.0, 0.0), np.minimum(angles + 1.0, 90.0)
    middle, first, last = (reflected_share(instrument.mirror_reflectance, wavelength_nm, each) for each in (angles, near, far))
    slope = (last - first) / (np.cos(np.radians(far)) - np.cos(np.radians(near)))
    return np.stack([middle - slope * np.cos(np.radians(angles)), slope], axis=1)


def _landing(beam: Beam) -> tuple[float, float]:
    """Flux of the rays over all mirrors into the hole, and of those that land beside it, without losses."""
    place, along = beam.rays[:, :3].copy(), beam.rays[:, 3:].copy()
    passing = np.ones(len(place), dtype=bool)
    for centre, normal, axis_u, axis_v in beam.mirrors:
        slope = along @ normal
        place += (((centre - place) @ normal) / slope)[:, None] * along
        passing &= (np.abs((place - centre) @ axis_u) <= beam.mirror_half) & (
            np.abs((place - centre) @ axis_v) <= beam.mirror_half
        )
        along -= 2.0 * slope[:, None] * normal
    place += ((beam.gap - place[:, 2]) / along[:, 2])[:, None] * along
    hole = np.all(np.abs(place[:, :2]) <= beam.hole_half, axis=1)
    inside = float(beam.flux[passing & hole].sum())
    if inside <= 0.0:
        raise ValueError("source: none of its rays reaches the hole over the mirrors; replay it at the instrument's pupil")
    return inside, float(beam.flux[passing & ~hole].sum())


def _etendue(beam: Beam) -> float:
    """Etendue of the uniform exit pupil and the hole, in m^2 sr, with mirrors that are large enough and have no losses."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    turns = np.arange(12) * (math.pi / 6.0)
    radii, shares = np.sqrt(0.5 * (nodes + 1.0)), 0.5 * weights / turns.size
    starts = beam.pupil[0] + (radii[:, None, None] * np.cos(turns)[:, None]) * beam.pupil[1]
    starts = starts + (radii[:, None, None] * np.sin(turns)[:, None]) * beam.pupil[2]
    ends = beam.aim[0] + nodes[:, None, None] * beam.aim[1] + nodes[:, None] * beam.aim[2]
    lines = ends[:, :, None, None] - starts
    square = np.sum(lines**2, axis=-1)
    normal = np.cross(beam.aim[1], beam.aim[2]) / np.linalg.norm(np.cross(beam.aim[1], beam.aim[2]))
    element = np.abs(lines @ normal) * (lines @ beam.pupil[3]) / square**2
    mean = np.einsum("ijkl,i,j,k->", element, weights / 2.0, weights / 2.0, shares)
    area = math.pi * float(beam.pupil[1] @ beam.pupil[1]) * 4.0 * beam.hole_half**2
    return float(mean) * area * MM2_TO_M2
