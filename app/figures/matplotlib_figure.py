"""The back end for files and notebooks: a description drawn by matplotlib, on a new figure or on given axes."""

import io
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import figure as mpl_figure
from matplotlib.axes import Axes
from matplotlib.axis import Axis as MplAxis
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.patches import Circle
from matplotlib.patheffects import withStroke
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import ScaledTranslation

from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import MOST_MARKED
from goniotwin.app.figures.description import Bar, Colour, Figure, Map, Panel, Series
from goniotwin.app.figures.hemisphere import EDGE_DEG, HORIZON_DEG, RINGS_DEG, colour_table
from goniotwin.app.figures.scale import Scale, tick_text
from goniotwin.app.figures.style import (
    BAND_ALPHA,
    BAR_WIDTH,
    DISC,
    GUIDE_WIDTH,
    HALO_WIDTH,
    LINE_WIDTH,
    MARKS,
    OPEN_WIDTH,
    PAPER,
    SIMULATED,
    SPAN_ALPHA,
    Palette,
    Symbol,
)
from goniotwin.app.figures.surface import coloured_places, surface
from goniotwin.app.formats.file import check_writable, write_file

SYMBOLS: dict[Symbol, str] = {
    "circle": "o",
    "square": "s",
    "triangle": "^",
    "diamond": "D",
    "triangle down": "v",
    "pentagon": "P",
    "cross": "x",
    "plus": "+",
    "star": "*",
    "dot": ".",
}
LINES = {"solid": "-", "dashed": "--", "dotted": ":", "none": "None"}
LETTERS_AN_INCH, MOST_LETTERS = 12.0, 100
"""Of a title, and of a line above a legend."""
MOST_RINGS = 5
"""Labelled circles of a polar diagram."""
SIMULATED_STYLE: dict[str, Any] = {"color": PAPER.bad, "weight": "bold", "fontsize": 11}
LEGEND_STYLE: dict[str, Any] = {
    "frameon": False,
    "fontsize": 9,
    "title_fontsize": 9,
    "alignment": "left",
    "handlelength": 1.5,
    "columnspacing": 1.0,
}
APART, TITLE_ROOM, LABEL_SHARE = 2.0, 18.0, 0.6
"""Points between the words above given axes, and over these under a title of the whole; the part of ticks and label in the
distance to the axes below."""
FILLED_SIZE = 1.0
"""Of the dot at a filled node of a table, points."""
DPI = 150
SUFFIXES = (".png", ".svg")


def draw(description: Figure, ax: Axes | Sequence[Axes] | None = None) -> mpl_figure.Figure:
    """Draw a description on a new figure, or on axes, one for each panel; returns the figure, which is not shown yet.

    On given axes there is no title of the whole, for the figure is the caller's. Raises UserError for axes that do not fit.
    """
    if ax is not None:
        axes = _given_axes(description, ax)
    else:
        figure, axes = _new_axes(description)
    for each, panel in zip(axes, description.panels, strict=True):
        _draw_panel(each, panel)
    if ax is not None:
        figure = _root(axes[0])
    for bar in description.bars:
        shown = [each for each, panel in zip(axes, description.panels, strict=True) if panel.map is not None]
        _draw_bar(figure, shown, bar)
    if ax is None:
        _write_around(figure, axes, description)
    else:
        _write_above(figure, axes, description)
    return figure


def save_figure(figure: mpl_figure.Figure, path: Path, dpi: int = DPI) -> None:
    """Write a figure as PNG or SVG, by the suffix; the file is complete or not there. Raises GoniotwinError."""
    check_picture(path)
    write_file(path, picture(figure, path.suffix.lower()[1:], dpi))


def picture(figure: mpl_figure.Figure, form: str, dpi: int = DPI) -> bytes:
    """The bytes of a figure as "png" or "svg"; the same figure gives the same ones."""
    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "goniotwin"}):  # no random names
        figure.savefig(buffer, format=form, dpi=dpi, metadata={"Date": None} if form == "svg" else {"Software": "goniotwin"})
    return buffer.getvalue()


