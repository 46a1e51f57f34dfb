"""Pictures: what is drawn where, on logarithmic scales too; each kind from a journal and from made values."""

import math
import warnings
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import imread

import goniotwin
from goniotwin.app.data import kinds
from goniotwin.app.data.comparison import compare
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds import KINDS
from goniotwin.app.data.kinds.choice import curve
from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.data.plotting import plot, plot_comparison
from goniotwin.app.figures.description import Figure as Description
from goniotwin.app.figures.description import Panel, Series
from goniotwin.app.figures.hemisphere import is_half
from goniotwin.app.figures.matplotlib_figure import draw, save_figure
from goniotwin.app.figures.scale import scale_of
from goniotwin.app.figures.style import SIMULATED
from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from tests.app.data.made import gaussian, lambertian, rings
from tests.sizes import some

RINGS, ROUND = np.arange(0.0, 86.0, 5.0), np.arange(0.0, 181.0, 15.0)


def made(*parts: ScatteredBsdf) -> Dataset:
    return dataset_of_file(BsdfFile(parts), "made")


def two_wavelengths(**changes: Any) -> Dataset:
    one = rings(lambertian(0.6), 30.0, RINGS, ROUND, u=0.01)
    return made(*(replace(one, wavelength_nm=np.full(one.size, nm), **changes) for nm in (450.0, 600.0)))


def texts(figure: Figure) -> str:
    found = [each.get_text() for each in figure.texts]
    for axes in figure.axes:
        legend = axes.get_legend()
        found += [axes.get_ylabel(), axes.get_title(), axes.get_title(loc="left")]
        found += [] if legend is None else [legend.get_title().get_text(), *(each.get_text() for each in legend.get_texts())]
    return "\n".join(found)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_a_picture_of_something(kind: Any, tmp_path: Path) -> None:
    figure = plot(two_wavelengths(), kind)
    for suffix in ("png", "svg"):
        save_figure(figure, tmp_path / f"a.{suffix}", 60)
    pixels = imread(tmp_path / "a.png")
    assert pixels[..., :3].std() > 0.02
    assert b"<svg" in (tmp_path / "a.svg").read_bytes()[:1000]
    assert [each.name for each in sorted(tmp_path.iterdir())] == ["a.png", "a.svg"]


