"""What observations show of inputs: generalised least squares, with what was known of the inputs before as prior.

Observations differ from what was expected by d = J e + r: e are the errors of the inputs, of covariance U, and r what the
observations have of their own, of covariance R. With S = J U J' + R, the covariance that d has before it is seen,

    e = U J' S^-1 d,    its covariance afterwards U - U J' S^-1 J U,    chi-square = d' S^-1 d

The *rank* is the trace of J U J' S^-1: each combination of inputs counts by the share of its variance that the observations
take away, 1 where they determine it, 0 where they show nothing of it. What they do not determine stays as it was.

A *single error* is one input that is off by more than is stated while all else is as stated: J_k' S^-1 d / J_k' S^-1 J_k. The
largest of them, in their uncertainties, is the test. How often it is as large by chance is counted on drawn inputs, each of the
distribution that is stated: a sum of few rectangular ones has no tails.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from goniotwin.app.campaign.measurement_model.alignment import FLOOR, Alignment
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.arrays import Floats

HALF_KNOWN = 0.5
"""A combination is determined where the observations take more than this share of its variance away."""
LEAST_SHARE = 1e-9
"""Share of the largest effect below which an input has none."""
DRAWS = 50_000
AT_ONCE = 5_000


@dataclass(frozen=True)
class SingleError:
    """An error of one input beyond what is stated, that would explain observations: its `size` and `u`, in the input's unit."""

    input: InputQuantity
    size: float
    u: float

    @property
    def z(self) -> float:
        """The size in its uncertainties."""
        return self.size / self.u


@dataclass(frozen=True)
class PosteriorAlignment(Alignment):
    """Inputs as they are known after observations, about what was known `before`.

    In a budget they keep their names: its modes are the uncorrelated inputs before the observations, each with what these leave
    of its effects, and the observations' own errors.
    """

    before: Alignment
    left: tuple[tuple[InputQuantity, ...], Floats]

    @property
    def of_place(self) -> Alignment | None:
        """What was known before: a scan shows where the light comes from, and hardly by which mirror."""
        return self.before if self.before.source else None

    @cached_property
    def modes(self) -> tuple[tuple[InputQuantity, ...], Floats]:
        """Uncorrelated inputs, and the change (inputs, these) of each input for one unit of them."""
        return self.left

    def mode_errors(self, drawn: Mapping[str, float]) -> dict[str, float]:
        """The modes of the alignment before, by name; inputs that have kept their names are drawn by these."""
        return self.before.mode_errors(drawn)


