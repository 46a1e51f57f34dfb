"""Forward paths from the source over the three real mirrors into the hole, a block at a time.

The paths of a block are in one buffer of single precision, with a row for each coordinate. All rows have the same length, a
constant of the compiled code, so LLVM can prove that they do not overlap, and vectorises each pass: 5 ns per path in total.
Everything is in the sample's frame (twin.optics.geometry.scene), with mirrors at their places and not unfolded. Random numbers
for the points on the pupil and in the hole have 16 bits: 0.1 micrometres.
"""

from typing import NamedTuple

import numpy as np

from goniotwin.arrays import Floats, Singles, Words
from goniotwin.twin.optics.forward.elementary import cosine_and_sine
from goniotwin.twin.optics.illumination.slit_image import LINES, SlitImage, relative_radiance
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.montecarlo import high_16, low_16, word

BLOCK = 2048
F32 = np.float32
ONE, TWO, ZERO = np.float32(1.0), np.float32(2.0), np.float32(0.0)
# Start of each row in the buffer. Position and direction of the arriving ray, then those of the scattered ray.
X, Y, Z, WX, WY, WZ = (row * BLOCK for row in range(6))
FLUX, PX, PY, DX, DY, DZ, WEIGHT, STOP = (row * BLOCK for row in range(6, 14))
ROWS = 14
# Size of the target area relative to the hole; the hole itself then decides which rays pass.
MARGIN = 1.002


class Beam(NamedTuple):
    """Light on the sample, lengths in mm.

    `pupil` (4, 3): centre, two axes as long as its radius, and its normal along the light. `aim` (3, 3): the images, in the
    three mirrors, of the hole's centre and of its half sides. `mirrors` (3, 4, 3). `reflectance` (3, 2): that of each mirror
    for cosine c is r[0] + r[1] c. Half sides of mirrors, hole and frames; the frames' gap. `light` is what the illumination
    unit sends from the pupil into the hole. `rays` (n, 6) and `flux` (n,) replace both, if there are any.
    """

    pupil: Floats
    aim: Floats
    mirrors: Floats
    reflectance: Floats
    mirror_half: float
    hole_half: float
    frame_half: float
    gap: float
    light: SlitImage
    rays: Floats
    flux: Floats


@kernel(fastmath={"contract"})
def aim_at_hole(buffer: Singles, count: int, key: np.uint32) -> None:
    """Fill PX, PY with points of the hole, in units of its half side, and slightly beyond."""
    for i in range(count):
        bits = word(key, i)
        buffer[i + PX] = (TWO * low_16(bits) - ONE) * F32(MARGIN)
        buffer[i + PY] = (TWO * high_16(bits) - ONE) * F32(MARGIN)


@kernel()
def aim_beside_hole(buffer: Singles, count: int, key: np.uint32, lit: float) -> None:
    """Fill PX, PY with points of the square `lit` times as wide, without the hole: four equal rectangles like a windmill."""
    for i in range(count):
        bits = word(key, i)
        s, t = F32(-1.0) + (F32(lit) + ONE) * low_16(bits), ONE + (F32(lit) - ONE) * high_16(bits)
        quarter = i & 3
        if quarter & 1:
            s, t = -t, s
        if quarter & 2:
            s, t = -s, -t
        buffer[i + PX], buffer[i + PY] = s, t


