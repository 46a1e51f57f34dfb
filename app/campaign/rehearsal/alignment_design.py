"""The design of an alignment's campaign: the grids that give the least uncertainty in a given time.

What a campaign shows is known before it is measured: the estimator's sensitivities and covariance (`reduction.alignment`) at
the directions that it measures, with light and noise as in some rows that the twin reads. A design is a set of levels of sigma,
gamma, beta and shift, as the schedule's grids have them. Levels are exchanged for others, added and removed, as long as the
plan of the rig takes no longer, for the smallest determinant of the covariance of the predictions: of the specular direction
against the arc, on both sides, at incidences and azimuths of their own (D-optimality). While designs are compared, each row has
positions of its own for all axes, but for those that have one level and are not moved; what is stated of the design, and of the
schedule that it began with, is by the whole estimator and the rows of their plans.
"""

import math
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from goniotwin.app.campaign.geometry.arcs import lit_sides
from goniotwin.app.campaign.geometry.directions import PoseAngles, rig_sigma_deg
from goniotwin.app.campaign.geometry.open_beam import scan_wavelength_nm
from goniotwin.app.campaign.journal.reading import ExecutedRow
from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.effects import Effects, group_variance
from goniotwin.app.campaign.measurement_model.pose import POSITIONS, Views, mounting_inputs, pose_effects, rig_inputs
from goniotwin.app.campaign.planning.exposure import exposure_twin
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints
from goniotwin.app.campaign.reduction.row_history import RowHistory
from goniotwin.app.campaign.reduction.settings import ReductionSettings, reduction_settings
from goniotwin.app.campaign.rehearsal.without_wires import rows_without_wires
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.campaign.studies.alignment import LEAST_SHARE, TERMS, WIDEST_DEG, fit_lobe, lobe_effects
from goniotwin.app.campaign.studies.closure import ScannedBeam
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.sample_alignment import sample_lobe
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, nominal_instrument
from goniotwin.app.rig.alignment import Combination
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, round_deg

FIRST_LINE = "# Planned by goniotwin align --plan."
"""Of a schedule that was planned; no other one is overwritten."""
GRIDS = ("sigma_deg", "gamma_deg", "beta_deg", "shift_deg")
FURTHER: Mapping[str, tuple[float, ...]] = {
    "sigma_deg": (5.0, 15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0),
    "gamma_deg": (0.0, 90.0, 180.0, 270.0),
    "beta_deg": tuple(SPECULAR_AZIMUTH_DEG + each for each in (-24.0, -16.0, -12.0, -8.0, -4.0, 4.0, 8.0, 12.0, 16.0, 24.0)),
    "shift_deg": (0.0, 1.0, 2.0, 3.0, 4.0),
}
"""Levels beside those of the schedule, as far as the rig's limits and the arc's clearance allow them."""
LEAST_LEVELS = {"sigma_deg": 2, "gamma_deg": 1, "beta_deg": 1, "shift_deg": 1}
BETWEEN_SIGMA_DEG, BETWEEN_GAMMA_DEG = (11.0, 24.0, 36.0, 51.0, 68.0), (45.0, 135.0, 250.0)
"""Where the predictions are that a design is judged by."""
LEAST_GAIN = 0.02
"""Least gain of the logarithm of the determinant for which a level is exchanged."""
MOST_EXCHANGES = 40
MOST_MINUTES = 180.0
"""Longest design, and longest schedule to begin with: the estimator takes the cube of their rows."""
MOST_PLANNED_ROWS = 300_000
"""Rows of all plans of a search, after which it ends with what it has: some two minutes of computing."""
SAME_INCIDENCE = 0.02
"""A degree of the angle of incidence counts as much as this of the angle from the specular direction, where light is alike."""
LEAST_KNOWN = 1e-9
"""Share of the largest variance of a prediction below which a combination of the inputs has no part in it."""
FLOOR = 1e-12
OWN_POSITIONS, OF_ROW, OF_PHOTODIODE = "position", "row", "photodiode_angle"


