"""Values and drawn directions of a sample, by the kernels of its models."""

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.lobes import rotate_about_z
from goniotwin.twin.optics.bsdf.models import evaluate_all, to_canonical
from goniotwin.twin.optics.bsdf.sampling import scatter_all
from goniotwin.twin.optics.bsdf.scatterer import Scatterer, lobe_shares


def evaluate(
    scatterer: Scatterer,
    light: npt.ArrayLike,
    observer: npt.ArrayLike,
    wavelength_nm: float | None = None,
    gamma_deg: float = 0.0,
) -> Floats:
    """BSDF (...) in 1/sr for unit vectors towards `light` and `observer`, (..., 3) each, broadcast.

    Only the lobes for these sides contribute. A regular lobe has no finite value and adds 0. `gamma_deg` turns the sample.
    Raises ValueError for a wrong shape, and for a sample with a spectrum without a wavelength.
    """
    rows, shape = _rows(light, observer, gamma_deg)
    weights = scatterer.weights(wavelength_nm)
    result: Floats = np.zeros(rows[0].shape[0])
    for lobe, weight in zip(scatterer.lobes, weights, strict=True):
        if weight > 0.0:
            result += weight * evaluate_all(*lobe.kernel_arguments, lobe.incident, lobe.transmits, *rows)
    return result.reshape(shape)


def draw_directions(
    scatterer: Scatterer,
    light: npt.ArrayLike,
    uniform: npt.ArrayLike,
    wavelength_nm: float | None = None,
    gamma_deg: float = 0.0,
) -> tuple[Floats, Floats]:
    """Scattered directions (n, 3) and weights (n,) for the unit vector towards `light` (3,), from numbers (n, 4).

    The numbers are uniform in [0, 1): the first selects the lobe by `lobe_shares`, the others the direction. A weight is the
    lobe's value times cosine over the density and over the lobe's probability, so the mean of the weights is the sum of both
    albedos. It is 0 for a direction without scattering. Raises ValueError for wrong shapes.
    """
    vector, numbers = np.asarray(light, float), np.asarray(uniform, float)
    if vector.shape != (3,):
        raise ValueError(f"light has the shape {vector.shape}: give one vector (3,)")
    if numbers.ndim != 2 or numbers.shape[1] != 4 or not np.all((numbers >= 0.0) & (numbers < 1.0)):
        raise ValueError(f"uniform has the shape {numbers.shape}: give (n, 4), numbers from 0 to less than 1")
    sigma_deg = float(np.degrees(np.arctan2(np.hypot(vector[0], vector[1]), vector[2])))
    shares, weights = lobe_shares(scatterer, sigma_deg, wavelength_nm), scatterer.weights(wavelength_nm)
    own = rotate_about_z(-gamma_deg, vector)
    directions, scattered = np.tile([0.0, 0.0, 1.0], (numbers.shape[0], 1)), np.zeros(numbers.shape[0])
    chosen = np.searchsorted(np.cumsum(shares), numbers[:, 0] * shares.sum(), side="right")
    for i, lobe in enumerate(scatterer.lobes):
        members = np.flatnonzero(chosen == i) if shares[i] > 0.0 else np.empty(0, dtype=np.int64)
        if not members.size:
            continue
        x, y, z = (float(c) for c in own)
        canonical_light = to_canonical(lobe.incident, lobe.transmits, x, y, z, 0.0, 0.0, 0.0)[0]
        drawn = scatter_all(
            *lobe.kernel_arguments,
            lobe.cells,
            lobe.incident,
            lobe.transmits,
            *canonical_light,
            np.ascontiguousarray(numbers[members, 1:]),
        )
        directions[members] = rotate_about_z(gamma_deg, drawn[:, :3])
        scattered[members] = drawn[:, 3] * weights[i] / shares[i]
    return directions, scattered


def _rows(light: npt.ArrayLike, observer: npt.ArrayLike, gamma_deg: float) -> tuple[list[Floats], tuple[int, ...]]:
    """Rows (n, 3) of light and observer in the sample's own frame, and their former shape."""
    pair = np.broadcast_arrays(np.asarray(light, float), np.asarray(observer, float))
    if pair[0].ndim == 0 or pair[0].shape[-1] != 3:
        raise ValueError(f"light and observer have the shape {pair[0].shape}: give vectors along the last axis")
    rows = [np.array(vectors, order="C").reshape(-1, 3) for vectors in pair]
    if gamma_deg != 0.0:
        rows = [rotate_about_z(-gamma_deg, vectors) for vectors in rows]
    return rows, pair[0].shape[:-1]
