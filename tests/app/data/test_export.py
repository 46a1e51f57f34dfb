"""Export: interpolation to specular coordinates, .ddr and CSV files."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import goniotwin
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.components import interval, mostly_added
from goniotwin.app.campaign.reduction.overlaps import overlaps
from goniotwin.app.campaign.reduction.points import FLAGS, BsdfPoints
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset
from goniotwin.app.cli.main import app
from goniotwin.app.data import conversion
from goniotwin.app.data.conversion import format_to_write
from goniotwin.app.data.export import scattered_of, scattered_points
from goniotwin.app.data.opening import sample_of_points
from goniotwin.app.errors import UserError
from goniotwin.app.formats import read_ddr, read_points_csv, read_zemax, registry, writing
from goniotwin.app.formats.content import FILLED, ISOTROPIC, UNTRUSTED
from goniotwin.app.formats.gridding import grid_table
from goniotwin.app.formats.specular_grid import SpecularCut
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.samples import parse_sample
from goniotwin.twin.optics import arc_direction, evaluate, from_specular, light_direction
from tests.app.campaign.reduction.made_points import made_points
from tests.app.data.exporting import export
from tests.conftest import RIG, SMALL, Writer
from tests.system.command import invoke


def points_of(sigma: float, zenith: np.ndarray, azimuth: np.ndarray, blocked: np.ndarray | None = None) -> BsdfPoints:
    """Points of a BSDF that is smooth over the sphere, 1/sr; see `smooth`."""
    zenith, azimuth = (each.ravel() for each in np.broadcast_arrays(zenith, azimuth))
    flags = None if blocked is None else {"shadowed": blocked.ravel()}
    return made_points(sigma, zenith, azimuth, smooth(zenith, azimuth), 0.01, flags)


def smooth(zenith: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Smooth over the sphere, also at the normal, and symmetric about the plane of incidence."""
    polar = np.radians(zenith)
    return np.asarray(2.0 - np.cos(polar) - np.sin(polar) * np.cos(np.radians(azimuth)))


def regrid(points: BsdfPoints) -> tuple[tuple[np.ndarray, np.ndarray], SpecularCut]:
    """phi and theta of the table of points at one sigma, and the cut there."""
    table = grid_table(scattered_points(points, "paper", isotropic=True, generated=False))
    at = table.sigma_deg.tolist().index(points.sigma_deg[0])
    assert table.u is not None
    assert table.known is not None
    return (table.phi_deg, table.theta_deg), SpecularCut(*(each[0, 0, at] for each in (table.values, table.u, table.known)))


@settings(deadline=None)
@given(st.floats(0.0, 80.0), st.integers(0, 36), st.floats(0.0, 80.0))
def test_the_grid_reproduces_the_measured_bsdf(sigma: float, column: int, theta: float) -> None:
    points = points_of(sigma, np.arange(0.0, 90.1, 2.5)[:, None], np.arange(0.0, 180.1, 3.0)[None, :])
    (phi_deg, theta_deg), cut = regrid(points)
    node = int(np.argmin(np.abs(theta_deg - theta)))
    direction = from_specular(sigma, theta_deg[node], phi_deg[column])
    zenith = math.degrees(math.acos(min(1.0, max(-1.0, float(direction[2])))))
    azimuth = math.degrees(math.atan2(float(direction[1]), float(direction[0])))
    if zenith > 90.0:
        assert not cut.known[column, node]
    else:
        assert cut.known[column, node]
        assert cut.values[column, node] == pytest.approx(float(smooth(np.array(zenith), np.array(azimuth))), rel=2e-3)


def test_measurements_in_the_plane_of_incidence_give_two_columns() -> None:
    (phi_deg, theta_deg), cut = regrid(points_of(30.0, np.arange(0.0, 89.6, 0.5)[:, None], np.array([[0.0, 180.0]])))
    assert phi_deg.tolist() == [0.0, 180.0]
    assert theta_deg[1] == 0.5
    assert cut.known[1].sum() == 120  # from the specular direction at 30 deg to 89.5 deg, in half degrees
    assert cut.known[0].sum() == 240  # over the normal, and down to 89.5 deg on the light's side


