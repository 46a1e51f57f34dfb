"""The absolute scale of the open beam, and its closure: radiance factors of the etalon by it against those of the certificate.

    rho_absolute = pi S_etalon / (cos(theta_r) sum of S_open dOmega)

Both signals are of one photodiode: the etalon at polar = sigma, and the open beam that this photodiode has scanned with the
mirror unit at 180 deg - sigma. Its responsivity, disc, cone and distance are common to both. The sum over the scan has to know
the angles: S_etalon goes as cos(theta_i) cos(theta_r), the beam through the hole as cos(theta_b), and dOmega as sin(theta). A
mirror's tilt d in the plane of incidence turns the light by +d at sigma and by -d at 180 deg - sigma, so that it counts twice.
The scan sees some of this itself: its centroid is the sum of the tilts of light and arc. It is an observation of the inputs, by
which the value is corrected and their uncertainty reduced (the conditional expectation of normal inputs).

The scan's second moment is that of the instrument function: the field of view that the values are corrected for. Where it is
not that of the rig file, `field_deg` is the one that explains the scan.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from operator import itemgetter
from typing import Any

import numpy as np

from goniotwin.app.campaign.geometry.open_beam import LEAST_SIGMA_DEG, BeamScan, beam_scans, scan_wavelength_nm
from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.effects import Component
from goniotwin.app.campaign.measurement_model.field import directions_covariance
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity, quantity
from goniotwin.app.campaign.measurement_model.light_place import across_beam, place_law, seen_light
from goniotwin.app.campaign.measurement_model.lit_share import SLIT_IMAGE
from goniotwin.app.campaign.measurement_model.pose import (
    LIGHT,
    MOUNTED,
    POSITIONS,
    Views,
    disc_moves,
    image_shifts,
    light_at,
    mounting_inputs,
    photodiode_inputs,
    position_input,
    rig_inputs,
    standard_uncertainties,
)
from goniotwin.app.campaign.measurement_model.posterior import Posterior
from goniotwin.app.campaign.measurement_model.quantity import NONE
from goniotwin.app.campaign.measurement_model.slopes import Directions
from goniotwin.app.campaign.reduction.components import Signal, input_of
from goniotwin.app.campaign.reduction.etalon import SIGNATURE, SIGNATURE_READING, comparable_signals
from goniotwin.app.campaign.reduction.reading_inputs import Numbers
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.reduction.row_signals import RowSignal, pose_key, rows_in_columns
from goniotwin.app.campaign.reduction.scale import factor_quantities
from goniotwin.app.campaign.reduction.settings import BeamScale
from goniotwin.app.campaign.reduction.signals import LIGHT as LEAST_LIGHT
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.rig import RigFile, nominal_instrument
from goniotwin.app.rig import inputs as declared
from goniotwin.app.rig.uncertainty import UncertaintyTable
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics import Instrument
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, round_deg
from goniotwin.twin.plant.disturbances import ETALON, SharedBy

STEP_DEG = 0.2
"""Step of the scan to which the uncertainty of its sum belongs."""
EDGE_SHARE = 0.01
"""A signal at the edge of the scan above this share of the largest means that the beam is not all within."""
CERTAIN = 5.0
"""What a scan shows of cross-talk counts beyond so many of its standard uncertainties."""
SMALLEST_U = 1e-12
"""A rig file may state that everything is exact."""
AGREES, DIFFERS = 2.0, 4.0
"""Up to so many combined uncertainties two scales agree; beyond so many they certainly do not, see BY_CHANCE."""
BY_CHANCE = 2e-3
"""A difference that the light's place explains on more than this share of all rigs shows nothing else."""
MOMENT_U = 0.02
"""Relative standard uncertainty of a scan's second moment against the expected one: on the virtual rig 0 to 1.8 % apart."""
SCANS_KEPT = 64
"""A campaign has few scans, each at many wavelengths."""
FIELDS_DEG = (0.05, 6.0)
"""Fields of view that a scan can show: of a wider one the beam is not within the scan."""


@dataclass(frozen=True)
class ScannedBeam:
    """What a scan shows of the instrument, at its wavelength. Angles along the arc and across it, in degrees.

    `total` is the sum of signal times solid angle. `centroid_deg` (2,) is where the beam is from where the angles of the axes
    put it, `moment_deg2` (2, 2) the second moment of the instrument function: of pupil, cone, disc and spot together. `share`
    (n,) is each pose's part of the total, `edge` the largest signal at the edge of the grid over the largest of all.
    `crosstalk` (photodiodes,) is the signal in volts of each photodiode over that of the one in the beam, at the same gain,
    with `u_crosstalk`: cross-talk and stray light together; NaN where it was not read.
    """

    scan: BeamScan
    wavelength_nm: float
    total: float
    share: Floats
    centroid_deg: Floats
    moment_deg2: Floats
    edge: float
    crosstalk: Floats
    u_crosstalk: Floats

    @property
    def neighbours(self) -> dict[int, tuple[float, float]]:
        """Cross-talk and its uncertainty of the photodiodes next to the one in the beam, by number."""
        beside = [self.scan.photodiode - 1, self.scan.photodiode + 1]
        return {
            k: (float(self.crosstalk[k]), float(self.u_crosstalk[k]))
            for k in beside
            if 0 <= k < self.crosstalk.size and np.isfinite(self.crosstalk[k])
        }


