"""Orders over the simulation control port."""

import contextlib
import json
import socket
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.app.rig import read_rig
from goniotwin.drivers import DeviceError, wait
from goniotwin.mocks.control import ControlPort, ControlServer
from goniotwin.mocks.faulty_wires import FaultyWires
from goniotwin.mocks.loopback import LOOPBACK
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from tests.conftest import RIG, RigOpener

QUIET = ("noise = true", "noise = false")


def test_a_jammed_axis_does_not_turn_and_the_encoder_shows_it(opened: RigOpener) -> None:
    rig = opened(QUIET)
    assert rig.virtual is not None
    door = ControlPort(rig.virtual)
    assert door.obey(b'{"do": "jam", "axis": "beta"}') == {"ok": True}
    before = rig.virtual.plant.angle_deg("beta", rig.rig.clock.now())
    with contextlib.suppress(DeviceError):  # an axis that monitors its encoder raises a fault
        wait(rig.rig.clock, [rig.rig.start("beta", 20.0)])
    assert rig.rig.axes["beta"].encoder_deg() == pytest.approx(before, abs=0.1)
    assert rig.virtual.plant.angle_deg("beta", rig.rig.clock.now()) == pytest.approx(before, abs=0.1)


BAD = [
    b"", b"[]", b"\xff", b"null", b"1e999", b"[" * 60_000, b'{"do": "state", "x": ' + b"9" * 5000 + b"}",
    b'{"do": "mount", "sample": 3}', b'{"do": "mount", "sample": "satin"}', b'{"do": "mount"}',
    b'{"do": "jam", "axis": "delta"}', b'{"do": "jam", "axis": ["beta"]}', b'{"do": "jam", "axis": {"a": 1}}',
    b'{"do": "jam"}', b'{"do": "jam", "axis": "beta", "jammed": "no"}', b'{"do": "jam", "axis": "beta", "jammed": null}',
    b'{"do": "lamp", "level": "x"}', b'{"do": "lamp", "level": -0.1}', b'{"do": "lamp", "drift_per_hour": true}',
    b'{"do": "tilt"}', b'{"do": "tilt", "deg": 91}', b'{"do": "tilt", "deg": -10.1}', b'{"do": "tilt", "deg": NaN}',
    b'{"do": ["x"]}', b'{"do": {"a": 1}}', b'{"do": null}',
]  # fmt: skip


@pytest.mark.parametrize("line", BAD, ids=lambda line: repr(line[:40]))
def test_an_invalid_order_returns_an_error_message(opened: RigOpener, line: bytes) -> None:
    rig = opened(QUIET)
    assert rig.virtual is not None
    answer: dict[str, Any] = ControlPort(rig.virtual).obey(line)
    assert answer["ok"] is False
    assert answer["error"]
    assert json.dumps(answer)


def test_only_null_removes_the_sample(opened: RigOpener) -> None:
    rig = opened(QUIET)
    assert rig.virtual is not None
    door = ControlPort(rig.virtual)
    assert door.obey(b'{"do": "mount", "sample": "etalon"}') == {"ok": True}
    assert not door.obey(b'{"do": "mount"}')["ok"]
    assert door.obey(b'{"do": "state"}')["sample"] == "etalon"
    assert door.obey(b'{"do": "mount", "sample": null}') == {"ok": True}
    assert door.obey(b'{"do": "state"}')["sample"] is None


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=4),
    max_leaves=10,
)
WORDS = ("do", "sample", "deg", "level", "drift_per_hour", "axis", "jammed", "device", "kinds", "share", "seed", "exchanges",
         "script", "reset")  # fmt: skip
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


@given(line=st.binary(max_size=200) | (JSON | ORDERS).map(lambda value: json.dumps(value).encode()))
def test_any_line_is_answered(door: ControlPort, line: bytes) -> None:
    answer = door.obey(line)
    assert isinstance(answer["ok"], bool)
    assert answer["ok"] or answer["error"]
    assert json.dumps(answer)


@pytest.mark.endpoint
def test_a_line_without_end_is_answered_once_and_the_next_line_is_processed(door: ControlPort) -> None:
    server = ControlServer(door)
    server.start()
    try:
        with socket.create_connection((LOOPBACK, server.port), timeout=10.0) as client, client.makefile("rwb") as wire:
            for line in (b'{"do": "mount", "sample": "etalon"}' + b" " * 200_000, b"[" * 60_000, b'{"do": "state"}'):
                wire.write(line + b"\n")
            wire.flush()
            answers = [json.loads(wire.readline()) for _ in range(3)]
        assert [answer["ok"] for answer in answers] == [False, False, True]
        assert answers[0]["error"] == "the line is too long"
    finally:
        server.stop()
