"""Text files: read whole, whatever wrote them, and written so that nobody ever finds half of one."""

import codecs
import contextlib
import os
import re
import threading
from pathlib import Path

from app.formats.errors import FormatError, StrPath

# C0 control characters other than tab, line ends, vertical tab, form feed and DOS's end-of-file mark.
CONTROL = re.compile("[\x00-\x08\x0e-\x19\x1b-\x1f]")
LINE_END = re.compile(r"\r\n|\r|\n")
UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: StrPath) -> str:
    """The text of a file (UTF-8, or the 8-bit alphabet of older programs), line ends as they are.

    Raises FormatError if the file is absent, not a regular file, unreadable, empty or not text.
    """
    try:
        file = Path(path)
        if not file.exists():
            raise FormatError(path, "there is no such file", "check the name and the folder")
        if not file.is_file():
            raise FormatError(path, "is a folder or a device, not a file", "name a file")
        content = file.read_bytes()
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror})", "check the name and the permissions") from error
    if content.startswith(UTF16_MARKS):
        raise FormatError(path, "is UTF-16 text", "save it as plain text (ASCII or UTF-8)")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if found := CONTROL.search(text):
        line = 1 + len(LINE_END.findall(text, 0, found.start()))
        raise FormatError(path, "holds binary data, not text", "name a text file of this format", line)
    if not text.strip():
        raise FormatError(path, "is empty", "export or copy it again")
    return text


def write_text(path: StrPath, text: str) -> None:
    """Write a file as a whole: under another name in the same folder, onto the disk, then renamed to `path`.

    Raises FormatError if that is impossible; what stood at `path` before is then untouched.
    """
    spare = None
    try:
        content = text.encode("utf-8")
        file = Path(os.path.realpath(path))  # a link stays a link
        if file.exists() and not file.is_file():
            raise FormatError(path, "is a folder or a device, not a file", "name a file to write")
        spare = file.parent / f".{os.getpid()}-{threading.get_ident()}.tmp"
        with spare.open("wb") as out:
            out.write(content)
            out.flush()
            os.fsync(out.fileno())
        spare.replace(file)
        _sync_folder(file.parent)
    except OSError as error:
        wrong = f"cannot be written ({error.strerror})"
        raise FormatError(path, wrong, "check the folder, its permissions and the space on the disk") from error
    except UnicodeEncodeError as error:
        raise FormatError(path, "the text holds broken characters", "correct names and comments") from error
    except ValueError as error:
        if isinstance(error, FormatError):
            raise
        raise FormatError(path, "is not a possible file name", "check the name") from error
    finally:
        if spare is not None:
            with contextlib.suppress(OSError):  # after the renaming there is nothing left to remove
                spare.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    # Windows cannot open a folder, and some network disks cannot sync one; the file itself is on the disk by now.
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
