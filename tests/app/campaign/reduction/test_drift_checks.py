"""Photodiodes that the drift checks cannot watch are named, before and after: a fault of theirs would pass."""

from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.reduction.reduction import BsdfDataset, reduce_journal
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.wording import number_list
from goniotwin.app.rig import OpenRig, read_rig
from tests.app.campaign.campaign_bench import run_plan
from tests.conftest import RIG

TEXT = """
name = "watched"
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


def planned(text: str) -> Plan:
    return make_plan(parse_schedule(text, "x.toml"), read_rig(RIG))


def fading(text: str, photodiode: int, path: Path) -> BsdfDataset:
    """The photodiode gives a fifth less from the sample's first check on."""
    rigs: list[OpenRig] = []

    def fade(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.kind == "drift" and event.row.sample == "gaussian-5":
            assert rigs[0].virtual is not None
            rigs[0].virtual.plant.fade(photodiode, 0.8)

    run_plan(planned(text), path, rigs.append, listeners=[fade])
    with Journal.open(path) as journal:
        return reduce_journal(journal)


def test_a_photodiode_that_the_checks_see_is_flagged_and_not_told_of(tmp_path: Path) -> None:
    found = fading(TEXT, 3, tmp_path / "a.journal")  # at 15 deg, the peak of the lobe at the checks' pose
    points = found.samples["gaussian-5"]
    assert points.drifted[points.photodiode == 3].all()
    assert 3 not in found.unchecked["gaussian-5"]


def test_a_photodiode_that_they_do_not_see_is_told_of(tmp_path: Path) -> None:
    found = fading(TEXT, 12, tmp_path / "a.journal")  # at 60 deg, the peak of the other lobe
    points = found.samples["gaussian-5"]
    peak = points.where((points.photodiode == 12) & (points.sigma_deg == 60.0))
    assert peak.good.all()  # and wrong
    assert 12 in found.unchecked["gaussian-5"]
    (note,) = [each for each in found.notes if each.startswith("drift checks of gaussian-5 cannot detect")]
    assert number_list(found.unchecked["gaussian-5"]) in note
    assert "a fault of theirs would not be noticed" in note
    assert "white-tile" not in found.unchecked


def test_a_rehearsal_warns_of_them_and_says_what_to_do() -> None:
    def told(text: str) -> list[str]:
        found = rehearse(*plan_rehearsal(parse_schedule(text, "x.toml"), read_rig(RIG), {}))
        return [each for each in found.result["warnings"] if "drift checks of" in each]

    (warning,) = told(TEXT)
    assert "drift checks of gaussian-5" in warning
    assert "choose a [drift] pose at which more of them have light" in warning
    assert told(TEXT.replace("gaussian-5", "opal")) == []
    assert told(TEXT.partition("[drift]")[0]) == []


def test_check_warns_of_those_that_no_light_can_reach_at_the_checks_pose() -> None:
    def told(text: str) -> list[str]:
        return [each for each in check_plan(planned(text))["warnings"] if "a fault of theirs" in each]

    assert told(TEXT) == []
    through = 'light = "transmitted"\n' + TEXT.replace("gaussian-5", "opal")
    (dark,) = told(through)
    assert "photodiodes 18 to 35 look at" in dark
    assert "a [drift] sigma_deg of 165 lights them" in dark
    assert told(through.replace("sigma_deg = 15\n", "sigma_deg = 165\n")) == []
    (hidden,) = told(TEXT.replace("sigma_deg = 15\nbeta_deg = 180", "sigma_deg = 15\nbeta_deg = 0"))
    assert "the mirror unit hides photodiodes 3" in hidden


def test_numbers_are_told_in_runs() -> None:
    assert number_list([]) == ""
    assert number_list([5]) == "5"
    assert number_list(np.array([9, 3, 1, 2, 7, 8]).tolist()) == "1 to 3, 7 to 9"
    assert number_list([1, 2, 4]) == "1, 2, 4"
