"""Referencing of the axes: `goniotwin home` and `goniotwin here`."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from goniotwin.app.cli.work import referencing
from goniotwin.app.cli.work.bench import BenchFault
from goniotwin.app.cli.work.referencing import home_axes, set_axis_position
from goniotwin.app.errors import UserError
from goniotwin.drivers import TmclAxis, TmclModule
from goniotwin.drivers.motion import StopSteps
from goniotwin.protocols.tmcl import CommandFrame
from tests.conftest import Change, Writer

HOMING = "[axes.sigma.homing]\nmode = 8\nspeed_deg_s = 5.0\nswitch_speed_deg_s = 0.5\nangle_deg = -4.0\n\n"
HOMES: tuple[Change, ...] = (
    ("[axes.beta] ", HOMING + "[axes.beta] "),
    ("sigma = { motor = 4, gear = 36.0 }", "sigma = { motor = 4, gear = 36.0, home_deg = -5.0 }"),
)


def test_home_homes_the_axes_with_a_homing_table(write_rig: Writer, capsys: pytest.CaptureFixture[str]) -> None:
    home_axes(write_rig(*HOMES), [], print)
    (line,) = capsys.readouterr().out.splitlines()
    assert line.startswith("sigma: homed, at ")


@pytest.mark.parametrize(
    ("names", "changes", "message"),
    [
        (["shift"], HOMES, r"axes.shift: has no \[axes.shift.homing\] table; .*goniotwin here --rig .* shift DEG"),
        ([], (), "no axis has a .homing. table"),
        (["omega"], HOMES, "'omega' is not an axis; the axes are gamma, sigma, beta, shift"),
    ],
)
def test_an_axis_that_cannot_be_homed_is_refused(
    write_rig: Writer, names: list[str], changes: tuple[Change, ...], message: str
) -> None:
    with pytest.raises(UserError, match=message):
        home_axes(write_rig(*changes), names, print)


def test_homing_that_finds_no_reference_is_a_fault(write_rig: Writer) -> None:
    rig = write_rig(HOMES[0], ("angle_deg = -4.0", "angle_deg = -4.0\nlongest_s = 5.0"))
    with pytest.raises(BenchFault, match="no reference within 5 s"):
        home_axes(rig, ["sigma"], print)


def test_ctrl_c_stops_the_axes(write_rig: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    stopped: list[str] = []
    begin_stop = TmclModule.begin_stop

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    def record(module: TmclModule, targets: Sequence[tuple[str, CommandFrame]]) -> StopSteps:
        stopped.extend(name for name, _ in targets)
        return begin_stop(module, targets)

    monkeypatch.setattr(referencing, "wait", interrupt)
    monkeypatch.setattr(TmclModule, "begin_stop", record)
    with pytest.raises(KeyboardInterrupt):
        home_axes(write_rig(*HOMES), [], print)
    assert set(stopped) == {"gamma", "sigma", "beta", "shift"}


def test_here_sets_the_position(write_rig: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    angles: list[float | None] = []
    set_position = TmclAxis.set_position

    def record(axis: TmclAxis, angle_deg: float | None = None) -> None:
        angles.append(angle_deg)
        set_position(axis, angle_deg)

    monkeypatch.setattr(TmclAxis, "set_position", record)
    set_axis_position(write_rig(), "sigma", 12.5, lines.append)
    assert (lines, angles) == (["sigma: position set to 12.500 deg"], [12.5])


def test_here_refuses_an_angle_outside_the_limits_or_nan(write_rig: Writer) -> None:
    for angle in (-10.0, float("nan")):
        with pytest.raises(UserError, match="soft limits of 0 to 180 deg"):
            set_axis_position(write_rig(), "sigma", angle, print)


def test_a_rig_file_with_two_kinds_of_reference_is_refused(write_rig: Writer) -> None:
    rig: Path = write_rig(
        ("power_up_at_reference = true\nencoder = false", "power_up_at_reference = true\nhoming_required = true")
    )
    with pytest.raises(UserError, match="contradict"):
        set_axis_position(rig, "sigma", 0.0, print)
