"""Pictures of every screen of the window, and a check that every control is on the screen.

    python -m benchmarks.screenshots DIR [--scale 100 125 150 200] [--scheme light dark] [--size 1280x800]
    python -m benchmarks.screenshots docs/pictures --readme      # the pictures of docs/operate/window.md

The window fills a screen of so many pixels at each scale factor, in a process of its own. It is shown before its rig is
open, ready, with a tolerance study, at the bench, in a run of the virtual rig, paused, with a safety order and an open
question, with notices, after the run, with many campaigns, and after the death of the station; then the windows beside it. A
control that is not whole on the screen, or a text that is cut off, is printed, and the exit status is then 1.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image
from PySide6.QtCore import QEvent
from PySide6.QtWidgets import QApplication, QTabWidget, QWidget

from goniotwin import examples
from goniotwin.app.campaign.running.events import State
from goniotwin.app.desktop import MainWindow, Theme
from goniotwin.app.desktop.bench.readings_view import NO_READING
from goniotwin.app.desktop.bench.screen import BenchScreen
from goniotwin.app.desktop.campaigns.screen import CampaignsScreen
from goniotwin.app.desktop.results.screen import ResultsScreen
from goniotwin.app.desktop.rig.screen import RigScreen
from goniotwin.app.desktop.run.screen import RunScreen
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.theme import Scheme
from goniotwin.app.desktop.tolerances.screen import FOLDER, TolerancesScreen
from goniotwin.app.desktop.view import SCREENS
from tests.app.desktop.screen_faults import SCREEN, faults

SCALES = (100, 125, 150, 200)
SCHEMES: tuple[Scheme, ...] = ("light", "dark")
SPEED = 60.0
"""Simulation speed of the run that is shown."""
FIRST_SHARE, SHARE = 0.2, 0.85
"""Parts of the rows that are measured in the pictures of a run."""
LONGEST_S, SETTLE_S, PLANE_S = 60.0, 0.3, 4.0
BENCH: tuple[tuple[str, dict[str, object]], ...] = (
    ("mount", {"sample": "satin"}),
    ("move", {"axis": "sigma", "target_deg": 30.0}),
    ("move", {"axis": "beta", "target_deg": 180.0}),
    ("wavelength", {"nm": 550.0}),
    ("gain", {"v_per_a": 1e8}),
    ("shutter", {"opened": True}),
)
"""Commands before the first reading."""
README = {"bench-bench": "window-bench", "running-run": "window-run"}
"""The pictures of docs/operate/window.md, and the names of their files."""
COLOURS = 160
"""Colours of these: they are small files then."""


class Pictures:
    """The pictures of one scale factor."""

    def __init__(
        self, folder: Path, percent: int, schemes: list[Scheme], journals: Path, names: dict[str, str], size: tuple[int, int]
    ) -> None:
        self._folder = folder
        self._size = size
        self._percent = percent
        self._schemes = schemes
        self._names = names
        application = QApplication.instance()
        assert isinstance(application, QApplication)
        self._application = application
        self.window = MainWindow(Theme(application), examples.FIRST_RIG, examples.FIRST_SCHEDULE, journals, SPEED)
        self.faults: list[str] = []

    def take(self) -> None:
        """Take all pictures."""
        window = self.window
        view, run = window.view, window.view.run
        window.resize(*(side * 100 // self._percent for side in self._size))
        window.show()
        self._each_screen("opening")
        window.complete()
        self._wait(run.start_button.isEnabled)
        self._each_screen("ready")
        if not self._names:
            self._with_a_study()
        self._at_the_bench()
        run.start_button.click()
        self._rows(FIRST_SHARE)
        self._picture("etalon-run")
        self._rows(SHARE)
        window.connection.set_speed(1.0)  # the run waits for no picture
        plane = view.screen_of(RunScreen).plane
        plane.setValue(1)
        self._settle(PLANE_S)  # until then the summary is that of the scan
        self._wait(lambda: "predicted" in view.plot.summary and " 0 measured" not in view.plot.summary.replace("\u00a0", " "))
        self._settle(SETTLE_S)
        self._picture("running-run")
        if self._names:
            self._end()
            return
        plane.setValue(0)
        window.connection.set_speed(SPEED)
        run.pause_button.click()
        self._wait(lambda: view.status.startswith("Paused"))
        self._each_screen("paused")
        self._with_notices()
        run.pause_button.click()
        self._wait(lambda: not window.presenter.busy and "Saved in" in view.saved)
        self._picture("done-run")
        self._of_planes()
        self._with_results()
        self._with_many_campaigns()
        self._dialogs()
        self._without_rig()
        self._end()

    def _end(self) -> None:
        """End the run and the station."""
        self.window.connection.stop()
        self._wait(lambda: not self.window.connection.snapshot.busy)
        self.window.connection.command("disconnect")
        self.window.shut_down()

    def _rows(self, share: float) -> None:
        """Wait until this part of the rows is measured."""
        progress = self.window.view.run.progress
        self._wait(lambda: progress.value() >= share * progress.maximum() > 1)

    def _show(self, kind: type[Screen]) -> None:
        self.window.view.show_screen(SCREENS.index(kind))

    def _command(self, name: str, **arguments: object) -> None:
        """Give a command to the bench, and wait until it is done."""
        self.window.connection.command(name, **arguments)
        time.sleep(SETTLE_S)
        self._wait(lambda: not self.window.presenter.station.activity)

    def _at_the_bench(self) -> None:
        """Light on the sample, readings at two gains, and a move that is refused."""
        view = self.window.view
        bench = view.screen_of(BenchScreen)
        self._show(BenchScreen)
        for name, arguments in BENCH:
            self._command(name, **arguments)
        self._command("read", readings=4, dark=True)
        self._command("live", on=True)
        self._wait(lambda: bench.trend.summary != NO_READING and "in 10 min" in bench.trend.summary)
        time.sleep(SETTLE_S)
        self._parts("bench", bench)
        self._command("live", on=False)
        self._command("gain", v_per_a=1e10)
        self._command("move", axis="shift", target_deg=5.0)
        self._command("read", readings=1)
        self._command("move", axis="beta", target_deg=999.0)
        self._parts("refused", bench)
        self._command("shutter", opened=False)
        view.show_screen(SCREENS.index(RunScreen))

    def _parts(self, name: str, screen: Screen) -> None:
        """The pictures of a screen, with that of each of its parts where they are in tabs."""
        tabs = next((each for each in screen.findChildren(QTabWidget) if each.isVisible()), None)
        self._picture(f"{name}-{screen.title.lower()}")
        for at in range(1, 0 if tabs is None else tabs.count()):
            assert tabs is not None
            tabs.setCurrentIndex(at)
            self._picture(f"{name}-{screen.title.lower()}-{at + 1}")
        if tabs is not None:
            tabs.setCurrentIndex(0)

    def _with_a_study(self) -> None:
        """A tolerance study that is computed, and its result."""
        view = self.window.view
        screen = view.screen_of(TolerancesScreen)
        self._show(TolerancesScreen)
        screen.open_study(FOLDER / "quick.toml")
        screen.compute()
        self._wait(lambda: screen.progress.value() > 0 or screen.outcome is not None)
        self._picture("computing-tolerances")
        self._wait(lambda: screen.outcome is not None)
        screen.parts.setCurrentIndex(0)
        self._parts("computed", screen)
        view.show_screen(SCREENS.index(RunScreen))

    def _with_notices(self) -> None:
        """A safety order and a question; a notice about the station; a device that does not respond; points in alarm."""
        from goniotwin.app.campaign.running.events import SafetyOrder
        from goniotwin.app.station.messages import Contact, DeviceStatus

        view = self.window.view
        order = SafetyOrder("Cut the motors' power", "the stop is not confirmed; Axis sigma (TMCM-6214) is not responding")
        view.orders.add(order)
        view.question.set_question("Mount gaussian-5")
        self._picture("order-run")
        view.question.set_question("")
        view.orders.remove(order)
        view.notice.show_notice("terminal 4711 operates this rig; this window watches. Stop works from here too.", "operate")
        statuses = dict(view.devices.statuses)
        silent = DeviceStatus(
            Contact.DISCONNECTED,
            error="Monitor (PM100D) is not responding: check cable and power",
            detail="READ?: no reply in 2 s",
        )
        view.devices.set_devices({**statuses, "monitor": silent})
        for kind in (RunScreen, RigScreen):
            self._show(kind)
            self._parts("notice", view.screen_of(kind))
        view.devices.set_devices(statuses)
        view.notice.clear()
        self._show(RunScreen)

    def _of_planes(self) -> None:
        """The plane of incidence, on each scale."""
        run = self.window.view.screen_of(RunScreen)
        run.plane.setValue(1)
        for scale in ("log", "linear", "symlog"):
            run.scale.setCurrentText(scale)
            self._settle(SETTLE_S)
            self._picture(f"{scale}-run")
        run.scale.setCurrentText("log")
        run.plane.setValue(0)

    def _with_results(self) -> None:
        """The values of the run, with the cursor on the highest one."""
        view = self.window.view
        campaigns, results = view.screen_of(CampaignsScreen), view.screen_of(ResultsScreen)
        self._show(CampaignsScreen)
        self._wait(campaigns.results_button.isEnabled)
        campaigns.results_button.click()
        self._wait(lambda: results.shown is not None)
        self._picture("done-results")
        self._show(RunScreen)

    def _with_many_campaigns(self) -> None:
        """Campaigns in all states, with names that are too long."""
        from goniotwin.app.campaign.journal.summary import CampaignSummary
        from goniotwin.app.desktop.campaigns.screen import MARKS
        from goniotwin.app.desktop.model.campaigns import Campaign, CampaignsListed

        screen = self.window.view.screen_of(CampaignsScreen)
        folder = Path("/home/operator/measurements/2026/facade panels, third series, after weathering")
        found = []
        for number in range(30):
            state = tuple(MARKS)[number % len(MARKS)]
            name = f"panel-{number}" if number % 4 else f"panel-{number}-anodised-aluminium-after-weathering-second-side"
            summary = CampaignSummary(
                str(folder / f"{name}-001.journal"),
                name,
                state,
                17 * number,
                number % 3,
                1096,
                60.0 * number,
                300.0 * number,
                bool(number % 2),
                "2026-11-23T04:26:00",
                None,
                2,
                ["Monitor (PM100D) is not responding"] if number % 3 else [],
                ["Cut the motors' power"] if number == 3 else [],
                "",
            )
            found.append(Campaign(summary, ""))
        screen.refresh_wanted.disconnect()
        self._show(CampaignsScreen)
        screen.show_campaigns(CampaignsListed(folder, tuple(found), ("other.journal: this file is not a journal",)))
        screen.table.selectRow(3)
        self._picture("many-campaigns")
        self._show(RunScreen)

    def _without_rig(self) -> None:
        """What is left after the death of the station."""
        from goniotwin.app.desktop.model.messages import StationLost

        lost = replace(self.window.presenter.station, state=State.RUNNING, done=245, total=394)
        self.window.presenter.message_received.emit(StationLost(lost))
        self._settle()
        self._each_screen("lost")

    def _dialogs(self) -> None:
        """The windows beside the main one."""
        from goniotwin.app.campaign.running.question import EFFECTS, Answer
        from goniotwin.app.desktop.bench.position_entry import NO_ANGLE, PositionEntry
        from goniotwin.app.desktop.dialogs import TextBox
        from goniotwin.app.desktop.events.question import Choice, QuestionBox

        window = self.window
        answers = (Answer.RETRY, Answer.SKIP, Answer.PAUSE, Answer.STOP)
        choices = [Choice(each, EFFECTS[each], each is Answer.STOP) for each in answers]
        text = "row 12: Monitor (PM100D) is not responding: check cable and power."
        question = QuestionBox(window, "Device fault", text, choices)
        self._picture("dialog-question", question)
        question.dismiss()
        entry = PositionEntry("beta")
        entry.show_place(150.0, 180.003)
        of_axis = (Answer.HOME, Answer.SET_POSITION, *answers)
        choices = [Choice(each, EFFECTS[each], each is Answer.STOP) for each in of_axis]
        text = "row 12: beta: its counter is at 150.000 deg and its encoder at 180.003 deg, more than 0.05 deg apart."
        question = QuestionBox(window, "Position of beta unknown", text, choices, entry)
        question.set_problem(NO_ANGLE)
        self._picture("dialog-position", question)
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
        if self._names and name not in self._names:
            return
        shown = shown or self.window
        for scheme in self._schemes:
            self.window.theme.force(scheme)
            self._settle()
            file = f"{self._names[name]}-{scheme}.png" if self._names else f"{name}-{scheme}-{self._percent}.png"
            shown.grab().save(str(self._folder / file))
            if self._names:
                with Image.open(self._folder / file) as image:
                    few = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
                few.save(self._folder / file, optimize=True)
            self.faults += [f"{file}: {line}" for line in faults(shown, self._percent, self._size)]

    def _settle(self, seconds: float = 0.0) -> None:
        time.sleep(seconds)
        for _ in range(3):
            self._application.processEvents()
            time.sleep(0.03)
        for _ in range(3):  # what has changed in a run since then is laid out, too
            self._application.sendPostedEvents(None, QEvent.Type.LayoutRequest)

    def _wait(self, condition: Callable[[], bool]) -> None:
        end = time.monotonic() + LONGEST_S
        while not condition():
            if time.monotonic() > end:
                raise SystemExit(f"the window did not get on: {self.window.view.status}")
            self._application.processEvents()
            time.sleep(0.01)


def of_one_scale(folder: Path, percent: int, schemes: list[Scheme], names: dict[str, str], size: tuple[int, int]) -> list[str]:
    """Take the pictures of one scale factor in this process; return the faults."""
    application = QApplication(["goniotwin"])
    with TemporaryDirectory(prefix="campaigns-") as journals:
        pictures = Pictures(folder, percent, schemes, Path(journals), names, size)
        pictures.take()
        application.processEvents()
    return pictures.faults


def of_all_scales(
    folder: Path, percents: list[int], schemes: list[Scheme], more: list[str], size: tuple[int, int]
) -> Iterator[str]:
    """Take the pictures of each scale factor in a process of its own, with a state folder and a station of its own; yield the
    faults.
    """
    for percent in percents:
        command = [
            sys.executable,
            "-m",
            "benchmarks.screenshots",
            str(folder),
            *more,
            "--one",
            str(percent),
            "--size",
            "{}x{}".format(*size),
        ]
        with TemporaryDirectory() as state:
            screen = Path(state) / "screen.json"
            about = {"name": "screen", "x": 0, "y": 0, "width": size[0], "height": size[1], "logicalDpi": 96, "dpr": 1}
            screen.write_text(json.dumps({"screens": [about | {"logicalBaseDpi": 96}]}), encoding="utf-8")
            environment = {
                **os.environ,
                "QT_QPA_PLATFORM": f"offscreen:configfile={screen}",
                "QT_SCALE_FACTOR": str(percent / 100),
                "XDG_STATE_HOME": state,
                "WIN_PD_OVERRIDE_LOCAL_APPDATA": state,
                "QT_LOGGING_RULES": "qt.qpa.*=false",
            }
            child = subprocess.run([*command, "--scheme", *schemes], env=environment, stdout=subprocess.PIPE, text=True)
        yield from child.stdout.splitlines()
        if child.returncode not in (0, 1):
            yield f"{percent} %: no pictures, status {child.returncode}"


def main() -> int:
    """Take the pictures; return 1 if a control is outside the screen."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--scale", type=int, nargs="+", choices=SCALES, default=list(SCALES), help="in percent")
    parser.add_argument("--scheme", nargs="+", choices=SCHEMES, default=list(SCHEMES))
    parser.add_argument("--size", default="{}x{}".format(*SCREEN), help="pixels of the screen")
    parser.add_argument("--readme", action="store_true", help="only the pictures of the README, at 100 percent")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    wide, high = map(int, options.size.split("x"))
    if options.one is None:
        scales, more = ([100], ["--readme"]) if options.readme else (options.scale, [])
        found = list(of_all_scales(options.folder, scales, options.scheme, more, (wide, high)))
    else:
        found = of_one_scale(options.folder, options.one, options.scheme, README if options.readme else {}, (wide, high))
    for line in found:
        print(line)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