def test_there_is_no_interpolation_between_distant_azimuths() -> None:
    points = points_of(30.0, np.arange(0.0, 89.6, 0.5)[:, None], np.array([0.0, 90.0, 180.0])[None, :])
    (phi_deg, theta_deg), cut = regrid(points)
    sideways = cut.known[phi_deg == 90.0][0]
    assert not sideways[theta_deg > 1.0][:50].any()
    assert cut.known[0, theta_deg <= 119.0].all()  # in the plane of incidence nothing changes


def test_blocked_nodes_are_not_marked_as_measured() -> None:
    zenith, azimuth = np.arange(0.0, 89.6, 0.5)[:, None], np.array([0.0, 180.0])[None, :]
    blocked = np.broadcast_to(zenith <= 3.5, (zenith.size, 2))
    (_, theta_deg), cut = regrid(points_of(0.0, zenith, azimuth, blocked))
    assert not cut.known[:, theta_deg <= 3.5].any()
    assert np.isfinite(cut.values).all()
    assert np.array_equal(cut.u[~cut.known], cut.values[~cut.known])  # nothing is known of them
    np.testing.assert_allclose(cut.u[cut.known], 0.01, rtol=1e-12)  # each of these nodes is a measured direction


def test_between_directions_noise_is_averaged_and_the_certificate_is_not() -> None:
    points = points_of(30.0, np.arange(0.0, 89.6, 1.0)[:, None], np.arange(0.0, 180.1, 1.0)[None, :])
    for name, largest, smallest in (("noise", 0.011, 0.002), ("certificate", 0.0101, 0.0099)):
        each = replace(points, own={name: np.full(points.bsdf.size, 0.01**2)})
        (phi_deg, _), cut = regrid(each)
        sideways = cut.u[phi_deg == 90.0][0, 5:30]  # no node of these is a measured direction
        assert np.all((sideways > smallest) & (sideways < largest)), name
        assert (sideways.min() < 0.008) == (name == "noise")


@pytest.mark.parametrize("name", ["certificate", "field", "calibration", "monitor", "gain", "signature", "dark", "further"])
def test_interpolation_averages_no_error_that_neighbouring_directions_share(name: str) -> None:
    points = points_of(30.0, np.arange(0.0, 89.6, 1.0)[:, None], np.arange(0.0, 180.1, 1.0)[None, :])
    _, cut = regrid(replace(points, own={name: (0.02 * points.bsdf) ** 2}))
    np.testing.assert_allclose(cut.u[cut.known], 0.02 * cut.values[cut.known], rtol=1e-9)


def test_a_grid_without_any_value_is_refused() -> None:
    zenith = np.arange(0.0, 80.0, 5.0)
    points = points_of(0.0, zenith, np.zeros(zenith.size), np.ones(zenith.size, dtype=bool))
    with pytest.raises(ValueError, match="no direction"):
        regrid(points)


@pytest.fixture
def reduced() -> BsdfDataset:
    zenith, azimuth = np.arange(0.0, 89.6, 0.5)[:, None], np.array([0.0, 180.0])[None, :]
    points = points_of(30.0, zenith, azimuth, np.broadcast_to((zenith > 26.0) & (zenith < 34.0) & (azimuth == 0.0), (180, 2)))
    return BsdfDataset("test", read_rig(RIG), True, {"gaussian-5": points}, {"gaussian-5": overlaps(points, 0.0)}, ("a note",))


