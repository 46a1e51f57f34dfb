"""The back end for files and notebooks: a description drawn by matplotlib, on a new figure or on given axes."""

import io
import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import MOST_MARKED
from goniotwin.app.figures.description import Bar, Colour, Figure, Map, Panel, Series
from goniotwin.app.figures.hemisphere import EDGE_DEG, GAPS, HORIZON_DEG, RINGS_DEG, WIDEST_DEG, colour_table
from goniotwin.app.figures.scale import Scale, tick_text
from goniotwin.app.figures.style import BAND_ALPHA, DISC, MARKS, PAPER, SIMULATED, Palette, Symbol
from goniotwin.app.formats.file import check_writable, write_file
from goniotwin.arrays import Flags, Floats

if TYPE_CHECKING:  # matplotlib loads 249 modules, which checks of names and axes do not need
    from matplotlib import figure as mpl_figure
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap, Normalize
    from matplotlib.projections.polar import PolarAxes

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
MOST_DOTS = 2000
MOST_RINGS = 5
"""Labelled circles of a polar diagram."""
DPI = 150
SUFFIXES = (".png", ".svg")


def draw(description: Figure, ax: "Axes | Sequence[Axes] | None" = None) -> "mpl_figure.Figure":
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
        _write_title(figure, description)
    if description.legend:
        _common_legend(figure, axes, description, own=ax is None)
    if description.simulated:
        place = figure.transFigure if ax is None else axes[0].transAxes
        text = axes[0].text if ax is not None else figure.text
        at = (0.99, 0.99, "top") if ax is None else (1.0, 1.01, "bottom")
        text(*at[:2], SIMULATED, ha="right", va=at[2], color=PAPER.bad, weight="bold", fontsize=11, transform=place)
    return figure


def save_figure(figure: "mpl_figure.Figure", path: Path, dpi: int = DPI) -> None:
    """Write a figure as PNG or SVG, by the suffix; the file is complete or not there. Raises GoniotwinError."""
    check_picture(path)
    write_file(path, picture(figure, path.suffix.lower()[1:], dpi))


def picture(figure: "mpl_figure.Figure", form: str, dpi: int = DPI) -> bytes:
    """The bytes of a figure as "png" or "svg"; the same figure gives the same ones."""
    import matplotlib as mpl

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


def _given_axes(description: Figure, ax: "Axes | Sequence[Axes]") -> "list[Axes]":
    from matplotlib.axes import Axes

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


def _root(axes: "Axes") -> "mpl_figure.Figure":
    figure: Any = axes.figure
    while figure is not figure.figure:  # a subfigure
        figure = figure.figure
    return figure  # type: ignore[no-any-return]