def check_picture(path: Path) -> None:
    """Raise UserError for a name that is not one of a picture, and for a file that cannot be written."""
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{path}: a picture is a {' or '.join(SUFFIXES)}; choose such a name")
    check_writable(path)


def shortened(text: str, letters: int) -> str:
    """A text of at most so many letters, but 20: its beginning and its end."""
    most = max(letters, 20)
    return text if len(text) <= most else f"{text[: most // 2 - 2]} ... {text[3 - (most - most // 2) :]}"


# ---- axes and words ----


def _given_axes(description: Figure, ax: Axes | Sequence[Axes]) -> list[Axes]:
    given: Any = np.ravel(np.asarray(ax, dtype=object)).tolist()
    if not all(isinstance(each, Axes) for each in given):
        raise UserError("ax: give matplotlib axes, or a list of them")
    needed = len(description.panels)
    if len(given) != needed:
        raise UserError(f"ax: {len(given)} axes are given, and this picture has {needed} panels: give a list of {needed} axes")
    for each, panel in zip(given, description.panels, strict=True):
        wanted = "polar" if panel.projection == "polar" else "rectilinear"
        if each.name != wanted:
            how = "plt.subplots(subplot_kw={'projection': 'polar'})" if wanted == "polar" else "plt.subplots()"
            raise UserError(f"ax: the projection is {each.name!r}, and this picture needs {wanted!r}: make the axes with {how}")
    return list(given)


def _root(axes: Axes) -> mpl_figure.Figure:
    figure: Any = axes.figure
    while figure is not figure.figure:  # a subfigure
        figure = figure.figure
    return figure  # type: ignore[no-any-return]  # matplotlib gives parents no type


def _new_axes(description: Figure) -> tuple[mpl_figure.Figure, list[Axes]]:
    panels, columns = description.panels, description.columns
    if panels[0].projection == "polar":  # a layout engine would leave the room of a whole disc to a half one
        figure = mpl_figure.Figure(figsize=description.size, dpi=100)
        place = (0.12, 0.14, 0.76, 0.7125) if panels[0].angles else (0.1, -0.07, 0.8, 1.2245)
        return figure, [figure.add_axes(place, projection="polar")]
    figure = mpl_figure.Figure(figsize=description.size, dpi=100, layout="constrained")
    rows = -(-len(panels) // columns)
    grid = figure.subplots(
        rows, columns, squeeze=False, height_ratios=description.heights, width_ratios=description.widths
    ).ravel()
    for each in grid[len(panels) :]:
        each.set_axis_off()
    return figure, grid[: len(panels)].tolist()


def _write_title(figure: mpl_figure.Figure, description: Figure) -> None:
    if not description.title:
        return
    width = LETTERS_AN_INCH * (figure.get_figwidth() - (1.4 if description.simulated else 0.2))
    name = shortened(description.title, round(width) - len(description.about))
    figure.suptitle(f"{name}{description.about}", x=0.01, ha="left", fontsize=10.5)


def _write_around(figure: mpl_figure.Figure, axes: list[Axes], description: Figure) -> None:
    """Write the words of a new figure, with its title and the mark of simulated values at its top."""
    _write_title(figure, description)
    for row in _rows(axes, description):
        _write_labels(row)
    for each, panel in zip(axes, description.panels, strict=True):
        if panel.legend:
            _legend_above(each, panel.legend, MOST_LETTERS, 3)
    if description.legend:
        _common_legend(figure, axes, description)
    if description.simulated:
        figure.text(0.99, 0.99, SIMULATED, ha="right", va="top", **SIMULATED_STYLE)


def _write_above(figure: mpl_figure.Figure, axes: list[Axes], description: Figure) -> None:
    """Write the words of given axes. Legends are above title and ticks, and the mark of simulated values is above these.

    A layout engine leaves them room; without one the axes become lower.
    """
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)  # for the widths
    places: list[tuple[Axes, tuple[float, float]]] = []
    for k, row in enumerate(_rows(axes, description)):
        _write_labels(row)
        above = _write_words(row, description if k == 0 else Figure((), description.size))
        if engine is None:
            given = [each for each, _ in row]
            places += [(each, _lower_place(given, above)) for each in given]
    for each, (low, high) in places:
        place = each.get_position(original=True)
        each.set_position((place.x0, low, place.width, high - low))
        each.set_in_layout(True)  # which a position ends


