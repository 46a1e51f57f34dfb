"""Drawing of scattered directions and their density, for one lobe and canonical light (see twin.optics.bsdf.models).

Each kind has a draw after its own shape. The density is exactly that of the draw, so the mean of value times cosine over
density is the albedo. A Gaussian and a table draw a share of the directions by the cosine law, so that directions far from the
lobe are drawn too.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.cells import cell_density, cell_direction
from goniotwin.twin.optics.bsdf.models import (
    ANISOTROPIC,
    GAUSSIAN,
    REGULAR,
    TABLE,
    analytic_value,
    from_canonical,
    refract,
    regular_share,
)
from goniotwin.twin.optics.bsdf.tables import light_place, observer_place, specular_vector, value_at
from goniotwin.twin.optics.kernel import kernel

# Share of the draws of a Gaussian or a table that follow its shape.
LOBE_SHARE = 0.75


@kernel(forceinline=True)
def analytic_density(
    kind: int, exponent: float, cut: float, lx: float, ly: float, lz: float, dx: float, dy: float, dz: float
) -> float:
    """`density` of a LAMBERTIAN or GAUSSIAN lobe, with its parameters one by one.

    l is from `refract`, as in `analytic_value`.
    """
    cosine = max(dz, 0.0) / math.pi
    if kind != GAUSSIAN or lz <= 0.0:
        return cosine
    theta = math.acos(min(1.0, max(-1.0, lz * dz - lx * dx - ly * dy)))
    # The lobe is drawn as a plane Gaussian wrapped onto the sphere: theta / sin(theta) is the stretch.
    stretch = theta / math.sin(theta) if theta > 1e-9 else 1.0
    lobe = exponent / (math.pi * cut) * math.exp(-exponent * theta * theta) * stretch
    return LOBE_SHARE * lobe + (1.0 - LOBE_SHARE) * cosine


@kernel(forceinline=True)
def analytic_sample(
    kind: int, exponent: float, cut: float, lx: float, ly: float, lz: float, u: float, v: float, choice: float
) -> tuple[float, float, float]:
    """Direction of `scatter` of a LAMBERTIAN or GAUSSIAN lobe, with its parameters one by one.

    l is from `refract`, as in `analytic_value`.
    """
    turn = 2.0 * math.pi * v
    if kind != GAUSSIAN or choice >= LOBE_SHARE or lz <= 0.0:
        radius = math.sqrt(u)
        return radius * math.cos(turn), radius * math.sin(turn), math.sqrt(1.0 - u)
    theta = math.sqrt(-math.log(1.0 - u * cut) / exponent)
    return specular_vector(lx, ly, lz, theta, turn)


@kernel()
def density(
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, psi: Floats, cells: Floats,
    lx: float, ly: float, lz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Density of the canonical directions that `scatter` draws, in 1/sr; 0 for a REGULAR lobe, which has one direction only."""
    if kind == REGULAR:
        return 0.0
    if kind in (TABLE, ANISOTROPIC):
        n, n1, share, sign, m, a = light_place(sig, psi, params, lx, ly, lz)
        j, _, k, _, theta = observer_place(ph, th, sign, lx, ly, lz, dx, dy, dz)
        own = cell_density(ph, th, cells, n, n1, share, m, a, j, k, theta)
        return LOBE_SHARE * own + (1.0 - LOBE_SHARE) * max(dz, 0.0) / math.pi
    if kind == GAUSSIAN:
        lx, ly, lz = refract(params[4], lx, ly, lz)
    return analytic_density(kind, params[1], params[3], lx, ly, lz, dx, dy, dz)


@kernel(forceinline=True)
def scatter_by_table(
    params: Floats, sig: Floats, ph: Floats, th: Floats, psi: Floats, table: Floats, cells: Floats,
    lx: float, ly: float, lz: float, u: float, v: float, choice: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """`scatter` of a table: the places of light and observer in it are found once for draw, value and density."""
    n, n1, share, sign, m, a = light_place(sig, psi, params, lx, ly, lz)
    if choice < LOBE_SHARE and lz > 0.0:
        dx, dy, dz = cell_direction(ph, th, cells, n, n1, share, sign, m, a, lx, ly, lz, u, v, choice / LOBE_SHARE)
    else:
        dx, dy, dz = analytic_sample(TABLE, 0.0, 0.0, lx, ly, lz, u, v, choice)
    if lz <= 0.0 or dz <= 0.0:
        return dx, dy, dz, 0.0
    j, b, k, c, theta = observer_place(ph, th, sign, lx, ly, lz, dx, dy, dz)
    value = value_at(sig, table, n, n1, share, m, a, j, b, k, c)
    if value == 0.0:
        return dx, dy, dz, 0.0
    own = cell_density(ph, th, cells, n, n1, share, m, a, j, k, theta)
    return dx, dy, dz, value * dz / (LOBE_SHARE * own + (1.0 - LOBE_SHARE) * max(dz, 0.0) / math.pi)


@kernel()
def scatter(
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, psi: Floats, table: Floats, cells: Floats,
    lx: float, ly: float, lz: float, u: float, v: float, choice: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Canonical direction from three uniform numbers in [0, 1), and its weight: value times cosine over density.

    The mean of the weight is the lobe's albedo. It is 0 where the direction points below the surface. The direction of a
    REGULAR lobe is the specular one, and its weight the lobe's share of the light.
    """
    if kind == REGULAR:
        return -lx, -ly, lz, regular_share(params, sig, table, lx, ly, lz)
    if kind in (TABLE, ANISOTROPIC):
        return scatter_by_table(params, sig, ph, th, psi, table, cells, lx, ly, lz, u, v, choice)
    ax, ay, az = refract(params[4], lx, ly, lz) if kind == GAUSSIAN else (lx, ly, lz)
    dx, dy, dz = analytic_sample(kind, params[1], params[3], ax, ay, az, u, v, choice)
    value = analytic_value(kind, params[0], params[1], params[2], ax, ay, az, dx, dy, dz)
    if value == 0.0:
        return dx, dy, dz, 0.0
    return dx, dy, dz, value * dz / analytic_density(kind, params[1], params[3], ax, ay, az, dx, dy, dz)


@kernel()
def scatter_all(
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, psi: Floats, table: Floats, cells: Floats,
    incident: int, transmits: bool, lx: float, ly: float, lz: float, uniform: Floats,
) -> Floats:  # fmt: skip
    """`scatter` for canonical light and rows (n, 3) of numbers: direction in the sample's own frame and weight (n, 4)."""
    result = np.empty((uniform.shape[0], 4))
    for i in range(uniform.shape[0]):
        x, y, z, weight = scatter(
            kind, params, sig, ph, th, psi, table, cells, lx, ly, lz, uniform[i, 0], uniform[i, 1], uniform[i, 2]
        )
        result[i, 0], result[i, 1], result[i, 2] = from_canonical(incident, transmits, x, y, z)
        result[i, 3] = weight
    return result


@kernel()
def density_all(
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, psi: Floats, cells: Floats,
    lx: float, ly: float, lz: float, observer: Floats,
) -> Floats:  # fmt: skip
    """`density` of rows (n, 3) of canonical directions, for canonical light."""
    result = np.empty(observer.shape[0])
    for i in range(observer.shape[0]):
        result[i] = density(kind, params, sig, ph, th, psi, cells, lx, ly, lz, observer[i, 0], observer[i, 1], observer[i, 2])
    return result
