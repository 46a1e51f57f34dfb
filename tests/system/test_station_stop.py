"""Stop through a station in another process: from the key to the stop frames at the devices, in real time.

The devices are served by this process, so that press and frames have one clock; a window in a third process gives the calendar
time of its key. Attached is also a client that never reads.
"""

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.rig import read_rig
from goniotwin.app.station.client import Refused
from goniotwin.app.station.connection_file import read_connection
from goniotwin.app.station.permissions import STOPPED
from goniotwin.drivers.motion.tmcl.module import HEARTBEAT_S
from goniotwin.mocks.faults import Fault, FaultPlan, ScriptedFaults
from goniotwin.mocks.faulty_usb import FaultyUsb
from goniotwin.mocks.modbus_endpoints import ModbusEndpoints
from goniotwin.mocks.serial_endpoints import SerialEndpoints, ptys_exist
from goniotwin.mocks.usb_endpoints import UsbEndpoints
from goniotwin.protocols.channel import connect
from goniotwin.protocols.clock import RealClock, calendar_s
from goniotwin.protocols.loopback import LOOPBACK
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.line import SerialDevice
from tests.conftest import Writer
from tests.drivers.busy_rig import MODULE, STILL_DEG, RecordingWire
from tests.drivers.test_stop_times import LONGEST_RAMP_S, MOST_S
from tests.system.command_process import FORKED
from tests.system.conftest import until
from tests.system.station_bench import Attached, station_process
from tests.system.window_by_keys import WindowByKeys

pytestmark = [
    *FORKED,
    pytest.mark.long,
    pytest.mark.endpoint,
    pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals"),
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="this system does not list what its sockets hold"),
]
STOPS = {
    "none": 100,
    "deaf axes": 100,
    "deaf monochromator": 100,
    "deaf converter module": 100,
    "hung monitor": 100,
    "busy processes": 100,
    "a run": 10,
}
BY_A_KEY = {"none": 100, "deaf axes": 20, "busy processes": 100}
ANSWERS, FLOOD_S = 300, 0.5
"""Commands at once whose answers are not read, and the time for them: fewer than a station holds for a client."""
AXES = 4
BUSY = 8
FRAMES_S = 5.0
"""Time after which stop frames count as missing."""
SIGMA_DEG_S, SIGMA_RAMP_DEG = 10.0, 5.0
"""Speed of sigma, and its way from that to rest."""
Key = Callable[[], float]
"""Presses a key; returns the calendar time just before, s."""


