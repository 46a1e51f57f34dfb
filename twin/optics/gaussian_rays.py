"""A Gaussian lobe's values over many rays: `analytic` of twin.optics.bsdf as one plain loop, of which LLVM makes vectors.

The angle is that of the chord between lobe axis and observer, which does not cancel near the axis; arcsine and exponential are
polynomials fitted by least maximum error, to 1e-12 and better.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.kernel import kernel

LOG2_E = 1.0 / math.log(2.0)
FARTHEST = -1000.0
"""Powers of two below this are taken for it: 1e-301, and no number that is not normal."""
BIAS, MANTISSA_BITS = np.int64(1023), np.int64(52)
A0, A1, A2, A3, A4 = 0.999999999999943, 0.16666666671090202, 0.07499999428106169, 0.044643143181678384, 0.030374710191438888
A5, A6, A7, A8, A9 = 0.0224765358692889, 0.0164461237675982, 0.018744129431705087, -0.0030822990518015654, 0.03214532705777029
E0, E1, E2, E3, E4 = 0.9999999999997623, 0.6931471805465146, 0.24022650698880404, 0.05550410939341342, 0.00961812854285181
E5, E6, E7, E8 = 0.001333345206273817, 0.00015403851761890063, 1.5309737273786115e-05, 1.3175854503915213e-06


@kernel(inline="always")
def arcsine(x: float, square: float) -> float:
    """asin(x) for x from 0 to a half, by its square too."""
    low = A0 + square * (A1 + square * (A2 + square * (A3 + square * A4)))
    high = A5 + square * (A6 + square * (A7 + square * (A8 + square * A9)))
    return x * (low + square**5 * high)


@kernel(inline="always")
def power_of_two(y: float) -> float:
    """2^y for y from -1000 to 1000."""
    whole = np.int32(np.floor(y + 0.5))
    x = y - whole
    power = np.int64((np.int64(whole) + BIAS) << MANTISSA_BITS).view(np.float64)
    return power * (E0 + x * (E1 + x * (E2 + x * (E3 + x * (E4 + x * (E5 + x * (E6 + x * (E7 + x * E8))))))))


@kernel(nogil=True, fastmath={"contract"})
def gaussian_values(
    peak: float, exponent: float, intensity: bool, ratio: float, transmits: bool, rays: Floats, values: Floats
) -> None:
    """Fills `values` (n,) with weight times value of the first n `rays` (7, at least n), as `lobe_sums` has them."""
    way, inverse, scale = -1.0 if transmits else 1.0, 1.0 / ratio, -exponent * LOG2_E
    for i in range(values.size):
        lx, ly, lz = rays[1, i] * inverse, rays[2, i] * inverse, rays[3, i]
        lit = lz > 0.0
        if ratio != 1.0:
            lz = math.sqrt(max(0.0, 1.0 - lx * lx - ly * ly))
        dx, dy, dz = rays[4, i], rays[5, i], way * rays[6, i]
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
