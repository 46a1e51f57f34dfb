"""Two spellings of one device are one place, and two devices are two."""

from pathlib import Path

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig.addresses import place_of
from goniotwin.app.rig.lock import RigLock


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("rtu:/dev/ttyUSB1?unit=3&baudrate=9600", "/dev/ttyUSB1"),
        ("127.0.0.1", "127.0.0.1:502"),
        ("127.0.0.1", "rtu:127.0.0.1"),
        ("localhost:4001", "socket://127.0.0.1:4001"),
        ("LOCALHOST:4001", "localhost:4001"),
        ("usbip:127.0.0.1/1-1", "usbip:localhost:3240/1-1"),
        ("COM4", "com4"),
        ("1313:807A:P1", "1313:807a:P1"),
        ("/dev/../dev/ttyUSB0", "/dev/ttyUSB0"),
    ],
)
def test_one_place(one: str, other: str) -> None:
    assert place_of(one) == place_of(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("127.0.0.1:502", "127.0.0.1:503"),
        ("usbip:127.0.0.1/1-1", "usbip:127.0.0.1/1-2"),
        ("1313:8078:P1", "1313:8078:P2"),
        ("no-such-host-anywhere.invalid:1", "another.invalid:1"),
        ("COM4", "COM5"),
    ],
)
def test_two_places(one: str, other: str) -> None:
    assert place_of(one) != place_of(other)


def test_a_link_and_what_it_points_to_are_locked_together(tmp_path: Path) -> None:
    port, link = tmp_path / "ttyACM0", tmp_path / "by-id"
    port.touch()
    link.symlink_to(port)
    held = RigLock([str(port)], "the first", tmp_path / "locks")
    with pytest.raises(UserError, match="the first"):
        RigLock([f"rtu:{link}?unit=2"], "the second", tmp_path / "locks")
    held.release()
