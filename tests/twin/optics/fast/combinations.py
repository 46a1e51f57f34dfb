"""All combinations of the twelve tilts of Table 2, exact and by the surrogate: for tests and for `benchmarks.tolerances`."""

import math

import numpy as np

from goniotwin.app.simulation.paper.gaussian_cut import (
    HIGHEST_ZENITH_DEG,
    gaussian_theory,
    in_plane_directions,
    in_plane_theta,
    relative_deviation,
)
from goniotwin.app.simulation.paper.worst_corner import TILT_DEG, tilts
from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    Pose,
    Scenes,
    Surrogate,
    deviation_array,
    factor_blocks,
    from_specular,
    gaussian,
)

COUNT = 12
LARGE_DEG = 0.2
CHECKED = {TILT_DEG: 50, LARGE_DEG: 1000}
"""Random combinations in `surrogate_error`, by the tilt."""


class Lobe:
    """A Gaussian lobe seen by detectors in the plane of incidence, or at theta and phi (n,); its theory has a peak of 1."""

    def __init__(
        self,
        instrument: Instrument,
        sigma_deg: float,
        width_deg: float,
        theta_deg: Floats | None = None,
        phi_deg: Floats | None = None,
    ) -> None:
        if theta_deg is None or phi_deg is None:
            theta = in_plane_theta(sigma_deg, width_deg)
            directions = in_plane_directions(sigma_deg, theta)
        else:
            directions = from_specular(sigma_deg, theta_deg, phi_deg)
            seen = directions[:, 2] > math.cos(math.radians(HIGHEST_ZENITH_DEG))
            directions, theta = directions[seen], theta_deg[seen]
        self.theory = gaussian_theory(theta, width_deg, "one_over_e")
        self.scenes = Scenes(instrument, [Pose(sigma_deg, directions)], [gaussian(width_deg, peak=1.0 / math.pi)])

    def exact_percent(self, deviations: list[Floats]) -> Floats:
        """Relative RMS (n,), percent, of blocks of deviations."""

        def rms(ratios: Floats) -> Floats:
            squares = relative_deviation(ratios[:, 0, 0], self.theory) ** 2
            return np.asarray(100.0 * np.sqrt(np.mean(squares, axis=1)))

        return np.concatenate(list(self.scenes.map(rms, deviations, ratios=True)))

    def surrogate_percent(self, parts: Floats, blocks: list[Floats]) -> Floats:
        """Relative RMS (n,), percent, by the surrogate, its fit included."""
        return 100.0 * np.concatenate(list(Surrogate(self.scenes, parts).relative_rms(blocks, self.theory)))


def tilt_parts(instrument: Instrument, tilt_deg: float = TILT_DEG) -> Floats:
    """The twelve tilts (12, elements, 6), each at its limit."""
    return deviation_array({each.element: Deviation(**{each.name: each.amount})} for each in tilts(instrument, tilt_deg))


def deviations_of(parts: Floats, blocks: list[Floats]) -> list[Floats]:
    """Blocks of deviations from blocks of factors."""
    return [np.tensordot(each, parts, 1) for each in blocks]


def surrogate_error(instrument: Instrument, width_deg: float, tilt_deg: float) -> float:
    """Largest error of the surrogate, percentage points, at random combinations and at the worst corner that it finds."""
    lobe, parts = Lobe(instrument, 30.0, width_deg), tilt_parts(instrument, tilt_deg)
    blocks = list(factor_blocks(COUNT))
    found = lobe.surrogate_percent(parts, blocks)
    rows = np.concatenate(blocks)
    random = np.random.Generator(np.random.Philox(18)).integers(0, len(rows), CHECKED[tilt_deg])
    chosen = np.append(random, np.argmax(found))
    exact = lobe.exact_percent(deviations_of(parts, [rows[chosen]]))
    return float(np.max(np.abs(exact - found[chosen])))
