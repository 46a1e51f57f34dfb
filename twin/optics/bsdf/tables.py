"""Tables over specular coordinates as kernels: position of a pair of directions in a table, and the value there.

A table is table[2 psi + part, sigma, phi, theta]: part 0 holds the values in 1/sr, part 1 their slopes over sigma in 1/(sr
deg); an isotropic one has a single psi. phi runs over 180 deg (mirrored in the plane of incidence) or 360 deg. Directions are
canonical (see twin.optics.bsdf.models): light and observer in front.
"""

import math

from goniotwin.arrays import Floats
from goniotwin.twin.optics.kernel import kernel


@kernel()
def find_interval(axis: Floats, x: float) -> tuple[int, float]:
    """Interval of an ascending axis that contains x, and the relative position in it; limited at both ends."""
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


@kernel(forceinline=True)
def plane_of_incidence(lx: float, ly: float) -> tuple[float, float, float]:
    """Sine of the light's polar angle, and the unit vector (x, y) of the plane of incidence.

    At normal incidence the plane of incidence is that of the frame, as for any other sigma.
    """
    sine = math.sqrt(lx * lx + ly * ly)
    if sine > 0.0:
        return sine, lx / sine, ly / sine
    return sine, 1.0, 0.0


@kernel(forceinline=True)
def specular_angles(lx: float, ly: float, lz: float, dx: float, dy: float, dz: float) -> tuple[float, float]:
    """theta and phi of a pair of directions, in degrees; phi within -180 and 180."""
    sine, ux, uy = plane_of_incidence(lx, ly)
    radial = ux * dx + uy * dy
    inward, across, along = lz * radial + sine * dz, ux * dy - uy * dx, lz * dz - sine * radial
    theta = math.degrees(math.atan2(math.sqrt(inward * inward + across * across), along))
    return theta, math.degrees(math.atan2(across, inward))


@kernel(forceinline=True)
def specular_vector(lx: float, ly: float, lz: float, theta: float, phi: float) -> tuple[float, float, float]:
    """The direction at theta and phi, in rad, for light from l: the inverse of `specular_angles`."""
    sine, ux, uy = plane_of_incidence(lx, ly)
    inward, across, along = math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)
    radial = lz * inward - sine * along
    return radial * ux - across * uy, radial * uy + across * ux, sine * inward + lz * along


@kernel(forceinline=True)
def phi_in_list(ph: Floats, phi: float) -> float:
    """phi (-180 to 180) in the range of the list: mirrored where the list ends at 180 deg."""
    if ph[ph.size - 1] <= 180.0:
        return abs(phi)
    return phi + 360.0 if phi < 0.0 else phi


@kernel(forceinline=True)
def azimuth_place(psi: Floats, period: float, mirrored: float, lx: float, ly: float) -> tuple[int, int, float, float]:
    """The two blocks of psi around the light's azimuth, the weight of the second, and the sign for phi.

    The list of psi runs over one whole period, with its first block repeated at the end; or, if mirrored, over half a period,
    and beyond that half both azimuths change their sign.
    """
    if psi.size == 1:
        return 0, 0, 0.0, 1.0
    azimuth = math.degrees(math.atan2(ly, lx))
    azimuth -= period * math.floor((azimuth - psi[0]) / period)
    sign = 1.0
    if mirrored > 0.0 and azimuth > 0.5 * period:
        azimuth, sign = period - azimuth, -1.0
    n, share = find_interval(psi, azimuth)
    return n, n + 1, share, sign


@kernel(forceinline=True)
def hermite_weights(a: float, step: float) -> tuple[float, float, float, float]:
    """Weights of the values at both ends of an interval and of the slopes there, at the relative position a in it."""
    rest = 1.0 - a
    return rest * rest * (1.0 + 2.0 * a), a * a * (3.0 - 2.0 * a), step * a * rest * rest, -step * a * a * rest


@kernel(forceinline=True)
def light_place(
    sig: Floats, psi: Floats, params: Floats, lx: float, ly: float, lz: float
) -> tuple[tuple[int, int, float, float], tuple[int, float]]:
    """The light's place: `azimuth_place`, and the interval of sigma with the relative position in it."""
    place = find_interval(sig, math.degrees(math.atan2(math.sqrt(lx * lx + ly * ly), lz)))
    return azimuth_place(psi, params[0], params[1], lx, ly), place


@kernel(forceinline=True)
def observer_place(
    ph: Floats, th: Floats, sign: float, lx: float, ly: float, lz: float, dx: float, dy: float, dz: float
) -> tuple[int, float, int, float, float]:
    """The observer's place: the intervals of phi and theta, each with the relative position in it, and theta in deg."""
    theta, phi = specular_angles(lx, ly, lz, dx, dy, dz)
    j, b = find_interval(ph, phi_in_list(ph, sign * phi))
    k, c = find_interval(th, theta)
    return j, b, k, c, theta


@kernel(forceinline=True)
def _block_value(sig: Floats, table: Floats, block: int, m: int, a: float, j: int, b: float, k: int, c: float) -> float:
    """Value of one block of psi: cubic in sigma, linear in phi and theta; end values hold beyond each list."""
    m1, j1, k1 = min(m + 1, table.shape[1] - 1), min(j + 1, table.shape[2] - 1), min(k + 1, table.shape[3] - 1)
    weights = hermite_weights(a, sig[m1] - sig[m])
    total = 0.0
    for term in range(4):
        part, i = 2 * block + term // 2, m if term % 2 == 0 else m1
        near = (1.0 - c) * table[part, i, j, k] + c * table[part, i, j, k1]
        far = (1.0 - c) * table[part, i, j1, k] + c * table[part, i, j1, k1]
        total += weights[term] * ((1.0 - b) * near + b * far)
    return total


@kernel(forceinline=True)
def value_at(
    sig: Floats, table: Floats, n: int, n1: int, share: float, m: int, a: float, j: int, b: float, k: int, c: float
) -> float:
    """Value in 1/sr at the places of light and observer, linear in psi."""
    value = _block_value(sig, table, n, m, a, j, b, k, c)
    if share == 0.0:
        return value
    return (1.0 - share) * value + share * _block_value(sig, table, n1, m, a, j, b, k, c)


@kernel()
def table_value(
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
    """Value of a table in 1/sr, for directions in the sample's own frame; zero where light or observer is not in front."""
    if lz <= 0.0 or dz <= 0.0:
        return 0.0
    (n, n1, share, sign), (m, a) = light_place(sig, psi, params, lx, ly, lz)
    j, b, k, c, _ = observer_place(ph, th, sign, lx, ly, lz, dx, dy, dz)
    return value_at(sig, table, n, n1, share, m, a, j, b, k, c)