class ServedStation:
    """A station in a process, its wires recorded here, and a client.

    Without `monitor` that is in the station's process, and so is an operator that mounts samples.
    """

    def __init__(self, folder: Path, write_rig: Writer, *, monitor: bool) -> None:
        self.clock = RealClock()
        model = read_rig(write_rig()).model()
        assert model is not None
        self.virtual = virtual = VirtualRig.build(model, self.clock)
        self.axes, self.mono = RecordingWire(virtual.serial["axes"]), RecordingWire(virtual.serial["mono"])
        self._module: RecordingWire | None = None
        self._module_deaf = False
        virtual.modbus_wires[MODULE] = self._record_module
        virtual.usb["monitor"] = self.monitor = FaultyUsb(virtual.usb["monitor"], ScriptedFaults(()), self.clock)
        self._lines, self._modules = SerialEndpoints(self.clock, virtual.lock), ModbusEndpoints(virtual)
        self._usb = UsbEndpoints(virtual)
        for name in virtual.modbus:
            self._modules.add_tcp(name)
        self._modules.__enter__()
        self._usb.start()
        addresses = [(f'"twin://virtual/{name}"', f'"{self._modules.address[name]}"') for name in virtual.modbus]
        addresses += [
            (f'"twin://virtual/{name}"', f'"usbip:{LOOPBACK}:{self._usb.port}/{bus_id}"')
            for name, bus_id in self._usb.bus_ids.items()
            if monitor
        ]
        ports = [(f'"twin://virtual/{name}"', f'"{folder / name}"') for name in ("axes", "mono")]
        self.rig = write_rig(*ports, *addresses, name="served.toml")
        for name, wire in (("axes", self.axes), ("mono", self.mono)):
            self._lines.add_pty(name, wire, folder / name)
        self._lines.start()
        self.process, path = station_process(folder, self.rig)
        connection = read_connection(path)
        assert connection is not None
        self.deaf_client = connect(connection.port, connection.token, 10.0, client="never reads")
        self._flood(connection.port)
        self.client = Attached(path)
        self.client.wait_for(lambda: self.client.snapshot.rig is not None)
        rig_now = self.client.snapshot.rig
        assert rig_now is not None
        assert rig_now.not_responding == []
        self.random = np.random.default_rng(1)

    def close(self) -> None:
        self.process.kill()
        self.client.client.close()
        self.deaf_client.close()
        self._lines.stop()
        self._usb.stop()
        self._modules.__exit__(None, None, None)

    def _flood(self, port: int) -> None:
        """Let the client that never reads have so many answers that its line is full: the station waits in sending to it."""
        held = -1
        while (now := held_for_clients(port)) > held:
            held = now
            for number in range(ANSWERS):
                self.deaf_client.send({"do": "nothing", "id": number})
            self.clock.sleep_until(self.clock.now() + FLOOD_S)
        assert held > 100 * ANSWERS

    def _record_module(self, device: SerialDevice) -> SerialDevice:
        """A connection to the module; it is as deaf as the one before."""
        self._module = RecordingWire(device)
        self._module.deaf = self._module_deaf
        return self._module

    def hang(self, which: str) -> None:
        """Let a device hear nothing from now on, and all others respond."""
        self.axes.deaf = which == "deaf axes"
        self.mono.deaf = which == "deaf monochromator"
        self._module_deaf = which == "deaf converter module"
        if self._module is not None:
            self._module.deaf = self._module_deaf
        self.monitor.misfortune = FaultPlan(1, (Fault.UNHEARD,), 1.0) if which == "hung monitor" else ScriptedFaults(())

    def wait_for_rest(self) -> None:
        """Wait until nothing is in progress and all devices respond."""
        client = self.client
        client.wait_for(lambda: not client.snapshot.activity and not client.snapshot.busy)
        self.hang("none")
        if client.snapshot.rig is not None and client.snapshot.rig.not_responding:
            until(self._connects)
            client.wait_for(lambda: not client.snapshot.activity)

    def _connects(self) -> bool:
        """Whether the devices are being connected: not while a stop by a key waits for deaf axes, or is not known here."""
        try:
            self.client.client.do("connect")
        except Refused as refusal:
            if "being stopped" not in str(refusal) and STOPPED not in str(refusal):
                raise
            return False
        return True

    def move_sigma(self) -> None:
        """Move sigma to the far end of its range."""
        here = self.client.snapshot.positions.get("sigma", 0.0)
        self.client.client.do("move", axis="sigma", target_deg=170.0 if here < 85.0 else 5.0)

    def stop_once(self, begin: str, schedule: Path, folder: Path, key: Key | None = None) -> float:
        """Time from the key, or from the client's call, to the last of the first stop frames of all axes, s."""
        client = self.client.client
        self.hang(begin)
        if begin == "a run":
            client.do("start", schedule=str(schedule), folder=str(folder))
            self.client.wait_for(lambda: client.snapshot.busy)
        elif begin == "deaf monochromator":
            client.do("wavelength", nm=float(self.random.integers(400, 760)))
        elif begin in ("deaf converter module", "hung monitor"):
            client.do("read", readings=4)
        else:
            self.move_sigma()
        self.clock.sleep_until(self.clock.now() + float(self.random.uniform(0.0, 0.5)))
        self.axes.stops.clear()
        if key is None:
            pressed = self.clock.now()
            client.send("stop").result(30.0)
        else:
            pressed = key() - (calendar_s() - self.clock.now())
            until(lambda: len({motor for _, motor in self.axes.stops}) >= AXES or self.clock.now() > pressed + FRAMES_S)
        first: dict[int, float] = {}
        for t, motor in self.axes.stops:  # a frame whose confirmation is late is sent again
            first.setdefault(motor, t)
        assert len(first) == AXES
        self.wait_for_rest()
        return max(first.values()) - pressed


