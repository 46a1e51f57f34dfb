"""The uncertainty budget of one value or one reflectance of a journal: its components, with what shares each of them."""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from goniotwin.app.campaign.measurement_model.effects import Component
from goniotwin.app.campaign.measurement_model.quantity import NONE
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.lit_hole import in_one_line
from goniotwin.app.campaign.reduction.points import BsdfPoints, Tally
from goniotwin.app.campaign.reduction.reading_inputs import Numbers
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.studies.reflectance import (
    WIDEST_AZIMUTH_DEG,
    WIDEST_POLAR_DEG,
    Setting,
    components_of_sum,
    integration_settings,
    quadrature,
)
from goniotwin.app.campaign.wording import number_list
from goniotwin.app.errors import UserError
from goniotwin.app.json_document import OPTIONAL_KEY
from goniotwin.arrays import Floats
from goniotwin.keys import MEASURED, STATED
from goniotwin.twin.optics import arc_direction
from goniotwin.twin.optics.geometry.coordinates import round_deg

NEAR_DEG = 0.05
"""A direction further than this from all measured ones is another direction: angles are typed with two decimals or one."""
NEIGHBOURS = 3
ANGLES = ("theta", "phi", "zenith", "azimuth")
NUMBERS = ("wavelength", "sigma", "gamma", *ANGLES, "photodiode")
LIGHTS = ("reflected", "transmitted")
KEYS = ("sample", *NUMBERS, "light")
Unit = Literal["1/sr", "1"]
INDEX = re.compile(r"[\[@].*")
"""What follows the kind of an input in its name: its element, row or mounting."""
INTERPOLATION, FILLED = "interpolation", "directions without a value"


MOST_FREEDOM = 1e6
NOISE, LAMP = "noise", "lamp"
ESTIMATES = {
    NOISE: NOISE,
    "dark": NOISE,
    "etalon_reading": NOISE,
    "signature_reading": NOISE,
    "field_noise": NOISE,
    LAMP: LAMP,
}
"""By component, the estimate of a variance that it is from: what is from one is one input to the degrees of freedom."""
OF_READINGS = ("noise", "field_noise", "ray_tracing")
"""Components without an input that the readings, or the traced rays, themselves show."""


@dataclass(frozen=True)
class Line:
    """A component of a budget: its `origin` (measured, stated, assumed; empty of what follows from others), degrees of freedom.

    `estimate` is common to those that are from one estimate of a variance.
    """

    component: Component
    origin: str
    degrees_of_freedom: float
    estimate: str


def lines_of(components: Iterable[Component], freedom: Mapping[str, float]) -> tuple[Line, ...]:
    """The lines of a budget; `freedom` are the degrees of freedom of the estimates NOISE and LAMP of its value."""
    found = []
    for each in components:
        kind = INDEX.sub("", each.name)
        estimate = ESTIMATES.get(kind, each.name)
        origin = MEASURED if kind in OF_READINGS else STATED if kind == "resolution" else ""
        degrees = freedom.get(estimate, math.inf)
        if each.input is not None:
            origin, degrees = each.input.origin, min(degrees, each.input.degrees_of_freedom)
        found.append(Line(each, origin, degrees, estimate))
    return tuple(found)


def freedom_of(settings: ReductionSettings, points: BsdfPoints) -> dict[str, float]:
    """The degrees of freedom of the estimates that the u of some values are from: the least at the gains that they used.

    Each reading of a value has a dark reading at its gain: of the sample, of both standards, without a sample.
    """
    by_gain, used = settings.noise_freedom, np.union1d(points.gain, points.etalon_gain)
    if (dark := points.grouped.get("dark")) is not None:
        members = dark.member[dark.member != NONE]
        used = np.union1d(used, Numbers.of(settings.rig).gain_of_dark(members))
    return {NOISE: min((by_gain[k] for k in used.tolist() if k >= 0), default=math.inf), LAMP: settings.lamp_freedom}


def effective_degrees_of_freedom(lines: Iterable[Line]) -> float:
    """Those of u by the formula of Welch and Satterthwaite (GUM, G.4): u^4 over the sum of u_i^4 over their own.

    Components from one estimate of a variance are too large or too small together: they are one u_i.
    """
    squares: dict[str, tuple[float, float]] = {}
    for each in lines:
        before, degrees = squares.get(each.estimate, (0.0, math.inf))
        squares[each.estimate] = (before + each.component.u**2, min(degrees, each.degrees_of_freedom))
    total = math.fsum(square for square, _ in squares.values())
    spread = math.fsum(square**2 / degrees for square, degrees in squares.values())
    return total**2 / spread if spread > 0.0 else math.inf