def _rows(axes: list[Axes], description: Figure) -> list[list[tuple[Axes, Panel]]]:
    """The rows of axes with their panels, from left to right; that of the first axes is the first."""
    rows: dict[float, list[tuple[Axes, Panel]]] = {}
    for pair in zip(axes, description.panels, strict=True):
        rows.setdefault(round(pair[0].get_position(original=True).y1, 3), []).append(pair)
    return [sorted(row, key=lambda pair: pair[0].get_position(original=True).x0) for row in rows.values()]


def _write_labels(row: list[tuple[Axes, Panel]]) -> None:
    """Titles within the distance of the axes; labels that are the same for the whole row once, in its middle."""
    first, last = row[0][0], row[-1][0]
    width = row[1][0].bbox.x0 - first.bbox.x0 if len(row) > 1 else first.bbox.width
    for each, panel in row:
        title = "\n".join(fill(line, _letters(each, width)) for line in panel.title.split("\n"))
        is_map = panel.map is not None
        each.set_title(title, loc="center" if is_map else "left", fontsize=10 if is_map else 9)
        each.set_ylabel(panel.y.label if panel.projection == "rectangular" else "")
    if len({panel.y.label for _, panel in row}) == 1:
        for each, _ in row[1:]:
            each.set_ylabel("")
    if row[0][1].projection != "rectangular":
        return
    if len({panel.x.label for _, panel in row}) > 1:
        for each, panel in row:
            each.set_xlabel(fill(panel.x.label, _letters(each, width)))
        return
    given = [each for each, _ in row]
    low, high, middle = first.bbox.x0, last.bbox.x1, 0.5 * (first.bbox.x0 + last.bbox.x1)
    others = [each.bbox for each in first.figure.axes if each not in given and _beside(each, first)]
    left = max([first.figure.bbox.x0, *(each.x1 for each in others if each.x1 <= low)])
    right = min([first.figure.bbox.x1, *(each.x0 for each in others if each.x0 >= high)])
    for each in given:
        each.set_xlabel("")
    here = given[(len(given) - 1) // 2]  # a layout engine takes the middle of a label for that of its axes
    here.set_xlabel(fill(row[0][1].x.label, _letters(first, 2.0 * min(middle - left, right - middle))))
    here.xaxis.label.set_x((middle - here.bbox.x0) / here.bbox.width)


def _beside(one: Axes, other: Axes) -> bool:
    """Whether axes have some height in common."""
    return bool(one.bbox.y0 < other.bbox.y1 and other.bbox.y0 < one.bbox.y1)


def _write_words(row: list[tuple[Axes, Panel]], description: Figure) -> float:
    """Write legends and mark above a row of axes; returns the height of all that is above these, in points."""
    first, shown = row[0][0], row[-1][0]
    for each, _ in row:
        each.apply_aspect()
    bottom = height = max(_overhang(each)[1] for each, _ in row)
    for each, panel in row:
        if panel.legend:
            height = max(height, bottom + _legend_above(each, panel.legend, _letters(each), 3, bottom, each.bbox.width))
    if description.legend:
        width = shown.bbox.x1 - first.bbox.x0
        height += _legend_above(first, description.legend, _letters(first, width), 3, bottom, width)
    if description.simulated or description.legend:
        at: dict[str, Any] = {"xycoords": "axes fraction", "textcoords": "offset points", "ha": "right", "va": "bottom"}
        text = SIMULATED if description.simulated else " "
        mark = first.annotate(text, (1.0, 1.0), (0.0, height + APART), **at, **SIMULATED_STYLE)
        height += APART + _points(first, mark.get_window_extent().height)
    return height


def _overhang(axes: Axes) -> tuple[float, float]:
    """What is drawn below and above axes, in points."""
    whole = axes.get_tightbbox()
    ends = (axes.bbox.y0 - whole.y0, whole.y1 - axes.bbox.y1) if whole is not None else (0.0, 0.0)
    return max(_points(axes, ends[0]), 0.0), max(_points(axes, ends[1]), 0.0)


def _lower_place(row: list[Axes], above: float) -> tuple[float, float]:
    """The ends in height of axes of a row that has so many points above it, with all of theirs in the room that there is.

    That is the room to the edge of the figure, and shares of the distance to the next axes.
    """
    parent, place = row[0].figure, row[0].get_position(original=True)
    height = _points(row[0], parent.bbox.height)
    places = [each.get_position(original=True) for each in parent.axes]
    over = min((each.y0 - place.y1 for each in places if each.y0 >= place.y1), default=None)
    under = min((place.y0 - each.y1 for each in places if each.y1 <= place.y0), default=None)
    top = 1.0 - place.y1 if not parent.get_suptitle() else TITLE_ROOM / height
    room_above = (top if over is None else (1.0 - LABEL_SHARE) * over) - APART / height
    room_below = (place.y0 if under is None else LABEL_SHARE * under) - APART / height
    low = place.y0 + max(max(_overhang(each)[0] for each in row) / height - room_below, 0.0)
    high = place.y1 - max(above / height - room_above, 0.0)
    return low, max(high, low + 0.1 * place.height)


def _points(axes: Axes, pixels: float) -> float:
    return 72.0 * pixels / _root(axes).dpi


def _letters(axes: Axes, pixels: float | None = None) -> int:
    """The letters of a line as wide as axes, or as so many pixels."""
    return max(int(LETTERS_AN_INCH * (axes.bbox.width if pixels is None else pixels) / _root(axes).dpi), 10)


def _legend_above(
    axes: Axes, heading: str, letters: int, columns: int, bottom: float = 0.0, width: float | None = None
) -> float:
    """Write a legend above axes, so many points over them, in as many columns as have room; returns its height in points."""
    figure = _root(axes)
    handles, labels = axes.get_legend_handles_labels()
    place = axes.transAxes + ScaledTranslation(0.0, bottom / 72.0, figure.dpi_scale_trans)
    at: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "bbox_transform": place, "borderaxespad": 0.2}
    short = [shortened(each, letters - 6) for each in labels]
    for ncols in range(columns, 0, -1):
        legend = axes.legend(handles, short, title=fill(heading, letters), ncols=ncols, **at, **LEGEND_STYLE)
        box = legend.get_window_extent()
        if width is None or box.width <= width:
            break
    legend.set_in_layout(width is None or width <= axes.bbox.width)  # of one over several axes, the mark above takes the room
    return _points(axes, box.height) + 0.2 * 9.0


