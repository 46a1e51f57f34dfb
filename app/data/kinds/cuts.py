"""Cuts: the plane of incidence over the signed polar angle, a curve for each sigma."""

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
    curve_panel,
    curve_parts,
    distinct,
    quantity,
)
from goniotwin.app.figures.description import Figure, Guide
from goniotwin.app.figures.style import CURVE_COLOURS, CURVE_SYMBOLS


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
