"""The surrogate: ratios of sample and etalon to the second order of a few deviations, fitted to exact scenes.

The logarithm of a Gaussian lobe is quadratic in the shift of its axis, which is nearly linear in small tilts; the mean over
beam and detector changes that little. So the logarithm of a ratio is expanded, with all products of two deviations. For twelve
deviations that takes 157 exact scenes, and then a rig costs about a hundredth of an exact one. The expansion has few
independent columns over the detectors (of a lobe: those of a shift along two directions and of a width), so sums over the
detectors are computed from these (optics.md, section 7).

It is a second evaluator, not the instrument: what it finds is confirmed with `Scenes`. It knows no edge of a mirror; its error
grows with the third power of the deviations (`benchmarks.tolerances` states it).
"""

from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.scenes import Scenes
from goniotwin.twin.optics.kernel import kernel, thread_count

FACTOR_BLOCK = 6561
"""Most rigs in a block of `factor_blocks`."""
ROUNDING = 1e-6
"""Largest error of a logarithm by the columns that are omitted."""
UNROLLED = 4


class Surrogate:
    """Ratios of one sample at one wavelength as a function of k factors: a rig has the deviations sum of factor times part.

    `parts` (k, elements, 6) as in `deviation_array`: the expansion is fitted to factors of -1, 0 and 1, and is for factors
    within. Raises ValueError for several samples or wavelengths, and for detectors that receive no light.
    """

    def __init__(self, scenes: Scenes, parts: npt.ArrayLike) -> None:
        self._parts = np.asarray(parts, dtype=np.float64)
        count = len(self._parts)
        one = np.eye(count)
        first, second = np.triu_indices(count, 1)
        pairs = one[first] + one[second]
        ratios = scenes.ratios(self.deviations(np.concatenate([np.zeros((1, count)), one, -one, pairs, -pairs])))
        if ratios.shape[1] * ratios.shape[2] != 1:
            raise ValueError(f"scenes has {ratios.shape[1]} samples and {ratios.shape[2]} wavelengths: give one of each")
        if not np.all(ratios > 0.0):
            raise ValueError("scenes has detectors without light: the surrogate is for those that receive some in every rig")
        logs = np.log(ratios[:, 0, 0])
        middle, plus, minus, both, neither = np.split(logs, np.cumsum([1, count, count, len(pairs)]))
        squares = 0.5 * (plus + minus) - middle
        products = 0.5 * (both + neither) - middle - squares[first] - squares[second]
        quadratic = np.empty((count * (count + 1) // 2, logs.shape[1]))
        rows, columns = np.triu_indices(count)
        quadratic[rows == columns], quadratic[rows != columns] = squares, products
        self._terms = np.concatenate([middle, 0.5 * (plus - minus), quadratic])

    def deviations(self, factors: npt.ArrayLike) -> Floats:
        """Deviations (n, elements, 6) of rigs with factors (n, k), for `Scenes`."""
        return np.ascontiguousarray(np.tensordot(np.asarray(factors, dtype=np.float64), self._parts, 1))

    def ratios(self, factors: npt.ArrayLike) -> Floats:
        """Ratios (n, detectors) of rigs with factors (n, k)."""
        rigs = np.asarray(factors, dtype=np.float64)
        rows, columns = np.triu_indices(rigs.shape[1])
        features = np.concatenate([np.ones((len(rigs), 1)), rigs, rigs[:, rows] * rigs[:, columns]], axis=1)
        found: Floats = np.exp(features @ self._terms)
        return found

    def relative_rms(self, blocks: Iterable[Floats], reference: npt.ArrayLike) -> Iterator[Floats]:
        """Relative RMS of the ratios to `reference` (detectors,), the paper's formula 5, of each block of factors (n, k).

        The difference of two values over their mean is 2 tanh(y / 2), with y the difference of their logarithms.
        """
        left, right = self._columns(np.log(np.asarray(reference, dtype=np.float64)))

        def rms(block: Floats) -> Floats:
            result = np.empty(len(block))
            fill_relative_rms(np.ascontiguousarray(block, dtype=np.float64), left, right, result)
            return result

        with ThreadPoolExecutor(thread_count()) as pool:
            yield from pool.map(rms, blocks)

    def _columns(self, reference: Floats) -> tuple[Floats, Floats]:
        """Factors (terms, r) and (r, detectors) whose product is the expansion minus `reference`; r is a multiple of 4."""
        terms = self._terms.copy()
        terms[0] -= reference
        u, sizes, v = np.linalg.svd(terms, full_matrices=False)
        # A rig's features are at most 1, so an omitted column changes a logarithm by at most its sum over the features.
        rest = np.cumsum((sizes * np.abs(u).sum(axis=0) * np.abs(v).max(axis=1))[::-1])[::-1]
        rank = int(np.count_nonzero(rest > ROUNDING))
        padded = UNROLLED * -(-max(rank, 1) // UNROLLED)
        left, right = np.zeros((len(terms), padded)), np.zeros((padded, terms.shape[1]))
        left[:, :rank], right[:rank] = u[:, :rank] * sizes[:rank], v[:rank]
        return left, right


def factor_blocks(count: int, levels: tuple[float, ...] = (-1.0, 0.0, 1.0)) -> Iterator[Floats]:
    """All combinations of `levels` for `count` factors, in blocks (n, count); the last factor changes fastest."""
    last = count
    while len(levels) ** last > FACTOR_BLOCK:
        last -= 1
    table = _combinations(last, levels)
    for first in _combinations(count - last, levels):
        yield np.concatenate([np.tile(first, (len(table), 1)), table], axis=1)


def _combinations(count: int, levels: tuple[float, ...]) -> Floats:
    grids = np.meshgrid(*[np.array(levels)] * count, indexing="ij")
    return np.stack([each.ravel() for each in grids], axis=1) if count else np.empty((1, 0))


@kernel(nogil=True, fastmath={"contract", "reassoc", "nsz"})
def fill_relative_rms(factors: Floats, left: Floats, right: Floats, result: Floats) -> None:
    """Fill `result` (n,) with the root mean square of 2 tanh(y / 2), y = features @ left @ right, for factors (n, k)."""
    count, rank, detectors = factors.shape[1], left.shape[1], right.shape[1]
    u, y = np.empty(rank), np.empty(detectors)
    for n in range(factors.shape[0]):
        for r in range(rank):
            u[r] = left[0, r]
        term = 1 + count
        for i in range(count):
            x = factors[n, i]
            for r in range(rank):
                u[r] += x * left[1 + i, r]
            for j in range(i, count):
                product = x * factors[n, j]
                if product != 0.0:
                    for r in range(rank):
                        u[r] += product * left[term, r]
                term += 1
        for d in range(detectors):
            y[d] = 0.0
        for r in range(0, rank, UNROLLED):
            a, b, c, e = u[r], u[r + 1], u[r + 2], u[r + 3]
            for d in range(detectors):
                y[d] += a * right[r, d] + b * right[r + 1, d] + c * right[r + 2, d] + e * right[r + 3, d]
        total = 0.0
        for d in range(detectors):
            # tanh by its continued fraction: 1e-8 for a ratio of 7.
            q = 0.25 * y[d] * y[d]
            share = (10395.0 + q * (1260.0 + 21.0 * q)) / (10395.0 + q * (4725.0 + q * (210.0 + q)))
            total += q * share * share
        result[n] = 2.0 * np.sqrt(total / detectors)