def _common_legend(figure: mpl_figure.Figure, axes: list[Axes], description: Figure) -> None:
    """The legend of the whole: of the curves and marks of all panels, each once, above all."""
    named = [pair for each in axes for pair in zip(*each.get_legend_handles_labels(), strict=True)]
    first = {label: handle for handle, label in reversed(named)}
    labels = list(dict.fromkeys(label for _, label in named))
    handles = [first[label] for label in labels]
    style = LEGEND_STYLE
    if description.panels[0].projection == "polar":
        title = fill(description.legend, MOST_LETTERS)
        figure.legend(handles, labels, loc="lower left", ncols=4, title=title, **{**style, "title_fontsize": 8.5})
        return
    width = round(LETTERS_AN_INCH * figure.get_figwidth() - (24 if description.simulated else 9))
    short = [shortened(each, width) for each in labels]
    columns = 2 if sum(map(len, short)) + 12 < width else 1
    title = fill(description.legend, round(1.1 * width))
    figure.legend(handles, short, loc="outside upper left", ncols=columns, title=title, **style)


# ---- panels ----


def _draw_panel(axes: Axes, panel: Panel) -> None:
    for span in panel.spans:
        shade = axes.axvspan if span.upright else axes.axhspan
        shade(span.low, span.high, color=_colour(span.colour), alpha=SPAN_ALPHA, lw=0, zorder=0)
    if panel.map is not None:
        _draw_disc(axes, panel.map)
    for each in panel.series:
        _draw_series(axes, each, PAPER if panel.map is None else DISC)
    _draw_marks(axes, panel)
    for guide in panel.guides:
        line = axes.axvline if guide.upright else axes.axhline
        line(guide.at, color=_colour(guide.colour), lw=GUIDE_WIDTH, ls=LINES[guide.line], zorder=1)
    if panel.projection == "rectangular":
        _set_axes(axes, panel)
    elif panel.projection == "polar":
        _set_polar(axes, panel)  # type: ignore[arg-type]  # the projection has been checked


