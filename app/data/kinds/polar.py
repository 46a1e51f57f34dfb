"""The polar diagram: the plane of incidence with the value as the radius; the light comes from above."""

from dataclasses import replace

import numpy as np

from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds.choice import (
    MOST_CURVES,
    about_curves,
    abscissa,
    at_sigma,
    curve,
    figure_of,
    in_plane,
    one_channel,
    quantity_of,
    scale_for,
    sides,
    some_of,
)
from goniotwin.app.figures.curves import curve_parts, distinct, key_of
from goniotwin.app.figures.description import Arrow, Axis, Figure, Panel
from goniotwin.app.figures.scale import ROOM
from goniotwin.app.figures.style import CURVE_COLOURS
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG


def describe(dataset: Dataset, log: bool | None) -> Figure:
    """The description of the diagram: one panel for all sides. Raises UserError where no value is near the plane."""
    plane = in_plane(one_channel(dataset))
    there = plane.sigma_deg[plane.good]
    shown = list(distinct(there, MOST_CURVES))
    plane = plane.where(np.isin(np.round(plane.sigma_deg, 6), shown))
    scale = scale_for(plane, log)
    through = bool((plane.transmitted & plane.good).any())
    series, dots, named = [], [], set()
    arrows: dict[float, Arrow] = {}
    for sigma, colour in zip(shown, CURVE_COLOURS, strict=False):
        for back, transmitted, here in sides(at_sigma(plane, sigma)):
            name = "" if (back, sigma) in named else f"sigma {sigma:g} deg{' on the back' if back else ''}"
            named.add((back, sigma))
            line, marks = curve_parts(
                curve(here, abscissa(here)), scale, colour, name, "circle", line="dashed" if back else "solid"
            )
            assert line.lower is not None
            assert line.upper is not None
            series.append(
                replace(
                    line,
                    x=_angle(line.x, transmitted),
                    y=scale.radius(line.y),
                    lower=scale.radius(line.lower),
                    upper=scale.radius(line.upper),
                )
            )
            dots += [
                replace(each, x=_angle(each.x, transmitted), y=scale.radius(each.y)) for each in marks if each.kind == "lost"
            ]
            arrows.setdefault(sigma, Arrow(-sigma, colour))
    around = range(0, 360, 30)
    own = [each if each <= 90 else 180 - each if each < 270 else each - 360 for each in around]
    panel = Panel(
        y=Axis(limits=(0.0, ROOM * float(scale.radius(np.array([scale.top]))[0]) or 1.0)),
        scale=scale,
        projection="polar",
        series=tuple(series),
        marks=tuple(dots),
        key=key_of(dots),
        arrows=tuple(arrows.values()),
        angles=tuple((float(at), f"{each}°") for at, each in zip(around, own, strict=True)) if through else (),
    )
    some = some_of(len(shown), len(list(distinct(there, there.size))))
    about = about_curves([plane], scale, some)
    legend = f"{quantity_of(plane)}; {'transmitted light below; ' if through else ''}arrows: the light; {about}"
    return figure_of(plane, [panel], (7.5, 8.0 if through else 4.9), legend=legend)


def _angle(x_deg: Floats, transmitted: bool) -> Floats:
    """The angle of a polar panel, radians; transmitted light is below."""
    return np.radians(HALF_TURN_DEG - x_deg if transmitted else x_deg)
