"""The fast estimator: for a sample whose BSDF is known, from the detectors back to the exit pupil."""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from twin.optics.bsdf import TABLE, analytic, tabular
from twin.optics.bundle import bundle_measure_mm2sr, cone, detector_ray, detector_sizes, hole_turn, ray_bundle, view
from twin.optics.frames import Floats, direction_rows
from twin.optics.instrument import Instrument
from twin.optics.mirrors import Mirrors, mirrors_at, pupil_image, unfolded
from twin.optics.obstruction import distance_to, hidden, mirrors_near
from twin.optics.scattering import Scatterer, lambertian


@njit(cache=True, error_model="numpy", forceinline=True)
def arrival(
    px: float, py: float, u: float, v: float, pupil: Floats, images: Floats, half: float, clipped: bool
) -> tuple[float, float, float, float]:
    """Direction (x, y, z) to the pupil's point (u, v) from (px, py) on the sample, and its cos(l) cos(pupil) / r^2.

    The latter is 0 for light that comes from behind or would have missed one of the unfolded mirrors.
    """
    lx = pupil[0, 0] + u * pupil[1, 0] + v * pupil[2, 0] - px
    ly = pupil[0, 1] + u * pupil[1, 1] + v * pupil[2, 1] - py
    lz = pupil[0, 2] + u * pupil[1, 2] + v * pupil[2, 2]
    shrink = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx * shrink, ly * shrink, lz * shrink
    gain = max(lz, 0.0) * (lx * pupil[3, 0] + ly * pupil[3, 1] + lz * pupil[3, 2]) * shrink * shrink
    if clipped:
        for m in range(3):
            if distance_to(images, m, half, px, py, 0.0, lx, ly, lz) == math.inf:
                gain = 0.0
    return lx, ly, lz, gain


@njit(cache=True, error_model="numpy")
def _throughput(
    directions: Floats, rays: Floats, sizes: Floats, turn: Floats, mirrors: Floats, half: float, obstruction: bool,
    pupil: Floats, images: Floats, clipped: bool,
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, table: Floats,
) -> Floats:  # fmt: skip
    """Mean over the rays of f cos(l) cos(pupil) / r^2, in 1/sr/mm^2; a ray that is cut or misses counts as zero."""
    result = np.zeros(directions.shape[0])
    near, axes, slopes = np.zeros(3), np.zeros((5, 3)), cone(rays, sizes)
    peak, exponent, intensity = params[0], params[1], params[2]
    for k in range(directions.shape[0]):
        if directions[k, 2] <= 0.0:
            continue
        view(directions[k, 0], directions[k, 1], directions[k, 2], turn, axes)
        if obstruction:
            mirrors_near(mirrors, half, directions[k], sizes, near)
        crowded = near[0] + near[1] + near[2] > 0.0
        total = 0.0
        for j in range(rays.shape[0]):
            weight, px, py, wx, wy, wz, length = detector_ray(axes, rays, slopes, j, sizes, turn)
            if weight == 0.0 or (crowded and hidden(mirrors, near, half, length, px, py, wx, wy, wz)):
                continue
            lx, ly, lz, gain = arrival(px, py, rays[j, 4], rays[j, 5], pupil, images, half, clipped)
            if kind == TABLE:
                f = tabular(sig, ph, th, table, lx, ly, lz, wx, wy, wz)
            else:
                f = analytic(kind, peak, exponent, intensity, lx, ly, lz, wx, wy, wz)
            total += weight * gain * f
        result[k] = total / rays.shape[0]
    return result


def _clips(instrument: Instrument, images: Mirrors, pupil: Floats, gamma_deg: float) -> bool:
    """Whether some ray of the beam misses a mirror.

    Hole and pupil are convex, so the beam's section in a mirror's plane is the hull of the lines between their corners:
    when these 16 lines pass, all do, and the kernel need not ask.
    """
    cos, sin = hole_turn(gamma_deg)
    half = 0.5 * instrument.spot_side_mm
    signs = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
    corners = half * np.stack([signs @ [cos, -sin], signs @ [sin, cos], np.zeros(4)], axis=1)
    rim = pupil[0] + signs @ pupil[1:3]
    start = corners[:, None, None, :]
    leg = rim[None, :, None, :] - start
    reach = np.sum((images.centres - start) * images.normals, axis=-1) / np.sum(leg * images.normals, axis=-1)
    offset = start + reach[..., None] * leg - images.centres
    widest = np.max(np.abs([np.sum(offset * images.axes_u, axis=-1), np.sum(offset * images.axes_v, axis=-1)]))
    return bool(widest > 0.5 * instrument.mirror_side_mm)


def throughput(
    instrument: Instrument,
    sigma_deg: float,
    directions: npt.ArrayLike,
    scatterer: Scatterer,
    rays: int = 1024,
    gamma_deg: float = 0.0,
) -> Floats:
    """Throughput (n,) in m^2 sr of detectors in `directions` (n, 3): their flux over the radiance of the exit pupil.

    With the mirrors' reflectance, all cosines, the hole of the frame on the sample, the detectors' discs and acceptance
    cones, and, where the instrument says so, what the mirrors hide. `gamma_deg` turns the frame with the sample.
    Directions that are not in front of the sample (z <= 0) give 0, and so does light from behind: these samples scatter
    to the front only.

    Each detector is scored with the same `rays` deterministic rays, from its disc within its cone to the hole and on to
    the pupil, whatever the sample: so in the ratio of sample and etalon (paper, formula 1) what the frame and the
    mirrors cut cancels. One thread, always the same order: bit-identical between runs. Raises ValueError for a wrong
    shape, a vector of no length, or a number of rays that is no multiple of 4.
    """
    centre, axis_u, axis_v = pupil_image(instrument, sigma_deg)
    radius = instrument.pupil_radius_mm
    pupil = np.array([centre, radius * axis_u, radius * axis_v, np.cross(axis_u, axis_v)])
    if pupil[3] @ centre < 0.0:
        pupil[3] *= -1.0
    images = unfolded(instrument, sigma_deg)
    sizes = detector_sizes(instrument)
    mean = _throughput(
        direction_rows(directions), ray_bundle(rays), sizes, hole_turn(gamma_deg),
        mirrors_at(instrument, sigma_deg).packed, 0.5 * instrument.mirror_side_mm, instrument.obstruction,
        pupil, images.packed, _clips(instrument, images, pupil, gamma_deg), *scatterer.kernel_arguments,
    )  # fmt: skip
    seen_mm2sr = bundle_measure_mm2sr(sizes)
    result: Floats = mean * (instrument.mirror_reflectance**3 * seen_mm2sr * math.pi * radius**2 * 1e-6)
    return result


def luminance_factor(
    instrument: Instrument,
    sigma_deg: float,
    directions: npt.ArrayLike,
    scatterer: Scatterer,
    rays: int = 1024,
    gamma_deg: float = 0.0,
) -> Floats:
    """Luminance factor (n,), as the instrument measures it against an ideal diffuser (paper, formula 1).

    NaN where the etalon gives no signal: a direction that the mirrors hide has no value.
    """
    sample = throughput(instrument, sigma_deg, directions, scatterer, rays, gamma_deg)
    etalon = throughput(instrument, sigma_deg, directions, lambertian(), rays, gamma_deg)
    return np.divide(sample, etalon, out=np.full_like(sample, np.nan), where=etalon > 0.0)
