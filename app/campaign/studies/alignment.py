"""The alignment: a rig's misalignments from a narrow lobe that was measured, by the sensitivities that the budget uses.

A lobe that is round about the specular direction shows where that direction is: each value depends on the angle between them.
The logarithm of the lobe is a polynomial in the square of that angle, of one form for all incidences, with a scale and small
changes of its form for each of them. These are unknown, as are each photodiode's own angles and the positions of the axes after
each move, with the uncertainties that the rig file states. The inputs of pose are fitted to all values together: least squares
with the stated uncertainties as prior. One step is not enough: values are predicted anew, with the angles as found, and what is
left is fitted, until nothing changes (Gauss-Newton).

A scan of the open beam adds its centroid: it alone distinguishes light and arc in the plane of incidence.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.measurement_model.alignment import Alignment, known_displacement
from goniotwin.app.campaign.measurement_model.effects import Dense, Effects, Group, group_variance
from goniotwin.app.campaign.measurement_model.field import correct_logarithm, directions_covariance
from goniotwin.app.campaign.measurement_model.fit import Fit, ValuesCovariance
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.measurement_model.light_place import (
    distinct_poses,
    light_place,
    lit_spots,
    of_centres,
    spot_weights,
)
from goniotwin.app.campaign.measurement_model.pose import (
    MOUNTED,
    POSITIONS,
    RAD,
    Displacement,
    PoseEffects,
    Views,
    mounting_inputs,
    photodiode_inputs,
    position_u_deg,
    rig_inputs,
)
from goniotwin.app.campaign.measurement_model.slopes import Directions
from goniotwin.app.campaign.reduction.angles import angles, displacement_of, views_of_points
from goniotwin.app.campaign.reduction.components import INDEPENDENT, OTHER, kinds
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.points import BITS, BsdfPoints
from goniotwin.app.campaign.reduction.settings import ReductionSettings, mounted
from goniotwin.app.campaign.studies.closure import EDGE_SHARE, ScannedBeam
from goniotwin.app.campaign.studies.light_search import (
    LightSeen,
    LobeData,
    PlaceOfImage,
    flux_chi_square,
    image_by_inputs,
    nearest_lit,
    search_place,
)
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, nominal_instrument
from goniotwin.app.rig.alignment import (
    DOUBTED_CHI_SQUARE,
    REFUSED_CHI_SQUARE,
    AlignmentFile,
    Combination,
    residual_findings,
    residual_words,
)
from goniotwin.app.rig.inputs import ETALON_TILT, FIELD_OF_VIEW
from goniotwin.app.rig.uncertainty import UncertaintyTable
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import Instrument
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG

LEAST_SHARE = 0.01
"""Values below this share of the largest one of their incidence are not used: there the form of a lobe is less certain."""
WIDEST_DEG = 20.0
"""Values further from the specular direction are not used: no narrow lobe reaches so far."""
TERMS = 5
"""Terms of the polynomial, in the square of the angle over that of the furthest value."""
SCALE_U, FORM_U = 1.0, 0.01
"""Standard uncertainties of a lobe's logarithm: of its scale at each incidence, and of each further term's change with it."""
FREE_U = 100.0
"""Standard uncertainty of the terms that all incidences have in common: they are free."""
SIZE = "step"
"""Name of the input that is the size of a step."""
MOST_STEPS = 12
SETTLED = 0.05
"""A step that changes no mode by more than this share of its uncertainty is the last one."""
CENTROID_U_DEG = 0.002
"""Standard uncertainty of a scan's centroid by its steps; assumed."""
MIDDLE_U_MM = 0.01
"""Standard uncertainty of the light's middle at a pose by the model of a hole that is lit in part; assumed."""
LEAST_DARK = 0.01
"""Share of the hole from which on light is stated to miss it."""


@dataclass(frozen=True)
class FoundLight:
    """Where the slit's image is on the sample: its `place` in mm, in the plane of incidence and along y, and its `u`.

    `dark` is the largest share of the hole that it leaves dark, at `sigma_deg`.
    """

    place: tuple[float, float]
    u: tuple[float, float]
    dark: float
    sigma_deg: float

    @property
    def missing(self) -> bool:
        """Whether light misses part of the hole."""
        return self.dark > LEAST_DARK

    @property
    def text(self) -> str:
        """The same in plain words."""
        ways = " and ".join(
            f"{x:+.1f} mm (u {u:.1f}) {way}"
            for x, u, way in zip(self.place, self.u, ("in the plane of incidence", "across it"), strict=True)
        )
        image = f"the slit's image on the sample is off by {ways}"
        if not self.missing:
            return f"{image}; no dark part of the hole is seen"
        return (
            f"light misses part of the hole: {image}; at sigma {self.sigma_deg:g} deg {100.0 * self.dark:.0f} % of the hole is "
            "dark. Values are corrected for its direction; align the mirrors"
        )

    def as_dict(self) -> dict[str, Any]:
        """The light for JSON; mm, deg."""
        return {**vars(self), "missing": self.missing}


