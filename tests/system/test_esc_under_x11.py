"""Esc, held, with the key events of an X server: its auto-repeat, its stamps, and a window that stalls meanwhile.

xdotool has the keyboard of an Xvfb. The window is a process, stalled by SIGSTOP; the stops are those that its station receives.
"""

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.station.connection_file import known_stations
from goniotwin.protocols.clock import RealClock
from tests.conftest import RIG, Writer
from tests.system.conftest import MAIN, until
from tests.system.station_bench import Attached, kill_stations

PROGRAMS = ("Xvfb", "xdotool")
MISSING = [each for each in PROGRAMS if shutil.which(each) is None]
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(MISSING), reason=f"needs {' and '.join(MISSING)}; on Debian: apt-get install -y xvfb xdotool"),
]
HOLDS, TAPS = 40, 20
REST_S = 0.6
"""After a trial: for the end of the hold, and so that the next press is none of auto-repeat."""
LATE_S = 1.5
"""After a tap, for a stop that should not come."""
LONGEST_S = 20.0


class X11Window:
    """`goniotwin desktop` on an X server of its own, with the keyboard of that and a client of the window's station."""

    def __init__(self, display: str, rig: Path, schedule: Path, folder: Path) -> None:
        self._display = {**os.environ, "DISPLAY": display, "QT_QPA_PLATFORM": "xcb"}
        self._errors = folder / "window.err"
        with self._errors.open("w", encoding="utf-8") as errors:
            self.process = subprocess.Popen(
                [*MAIN, "desktop", "--rig", str(rig), "--schedule", str(schedule), "--out", str(folder / "out")],
                env=self._display,
                stdout=errors,
                stderr=errors,
            )
        self._clock = RealClock()
        until(lambda: self.process.poll() is not None or bool(known_stations()))
        if self.process.poll() is not None and "xcb" in self.errors:
            pytest.skip(f"Qt has no X11 here: {self.errors}")
        assert self.process.poll() is None, self.errors
        (path,) = known_stations()
        self.station = Attached(path)
        self.station.wait_for(lambda: self.station.snapshot.rig is not None)
        self._keys("search", "--sync", "--onlyvisible", "--class", "goniotwin", "windowfocus", "--sync")
        while not self.stops:  # until the window has the focus, and knows of the rig
            self._keys("key", "ctrl+period")
            self._clock.sleep_until(self._clock.now() + 0.5)

    @property
    def errors(self) -> str:
        """Its output."""
        return self._errors.read_text(encoding="utf-8")

    @property
    def stops(self) -> int:
        """The stops that the station has received."""
        return self.station.snapshot.stops

    def stops_by(self, keys: Sequence[object], stalled_s: float, goes_on_s: float, wanted: int) -> int:
        """Work the keyboard, with the window stalled from one time to another; return the stops by that."""
        before, began = self.stops, self._clock.now()
        hand = subprocess.Popen(["xdotool", *map(str, keys)], env=self._display)
        if goes_on_s > stalled_s:
            self._clock.sleep_until(began + stalled_s)
            self.process.send_signal(signal.SIGSTOP)
            self._clock.sleep_until(began + goes_on_s)
            self.process.send_signal(signal.SIGCONT)
        assert hand.wait(LONGEST_S) == 0
        up = self._clock.now()
        while self.stops - before < wanted and self._clock.now() < up + LONGEST_S:
            self._clock.sleep_until(self._clock.now() + 0.01)
        self._clock.sleep_until(max(up, self._clock.now()) + (REST_S if wanted else LATE_S))
        assert self.process.poll() is None, self.errors
        return self.stops - before

    def end(self) -> None:
        """End the window and its station."""
        self.process.kill()
        self.process.wait()
        kill_stations()

    def _keys(self, *arguments: str) -> None:
        subprocess.run(["xdotool", *arguments], env=self._display, check=True, stdout=subprocess.DEVNULL)


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    """An X server, by its name."""
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", "1", "-screen", "0", "1280x1024x24", "-nolisten", "tcp"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert server.stdout is not None
    yield f":{server.stdout.readline().strip()}"
    server.terminate()
    server.communicate()


@pytest.fixture
def window(display: str, tmp_path: Path, write_schedule: Writer) -> Iterator[X11Window]:
    window = X11Window(display, RIG, write_schedule(), tmp_path)
    yield window
    window.end()


def hold(seconds: float, before: float = 0.0) -> list[object]:
    """A key that is down for some time."""
    return ["sleep", round(before, 3), "keydown", "Escape", "sleep", round(seconds, 3), "keyup", "Escape"]


def test_a_hold_of_a_second_stops_once_however_the_window_stalls_and_taps_do_not(
    window: X11Window, capsys: pytest.CaptureFixture[str]
) -> None:
    """Stalls of 0.5 to 1.5 s begin from 0.4 s before the press until 0.9 s after it."""
    rng = np.random.default_rng(33)
    down_s = np.linspace(1.1, 2.2, HOLDS)
    free = [hold(each) for each in down_s]
    lengths, begins = rng.permutation(np.linspace(0.5, 1.5, HOLDS)), rng.permutation(np.linspace(0.1, 1.4, HOLDS))
    tap_lengths, tap_begins = np.linspace(0.5, 1.5, TAPS), rng.permutation(np.linspace(0.1, 0.9, TAPS))
    two_taps = [*hold(0.1, 0.5), *hold(0.1, 1.1)]
    trials = {
        "holds, window free": [(keys, 0.0, 0.0, 1) for keys in free],
        "holds, window stalled": [
            (hold(down, 0.5), begin, begin + length, 1) for down, begin, length in zip(down_s, begins, lengths, strict=True)
        ],
        "taps of 0.5 s, window free": [(hold(0.5), 0.0, 0.0, 0)] * (TAPS // 2),
        "taps of 0.5 s, window stalled": [
            (hold(0.5, 0.5), begin, begin + length, 0) for begin, length in zip(tap_begins, tap_lengths, strict=True)
        ][::2],
        "two taps 1.2 s apart, window free": [(two_taps, 0.0, 0.0, 0)] * (TAPS // 2),
        "two taps 1.2 s apart, window stalled": [
            (two_taps, begin, begin + length, 0) for begin, length in zip(tap_begins, tap_lengths, strict=True)
        ][1::2],
    }
    found = {name: [window.stops_by(*each) for each in of] for name, of in trials.items()}
    with capsys.disabled():
        for name, stops in found.items():
            print(f"\n{name}: {sum(map(bool, stops))} of {len(stops)} stopped, {sum(stops)} stops", end="")
    assert found == {name: [wanted for *_, wanted in of] for name, of in trials.items()}
