"""One rig against the truth: deviations in u by cell, what is left after a fit of the shared inputs, and reflectances.

The result is small, whatever the campaign: sums by cell. Nothing of the truth is used to make the values or their u.
"""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.effects import Effects
from goniotwin.app.campaign.measurement_model.fit import Fit, ValuesCovariance
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.reduction.angles import angles
from goniotwin.app.campaign.reduction.components import ADDED, COVERAGE, KINDS, OTHER, total_variance
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.reduction.scale import deviate_of_sum
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.studies.budget import INDEX, finished_blocks
from goniotwin.app.campaign.studies.decades import DECADE_NAMES, decades_below_peak
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reflectance import components_of_sum, integration_settings, quadrature
from goniotwin.app.campaign.studies.theory import (
    deviations_in_u,
    moved_logarithm,
    noisy,
    relative_residuals,
    true_bsdf,
    with_true_slopes,
)
from goniotwin.app.rig import AXES
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Scatterer
from goniotwin.twin.plant import Drawn

FAR_U = 5.0
"""A deviation beyond so many u fell out."""
MOST_LISTED = 20
"""Points beyond FAR_U whose places are listed, of one rig."""
MOST_FITTED = 4000
"""Values in one fit: of more, each wavelength is fitted by itself, then each sigma. The law holds for each."""
SECOND_ORDER_STEPS = 2
"""Fits with the second order of the angles of the fit before."""
ZENITHS_DEG = (15.0, 30.0, 45.0, 60.0, 75.0, 90.0)
STEEP, SLOPE, NO_SLOPE = "steep", "with a slope", "without a slope"
BOUND = "bound"
"""Of values more than half of whose variance is of a component of BOUNDS."""
BOUNDS = ("slope_unresolved", "field_unresolved")
"""Components that are limits of what is not known: their error is no draw of a law with that variance."""
REFLECTED, TRANSMITTED = SIDES = ("reflected", "transmitted")
IN_PLANE, OUT_OF_PLANE = "in plane", "out of plane"


@dataclass
class Cell:
    """Sums over values: their number, those within their 95 % interval, their deviations in u, and those beyond 5 u.

    `chi_square` of what is left after the fit, with its expectation `freedom`; `square` of the deviations in u.
    """

    values: int = 0
    covered: int = 0
    deviation: float = 0.0
    beyond: int = 0
    chi_square: float = 0.0
    freedom: float = 0.0
    square: float = 0.0

    def add(self, other: "Cell") -> None:
        """Add the sums of another cell."""
        for name, each in vars(other).items():
            setattr(self, name, getattr(self, name) + each)


Cells = dict[str, dict[str, Cell]]
"""Cells by table and label."""


@dataclass
class RigResult:
    """A rig by its `seed`: its cells; by kind of input the sums of (fitted / u)^2 and of their expectations.

    `angles` by sample: the error in deg of the angle between lobe and photodiode in the plane of incidence, as drawn and as
    fitted. `reflectances` are by sample and setting: the relative deviation, u, the normal deviate of the deviation's
    probability, and the share of limits in u^2. `far` are the points beyond 5 u. `failed` is the reason why the rig has no
    result, or empty.
    """

    seed: int
    cells: Cells = field(default_factory=dict)
    inputs: dict[str, tuple[float, float]] = field(default_factory=dict)
    angles: dict[str, tuple[float, float]] = field(default_factory=dict)
    reflectances: dict[str, tuple[float, float, float, float]] = field(default_factory=dict)
    far: list[dict[str, Any]] = field(default_factory=list)
    failed: str = ""

    def as_dict(self) -> dict[str, Any]:
        """The result for its file."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: dict[str, Any]) -> "RigResult":
        """The result of a file. Raises TypeError, KeyError or AttributeError for another content."""
        cells = {
            table: {label: Cell(**cell) for label, cell in labels.items()} for table, labels in content.pop("cells").items()
        }
        inputs, angles = (
            {key: (float(a), float(b)) for key, (a, b) in content.pop(name).items()} for name in ("inputs", "angles")
        )
        reflectances = {
            key: (float(a), float(b), float(c), float(d)) for key, (a, b, c, d) in content.pop("reflectances").items()
        }
        return cls(cells=cells, inputs=inputs, angles=angles, reflectances=reflectances, **content)


def judge(journal: Path, plan: Plan) -> RigResult:
    """Compare the values of a rig's journal with the truth. Raises UserError."""
    model = plan.rig.model()
    assert model is not None
    assert plan.rig.seed is not None
    result = RigResult(plan.rig.seed)
    with Journal.open(journal) as opened:
        reduction = evaluate_journal(opened).reduction
        drawn = _DrawnInputs(Drawn(model.disturbances, model.seed, model.photodiodes.count), plan, reduction)
        for name in reduction.schedule.samples:
            blocks = list(finished_blocks(reduction, name))
            if blocks:
                points = BsdfPoints.join(blocks)
                _add_sample(result, reduction, name, points, model.samples[name], drawn)
    return result