@dataclass(frozen=True)
class AlignmentResult:
    """What an alignment has found: rig and mountings of the sample together, in `alignment`; in `with_photodiodes` also the own
    angles of the photodiodes that have seen the lobe, which are correlated with the others.

    `combinations` are those that the data determine, with their `covariance` in deg^2. `chi_square` is that of the residuals of
    the predictions over its expectation, of `values` values. `scans` is the number of scans of the open beam in it. `light` is
    that on the sample; None where the rig file states no tilt of a mirror. `findings` state what the residuals show that no
    displacement of a lobe explains, and that part of the hole is dark. `before` names the alignment that it began with; it is
    empty where that is `[uncertainty]`.
    """

    sample: str
    mountings: tuple[str, ...]
    alignment: Alignment
    with_photodiodes: Alignment
    combinations: tuple[Combination, ...]
    covariance: Floats
    chi_square: float
    values: int
    scans: int
    light: FoundLight | None
    findings: tuple[str, ...]
    before: str = ""

    def as_dict(self) -> dict[str, Any]:
        """The result for JSON; angles in deg."""
        return {
            "sample": self.sample,
            "mountings": list(self.mountings),
            "values": self.values,
            "chi2": self.chi_square,
            "scans": self.scans,
            "combinations": self.combinations,
            "covariance": self.covariance.tolist(),
            "light": self.light,
            "findings": list(self.findings),
            "before": self.before or None,
        }


def alignment_file(result: AlignmentResult, journal: JournalReader, rig: RigDescription, measured: str) -> AlignmentFile:
    """The alignment file of a result; `measured` is the day of the measurement, or empty."""
    identity = rig.identity
    return AlignmentFile(
        alignment=1,
        simulated=journal.simulated,
        seed=rig.seed,
        rig=rig.file.name,
        rig_sha256=rig.digest,
        campaign=journal.value("name"),
        journal=journal.chain.tip,
        measured=measured,
        sample=result.sample,
        mountings=result.mountings,
        values=result.values,
        chi_square=result.chi_square,
        open_beam=result.scans,
        combinations=result.combinations,
        covariance=tuple(map(tuple, result.covariance.tolist())),
        inputs={name: value for name, value in result.alignment.values.items() if "@" not in name},
        before=result.before or None,
        geometry_sha256=identity.geometry,
        tables_sha256=dict(identity.tables),
    )


def lobe_points(points: BsdfPoints) -> BsdfPoints:
    """The points that an alignment can use: trusted values of reflected light in the upper part of each incidence's lobe."""
    # The scale of a lobe is free: a doubt about that of the etalon is no reason.
    trusted = replace(points, marks=points.marks & ~BITS["scale"])
    near = trusted.good & ~points.transmitted & ~points.flag("under-range") & (points.bsdf > 0.0)
    near &= points.theta_deg <= WIDEST_DEG
    _, which = np.unique(points.sigma_deg, return_inverse=True)
    peak = np.full(int(which.max(initial=-1)) + 1, math.inf)
    for k in range(peak.size):
        peak[k] = np.max(points.bsdf[near & (which == k)], initial=0.0)
    return points.where(near & (points.bsdf > LEAST_SHARE * peak[which]))


def estimate_alignment(
    points: BsdfPoints,
    settings: ReductionSettings,
    beams: Sequence[ScannedBeam] = (),
    source: str = "",
    seen: LightSeen | None = None,
) -> AlignmentResult:
    """The alignment by the points of one sample at one wavelength, before their corrections, and by scans of the open beam.

    Where the residuals are larger than those of displaced lobes the uncertainties are widened. Raises UserError, without the
    name of the journal, where they are those of no displaced lobe, or the points determine nothing.
    """
    found = fit_lobe(points, settings, beams, source, seen=seen)
    aligned, whole, chi_square = found.alignment, found.whole, found.chi_square
    if chi_square > REFUSED_CHI_SQUARE:
        raise UserError(f"{settings.sample}: {residual_words(chi_square)}; no alignment is made of it")
    if chi_square > DOUBTED_CHI_SQUARE:
        aligned, whole = (each.widened(chi_square) for each in (aligned, whole))
    before = None if settings.alignment is None else settings.alignment.with_inputs(aligned.inputs)
    combinations, covariance = aligned.combinations(nominal_instrument(settings.rig), before)
    if not combinations:
        raise UserError(
            f"{settings.sample}: its values determine no misalignment; measure a lobe some degrees wide, with less noise"
        )
    light, findings = None if found.place is None else found_light(found, settings), residual_findings(chi_square)
    if light is not None and light.missing:
        findings = (*findings, light.text)
    return AlignmentResult(
        settings.sample,
        found.mountings,
        aligned,
        whole,
        combinations,
        covariance,
        chi_square,
        found.points.size,
        found.scans,
        light,
        findings,
        "" if settings.alignment is None else settings.alignment.source,
    )


@dataclass(frozen=True)
class PoseSensitivities:
    """Relative change of values (n, inputs) of a lobe for one unit of the rig's inputs, LIGHT and VIEW, and of a mounting's."""

    rig: Floats
    mounting: Floats


