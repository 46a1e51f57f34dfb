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
def specular_angles(lx: float, ly: float, lz: float, dx: float, dy: float, dz: float) -> tuple[float, float, float]:
    """sigma, theta and phi of a pair of directions, in degrees; phi within -180 and 180."""
    sine, ux, uy = plane_of_incidence(lx, ly)
    radial = ux * dx + uy * dy
    inward, across, along = lz * radial + sine * dz, ux * dy - uy * dx, lz * dz - sine * radial
    theta = math.degrees(math.atan2(math.sqrt(inward * inward + across * across), along))
    return math.degrees(math.atan2(sine, lz)), theta, math.degrees(math.atan2(across, inward))


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


@kernel()
def look_up(sig: Floats, ph: Floats, th: Floats, table: Floats, block: int, sigma: float, theta: float, phi: float) -> float:
    """Value of one block of psi: cubic in sigma, linear in phi and theta; end values hold beyond each list."""
    i, a = find_interval(sig, sigma)
    j, b = find_interval(ph, phi_in_list(ph, phi))
    k, c = find_interval(th, theta)
    i1, j1, k1 = min(i + 1, sig.size - 1), min(j + 1, ph.size - 1), min(k + 1, th.size - 1)
    weights = hermite_weights(a, sig[i1] - sig[i])
    total = 0.0
    for term in range(4):
        part, m = 2 * block + term // 2, i if term % 2 == 0 else i1
        near = (1.0 - c) * table[part, m, j, k] + c * table[part, m, j, k1]
        far = (1.0 - c) * table[part, m, j1, k] + c * table[part, m, j1, k1]
        total += weights[term] * ((1.0 - b) * near + b * far)
    return total


@kernel()
def table_value(
    sig: Floats, ph: Floats, th: Floats, table: Floats,
    lx: float, ly: float, lz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Value of an isotropic table in 1/sr; zero where light or observer is not in front."""
    if lz <= 0.0 or dz <= 0.0:
        return 0.0
    sigma, theta, phi = specular_angles(lx, ly, lz, dx, dy, dz)
    return look_up(sig, ph, th, table, 0, sigma, theta, phi)


@kernel()
def anisotropic_value(
    sig: Floats, ph: Floats, th: Floats, psi: Floats, period: float, mirrored: float, table: Floats,
    lx: float, ly: float, lz: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Value of an anisotropic table in 1/sr, linear in psi, for directions in the sample's own frame."""
    if lz <= 0.0 or dz <= 0.0:
        return 0.0
    sigma, theta, phi = specular_angles(lx, ly, lz, dx, dy, dz)
    n, n1, share, sign = azimuth_place(psi, period, mirrored, lx, ly)
    value = look_up(sig, ph, th, table, n, sigma, theta, sign * phi)
    if share == 0.0:
        return value
    return (1.0 - share) * value + share * look_up(sig, ph, th, table, n1, sigma, theta, sign * phi)
