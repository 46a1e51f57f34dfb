"""The forward estimator: Monte Carlo from the exit pupil over real mirrors and the sample to all detectors at once.

It knows nothing of the unfolded path, of the bundle of rays or of a detector's own rays, so that it can hold the fast
estimator. Numbers are counter-based: a path's are a function of seed and path, and partial sums are added in the order
of the chunks, so results are bit-identical whatever the number of threads.
"""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt
from numba import njit

from twin.optics.bsdf import bsdf, density, sample
from twin.optics.bundle import detector_sizes, hole_turn
from twin.optics.frames import Floats, direction_rows
from twin.optics.instrument import Instrument
from twin.optics.mirrors import mirrors_at, pupil
from twin.optics.obstruction import distance_to
from twin.optics.scattering import Scatterer

CHUNK = 65536
# Of the region aimed at, against the hole: some of the beam lands on the frame, as it does in the instrument.
AIM = 1.1
U64 = np.uint64


@dataclass(frozen=True, eq=False)
class Estimate:
    """What `forward` found: throughput (n,) in m^2 sr, its standard error (n,) in m^2 sr, and the number of paths."""

    throughput_m2sr: Floats
    standard_error: Floats
    paths: int


@njit(cache=True, error_model="numpy")
def scrambled(bits: np.uint64) -> np.uint64:
    """64 bits that look random: the finaliser of splitmix64 (Steele, Lea, Flood 2014)."""
    # Every constant is cast: with a plain integer numba goes over to floats, and the bits are wrong without a word.
    bits = (bits ^ (bits >> U64(30))) * U64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> U64(27))) * U64(0x94D049BB133111EB)
    return bits ^ (bits >> U64(31))


@njit(cache=True, error_model="numpy")
def uniform(key: np.uint64, counter: int) -> float:
    """Number `counter` of a path's key, in [0, 1)."""
    bits = scrambled(key + U64(counter + 1) * U64(0x9E3779B97F4A7C15))
    return float(bits >> U64(11)) * 1.1102230246251565e-16


@njit(cache=True, error_model="numpy", nogil=True)
def _trace(
    first: int, last: int, seed: np.uint64, directions: Floats, sizes: Floats, turn: Floats,
    mirrors: Floats, half: float, obstruction: bool, pupil_frame: Floats, aim: Floats,
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, table: Floats,
) -> Floats:  # fmt: skip
    """Sums (2, n) of the weights and of their squares over paths first..last-1, in mm^2."""
    count = directions.shape[0]
    sums = np.zeros((2, count))
    x, w = np.empty(3), np.empty(3)
    start = scrambled(U64(seed))
    cone = 1.0 - sizes[2] * sizes[2]
    for path in range(first, last):
        key = scrambled(start + U64(path) * U64(0xD1342543DE82EF95))
        # From a point of the pupil towards the image, in the three mirrors, of a point in and around the hole.
        radius, angle = math.sqrt(uniform(key, 0)), 2.0 * math.pi * uniform(key, 1)
        u, v = radius * math.cos(angle), radius * math.sin(angle)
        s, t = 2.0 * uniform(key, 2) - 1.0, 2.0 * uniform(key, 3) - 1.0
        square = 0.0
        for c in range(3):
            x[c] = pupil_frame[0, c] + u * pupil_frame[1, c] + v * pupil_frame[2, c]
            w[c] = aim[0, c] + s * aim[1, c] + t * aim[2, c] - x[c]
            square += w[c] * w[c]
        for c in range(3):
            w[c] /= math.sqrt(square)
        cosine = abs(w[0] * pupil_frame[3, 0] + w[1] * pupil_frame[3, 1] + w[2] * pupil_frame[3, 2])
        lost = False
        for m in range(3):
            distance = distance_to(mirrors, m, half, x[0], x[1], x[2], w[0], w[1], w[2])
            if distance == math.inf:
                lost = True
                break
            along = w[0] * mirrors[m, 1, 0] + w[1] * mirrors[m, 1, 1] + w[2] * mirrors[m, 1, 2]
            for c in range(3):
                x[c] += distance * w[c]
                w[c] -= 2.0 * along * mirrors[m, 1, c]
        if lost or w[2] >= 0.0:
            continue
        lx, ly, lz = -w[0], -w[1], -w[2]
        px, py = x[0] + x[2] / lz * w[0], x[1] + x[2] / lz * w[1]
        if abs(px * turn[0] + py * turn[1]) > sizes[3] or abs(py * turn[0] - px * turn[1]) > sizes[3]:
            continue
        dx, dy, dz = sample(kind, params, lx, ly, lz, uniform(key, 4), uniform(key, 5), uniform(key, 6))
        f = bsdf(kind, params, sig, ph, th, table, lx, ly, lz, dx, dy, dz)
        if f == 0.0:
            continue
        # Radiance of 1 through the beam's element of etendue, times what the sample sends along d.
        weight = cosine * lz / square * f * dz / density(kind, params, lx, ly, lz, dx, dy, dz)
        stop = math.inf
        if obstruction:
            for m in range(3):
                stop = min(stop, distance_to(mirrors, m, half, px, py, 0.0, dx, dy, dz))
        for k in range(count):
            ex, ey, ez = directions[k, 0], directions[k, 1], directions[k, 2]
            along = dx * ex + dy * ey + dz * ez
            if along <= 0.0 or along * along < cone:
                continue
            reach = (sizes[0] - px * ex - py * ey) / along
            ax, ay, az = px + reach * dx - sizes[0] * ex, py + reach * dy - sizes[0] * ey, reach * dz - sizes[0] * ez
            if ax * ax + ay * ay + az * az <= sizes[1] * sizes[1] and 0.0 < reach < stop:
                sums[0, k] += weight
                sums[1, k] += weight * weight
    return sums