@dataclass(frozen=True)
class LobeFit:
    """The inputs of pose fitted to a lobe: the `points` (n,) that were used, what was found, and the fit's last step.

    `whole` is the `alignment` with the photodiodes' own angles.
    `effects` and `residual` are those of the points, then those of `scans` scans: all inputs with their uncertainties before
    the fit, and what the values are beside a prediction without the modes of the prior. `step` is the size of a step in the
    fit, and its standard uncertainty. `place` is that of the slit's image by the values; None where the rig file states no tilt
    of a mirror. `lit`: the hole is taken as lit everywhere. `light` is the instrument by which the light on the sample is
    known.
    """

    points: BsdfPoints
    mountings: tuple[str, ...]
    scans: int
    alignment: Alignment
    whole: Alignment
    effects: Effects
    residual: Floats
    fit: Fit
    sensitivities: PoseSensitivities
    step: tuple[float, float]
    place: PlaceOfImage | None
    lit: bool
    light: Instrument

    @property
    def chi_square(self) -> float:
        """That of the values' residuals over its expectation: per degree of freedom."""
        of_values = slice(0, self.points.size)
        return float(self.fit.chi_square[of_values].sum() / self.fit.expected[of_values].sum())


def found_light(found: LobeFit, settings: ReductionSettings) -> FoundLight:
    """The light on the sample by a fit, at its incidences with the hole's sides along and across the plane of incidence."""
    instrument, aligned = nominal_instrument(settings.rig), found.alignment
    by_inputs = image_by_inputs(instrument, aligned)
    sigmas = np.unique(found.points.sigma_deg)
    poses = np.stack([sigmas, np.zeros(sigmas.size)], axis=1)
    dark = 1.0 - (np.ones(sigmas.size) if found.lit else lit_spots(found.light, poses, aligned.values).share)
    most = int(np.argmax(dark))
    place, covariance = by_inputs @ aligned.value, by_inputs @ aligned.covariance @ by_inputs.T
    u = tuple(math.sqrt(each) for each in np.diag(covariance).tolist())
    return FoundLight((float(place[0]), float(place[1])), (u[0], u[1]), float(dark[most]), float(sigmas[most]))


@dataclass(frozen=True)
class Step:
    """A change in the middle of the rows: `inputs` of the rig, or of all mountings, are off by one size more since `row`."""

    inputs: tuple[str, ...]
    row: int


def fit_lobe(
    points: BsdfPoints,
    settings: ReductionSettings,
    beams: Sequence[ScannedBeam] = (),
    source: str = "",
    step: Step | None = None,
    *,
    seen: LightSeen | None = None,
) -> LobeFit:
    """Fit the inputs of pose to the points of one sample at one wavelength, before their corrections, and to scans.

    With a `step` its size is fitted too, and a change of the light at that row. `seen` is what else shows the light on the
    sample. Raises UserError, without the name of the journal, where there is no lobe.
    """
    points = lobe_points(points)
    if points.size < TERMS:
        raise UserError(f"{settings.sample}: has no lobe of reflected light that an alignment could use")
    seen = seen or LightSeen({}, nominal_instrument(settings.rig))
    values = LobeValues(points, settings, seen.instrument)
    scans = [each for each in beams if each.edge <= EDGE_SHARE]
    before = settings.alignment or Alignment.stated(rig_inputs(settings.rig.uncertainty))
    mountings = [each for name in values.mountings for each in mounting_inputs(settings.rig.uncertainty, "sample", name)]
    before = replace(before.with_inputs(mountings), source=source)
    if not before.inputs:
        raise UserError(f"{settings.sample}: the rig file states no misalignment in [uncertainty] that could be found")
    lobe = _Fitting(values, scans, before, settings, step)
    state, place = lobe.with_light(lobe.settle(before.value, lit=True), seen)
    modes, of_modes = before.modes
    fit, value, after, size = state.fit, state.value, state.covariance, state.size
    place_of = {each.name: k for k, each in enumerate(fit.inputs)}
    used = [k for k, each in enumerate(modes) if each.name in place_of]
    columns = [place_of[modes[k].name] for k in used]
    aligned = Alignment(before.inputs, value, after, source)
    photodiodes = [k for k, each in enumerate(fit.inputs) if each.name.startswith("photodiode_")]
    crossed = np.zeros((len(modes), len(photodiodes)))
    crossed[used] = fit.covariance[np.ix_(columns, photodiodes)]
    crossed = of_modes @ crossed
    whole = Alignment(
        (*before.inputs, *(fit.inputs[k] for k in photodiodes)),
        np.append(value, fit.estimate[photodiodes]),
        np.block([[aligned.covariance, crossed], [crossed.T, fit.covariance[np.ix_(photodiodes, photodiodes)]]]),
        source,
    )
    return LobeFit(
        points,
        tuple(values.mountings),
        len(scans),
        aligned,
        whole,
        state.effects,
        state.residual,
        fit,
        values.sensitivities,
        (size, math.sqrt(fit.variance_of(SIZE))),
        place,
        state.lit,
        seen.instrument,
    )