def test_a_ddr_marks_simulated_data_and_continued_nodes(reduced: BsdfDataset, tmp_path: Path) -> None:
    exported = export(reduced, None, tmp_path / "a.ddr", "ddr")
    table = read_ddr(tmp_path / "a.ddr")
    text = "\n".join(table.comments)
    assert "SIMULATED" in text
    assert "sigma 30, phi 0: theta 56.5 to 63.5" in text
    assert table.sigma_deg.tolist() == [0.0, 30.0, 90.0]  # repeated at the ends, because readers extrapolate
    assert table.channels == (550.0,)
    assert exported.values == 120 + 240 - 15
    assert exported.files == (tmp_path / "a.ddr", tmp_path / "a.u.ddr", tmp_path / "a.mask.ddr")
    assert sorted(tmp_path.iterdir()) == sorted(exported.files)
    uncertainty = read_ddr(tmp_path / "a.u.ddr")
    assert any("standard uncertainties of the values in a.ddr" in line for line in uncertainty.comments)
    node = int(np.searchsorted(table.theta_deg, 10.0))
    assert table.values[0, 0, 1, 1, node] == pytest.approx(math.pi * float(smooth(np.array(40.0), np.array(180.0))))
    assert uncertainty.values[0, 0, 1, 1, node] == pytest.approx(math.pi * 0.01)
    for name in ("sigma_deg", "phi_deg", "theta_deg"):
        assert np.array_equal(getattr(uncertainty, name), getattr(table, name))
    # Where nothing was measured the uncertainty is the value: repeated at sigma 0 and 90, continued at the blocked nodes.
    np.testing.assert_array_equal(uncertainty.values[0, 0, [0, 2]], table.values[0, 0, [0, 2]])
    blocked = slice(*np.searchsorted(table.theta_deg, [56.5, 63.6]))
    np.testing.assert_array_equal(uncertainty.values[0, 0, 1, 0, blocked], table.values[0, 0, 1, 0, blocked])
    mask = registry.read(tmp_path / "a.mask.ddr").only_table().values
    np.testing.assert_allclose(mask[0, 0, [0, 2]], 1.0, rtol=1e-8)
    np.testing.assert_allclose(mask[0, 0, 1, 0, blocked], 1.0, rtol=1e-8)
    assert mask[0, 0, 1, 1, node] == 0.0


def test_a_csv_has_every_point(reduced: BsdfDataset, tmp_path: Path) -> None:
    assert export(reduced, None, tmp_path / "a.csv", "csv").values == 360
    points = read_points_csv(tmp_path / "a.csv")
    assert any("SIMULATED" in comment for comment in points.comments)
    assert len(points.columns["bsdf_per_sr"]) == 360
    assert list(np.unique(points.columns["flags"])) == ["", "shadowed"]


def test_a_csv_states_the_rule_of_the_intervals(reduced: BsdfDataset, tmp_path: Path) -> None:
    """By it a reader gets those of `interval`."""
    export(reduced, None, tmp_path / "a.csv", "csv")
    (rule,) = (each for each in read_points_csv(tmp_path / "a.csv").comments if each.startswith("an interval"))
    threshold = float(rule.partition("above ")[2].partition(" %")[0]) / 100.0
    added = rule.partition("all components but ")[2].partition(")")[0].split(", ")
    u, one = np.array([0.99, 1.01]) * threshold, np.ones(2)
    for names, logarithms in ((["pose"], [False, True]), *(([name], [False, False]) for name in added)):
        ends = interval(one, u, mostly_added(dict.fromkeys(names, u**2)), 1.0, 1.0)
        for end, sign in zip(ends, (-1.0, 1.0), strict=True):
            assert end == pytest.approx(np.where(logarithms, np.exp(sign * u), 1.0 + sign * u), rel=1e-12)


