"""Orders over the simulation control port."""

import contextlib
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.app.rig import read_rig
from goniotwin.drivers import DeviceError, wait
from goniotwin.mocks.control import ControlClient, ControlPort, ControlServer
from goniotwin.mocks.faulty_wires import FaultyWires
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from tests.conftest import RIG, RigOpener

QUIET = ("noise = true", "noise = false")


def test_a_jammed_axis_does_not_turn_and_the_encoder_shows_it(opened: RigOpener) -> None:
    rig = opened(QUIET)
    assert rig.virtual is not None
    door = ControlPort(rig.virtual)
    assert door.obey({"do": "jam", "axis": "beta"}) == {"ok": True}
    before = rig.virtual.plant.angle_deg("beta", rig.rig.clock.now())
    with contextlib.suppress(DeviceError):  # an axis that monitors its encoder raises a fault
        wait(rig.rig.clock, [rig.rig.start("beta", 20.0)])
    assert rig.rig.axes["beta"].encoder_deg() == pytest.approx(before, abs=0.1)
    assert rig.virtual.plant.angle_deg("beta", rig.rig.clock.now()) == pytest.approx(before, abs=0.1)


BAD: list[dict[str, Any]] = [
    {"do": "mount", "sample": 3},
    {"do": "mount", "sample": "satin"},
    {"do": "mount"},
    {"do": "jam", "axis": "delta"},
    {"do": "jam", "axis": ["beta"]},
    {"do": "jam", "axis": {"a": 1}},
    {"do": "jam"},
    {"do": "jam", "axis": "beta", "jammed": "no"},
    {"do": "jam", "axis": "beta", "jammed": None},
    {"do": "lamp", "level": "x"},
    {"do": "lamp", "level": -0.1},
    {"do": "lamp", "drift_per_hour": True},
    {"do": "tilt"},
    {"do": "tilt", "deg": 91},
    {"do": "tilt", "deg": -10.1},
    {"do": "tilt", "deg": float("nan")},
    {"do": ["x"]},
    {"do": {"a": 1}},
    {"do": None},
]


@pytest.mark.parametrize("order", BAD, ids=repr)
def test_an_invalid_order_returns_an_error_message(opened: RigOpener, order: dict[str, Any]) -> None:
    rig = opened(QUIET)
    assert rig.virtual is not None
    answer: dict[str, Any] = ControlPort(rig.virtual).obey(order)
    assert answer["ok"] is False
    assert answer["error"]
    assert json.dumps(answer)


def test_only_null_removes_the_sample(opened: RigOpener) -> None:
    rig = opened(QUIET)
    assert rig.virtual is not None
    door = ControlPort(rig.virtual)
    assert door.obey({"do": "mount", "sample": "etalon"}) == {"ok": True}
    assert not door.obey({"do": "mount"})["ok"]
    assert door.obey({"do": "state"})["sample"] == "etalon"
    assert door.obey({"do": "mount", "sample": None}) == {"ok": True}
    assert door.obey({"do": "state"})["sample"] is None


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=10,
)
WORDS = (
    "do",
    "sample",
    "deg",
    "level",
    "drift_per_hour",
    "axis",
    "jammed",
    "device",
    "kinds",
    "share",
    "seed",
    "exchanges",
    "script",
    "reset",
)
VALUES = (
    st.sampled_from(["mount", "lamp", "tilt", "jam", "state", "faults", "beta", "etalon", "axes", "adc-0", "monitor"]) | JSON
)
ORDERS = st.builds(
    lambda what, rest: {**rest, "do": what},
    st.sampled_from(["mount", "lamp", "tilt", "jam", "state", "faults"]),
    st.dictionaries(st.sampled_from(WORDS), VALUES, max_size=6),
)


@pytest.fixture(scope="module")
def door() -> ControlPort:
    model = read_rig(RIG).model()
    assert model is not None
    clock = VirtualClock()
    rig = VirtualRig.build(model, clock)
    wires = FaultyWires(rig, clock)
    for name, device in rig.serial.items():
        wires.line(name, device, lambda: None, lambda: None)
    for name in rig.modbus:
        wires.connections(name, lambda: None, lambda: None)
    for name in [*rig.usb]:
        wires.usb(name, lambda: None, lambda reset: None)
    return ControlPort(rig, wires.orders)


@given(order=st.dictionaries(st.text(max_size=6), JSON, max_size=4) | ORDERS)
def test_any_order_is_answered(door: ControlPort, order: dict[str, Any]) -> None:
    answer = door.obey(order)
    assert isinstance(answer["ok"], bool)
    assert answer["ok"] or answer["error"]
    assert json.dumps(answer)


@pytest.mark.endpoint
def test_the_port_obeys_a_client_with_its_token_and_no_other(door: ControlPort) -> None:
    server = ControlServer(door)
    server.start()
    try:
        client = ControlClient(server.port, server.token)
        client.mount("etalon")
        with pytest.raises(ConnectionError, match="does not have the token"):
            ControlClient(server.port, server.token[:-1])
        assert client.do("state")["sample"] == "etalon"
        client.close()
    finally:
        server.stop()