@dataclass(frozen=True)
class Closure:
    """The etalon's radiance factor by its certificate and by the open beam, at one incidence and wavelength.

    `absolute` is corrected for the centroid of the scan by the relative `correction`. `components` are relative, of the ratio
    of the two; those of `of_etalon_route` belong to the route by the etalon, those of `light` to the light's place.
    `etalon_row` is the number of the etalon's row.
    """

    beam: ScannedBeam
    wavelength_nm: float
    certified: float
    absolute: float
    correction: float
    components: tuple[Component, ...]
    light: "LightEffects"
    etalon_row: int = 0

    @property
    def ratio(self) -> float:
        """The absolute route over the route by the etalon."""
        return self.absolute / self.certified

    @property
    def u(self) -> float:
        """Combined relative standard uncertainty of the ratio."""
        return math.sqrt(math.fsum(each.u**2 for each in self.components))

    @property
    def u_absolute(self) -> float:
        """Relative standard uncertainty of the absolute route alone."""
        others = of_etalon_route()
        own = (each.u**2 for each in self.components if each.name.partition("@")[0] not in others)
        return math.sqrt(math.fsum(own))

    @property
    def u_scale(self) -> float:
        """That of values which the open beam scales: they have the place of the slit's image themselves."""
        of_image = (each.u**2 for each in self.components if each.name.startswith(SLIT_IMAGE))
        return math.sqrt(max(self.u_absolute**2 - math.fsum(of_image), 0.0))

    @property
    def z(self) -> float:
        """The difference of the two routes in combined uncertainties."""
        return (self.ratio - 1.0) / max(self.u, SMALLEST_U)

    @property
    def chance(self) -> float:
        """How often the ratio is as far from 1 on rigs whose scales agree."""
        own = math.fsum(each.u**2 for each in self.components if not each.name.startswith(SLIT_IMAGE))
        return self.light.chance(self.ratio - 1.0, own)

    @property
    def apart(self) -> bool:
        """Whether the two routes certainly do not agree, and the light's place hardly explains it."""
        return abs(self.z) > DIFFERS and self.chance < BY_CHANCE

    @property
    def word(self) -> str:
        """The comparison in a word, for a table."""
        return "agree" if abs(self.z) <= AGREES else "do NOT agree" if self.apart else "differ"

    @property
    def verdict(self) -> str:
        """The comparison in words."""
        size = abs(self.z)
        if size <= AGREES:
            return "the two scales agree"
        side = "above" if self.ratio > 1.0 else "below"
        difference = f"the open beam gives {100.0 * abs(self.ratio - 1.0):.2f} % {side} the certificate, {size:.1f} u"
        return f"{difference}: they do NOT agree" if self.apart else f"{difference}: more than expected"


@dataclass(frozen=True)
class JointClosure:
    """The closures of several scans together: their best mean `ratio`, with its relative standard uncertainty `u`.

    `chance`: how often the ratio is as far from 1 on rigs whose scales agree.
    """

    sigmas_deg: tuple[float, ...]
    ratio: float
    u: float
    chance: float

    @classmethod
    def of(cls, closures: Sequence[Closure]) -> "JointClosure | None":
        """Of those at the wavelengths of their scans; None of fewer than two. Inputs of one name are common to them."""
        scanned = [each for each in closures if each.wavelength_nm == each.beam.wavelength_nm]
        if len(scanned) < 2:
            return None
        effects: dict[str, Floats] = {}
        by_light = np.stack([each.light.by_place for each in scanned])
        for k, each in enumerate(scanned):
            for part in each.components:
                if part.name.startswith(SLIT_IMAGE):  # with the place that the image has at all scans
                    continue
                name = f"{k} {part.name}" if is_own_of_a_scan(part) else part.name
                effect = effects.setdefault(name, np.zeros(len(scanned)))
                effect[k] = math.copysign(part.u, part.sensitivity)
        columns = np.array(list(effects.values()))
        own = columns.T @ columns + SMALLEST_U**2 * np.eye(len(scanned))
        weight = np.linalg.solve(own + by_light @ by_light.T, np.ones(len(scanned)))
        total, weight = float(weight.sum()), weight / weight.sum()
        ratio = float(weight @ [each.ratio for each in scanned])
        light = LightEffects.mean([each.light for each in scanned], weight)
        chance = light.chance(ratio - 1.0, float(weight @ own @ weight))
        return cls(tuple(each.beam.scan.at_deg for each in scanned), ratio, 1.0 / math.sqrt(total), chance)

    @property
    def z(self) -> float:
        """The difference of the two routes in combined uncertainties."""
        return (self.ratio - 1.0) / max(self.u, SMALLEST_U)

    @property
    def apart(self) -> bool:
        """Whether the two routes certainly do not agree."""
        return abs(self.z) > DIFFERS and self.chance < BY_CHANCE

    def as_dict(self) -> dict[str, Any]:
        """The result for JSON."""
        return {
            "sigmas_deg": list(self.sigmas_deg),
            "ratio": self.ratio,
            "u": self.u,
            "z": self.z,
            "chance": self.chance,
        }

    def __str__(self) -> str:
        sigmas = ", ".join(f"{each:g}" for each in self.sigmas_deg)
        return f"all scans together (sigma {sigmas} deg): ratio {self.ratio:.4f}, u {100.0 * self.u:.2f} %, z {signed(self.z)}"


CERTIFICATE = "certificate"
OF_A_SCAN = (SharedBy.SCAN, SharedBy.AXIS_MOVE, SharedBy.MOVE)
"""What is another at each scan, beside the readings."""
TROUBLES = {
    "dead": "has lost its dark current",
    "drift": "is flagged for drift",
    "module": "is of a module that did not pass its tests: see the notes of the reduction",
    "monitor": "was read with the monitor at the end of its range",
    "contradiction": "has readings that contradict each other",
}
"""Flags of a row's signal with which it is not used."""


