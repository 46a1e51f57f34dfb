"""A person's day with a sample, by keyboard alone: from an empty folder to a PDF, through what goes wrong on the way.

No file is edited. Each window is a process whose keys are pressed and whose texts are read, as in `test_operators_night`.
"""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import goniotwin
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.desktop.results.screen import COMPARISONS
from goniotwin.app.station.connection_file import known_stations
from tests.app.campaign.campaign_bench import QUIET
from tests.app.data.report_values import check_report_values
from tests.conftest import Writer
from tests.system.command_process import FORKED
from tests.system.conftest import until
from tests.system.window_by_keys import WindowByKeys, windows

pytestmark = [
    *FORKED,
    pytest.mark.long,
    pytest.mark.endpoint,
    pytest.mark.usefixtures("heard_hangup"),
]
SPEED = 60.0
MOST_PRESSES = 400
RIG, SCHEDULE, CAMPAIGNS, RESULTS = "Ctrl+1", "Ctrl+3", "Ctrl+5", "Ctrl+6"
FAULTS = '\n[faults]\nwire = "ask"\naxis = "ask"\n\n[metadata]\noperator = "Ada Lovelace"\n'


@pytest.fixture
def open_window(tmp_path: Path) -> Iterator[Callable[..., WindowByKeys]]:
    with windows(tmp_path) as opened:
        yield opened


def test_an_operators_day(open_window: Callable[..., WindowByKeys], write_rig: Writer, tmp_path: Path) -> None:
    pytest.importorskip("weasyprint", reason="the extra `release` is not installed: no PDF")
    pypdf = pytest.importorskip("pypdf", reason="the extra `release` is not installed: no text of a PDF")
    folder, schedule = tmp_path / "day", tmp_path / "day.toml"
    arguments = ("--rig", write_rig(*QUIET), "--out", folder, "--speed", SPEED)
    window = open_window(*arguments)
    window.wait_for("All devices are connected")  # the example has a sample that this rig has not
    window.press(RIG, "Alt+E")
    window.wait_for("[A person is the operator] (checked)")

    # A schedule from a template, with what to do about faults and the operator's name in the text beside the form.
    window.press(SCHEDULE)
    window.choose("New schedule from a template")
    window.wait_for("What is measured: 45:0")
    window.tab_to("What is measured")
    window.press("Down", "Down", "Down")
    window.wait_for("What is measured: isotropic")
    window.tab_to("Longest time, h")
    window.press("Ctrl+A")
    window.type_text("0.5")
    window.press("Return")
    window.wait_for("A new schedule. Save it to measure it")
    window.wait_for("new schedule", " rows, about ", " lamp hours")
    window.tab_to("Text of the schedule file")
    window.press("Ctrl+End")
    for line in FAULTS.splitlines():
        window.type_text(line)
        window.press("Return")
    window.press("Ctrl+S")
    window.wait_for_window("Save the schedule as")
    until(lambda: window.focused == "File name")
    window.type_text(str(schedule))
    window.press("Return")
    window.wait_for("Ready to start.")
    assert schedule.read_text(encoding="utf-8").endswith('operator = "Ada Lovelace"\n')

    # Rehearse: the target is missed beside the lobe, and Start asks for a yes.
    window.press("Ctrl+Shift+R")
    window.wait_for("Rehearsed gaussian-5, isotropic: gaussian-5 misses [target]")
    window.wait_for_window("Rehearsal of gaussian-5, isotropic")
    window.choose("Close ")

    # Start, and mount.
    window.press("Alt+S")
    window.answer("Start gaussian-5, isotropic as it is?", "Start anyway")
    window.answer("Mount etalon", "Wait")
    window.wait_for("The run waits for an answer: Mount etalon")
    window.press("Alt+A")
    window.answer("Mount etalon", "Mounted")
    window.wait_for_window("Mount gaussian-5")
    window.tab_to("Sample: thickness, mm")
    window.type_text("1.5")
    window.press("Alt+M")
    (journal,) = folder.glob("*.journal")
    done = window.wait_for_rows(campaign_summary(journal).rows + 3)

    # The monitor's plug is pulled, and put back; beta jams, and stands at a right angle to where its counter is.
    ((path, station),) = known_stations().items()
    os.kill(station.pid, signal.SIGUSR1)
    window.wait_for("Device fault", "Monitor (PM100D) is not responding", "[Retry]")
    os.kill(station.pid, signal.SIGUSR2)
    window.answer("Device fault", "Retry")
    done = window.wait_for_rows(done + 2)
    os.kill(station.pid, signal.SIGRTMIN)
    window.wait_for("Position of beta unknown", "[Set position]")
    os.kill(station.pid, signal.SIGRTMIN + 1)
    until(lambda: "[Use the encoder]" in window.seen())  # enabled, as its value is known
    window.wait_for_window("Position of beta unknown")
    window.choose("Enter the value of the encoder of beta")
    window.answer("Position of beta unknown", "Set position")
    done = window.wait_for_rows(done + 2)

    # Window and station are killed: nothing is lost, and one key goes on.
    window.process.send_signal(signal.SIGKILL)
    window.wait_for_end()
    os.kill(known_stations()[path].pid, signal.SIGKILL)
    until(lambda: campaign_summary(journal).state == "killed")
    kept = campaign_summary(journal)
    assert kept.rows >= done
    window = open_window(*arguments, "--schedule", schedule)
    window.wait_for(f"Interrupted: gaussian-5, isotropic, {kept.rows} of {kept.planned} rows. Resume?")
    window.press(RIG, "Alt+E")
    window.wait_for("[A person is the operator] (checked)")
    window.choose("Resume. Interrupted")
    window.answer("Mount gaussian-5", "Mounted")
    window.wait_for("Saved in", "values are above the detection limit", "[Results]", "[Report…]", "[Next sample…]")
    assert campaign_summary(journal).state == "done"

    # The result, over what the twin predicts.
    window.answer(f"{journal.stem} is done", "Results")
    window.wait_for("Shares of u²")
    window.press("Alt+K")
    window.wait_for_window("Checks of the campaign")
    window.wait_for(": holds")
    window.choose("Close ")
    window.tab_to("What the values are compared with")
    window.press("Down", "Down")
    window.wait_for(COMPARISONS[2], "orange: prediction of the twin", "chi-square")
    values = goniotwin.open(journal)
    assert values.metadata.sample.thickness_mm == 1.5
    assert values.good.sum() > 0.8 * values.size

    # The report, whose numbers are those of the export.
    window.press("Alt+O")
    window.wait_for_window("Report of the campaign")
    until(lambda: window.focused == "File name")
    pdf, exported = tmp_path / "day.pdf", tmp_path / "day.csv"
    window.press("Ctrl+A")
    window.type_text(str(pdf))
    window.tab_to("Report number")
    window.type_text("A-7")
    window.press("Return")
    window.wait_for(f"Written: SIMULATED, report: {pdf}")
    text = " ".join(" ".join(each.extract_text().split()) for each in pypdf.PdfReader(pdf).pages)
    for each in ("report A-7", "measured by Ada Lovelace", "SIMULATED", "(k = 2)", " of gaussian-5 holds "):
        assert each in text
    values.save(exported)
    assert check_report_values(text, exported)
    assert window.presses < MOST_PRESSES