@kernel(fastmath={"contract"})
def leave_pupil(buffer: Singles, count: int, key: np.uint32, pupil: Floats, aim: Floats) -> None:
    """Rays from uniform points of the pupil to PX, PY; FLUX is the cosine at the pupil over the squared length, 1/mm^2."""
    p00, p01, p02 = F32(pupil[0, 0]), F32(pupil[0, 1]), F32(pupil[0, 2])
    p10, p11, p12 = F32(pupil[1, 0]), F32(pupil[1, 1]), F32(pupil[1, 2])
    p20, p21, p22 = F32(pupil[2, 0]), F32(pupil[2, 1]), F32(pupil[2, 2])
    p30, p31, p32 = F32(pupil[3, 0]), F32(pupil[3, 1]), F32(pupil[3, 2])
    a00, a01, a02 = F32(aim[0, 0]), F32(aim[0, 1]), F32(aim[0, 2])
    a10, a11, a12 = F32(aim[1, 0]), F32(aim[1, 1]), F32(aim[1, 2])
    a20, a21, a22 = F32(aim[2, 0]), F32(aim[2, 1]), F32(aim[2, 2])
    for i in range(count):
        bits = word(key, i)
        radius = np.sqrt(low_16(bits))
        cos, sin = cosine_and_sine(high_16(bits))
        u, v, s, t = radius * cos, radius * sin, buffer[i + PX], buffer[i + PY]
        x, y, z = p00 + u * p10 + v * p20, p01 + u * p11 + v * p21, p02 + u * p12 + v * p22
        wx, wy, wz = a00 + s * a10 + t * a20 - x, a01 + s * a11 + t * a21 - y, a02 + s * a12 + t * a22 - z
        inverse = ONE / np.sqrt(wx * wx + wy * wy + wz * wz)
        wx, wy, wz = wx * inverse, wy * inverse, wz * inverse
        buffer[i + X], buffer[i + Y], buffer[i + Z] = x, y, z
        buffer[i + WX], buffer[i + WY], buffer[i + WZ] = wx, wy, wz
        buffer[i + FLUX] = (wx * p30 + wy * p31 + wz * p32) * inverse * inverse


@kernel(fastmath={"contract"})
def stop_at_slit(buffer: Singles, count: int, key: np.uint32, edge: Floats, half: float) -> None:
    """Rays from the pupil to PX, PY that are beyond an `edge` (3, 3) of the slit's image have no flux from then on.

    `key` is that of `leave_pupil`; `half` is the hole's half side.
    """
    e00, e01, e02 = F32(edge[0, 0]), F32(half * edge[0, 1]), F32(half * edge[0, 2])
    e10, e11, e12 = F32(edge[1, 0]), F32(half * edge[1, 1]), F32(half * edge[1, 2])
    e20, e21, e22 = F32(edge[2, 0]), F32(half * edge[2, 1]), F32(half * edge[2, 2])
    for i in range(count):
        bits = word(key, i)
        radius = np.sqrt(low_16(bits))
        cos, sin = cosine_and_sine(high_16(bits))
        a, b, s, t = radius * cos, radius * sin, buffer[i + PX], buffer[i + PY]
        inside = e00 + e01 * s + e02 * t + a * (e10 + e11 * s + e12 * t) + b * (e20 + e21 * s + e22 * t)
        buffer[i + FLUX] = buffer[i + FLUX] if inside >= ZERO else ZERO


@kernel()
def weigh_paths(buffer: Singles, count: int, key: np.uint32, light: SlitImage, half: float) -> None:
    """Multiply FLUX of rays from the pupil to PX, PY by the relative radiance of the illumination unit along them."""
    for i in range(count):
        if buffer[i + FLUX] > ZERO:
            bits = word(key, i)
            radius = np.sqrt(low_16(bits))
            cos, sin = cosine_and_sine(high_16(bits))
            a, b = np.float64(radius * cos), np.float64(radius * sin)
            u, v = half * np.float64(buffer[i + PX]), half * np.float64(buffer[i + PY])
            buffer[i + FLUX] = F32(np.float64(buffer[i + FLUX]) * relative_radiance(light, a, b, u, v))


@kernel()
def leave_rays(buffer: Singles, count: int, key: np.uint32, rays: Floats, flux: Floats) -> None:
    """Rays of a rayset, each with the same probability; FLUX is the ray's own."""
    for i in range(count):
        k = (np.int64(word(key, i)) * np.int64(rays.shape[0])) >> 32
        buffer[i + X], buffer[i + Y], buffer[i + Z] = rays[k, 0], rays[k, 1], rays[k, 2]
        buffer[i + WX], buffer[i + WY], buffer[i + WZ] = rays[k, 3], rays[k, 4], rays[k, 5]
        buffer[i + FLUX] = flux[k]


