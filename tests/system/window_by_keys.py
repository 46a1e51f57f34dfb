"""A window in a process of its own, worked by keys alone: what its keys are, and what is to be read in it.

The process runs `goniotwin ARGUMENTS` and takes lines on standard input. A line is a JSON array: the name of a function of
`tests.app.desktop.keyboard`, and its arguments. Its answer is a line with `{"ok": ...}`, or `{"error": ...}`; it is given once
the key has been taken, whatever follows from it. The stations that the window starts have a plug (`station_with_plug`).
"""

import contextlib
import json
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from goniotwin.protocols.clock import RealClock
from tests.conftest import REPOSITORY
from tests.system.station_bench import kill_stations

LONGEST_S = 120.0
LOOK_S = 0.05
MOST_TABS = 100


class WindowByKeys:
    """`goniotwin ARGUMENTS`, which opens a window, and the hands and eyes of its operator."""

    def __init__(self, folder: Path, *arguments: object) -> None:
        self._errors = folder / f"window-{len(list(folder.glob('window-*.err')))}.err"
        with self._errors.open("w", encoding="utf-8") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "tests.system.window_by_keys", *map(str, arguments)],
                cwd=REPOSITORY,
                env={**os.environ, "QT_QPA_PLATFORM": "offscreen"},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
            )
        self._clock = RealClock()
        self.presses = 0

    def press(self, *keys: str) -> None:
        """Press and release keys or combinations, where the focus is."""
        self.presses += len(keys)
        self._do("press", *keys)

    def type_text(self, text: str) -> None:
        """Type a text, where the focus is."""
        self._do("type_text", text)

    def tab_to(self, name: str) -> None:
        """Press Tab until the focus is on the control whose accessible name begins with `name`.

        One key at a time: a question that is about to be active gets the next one.
        """
        passed = []
        for _ in range(MOST_TABS):
            self.press("Tab")
            passed.append(self.focused)
            if passed[-1].startswith(name):
                return
        raise AssertionError(f"Tab does not reach {name}; it reaches {passed}")

    def choose(self, name: str) -> None:
        """Press Tab until the focus is on a control, then Space."""
        self.tab_to(name)
        self.press("Space")

    def answer(self, question: str, choice: str) -> None:
        """Answer a question that comes, once the keys go there."""
        self.wait_for(question, f"[{choice}]")
        self.wait_for_window(question)
        self.choose(choice)

    def press_at(self, key: str) -> float:
        """Press a key; return the calendar time just before, s."""
        return float(self._do("press_at", key))

    @property
    def focused(self) -> str:
        """The accessible name of the control that has the focus."""
        return str(self._do("focused"))

    def seen(self) -> list[str]:
        """What is to be read."""
        return list(map(str, self._do("seen")))

    def reads(self, *texts: str) -> bool:
        """Whether all texts are to be read."""
        return bool(self._do("reads", *texts))

    def wait_for(self, *texts: str) -> None:
        """Wait until all texts are to be read."""
        until = self._clock.now() + LONGEST_S
        while not self.reads(*texts):
            assert self._clock.now() < until, f"{texts} are not to be read: {self.seen()}"
            self._clock.sleep_until(self._clock.now() + LOOK_S)

    def wait_for_window(self, title: str) -> None:
        """Wait until the keys go to the window with this in its title."""
        until = self._clock.now() + LONGEST_S
        while title not in (active := str(self._do("active_title"))):
            assert self._clock.now() < until, f"{active} is active, not {title}"
            self._clock.sleep_until(self._clock.now() + LOOK_S)

    def wait_for_rows(self, rows: int) -> int:
        """Wait until the progress is so many rows; return what it is then."""
        until = self._clock.now() + LONGEST_S
        while self._clock.now() < until:
            found = [int(match[1]) for line in self.seen() if (match := re.match(r"(\d+) of \d+ rows", line))]
            if found and found[0] >= rows:
                return found[0]
            self._clock.sleep_until(self._clock.now() + LOOK_S)
        raise AssertionError(f"{rows} rows are not done: {self.seen()}")

    def wait_for_end(self) -> int:
        """Wait until the process ends; return its status."""
        return self.process.wait(LONGEST_S)

    def kill(self) -> None:
        """Kill the process, if it is still there, and close its pipes."""
        self.process.kill()
        self.process.communicate()

    @property
    def errors(self) -> str:
        """Its standard error."""
        return self._errors.read_text(encoding="utf-8")

    def _do(self, name: str, *arguments: object) -> Any:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(json.dumps([name, *arguments]), file=self.process.stdin, flush=True)
        line = self.process.stdout.readline()
        assert line, f"the window has ended: {self.errors}"
        answer = json.loads(line)
        assert "ok" in answer, answer["error"]
        return answer["ok"]


@contextlib.contextmanager
def windows(folder: Path) -> Iterator[Callable[..., WindowByKeys]]:
    """What opens windows with arguments; in the end kills them, and the stations."""
    opened: list[WindowByKeys] = []

    def open_window(*arguments: object) -> WindowByKeys:
        opened.append(WindowByKeys(folder, "desktop", *arguments))
        return opened[-1]

    yield open_window
    for each in opened:
        each.kill()
    kill_stations()


def run() -> None:
    """Be the process."""
    from PySide6.QtCore import QObject, Qt, Signal, Slot
    from PySide6.QtWidgets import QApplication

    from goniotwin.app.cli.main import main
    from goniotwin.app.station import starting
    from tests.app.desktop import keyboard

    start = starting._start

    def start_with_plug(command: list[str], log: Path) -> "subprocess.Popen[bytes]":
        return start([command[0], "-m", "tests.system.station_with_plug", *command[3:]], log)

    starting._start = start_with_plug

    class Hands(QObject):
        """Take the lines in a thread, and carry them out in the window's thread."""

        ordered = Signal(str)

        def __init__(self) -> None:
            super().__init__()
            self.ordered.connect(self._obey, Qt.ConnectionType.QueuedConnection)
            threading.Thread(target=self._read, daemon=True).start()

        def _read(self) -> None:
            for line in sys.stdin:
                self.ordered.emit(line)

        @Slot(str)
        def _obey(self, line: str) -> None:
            name, *arguments = json.loads(line)
            try:
                answer = {"ok": getattr(keyboard, name)(*arguments)}
            except AssertionError as error:
                answer = {"error": str(error)}
            print(json.dumps(answer), flush=True)

    _application = QApplication(["goniotwin"])
    _hands = Hands()
    main()


if __name__ == "__main__":
    run()
