"""What the reduction subtracts, scales and flags: the signature, the certificate, drift, dead photodiodes, transmission."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.geometry.directions import arc_views
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.reduction.export import export_csv
from goniotwin.app.campaign.reduction.overlaps import overlaps
from goniotwin.app.campaign.reduction.reduction import BsdfDataset, reduce_journal
from goniotwin.app.campaign.running.events import Event, RowCommitted, State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import OpenRig, read_rig
from goniotwin.twin.optics import from_specular
from tests.app.campaign.campaign_bench import QUIET, RunResult, run_plan
from tests.conftest import RIG, SMALL, Change, Writer, changed

GREY = '[twin.samples.grey]\nmodel = "lambertian"\nreflectance = 0.03\n\n'
GLASS = '[twin.samples.glass]\nmodel = "lambertian"\nreflectance = 0.4\ntransmittance = 0.3\nside = "both"\n\n'
STRAY = "[twin.optics]\nstray = true\n\n[twin.frames]\nreflectance = 0.045\n\n"
ONE = (("gaussian-5", "grey"), ("[1e8, 1e10]", "[1e10, 1e11]"))
DRIFT = "\n[drift]\nevery_s = 10\nsigma_deg = 30\nbeta_deg = 180\nwavelength_nm = 550\nlimit = 0.005\n"


def reduced(path: Path) -> BsdfDataset:
    with Journal.open(path) as journal:
        return reduce_journal(journal)


def grey_plan(write_rig: Writer, write_schedule: Writer, tables: str = "", *changes: Change, twin: str = "") -> Plan:
    rig = write_rig(*QUIET, ("[twin.samples.etalon]", f"{GREY}[twin.samples.etalon]"), ("[twin.light]", f"{twin}[twin.light]"))
    return make_plan(read_schedule(write_schedule(*ONE, *changes, text=SMALL + tables)), read_rig(rig))


# ---- the signature ----


def test_the_signature_is_subtracted_where_it_was_measured(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    plan = grey_plan(write_rig, write_schedule, "signature = true\n", twin=STRAY)
    run_campaign(plan, tmp_path / "a.journal")
    found = reduced(tmp_path / "a.journal")
    points = found.samples["grey"].where(found.samples["grey"].good)
    assert float(np.median(points.signature)) == pytest.approx(0.14, abs=0.03)
    assert np.abs((points.bsdf - 0.03 / np.pi) / points.u_bsdf).max() < 3.0
    assert any("without a sample" in note for note in found.notes)


def test_what_is_subtracted_is_as_uncertain_as_the_rig_file_says(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    plan = grey_plan(write_rig, write_schedule, "signature = true\n", twin=STRAY)
    run_campaign(plan, tmp_path / "a.journal")
    found = reduced(tmp_path / "a.journal")
    surely = found.samples["grey"].where(found.samples["grey"].good)
    with sqlite3.connect(tmp_path / "a.journal") as journal:
        ((rig,),) = journal.execute("SELECT value FROM campaign WHERE key = 'rig'")
        less = changed(rig, (("signature_uncertainty = 0.01", "signature_uncertainty = 0.3"),))
        journal.execute("UPDATE campaign SET value = ? WHERE key = 'rig'", (less,))
    doubtful = reduced(tmp_path / "a.journal").samples["grey"]
    doubtful = doubtful.where(doubtful.good)
    taken = surely.signature / (1.0 - surely.signature)  # over what is left
    added = np.sqrt(doubtful.u_bsdf**2 - surely.u_bsdf**2) / surely.bsdf
    # The etalon's own share of it, 0.99 to 0.03 less, hardly adds to that.
    assert added == pytest.approx(np.sqrt(0.3**2 - 0.01**2) * taken, rel=0.01)
    assert any("the same to 1 %" in note for note in found.notes)


def test_without_it_the_same_light_is_in_the_value_and_nothing_says_otherwise(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    run_campaign(grey_plan(write_rig, write_schedule, twin=STRAY), tmp_path / "a.journal")
    points = reduced(tmp_path / "a.journal").samples["grey"]
    assert np.isnan(points.signature).all()
    assert float(np.nanmedian(points.bsdf[points.good]) / (0.03 / np.pi)) > 1.1


# ---- drift ----


def drifting(write_rig: Writer, write_schedule: Writer, tmp_path: Path, tables: str, share: float) -> tuple[Plan, RunResult]:
    """After the sample's first interval all photodiodes give less: a change of which the monitor knows nothing."""
    longer = ("shift_deg = [0, 1]", "shift_deg = { start = 0, stop = 5, step = 0.5 }")
    plan = grey_plan(write_rig, write_schedule, tables, longer)
    second = [row.number for row in plan.rows if row.kind == "drift" and row.sample == "grey"][1]
    rigs: list[OpenRig] = []

    def fades(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.number == second + 1:
            assert rigs[0].virtual is not None
            for k in range(36):
                rigs[0].virtual.plant.fade(k, share)

    return plan, run_plan(plan, tmp_path / "a.journal", rigs.append, listeners=[fades])


def test_a_change_of_1_percent_is_found_within_one_interval_and_what_it_spoils_is_flagged(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    _, run = drifting(write_rig, write_schedule, tmp_path, DRIFT, 0.99)
    assert run.state is State.DONE
    beyond = [text for kind, text in run.events if kind == "drift" and "beyond the limit" in text]
    assert beyond
    change = float(beyond[0].split("changed by ")[1].split(" %")[0])
    assert change == pytest.approx(-1.0, abs=0.3)
    points = reduced(tmp_path / "a.journal").samples["grey"]
    spoiled = set(points.shift_deg[points.drifted])
    assert spoiled == {3.5, 4.0, 4.5, 5.0}  # since the last good check
    assert float(np.nanmedian(points.bsdf[points.shift_deg > 3.5]) / (0.03 / np.pi)) == pytest.approx(0.99, abs=0.003)
    assert not points.good[points.drifted].any()


def test_a_change_within_the_limit_is_told_and_not_flagged(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    _, run = drifting(write_rig, write_schedule, tmp_path, DRIFT, 0.998)
    told = [text for kind, text in run.events if kind == "drift"]
    assert any("changed by -0.1" in text or "changed by -0.2" in text for text in told)
    assert not any("beyond" in text for text in told)
    assert not reduced(tmp_path / "a.journal").samples["grey"].drifted.any()


def test_a_drift_may_end_the_run(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    plan, run = drifting(write_rig, write_schedule, tmp_path, DRIFT + 'on_excess = "stop"\n', 0.98)
    assert run.state is State.IDLE
    assert run.rows[-1].row.kind == "drift"
    assert len(run.rows) < len(plan.rows)
    assert any(kind == "stop" and "beyond the limit" in text for kind, text in run.events)


# ---- photodiodes ----


@pytest.mark.parametrize("after", ["grey/mount", "grey/sigma"])
def test_a_photodiode_that_dies_is_flagged(after: str, write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """Between the darks of the sample as between its rows."""
    rigs: list[OpenRig] = []

    def dies(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.identity.startswith(after):
            assert rigs[0].virtual is not None
            rigs[0].virtual.plant.fade(5, 0.0)

    plan = grey_plan(write_rig, write_schedule)
    run_plan(plan, tmp_path / "a.journal", rigs.append, listeners=[dies])
    points = reduced(tmp_path / "a.journal").samples["grey"]
    wrong = ~np.isfinite(points.bsdf) | (np.abs(points.bsdf - 0.03 / np.pi) > 4.0 * points.u_bsdf)
    assert set(points.photodiode[wrong & ~points.shadowed]) == {5}
    assert points.dead[wrong & ~points.shadowed].all()
    assert not points.good[wrong].any()
    assert set(points.photodiode[points.dead]) == {5}


def test_a_photodiode_that_was_dead_from_the_beginning_is_flagged(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    def dead(opened: OpenRig) -> None:
        assert opened.virtual is not None
        opened.virtual.plant.fade(5, 0.0)

    run_plan(grey_plan(write_rig, write_schedule), tmp_path / "a.journal", dead)
    points = reduced(tmp_path / "a.journal").samples["grey"]
    assert set(points.photodiode[points.dead]) == {5}
    assert points.no_etalon[points.dead].all()
    assert np.isnan(points.bsdf[points.dead]).all()


def test_two_photodiodes_that_saw_one_direction_agree(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """With noise: shift 5 deg is where the next photodiode stood."""
    rig = write_rig(("[twin.samples.etalon]", f"{GREY}[twin.samples.etalon]"))
    shifts = ("shift_deg = [0, 1]", "shift_deg = [0, 5]")
    run_campaign(make_plan(read_schedule(write_schedule(*ONE, shifts)), read_rig(rig)), tmp_path / "a.journal")
    found = reduced(tmp_path / "a.journal")
    assert found.overlaps["grey"].pairs == 17
    assert found.overlaps["grey"].agree
    points = found.samples["grey"]
    points.bsdf[points.photodiode == 4] *= 1.1  # as if it had been turned between etalon and sample
    other = overlaps(points, 0.002)
    assert not other.agree
    assert "do NOT agree" in str(other)


# ---- sides and light ----


def test_directions_of_both_arcs_and_both_sides() -> None:
    file = read_rig(RIG).file
    front_up, front_low = arc_views(file, (0.0, 30.0, 180.0, 0.0))
    assert (front_up.back, front_up.transmitted) == (False, False)
    assert (front_low.back, front_low.transmitted) == (False, True)
    assert front_up.theta[6] == pytest.approx(0.0, abs=1e-9)  # specular
    assert front_low.theta[6] == pytest.approx(0.0, abs=1e-9)  # straight on
    assert front_low.zenith[6] == pytest.approx(150.0)
    assert front_up.etalon_pose((0.0, 30.0, 180.0, 0.0)) == (0.0, 30.0, 180.0, 0.0)
    assert front_low.etalon_pose((0.0, 30.0, 180.0, 0.0)) == (0.0, 150.0, 180.0, 0.0)
    back_up, back_low = arc_views(file, (0.0, 150.0, 180.0, 0.0))
    assert (back_up.back, back_up.transmitted) == (True, True)
    assert (back_low.back, back_low.transmitted) == (True, False)
    assert back_low.theta[6] == pytest.approx(0.0, abs=1e-9)
    assert back_up.theta[6] == pytest.approx(0.0, abs=1e-9)
    # The sample turned about x: theta and phi of its back are those of a front lit at 30 deg, with phi the other way round.
    _, low = arc_views(file, (0.0, 150.0, 100.0, 2.0))
    x, y, z = from_specular(30.0, low.theta, low.phi).T
    assert np.allclose(np.degrees(np.arccos(z)), low.polar)
    assert np.allclose(np.degrees(np.arctan2(-y, x)), 100.0)


def test_reflection_and_transmission_of_both_sides_come_back(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    white = ('model = "lambertian"\nreflectance = 0.99', 'model = "lambertian"\nreflectance = 0.99\nside = "both"')
    rig = write_rig(*QUIET, white, ("[twin.samples.etalon]", f"{GLASS}[twin.samples.etalon]"))
    schedule = write_schedule(
        ("gaussian-5", "glass"), ("[1e8, 1e10]", "[1e10, 1e11]"), text=SMALL + 'side = "both"\nlight = "both"\n'
    )
    run_campaign(make_plan(read_schedule(schedule), read_rig(rig)), tmp_path / "a.journal")
    found = reduced(tmp_path / "a.journal")
    points = found.samples["glass"]
    for back in (False, True):
        for transmitted, share in ((False, 0.4), (True, 0.3)):
            here = points.where(points.good & (points.back == back) & (points.transmitted == transmitted))
            assert here.bsdf.size > 25
            assert np.abs((here.bsdf - share / np.pi) / here.u_bsdf).max() < 3.0, (back, transmitted)
    assert any("transmitted light is scaled" in note for note in found.notes)
    export_csv(found, "glass", tmp_path / "a.csv")
    text = (tmp_path / "a.csv").read_text()
    assert "back" in text
    assert "transmitted" in text


def test_transmitted_light_is_scaled_by_an_etalon_without_the_signature(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """The frames' light is a tenth of a dark etalon's, and would make the sample seem darker by as much."""
    dark = ('model = "lambertian"\nreflectance = 0.99', 'model = "lambertian"\nreflectance = 0.05\nside = "both"')
    factor = ("radiance_factor = 0.99", "radiance_factor = 0.05")
    tables = (("[twin.samples.etalon]", f"{GLASS}[twin.samples.etalon]"), ("[twin.light]", f"{STRAY}[twin.light]"))
    rig = read_rig(write_rig(*QUIET, dark, factor, *tables))
    changes = (("gaussian-5", "glass"), ("[1e8, 1e10]", "[1e10, 1e11]"))
    medians = []
    for signature in ("false", "true"):
        text = f'{SMALL}light = "transmitted"\nsignature = {signature}\n'
        journal = tmp_path / f"{signature}.journal"
        run_campaign(make_plan(read_schedule(write_schedule(*changes, text=text)), rig), journal)
        points = reduced(journal).samples["glass"]
        points = points.where(points.good & points.transmitted)
        medians.append(float(np.median(points.bsdf)) / (0.3 / np.pi))
    assert medians[0] < 0.97
    assert medians[1] == pytest.approx(1.0, abs=0.03)


def test_a_front_measured_alone_has_no_transmitted_points(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    run_campaign(grey_plan(write_rig, write_schedule), tmp_path / "a.journal")
    points = reduced(tmp_path / "a.journal").samples["grey"]
    assert not points.transmitted.any()
    assert not points.back.any()
    assert points.bsdf.size == 36


def test_a_zero_that_is_for_the_other_side_of_the_backlash_is_told(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """Every move arrives from above, but the zero is where the axis stands coming from below."""
    above = ("lower_deg = -5.0\n", 'lower_deg = -5.0\nbacklash_deg = 0.2\napproach_from = "above"\n')
    play = ("beta = { motor = 5, gear = 18.0", "beta = { motor = 5, gear = 18.0, backlash_deg = 0.2")
    for name, changes in (("above", (above, play)), ("below", ((above[0], above[1].replace("above", "below")), play))):
        journal = tmp_path / f"{name}.journal"
        run_campaign(make_plan(read_schedule(write_schedule()), read_rig(write_rig(*QUIET, *changes))), journal)
        told = [note for note in reduced(journal).notes if note.startswith("beta: the encoder is +0.2")]
        assert len(told) == (name == "above")