@dataclass(frozen=True)
class Posterior:
    """The inputs of `before` after observations (m,): their `residual` is what they are beside their expectation.

    `sensitivity` (m, inputs) is the change of the observations for one unit of each input, and `own` (m, m) the covariance of
    what they have of their own.
    """

    before: Alignment
    residual: Floats
    sensitivity: Floats
    own: Floats

    @cached_property
    def alignment(self) -> Alignment:
        """The inputs as they are known afterwards."""
        prior = self.before.covariance
        return replace(
            self.before,
            value=self.before.value + self._gain @ self.residual,
            covariance=prior - self._gain @ self.sensitivity @ prior,
        )

    def named_alignment(self, errors: Sequence[InputQuantity], source: str) -> PosteriorAlignment:
        """The same by uncorrelated inputs; `errors` are what each observation has of its own, with the variances in `own`.

        Its covariance is a sum of squares (Joseph), and so has no negative variance.
        """
        before, change = self._uncorrelated
        inputs, left = (*before, *errors), np.hstack([change - self._gain @ (self.sensitivity @ change), -self._gain])
        scaled, source = left * [each.u for each in inputs], ", ".join(filter(None, (self.before.source, source)))
        return PosteriorAlignment(
            self.before.inputs, self.alignment.value, scaled @ scaled.T, source, self.before, (inputs, left)
        )

    def left(self, sensitivity: Floats) -> Floats:
        """The effects (..., inputs) of the inputs as they were before, on values that are corrected by the observations."""
        return np.asarray(sensitivity - (sensitivity @ self._gain) @ self.sensitivity)

    @property
    def rank(self) -> float:
        """How many combinations of the inputs the observations determine; in part known ones count in part."""
        return float(self._known.sum())

    @property
    def determined(self) -> int:
        """How many combinations they determine for the most part."""
        return int(np.sum(self._known > HALF_KNOWN))

    @property
    def chi_square(self) -> float:
        """That of the residuals with all that was known before; its expectation is the number of observations."""
        return float(self.residual @ self._inverse @ self.residual)

    @cached_property
    def single_errors(self) -> list[SingleError]:
        """The errors of each input alone that would explain the residuals, the most likely first."""
        u = 1.0 / np.linalg.norm(self._effects, axis=0)
        size = u**2 * (self._effects.T @ self._white @ self.residual)
        found = [
            SingleError(self.before.inputs[k], *each) for k, *each in zip(self._acting, size.tolist(), u.tolist(), strict=True)
        ]
        return sorted(found, key=lambda each: -abs(each.z))

    @cached_property
    def chance(self) -> float:
        """How often the largest single error is as large, in its uncertainties, where all is as stated."""
        if not self._acting:
            return 1.0
        rng, largest, beyond = np.random.default_rng(0), abs(self.single_errors[0].z), 0
        directions = self._effects / np.linalg.norm(self._effects, axis=0)
        of_own = self._white @ np.linalg.cholesky(self.own + self._floor)
        modes, by_mode = self._uncorrelated
        by_mode = self._white @ self.sensitivity @ by_mode
        for _ in range(DRAWS // AT_ONCE):
            errors = np.stack([_drawn(each, rng) for each in modes])
            drawn = by_mode @ errors + of_own @ rng.standard_normal((self.residual.size, AT_ONCE))
            beyond += int(np.sum(np.abs(directions.T @ drawn).max(axis=0) >= largest))
        return (beyond + 1) / (DRAWS + 1)

    @property
    def _uncorrelated(self) -> tuple[Sequence[InputQuantity], Floats]:
        """Uncorrelated inputs: those before, or the modes of their covariance; and what one unit of each does to these."""
        if np.count_nonzero(self.before.covariance) > len(self.before.inputs):
            return self.before.modes
        return self.before.inputs, np.eye(len(self.before.inputs))

    @cached_property
    def _floor(self) -> Floats:
        return FLOOR * np.eye(self.residual.size)

    @cached_property
    def _white(self) -> Floats:
        """W with W' W = S^-1."""
        inputs = self.sensitivity @ self.before.covariance @ self.sensitivity.T
        return np.asarray(np.linalg.inv(np.linalg.cholesky(inputs + self.own + self._floor)))

    @property
    def _inverse(self) -> Floats:
        return np.asarray(self._white.T @ self._white)

    @cached_property
    def _gain(self) -> Floats:
        return np.asarray(self.before.covariance @ self.sensitivity.T @ self._inverse)

    @cached_property
    def _known(self) -> Floats:
        """The share (m,) of the variance of each combination that the observations take away."""
        expected = self._white @ self.sensitivity
        return np.asarray(np.maximum(np.linalg.eigvalsh(expected @ self.before.covariance @ expected.T), 0.0))

    @cached_property
    def _acting(self) -> list[int]:
        """The inputs with an effect."""
        effect = np.linalg.norm(self._white @ self.sensitivity, axis=0) * [each.u for each in self.before.inputs]
        return [k for k, each in enumerate(effect.tolist()) if each > LEAST_SHARE * effect.max()]

    @cached_property
    def _effects(self) -> Floats:
        """What one unit of each acting input does to the observations, in their uncertainties."""
        return np.asarray((self._white @ self.sensitivity)[:, self._acting])


def _drawn(each: InputQuantity, rng: np.random.Generator) -> Floats:
    """Errors of an input, of its distribution."""
    if each.distribution == "rectangular":
        return math.sqrt(3.0) * each.u * rng.uniform(-1.0, 1.0, AT_ONCE)
    return each.u * rng.standard_normal(AT_ONCE)
