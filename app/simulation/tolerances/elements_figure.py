"""The figure of a study's elements and their deviations, from the twin's own geometry (paper, figures 9 and 11).

A study of the flux shows the illumination unit, one of a lobe mirrors, sample and arc. Each deviation is an arrow in its
positive sense: an angle about its axis, a shift along it. Dimensions are to scale, the arrows are not.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from goniotwin.app.figures.style import CURVE_COLOURS, LINE_WIDTH, PAPER
from goniotwin.app.simulation.files import write_figure
from goniotwin.app.simulation.tolerances.result import StudyResult
from goniotwin.app.simulation.tolerances.study import BEAM, FluxTable, Parameter
from goniotwin.arrays import Floats
from goniotwin.twin.optics import IlluminationUnit, Instrument, SampleFrames
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, arc_direction
from goniotwin.twin.optics.geometry.mirrors import mirrors_at

DOTS_PER_INCH = 130
ROUND_DEG, PART_DEG = 290.0, 22.0
"""Angle of an arrow round its axis, and of one at a long radius, beside the arc."""
LONGEST_MM = 65.0
"""Longest arrow of a shift."""
AXES = ("x", "y", "z")
COLOURS = dict(zip(AXES, CURVE_COLOURS, strict=False))


@dataclass(frozen=True, eq=False)
class Element:
    """An element as it is drawn: outlines (n, 3) in mm, its reference point (3,) and axes (3, 3), rows x, y, z.

    Arrows of angles have `radius_mm` and are about the direction `start` (3,); without one they go round the axis. Those of
    shifts begin at `place` (3,), by default the reference point. `label` is the place of its name from there, in the picture.
    """

    title: str
    outlines: tuple[Floats, ...]
    reference: Floats
    axes: Floats
    radius_mm: float
    label: tuple[float, float]
    start: Floats | None = None
    place: Floats | None = None


@dataclass(frozen=True, eq=False)
class View:
    """A parallel projection of points in mm: unit vectors (3,) to the right and up."""

    right: Floats
    up: Floats

    def of(self, points: Floats) -> Floats:
        """Places (..., 2) of points (..., 3)."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


def view_from(azimuth_deg: float, elevation_deg: float) -> View:
    """The view from a direction: azimuth from x towards y, elevation above the plane of x and y."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    right = np.array([-math.sin(a), math.cos(a), 0.0])
    towards = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
    return View(right, np.cross(towards, right))


def arrow(element: Element, name: str) -> Floats:
    """The line (n, 3) of a deviation's arrow, in its positive sense; `name` is rx, ry, rz, x, y or z."""
    axis = element.axes[AXES.index(name[-1])]
    if len(name) == 1:
        origin = element.reference if element.place is None else element.place
        return np.stack([origin, origin + min(1.5 * element.radius_mm, LONGEST_MM) * axis])
    other = element.axes[(AXES.index(name[-1]) + 1) % 3] if element.start is None else element.start
    first = other - axis * (axis @ other)
    if np.linalg.norm(first) < 0.1:  # the start is on the axis itself
        first = element.axes[(AXES.index(name[-1]) + 1) % 3]
    first = first / np.linalg.norm(first)
    span = ROUND_DEG if element.start is None else PART_DEG
    angle = np.radians(np.linspace(-0.5 * span, 0.5 * span, 61))[:, None]
    # The own axes of mirrors 1 and 2 are left-handed: there a positive angle is the other way round.
    second = np.sign(np.linalg.det(element.axes)) * np.cross(axis, first)
    turned = np.cos(angle) * first + np.sin(angle) * second
    return np.asarray(element.reference + element.radius_mm * turned)


def rectangle(centre: Floats, u: Floats, v: Floats) -> Floats:
    """The outline (5, 3) of a rectangle with half sides u and v."""
    return np.array([centre + s * u + t * v for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))])


