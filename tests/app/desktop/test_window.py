"""The window before a measurement."""

import re
from pathlib import Path

import pytest
from PySide6.QtWidgets import QApplication, QCheckBox, QProgressBar
from pytestqt.qtbot import QtBot

from goniotwin.app.desktop import MainWindow, Theme
from goniotwin.app.desktop.run.axes import AngleAxis
from goniotwin.app.desktop.theme import DARK, LIGHT, Colours, Scheme
from goniotwin.app.rig.kinds import ROLES
from goniotwin.drivers import Rig
from tests.app.desktop.conftest import READY_MS, WindowOpener, ready
from tests.app.desktop.test_pieces import contrast
from tests.conftest import Writer


def test_all_four_devices_of_the_virtual_rig_are_connected_with_their_identity(window: MainWindow) -> None:
    for device, identity in zip(ROLES, ("TMCM-6214", "Cornerstone 260", "ADAM-6017", "PM100D"), strict=True):
        assert "✓ connected" in window.view.devices.text(device)
        assert identity in window.view.devices.text(device)


def test_a_simulated_rig_is_marked_in_title_banner_and_plot(window: MainWindow) -> None:
    assert "SIMULATED (seed 1)" in window.windowTitle()
    assert "SIMULATED" in window.view.banner
    assert "seed 1" in window.view.banner
    assert "SIMULATED (seed 1)" in window.view.plot.title


def test_positions_are_shown_before_anything_runs(qtbot: QtBot, window: MainWindow) -> None:
    qtbot.waitUntil(lambda: window.view.axes.position("gamma") == "0.00°", timeout=READY_MS)


@pytest.fixture
def no_port(tmp_path: Path) -> str:
    """A port that does not exist, another one in each test: the lock of a port is one for all programs of the computer."""
    return (tmp_path / "no-such-port").as_posix()


def test_a_port_that_does_not_exist_is_named_and_the_other_devices_connect(
    qtbot: QtBot, open_window: WindowOpener, write_rig: Writer, no_port: str
) -> None:
    window = open_window(write_rig(('port = "twin://virtual/axes"', f'port = "{no_port}"')))
    qtbot.waitUntil(lambda: "✗ disconnected" in window.view.devices.text("axes"), timeout=READY_MS)
    assert no_port in window.view.devices.text("axes")
    for device in ROLES[1:]:
        assert "✓ connected" in window.view.devices.text(device)
    qtbot.waitUntil(lambda: window.presenter.plan is not None, timeout=READY_MS)
    assert not window.view.run.start_button.isEnabled()
    assert "not responding: axes" in window.view.run.start_button.toolTip()
    assert window.view.run.stop_button.isEnabled()


@pytest.mark.parametrize(
    ("text", "message"),
    [("name = ", "is not TOML"), ('name = "x"\nport = 1', "there is no such key"), (None, "cannot be read")],
)
def test_an_error_in_the_rig_file_is_shown_with_its_name(
    qtbot: QtBot, open_window: WindowOpener, tmp_path: Path, text: str | None, message: str
) -> None:
    path = tmp_path / "bad.toml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    window = open_window(path)
    qtbot.waitUntil(lambda: re.search(f"bad.toml.*{message}|is missing", window.view.status) is not None, timeout=READY_MS)
    assert not window.view.run.start_button.isEnabled()
    assert not window.view.run.stop_button.isEnabled()


def test_an_address_without_a_device_is_shown(qtbot: QtBot, open_window: WindowOpener, write_rig: Writer) -> None:
    window = open_window(write_rig(("twin://virtual/adc-0", "twin://virtual/adc-9")))
    qtbot.waitUntil(lambda: "adc-9" in window.view.status + window.view.devices.text("photodiodes"), timeout=READY_MS)
    assert not window.view.run.start_button.isEnabled()


def test_an_unexpected_exception_is_shown_and_the_window_stays_open(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise AttributeError("no such thing")

    with monkeypatch.context() as patch:
        patch.setattr(Rig, "connect", broken)
        window = open_window()
        qtbot.waitUntil(lambda: "AttributeError: no such thing" in window.view.status, timeout=READY_MS)
        assert not window.view.run.stop_button.isEnabled()
    window.view.rig.again_button.click()
    ready(qtbot, window)


def test_a_schedule_that_the_rig_cannot_do_is_refused_and_cannot_be_started(
    qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer
) -> None:
    window = open_window(schedule=write_schedule(("sigma_deg = [30]", "sigma_deg = [30]\ngamma_deg = [400]")))
    qtbot.waitUntil(lambda: "gamma_deg: 400 deg is outside" in window.view.status, timeout=READY_MS)
    assert not window.view.run.start_button.isEnabled()
    assert "gamma_deg" in window.view.run.start_button.toolTip()


def test_a_rig_connects_again_after_its_port_is_corrected(
    qtbot: QtBot, open_window: WindowOpener, write_rig: Writer, no_port: str
) -> None:
    window = open_window(write_rig(('port = "twin://virtual/axes"', f'port = "{no_port}"')))
    qtbot.waitUntil(lambda: "✗ disconnected" in window.view.devices.text("axes"), timeout=READY_MS)
    write_rig()
    window.view.rig.again_button.click()
    ready(qtbot, window)
    assert "✓ connected" in window.view.devices.text("axes")


def test_after_a_rig_that_cannot_be_opened_another_one_can(qtbot: QtBot, window: MainWindow, tmp_path: Path) -> None:
    window.connection.operate()
    qtbot.waitUntil(lambda: window.presenter.station.operator != "", timeout=READY_MS)
    window.connection.open(tmp_path / "none.toml")
    qtbot.waitUntil(lambda: "none.toml" in window.view.status, timeout=READY_MS)
    assert window.view.rig.open_button.isEnabled()


@pytest.mark.parametrize(("scheme", "colours"), [("light", LIGHT), ("dark", DARK)])
def test_an_empty_check_box_and_an_empty_progress_bar_have_a_frame(
    qtbot: QtBot, qapp: QApplication, scheme: Scheme, colours: Colours
) -> None:
    """WCAG 2.2, 1.4.11: at least 3 to 1."""
    theme = Theme(qapp, scheme)
    for widget in (QCheckBox("operator"), QProgressBar()):
        qtbot.addWidget(widget)
        image = widget.grab().toImage()
        left = [image.pixelColor(x, image.height() // 2).name() for x in range(8)]
        assert max(contrast(each, colours.window) for each in left) >= 3.0
    theme.force(None)


@pytest.mark.parametrize(
    ("range_deg", "size", "texts_deg"),
    [((-61.0, 122.0), 755.0, 10.0), ((-61.0, 122.0), 300.0, 30.0), ((-2.0, 2.0), 755.0, 0.5)],
)
def test_the_angles_have_texts_at_whole_tens(
    qapp: QApplication, range_deg: tuple[float, float], size: float, texts_deg: float
) -> None:
    """Not at 50, as pyqtgraph has them for the first of these."""
    ticks = AngleAxis().tickValues(*range_deg, size)
    assert ticks[0][0] == texts_deg


def test_the_plot_follows_the_scheme(window: MainWindow, qapp: QApplication) -> None:
    window.theme.force("light")
    light = window.grab().toImage().pixelColor(window.width() - 40, 200).lightness()
    window.theme.force("dark")
    dark = window.grab().toImage().pixelColor(window.width() - 40, 200).lightness()
    window.theme.force(None)
    assert light > 200
    assert dark < 60
    assert isinstance(window.theme, Theme)
    assert qapp.style().objectName() == "fusion"
