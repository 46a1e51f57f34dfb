"""Windows on the virtual rig, with a schedule that is over in a second, and a clean end whatever the test did."""

import gc
import os
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

import pytest
from PySide6.QtCore import QEvent
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from goniotwin.app.desktop import MainWindow, Theme
from tests.conftest import RIG, Writer

WindowOpener = Callable[..., MainWindow]
READY_MS = 30_000
"""For what takes a second: numba's compilation on a fresh machine is in it."""


@pytest.fixture(scope="package", autouse=True)
def leave_no_widgets() -> Iterator[None]:
    """What is left of them in cycles goes here, and not in a thread of a later test: see `app.desktop.collector`."""
    yield
    gc.collect()


@pytest.fixture
def journals(tmp_path: Path) -> Path:
    return tmp_path / "journals"


@pytest.fixture
def open_window(qapp: QApplication, write_schedule: Writer, journals: Path) -> Iterator[WindowOpener]:
    windows: list[MainWindow] = []

    def opened(rig: Path = RIG, schedule: Path | None = None, speed: float = 200.0) -> MainWindow:
        window = MainWindow(Theme(qapp), rig, schedule or write_schedule(), journals, speed)
        windows.append(window)
        window.show()
        return window

    yield opened
    for window in windows:
        window.shut_down()
        window.hide()
        window.deleteLater()
        qapp.sendPostedEvents(window, QEvent.Type.DeferredDelete)


@pytest.fixture
def window(qtbot: QtBot, open_window: WindowOpener) -> MainWindow:
    """Ready to start, the rig's time at 200 times ours."""
    return ready(qtbot, open_window())


def ready(qtbot: QtBot, window: MainWindow) -> MainWindow:
    """The window, when Start is enabled."""
    qtbot.waitUntil(window.parts.run.start_button.isEnabled, timeout=READY_MS)
    return window
