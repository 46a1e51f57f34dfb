"""The log: where records of the standard library's `logging` go. Modules log by their names, `goniotwin.` first.

A line has the calendar time of this computer (`real`: rows have times of the rig's clock as well, which may be a virtual one),
the process, the level, the module and the message. No record has a token, and none has the content of a file.
"""

import logging
import logging.handlers
import platform
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

LOG = logging.getLogger("goniotwin")
LINE = "%(asctime)s real %(process)d %(levelname)s %(name)s: %(message)s"
MOST_BYTES, OLD_FILES = 5_000_000, 4
"""Size at which a log file is renamed to FILE.1, and the number of renamed ones that are kept."""
FIRST, MOST_READ = re.compile(rb"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} real \d+ [A-Z]+ "), 64
"""How each line of a log begins, and as many bytes of a file as show that."""
PRINTED = "goniotwin.app.cli.output"
"""Its records are what a command prints."""


class LogFile(logging.handlers.RotatingFileHandler):
    """A log file of limited size. Where it cannot be written, one line says so, and the command goes on without it.

    A log that is there is continued. Raises FileExistsError for any other file, which is left as it is, and OSError where it
    cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        if path.is_file():
            with path.open("rb") as file:
                if (first := file.read(MOST_READ)) and FIRST.match(first) is None:
                    raise FileExistsError(f"{path} is no log of goniotwin")
        super().__init__(path, maxBytes=MOST_BYTES, backupCount=OLD_FILES, encoding="utf-8", errors="backslashreplace")
        self._failed = False
        self.setFormatter(logging.Formatter(LINE))

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record (logging calls this)."""
        if not self._failed:
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:
        """Report the first failure, and write no more (logging calls this)."""
        del record
        self._failed = True
        print(f"goniotwin: {self.baseFilename}: the log ends here: {sys.exc_info()[1]}", file=sys.stderr)

    def close(self) -> None:
        """Close the file (logging calls this); what a full disk has not taken is lost, and was reported."""
        with suppress(OSError):
            super().close()


class LogOnScreen(logging.StreamHandler[TextIO]):
    """The log on standard error, without what is printed there in any case."""

    def __init__(self, level: int) -> None:
        super().__init__()
        self.setLevel(level)
        self.setFormatter(logging.Formatter(LINE))
        self.addFilter(lambda record: record.name != PRINTED)


def begin_log(handler: logging.Handler) -> int:
    """Give all records of this program, and other packages' warnings, to a handler. Returns the level to give `end_log`."""
    level = LOG.level
    LOG.setLevel(min(handler.level or logging.DEBUG, level or logging.CRITICAL))
    logging.getLogger().addHandler(handler)
    return level


def end_log(handler: logging.Handler, level: int) -> None:
    """Close a handler, and leave logging as it was."""
    logging.getLogger().removeHandler(handler)
    LOG.setLevel(level)
    handler.close()


def log_folder() -> Path:
    """The folder of the logs of windows and stations, and of the details of unexpected errors. It is not looked at."""
    from platformdirs import user_log_path  # 20 ms, which most commands do without

    return user_log_path("goniotwin")


@contextmanager
def own_log(name: str) -> Iterator[None]:
    """Log to the file `name` of `log_folder`, where that can be written."""
    try:
        log_folder().mkdir(parents=True, exist_ok=True)
        handler = LogFile(log_folder() / f"{name}.log")
    except (OSError, RuntimeError):  # a read-only disk, or no home: neither is a reason not to measure
        yield
        return
    level = begin_log(handler)
    try:
        log_start(handler)
        yield
    finally:
        end_log(handler, level)


def log_start(handler: logging.Handler) -> None:
    """Write to a handler what runs here: versions, system and command."""
    # Loads importlib.metadata, which a command without a log does without.
    from goniotwin.version import __version__

    for text in (
        f"goniotwin {__version__}, Python {platform.python_version()}, {platform.platform()}",
        f"command: {' '.join(map(ascii, sys.argv))}",
    ):
        handler.handle(logging.makeLogRecord({"name": LOG.name, "levelno": logging.INFO, "levelname": "INFO", "msg": text}))
