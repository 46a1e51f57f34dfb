"""The description of a figure: panels with axes, series, marks, maps and words. A back end draws it in the style of `style`.

A back end decides what depends on the room: which ticks have a text, where lines of words break, and where legend and mark of
simulated values are; and whether the colours of a map are a surface, or a mark at each direction where they span no area. That
of the window has no symbols on its curves, no broad ones and no polar panels, which it does not show.

Arrays are of one length within a series, a group of marks or a map; NaN is a gap. A colour is "#rrggbb" or a role of `Palette`.
"""

from dataclasses import dataclass
from typing import Literal

from goniotwin.app.figures.scale import Scale
from goniotwin.app.figures.style import MarkKind, Role, Symbol
from goniotwin.arrays import Flags, Floats

Colour = Role | str
Line = Literal["solid", "dashed", "none"]
ColourMap = Literal["values", "deviations"]


@dataclass(frozen=True)
class Axis:
    """An axis with its label (and unit), limits, and ticks at even distances about the middle, which has one.

    As many ticks have a text as there is room for; without ticks the back end chooses them by the room, too.
    """

    label: str = ""
    limits: tuple[float, float] | None = None
    ticks: tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class Series:
    """A curve (n,) with the ends of its intervals; `bars` draws them at the points, else they are a band.

    `name` is that in the legend, empty where it has none. A `broad` curve is seen beneath another.
    """

    x: Floats
    y: Floats
    colour: Colour
    name: str = ""
    lower: Floats | None = None
    upper: Floats | None = None
    line: Line = "solid"
    symbol: Symbol | None = None
    broad: bool = False
    bars: bool = False


@dataclass(frozen=True, eq=False)
class Marks:
    """Marks (n,) of one kind; `colour` is that of their curve."""

    kind: MarkKind
    x: Floats
    y: Floats
    colour: Colour = "points"


@dataclass(frozen=True)
class Guide:
    """A line across the panel, at a value of the abscissa or of the ordinate."""

    at: float
    colour: Colour
    upright: bool = True
    line: Literal["solid", "dotted"] = "dotted"


@dataclass(frozen=True)
class Span:
    """A shaded interval of the abscissa or of the ordinate."""

    low: float
    high: float
    upright: bool = True
    colour: Colour = "blocked"


@dataclass(frozen=True)
class Bar:
    """The bar of a colour map: its label with the unit, its ends and its ticks, and whether values are below its lower end."""

    label: str
    colours: ColourMap
    scale: Scale
    limits: tuple[float, float]
    ticks: tuple[float, ...]
    extend: Literal["neither", "min", "both"] = "neither"


@dataclass(frozen=True, eq=False)
class Map:
    """Values (n,) at places (n,) of a disc whose radius is the polar angle, degrees; colours by `bar`.

    What is not `trusted` has no colour, and a cross, but for what a table has `filled`: it has colour, under a dot. `mirrored`:
    the other half is the image of this one.
    """

    x: Floats
    y: Floats
    values: Floats
    trusted: Flags
    bar: Bar
    mirrored: bool = False
    filled: Flags | None = None


@dataclass(frozen=True)
class Arrow:
    """An arrow of a polar panel, inwards at an angle in degrees."""

    angle_deg: float
    colour: Colour


@dataclass(frozen=True, eq=False)
class Panel:
    """One pair of axes with what is drawn there; `legend` is the heading of its legend, `key` its marks with their meaning.

    The angles of a polar panel are radians, clockwise from above; its radii are those of `Scale.radius`.
    """

    x: Axis = Axis()
    y: Axis = Axis()
    scale: Scale | None = None
    projection: Literal["rectangular", "polar", "disc"] = "rectangular"
    title: str = ""
    legend: str = ""
    key: tuple[tuple[MarkKind, str], ...] = ()
    series: tuple[Series, ...] = ()
    marks: tuple[Marks, ...] = ()
    guides: tuple[Guide, ...] = ()
    spans: tuple[Span, ...] = ()
    map: Map | None = None
    arrows: tuple[Arrow, ...] = ()
    angles: tuple[tuple[float, str], ...] = ()
    """Labelled spokes of a polar panel, degrees."""


@dataclass(frozen=True, eq=False)
class Figure:
    """Panels, row by row, with the words of the whole: title, and what is never cut off after it; heading of a legend.

    `simulated` values are marked.

    Sizes are in inches. `heights` and `widths` are those of rows and columns to each other.
    """

    panels: tuple[Panel, ...]
    size: tuple[float, float]
    columns: int = 1
    title: str = ""
    about: str = ""
    legend: str = ""
    simulated: bool = False
    heights: tuple[float, ...] | None = None
    widths: tuple[float, ...] | None = None

    @property
    def bars(self) -> tuple[Bar, ...]:
        """The bars of its maps, each once."""
        return tuple(dict.fromkeys(each.map.bar for each in self.panels if each.map is not None))
