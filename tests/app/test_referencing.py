"""Saying where the axes are, from the command line."""

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from goniotwin.app.cli.instrument import home_axes, set_axis_position
from goniotwin.app.errors import UserError
from goniotwin.drivers import Axis, DeviceError, TmclModule
from goniotwin.protocols.tmcl import CommandFrame
from tests.conftest import Change, Writer

HOMING = "[axes.sigma.homing]\nmode = 8\nspeed_deg_s = 5.0\nswitch_speed_deg_s = 0.5\nangle_deg = -4.0\n\n"
HOMES: tuple[Change, ...] = (
    ("[axes.beta] ", HOMING + "[axes.beta] "),
    ("sigma = { motor = 4, gear = 36.0 }", "sigma = { motor = 4, gear = 36.0, home_deg = -5.0 }"),
)


def test_home_homes_what_can_and_says_each(write_rig: Writer, capsys: pytest.CaptureFixture[str]) -> None:
    home_axes(write_rig(*HOMES), [], print)
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("sigma: homed, at ")


@pytest.mark.parametrize(
    ("names", "changes", "told"),
    [
        (["shift"], HOMES, r"axes.shift: has no \[axes.shift.homing\] table; .*goniotwin here --rig .* shift DEG"),
        ([], (), "no axis has a .homing. table"),
        (["omega"], HOMES, "'omega' is not an axis; the axes are gamma, sigma, beta, shift"),
    ],
)
def test_what_cannot_be_homed_is_refused_in_words(
    write_rig: Writer, names: list[str], changes: tuple[Change, ...], told: str
) -> None:
    with pytest.raises(UserError, match=told):
        home_axes(write_rig(*changes), names, print)


def test_a_search_that_finds_nothing_is_a_fault(write_rig: Writer) -> None:
    rig = write_rig(HOMES[0], ("angle_deg = -4.0", "angle_deg = -4.0\nlongest_s = 5.0"))
    with pytest.raises(DeviceError, match="no reference within 5 s"):
        home_axes(rig, ["sigma"], print)


def test_ctrl_c_stops_the_axes(write_rig: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    stop = TmclModule.stop

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    def heard(module: TmclModule, targets: Sequence[tuple[str, CommandFrame]], then: Callable[[], None]) -> list[DeviceError]:
        told.extend(name for name, _ in targets)
        return stop(module, targets, then)

    monkeypatch.setattr("goniotwin.drivers.wait", interrupt)
    monkeypatch.setattr(TmclModule, "stop", heard)
    with pytest.raises(KeyboardInterrupt):
        home_axes(write_rig(*HOMES), [], print)
    assert set(told) == {"gamma", "sigma", "beta", "shift"}


def test_here_is_what_somebody_says(write_rig: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    stated: list[float | None] = []
    assume = Axis.set_position

    def assumed(axis: Axis, angle_deg: float | None = None) -> None:
        stated.append(angle_deg)
        assume(axis, angle_deg)

    monkeypatch.setattr(Axis, "set_position", assumed)
    set_axis_position(write_rig(), "sigma", 12.5, said.append)
    assert (said, stated) == (["sigma: position set to 12.500 deg"], [12.5])


def test_here_outside_the_limits_or_no_angle_is_refused(write_rig: Writer) -> None:
    for angle in (-10.0, float("nan")):
        with pytest.raises(UserError, match="soft limits of 0 to 180 deg"):
            set_axis_position(write_rig(), "sigma", angle, print)


def test_two_ways_to_the_reference_contradict_each_other(write_rig: Writer) -> None:
    rig: Path = write_rig(
        ("power_up_at_reference = true\nencoder = false", "power_up_at_reference = true\nhoming_required = true")
    )
    with pytest.raises(UserError, match="contradict"):
        set_axis_position(rig, "sigma", 0.0, print)