@dataclass(frozen=True)
class _Settled:
    """Where a fit has settled: `value` (inputs,) and their `covariance`; effects and residual of its last step.

    `chi_square` is that of the residuals and of the inputs together, `size` that of a step. `lit`: the hole is taken as
    lit everywhere.
    """

    value: Floats
    covariance: Floats
    effects: Effects
    residual: Floats
    fit: Fit
    size: float
    lit: bool
    chi_square: float


class _Fitting:
    """The fit of a lobe and of scans: the same values, from one place of the light or another."""

    def __init__(
        self,
        values: "LobeValues",
        scans: Sequence[ScannedBeam],
        before: Alignment,
        settings: ReductionSettings,
        step: Step | None,
    ) -> None:
        self._values, self._scans, self._before, self._settings, self._step = values, scans, before, settings, step
        self._instrument = nominal_instrument(settings.rig)

    def settle(self, value: Floats, *, lit: bool) -> _Settled:
        """The fit that begins with a value (inputs,), step by step until nothing changes."""
        before, values = self._before, self._values
        modes, of_modes = before.modes
        error, size = np.asarray(np.linalg.solve(of_modes, value - before.value), dtype=np.float64), 0.0
        for _ in range(MOST_STEPS):
            known = dict(zip((each.name for each in before.inputs), value.tolist(), strict=True))
            if self._step is None:
                effects, residual = values.linearised(known, before, error, lit=lit)
            else:
                effects, residual = values.with_step(self._step, size, known, before, error, lit=lit)
            if self._scans:
                effects, residual = _with_scans(
                    effects, residual, self._scans, known, before, error, self._settings, values.light(lit=lit)
                )
            weight = ValuesCovariance(effects)
            fit = weight.fit(residual)
            place = {each.name: k for k, each in enumerate(fit.inputs)}
            used = [k for k, each in enumerate(modes) if each.name in place]
            columns = [place[modes[k].name] for k in used]
            found = np.zeros(len(modes))
            found[used] = fit.estimate[columns]
            values.correct_lobe({each.name: x for each, x in zip(fit.inputs, fit.estimate.tolist(), strict=True)})
            after = np.diag([each.u**2 for each in modes])
            after[np.ix_(used, used)] = fit.covariance[np.ix_(columns, columns)]
            way = float(np.max(np.abs(found - error) / np.sqrt(np.maximum(np.diag(after), np.finfo(float).tiny)), initial=0.0))
            error, value, size = found, before.value + of_modes @ found, fit.of(SIZE)
            if way < SETTLED:
                break
        chi_square = float(residual @ weight.solve(residual[:, None])[:, 0])
        return _Settled(value, of_modes @ after @ of_modes.T, effects, residual, fit, size, lit, chi_square)

    def with_light(self, plain: _Settled, seen: LightSeen) -> tuple[_Settled, PlaceOfImage | None]:
        """The same with the place of the slit's image that the values show, from a fit with a hole that is lit."""
        before = self._before
        by_inputs = image_by_inputs(self._instrument, before)
        prior = by_inputs @ before.covariance @ by_inputs.T
        if np.min(np.diag(prior)) <= 0.0:
            return plain, None
        known = dict(zip((each.name for each in before.inputs), plain.value.tolist(), strict=True))
        poses, columns = self._values.of_light(self._scans, known)
        modes, of_modes = before.modes
        common = plain.effects.dense[0].sensitivity * [each.u**2 for each in modes] @ of_modes.T @ by_inputs.T
        table = np.concatenate([common, columns, plain.residual[:, None]], axis=1)
        white = table.T @ ValuesCovariance(plain.effects).solve(table)
        etalon = self._settings.rig.uncertainty.u(ETALON_TILT)
        place = search_place(seen, LobeData(poses, white), prior, etalon)
        gain = before.covariance @ by_inputs.T @ np.linalg.inv(prior)
        if not place.seen and place.upright:
            lit = nearest_lit(seen.instrument, poses, by_inputs @ plain.value)
            return _with_image_at(plain, by_inputs, lit), place
        # A search about one fit is no more than a guess: the fits themselves decide.
        begins = (plain.value + gain @ (each - by_inputs @ plain.value) for each in place.places)
        settled = [self.settle(each, lit=False) for each in begins]
        spots = [spot_weights(seen.instrument, sigma, gamma) for sigma, gamma in poses.tolist()]
        at = np.array([by_inputs @ each.value for each in settled])
        share = np.stack([spot.lit(at)[0] for spot in spots], axis=1)
        flux = flux_chi_square(poses, share, seen.shares, etalon)
        return settled[int(np.argmin(flux + [each.chi_square for each in settled]))], place


def _with_image_at(plain: _Settled, by_inputs: Floats, place: Floats) -> _Settled:
    """The fit with values of the inputs that have the slit's image at a place (2,); their uncertainty stays."""
    way = place - by_inputs @ plain.value
    gain = plain.covariance @ by_inputs.T @ np.linalg.inv(by_inputs @ plain.covariance @ by_inputs.T)
    return replace(plain, value=plain.value + gain @ way)