def _aim(instrument: Instrument, sigma_deg: float, gamma_deg: float) -> Floats:
    """Centre and half sides (3, 3), mm, of the hole's image before mirror 1, a little enlarged."""
    unit = mirrors_at(instrument, sigma_deg)
    cos, sin = hole_turn(gamma_deg)
    half = AIM * 0.5 * instrument.spot_side_mm
    points = [np.zeros(3), half * np.array([cos, sin, 0.0]), half * np.array([-sin, cos, 0.0])]
    for mirror in (2, 1, 0):
        points = [unit.reflect_point(mirror, point) for point in points]
    return np.array([points[0], points[1] - points[0], points[2] - points[0]])


def forward(
    instrument: Instrument,
    sigma_deg: float,
    directions: npt.ArrayLike,
    scatterer: Scatterer,
    paths: int,
    seed: int,
    gamma_deg: float = 0.0,
) -> Estimate:
    """Throughput of detectors in `directions` (n, 3), with standard errors: see `throughput` for what it is.

    A path starts uniformly on the exit pupil towards a region round the hole's image, meets the three mirrors as they
    stand, must fall in the hole, is scattered as the sample scatters, and counts in every detector whose disc it
    crosses within its acceptance cone before a mirror stops it; detectors may overlap. The error is that of the mean of
    the weights, zero included; a detector that no path has met has 0 with error 0, which is no knowledge. Raises
    ValueError for fewer than 2 paths, a negative seed, or wrong directions.
    """
    if paths < 2:
        raise ValueError(f"paths is {paths}: give at least 2, for an error needs two")
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed is {seed}: give a whole number from 0 to 2^64 - 1")
    rows = direction_rows(directions)
    sizes, aim = detector_sizes(instrument), _aim(instrument, sigma_deg, gamma_deg)
    centre, axis_u, axis_v = pupil(instrument)
    radius = instrument.pupil_radius_mm
    frame = np.array([centre, radius * axis_u, radius * axis_v, np.cross(axis_u, axis_v)])
    light, mirrors = hole_turn(gamma_deg), mirrors_at(instrument, sigma_deg).packed
    # Called from Python, a kernel hands an unsigned number back as a plain int: so the seed is scrambled in the kernel.
    start = U64(seed)

    def chunk(first: int) -> Floats:
        sums: Floats = _trace(
            first, min(first + CHUNK, paths), start, rows, sizes, light, mirrors, 0.5 * instrument.mirror_side_mm,
            instrument.obstruction, frame, aim, *scatterer.kernel_arguments,
        )  # fmt: skip
        return sums

    # Plain threads, for the kernel holds no lock: numba's own would add seconds of compilation, and one of its
    # threading layers ends the process when two threads call at once.
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        total = np.zeros((2, rows.shape[0]))
        for sums in pool.map(chunk, range(0, paths, CHUNK)):
            total += sums
    mean = total[0] / paths
    variance = np.maximum(total[1] / paths - mean**2, 0.0) / (paths - 1)
    aimed_mm2 = (AIM * instrument.spot_side_mm) ** 2
    scale = instrument.mirror_reflectance**3 * math.pi * radius**2 * aimed_mm2 * 1e-6
    return Estimate(mean * scale, np.sqrt(variance) * scale, paths)
