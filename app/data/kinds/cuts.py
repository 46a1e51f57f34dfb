"""Cuts: the plane of incidence over the signed polar angle, a curve for each sigma; and another plane, of one light."""

from collections.abc import Sequence
from dataclasses import replace

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
    reasons_of,
    scale_for,
    sides,
    some_of,
)
from goniotwin.app.figures.curves import (
    PLANE_AXIS,
    POSITIVE,
    Curve,
    curve_panel,
    curve_parts,
    distinct,
    quantity,
)
from goniotwin.app.figures.description import Figure, Guide, Panel
from goniotwin.app.figures.style import CURVE_COLOURS, CURVE_SYMBOLS
from goniotwin.arrays import Floats, Ints


def describe(dataset: Dataset, log: bool | None) -> Figure:
    """The description of the cuts, a panel for each side. Raises UserError where no value is near the plane."""
    dataset = one_channel(dataset)
    panels = []
    for back, transmitted, here in sides(dataset):
        plane = in_plane(here)
        scale = scale_for(plane, log)
        there = plane.sigma_deg[plane.good]
        shown = list(distinct(there, MOST_CURVES))
        drawn = [at_sigma(plane, sigma) for sigma in shown]
        styles = list(zip(drawn, shown, CURVE_COLOURS, CURVE_SYMBOLS, strict=False))
        panels.append(
            curve_panel(
                [
                    curve_parts(curve(each, abscissa(each)), scale, colour, f"sigma {sigma:g} deg", symbol)
                    for each, sigma, colour, symbol in styles
                ],
                scale,
                PLANE_AXIS,
                quantity(transmitted, back),
                legend=about_curves(drawn, scale, some_of(len(shown), len(list(distinct(there, there.size))))),
                reasons=reasons_of(drawn),
                guides=tuple(Guide(sigma, colour) for _, sigma, colour, _ in styles),
            )
        )
    return figure_of(dataset, panels, (8.0, 1.0 + 3.8 * len(panels)))


def describe_plane(
    dataset: Dataset, index: Ints, x: Floats, plane_deg: float, others: Sequence[tuple[str, Curve]] = ()
) -> Panel:
    """The panel of one light in a plane: its values by `index` over `x` (m,), as `cut_of_plane` has them.

    `others` are curves with their names, beside it.
    """
    here = dataset.where(index)
    scale, axis = scale_for(here, None), PLANE_AXIS
    if plane_deg:
        axis = replace(axis, label=f"polar angle in the plane at {plane_deg:.4g} deg from the light, deg; {POSITIVE}")
    parts = [curve_parts(curve(here, x), scale, "points", "measured" if others else "", "circle")]
    parts += [curve_parts(each, scale, "predicted", name, line="dashed") for name, each in others]
    light = here.only.lights[0]
    guides = () if plane_deg else (Guide(light.sigma_deg, "points"),)
    of, about = quantity(light.transmitted, light.back), about_curves([here], scale)
    return curve_panel(parts, scale, axis, of, legend=about, reasons=reasons_of([here]), guides=guides)
