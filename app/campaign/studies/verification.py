"""Verification of measured values: against physics (reciprocity, energy) and against each other, with their covariances.

A verdict `holds`, `warns` or `fails`, with figures; where the schedule measures nothing for it, there is nothing to judge. The
checks of symmetry, overlaps and drift are those of the reduction. Where a campaign observes inputs of its own, the verdict has
it as evidence: what it determines, and whether that contradicts what is stated.
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from goniotwin.app.campaign.geometry.directions import is_lower, polar_from_zenith, round_azimuth
from goniotwin.app.campaign.measurement_model.alignment import Alignment, chance_of
from goniotwin.app.campaign.measurement_model.inputs import quantity
from goniotwin.app.campaign.measurement_model.posterior import Posterior
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.evidence import SignalEvidence
from goniotwin.app.campaign.reduction.points import BsdfPoints, Tally, plausible
from goniotwin.app.campaign.reduction.reading_inputs import gain_input
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.campaign.schedule.refinement import StatedSymmetry
from goniotwin.app.campaign.studies.budget import Budget, reflectance
from goniotwin.app.campaign.studies.checks import ConsistencyChecks
from goniotwin.app.campaign.studies.closure import BY_CHANCE, DIFFERS
from goniotwin.app.campaign.studies.evaluation import Evaluation
from goniotwin.app.campaign.studies.notes import calibration_notes
from goniotwin.app.campaign.studies.pose_evidence import UNLIKELY
from goniotwin.app.campaign.studies.reflectance import integration_settings, quadrature
from goniotwin.app.campaign.wording import number_list
from goniotwin.app.rig import RigFile
from goniotwin.app.rig.inputs import MONITOR_DRIFT
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import fold_azimuth, incidence_deg, round_deg

Outcome = Literal["holds", "warns", "fails", "nothing to judge"]
NOTHING: Outcome = "nothing to judge"
MOST_U = 2.0
"""A reflectance above 1 by so many standard uncertainties is not possible."""
MOST_NOT_MEASURED = 0.1
"""Share of the energy in directions without a trusted value, and beyond the last ones, above which a verdict warns."""
REMEDIES = {
    "reciprocity": "Check the alignment of the rig (goniotwin align), then repeat the reference standard's measurement.",
    "energy": "Check the certificate and the surface of the reference standard, and whether its readings are saturated.",
    "symmetry": 'Measure all half planes: symmetry = "anisotropic" in the schedule.',
    "overlaps": "Clean the photodiodes, or write calibrate = true in [overlap].",
    "instrument signature": "Screen stray light at the sample unit.",
    "missing directions": "Saturated directions need a lower gain; the others need more shifts or beta angles.",
    "gain linkage": "Have the converter's gains calibrated; until then read at the certified gain alone.",
    "pose by the open beam": "Align the rig, or state larger angles in [uncertainty] of the rig file.",
    "alignment": "Align the rig, or state larger angles in [uncertainty] of the rig file.",
    "closure": "Check the reference standard and its certificate, then repeat the scan of the open beam.",
    "standards": "Clean both standards and compare them again; if they still differ, have them calibrated.",
    "drift": "Let the lamp warm up for longer ([warm_up]), then repeat the flagged rows.",
}
"""By check, what a person does where it warns or fails."""
MOST_TOGETHER = 500
"""Pairs whose full covariance is used; of more, so many are taken evenly."""
MOST_PAIRS_AT_ONCE = 5_000


@dataclass(frozen=True)
class Evidence:
    """What so many `observations` show `of` inputs of the campaign: `rank` is how many combinations of them they determine.

    `chi_square` is that of the observations before they are seen, about their number where all is as stated, and `chance` how
    often the largest single error, or chi-square, is as large.
    """

    of: str
    observations: int
    rank: float
    chi_square: float
    chance: float

    @classmethod
    def by(cls, of: str, found: Posterior) -> "Evidence":
        """That of a posterior."""
        return cls(of, found.residual.size, found.rank, found.chi_square, found.chance)


@dataclass(frozen=True)
class Verdict:
    """One check by `name`: its verdict, the reason in one line, and its figures; of observed inputs the `evidence`."""

    name: str
    verdict: Outcome
    text: str
    figures: dict[str, Any] = field(default_factory=dict)
    evidence: Evidence | None = None

    @property
    def remedy(self) -> str:
        """What a person does about it; empty where it holds, and where there is nothing to judge."""
        return REMEDIES[re.split(" of | at ", self.name)[0]] if self.verdict in ("warns", "fails") else ""

    def as_dict(self) -> dict[str, Any]:
        """The verdict for JSON."""
        own = {} if self.evidence is None else {"evidence": vars(self.evidence)}
        return {"name": self.name, "verdict": self.verdict, "text": self.text, "remedy": self.remedy, **self.figures, **own}


def verdicts_text(verdicts: Iterable[Verdict]) -> str:
    """The number of verdicts by outcome, with the names of those that do not hold."""
    of = {word: [each.name for each in verdicts if each.verdict == word] for word in ("fails", "warns", "holds")}
    parts = [
        f"{len(of[word])} {text}: {', '.join(of[word])}" for word, text in (("fails", "fail"), ("warns", "warn")) if of[word]
    ]
    return "Checks: " + "; ".join([*parts, f"{len(of['holds'])} hold"])


def verify_journal(evaluation: Evaluation) -> list[Verdict]:
    """All verdicts on a journal, by sample and check. Raises UserError as the reduction does."""
    reduction = evaluation.reduction
    verdicts: list[Verdict] = []
    tallies: dict[str, Tally] = {}
    for name in reduction.schedule.samples:
        of_sample = _Sample(reduction, name)
        if not of_sample.tally.directions:
            verdicts.append(Verdict(name, NOTHING, "no value of it has been measured"))
            continue
        tallies[name] = of_sample.tally
        verdicts += of_sample.verdicts()
    return [
        *verdicts,
        _gains(reduction),
        _pose(evaluation),
        _alignment(evaluation),
        _closure(evaluation),
        _standards(evaluation),
        _drift(reduction, tallies),
    ]


def evidence_text(verdicts: Sequence[Verdict]) -> str:
    """A table of what a campaign observes of its own inputs, a line for each verdict with evidence; empty without one."""
    lines = [
        f"  {each.name:22}  {found.of:38}  {found.observations:6d}  {found.rank:5.1f}  {found.chi_square:10.1f}  "
        f"{100.0 * found.chance:9.3g}  {each.verdict}"
        for each in verdicts
        if (found := each.evidence) is not None
    ]
    head = f"  {'evidence':22}  {'of':38}  values   rank  chi-square  chance, %  verdict"
    return "\n".join([head, *lines]) if lines else ""


class _Sample:
    """The points of one sample, read once: what each check keeps of them."""

    def __init__(self, reduction: Reduction, name: str) -> None:
        self._reduction, self._name = reduction, name
        self._checks = ConsistencyChecks(reduction, name)
        self.tally = Tally()
        self._reciprocal: list[BsdfPoints] = []
        self._energies: list[Budget] = []
        self._shares: list[Floats] = []
        self._parts: list[list[float]] = []
        sigmas = grid_values(reduction.schedule.sigma_deg)
        incidences = round_deg([incidence_deg(sigma) for sigma in sigmas])
        overlaps = reduction.overlaps(name)
        for block in reduction.blocks(name):
            self._checks.add(block.points)
            points = reduction.finish(name, block.points, overlaps)
            self.tally.add(points)
            of_sigmas = points.good & np.isin(round_deg(polar_from_zenith(points.zenith_deg)), incidences)
            self._reciprocal.append(points.where(of_sigmas))
            self._add_energy(points)
            above_noise = points.good & ~points.flag("under-range") & np.isfinite(points.signature)
            self._shares.append(points.signature[above_noise])

    def verdicts(self) -> Iterator[Verdict]:
        """The verdicts on this sample."""
        yield self._reciprocity()
        yield self._energy()
        yield self._symmetry()
        yield self._overlaps()
        yield self._signature()
        yield self._directions()

    def _add_energy(self, points: BsdfPoints) -> None:
        for setting in integration_settings(points):
            here = points.where(setting.index)
            rule = quadrature(here, self._reduction.schedule.symmetry)
            value = np.where(rule.weight != 0.0, here.bsdf, 0.0)
            if rule.hemisphere:
                parts = (rule.weight, rule.obstructed, rule.extrapolated)
                self._parts.append([float(np.sum(part * value)) for part in parts])
                self._energies.append(reflectance(self._reduction.settings, self._name, points, setting))

    def _reciprocity(self) -> Verdict:
        name = f"reciprocity of {self._name}"
        points = BsdfPoints.join(self._reciprocal)
        one, other = reciprocal_pairs(points, self._reduction.schedule.symmetry)
        if not one.size:
            return Verdict(
                name, NOTHING, "no pair of values has light and view exchanged; measure at zenith angles that are sigmas"
            )
        difference, u = _differences(points, one, other, self._reduction)
        z = difference / u
        k = int(np.argmax(np.abs(z)))
        at = (
            f"{points.wavelength_nm[one[k]]:g} nm, sigma {points.sigma_deg[one[k]]:g}, zenith {points.zenith_deg[one[k]]:g}, "
            f"azimuth {points.azimuth_deg[one[k]]:g} deg"
        )
        worst, beyond = float(np.abs(z[k])), float(np.mean(np.abs(z) > MOST_U))
        # Errors that values share make differences of one sign: chi-square needs the covariance of the pairs.
        some = np.unique(np.linspace(0, one.size - 1, min(one.size, MOST_TOGETHER)).astype(np.int64))
        covariance = _covariance_of_differences(points, one[some], other[some], self._reduction)
        chi_square = float(difference[some] @ np.linalg.solve(covariance, difference[some]))
        holds = plausible(z.size, 0.0, worst) and plausible(some.size, chi_square, 0.0)
        text = (
            f"{z.size} pairs, {100.0 * beyond:.1f} % of them differ by more than 2 u, worst {worst:.1f} u at {at}; "
            f"chi-square of {some.size} pairs with their covariance {chi_square:.1f}"
        )
        figures = {
            "pairs": int(z.size),
            "judged": int(some.size),
            "chi_square": chi_square,
            "worst_u": worst,
            "beyond_2u": beyond,
        }
        return Verdict(name, "holds" if holds else "fails", text, figures)

    def _energy(self) -> Verdict:
        name = f"energy of {self._name}"
        if not self._energies:
            return Verdict(name, NOTHING, "no half sphere of directions has been measured, so there is no reflectance")
        z = [(each.value - 1.0) / each.u if each.u else math.inf * (each.value - 1.0) for each in self._energies]
        k = int(np.argmax(z))
        largest = self._energies[k]
        setting = largest.title.rsplit(f"{self._name}, ", 1)[-1]
        text = f"{len(z)} reflectances, the largest against 1 is {largest.value:.4f} (u {largest.u:.4f}), at {setting}"
        listed = [{"of": each.title, "value": each.value, "u": each.u} for each in self._energies]
        fails = z[k] > MOST_U
        if fails:
            text += f": more light than arrives, by {z[k]:.1f} u"
        return Verdict(name, "fails" if fails else "holds", text, {"reflectances": listed, "largest_z": float(z[k])})

    def _symmetry(self) -> Verdict:
        name = f"symmetry of {self._name}"
        result = self._checks.symmetry()
        if result is None or not result.pairs:
            return Verdict(name, NOTHING, str(result) if result is not None else "the schedule has no [symmetry_check]")
        return Verdict(name, "holds" if result.holds else "fails", str(result), result.as_dict())

    def _overlaps(self) -> Verdict:
        name = f"overlaps of {self._name}"
        result = self._checks.overlaps()
        if not result.pairs:
            return Verdict(name, NOTHING, "no direction was measured by two photodiodes")
        factors = "; ".join(calibration_notes(self._reduction, result))
        text = f"{result}; {factors}" if factors else str(result)
        return Verdict(name, "holds" if result.agree else "fails", text, result.as_dict())

    def _signature(self) -> Verdict:
        name = f"instrument signature at {self._name}"
        shares = np.concatenate(self._shares)
        if not shares.size:
            return Verdict(name, NOTHING, "no signal without a sample was measured")
        u = self._reduction.rig.file.sample_unit.signature_uncertainty
        median, largest = float(np.median(shares)), float(np.max(shares))
        size = f"median {100.0 * median:.2f} %, at most {100.0 * largest:.2f} %"
        text = f"{size} of a signal above its noise; subtracted, with a u of {100.0 * u:.2g} % of it"
        return Verdict(name, "holds", text, {"median_share": median, "largest_share": largest})

    def _directions(self) -> Verdict:
        name, missing, measured = f"missing directions of {self._name}", self.tally.missing, self.tally.directions
        figures: dict[str, Any] = {"missing": missing, "directions": measured}
        text = (
            f"{sum(missing.values())} of {measured} directions have no trusted value: {self.tally.missing_in_words}"
            if missing
            else f"all {measured} directions have a trusted value"
        )
        total, interpolated, extrapolated = np.sum(self._parts, axis=0).tolist() if self._parts else (0.0, 0.0, 0.0)
        if total <= 0.0:
            return Verdict(name, NOTHING, f"{text}; no half sphere has been measured, so the energy there is unknown", figures)
        interpolated, extrapolated = abs(interpolated / total), abs(extrapolated / total)
        figures |= {"interpolated_energy": interpolated, "extrapolated_energy": extrapolated}
        text += (
            f"; {100.0 * interpolated:.2f} % of the energy is interpolated there, {100.0 * extrapolated:.2f} % is beyond the "
            "last directions"
        )
        if "clipped" in missing:  # whatever is interpolated over a peak is less than the peak
            return Verdict(name, "warns", f"{text}; saturated directions have more than that", figures)
        if interpolated + extrapolated > MOST_NOT_MEASURED:
            limit = f"{100.0 * MOST_NOT_MEASURED:g} %"
            return Verdict(name, "warns", f"{text}: more than {limit} of the energy is not measured", figures)
        return Verdict(name, "holds", text, figures)


def reciprocal_pairs(points: BsdfPoints, symmetry: StatedSymmetry) -> tuple[Ints, Ints]:
    """Indices of the pairs of values with light and view exchanged, each pair once.

    In the sample's frame the light comes from the azimuth -gamma, and the view is at the azimuth phi - gamma: exchanged, gamma
    becomes gamma - phi and phi becomes -phi. What the stated symmetry makes alike counts as one.
    """
    lit, seen = points.back, is_lower(points.zenith_deg)
    incidence = round_deg([incidence_deg(sigma) for sigma in points.sigma_deg.tolist()])
    polar = round_deg(polar_from_zenith(points.zenith_deg))
    azimuth = np.where((polar == 0.0) | (incidence == 0.0), 0.0, round_azimuth(points.azimuth_deg))
    gamma = round_azimuth(points.gamma_deg)

    def keys(light: Flags, i: Floats, view: Flags, r: Floats, turned: Floats, phi: Floats) -> Floats:
        turned, phi = round_azimuth(turned), round_azimuth(phi)
        if symmetry == "isotropic":
            turned, phi = np.zeros(phi.size), round_deg(fold_azimuth(phi))
        elif symmetry == "plane-symmetric":
            other = round_azimuth(-turned), round_azimuth(-phi)
            swap = (other[0] < turned) | ((other[0] == turned) & (other[1] < phi))
            turned, phi = np.where(swap, other[0], turned), np.where(swap, other[1], phi)
        return np.stack([round_deg(points.wavelength_nm), light, i, view, r, turned, phi], axis=1)

    own = keys(lit, incidence, seen, polar, gamma, azimuth)
    exchanged = keys(seen, polar, lit, incidence, gamma - azimuth, -azimuth)
    _, number = np.unique(np.concatenate([own, exchanged]), axis=0, return_inverse=True)
    number = number.ravel()
    of_own, of_exchanged = number[: points.size], number[points.size :]
    first: dict[int, int] = {}
    for k, each in enumerate(of_own.tolist()):
        first.setdefault(each, k)
    found = [
        (k, first[partner])
        for k, (each, partner) in enumerate(zip(of_own.tolist(), of_exchanged.tolist(), strict=True))
        if each < partner and partner in first
    ]
    pairs = np.array(found, dtype=np.int64).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1]


def _differences(points: BsdfPoints, one: Ints, other: Ints, reduction: Reduction) -> tuple[Floats, Floats]:
    """Differences (m,) of pairs of values, and their standard uncertainties with the covariance of the two."""
    differences, variances = [], []
    for begin in range(0, one.size, MOST_PAIRS_AT_ONCE):
        a, b = one[begin : begin + MOST_PAIRS_AT_ONCE], other[begin : begin + MOST_PAIRS_AT_ONCE]
        used, place = np.unique(np.concatenate([a, b]), return_inverse=True)
        a, b = place.ravel()[: a.size], place.ravel()[a.size :]
        effects = effects_of(points.where(used), reduction.settings)
        own = [effects.paired_covariance(each, each) for each in (a, b)]
        variances.append(own[0] + own[1] - 2.0 * effects.paired_covariance(a, b))
        differences.append(points.bsdf[used[a]] - points.bsdf[used[b]])
    return np.concatenate(differences), np.sqrt(np.maximum(np.concatenate(variances), np.finfo(float).tiny))


def _covariance_of_differences(points: BsdfPoints, one: Ints, other: Ints, reduction: Reduction) -> Floats:
    """Covariance matrix (m, m) of the differences of pairs of values."""
    used, place = np.unique(np.concatenate([one, other]), return_inverse=True)
    a, b = place.ravel()[: one.size], place.ravel()[one.size :]
    effects = effects_of(points.where(used), reduction.settings)
    crossed = effects.covariance(a, b)
    return effects.covariance(a, a) + effects.covariance(b, b) - crossed - crossed.T


def _gains(reduction: Reduction) -> Verdict:
    """The gain linkage: ratios of gains in rows that were read at two of them, against each other and the certificate."""
    evidence, name = reduction.measurements.evidence, "gain linkage"
    found = evidence.findings
    figures = {"ratios": evidence.ratios, "worst_u": evidence.worst_ratio, "unsound": np.flatnonzero(evidence.unsound).tolist()}
    by_rows = None
    if evidence.linked is not None:
        by_rows = Evidence.by("gains of photodiodes against each other", _linked_gains(evidence, reduction.rig.file))
    if found:
        return Verdict(name, "fails", "; ".join(found), figures, by_rows)
    if not evidence.ratios:
        return Verdict(name, NOTHING, "too few rows were read at two gains that are not saturated, and with light", figures)
    text = f"{evidence.ratios} ratios of gains were measured, the worst is {evidence.worst_ratio:.1f} u from the nominal one"
    return Verdict(name, "holds", text, figures, by_rows)


def _linked_gains(evidence: SignalEvidence, rig: RigFile) -> Posterior:
    """The gains of all photodiodes after the rows that were read at two of them, with their certificate before."""
    assert evidence.linked is not None
    linked, photodiodes = evidence.linked, evidence.linked.value.shape[1]
    gains = linked.step.shape[1]
    of_gains = Alignment.stated([gain_input(number, rig) for number in range(photodiodes * gains)])
    pair, photodiode = np.nonzero(linked.weight)
    sensitivity = np.zeros((pair.size, photodiodes, gains))
    sensitivity[np.arange(pair.size), photodiode] = linked.step[pair]
    own = np.diag(1.0 / linked.weight[pair, photodiode])
    return Posterior(of_gains, linked.value[pair, photodiode], sensitivity.reshape(pair.size, -1), own)


def _pose(evaluation: Evaluation) -> Verdict:
    """Light against view by the scans of the open beam, with the inputs of pose as they are stated or aligned."""
    name, found, report = "pose by the open beam", evaluation.pose, evaluation.closure
    if found is None:
        return Verdict(name, NOTHING, "; ".join((*report.not_planned, *report.missing)) or "no input of pose is stated")
    evidence = Evidence.by("light against view, along and across", found.posterior)
    used = "; values are corrected by it" if evaluation.reduction.settings.alignment is found.alignment else ""
    return Verdict(name, found.verdict, found.text + used, found.as_dict(), evidence)


def _alignment(evaluation: Evaluation) -> Verdict:
    """The misalignments that the campaign corrects its values for, against what is stated of the inputs of pose."""
    name, found = "alignment", evaluation.aligned
    if found is None:
        return Verdict(name, NOTHING, evaluation.not_aligned or "the schedule does not align by a sample")
    departure, count = found.alignment.departure
    chance = chance_of(departure, count)
    evidence = Evidence("light, view, and the tilt of the sample", found.values, found.alignment.rank, departure, chance)
    text = f"{count} combinations of the inputs of pose, chi-square {departure:.1f} by what is stated of them"
    if chance < UNLIKELY:
        text += "; the rig is off by more than is stated: values are corrected, state larger angles in [uncertainty]"
    text = "; ".join((text, *found.findings))
    return Verdict(
        name, "warns" if found.findings or chance < UNLIKELY else "holds", text, {"chi2": found.chi_square}, evidence
    )


def _closure(evaluation: Evaluation) -> Verdict:
    """The closure of the etalon's scale with that of the open beam, and the field of view by its scan."""
    name, report = "closure", evaluation.closure
    if not report.closures and report.field is None:
        return Verdict(name, NOTHING, "; ".join((*report.not_planned, *report.missing)) or report.verdict)
    text = "; ".join(report.alarms) or f"{report.verdict}; {report.field}"
    verdict: Outcome = "fails" if report.alarms else "holds"
    if report.field is not None and report.alarms == [str(report.field)] and abs(report.field.z) <= DIFFERS:
        verdict = "warns"  # its own u explains it on one campaign in twenty
    return Verdict(name, verdict, text, report.as_dict())


