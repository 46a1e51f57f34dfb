"""Errors that the user sees: those of input, a full disk, and the last resort for those of the program."""

import errno
import logging
import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path

from goniotwin.protocols.clock import calendar_stamp

LOG = logging.getLogger(__name__)
LOG.addHandler(logging.NullHandler())  # what is logged here is printed too
LONGEST_MESSAGE = 2000
"""Characters of an error message: a value of a file that is quoted in it may be a megabyte."""
IMPOSSIBLE = frozenset({errno.ENAMETOOLONG, errno.EACCES, errno.ELOOP, errno.ENOTDIR})
"""What the system answers to a name that no file can have, or in a folder that this user cannot enter."""
FULL_DISK = frozenset({errno.ENOSPC, errno.EDQUOT})


class UserError(Exception):
    """A mistake with a file, an argument or a device: one printable line with what, where and the remedy.

    A command prints it without a traceback, and ends with `status`.
    """

    status = 2

    def __str__(self) -> str:
        return one_line(super().__str__())


GoniotwinError = UserError
"""Its name in the public API."""


class MissingPackage(UserError):
    """A package of an extra is not installed."""


def one_line(text: str) -> str:
    """The text as one printable line of a readable length."""
    if len(text) > LONGEST_MESSAGE:
        half = LONGEST_MESSAGE // 2
        text = f"{text[:half]} ... {text[-half:]}"
    return printable(text)


def printable(text: str) -> str:
    """The text as one line, a question mark for each character that acts on a terminal."""
    return "".join(letter if letter.isprintable() else " " if letter.isspace() else "?" for letter in text)


def unexpected_error(error: BaseException) -> str:
    """One line about an error that nothing else has handled; its details go to a file, which the line names, and to the log."""
    LOG.critical("unexpected error", exc_info=error)
    # Loads 69 modules, importlib.metadata among them: 26 ms, for an error that should not be.
    from platformdirs import user_log_path

    from goniotwin.version import __version__

    what = "there is not enough memory" if isinstance(error, MemoryError) else "".join(traceback.format_exception_only(error))
    line = f"unexpected error: {what.strip()}"
    about = f"goniotwin {__version__}, Python {sys.version}, {platform.platform()}, {calendar_stamp()}"
    details = "\n".join([about, " ".join(map(ascii, sys.argv)), *traceback.format_exception(error)])
    folders: tuple[Callable[[], Path], ...] = (lambda: user_log_path("goniotwin"), lambda: Path(tempfile.gettempdir()))
    for folder in folders:
        try:
            folder().mkdir(parents=True, exist_ok=True)
            number, name = tempfile.mkstemp(".txt", "fault-", folder(), text=True)
            with open(number, "w", encoding="utf-8", errors="backslashreplace") as file:  # noqa: PTH123  (a file number)
                file.write(details)
        except OSError:  # a read-only disk, or a full one
            continue
        return f"{one_line(line)}; the details are in {name}"
    places = [
        f", at {each.name}, line {each.lineno} of {each.filename}" for each in traceback.extract_tb(error.__traceback__)[-1:]
    ]
    return f"{one_line(line)}{''.join(places)}; the details cannot be written to any folder"


def unusable(path: str | os.PathLike[str], what: str, error: OSError, remedy: str) -> UserError:
    """An error of the system with a file or a folder that a person named: `what` cannot be done, why, and the remedy."""
    return UserError(f"{os.fspath(path)}: {what}: {error.strerror or error}; {room_on_disk(error) or remedy}")


def fault_of_named_path(error: OSError, named: Iterable[str]) -> str:
    """One line about a path that the system refuses, where it is one of those that the person `named`, is below one of these,
    or is the folder of one; also for a name that no file can have. Else empty."""
    if not isinstance(error.filename, str):
        return ""
    path = Path(error.filename).absolute()
    paths = [Path(each.rpartition("=")[2]).absolute() for each in named if each]
    if error.errno in IMPOSSIBLE or any(path == each.parent or path.is_relative_to(each) for each in paths):
        return str(unusable(error.filename, "cannot be used", error, "check the name and the permissions"))
    return ""


def room_on_disk(error: OSError) -> str:
    """The remedy for a file that cannot be written because the disk, or the user's part of it, is full; else empty."""
    return "free space on the disk" if error.errno in FULL_DISK else ""