@dataclass(frozen=True)
class ScannedField:
    """The field of view by the scans: `ratio` of their second moments to those of the rig file's `stated_deg`, with `u`.

    `field_deg` is the one that explains the scans; None where none does.
    """

    ratio: float
    u: float
    stated_deg: float
    field_deg: float | None

    @property
    def z(self) -> float:
        """The logarithm of the ratio in its uncertainties."""
        return math.log(self.ratio) / self.u

    @property
    def applied(self) -> bool:
        """Whether the values are corrected for `field_deg` in place of the rig file's."""
        return abs(self.z) > AGREES and self.field_deg is not None

    def as_dict(self) -> dict[str, Any]:
        """The result for JSON."""
        return {
            "ratio": self.ratio,
            "u": self.u,
            "z": self.z,
            "field_deg": self.field_deg,
            "applied": self.applied,
            "verdict": str(self),
        }

    def __str__(self) -> str:
        shown = f"the scan of the open beam has {self.ratio:.2f} of the variance of directions that the rig file has"
        if abs(self.z) <= AGREES:
            return f"{shown} (u {self.u:.2f}): they agree"
        if self.field_deg is None:
            return f"{shown}, and no field of view explains it; check [geometry] in the rig file"
        return (
            f"{shown}: its field of view is {self.field_deg:.2f} deg, not {self.stated_deg:g}; values are corrected for it; "
            "correct field_deg of [geometry] in the rig file"
        )


@dataclass(frozen=True)
class ClosureReport:
    """The closures of a journal, the scans that they come from, and the reasons why there are no others.

    `not_planned` are those of the schedule, `missing` those of the measurement. `field` is the field of view by the scans, None
    without one that has all of the beam. `crosstalk` is what they show of it beyond the rig file's, in words; empty without.
    """

    closures: tuple[Closure, ...]
    beams: tuple[ScannedBeam, ...]
    not_planned: tuple[str, ...]
    missing: tuple[str, ...] = ()
    field: ScannedField | None = None
    crosstalk: str = ""

    @property
    def scale(self) -> dict[tuple[float, float, bool], BeamScale]:
        """The scale of the open beam, as `ReductionSettings.absolute` has it."""
        return {
            (*round_deg([each.wavelength_nm, each.beam.scan.sigma_deg]).tolist(), each.beam.scan.arc == "lower"): BeamScale(
                each.ratio, each.u_scale, each.etalon_row
            )
            for each in self.closures
        }

    def as_dict(self) -> dict[str, Any]:
        """The results for JSON."""
        return {
            "closures": [
                {
                    "sigma_deg": each.beam.scan.sigma_deg,
                    "at_deg": each.beam.scan.at_deg,
                    "photodiode": each.beam.scan.photodiode,
                    "wavelength_nm": each.wavelength_nm,
                    "scanned": each.wavelength_nm == each.beam.wavelength_nm,
                    "certified": each.certified,
                    "absolute": each.absolute,
                    "centroid_correction": each.correction,
                    "ratio": each.ratio,
                    "u": each.u,
                    "u_absolute": each.u_absolute,
                    "z": each.z,
                    "chance": each.chance,
                    "verdict": each.verdict,
                    "components": {part.name: part.u for part in each.components},
                }
                for each in self.closures
            ],
            "scans": [
                {
                    "sigma_deg": each.scan.sigma_deg,
                    "at_deg": each.scan.at_deg,
                    "photodiode": each.scan.photodiode,
                    "wavelength_nm": each.wavelength_nm,
                    "poses": len(each.scan.poses),
                    "centroid_deg": each.centroid_deg.tolist(),
                    "moment_deg2": each.moment_deg2.tolist(),
                    "edge": each.edge,
                    "neighbours": {str(k): {"crosstalk": x, "u": u} for k, (x, u) in each.neighbours.items()},
                }
                for each in self.beams
            ],
            "together": self.together,
            "field": self.field,
            "missing": [*self.not_planned, *self.missing],
            "verdict": self.verdict,
        }

    @property
    def apart(self) -> list[Closure]:
        """The closures that certainly do not agree."""
        return [each for each in self.closures if each.apart]

    @property
    def together(self) -> JointClosure | None:
        """The closures of all scans together; None with fewer than two."""
        return JointClosure.of(self.closures)

    @property
    def contradicts_etalon(self) -> bool:
        """Whether a comparison shows that the etalon's scale, or that of the open beam, is certainly wrong."""
        return bool(self.apart) or self._apart_together

    @property
    def _apart_together(self) -> bool:
        return self.together is not None and self.together.apart

    @property
    def alarms(self) -> list[str]:
        """What could not be compared, and the comparisons that do not agree, as warnings."""
        return [
            *(f"no closure: {each}" for each in self.missing),
            *(
                f"closure at sigma {each.beam.scan.at_deg:g} deg, {each.wavelength_nm:g} nm: {each.verdict}"
                for each in self.apart
            ),
            *([f"closure of {self.together}: they do NOT agree"] if self._apart_together else []),
            *([str(self.field)] if self.field is not None and abs(self.field.z) > AGREES else []),
            *([self.crosstalk] if self.crosstalk else []),
        ]

    @property
    def verdict(self) -> str:
        """The comparison as a whole, in words."""
        if not self.closures:
            return "there is no closure"
        if self._apart_together and not self.apart:
            return f"{self.together}: they do NOT agree"
        worst = max(self.closures, key=lambda each: abs(each.z))
        where = f"sigma {worst.beam.scan.at_deg:g} deg, {worst.wavelength_nm:g} nm"
        if abs(worst.z) <= AGREES:
            return (
                f"the two scales agree in all {len(self.closures)} comparisons; the largest difference is {signed(worst.z)} u"
            )
        return f"{worst.verdict} ({where})"


def of_etalon_route() -> frozenset[str]:
    """The components of the route by the etalon, without mountings and moves: the certificate, and the factors on its light."""
    return frozenset([CERTIFICATE, *(each.name for each in declared.factors(ETALON))])


def is_own_of_a_scan(part: Component) -> bool:
    """Whether each scan has an error of its own of a component."""
    return part.input is None or part.input.shared_by in OF_A_SCAN


