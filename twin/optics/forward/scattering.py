"""Scattering at the sample: a direction and a weight for each path of a block, and the first surface on its way.

A weight is flux times value times cosine over the density of the draw. A share of a Gaussian's paths follows its shape, the
others the cosine, so that detectors far from the lobe receive paths too; the density is that of both together. Lambertian and
Gaussian lobes are drawn in single precision and in vectorised loops, with 24 bits for each angle; all others by
twin.optics.bsdf.sampling, path by path.
"""

import math

import numpy as np

from goniotwin.arrays import Floats, Singles, Words
from goniotwin.twin.optics.bsdf.packed_lobes import TRANSMITS, Lobes, cells_of, model_arrays
from goniotwin.twin.optics.bsdf.sampling import scatter
from goniotwin.twin.optics.forward.elementary import arcsine, cosine, cosine_and_sine, exp_minus, minus_log, sine_ratio
from goniotwin.twin.optics.forward.paths import DX, DY, DZ, FLUX, PX, PY, STOP, WEIGHT, WX, WY, WZ
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.montecarlo import circle_point, item_key, uniform, upper_24, word

F32 = np.float32
U64 = np.uint64
ONE, TWO, ZERO, HALF, QUARTER = (np.float32(x) for x in (1.0, 2.0, 0.0, 0.5, 0.25))
TINY = np.float32(1e-30)


@kernel(fastmath={"contract"})
def leave_by_cosine(buffer: Singles, count: int, keys: Words, transmits: bool, gain: float) -> None:
    """Draw directions by Lambert's law, with the two words of `keys` (2,); the weight is FLUX times `gain`."""
    factor, way = F32(gain), F32(-1.0 if transmits else 1.0)
    for i in range(count):
        height = upper_24(word(keys[0], i))
        cos, sin = cosine_and_sine(upper_24(word(keys[1], i)))
        radius = np.sqrt(height)
        buffer[i + DX], buffer[i + DY], buffer[i + DZ] = radius * cos, radius * sin, way * np.sqrt(ONE - height)
        buffer[i + WEIGHT] = buffer[i + FLUX] * factor


@kernel(fastmath={"contract"})
def leave_by_lobe(buffer: Singles, count: int, keys: Words, params: Floats, share: float, transmits: bool, gain: float) -> None:
    """Draw directions by the shape of a Gaussian lobe (twin.optics.bsdf.models); `share` of its paths do.

    The weight is as in the module.
    """
    peak, inverse, cut = F32(params[0] * gain), F32(1.0 / params[1]), F32(params[3])
    intensity, ratio = params[2] == 1.0, F32(1.0 / params[4])
    lobe, rest = F32(share * params[1] / (math.pi * params[3])), F32((1.0 - share) / math.pi)
    way = F32(-1.0 if transmits else 1.0)
    for i in range(count):
        below = ONE - upper_24(word(keys[0], i)) * cut
        cos, sin = cosine_and_sine(upper_24(word(keys[1], i)))
        square = max(minus_log(below), ZERO) * inverse
        half = QUARTER * square
        sinc, cos_half = sine_ratio(half), cosine(half)
        # sin(theta) / theta, sin(theta) and cos(theta), from the half angle
        stretch = sinc * cos_half
        sine, along = np.sqrt(square) * stretch, TWO * cos_half * cos_half - ONE
        lx, ly, lz = -buffer[i + WX] * ratio, -buffer[i + WY] * ratio, -buffer[i + WZ]
        across = lx * lx + ly * ly
        lz = np.sqrt(max(ONE - across, ZERO)) if ratio != ONE else lz
        turn = ONE / np.sqrt(max(across, TINY))
        ux, uy = (lx * turn, ly * turn) if across > TINY else (ONE, ZERO)
        radial = lz * sine * cos - across * turn * along
        dz = across * turn * sine * cos + lz * along
        buffer[i + DX], buffer[i + DY] = radial * ux - sine * sin * uy, radial * uy + sine * sin * ux
        buffer[i + DZ] = way * dz
        value = peak * below
        scattered = value if intensity else value * dz
        density = lobe * below / stretch + rest * dz
        weight = buffer[i + FLUX] * scattered / density
        buffer[i + WEIGHT] = weight if (dz > ZERO) & (lz > ZERO) else ZERO


@kernel(fastmath={"contract"})
def weigh_lobe(buffer: Singles, count: int, params: Floats, share: float, transmits: bool, gain: float) -> None:
    """Weights for a Gaussian lobe of paths that were drawn by the cosine; `share` of the lobe's paths follow its shape."""
    peak, exponent = F32(params[0] * gain), F32(params[1])
    intensity, ratio = params[2] == 1.0, F32(1.0 / params[4])
    lobe, rest = F32(share * params[1] / (math.pi * params[3])), F32((1.0 - share) / math.pi)
    way = F32(-1.0 if transmits else 1.0)
    for i in range(count):
        lx, ly, lz = -buffer[i + WX] * ratio, -buffer[i + WY] * ratio, -buffer[i + WZ]
        lz = np.sqrt(max(ONE - lx * lx - ly * ly, ZERO)) if ratio != ONE else lz
        dz = way * buffer[i + DZ]
        ax, ay, az = buffer[i + DX] + lx, buffer[i + DY] + ly, dz - lz
        # The chord between lobe axis and direction: no cancellation near the axis.
        sine_half = HALF * np.sqrt(ax * ax + ay * ay + az * az)
        theta = TWO * arcsine(sine_half)
        sine = TWO * sine_half * np.sqrt(max(ONE - sine_half * sine_half, TINY))
        stretch = theta / sine if sine_half > F32(1e-4) else ONE
        below = exp_minus(exponent * theta * theta)
        value = peak * below
        scattered = value if intensity else value * dz
        density = lobe * below * stretch + rest * dz
        weight = buffer[i + FLUX] * scattered / density
        buffer[i + WEIGHT] = weight if (dz > ZERO) & (lz > ZERO) else ZERO


