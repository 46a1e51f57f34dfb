"""The scattering models as kernels: value, sampling and density, each for one pair of directions.

A model is a code, four parameters and a table (arrays of one element where there is none), so that every sample has the
same types and each kernel is compiled once. Vectors are unit vectors from the sample: l towards the light, d towards
the observer, z the sample's normal. Both must be in front (z > 0); otherwise the value is zero.

- LAMBERTIAN: params[0] is the value in 1/sr.
- GAUSSIAN: params[0] is the peak in 1/sr, params[1] the factor of theta^2 in the exponent (1/rad^2), params[2] is 1
  where the Gaussian is the intensity, so that its value is divided by the cosine of d, params[3] the share of a lobe
  cut at 180 deg.
- TABLE: table[0, sigma, phi, theta] in 1/sr, table[1] its slopes over sigma in 1/(sr deg). phi runs over 180 deg (mirrored
  in the plane of incidence) or 360 deg.
"""

import math

import numpy as np
from numba import njit

from twin.optics.frames import Floats

LAMBERTIAN = 0
GAUSSIAN = 1
TABLE = 2

# Of a Gaussian's samples. The others are drawn by the cosine law, so that directions far off the lobe get theirs too.
LOBE_SHARE = 0.75


@njit(cache=True, error_model="numpy")
def _place(axis: Floats, x: float) -> tuple[int, float]:
    """Interval of an ascending axis that holds x, and the share of the way through it; held at both ends."""
    last = axis.size - 1
    if last == 0 or x <= axis[0]:
        return 0, 0.0
    if x >= axis[last]:
        return last - 1, 1.0
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if axis[middle] <= x:
            low = middle
        else:
            high = middle
    return low, (x - axis[low]) / (axis[low + 1] - axis[low])


@njit(cache=True, error_model="numpy")
def tabular(
    sig: Floats, ph: Floats, th: Floats, table: Floats,
    lx: float, ly: float, lz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """`bsdf` of a table: cubic in sigma, linear in phi and theta; the first and last of each list hold outside of it."""
    if lz <= 0.0 or dz <= 0.0:
        return 0.0
    sine = math.sqrt(lx * lx + ly * ly)
    # At normal incidence the plane of incidence is the rig's, as for any other sigma.
    ux, uy = (lx / sine, ly / sine) if sine > 0.0 else (1.0, 0.0)
    radial = ux * dx + uy * dy
    inward, across, along = lz * radial + sine * dz, ux * dy - uy * dx, lz * dz - sine * radial
    theta = math.degrees(math.atan2(math.sqrt(inward * inward + across * across), along))
    phi = math.degrees(math.atan2(across, inward))
    if ph[ph.size - 1] <= 180.0:
        phi = abs(phi)
    elif phi < 0.0:
        phi += 360.0
    i, a = _place(sig, math.degrees(math.atan2(sine, lz)))
    j, b = _place(ph, phi)
    k, c = _place(th, theta)
    i1, j1, k1 = min(i + 1, sig.size - 1), min(j + 1, ph.size - 1), min(k + 1, th.size - 1)
    # Hermite's basis: value and slope at both ends of the interval.
    step = sig[i1] - sig[i]
    rest = 1.0 - a
    weights = (rest * rest * (1.0 + 2.0 * a), a * a * (3.0 - 2.0 * a), step * a * rest * rest, -step * a * a * rest)
    total = 0.0
    for term in range(4):
        part, m = term // 2, i if term % 2 == 0 else i1
        near = (1.0 - c) * table[part, m, j, k] + c * table[part, m, j, k1]
        far = (1.0 - c) * table[part, m, j1, k] + c * table[part, m, j1, k1]
        total += weights[term] * ((1.0 - b) * near + b * far)
    return total


@njit(cache=True, error_model="numpy", forceinline=True)
def analytic(
    kind: int, peak: float, exponent: float, intensity: float,
    lx: float, ly: float, lz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """`bsdf` of the models without a table, their parameters one by one.

    Loops call this themselves: handing arrays to a function costs numba's reference counts, ten times what the model
    does.
    """
    if lz <= 0.0 or dz <= 0.0:
        return 0.0
    if kind == LAMBERTIAN:
        return peak
    theta = math.acos(min(1.0, max(-1.0, lz * dz - lx * dx - ly * dy)))
    value = peak * math.exp(-exponent * theta * theta)
    return value / dz if intensity == 1.0 else value


@njit(cache=True, error_model="numpy")
def bsdf(
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, table: Floats,
    lx: float, ly: float, lz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Value in 1/sr for light from l and an observer at d."""
    if kind == TABLE:
        return tabular(sig, ph, th, table, lx, ly, lz, dx, dy, dz)
    return analytic(kind, params[0], params[1], params[2], lx, ly, lz, dx, dy, dz)


@njit(cache=True, error_model="numpy")
def density(kind: int, params: Floats, lx: float, ly: float, lz: float, dx: float, dy: float, dz: float) -> float:
    """Of the directions that `sample` draws, in 1/sr."""
    cosine = max(dz, 0.0) / math.pi
    if kind != GAUSSIAN:
        return cosine
    theta = math.acos(min(1.0, max(-1.0, lz * dz - lx * dx - ly * dy)))
    # The lobe is drawn as a plane Gaussian wrapped onto the sphere: theta / sin(theta) is the stretch.
    stretch = theta / math.sin(theta) if theta > 1e-9 else 1.0
    lobe = params[1] / (math.pi * params[3]) * math.exp(-params[1] * theta * theta) * stretch
    return LOBE_SHARE * lobe + (1.0 - LOBE_SHARE) * cosine  # type: ignore[no-any-return]


@njit(cache=True, error_model="numpy")
def sample(
    kind: int, params: Floats, lx: float, ly: float, lz: float, u: float, v: float, choice: float
) -> tuple[float, float, float]:
    """A direction for three uniform numbers in [0, 1); it may point below the surface, where nothing is scattered."""
    turn = 2.0 * math.pi * v
    if kind != GAUSSIAN or choice >= LOBE_SHARE:
        radius = math.sqrt(u)
        return radius * math.cos(turn), radius * math.sin(turn), math.sqrt(1.0 - u)
    theta = math.sqrt(-math.log(1.0 - u * params[3]) / params[1])
    sine = math.sqrt(lx * lx + ly * ly)
    ux, uy = (lx / sine, ly / sine) if sine > 0.0 else (1.0, 0.0)
    inward, across, along = math.sin(theta) * math.cos(turn), math.sin(theta) * math.sin(turn), math.cos(theta)
    radial = lz * inward - sine * along
    return radial * ux - across * uy, radial * uy + across * ux, sine * inward + lz * along


@njit(cache=True, error_model="numpy")
def evaluate_all(
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, table: Floats, light: Floats, observer: Floats
) -> Floats:
    """`bsdf` of rows (n, 3) of directions."""
    result = np.empty(light.shape[0])
    for i in range(light.shape[0]):
        result[i] = bsdf(
            kind, params, sig, ph, th, table,
            light[i, 0], light[i, 1], light[i, 2], observer[i, 0], observer[i, 1], observer[i, 2],
        )  # fmt: skip
    return result