def journal_closure(reduction: Reduction) -> ClosureReport:
    """The closures of a journal, by scan and wavelength. Raises UserError where a row cannot be reduced."""
    file, rig = reduction.schedule, reduction.settings.rig
    if file.open_beam_scan is None:
        return ClosureReport((), (), ("the schedule has no scan of the open beam: add the table [open_beam] to it",))
    not_planned = [
        f"sigma {sigma:g} deg: below {LEAST_SIGMA_DEG:g} deg beta cannot scan the open beam"
        for sigma in file.scanned_sigmas_deg
        if sigma < LEAST_SIGMA_DEG
    ]
    scans = beam_scans(file, rig)
    scanned = {each.sigma_deg for each in scans}
    not_planned += [
        f"sigma {sigma:g} deg: has no scan of its own, because the limits of the arc's shift leave it that of another sigma"
        for sigma in file.scanned_sigmas_deg
        if sigma >= LEAST_SIGMA_DEG and sigma not in scanned
    ]
    closures: list[Closure] = []
    beams: list[ScannedBeam] = []
    missing: list[str] = []
    for scan in scans:
        readings = _Readings(scan, reduction)
        where = f"sigma {scan.sigma_deg:g} deg"
        if reason := readings.trouble:
            missing.append(f"{where}: {reason}")
            continue
        beam = readings.beam()
        beams.append(beam)
        if beam.edge > EDGE_SHARE:
            share = f"{100.0 * beam.edge:.0f} %"
            missing.append(f"{where}: at the edge of the scan the signal is still {share} of the largest: take more poses")
            continue
        for wavelength in grid_values(file.wavelength_nm):
            found = readings.closure(beam, wavelength)
            if isinstance(found, Closure):
                closures.append(found)
            else:
                missing.append(f"{where}, {wavelength:g} nm: {found}")
    return ClosureReport(
        tuple(closures),
        tuple(beams),
        tuple(not_planned),
        tuple(missing),
        scanned_field(beams, rig),
        scanned_crosstalk(beams, rig),
    )


def closure_text(report: ClosureReport) -> str:
    """A report as lines of text: a table of the comparisons, what each scan shows, what is missing, the verdict."""
    lines = []
    if report.closures:
        lines.append("  sigma  photodiode      nm  certified  absolute   ratio    u %      z  scales")
    for each in report.closures:
        scan, star = each.beam.scan, "*" if each.wavelength_nm == each.beam.wavelength_nm else " "
        lines.append(
            f"  {scan.at_deg:5.1f}  {scan.photodiode:10d}  {each.wavelength_nm:6.1f}{star} {each.certified:9.4f} "
            f"{each.absolute:9.4f}  {each.ratio:6.4f}  {100.0 * each.u:5.2f}  {signed(each.z):>5}  {each.word}"
        )
    for beam in report.beams:
        along, across = beam.centroid_deg.tolist()
        width = np.sqrt(np.diag(beam.moment_deg2)).tolist()
        lines.append(
            f"  scan at sigma {beam.scan.at_deg:g} deg, {beam.wavelength_nm:g} nm: the beam is {along:+.3f} deg along the arc "
            f"and {across:+.3f} deg across it from where the axes put it; width (standard deviation) {width[0]:.3f} and "
            f"{width[1]:.3f} deg"
        )
        if beam.neighbours:
            seen = ", ".join(f"{k}: {x:.1e} (u {u:.0e})" for k, (x, u) in beam.neighbours.items())
            lines.append(f"    cross-talk and stray light, in volts over those of photodiode {beam.scan.photodiode}: {seen}")
    lines += [f"  {each}" for each in (report.together, report.field, report.crosstalk or None) if each is not None]
    if report.closures:
        lines.append("  *: the wavelength of the scan; at the others its middle pose")
    lines += [f"  none: {each}" for each in (*report.not_planned, *report.missing)]
    return "\n".join([*lines, report.verdict])


