"""The style of all figures, of both back ends: colours by their role, lines, and the shapes of marks. Plain data."""

from dataclasses import dataclass
from typing import Literal

Symbol = Literal["circle", "square", "triangle", "diamond", "triangle down", "pentagon", "cross", "plus", "star", "dot"]
MarkKind = Literal[
    "measured",
    "transmitted",
    "steep",
    "lost",
    "below",
    "untrusted",
    "blocked",
    "alarm",
    "alarm above",
    "alarm below",
    "light",
    "specular",
]
Role = Literal["base", "text", "dim", "line", "bad", "points", "blocked", "predicted"]

SIMULATED = "SIMULATED"
CURVE_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#a66f00", "#4d4d4d")
"""Colours of curves (Okabe and Ito): also apart for people with a colour deficiency, and on white paper."""
CURVE_SYMBOLS: tuple[Symbol, ...] = ("circle", "square", "triangle", "diamond", "triangle down", "pentagon", "cross")
BAND_ALPHA = 0.27
SPAN_ALPHA = 0.2
"""Opacity of a band, and of a shaded interval of an axis."""
LINE_WIDTH, BAR_WIDTH, GUIDE_WIDTH = 1.5, 0.75, 0.75
"""Of a curve, of the bars at its points and of a line across a panel, in points as all widths."""
OPEN_WIDTH, HALO_WIDTH = 1.125, 3.0
"""Of the line of a mark that is not filled, and of the dark one beneath it on a map."""


@dataclass(frozen=True)
class Palette:
    """Colours by their role: paper's, or those of a scheme of the window. That of marks to `base` is at least 3 to 1."""

    base: str
    text: str
    dim: str
    line: str
    bad: str
    points: str
    blocked: str
    predicted: str


PAPER = Palette(
    base="#ffffff",
    text="#000000",
    dim="#59616b",
    line="#c3c8d0",
    bad="#b3161b",
    points=CURVE_COLOURS[0],
    blocked="#6b7280",
    predicted="#b45f06",
)


@dataclass(frozen=True)
class MarkStyle:
    """The shape of a mark, its size in points, whether it is filled, and its colour; "" is that of its curve."""

    symbol: Symbol
    size: float
    filled: bool
    colour: Role | str = ""


MARKS: dict[MarkKind, MarkStyle] = {
    "measured": MarkStyle("circle", 5.0, True),
    "transmitted": MarkStyle("square", 5.0, True),
    "steep": MarkStyle("diamond", 6.0, True),
    "lost": MarkStyle("dot", 2.5, True),
    "below": MarkStyle("triangle down", 5.0, False),
    "untrusted": MarkStyle("cross", 4.0, False, "blocked"),
    "blocked": MarkStyle("circle", 4.0, False, "blocked"),
    "alarm": MarkStyle("square", 9.0, False, "bad"),
    "alarm above": MarkStyle("triangle", 6.0, True, "bad"),
    "alarm below": MarkStyle("triangle down", 6.0, True, "bad"),
    "light": MarkStyle("star", 10.0, True, "#ffd24d"),
    "specular": MarkStyle("plus", 10.0, False, "#ff8c69"),
}
"""The marks of all figures: values with their flags. Light and specular direction have a dark edge."""

DISC = Palette(
    base="#15171b",
    text="#ffffff",
    dim="#727a87",
    line="#8b93a0",
    bad="#ff8080",
    points="#ffffff",
    blocked="#b8bec8",
    predicted="#f0a63a",
)
"""The colours of a map of the hemisphere, on paper and in both schemes: the disc has a ground of its own."""