def lobe_effects(
    points: BsdfPoints, settings: ReductionSettings, beams: Sequence[ScannedBeam] = ()
) -> tuple[Effects, Alignment]:
    """The effects of all inputs on points of a lobe and on scans, as they are before a fit, and what is known before it."""
    values = LobeValues(points, settings)
    before = settings.alignment or Alignment.stated(rig_inputs(settings.rig.uncertainty))
    before = before.with_inputs(
        [each for name in values.mountings for each in mounting_inputs(settings.rig.uncertainty, "sample", name)]
    )
    known, error = before.values, np.zeros(len(before.inputs))
    effects, residual = values.linearised(known, before, error)
    scans = [each for each in beams if each.edge <= EDGE_SHARE]
    if scans:
        effects, _ = _with_scans(effects, residual, scans, known, before, error, settings, values.light(lit=True))
    return effects, before


class LobeValues:
    """The values of a lobe, with its form as known so far."""

    def __init__(self, points: BsdfPoints, settings: ReductionSettings, light: Instrument | None = None) -> None:
        self._light = light or nominal_instrument(settings.rig)
        self._points, self._settings = points, settings
        self._instrument = nominal_instrument(settings.rig)
        self._views = views_of_points(points)
        self._logarithm = np.log(points.bsdf)
        _, self._which = np.unique(points.sigma_deg, return_inverse=True)
        self._settings_count = int(self._which.max()) + 1
        self._furthest = math.radians(float(points.theta_deg.max()))
        self.mountings, self._mounting = mounted("sample", points.row, settings)
        self.sensitivities = PoseSensitivities(np.zeros((points.size, 0)), np.zeros((points.size, 0)))
        self._form = self._first_form()
        self._signals()

    def _first_form(self) -> Floats:
        """Coefficients (incidences, terms) of the lobe by the nominal angles, with one form."""
        basis = self._basis(np.radians(self._points.theta_deg))
        return np.tile(np.linalg.lstsq(basis, self._logarithm, rcond=None)[0], (self._settings_count, 1))

    def _basis(self, theta: Floats) -> Floats:
        return np.asarray((theta[:, None] / self._furthest) ** (2 * np.arange(TERMS)))

    def _signals(self) -> None:
        """What the values share besides angles, and their independent variances."""
        base = effects_of(self._points, self._settings)
        self._independent = {name: each for name, each in base.independent.items() if name in INDEPENDENT}
        common = np.zeros(self._points.size)
        of = kinds()
        for group in base.groups:
            if of.get(group.name, OTHER).of_row:
                common += group_variance(group)
            else:  # its inputs are common to few values: of a photodiode at a gain, of one reading of the etalon
                self._independent[group.name] = self._independent.get(group.name, 0.0) + group_variance(group)
        rows = np.unique(self._points.row)
        of_row = {
            k: InputQuantity(f"light@row {k}", "1", 1.0, "normal", "all photodiodes of the row", "lamp and monitor", "")
            for k in rows.tolist()
        }
        self._row = Group("row", of_row, self._points.row[:, None], np.sqrt(common)[:, None])
        self._dense = list(base.dense)

    def correct_lobe(self, found: dict[str, float]) -> None:
        """Add the changes of the form that a fit has found."""
        for j in range(TERMS):
            self._form[:, j] += found.get(_of_all(j), 0.0)
            for k in range(self._settings_count):
                self._form[k, j] += found.get(_of_one(j, k), 0.0)

    def light(self, *, lit: bool) -> Instrument:
        """The instrument by which the light on the sample is known; with a hole that is `lit` everywhere."""
        return replace(self._light, lit_everywhere=True) if lit else self._light

    def _displaced(self, known: Mapping[str, float], *, lit: bool) -> tuple[Displacement, PoseEffects]:
        table = self._settings.rig.uncertainty
        of_mounting = np.array(
            [[known.get(each.name, 0.0) for each in mounting_inputs(table, "sample", name)] for name in self.mountings]
        )
        return known_displacement(self._instrument, self._views, known, of_mounting[self._mounting], lit=self.light(lit=lit))

    def linearised(
        self,
        known: Mapping[str, float],
        before: Alignment,
        error: Floats,
        changed: tuple[Mapping[str, float], Flags] | None = None,
        *,
        lit: bool = True,
    ) -> tuple[Effects, Floats]:
        """The effects of all inputs about `known` values, and what the values are beside a prediction without the modes.

        The modes have the values `error` there. In some of the values inputs may have `changed` by so much.
        """
        points, table = self._points, self._settings.rig.uncertainty
        moved, effects = self._displaced(known, lit=lit)
        if changed is not None:
            other, _ = self._displaced({**known, **{k: known.get(k, 0.0) + by for k, by in changed[0].items()}}, lit=lit)
            moved = Displacement(
                *(np.where(changed[1][:, None], getattr(other, name), each) for name, each in vars(moved).items())
            )
        place = _Place(self._views, self._instrument, moved.along[:, 0], moved.across[:, 0])
        basis = self._basis(place.theta)
        lobe = place.lobe(self._form[self._which], self._furthest)
        seen = replace(points, slope_along=RAD * lobe.gradient[:, 0], slope_across=RAD * lobe.gradient[:, 1])
        of_angles = angles(seen, replace(self._settings, alignment=None))
        own = (
            (mounting_inputs(table, "sample", name), effects.sample.where(self._mounting == k))
            for k, name in enumerate(self.mountings)
        )
        columns = displacement_of(before, [(rig_inputs(table), effects.common), *own])
        sensitivity = columns.relative(seen.slope_along, seen.slope_across)
        self._slopes = np.stack([seen.slope_along, seen.slope_across], axis=1)
        self.sensitivities = PoseSensitivities(
            *(each.relative(seen.slope_along, seen.slope_across) for each in (effects.common, effects.sample))
        )
        modes, of_modes = before.modes
        by_mode = sensitivity @ of_modes
        dense = [Dense(modes, by_mode), *self._dense, *self._lobe_inputs(basis), *self._etalon_inputs(of_angles)]
        field = table.u(FIELD_OF_VIEW)
        of_field = lobe.blur
        if not lit:
            by_field = light_place(self._light, self._views, effects.common, known).by_field
            of_field = of_field + seen.slope_along * by_field[:, 0] + seen.slope_across * by_field[:, 1]
            poses, which = distinct_poses(self._views)
            ways = of_centres(self._instrument, poses, which, effects.common)
            middle = _spread(seen.slope_along[:, None] * ways[0] + seen.slope_across[:, None] * ways[1], which, len(poses))
            dense.append(Dense([_free(f"middle[{k}]", MIDDLE_U_MM) for k in range(middle.shape[1])], middle))
        dense.append(Dense([_free("field", field)], of_field[:, None]))
        groups = [*(_of_sample(each) for each in of_angles.groups), self._row]
        residual = self._logarithm - lobe.logarithm - lobe.blur - moved.diffuse[:, 0] + by_mode @ error
        return Effects(points.bsdf, self._independent, groups, dense), residual

    def of_light(self, scans: Sequence[ScannedBeam], known: Mapping[str, float]) -> tuple[Floats, Floats]:
        """The poses (m, 2) of sigma and gamma, and what a middle of the light at each of them does, for a mm along x and y.

        The latter is (n, 2 m), of the values and then of the scans, with the slopes of the last step.
        """
        views = self._views
        _, at = self._displaced(known, lit=True)
        own, which = distinct_poses(views)
        along, across = of_centres(self._instrument, own, which, at.common)
        moved = self._slopes[:, :1] * along + self._slopes[:, 1:] * across
        poses, columns = [own], [_spread(moved, which, len(own))]
        if scans:
            seen = _scan_views(scans)
            _, beside = known_displacement(
                self._instrument, seen, known, np.zeros((len(scans), len(MOUNTED))), lit=self.light(lit=True)
            )
            theirs, of_scan = distinct_poses(seen)
            both = of_centres(self._instrument, theirs, of_scan, beside.common)
            poses.append(theirs)
            columns.append(np.concatenate([_spread(each, of_scan, len(theirs)) for each in both]))
        count = sum(each.shape[0] for each in columns)
        table, row, column = np.zeros((count, sum(each.shape[1] for each in columns))), 0, 0
        for each in columns:
            table[row : row + each.shape[0], column : column + each.shape[1]] = each
            row, column = row + each.shape[0], column + each.shape[1]
        return np.concatenate(poses), table

    def with_step(
        self, step: Step, size: float, known: Mapping[str, float], before: Alignment, error: Floats, *, lit: bool
    ) -> tuple[Effects, Floats]:
        """The same with a step of about a `size`, which is an input, beside a change of the light."""
        since = self._points.row >= step.row
        effects, residual = self.linearised(known, before, error, (dict.fromkeys(step.inputs, size), since), lit=lit)
        names = [each.name for each in rig_inputs(self._settings.rig.uncertainty)]
        if step.inputs[0] in names:
            column = self.sensitivities.rig[:, names.index(step.inputs[0])]
        else:
            column = self.sensitivities.mounting[:, [f"sample_{each}@" in step.inputs[0] for each in MOUNTED].index(True)]
        columns = np.stack([np.where(since, column, 0.0), since.astype(np.float64)], axis=1)
        own = Dense([_free(SIZE, FREE_U), _free("light since", SCALE_U)], columns)
        return replace(effects, dense=[*effects.dense, own]), residual + columns[:, 0] * size

    def _lobe_inputs(self, basis: Floats) -> list[Dense]:
        found = [Dense([_free(_of_all(j), FREE_U) for j in range(TERMS)], basis)]
        for k in range(self._settings_count):
            here = (self._which == k)[:, None]
            inputs = [_free(_of_one(j, k), SCALE_U if j == 0 else FORM_U) for j in range(TERMS)]
            found.append(Dense(inputs, np.where(here, basis, 0.0)))
        return found

    def _etalon_inputs(self, of_angles: Effects) -> list[Dense]:
        """The inputs of the etalon's mountings, and products with a lift: they have no part in the displacement."""
        return [each for each in of_angles.dense if any(("etalon_" in one.name or "*" in one.name) for one in each.inputs)]