def test_the_same_values_give_the_same_file(tmp_path: Path) -> None:
    for name in ("a", "b"):  # without the search for a layout, which takes most of the time
        save_figure(plot(two_wavelengths(), "polar"), tmp_path / f"{name}.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_a_cut_has_the_values_and_a_band_of_two_standard_uncertainties() -> None:
    (axes,) = plot(made(rings(lambertian(0.6), 30.0, RINGS, ROUND, u=0.01))).axes
    x, y = (np.asarray(each, dtype=float) for each in axes.lines[0].get_data())
    assert x.tolist() == [*np.arange(-85.0, 1.0, 5.0), *np.zeros(12), *np.arange(5.0, 86.0, 5.0)]
    np.testing.assert_allclose(y, 0.6 / math.pi)
    band = np.asarray(axes.collections[0].get_paths()[0].vertices, dtype=float)
    assert np.min(band[:, 1]) == pytest.approx(0.98 * 0.6 / math.pi)
    assert np.max(band[:, 1]) == pytest.approx(1.02 * 0.6 / math.pi)


def test_a_logarithmic_scale_has_zeros_and_negative_values_at_its_edge_and_the_curve_does_not_vanish() -> None:
    lobe = rings(gaussian(8.0), 30.0, RINGS, np.array([0.0, 180.0]), u=0.01)
    noise = np.where(lobe.values < 1e-4, np.where(np.arange(lobe.size) % 2, -2e-4, 0.0), lobe.values)
    dataset = made(replace(lobe, values=noise, u=np.full(lobe.size, 1e-4)))
    figure = plot(dataset, log=True)
    (axes,) = figure.axes
    assert axes.get_yscale() == "log"
    low, high = axes.get_ylim()
    assert 1e-6 < low <= 1.001e-3
    assert high > 1.0
    marks = [line for line in axes.lines if line.get_marker() == "v"]
    assert sum(np.size(line.get_xdata()) for line in marks) == int((noise <= 0.0).sum())
    assert all(np.all(np.asarray(line.get_ydata()) == low) for line in marks)
    drawn = np.asarray(axes.lines[0].get_ydata(), dtype=float)
    assert np.nanmax(drawn) == noise.max()
    assert np.nanmin(drawn) >= low
    assert f"{int((noise <= 0.0).sum())} of them not above 0" in texts(figure).replace("\n", " ")
    assert "0 of them not above 0" not in texts(plot(made(lobe), log=True))


@pytest.mark.parametrize("values", [np.zeros(36), np.full(36, -1.0)])
@pytest.mark.parametrize("kind", ["cuts", "hemisphere", "polar"])
def test_values_that_are_all_zero_or_negative_are_drawn_on_a_linear_scale(kind: Any, values: np.ndarray) -> None:
    flat = rings(lambertian(0.6), 30.0, RINGS, np.array([0.0, 180.0]))
    figure = plot(made(replace(flat, values=values)), kind, log=True)
    assert figure.axes[0].get_yscale() != "log"


def test_the_scale_is_logarithmic_where_the_values_span_decades() -> None:
    no_u = np.full(50, np.nan)
    assert not scale_of(np.linspace(0.1, 1.0, 50), no_u, None).log
    found = scale_of(np.geomspace(1e-12, 1.0, 50), no_u, None)
    assert (found.log, found.floor) == (True, 1e-7)
    assert scale_of(np.geomspace(1e-6, 1.0, 50), np.full(50, 3e-3), None).floor == 1e-3


def test_a_curve_has_gaps_where_no_value_is_trusted_and_where_directions_are_far_apart() -> None:
    one = rings(lambertian(0.6), 30.0, np.array([5.0, 10.0, 15.0, 20.0, 60.0, 65.0]), np.array([180.0]))
    dataset = made(replace(one, flags=np.array(["", "", "shadowed", "", "", ""])))
    found = curve(dataset, dataset.polar_deg)
    assert found.x.tolist() == [5.0, 10.0, 15.0, 20.0, 40.0, 60.0, 65.0]
    assert np.isnan(found.y).tolist() == [False, False, True, False, True, False, False]
    assert [(kind, x.tolist()) for kind, x, _ in found.apart] == [("blocked", [15.0])]


@pytest.mark.parametrize("kind", ["cuts", "polar"])
@pytest.mark.parametrize("log", [False, True])
def test_values_below_the_detection_limit_or_u_are_dots_without_the_line(kind: Any, log: bool) -> None:
    one = rings(lambertian(0.6), 30.0, np.arange(10.0, 31.0, 5.0), np.array([180.0]), u=0.01)
    flags, laws = np.array(["", "under-range", "", "", ""]), np.full(5, "logarithmic")
    u = np.where(np.arange(5) == 3, 0.7, 0.01) * one.values
    (axes,) = plot(made(replace(one, flags=flags, u=u, interval=laws)), kind, log=log).axes
    curve, *dots = axes.lines
    assert np.isnan(np.asarray(curve.get_ydata(), dtype=float)).tolist() == [False, True, False, True, False]
    at = np.concatenate([np.asarray(each.get_xdata(), dtype=float) for each in dots if each.get_marker() == "."])
    np.testing.assert_allclose(np.degrees(at) if kind == "polar" else at, [15.0, 25.0])


def test_simulated_values_are_marked_in_every_picture() -> None:
    for kind in KINDS:
        assert SIMULATED in texts(plot(two_wavelengths(generated=True), kind))
        assert SIMULATED not in texts(plot(two_wavelengths(), kind))


@pytest.mark.parametrize("reflected", [False, True])
def test_a_polar_diagram_of_transmitted_light_has_its_legend_and_one_arrow_of_each_light(reflected: bool) -> None:
    through = [
        replace(rings(lambertian(0.3), sigma, RINGS, np.array([0.0, 180.0])), transmitted=np.ones(36, dtype=bool))
        for sigma in (0.0, 40.0)
    ]
    one_side = [rings(lambertian(0.6), 40.0, RINGS, np.array([0.0, 180.0]))] if reflected else []
    figure = plot(made(*through, *one_side), "polar")
    (axes,) = figure.axes
    (legend,) = figure.legends
    assert [each.get_text() for each in legend.get_texts()] == ["sigma 0 deg", "sigma 40 deg"]
    arrows = [each for each in axes.texts if getattr(each, "arrow_patch", None) is not None]
    assert sorted(round(math.degrees(each.xy[0])) for each in arrows) == [-40, 0]  # type: ignore[attr-defined]
    lines = [np.degrees(np.asarray(line.get_xdata(), dtype=float)) for line in axes.lines]
    assert sorted(each.min() >= 90.0 for each in lines) == [False] * reflected + [True, True]  # transmitted light is below


def test_labels_of_a_polar_diagram_are_few() -> None:
    for log, wide in ((False, 5.0), (True, 8.0)):
        figure = plot(made(rings(gaussian(wide), 30.0, RINGS, np.array([0.0, 180.0]))), "polar", log=log)
        figure.draw_without_rendering()
        labels = [each.get_text() for each in figure.axes[0].yaxis.get_ticklabels()]
        assert 2 <= len([each for each in labels if each]) <= 6


def test_a_title_has_a_long_name_in_short_and_the_azimuth_of_the_light() -> None:
    part = two_wavelengths().only.values
    turned = replace(part, psi_deg=np.full(part.size, 90.0), isotropic=False)
    figure = plot(replace(made(turned), name="x" * 300 + ".csv"), "hemisphere", wavelength_nm=450.0)
    title = figure.get_suptitle()
    assert len(title) < 100
    assert title.startswith("xxx")
    assert title.endswith(".csv; 450 nm; psi 90 deg")


def test_the_picture_of_a_journal_is_of_its_sample_and_wavelength(dataset: Dataset) -> None:
    figure = plot(dataset)
    assert f"{dataset.name}, {dataset.sample}; 550 nm" in texts(figure)
    assert "bands: U (k = 2), median" in texts(figure)
    assert "sigma 30 deg" in texts(figure)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "lobe"}, "kind: 'lobe': give one of 'cuts', 'hemisphere', 'polar', 'spectrum'"),
        ({"sigma_deg": 31.0}, "sigma_deg 31: made has no values there; the nearest is 30"),
        ({"kind": "spectrum", "wavelength_nm": 450.0}, "needs values at two wavelengths at least, and it has only 450 nm"),
    ],
)
def test_what_cannot_be_drawn_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(goniotwin.GoniotwinError, match=message):
        plot(two_wavelengths(), **arguments)