class _Readings:
    """The signals of one scan's photodiode in a journal: of the open beam, of the etalon, and without a sample."""

    def __init__(self, scan: BeamScan, reduction: Reduction) -> None:
        self._scan, self._settings, self._measurements = scan, reduction.settings, reduction.measurements
        self._empty = reduction.signature
        self._wavelength_nm = scan_wavelength_nm(reduction.schedule)
        wavelengths = grid_values(reduction.schedule.wavelength_nm)
        middle = _angles(scan, scan.middle)
        self._keys = [pose_key(_row(self._wavelength_nm), _angles(scan, k)) for k in range(len(scan.poses))]
        self._middle = {each: pose_key(_row(each), middle) for each in wavelengths}
        self._at_etalon = {each: pose_key(_row(each), scan.etalon_pose) for each in wavelengths}
        self._open = self._empty.at([*self._keys, *self._middle.values(), *self._at_etalon.values()])
        self._etalon = reduction.etalon.at(self._at_etalon.values())

    @property
    def trouble(self) -> str:
        """The reason why the scan has no sum; empty where it has."""
        measured = [self._open[key] for key in self._keys if key in self._open]
        if len(measured) < len(self._keys):
            return f"{len(measured)} of {len(self._keys)} poses of the scan have been measured"
        if reason := _trouble(measured, self._scan.photodiode):
            return reason
        signal = self._signals(measured)
        brightest = int(np.argmax(signal.value))
        if (
            not signal.value[brightest] > LEAST_LIGHT * math.sqrt(signal.reading_variance[brightest])
            or signal.value.sum() <= 0.0
        ):
            return f"photodiode {self._scan.photodiode} has no light in any pose of the scan: was the sample unit empty?"
        return ""

    def beam(self) -> ScannedBeam:
        """The scan as a whole."""
        signal = self._signals([self._open[key] for key in self._keys])
        return scanned_beam(self._scan, self._wavelength_nm, signal, *self.crosstalk())

    def closure(self, beam: ScannedBeam, wavelength_nm: float) -> Closure | str:
        """The closure at a wavelength, or the reason why there is none."""
        scan, certificate, rig = self._scan, self._settings.certificate, self._settings.rig
        etalon_key, middle_key = self._at_etalon[wavelength_nm], self._middle[wavelength_nm]
        if etalon_key not in self._etalon:
            return "the etalon has not been measured in the pose of the scan"
        if middle_key not in self._open:
            return "the open beam has not been measured"
        needed = [self._etalon[etalon_key], self._open[middle_key], self._open[self._keys[scan.middle]]]
        if reason := _trouble(needed, scan.photodiode):
            return reason
        if not all(each.signal.value[scan.photodiode] > 0.0 for each in needed):
            return f"photodiode {scan.photodiode} has no light"
        factor, u_factor = certificate.interpolate(*(np.array([each]) for each in self._direction(wavelength_nm)))
        if not np.isfinite(factor[0]):
            return f"the certificate does not cover it: it is valid for {certificate}"
        scanned = self._signals([self._open[key] for key in self._keys])
        etalon = self._signals([self._etalon[etalon_key]])
        if (signature := self._open.get(etalon_key)) is not None and self._settings.schedule.signature:
            own = self._signals([signature])
            own = own.with_common(SIGNATURE, rig.sample_unit.signature_uncertainty * own.value)
            number = Numbers.of(rig).reading(np.array([signature.row.number]), np.array(scan.photodiode))
            etalon = Signal.of(etalon - own.own_as(SIGNATURE_READING, number[:1]), etalon.gain)
            if not etalon.value[0] > 0.0:
                return "the etalon is no brighter than the empty sample unit"
        middle = None
        if wavelength_nm != self._wavelength_nm:
            middle = self._signals([self._open[middle_key]])
        certified = InputQuantity(CERTIFICATE, "1", float(u_factor[0]), "normal", SharedBy.ALL, "the certificate", "")
        row = self._etalon[etalon_key].row.number
        factors = [factor_quantities(each, ETALON, np.array([row]), self._settings)[0] for each in declared.factors(ETALON)]
        of_etalon = [_of_effect(each, each.u) for each in (certified, *itertools.chain.from_iterable(factors))]
        found = compare(beam, wavelength_nm, scanned, middle, etalon, float(factor[0]), of_etalon, rig, self._moves())
        return replace(found, etalon_row=row)

    def _moves(self) -> Ints | None:
        """For each pose (n, 2) the number of moves so far of shift and beta; None without a history of the rows."""
        if self._settings.history is None:
            return None
        rows = np.array([self._open[key].row.number for key in self._keys])
        return self._settings.history.moves(rows)[:, [POSITIONS.index("shift"), POSITIONS.index("beta")]]

    def _signals(self, rows: Sequence[RowSignal]) -> Signal:
        """The signals (n,) of the scan's photodiode in rows, of which there is at least one."""
        columns = rows_in_columns(rows)
        assert columns is not None
        found = comparable_signals(columns, np.array([self._scan.photodiode]), self._settings.rig)
        return found.each(lambda array: array[:, 0])

    def _direction(self, wavelength_nm: float) -> tuple[float, float, float, float]:
        scan = self._scan
        return wavelength_nm, scan.at_deg, scan.at_deg, scan.etalon_pose[2]

    def crosstalk(self) -> tuple[Floats, Floats]:
        """Cross-talk (photodiodes,) and its uncertainty: volts against those of the photodiode in the beam, at all gains.

        The flanks of the beam are read at higher gains too, where the converter's steps count less.
        """
        photodiode, settings = self._scan.photodiode, self._settings.rig.photodiodes
        numbers = self._empty.numbers_at(self._keys)
        weights, weighted = np.zeros(settings.count), np.zeros(settings.count)
        for gain_v_per_a in settings.gains_v_per_a:
            volts = list(self._measurements.volts(numbers, gain_v_per_a))
            seen = np.array([each.value for each in volts]).reshape(-1, settings.count)
            beam = np.where(np.isfinite(seen[:, photodiode]), seen[:, photodiode], 0.0)[:, None]
            square = float((beam**2).sum())
            if not square > 0.0:
                continue
            noise = np.array([each.components["noise"] for each in volts])
            dark = np.array([each.variance - each.components["noise"] for each in volts])  # common to neighbouring rows
            variance = ((beam**2 * noise).sum(axis=0) + (np.abs(beam) * np.sqrt(dark)).sum(axis=0) ** 2) / square**2
            ratio = (beam * seen).sum(axis=0) / square
            known = np.isfinite(ratio) & (variance > 0.0)
            weights[known] += 1.0 / variance[known]
            weighted[known] += ratio[known] / variance[known]
        weights = np.where(weights > 0.0, weights, np.nan)
        weights[photodiode] = np.nan
        return weighted / weights, np.asarray(1.0 / np.sqrt(weights))


def scanned_beam(
    scan: BeamScan, wavelength_nm: float, signal: Signal, crosstalk: Floats | None = None, u_crosstalk: Floats | None = None
) -> ScannedBeam:
    """The sum and the moments of a scan; `signal` (n,) is that of its photodiode."""
    parts = signal.value * scan.solid_angle_sr
    total = float(parts.sum())
    share = parts / total
    offset = scan.offset_deg
    centroid = share @ offset
    moment = (offset - centroid).T @ ((offset - centroid) * share[:, None])
    edge = float(np.max(signal.value[scan.edge]) / np.max(signal.value))
    none = np.zeros(0)
    return ScannedBeam(
        scan,
        wavelength_nm,
        total,
        share,
        centroid,
        moment,
        edge,
        none if crosstalk is None else crosstalk,
        none if u_crosstalk is None else u_crosstalk,
    )