@dataclass(frozen=True)
class Forecast:
    """What a plan of `seconds` and so many `rows` is expected to find; `combinations` are those that it determines.

    Their values are 0. `u_before` are their uncertainties by the schedule that the design began with, at equal time.
    """

    rows: int
    seconds: float
    combinations: tuple[Combination, ...]
    u_before: tuple[float, ...]


@dataclass(frozen=True)
class AlignmentDesign:
    """A schedule for an alignment: its `text`, the `plan`, what it is expected to find, and the seconds that were allowed.

    `began_s` is the duration of the schedule that the design began with, and `gain` how much the determinant's logarithm of
    the predictions' covariance is below that of it at equal time, for each combination. `ended_early`: the search ended because
    it had planned MOST_PLANNED_ROWS, and there may be better levels.
    """

    text: str
    plan: NewPlan
    sample: str
    levels: Mapping[str, tuple[float, ...]]
    forecast: Forecast
    allowed_s: float
    began_s: float
    gain: float
    ended_early: bool

    def as_dict(self) -> dict[str, Any]:
        """The design for JSON; angles in deg."""
        found = zip(self.forecast.combinations, self.forecast.u_before, strict=True)
        return {
            "sample": self.sample,
            "simulated": self.plan.rig.simulated,
            "rows": self.forecast.rows,
            "duration_s": self.forecast.seconds,
            "allowed_s": self.allowed_s,
            "schedule_duration_s": self.began_s,
            "levels": {key: list(values) for key, values in self.levels.items()},
            "combinations": [
                {"u": each.u, "prior_u": each.prior_u, "schedule_u": u, "coefficients": each.coefficients} for each, u in found
            ],
            "log_determinant_gain": self.gain,
            "ended_early": self.ended_early,
            "schedule": self.text,
        }


@dataclass(frozen=True)
class SearchLimits:
    """What a search for a design may take: levels beyond the schedule's own, by grid; the longest design; planned rows."""

    further: Mapping[str, tuple[float, ...]] = field(default_factory=lambda: FURTHER)
    most_minutes: float = MOST_MINUTES
    most_planned_rows: int = MOST_PLANNED_ROWS


def design_alignment(
    schedule: ScheduleDescription,
    rig: RigDescription,
    minutes: float,
    sample: str | None = None,
    limits: SearchLimits | None = None,
) -> AlignmentDesign:
    """The design that begins with a schedule, of at most so many minutes on the rig's clock, without mountings.

    Raises UserError where the rig file describes no light of the sample, or the time, or the schedule's own, is too short or
    above the limit.
    """
    limits = limits or SearchLimits()
    if minutes > limits.most_minutes:
        raise UserError(f"--minutes {minutes:g}: an alignment is planned for at most {limits.most_minutes:g} min; give fewer")
    search = _Search(schedule, rig, _named(schedule, sample), limits)
    levels = search.exchange(search.shortened(search.first, 60.0 * minutes), 60.0 * minutes)
    text = f"{FIRST_LINE}\n{search.text(levels).removeprefix(FIRST_LINE).lstrip()}"
    plan = search.plan(levels)
    began = search.plan(search.first)
    after, of_schedule = search.alignment(plan), search.alignment(began)
    stated = search.stated
    at_equal_time = _with_time(of_schedule, stated, plan.seconds / began.seconds)
    combinations, _ = after.combinations(nominal_instrument(rig.file))
    if not combinations:
        raise UserError(f"{schedule.name}: {minutes:g} min determine no combination; allow more")
    names = [each.name for each in stated.inputs]
    rows = np.array([[each.coefficients.get(name, 0.0) for name in names] for each in combinations])
    u_before = np.sqrt(np.einsum("ki,ij,kj->k", rows, at_equal_time, rows))
    forecast = Forecast(len(plan.rows), plan.seconds, combinations, tuple(u_before.tolist()))
    gain = search.determinant(at_equal_time) - search.determinant(after.covariance)
    return AlignmentDesign(
        text, plan, search.sample, levels, forecast, 60.0 * minutes, began.seconds, gain / len(combinations), search.ended
    )


