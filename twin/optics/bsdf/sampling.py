"""Drawing of scattered directions and their density, for one lobe and canonical light (see twin.optics.bsdf.models).

Each kind has a draw after its own shape. The density is exactly that of the draw, so the mean of value times cosine over
density is the albedo. All but the diffuser draw a share of the directions by the cosine law, so that directions far from the
lobe are drawn too.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.cells import cell_density, cell_direction
from goniotwin.twin.optics.bsdf.kinds import ANISOTROPIC, ELLIPTIC, GAUSSIAN, REGULAR, TABLE, WARD, WIDE
from goniotwin.twin.optics.bsdf.models import analytic_value, from_canonical, refract, regular_share, shaped_value
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
def shaped_density(kind: int, params: Floats, lx: float, ly: float, lz: float, dx: float, dy: float, dz: float) -> float:
    """`density` of an ELLIPTIC, WIDE or WARD lobe."""
    cosine = max(dz, 0.0) / math.pi
    if lz <= 0.0:
        return cosine
    cx, cy, cz = dx + lx, dy + ly, dz - lz
    if kind == WARD:
        hz, lobe = dz + lz, 0.0
        square = cx * cx + cy * cy + hz * hz
        if hz > 0.0:
            along = cx * params[6] + cy * params[7]
            slope2 = (params[1] * (cx * cx + cy * cy) + (params[5] - params[1]) * along * along) / (hz * hz)
            # Slopes of h are Gaussian: their density over the cube of its cosine is that of h, over 4 (h d) that of d.
            lobe = math.sqrt(params[1] * params[5]) / math.pi * math.exp(-slope2) * square / (2.0 * hz**3)
        return LOBE_SHARE * lobe + (1.0 - LOBE_SHARE) * cosine
    chord = math.sqrt(cx * cx + cy * cy + cz * cz)
    theta = 2.0 * math.asin(min(1.0, 0.5 * chord))
    stretch = theta / math.sin(theta) if 1e-9 < theta < math.pi else 1.0
    if kind == WIDE:
        wide: float = params[1] / (math.pi * params[3] * (1.0 + params[1] * theta * theta) ** 2) * stretch
        return LOBE_SHARE * wide + (1.0 - LOBE_SHARE) * cosine
    ex, ey, ez, tilt2 = _axis_at_lobe(params, lx, ly, lz)
    sine = math.sin(theta)
    # The part of d across the specular direction, along the lobe's own axis there.
    along = theta * (dx * ex + dy * ey + dz * ez) / sine if sine > 1e-9 else 0.0
    steep = params[1] + params[5] * tilt2
    exponent = params[1] * (theta * theta - along * along) + steep * along * along
    lobe = math.sqrt(params[1] * steep) / math.pi * math.exp(-exponent) * stretch
    return LOBE_SHARE * lobe + (1.0 - LOBE_SHARE) * cosine


@kernel(forceinline=True)
def _axis_at_lobe(params: Floats, lx: float, ly: float, lz: float) -> tuple[float, float, float, float]:
    """Axis of an ELLIPTIC lobe as a unit vector across the specular direction, and the square of its projection's length."""
    part = -lx * params[6] - ly * params[7]
    ex, ey, ez = params[6] + part * lx, params[7] + part * ly, -part * lz
    tilt2 = 1.0 - part * part
    if tilt2 < 1e-12:  # light along the axis: any direction across it
        return -params[7], params[6], 0.0, 0.0
    length = math.sqrt(tilt2)
    return ex / length, ey / length, ez / length, tilt2


@kernel()
def shaped_sample(
    kind: int, params: Floats, lx: float, ly: float, lz: float, u: float, v: float, choice: float
) -> tuple[float, float, float]:
    """Direction of `scatter` of an ELLIPTIC, WIDE or WARD lobe."""
    turn = 2.0 * math.pi * v
    if choice >= LOBE_SHARE or lz <= 0.0:
        radius = math.sqrt(u)
        return radius * math.cos(turn), radius * math.sin(turn), math.sqrt(1.0 - u)
    if kind == WIDE:
        rest = u * params[3]
        return specular_vector(lx, ly, lz, math.sqrt(rest / ((1.0 - rest) * params[1])), turn)
    radius = math.sqrt(-math.log(1.0 - u))
    if kind == WARD:
        a, b = radius * math.cos(turn) / math.sqrt(params[5]), radius * math.sin(turn) / math.sqrt(params[1])
        hx, hy = a * params[6] - b * params[7], a * params[7] + b * params[6]
        factor = 2.0 * (lx * hx + ly * hy + lz) / (hx * hx + hy * hy + 1.0)
        return factor * hx - lx, factor * hy - ly, factor - lz
    ex, ey, ez, tilt2 = _axis_at_lobe(params, lx, ly, lz)
    a = radius * math.cos(turn) / math.sqrt(params[1] + params[5] * tilt2)
    b = radius * math.sin(turn) / math.sqrt(params[1])
    theta = math.hypot(a, b)
    if theta >= math.pi:
        return 0.0, 0.0, -1.0
    # The specular direction (-lx, -ly, lz), the axis, and their vector product.
    qx, qy, qz = -ly * ez - lz * ey, lz * ex + lx * ez, -lx * ey + ly * ex
    along = math.cos(theta)
    part = math.sin(theta) / theta if theta > 1e-12 else 1.0
    x = -lx * along + part * (a * ex + b * qx)
    y = -ly * along + part * (a * ey + b * qy)
    return x, y, lz * along + part * (a * ez + b * qz)


