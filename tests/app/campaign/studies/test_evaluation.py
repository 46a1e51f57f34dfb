"""What a campaign shows of its own inputs takes the place of what the rig file states, with its source."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.effects import Component
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.budget import budget_of_value
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import parse_rig
from tests.conftest import RIG, Change, changed
from tests.sizes import some
from tests.system.command import invoke

SCHEDULE = """
name = "lobe"
samples = ["gaussian-5"]
etalon = "etalon"
sigma_deg = [30]
beta_deg = { start = 100, stop = 260, step = 10 }
wavelength_nm = [550]
gains_v_per_a = [1e8, 1e10, 1e11]
readings = 4
dark_readings = 8
"""
WIDE = ("width_deg = 5.0", "width_deg = 15.0")


def measured(path: Path, *changes: Change, schedule: str = SCHEDULE) -> Path:
    """The journal of a campaign on the example rig with some changes."""
    rig = parse_rig(changed(RIG.read_text(encoding="utf-8"), changes), RIG.parent, "rig")
    run_without_wires(make_plan(parse_schedule(schedule, "lobe.toml"), rig), path)
    return path


def components(path: Path) -> Sequence[Component]:
    """The budget of the lobe's largest value."""
    with Journal.open(path) as journal:
        return budget_of_value(evaluate_journal(journal).reduction, {"zenith": 30.0, "azimuth": 180.0}).components


@pytest.mark.parametrize("stated", ["", "[uncertainty]\ncrosstalk = 0.0\n"])
def test_cross_talk_that_rows_at_two_gains_show_is_the_inputs_uncertainty_and_its_source(stated: str, tmp_path: Path) -> None:
    off = ("[twin.light]", f"{stated}[twin.disturbances]\ncrosstalk = 0.001\n[twin.light]")
    (found,) = [
        each
        for each in components(measured(tmp_path / "a.journal", ("seed = 1", "seed = 7"), WIDE, off))
        if each.name == "crosstalk"
    ]
    assert found.input is not None
    assert found.input.source == "the rows of this campaign at two gains"
    assert found.input.u == pytest.approx(1.9e-3, rel=0.05)
    assert found.u == pytest.approx(abs(found.sensitivity) * found.input.u)


def test_a_position_with_play_names_both_keys(tmp_path: Path) -> None:
    play = ("[twin.light]", "[uncertainty]\nbacklash_deg = 0.5\n[twin.light]")
    found = components(measured(tmp_path / "a.journal", play, schedule=SCHEDULE.replace("start = 100", "start = 170")))
    sources = {each.input.source for each in found if each.input is not None and each.name.startswith("position@")}
    assert sources == {"[uncertainty] position_deg (assumed), [uncertainty] backlash_deg (stated)"}


@pytest.mark.parametrize("gains", some(["[1e8, 1e10]", "[1e10]"]))
def test_gains_that_are_exact_have_no_component(gains: str, tmp_path: Path) -> None:
    exact = ("gain_uncertainty = 0.001", "gain_uncertainty = 0.0")
    short = SCHEDULE.replace("start = 100", "start = 170").replace("[1e8, 1e10, 1e11]", gains)
    path = measured(tmp_path / "a.journal", exact, schedule=short)
    with Journal.open(path) as journal:
        assert "gain" not in reduce_journal(journal).samples["gaussian-5"].components
    for command in ("report", "plot"):
        done = invoke(command, path, "--out", tmp_path / f"a.{'html' if command == 'report' else 'png'}")
        assert done.returncode == 0, done.stderr
