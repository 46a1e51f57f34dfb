"""Drawing of directions from a table: cells of theta and phi, one list for each psi and sigma.

A cell lies between neighbouring angles of the table's lists. Theta's first and last cell extend to 0 and 180 deg, because a
table's end values hold beyond its ends. Within a cell all directions are equally likely.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.tables import specular_vector
from goniotwin.twin.optics.geometry.coordinates import from_specular
from goniotwin.twin.optics.kernel import kernel

# Points per side of a cell, for the mean of its scattered light.
FINE = 4


@kernel(forceinline=True)
def theta_cells(th: Floats) -> tuple[int, int]:
    """Number of cells over theta, and 1 if the first of them lies before the list."""
    lead = 1 if th[0] > 0.0 else 0
    tail = 1 if th[th.size - 1] < 180.0 else 0
    return th.size - 1 + lead + tail, lead


@kernel(forceinline=True)
def _height(th: Floats, lead: int, edge: int) -> float:
    """sin^2(theta / 2) at an edge of the cells: proportional to the solid angle."""
    if edge < lead:
        return 0.0
    if edge - lead >= th.size:
        return 1.0
    return math.sin(math.radians(0.5 * th[edge - lead])) ** 2


@kernel(forceinline=True)
def _phi_edges(ph: Floats, j: int) -> tuple[float, float]:
    """Both ends of cell j over phi, deg; a single phi covers the whole turn."""
    if ph.size == 1:
        return 0.0, 360.0
    return ph[j], ph[j + 1]


@kernel(forceinline=True)
def _share(shares: Floats, n: int, m: int, cell: int) -> float:
    """Share of the light that one cell of the list of psi n and sigma m scatters."""
    below = shares[n, m, cell - 1] if cell > 0 else 0.0
    return shares[n, m, cell] - below  # type: ignore[no-any-return]


@kernel(forceinline=True)
def cell_density(
    ph: Floats, th: Floats, shares: Floats, n: int, n1: int, share: float, m: int, a: float, j: int, k: int, theta: float
) -> float:
    """Density in 1/sr of `cell_direction`, at the places of light and observer: linear between neighbouring sigma and psi."""
    count, lead = theta_cells(th)
    if theta < th[0]:
        k = 0
    else:
        k = min(lead + (k if theta < th[th.size - 1] else th.size - 1), count - 1)
    start, end = _phi_edges(ph, j)
    # In a list over 180 deg a cell lies on both sides of the plane of incidence.
    sides = 2.0 if ph.size > 1 and ph[ph.size - 1] <= 180.0 else 1.0
    area = 2.0 * sides * math.radians(end - start) * (_height(th, lead, k + 1) - _height(th, lead, k))
    cell, m1 = j * count + k, min(m + 1, shares.shape[1] - 1)
    result = (1.0 - share) * (1.0 - a) * (_share(shares, n, m, cell) / area)
    if a > 0.0:
        result += (1.0 - share) * a * (_share(shares, n, m1, cell) / area)
    if share > 0.0:
        result += share * (1.0 - a) * (_share(shares, n1, m, cell) / area)
        result += share * a * (_share(shares, n1, m1, cell) / area)
    return result


@kernel(forceinline=True)
def cell_direction(
    ph: Floats,
    th: Floats,
    shares: Floats,
    n: int,
    n1: int,
    share: float,
    sign: float,
    m: int,
    a: float,
    lx: float,
    ly: float,
    lz: float,
    u: float,
    v: float,
    choice: float,
) -> tuple[float, float, float]:
    """Direction for light at its place, from three uniform numbers in [0, 1).

    `choice` selects the list, u the cell and theta in it, v phi.
    """
    if choice < share:
        n, choice = n1, choice / share
    else:
        choice = (choice - share) / (1.0 - share)
    if choice < a:
        m = min(m + 1, shares.shape[1] - 1)
    low, cell = -1, shares.shape[2] - 1
    while cell - low > 1:
        middle = (low + cell) // 2
        if shares[n, m, middle] <= u:
            low = middle
        else:
            cell = middle
    below = shares[n, m, cell - 1] if cell > 0 else 0.0
    rest = (u - below) / (shares[n, m, cell] - below)
    count, lead = theta_cells(th)
    j, k = cell // count, cell % count
    bottom = _height(th, lead, k)
    theta = 2.0 * math.asin(math.sqrt(min(1.0, bottom + rest * (_height(th, lead, k + 1) - bottom))))
    start, end = _phi_edges(ph, j)
    if ph.size > 1 and ph[ph.size - 1] <= 180.0:
        sign, v = (sign, 2.0 * v) if v < 0.5 else (-sign, 2.0 * v - 1.0)
    phi = sign * math.radians(start + v * (end - start))
    return specular_vector(lx, ly, lz, theta, phi)


def cell_shares(sigma_deg: Floats, phi_deg: Floats, theta_deg: Floats, values: Floats) -> Floats:
    """Cumulative shares (psi, sigma, cells) of the light that each cell scatters, for values (psi, sigma, phi, theta).

    Cells are ordered by theta first, then phi. A list that scatters nothing is drawn by solid angle.
    """
    edges = np.unique(np.concatenate([[0.0], theta_deg, [180.0]]))
    turns = phi_deg if phi_deg.size > 1 else np.array([0.0, 360.0])
    heights = np.sin(np.radians(0.5 * edges)) ** 2
    inner = (np.arange(FINE) + 0.5) / FINE
    height = heights[:-1, None] + inner * np.diff(heights)[:, None]
    theta = np.degrees(2.0 * np.arcsin(np.sqrt(height))).ravel()
    phi = (turns[:-1, None] + inner * np.diff(turns)[:, None]).ravel()
    area = np.diff(turns)[:, None] * np.diff(heights)
    result = np.empty((*values.shape[:2], area.size))
    for m, sigma in enumerate(sigma_deg):
        cosine = np.maximum(from_specular(sigma, theta, phi[:, None])[..., 2], 0.0)
        for n in range(values.shape[0]):
            scattered = _bilinear(phi_deg, theta_deg, values[n, m], phi, theta) * cosine
            mean = scattered.reshape(turns.size - 1, FINE, edges.size - 1, FINE).mean(axis=(1, 3))
            share = (mean if np.any(mean > 0.0) else 1.0) * area
            total = np.cumsum(share)
            result[n, m] = total / total[-1]
    return result


def _bilinear(phi_deg: Floats, theta_deg: Floats, values: Floats, phi: Floats, theta: Floats) -> Floats:
    """Values (phi, theta) at every pair of new angles; end values hold beyond the ends."""
    over_theta = np.array([np.interp(theta, theta_deg, row) for row in values])
    if phi_deg.size == 1:
        return np.broadcast_to(over_theta, (phi.size, theta.size))
    return np.array([np.interp(phi, phi_deg, column) for column in over_theta.T]).T
