"""The conclusion of a journal: what reaches the target, what is saturated, and what to change."""

from pathlib import Path

from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.conclusion import conclude
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import read_rig
from tests.conftest import RIG, SMALL


def concluded(folder: Path, gains: str, target_u: float) -> tuple[str, ...]:
    """The lines about the small campaign with these gains and this target."""
    text = f"{SMALL.replace('[1e8, 1e10]', gains)}\n[target]\nrelative_u = {target_u}\n"
    run_without_wires(make_plan(parse_schedule(text, "small"), read_rig(RIG)), folder / "a.journal")
    return conclude(folder / "a.journal").lines


def test_the_values_that_reach_the_target_are_counted(tmp_path: Path) -> None:
    (line,) = [each for each in concluded(tmp_path, "[1e8, 1e10]", 0.9) if "reach the target" in each]
    name, reached, _of, values = line.split()[:4]
    assert (name, reached) == ("gaussian-5:", values)
    assert int(values) > 0
    assert line.endswith("u ≤ 90 %")


def test_saturated_values_are_named_with_the_gain_to_add(tmp_path: Path) -> None:
    lines = concluded(tmp_path, "[1e11]", 0.9)
    (line,) = [each for each in lines if "saturated at every gain" in each]
    assert line.startswith("gaussian-5: ")
    assert line.endswith("Add 1e10 V/A to gains_v_per_a")
