"""Templates of schedules: a complete schedule for a rig from a purpose, a target of u and a longest machine time.

A template states incidences, and directions by name or whole planes and hemispheres; its steps go from fine to coarse. The
schedule has the finest steps whose estimated duration is within the longest time. Directions that the rig does not reach are
replaced by the nearest one, with a note. Signed polar angles are positive on the side of the specular direction.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from goniotwin.app.campaign.geometry.arcs import etalon_sigma_deg, far_arc, lit_arc, polar_deg
from goniotwin.app.campaign.geometry.directions import Arc, zenith_deg
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.planning.poses import overlapping_step_deg
from goniotwin.app.campaign.schedule.editing import literal
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.schedule.grids import evenly_spaced
from goniotwin.app.campaign.schedule.standard_geometries import ASPECULAR, COLOUR, GLOSS, StandardGeometry
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.errors import UserError, printable
from goniotwin.app.rig import RigDescription
from goniotwin.drivers.motion import within_limits
from goniotwin.twin.optics.geometry.coordinates import (
    HALF_TURN_DEG,
    SPECULAR_AZIMUTH_DEG,
    TOLERANCE_DEG,
    TURN_DEG,
    polar_and_azimuth,
    round_deg,
)

SPECTRUM_NM, ONE_NM = tuple(range(400, 701, 20)), (550,)
USUAL_U, USUAL_H, USUAL_ETALON = 0.01, 4.0, "etalon"
"""What a person is offered: target of u (k = 1, relative), longest machine time in h, and reference standard."""
NOISE_SHARE = 3.0
"""The target over the noise of a row: so large a noise adds 5 % to an uncertainty that is otherwise as large as the target."""
USUAL_SIGMA_DEG = 30.0
"""The drift checks are at the incidence next to this one: the photodiodes have light, and the mirror unit blocks few."""


@dataclass(frozen=True)
class Steps:
    """Steps of a template.

    `beta_deg`, `gamma_deg` are steps over the whole range, 0 for the values of the template. `shifts` is the number of shifts
    from one photodiode to the next. Near the specular direction these are `near_shifts`, 0 for none, and `near_beta_deg`.
    `longest_s` limits the averaging.
    """

    beta_deg: float = 0.0
    shifts: int = 1
    near_shifts: int = 0
    near_beta_deg: float = 1.0
    gamma_deg: float = 0.0
    repeats: int = 1
    longest_s: float = 2.0


@dataclass(frozen=True)
class Template:
    """A purpose: `title` states it.

    `views` are the signed polar angles of the named directions by incidence; without them all directions of `beta_deg` are
    measured. `steps` are from fine to coarse. `near_deg`: radius of finer steps about the specular direction.
    """

    title: str
    sigma_deg: tuple[float, ...]
    steps: tuple[Steps, ...]
    views: dict[float, tuple[float, ...]] | None = None
    wavelength_nm: tuple[int, ...] = ONE_NM
    beta_deg: tuple[float, ...] = (0.0, SPECULAR_AZIMUTH_DEG)
    light: str = "reflected"
    symmetry: str = "isotropic"
    near_deg: float = 10.0


def _views(geometries: Sequence[StandardGeometry]) -> dict[float, tuple[float, ...]]:
    """The signed polar angles of geometries, by incidence."""
    views: dict[float, tuple[float, ...]] = {}
    for each in geometries:
        views[each.sigma_deg] = (*views.get(each.sigma_deg, ()), each.sigma_deg - each.aspecular_deg)
    return views


SINGLE = (Steps(repeats=3, longest_s=10.0), Steps(longest_s=10.0), Steps(), Steps(longest_s=0.5))
HEMISPHERE = (
    Steps(2.0, 5, 10),
    Steps(5.0, 5, 10),
    Steps(5.0, 2, 10),
    Steps(10.0, 2, 5, 2.0),
    Steps(10.0, 1, 5, 2.0),
    Steps(10.0, 1, 2, 5.0),
    Steps(10.0, longest_s=1.0),
    Steps(15.0, longest_s=1.0),
    Steps(30.0, longest_s=0.5),
)
TEMPLATES = {
    "45:0": Template(
        "Colour of a matt sample: light at 45 deg seen from the normal (45:0), and light at the normal seen at 45 deg (0:45)",
        (0.0, 45.0),
        SINGLE,
        _views(COLOUR),
        SPECTRUM_NM,
        (90.0, SPECULAR_AZIMUTH_DEG),
    ),
    "aspecular": Template(
        f"Colour of an effect coating, in {len(ASPECULAR)} aspecular directions at an incidence of 45 deg",
        (45.0,),
        SINGLE,
        _views(ASPECULAR),
        SPECTRUM_NM,
    ),
    "plane": Template(
        "The plane of incidence at five incidences",
        (15.0, 30.0, 45.0, 60.0, 75.0),
        (Steps(shifts=10, longest_s=5.0), Steps(shifts=10), Steps(shifts=5), Steps(shifts=2), Steps(), Steps(longest_s=0.5)),
    ),
    "isotropic": Template(
        "All directions of reflected light, of a sample without a preferred direction",
        (0.0, 15.0, 30.0, 45.0, 60.0, 75.0),
        HEMISPHERE,
    ),
    "anisotropic": Template(
        "All directions of reflected light, of a sample that looks different when it is turned about its normal",
        (20.0, 40.0, 60.0),
        (
            Steps(5.0, 1, 10, 1.0, 10.0),
            Steps(5.0, 1, 10, 2.5, 15.0),
            Steps(10.0, 1, 5, 2.5, 15.0),
            Steps(10.0, 1, 5, 2.5, 30.0),
            Steps(10.0, gamma_deg=30.0),
            Steps(15.0, gamma_deg=30.0, longest_s=1.0),
            Steps(15.0, gamma_deg=45.0, longest_s=0.5),
            Steps(30.0, gamma_deg=90.0, longest_s=0.5),
        ),
        symmetry="anisotropic",
    ),
    "transmitted": Template(
        "All directions of transmitted light, of a diffusing sample. The reference standard has to be white on both sides",
        (0.0, 20.0, 40.0, 60.0),
        HEMISPHERE,
        light="transmitted",
    ),
    "gloss": Template(
        "Specular directions of gloss measurement (20, 60 and 85 deg), with their surroundings",
        tuple(each.sigma_deg for each in GLOSS),
        (
            Steps(20.0, 1, 10, 1.0, longest_s=5.0),
            Steps(20.0, 1, 10, 2.0),
            Steps(20.0, 1, 5, 2.0),
            Steps(20.0),
            Steps(20.0, longest_s=0.5),
        ),
        _views(GLOSS),
        beta_deg=(160.0, SPECULAR_AZIMUTH_DEG),
        near_deg=6.0,
    ),
}


@dataclass(frozen=True)
class MadeSchedule:
    """The text of a schedule from a template, its plan, and notes on what the rig or the time does not allow."""

    text: str
    plan: NewPlan
    notes: tuple[str, ...]


def choose_template(name: str) -> Template:
    """The template of a name. Raises UserError for a name that there is not."""
    if name not in TEMPLATES:
        raise UserError(f"template {name!r}: there is none of this name; choose one of {', '.join(TEMPLATES)}")
    return TEMPLATES[name]


def make_schedule(
    template: str, rig: RigDescription, name: str, sample: str, etalon: str, relative_u: float, longest_h: float
) -> MadeSchedule:
    """The schedule of a template for a rig, with the finest steps that the longest time allows.

    `name` is that of its file, for errors. Raises UserError for what the rig cannot do.
    """
    chosen = choose_template(template)
    if not 0.0 < relative_u < 1.0 or not 0.0 < longest_h < math.inf:
        raise UserError(
            f"{name}: a target u of {relative_u:g} within {longest_h:g} h: u is from 0 to 1, such as 0.01 for 1 %, and the "
            "longest time is above 0; correct them"
        )
    geometry = _Geometry(chosen, rig)
    for steps in chosen.steps:
        values: dict[str, object] = {"name": f"{sample}, {template}", "samples": [sample], "etalon": etalon}
        text = _text(geometry, steps, values, relative_u, longest_h)
        plan = make_plan(parse_schedule(text, name), rig)
        over_s = plan.seconds - 3600.0 * longest_h
        if over_s <= 0.0:
            break
    notes = geometry.notes
    if over_s > 0.0:
        notes = (*notes, f"Even with the coarsest steps it takes {duration_text(over_s)} more than {longest_h:g} h.")
    made = f"From a template for {rig.file.name}, u of {100.0 * relative_u:g} % and at most {longest_h:g} h."
    heading = "".join(f"# {printable(each)}\n" for each in (f"{chosen.title}.", made, *notes))
    return MadeSchedule(heading + text, plan, notes)


class _Geometry:
    """What a rig can do of a template: incidences, shifts of the named directions, and notes on the rest.

    Raises UserError for a rig that has nothing of it.
    """

    def __init__(self, template: Template, description: RigDescription) -> None:
        rig = description.file
        self.template, self.rig = template, rig
        self.arc: Arc = lit_arc(0.0) if template.light == "reflected" else far_arc(0.0)
        self.polar = polar_deg(rig, self.arc)
        self.sigmas = [each for each in template.sigma_deg if within_limits(rig.axes.sigma, each)]
        mono = rig.monochromator
        self.wavelengths = [each for each in template.wavelength_nm if mono.lowest_nm <= each <= mono.highest_nm]
        self.spacing_deg = min((b - a for a, b in pairwise(sorted(self.polar))), default=0.0)
        lacking = {
            "photodiodes on the arc that sees this light": self.polar,
            "sigma of it within the limits of the axis": self.sigmas,
            "beta of it within the limits of the axis": self.betas(0.0),
            "shift 0 within the limits of the axis": self.shift_grid(1),
            "wavelength of it within the range of the monochromator": self.wavelengths,
        }
        for what, found in lacking.items():
            if not found:
                raise UserError(f"{description.name}: has no {what}; choose another template or another rig")
        views = [(sigma, each) for sigma in self.sigmas for each in (template.views or {}).get(sigma, ())]
        reached = [self._nearest(each) for _, each in views]
        self.shifts = sorted({shift for shift, _ in reached}, key=lambda each: (abs(each), each)) or [0.0]
        self.notes = (*self._omitted(), *self._looks_elsewhere(views, [polar for _, polar in reached]))

    def _omitted(self) -> Iterator[str]:
        template = self.template
        betas = (0.0, HALF_TURN_DEG, 330.0) if template.symmetry == "anisotropic" else template.beta_deg
        for axis, asked in (("sigma", template.sigma_deg), ("beta", betas)):
            for each in asked:
                if not within_limits(getattr(self.rig.axes, axis), each):
                    yield f"Omitted: {axis} {each:g} deg, beyond the limits of the axis."
        if beyond := len(template.wavelength_nm) - len(self.wavelengths):
            yield f"Omitted: {beyond} wavelengths beyond the range of the monochromator."

    def _looks_elsewhere(self, views: list[tuple[float, float]], reached: list[float]) -> Iterator[str]:
        """Notes on named directions that no photodiode reaches, or that the mirror unit blocks."""
        for (sigma, wanted), polar in zip(views, reached, strict=True):
            if abs(polar - wanted) > TOLERANCE_DEG:
                yield f"At sigma {sigma:g} deg no photodiode looks {wanted:g} deg from the normal. The nearest: {polar:g} deg."
            zenith, azimuth = polar_and_azimuth([polar], SPECULAR_AZIMUTH_DEG)
            if blocked_by_mirrors(self.rig, sigma, zenith_deg(zenith, self.arc), azimuth)[0]:
                yield f"At sigma {sigma:g} deg the mirror unit blocks the direction {polar:g} deg from the normal."

    def _nearest(self, wanted: float) -> tuple[float, float]:
        """The shift with which a photodiode looks nearest to a signed polar angle, and the angle that it has then."""
        axis, sign = self.rig.axes.shift, -1.0 if wanted < 0.0 else 1.0
        shifts = [float(round_deg(np.clip(abs(wanted) - each, axis.lower_deg, axis.upper_deg))) for each in self.polar]
        reached = [float(round_deg(each + shift)) for each, shift in zip(self.polar, shifts, strict=True)]
        best = min(range(len(shifts)), key=lambda k: (round(abs(reached[k] - abs(wanted)), 6), abs(shifts[k])))
        return shifts[best], sign * reached[best]

    def betas(self, step_deg: float) -> list[float]:
        """Betas of all directions with a step, or those of the template."""
        first, last = (min(self.template.beta_deg), max(self.template.beta_deg))
        if self.template.symmetry == "anisotropic":
            first, last = 0.0, TURN_DEG - step_deg
        every = (
            evenly_spaced(first, step_deg, round((last - first) / step_deg)).tolist() if step_deg else self.template.beta_deg
        )
        return [each for each in every if within_limits(self.rig.axes.beta, each)]

    def shift_grid(self, parts: int) -> list[float]:
        """Shifts from one photodiode to the next in parts, as far as the axis reaches."""
        every = evenly_spaced(0.0, self.spacing_deg / parts, parts - 1).tolist()
        return [each for each in dict.fromkeys(every) if within_limits(self.rig.axes.shift, each)]


def _text(geometry: _Geometry, steps: Steps, values: Mapping[str, object], relative_u: float, longest_h: float) -> str:
    """A schedule with the steps of a template."""
    template, rig = geometry.template, geometry.rig
    betas = geometry.betas(steps.beta_deg)
    shifts = geometry.shifts if template.views else geometry.shift_grid(steps.shifts)
    gammas = evenly_spaced(0.0, steps.gamma_deg, round(TURN_DEG / steps.gamma_deg) - 1).tolist() if steps.gamma_deg else [0.0]
    sigma = min(geometry.sigmas, key=lambda each: abs(each - USUAL_SIGMA_DEG))
    lines = [
        *(f"{key} = {literal(value)}" for key, value in values.items()),
        f"light = {literal(template.light)}",
        f"symmetry = {literal(template.symmetry)}",
        "",
        f"sigma_deg = {_grid(geometry.sigmas)}  # incidence, from the normal",
        f"gamma_deg = {_grid([each for each in gammas if within_limits(rig.axes.gamma, each)])}  # rotation of the sample",
        f"beta_deg = {_grid(betas)}  # azimuth of the arc: the specular direction is at 180, the light at 0",
        f"shift_deg = {_grid(shifts)}  # of the arc, added to the angle of each photodiode",
        f"wavelength_nm = {_grid(geometry.wavelengths)}",
        "",
        'gains_v_per_a = "automatic"  # from the highest gain down, until no photodiode is saturated',
        "dark_every_s = 120",
        *([f"repeats = {steps.repeats}"] if steps.repeats > 1 else []),
        "",
        "[averaging]  # each row is read until its noise is a third of the target",
        f"relative_uncertainty = {float(f'{relative_u / NOISE_SHARE:.2g}'):g}",
        f"longest_s = {steps.longest_s:g}",
        "",
        "[drift]  # the same pose again, to find changes of the lamp and of the photodiodes",
        "every_s = 600",
        f"sigma_deg = {literal(etalon_sigma_deg(sigma, geometry.arc))}",
        f"beta_deg = {literal(betas[-1] if SPECULAR_AZIMUTH_DEG not in betas else SPECULAR_AZIMUTH_DEG)}",
        f"shift_deg = {literal(shifts[0])}",
        f"wavelength_nm = {literal(geometry.wavelengths[len(geometry.wavelengths) // 2])}",
        "",
        "[target]  # what is asked for: check and rehearse compare with it",
        f"relative_u = {literal(relative_u)}  # standard uncertainty (k = 1)",
        f"longest_h = {literal(longest_h)}",
    ]
    if steps.near_shifts:
        lines += [
            "",
            "[near_specular]  # finer where a narrow lobe is",
            f"within_deg = {literal(template.near_deg)}",
            f"shift_deg = {_grid(geometry.shift_grid(steps.near_shifts))}",
            f"beta_step_deg = {literal(steps.near_beta_deg)}",
        ]
    if not template.views and overlapping_step_deg(rig, shifts[0]) is not None:
        lines += ["", "[overlap]  # photodiodes where their neighbours look", "points = 1"]
    return "\n".join([*lines, ""])


def _grid(values: Sequence[float]) -> str:
    """Values as a list, or as a range where they are evenly spaced."""
    steps = {float(round_deg(b - a)) for a, b in pairwise(values)}
    if len(values) > 3 and len(steps) == 1:
        return literal({"start": values[0], "stop": values[-1], "step": steps.pop()})
    return literal(list(values))