class _DrawnInputs:
    """What is drawn by the names of a budget: the positions of an axis have other numbers there, from row to row the same."""

    def __init__(self, drawn: Drawn, plan: Plan, reduction: Reduction) -> None:
        self._drawn = drawn
        alignment = reduction.settings.alignment
        self._modes = {} if alignment is None else alignment.mode_errors(drawn)
        self._positions: dict[str, str] = {}
        moves, pose = [0] * len(AXES), [0.0] * len(AXES)
        history = reduction.settings.history
        for row in plan.rows if history is not None else ():
            if row.pose is not None and history is not None:
                moves = [count + (now != before) for count, now, before in zip(moves, row.pose, pose, strict=True)]
                pose = list(row.pose)
                counted = history.moves(np.array([row.number]))[0].tolist()
                for axis, own, of_plant in zip(AXES, counted, moves, strict=True):
                    self._positions[f"position@{axis}#{own}"] = f"position@{axis}#{of_plant}"

    def of(self, name: str) -> float:
        """The drawn value of an input, of an alignment's mode that beside the one found; 0 for one that is not drawn."""
        if name in self._modes:
            return self._modes[name]
        try:
            return self._drawn[self._positions.get(name, name)]
        except KeyError:
            return 0.0


def _add_sample(
    result: RigResult, reduction: Reduction, name: str, points: BsdfPoints, scatterer: Scatterer, drawn: _DrawnInputs
) -> None:
    truth = true_bsdf(scatterer, points)
    chosen = points.good & np.isfinite(truth)
    points_of, truth_of = points.where(chosen), truth[chosen]
    if not points_of.size:
        return
    z = deviations_in_u(points_of, truth_of)
    tables, kind = cell_labels(name, points_of, truth_of), kind_of_u(points_of)
    steep = kind == STEEP
    chi_square, freedom = np.zeros(z.size), np.zeros(z.size)
    known = np.flatnonzero(~steep)
    for part in _parts(points_of.where(known)):
        at = known[part]
        fitted = with_true_slopes(scatterer, points_of.where(at), reduction.settings.rig)
        effects, fit = _fit(scatterer, fitted, truth_of[at], reduction.settings)
        chi_square[at], freedom[at] = fit.chi_square, fit.expected
        _add_inputs(result, fit)
        if name not in result.angles and (angles := _in_plane_angles(fitted, effects, fit, drawn)) is not None:
            result.angles[name] = angles
    _add_cells(result.cells, tables, kind, (z, chi_square, freedom))
    for k in np.flatnonzero(np.abs(z) > FAR_U)[:MOST_LISTED].tolist():
        place = {key: float(getattr(points_of, key)[k]) for key in ("wavelength_nm", "sigma_deg", "zenith_deg", "azimuth_deg")}
        result.far.append({"sample": name, **place, "kind": str(kind[k]), "deviation_u": float(z[k])})
    for setting in integration_settings(points):
        here = points.where(setting.index)
        weight = quadrature(here, reduction.schedule.symmetry).weight
        used = np.flatnonzero(weight != 0.0)
        total = float(np.sum(weight[used] * truth[setting.index][used]))
        components = components_of_sum(here, weight, reduction.settings)
        variance = math.fsum(each.u**2 for each in components)
        if total > 0.0 and variance > 0.0:
            deviation, u = float(np.sum(weight[used] * here.bsdf[used])) - total, math.sqrt(variance)
            deviate = deviate_of_sum(here.where(used), weight[used], u, deviation, reduction.settings)
            limited = math.fsum(each.u**2 for each in components if each.name in BOUNDS) / variance
            result.reflectances[f"{name}, {setting}"] = (deviation / total, u / total, deviate, limited)


