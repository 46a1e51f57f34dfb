"""What is hostile to a run and is no fault of its devices: each of these must leave a run, its archive and its rig unharmed."""

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from goniotwin.app.rig import AXES, RigDescription, open_rig, read_rig
from goniotwin.drivers import Monochromator, MonochromatorSettings
from goniotwin.drivers.motion.stop import stop_all
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.mocks.faults import Fault, FaultPlan
from goniotwin.mocks.faulty_line import FaultyLine
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock
from goniotwin.protocols.tmcl import Command, CommandFrame
from tests.conftest import RIG, RigOpener
from tests.drivers.endless_wires import QUICK, WIRES, FloodedPort, check_calls, check_flood, check_stops
from tests.system.conftest import Serve

# ---- a busy computer ----


class BusyClock(VirtualClock):
    """The clock of a busy computer: every third wait lasts up to `LATE_S` longer than it should, by a seed."""

    LATE_S = 0.3

    def __init__(self, seed: int) -> None:
        super().__init__(1.0)
        self._draws = FaultPlan(seed, ())
        self._waits = 0

    def sleep_until(self, t: float) -> None:
        self._waits += 1
        late = self._draws.draw(self._waits, 1000) / 1000.0 if self._draws.draw(self._waits + (1 << 32), 3) == 0 else 0.0
        super().sleep_until(t + self.LATE_S * late)


@pytest.mark.parametrize("seed", range(5))
def test_a_rig_connects_on_a_busy_computer(seed: int) -> None:
    """Its own waits are late, and so are replies, as those of a rig that the same computer serves."""
    with open_rig(read_rig(RIG), BusyClock(seed)) as opened:
        assert opened.virtual is not None
        serial = opened.virtual.serial
        serial["axes"] = FaultyLine(serial["axes"], FaultPlan(seed, (Fault.LATE,), share=0.2), late_s=0.3)
        assert [str(error) for error in opened.rig.connect().values() if error is not None] == []


@contextlib.contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """Processes that use all the time that they get."""
    processes = [subprocess.Popen([sys.executable, "-S", "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()


def connection_errors(rig: RigDescription, clock: Clock) -> list[str]:
    with open_rig(rig, clock) as opened:
        return [str(error) for error in opened.rig.connect().values() if error is not None]


@pytest.mark.long
@pytest.mark.endpoint
def test_one_process_connects_a_hundred_times_beside_twenty_busy_ones() -> None:
    """Ten times as fast as in the laboratory, so that a tenth of the lateness counts."""
    rig = read_rig(RIG)
    with busy_processes(20):
        assert [error for _ in range(100) for error in connection_errors(rig, RealClock(10.0))] == []


@pytest.mark.long
def test_beside_twenty_busy_processes_a_served_rig_connects_though_its_server_is_late_too(serve: Serve, tmp_path: Path) -> None:
    served = tmp_path / "served.toml"
    serve(RIG, "--write-rig", served)
    rig = read_rig(served)
    with busy_processes(20):
        assert [error for _ in range(20) for error in connection_errors(rig, RealClock())] == []


# ---- a device that never stops sending ----


@pytest.mark.parametrize("name", QUICK)
def test_every_call_of_a_driver_ends_within_five_seconds_though_its_device_never_stops_sending(
    opened: RigOpener, name: str
) -> None:
    check_calls(opened, name, (0, 5))


@pytest.mark.long
@pytest.mark.parametrize("name", WIRES)
def test_every_call_ends_at_whichever_request_the_device_begins_to_send_without_end(opened: RigOpener, name: str) -> None:
    check_calls(opened, name, (*range(20), 34, 55, 89))


@pytest.mark.parametrize(
    "name",
    [each if each in QUICK else pytest.param(each, marks=pytest.mark.long) for each in WIRES if each.startswith("axes")],
)
def test_a_stop_is_on_the_wire_in_time_though_the_module_never_stops_sending(opened: RigOpener, name: str) -> None:
    check_stops(opened, name)


@pytest.mark.parametrize("piece", [b"x", b"00\r\n"])
def test_a_flooded_monochromator_holds_no_call_for_longer_than_five_seconds(piece: bytes) -> None:
    clock = VirtualClock(1.0)
    port: Any = FloodedPort(clock, piece)
    driver = Monochromator(lambda *_: port, MonochromatorSettings(), clock)
    check_flood(clock, driver.connect, driver.wavelength_nm, lambda: driver.start_wavelength(600.0), driver.shutter_is_open)


def test_stop_frames_are_on_a_flooded_line_within_200_ms() -> None:
    clock = VirtualClock(1.0)
    port: Any = FloodedPort(clock, b"\2\1")
    module = TmclModule(lambda *_: port, clock)
    check_flood(clock, module.connect, module.identify)
    started = clock.now()
    stops = {"axes": module.begin_stop([(name, CommandFrame(1, Command.MST, 0, k)) for k, name in enumerate(AXES)])}
    assert [each.device for each in stop_all(stops)] == list(AXES)
    frames = [t - started for t, data in port.written if t >= started and data[1] == Command.MST]
    assert frames[len(AXES) - 1] < 0.2
    assert clock.now() - started < 5.0