def _standards(evaluation: Evaluation) -> Verdict:
    """The comparison of the two reference standards."""
    name, report = "standards", evaluation.standards
    if report is None:
        return Verdict(name, NOTHING, "the schedule has no [second_standard]")
    if report.together is None:
        return Verdict(name, NOTHING, report.verdict)
    verdict: Outcome = "fails" if report.apart else "warns" if report.differs else "holds"
    return Verdict(name, verdict, report.verdict, report.as_dict())


def _drift(reduction: Reduction, tallies: dict[str, Tally]) -> Verdict:
    """The drift checks: by the limit of the schedule, and all together against the stated drift of the monitor."""
    if reduction.schedule.drift is None:
        return Verdict("drift", NOTHING, "the schedule has no [drift]")
    intervals = [str(each) for each in reduction.measurements.drift_intervals]
    unchecked = {name: number_list(photodiodes) for name, photodiodes in reduction.unchecked(tallies).items()}
    listed = "; ".join(f"photodiodes {photodiodes} of {name}" for name, photodiodes in unchecked.items())
    text, evidence = "; ".join(intervals) or "every check is within the limit", None
    verdict: Outcome = "fails" if intervals else "holds"
    if (found := _monitor_drift(reduction)) is not None:
        evidence = Evidence.by("monitor's drift against the light", found)
        if verdict == "holds" and found.chance < UNLIKELY:
            (error,) = found.single_errors
            verdict = "fails" if found.chance < BY_CHANCE else "warns"
            text += (
                f", but all together show the monitor drift by {100.0 * error.size:+.3f} % an hour against the light (u "
                f"{100.0 * error.u:.3f} %), more than {MONITOR_DRIFT.key} of [uncertainty] states: state that"
            )
    return Verdict(
        "drift",
        verdict,
        f"{text}; not covered: {listed}" if listed else text,
        {"intervals": intervals, "unchecked": unchecked},
        evidence,
    )


def _monitor_drift(reduction: Reduction) -> Posterior | None:
    """The monitor's drift by all drift checks; None without one after the first of a mounting, or where none is stated."""
    changes, table = reduction.measurements.drift_changes, reduction.rig.file.uncertainty
    if not changes or not table.u(MONITOR_DRIFT):
        return None
    mounting, hours, u = (
        np.array(each) for each in zip(*((each.mounting, each.hours, each.check.u_change) for each in changes), strict=True)
    )
    # Checks of one mounting have their first one in common: half of the variance of each.
    own = np.outer(u, u) * (0.5 * (mounting[:, None] == mounting) + 0.5 * np.eye(u.size))
    stated = Alignment.stated([quantity(MONITOR_DRIFT, table)])
    return Posterior(stated, np.array([each.check.change for each in changes]), -hours[:, None], own)