def is_planned(content: bytes) -> bool:
    """Whether a file is a schedule that was planned."""
    return content.startswith(FIRST_LINE.encode())


def _named(schedule: ScheduleDescription, sample: str | None) -> str:
    samples = schedule.file.samples
    if sample is None and len(samples) > 1:
        raise UserError(f"{schedule.name}: has several samples; name one with --sample: {', '.join(samples)}")
    if sample is not None and sample not in samples:
        raise UserError(f"{schedule.name}: has no sample {sample!r}; choose with --sample: {', '.join(samples)}")
    return sample or samples[0]


def _with_time(alignment: Alignment, stated: Alignment, ratio: float) -> Floats:
    """The covariance of a campaign's inputs after so many times its duration: its information is in proportion."""
    u = np.array([each.u for each in stated.inputs])
    unit = np.outer(u, u)
    before = np.linalg.inv(stated.covariance / unit + FLOOR * np.eye(u.size))
    after = np.linalg.inv(alignment.covariance / unit + FLOOR * np.eye(u.size))
    return np.asarray(np.linalg.inv(before + ratio * (after - before)) * unit)


class _PlannedRows:
    """The rows of a plan as a history has them."""

    def __init__(self, plan: NewPlan) -> None:
        self._plan = plan

    def executed_rows(self) -> Iterator[ExecutedRow]:
        """The rows in order of time."""
        return (ExecutedRow(row.number, row.kind, row.sample, 0, row.pose) for row in self._plan.rows)


class _Light:
    """A lobe and its noise at all directions, as in the rows that a twin has read of one azimuth of the sample."""

    def __init__(self, points: BsdfPoints) -> None:
        self._points = points
        self._furthest = float(points.theta_deg.max())
        basis = self._basis(points.theta_deg)
        self._form = np.linalg.lstsq(basis, np.log(points.bsdf), rcond=None)[0]

    def _basis(self, theta_deg: Floats) -> Floats:
        return np.asarray((theta_deg[:, None] / self._furthest) ** (2 * np.arange(TERMS)))

    def points(
        self, rows: Sequence[tuple[int, int, PoseAngles]], wavelength_nm: float, settings: ReductionSettings
    ) -> BsdfPoints:
        """The expected points of a lobe in rows: the numbers of each row and of the etalon's, and the pose."""
        places: list[tuple[float, ...]] = []
        parts: list[Floats] = []
        for number, etalon, pose in rows:
            for view, blocked in settings.geometry.views(pose):
                near = ~blocked & (view.theta <= min(self._furthest, WIDEST_DEG))
                if view.transmitted or not near.any():
                    continue
                columns = (view.channels, view.zenith, view.azimuth, view.theta, view.phi)
                count = int(near.sum())
                of_row = np.tile([len(places), number, etalon, view.back], (count, 1))
                parts.append(np.concatenate([np.stack([each[near] for each in columns], axis=1), of_row], axis=1))
            places.append((wavelength_nm, *pose))
        if not parts:
            raise UserError(f"{settings.sample}: its lobe is in no row")
        table, of_places = np.concatenate(parts), np.array(places)
        sigma = of_places[table[:, 5].astype(np.int64), PLACE.index("sigma_deg")]
        logarithm = self._basis(table[:, 3]) @ self._form
        table = table[logarithm > self._peaks(sigma, logarithm) + math.log(LEAST_SHARE)]
        at = table[:, 5].astype(np.int64)
        like = self._points.where(self._alike(table[:, 3], of_places[at, PLACE.index("sigma_deg")]))
        change = np.exp((self._basis(table[:, 3]) - self._basis(like.theta_deg)) @ self._form)
        return replace(
            like.scaled(change),
            places=of_places,
            place=at.astype(like.place.dtype),
            photodiode=table[:, 0].astype(like.photodiode.dtype),
            zenith_deg=table[:, 1],
            azimuth_deg=table[:, 2],
            theta_deg=table[:, 3],
            phi_deg=table[:, 4],
            back=table[:, 8] > 0.0,
            row=table[:, 6].astype(np.int64),
            etalon_row=table[:, 7].astype(np.int64),
        )

    @staticmethod
    def _peaks(sigma: Floats, logarithm: Floats) -> Floats:
        _, which = np.unique(sigma, return_inverse=True)
        peak = np.full(int(which.max()) + 1, -np.inf)
        np.maximum.at(peak, which, logarithm)
        return np.asarray(peak[which])

    def _alike(self, theta_deg: Floats, sigma_deg: Floats) -> Ints:
        """The point that was read with the most similar light, for each direction (n,)."""
        read = self._points
        found = [
            np.argmin(np.abs(theta - read.theta_deg) + SAME_INCIDENCE * np.abs(sigma - read.sigma_deg))
            for theta, sigma in zip(theta_deg.tolist(), sigma_deg.tolist(), strict=True)
        ]
        return np.array(found, dtype=np.int64)


