"""Stop from a second thread, in real time, with axes and monochromator behind pseudo-terminals and at network ports."""

import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.app.rig import open_rig, read_rig
from goniotwin.mocks.modbus_endpoints import ModbusEndpoints
from goniotwin.mocks.serial_endpoints import SerialEndpoints, ptys_exist
from goniotwin.protocols.clock import RealClock
from goniotwin.twin import VirtualRig
from tests.conftest import Writer
from tests.drivers.busy_rig import BusyRig, StopTimes
from tests.drivers.test_stop_times import MOST_S, summary

pytestmark = [
    pytest.mark.long,
    pytest.mark.endpoint,
    pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals"),
]
STOPS = {"none": 100, "the monochromator": 50, "mute axes": 50}
WITHIN_S = 60.0
Work = Callable[[], BusyRig]


@pytest.fixture(params=["pseudo-terminals", "network ports"])
def busy(write_rig: Writer, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[BusyRig]:
    """Drivers of a rig with axes, monochromator and converters on real endpoints, and the monitor in process."""
    clock = RealClock()
    model = read_rig(write_rig()).model()
    assert model is not None
    virtual = VirtualRig.build(model, clock)
    lines, modules = SerialEndpoints(clock, virtual.lock), ModbusEndpoints(virtual)
    for name in virtual.modbus:
        modules.add_tcp(name)
    with modules:
        addresses = [(f'"twin://virtual/{name}"', f'"{modules.address[name]}"') for name in virtual.modbus]
        names = ("axes", "mono")
        places = {name: str(tmp_path / name) for name in names}
        if request.param == "network ports":
            places = {name: f"socket://127.0.0.1:{free_port()}" for name in names}
        ports = [(f'"twin://virtual/{name}"', f'"{places[name]}"') for name in names]
        rig = open_rig(read_rig(write_rig(*ports, *addresses, name="served.toml")), clock)
        busy_rig = BusyRig(rig.rig, virtual, 1, reach_s=1.5, rest_s=1.5)
        for name, device in virtual.serial.items():
            if request.param == "network ports":
                lines.add_tcp(name, device, int(places[name].rpartition(":")[2]))
            else:
                lines.add_pty(name, device, tmp_path / name)
        lines.start()
        try:
            rig.connect()
            yield busy_rig
        finally:
            rig.close()
            lines.stop()


def free_port() -> int:
    """A port at which no program listens."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        return int(taken.getsockname()[1])


def stopped_once(busy: BusyRig, silent: str) -> StopTimes:
    """Another thread drives the rig; this one requests a stop at a random time."""
    clock, random = busy.clock, busy.random
    wire = busy.mono if silent == "the monochromator" else busy.axes
    silenced = threading.Event()

    def silence(t: float) -> None:
        wire.mute = silent == "mute axes"
        wire.deaf = silent == "the monochromator"
        silenced.set()

    wire.call_at(int(random.integers(1, 6 if wire is busy.mono else 40)), silence)
    worker = threading.Thread(target=busy.work)
    worker.start()
    try:
        assert silenced.wait(WITHIN_S)
        clock.sleep_until(clock.now() + float(random.uniform(0.0, (0.003, 0.5)[int(random.integers(2))])))
    finally:
        busy.stop()
        worker.join(WITHIN_S)
    assert not worker.is_alive()
    stop = busy.outcome()
    assert len(stop.failures) == (4 if silent == "mute axes" else 0)
    busy.recover()
    return stop


@pytest.mark.early
@pytest.mark.parametrize("silent", STOPS)
def test_a_hundred_stops_over_real_ports_are_all_in_time(
    busy: BusyRig, silent: str, capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest
) -> None:
    """The bound is guaranteed in real time, so that real time is measured here."""
    stops = [stopped_once(busy, silent) for _ in range(STOPS[silent])]
    with capsys.disabled():
        print(f"\nstop over {request.node.callspec.params['busy']}, {summary(silent, stops)}")
    assert max(stop.last_frame_s for stop in stops) < MOST_S
    # An axis that started or accelerated until it received the stop brakes a little longer.
    assert all(stop.rest_s <= stop.ramp_s + 2.0 * MOST_S for stop in stops)