def test_directions_beside_the_plane_of_incidence_make_no_cut() -> None:
    with pytest.raises(goniotwin.GoniotwinError, match="no trusted value is within 1 deg of the plane of incidence"):
        plot(made(rings(lambertian(0.6), 30.0, np.array([30.0, 60.0]), np.array([90.0]))))


def test_a_comparison_has_both_profiles_and_a_map_of_z() -> None:
    one, other = (made(rings(lambertian(r), 30.0, RINGS, ROUND, u=0.01)) for r in (0.60, 0.63))
    found = compare(one, other)
    figure = plot_comparison(found)
    profile, z_map = figure.axes[0], figure.axes[1]
    levels = [np.nanmedian(np.asarray(line.get_ydata(), dtype=float)) for line in profile.lines[:2]]
    assert levels == pytest.approx([0.60 / math.pi, 0.63 / math.pi])
    (surface,) = [each for each in z_map.collections if each.get_array() is not None]
    expected = -0.03 / math.hypot(0.006, 0.0063)
    np.testing.assert_allclose(np.asarray(surface.get_array(), dtype=float), expected)
    assert "formula 5: 4.88 %" in texts(figure)


def test_a_comparison_without_uncertainties_has_the_relative_deviation() -> None:
    one, other = (made(rings(lambertian(r), 30.0, RINGS, np.array([0.0, 180.0]))) for r in (0.60, 0.63))
    figure = plot_comparison(compare(one, other))
    below = figure.axes[1]
    assert below.get_title(loc="left") == "first less second over their mean, %"
    assert [(line.get_linestyle(), line.get_marker()) for line in below.lines[:2]] == [("None", ".")] * 2
    np.testing.assert_allclose(np.concatenate([line.get_ydata() for line in below.lines[:2]]), -100.0 * 0.03 / 0.615)


def test_either_half_of_an_isotropic_sample_is_drawn_with_its_image() -> None:
    for start in (0.0, 180.0, -180.0):
        around = start + np.arange(0.0, 181.0, 30.0)
        assert is_half(around)
        assert not is_half(around + 40.0)


def test_a_map_has_no_marks_at_its_measured_directions() -> None:
    """Dots along the measured half planes look like seams, and the mirrored half has none."""
    disc = plot(made(rings(lambertian(0.6), 30.0, RINGS, ROUND)), "hemisphere").axes[0]
    marked = [line for line in disc.lines if line.get_marker() not in ("None", "", None)]
    assert sorted(str(line.get_marker()) for line in marked) == ["*", "+"]  # light and specular direction