def _new_axes(description: Figure) -> "tuple[mpl_figure.Figure, list[Axes]]":
    from matplotlib.figure import Figure as NewFigure

    panels, columns = description.panels, description.columns
    if panels[0].projection == "polar":  # a layout engine would leave the room of a whole disc to a half one
        figure = NewFigure(figsize=description.size, dpi=100)
        place = (0.12, 0.14, 0.76, 0.7125) if panels[0].angles else (0.1, -0.07, 0.8, 1.2245)
        return figure, [figure.add_axes(place, projection="polar")]
    figure = NewFigure(figsize=description.size, dpi=100, layout="constrained")
    rows = -(-len(panels) // columns)
    grid = figure.subplots(
        rows, columns, squeeze=False, height_ratios=description.heights, width_ratios=description.widths
    ).ravel()
    for each in grid[len(panels) :]:
        each.set_axis_off()
    return figure, grid[: len(panels)].tolist()


def _write_title(figure: "mpl_figure.Figure", description: Figure) -> None:
    if not description.title:
        return
    width = LETTERS_AN_INCH * (figure.get_figwidth() - (1.4 if description.simulated else 0.2))
    name = shortened(description.title, round(width) - len(description.about))
    figure.suptitle(f"{name}{description.about}", x=0.01, ha="left", fontsize=10.5)


def _common_legend(figure: "mpl_figure.Figure", axes: "list[Axes]", description: Figure, *, own: bool) -> None:
    """The legend of the whole: of the curves of the first panel, above all or, on given axes, in it."""
    handles, labels = axes[0].get_legend_handles_labels()
    style: dict[str, Any] = {"frameon": False, "fontsize": 9, "title_fontsize": 9, "alignment": "left"}
    if not own:
        axes[0].legend(handles, [shortened(each, 40) for each in labels], title=fill(description.legend, 50), **style)
        return
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


def _draw_panel(axes: "Axes", panel: Panel) -> None:
    for span in panel.spans:
        shade = axes.axvspan if span.upright else axes.axhspan
        shade(span.low, span.high, color=_colour(span.colour), alpha=0.15, lw=0, zorder=0)
    if panel.map is not None:
        _draw_disc(axes, panel.map)
    for each in panel.series:
        _draw_series(axes, each, PAPER if panel.map is None else DISC)
    _draw_marks(axes, panel)
    for guide in panel.guides:
        line = axes.axvline if guide.upright else axes.axhline
        line(guide.at, color=_colour(guide.colour), lw=0.8, ls=LINES[guide.line], zorder=1)
    axes.set_title(panel.title, fontsize=10 if panel.projection == "disc" else 9, loc="center" if panel.map else "left")
    if panel.projection == "rectangular":
        _set_axes(axes, panel)
    elif panel.projection == "polar":
        _set_polar(axes, panel)  # type: ignore[arg-type]  # the projection has been checked
    if panel.legend:  # above the axes, where it hides nothing
        axes.legend(
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
            ncols=3,
            frameon=False,
            fontsize=9,
            title=fill(panel.legend, MOST_LETTERS),
            title_fontsize=9,
            alignment="left",
            borderaxespad=0.2,
        )


def _colour(colour: Colour, palette: Palette = PAPER) -> str:
    return str(getattr(palette, colour, colour))


def _draw_series(axes: "Axes", each: Series, palette: Palette) -> None:
    colour = _colour(each.colour, palette)
    if each.lower is not None and each.upper is not None:
        axes.fill_between(each.x, each.lower, each.upper, color=colour, alpha=BAND_ALPHA, lw=0, zorder=1.5)
    width, alpha = (4.0, 0.55) if each.broad else (1.3, 1.0)
    symbol = SYMBOLS[each.symbol] if each.symbol else ""
    label = each.name or "_nolegend_"
    style: dict[str, Any] = {"ls": LINES[each.line], "marker": symbol, "ms": 3.0, "lw": width, "alpha": alpha}
    axes.plot(each.x, each.y, color=colour, label=label, zorder=2.5, **style)


def _draw_marks(axes: "Axes", panel: Panel) -> None:
    from matplotlib.patheffects import withStroke

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
                mew=0.6 if style.filled else 1.8,
                path_effects=[] if style.filled else [withStroke(linewidth=3.4, foreground="black")],
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
            mew=0.9,
            clip_on=each.kind != "below",
            zorder=4,
        )


def _set_axes(axes: "Axes", panel: Panel) -> None:
    """Limits, ticks and labels of axes without a frame at top and right, with a faint grid."""
    scale = panel.scale
    if scale is not None and scale.log:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(lambda value, _: tick_text(scale, math.log10(value)))
    for axis, set_limits, set_ticks, set_label in (
        (panel.x, axes.set_xlim, axes.set_xticks, axes.set_xlabel),
        (panel.y, axes.set_ylim, axes.set_yticks, axes.set_ylabel),
    ):
        if axis.limits is not None:
            set_limits(*axis.limits)
        if axis.ticks is not None:
            set_ticks(axis.ticks)
        set_label(axis.label)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.9", lw=0.6)
    axes.set_axisbelow(True)


# ---- maps ----


def _norm(bar: Bar) -> "Normalize":
    from matplotlib.colors import LogNorm, Normalize

    return (LogNorm if bar.scale.log else Normalize)(*bar.limits)


def _colour_map(bar: Bar) -> "ListedColormap":
    from matplotlib.colors import ListedColormap

    return ListedColormap(colour_table(bar.colours) / 255.0)


def _draw_bar(figure: "mpl_figure.Figure", axes: "list[Axes]", bar: Bar) -> None:
    from matplotlib.cm import ScalarMappable

    shown = figure.colorbar(
        ScalarMappable(_norm(bar), _colour_map(bar)),
        ax=axes,
        label=bar.label,
        extend=bar.extend,
        shrink=0.8,
        aspect=30,
        panchor=False,
        ticks=list(bar.ticks),
    )
    shown.ax.minorticks_off()
    shown.ax.set_yticklabels([f"{each:g}" for each in bar.ticks])


