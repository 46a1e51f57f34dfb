"""How soon the window shows itself, and how smoothly it runs.

    python -m benchmarks.window [--json] [--quick] [--repeats 3]

first_window_cpu_s: CPU time of a process from its start to the first painted window, of `goniotwin` without a command; the
median of some starts. heavy_modules: which of HEAVY it has loaded by then. It runs offscreen, without the time of a display.

frame_p99_ms: the 99th percentile of the time that a repaint of the plot takes during a run of the first schedule at simulation
speed 60; frame_cpu_p99_ms: that of its CPU time. block_p99_ms: that of the time for which an event, one every 20 ms, waits for
the window's thread during the run.

time_left_error_percent: by simulation speed, how far the time left that the window shows after the first tenth of the rows of
examples/schedules/quick.toml is from the time that the run then takes; time_left has the seconds. At 1x this takes five
minutes: not with `--quick`.
map_p99_ms: the 99th percentile of the time that it takes to add a scan to a hemisphere of MAP_POINTS points and to paint it.

results_first_s: time from the opening of a journal of 900,000 values to the picture of the first setting on the screen Results,
the start of the worker included; results_whole_s: to the pictures by all values. results_choice_ms: the median of the time
that a choice of another wavelength takes; results_worker_mb: the largest memory of the worker. The journal takes minutes to
make: with `--results` alone.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from goniotwin.own_files import cache_folder

HEAVY = (
    "numba",
    "llvmlite",
    "h5py",
    "pymodbus",
    "scipy",
    "pandas",
    "matplotlib",
    "xarray",
    "pyqtgraph",
    "serial",
    "usb",
    "numpy",
)
"""Packages that the first window does without."""
SPEED = 60.0
TIMED_SPEEDS = (1.0, 10.0, 60.0)
TENTH = 0.1
MAP_POINTS, SCAN_POINTS, MAP_FRAMES = 120_000, 360, 100
LONGEST_S = 120.0
PING_S = 0.02
READING_S = 10.0
PERCENT = 99


def first_window() -> dict[str, Any]:
    """Start the program in this process; return the CPU time and the modules at the first painted window."""
    sys.argv = ["goniotwin"]
    from PySide6.QtCore import QEvent, QObject, QTimer
    from PySide6.QtWidgets import QApplication, QMainWindow

    from goniotwin.app.cli.main import main  # the time begins with the process

    found: dict[str, Any] = {}

    class FirstPaint(QObject):
        """Notes the time of the first painted window, then closes it."""

        def eventFilter(self, watched: QObject, event: QEvent) -> bool:
            """Look for the end of the first repaint; Qt calls it."""
            if not found and event.type() is QEvent.Type.Paint and isinstance(watched, QMainWindow):
                found["heavy_modules"] = [name for name in HEAVY if name in sys.modules]
                QTimer.singleShot(0, self.close)
            return False

        def close(self) -> None:
            """All widgets are painted."""
            if "first_window_cpu_s" not in found:
                found["first_window_cpu_s"] = time.process_time()
                QApplication.closeAllWindows()

    application = QApplication(["goniotwin"])
    watch = FirstPaint()
    application.installEventFilter(watch)
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
    return found


def run() -> dict[str, Any]:
    """Run the first schedule in a window of this process; return the times of repaints and of the event loop."""
    import pyqtgraph as pg
    from PySide6.QtCore import QObject, Qt, QTimer, Signal, Slot
    from PySide6.QtWidgets import QApplication

    from goniotwin import examples
    from goniotwin.app.desktop import MainWindow, Theme

    class Ping(QObject):
        """Posts an event to the window's thread every PING_S, and notes how long each has waited."""

        sent = Signal(float)

        def __init__(self) -> None:
            super().__init__()
            self.waits: list[float] = []

        @Slot(float)
        def note(self, begin: float) -> None:
            """Note the wait of an event."""
            self.waits.append(time.perf_counter() - begin)

        def send(self, ended: threading.Event) -> None:
            """Post events until the end, in a thread."""
            while not ended.wait(PING_S):
                self.sent.emit(time.perf_counter())

    frames: list[float] = []
    frames_cpu: list[float] = []
    paint = pg.GraphicsView.paintEvent

    def timed(widget: pg.GraphicsView, event: object) -> None:
        begin, begin_cpu = time.perf_counter(), time.thread_time()
        paint(widget, event)
        frames.append(time.perf_counter() - begin)
        frames_cpu.append(time.thread_time() - begin_cpu)

    pg.GraphicsView.paintEvent = timed
    application = QApplication(["goniotwin"])
    with TemporaryDirectory() as journals:
        window = MainWindow(Theme(application), examples.FIRST_RIG, examples.FIRST_SCHEDULE, Path(journals), SPEED)
        window.resize(1280, 800)
        window.show()
        window.complete()
        wait_until_ready(window)
        ping = Ping()
        ping.sent.connect(ping.note, Qt.ConnectionType.QueuedConnection)
        ended = threading.Event()
        sender = threading.Thread(target=ping.send, args=(ended,))
        sender.start()
        frames.clear()
        window.presenter.run_ended.connect(application.quit)
        window.view.run.start_button.click()
        QTimer.singleShot(int(1e3 * LONGEST_S), application.quit)
        application.exec()
        ended.set()
        sender.join()
        rows = window.view.run.progress.value()
        window.shut_down()
    return {
        "frame_p99_ms": 1e3 * percentile(frames),
        "frames": len(frames),
        "frame_cpu_p99_ms": 1e3 * percentile(frames_cpu),
        "block_p99_ms": 1e3 * percentile(ping.waits),
        "block_longest_ms": 1e3 * max(ping.waits),
        "rows": rows,
    }


