"""The map of a hemisphere, seen along the normal: places of directions, colours of values, rings, light and specular direction.

The light comes from the left and the specular direction is on the right, as in a cut positive angles are; azimuths are
counter-clockwise. The disc has a dark ground of its own, on paper and in both schemes of the window: each colour of a value has
a contrast of at least 3 to 1 to it, and is the same everywhere.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

from goniotwin.app.figures.description import Bar, ColourMap, Map, Marks, Panel, Series
from goniotwin.app.figures.scale import Scale, bar_ticks
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG

HORIZON_DEG, EDGE_DEG = 90.0, 96.0
"""Radius of the disc, and half the side of the panel."""
RINGS_DEG = (30.0, 60.0, 90.0)
ON_AXIS = 1e-6
"""Sine of the azimuth of a direction in the plane of incidence, at most."""
WIDEST_DEG, GAPS = 12.0, 1.5
"""A map has no colour between directions further apart than so many degrees, and than so many times most neighbours are."""
MAPS: dict[ColourMap, tuple[str, float, float]] = {
    "values": ("bids:viridis", 0.36, 1.0),
    "deviations": ("colorbrewer:RdBu_r", 0.13, 0.87),
}
"""Maps ordered by lightness, with the part whose contrast to the ground of the disc is at least 3 to 1."""
LEVELS, PIXELS = 254, 400
"""Colours of a map, and the side of its image in the window."""


@cache
def colour_table(colours: ColourMap) -> npt.NDArray[np.uint8]:
    """The colours of a map as red, green and blue (LEVELS, 3), from low to high."""
    # Loads 78 modules: 0.07 s, which descriptions without a map do without.
    from cmap import Colormap

    name, low, high = MAPS[colours]
    found = np.asarray(Colormap(name)(np.linspace(low, high, LEVELS)))[:, :3]
    return np.round(255.0 * found).astype(np.uint8)


def places(polar_deg: Floats, around_deg: Floats) -> tuple[Floats, Floats]:
    """Places (n,) of directions: the radius is the polar angle, `around_deg` the azimuth from the light's, which is left."""
    turn = np.radians(around_deg - SPECULAR_AZIMUTH_DEG)
    return polar_deg * np.cos(turn), polar_deg * np.sin(turn)


def is_half(around_deg: Floats) -> bool:
    """Whether directions are on one side of the plane of incidence: an isotropic sample has the image of them on the other."""
    side = np.sin(np.radians(around_deg))
    return bool((side > -ON_AXIS).all() or (side < ON_AXIS).all())


@cache
def ring_lines() -> tuple[Series, ...]:
    """The circles of some polar angles."""
    turn = np.radians(np.linspace(0.0, 360.0, 181))
    return tuple(Series(each * np.cos(turn), each * np.sin(turn), "line") for each in RINGS_DEG)


def value_bar(scale: Scale, values: Floats, label: str) -> Bar:
    """The bar of trusted values (n,) on a scale."""
    limits = scale.map_limits(values)
    return Bar(label, "values", scale, limits, bar_ticks(scale, limits), "min" if scale.log else "neither")


@cache
def disc_marks(sigma_deg: float) -> tuple[Marks, Marks]:
    """The light and the specular direction (or that straight through)."""
    at, opposite = np.array([sigma_deg]), np.array([SPECULAR_AZIMUTH_DEG])
    return Marks("light", *places(at, np.zeros(1))), Marks("specular", *places(at, opposite))


def disc_panel(
    sigma_deg: float,
    polar_deg: Floats,
    around_deg: Floats,
    values: Floats,
    trusted: Flags,
    bar: Bar,
    isotropic: bool,
    title: str,
    filled: Flags | None = None,
) -> Panel:
    """The map of values (n,) of one light. Of an isotropic sample the half that was not measured is the image of the other."""
    x, y = places(polar_deg, around_deg)
    cells = Map(x, y, values, trusted, bar, isotropic and is_half(around_deg), filled)
    return Panel(projection="disc", title=title, map=cells, series=ring_lines(), marks=disc_marks(sigma_deg))
