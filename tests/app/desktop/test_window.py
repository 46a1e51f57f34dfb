"""What a person sees before anything is measured."""

import re
from pathlib import Path

import pytest
from PySide6.QtWidgets import QAbstractButton, QApplication, QComboBox, QProgressBar
from pytestqt.qtbot import QtBot

from goniotwin.app.desktop import MainWindow, Theme
from goniotwin.app.desktop.model.messages import DEVICES
from goniotwin.drivers import Rig
from tests.app.desktop.conftest import READY_MS, WindowOpener, ready
from tests.conftest import Writer


def test_all_four_devices_of_the_virtual_rig_answer_and_say_who_they_are(window: MainWindow) -> None:
    for device, identity in zip(DEVICES, ("TMCM-6214", "Cornerstone 260", "ADAM-6017", "PM100D"), strict=True):
        assert "✓ answers" in window.parts.devices.text(device)
        assert identity in window.parts.devices.text(device)


def test_a_simulated_rig_is_called_so_in_frame_banner_and_plot(window: MainWindow) -> None:
    assert "SIMULATED (seed 1)" in window.windowTitle()
    assert "SIMULATED" in window.parts.banner
    assert "seed 1" in window.parts.banner
    assert "SIMULATED (seed 1)" in window.parts.plot.title


def test_positions_are_shown_before_anything_runs(qtbot: QtBot, window: MainWindow) -> None:
    qtbot.waitUntil(lambda: window.parts.axes.position("gamma") == "0.00°", timeout=READY_MS)


def test_a_port_that_does_not_exist_is_named_and_the_rest_answers(
    qtbot: QtBot, open_window: WindowOpener, write_rig: Writer
) -> None:
    window = open_window(write_rig(('port = "twin://virtual/axes"', 'port = "/dev/no-such-port"')))
    qtbot.waitUntil(lambda: "does not answer" in window.parts.devices.text("axes"), timeout=READY_MS)
    assert "/dev/no-such-port" in window.parts.devices.text("axes")
    for device in DEVICES[1:]:
        assert "✓ answers" in window.parts.devices.text(device)
    qtbot.waitUntil(lambda: window.session.plan is not None, timeout=READY_MS)
    assert not window.parts.run.start_button.isEnabled()
    assert "no answer from axes" in window.parts.run.start_button.toolTip()
    assert window.parts.run.stop_button.isEnabled()


@pytest.mark.parametrize(
    ("text", "said"),
    [("name = ", "is not TOML"), ('name = "x"\nport = 1', "there is no such key"), (None, "cannot be read")],
)
def test_a_rig_file_that_will_not_do_is_named_in_the_window(
    qtbot: QtBot, open_window: WindowOpener, tmp_path: Path, text: str | None, said: str
) -> None:
    path = tmp_path / "bad.toml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    window = open_window(path)
    qtbot.waitUntil(lambda: re.search(f"bad.toml.*{said}|is missing", window.parts.status) is not None, timeout=READY_MS)
    assert not window.parts.run.start_button.isEnabled()
    assert not window.parts.run.stop_button.isEnabled()


def test_an_address_that_leads_nowhere_is_told(qtbot: QtBot, open_window: WindowOpener, write_rig: Writer) -> None:
    window = open_window(write_rig(("twin://virtual/adc-0", "twin://virtual/adc-9")))
    qtbot.waitUntil(lambda: "adc-9" in window.parts.status + window.parts.devices.text("photodiodes"), timeout=READY_MS)
    assert not window.parts.run.start_button.isEnabled()


def test_a_fault_that_nobody_foresaw_is_told_and_the_window_lives_on(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise AttributeError("no such thing")

    with monkeypatch.context() as patch:
        patch.setattr(Rig, "connect", broken)
        window = open_window()
        qtbot.waitUntil(lambda: "AttributeError: no such thing" in window.parts.status, timeout=READY_MS)
        assert not window.parts.run.stop_button.isEnabled()
    window.parts.rig.again_button.click()
    ready(qtbot, window)


def test_a_schedule_that_the_rig_cannot_do_is_told_and_cannot_be_started(
    qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer
) -> None:
    window = open_window(schedule=write_schedule(("sigma_deg = [30]", "sigma_deg = [30]\ngamma_deg = [400]")))
    qtbot.waitUntil(lambda: "gamma_deg: 400 deg is outside" in window.parts.status, timeout=READY_MS)
    assert not window.parts.run.start_button.isEnabled()
    assert "gamma_deg" in window.parts.run.start_button.toolTip()


def test_a_rig_whose_port_was_mended_connects_again(qtbot: QtBot, open_window: WindowOpener, write_rig: Writer) -> None:
    window = open_window(write_rig(('port = "twin://virtual/axes"', 'port = "/dev/no-such-port"')))
    qtbot.waitUntil(lambda: "does not answer" in window.parts.devices.text("axes"), timeout=READY_MS)
    write_rig()
    window.parts.rig.again_button.click()
    ready(qtbot, window)
    assert "✓ answers" in window.parts.devices.text("axes")


def test_every_control_has_a_name_for_those_who_do_not_see_it(window: MainWindow) -> None:
    controls = [
        control
        for kind in (QAbstractButton, QComboBox, QProgressBar)
        for control in window.parts.findChildren(kind)
        if control.isVisible()
    ]
    assert len(controls) == 9
    assert [control for control in controls if not control.accessibleName()] == []


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