def _parts(points: BsdfPoints) -> Iterator[Any]:
    """Indices of the values that are fitted together."""
    whole = np.arange(points.size)
    parts = [whole] if points.size else []
    for column in (points.wavelength_nm, points.sigma_deg):
        parts = [
            split
            for part in parts
            for split in (
                [part] if part.size <= MOST_FITTED else [part[column[part] == each] for each in np.unique(column[part])]
            )
        ]
    return iter(parts)


def _fit(scatterer: Scatterer, points: BsdfPoints, truth: Floats, settings: ReductionSettings) -> tuple[Effects, Fit]:
    """The effects of all inputs, by the true slopes, and the shared inputs as fitted to the deviations from the truth.

    With the true slopes what is left of the measured ones' errors, times an angle, is no independent error; nor is the second
    order of the fitted angles, which follows from them. What an input adds to a value that is for the most part noise is a
    share of the truth: taken of the value it would follow the noise, and the fit would take noise for the input.
    """
    share = np.where(noisy(points), truth / np.where(points.bsdf == 0.0, 1.0, points.bsdf), 1.0)
    effects = scaled_to_truth(effects_of(points, settings), share)
    # What is left where slopes are too little: the fitted angles have it.
    own = {name: each for name, each in effects.independent.items() if not KINDS.get(name, OTHER).of_angles}
    effects = replace(effects, independent=own)
    residual = relative_residuals(points, truth)
    covariance = ValuesCovariance(effects)
    fit = covariance.fit(residual)
    none = np.zeros(points.size)
    by_slopes = [
        angles(replace(points, slope_along=none + along, slope_across=none + across), settings)
        for along, across in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
    ]
    for _ in range(SECOND_ORDER_STEPS):
        estimate = dict(zip((each.name for each in fit.inputs), fit.estimate.tolist(), strict=True))
        diffuse, *moved = (effect_of(each, estimate) for each in by_slopes)
        along, across = (each - diffuse for each in moved)
        fit = covariance.fit(residual - share * _second_order(scatterer, points, along, across))
    return effects, fit


def scaled_to_truth(effects: Effects, share: Floats) -> Effects:
    """The effects with sensitivities to all inputs but those of ADDED times the `share` (n,) of the truth in the values."""
    groups = [
        each if each.name in ADDED else replace(each, sensitivity=each.sensitivity * share[:, None]) for each in effects.groups
    ]
    dense = []
    for part in effects.dense:
        added = np.array([INDEX.sub("", each.name) in ADDED for each in part.inputs], dtype=bool)
        dense.append(replace(part, sensitivity=part.sensitivity * np.where(added, 1.0, share[:, None])))
    return replace(effects, groups=groups, dense=dense)


def _second_order(scatterer: Scatterer, points: BsdfPoints, along: Floats, across: Floats) -> Floats:
    """What angles (n,), in deg, change in the values (n,) beyond the first order; relative to the truth."""
    change = moved_logarithm(scatterer, points, along, across) - moved_logarithm(scatterer, points, 0.0, 0.0)
    change = np.where(noisy(points), np.expm1(np.minimum(change, 1.0)), change)
    return np.asarray(change - points.slope_along * along - points.slope_across * across)


def effect_of(effects: Effects, inputs: Mapping[str, float]) -> Floats:
    """The relative change (n,) of values by the errors of inputs, by name."""
    total = np.zeros(effects.value.size)
    for part in effects.dense:
        total += part.sensitivity @ np.array([inputs.get(each.name, 0.0) for each in part.inputs])
    for group in effects.groups:
        numbers, place = np.unique(group.member, return_inverse=True)
        error = np.array([inputs.get(group.inputs[k].name, 0.0) if k >= 0 else 0.0 for k in numbers.tolist()])
        total += np.sum(group.sensitivity * error[place.reshape(group.member.shape)], axis=1)
    return total


def cell_labels(name: str, points: BsdfPoints, truth: Floats) -> dict[str, Any]:
    """The label (n,) of each point's cell in each table."""
    decade = decades_below_peak(points, truth)
    edges = np.array([0.0, *ZENITHS_DEG])
    ring = np.clip(np.searchsorted(edges, polar_from_zenith(points.zenith_deg), side="right") - 1, 0, len(ZENITHS_DEG) - 1)
    rings = np.array([f"{low:g} to {high:g} deg" for low, high in itertools.pairwise(edges)])
    clear = np.isfinite(points.slope_along)
    decades = np.array(DECADE_NAMES)[decade]
    plane = np.where(points.in_plane, IN_PLANE, OUT_OF_PLANE)
    in_place = np.array([f"{a}, {b}" for a, b in zip(decades.tolist(), plane.tolist(), strict=True)])
    sides = {each: np.where(points.transmitted == (each == TRANSMITTED), in_place, "") for each in SIDES}
    return {
        "decade": decades,
        **sides,
        "zenith": rings[ring],
        "sigma": np.array([f"{each:g} deg" for each in points.sigma_deg.tolist()]),
        "wavelength": np.array([f"{each:g} nm" for each in points.wavelength_nm.tolist()]),
        "sample": np.full(points.size, name),
        "sample and decade": np.array([f"{name}, {each}" for each in DECADE_NAMES])[decade],
        "slope": np.where(points.flag("steep"), STEEP, np.where(clear, SLOPE, NO_SLOPE)),
    }