def _colour(colour: Colour, palette: Palette = PAPER) -> str:
    return str(getattr(palette, colour, colour))


def _draw_series(axes: Axes, each: Series, palette: Palette) -> None:
    colour = _colour(each.colour, palette)
    if each.lower is not None and each.upper is not None and each.bars:
        axes.vlines(each.x, each.lower, each.upper, color=colour, lw=BAR_WIDTH, zorder=2.0)
    elif each.lower is not None and each.upper is not None:
        axes.fill_between(each.x, each.lower, each.upper, color=colour, alpha=BAND_ALPHA, lw=0, zorder=1.5)
    width, alpha = (4.0, 0.55) if each.broad else (LINE_WIDTH, 1.0)
    symbol = SYMBOLS[each.symbol] if each.symbol else ""
    label = each.name or "_nolegend_"
    style: dict[str, Any] = {"ls": LINES[each.line], "marker": symbol, "ms": 3.0, "lw": width, "alpha": alpha}
    axes.plot(each.x, each.y, color=colour, label=label, zorder=2.5, **style)


def _draw_marks(axes: Axes, panel: Panel) -> None:
    meanings = dict(panel.key)
    for each in panel.marks:
        style = MARKS[each.kind]
        colour = _colour(style.colour or each.colour, PAPER if panel.map is None else DISC)
        if panel.map is not None:
            axes.plot(
                each.x,
                each.y,
                SYMBOLS[style.symbol],
                ms=style.size,
                color=colour,
                mec="black" if style.filled else colour,
                mew=0.6 if style.filled else OPEN_WIDTH,
                path_effects=[] if style.filled else [withStroke(linewidth=HALO_WIDTH, foreground="black")],
                zorder=6,
            )
            continue
        face = colour if style.filled else "none" if each.kind != "below" else "white"
        axes.plot(
            each.x,
            each.y,
            SYMBOLS[style.symbol],
            ms=style.size,
            color=colour,
            mfc=face,
            mew=OPEN_WIDTH,
            clip_on=each.kind != "below",
            label=meanings.pop(each.kind, "_nolegend_"),
            zorder=4,
        )


def _set_axes(axes: Axes, panel: Panel) -> None:
    """Limits and ticks of axes without a frame at top and right, with a faint grid."""
    scale = panel.scale
    if scale is not None and scale.log:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(lambda value, _: tick_text(scale, math.log10(value)))
    for axis, of, set_limits in ((panel.x, axes.xaxis, axes.set_xlim), (panel.y, axes.yaxis, axes.set_ylim)):
        if axis.limits is not None:
            set_limits(*axis.limits)
        if axis.ticks is not None:
            of.set_ticks(axis.ticks)
            of.set_major_formatter(partial(_tick_text, of, axis.ticks))
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.9", lw=0.6)
    axes.set_axisbelow(True)


