"""Windows on the virtual rig, with a schedule that takes a second, and an orderly end after every test."""

import gc
import os
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

import pytest
from PySide6.QtCore import QEvent
from PySide6.QtWidgets import QAbstractButton, QApplication, QLabel, QWidget
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.running.events import State
from goniotwin.app.desktop import MainWindow, Theme
from goniotwin.app.desktop.remembered import Remembered
from goniotwin.app.guardian.guard import record_folder
from goniotwin.app.station.messages import BUSY
from tests.app.desktop.local_stations import LocalStations
from tests.conftest import RIG, Writer

WindowOpener = Callable[..., MainWindow]
READY_MS = 30_000
"""Limit for steps of a second; it includes the compilation by numba on a fresh machine."""
ROWS = 10


@pytest.fixture(scope="package", autouse=True)
def leave_no_widgets() -> Iterator[None]:
    """Collect widgets in reference cycles here, not in a thread of a later test: see `app.desktop.event_loop`."""
    yield
    gc.collect()


@pytest.fixture(autouse=True)
def _nothing_left() -> None:
    """No window shows the order of a program that another test has killed."""
    for each in record_folder().glob("*.json"):
        each.unlink()


@pytest.fixture
def journals(tmp_path: Path) -> Path:
    return tmp_path / "journals"


@pytest.fixture
def stations() -> Iterator[LocalStations]:
    """Stations in this process."""
    stations = LocalStations()
    yield stations
    stations.end()


@pytest.fixture
def open_window(qapp: QApplication, write_schedule: Writer, journals: Path, stations: LocalStations) -> Iterator[WindowOpener]:
    windows: list[MainWindow] = []

    def opened(
        rig: Path = RIG, schedule: Path | None = None, speed: float = 200.0, remembered: Remembered | None = None
    ) -> MainWindow:
        window = MainWindow(Theme(qapp), rig, schedule or write_schedule(), journals, speed, remembered, stations)
        windows.append(window)
        window.show()
        window.complete()
        return window

    yield opened
    for window in windows:
        end_window(qapp, window)


@pytest.fixture
def window(qtbot: QtBot, open_window: WindowOpener) -> MainWindow:
    """A window that is ready to start, at simulation speed 200."""
    return ready(qtbot, open_window())


def end_window(application: QApplication, window: MainWindow) -> None:
    """Close a window, and destroy it now."""
    window.shut_down()
    window.hide()
    window.deleteLater()
    application.sendPostedEvents(window, QEvent.Type.DeferredDelete)


def ready(qtbot: QtBot, window: MainWindow) -> MainWindow:
    """Wait until Start is enabled; return the window."""
    qtbot.waitUntil(window.view.run.start_button.isEnabled, timeout=READY_MS)
    return window


def named_label(shown: QWidget, name: str) -> QLabel:
    """The one label whose accessible name begins so."""
    (found,) = [each for each in shown.findChildren(QLabel) if each.accessibleName().startswith(name)]
    return found


def click(button: QAbstractButton) -> None:
    """Click a button, which must be enabled."""
    assert button.isEnabled()
    button.click()


def wait_for_end(qtbot: QtBot, window: MainWindow, state: State) -> None:
    """Wait until a run has ended, in this state."""
    qtbot.waitUntil(lambda: window.presenter.state not in BUSY and "Saved in" in window.view.saved, timeout=READY_MS)
    assert window.presenter.state is state, window.view.status
