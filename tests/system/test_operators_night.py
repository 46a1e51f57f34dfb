"""A person's night at a virtual rig, by keyboard alone: the bench, a run, a fault, and the ends of window and station.

Each window is a process whose keys are pressed and whose texts are read (`window_by_keys`); nothing else of it is touched. The
part of it that needs no process to be killed is in `tests/app/desktop/test_by_keys.py`.
"""

import os
import re
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.geometry.directions import scan_plane_deg
from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.desktop.bench.screen import READY
from goniotwin.app.station.connection_file import known_stations
from tests.app.campaign.campaign_bench import QUIET
from tests.conftest import SMALL, Writer
from tests.system.command_process import FORKED
from tests.system.conftest import until
from tests.system.window_by_keys import WindowByKeys, windows

pytestmark = [
    *FORKED,
    pytest.mark.long,
    pytest.mark.endpoint,
    pytest.mark.usefixtures("heard_hangup"),
]
SPEED = 2.0
BETAS_DEG = list(range(100, 261, 10))
SHIFTS_DEG = [0, 1, 2, 3, 4]
NIGHT = SMALL.replace("beta_deg = [180]", f"beta_deg = {BETAS_DEG}").replace("[0, 1]", f"{SHIFTS_DEG}")
"""Seventeen cuts, after the etalon's: more than are done until the station is killed, also on a slow computer."""
ASK = '\n[faults]\nwire = "ask"\n'
PREFLIGHT = ("Ports", "Homed", "Limits", "Lamp", "Dark reading", "Drift", "Certificate", "Disk")
CUT = "Plot of the scan in progress"
RIG, BENCH, RUN, CAMPAIGNS = "Ctrl+1", "Ctrl+2", "Ctrl+4", "Ctrl+5"


@pytest.fixture
def open_window(tmp_path: Path) -> Iterator[Callable[..., WindowByKeys]]:
    with windows(tmp_path) as opened:
        yield opened


def next_point_has_residual(window: WindowByKeys) -> bool:
    """Move the cursor of the cut by a point; return whether its residual is to be read."""
    window.press("Right")
    return window.reads(", residual ")


def points_of(journal: Path) -> BsdfPoints:
    """All points of a journal, reduced here."""
    with JournalFollower(journal).reading() as reader:
        return reduce_journal(reader).samples["gaussian-5"]


def check_all_shown(window: WindowByKeys, journal: Path) -> None:
    """Pause the run; the map has all directions of the journal, and the plot all points of the cut in progress; resume."""
    window.press("Ctrl+P")
    window.wait_for("Paused, with the shutter closed")
    points = points_of(journal)
    planes = scan_plane_deg(points.beta_deg)
    in_map = int((~points.flag("shadowed") & np.isfinite(points.bsdf)).sum())
    in_cut = int((np.isfinite(points.bsdf) & (planes == planes[-1])).sum())
    assert in_map > in_cut > 0

    def shown() -> bool:
        lines = window.seen()
        counts = [sum(map(int, re.findall(r"[●○×▽]\s(\d+)", line))) for line in lines if line.startswith("●")]
        return in_cut in counts and any(re.match(rf"{in_map} of \d+ directions", line) for line in lines)

    window.press(RUN)
    until(shown)
    window.press("Ctrl+P")


def test_an_operators_night(
    open_window: Callable[..., WindowByKeys], write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    folder = tmp_path / "journals"
    arguments = ("--rig", write_rig(*QUIET), "--schedule", write_schedule(text=NIGHT + ASK), "--out", folder, "--speed", SPEED)

    # Connect and preflight.
    window = open_window(*arguments)
    window.wait_for("Ready to start.")
    window.press(RIG)
    window.wait_for(*PREFLIGHT)
    window.press("Alt+E")
    window.wait_for("[A person is the operator] (checked)")

    # The bench.
    window.press(BENCH, "Alt+J", "End")
    window.choose("Jog sigma up")
    window.wait_for("σ 30.00°", READY)
    window.choose("Open the shutter")
    window.wait_for("[Close]", READY)
    window.choose("Read all photodiodes once")
    window.wait_for("Mean of 4: 36 photodiodes", READY)

    # Start and mount.
    window.press("Alt+S")
    window.answer("Mount etalon", "Wait")
    window.wait_for("The run waits for an answer: Mount etalon")
    window.press("Alt+A")
    window.answer("Mount etalon", "Mounted")
    window.answer("Mount gaussian-5", "Mounted")
    (journal,) = folder.glob("*.journal")
    done = window.wait_for_rows(campaign_summary(journal).rows + 3)

    # Prediction and residual.
    window.press(RUN)
    window.wait_for("predicted ± 2 u")
    window.tab_to(CUT)
    until(lambda: next_point_has_residual(window))

    # The monitor's plug is pulled, and put back.
    ((path, station),) = known_stations().items()
    os.kill(station.pid, signal.SIGUSR1)
    window.wait_for("Device fault", "Monitor (PM100D) is not responding", "[Retry]")
    os.kill(station.pid, signal.SIGUSR2)
    window.answer("Device fault", "Retry")
    done = window.wait_for_rows(done + 2)

    # The window is closed; the run goes on; the next one shows all of it.
    window.press("Ctrl+Q")
    window.answer("Close the window?", "Close the window")
    assert window.wait_for_end() == 0, window.errors
    until(lambda: campaign_summary(journal).rows > done)
    window = open_window(*arguments)
    window.wait_for("Attached to a station that was running")
    done = window.wait_for_rows(campaign_summary(journal).rows)
    check_all_shown(window, journal)

    # The window is killed.
    window.process.send_signal(signal.SIGKILL)
    window.wait_for_end()
    until(lambda: campaign_summary(journal).rows > done)
    window = open_window(*arguments)
    done = window.wait_for_rows(campaign_summary(journal).rows)
    check_all_shown(window, journal)

    # The station is killed: the window shows it, nothing is lost, and one key goes on with a new one.
    assert known_stations()[path].pid == station.pid
    os.kill(station.pid, signal.SIGKILL)
    window.wait_for("The station has ended during the run", "rows are kept in small-001.journal", "the shutter may be open")
    kept = campaign_summary(journal)
    assert kept.state == "killed"
    assert kept.rows >= done
    window.press("Alt+U")
    window.answer("Mount gaussian-5", "Mounted")  # a new session; the operator is still a person
    assert window.wait_for_rows(kept.rows + 1) > kept.rows
    until(lambda: campaign_summary(journal).rows > kept.rows)

    # The cut is finished, and what there is exported.
    window.press("Alt+T")
    window.wait_for("ended after the cut, as requested")
    ended = campaign_summary(journal)
    assert (ended.state, ended.sessions) == ("stopped", 2)
    assert kept.rows < ended.rows < ended.planned
    planes, shifts = scan_plane_deg(points_of(journal).beta_deg), points_of(journal).shift_deg
    assert np.unique(shifts[planes == planes[-1]]).tolist() == SHIFTS_DEG
    assert all(fault.startswith("Monitor (PM100D) ") for fault in ended.faults)
    window.press(CAMPAIGNS)
    window.wait_for("| small-001.journal")
    window.press("Alt+X")
    window.wait_for("Export the campaign")
    window.press("Return")
    values = journal.with_suffix(".csv")
    until(values.exists)
    lines = [line for line in values.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    assert len(lines) == 1 + points_of(journal).bsdf.size
    window.press("Ctrl+Q")
    assert window.wait_for_end() == 0, window.errors