def moment_deg2(scan: BeamScan, instrument: Instrument) -> Floats:
    """The second moment (2, 2) that a scan has with an instrument, deg^2: of light straight through the empty holder."""
    one, none, number = np.ones(1), np.zeros(1), np.zeros(1, dtype=np.int64)
    place = Directions(
        light=number,
        setting=number,
        plane=number,
        polar=np.radians(scan.at_deg) * one,
        azimuth=np.radians(SPECULAR_AZIMUTH_DEG) * one,
        up=one if scan.arc == "upper" else -one,
        middle=one,
        along=none,
        across=none,
    )
    sigma = np.radians(scan.poses[scan.middle, 1]) * one
    along, across, both = directions_covariance(instrument, place, sigma, np.ones(1, dtype=bool))[0].tolist()
    return np.array([[along, both], [both, across]]) * math.degrees(1.0) ** 2


def scanned_field(beams: Sequence[ScannedBeam], rig: RigFile) -> ScannedField | None:
    """The field of view by the scans that have all of the beam; None without one."""
    whole = [each for each in beams if each.edge <= EDGE_SHARE and np.trace(each.moment_deg2) > 0.0]
    if not whole:
        return None
    nominal = nominal_instrument(rig)

    def ratio(field_deg: float) -> float:
        instrument = replace(nominal, field_deg=field_deg)
        parts = [math.log(np.trace(each.moment_deg2) / np.trace(moment_deg2(each.scan, instrument))) for each in whole]
        return math.exp(math.fsum(parts) / len(parts))

    found, u = ratio(nominal.field_deg), math.hypot(rig.uncertainty.u(declared.FIELD_OF_VIEW), MOMENT_U)
    low, high = FIELDS_DEG
    if abs(math.log(found)) <= AGREES * u or not ratio(low) > 1.0 > ratio(high):
        return ScannedField(found, u, nominal.field_deg, nominal.field_deg if abs(math.log(found)) <= AGREES * u else None)
    while high - low > 1e-3:  # the moment grows with the field
        middle = 0.5 * (low + high)
        low, high = (middle, high) if ratio(middle) > 1.0 else (low, middle)
    return ScannedField(found, u, nominal.field_deg, low)


def scanned_crosstalk(beams: Sequence[ScannedBeam], rig: RigFile) -> str:
    """What scans show of the cross-talk beyond the rig file's, in words; empty where they show no more.

    The channels beside the one in the beam count where they are of its module.
    """
    module, stated = rig.photodiodes.module_channels, rig.uncertainty.u(declared.CROSSTALK)
    found = [
        (
            abs(share),
            f"photodiode {k} has {share:.1e} (u {u:.0e}) of the volts of photodiode {each.scan.photodiode} in the open beam",
        )
        for each in beams
        for k, (share, u) in each.neighbours.items()
        if k // module == each.scan.photodiode // module and abs(share) > math.hypot(DIFFERS * stated, CERTAIN * u)
    ]
    if not found:
        return ""
    return (
        f"{max(found)[1]}, where [uncertainty] states a crosstalk of {stated:.1e}: it is cross-talk, or stray light of the "
        "beam; state crosstalk in [uncertainty]"
    )


def signed(z: float) -> str:
    """A deviation with its sign and one decimal; what rounds to 0 has no sign."""
    return "0.0" if abs(z) < 0.05 else f"{z:+.1f}"


def compare(
    beam: ScannedBeam,
    wavelength_nm: float,
    scanned: Signal,
    middle: Signal | None,
    etalon: Signal,
    certified: float,
    of_etalon: Sequence[Component],
    rig: RigFile,
    moves: Ints | None = None,
) -> Closure:
    """The closure at a wavelength: `scanned` (n,) is the scan, `etalon` (1,) the etalon's signal.

    `of_etalon` are the components of the etalon's light: of its certificate, and of the factors on it.
    `middle` (1,) is the open beam at the wavelength in the middle pose; None at the wavelength of the scan itself. `moves`
    (n, 2) are the numbers of moves of shift and beta before each pose; without them each pose has its own.
    """
    scan = beam.scan
    at = scan.middle
    spectral = 1.0 if middle is None else float(middle.value[0] / scanned.value[at])
    seen = float(etalon.value[0])
    plain = math.pi * seen / (math.cos(math.radians(scan.at_deg)) * beam.total * spectral)
    inputs, correction = pose_effects(scan, rig, float(beam.centroid_deg[0]))
    light = light_effects(scan, rig)
    components = [
        *inputs,
        *light.components,
        *_scan_positions(beam, scanned, middle, moves, rig),
        *_reading_components(beam, scanned, middle, etalon, rig),
        *(_component(declared.BEAM_HOLE, 1.0, rig, f"{declared.BEAM_HOLE.name}@{side}") for side in ("upper", "lower")),
        # The sharper edges of the beam, foreshortened by the spot at grazing incidence, are sampled less well.
        _component(
            declared.SCAN, math.hypot(1.0, 0.5 * math.tan(math.radians(scan.at_deg))) * (scan.step_deg / STEP_DEG) ** 2, rig
        ),
        *of_etalon,
    ]
    found = tuple(sorted(components, key=lambda each: -each.u))
    return Closure(beam, wavelength_nm, certified, plain * math.exp(correction), correction, found, light)


@dataclass(frozen=True)
class PoseInput:
    """An input of the pose: the change of ln rho and of the scan's centroid along the arc for one degree of it."""

    input: InputQuantity
    of_value: float
    of_centroid: float