def test_a_csv_has_the_interval_of_each_value_and_every_format_of_points_keeps_it(reduced: BsdfDataset, tmp_path: Path) -> None:
    """By the formulas of the rule: 1.96 u to either side, or a factor exp(1.96 u / value) where large shares are most of u."""
    ((name, points),) = reduced.samples.items()
    share = np.where(points.zenith_deg > 20.0, 0.3, 0.01)
    pose = (share * points.bsdf) ** 2
    of_journal = replace(reduced, samples={name: replace(points, own={"noise": 0.1 * pose, "pose": pose})})
    export(of_journal, None, tmp_path / "a.csv", "csv")
    columns = read_points_csv(tmp_path / "a.csv").columns
    value, u, steep = columns["bsdf_per_sr"], columns["u_bsdf_per_sr"], points.zenith_deg > 20.0
    has = np.isfinite(value)
    assert np.array_equal(columns["interval"][has], np.where(steep, "logarithmic", "linear")[has])
    assert np.array_equal(columns["interval"] == "", ~has)
    for column, sign in (("low95_per_sr", -1.0), ("high95_per_sr", 1.0)):
        expected = np.where(steep, value * np.exp(sign * 1.96 * u / value), value + sign * 1.96 * u)
        np.testing.assert_allclose(columns[column], expected, rtol=1e-7)
    for path in (tmp_path / "a.csv", tmp_path / "a.h5", tmp_path / "b.csv"):
        if not path.exists():
            writing.write(path, registry.read(tmp_path / "a.csv"), format_to_write(path))
        found = goniotwin.open(path)
        assert found.interval.tolist() == columns["interval"].tolist()
        np.testing.assert_array_equal(found.low95, columns["low95_per_sr"])
        np.testing.assert_array_equal(found.high95, columns["high95_per_sr"])


def test_a_csv_has_the_fields_component_and_a_flag_where_it_is_unknown(reduced: BsdfDataset, tmp_path: Path) -> None:
    ((name, points),) = reduced.samples.items()
    known = points.zenith_deg > 20.0
    partly_known = replace(points, own={**points.own, "field": np.full(360, 0.002**2)})
    partly_known = partly_known.flagged({"field": ~known & points.good})
    export(replace(reduced, samples={name: partly_known}), None, tmp_path / "a.csv", "csv")
    table = read_points_csv(tmp_path / "a.csv")
    assert np.array_equal(table.columns["u_field_per_sr"], partly_known.u_field, equal_nan=True)
    flagged = np.array(["field" in flags.split() for flags in table.columns["flags"]])
    assert np.array_equal(flagged, ~known & points.good)
    assert any("u_field_per_sr" in comment for comment in table.comments)


def test_the_uncertainty_is_never_zero_where_nothing_was_measured(reduced: BsdfDataset, tmp_path: Path) -> None:
    ((name, points),) = reduced.samples.items()
    dark = replace(points, bsdf=np.where(points.zenith_deg > 20.0, 0.0, points.bsdf))  # also around the blocked directions
    export(replace(reduced, samples={name: dark}), None, tmp_path / "a.ddr", "ddr")
    table, uncertainty = read_ddr(tmp_path / "a.ddr"), read_ddr(tmp_path / "a.u.ddr")
    blocked = slice(*np.searchsorted(table.theta_deg, [56.5, 63.6]))
    for at in (0, 1, 2):  # repeated at sigma 0 and 90, continued at sigma 30
        assert not table.values[0, 0, at, 0, blocked].any()
        np.testing.assert_allclose(uncertainty.values[0, 0, at, 0, blocked], math.pi * 0.01, rtol=1e-8)  # that of the points
    assert uncertainty.values.min() > 0.0


def test_an_unknown_sample_is_refused_by_name(reduced: BsdfDataset, tmp_path: Path) -> None:
    for name in ("csv", "ddr"):
        with pytest.raises(UserError, match="no measured sample 'satin'"):
            export(reduced, "satin", tmp_path / "a", name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["ies", "rayset"])
def test_an_unknown_format_is_refused_with_those_that_hold_a_bsdf(name: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=f"format '{name}': there is no such format .*; give ddr, ddt, sdr, sdt, ssdd, zemax"):
        format_to_write(tmp_path / "a.ddr", name)


def test_a_bsdf_file_is_of_zemax_unless_a_format_is_named(tmp_path: Path) -> None:
    assert format_to_write(tmp_path / "a.bsdf").name == "zemax"
    assert format_to_write(tmp_path / "a.bsdf", "csv").name == "csv"


