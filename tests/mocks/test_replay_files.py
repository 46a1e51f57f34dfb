"""Transcript files: any content is read back as written; a full disk does not stop the measurement."""

import contextlib
import errno
import io
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.drivers import Transcript
from goniotwin.drivers.motion import tmcl
from goniotwin.drivers.photodiodes.modbus import explain, explain_rtu
from goniotwin.drivers.tap import Explain, as_text
from goniotwin.drivers.usb import control_endpoint
from goniotwin.mocks.transcript import TranscriptError, Transfer, exchanges, merge_transcripts, read_transcript
from goniotwin.protocols.clock import VirtualClock
from tests.conftest import RigOpener
from tests.mocks.replay_bench import QUIET, read_photodiodes

TIMES = st.floats(-1e6, 1e9, allow_nan=False).map(lambda t: round(t, 6))
PIECES = st.lists(st.tuples(TIMES, st.sampled_from("<>"), st.binary(min_size=1, max_size=40)), max_size=20)
EXPLAINS = (as_text, tmcl.explain, control_endpoint.explain, explain, explain_rtu)


class Times(VirtualClock):
    """A clock that returns the time set in `t`."""

    t = 0.0

    def now(self) -> float:
        return self.t


@given(pieces=PIECES, meaning=st.text(max_size=20))
def test_written_transcripts_are_read_back(
    tmp_path_factory: pytest.TempPathFactory, pieces: list[tuple[float, str, bytes]], meaning: str
) -> None:
    folder, clock = tmp_path_factory.mktemp("t"), Times()
    transcript = Transcript(folder, clock)
    tap = transcript.tap("device", lambda direction, data: meaning)
    for t, direction, data in pieces:
        clock.t = t
        tap(direction, data)
    transcript.close()
    found = read_transcript(folder / "device.txt")
    assert [(each.direction, each.data) for each in found] == [(direction, data) for _, direction, data in pieces]
    assert [each.t for each in found] == pytest.approx([t for t, _, _ in pieces], rel=1e-15, abs=5e-7)
    assert [each.line for each in found] == list(range(2, len(pieces) + 2))
    assert {each.file for each in found} <= {"device.txt"}


@pytest.mark.skipif(os.name == "nt", reason="pipes and devices as files")
def test_a_file_without_end_is_no_transcript(tmp_path: Path) -> None:
    pipe, long, many = tmp_path / "pipe.txt", tmp_path / "long.txt", tmp_path / "many.txt"
    os.mkfifo(pipe)
    long.touch()
    os.truncate(long, 10**11)  # takes no room
    many.write_text("0 > 00\n" * 11, encoding="utf-8")
    not_a_file = "is a folder or a device, not a file"
    for path, wrong in (
        (Path("/dev/zero"), not_a_file),
        (pipe, not_a_file),
        (long, "has more than 150000000 bytes"),
        (many, "line 11: has more than 10 transfers"),
    ):
        with pytest.raises(TranscriptError, match=wrong):
            read_transcript(path, 10)


@given(st.sampled_from(EXPLAINS), st.sampled_from("<>"), st.binary(max_size=40))
def test_any_bytes_have_an_explanation_of_one_line(words: Explain, direction: str, data: bytes) -> None:
    assert len(words(direction, data).splitlines()) <= 1


@given(st.lists(PIECES, max_size=4))
def test_merged_transcripts_keep_all_and_each_its_order(lists: list[list[tuple[float, str, bytes]]]) -> None:
    files = [
        [
            Transfer(t, direction, data, k, str(name))
            for k, (t, direction, data) in enumerate(sorted(pieces, key=lambda p: p[0]))
        ]
        for name, pieces in enumerate(lists)
    ]
    line = merge_transcripts(files)
    assert [each.t for each in line] == sorted(each.t for file in files for each in file)
    assert [[each for each in line if each.file == str(name)] for name in range(len(files))] == files
    assert [each for one in exchanges(line) for each in ([one.sent] if one.sent else []) + one.answers] == line


def test_where_times_are_equal_an_answer_comes_before_the_next_question() -> None:
    first = [Transfer(0.0, ">", b"a", 1), Transfer(1.0, "<", b"b", 2)]
    second = [Transfer(1.0, ">", b"c", 1), Transfer(1.0, "<", b"d", 2)]
    assert [each.data for each in merge_transcripts([second, first])] == [b"a", b"b", b"c", b"d"]


