"""An operator's way through a bench and a run by keyboard alone: a short part of `tests/system/test_operators_night.py`."""

from pathlib import Path

from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.desktop.bench.screen import READY
from goniotwin.app.desktop.events.question import QuestionBox
from tests.app.desktop.conftest import READY_MS, WindowOpener
from tests.app.desktop.keyboard import focused, press, reads, seen, tab_to
from tests.app.desktop.local_stations import LocalStations
from tests.conftest import SMALL, Writer

LOOK_MS = 50


def wait_for(qtbot: QtBot, *texts: str) -> None:
    """Wait until all texts are to be read in the window."""
    for _ in range(READY_MS // LOOK_MS):
        if reads(*texts):
            return
        qtbot.wait(LOOK_MS)
    raise AssertionError(f"{texts} are not to be read: {seen()}")


def answer(qtbot: QtBot, question: str, choice: str) -> None:
    """Answer a question that comes."""
    wait_for(qtbot, question, f"[{choice}]")
    qtbot.waitUntil(lambda: isinstance(QApplication.activeWindow(), QuestionBox))
    tab_to(choice)
    press("Space")


def test_bench_run_and_resume_by_keys(
    qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer, journals: Path, stations: LocalStations
) -> None:
    open_window(schedule=write_schedule(text=SMALL.replace("[0, 1]", "[0, 1, 2, 3]")), speed=20.0)
    wait_for(qtbot, "Ready to start.")
    press("Ctrl+1")
    wait_for(qtbot, "Ports", "Disk", "σ 0.00°")
    press("Alt+E")
    wait_for(qtbot, "[A person is the operator] (checked)")
    press("Ctrl+2", "Alt+J", "End")
    assert focused() == "Step of a jog"
    tab_to("Jog sigma up")
    press("Space")
    wait_for(qtbot, "30.00°", READY)
    tab_to("Open the shutter")
    press("Space")
    wait_for(qtbot, "[Close]", READY)
    tab_to("Read all photodiodes once")
    press("Space")
    wait_for(qtbot, "Mean of 4: 36 photodiodes")
    press("Alt+L", "End")
    wait_for(qtbot, "Simulation speed: 60×", READY)
    press("Alt+S")
    answer(qtbot, "Mount etalon", "Wait")
    wait_for(qtbot, "The run waits for an answer: Mount etalon")
    press("Alt+A")
    answer(qtbot, "Mount etalon", "Mounted")
    wait_for(qtbot, "Mount gaussian-5")
    (journal,) = journals.glob("*.journal")
    stations.hosts[-1].kill()
    wait_for(qtbot, "The station has ended during the run")
    press("Alt+U")
    answer(qtbot, "Mount gaussian-5", "Mounted")
    wait_for(qtbot, "Saved in")
    tab_to("Plot of the scan in progress")
    for _ in range(READY_MS // LOOK_MS):
        press("Home")  # the plot is drawn anew at the end of a run
        if reads("°: ", "(u)"):
            break
        qtbot.wait(LOOK_MS)
    else:
        raise AssertionError(f"the cursor has no value: {seen()}")
    assert campaign_summary(journal).state == "done"
