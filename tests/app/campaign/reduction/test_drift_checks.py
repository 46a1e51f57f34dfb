"""Drift checks: values are flagged beyond the limit, and photodiodes that the checks do not cover are named."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import NewPlan, Plan, make_plan
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.drift_checks import compare_signals
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
from goniotwin.app.campaign.running.events import Event, RowCommitted, State
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset
from goniotwin.app.campaign.wording import number_list
from goniotwin.app.rig import OpenRig, read_rig
from tests.app.campaign.campaign_bench import RunResult, run_plan
from tests.app.campaign.reduction.grey_campaign import grey_plan, reduced
from tests.conftest import RIG, Writer

DRIFT = "\n[drift]\nevery_s = 10\nsigma_deg = 30\nbeta_deg = 180\nwavelength_nm = 550\nlimit = 0.005\n"
TEXT = """
name = "lobe"
samples = ["gaussian-5"]
etalon = "white-tile"
sigma_deg = [15, 60]
beta_deg = [180]
wavelength_nm = [550]
gains_v_per_a = "automatic"
dark_readings = 4
[drift]
every_s = 600
sigma_deg = 15
beta_deg = 180
wavelength_nm = 550
"""


def run_with_drift(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, tables: str, share: float
) -> tuple[Plan, RunResult]:
    """After the sample's first interval all photodiodes give less: a change that the monitor does not see."""
    longer = ("shift_deg = [0, 1]", "shift_deg = { start = 0, stop = 5, step = 0.5 }")
    plan = grey_plan(write_rig, write_schedule, tables, longer)
    second = [row.number for row in plan.rows if row.kind == "drift" and row.sample == "grey"][1]
    rigs: list[OpenRig] = []

    def fade(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.number == second + 1:
            assert rigs[0].virtual is not None
            for k in range(36):
                rigs[0].virtual.plant.fade(k, share)

    return plan, run_plan(plan, tmp_path / "a.journal", rigs.append, listeners=[fade])


def test_a_change_of_1_percent_is_detected_within_one_interval_and_its_values_are_flagged(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    _, run = run_with_drift(write_rig, write_schedule, tmp_path, DRIFT, 0.99)
    assert run.state is State.DONE
    beyond = [text for kind, text in run.events if kind == "drift" and "beyond the limit" in text]
    assert beyond
    change = float(beyond[0].split("changed by ")[1].split(" %")[0])
    assert change == pytest.approx(-1.0, abs=0.3)
    points = reduced(tmp_path / "a.journal").samples["grey"]
    flagged = set(points.shift_deg[points.flag("drift")])
    assert flagged == {3.5, 4.0, 4.5, 5.0}  # since the last good check
    assert float(np.nanmedian(points.bsdf[points.shift_deg > 3.5]) / (0.03 / np.pi)) == pytest.approx(0.99, abs=0.003)
    assert not points.good[points.flag("drift")].any()


def test_a_change_within_the_limit_is_reported_and_not_flagged(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    _, run = run_with_drift(write_rig, write_schedule, tmp_path, DRIFT, 0.998)
    texts = [text for kind, text in run.events if kind == "drift"]
    assert any("changed by -0.1" in text or "changed by -0.2" in text for text in texts)
    assert not any("beyond" in text for text in texts)
    assert not reduced(tmp_path / "a.journal").samples["grey"].flag("drift").any()


def test_a_drift_beyond_the_limit_stops_the_run_if_the_schedule_asks_for_it(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    plan, run = run_with_drift(write_rig, write_schedule, tmp_path, DRIFT + 'on_excess = "stop"\n', 0.98)
    assert run.state is State.IDLE
    assert run.rows[-1].row.kind == "drift"
    assert len(run.rows) < len(plan.rows)
    assert any(kind == "stop" and "beyond the limit" in text for kind, text in run.events)


def planned(text: str) -> NewPlan:
    return make_plan(parse_schedule(text, "x.toml"), read_rig(RIG))


def run_with_fading(text: str, photodiode: int, path: Path) -> BsdfDataset:
    """From the sample's first drift check on the photodiode gives a fifth less."""
    rigs: list[OpenRig] = []

    def fade(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.kind == "drift" and event.row.sample == "gaussian-5":
            assert rigs[0].virtual is not None
            rigs[0].virtual.plant.fade(photodiode, 0.8)

    run_plan(planned(text), path, rigs.append, listeners=[fade])
    return reduced(path)


def test_a_photodiode_covered_by_the_checks_is_flagged(tmp_path: Path) -> None:
    dataset = run_with_fading(TEXT, 3, tmp_path / "a.journal")  # 15 deg: the peak of the lobe at the pose of the drift checks
    points = dataset.samples["gaussian-5"]
    assert points.flag("drift")[points.photodiode == 3].all()
    assert 3 not in dataset.unchecked["gaussian-5"]


def test_a_photodiode_that_the_checks_do_not_cover_is_named(tmp_path: Path) -> None:
    dataset = run_with_fading(TEXT, 12, tmp_path / "a.journal")  # 60 deg: the peak of the other lobe
    points = dataset.samples["gaussian-5"]
    peak = points.where((points.photodiode == 12) & (points.sigma_deg == 60.0))
    assert peak.good.all()  # although it is wrong
    assert 12 in dataset.unchecked["gaussian-5"]
    (note,) = [each for each in dataset.notes if each.startswith("drift checks of gaussian-5 cannot detect")]
    assert number_list(dataset.unchecked["gaussian-5"]) in note
    assert "because these have too little light" in note
    assert "white-tile" not in dataset.unchecked


def test_a_rehearsal_warns_of_unchecked_photodiodes_with_a_remedy() -> None:
    def warnings(text: str) -> list[str]:
        rehearsal = rehearse(*plan_rehearsal(parse_schedule(text, "x.toml"), read_rig(RIG), {}))
        return [each for each in rehearsal.result.warnings if "drift checks of" in each]

    (warning,) = warnings(TEXT)
    assert "drift checks of gaussian-5" in warning
    assert "Choose a [drift] pose at which more of them have light" in warning
    assert warnings(TEXT.replace("gaussian-5", "opal")) == []
    assert warnings(TEXT.partition("[drift]")[0]) == []


def test_check_warns_of_photodiodes_without_light_at_the_pose_of_the_drift_checks() -> None:
    def warnings(text: str) -> list[str]:
        return [each for each in check_plan(planned(text)).warnings if "a fault of these" in each]

    assert warnings(TEXT) == []
    through = 'light = "transmitted"\n' + TEXT.replace("gaussian-5", "opal")
    (dark,) = warnings(through)
    assert "photodiodes 18 to 35 have no light" in dark
    assert "Set [drift] sigma_deg = 165, which gives them light" in dark
    assert warnings(through.replace("sigma_deg = 15\n", "sigma_deg = 165\n")) == []
    (blocked,) = warnings(TEXT.replace("sigma_deg = 15\nbeta_deg = 180", "sigma_deg = 15\nbeta_deg = 0"))
    assert "the mirror unit blocks photodiodes 3" in blocked


def test_lists_of_numbers_are_written_as_ranges() -> None:
    assert number_list([]) == ""
    assert number_list([5]) == "5"
    assert number_list(np.array([9, 3, 1, 2, 7, 8]).tolist()) == "1 to 3, 7 to 9"
    assert number_list([1, 2, 4]) == "1, 2, 4"


def test_a_check_on_a_steep_lobe_has_the_stops_of_the_axes_in_its_u() -> None:
    """A lobe of 2.9 deg at 40 deg is seen 0.02 deg aside, twice the half width of one stop: no photodiode has drifted.

    One of them that has lost 5 % is found beside the flanks, and 5 % of all in their mean.
    """
    rig = read_rig(RIG).file
    polar = np.array([*rig.photodiodes.upper_deg, *rig.photodiodes.lower_deg])
    on_arc = np.arange(polar.size) < len(rig.photodiodes.upper_deg)

    def seen(aside_deg: float, loss: np.ndarray[tuple[int], np.dtype[np.float64]] | float = 1.0) -> Signal:
        value = loss * (1e-3 + np.where(on_arc, np.exp(-(((polar - 40.0 - aside_deg) / 2.9) ** 2)), 0.0))
        return Signal(value, {"noise": (1e-4 * value) ** 2}, gain=np.zeros(polar.size, dtype=np.int64))

    aside = compare_signals(seen(0.0), seen(0.02), rig, 0.005)
    change = seen(0.02).value / seen(0.0).value - 1.0
    assert np.abs(change).max() > 0.01
    assert not aside.beyond_limit
    lost = np.where(np.arange(polar.size) == 2, 0.95, 1.0)
    assert np.flatnonzero(compare_signals(seen(0.0), seen(0.0, lost), rig, 0.005).outliers).tolist() == [2]
    assert compare_signals(seen(0.0), seen(0.02, 0.95), rig, 0.005).beyond