def test_each_flag_that_takes_the_trust_away_is_one_that_values_have() -> None:
    assert {*FLAGS, FILLED, "hidden", "no-hits"} >= UNTRUSTED


def test_what_a_format_does_not_hold_is_refused_with_the_formats_that_do(reduced: BsdfDataset, tmp_path: Path) -> None:
    ((name, points),) = reduced.samples.items()
    colours = BsdfPoints.join([points, replace(points, places=points.places + np.array([100.0, 0.0, 0.0, 0.0, 0.0]))])
    with pytest.raises(
        UserError,
        match=r"the format zemax has one wavelength, .* 650 nm; .* all, or use ddr \(.ddr\), ssdd .* csv \(.csv\)",
    ):
        export(replace(reduced, samples={name: colours}), None, tmp_path / "a.bsdf", "zemax")
    through = replace(points, transmitted=~points.transmitted, zenith_deg=180.0 - points.zenith_deg)
    with pytest.raises(UserError, match=r"the format ddr does not hold transmitted light; use ddt \(.ddt\), ssdd .*, zemax"):
        export(replace(reduced, samples={name: through}), None, tmp_path / "a.ddr", "ddr")
    assert list(tmp_path.iterdir()) == []


def test_a_sample_measured_at_several_gamma_is_a_table_of_four_dimensions(reduced: BsdfDataset, tmp_path: Path) -> None:
    """The light's azimuth in the sample's frame is minus gamma: a quarter turn of the sample is psi 270."""
    ((name, points),) = reduced.samples.items()
    turned = replace(points, places=points.places + np.array([0.0, 90.0, 0.0, 0.0, 0.0]), bsdf=0.5 * points.bsdf)
    both = replace(reduced, samples={name: BsdfPoints.join([points, turned])}, isotropic=False)
    export(both, None, tmp_path / "a.ddr", "ddr")
    export(reduced, None, tmp_path / "b.ddr", "ddr")
    found, one = (registry.read(tmp_path / file).only_table() for file in ("a.ddr", "b.ddr"))
    assert found.psi_deg.tolist() == [0.0, 270.0]
    np.testing.assert_allclose(found.values[:, 0, :, :2], one.values[:, 0], rtol=1e-8)
    np.testing.assert_allclose(found.values[:, 1, :, :2], 0.5 * one.values[:, 0], rtol=1e-8)


def test_the_statement_of_the_schedule_decides_on_symmetry_however_many_gammas_there_are(reduced: BsdfDataset) -> None:
    """At one gamma, too: what `export` writes and `open` gives is folded only where the schedule states an isotropic sample."""
    zenith, azimuth = (each.ravel() for each in np.meshgrid(np.arange(0.0, 10.0, 3.0), np.arange(0.0, 360.0, 15.0)))
    values = 1.0 + 0.1 * np.sin(np.radians(zenith)) * np.sin(np.radians(azimuth))
    points = made_points(0.0, zenith, azimuth, values, 0.01)
    for isotropic in (True, False):
        (part,) = scattered_of(replace(reduced, samples={"a": points}, isotropic=isotropic)).scattered
        table = grid_table(part)
        assert table.phi_deg[-1] == (180.0 if isotropic else 360.0)
        assert (ISOTROPIC in table.comments) == isotropic
        assert any("not isotropic: taken the same at every psi" in line for line in table.comments) == (not isotropic)
        assert sample_of_points(points, "a", isotropic=isotropic, generated=True).values.isotropic == isotropic


def test_transmitted_light_is_a_table_about_the_straight_direction(reduced: BsdfDataset, tmp_path: Path) -> None:
    ((name, points),) = reduced.samples.items()
    through = replace(points, transmitted=~points.transmitted, zenith_deg=180.0 - points.zenith_deg)
    export(reduced, name, tmp_path / "a.ddr", "ddr")
    export(replace(reduced, samples={name: through}), name, tmp_path / "a.ddt", "ddt")
    np.testing.assert_array_equal(read_ddr(tmp_path / "a.ddt").values, read_ddr(tmp_path / "a.ddr").values)


