"""What an alignment knows of the inputs of pose: their values, the covariance that is left, and what both do to a direction.

Many inputs cannot be distinguished: the data determine combinations of them. So after an alignment the inputs are correlated.
Their covariance is stated by uncorrelated modes, combinations `alignment[1]`, `alignment[2]`, ... with an uncertainty of their
own; in a budget these take the place of the inputs. A mode is in units of the uncertainties that were stated before: the u of
one that the data do not determine is 1.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.measurement_model.light_place import light_place
from goniotwin.app.campaign.measurement_model.pose import LIGHT, VIEW, Displacement, PoseEffects, Views, pose_effects
from goniotwin.app.rig.alignment import AlignmentFile, Combination
from goniotwin.arrays import Floats
from goniotwin.keys import MEASURED
from goniotwin.twin.optics import Instrument

DETERMINED = 0.5
"""The data determine a combination whose u is below this share of that stated before."""
MOVED = 1e-3
"""Combinations that differ by as much on fewer rigs show that this one has moved."""
ALIGNMENT = "alignment"
"""The component whose elements are the modes of an alignment."""
LARGEST_NAMED = 3
"""Inputs that the description of a mode names."""
LEAST_COEFFICIENT = 1e-4
"""Coefficients below this share of a combination's largest one are not in a file."""
ROUNDING = 1e-9
"""A correlation below this is that of rounded numbers."""
FLOOR = 1e-12
"""Added to the diagonal of a matrix of variances over those stated: one that is stated as 0 leaves it regular."""


def chance_of(chi_square: float, degrees: int) -> float:
    """How often a chi-square is as large; its cube root is nearly normal (Wilson, Hilferty 1931)."""
    spread = 2.0 / (9.0 * degrees)
    return 0.5 * math.erfc((math.cbrt(chi_square / degrees) - 1.0 + spread) / math.sqrt(2.0 * spread))