def test_the_filled_nodes_of_a_table_have_colour_and_a_dot_and_others_that_are_not_trusted_a_cross() -> None:
    one = rings(lambertian(0.6), 30.0, RINGS, ROUND)
    flags = np.where(one.azimuth_deg > 90.0, "filled", "")
    flags[1] = "dead"
    disc = plot(made(replace(one, flags=flags)), "hemisphere").axes[0]
    marks = {str(line.get_marker()): np.size(line.get_xdata()) for line in disc.lines}
    assert (marks["."], marks["x"]) == ((flags == "filled").sum(), 1)
    (surface,) = [each for each in disc.collections if each.get_array() is not None]
    assert np.asarray(surface.get_array()).size > 1.5 * one.size  # with the mirrored half
    assert f"{100.0 * (flags == 'filled').mean():.0f} % of nodes filled (dots)" in disc.get_title().replace("\n", " ")


def test_normal_incidence_is_drawn_whatever_its_azimuth() -> None:
    polar, around = np.arange(0.0, 90.0, 10.0), np.arange(0.0, 360.0, 30.0)
    oblique, normal = (rings(lambertian(0.5), sigma, polar, around, isotropic=False) for sigma in (20.0, 0.0))
    turned = replace(normal, psi_deg=normal.psi_deg + 180.0)
    figure = plot(dataset_of_file(BsdfFile((oblique, turned)), "made"), "hemisphere")
    assert sum("sigma" in axes.get_title() for axes in figure.axes) == 2


def test_a_picture_is_drawn_on_given_axes() -> None:
    own = Figure()
    left, right = own.subplots(1, 2)
    dataset = two_wavelengths(generated=True)
    assert plot(dataset, "spectrum", ax=left) is own
    assert plot(dataset, ax=[right]) is own
    assert [axes.get_xlabel().replace("\n", " ").partition(",")[0] for axes in (left, right)] == [
        "wavelength",
        "polar angle in the plane of incidence",
    ]
    for axes in (left, right):
        assert SIMULATED in [each.get_text() for each in axes.texts]
    parts: Any = Figure().subfigures(1, 2)
    part = parts[0]
    assert plot(dataset, "polar", ax=part.subplots(subplot_kw={"projection": "polar"})) is part.figure
    both = [rings(lambertian(0.5), sigma, RINGS, ROUND) for sigma in (20.0, 50.0)]
    two = Figure().subplots(1, 2)
    figure = plot(made(*both), "hemisphere", ax=two)
    assert [axes.get_title() for axes in two] == [f"sigma {sigma} deg\nno uncertainties" for sigma in (20, 50)]
    assert [axes.get_ylabel() for axes in figure.axes] == ["", "", "BRDF, 1/sr"]  # one bar for both


def test_axes_that_do_not_fit_are_refused() -> None:
    one, dataset = Figure().subplots(), two_wavelengths()
    two: Any = Figure().subplots(1, 2)
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"ax": two}, "ax: 2 axes are given, and this picture has 1 panels: give a list of 1 axes"),
        ({"kind": "polar", "ax": one}, "ax: the projection is 'rectilinear', and this picture needs 'polar'"),
        ({"ax": Figure().subplots(subplot_kw={"projection": "polar"})}, "this picture needs 'rectilinear'"),
        ({"ax": "left"}, "ax: give matplotlib axes, or a list of them"),
    )
    for arguments, message in wrong:
        with pytest.raises(goniotwin.GoniotwinError, match=message):
            plot(dataset, **arguments)


def test_a_comparison_is_drawn_by_plot_on_its_own_figure_or_on_given_axes() -> None:
    one, other = (made(rings(lambertian(r), 30.0, RINGS, ROUND, u=0.01)) for r in (0.60, 0.63))
    found = compare(one, other)
    assert texts(plot(found)) == texts(plot_comparison(found))
    axes = Figure().subplots(1, 2)
    figure = plot(found, log=True, ax=axes)
    assert axes[0].get_yscale() == "log"
    assert len(axes[0].get_legend().get_texts()) == 2
    assert figure.axes[-1].get_ylabel() == "z: first less second, in u"
    others: tuple[dict[str, Any], ...] = {"kind": "polar"}, {"sigma_deg": 30.0}
    for arguments in others:
        with pytest.raises(goniotwin.GoniotwinError, match="a comparison has one kind of picture"):
            plot(found, **arguments)
    with pytest.raises(goniotwin.GoniotwinError, match="this picture has 2 panels"):
        plot(found, ax=axes[0])


