"""Test bench: the photodiode array on Modbus TCP or RTU, and faults of its wires."""

from collections.abc import Callable

import numpy as np
import pytest

from goniotwin.app.rig import OpenRig
from goniotwin.drivers import PhotodiodeArray, wait
from goniotwin.mocks.faults import FaultPlan
from goniotwin.mocks.faulty_line import FaultyEnd, FaultyLine, exception_rtu, exception_tcp, foreign_rtu, foreign_tcp, plug_in
from goniotwin.protocols.clock import Clock, VirtualClock
from goniotwin.twin.devices.line import SerialDevice
from tests.conftest import Change, RigOpener

QUIET: Change = ("noise = true", "noise = false")
NARROW: Change = ("gain_uncertainty", f"range_code = {0x0142}\ngain_uncertainty")  # not the power-on range of a module
SERIAL: tuple[Change, ...] = (
    ('kind = "adam-6017"', 'kind = "adam-4117"'),
    ("gains_v_per_a = [1e6, 1e8, 1e10, 1e11]", "gains_v_per_a = [1e11]"),
    ("[twin.light]", '[twin.electronics]\nmodule = "adam-4117"\ngains_v_per_a = [1e11]\n\n[twin.light]'),
)
BenchOpener = Callable[[bool], OpenRig]
"""Opens a rig with the converters on a serial line (True) or over TCP."""


@pytest.fixture
def bench(opened: RigOpener) -> BenchOpener:
    return lambda serial: opened(QUIET, NARROW, *(SERIAL if serial else ()), clock=VirtualClock(10.0))


def read(array: PhotodiodeArray, clock: Clock, gain: int = 0, readings: int = 1) -> np.ndarray:
    wait(clock, [array.start_gain(gain)])
    taken = array.start_readings(readings)
    wait(clock, [taken])
    assert len(taken.counts) == readings
    return taken.counts.astype(int)


def insert_faults(rig: OpenRig, misfortune: FaultPlan, late_s: float = 0.1) -> None:
    """Insert faults into the wires, from the next connection on."""
    virtual = rig.virtual
    assert virtual is not None
    rig.rig.photodiodes.close()
    if "adcs" in virtual.serial:
        line = FaultyLine(virtual.serial["adcs"], misfortune, late_s, foreign_rtu, exception_rtu)
        plug_in(line, virtual.clock, lambda end: virtual.serial.update(adcs=end))

    def connection(station: SerialDevice) -> SerialDevice:
        return FaultyEnd(FaultyLine(station, misfortune, late_s, foreign_tcp, exception_tcp))

    virtual.modbus_wires = dict.fromkeys(virtual.modbus, connection)
    misfortune.until, until = 0, misfortune.until
    rig.rig.photodiodes.connect()
    misfortune.until = until
