"""The record of a sample in the question for its mounting: shown as known, refused while wrong, never in the way."""

from pathlib import Path

import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.samples import KnownSample
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.bench.sample_entry import SampleEntry
from goniotwin.app.desktop.dialogs import FileDialog
from goniotwin.app.desktop.events.question import QuestionBox
from tests.app.desktop.conftest import READY_MS, WindowOpener, click, ready, wait_for_end
from tests.app.desktop.keyboard import focused, press
from tests.app.desktop.test_events import answer, wait_for_question
from tests.conftest import SMALL, Writer

SCHEDULE = f"""{SMALL}
[metadata.samples.gaussian-5]
identifier = "B7-3"
note = "planned"
thickness_mm = 1.25
mounted_by = "A. Planner"
"""
OWN = SampleMetadataTable(identifier="B7-3", note="planned", thickness_mm=1.25, mounted_by="A. Person", picture="a.jpg")
OTHER = SampleMetadataTable(identifier="C1", maker="Acme", picture="a.jpg", picture_sha256="0" * 64, mounted_by="B. Person")


@pytest.fixture
def entry(qtbot: QtBot) -> SampleEntry:
    """What is asked of satin, of which another campaign knows one more."""
    entry = SampleEntry()
    qtbot.addWidget(entry)
    own, other = (
        KnownSample("satin", record, Path(f"{journal}.journal"), "2026-01-31T14:05:00+00:00")
        for record, journal in ((OWN, "a"), (OTHER, "b"))
    )
    entry.fields["mounted_by"].setText("C. Person")  # typed before the journals are read
    entry.set_known(own, [own, other])
    return entry


def sample_question(qtbot: QtBot, window: MainWindow) -> tuple[QuestionBox, SampleEntry]:
    """The question for the sample of a run, whose record has been read."""
    window.view.rig.person.setChecked(True)
    click(ready(qtbot, window).view.run.start_button)
    assert wait_for_question(qtbot, window, "etalon").findChild(SampleEntry) is None
    answer(window, "Mounted")
    box = wait_for_question(qtbot, window, "gaussian-5")
    entry = box.findChild(SampleEntry)
    assert entry is not None
    qtbot.waitUntil(lambda: entry.fields["identifier"].text() == "B7-3", timeout=READY_MS)
    return box, entry


def stated(window: MainWindow) -> dict[str, object]:
    """What the journal has of the sample as it was mounted, without the time."""
    assert window.presenter.journal is not None
    with Journal.open(window.presenter.journal) as journal:
        given = journal.sample_records()["gaussian-5"].given
    assert given.pop("mounted_at")
    return given


def test_only_what_a_person_typed_is_given(entry: SampleEntry) -> None:
    assert entry.given() == {"mounted_by": "C. Person"}
    assert (entry.fields["thickness_mm"].text(), entry.fields["note"].text()) == ("1.25", "planned")
    entry.fields["mounted_by"].clear()
    assert entry.given() == {}
    entry.fields["thickness_mm"].setText("1,5")
    entry.fields["note"].setText(" ")
    assert entry.given() == {"thickness_mm": 1.5, "note": ""}
    entry.fields["thickness_mm"].setText("")
    assert entry.given() == {"thickness_mm": None, "note": ""}
    entry.fields["thickness_mm"].setText("thin")
    assert entry.given()["thickness_mm"] == "thin"


def test_a_record_of_another_campaign_replaces_this_one_but_for_who_mounts(entry: SampleEntry) -> None:
    entry.fields["note"].setText("typed")
    assert [entry.known.itemText(at)[:13] for at in range(entry.known.count())] == ["this campaign", "satin, C1, b,"]
    entry.known.setCurrentIndex(1)
    entry.known.activated.emit(1)
    replaced = {"identifier": "C1", "maker": "Acme", "note": "", "thickness_mm": None, "picture_sha256": "0" * 64}
    assert entry.given() == {**replaced, "mounted_by": "C. Person"}
    entry.fields["picture"].setText("/pictures/b.jpg")  # the station finds its digest
    replaced.pop("picture_sha256")
    assert entry.given() == {**replaced, "mounted_by": "C. Person", "picture": "/pictures/b.jpg"}
    entry.known.activated.emit(0)
    assert entry.given() == {"mounted_by": "C. Person"}


def test_the_name_of_a_picture_without_a_digest_is_not_copied(entry: SampleEntry) -> None:
    """A schedule may state one whose file is anywhere: the station would refuse it."""
    entry._records[1] = entry._records[1].model_copy(update={"picture": "elsewhere.jpg", "picture_sha256": ""})
    entry.known.activated.emit(1)
    assert "picture" not in entry.given()


def test_a_wrong_record_is_refused_and_a_right_one_is_in_the_journal(
    qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer, tmp_path: Path
) -> None:
    picture = tmp_path / "a.jpg"
    picture.write_bytes(b"a picture")
    window = ready(qtbot, open_window(schedule=write_schedule(text=SCHEDULE)))
    box, entry = sample_question(qtbot, window)
    entry.fields["thickness_mm"].setText("thin")
    click(box.buttons["Mounted"])
    qtbot.waitUntil(lambda: "thickness_mm" in box.problem and box.isVisible(), timeout=READY_MS)
    entry.fields["thickness_mm"].setText("1.5")
    entry.fields["note"].clear()
    entry._choose_picture()
    (dialog,) = box.findChildren(FileDialog)
    dialog.fileSelected.emit(str(picture))
    dialog.close()
    click(box.buttons["Mounted"])
    wait_for_end(qtbot, window, State.DONE)
    given = stated(window)
    assert len(str(given.pop("picture_sha256"))) == 64
    assert given == {"thickness_mm": 1.5, "note": "", "picture": "a.jpg"}


def test_mounted_is_one_key_and_the_keys_of_stop_hold_in_a_field(
    qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer
) -> None:
    window = ready(qtbot, open_window(schedule=write_schedule(text=SCHEDULE)))
    box, entry = sample_question(qtbot, window)
    qtbot.waitUntil(box.isActiveWindow)
    assert focused().startswith("Wait")
    press("Alt+M")
    wait_for_end(qtbot, window, State.DONE)
    assert stated(window) == {}

    box, entry = sample_question(qtbot, window)
    box.resize(box.width(), 250)
    qtbot.waitUntil(box.isActiveWindow)
    answers = [each.geometry() for each in box.buttons.values()]
    assert all(box.rect().contains(each) for each in answers)
    field = entry.fields["mounted_by"]
    entry.fields["note"].setFocus()
    while QApplication.focusWidget() is not field:
        press("Tab")
    assert entry.viewport().rect().contains(field.mapTo(entry.viewport(), field.rect().center()))
    qtbot.keyClicks(field, "A. Person")
    press("Return")
    assert box.isVisible()
    press("Esc")  # tapped: the question waits
    qtbot.waitUntil(lambda: not box.isVisible())
    window.question.show()
    qtbot.waitUntil(box.isActiveWindow)
    assert field.text() == "A. Person"
    field.setFocus()
    press("Ctrl+.")
    wait_for_end(qtbot, window, State.IDLE)