@dataclass(frozen=True)
class ScanCentroids:
    """The centroids of m scans of the open beam, in deg: all along the arc, then all across it.

    `residual` (2 m,) is what they are beside their prediction, and `variance` (2 m,) that of what each has of its own.
    `effects` (m,) are those of all inputs, `photodiode` (m,) the numbers of the photodiodes in the beam.
    """

    residual: Floats
    variance: Floats
    effects: PoseEffects
    photodiode: Ints

    @classmethod
    def of(
        cls, scans: Sequence[ScannedBeam], known: Mapping[str, float], settings: ReductionSettings, light: Instrument
    ) -> "ScanCentroids":
        """Those of scans, predicted with `known` values of the inputs and the light of an instrument.

        A scan sees the light straight through the empty holder: where it is beside the photodiode, the photodiode is beside it
        on the other side.
        """
        views, seen = _scan_views(scans), np.array([each.centroid_deg for each in scans])
        moved, effects = known_displacement(
            nominal_instrument(settings.rig), views, known, np.zeros((len(scans), len(MOUNTED))), lit=light
        )
        across = -np.where(views.lower, -1.0, 1.0) * seen[:, 1]
        stop = position_u_deg(settings.rig.uncertainty) ** 2
        own = np.array([np.sum(each.share**2) for each in scans]) * stop + CENTROID_U_DEG**2
        return cls(
            np.concatenate([-seen[:, 0] - moved.along[:, 0], across - moved.across[:, 0]]),
            np.concatenate([own + stop, own]),  # beside the stops of the scan itself, in the plane there is that of sigma
            effects,
            np.array([each.scan.photodiode for each in scans]),
        )

    def sensitivity(self, before: Alignment, table: UncertaintyTable) -> Floats:
        """The change (2 m, inputs) of the centroids for one unit of each input of an alignment."""
        of_photodiodes = (
            (photodiode_inputs(table, c), self.effects.photodiode.where(self.photodiode == c))
            for c in set(self.photodiode.tolist())
        )
        columns = displacement_of(before, [(rig_inputs(table), self.effects.common), *of_photodiodes])
        return np.concatenate([columns.along, columns.across])


