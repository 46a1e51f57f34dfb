"""What drivers call of the bus libraries, in a rehearsal and over the served ports of another process.

Each exchange on a wire is one call of its library, at the same lines of the drivers: what a rehearsal runs is what measures.
"""

import inspect
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import serial
import usb.core
from pymodbus.client.base import ModbusBaseSyncClient

import goniotwin.drivers
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.rehearsal import run_on_twin
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.rehearsal.warnings import relevant_photodiodes
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from goniotwin.twin.devices import Cornerstone260, TcpStation, TmclLine, UsbTmcDevice
from goniotwin.twin.doors import protocol_twin
from tests.conftest import Writer
from tests.system.command import invoke
from tests.system.command_process import FORKED
from tests.system.conftest import ForkedServe

pytestmark = FORKED
DRIVERS = str(Path(goniotwin.drivers.__file__).parent)
MODBUS, USB_OUT, USB_IN, USB_CONTROL, SERIAL = "Modbus", "USB bulk OUT", "USB bulk IN", "USB control", "serial"
LIBRARY: list[tuple[type, str, str]] = [
    (ModbusBaseSyncClient, "execute", MODBUS),
    (usb.core.Device, "write", USB_OUT),
    (usb.core.Device, "read", USB_IN),
    (usb.core.Device, "ctrl_transfer", USB_CONTROL),
    (serial.Serial, "write", SERIAL),
    (protocol_twin.Serial, "write", SERIAL),
]
"""The calls with which the libraries begin an exchange; a port of pyserial is of one class or the other.

Control transfers belong to finding the monitor, which is by serial number on one bus and by bus number on the other.
"""
DEVICES: list[tuple[type, str, str]] = [
    (TcpStation, "receive", MODBUS),
    (UsbTmcDevice, "bulk_out", USB_OUT),
    (UsbTmcDevice, "bulk_in", USB_IN),
    (Cornerstone260, "receive", SERIAL),
    (TmclLine, "receive", SERIAL),
]
"""Where the twin's devices take exchanges from their wires."""
Site = tuple[str, str, int]
"""Bus, file of the drivers, line."""


def site() -> tuple[str, int]:
    """The line of a driver that is being carried out."""
    frame = inspect.currentframe()
    assert frame is not None
    while not frame.f_code.co_filename.startswith(DRIVERS) and frame.f_back is not None:
        frame = frame.f_back
    return frame.f_code.co_filename.removeprefix(DRIVERS), frame.f_lineno


def count_before(patch: pytest.MonkeyPatch, owner: type, name: str, count: Callable[[], object]) -> None:
    """Calls `count` before each call of a method."""
    real = getattr(owner, name)

    def counting(*arguments: Any, **named: Any) -> Any:
        count()
        return real(*arguments, **named)

    patch.setattr(owner, name, counting)


@contextmanager
def counted(calls: Counter[Site], exchanges: Counter[str]) -> Iterator[None]:
    """Counts calls of the libraries by site, and exchanges at the twin's devices in this process by bus."""
    with pytest.MonkeyPatch.context() as patch:
        for owner, name, bus in LIBRARY:
            count_before(patch, owner, name, lambda bus=bus: calls.update([(bus, *site())]))  # type: ignore[misc]
        for owner, name, bus in DEVICES:
            count_before(patch, owner, name, lambda bus=bus: exchanges.update([bus]))  # type: ignore[misc]
        yield


def by_bus(calls: Counter[Site]) -> Counter[str]:
    found: Counter[str] = Counter()
    for (bus, _, _), number in calls.items():
        found[bus] += number
    return found


@pytest.mark.long
def test_each_exchange_is_one_call_of_its_library_at_the_same_lines_in_a_rehearsal_and_over_served_ports(
    write_rig: Writer, write_schedule: Writer, forked_serve: ForkedServe, tmp_path: Path
) -> None:
    rig, schedule = write_rig(), write_schedule()
    plan = make_plan(read_schedule(schedule), read_rig(rig))
    rehearsed, exchanges = Counter[Site](), Counter[str]()
    with counted(rehearsed, exchanges):
        statistics = RowStatistics(plan.rig.file.photodiodes, partial(relevant_photodiodes, plan))
        run_on_twin(plan, tmp_path / "rehearsal.journal", statistics, [])
    calls = by_bus(rehearsed)
    for bus in (MODBUS, USB_OUT, USB_IN, SERIAL):
        assert calls[bus] == exchanges[bus] > len(plan.rows)

    served_rig, wires = tmp_path / "served.toml", tmp_path / "wires"
    forked_serve(rig, "--speed", 5, "--write-rig", served_rig)
    served, none_here = Counter[Site](), Counter[str]()
    with counted(served, none_here):
        run = invoke("run", schedule, "--rig", served_rig, "--out", tmp_path / "served.journal", "--transcript", wires)
    assert run.returncode == 0, run.stderr
    assert not none_here
    transcripts = [path.read_text(encoding="utf-8").splitlines() for path in wires.glob("photodiodes*.txt")]
    assert by_bus(served)[MODBUS] == sum(line[14:17] == " > " for lines in transcripts for line in lines)
    assert {each for each in served if each[0] != USB_CONTROL} == {each for each in rehearsed if each[0] != USB_CONTROL}
