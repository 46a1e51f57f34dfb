"""Sums of a lobe over the rays of detectors.

Geometry comes first and is the same for every sample: the rays of each detector (twin.optics.fast.rays). Each lobe is then
summed over these rays.

The values of a Gaussian lobe (paper, formula 6; optics.md, section 4) are `analytic_value` of twin.optics.bsdf.models as
one plain loop, which LLVM vectorises. The angle follows from the chord between lobe axis and observer, which does not
cancel near the axis. Arcsine and exponential are minimax polynomials with errors of 1e-12 or less.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.kinds import GAUSSIAN, LAMBERTIAN
from goniotwin.twin.optics.bsdf.models import bsdf
from goniotwin.twin.optics.bsdf.packed_lobes import KIND, TRANSMITS, Models, model_arrays
from goniotwin.twin.optics.fast.detector_block import LIGHT, OBSERVER, WEIGHT, Block, X, Y, Z, whole_lanes
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
    """Fill `values` (at least n) with weight times value of the first `count` = n `rays` (7, at least n), see `add_lobe`."""
    sign, inverse, scale = -1.0 if transmits else 1.0, 1.0 / ratio, -exponent * LOG2_E
    for i in range(count):
        lx, ly, lz = rays[LIGHT + X, i] * inverse, rays[LIGHT + Y, i] * inverse, rays[LIGHT + Z, i]
        lit = lz > 0.0
        if ratio != 1.0:
            lz = math.sqrt(max(0.0, 1.0 - lx * lx - ly * ly))
        dx, dy, dz = rays[OBSERVER + X, i], rays[OBSERVER + Y, i], sign * rays[OBSERVER + Z, i]
        x, y, z = dx + lx, dy + ly, dz - lz
        half2 = 0.25 * (x * x + y * y + z * z)
        half = math.sqrt(half2)
        steep = half > 0.5
        square = 0.5 * (1.0 - min(half, 1.0)) if steep else half2
        root = math.sqrt(square) if steep else half
        angle = 2.0 * arcsine(root, square)
        theta = math.pi - 2.0 * angle if steep else angle
        value = rays[WEIGHT, i] * peak * power_of_two(max(scale * theta * theta, FARTHEST))
        value = value / dz if intensity else value
        values[i] = value if lit & (lz > 0.0) & (dz > 0.0) else 0.0


@kernel(nogil=True)
def add_lobe(models: Models, lobe: int, block: Block, sums: Floats) -> None:
    """Add weight times value of a lobe for the first n rays in `block` to `sums` (n,).

    They are one ray of each detector, or a tile of one detector's rays.
    """
    kind, params, transmits, rays = models.heads[lobe, KIND], models.params, models.heads[lobe, TRANSMITS] == 1, block.ray
    if kind == GAUSSIAN:
        intensity = params[lobe, 2] == 1.0
        gaussian_values(
            params[lobe, 0], params[lobe, 1], intensity, params[lobe, 4], transmits, rays, whole_lanes(sums.size), block.value
        )
    elif kind == LAMBERTIAN:
        for i in range(sums.size):
            block.value[i] = rays[WEIGHT, i] * params[lobe, 0] if (rays[OBSERVER + Z, i] < 0.0) == transmits else 0.0
    else:
        model = model_arrays(models, lobe)
        # Outside the loop: numba counts a reference to each array that is taken from a tuple.
        own, sig, ph = model.params, model.sigma_deg, model.phi_deg
        th, psi, table = model.theta_deg, model.psi_deg, model.table
        for i in range(sums.size):
            block.value[i] = 0.0
            if (rays[OBSERVER + Z, i] < 0.0) == transmits and rays[WEIGHT, i] > 0.0:
                block.value[i] = rays[WEIGHT, i] * bsdf(
                    kind,
                    own,
                    sig,
                    ph,
                    th,
                    psi,
                    table,
                    rays[LIGHT + X, i],
                    rays[LIGHT + Y, i],
                    rays[LIGHT + Z, i],
                    rays[OBSERVER + X, i],
                    rays[OBSERVER + Y, i],
                    abs(rays[OBSERVER + Z, i]),
                )
    for i in range(sums.size):
        sums[i] += block.value[i]