def test_values_that_are_not_to_be_trusted_have_grey_marks_at_their_place() -> None:
    one = rings(lambertian(0.6), 30.0, np.array([5.0, 10.0, 15.0, 20.0]), np.array([180.0]))
    flags = np.array(["", "shadowed", "monitor", ""])
    (axes,) = plot(made(replace(one, flags=flags, values=np.array([0.2, 0.1, np.nan, 0.2])))).axes
    marks = {
        line.get_marker(): np.asarray(line.get_data(), dtype=float) for line in axes.lines if str(line.get_marker()) in "ox"
    }
    assert marks["o"].tolist() == [[10.0], [0.1]]
    assert marks["x"].tolist() == [[15.0], [axes.get_ylim()[0]]]


def test_the_marks_in_a_picture_have_a_key() -> None:
    one = rings(lambertian(0.6), 30.0, np.arange(5.0, 31.0, 5.0), np.array([180.0]), u=0.01)
    flags = np.array(["", "shadowed clipped", "clipped", "under-range", "", ""])
    dim = replace(one, flags=flags, values=np.array([0.2, 0.1, np.nan, 1e-3, -1.0, 0.2]))
    named = [
        "below detection limit or U",
        "below the scale",
        "blocked by the mirror unit",
        "saturated at every gain",
    ]
    assert texts(plot(made(dim), log=True)).splitlines()[-5:] == ["sigma 30 deg", *named]
    assert named[0] in [each.get_text() for each in plot(made(dim), "polar", log=True).legends[0].get_texts()]
    assert not any(each in texts(plot(made(one))) for each in named)
    compared = plot(compare(made(one), made(replace(one, u=2.0 * one.values))))
    assert named[0] in [each.get_text() for each in compared.legends[0].get_texts()]


def lights(*sigma_deg: float, reflectance: float = 0.6, transmitted: bool = False, width_deg: float = math.inf) -> Dataset:
    """Simulated values: a lobe of a width in each of some incidences, or the same values in all directions."""
    model = lambertian(reflectance) if math.isinf(width_deg) else gaussian(width_deg)
    parts = [rings(model, sigma, RINGS, ROUND, u=0.01) for sigma in sigma_deg]
    return made(
        *(
            replace(
                each,
                generated=True,
                transmitted=np.full(each.size, transmitted),
                values=np.where(each.values > 1e-6, each.values, -1e-6),
            )
            for each in parts
        )
    )


def words(axes: Axes) -> list[Artist]:
    """The title, the legend and the mark of simulated values."""
    texts = [axes.title, axes._left_title, *axes.texts]  # type: ignore[attr-defined]
    legend = axes.get_legend()
    found = [each for each in texts if each.get_text().strip() and "°" not in each.get_text()]  # no labels of rings
    return found if legend is None else [*found, legend]


@pytest.mark.parametrize(
    ("kind", "layout"),
    [
        *some(((kind, None) for kind in ("cuts", "hemisphere", "two sides", "polar", "comparison")), 2),
        *some((kind, "constrained") for kind in ("comparison", "cuts", "two sides", "polar", "hemisphere")),
        *some(((kind, "tight") for kind in ("cuts", "polar")), 0),  # which has no place for a bar of several axes
    ],
)
def test_words_on_given_axes_of_the_usual_size_overlap_nothing_and_are_in_the_figure(kind: str, layout: Any) -> None:
    own, sigma = Figure(layout=layout), (0.0, 30.0, 60.0)
    shape: dict[str, Any] = {"hemisphere": {"ncols": 3}, "two sides": {"nrows": 2}, "comparison": {"nrows": 2, "ncols": 3}}.get(
        kind, {}
    )
    axes: Any = own.subplots(**shape, subplot_kw={"projection": "polar"} if kind == "polar" else {})
    if kind == "comparison":
        plot(compare(lights(*sigma), lights(*sigma, reflectance=0.63)), ax=axes)
    else:
        many = sigma if kind == "hemisphere" else (*sigma, 15.0, 45.0)
        sides = (False, True) if kind in ("polar", "two sides") else (False,)
        shown = made(*(lights(*many, width_deg=8.0, transmitted=each).only.values for each in sides))
        plot(shown, "cuts" if kind == "two sides" else kind, ax=axes)
    own.draw_without_rendering()
    panels: list[Axes] = list(own.axes)
    written = [each for panel in panels for each in words(panel)]
    assert sum(getattr(each, "get_text", str)() == SIMULATED for each in written) == 1
    assert any(hasattr(each, "get_texts") for each in written) == (kind != "hemisphere")
    labels = [each for panel in panels for each in (panel.xaxis.label, panel.yaxis.label) if each.get_text()]
    placed = [each.get_window_extent() for each in (*written, *labels)]
    drawn = [panel.patch.get_window_extent() for panel in panels]
    for one, other in combinations([*placed, *drawn], 2):
        shared = min(one.x1, other.x1) - max(one.x0, other.x0), min(one.y1, other.y1) - max(one.y0, other.y0)
        assert min(shared) < 1.0, (one, other)
    for each in placed:
        assert each.x0 >= -0.5
        assert each.y0 >= -0.5
        assert each.x1 <= own.bbox.x1 + 0.5
        assert each.y1 <= own.bbox.y1 + 0.5
    for panel in panels:
        texts_of_ticks = [each.get_window_extent() for each in panel.get_xticklabels() if each.get_text() and panel.axison]
        if panel.name == "rectilinear":
            assert all(left.x1 + 3.0 < right.x0 for left, right in pairwise(texts_of_ticks))
    assert min(each.height for each in drawn) > 40.0


