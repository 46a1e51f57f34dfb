"""Sums of a lobe over the rays of detectors.

Geometry comes first and is the same for every sample: the rays of each detector (twin.optics.fast.rays). Each lobe is then
summed over these rays.

The values of a Gaussian lobe are `analytic_value` of twin.optics.bsdf.models as one plain loop, which LLVM vectorises. The
angle follows from the chord between lobe axis and observer, which does not cancel near the axis. Arcsine and exponential are
minimax polynomials with errors of 1e-12 or less.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.kinds import GAUSSIAN, LAMBERTIAN
from goniotwin.twin.optics.bsdf.models import bsdf
from goniotwin.twin.optics.bsdf.packed_lobes import KIND, TRANSMITS, Models, model_arrays
from goniotwin.twin.optics.kernel import kernel

LOG2_E = 1.0 / math.log(2.0)
FARTHEST = -1000.0
"""Least exponent of a power of two: smaller ones are replaced by it (1e-301), which avoids denormal numbers."""
BIAS, MANTISSA_BITS = np.int64(1023), np.int64(52)
A0, A1, A2, A3, A4 = 0.999999999999943, 0.16666666671090202, 0.07499999428106169, 0.044643143181678384, 0.030374710191438888
A5, A6, A7, A8, A9 = 0.0224765358692889, 0.0164461237675982, 0.018744129431705087, -0.0030822990518015654, 0.03214532705777029
E0, E1, E2, E3, E4 = 0.9999999999997623, 0.6931471805465146, 0.24022650698880404, 0.05550410939341342, 0.00961812854285181
E5, E6, E7, E8 = 0.001333345206273817, 0.00015403851761890063, 1.5309737273786115e-05, 1.3175854503915213e-06


@kernel(forceinline=True, fastmath={"contract"})
def arcsine(x: float, square: float) -> float:
    """asin(x) for x from 0 to 0.5, with the square of x given too."""
    low = A0 + square * (A1 + square * (A2 + square * (A3 + square * A4)))
    high = A5 + square * (A6 + square * (A7 + square * (A8 + square * A9)))
    return x * (low + square**5 * high)


@kernel(forceinline=True, fastmath={"contract"})
def power_of_two(y: float) -> float:
    """2^y for y from -1000 to 1000."""
    whole = np.int32(np.floor(y + 0.5))
    x = y - whole
    power = np.int64((np.int64(whole) + BIAS) << MANTISSA_BITS).view(np.float64)
    return power * (E0 + x * (E1 + x * (E2 + x * (E3 + x * (E4 + x * (E5 + x * (E6 + x * (E7 + x * E8))))))))


@kernel(nogil=True, fastmath={"contract"})
def gaussian_values(
    peak: float, exponent: float, intensity: bool, ratio: float, transmits: bool, rays: Floats, count: int, values: Floats
) -> None:
    """Fill `values` (at least n) with weight times value of the first `count` = n `rays` (7, at least n), see `lobe_sums`."""
    sign, inverse, scale = -1.0 if transmits else 1.0, 1.0 / ratio, -exponent * LOG2_E
    for i in range(count):
        lx, ly, lz = rays[1, i] * inverse, rays[2, i] * inverse, rays[3, i]
        lit = lz > 0.0
        if ratio != 1.0:
            lz = math.sqrt(max(0.0, 1.0 - lx * lx - ly * ly))
        dx, dy, dz = rays[4, i], rays[5, i], sign * rays[6, i]
        x, y, z = dx + lx, dy + ly, dz - lz
        half2 = 0.25 * (x * x + y * y + z * z)
        half = math.sqrt(half2)
        steep = half > 0.5
        square = 0.5 * (1.0 - min(half, 1.0)) if steep else half2
        root = math.sqrt(square) if steep else half
        angle = 2.0 * arcsine(root, square)
        theta = math.pi - 2.0 * angle if steep else angle
        value = rays[0, i] * peak * power_of_two(max(scale * theta * theta, FARTHEST))
        value = value / dz if intensity else value
        values[i] = value if lit & (lz > 0.0) & (dz > 0.0) else 0.0


@kernel(nogil=True)
def lambertian_values(value: float, transmits: bool, rays: Floats, count: int, values: Floats) -> None:
    """`gaussian_values` of a lobe with the same value in all directions of its side."""
    for i in range(count):
        values[i] = rays[0, i] * value if (rays[6, i] < 0.0) == transmits else 0.0


@kernel(nogil=True)
def add_values(values: Floats, first: int, count: int, sums: Floats, row: int, start: int) -> None:
    """Add `count` = n `values` from `first` on to a row of `sums` (rows, at least start + n) from `start` on."""
    for k in range(count):
        sums[row, start + k] += values[first + k]


@kernel(nogil=True)
def lobe_sums(
    models: Models, lobe: int, rays: Floats, each: int, count: int, values: Floats, sums: Floats, row: int, start: int,
    general: bool | None,
) -> None:  # fmt: skip
    """Add sums of weight times value of a lobe over `each` rays of n detectors to a row of `sums`, from `start` on.

    `sums` (rows, at least start + n); `count` is n. `rays` (7, at least n each) has the first ray of every detector, then the
    second of every one, and so on. `values` (at least n each) is a buffer. With `general` None, see `score_scenes`, there are
    GAUSSIAN and LAMBERTIAN lobes alone.

    A slice, and an array that a function with branches takes, is counted as a reference, which costs as much as five rays:
    therefore rows and numbers are arguments, and a loop over rays calls the functions above.
    """
    kind, params, transmits = models.heads[lobe, KIND], models.params, models.heads[lobe, TRANSMITS] == 1
    if kind == GAUSSIAN:
        gaussian_values(
            params[lobe, 0], params[lobe, 1], params[lobe, 2] == 1.0, params[lobe, 4], transmits, rays, each * count, values
        )
    elif kind == LAMBERTIAN:
        lambertian_values(params[lobe, 0], transmits, rays, each * count, values)
    elif general is not None:
        _, own, sig, ph, th, psi, table = model_arrays(models, lobe)
        for ray in range(each * count):
            lit = (rays[6, ray] < 0.0) == transmits and rays[0, ray] > 0.0
            values[ray] = 0.0
            if lit:
                values[ray] = rays[0, ray] * bsdf(
                    kind, own, sig, ph, th, psi, table,
                    rays[1, ray], rays[2, ray], rays[3, ray], rays[4, ray], rays[5, ray], abs(rays[6, ray]),
                )  # fmt: skip
    for i in range(each):
        add_values(values, i * count, count, sums, row, start)
