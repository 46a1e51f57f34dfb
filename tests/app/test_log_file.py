"""The log of a command: what it has, what it never has, and what it does where it cannot be written."""

import logging
import re
from pathlib import Path

import pytest

from goniotwin.app import log_file
from goniotwin.app.campaign.running.event_log import log_event, log_listeners
from goniotwin.app.campaign.running.events import EventLogged, SafetyOrder, State, StateChanged
from goniotwin.app.errors import unexpected_error
from goniotwin.app.log_file import LOG, LogFile, begin_log, end_log, own_log
from goniotwin.drivers import NoAnswer
from tests.conftest import RIG, Writer
from tests.system.command import invoke

LINE = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} real \d+ (DEBUG|INFO|WARNING|ERROR|CRITICAL) [\w.]+: .")


def test_a_log_has_versions_identities_rows_and_the_end(small: Path, tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    done = invoke("run", small, "--rig", RIG, "--out", tmp_path / "a.journal", "--log-file", log)
    assert done.returncode == 0
    lines = log.read_text(encoding="utf-8").splitlines()
    assert all(map(LINE.match, lines)), lines
    text = "\n".join(lines)
    assert re.search(r"goniotwin \d+\.\d+\S*, Python 3\.\d+", lines[0])
    assert "monitor: connected: Thorlabs,PM100D" in text
    rows = re.findall(r"row (\d+) of (\d+), ", text)
    assert [int(k) for k, _ in rows] == list(range(1, len(rows) + 1))
    assert {int(n) for _, n in rows} == {len(rows)}
    assert text.index("run running") < text.index("row 1 of") < text.index("run done") < text.index("closed: axes")


def test_v_shows_the_log_without_rows_and_prints_nothing_twice(small: Path, tmp_path: Path) -> None:
    one = invoke("rehearse", small, "--rig", RIG, "-v").stderr
    two = invoke("rehearse", small, "--rig", RIG, "-vv").stderr
    assert ("monitor: connected" in one, " row 1 of" in one, " row 1 of" in two) == (True, False, True)
    refused = invoke("info", tmp_path / "none.csv", "-v").stderr
    assert len([each for each in refused.splitlines() if each.startswith("goniotwin: ")]) == 1
    assert "ERROR" in refused


def test_logging_is_as_before_after_a_command(small: Path, tmp_path: Path) -> None:
    root = logging.getLogger()
    before = root.handlers[:], root.level, LOG.handlers[:], LOG.level
    invoke("check", small, "--rig", RIG, "-vv", "--log-file", tmp_path / "a.log")
    assert (root.handlers, root.level, LOG.handlers, LOG.level) == before


def test_a_run_without_a_log_makes_no_call_for_it() -> None:
    assert not LOG.isEnabledFor(logging.INFO)
    assert log_listeners() == []


@pytest.mark.parametrize("name", ["missing/a.log", "."])
def test_a_log_that_cannot_be_opened_is_one_line(name: str, small: Path, tmp_path: Path) -> None:
    done = invoke("check", small, "--rig", RIG, "--log-file", tmp_path / name)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "the log cannot be written" in done.stderr


@pytest.mark.parametrize("content", [b"a,b\n1,2\n", b"SQLite format 3\0", b"\x89HDF\r\n", b"2026"])
def test_a_file_that_is_no_log_is_left_as_it_is(content: bytes, small: Path, tmp_path: Path) -> None:
    path = tmp_path / "values.csv"
    path.write_bytes(content)
    done = invoke("check", small, "--rig", RIG, "--log-file", path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert f"{path} is no log of goniotwin, and is left as it is; name another file" in done.stderr
    assert path.read_bytes() == content
    assert [each.name for each in tmp_path.iterdir() if each.name.startswith("values")] == ["values.csv"]


def test_a_log_that_is_there_is_continued(small: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    for _ in range(2):
        assert invoke("check", small, "--rig", RIG, "--log-file", path).returncode == 0
    text = path.read_text(encoding="utf-8")
    assert text.count("command: ") == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
def test_a_log_that_breaks_off_is_one_line_and_the_command_goes_on(small: Path) -> None:
    done = invoke("check", small, "--rig", RIG, "--log-file", "/dev/full")
    assert done.returncode == 0
    assert done.stderr.count("the log ends here") == 1
    assert "Traceback" not in done.stderr


def test_a_log_is_renamed_at_its_size_and_the_oldest_goes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_file, "MOST_BYTES", 2000)
    handler = LogFile(tmp_path / "a.log")
    level = begin_log(handler)
    for k in range(400):
        LOG.info("line %d", k)
    end_log(handler, level)
    files = sorted(tmp_path.iterdir())
    assert [each.name for each in files] == ["a.log", *(f"a.log.{k}" for k in range(1, log_file.OLD_FILES + 1))]
    assert all(each.stat().st_size <= 2000 for each in files)
    assert "line 399" in files[0].read_text(encoding="utf-8")


def test_events_of_a_run_and_failed_exchanges_are_logged(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG, "goniotwin"):
        assert log_listeners() == [log_event]
        log_event(StateChanged(State.FAILED, "no light"))
        log_event(EventLogged("fault", "Monitor is not responding", "row 3", "retry", "read: silent"))
        log_event(SafetyOrder("Close the shutter", "it may be open"))
        NoAnswer("monitor", "read the power", "no reply within 1 s")
    assert [(each.levelname, each.getMessage()) for each in caplog.records] == [
        ("INFO", "run failed: no light"),
        ("INFO", "fault: row 3: Monitor is not responding (read: silent): retry"),
        ("WARNING", "SAFETY: Close the shutter: it may be open"),
        ("DEBUG", "NoAnswer: monitor: read the power: no reply within 1 s"),
    ]


def test_an_unexpected_error_is_in_the_log_with_its_traceback(caplog: pytest.LogCaptureFixture) -> None:
    try:
        raise ZeroDivisionError("of the program")
    except ZeroDivisionError as error:
        unexpected_error(error)
    assert "ZeroDivisionError: of the program" in caplog.text
    assert "Traceback" in caplog.text


def test_a_program_without_a_place_for_its_own_log_works_all_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log_file, "log_folder", lambda: tmp_path / "file" / "log")
    (tmp_path / "file").touch()
    with own_log("window"):
        LOG.info("not written")
    monkeypatch.setattr(log_file, "log_folder", lambda: tmp_path / "log")
    with own_log("window"):
        LOG.info("written")
    assert "written" in (tmp_path / "log" / "window.log").read_text(encoding="utf-8")


@pytest.fixture
def small(write_schedule: Writer) -> Path:
    """A schedule of a few rows."""
    return write_schedule()
