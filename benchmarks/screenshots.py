"""Pictures of every screen of the window, and a check that every control is on the screen.

    python -m benchmarks.screenshots DIR [--scale 100 125 150 200] [--scheme light dark]

The window fills a screen of 1280 x 800 pixels at each scale factor, in a process of its own. It is shown before a run, in a run
of the virtual rig, with a safety order and an open question, and after the run; then the windows beside it. A control that is
not whole on the screen, or a text that is cut off, is printed, and the exit status is then 1.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from PySide6.QtWidgets import QApplication, QWidget

from goniotwin import examples
from goniotwin.app.desktop import MainWindow, Theme
from goniotwin.app.desktop.theme import Scheme
from tests.app.desktop.screen_faults import SCREEN, faults

SCALES = (100, 125, 150, 200)
SCHEMES: tuple[Scheme, ...] = ("light", "dark")
SPEED = 60.0
"""Simulation speed of the run that is shown."""
SHARE = 0.6
"""Part of the rows that are measured in the picture of a run."""
LONGEST_S = 300.0


class Pictures:
    """The pictures of one scale factor."""

    def __init__(self, folder: Path, percent: int, schemes: list[Scheme], journals: Path) -> None:
        self._folder = folder
        self._percent = percent
        self._schemes = schemes
        application = QApplication.instance()
        assert isinstance(application, QApplication)
        self._application = application
        self.window = MainWindow(Theme(application), examples.FIRST_RIG, examples.FIRST_SCHEDULE, journals, SPEED)
        self.faults: list[str] = []

    def take(self) -> None:
        """Take all pictures."""
        window = self.window
        window.resize(SCREEN[0] * 100 // self._percent, SCREEN[1] * 100 // self._percent)
        window.show()
        window.complete()
        self._wait(window.view.run.start_button.isEnabled)
        self._each_screen("ready")
        window.view.run.start_button.click()
        self._wait(lambda: window.view.run.progress.value() >= SHARE * window.view.run.progress.maximum())
        window.view.run.pause_button.click()
        self._wait(lambda: window.view.status.startswith("Paused"))
        self._each_screen("run")
        self._with_order()
        window.view.run.pause_button.click()
        self._wait(lambda: not window.presenter.busy and "Saved in" in window.view.saved)
        self._picture("done-run")
        self._dialogs()
        window.shut_down()

    def _with_order(self) -> None:
        from goniotwin.app.campaign.running.events import SafetyOrder

        view = self.window.view
        order = SafetyOrder("Cut the motors' power", "the stop is not confirmed; sigma: MST: nothing")
        view.orders.add(order)
        view.question.set_question("Mount gaussian-5")
        self._picture("order-run")
        view.question.set_question("")
        view.orders.acknowledge(order)

    def _dialogs(self) -> None:
        """The windows beside the main one."""
        from goniotwin.app.campaign.running.question import EFFECTS, Answer
        from goniotwin.app.desktop.events.question import Choice, QuestionBox
        from goniotwin.app.desktop.menu import TextBox

        window = self.window
        answers = (Answer.RETRY, Answer.SKIP, Answer.PAUSE, Answer.STOP)
        choices = [Choice(each, EFFECTS[each], each is Answer.STOP) for each in answers]
        text = "row 12: monitor: no reply to READ?; fix the fault, then press Retry."
        question = QuestionBox(window, "Device fault", text, choices)
        self._picture("dialog-question", question)
        question.dismiss()
        for action in ("help_wanted", "about_wanted"):
            getattr(window.menus, action).emit()
            box = next(each for each in window.findChildren(TextBox) if each.isVisible())
            self._picture(f"dialog-{action.partition('_')[0]}", box)
            box.close()
            self._settle()

    def _each_screen(self, state: str) -> None:
        view = self.window.view
        shown = view.shown_screen
        for number, screen in enumerate(view.screens):
            view.show_screen(number)
            self._picture(f"{state}-{screen.title.lower()}")
        view.show_screen(shown)

    def _picture(self, name: str, shown: QWidget | None = None) -> None:
        shown = shown or self.window
        for scheme in self._schemes:
            self.window.theme.force(scheme)
            self._settle()
            file = f"{name}-{scheme}-{self._percent}.png"
            shown.grab().save(str(self._folder / file))
            self.faults += [f"{file}: {line}" for line in faults(shown, self._percent)]

    def _settle(self) -> None:
        for _ in range(3):
            self._application.processEvents()
            time.sleep(0.03)

    def _wait(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + LONGEST_S
        while not condition():
            if time.monotonic() > end:
                raise SystemExit(f"the window did not get on: {self.window.view.status}")
            self._application.processEvents()
            time.sleep(0.01)


def of_one_scale(folder: Path, percent: int, schemes: list[Scheme]) -> list[str]:
    """Take the pictures of one scale factor in this process; return the faults."""
    application = QApplication(["goniotwin"])
    with TemporaryDirectory() as journals:
        pictures = Pictures(folder, percent, schemes, Path(journals))
        pictures.take()
        application.processEvents()
    return pictures.faults


def of_all_scales(folder: Path, percents: list[int], schemes: list[Scheme]) -> Iterator[str]:
    """Take the pictures of each scale factor in a process of its own; yield the faults."""
    for percent in percents:
        command = [sys.executable, "-m", "benchmarks.screenshots", str(folder), "--one", str(percent), "--scheme", *schemes]
        environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen", "QT_SCALE_FACTOR": str(percent / 100)}
        child = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True)
        yield from child.stdout.splitlines()
        if child.returncode not in (0, 1):
            yield f"{percent} %: no pictures, status {child.returncode}"


def main() -> int:
    """Take the pictures; return 1 if a control is outside the screen."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--scale", type=int, nargs="+", choices=SCALES, default=list(SCALES), help="in percent")
    parser.add_argument("--scheme", nargs="+", choices=SCHEMES, default=list(SCHEMES))
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.one is None:
        found = list(of_all_scales(options.folder, options.scale, options.scheme))
    else:
        found = of_one_scale(options.folder, options.one, options.scheme)
    for line in found:
        print(line)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