@dataclass(frozen=True)
class ListedComponent:
    """A component as `goniotwin budget` lists it; one that other values share has its input. `share` is that of u^2."""

    name: str
    u: float
    relative_u: float | None
    share: float
    sensitivity: float
    origin: str
    degrees_of_freedom: float | None
    shared_by: str = "no other value"
    input_u: float | None = field(default=None, metadata=OPTIONAL_KEY)
    input_unit: str | None = field(default=None, metadata=OPTIONAL_KEY)
    distribution: str | None = field(default=None, metadata=OPTIONAL_KEY)
    source: str | None = field(default=None, metadata=OPTIONAL_KEY)
    twin: str | None = field(default=None, metadata=OPTIONAL_KEY)


@dataclass(frozen=True)
class BudgetDocument:
    """A budget as `goniotwin budget` lists it; degrees of freedom are None where they are infinite, or as many as that."""

    of: str
    value: float
    u: float
    relative_u: float | None
    unit: Unit
    degrees_of_freedom: float | None
    components: list[ListedComponent]
    about: tuple[str, ...]
    simulated: bool | None = field(default=None, metadata=OPTIONAL_KEY)


@dataclass(frozen=True)
class Budget:
    """A value with its standard uncertainty `u`, both in `unit`, and the lines of its components, the largest first.

    The squares of the components add up to the square of u. `about` are remarks on the value.
    """

    title: str
    value: float
    u: float
    unit: Unit
    lines: tuple[Line, ...]
    about: tuple[str, ...] = ()

    @property
    def components(self) -> tuple[Component, ...]:
        """The components of u."""
        return tuple(each.component for each in self.lines)

    @property
    def degrees_of_freedom(self) -> float:
        """The effective degrees of freedom of u."""
        return effective_degrees_of_freedom(self.lines)

    @property
    def listed(self) -> BudgetDocument:
        """The budget as it is listed."""
        return BudgetDocument(
            of=self.title,
            value=self.value,
            u=self.u,
            relative_u=abs(self.u / self.value) if self.value else None,
            unit=self.unit,
            degrees_of_freedom=finite(self.degrees_of_freedom),
            components=[self._component(each) for each in self.lines],
            about=self.about,
        )

    def _component(self, line: Line) -> ListedComponent:
        each = line.component
        own = ListedComponent(
            name=each.name,
            u=each.u,
            relative_u=abs(each.u / self.value) if self.value else None,
            share=each.u**2 / self.u**2 if self.u else 0.0,
            sensitivity=each.sensitivity,
            origin=line.origin,
            degrees_of_freedom=finite(line.degrees_of_freedom),
        )
        if each.input is None:
            return own
        return replace(
            own,
            shared_by=each.input.shared_by,
            input_u=each.input.u,
            input_unit=each.input.unit,
            distribution=each.input.distribution,
            source=each.input.source,
            twin=each.input.twin,
        )


def parse_place(text: str) -> dict[str, str | float]:
    """The keys and values of `--at sigma=30,zenith=35,azimuth=180`. Raises UserError."""
    place: dict[str, str | float] = {}
    for part in text.split(","):
        key, equals, value = (each.strip() for each in part.partition("="))
        if not equals or key not in KEYS:
            raise UserError(f"--at {part.strip()!r}: write KEY=VALUE, with one of the keys {', '.join(KEYS)}")
        if key in place:
            raise UserError(f"--at {key}: is given twice; remove one of them")
        place[key] = _number(key, value) if key in NUMBERS else value
    if place.get("light", LIGHTS[0]) not in LIGHTS:
        raise UserError(f"--at light={place['light']}: is not {' or '.join(LIGHTS)}")
    return place