@given(st.text(max_size=80))
def test_any_other_text_is_a_transcript_error(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("t") / "other.txt"
    path.write_text(text, encoding="utf-8")
    with contextlib.suppress(TranscriptError):
        assert isinstance(read_transcript(path), list)


@given(st.binary(max_size=80))
def test_any_other_bytes_are_a_transcript_error(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("t") / "other.txt"
    path.write_bytes(data)
    with contextlib.suppress(TranscriptError):
        assert isinstance(read_transcript(path), list)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (" 1.0 > 01 02  | ok\n 2.0 > 0", "line 2: the file ends within it"),
        (" 1.0 > 01 02  | ok\n 2.0 > 01 02", "line 2: the file ends within it"),
        (" 1.0 > 01 2  | odd\n", "line 1: is no line"),
        (f" {'9' * 400} > 01  | late\n", "line 1: 9999"),
        (" nan > 01  | never\n", "line 1: is no line"),
    ],
)
def test_an_error_names_its_line(tmp_path: Path, text: str, why: str) -> None:
    path = tmp_path / "axes.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(TranscriptError, match=why):
        read_transcript(path)


def test_files_of_other_systems_are_read(tmp_path: Path) -> None:
    path = tmp_path / "axes.txt"
    path.write_bytes(b"\xef\xbb\xbf# time\r\n 1.5 > 01 02 | sent\r\n 1.6 < 03 | whole, though its line has no end")
    assert read_transcript(path) == [Transfer(1.5, ">", b"\1\2", 2, "axes.txt"), Transfer(1.6, "<", b"\3", 3, "axes.txt")]


# ---- a disk that is full ----


class FullDisk(io.StringIO):
    """A file that takes `room` lines."""

    def __init__(self, room: int) -> None:
        super().__init__()
        self.room = room

    def write(self, text: str, /) -> int:
        self.room -= 1
        if self.room < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(text)


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> dict[str, FullDisk]:
    """Transcripts with room for nine lines each, by their names."""
    files: dict[str, FullDisk] = {}
    really: Callable[..., IO[Any]] = Path.open

    def opened(path: Path, *arguments: Any, **options: Any) -> IO[Any]:
        if path.suffix != ".txt" or not path.is_relative_to(tmp_path):
            return really(path, *arguments, **options)
        return files.setdefault(path.name, FullDisk(9))

    monkeypatch.setattr(Path, "open", opened)
    return files


def test_a_full_disk_ends_the_transcripts_with_one_message(
    full: dict[str, FullDisk], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    transcript = Transcript(tmp_path, VirtualClock())
    taps = [transcript.tap(device, as_text) for device in ("axes", "monitor")]
    with caplog.at_level(logging.ERROR):
        for tap in taps:
            for _ in range(20):
                tap(">", b"hello")
        transcript.close()
    (message,) = caplog.messages
    assert message == transcript.failure
    assert message.startswith(f"{tmp_path / 'axes.txt'}: the transcript cannot be written: No space left on device; ")
    assert "the measurement continues" in message
    transcript.tap("photodiodes-0", as_text)(">", b"hello")
    assert "photodiodes-0.txt" not in full


def test_a_measurement_continues_without_its_transcript(
    opened: RigOpener, full: dict[str, FullDisk], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    undisturbed = opened(QUIET)
    with_transcript = opened(QUIET, transcript=tmp_path / "wires")
    assert read_photodiodes(with_transcript.rig) == read_photodiodes(undisturbed.rig)
    with_transcript.close()
    assert not with_transcript.rig.monitor.events
    assert len(caplog.messages) == 1
    assert {name for name, file in full.items() if file.room < 0} == {"axes.txt"}


def test_a_file_that_cannot_be_opened_is_reported_in_the_same_way(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "axes.txt").mkdir()
    transcript = Transcript(tmp_path, VirtualClock())
    transcript.tap("axes", as_text)(">", b"hello")
    transcript.tap("monitor", as_text)(">", b"hello")
    transcript.close()
    assert len(caplog.messages) == 1
    assert f"{tmp_path / 'axes.txt'}: the transcript cannot be written" in caplog.messages[0]


def test_a_read_only_folder_is_refused_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "wires").write_text("a file", encoding="utf-8")
    with pytest.raises(OSError, match="wires"):
        Transcript(tmp_path / "wires", VirtualClock())


def test_each_line_is_in_the_file_when_its_bytes_have_passed(tmp_path: Path) -> None:
    transcript = Transcript(tmp_path, VirtualClock())
    transcript.tap("axes", as_text)(">", b"hello")
    assert [each.data for each in read_transcript(tmp_path / "axes.txt")] == [b"hello"]
    transcript.close()
