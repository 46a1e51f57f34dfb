"""Pictures of a dataset: cuts through the plane of incidence, maps of the hemisphere, a polar diagram, a spectrum.

On a logarithmic scale a value that is zero or negative has no place. There a curve is drawn as a line where it is above its
noise, and as a dot for each value that is lost in it (less than two of its uncertainties); what is below the lower edge is an
open triangle on it, and bands are cut off there. Values that are not to be trusted are not drawn: a curve has a gap there, and
a grey mark at the lower edge.
"""

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from goniotwin.app.campaign.reduction.components import COVERAGE as INTERVAL_U
from goniotwin.app.campaign.reduction.components import DRAWN_LAW, LOGARITHMIC_LAW, interval
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.data.values import Number, flag, quoted, with_names
from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import StrPath, check_writable, write_file
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import (
    HALF_TURN_DEG,
    SPECULAR_AZIMUTH_DEG,
    round_deg,
    signed_polar,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.projections.polar import PolarAxes

    from goniotwin.app.data.comparison import DatasetComparison, LightComparison

Kind = Literal["cuts", "hemisphere", "polar", "spectrum"]
KINDS: tuple[Kind, ...] = get_args(Kind)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#a66f00", "#4d4d4d")
"""Colours of curves (Okabe and Ito): also apart for people with a colour deficiency, and on white paper."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
SIMULATED_COLOUR = "#a93226"
SIMULATED = "SIMULATED"
COVERAGE = 2.0
"""Standard uncertainties from a curve to the edge of its band."""
MOST_CURVES, MOST_MAPS = 7, 6
DECADES = 7
"""A logarithmic scale has no more of them."""
STEEP = 30.0
"""Ratio of the largest value to the tenth percentile from which the scale is logarithmic, if none is asked for."""
NEAR_PLANE_DEG = 1.0
"""Directions so near to the plane of incidence make a cut where none is in it."""
WIDEST_DEG, GAPS = 12.0, 1.5
"""A map has no colour between directions further apart than so many degrees, and than so many times most neighbours are."""
GAP_DEG, WIDEST_GAP_DEG = 6.0, 30.0
"""A curve ends where neighbours are further apart than the first and than four times most of them are, or than the second."""
MOST_MARKED = 60
"""Values of a curve that each have a mark."""
LETTERS_AN_INCH, MOST_LETTERS = 12.0, 100
"""Of a title, and of a line above a legend."""
MOST_DOTS = 2000
MOST_RINGS = 5
"""Labelled circles of a polar diagram."""
SHOWN_THETA_DEG = (0.0, 10.0, 30.0, 60.0)
"""Of a spectrum the directions nearest to these aspecular angles are shown."""
MOST_COMPARED = 4
LEAST_WIDTH_DEG = 10.0
"""Of a profile's axis."""
LARGEST_Z = 4.0
"""z at the ends of a map's colours."""
DPI = 150
SUFFIXES = (".png", ".svg")


@with_names
def plot(
    dataset: Dataset | StrPath,
    kind: Kind = "cuts",
    *,
    sigma_deg: Number | None = None,
    psi_deg: Number | None = None,
    wavelength_nm: Number | None = None,
    log: bool | None = None,
) -> "Figure":
    """Draw the values of one sample, of a dataset or a file; returns the matplotlib figure, which is not shown anywhere yet.

    "cuts": the plane of incidence at each sigma. "hemisphere": a map of all directions at each sigma. "polar": the plane of
    incidence as a polar diagram. "spectrum": some directions over the wavelength. Bands are the values with two standard
    uncertainties. `sigma_deg`, `psi_deg` and `wavelength_nm` choose among the values; without them all sigmas are drawn (of
    many some), the first psi, and the middle wavelength or the green colour. `log` chooses the scale. Raises GoniotwinError.
    """
    given: object = kind
    if not isinstance(given, str) or given not in KINDS:
        raise UserError(f"kind: {quoted(kind)}: give one of {', '.join(map(repr, KINDS))}")
    log = flag("log", log)
    dataset = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    chosen = dataset.select(sigma_deg=sigma_deg, psi_deg=psi_deg, wavelength_nm=wavelength_nm)
    if not chosen.good.any():
        raise UserError(f"{dataset.name}: there is no trusted value to draw")
    if psi_deg is None:
        psi = chosen.psi_deg
        first = psi == psi[chosen.good & (chosen.sigma_deg > 0.0)].min(initial=psi[chosen.good].max())
        # At normal incidence the light has no azimuth: one psi is enough there, whichever it is.
        others = (chosen.sigma_deg == 0.0) & ~np.isin(chosen.sigma_deg, chosen.sigma_deg[first])
        others &= psi == psi[others].min(initial=np.inf)
        chosen = chosen.where(first | others)
    if kind == "spectrum":
        return _spectrum(chosen, log)
    chosen = _one_channel(chosen)
    return {"cuts": _cuts, "hemisphere": _hemisphere, "polar": _polar}[kind](chosen, log)


def save_figure(figure: "Figure", path: Path, dpi: int = DPI) -> None:
    """Write a figure as PNG or SVG, by the suffix; the file is complete or not there. Raises GoniotwinError."""
    import matplotlib as mpl

    check_picture(path)
    buffer = io.BytesIO()
    form = path.suffix.lower()[1:]
    with mpl.rc_context({"svg.hashsalt": "goniotwin"}):  # no random names: the same data give the same file
        figure.savefig(buffer, format=form, dpi=dpi, metadata={"Date": None} if form == "svg" else {"Software": "goniotwin"})
    write_file(path, buffer.getvalue())


def check_picture(path: Path) -> None:
    """Raise UserError for a name that is not one of a picture, and for a file that cannot be written."""
    if path.suffix.lower() not in SUFFIXES:
        raise UserError(f"{path}: a picture is a {' or '.join(SUFFIXES)}; choose such a name")
    check_writable(path)


# ---- scales and curves ----


@dataclass(frozen=True)
class Scale:
    """A logarithmic or linear scale. `floor`: the lower edge of a logarithmic one; `top`: the largest value with its band."""

    log: bool
    floor: float
    top: float

    def placed(self, values: Floats) -> Floats:
        """Values as they are drawn: not below the lower edge."""
        return np.maximum(values, self.floor) if self.log else values

    def below(self, values: Floats) -> Flags:
        """The values that are drawn at the lower edge."""
        return np.asarray(values < self.floor) if self.log else np.zeros(values.shape, dtype=bool)

    def radius(self, values: Floats) -> Floats:
        """The distance from the centre of a polar diagram: decades above the lower edge, or the value."""
        return np.log10(self.placed(values) / self.floor) if self.log else np.maximum(values, 0.0)


def scale_of(values: Floats, u: Floats, log: bool | None) -> Scale:
    """The scale for values (n,) with their u (NaN: unknown); without `log` by the range of the values."""
    known = values[np.isfinite(values)]
    positive = known[known > 0.0]
    top = float(np.max(known, initial=0.0))
    if not positive.size or log is False:
        return Scale(False, 0.0, top)
    if log is None and top <= STEEP * float(np.quantile(positive, 0.1)):
        return Scale(False, 0.0, top)
    noise = u[np.isfinite(u) & (u > 0.0)]
    least = max(float(positive.min()), float(np.quantile(noise, 0.05)) if noise.size else 0.0, 10.0**-DECADES * top)
    return Scale(True, 10.0 ** math.floor(math.log10(min(least, 0.5 * top))), top)


@dataclass(frozen=True)
class Curve:
    """Values with the ends of their bands, and the places without a trusted value; arrays (n,) in the order of `x`."""

    x: Floats
    y: Floats
    lower: Floats
    upper: Floats
    untrusted: Floats

    @property
    def lost_in_noise(self) -> Flags:
        """The values (n,) whose band reaches zero."""
        return np.asarray(self.lower <= 0.0)


def band(dataset: Dataset, coverage: float = COVERAGE) -> tuple[Floats, Floats]:
    """Lower and upper ends (n,) of the values' intervals, of their law where it is stated; NaN without an uncertainty."""
    added = np.asarray(dataset.interval != LOGARITHMIC_LAW)
    with np.errstate(invalid="ignore"):
        low, high = interval(dataset.bsdf, dataset.u, added, coverage, coverage)
        drawn, wider = dataset.interval == DRAWN_LAW, coverage / INTERVAL_U
        low = np.where(drawn, dataset.bsdf + wider * (dataset.low95 - dataset.bsdf), low)
        return low, np.where(drawn, dataset.bsdf + wider * (dataset.high95 - dataset.bsdf), high)


def curve(dataset: Dataset, x: Floats, widest: float = WIDEST_GAP_DEG) -> Curve:
    """The values over `x` (n,): a gap where there is none to be trusted, and where neighbours are far apart."""
    good = dataset.good
    lower, upper = band(dataset)
    order = np.argsort(x[good], kind="stable")
    at, y, low, high = (each[good][order] for each in (x, dataset.bsdf, lower, upper))
    lost = np.setdiff1d(round_deg(x[~good]), round_deg(at))
    gaps = _gaps(at, widest)
    breaks = np.union1d(lost, 0.5 * (at[gaps] + at[gaps + 1]))
    places = np.searchsorted(at, breaks)
    y, low, high = (np.insert(each, places, np.nan) for each in (y, low, high))
    return Curve(np.insert(at, places, breaks), y, low, high, lost)


def _gaps(x: Floats, widest: float = WIDEST_GAP_DEG) -> Ints:
    """The places k of ascending `x` (n,) with a gap between k and k + 1."""
    apart = np.diff(x)
    typical = float(np.median(apart[apart > 0.0])) if (apart > 0.0).any() else math.inf
    return np.flatnonzero(apart > min(max(4.0 * typical, GAP_DEG), widest))


def draw_curve(axes: "Axes", found: Curve, scale: Scale, colour: str, marker: str, label: str, *, broad: bool = False) -> None:
    """Draw a curve with its band on rectangular axes; a `broad` one is seen beneath another."""
    dense = np.isfinite(found.y).sum() > MOST_MARKED
    lost = found.lost_in_noise if scale.log else np.zeros(found.y.size, dtype=bool)
    axes.fill_between(found.x, scale.placed(found.lower), scale.placed(found.upper), color=colour, alpha=0.25, lw=0, zorder=1.5)
    clear = np.where(lost, np.nan, scale.placed(found.y))
    marker = "" if dense or broad else marker
    width, alpha = (4.0, 0.55) if broad else (1.3, 1.0)
    axes.plot(found.x, clear, color=colour, lw=width, alpha=alpha, marker=marker, ms=3.0, label=label, zorder=2.5)
    dots = lost & ~scale.below(found.y)
    axes.plot(found.x[dots], found.y[dots], ".", color=colour, ms=2.5, zorder=2.5)
    below = scale.below(found.y)
    if below.any():
        axes.plot(
            found.x[below],
            np.full(below.sum(), scale.floor),
            "v",
            ms=5,
            mfc="white",
            mec=colour,
            mew=0.9,
            clip_on=False,
            zorder=4,
        )
    if found.untrusted.size:
        axes.plot(
            found.untrusted,
            np.zeros(found.untrusted.size),
            "|",
            ms=6,
            color="0.6",
            zorder=1,
            transform=axes.get_xaxis_transform(),
        )


# ---- choice of values ----


def _one_channel(dataset: Dataset) -> Dataset:
    """The values of the middle wavelength, or of the green colour; all where there is one channel."""
    nm = np.unique(dataset.wavelength_nm[dataset.good & np.isfinite(dataset.wavelength_nm)])
    if nm.size:
        return dataset.select(wavelength_nm=float(nm[nm.size // 2]))
    names = np.unique(dataset.channel[dataset.good]).tolist()
    if len(names) > 1:
        return dataset.select(channel=next((each for each in ("green", "Y") if each in names), names[0]))
    return dataset


def _sides(dataset: Dataset) -> Iterator[tuple[bool, bool, Dataset]]:
    """The values by the lit side and by the side that the light leaves on: whether lit on the back, whether transmitted."""
    for back in (False, True):
        for transmitted in (False, True):
            chosen = (dataset.back == back) & (dataset.transmitted == transmitted)
            if (chosen & dataset.good).any():
                yield back, transmitted, dataset.where(chosen)


def _some(values: Floats, most: int) -> Floats:
    """Distinct values; of more than `most` so many, evenly spread, with the first and the last."""
    there = np.unique(round_deg(values))
    return there if there.size <= most else there[np.unique(np.linspace(0, there.size - 1, most).round().astype(np.int64))]


def _in_plane(dataset: Dataset) -> tuple[Dataset, Floats]:
    """The values in the plane of incidence, and their signed polar angles (n,): positive on the specular side."""
    around = dataset.azimuth_deg - dataset.psi_deg
    out = np.degrees(np.arcsin(np.minimum(np.abs(np.sin(np.radians(dataset.polar_deg)) * np.sin(np.radians(around))), 1.0)))
    in_it = out <= 1e-4
    if not (in_it & dataset.good).any():
        in_it = out <= NEAR_PLANE_DEG
    if not (in_it & dataset.good).any():
        raise UserError(
            f"{dataset.name}: no trusted value is within {NEAR_PLANE_DEG:g} deg of the plane of incidence; draw the hemisphere"
        )
    here = dataset.where(in_it)
    return here, signed_polar(here.polar_deg, around[in_it], SPECULAR_AZIMUTH_DEG)


# ---- pictures ----


def new_figure(width: float, height: float) -> "Figure":
    """An empty figure in inches, with the style of all pictures."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=100, layout="constrained")


def finish(figure: "Figure", dataset: Dataset, about: str = "") -> "Figure":
    """The figure with its title, and the mark of simulated values."""
    psi = np.unique(dataset.psi_deg[dataset.sigma_deg > 0.0])
    more = [_channel_words(dataset), f"psi {psi[0]:g} deg" if psi.size == 1 and psi[0] else "", about]
    after = "".join(f"; {each}" for each in more if each)
    sample = f", {dataset.sample}" if dataset.sample and dataset.sample != dataset.name else ""
    width = LETTERS_AN_INCH * (figure.get_figwidth() - (1.4 if dataset.simulated else 0.2))
    title = f"{shortened(f'{dataset.name}{sample}', round(width) - len(after))}{after}"
    figure.suptitle(title, x=0.01, ha="left", fontsize=10.5)
    mark(figure, dataset.simulated)
    return figure


def mark(figure: "Figure", simulated: bool) -> None:
    """The mark of simulated values, at the upper right."""
    if simulated:
        figure.text(0.99, 0.99, SIMULATED, ha="right", va="top", color=SIMULATED_COLOUR, weight="bold", fontsize=11)


def shortened(text: str, letters: int) -> str:
    """A text of at most so many letters, but 20: its beginning and its end."""
    most = max(letters, 20)
    return text if len(text) <= most else f"{text[: most // 2 - 2]} ... {text[3 - (most - most // 2) :]}"


def _channel_words(dataset: Dataset) -> str:
    nm = np.unique(dataset.wavelength_nm[np.isfinite(dataset.wavelength_nm)])
    names = [each for each in np.unique(dataset.channel).tolist() if each]
    if nm.size == 1:
        return f"{nm[0]:g} nm"
    return names[0] if len(names) == 1 else ""


def quantity(transmitted: bool, back: bool) -> str:
    """The name of the values of one side, for an axis."""
    name = "BTDF" if transmitted else "BRDF"
    return f"{name}{' of the back' if back else ''}, 1/sr"


def tidy(axes: "Axes") -> None:
    """Axes without a frame at top and right, with a faint grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.9", lw=0.6)
    axes.set_axisbelow(True)


def set_scale(axes: "Axes", scale: Scale) -> None:
    """A vertical axis with a scale; a linear one has its zero, and negative values where there are some."""
    if scale.log:
        axes.set_yscale("log")
        axes.set_ylim(scale.floor, 10.0 ** math.ceil(math.log10(1.05 * scale.top)))
    else:
        low, high = axes.get_ylim()
        axes.set_ylim(min(low, 0.0), max(high, 1.08 * scale.top))


def _cuts(dataset: Dataset, log: bool | None) -> "Figure":
    sides = list(_sides(dataset))
    figure = new_figure(8.0, 1.0 + 3.8 * len(sides))
    panels = figure.subplots(len(sides), 1, squeeze=False)[:, 0]
    for axes, (back, transmitted, here) in zip(panels, sides, strict=True):
        plane, x = _in_plane(here)
        scale = scale_of(plane.bsdf[plane.good], plane.u[plane.good], log)
        there = np.unique(plane.sigma_deg[plane.good])
        shown = _some(there, MOST_CURVES)
        for k, sigma in enumerate(shown.tolist()):
            at = np.abs(plane.sigma_deg - sigma) < 1e-5
            colour = COLOURS[k % len(COLOURS)]
            draw_curve(axes, curve(plane.where(at), x[at]), scale, colour, MARKERS[k % len(MARKERS)], f"sigma {sigma:g} deg")
            axes.axvline(sigma, color=colour, lw=0.8, ls=":", zorder=1)
        drawn = plane.where(np.isin(round_deg(plane.sigma_deg), shown))
        set_scale(axes, scale)
        axes.set_ylabel(quantity(transmitted, back))
        direct = "direction straight through" if transmitted else "specular direction"
        axes.set_xlabel(f"polar angle in the plane of incidence, deg; positive and dotted: the {direct}")
        axes.set_xlim(-90.0, 90.0)
        axes.set_xticks(range(-90, 91, 15))
        tidy(axes)
        some = f" ({shown.size} of {there.size} incidences)" if shown.size < there.size else ""
        _legend(axes, about_curves([drawn], scale, some))
    return finish(figure, dataset)


def _legend(axes: "Axes", title: str) -> None:
    """The names of the curves above the axes, where they hide nothing."""
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=3,
        frameon=False,
        fontsize=9,
        title=fill(title, MOST_LETTERS),
        title_fontsize=9,
        alignment="left",
        borderaxespad=0.2,
    )


def about_curves(drawn: Sequence[Dataset], scale: Scale, more: str = "", *, below: str = "below the scale (triangles)") -> str:
    """What bands and marks are, for the top of a legend; of the values that are drawn."""
    values, u = (np.concatenate([getattr(each, name)[each.good] for each in drawn]) for name in ("bsdf", "u"))
    parts = [f"{'bands: k = 2' if np.isfinite(u).any() else 'no uncertainties'}{more}"]
    if low := int(scale.below(values).sum()):
        negative = int((values <= 0.0).sum())
        parts.append(f"{low} of {values.size} values are {below}{f', {negative} of them not above 0' if negative else ''}")
    return "; ".join(parts)


def _hemisphere(dataset: Dataset, log: bool | None) -> "Figure":
    good = dataset.good
    scale = scale_of(dataset.bsdf[good], dataset.u[good], log)
    maps = [
        (back, transmitted, sigma, here.where(np.abs(here.sigma_deg - sigma) < 1e-5))
        for back, transmitted, here in _sides(dataset)
        for sigma in np.unique(here.sigma_deg[here.good]).tolist()
    ]
    shown = [maps[k] for k in _spread(len(maps), MOST_MAPS)]
    columns = min(3, len(shown))
    rows = math.ceil(len(shown) / columns)
    figure = new_figure(1.2 + 3.4 * columns, 0.9 + 3.6 * rows)
    panels = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    norm = _norm(scale, dataset.bsdf[good])
    for axes, (back, transmitted, sigma, here) in zip(panels, shown, strict=False):
        around = here.azimuth_deg - here.psi_deg
        at = Directions.of(sigma, here.polar_deg, around, here.only.values.isotropic)
        _draw_map(axes, at, here.good, scale.placed(here.bsdf), norm, "viridis")
        axes.set_title(f"sigma {sigma:g} deg{', transmitted' if transmitted else ''}{', back' if back else ''}", fontsize=10)
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    _colour_bar(figure, panels, norm, "viridis", "BSDF, 1/sr", extend="min" if scale.log else "neither")
    return finish(figure, dataset, f"{len(shown)} of {len(maps)} incidences" if len(shown) < len(maps) else "")


def _norm(scale: Scale, values: Floats) -> "Normalize":
    from matplotlib.colors import LogNorm, Normalize

    if scale.log:
        return LogNorm(scale.floor, scale.top)
    return Normalize(float(min(values.min(), 0.0)), float(values.max()) or 1.0)


def _colour_bar(figure: "Figure", panels: Sequence["Axes"], norm: "Normalize", colours: str, label: str, extend: str) -> None:
    from matplotlib.cm import ScalarMappable

    bar = ScalarMappable(norm, colours)
    figure.colorbar(bar, ax=list(panels), label=label, extend=extend, shrink=0.8, aspect=30, panchor=False)


ON_AXIS = 1e-6
"""Sine of the azimuth of a direction in the plane of incidence, at most."""


@dataclass(frozen=True)
class Directions:
    """Directions (n,) of one light for a map: polar angle, azimuth from the light's; whether the other half is its image."""

    sigma_deg: float
    polar_deg: Floats
    around_deg: Floats
    mirrored: bool

    @classmethod
    def of(cls, sigma: float, polar_deg: Floats, around_deg: Floats, isotropic: bool) -> "Directions":
        """Of an isotropic sample the half that was not measured is drawn as the image of the other."""
        side = np.sin(np.radians(around_deg))
        return cls(sigma, polar_deg, around_deg, isotropic and bool((side > -ON_AXIS).all() or (side < ON_AXIS).all()))


def _draw_map(axes: "Axes", at: Directions, trusted: Flags, placed: Floats, norm: "Normalize", colours: str) -> None:
    """Draw values (n,) at their directions: the polar angle is the radius, the light comes from the left."""
    from matplotlib.patheffects import withStroke

    around = np.radians(at.around_deg - SPECULAR_AZIMUTH_DEG)
    x, y = at.polar_deg * np.cos(around), at.polar_deg * np.sin(around)
    index: Ints = np.arange(x.size)
    both = np.concatenate([index, index]) if at.mirrored else index
    px, py = (np.concatenate([x, x]), np.concatenate([y, -y])) if at.mirrored else (x, y)
    _draw_surface(axes, px, py, placed[both], trusted[both], norm, colours)
    if index.size <= MOST_DOTS:
        axes.plot(x[trusted], y[trusted], ".", ms=1.0, color="black", alpha=0.35, mew=0, zorder=3)
    if not trusted.all():
        axes.plot(x[~trusted], y[~trusted], "x", ms=2.0, mew=0.5, color="0.55", zorder=3)
    turn = np.linspace(0.0, 2.0 * math.pi, 181)
    for radius in (30.0, 60.0, 90.0):
        axes.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.3" if radius == 90.0 else "0.7", lw=0.7, zorder=4)
        text = axes.text(0.0, -radius, f"{radius:g}", fontsize=7, ha="center", va="bottom", color="black", zorder=5)
        text.set_path_effects([withStroke(linewidth=1.8, foreground="white")])
    axes.plot([-at.sigma_deg], [0.0], marker="*", ms=9, mfc="#ffd400", mec="black", mew=0.6, zorder=6)
    axes.plot([at.sigma_deg], [0.0], marker="+", ms=9, color="#d55e00", mew=1.4, zorder=6)
    axes.set_xlim(-96.0, 96.0)
    axes.set_ylim(-96.0, 96.0)
    axes.set_aspect("equal")
    axes.set_axis_off()


def _draw_surface(axes: "Axes", x: Floats, y: Floats, placed: Floats, trusted: Flags, norm: "Normalize", colours: str) -> None:
    """Colours between directions that are near each other; where they span no area, a mark at each."""
    from matplotlib.tri import Triangulation

    found = None
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


def _polar(dataset: Dataset, log: bool | None) -> "Figure":
    plane, x = _in_plane(dataset)
    there = np.unique(round_deg(plane.sigma_deg[plane.good]))
    shown = _some(there, MOST_CURVES)
    chosen = np.isin(round_deg(plane.sigma_deg), shown)
    plane, x = plane.where(chosen), x[chosen]
    good = plane.good
    scale = scale_of(plane.bsdf[good], plane.u[good], log)
    through = bool((plane.transmitted & good).any())
    figure = new_figure(7.5, 8.0 if through else 4.9)
    figure.set_layout_engine("none")  # it would leave the room of a whole disc to a half one
    place = (0.12, 0.14, 0.76, 0.7125) if through else (0.1, -0.07, 0.8, 1.2245)
    axes: PolarAxes = figure.add_axes(place, projection="polar")  # type: ignore[assignment]  # the stub has Axes
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    outer = 1.08 * float(scale.radius(np.array([scale.top]))[0]) or 1.0
    named: dict[tuple[bool, float], Line2D] = {}
    for back, transmitted, _ in _sides(plane):
        for k, sigma in enumerate(shown.tolist()):
            at = (np.abs(plane.sigma_deg - sigma) < 1e-5) & (plane.back == back) & (plane.transmitted == transmitted)
            if not (at & good).any():
                continue
            found, colour = curve(plane.where(at), x[at]), COLOURS[k % len(COLOURS)]
            angle = np.radians(HALF_TURN_DEG - found.x if transmitted else found.x)
            clear = np.where(found.lost_in_noise & scale.log, np.nan, found.y)
            lower, upper, middle = (scale.radius(each) for each in (found.lower, found.upper, clear))
            axes.fill_between(angle, lower, upper, color=colour, alpha=0.25, lw=0)
            few = np.isfinite(found.y).sum() <= MOST_MARKED
            style, dot = "--" if back else "-", "." if few else ""
            (line,) = axes.plot(angle, middle, style, color=colour, lw=1.4, marker=dot, ms=4.0)
            if not {(False, sigma), (True, sigma)} & set(named):
                axes.annotate(
                    "",
                    (-math.radians(sigma), 0.82 * outer),
                    (-math.radians(sigma), outer),
                    arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.3},
                )
            named.setdefault((back, sigma), line)
    axes.set_rlim(0.0, outer)
    _label_rings(axes, scale, outer)
    if through:
        around = np.arange(0, 360, 30)
        own = np.where(around <= 90, around, np.where(around < 270, 180 - around, around - 360))
        axes.set_thetagrids(around.tolist(), [f"{each}°" for each in own.tolist()])
    else:
        axes.set_thetamin(-90.0)
        axes.set_thetamax(90.0)
    axes.grid(color="0.85", lw=0.6)
    axes.tick_params(labelsize=8)
    some = f" ({shown.size} of {there.size} incidences)" if shown.size < there.size else ""
    below = "transmitted light below; " if through else ""
    title = f"BSDF, 1/sr; {below}arrows: the light; {about_curves([plane], scale, some, below='below the scale')}"
    title = fill(title, MOST_LETTERS)
    names = [f"sigma {sigma:g} deg{' on the back' if back else ''}" for back, sigma in sorted(named)]
    lines = [named[each] for each in sorted(named)]
    figure.legend(
        lines, names, loc="lower left", frameon=False, fontsize=9, ncols=4, title=title, title_fontsize=8.5, alignment="left"
    )
    return finish(figure, dataset)


def _label_rings(axes: "PolarAxes", scale: Scale, outer: float) -> None:
    """Some labels of the circles of a polar diagram, so few that they are apart."""
    from matplotlib.ticker import MaxNLocator

    axes.set_rlabel_position(88)
    if not scale.log:
        axes.yaxis.set_major_locator(MaxNLocator(MOST_RINGS, min_n_ticks=2))
        return
    decades = np.arange(0, math.floor(outer) + 1)
    first = round(math.log10(scale.floor))
    step = math.ceil(decades.size / MOST_RINGS)
    names = [f"$10^{{{k + first}}}$" if (decades[-1] - k) % step == 0 else "" for k in decades.tolist()]
    axes.set_rgrids(decades.tolist(), names)


def _spectrum(dataset: Dataset, log: bool | None) -> "Figure":
    wavelengths = np.unique(dataset.wavelength_nm[dataset.good & np.isfinite(dataset.wavelength_nm)])
    if wavelengths.size < 2:
        has = f"only {wavelengths[0]:g} nm" if wavelengths.size else "no wavelengths"
        raise UserError(f"{dataset.name}: a spectrum needs values at two wavelengths at least, and it has {has}")
    sides = list(_sides(dataset))
    figure = new_figure(8.0, 1.0 + 3.8 * len(sides))
    panels = figure.subplots(len(sides), 1, squeeze=False)[:, 0]
    for axes, (back, transmitted, side) in zip(panels, sides, strict=True):
        sigmas = np.unique(side.sigma_deg[side.good])
        sigma = float(sigmas[sigmas.size // 2])
        here = side.where(np.abs(side.sigma_deg - sigma) < 1e-5)
        scale = scale_of(here.bsdf[here.good], here.u[here.good], log)
        drawn = list(_directions(here))
        for k, chosen in enumerate(drawn):
            label = f"theta {chosen.theta_deg[0]:.3g}, phi {chosen.phi_deg[0]:.3g} deg"
            draw_curve(axes, curve(chosen, chosen.wavelength_nm, math.inf), scale, COLOURS[k], MARKERS[k], label)
        set_scale(axes, scale)
        axes.set_ylabel(quantity(transmitted, back))
        axes.set_xlabel("wavelength, nm")
        tidy(axes)
        _legend(axes, f"sigma {sigma:g} deg; {about_curves(drawn, scale)}")
    return finish(figure, dataset)


def _directions(dataset: Dataset) -> Iterator[Dataset]:
    """The values over the wavelength in the directions nearest to SHOWN_THETA_DEG that have most wavelengths, each once."""
    keys = round_deg(np.stack([dataset.theta_deg, np.where(dataset.theta_deg == 0.0, 0.0, dataset.phi_deg)], axis=1))
    places, which = np.unique(keys, axis=0, return_inverse=True)
    pairs = np.unique(np.stack([which.ravel(), round_deg(dataset.wavelength_nm)], axis=1)[dataset.good], axis=0)
    counts = np.bincount(pairs[:, 0].astype(np.int64), minlength=len(places))
    whole = np.flatnonzero(counts == counts.max())
    taken = dict.fromkeys(int(whole[np.argmin(np.abs(places[whole, 0] - theta))]) for theta in SHOWN_THETA_DEG)
    for each in taken:
        here = dataset.where((which.ravel() == each) & dataset.good)
        yield here.where(np.unique(here.wavelength_nm, return_index=True)[1])


# ---- comparisons ----


def plot_comparison(found: "DatasetComparison", *, log: bool | None = None) -> "Figure":
    """Draw a comparison: profiles of both in the plane of incidence, with bands, and maps of z for some of its lights.

    Where no uncertainty is known, the maps have the relative deviation. Where all directions are in the plane of incidence, z
    is drawn over the angle.
    """
    lights = _pictured(found.lights)
    flat = all(_plane(each).all() for each in lights)
    beside = len(lights) == 1 and not flat
    figure = new_figure(1.0 + 3.9 * max(len(lights), 2), 4.4 if beside else 5.6 if flat else 6.6)
    if beside:
        grid = figure.subplots(1, 2, squeeze=False, width_ratios=(1.25, 1.0)).T
    else:
        grid = figure.subplots(
            2, len(lights), squeeze=False, height_ratios=(1.0, 0.6 if flat else 1.1), sharex="col" if flat else False
        )
    known = any(np.isfinite(each.z).any() for each in lights)
    shades, label = _deviation_scale(lights, known)
    for k, each in enumerate(lights):
        _draw_profiles(grid[0, k], found, each, log)
        deviation = each.z if known else _relative_deviation(each)
        if flat:
            grid[0, k].set_xlabel("")
            _draw_deviations(grid[1, k], each, deviation, label if k == 0 else "", known)
            continue
        isotropic = found.first.only.values.isotropic
        at = Directions.of(each.light.sigma_deg, each.polar_deg, each.azimuth_deg - each.light.psi_deg, isotropic)
        _draw_map(grid[1, k], at, np.isfinite(deviation), np.nan_to_num(deviation), shades, "RdBu_r")
    if not flat:
        _colour_bar(figure, grid[1].tolist(), shades, "RdBu_r", label, "both")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    total = f"{found.relative_rms_percent:.3g} %" if any(each.count for each in found.lights) else "no direction"
    known = any(np.isfinite(u).any() for each in found.lights for u in (each.u_first, each.u_second))
    names = f"{'bands: k = 2' if known else 'no uncertainties'}; formula 5: {total} ({found.range})"
    width = round(LETTERS_AN_INCH * figure.get_figwidth() - (24 if found.simulated else 9))
    short = [shortened(each, width) for each in labels]
    beside_each_other = sum(map(len, short)) + 12 < width
    figure.legend(
        handles,
        short,
        loc="outside upper left",
        ncols=2 if beside_each_other else 1,
        frameon=False,
        fontsize=9,
        title=fill(names, round(1.1 * width)),
        title_fontsize=9,
        alignment="left",
    )
    mark(figure, found.simulated)
    return figure


def _pictured(lights: Sequence["LightComparison"]) -> list["LightComparison"]:
    """Some lights of the middle wavelength; those with few directions, as of a check of the symmetry, are not drawn."""
    waves = sorted({each.light.wavelength_nm for each in lights if not math.isnan(each.light.wavelength_nm)})
    middle = [each for each in lights if not waves or each.light.wavelength_nm == waves[len(waves) // 2]]
    most = max(each.index.size for each in middle)
    kept = [each for each in middle if 4 * each.index.size >= most]
    return [kept[k] for k in _spread(len(kept), MOST_COMPARED)]


def _spread(count: int, most: int) -> list[int]:
    """Indices below `count`; of more than `most` so many, evenly spread."""
    chosen: list[int] = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)).tolist()
    return chosen


def _plane(light: "LightComparison") -> Flags:
    """The directions (n,) in the plane of incidence."""
    around = np.radians(light.azimuth_deg - light.light.psi_deg)
    return np.asarray(np.abs(np.sin(np.radians(light.polar_deg)) * np.sin(around)) < 1e-6)


def _signed(light: "LightComparison") -> Floats:
    return signed_polar(light.polar_deg, light.azimuth_deg - light.light.psi_deg, SPECULAR_AZIMUTH_DEG)


def _relative_deviation(light: "LightComparison") -> Floats:
    """Difference over mean (n,), percent; NaN where the mean is not above zero."""
    mean = 0.5 * (light.first + light.second)
    return 100.0 * (light.first - light.second) / np.where(mean > 0.0, mean, np.nan)


def _deviation_scale(lights: Sequence["LightComparison"], known: bool) -> tuple["Normalize", str]:
    """The colours of z, or of relative deviations: white is none, and the ends are so many u or percent."""
    from matplotlib.colors import Normalize

    if known:
        return Normalize(-LARGEST_Z, LARGEST_Z), "z: first less second, in u"
    sizes = np.concatenate([np.abs(_relative_deviation(each)[each.in_range]) for each in lights])
    sizes = sizes[np.isfinite(sizes)]
    most = float(np.quantile(sizes, 0.98)) if sizes.size else 1.0
    return Normalize(-most or -1.0, most or 1.0), "first less second over their mean, %"


def _draw_profiles(axes: "Axes", found: "DatasetComparison", light: "LightComparison", log: bool | None) -> None:
    """The values of both over the signed polar angle, where there are any in the plane of incidence; else over theta."""
    plane = _plane(light)
    here = np.flatnonzero(plane if plane.any() else np.ones(plane.size, dtype=bool))
    x = _signed(light)[here] if plane.any() else light.theta_deg[here]
    order = np.argsort(x, kind="stable")
    here, x = here[order], x[order]
    both = np.concatenate([light.first[here], light.second[here]])
    scale = scale_of(both, np.concatenate([light.u_first[here], light.u_second[here]]), log)
    pairs = ((found.first, light.first, light.u_first), (found.second, light.second, light.u_second))
    for k, (dataset, values, u) in enumerate(pairs):
        y, margin = values[here], COVERAGE * u[here]
        gaps = _gaps(x) + 1
        name = f"{('first', 'second')[k]}: {dataset.name}{f', {dataset.sample}' if dataset.sample else ''}"
        at, middle, low, high = (np.insert(each, gaps, np.nan) for each in (x, y, y - margin, y + margin))
        if plane.any():
            drawn = Curve(at, middle, low, high, np.zeros(0))
            draw_curve(axes, drawn, scale, COLOURS[k], MARKERS[k], name, broad=k == 0)
        else:  # at one theta there are values of several phi
            axes.plot(x, scale.placed(y), ".", ms=(5.0, 3.0)[k], color=COLOURS[k], label=name)
    set_scale(axes, scale)
    axes.set_title(f"{light.light}\nformula 5: {light.formula_5}", fontsize=9, loc="left")
    if np.ptp(x) < LEAST_WIDTH_DEG:
        axes.set_xlim(float(x.mean()) - 0.5 * LEAST_WIDTH_DEG, float(x.mean()) + 0.5 * LEAST_WIDTH_DEG)
    axes.set_ylabel(quantity(light.light.transmitted, light.light.back))
    axes.set_xlabel("polar angle in the plane of incidence, deg" if plane.any() else "theta, deg")
    tidy(axes)


def _draw_deviations(axes: "Axes", light: "LightComparison", deviation: Floats, label: str, known: bool) -> None:
    """Deviations over the signed polar angle; those outside the range of formula 5 are paler."""
    x = _signed(light)
    axes.axhline(0.0, color="0.5", lw=0.8)
    if known:
        axes.axhspan(-COVERAGE, COVERAGE, color="0.92", lw=0, zorder=0)
    for chosen, shade in ((~light.in_range, "0.65"), (light.in_range, COLOURS[0])):
        axes.plot(x[chosen], deviation[chosen], ".", ms=3.5, color=shade)
    axes.set_title(label, fontsize=9, loc="left")
    axes.set_xlabel("polar angle in the plane of incidence, deg")
    tidy(axes)