def kind_of_u(points: BsdfPoints) -> Any:
    """What the u (n,) of values is for the most part: STEEP by their flag, BOUND, or empty for variances of errors."""
    components = points.components
    bound = total_variance({name: each for name, each in components.items() if name in BOUNDS}) if components else 0.0
    mostly = np.broadcast_to(bound > 0.5 * total_variance(components), points.size)
    return np.where(points.flag("steep"), STEEP, np.where(mostly, BOUND, ""))


def _add_cells(cells: Cells, tables: dict[str, Any], kind: Any, found: tuple[Floats, Floats, Floats]) -> None:
    """Add the sums of values, by their z, chi_square and freedom.

    The steep ones count in the table of slopes, and in those of sides: there each kind of u has its own.
    """
    all_values = np.ones(kind.size, dtype=bool)
    parts = [(table, labels, all_values if table == "slope" else kind != STEEP) for table, labels in tables.items()]
    parts.append(("all", np.full(kind.size, "all"), kind != STEEP))
    parts = [each for each in parts if each[0] not in SIDES]
    parts += [(table_of(side, each), tables[side], kind == each) for side in SIDES for each in ("", BOUND, STEEP)]
    z, chi_square, freedom = found
    for table, labels, chosen in parts:
        for label in np.unique(labels[chosen]).tolist():
            at = (labels == label) & chosen
            if label:
                inside, beyond = (int(np.sum(each)) for each in (np.abs(z[at]) <= COVERAGE, np.abs(z[at]) > FAR_U))
                total, left, expected, square = (float(np.sum(each[at])) for each in (z, chi_square, freedom, z**2))
                cell = Cell(int(at.sum()), inside, total, beyond, left, expected, square)
                cells.setdefault(table, {}).setdefault(label, Cell()).add(cell)


def table_of(side: str, kind: str) -> str:
    """The name of the table of a side with values of one kind of u."""
    return f"{side}, {kind}" if kind else side


def _add_inputs(result: RigResult, fit: Fit) -> None:
    for each, estimate, expected in zip(fit.inputs, fit.estimate.tolist(), fit.expected_variance.tolist(), strict=True):
        kind = INDEX.sub("", each.name)
        square, share = result.inputs.get(kind, (0.0, 0.0))
        result.inputs[kind] = (square + (estimate / each.u) ** 2, share + expected / each.u**2)


def _in_plane_angles(points: BsdfPoints, effects: Effects, fit: Fit, drawn: _DrawnInputs) -> tuple[float, float] | None:
    """The error of the angle in the plane of incidence, deg, as drawn and as fitted; None without a slope there.

    Both from the inputs of pose at the value of that plane that determines the angle best: what they change there over its
    slope.
    """
    own = np.sqrt(np.sum(list(effects.independent.values()), axis=0))
    known = points.in_plane & np.isfinite(points.slope_along) & ~noisy(points)
    slope = np.where(known, np.abs(points.slope_along), 0.0)
    k = int(np.argmax(slope / np.maximum(own, np.finfo(float).tiny)))
    if not slope[k] > 0.0:
        return None
    pairs = [(each, float(part.sensitivity[k, i])) for part in effects.dense for i, each in enumerate(part.inputs)]
    for group in effects.groups:
        of_point = zip(group.member[k].tolist(), group.sensitivity[k].tolist(), strict=True)
        pairs += [(group.inputs[number], sensitivity) for number, sensitivity in of_point if number >= 0]
    errors = [0.0, 0.0]
    for each, sensitivity in pairs:
        if each.unit in ("deg", "mm"):
            errors[0] += sensitivity * drawn.of(each.name)
            errors[1] += sensitivity * fit.of(each.name)
    return errors[0] / float(points.slope_along[k]), errors[1] / float(points.slope_along[k])