Levels = Mapping[str, tuple[float, ...]]


class _Search:
    """The exchange of levels, with the information of all rows that a design can have."""

    def __init__(self, schedule: ScheduleDescription, rig: RigDescription, sample: str, limits: SearchLimits) -> None:
        self._schedule, self._rig, self.sample, self._limits = schedule, rig, sample, limits
        self._wavelength = scan_wavelength_nm(schedule.file)
        self.first: Levels = {key: grid_values(getattr(schedule.file, key)) for key in GRIDS}
        self._kept = set(schedule.file.scanned_sigmas_deg) if schedule.file.open_beam_scan is not None else set()
        if schedule.file.open_beam_scan is not None and schedule.file.open_beam_scan.sigma_deg is None:
            self._kept = set()
        self._plans: dict[str, NewPlan] = {}
        self._planned_rows = 0
        if (own_minutes := self.plan(self.first).seconds / 60.0) > limits.most_minutes:
            raise UserError(
                f"{schedule.name}: takes {math.ceil(own_minutes)} min, and a design begins with at most "
                f"{limits.most_minutes:g}; take a schedule with fewer levels"
            )
        light, self._beams = self._read_light()
        self._light = _Light(light)
        self._pool = {key: self._possible(key) for key in GRIDS}
        self._collect()

    # Schedules and plans.

    def text(self, levels: Levels) -> str:
        """The schedule with these levels."""
        document = tomlkit.parse(self._schedule.text)
        document["samples"] = [self.sample]
        document["symmetry"] = "anisotropic"
        document["wavelength_nm"] = [self._wavelength]
        for key, values in levels.items():
            document[key] = [int(each) if each == int(each) else each for each in values]
        for key in ("align", "near_specular", "symmetry_check", "overlap"):
            document.pop(key, None)
        return tomlkit.dumps(document)

    def plan(self, levels: Levels) -> NewPlan:
        """The plan of the schedule with these levels. Raises UserError."""
        text = self.text(levels)
        if text not in self._plans:
            described = parse_schedule(text, self._schedule.name)
            self._plans[text] = make_plan(replace(described, certificate=self._schedule.certificate), self._rig)
            self._planned_rows += len(self._plans[text].rows)
        return self._plans[text]

    def _read_light(self) -> tuple[BsdfPoints, Sequence[ScannedBeam]]:
        """The lobe at one azimuth of the sample, as the twin reads it, and the scans of the open beam, which show nothing."""
        gamma = self.first["gamma_deg"][:1]
        described = parse_schedule(self.text({**self.first, "gamma_deg": gamma}), self._schedule.name)
        plan = make_plan(replace(described, certificate=self._schedule.certificate), self._rig)
        file = plan.schedule.file
        model = None if self._rig.file.twin is None else exposure_twin(self._rig, file)
        if model is None:
            raise UserError(
                f"{self._rig.name}: has no [twin] that describes the light of {self.sample} quickly; add it, or measure "
                "examples/proof/alignment.toml with that of examples/proof"
            )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "light.journal"
            with Journal.create(path, plan, software_versions(), durable=False) as journal:
                session, now = journal.begin_session(0.0, self._rig.text, software_versions()), 0.0
                for each in rows_without_wires(plan, model):
                    journal.commit(each.row, each.data)
                    now = each.data.ended_s
                journal.end_session(session, now, "done")
            with Journal.open(path) as journal:
                evaluation = evaluate_journal(journal)
                points, beams = sample_lobe(evaluation.reduction, self.sample), evaluation.closure.beams
        if points is None or points.size < TERMS:
            raise UserError(f"{self._schedule.name}: {self.sample} has no lobe of reflected light")
        return points, [replace(each, centroid_deg=np.zeros(2)) for each in beams]

    def _possible(self, key: str) -> tuple[float, ...]:
        """The levels of a grid that the rig can have."""
        found = set(self.first[key])
        for level in set(self._limits.further[key]) - found:
            levels = (*sorted(self._kept), level) if key == "sigma_deg" and level not in self._kept else (level,)
            try:
                self.plan({**self.first, key: tuple(sorted(levels))})
            except UserError:
                continue
            found.add(level)
        return tuple(sorted(found))

    # Information.

    def _settings(self, history: RowHistory | None) -> ReductionSettings:
        schedule, rig = self._schedule, self._rig
        settings = reduction_settings(rig.file, schedule.file, schedule.certificate, schedule.name, alignment=rig.alignment)
        return replace(settings, history=history, sample=self.sample)

    def alignment(self, plan: NewPlan) -> Alignment:
        """What an alignment by a plan is expected to find, by the whole estimator."""
        etalon = plan.schedule.file.etalon
        of_etalon = {
            tuple(round_deg(row.pose).tolist()): row.number
            for row in plan.rows
            if row.kind == "measure" and row.sample == etalon and row.pose is not None
        }
        rows = [
            (row.number, of_etalon[tuple(round_deg(row.pose).tolist())], row.pose)
            for row in plan.rows
            if row.kind == "measure" and row.sample == self.sample and row.pose is not None
        ]
        settings = self._settings(RowHistory(_PlannedRows(plan)))
        return fit_lobe(self._light.points(rows, self._wavelength, settings), settings, self._beams).alignment

    def _collect(self) -> None:
        """The information of all rows of the pool: sensitivities to inputs in units of their u, with rows decorrelated."""
        sides = lit_sides(self._schedule.file)
        poses = [
            (self._pool["gamma_deg"][0], rig_sigma_deg(sigma, side), beta, shift)
            for sigma in self._pool["sigma_deg"]
            for side in sides
            for beta in self._pool["beta_deg"]
            for shift in self._pool["shift_deg"]
        ]
        settings = self._settings(None)
        of_one = self._light.points([(k, k, pose) for k, pose in enumerate(poses)], self._wavelength, settings)
        turned = []
        for turn, gamma in enumerate(self._pool["gamma_deg"]):
            places, first = of_one.places.copy(), turn * len(poses)
            places[:, PLACE.index("gamma_deg")] = gamma
            turned.append(replace(of_one, places=places, row=of_one.row + first, etalon_row=of_one.etalon_row + first))
        points = BsdfPoints.join(turned)
        effects, self.stated = lobe_effects(points, settings, self._beams)
        sigma = np.where(points.back, 180.0 - points.sigma_deg, points.sigma_deg)
        self._levels = {
            "sigma_deg": sigma,
            "gamma_deg": points.gamma_deg,
            "beta_deg": points.beta_deg,
            "shift_deg": points.shift_deg,
        }
        self._white = _decorrelated(effects, points.row)
        modes, of_modes = self.stated.modes
        self._modes = len(modes)
        self._of_modes = of_modes * [each.u for each in modes]
        self._directions = self._predicted()

    def _predicted(self) -> Floats:
        """Combinations (inputs, m) of the inputs that the predictions have, in which their covariance before is 1."""
        incidences = [rig_sigma_deg(each, side) for side in lit_sides(self._schedule.file) for each in BETWEEN_SIGMA_DEG]
        sigma, gamma = (each.ravel() for each in np.meshgrid(incidences, BETWEEN_GAMMA_DEG, indexing="ij"))
        back = sigma > 90.0
        polar, no = np.radians(np.where(back, 180.0 - sigma, sigma)), np.zeros(sigma.size, dtype=bool)
        views = Views(sigma, gamma, polar, np.full(sigma.size, math.radians(SPECULAR_AZIMUTH_DEG)), back, no, no)
        effects = pose_effects(nominal_instrument(self._rig.file), views)
        names = [each.name for each in rig_inputs(self._rig.file.uncertainty)]
        names += [each.name for each in mounting_inputs(self._rig.file.uncertainty, "sample", f"{self.sample}#1")]
        columns = np.concatenate(
            [
                np.concatenate([getattr(part, axis) for part in (effects.common, effects.sample)], axis=1)
                for axis in ("along", "across")
            ]
        )[:, [names.index(each.name) for each in self.stated.inputs]]
        _, size, rows = np.linalg.svd(columns @ self._of_modes, full_matrices=False)
        return np.asarray(rows[size**2 > LEAST_KNOWN * size[0] ** 2].T)

    def determinant(self, covariance: Floats) -> float:
        """Logarithm of the determinant of the predictions' covariance over that before, by that of the inputs."""
        inverse = np.linalg.pinv(self._of_modes)
        return self._logarithm(np.asarray(inverse @ covariance @ inverse.T))

    def _logarithm(self, of_modes: Floats) -> float:
        return float(np.linalg.slogdet(self._directions.T @ of_modes @ self._directions)[1])

    def _score(self, levels: Levels) -> float:
        """The same for a design."""
        chosen = np.ones(self._levels["sigma_deg"].size, dtype=bool)
        for key, values in levels.items():
            chosen &= np.isin(np.round(self._levels[key], 6), values)
        some = self._white[np.append(np.flatnonzero(chosen), np.arange(chosen.size, len(self._white)))]
        # An axis with one level is not moved: its position is the same in all rows.
        moved = np.array([len(levels[f"{axis}_deg"]) > 1 for axis in POSITIONS])
        some = some[:, np.append(np.ones(some.shape[1] - moved.size, dtype=bool), ~moved)]
        covariance = np.asarray(np.linalg.inv(np.eye(some.shape[1]) + some.T @ some), dtype=np.float64)
        return self._logarithm(covariance[: self._modes, : self._modes])

    # The exchange.

    def shortened(self, levels: Levels, allowed_s: float) -> Levels:
        """The levels that are left where those with the least information for their time are removed. Raises UserError."""
        while (seconds := self.plan(levels).seconds) > allowed_s:
            here, possible = self._score(levels), []
            for other in self._without(levels):
                saved = seconds - self.plan(other).seconds
                if saved > 0.0:
                    possible.append(((self._score(other) - here) / saved, other))
            if not possible:
                raise UserError(
                    f"{self._schedule.name}: {allowed_s / 60.0:g} min are too few; the shortest design takes "
                    f"{math.ceil(seconds / 60.0)} min"
                )
            levels = min(possible, key=lambda each: each[0])[1]
        return levels

    def exchange(self, levels: Levels, allowed_s: float) -> Levels:
        """The levels after exchanges, as long as any of them gives more information in the time."""
        here = self._score(levels)
        for _ in range(MOST_EXCHANGES):
            found = self._better(levels, here, allowed_s)
            if found is None:
                break
            here, levels = found
        return levels

    def _better(self, levels: Levels, here: float, allowed_s: float) -> tuple[float, Levels] | None:
        for near in (self._swapped(levels), self._with_one_for_another(levels)):
            scored = sorted(((self._score(each), each) for each in near), key=lambda each: each[0])
            for score, each in scored:
                if score > here - LEAST_GAIN or self.ended:
                    break
                if self._fits(each, allowed_s):
                    return score, each
        return None

    @property
    def ended(self) -> bool:
        """Whether the search has planned as many rows as it may."""
        return self._planned_rows > self._limits.most_planned_rows

    def _fits(self, levels: Levels, allowed_s: float) -> bool:
        try:
            return self.plan(levels).seconds <= allowed_s
        except UserError:  # no order of the rows is clear of the beam
            return False

    def _swapped(self, levels: Levels) -> Iterator[Levels]:
        """A level for another one of its grid, or one more."""
        yield from self._with(levels)
        for each in self._without(levels, least=False):
            (key,) = [key for key in GRIDS if each[key] != levels[key]]
            yield from (other for other in self._with(each, (key,)) if other[key] != levels[key])

    def _with_one_for_another(self, levels: Levels) -> Iterator[Levels]:
        """A level more of one grid, and one fewer of another."""
        for each in self._without(levels):
            (key,) = [key for key in GRIDS if each[key] != levels[key]]
            yield from self._with(each, tuple(other for other in GRIDS if other != key))

    def _with(self, levels: Levels, keys: Sequence[str] = GRIDS) -> Iterator[Levels]:
        for key in keys:
            for level in self._pool[key]:
                if level not in levels[key]:
                    yield {**levels, key: tuple(sorted((*levels[key], level)))}

    def _without(self, levels: Levels, *, least: bool = True) -> Iterator[Levels]:
        for key in GRIDS:
            if len(levels[key]) > (LEAST_LEVELS[key] if least else 0):
                for level in levels[key]:
                    if key != "sigma_deg" or level not in self._kept:
                        yield {**levels, key: tuple(each for each in levels[key] if each != level)}