def _with_scans(
    effects: Effects,
    residual: Floats,
    scans: Sequence[ScannedBeam],
    known: Mapping[str, float],
    before: Alignment,
    error: Floats,
    settings: ReductionSettings,
    light: Instrument,
) -> tuple[Effects, Floats]:
    """The effects and residuals of the scans' centroids after those of the values: two for each, along and across."""
    table, seen = settings.rig.uncertainty, ScanCentroids.of(scans, known, settings, light)
    modes, of_modes = before.modes
    own = seen.sensitivity(before, table) @ of_modes
    count = seen.residual.size
    dense = [
        Dense(
            each.inputs,
            np.concatenate([each.sensitivity, own if each.inputs is modes else np.zeros((count, len(each.inputs)))]),
        )
        for each in effects.dense
    ]
    of_photodiodes = Group(
        "photodiode_angle",
        {2 * c + k: each for c in seen.photodiode.tolist() for k, each in enumerate(photodiode_inputs(table, c))},
        (2 * seen.photodiode + np.arange(2)[:, None]).reshape(-1, 1),
        np.concatenate([seen.effects.photodiode.along[:, :1], seen.effects.photodiode.across[:, 1:]]),
    )
    groups = [_continued(each, of_photodiodes if each.name == of_photodiodes.name else None, count) for each in effects.groups]
    independent = {name: np.append(each, np.zeros(count)) for name, each in effects.independent.items()}
    independent["centroid"] = np.append(np.zeros(residual.size), seen.variance)
    value = np.append(effects.value, np.ones(count))
    return Effects(value, independent, groups, dense), np.append(residual, seen.residual + own @ error)


def _scan_views(scans: Sequence[ScannedBeam]) -> Views:
    """The views of scans, each in the middle of its poses."""
    poses = np.array([each.scan.poses[each.scan.middle] for each in scans])
    lower = np.array([each.scan.arc == "lower" for each in scans])
    none = np.zeros(len(scans), dtype=bool)
    return Views(
        sigma_deg=poses[:, 1],
        gamma_deg=poses[:, 0],
        polar=np.radians([each.scan.at_deg for each in scans]),
        azimuth=np.full(len(scans), math.radians(SPECULAR_AZIMUTH_DEG)),
        lower=lower,
        transmitted=~none,
        reverse=none,
    )


def _spread(moved: Floats, which: Ints, poses: int) -> Floats:
    """Effects (n, 3) of a middle of the light, each of x and y in the columns of its pose: (n, 2 poses)."""
    table = np.zeros((len(moved), poses, 2))
    table[np.arange(len(moved)), which] = moved[:, :2]
    return table.reshape(len(moved), -1)