@kernel(fastmath={"contract"})
def reflect_at_mirror(buffer: Singles, count: int, mirror: Floats, half: float, reflectance: Floats) -> None:
    """Propagate the rays to a mirror and reflect them; one that misses it has no flux from then on."""
    cx, cy, cz = F32(mirror[0, 0]), F32(mirror[0, 1]), F32(mirror[0, 2])
    nx, ny, nz = F32(mirror[1, 0]), F32(mirror[1, 1]), F32(mirror[1, 2])
    ux, uy, uz = F32(mirror[2, 0]), F32(mirror[2, 1]), F32(mirror[2, 2])
    vx, vy, vz = F32(mirror[3, 0]), F32(mirror[3, 1]), F32(mirror[3, 2])
    limit, r0, r1 = F32(half), F32(reflectance[0]), F32(reflectance[1])
    for i in range(count):
        x, y, z = buffer[i + X] - cx, buffer[i + Y] - cy, buffer[i + Z] - cz
        wx, wy, wz = buffer[i + WX], buffer[i + WY], buffer[i + WZ]
        along = wx * nx + wy * ny + wz * nz
        distance = -(x * nx + y * ny + z * nz) / along
        x, y, z = x + distance * wx, y + distance * wy, z + distance * wz
        u, v = abs(x * ux + y * uy + z * uz), abs(x * vx + y * vy + z * vz)
        met = (u <= limit) & (v <= limit) & (distance > ZERO) & (along < ZERO)
        buffer[i + FLUX] = buffer[i + FLUX] * (r0 - r1 * along) if met else ZERO
        buffer[i + X], buffer[i + Y], buffer[i + Z] = x + cx, y + cy, z + cz
        along = TWO * along
        buffer[i + WX], buffer[i + WY], buffer[i + WZ] = wx - along * nx, wy - along * ny, wz - along * nz


@kernel(fastmath={"contract"})
def land(buffer: Singles, count: int, hole: float, frame: float, gap: float, inside: bool, project: bool) -> None:
    """Propagate the rays to the frame's plane, and those in the hole on to the sample: PX, PY are their points there.

    `inside` keeps the rays through the hole; without it the rays that land on the frame are kept, at their points there. With
    `project` FLUX is multiplied by the cosine to the normal.
    """
    limit, edge, height = F32(hole), F32(frame), F32(gap)
    for i in range(count):
        wx, wy, wz = buffer[i + WX], buffer[i + WY], buffer[i + WZ]
        down = ONE / wz
        x, y = buffer[i + X] - (buffer[i + Z] - height) * down * wx, buffer[i + Y] - (buffer[i + Z] - height) * down * wy
        hit = (abs(x) <= limit) & (abs(y) <= limit)
        if inside:
            x, y = x - height * down * wx, y - height * down * wy
        else:
            hit = not hit
        hit = hit & (abs(x) <= edge) & (abs(y) <= edge) & (wz < ZERO)
        flux = buffer[i + FLUX]
        if project:
            flux = -flux * wz
        buffer[i + PX], buffer[i + PY] = x, y
        buffer[i + FLUX] = flux if hit else ZERO


@kernel()
def trace_to_sample(buffer: Singles, count: int, keys: Words, beam: Beam, inside: bool, lit: float) -> None:
    """All steps: rays into the hole or, without `inside`, onto the frame around it; `keys` (2,) for the two words of a path."""
    uniform_pupil = beam.rays.shape[0] == 0
    if not uniform_pupil:
        leave_rays(buffer, count, keys[0], beam.rays, beam.flux)
    else:
        if inside:
            aim_at_hole(buffer, count, keys[0])
        else:
            aim_beside_hole(buffer, count, keys[0], lit)
        leave_pupil(buffer, count, keys[1], beam.pupil, beam.aim)
        if inside and not beam.light.everywhere:
            for k in range(LINES):
                stop_at_slit(buffer, count, keys[1], beam.light.edges[k], beam.hole_half)
        if inside and not beam.light.slit.even:
            weigh_paths(buffer, count, keys[1], beam.light, beam.hole_half)
    for m in range(3):
        reflect_at_mirror(buffer, count, beam.mirrors[m], beam.mirror_half, beam.reflectance[m])
    land(buffer, count, beam.hole_half, beam.frame_half, beam.gap, inside, uniform_pupil)