def _number(key: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise UserError(f"--at {key}={value}: is not a number")
    return number


def budget_of_value(reduction: Reduction, place: Mapping[str, str | float]) -> Budget:
    """The budget of the value measured at a place (see `parse_place`). Raises UserError where none was measured there."""
    pair = ("theta", "phi") if "theta" in place or "phi" in place else ("zenith", "azimuth")
    if any(key not in place for key in pair):
        raise UserError("--at: a direction is missing; give zenith and azimuth, or theta and phi")
    if both := [key for key in ANGLES if key in place and key not in pair]:
        raise UserError(f"--at {both[0]}: give either theta and phi, or zenith and azimuth")
    name, points = _points_at(reduction, place)
    distance = _distances_deg(points, float(place[pair[0]]), float(place[pair[1]]), pair[0] == "theta")
    order = np.argsort(distance, kind="stable")
    if not order.size or distance[order[0]] > NEAR_DEG:
        raise UserError(
            f"--at: no direction within {NEAR_DEG:g} deg of it was measured; the nearest are {_listed(points, order)}"
        )
    near = points.where(order[distance[order] <= NEAR_DEG])
    chosen = int(np.argmax(near.good))
    point = near.where(np.array([chosen]))
    if not math.isfinite(point.bsdf[0]):
        flags = ", ".join(flag for flag, marked in point.flags.items() if marked[0]) or "none"
        raise UserError(f"--at: this direction has no value; its flags are {flags}")
    about = [] if point.good[0] else [f"the value is flagged: {', '.join(f for f, m in point.flags.items() if m[0])}"]
    if near.size > 1:
        by = ", ".join(str(each) for each in sorted(set(near.photodiode.tolist())))
        about.append(f"{near.size} values are of this direction, by photodiodes {by}; this is the first with a trusted value")
    components = in_one_line(effects_of(point, reduction.settings).budget(0))
    lines = lines_of(components, freedom_of(reduction.settings, point))
    title = (
        f"{name}, {point.wavelength_nm[0]:g} nm, sigma {point.sigma_deg[0]:g}, gamma {point.gamma_deg[0]:g}, "
        f"zenith {point.zenith_deg[0]:g}, azimuth {point.azimuth_deg[0]:g} deg (theta {point.theta_deg[0]:.4g}, phi "
        f"{point.phi_deg[0]:.4g}; photodiode {point.photodiode[0]})"
    )
    return Budget(title, float(point.bsdf[0]), _root_sum(components), "1/sr", lines, tuple(about))


def budget_of_reflectance(reduction: Reduction, place: Mapping[str, str | float]) -> Budget:
    """The budget of the directional-hemispherical reflectance at a place without a direction. Raises UserError."""
    if given := [key for key in (*ANGLES, "photodiode") if key in place]:
        raise UserError(f"--at {given[0]}: a reflectance is of all directions; remove it")
    name, points = _points_at(reduction, place)
    settings = list(integration_settings(points))
    if len(settings) > 1:
        raise UserError(
            f"--at: {'; '.join(map(str, settings[:NEIGHBOURS]))}: choose one of them by sigma, wavelength, gamma, light"
        )
    if not settings:
        raise UserError("--at: no direction has a trusted value there")
    return reflectance(reduction.settings, name, points, settings[0])


def reflectance(settings: ReductionSettings, name: str, points: BsdfPoints, setting: Setting) -> Budget:
    """The reflectance (or transmittance) of one setting of a sample's points, with its budget.

    Raises UserError where the measured directions do not cover the half sphere.
    """
    here = points.where(setting.index)
    rule = quadrature(here, settings.schedule.symmetry)
    if not rule.hemisphere:
        raise UserError(
            f"{name}, {setting}: the measured directions do not cover the half sphere, so there is no reflectance; they may be "
            f"{WIDEST_AZIMUTH_DEG:g} deg apart in azimuth and {WIDEST_POLAR_DEG:g} deg in zenith"
        )
    value = np.where(rule.weight != 0.0, here.bsdf, 0.0)
    of_filled = float(np.sum((rule.obstructed + rule.extrapolated) * np.abs(value)))
    components = [
        *in_one_line(components_of_sum(here, rule.weight, settings)),
        Component(INTERPOLATION, rule.interpolation_error(here.bsdf), 1.0, None),
        # What stands for a direction without a value is between nothing and twice as much: rectangular.
        Component(FILLED, of_filled / math.sqrt(3.0), 1.0, None),
    ]
    components.sort(key=lambda each: -each.u)
    total = float(np.sum(rule.weight * value))
    about: list[str] = []
    if total:
        tally = Tally()
        tally.add(here)
        missing = f" ({tally.missing_in_words})" if tally.missing else ""
        parts = (
            (f"directions without a trusted value{missing}", rule.obstructed),
            ("directions beyond the outermost ring", rule.extrapolated),
        )
        about += [f"{100.0 * abs(np.sum(part * value) / total):.2f} % of it is of {title}" for title, part in parts]
    kind = "transmittance" if setting.transmitted else "reflectance"
    return Budget(
        f"directional-hemispherical {kind} of {name}, {setting}",
        total,
        _root_sum(components),
        "1",
        lines_of(components, freedom_of(settings, here)),
        tuple(about),
    )


def finished_blocks(reduction: Reduction, sample: str) -> Iterator[BsdfPoints]:
    """The points of a sample, finished, block by block: each block has whole settings."""
    overlaps = reduction.overlaps(sample)
    for block in reduction.blocks(sample):
        yield reduction.finish(sample, block.points, overlaps)


def _points_at(reduction: Reduction, place: Mapping[str, str | float]) -> tuple[str, BsdfPoints]:
    """The sample's name and its points at the wavelength, sigma and gamma of a place, all lights if none is given."""
    samples = reduction.schedule.samples
    name = str(place.get("sample", samples[0]))
    if name not in samples or ("sample" not in place and len(samples) > 1):
        known = ", ".join(samples)
        raise UserError(f"--at sample{'=' + name if 'sample' in place else ''}: choose one of the journal's samples: {known}")
    known_at: dict[str, set[float]] = {"wavelength_nm": set(), "sigma_deg": set(), "gamma_deg": set()}
    wanted = {column: float(place[key]) for column in known_at if (key := column.split("_")[0]) in place}
    found: list[BsdfPoints] = []
    for points in finished_blocks(reduction, name):
        chosen = np.ones(points.size, dtype=bool)
        for column, each in known_at.items():
            values = getattr(points, column)
            each.update(np.unique(values).tolist())
            if column in wanted:
                chosen &= np.abs(values - wanted[column]) <= NEAR_DEG
        if chosen.any():
            found.append(points.where(chosen))
    for column, each in known_at.items():
        key, unit = column.split("_")
        listed = ", ".join(f"{value:g}" for value in sorted(each))
        if column in wanted and not any(abs(value - wanted[column]) <= NEAR_DEG for value in each):
            raise UserError(f"--at {key}={wanted[column]:g}: {name} was not measured there, but at {listed or 'none'} {unit}")
        if column not in wanted and len(each) > 1:
            raise UserError(f"--at: {key} is missing; {name} was measured at {listed} {unit}")
    if not found:
        raise UserError(f"--at: {name} has no values there")
    points = BsdfPoints.join(found)
    if "light" in place:
        chosen = points.transmitted == (place["light"] == LIGHTS[1])
        if not chosen.any():
            other = LIGHTS[int(points.transmitted[0])]
            raise UserError(f"--at light={place['light']}: {name} has no such values there, only {other} light")
        points = points.where(chosen)
    if "photodiode" in place:
        chosen = points.photodiode == place["photodiode"]
        if not chosen.any():
            known = number_list(np.unique(points.photodiode).tolist())
            raise UserError(f"--at photodiode={place['photodiode']:g}: {name} has no values of it there, but of {known}")
        points = points.where(chosen)
    return name, points


def _distances_deg(points: BsdfPoints, first: float, second: float, specular: bool) -> Floats:
    """Angles (n,) between the points' directions and one, which is given in specular or in rig coordinates."""
    here = (points.theta_deg, points.phi_deg) if specular else (points.zenith_deg, points.azimuth_deg)
    chord = np.linalg.norm(arc_direction(*here) - arc_direction(first, second), axis=1)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))))


def _listed(points: BsdfPoints, order: np.ndarray) -> str:
    """The first directions of an order, in words."""
    columns = (points.zenith_deg, points.azimuth_deg, points.theta_deg, points.phi_deg)
    rows = round_deg(np.stack(columns, axis=1))[order[: 4 * NEIGHBOURS]].tolist()
    found = dict.fromkeys(f"zenith {z:g}, azimuth {a:g} (theta {theta:.4g}, phi {phi:.4g})" for z, a, theta, phi in rows)
    return "; ".join(list(found)[:NEIGHBOURS]) or "none"


def _root_sum(components: Sequence[Component]) -> float:
    return math.sqrt(math.fsum(each.u**2 for each in components))


def finite(number: float) -> float | None:
    """Degrees of freedom for JSON; None for infinity, and for so many that they are no other."""
    return number if number < MOST_FREEDOM else None