@dataclass(frozen=True)
class Alignment:
    """Inputs with the uncertainties stated before, their values (n,) as found, and their covariance (n, n), each in its unit.

    `source` names the file or the journal that they are from.
    """

    inputs: tuple[InputQuantity, ...]
    value: Floats
    covariance: Floats
    source: str

    @classmethod
    def stated(cls, inputs: Sequence[InputQuantity]) -> "Alignment":
        """The inputs as the rig file states them: uncorrelated, of mean 0. Those without an uncertainty are not in it."""
        known = tuple(each for each in inputs if each.u > 0.0)
        return cls(known, np.zeros(len(known)), np.diag([each.u**2 for each in known]), "")

    @classmethod
    def of_file(cls, file: AlignmentFile, inputs: Sequence[InputQuantity], source: str) -> "Alignment":
        """Inputs with the combinations of a file; what these do not determine is as stated.

        With the combinations a = A x, of prior covariance A U A', where the file has a = m with the covariance S: the values
        are G m with G = U A' (A U A')^-1, and the covariance is U - G (A U A' - S) G'. The file's `inputs` come before these
        values.
        """
        before = cls.stated(inputs)
        names = [each.name for each in before.inputs]
        rows = np.array([[each.coefficients.get(name, 0.0) for name in names] for each in file.combinations])
        rows = rows.reshape(len(file.combinations), len(names))
        scale = np.array([each.u for each in before.inputs])
        scaled = rows * scale
        size = np.linalg.norm(scaled, axis=1)
        used = size > 0.0
        # In units of the stated uncertainties, each combination of length 1.
        unit = scaled[used] / size[used, None]
        value = np.array([each.value for each in file.combinations])[used] / size[used]
        after = np.array(file.covariance).reshape(used.size, used.size)[np.ix_(used, used)] / np.outer(size[used], size[used])
        prior = unit @ unit.T
        gain = np.linalg.solve(prior + FLOOR * np.eye(len(prior)), unit).T
        covariance = np.eye(len(names)) - gain @ (prior - after) @ gain.T
        found = scale * (gain @ value)
        # The file's own values make the same combinations, and have the slit's image where it is.
        found = np.array([file.inputs.get(name, each) for name, each in zip(names, found.tolist(), strict=True)])
        return replace(before, value=found, covariance=scale[:, None] * covariance * scale, source=source)

    def only(self, names: Sequence[str]) -> "Alignment":
        """What is known of some of the inputs alone."""
        chosen = [k for k, each in enumerate(self.inputs) if each.name in names]
        return Alignment(
            tuple(self.inputs[k] for k in chosen), self.value[chosen], self.covariance[np.ix_(chosen, chosen)], self.source
        )

    def widened(self, chi_square: float) -> "Alignment":
        """The same where the residuals have a chi-square above 1 per degree of freedom: variances in proportion (Birge).

        None becomes larger than it is stated, where it is not so already.
        """
        values, vectors = self._eigen
        wide = np.minimum(chi_square * values, np.maximum(values, 1.0))
        u = self._stated
        return replace(self, covariance=u[:, None] * (vectors * wide @ vectors.T) * u)

    @property
    def of_place(self) -> "Alignment | None":
        """What is known of the place of the slit's image."""
        return self

    def with_inputs(self, inputs: Sequence[InputQuantity]) -> "Alignment":
        """The same with further inputs as they are stated; those that it has already stay as they are."""
        further = Alignment.stated([each for each in inputs if each.name not in self.values])
        n, m = len(self.inputs), len(further.inputs)
        covariance = np.zeros((n + m, n + m))
        covariance[:n, :n], covariance[n:, n:] = self.covariance, further.covariance
        return Alignment(self.inputs + further.inputs, np.append(self.value, further.value), covariance, self.source)

    @cached_property
    def values(self) -> Mapping[str, float]:
        """The value of each input by its name."""
        return {each.name: value for each, value in zip(self.inputs, self.value.tolist(), strict=True)}

    @cached_property
    def _eigen(self) -> tuple[Floats, Floats]:
        """Eigenvalues, ascending, and eigenvectors of the covariance in units of the stated uncertainties."""
        u = self._stated
        values, vectors = np.linalg.eigh(self.covariance / np.outer(u, u))
        largest = np.abs(vectors).argmax(axis=0)
        return np.maximum(values, 0.0), vectors * np.sign(vectors[largest, np.arange(values.size)])

    @property
    def rank(self) -> float:
        """How many combinations are determined: each counts by the share of its variance that is no longer there."""
        return float(np.sum(np.maximum(1.0 - self._eigen[0], 0.0)))

    @property
    def departure(self) -> tuple[float, int]:
        """Chi-square of the determined combinations by what was stated of them before, and their number."""
        values, vectors = self._eigen
        found = values < DETERMINED**2
        unit = vectors[:, found].T @ (self.value / self._stated)
        return float(np.sum(unit**2 / (1.0 - values[found]))), int(found.sum())

    @cached_property
    def _stated(self) -> Floats:
        return np.array([each.u for each in self.inputs])

    @cached_property
    def modes(self) -> tuple[tuple[InputQuantity, ...], Floats]:
        """The modes of the covariance, the best known first, and the change (inputs, modes) of each input for one of them."""
        values, vectors = self._eigen
        found = []
        for k, (value, vector) in enumerate(zip(values.tolist(), vectors.T, strict=True), 1):
            order = np.argsort(-np.abs(vector), kind="stable")[:LARGEST_NAMED]
            about = ", ".join(self.inputs[i].name for i in order.tolist())
            shared = "all values, tilts of a sample those of its mounting"
            source = f"{self.source}: {about}" if self.source else about
            found.append(
                InputQuantity(f"{ALIGNMENT}[{k}]", "1", float(np.sqrt(value)), "normal", shared, source, "", origin=MEASURED)
            )
        return tuple(found), self._stated[:, None] * vectors

    def mode_errors(self, drawn: Mapping[str, float]) -> dict[str, float]:
        """The modes by name of the differences of `drawn` values of the inputs from those found."""
        difference = np.array([drawn[each.name] for each in self.inputs]) - self.value
        modes, _ = self.modes
        _, vectors = self._eigen
        found = (vectors.T @ (difference / self._stated)).tolist()
        return {each.name: value for each, value in zip(modes, found, strict=True)}

    def agrees_with(self, other: "Alignment") -> bool:
        """Whether the combinations that are determined here are, within both uncertainties, where another alignment has them.

        That is of other data. It fails once in a thousand where nothing has moved (chi-square of all combinations).
        """
        known = other.with_inputs(self.inputs)
        order = [[each.name for each in known.inputs].index(each.name) for each in self.inputs]
        values, vectors = self._eigen
        rows = (vectors[:, values < DETERMINED**2] / self._stated[:, None]).T
        difference = rows @ (self.value - known.value[order])
        covariance = rows @ (self.covariance + known.covariance[np.ix_(order, order)]) @ rows.T
        statistic = float(difference @ np.linalg.solve(covariance + FLOOR * np.eye(len(rows)), difference))
        if not len(rows):
            return True
        return chance_of(statistic, len(rows)) > MOVED

    def combinations(self, instrument: Instrument, before: "Alignment | None" = None) -> tuple[tuple[Combination, ...], Floats]:
        """The combinations that are determined, and their covariance (m, m) in deg^2.

        Their coefficients have the length 1, where an input in mm counts by the angle that it makes. `before` is what was known
        of the same inputs before; None for what is stated.
        """
        values, vectors = self._eigen
        determined = np.flatnonzero(values < DETERMINED**2)
        rows = (vectors[:, determined] / self._stated[:, None]).T
        rows /= np.linalg.norm(rows / self._turns(instrument), axis=1)[:, None]
        covariance = rows @ self.covariance @ rows.T
        u = np.sqrt(np.diag(covariance))
        covariance = np.where(np.abs(covariance) < ROUNDING * np.outer(u, u), 0.0, covariance)
        found = []
        for row, variance in zip(rows, np.diag(covariance).tolist(), strict=True):
            largest = LEAST_COEFFICIENT * float(np.abs(row / self._turns(instrument)).max())
            kept = np.abs(row / self._turns(instrument)) >= largest
            coefficients = {self.inputs[k].name: float(row[k]) for k in np.flatnonzero(kept).tolist()}
            prior_u = float(np.linalg.norm(row * self._stated) if before is None else np.sqrt(row @ before.covariance @ row))
            found.append(Combination(float(row @ self.value), float(np.sqrt(variance)), prior_u, coefficients))
        return tuple(found), covariance

    def _turns(self, instrument: Instrument) -> Floats:
        """For each input (n,) the angle, deg, that one unit of it makes: 1 for an angle."""
        light, arc = (float(np.degrees(1.0 / far)) for far in (instrument.pupil_distance_mm, instrument.arc_radius_mm))
        return np.array([1.0 if each.unit == "deg" else light if each.name in LIGHT else arc for each in self.inputs])