def held_for_clients(port: int) -> int:
    """Bytes that the system holds because a client of a port, or its server, does not read them."""
    held = 0
    for line in Path("/proc/net/tcp").read_text(encoding="utf-8").splitlines()[1:]:
        _, local, remote, _, queues, *_ = line.split()
        if f"{port:04X}" in (local[-4:], remote[-4:]):
            held += sum(int(each, 16) for each in queues.split(":"))
    return held


@pytest.fixture
def meanwhile() -> str:
    """What is in progress at the stop, where a test has no parameter for it."""
    return "none"


@pytest.fixture
def served(tmp_path: Path, write_rig: Writer, meanwhile: str) -> Iterator[ServedStation]:
    served = ServedStation(tmp_path, write_rig, monitor=meanwhile != "a run")
    yield served
    served.close()


@pytest.fixture
def window(served: ServedStation, tmp_path: Path, write_schedule: Writer) -> Iterator[WindowByKeys]:
    """A window of the station, in a process of its own."""
    window = WindowByKeys(tmp_path, "desktop", "--rig", served.rig, "--schedule", write_schedule(), "--out", tmp_path / "out")
    window.wait_for("Ready to start.")
    yield window
    window.kill()


def burn() -> None:
    """Use a processor."""
    while True:
        pass


@pytest.fixture
def busy(served: ServedStation, meanwhile: str) -> Iterator[None]:
    """Busy processes beside the station, for the tests with that name."""
    del served
    context = multiprocessing.get_context("spawn")
    number = BUSY if meanwhile == "busy processes" else 0
    processes = [context.Process(target=burn, daemon=True) for _ in range(number)]
    for each in processes:
        each.start()
    yield
    for each in processes:
        each.kill()
        each.join()


def check(times: list[float], what: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Print the times of stops, and check the longest one."""
    with capsys.disabled():
        longest, median = 1e3 * max(times), 1e3 * float(np.median(times))
        print(f"\nstop through a station, {what}: {len(times)} stops, median {median:.1f} ms, {longest:.1f} ms")
    assert max(times) < MOST_S


@pytest.mark.early
@pytest.mark.usefixtures("busy")
@pytest.mark.parametrize("meanwhile", STOPS)
def test_the_stop_frames_are_on_the_wire_within_200_ms_of_the_call(
    served: ServedStation, meanwhile: str, write_schedule: Writer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    times = [served.stop_once(meanwhile, write_schedule(), tmp_path / "journals") for _ in range(STOPS[meanwhile])]
    check(times, f"meanwhile {meanwhile}", capsys)


@pytest.mark.early
@pytest.mark.usefixtures("busy")
@pytest.mark.parametrize("meanwhile", BY_A_KEY)
def test_the_stop_frames_are_on_the_wire_within_200_ms_of_the_key(
    served: ServedStation,
    window: WindowByKeys,
    meanwhile: str,
    write_schedule: Writer,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The key of a window that only watches."""

    def key() -> float:
        return window.press_at("Ctrl+.")

    times = [served.stop_once(meanwhile, write_schedule(), tmp_path / "journals", key) for _ in range(BY_A_KEY[meanwhile])]
    check(times, f"by the key of a window, meanwhile {meanwhile}", capsys)


def test_a_frozen_station_is_named_by_the_window_and_its_motors_are_stopped_by_the_heartbeat(
    served: ServedStation, window: WindowByKeys
) -> None:
    """From full speed: the heartbeat's time at that speed at most, then the ramp."""
    served.move_sigma()
    served.clock.sleep_until(served.clock.now() + 1.5)
    frozen_s = served.clock.now()
    os.kill(served.process.pid, signal.SIGSTOP)
    frozen_deg = served.virtual.plant.angle_deg("sigma", served.clock.now())
    window.press("Ctrl+.")
    window.wait_for("Stop did not get through: use the main switch")
    served.clock.sleep_until(frozen_s + HEARTBEAT_S + LONGEST_RAMP_S + 0.1)
    resting_deg = served.virtual.plant.angle_deg("sigma", served.clock.now())
    assert 1.0 < resting_deg - frozen_deg < SIGMA_DEG_S * HEARTBEAT_S + SIGMA_RAMP_DEG + 0.1
    served.clock.sleep_until(served.clock.now() + 1.0)
    assert abs(served.virtual.plant.angle_deg("sigma", served.clock.now()) - resting_deg) < STILL_DEG
