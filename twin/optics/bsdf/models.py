"""Scattering models as kernels: value of one lobe for one pair of directions.

A lobe is a code, eight parameters and a table (arrays of one element where there is none), so that every lobe has the same
types and each kernel is compiled once. Vectors are unit vectors from the sample: l towards the light, d towards the observer, z
the sample's normal. The models are defined for one pair of sides: light in front, observer in front. `to_canonical` maps any
other pair to it. Where a direction then still is not in front (z <= 0) the value is zero. The codes and what the parameters are
for each: twin.optics.bsdf.kinds.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.kinds import ANISOTROPIC, ELLIPTIC, GAUSSIAN, LAMBERTIAN, REGULAR, TABLE, WARD, WIDE
from goniotwin.twin.optics.bsdf.tables import find_interval, hermite_weights, table_value
from goniotwin.twin.optics.kernel import kernel


@kernel(forceinline=True)
def to_canonical(
    incident: int, transmits: bool, lx: float, ly: float, lz: float, dx: float, dy: float, dz: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Directions of the sample's own frame in canonical form, for light from the front (1) or the back (-1).

    A sample lit from the back is turned about x, so azimuths change their sign. A transmitted direction is mirrored in the
    sample's plane, so that straight through becomes specular. Both directions are in front if they are on the sides where the
    lobe acts.
    """
    if incident < 0:
        ly, lz, dy, dz = -ly, -lz, -dy, -dz
    if transmits:
        dz = -dz
    return (lx, ly, lz), (dx, dy, dz)


@kernel(forceinline=True)
def from_canonical(incident: int, transmits: bool, dx: float, dy: float, dz: float) -> tuple[float, float, float]:
    """The observer's direction in the sample's own frame from its canonical form: the inverse of `to_canonical`."""
    if transmits:
        dz = -dz
    if incident < 0:
        dy, dz = -dy, -dz
    return dx, dy, dz


@kernel(forceinline=True)
def refract(ratio: float, lx: float, ly: float, lz: float) -> tuple[float, float, float]:
    """Light direction whose specular direction is the refracted axis of a lobe: sin(theta_t) = sin(theta_i) / ratio (Snell).

    `analytic_value` takes it in place of the light. Beyond total reflection its z is 0: there is no lobe, and the value is 0.
    """
    if ratio == 1.0 or lz <= 0.0:
        return lx, ly, lz
    x, y = lx / ratio, ly / ratio
    return x, y, math.sqrt(max(0.0, 1.0 - x * x - y * y))


@kernel(forceinline=True)
def analytic_value(
    kind: int,
    peak: float,
    exponent: float,
    intensity: float,
    lx: float,
    ly: float,
    lz: float,
    dx: float,
    dy: float,
    dz: float,
) -> float:
    """`bsdf` of a LAMBERTIAN or GAUSSIAN lobe, with its parameters one by one; for a ratio other than 1, l is from `refract`.

    Loops call this directly: passing arrays to a function costs numba's reference counting, ten times the time of the model.
    """
    if lz <= 0.0 or dz <= 0.0:
        return 0.0
    if kind == LAMBERTIAN:
        return peak
    theta = math.acos(min(1.0, max(-1.0, lz * dz - lx * dx - ly * dy)))
    value = peak * math.exp(-exponent * theta * theta)
    return value / dz if intensity == 1.0 else value


@kernel()
def shaped_value(kind: int, params: Floats, lx: float, ly: float, lz: float, dx: float, dy: float, dz: float) -> float:
    """`bsdf` of an ELLIPTIC, WIDE or WARD lobe."""
    if lz <= 0.0 or dz <= 0.0:
        return 0.0
    cx, cy, cz = dx + lx, dy + ly, dz - lz
    along = cx * params[6] + cy * params[7]
    if kind == WARD:
        hz = dz + lz
        slope2 = (params[1] * (cx * cx + cy * cy) + (params[5] - params[1]) * along * along) / (hz * hz)
        square = (cx * cx + cy * cy + hz * hz) / (hz * hz)
        return params[0] * square * math.exp(-slope2) / (hz * hz)  # type: ignore[no-any-return]
    chord2 = cx * cx + cy * cy + cz * cz
    theta = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(chord2)))
    if kind == WIDE:
        return params[0] / (1.0 + params[1] * theta * theta) ** 2  # type: ignore[no-any-return]
    share = along * along / chord2 if chord2 > 0.0 else 0.0
    return params[0] * math.exp(-theta * theta * (params[1] + params[5] * share))  # type: ignore[no-any-return]


@kernel()
def regular_share(params: Floats, sig: Floats, table: Floats, lx: float, ly: float, lz: float) -> float:
    """Share of the light from l that a REGULAR lobe sends on in its one direction; 0 for light that is not in front."""
    if lz <= 0.0:
        return 0.0
    if sig.size == 1:
        return params[0]  # type: ignore[no-any-return]
    i, a = find_interval(sig, math.degrees(math.atan2(math.sqrt(lx * lx + ly * ly), lz)))
    w = hermite_weights(a, sig[i + 1] - sig[i])
    values = w[0] * table[0, i, 0, 0] + w[1] * table[0, i + 1, 0, 0]
    return values + w[2] * table[1, i, 0, 0] + w[3] * table[1, i + 1, 0, 0]  # type: ignore[no-any-return]


@kernel()
def bsdf(
    kind: int,
    params: Floats,
    sig: Floats,
    ph: Floats,
    th: Floats,
    psi: Floats,
    table: Floats,
    lx: float,
    ly: float,
    lz: float,
    dx: float,
    dy: float,
    dz: float,
) -> float:
    """Value in 1/sr of a lobe for canonical light l and observer d; 0 for a REGULAR one."""
    if kind == REGULAR:
        return 0.0
    if kind in (TABLE, ANISOTROPIC):
        return table_value(params, sig, ph, th, psi, table, lx, ly, lz, dx, dy, dz)
    if kind >= ELLIPTIC:
        return shaped_value(kind, params, lx, ly, lz, dx, dy, dz)
    if kind == GAUSSIAN:
        lx, ly, lz = refract(params[4], lx, ly, lz)
    return analytic_value(kind, params[0], params[1], params[2], lx, ly, lz, dx, dy, dz)


@kernel()
def evaluate_all(
    kind: int,
    params: Floats,
    sig: Floats,
    ph: Floats,
    th: Floats,
    psi: Floats,
    table: Floats,
    incident: int,
    transmits: bool,
    light: Floats,
    observer: Floats,
) -> Floats:
    """`bsdf` of rows (n, 3) of directions in the sample's own frame."""
    result = np.empty(light.shape[0])
    for i in range(light.shape[0]):
        (lx, ly, lz), (dx, dy, dz) = to_canonical(
            incident, transmits, light[i, 0], light[i, 1], light[i, 2], observer[i, 0], observer[i, 1], observer[i, 2]
        )
        result[i] = bsdf(kind, params, sig, ph, th, psi, table, lx, ly, lz, dx, dy, dz)
    return result