ZEROS = ("sigma_zero", "beta_zero", "shift_zero")


def halfway(views: Views, rig: Mapping[str, float]) -> Views:
    """The views half way from where the axes put them to where their zeros have them.

    The sensitivities there are those of the way as a whole, to the second order of the zeros.
    """
    sigma, beta, shift = (0.5 * rig.get(name, 0.0) for name in ZEROS)
    polar = views.polar + np.where(views.reverse, -1.0, 1.0) * np.radians(shift)
    return replace(
        views, sigma_deg=views.sigma_deg + sigma, azimuth=views.azimuth + np.radians(beta), polar=np.maximum(polar, 0.0)
    )


def known_displacement(
    instrument: Instrument, views: Views, rig: Mapping[str, float], mounted: Floats, *, lit: Instrument | None = None
) -> tuple[Displacement, PoseEffects]:
    """The displacement (n, 1) by known values of the `rig`'s inputs and of the sample's mounting (n, 3), and the sensitivities.

    `along` and `across` are in deg, `diffuse` is relative; the sensitivities are those `halfway`. Both have the
    light's place on the sample of the instrument `lit`, by default the same; without one where that is `lit_everywhere`.
    """
    effects = pose_effects(instrument, halfway(views, rig))
    lit = lit or instrument
    place = None if lit.lit_everywhere else light_place(lit, views, effects.common, rig)
    common = np.array([rig.get(name, 0.0) for name in (*LIGHT, *VIEW)])

    def total(of_rig: Floats, of_sample: Floats, beside: Floats | float = 0.0) -> Floats:
        return np.asarray(of_rig @ common + np.sum(of_sample * mounted, axis=1) + beside)[:, None]

    moved = Displacement(
        total(effects.common.along, effects.sample.along, 0.0 if place is None else place.along),
        total(effects.common.across, effects.sample.across, 0.0 if place is None else place.across),
        total(effects.common.diffuse, effects.sample.diffuse),
    )
    return moved, effects if place is None else replace(effects, common=place.added_to(effects.common))