def _continued(group: Group, further: Group | None, count: int) -> Group:
    """A group with `count` further values, of which each has at most one of its inputs."""
    member, sensitivity = np.full((count, group.member.shape[1]), -1, dtype=np.int64), np.zeros((count, group.member.shape[1]))
    inputs = dict(group.inputs)
    if further is not None:
        member[:, :1], sensitivity[:, :1] = further.member, further.sensitivity
        inputs |= further.inputs
    return Group(group.name, inputs, np.concatenate([group.member, member]), np.concatenate([group.sensitivity, sensitivity]))


def _free(name: str, u: float) -> InputQuantity:
    return InputQuantity(name, "1", u, "normal", "the lobe", "", "")


def _of_all(term: int) -> str:
    return f"lobe[{term}]"


def _of_one(term: int, setting: int) -> str:
    return f"lobe[{term}]@{setting}"


def _of_sample(group: Group) -> Group:
    """The group without the axes' positions at the rows of the standards: of the diffuse part alone."""
    if group.name != "position":
        return group
    count = len(POSITIONS)
    return replace(group, member=group.member[:, :count], sensitivity=group.sensitivity[:, :count])


@dataclass(frozen=True)
class _Lobe:
    """A lobe at the values' true directions: its `logarithm`, and what the field of view adds to it; the `gradient` of both.

    Along the arc and across it, per rad.
    """

    logarithm: Floats
    blur: Floats
    gradient: Floats


@dataclass(frozen=True)
class _Derivatives:
    """Those of the logarithm of a lobe, per rad: see `field.Derivatives`."""

    first_along: Floats
    first_across: Floats
    second_along: Floats
    second_across: Floats
    mixed: Floats


class _Place:
    """The true directions of values against the specular direction where the light's axis has it; angles in rad."""

    def __init__(self, views: Views, instrument: Instrument, along_deg: Floats, across_deg: Floats) -> None:
        up = np.where(views.lower, -1.0, 1.0)
        level = np.stack([-np.sin(views.azimuth), np.cos(views.azimuth), np.zeros(up.size)], axis=1)
        ahead = np.stack([level[:, 1], -level[:, 0], np.zeros(up.size)], axis=1)
        sin, cos = np.sin(views.polar)[:, None], np.cos(views.polar)[:, None]
        upward = np.stack([np.zeros(up.size), np.zeros(up.size), up], axis=1)
        d, along, across = sin * ahead + cos * upward, cos * ahead - sin * upward, up[:, None] * level
        sigma = np.radians(views.sigma_deg)
        specular = np.stack([-np.sin(sigma), np.zeros(up.size), np.cos(sigma)], axis=1)
        turn = RAD * np.stack([along_deg, across_deg], axis=1)
        size = np.maximum(np.linalg.norm(turn, axis=1), 1e-15)
        seen = np.cos(size)[:, None] * d + (np.sin(size) / size)[:, None] * (turn[:, :1] * along + turn[:, 1:] * across)
        # Both axes, carried along the great circle.
        axes = [each - (_dot(seen, each) / (1.0 + _dot(seen, d)))[:, None] * (seen + d) for each in (along, across)]
        self.theta = np.maximum(np.arctan2(np.linalg.norm(np.cross(specular, seen), axis=1), _dot(specular, seen)), 1e-9)
        outward = -np.stack([_dot(specular, each) for each in axes], axis=1) / np.sin(self.theta)[:, None]
        self._outward = outward / np.maximum(np.linalg.norm(outward, axis=1), 1e-12)[:, None]
        none = np.zeros(up.size)
        numbers = np.zeros(up.size, dtype=np.int64)
        directions = Directions(numbers, numbers, numbers, views.polar, views.azimuth, up, none, none, none)
        self._spread = directions_covariance(instrument, directions, sigma, views.transmitted)

    def lobe(self, form: Floats, furthest: float) -> _Lobe:
        """The lobe of a form (n, terms)."""
        q, powers = (self.theta / furthest) ** 2, np.arange(TERMS)
        value = np.sum(form * q[:, None] ** powers, axis=1)
        by_q = np.sum(form[:, 1:] * powers[1:] * q[:, None] ** powers[:-1], axis=1)
        by_qq = np.sum(form[:, 2:] * powers[2:] * powers[1:-1] * q[:, None] ** powers[:-2], axis=1)
        first = 2.0 * self.theta / furthest**2 * by_q
        second = 2.0 / furthest**2 * by_q + (2.0 * self.theta / furthest**2) ** 2 * by_qq
        beside = first / np.tan(self.theta)  # the second derivative at right angles to the way from the centre
        a, c = self._outward.T
        slopes = _Derivatives(
            first * a, first * c, second * a * a + beside * c * c, second * c * c + beside * a * a, (second - beside) * a * c
        )
        mean = correct_logarithm(slopes, -self._spread)
        plain = np.stack([slopes.first_along, slopes.first_across], axis=1)
        known = np.isfinite(mean.logarithm)
        return _Lobe(value, np.where(known, mean.logarithm, 0.0), np.where(known[:, None], mean.gradient, plain))


def _dot(one: Floats, other: Floats) -> Floats:
    return np.asarray(np.einsum("ni,ni->n", one, other))