def circle(centre: Floats, u: Floats, v: Floats, radius: float) -> Floats:
    """The outline (n, 3) of a circle in the plane of the unit vectors u and v."""
    angle = np.linspace(0.0, 2.0 * np.pi, 73)[:, None]
    return np.asarray(centre + radius * (np.cos(angle) * u + np.sin(angle) * v))


def illumination_elements(unit: IlluminationUnit) -> dict[str, Element]:
    """The elements of the illumination unit along its axis y; the whole unit turns about the exit pupil."""
    frames = unit.frames
    x, y, z = np.eye(3)
    lamp, reflector, lens, slit, output = frames[:, 0]
    angles = np.radians(np.linspace(-unit.reflector_half_angle_deg, unit.reflector_half_angle_deg, 49))[:, None]
    bowl = [lamp + unit.reflector_radius_mm * (-np.cos(angles) * y + np.sin(angles) * across) for across in (x, z)]
    half = unit.arc_radius_mm, 0.5 * unit.arc_length_mm
    width, height = (0.5 * each for each in unit.opening_mm)
    screen = 12.0
    outlines: dict[str, tuple[Floats, ...]] = {
        "arc": (rectangle(lamp, half[0] * x, half[1] * z),),
        "reflector": tuple(bowl),
        "input_condenser": (circle(lens, x, z, unit.input_condenser_radius_mm),),
        "slit": (rectangle(slit, width * x, height * z), rectangle(slit, screen * x, screen * z)),
        "output_condenser": (circle(output, x, z, unit.exit_pupil_radius_mm),),
        "unit": (rectangle(0.5 * (output + reflector), 0.55 * (output - reflector), 62.0 * z),),
    }
    labels = {
        "arc": (0.0, -88.0),
        "reflector": (-14.0, 76.0),
        "input_condenser": (0.0, 76.0),
        "slit": (-20.0, -82.0),
        "output_condenser": (0.0, 76.0),
        "unit": (74.0, -46.0),
    }
    places = [*frames, frames[4]]
    radii = {"arc": 11.0, "unit": 30.0}
    return {
        name: Element(name, lines, frame[0], frame[1:], radii.get(name, 18.0), labels[name])
        for (name, lines), frame in zip(outlines.items(), places, strict=True)
    }


def instrument_elements(instrument: Instrument, sigma_deg: float) -> dict[str, Element]:
    """Mirrors, sample, arc and beam of an instrument with the mirror unit at sigma; angles of mirrors are about their sides."""
    mirrors, half = mirrors_at(instrument, sigma_deg), 0.5 * instrument.mirror_side_mm
    labels = ((0.0, -95.0), (-85.0, -22.0), (40.0, 62.0))
    found = {}
    for k in range(3):
        centre, u, v = mirrors.centres[k], mirrors.axes_u[k], mirrors.axes_v[k]
        axes = np.stack([u, v, mirrors.normals[k]])
        outline = rectangle(centre, half * u, half * v)
        found[f"mirror_{k + 1}"] = Element(f"mirror {k + 1}", (outline,), centre, axes, 30.0, labels[k])
    frame, origin = np.eye(3), np.zeros(3)
    sample = 0.5 * SampleFrames().side_mm
    spot = 0.5 * instrument.spot_side_mm
    squares = tuple(rectangle(origin, each * frame[0], each * frame[1]) for each in (sample, spot))
    found["sample"] = Element("sample", squares, origin, frame, 45.0, (60.0, -75.0))
    polar = np.linspace(0.0, 90.0, 91)
    line = instrument.arc_radius_mm * arc_direction(polar, SPECULAR_AZIMUTH_DEG)
    diodes = []
    for each in np.arange(0.0, 86.0, 5.0):
        d = arc_direction(each, SPECULAR_AZIMUTH_DEG)
        along = np.cross(frame[1], d)
        diodes.append(circle(instrument.arc_radius_mm * d, along, frame[1], 0.5 * instrument.detector_diameter_mm))
    middle = arc_direction(45.0, SPECULAR_AZIMUTH_DEG)
    found["arc"] = Element(
        "arc",
        (line, *diodes),
        origin,
        frame,
        instrument.arc_radius_mm + 22.0,
        (-60.0, 30.0),
        start=middle,
        place=instrument.arc_radius_mm * middle,
    )
    pupil = np.array([0.0, -instrument.mirror_distance_mm - instrument.pupil_to_mirror_mm, 0.0])
    disc = circle(pupil, frame[0], frame[2], instrument.pupil_radius_mm)
    found[BEAM] = Element("beam", (disc,), pupil, frame, 30.0, (0.0, -75.0))
    return found


