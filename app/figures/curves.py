"""Curves of values with their intervals: gaps, values lost in their noise, those below the scale, those not to be trusted.

A curve is a line where it is above its noise, and a dot for each value that is lost in it. On a logarithmic scale what is below
the lower edge is an open triangle on it, and bands are cut off there. Values that are not to be trusted are no part of the
curve: it has a gap there, and each has a grey mark, a ring if the mirror unit blocks it and a cross for any other reason.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from goniotwin.app.figures.description import Axis, Colour, Guide, Line, Marks, Panel, Series, Span
from goniotwin.app.figures.scale import Scale
from goniotwin.app.figures.style import MarkKind, Symbol
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, round_deg, signed_polar

COVERAGE = 2.0
"""Standard uncertainties from a value to the ends of its band or bar."""
GAP_DEG, WIDEST_GAP_DEG = 6.0, 30.0
"""A curve ends where neighbours are further apart than the first and than four times most of them are, or than the second."""
MOST_MARKED = 60
"""Values of a curve that each have a mark."""
MEANINGS: dict[MarkKind, str] = {
    "lost": "below detection limit or U",
    "below": "below the scale",
    "blocked": "blocked by the mirror unit",
    "untrusted": "not trusted",
}
"""The meaning of the marks of curves, for a legend."""
POSITIVE = "positive: specular side"
ANGLE_TICKS = tuple(float(each) for each in range(-90, 91, 10))
ANGLE_LIMITS = (-90.0, 90.0)
PLANE_AXIS = Axis(f"polar angle in the plane of incidence, deg; {POSITIVE}", ANGLE_LIMITS, ANGLE_TICKS)
"""The abscissa of whatever is drawn in the plane of incidence."""


def plane_angle(polar_deg: Floats, around_deg: Floats, plane_deg: float = 0.0) -> Floats:
    """The abscissa of a cut: signed polar angles (n,), positive on the side of the specular direction (ASTM E2387).

    `around_deg` is the azimuth from the light's; a cut in another half plane through the normal, `plane_deg` from the light's,
    is positive on that side too. So right in a cut is right in a map.
    """
    return signed_polar(polar_deg, around_deg, plane_deg if 90.0 < plane_deg < 180.0 else plane_deg + SPECULAR_AZIMUTH_DEG)


def quantity(transmitted: bool | None, back: bool = False) -> str:
    """The name of values with their unit, for an axis; None is light of both sides."""
    name = "BSDF" if transmitted is None else "BTDF" if transmitted else "BRDF"
    return f"{name}{' of the back' if back else ''}, 1/sr"


@dataclass(frozen=True, eq=False)
class Curve:
    """Values with the ends of their intervals, arrays (n,) in the order of `x`, with gaps of NaN.

    `lost` are below their detection limit, by the flag, or below their expanded uncertainty: no line joins them. `apart` are
    the values that are not to be trusted, by the kind of their mark: x and y.
    """

    x: Floats
    y: Floats
    lower: Floats
    upper: Floats
    lost: Flags
    apart: tuple[tuple[MarkKind, Floats, Floats], ...] = ()


def curve_of(
    x: Floats,
    y: Floats,
    interval: tuple[Floats, Floats],
    *,
    good: Flags | None = None,
    lost: Flags | None = None,
    blocked: Flags | None = None,
    widest: float = WIDEST_GAP_DEG,
) -> Curve:
    """The curve of values (n,) in any order: a gap where there is none to be trusted, and where neighbours are far apart."""
    good = np.ones(x.size, dtype=bool) if good is None else good
    below = np.zeros(x.size, dtype=bool) if lost is None else lost
    order = np.flatnonzero(good)[np.argsort(x[good], kind="stable")]
    at, values, low, high = (each[order] for each in (x, y, *interval))
    bad = np.flatnonzero(~good)
    ring = np.zeros(bad.size, dtype=bool) if blocked is None else blocked[bad]
    gaps = gaps_of(at, widest)
    breaks = np.union1d(np.setdiff1d(round_deg(x[bad]), round_deg(at)), 0.5 * (at[gaps] + at[gaps + 1]))
    places = np.searchsorted(at, breaks)
    values, low, high = (np.insert(each, places, np.nan) for each in (values, low, high))
    below = np.insert(below[order], places, False) | (low <= 0.0)
    apart: list[tuple[MarkKind, Floats, Floats]] = [("blocked", x[bad[ring]], y[bad[ring]])]
    apart.append(("untrusted", x[bad[~ring]], y[bad[~ring]]))
    return Curve(np.insert(at, places, breaks), values, low, high, below, tuple(each for each in apart if each[1].size))


def gaps_of(x: Floats, widest: float = WIDEST_GAP_DEG) -> Ints:
    """The places k of ascending `x` (n,) with a gap between k and k + 1."""
    apart = np.diff(x)
    typical = float(np.median(apart[apart > 0.0])) if (apart > 0.0).any() else math.inf
    return np.flatnonzero(apart > min(max(4.0 * typical, GAP_DEG), widest))


def curve_parts(
    found: Curve,
    scale: Scale,
    colour: Colour,
    name: str = "",
    symbol: Symbol | None = None,
    *,
    line: Line = "solid",
    broad: bool = False,
    bars: bool = False,
) -> tuple[Series, list[Marks]]:
    """A curve on a scale: its line with the band, and the marks of what is lost, below, or not to be trusted."""
    below = scale.below(found.y)
    if np.isfinite(found.y).sum() > MOST_MARKED or broad:
        symbol = None
    series = Series(
        found.x,
        np.where(found.lost | below, np.nan, found.y),
        colour,
        name,
        scale.placed(found.lower),
        scale.placed(found.upper),
        line,
        symbol,
        broad,
        bars,
    )
    dots = found.lost & ~below
    marks = [Marks("lost", found.x[dots], found.y[dots], colour)]
    marks += [Marks("below", found.x[below], np.full(int(below.sum()), scale.floor), colour)]
    ends = scale.limits(found.lower, found.upper)
    for kind, x, y in found.apart:
        marks.append(Marks(kind, x, np.clip(np.nan_to_num(y, nan=ends[0]), *ends)))
    return series, [each for each in marks if each.x.size]


def curve_panel(
    parts: Sequence[tuple[Series, list[Marks]]],
    scale: Scale,
    x: Axis,
    y_label: str,
    *,
    title: str = "",
    legend: str = "",
    reasons: str = "",
    guides: tuple[Guide, ...] = (),
    spans: tuple[Span, ...] = (),
) -> Panel:
    """A panel of curves on one scale; a linear one has its zero, and negative values where there are some.

    `reasons` are those of values that are not to be trusted, for the key of the marks.
    """
    series = tuple(each for each, _ in parts)
    marks = tuple(each for _, several in parts for each in several)
    drawn = [each for one in series for each in (one.y, one.lower, one.upper) if each is not None]
    y = Axis(y_label, scale.limits(*drawn, *(each.y for each in marks)))
    key = key_of(marks, reasons)
    return Panel(x, y, scale, title=title, legend=legend, key=key, series=series, marks=marks, guides=guides, spans=spans)


def key_of(marks: Sequence[Marks], reasons: str = "") -> tuple[tuple[MarkKind, str], ...]:
    """The meaning of the kinds of marks that there are; the one of values that are not to be trusted has the `reasons`."""
    meanings = MEANINGS | ({"untrusted": reasons} if reasons else {})
    return tuple((kind, meaning) for kind, meaning in meanings.items() if any(each.kind == kind for each in marks))


def spread(count: int, most: int) -> list[int]:
    """Indices below `count`; of more than `most` so many, evenly spread, with the first and the last."""
    chosen: list[int] = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)).tolist()
    return chosen


def distinct(values: Floats, most: int) -> Iterator[float]:
    """Distinct angles; of more than `most` so many, evenly spread, with the first and the last."""
    there = np.unique(round_deg(values))
    return iter(there[spread(there.size, most)].tolist())
