"""The campaigns of a folder: their state, and how an unfinished one is resumed."""

import itertools
import sys
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLineEdit
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.rehearsal.without_wires import rows_without_wires, run_without_wires
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop.campaigns.screen import CampaignsScreen
from goniotwin.app.desktop.dialogs import FileDialog
from goniotwin.app.desktop.events.question import QuestionBox
from goniotwin.app.desktop.model.campaigns import list_campaigns
from goniotwin.app.desktop.run.panel import PAUSE
from goniotwin.app.desktop.theme import LIGHT
from goniotwin.app.rig import read_rig
from goniotwin.protocols.clock import local_stamp
from tests.app.desktop.conftest import READY_MS, ROWS, WindowOpener, click, ready, wait_for_end
from tests.conftest import RIG, Writer


@pytest.fixture
def plan(write_schedule: Writer) -> NewPlan:
    return make_plan(read_schedule(write_schedule()), read_rig(RIG))


def killed(plan: NewPlan, path: Path, rows: int) -> None:
    """Leave a journal whose program ended after so many rows, without a word."""
    model = plan.rig.model()
    assert model is not None
    path.parent.mkdir(exist_ok=True)
    with Journal.create(path, plan, software_versions()) as journal:
        journal.begin_session(0.0, plan.rig.text, software_versions())
        for each in itertools.islice(rows_without_wires(plan, model), rows):
            journal.commit(each.row, each.data)


def cell(screen: CampaignsScreen, row: int, column: int) -> str:
    item = screen.table.item(row, column)
    assert item is not None
    return item.text()


def test_the_folder_is_listed_with_what_cannot_be_read(plan: NewPlan, tmp_path: Path, qtbot: QtBot) -> None:
    killed(plan, tmp_path / "a.journal", 4)
    run_without_wires(plan, tmp_path / "b.journal")
    (tmp_path / "c.journal").write_text("no journal", encoding="utf-8")
    listed = list_campaigns(tmp_path)
    assert {each.path.name: each.summary.state for each in listed.campaigns} == {"a.journal": "killed", "b.journal": "done"}
    assert len(listed.errors) == 1
    assert "c.journal" in listed.errors[0]
    found = listed.unfinished(plan)
    assert found is not None
    assert found.path.name == "a.journal"

    screen = CampaignsScreen(LIGHT)
    qtbot.addWidget(screen)
    screen.show_campaigns(listed)
    shown = [[cell(screen, row, column) for column in range(6)] for row in range(2)]
    assert ["✗ killed", f"4 of {ROWS}"] in [each[1:3] for each in shown]
    assert all(each[5] == "SIMULATED" for each in shown)
    begun = {local_stamp(each.summary.begun or "") for each in listed.campaigns}
    assert {each[4] for each in shown} == begun
    assert all(" UTC" in each for each in begun)
    row = next(number for number, each in enumerate(shown) if "killed" in each[1])
    screen.table.selectRow(row)
    assert not screen.resume_button.isEnabled()  # no rig is open
    screen.set_resume("")
    assert screen.resume_button.isEnabled()
    with qtbot.waitSignal(screen.resume_wanted) as resumed:
        screen.resume_button.click()
    assert resumed.args == [tmp_path / "a.journal"]
    screen.table.selectRow(1 - row)
    assert not screen.resume_button.isEnabled()
    assert screen.export_button.isEnabled()


@pytest.mark.skipif(sys.platform == "win32", reason="the program of the test is a shell script")
def test_the_status_of_an_export_is_what_was_written_and_the_warning_after_it(
    qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "program"
    program.write_text("#!/bin/sh\necho 'goniotwin: a warning' >&2\necho 'SIMULATED, 4 values: a.ddr'\necho 'chain'\n")
    program.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(program))
    screen = CampaignsScreen(LIGHT)
    qtbot.addWidget(screen)
    seen: list[tuple[str, bool]] = []
    screen.reported.connect(lambda text, error: seen.append((text, error)))
    screen.run_command("export", tmp_path / "a.journal", tmp_path / "a.ddr")
    qtbot.waitUntil(lambda: len(seen) == 2, timeout=READY_MS)
    assert seen[1] == ("Written: SIMULATED, 4 values: a.ddr; a warning", False)


