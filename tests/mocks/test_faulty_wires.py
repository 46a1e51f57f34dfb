"""Injected faults on the wires of a served rig, seen by the connected drivers."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from goniotwin.app.rig import OpenRig, open_rig, parse_rig, read_rig
from goniotwin.app.rig.served_file import served_rig
from goniotwin.drivers import wait
from goniotwin.drivers.errors import DeviceError
from goniotwin.mocks.control import ControlClient, OrderRefused
from goniotwin.mocks.served import ServedRig
from goniotwin.protocols.clock import RealClock
from tests.conftest import Writer

pytestmark = pytest.mark.endpoint
SPEED = 5.0
"""Simulation speed: most of these tests wait for timeouts."""


@pytest.fixture
def server(write_rig: Writer, tmp_path: Path) -> Iterator[tuple[str, ControlClient]]:
    """A served rig: its connection file and its simulation control port."""
    description = read_rig(write_rig(("noise = true", "noise = false")))
    model = description.model()
    assert model is not None
    server = ServedRig(model, SPEED, tmp_path / "ptys")
    server.start()
    control = ControlClient(server.endpoints[-1].port or 0, server.endpoints[-1].token or "")
    yield served_rig(description, server.endpoints, SPEED), control
    control.close()
    server.stop()


@pytest.fixture
def served(server: tuple[str, ControlClient], tmp_path: Path) -> Iterator[tuple[OpenRig, ControlClient]]:
    """The drivers of a rig, connected over its endpoints, and its simulation control port."""
    with open_rig(parse_rig(server[0], tmp_path, "served.toml"), RealClock(SPEED)) as opened:
        opened.connect()
        yield opened, server[1]


def read(opened: OpenRig) -> None:
    readings = opened.rig.photodiodes.start_readings(1)
    wait(opened.rig.clock, [readings])
    assert len(readings.counts) == 1


def mean(opened: OpenRig) -> None:
    wait(opened.rig.clock, [opened.rig.monitor.start_mean(0.02)])


def wavelength(opened: OpenRig) -> None:
    wait(opened.rig.clock, [opened.rig.monochromator.start_wavelength(555.0)])


def angle(opened: OpenRig) -> None:
    assert opened.rig.axes["sigma"].position_deg() == pytest.approx(0.0)


USES = {"axes": angle, "mono": wavelength, "adc-2": read, "monitor": mean}
OF = {"axes": "axes|sigma", "mono": "monochromator", "adc-2": "photodiodes", "monitor": "monitor"}


def test_an_injected_fault_happens_once_and_is_reported(served: tuple[OpenRig, ControlClient]) -> None:
    opened, control = served
    control.do("faults", device="axes", script=["lost"])
    angle(opened)  # asked again
    assert control.do("faults", device="axes", script=["none"])["met"] == ["lost"]
    control.do("faults", device="adc-2", kinds=["exception"], share=1.0, exchanges=1)
    read(opened)
    assert control.do("faults", device="adc-2", share=0.0)["met"] == ["exception"]


@pytest.mark.parametrize("device", USES)
def test_a_pulled_plug_raises_an_error_that_names_the_device(served: tuple[OpenRig, ControlClient], device: str) -> None:
    """The other devices keep working. The unplugged device works again after it is plugged in, without a restart."""
    opened, control = served
    control.do("unplug", device=device)
    with pytest.raises(DeviceError, match=OF[device]):
        USES[device](opened)
    for other, use in USES.items():
        if other != device:
            use(opened)
    control.do("replug", device=device)
    assert all(error is None for error in opened.rig.connect().values())
    USES[device](opened)


@pytest.mark.parametrize(
    ("order", "message"),
    [
        ({"device": "lamp"}, "device is one of: axes, mono, adc-0"),
        ({"device": "mono", "kinds": ["foreign"]}, "faults of this wire are corrupted"),
        ({"device": "monitor", "kinds": ["merged"]}, "nak"),
        ({"device": "axes", "kinds": "late"}, "'late'"),
        ({"device": "axes", "share": 2}, "0 to 1"),
    ],
)
def test_impossible_faults_are_refused_with_a_message(
    server: tuple[str, ControlClient], order: dict[str, object], message: str
) -> None:
    with pytest.raises(OrderRefused, match=message):
        server[1].do("faults", **order)