def _decorrelated(effects: Effects, rows: Ints) -> Floats:
    """Sensitivities (n, inputs) to what rows share, in units of the inputs' u, over the square root of each row's covariance.

    What a row alone has in common is in that covariance: its light and the positions of the axes. The dense inputs come first,
    and a position of each of POSITIONS that all rows have in common last.
    """
    still = np.zeros((effects.value.size, len(POSITIONS)))
    count = effects.value.size
    variance = np.sum(list(effects.independent.values()), axis=0)
    columns = [part.sensitivity * [each.u for each in part.inputs] for part in effects.dense]
    of_row = [np.zeros((count, 0))]
    for group in effects.groups:
        u = np.array([[group.inputs[k].u if k >= 0 else 0.0 for k in line] for line in group.member.tolist()])
        effect = group.sensitivity * u
        if group.name in (OWN_POSITIONS, OF_ROW):
            of_row.append(effect)
            for axis in range(len(POSITIONS) if group.name == OWN_POSITIONS else 0):
                of_axis = (group.member >= 0) & (group.member % len(POSITIONS) == axis)
                still[:, axis] += np.sum(np.where(of_axis, effect, 0.0), axis=1)
        elif group.name == OF_PHOTODIODE:
            numbers = sorted({int(k) for k in group.member.ravel()} - {-1})
            own = np.zeros((count, len(numbers)))
            for j, k in enumerate(numbers):
                own[:, j] = np.sum(np.where(group.member == k, effect, 0.0), axis=1)
            columns.append(own)
        else:
            variance = variance + group_variance(group)
    shared, common = np.concatenate([*columns, still], axis=1), np.concatenate(of_row, axis=1)
    white = shared / np.sqrt(variance)[:, None]
    for here in np.split(np.arange(rows.size), np.flatnonzero(np.diff(rows)) + 1):
        covariance = np.diag(variance[here]) + common[here] @ common[here].T
        white[here] = np.linalg.solve(np.linalg.cholesky(covariance), shared[here])
    return np.asarray(white)