@pytest.mark.skipif(sys.platform == "win32", reason="the program of the test is a shell script")
def test_a_report_has_number_and_person_and_one_that_is_no_pdf_states_why_and_where_it_is(
    qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, out = tmp_path / "program", tmp_path / "a.pdf"
    program.write_text(
        f"#!/bin/sh\nprintf '%s\\n' \"$@\" > {tmp_path}/given\necho 'goniotwin: no PDF; it is in a.html' >&2\nexit 2\n"
    )
    program.chmod(0o700)
    out.touch()
    monkeypatch.setattr(sys, "executable", str(program))
    screen = CampaignsScreen(LIGHT)
    qtbot.addWidget(screen)
    seen: list[tuple[str, bool]] = []
    screen.reported.connect(lambda text, error: seen.append((text, error)))
    screen.report(tmp_path / "a.journal")
    (dialog,) = screen.findChildren(FileDialog)
    dialog.selectNameFilter(dialog.nameFilters()[1])
    dialog.selectFile(out.name)
    fields = {each.accessibleName(): each for each in dialog.findChildren(QLineEdit)}
    fields["Report number"].setText("R-17 ")
    fields["Approved by"].setText("A. Person")
    dialog.accept()
    click(screen.findChildren(QuestionBox)[0].buttons["Replace"])
    qtbot.waitUntil(lambda: len(seen) == 2, timeout=READY_MS)
    assert seen[1] == ("no PDF; it is in a.html", True)
    given = (tmp_path / "given").read_text().split("\n")[2:]
    assert given == ["report", str(tmp_path / "a.journal"), "--out", str(out), "--number=R-17", "--approved-by=A. Person", ""]


@pytest.mark.parametrize("outcome", [None, "stopped", "failed", "done"])
def test_a_resume_is_offered_of_what_is_unfinished_on_this_rig(
    plan: NewPlan, tmp_path: Path, write_schedule: Writer, write_rig: Writer, outcome: str | None
) -> None:
    """`kill -9` records no end; a full stop, and Finish cut, record that it was stopped."""
    killed(plan, tmp_path / "a.journal", 4)
    if outcome is not None:
        with Journal.reopen(tmp_path / "a.journal") as journal:
            journal.end_session(1, 10.0, outcome)
    listed = list_campaigns(tmp_path)
    assert (listed.unfinished(plan) is None) == (outcome == "done")
    other = read_schedule(write_schedule(("readings = 2", "readings = 3"), name="other.toml"))
    assert listed.unfinished(make_plan(other, plan.rig)) is None
    settling = write_rig(("settling_s = 0.2", "settling_s = 0.3"), name="other.toml")
    assert listed.unfinished(make_plan(plan.schedule, read_rig(settling))) is None


def test_a_folder_that_is_not_there_has_no_campaigns(tmp_path: Path) -> None:
    listed = list_campaigns(tmp_path / "later")
    assert (listed.campaigns, listed.errors) == ((), ())


def test_an_unfinished_campaign_of_the_schedule_is_resumed_with_the_key_of_pause(
    qtbot: QtBot, open_window: WindowOpener, plan: NewPlan, journals: Path
) -> None:
    """After a crash of everything: the journal is all that is left."""
    killed(plan, journals / "small-001.journal", 4)
    window = ready(qtbot, open_window())
    button = window.view.run.pause_button
    qtbot.waitUntil(lambda: button.text() == "Res&ume" and button.isEnabled(), timeout=READY_MS)
    assert f"small-001.journal: 4 of {ROWS} rows" in button.toolTip()
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    qtbot.keyClick(window, Qt.Key.Key_P, Qt.KeyboardModifier.ControlModifier)
    wait_for_end(qtbot, window, State.DONE)
    [begun] = [each for each in window.view.log.entries if each.what.startswith("Run of ")]
    assert (begun.what, begun.consequence) == ("Run of small resumed", f"4 of {ROWS} rows are kept")
    with Journal.open(journals / "small-001.journal") as journal:
        assert journal.row_counts() == (ROWS, ROWS)
    qtbot.waitUntil(lambda: button.text() == PAUSE and not button.isEnabled(), timeout=READY_MS)
    screen = window.view.screen_of(CampaignsScreen)
    qtbot.waitUntil(lambda: screen.table.rowCount() == 1 and "done" in cell(screen, 0, 1), timeout=READY_MS)
