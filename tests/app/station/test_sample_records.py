"""What the operator states of a sample as it is mounted: kept in the journal, before the schedule, and known in its folder."""

import hashlib
import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

import goniotwin
from goniotwin.app.campaign.journal.samples import known_samples
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.running.events import RowStarted, State
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.data.report.report import report_html
from goniotwin.app.errors import UserError
from goniotwin.app.formats.metadata import SampleMetadata
from goniotwin.app.station.messages import Message, QuestionAsked
from goniotwin.app.station.permissions import CommandRefused
from tests.app.campaign.campaign_bench import QUIET
from tests.app.station.station_bench import StationBench
from tests.conftest import SMALL, Writer

SCHEDULE = f"""{SMALL}
[metadata.samples.gaussian-5]
identifier = "B7-3"
note = "planned"
thickness_mm = 1
"""


def answering(bench: StationBench, give: Callable[[QuestionAsked], dict[str, Any] | None], refused: list[str]) -> None:
    """Answer each mounting with the record that `give` makes; after a refusal without one."""

    def react(message: Message) -> None:
        if not isinstance(message, QuestionAsked):
            return
        try:
            bench.station.answer(message.number, Answer.MOUNTED, sample=give(message))
        except CommandRefused as error:
            refused.append(str(error))
            bench.station.answer(message.number, Answer.MOUNTED)

    bench.reactions.append(react)


def run(bench: StationBench, schedule: Path, folder: Path, record: dict[str, Any] | None) -> tuple[Path, list[str]]:
    """The journal of a run whose operator states a record of the sample, and what was refused."""
    refused: list[str] = []
    answering(bench, lambda asked: record if asked.question.sample else None, refused)
    bench.station.start(schedule, folder, person=True)
    now = bench.work()
    assert now.state is State.DONE
    assert now.journal is not None
    return now.journal, refused


