"""Text files are written completely or not at all; comments cannot damage them."""

import os
import pickle
import tracemalloc
from pathlib import Path

import pytest

from goniotwin.app.formats.file import FormatError
from goniotwin.app.formats.text import Words, comment_lines, read_text, write_text


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


def test_words_of_a_long_text_are_not_in_memory_together(tmp_path: Path) -> None:
    """Neither many short lines, nor many words of one line, nor what follows an error."""
    for separator in ("\n", " ", "\r\n"):
        path = tmp_path / "a.ddr"
        path.write_bytes(f"ab{separator}".encode() * 20_000)
        tracemalloc.start()
        words = Words(path, ";;")
        taken = sum(words.take("a word") == "ab" for _ in range(20_000))
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert taken == 20_000
        assert words.peek() is None
        assert words.line == (20_000 if "\n" in separator else 1)
        assert most < 600_000  # the text itself has 60 to 80 kB


def test_more_comments_than_fit_in_memory_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.ddr"
    path.write_text(";;ab\n" * 11)
    with pytest.raises(FormatError, match=r"a\.ddr, line 11: has more than 10 lines of comments"):
        Words(path, ";;", 10)


def test_surplus_numbers_are_counted_and_not_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.ddr"
    path.write_text("1\n" * 10_000)
    words = Words(path, ";;")
    tracemalloc.start()
    with pytest.raises(FormatError, match="line 3: def has too many numbers: 10000, not 2 rows of 1"):
        words.block("def", 2, 1, ())
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 10_000