@kernel()
def density(
    kind: int,
    params: Floats,
    sig: Floats,
    ph: Floats,
    th: Floats,
    psi: Floats,
    cells: Floats,
    lx: float,
    ly: float,
    lz: float,
    dx: float,
    dy: float,
    dz: float,
) -> float:
    """Density of the canonical directions that `scatter` draws, in 1/sr; 0 for a REGULAR lobe, which has one direction only."""
    if kind == REGULAR:
        return 0.0
    if kind in (TABLE, ANISOTROPIC):
        (n, n1, share, sign), (m, a) = light_place(sig, psi, params, lx, ly, lz)
        j, _, k, _, theta = observer_place(ph, th, sign, lx, ly, lz, dx, dy, dz)
        own = cell_density(ph, th, cells, n, n1, share, m, a, j, k, theta)
        return LOBE_SHARE * own + (1.0 - LOBE_SHARE) * max(dz, 0.0) / math.pi
    if kind >= ELLIPTIC:
        return shaped_density(kind, params, lx, ly, lz, dx, dy, dz)
    if kind == GAUSSIAN:
        lx, ly, lz = refract(params[4], lx, ly, lz)
    return analytic_density(kind, params[1], params[3], lx, ly, lz, dx, dy, dz)


@kernel(forceinline=True)
def scatter_by_table(
    params: Floats,
    sig: Floats,
    ph: Floats,
    th: Floats,
    psi: Floats,
    table: Floats,
    cells: Floats,
    lx: float,
    ly: float,
    lz: float,
    u: float,
    v: float,
    choice: float,
) -> tuple[float, float, float, float]:
    """`scatter` of a table: the places of light and observer in it are found once for draw, value and density."""
    (n, n1, share, sign), (m, a) = light_place(sig, psi, params, lx, ly, lz)
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
    kind: int,
    params: Floats,
    sig: Floats,
    ph: Floats,
    th: Floats,
    psi: Floats,
    table: Floats,
    cells: Floats,
    lx: float,
    ly: float,
    lz: float,
    u: float,
    v: float,
    choice: float,
) -> tuple[float, float, float, float]:
    """Canonical direction from three uniform numbers in [0, 1), and its weight: value times cosine over density.

    The mean of the weight is the lobe's albedo. It is 0 where the direction points below the surface. The direction of a
    REGULAR lobe is the specular one, and its weight the lobe's share of the light.
    """
    if kind == REGULAR:
        return -lx, -ly, lz, regular_share(params, sig, table, lx, ly, lz)
    if kind in (TABLE, ANISOTROPIC):
        return scatter_by_table(params, sig, ph, th, psi, table, cells, lx, ly, lz, u, v, choice)
    if kind >= ELLIPTIC:
        dx, dy, dz = shaped_sample(kind, params, lx, ly, lz, u, v, choice)
        value = shaped_value(kind, params, lx, ly, lz, dx, dy, dz)
        if value == 0.0:
            return dx, dy, dz, 0.0
        return dx, dy, dz, value * dz / shaped_density(kind, params, lx, ly, lz, dx, dy, dz)
    ax, ay, az = refract(params[4], lx, ly, lz) if kind == GAUSSIAN else (lx, ly, lz)
    dx, dy, dz = analytic_sample(kind, params[1], params[3], ax, ay, az, u, v, choice)
    value = analytic_value(kind, params[0], params[1], params[2], ax, ay, az, dx, dy, dz)
    if value == 0.0:
        return dx, dy, dz, 0.0
    return dx, dy, dz, value * dz / analytic_density(kind, params[1], params[3], ax, ay, az, dx, dy, dz)


@kernel()
def scatter_all(
    kind: int,
    params: Floats,
    sig: Floats,
    ph: Floats,
    th: Floats,
    psi: Floats,
    table: Floats,
    cells: Floats,
    incident: int,
    transmits: bool,
    lx: float,
    ly: float,
    lz: float,
    uniform: Floats,
) -> Floats:
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
    kind: int,
    params: Floats,
    sig: Floats,
    ph: Floats,
    th: Floats,
    psi: Floats,
    cells: Floats,
    lx: float,
    ly: float,
    lz: float,
    observer: Floats,
) -> Floats:
    """`density` of rows (n, 3) of canonical directions, for canonical light."""
    result = np.empty(observer.shape[0])
    for i in range(observer.shape[0]):
        result[i] = density(kind, params, sig, ph, th, psi, cells, lx, ly, lz, observer[i, 0], observer[i, 1], observer[i, 2])
    return result