def light_path(instrument: Instrument, sigma_deg: float) -> Floats:
    """The axis of the light (5, 3), mm: exit pupil, mirrors 1 to 3, sample."""
    pupil = [0.0, -instrument.mirror_distance_mm - instrument.pupil_to_mirror_mm, 0.0]
    return np.array([pupil, *mirrors_at(instrument, sigma_deg).centres, [0.0, 0.0, 0.0]])


def write_elements(result: StudyResult, path: Path) -> None:
    """Write the figure of the study's elements as PNG. Raises UserError."""
    criterion = result.study.criterion
    parameters = list({each.title: each for case in result.cases for each in case.parameters}.values())
    if isinstance(criterion, FluxTable):
        unit = IlluminationUnit()
        elements, view = illumination_elements(unit), view_from(20.0, 14.0)
        light = np.array([unit.frames[0, 0], [0.0, 70.0, 0.0]])
        size = (13.0, 5.4)
    else:
        sigma, instrument = criterion.sigma_deg[0], result.study.instrument.instrument()
        elements, view = instrument_elements(instrument, sigma), view_from(-35.0, 24.0)
        light, size = light_path(instrument, sigma), (12.0, 8.0)
    with mpl.rc_context({"font.size": 10.0}):
        figure = Figure(figsize=size, layout="constrained", facecolor=PAPER.base)
        axes = figure.subplots()
        _draw(axes, elements, view, light, parameters)
        figure.suptitle(f"SIMULATED: {result.study.name}: elements and deviations", color=PAPER.bad, weight="bold", fontsize=12)
        handles = [
            *(Line2D([], [], color=COLOURS[each], label=f"turn about {each} or shift along it, own axes") for each in AXES),
            Line2D([], [], color=PAPER.blocked, ls="--", label="axis of the light"),
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    write_figure(figure, path, DOTS_PER_INCH)


def _draw(axes: Axes, elements: dict[str, Element], view: View, light: Floats, parameters: Sequence[Parameter]) -> None:
    axes.set_aspect("equal")
    axes.axis("off")
    axes.plot(*view.of(light).T, color=PAPER.blocked, lw=LINE_WIDTH, ls="--")
    for name, element in elements.items():
        own = [each for each in parameters if each.element == name]
        colour = PAPER.text if own else PAPER.line
        for line in element.outlines:
            axes.plot(*view.of(line).T, color=colour, lw=0.8 if name == "unit" else 1.4)
        for each in own:
            _draw_arrow(axes, view.of(arrow(element, each.name)), each.name)
        if own:
            anchor = element.reference if element.place is None else element.place
            x, y = view.of(anchor) + np.array(element.label)
            axes.text(x, y, _describe(element.title, own), ha="center", va="center", fontsize=8.5, color=PAPER.text)
    axes.margins(0.08, 0.12)


def _draw_arrow(axes: Axes, line: Floats, name: str) -> None:
    colour = COLOURS[name[-1]]
    axes.plot(*line.T, color=colour, lw=1.2)
    axes.annotate(
        "", line[-1], line[-2], arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    )


def _describe(title: str, own: Sequence[Parameter]) -> str:
    """An element's name with its deviations and their limits, one line for each unit."""
    lines = [title.replace("_", " ")]
    for unit in ("deg", "mm"):
        limits = {each.limit for each in own if each.unit == unit}
        for limit in sorted(limits):
            names = " ".join(each.name for each in own if each.unit == unit and each.limit == limit)
            lines.append(f"{names}  +-{limit:g} {unit}")
    return "\n".join(lines)