def wait_until_ready(window: Any) -> None:
    """Wait until Start is enabled, and as long as a person reads what the window shows then: the twin predicts meanwhile."""
    from PySide6.QtCore import QCoreApplication, QEventLoop

    limit = time.monotonic() + LONGEST_S
    while not window.view.run.start_button.isEnabled() and time.monotonic() < limit:
        QCoreApplication.processEvents()
    limit = time.monotonic() + READING_S
    while time.monotonic() < limit:
        QCoreApplication.processEvents(QEventLoop.ProcessEventsFlag.AllEvents, 50)
        time.sleep(PING_S)


def time_left(speed: float) -> dict[str, Any]:
    """Run quick.toml at a simulation speed; return the time left that is shown after a tenth of its rows, and its error."""
    from PySide6.QtCore import QTimer
    from PySide6.QtWidgets import QApplication

    from goniotwin import examples
    from goniotwin.app.desktop import MainWindow, Theme
    from goniotwin.app.station.messages import RowSaved

    application = QApplication(["goniotwin"])
    seen: dict[str, float] = {}
    schedule = examples.FIRST_SCHEDULE.with_name("quick.toml")
    with TemporaryDirectory() as journals:
        window = MainWindow(Theme(application), examples.FIRST_RIG, schedule, Path(journals), speed)
        window.show()
        window.complete()
        wait_until_ready(window)

        def note(message: object) -> None:
            if isinstance(message, RowSaved):
                if message.done >= TENTH * message.total and "left" not in seen:
                    wait = window.presenter.countdown.wait
                    seen.update(left=wait.seconds, band=wait.band, at=time.perf_counter())
                seen["end"] = time.perf_counter()

        window.presenter.message_shown.connect(note)
        window.presenter.run_ended.connect(application.quit)
        window.view.run.start_button.click()
        QTimer.singleShot(int(1e3 * (LONGEST_S + 400.0 / speed)), application.quit)
        application.exec()
        window.connection.command("disconnect")
        window.shut_down()
    took = seen["end"] - seen["at"]
    error = 100.0 * abs(seen["left"] - took) / took
    return {"error_percent": error, "took_s": took, "left_s": seen["left"], "band_s": seen["band"]}


def hemisphere() -> dict[str, Any]:
    """Fill the map of the hemisphere with many points; return the time for a further scan and its repaint."""
    import numpy as np
    from PySide6.QtWidgets import QApplication

    from goniotwin.app.desktop.model.live_scan import ScanData, ScanPoints, Setting
    from goniotwin.app.desktop.model.run_points import RunPoints, map_points
    from goniotwin.app.desktop.run.hemisphere import HemisphereMap
    from goniotwin.app.desktop.theme import LIGHT

    application = QApplication(["goniotwin"])
    rng = np.random.default_rng(1)
    setting: Setting = ("sample", 550.0, 30.0, 0.0)
    shown = HemisphereMap(LIGHT)
    shown.resize(420, 480)
    shown.show()

    def scan(number: int) -> ScanData:
        zenith, azimuth = rng.uniform(0.0, 90.0, SCAN_POINTS), rng.uniform(0.0, 360.0, SCAN_POINTS)
        values = np.exp(-((zenith / 20.0) ** 2)) + 1e-4
        none = np.zeros(SCAN_POINTS, dtype=bool)
        directions = np.stack((zenith, azimuth, zenith, azimuth), axis=1)
        marks = np.zeros(SCAN_POINTS, dtype=np.uint16)
        points = ScanPoints(zenith, values, 0.01 * values, none, none, none, none, none, marks, directions)
        return ScanData("scan", "", "BSDF (1/sr)", (-90.0, 90.0), (), points, key=(setting, 0.001 * number))

    points = RunPoints()
    scans = MAP_POINTS // SCAN_POINTS
    for number in range(scans):
        points.add(scan(number))
    shown.begin(setting, points.hemisphere(setting, transmitted=False))
    shown.stamp(points.hemisphere(setting, transmitted=False))
    frames = []
    for number in range(scans, scans + MAP_FRAMES):
        arrived = scan(number)
        begin = time.perf_counter()
        shown.stamp(map_points([points.add(arrived)], transmitted=False))
        shown.show_points(points.hemisphere(setting, transmitted=False), MAP_POINTS)
        shown.grab()
        frames.append(time.perf_counter() - begin)
    application.processEvents()
    return {"map_p99_ms": 1e3 * percentile(frames), "map_median_ms": 1e3 * statistics.median(frames)}