def test_light_is_chosen_where_a_format_holds_either(reduced: BsdfDataset, tmp_path: Path) -> None:
    ((name, points),) = reduced.samples.items()
    through = replace(points, transmitted=~points.transmitted, zenith_deg=180.0 - points.zenith_deg, bsdf=0.5 * points.bsdf)
    both = replace(reduced, samples={name: BsdfPoints.join([points, through])})
    path, form = tmp_path / "a.bsdf", "zemax"
    with pytest.raises(UserError, match=r"there is reflected and transmitted light, .*; choose it with --light"):
        export(both, None, path, form)
    assert list(tmp_path.iterdir()) == []
    export(both, None, path, form, "reflected")
    brdf = read_zemax(path)
    export(both, None, path, form, "transmitted")
    btdf = read_zemax(path)
    assert (brdf.scatter_type, btdf.scatter_type) == ("BRDF", "BTDF")
    np.testing.assert_allclose(btdf.values, 0.5 * brdf.values, rtol=1e-8)
    assert export(both, None, tmp_path / "a.csv", "csv", "transmitted").values == 360
    assert set(read_points_csv(tmp_path / "a.csv").columns["light"].tolist()) == {"transmitted"}
    with pytest.raises(UserError, match=r"the format ddr does not hold transmitted light; use ddt"):
        export(both, None, tmp_path / "a.ddr", "ddr", "transmitted")
    with pytest.raises(UserError, match=r"no transmitted light of any sample has been measured; leave --light out"):
        export(reduced, None, path, form, "transmitted")


