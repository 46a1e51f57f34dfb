"""A small proof: eight rigs, each a whole campaign; the independent part, and the shared inputs fitted to each rig."""

from pathlib import Path

import pytest

from goniotwin.app.campaign.proof.proof import Proof, prove
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from goniotwin.app.sweeps.runners import Here
from tests.conftest import Writer

ROWS = ("shift_deg = [0, 1]", "shift_deg = [0, 1, 2, 3, 4]")
RIGS = 8


@pytest.mark.parametrize("wires", [False, pytest.param(True, marks=pytest.mark.long)], ids=["without wires", "with wires"])
def test_eight_rigs_have_the_law_that_they_state(
    wires: bool, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """(a) what a fit of all shared inputs leaves; (b) the fitted inputs over their u, and the angle as it was drawn.

    Of eight rigs: 1,400 values, whose chi-square has a standard error of 4 %; 35 determined inputs, one of 25 %.
    """
    schedule = read_schedule(
        write_schedule(ROWS, ("readings = 2", "readings = 4"), ("dark_readings = 4", "dark_readings = 16"))
    )
    totals = prove(Proof(schedule, read_rig(write_rig()), RIGS, tmp_path / "proof", wires), Here())
    whole = totals.whole
    assert whole is not None
    assert not totals.failed
    assert whole.chi_square == pytest.approx(1.0, abs=0.12)
    assert 0.3 < totals.variance_shared < 2.2
    correlation, difference = totals.angles["gaussian-5"]
    assert correlation > 0.99
    assert difference < 0.01
