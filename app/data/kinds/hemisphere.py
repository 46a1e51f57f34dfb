"""The hemisphere: a map of all directions for each sigma and side."""

import math

import numpy as np

from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds.choice import (
    MOST_MAPS,
    around_deg,
    at_sigma,
    figure_of,
    one_channel,
    quantity_of,
    relative_u_text,
    scale_for,
    sides,
    some_of,
)
from goniotwin.app.figures.curves import spread
from goniotwin.app.figures.description import Figure
from goniotwin.app.figures.hemisphere import disc_panel, value_bar
from goniotwin.app.formats.content import FILLED, flagged
from goniotwin.arrays import Flags


def describe(dataset: Dataset, log: bool | None) -> Figure:
    """The description of the maps, which have one bar."""
    dataset = one_channel(dataset)
    bar = value_bar(scale_for(dataset, log), dataset.bsdf[dataset.good], quantity_of(dataset))
    maps = [
        (f"sigma {sigma:g} deg{', transmitted' if transmitted else ''}{', back' if back else ''}", sigma, at_sigma(here, sigma))
        for back, transmitted, here in sides(dataset)
        for sigma in np.unique(here.sigma_deg[here.good]).tolist()
    ]
    panels = [
        disc_panel(
            sigma,
            here.polar_deg,
            around_deg(here),
            here.bsdf,
            here.good,
            bar,
            here.only.values.isotropic,
            f"{title}\n{relative_u_text(here)}{_filled_text(filled)}",
            filled if filled.any() else None,
        )
        for title, sigma, here in (maps[k] for k in spread(len(maps), MOST_MAPS))
        for filled in (np.isfinite(here.bsdf) & flagged(here.flags, {FILLED}),)
    ]
    columns = min(3, len(panels))
    size = 1.2 + 3.4 * columns, 0.9 + 3.6 * math.ceil(len(panels) / columns)
    return figure_of(dataset, panels, size, columns=columns, about=some_of(len(panels), len(maps)))


def _filled_text(filled: Flags) -> str:
    """The share of the nodes (n,) of a table that are filled, in words; empty without any."""
    return f"\n{100.0 * np.mean(filled):.0f} % of nodes filled (dots)" if filled.any() else ""