def _draw_disc(axes: "Axes", drawn: Map) -> None:
    """The values of a map on its ground, with rings; light and specular direction are marks of the panel."""
    from matplotlib.patches import Circle
    from matplotlib.patheffects import withStroke

    axes.add_patch(Circle((0.0, 0.0), HORIZON_DEG, facecolor=DISC.base, lw=0, zorder=1))
    x, y, trusted = drawn.x, drawn.y, drawn.trusted
    twice = 2 if drawn.mirrored else 1
    image = np.concatenate([y, -y]) if drawn.mirrored else y
    _draw_surface(
        axes, np.tile(x, twice), image, drawn.bar.scale.placed(np.tile(drawn.values, twice)), np.tile(trusted, twice), drawn.bar
    )
    if x.size <= MOST_DOTS:
        axes.plot(x[trusted], y[trusted], ".", ms=MARKS["direction"].size, color="black", alpha=0.35, mew=0, zorder=3)
    if not trusted.all():
        axes.plot(x[~trusted], y[~trusted], "x", ms=2.0, mew=0.5, color=DISC.blocked, zorder=3)
    for radius in RINGS_DEG:
        text = axes.text(0.0, -radius, f"{radius:g}°", fontsize=7, ha="center", va="bottom", color=DISC.text, zorder=5)
        text.set_path_effects([withStroke(linewidth=1.8, foreground=DISC.base)])
    axes.set_xlim(-EDGE_DEG, EDGE_DEG)
    axes.set_ylim(-EDGE_DEG, EDGE_DEG)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_surface(axes: "Axes", x: Floats, y: Floats, placed: Floats, trusted: Flags, bar: Bar) -> None:
    """Colours between directions that are near each other; where they span no area, a mark at each."""
    from matplotlib.tri import Triangulation

    found = None
    norm, colours = _norm(bar), _colour_map(bar)
    _, first = np.unique(np.round(np.stack([x, y]), 4), axis=1, return_index=True)
    order = first[np.argsort(~trusted[first], kind="stable")]
    if order.size > 3 and min(np.ptp(x[order]), np.ptp(y[order])) > 1.0:
        found = Triangulation(x[order], y[order])
        corners = found.triangles
        sides = [np.hypot(*(each[order][corners[:, k]] - each[order][corners[:, k - 1]] for each in (x, y))) for k in range(3)]
        longest = np.max(sides, axis=0)
        limit = max(WIDEST_DEG, GAPS * float(np.quantile(longest, 0.95)))
        hidden = (longest > limit) | ~trusted[order][corners].all(axis=1)
        if hidden.all():
            found = None
        else:
            found.set_mask(hidden)
    if found is None:
        size, edge = (9.0, 0.0) if x.size > MOST_MARKED else (30.0, 0.5)
        axes.scatter(
            x[trusted], y[trusted], c=placed[trusted], s=size, norm=norm, cmap=colours, lw=edge, edgecolors="0.3", zorder=2
        )
        return
    at = np.where(trusted, placed, norm.vmin or 0.0)[order]
    axes.tripcolor(found, at, shading="gouraud", norm=norm, cmap=colours, rasterized=True, zorder=2)


# ---- polar diagrams ----


def _set_polar(axes: "PolarAxes", panel: Panel) -> None:
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


def _label_rings(axes: "PolarAxes", scale: Scale, outer: float) -> None:
    """Some labels of the circles of a polar diagram, so few that they are apart."""
    from matplotlib.ticker import MaxNLocator

    axes.set_rlabel_position(88)
    if not scale.log:
        axes.yaxis.set_major_locator(MaxNLocator(MOST_RINGS, min_n_ticks=2))
        return
    decades = np.arange(0, int(outer) + 1)
    first = round(float(np.log10(scale.floor)))
    step = -(-decades.size // MOST_RINGS)
    names = [tick_text(scale, k + first) if (decades[-1] - k) % step == 0 else "" for k in decades.tolist()]
    axes.set_rgrids(decades.tolist(), names)