@kernel(fastmath={"contract"})
def stop_at_mirror(buffer: Singles, count: int, height: float, mirror: Floats, half: float) -> None:
    """Set STOP to the distance to a mirror, from points `height` above the sample, if that is smaller."""
    cx, cy, cz = F32(mirror[0, 0]), F32(mirror[0, 1]), F32(mirror[0, 2] - height)
    nx, ny, nz = F32(mirror[1, 0]), F32(mirror[1, 1]), F32(mirror[1, 2])
    ux, uy, uz = F32(mirror[2, 0]), F32(mirror[2, 1]), F32(mirror[2, 2])
    vx, vy, vz = F32(mirror[3, 0]), F32(mirror[3, 1]), F32(mirror[3, 2])
    limit = F32(half)
    for i in range(count):
        x, y, z = buffer[i + PX] - cx, buffer[i + PY] - cy, -cz
        dx, dy, dz = buffer[i + DX], buffer[i + DY], buffer[i + DZ]
        distance = -(x * nx + y * ny + z * nz) / (dx * nx + dy * ny + dz * nz)
        x, y, z = x + distance * dx, y + distance * dy, z + distance * dz
        u, v, stop = abs(x * ux + y * uy + z * uz), abs(x * vx + y * vy + z * vz), buffer[i + STOP]
        met = (u <= limit) & (v <= limit) & (distance > ZERO) & (distance < stop)
        buffer[i + STOP] = distance if met else stop


@kernel(fastmath={"contract"})
def stop_at_frame(buffer: Singles, count: int, hole: float, gap: float) -> None:
    """Set STOP to the distance to the frame's side that faces the sample, if that is smaller."""
    limit, height = F32(hole), F32(gap)
    for i in range(count):
        distance = height / abs(buffer[i + DZ])
        x, y = buffer[i + PX] + distance * buffer[i + DX], buffer[i + PY] + distance * buffer[i + DY]
        free = (abs(x) <= limit) & (abs(y) <= limit)
        stop = buffer[i + STOP]
        buffer[i + STOP] = stop if free else min(stop, distance)


@kernel()
def reset_stops(buffer: Singles, count: int) -> None:
    """Set STOP to infinity."""
    for i in range(count):
        buffer[i + STOP] = F32(np.inf)


@kernel()
def path_key(key: np.uint64, stratum: int, i: int) -> np.uint64:
    """Key of one path of a block, for numbers that are drawn path by path."""
    return item_key(key, stratum * 65536 + i + 1)


@kernel()
def leave_frame(buffer: Singles, count: int, key: np.uint64, stratum: int, gain: float) -> None:
    """Draw directions from the frame by Lambert's law, with two numbers of each path; the weight is FLUX times `gain`."""
    factor = F32(gain)
    for i in range(count):
        own = path_key(key, stratum, i)
        square = uniform(own, 0)
        cos, sin = circle_point(uniform(own, 1))
        radius = math.sqrt(square)
        buffer[i + DX], buffer[i + DY], buffer[i + DZ] = radius * cos, radius * sin, math.sqrt(1.0 - square)
        buffer[i + WEIGHT] = buffer[i + FLUX] * factor


@kernel()
def leave_by_model(buffer: Singles, count: int, key: np.uint64, stratum: int, which: int, gain: float, lobes: Lobes) -> None:
    """Draw directions of any lobe, one path after the other: number `which` of the packed ones."""
    model, cells = model_arrays(lobes.models, which), cells_of(lobes.models, which)
    # Outside the loop: numba counts a reference to each array that is taken from a tuple.
    kind, params, sig = model.kind, model.params, model.sigma_deg
    ph, th, psi, table = model.phi_deg, model.theta_deg, model.psi_deg, model.table
    transmits = lobes.models.heads[which, TRANSMITS] == 1
    for i in range(count):
        own = path_key(key, stratum, i)
        lx, ly, lz = -np.float64(buffer[i + WX]), -np.float64(buffer[i + WY]), -np.float64(buffer[i + WZ])
        dx, dy, dz, weight = scatter(
            kind,
            params,
            sig,
            ph,
            th,
            psi,
            table,
            cells,
            lx,
            ly,
            lz,
            uniform(own, 0),
            uniform(own, 1),
            uniform(own, 2),
        )
        buffer[i + DX], buffer[i + DY], buffer[i + DZ] = dx, dy, -dz if transmits else dz
        buffer[i + WEIGHT] = buffer[i + FLUX] * weight * gain