def test_a_heading_without_named_series_is_drawn_without_a_warning() -> None:
    for own in (None, Figure().subplots()):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            figure = draw(Description((Panel(legend="no values"),), (4.0, 3.0)), own)
        assert "no values" in texts(figure)


def test_a_polar_diagram_names_the_quantity_of_its_side() -> None:
    back, through = lights(30.0), lights(30.0, transmitted=True)
    both = made(back.only.values, through.only.values)
    for dataset, name in ((back, "BRDF, 1/sr"), (through, "BTDF, 1/sr"), (both, "BSDF, 1/sr")):
        (legend,) = plot(dataset, "polar").legends
        assert legend.get_title().get_text().startswith(f"{name};")


def test_a_comparison_has_the_abscissa_of_cuts() -> None:
    cut = plot(lights(30.0)).axes[0]
    for round_deg in (ROUND, np.array([0.0, 180.0])):
        one, other = (made(rings(lambertian(r), 30.0, np.arange(0.0, 41.0, 5.0), round_deg)) for r in (0.60, 0.63))
        axes = plot(compare(one, other)).axes
        across = [each for each in axes if each.get_xlim() != (0.0, 1.0) and each.axison and not each.get_label()]
        shown = [
            each for each in across if each.get_ylabel().startswith("BRDF") or "over their mean" in each.get_title(loc="left")
        ]
        assert len(shown) == (1 if round_deg is ROUND else 2)
        for each in shown:
            assert each.get_xlim() == cut.get_xlim() == (-90.0, 90.0)
            assert each.get_xticks().tolist() == cut.get_xticks().tolist()
        assert shown[-1].get_xlabel().replace("\n", " ") == cut.get_xlabel()
        assert "positive: specular side" in cut.get_xlabel()


def test_ticks_of_the_angle_have_a_text_at_the_normal_and_both_ends_where_they_have_room() -> None:
    for width, step in ((2.0, 90), (6.4, 30), (14.0, 10)):
        own = Figure(figsize=(width, 4.0))
        plot(lights(30.0), ax=own.subplots())
        own.draw_without_rendering()
        texts_there = [
            each.get_text().replace("\N{MINUS SIGN}", "-") for each in own.axes[0].get_xticklabels() if each.get_text()
        ]
        assert list(map(float, texts_there)) == list(range(-90, 91, step))
        assert own.axes[0].format_xdata(12.34) == "12.3"  # of the pointer


def test_bars_are_lines_at_the_points() -> None:
    x, y = np.array([0.0, 1.0]), np.array([1.0, 2.0])
    bars = Series(x, y, "points", lower=y - 0.5, upper=y + 0.25, bars=True)
    (lines,) = draw(Description((Panel(series=(bars,)),), (4.0, 3.0))).axes[0].collections
    ends = [path.vertices.tolist() for path in lines.get_paths()]  # type: ignore[union-attr]
    assert ends == [[[0.0, 0.5], [0.0, 1.25]], [[1.0, 1.5], [1.0, 2.25]]]


def test_each_file_beside_the_kinds_is_named() -> None:
    files = {each.stem for each in Path(str(kinds.__file__)).parent.glob("*.py")} - {"__init__"}
    assert {each for each in files if f"`{each}`" not in str(kinds.__doc__)} == set(KINDS)