def pose_inputs(scan: BeamScan, rig: RigFile) -> list[PoseInput]:
    """The inputs of the pose in the plane of incidence; out of it all have no effect to first order.

    They are those of the values' budgets, of the same names and signs.
    """
    sigma = math.radians(scan.at_deg)
    per_deg = math.radians(1.0)
    tangent, cotangent = math.tan(sigma) * per_deg, per_deg / math.tan(sigma)
    side = 1.0 if scan.arc == "upper" else -1.0  # the unit and the arc turn the other way about the lower arc's pole
    instrument, sigmas = nominal_instrument(rig), (scan.etalon_pose[1], float(scan.poses[scan.middle, 1]))
    etalon, beam = (light_at(instrument, each) for each in sigmas)
    # The change of the angle of incidence, and those of the irradiance, of the etalon and of the hole.
    turned = -math.copysign(1.0, beam[0][2]) / math.sin(sigma) * beam[1][:, 2]
    of_light = dict(zip(LIGHT, zip((etalon[2] - beam[2]).tolist(), turned.tolist(), strict=True), strict=True))
    of_arc = dict.fromkeys(("shift_zero", f"photodiode_angle[{scan.photodiode}]", "sensor_tilt_y"), (cotangent - tangent, -1.0))
    effects = {
        **of_light,
        "arc_tilt_y": (side * tangent, side),  # about y the arc turns towards smaller polar angles
        **of_arc,
        # The empty holder's hole cuts the beam out, tilted as a sample is.
        "sample_tilt_y@nothing": (side * tangent, 0.0),
        # sigma, and for the etalon the shift, arrive anew.
        "position@sigma#etalon": (-side * tangent, 0.0),
        "position@shift#etalon": (-tangent, 0.0),
        "position@sigma#open beam": (-side * tangent, -side),
    }
    table = rig.uncertainty
    moves = (("sigma", "etalon"), ("shift", "etalon"), ("sigma", "open beam"))
    named = [
        *rig_inputs(table),
        *photodiode_inputs(table, scan.photodiode),
        *mounting_inputs(table, "sample", "nothing"),
        *(position_input(table, axis, move) for axis, move in moves),
    ]
    inputs = {each.name: each for each in named}
    return [PoseInput(inputs[name], *effect) for name, effect in effects.items()]


def pose_effects(scan: BeamScan, rig: RigFile, centroid_deg: float) -> tuple[list[Component], float]:
    """What the pose adds to the uncertainty once the centroid of the scan is known, and the correction of ln rho by it.

    The inputs are estimated from the centroid by their variances; what it does not determine is left as their uncertainty.
    """
    inputs = [each for each in pose_inputs(scan, rig) if each.input.u > 0.0]
    of_value, of_centroid = (np.array([getattr(each, name) for each in inputs]) for name in ("of_value", "of_centroid"))
    stated = Alignment.stated([each.input for each in inputs])
    seen = Posterior(stated, np.array([centroid_deg]), of_centroid[None], np.zeros((1, 1)))
    left = seen.left(of_value).tolist()
    components = [
        Component(each.input.name, abs(x) * each.input.u, x, each.input) for each, x in zip(inputs, left, strict=True)
    ]
    return components, -float(of_value @ seen.alignment.value)


@dataclass(frozen=True)
class LightEffects:
    """What the light's place does to the ratio of the two routes, in `components` of a budget, and place by place.

    `effect` (k, n): the relative change of the ratio with the slit's image at n places, of a `probability` (n,) each: by the
    place alone, and for one standard uncertainty of each further input. The square of a component is the mean of its effect's.
    """

    components: tuple[Component, ...]
    probability: Floats
    effect: Floats

    @classmethod
    def mean(cls, several: "Sequence[LightEffects]", weight: Floats) -> "LightEffects":
        """The effects on a weighted mean of several scans, all with the image at one place."""
        return cls((), several[0].probability, np.einsum("s,skn->kn", weight, np.stack([each.effect for each in several])))

    @property
    def by_place(self) -> Floats:
        """The effects (k n,) times the root of the probability: the product of those of two scans is their covariance."""
        return (self.effect * np.sqrt(self.probability)).ravel()

    def chance(self, difference: float, variance: float) -> float:
        """How often a difference is as large by chance, with the `variance` of all but the light's place.

        A hole is lit everywhere on most rigs, and dark by much on few: that is no normal law.
        """
        u = np.sqrt(2.0 * np.maximum(variance + np.sum(self.effect[1:] ** 2, axis=0), SMALLEST_U**2))
        beyond = [math.erfc(each) for side in (1.0, -1.0) for each in ((abs(difference) + side * self.effect[0]) / u).tolist()]
        return 0.5 * float(np.tile(self.probability, 2) @ beyond)


def light_effects(scan: BeamScan, rig: RigFile) -> LightEffects:
    """The effects of the light's place, by the tilts of the mirrors that the rig file states.

    Where an edge of the slit's image is within the hole, part of it is dark. The mirror unit carries the image's place: what is
    off in the plane of incidence is off to the other side of the hole at 180 deg - sigma, what is off along y to the same. The
    image's sides do not turn with the unit, and are inclined against the hole by sigma at both. So an image that is off in both
    directions has one of its corners in the hole at the etalon, and another one at the open beam: the lit shares differ. One
    that is off in one direction has the same share at both, but in the plane of incidence on opposite sides: a photodiode
    accepts from each point what its cone and its disc have in common, and a disc that is off sees more of one side. A hole that
    is lifted, and a shift of the exit pupil, move the image against the hole by different ways.
    """
    sigmas = scan.etalon_pose[1], float(scan.poses[scan.middle, 1])
    return _light_effects(
        nominal_instrument(rig), rig.uncertainty, scan.etalon_pose[0], sigmas, scan.at_deg, scan.arc == "lower"
    )


