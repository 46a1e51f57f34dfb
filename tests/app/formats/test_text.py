"""Text files are written completely or not at all; comments cannot damage them."""

import os
import pickle
from pathlib import Path

import pytest

from goniotwin.app.formats.file import FormatError
from goniotwin.app.formats.text import comment_lines, read_text, write_text


def test_a_file_is_replaced_and_no_temporary_file_is_left(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"
    write_text(path, "one\n")
    write_text(path, "two\n")
    assert path.read_bytes() == b"two\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_failed_write_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "out.txt"
    write_text(path, "old")

    def full_disk(_handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full_disk)
    with pytest.raises(FormatError, match=r"cannot be written \(No space left on device\)"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_path_where_no_file_can_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="cannot be written"):
        write_text(tmp_path / "absent" / "out.txt", "")
    with pytest.raises(FormatError, match="is a folder or a device"):
        write_text(tmp_path, "")
    with pytest.raises(FormatError, match="not a possible file name"):
        write_text("a\0b", "")
    assert list(tmp_path.iterdir()) == []


if os.name == "posix":  # Windows has no such device files, and asks for rights to make links

    def test_devices_are_not_replaced_and_links_stay_links(tmp_path: Path) -> None:
        with pytest.raises(FormatError, match="is a folder or a device"):
            write_text(os.devnull, "")
        link = tmp_path / "link.txt"
        link.symlink_to(tmp_path / "target.txt")
        write_text(link, "through")
        assert link.is_symlink()
        assert read_text(tmp_path / "target.txt") == "through"


def test_comments_become_printable_lines() -> None:
    assert comment_lines(["20 °C, σ = 30°, 3 µm", "Müller\r\nnext"], ascii_only=True) == (
        "20  degC, sigma = 30 deg, 3 um",
        "Muller",
        "next",
    )
    assert comment_lines(["a\x1b[31m\tb\x85", "漢"], ascii_only=True) == ("a?[31m b", "?")
    assert comment_lines(["漢 °"], ascii_only=False) == ("漢 °",)


def test_an_error_is_one_printable_line_and_can_be_pickled() -> None:
    error = FormatError("a\nb\x1b.ddr", "is wrong", "correct it", 7)
    assert str(error) == "a b?.ddr, line 7: is wrong; correct it"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