def test_what_is_stated_at_the_mounting_is_in_the_journal_and_comes_before_the_schedule(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    picture = tmp_path / "photos" / "a.jpg"
    picture.parent.mkdir()
    picture.write_bytes(b"a picture")
    given = {"thickness_mm": 1.25, "picture": str(picture), "mounted_by": "A. Person", "side": "the glossy one"}
    journal, refused = run(bench, write_schedule(text=SCHEDULE), tmp_path, given)
    assert refused == []
    with Journal.open(journal) as opened:
        (text,) = opened.event_texts("mounted")
    event = json.loads(text)
    assert datetime.fromisoformat(event["mounted_at"]).tzinfo is not None
    wanted = {
        "thickness_mm": 1.25,
        "picture": "a.jpg",
        "picture_sha256": hashlib.sha256(b"a picture").hexdigest(),
        "mounted_by": "A. Person",
        "mounted_at": event["mounted_at"],
        "side": "the glossy one",
    }
    assert event == {"sample": "gaussian-5", **wanted}
    record = {**asdict(SampleMetadata()), "identifier": "B7-3", "note": "planned", **wanted}
    dataset = goniotwin.open(journal)
    assert asdict(dataset.metadata.sample) == record
    dataset.save(tmp_path / "a.h5")
    assert asdict(goniotwin.open(tmp_path / "a.h5").metadata.sample) == record
    dataset.save(tmp_path / "a.brdf")
    assert asdict(goniotwin.open(tmp_path / "a.brdf").metadata.sample) == record
    html, _ = report_html(journal, kinds=())
    for word in ("thickness, mm", "1.25", "a.jpg", "A. Person"):
        assert word in html
    (known,) = known_samples(tmp_path)
    assert (known.name, known.journal, known.record.note, known.record.thickness_mm) == ("gaussian-5", journal, "planned", 1.25)


def test_a_confirmation_alone_states_the_time_and_no_program_states_anything(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    journal, _ = run(bench, write_schedule(text=SCHEDULE), tmp_path, None)
    with Journal.open(journal) as opened:
        assert opened.sample_records()["gaussian-5"].stated.keys() == {"mounted_at"}
    bench.station.start(write_schedule(text=SCHEDULE), tmp_path)
    now = bench.work()
    assert now.journal is not None
    with Journal.open(now.journal) as opened:
        assert opened.sample_records() == {}


def test_a_record_that_is_wrong_is_refused_and_the_question_stays_open(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    refused: list[str] = []
    records = iter(({"note": "for the etalon"}, {"thicknes_mm": 1.0}))
    answering(bench, lambda _: next(records), refused)
    bench.station.start(write_schedule(text=SCHEDULE), tmp_path, person=True)
    assert bench.work().state is State.DONE
    assert refused == [
        "Mounted: takes no record of a sample; leave it out",
        "sample record: thicknes_mm: there is no such key; did you mean 'thickness_mm'?",
    ]


def test_an_empty_text_takes_the_place_of_what_the_schedule_states(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    given = {"note": "", "thickness_mm": None, "identifier": "", "picture": ""}
    journal, refused = run(bench, write_schedule(text=SCHEDULE), tmp_path, given)
    assert refused == []
    found = goniotwin.open(journal).metadata.sample
    assert (found.note, found.thickness_mm, found.identifier, found.picture_sha256) == ("", None, "gaussian-5", "")


def test_a_picture_that_cannot_be_read_is_refused(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    _, refused = run(bench, write_schedule(text=SCHEDULE), tmp_path, {"picture": str(tmp_path / "no.jpg")})
    assert refused == [f"{tmp_path / 'no.jpg'}: there is no such file; check the name and the folder"]


def test_a_resume_asks_again_and_each_key_has_what_was_stated_last(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, write_rig: Writer
) -> None:
    answering(bench, lambda asked: {"note": "first", "mounted_by": "A"} if asked.question.sample else None, [])

    def stop(message: Message) -> None:
        if isinstance(message, RowStarted) and (message.row.kind, message.row.sample) == ("measure", "gaussian-5"):
            bench.station.stop()

    bench.reactions.append(stop)
    bench.station.start(write_schedule(text=SCHEDULE), tmp_path, person=True)
    now = bench.work()
    assert now.state is State.IDLE
    assert now.journal is not None
    bench.station.close_rig()
    other = StationBench(write_rig(*QUIET))
    answering(other, lambda asked: {"note": "second"} if asked.question.sample else None, [])
    other.station.resume_journal(now.journal)
    assert other.work().state is State.DONE
    other.station.close_rig()
    found = goniotwin.open(now.journal).metadata.sample
    assert (found.note, found.mounted_by, found.identifier) == (
        "second",
        "",
        "B7-3",
    )  # another person may have mounted it again


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"sample": "gaussian-5", "thickness_mm": "x"}', '{"sample": "a", "b": 1}'])
def test_an_event_of_unknown_origin_is_refused_in_one_line(
    text: str, bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    journal, _ = run(bench, write_schedule(text=SCHEDULE), tmp_path, None)
    bench.station.close_rig()
    with closing(sqlite3.connect(journal)) as db:
        db.execute("UPDATE event SET text = ? WHERE kind = 'mounted'", (text,))
        db.commit()
    with Journal.open(journal) as opened, pytest.raises(UserError, match=str(journal)):
        opened.sample_records()
    assert known_samples(tmp_path) == []


def test_of_equal_samples_the_latest_is_known_and_others_beside_it(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    answering(bench, lambda asked: next(records) if asked.question.sample else None, [])
    records = iter(({"note": "one"}, {"note": "two"}, {"identifier": "C1"}))
    for _ in range(3):
        bench.station.start(write_schedule(text=SCHEDULE), tmp_path, person=True)
        assert bench.work().state is State.DONE
    (tmp_path / "z.journal").write_text("no journal", encoding="utf-8")
    found = known_samples(tmp_path)
    assert {(each.record.identifier, each.record.note) for each in found} == {("B7-3", "two"), ("C1", "planned")}