def test_what_a_format_does_not_hold_is_refused_before_anything_is_resampled(
    reduced: BsdfDataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ((name, points),) = reduced.samples.items()
    colours = BsdfPoints.join([points, replace(points, places=points.places + np.array([100.0, 0.0, 0.0, 0.0, 0.0]))])

    def resampled(*_: object, **__: object) -> None:
        raise AssertionError("the table was made before it was refused")

    monkeypatch.setattr(conversion, "grid_table", resampled)
    with pytest.raises(UserError, match="the format zemax has one wavelength"):
        export(replace(reduced, samples={name: colours}), None, tmp_path / "a.bsdf", "zemax")


def test_a_file_that_cannot_be_written_is_refused_before_the_reduction(tmp_path: Path) -> None:
    wrong = r"none\.ddr: there is no folder .*sub; make it first"
    with pytest.raises(UserError, match=wrong):  # the journal is not even looked for
        app(
            ["export", str(tmp_path / "no.journal"), "--format", "ddr", "--out", str(tmp_path / "sub" / "none.ddr")],
            standalone_mode=False,
        )


def test_an_exported_table_is_a_sample_also_where_noise_is_below_zero(
    reduced: BsdfDataset, write_rig: Writer, tmp_path: Path
) -> None:
    ((name, points),) = reduced.samples.items()
    noise = replace(points, bsdf=np.where(points.zenith_deg > 80.0, -0.001, points.bsdf))
    export(replace(reduced, samples={name: noise}), None, tmp_path / "a.ddr", "ddr")
    assert read_ddr(tmp_path / "a.ddr").values.min() < 0.0
    text = '[twin.samples.paper]\nmodel = "table"\nfile = "a.ddr"\n\n[twin.samples.etalon]'
    model = read_rig(write_rig(("[twin.samples.etalon]", text))).model()
    assert model is not None
    observers = arc_direction(np.array([40.0, 85.0]), 180.0)
    found = evaluate(model.samples["paper"], light_direction(30.0), observers, 550.0)
    np.testing.assert_allclose(found, [float(smooth(np.array(40.0), np.array(180.0))), 0.0], rtol=1e-7)
    far_below = replace(points, bsdf=np.where(points.zenith_deg > 80.0, -0.5, points.bsdf))
    export(replace(reduced, samples={name: far_below}), None, tmp_path / "a.ddr", "ddr")
    with pytest.raises(UserError, match=r"twin.samples.paper: .*a\.ddr: at 550 nm: values has -0.5.* at sigma 0"):
        read_rig(write_rig(("[twin.samples.etalon]", text))).model()


def test_a_journal_is_not_overwritten(reduced: BsdfDataset, tmp_path: Path) -> None:
    journal = tmp_path / "a.u.ddr"
    journal.write_bytes(b"SQLite format 3\0 and more")
    for path in (journal, tmp_path / "a.ddr"):
        with pytest.raises(UserError, match=r"a\.u\.ddr: is a data file \(journal\) .*, and is not overwritten; choose"):
            export(reduced, None, path, "ddr")
    assert journal.read_bytes() == b"SQLite format 3\0 and more"
    assert not (tmp_path / "a.ddr").exists()


def test_a_refused_export_leaves_every_file_as_it_was(reduced: BsdfDataset, tmp_path: Path) -> None:
    journal, folder, beside = tmp_path / "a.ddr", tmp_path / "f.ddr", tmp_path / "b.u.ddr"
    journal.write_bytes(b"SQLite format 3\0 and more")
    folder.mkdir()
    beside.write_text("notes of the user", encoding="utf-8")
    latest = tmp_path / "a.ddr-wal"  # the latest rows of a journal
    latest.write_bytes(b"rows")
    before = sorted(tmp_path.iterdir())
    for path, wrong in (
        (latest, r"a\.ddr-wal: .*or belongs to one, and is not overwritten"),
        (tmp_path / "a.ddr-shm", r"a\.ddr-shm: .*or belongs to one, and is not overwritten"),
        (journal, r"a\.ddr: is a data file \(journal\)"),
        (folder, r"f\.ddr: is a folder"),
        (tmp_path / "sub" / "none.ddr", r"none\.ddr: there is no folder .*sub; make it first"),
        (tmp_path / "b.ddr", r"b\.ddr: the uncertainties go to .*b\.u\.ddr, and another file is there; choose another name"),
    ):
        with pytest.raises(UserError, match=wrong):
            export(reduced, None, path, "ddr")
        assert sorted(tmp_path.iterdir()) == before
    assert (beside.read_text(encoding="utf-8"), latest.read_bytes()) == ("notes of the user", b"rows")
    for _ in range(2):  # what an export wrote is replaced by the next one
        assert export(reduced, None, tmp_path / "c.ddr", "ddr").files[1] == tmp_path / "c.u.ddr"


@pytest.mark.parametrize("name", ["ddr", pytest.param("zemax", marks=pytest.mark.long)])
def test_a_file_of_uncertainties_is_no_sample(name: str, reduced: BsdfDataset, tmp_path: Path) -> None:
    dark = {key: replace(points, bsdf=0.1 * points.bsdf) for key, points in reduced.samples.items()}
    path = tmp_path / f"paint, red.{name}"
    table, uncertainty, mask = export(replace(reduced, samples=dark), None, path, name).files
    parse_sample(f"table:{table}")
    for beside, what in ((uncertainty, "uncertainties"), (mask, "mask")):
        with pytest.raises(UserError, match=rf"it has the {what} of paint, red\.\w+, not values; give the table itself"):
            parse_sample(f"table:{beside}")


def test_a_csv_has_the_records_of_its_samples_and_who_measured_them(tmp_path: Path) -> None:
    text = f'{SMALL}[metadata]\noperator = "A. Person"\n[metadata.samples.gaussian-5]\nthickness_mm = 1.5\nnote = "a paint"\n'
    journal, out = tmp_path / "a.journal", tmp_path / "a.csv"
    run_without_wires(make_plan(parse_schedule(text, "small"), read_rig(RIG)), journal)
    assert invoke("export", journal, "--out", out).returncode == 0
    lines = out.read_text(encoding="utf-8").splitlines()
    for each in ("operator: A. Person", "sample thickness mm: 1.5", "sample note: a paint"):
        assert f"# gaussian-5: {each}" in lines