@lru_cache(maxsize=SCANS_KEPT)
def _light_effects(
    instrument: Instrument, table: UncertaintyTable, gamma: float, sigmas: tuple[float, float], at_deg: float, lower: bool
) -> LightEffects:
    one, no = np.ones(1), np.zeros(1, dtype=bool)
    views = Views(
        sigmas[0] * one, gamma * one, math.radians(at_deg) * one, math.radians(SPECULAR_AZIMUTH_DEG) * one, no | lower, no, no
    )
    (view,), (disc,) = disc_moves(instrument, views)
    of_rig = rig_inputs(table)
    of_light, of_view = of_rig[: len(LIGHT)], of_rig[len(LIGHT) :]
    ways = [image_shifts(instrument, sigma) @ across_beam(sigma).T for sigma in sigmas]
    law = place_law(0.5 * (ways[0] + ways[1]), math.sqrt(3.0) * standard_uncertainties(of_light))
    etalon, beam = (seen_light(instrument, (sigma, gamma), view, law.places) for sigma in sigmas)
    image = etalon.logarithm - beam.logarithm
    u = math.sqrt(float(law.probability @ image**2))
    alone = replace(quantity(declared.MIRROR_TILT, table, SLIT_IMAGE), unit="1", u=u, distribution="normal")
    components, effects = [Component(SLIT_IMAGE, alone.u, 1.0, alone)], [image]
    # With a star and an input: those of the place and of that input together.
    by_lift = [
        -(each.by_place @ across_beam(sigma)[:, 2]) - each.by_disc[:, 2]
        for each, sigma in zip((etalon, beam), sigmas, strict=True)
    ]
    mounted = [mounting_inputs(table, *each)[MOUNTED.index("height")] for each in (("etalon", "etalon"), ("sample", "nothing"))]
    with_image = [
        *zip(of_view, ((etalon.by_disc - beam.by_disc) @ disc.T).T, strict=True),
        # What moves the image alike at both sigmas is in the law of its place.
        *zip(of_light, ((etalon.by_place + beam.by_place) @ (0.5 * (ways[0] - ways[1])).T).T, strict=True),
        # A hole that is lifted meets the beam beside its middle, and the photodiode sees it from there.
        (mounted[0], by_lift[0]),
        (mounted[1], -by_lift[1]),
    ]
    for each, effect in with_image:
        sensitivity = math.sqrt(float(law.probability @ effect**2))
        effects.append(effect * each.u)
        if sensitivity * each.u > SMALLEST_U:
            both = replace(each, name=f"{SLIT_IMAGE}*{each.name}", distribution="normal")
            components.append(Component(both.name, sensitivity * each.u, sensitivity, both))
    return LightEffects(tuple(components), law.probability, np.stack(effects))


def _scan_positions(
    beam: ScannedBeam, scanned: Signal, middle: Signal | None, moves: Ints | None, rig: RigFile
) -> Iterator[Component]:
    """Where shift and beta stop for each pose of the scan: poses between two moves of an axis have one error."""
    scan = beam.scan
    slopes = scan.slopes(scanned.value) * [1.0, math.sin(math.radians(scan.at_deg))]
    parts = slopes * scan.solid_angle_sr[:, None] / beam.total
    own = np.repeat(np.arange(len(parts))[:, None], 2, axis=1)
    for k, axis in enumerate(("shift", "beta")):
        _, which = np.unique((own if moves is None else moves)[:, k], return_inverse=True)
        squares = float(np.sum(np.bincount(which.ravel(), weights=parts[:, k]) ** 2))
        if middle is not None:  # the middle pose is reached once more
            squares += 2.0 * float(slopes[scan.middle, k] / scanned.value[scan.middle]) ** 2
        stop = position_input(rig.uncertainty, axis, "scan")
        yield Component(stop.name, math.sqrt(squares) * stop.u, math.sqrt(squares), stop)


def _reading_components(
    beam: ScannedBeam, scanned: Signal, middle: Signal | None, etalon: Signal, rig: RigFile
) -> Iterator[Component]:
    """What the readings do to the etalon's signal over the sum of the scan: what both have in common cancels."""
    numbers = np.arange(len(scanned.value) + 1, dtype=np.int32)
    poses = scanned.own_as("scan_reading", numbers[:-1])
    total = poses.scaled(beam.scan.solid_angle_sr).summed()
    if middle is not None:
        further = middle.own_as("scan_reading", numbers[-1:])
        total = total / (poses.each(itemgetter(beam.scan.middle)) / further.each(itemgetter(0)))
    quotient = etalon.own_as("etalon_reading", numbers[:1]).each(itemgetter(0)) / total
    relative = quotient.scaled(1.0 / quotient.value)
    for name, effect in relative.common.items():
        yield _of_effect(input_of(name, 0, rig), float(effect))
    for name, terms in relative.grouped.items():
        if name == "gain":
            for number, each in zip(terms.member.tolist(), terms.effect.tolist(), strict=True):
                if number != NONE:
                    yield _of_effect(input_of(name, number, rig), each)
        else:
            yield Component(name, float(np.sqrt(terms.variance)), 1.0, None)


def _of_effect(source: InputQuantity, effect: float) -> Component:
    """A component of an input, by the effect of its standard uncertainty."""
    sensitivity = effect / source.u if source.u else 0.0
    return Component(source.name, abs(sensitivity) * source.u, sensitivity, source)


def _component(each: declared.Input, sensitivity: float, rig: RigFile, name: str = "") -> Component:
    """A component of a declared input."""
    given = quantity(each, rig.uncertainty, name)
    return Component(given.name, abs(sensitivity) * given.u, sensitivity, given)


def _trouble(rows: Sequence[RowSignal], photodiode: int) -> str:
    """Why readings of a photodiode cannot be used; empty where they can."""
    saturated = sum(int(each.signal.gain[photodiode] < 0) for each in rows)
    if saturated:
        return (
            f"photodiode {photodiode} is saturated at every gain in {saturated} of {len(rows)} readings: add the rig's lowest "
            "gain to gains_v_per_a, or less light"
        )
    for flag, reason in TROUBLES.items():
        if any(each.flags[flag][photodiode] for each in rows):
            return f"photodiode {photodiode} {reason}"
    return ""


def _row(wavelength_nm: float) -> Row:
    return Row(0, "", "measure", "", wavelength_nm=wavelength_nm)


def _angles(scan: BeamScan, k: int) -> tuple[float, float, float, float]:
    gamma, sigma, beta, shift = scan.poses[k].tolist()
    return gamma, sigma, beta, shift