RESULTS = """
name = "results"
samples = ["satin"]
etalon = "etalon"
sigma_deg = [15, 45]
beta_deg = { start = 0, stop = 180, step = 10 }
shift_deg = { start = 0, stop = 4.5, step = 0.5 }
wavelength_nm = { start = 400, stop = 725, step = 5 }
gains_v_per_a = [1e10]
readings = 2
dark_readings = 8
"""
CHOICES = 20


def results(journal: Path) -> dict[str, Any]:
    """Open a journal on the screen Results; return times, and the memory of its worker (Linux)."""
    import multiprocessing

    from PySide6.QtWidgets import QApplication

    import goniotwin.app.desktop.results.panels  # noqa: F401  (pyqtgraph: a window has loaded it for the screen Run)
    from goniotwin.app.desktop.results.screen import ResultsScreen
    from goniotwin.app.desktop.theme import LIGHT

    application = QApplication(["goniotwin"])
    screen = ResultsScreen(LIGHT)
    screen.complete()
    screen.resize(1180, 620)
    screen.show()

    def seconds(*, done: Callable[[], bool]) -> float:
        begin = time.perf_counter()
        while not done() and time.perf_counter() < begin + LONGEST_S:
            application.processEvents()
            time.sleep(0.001)
        return time.perf_counter() - begin

    screen.begin()
    time.sleep(READING_S)  # a person looks at the list of campaigns
    screen.open_file(journal)
    first = seconds(done=lambda: screen.shown is not None)
    whole = first + seconds(
        done=lambda: len(screen.lights) > 1 and screen.shown is not None and screen.shown.view == screen.wanted
    )
    times = []
    for at in range(CHOICES):
        screen._choose("colour", (7 * at + 3) % (len(screen.lights) // 2))
        times.append(seconds(done=lambda: screen.shown is not None and screen.shown.view == screen.wanted))
    (worker,) = [each for each in multiprocessing.active_children() if each.name == "results"]
    lines = Path(f"/proc/{worker.pid}/status").read_text(encoding="utf-8").splitlines()
    peak = next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))
    screen.shut_down()
    return {
        "results_first_s": first,
        "results_whole_s": whole,
        "results_choice_ms": 1e3 * statistics.median(times),
        "results_worker_mb": peak * 1024 / 1e6,
    }


def write_results_journal(path: Path) -> None:
    """Write the journal of a spectral campaign of 900,000 values."""
    from goniotwin import examples
    from goniotwin.app.campaign.planning.plan import make_plan
    from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
    from goniotwin.app.campaign.schedule.file import parse_schedule
    from goniotwin.app.rig import read_rig

    run_without_wires(make_plan(parse_schedule(RESULTS, "results.toml"), read_rig(examples.FIRST_RIG)), path)


def percentile(values: Sequence[float]) -> float:
    """The 99th percentile."""
    return statistics.quantiles(values, n=100, method="inclusive")[PERCENT - 1]


def measure(part: str) -> dict[str, Any]:
    """The result of a part, measured in a process of its own, with a state folder of its own."""
    with TemporaryDirectory() as state:
        environment = {
            **os.environ,
            "QT_QPA_PLATFORM": "offscreen",
            "XDG_STATE_HOME": state,
            "HOME": state,
            "NUMBA_CACHE_DIR": str(cache_folder()),  # compiled once
        }
        command = [sys.executable, "-m", "benchmarks.window", "--part", part]
        child = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    result: dict[str, Any] = json.loads(child.stdout.splitlines()[-1])
    return result


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--repeats", type=int, default=3, help="number of starts")
    parser.add_argument("--quick", action="store_true", help="without the time left, which takes six minutes")
    parser.add_argument("--results", action="store_true", help="the screen Results alone, on a journal that is made first")
    parser.add_argument("--part", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.results:
        with TemporaryDirectory() as folder:
            journal = Path(folder) / "results.journal"
            write_results_journal(journal)
            print(json.dumps(measure(str(journal))))
        return
    if options.part is not None:
        parts = {"first": first_window, "run": run, "map": hemisphere}
        if options.part.endswith(".journal"):
            print(json.dumps(results(Path(options.part))))
            return
        print(json.dumps(parts[options.part]() if options.part in parts else time_left(float(options.part))))
        return
    starts = [measure("first") for _ in range(options.repeats)]
    result = {
        "first_window_cpu_s": statistics.median(each["first_window_cpu_s"] for each in starts),
        "heavy_modules": sorted({name for each in starts for name in each["heavy_modules"]}),
        **measure("run"),
        **measure("map"),
    }
    if not options.quick:
        times = {f"{speed:g}": measure(f"{speed:g}") for speed in TIMED_SPEEDS}
        result["time_left_error_percent"] = {speed: each.pop("error_percent") for speed, each in times.items()}
        result["time_left"] = times
    if options.json:
        print(json.dumps(result))
        return
    for name, value in result.items():
        print(f"{name:20} {value:.3f}" if isinstance(value, float) else f"{name:20} {value}")


if __name__ == "__main__":
    main()