def _tick_text(axis: MplAxis, ticks: tuple[float, ...], value: float, _: int | None) -> str:
    """The text of a tick; of as many as there is room for: the one in the middle, and at equal steps to both ends."""
    if value not in ticks:  # that of the pointer
        return f"{value:.3g}"
    half = len(ticks) // 2
    steps = [k for k in range(1, half + 1) if half % k == 0]
    step = next((k for k in steps if 2 * half // k <= axis.get_tick_space()), half)
    return f"{value:g}".replace("-", "\N{MINUS SIGN}") if abs(ticks.index(value) - half) % step == 0 else ""


# ---- maps ----


def _norm(bar: Bar) -> Normalize:
    return (LogNorm if bar.scale.log else Normalize)(*bar.limits)


def _colour_map(bar: Bar) -> ListedColormap:
    return ListedColormap(colour_table(bar.colours) / 255.0)


def _draw_bar(figure: mpl_figure.Figure, axes: list[Axes], bar: Bar) -> None:
    height = max(each.bbox.y1 for each in axes) - min(each.bbox.y0 for each in axes)
    shown = figure.colorbar(
        ScalarMappable(_norm(bar), _colour_map(bar)),
        ax=axes,
        label=fill(bar.label, _letters(axes[0], height)),
        extend=bar.extend,
        shrink=0.8,
        aspect=30,
        panchor=False,
        ticks=list(bar.ticks),
    )
    shown.ax.minorticks_off()
    shown.ax.set_yticklabels([f"{each:g}" for each in bar.ticks])


def _draw_disc(axes: Axes, drawn: Map) -> None:
    """The values of a map on its ground, with rings; light and specular direction are marks of the panel."""
    axes.add_patch(Circle((0.0, 0.0), HORIZON_DEG, facecolor=DISC.base, lw=0, zorder=1))
    x, y, shown = drawn.x, drawn.y, drawn.trusted
    if drawn.filled is not None:
        axes.plot(x[drawn.filled], y[drawn.filled], ".", ms=FILLED_SIZE, color=DISC.base, mew=0, zorder=3)
        shown = shown | drawn.filled
    _draw_surface(axes, drawn)
    if not shown.all():
        axes.plot(x[~shown], y[~shown], "x", ms=2.0, mew=0.5, color=DISC.blocked, zorder=3)
    for radius in RINGS_DEG:
        text = axes.text(0.0, -radius, f"{radius:g}°", fontsize=7, ha="center", va="bottom", color=DISC.text, zorder=5)
        text.set_path_effects([withStroke(linewidth=1.8, foreground=DISC.base)])
    axes.set_xlim(-EDGE_DEG, EDGE_DEG)
    axes.set_ylim(-EDGE_DEG, EDGE_DEG)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_surface(axes: Axes, drawn: Map) -> None:
    """Colours between directions that are near each other; where they span no area, a mark at each."""
    bar, found = drawn.bar, surface(drawn)
    norm, colours = _norm(bar), _colour_map(bar)
    if found is None:
        x, y, values, shown = coloured_places(drawn)
        size, edge = (9.0, 0.0) if x.size > MOST_MARKED else (30.0, 0.5)
        c = bar.scale.placed(values[shown])
        axes.scatter(x[shown], y[shown], c=c, s=size, norm=norm, cmap=colours, lw=edge, edgecolors="0.3", zorder=2)
        return
    at = bar.scale.placed(found.values)
    axes.tripcolor(found.mesh, at, shading="gouraud", norm=norm, cmap=colours, rasterized=True, zorder=2)


# ---- polar diagrams ----


def _set_polar(axes: PolarAxes, panel: Panel) -> None:
    assert panel.scale is not None
    assert panel.y.limits is not None
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    outer = panel.y.limits[1]
    for arrow in panel.arrows:
        at, style = np.radians(arrow.angle_deg), {"arrowstyle": "->", "color": _colour(arrow.colour), "lw": 1.3}
        axes.annotate("", (at, 0.82 * outer), (at, outer), arrowprops=style)
    axes.set_rlim(0.0, outer)
    _label_rings(axes, panel.scale, outer)
    if panel.angles:
        axes.set_thetagrids([each for each, _ in panel.angles], [text for _, text in panel.angles])
    else:
        axes.set_thetamin(-90.0)
        axes.set_thetamax(90.0)
    axes.grid(color="0.85", lw=0.6)
    axes.tick_params(labelsize=8)


def _label_rings(axes: PolarAxes, scale: Scale, outer: float) -> None:
    """Some labels of the circles of a polar diagram, so few that they are apart."""
    axes.set_rlabel_position(88)
    if not scale.log:
        axes.yaxis.set_major_locator(MaxNLocator(MOST_RINGS, min_n_ticks=2))
        return
    decades = np.arange(0, int(outer) + 1)
    first = round(float(np.log10(scale.floor)))
    step = -(-decades.size // MOST_RINGS)
    names = [tick_text(scale, k + first) if (decades[-1] - k) % step == 0 else "" for k in decades.tolist()]
    axes.set_rgrids(decades.tolist(), names)
