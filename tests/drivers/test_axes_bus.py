"""Four TMCM-1240 on one RS485 bus instead of one TMCM-6214: the same drivers with another rig file."""

import pytest

from goniotwin.drivers import Refused, TmclController, wait
from goniotwin.drivers.errors import Forgotten
from goniotwin.protocols.tmcl import Command, CommandFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter
from goniotwin.twin.devices import TmclLine
from tests.conftest import RigOpener, tmcl_axis

BUS = (
    ("[twin]\n", '[twin]\ncontroller = { kind = "tmcm-1240", wire = "rs485", baudrate = 57600 }\n'),
    ("baudrate = 115200", "baudrate = 57600"),
    ("gamma = { motor = 3,", "gamma = { motor = 0, module = 1,"),
    ("sigma = { motor = 4,", "sigma = { motor = 0, module = 2,"),
    ("beta = { motor = 5,", "beta = { motor = 0, module = 3,"),
    ("shift = { motor = 0,", "shift = { motor = 0, module = 4,"),
    ("# the sample unit about its normal\nmotor = 3", "\nmotor = 0\nmodule = 1"),
    ("motor = 4\n", "motor = 0\nmodule = 2\n"),
    ("motor = 5\n", "motor = 0\nmodule = 3\n"),
    ("[axes.shift]                            # the arc's polar shift\nmotor = 0", "[axes.shift]\nmotor = 0\nmodule = 4"),
)


def test_axes_on_a_bus_reach_their_targets(opened: RigOpener) -> None:
    rig = opened(*BUS)
    assert rig.virtual is not None
    targets = {"gamma": 90.0, "sigma": 45.0, "beta": 123.0, "shift": 2.5}
    wait(rig.rig.clock, [rig.rig.start(name, target) for name, target in targets.items()])
    for name, target in targets.items():
        assert rig.virtual.plant.angle_deg(name, rig.rig.clock.now()) == pytest.approx(target, abs=1e-3)
        assert rig.rig.axes[name].position_deg() == pytest.approx(target, abs=1e-3)
    assert rig.rig.identities["axes"] == "TMCM-1240"


def test_a_stop_stops_all_axes_of_the_bus(opened: RigOpener) -> None:
    rig = opened(*BUS).rig
    for name in rig.axes:
        rig.axes[name].start(5.0 if name == "shift" else 150.0)
    rig.clock.sleep_until(rig.clock.now() + 0.3)
    start = rig.clock.now()
    assert rig.stop() == []
    assert rig.clock.now() - start < 0.2
    rig.clock.sleep_until(start + 2.0)
    rest = [axis.position_deg() for axis in rig.axes.values()]
    rig.clock.sleep_until(start + 20.0)
    assert [axis.position_deg() for axis in rig.axes.values()] == rest


def test_a_reset_of_one_module_affects_its_own_axis_only(opened: RigOpener) -> None:
    rig = opened(*BUS)
    assert rig.virtual is not None
    line = rig.virtual.serial["axes"]
    assert isinstance(line, TmclLine)
    line.modules[2].reset(rig.rig.clock.now())
    axes = rig.rig.axes
    assert axes["gamma"].position_deg() == 0.0
    with pytest.raises(Forgotten, match="module 2"):
        axes["sigma"].position_deg()
    assert [name for name, axis in axes.items() if axis.unreferenced_reason] == ["sigma"]
    rig.rig.reconnect("axes")
    assert [name for name, axis in axes.items() if axis.unreferenced_reason] == ["sigma"]
    axes["sigma"].set_position()
    assert axes["sigma"].position_deg() == 0.0


def test_each_module_has_its_own_heartbeat(opened: RigOpener) -> None:
    """Only requests to a module keep its own motor turning."""
    rig = opened(*BUS).rig
    rig.axes["sigma"].start(150.0)
    rig.axes["beta"].start(150.0)
    for _ in range(100):
        rig.clock.sleep_until(rig.clock.now() + 0.2)
        tmcl_axis(rig, "beta").read_parameter(AxisParameter.POSITION_REACHED)
    assert rig.axes["beta"].position_deg() == pytest.approx(150.0)
    assert rig.axes["sigma"].position_deg() == pytest.approx(10.0 * 2.0, abs=1.0)  # 2 s at 10 deg/s less the ramps


def test_errors_name_the_module(opened: RigOpener) -> None:
    rig = opened(*BUS).rig
    controller = rig.controllers[0]
    assert isinstance(controller, TmclController)
    with pytest.raises(Refused, match="of module 3"):
        controller.module.exchange(CommandFrame(3, Command.GAP, 99, 0))
