"""The live scan has the values of the reduction of the finished journal, and its plot shows every point."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.reduction.components import DETECTED, Signal
from goniotwin.app.campaign.reduction.points import BITS, BsdfPoints
from goniotwin.app.campaign.reduction.readings import DarkHistory
from goniotwin.app.campaign.row import CommittedRow
from goniotwin.app.campaign.running.events import Event, Listener, RowCommitted, RowStarted, State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset
from goniotwin.app.desktop.model.live_scan import LiveScan, ScanData, ScanKey, ScanPoints
from goniotwin.app.desktop.model.run_points import match
from goniotwin.app.desktop.run.live_plot import ScanPlot
from goniotwin.app.desktop.theme import LIGHT
from goniotwin.app.rig import OpenRig, read_rig
from tests.app.campaign.campaign_bench import QUIET, run_plan
from tests.app.campaign.reduction.grey_campaign import GLASS, GREY, GREY_ONLY, STRAY, reduced
from tests.conftest import SMALL, Writer

CERTIFICATE = "zenith_deg,radiance_factor,relative_uncertainty\n0,0.50,0.01\n90,0.48,0.02\n"
EVERYTHING = (
    SMALL
    + """signature = true
repeats = 2
dark_every_s = 20
[overlap]
points = 3
calibrate = true
[drift]
every_s = 20
sigma_deg = 30
beta_deg = 180
wavelength_nm = 550
limit = 0.005
[certificate]
file = "certificate.csv"
expires = 2999-12-31
"""
)
WHITE = ('model = "lambertian"\nreflectance = 0.99', 'model = "lambertian"\nreflectance = 0.99\nside = "both"')
SHEETS = ("[twin.samples.etalon]", f"{GLASS}[twin.samples.etalon]")


def watch(live: LiveScan, *, look: bool = False) -> Listener:
    """A listener that feeds a live scan, and looks at it after each row, as the plot does."""

    def listen(event: Event) -> None:
        if isinstance(event, RowStarted | RowCommitted):
            live.add_row(event)
            if look:
                live.data()

    return listen


def complete(live: LiveScan, key: ScanKey | None = None) -> ScanData:
    """A scan with all rows so far."""
    for _ in range(1000):
        scan = live.data(key)
        assert scan is not None
        if scan.complete:
            return scan
    raise AssertionError("a scan is never complete")


def points_of_scan(dataset: BsdfDataset, key: ScanKey) -> tuple[np.ndarray, BsdfPoints]:
    """The abscissae of a scan and its points in the journal, in their order."""
    (sample, *setting), plane = key
    points = dataset.samples[sample]
    same = np.stack([points.wavelength_nm, points.sigma_deg, points.gamma_deg], axis=1) == setting
    points = points.where(same.all(axis=1) & (np.mod(points.beta_deg, 180.0) == plane))
    polar = np.minimum(points.zenith_deg, 180.0 - points.zenith_deg)
    positive = plane if plane > 90.0 else plane + 180.0  # the side of the specular direction, at azimuth 180
    x = np.where(np.abs(points.azimuth_deg - positive) < 1.0, polar, -polar)
    order = np.argsort(x, kind="stable")
    return x[order], points.where(order)


def check_all_scans(live: LiveScan, dataset: BsdfDataset) -> int:
    """Every scan of a sample is that of the journal; returns their number."""
    scans = [key for key in live.scans if key[0][0] in dataset.samples]
    for key in scans:
        scan, (x, expected) = complete(live, key), points_of_scan(dataset, key)
        back = " of the back" if key[0][2] > 90.0 else ""
        assert scan.y_label in {f"{name}{back}, 1/sr" for name in ("BRDF", "BTDF", "BSDF")}
        assert scan.points.x_deg == pytest.approx(x, abs=1e-9)
        assert scan.points.values == pytest.approx(expected.bsdf, rel=1e-9, nan_ok=True)
        assert scan.points.u_values == pytest.approx(expected.u_bsdf, rel=1e-9, nan_ok=True)
        assert scan.points.blocked.tolist() == expected.flag("shadowed").tolist()
        assert scan.points.untrusted.tolist() == (~expected.good).tolist()
        assert scan.points.transmitted.tolist() == expected.transmitted.tolist()
        assert scan.points.lost.tolist() == expected.flag("under-range").tolist()
    return len(scans)


@pytest.fixture
def everything(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> Plan:
    """Two wavelengths and two half planes, with noise, certificate, signature, repeats, drift checks and calibration."""
    (tmp_path / "certificate.csv").write_text(CERTIFICATE, encoding="utf-8")
    rig = write_rig(("[twin.samples.etalon]", f"{GREY}[twin.samples.etalon]"), ("[twin.light]", f"{STRAY}[twin.light]"))
    changes = (
        *GREY_ONLY,
        ("[550]", "[500, 550]"),
        ("beta_deg = [180]", "beta_deg = [0, 180, 45]"),
        ("shift_deg = [0, 1]", "shift_deg = [0]"),
    )
    return make_plan(read_schedule(write_schedule(*changes, text=EVERYTHING)), read_rig(rig))


@pytest.mark.long
def test_after_the_last_row_every_scan_is_that_of_the_journal(everything: Plan, tmp_path: Path) -> None:
    """From the sample's second drift check on a photodiode gives 5 % less: rows of scans shown before are flagged."""
    live = LiveScan(everything)
    seen: list[OpenRig] = []
    checks = [row.number for row in everything.rows if row.kind == "drift" and row.sample == "grey"]

    def fade(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.number == checks[1] + 1:
            assert seen[0].virtual is not None
            seen[0].virtual.plant.fade(6, 0.95)

    run = run_plan(everything, tmp_path / "a.journal", seen.append, listeners=[fade, watch(live, look=True)])
    assert run.state is State.DONE
    dataset = reduced(tmp_path / "a.journal")
    points = dataset.samples["grey"]
    assert check_all_scans(live, dataset) == 4
    # Each table of the schedule is in the values.
    assert points.flag("drift").any()
    assert np.isfinite(points.signature).any()
    assert dataset.overlaps["grey"].factors.photodiodes
    assert {"calibration", "field", "signature", "certificate"} <= points.budget.keys()
    assert all((each > 0.0).any() for name, each in points.budget.items() if name != "gain")
    assert any("the etalon's" in note or "flagged for drift" in note for note in dataset.notes)


def test_a_certificate_of_a_half_halves_the_values_that_are_shown(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    (tmp_path / "certificate.csv").write_text("radiance_factor,relative_uncertainty\n0.495,0.003\n", encoding="utf-8")
    rig = read_rig(write_rig(*QUIET))
    highest: list[float] = []
    for table in ("", '[certificate]\nfile = "certificate.csv"\nexpires = 2999-12-31\n'):
        plan = make_plan(read_schedule(write_schedule(text=SMALL + table)), rig)
        live = LiveScan(plan)
        run_plan(plan, tmp_path / f"{len(highest)}.journal", listeners=[watch(live)])
        highest.append(float(np.nanmax(complete(live).points.values)))
    assert highest[1] == pytest.approx(0.5 * highest[0], rel=1e-9)  # the rig file's etalon has 0.99


@pytest.mark.long
def test_both_arcs_and_both_sides_are_those_of_the_journal(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    rig = read_rig(write_rig(WHITE, SHEETS))
    text = SMALL + 'side = "both"\nlight = "both"\nsignature = true\n'
    changes = (("gaussian-5", "glass"), ("beta_deg = [180]", "beta_deg = [0, 180]"))
    plan = make_plan(read_schedule(write_schedule(*changes, text=text)), rig)
    live = LiveScan(plan)
    run_plan(plan, tmp_path / "a.journal", listeners=[watch(live, look=True)])
    assert check_all_scans(live, reduced(tmp_path / "a.journal")) == 2
    lights = [complete(live, key).points.transmitted for key in live.scans if key[0][0] == "glass"]
    assert all(each.any() and not each.all() for each in lights)


@pytest.mark.long
def test_transmitted_light_alone_is_that_of_the_journal(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    rig = read_rig(write_rig(WHITE, SHEETS))
    plan = make_plan(read_schedule(write_schedule(("gaussian-5", "glass"), text=SMALL + 'light = "transmitted"\n')), rig)
    live = LiveScan(plan)
    run_plan(plan, tmp_path / "a.journal", listeners=[watch(live)])
    assert check_all_scans(live, reduced(tmp_path / "a.journal")) == 1
    scan = complete(live, next(key for key in live.scans if key[0][0] == "glass"))
    assert scan.points.transmitted.all()
    inside = [any(a <= x <= b for a, b in scan.blocked_deg) for x in scan.points.x_deg]
    assert inside == scan.points.blocked.tolist()


def test_values_by_two_standards_are_those_of_the_journal(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    second = '[twin.samples.second]\nmodel = "lambertian"\nreflectance = 0.8\n\n'
    stated = '[second_standard]\nname = "second"\nradiance_factor = 0.8\nrelative_uncertainty = 0.001\n'
    rig = read_rig(write_rig(("[twin.samples.etalon]", f"{second}[twin.samples.etalon]")))
    plan = make_plan(read_schedule(write_schedule(("dark_readings = 4\n", f"dark_readings = 4\n{stated}"))), rig)
    live = LiveScan(plan)
    assert run_plan(plan, tmp_path / "a.journal", listeners=[watch(live)]).state is State.DONE
    dataset = reduced(tmp_path / "a.journal")
    assert any("standards: second / etalon" in note and "they agree" in note for note in dataset.notes)
    assert check_all_scans(live, dataset) == 1


def test_rows_before_the_etalon_are_shown_as_signals_and_then_as_values(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """The rows of a finished run in another order: the sample first, as if the etalon were mounted later."""
    plan = make_plan(read_schedule(write_schedule(("beta_deg = [180]", "beta_deg = [0, 180]"))), read_rig(write_rig()))
    run = run_plan(plan, tmp_path / "a.journal")
    live = LiveScan(plan)
    of_etalon = [each for each in run.rows if each.row.kind == "measure" and each.row.sample == "etalon"]
    for each in run.rows:
        if each not in of_etalon:
            live.add_row(committed(each))
    (key,) = live.scans
    before = complete(live, key)
    assert before.y_label == "photocurrent / monitor, until the etalon has been measured"
    x, expected = points_of_scan(reduced(tmp_path / "a.journal"), key)
    assert before.points.x_deg == pytest.approx(x, abs=1e-9)
    assert np.isfinite(before.points.values).all()
    assert before.points.blocked.tolist() == expected.flag("shadowed").tolist()
    live.add_row(committed(of_etalon[0]))
    some = complete(live, key)
    assert some.y_label == "BRDF, 1/sr"
    assert 0 < some.points.values.size < expected.bsdf.size
    for each in of_etalon[1:]:
        live.add_row(committed(each))
    after = complete(live, key)
    assert after.points.values == pytest.approx(expected.bsdf, rel=1e-9, nan_ok=True)
    etalon = complete(live)
    assert etalon.title.startswith("etalon:")
    assert etalon.y_label == "photocurrent / monitor"


def committed(row: CommittedRow) -> RowCommitted:
    """The event of a row of a journal."""
    return RowCommitted(row.row, row.data, 0, 1_000_000, 0.0)


def test_the_work_for_a_row_does_not_grow_with_the_campaign(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A repaint after a row computes the signals of this row and of its etalon, however many rows there are."""
    shifts = ("shift_deg = [0, 1]", "shift_deg = { start = 0, stop = 5, step = 0.25 }")
    plan = make_plan(read_schedule(write_schedule(shifts, ("[1e8, 1e10]", "[1e8]"))), read_rig(write_rig()))
    live, computed, work = LiveScan(plan), [0], []
    plain = DarkHistory.signals

    def count(dark: DarkHistory, rows: Sequence[CommittedRow]) -> list[Signal]:
        computed[0] += len(rows)
        return plain(dark, rows)

    def look(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.kind == "measure":
            computed[0] = 0
            live.data()
            work.append((event.row.sample, computed[0]))

    monkeypatch.setattr(DarkHistory, "signals", count)
    run_plan(plan, tmp_path / "a.journal", listeners=[watch(live), look])
    of_sample = [number for sample, number in work if sample == "gaussian-5"]
    assert len(of_sample) == 21
    assert set(of_sample) == {2}


def test_a_scan_in_several_visits_is_shown_whole(tmp_path: Path, write_rig: Writer, write_schedule: Writer) -> None:
    """With sigma as the inner loop, each scan is visited once for each of its betas."""
    rig = read_rig(write_rig(*QUIET))
    nested = 'readings = 2\norder = ["sigma", "shift", "beta", "gamma", "wavelength"]'
    angles = ("sigma_deg = [30]", "sigma_deg = [30, 60]"), ("beta_deg = [180]", "beta_deg = [0, 180]")
    plan = make_plan(read_schedule(write_schedule(*angles, ("\nreadings = 2", f"\n{nested}"))), rig)
    live = LiveScan(plan)
    run_plan(plan, tmp_path / "a.journal", listeners=[watch(live, look=True)])
    assert check_all_scans(live, reduced(tmp_path / "a.journal")) == 2
    scan = complete(live)
    inside = [any(a <= x <= b for a, b in scan.blocked_deg) for x in scan.points.x_deg]
    assert scan.points.blocked.any()
    assert inside == scan.points.blocked.tolist()


def test_the_blocked_directions_of_a_cut_are_those_of_the_check(
    plot: ScanPlot, tmp_path: Path, write_rig: Writer, write_schedule: Writer
) -> None:
    """Most of them have no value."""
    changes = ("beta_deg = [180]", "beta_deg = [0, 180]"), ("shift_deg = [0, 1]", "shift_deg = [0, 1, 2, 3, 4]")
    plan = make_plan(read_schedule(write_schedule(*changes)), read_rig(write_rig(*QUIET)))
    live = LiveScan(plan)
    run_plan(plan, tmp_path / "a.journal", listeners=[watch(live)])
    scan = complete(live)
    assert np.isfinite(scan.points.values[scan.points.blocked]).sum() < check_plan(plan).shadowed
    plot.show_cut(match(scan, None))
    assert f"○\u00a0{check_plan(plan).shadowed} blocked by the mirror unit" in plot.summary


@pytest.fixture
def plot(qtbot: QtBot) -> ScanPlot:
    plot = ScanPlot(LIGHT)
    qtbot.addWidget(plot)
    return plot


def scan_data(values: list[float], u_values: list[float], blocked: list[bool], untrusted: list[bool] | None = None) -> ScanData:
    none = np.zeros(len(values), dtype=bool)
    points = ScanPoints(
        np.arange(float(len(values))),
        np.array(values),
        np.array(u_values),
        np.array(blocked),
        np.array(blocked if untrusted is None else untrusted),
        none,
        np.array(values) < DETECTED * np.array(u_values),
        none,
        np.zeros(len(values), dtype=np.uint16),
        np.zeros((len(values), 4)),
    )
    return ScanData("a scan", "x", "y", (-90.0, 90.0), ((2.5, 3.5),), points)


def test_values_below_the_detection_limit_are_marks_and_hide_no_other_point(plot: ScanPlot) -> None:
    values = [1.0, 0.0, -0.1, 0.5, float("nan"), 0.01, 1e-9]
    plot.show_cut(match(scan_data(values, [0.01] * 6 + [1e-12], [False, False, False, True, False, False, False]), None))
    assert "●\u00a02 measured, highest 1 at 0.0°" in plot.summary
    assert "○\u00a01 blocked by the mirror unit" in plot.summary
    assert "▽\u00a03 below detection limit" in plot.summary
    for x, y in plot.marks().values():
        assert np.all(np.isfinite(x))
        assert np.all(np.isfinite(y))
    assert {name: len(x) for name, (x, _y) in plot.marks().items()} == {
        "measured": 1,
        "blocked": 1,
        "lost": 1,
        "below": 3,  # zero, a negative one, and one more than seven decades below the largest
    }


def test_the_marks_below_the_detection_limit_are_the_values_that_the_journal_calls_lost(plot: ScanPlot) -> None:
    """The journal judges the signal. The value's u has more components, and may be greater than the value."""
    scan = scan_data([1.0, 0.026, 0.5], [0.01, 0.01, 0.6], [False] * 3)
    scan = replace(scan, points=replace(scan.points, lost=np.array([False, True, False])))
    plot.show_cut(match(scan, None))
    assert "▽\u00a01 below detection limit (signal under 3 u)" in plot.summary
    assert {name: x.tolist() for name, (x, _y) in plot.marks().items()} == {
        "measured": [0.0, 2.0],
        "lost": [1.0],
    }
    plot.grab()


def test_values_flagged_for_drift_are_marks_of_their_own(plot: ScanPlot) -> None:
    plot.show_cut(match(scan_data([1.0, 0.9, 0.8], [0.01] * 3, [False, True, False], [False, True, True]), None))
    assert "×\u00a01 flagged" in plot.summary
    assert {name: x.tolist() for name, (x, _y) in plot.marks().items()} == {
        "measured": [0.0],
        "blocked": [1.0],
        "untrusted": [2.0],
    }


def test_flags_are_named_steep_values_have_a_mark_and_findings_a_line(plot: ScanPlot) -> None:
    scan = scan_data([1.0, 0.9, 0.8, 0.7], [0.01] * 4, [False] * 4, [False, False, True, True])
    marks = np.array([0, BITS["steep"], BITS["module"], BITS["monitor"] | BITS["steep"]], dtype=np.uint16)
    scan = replace(scan, points=replace(scan.points, marks=marks), findings=("photodiodes module 2: the amplifiers",))
    plot.show_cut(match(scan, None))
    assert "◆\u00a01 of these steep" in plot.summary
    assert "×\u00a02 flagged (module, monitor)" in plot.summary
    assert plot.summary.endswith("\n✗\u00a0photodiodes module 2: the amplifiers")
    assert [len(plot.marks()[kind][0]) for kind in ("measured", "steep", "untrusted")] == [1, 1, 2]


def test_the_plot_changes_its_label_once_the_etalon_is_there(plot: ScanPlot) -> None:
    scan = scan_data([1.0], [0.01], [False])
    plot.show_cut(match(scan, None))
    assert plot.y_label == "y"
    plot.show_cut(match(replace(scan, y_label="BSDF (1/sr)"), None))
    assert plot.y_label == "BSDF (1/sr)"


def test_a_scan_without_light_is_shown(plot: ScanPlot) -> None:
    plot.show_cut(match(scan_data([-1.0, float("nan")], [1.0, float("nan")], [False, False]), None))
    assert "●\u00a00 measured" in plot.summary
    plot.grab()
