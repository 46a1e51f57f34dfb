"""Stop through a station in another process: from the key to the stop frames at the devices, in real time.

The devices are served by this process, so that press and frames have one clock. Attached is also a client that never reads.
"""

import multiprocessing
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.rig import read_rig
from goniotwin.app.station.connection_file import read_connection
from goniotwin.mocks.modbus_endpoints import ModbusEndpoints
from goniotwin.mocks.serial_endpoints import SerialEndpoints, ptys_exist
from goniotwin.protocols.channel import connect
from goniotwin.protocols.clock import RealClock
from goniotwin.twin import VirtualRig
from tests.conftest import Writer
from tests.drivers.busy_rig import RecordingWire
from tests.drivers.test_stop_times import MOST_S
from tests.system.command_process import FORKED
from tests.system.station_bench import Attached, station_process

pytestmark = [
    *FORKED,
    pytest.mark.long,
    pytest.mark.endpoint,
    pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals"),
]
STOPS = {"none": 100, "the monochromator": 20, "busy processes": 20, "a run": 5}
AXES = 4
BUSY = 8


class ServedStation:
    """A station in a process, its wires recorded here, and a client."""

    def __init__(self, folder: Path, write_rig: Writer) -> None:
        self.clock = RealClock()
        model = read_rig(write_rig()).model()
        assert model is not None
        virtual = VirtualRig.build(model, self.clock)
        self.axes, self.mono = RecordingWire(virtual.serial["axes"]), RecordingWire(virtual.serial["mono"])
        self._lines, self._modules = SerialEndpoints(self.clock, virtual.lock), ModbusEndpoints(virtual)
        for name in virtual.modbus:
            self._modules.add_tcp(name)
        self._modules.__enter__()
        addresses = [(f'"twin://virtual/{name}"', f'"{self._modules.address[name]}"') for name in virtual.modbus]
        ports = [(f'"twin://virtual/{name}"', f'"{folder / name}"') for name in ("axes", "mono")]
        rig = write_rig(*ports, *addresses, name="served.toml")
        for name, wire in (("axes", self.axes), ("mono", self.mono)):
            self._lines.add_pty(name, wire, folder / name)
        self._lines.start()
        self.process, path = station_process(folder, rig)
        connection = read_connection(path)
        assert connection is not None
        self.deaf_client = connect(connection.port, connection.token, 10.0, client="never reads")
        self.client = Attached(path)
        self.client.wait_for(lambda: self.client.snapshot.rig is not None)
        rig_now = self.client.snapshot.rig
        assert rig_now is not None
        assert rig_now.not_responding == []
        self.random = np.random.default_rng(1)

    def close(self) -> None:
        self.client.client.close()
        self.deaf_client.close()
        self.process.kill()
        self._lines.stop()
        self._modules.__exit__(None, None, None)

    def wait_for_rest(self) -> None:
        """Wait until nothing is in progress and all devices respond."""
        client = self.client
        client.wait_for(lambda: not client.snapshot.activity and not client.snapshot.busy)
        self.mono.deaf = False
        if client.snapshot.rig is not None and client.snapshot.rig.not_responding:
            client.client.do("connect")
            client.wait_for(lambda: not client.snapshot.activity)

    def stop_once(self, begin: str, schedule: Path, folder: Path) -> float:
        """Time from the key to the last of the axes' first stop frames, s."""
        client = self.client.client
        if begin == "a run":
            client.do("start", schedule=str(schedule), folder=str(folder))
            self.client.wait_for(lambda: client.snapshot.busy)
        elif begin == "the monochromator":
            self.mono.deaf = True
            client.do("wavelength", nm=float(self.random.integers(400, 760)))
        else:
            here = client.snapshot.positions.get("sigma", 0.0)
            client.do("move", axis="sigma", target_deg=170.0 if here < 85.0 else 5.0)
        self.clock.sleep_until(self.clock.now() + float(self.random.uniform(0.0, 0.5)))
        self.axes.stops.clear()
        pressed = self.clock.now()
        answer = client.send("stop")
        answer.result(30.0)
        first: dict[int, float] = {}
        for t, motor in self.axes.stops:  # a frame whose confirmation is late is sent again
            first.setdefault(motor, t)
        assert len(first) == AXES
        self.wait_for_rest()
        return max(first.values()) - pressed


@pytest.fixture
def served(tmp_path: Path, write_rig: Writer) -> Iterator[ServedStation]:
    served = ServedStation(tmp_path, write_rig)
    yield served
    served.close()


def burn() -> None:
    """Use a processor."""
    while True:
        pass


@pytest.mark.early
@pytest.mark.parametrize("meanwhile", STOPS)
def test_the_stop_frames_are_on_the_wire_within_200_ms_of_the_key(
    served: ServedStation, meanwhile: str, write_schedule: Writer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    context = multiprocessing.get_context("spawn")
    busy = [context.Process(target=burn, daemon=True) for _ in range(BUSY if meanwhile == "busy processes" else 0)]
    for each in busy:
        each.start()
    try:
        times = [served.stop_once(meanwhile, write_schedule(), tmp_path / "journals") for _ in range(STOPS[meanwhile])]
    finally:
        for each in busy:
            each.kill()
            each.join()
    with capsys.disabled():
        longest, median = 1e3 * max(times), 1e3 * float(np.median(times))
        print(f"\nstop through a station, meanwhile {meanwhile}: {len(times)} stops, median {median:.1f} ms, {longest:.1f} ms")
    assert max(times) < MOST_S
