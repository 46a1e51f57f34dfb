"""A session on a rig's wires, recorded, and rigs on which it happens again."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.app.rig import OpenRig, open_rig, read_rig
from goniotwin.drivers import Rig, wait
from goniotwin.mocks.transcript import Transfer, read_transcript
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from tests.conftest import Change, Writer
from tests.drivers.photodiode_bench import SERIAL

QUIET: Change = ("noise = true", "noise = false")
TCP, RTU = (QUIET,), (QUIET, *SERIAL)
BOTH = pytest.mark.parametrize("changes", [TCP, RTU], ids=["tcp", "rtu"])
UNITS = 5
RigMaker = Callable[..., OpenRig]
"""Opens the example rig with changes, not connected; its wires written to `transcript` where that is given."""


@pytest.fixture
def rig_of(write_rig: Writer) -> Iterator[RigMaker]:
    rigs: list[OpenRig] = []

    def open_changed(*changes: Change, transcript: Path | None = None) -> OpenRig:
        rigs.append(open_rig(read_rig(write_rig(*changes)), VirtualClock(), transcript))
        return rigs[-1]

    yield open_changed
    for rig in rigs:
        rig.close()


def session(rig: Rig) -> None:
    """Something on every wire of a rig with TCP modules; there is light."""
    assert set(rig.connect().values()) == {None}
    wait(rig.clock, [rig.start("sigma", 2.0), rig.monochromator.start_wavelength(600.0)])
    wait(rig.clock, [rig.monochromator.start_shutter(opened=True)])
    read_photodiodes(rig, gain=2)
    read_monitor(rig)


def read_photodiodes(rig: Rig, gain: int = 0) -> list[list[int]]:
    wait(rig.clock, [rig.photodiodes.start_gain(gain)])
    taken = rig.photodiodes.start_readings(2)
    wait(rig.clock, [taken])
    return [[int(count) for count in row] for row in taken.counts]


def read_monitor(rig: Rig) -> float:
    mean = rig.monitor.start_mean(0.1)
    wait(rig.clock, [mean])
    rig.monitor.status_byte()
    rig.monitor.abort()
    rig.monitor.check()
    return mean.current_a


def transcripts(folder: Path, stem: str) -> list[list[Transfer]]:
    """Of all files whose names begin so."""
    found = [read_transcript(path) for path in sorted(folder.glob(f"{stem}*.txt"))]
    assert found
    assert all(found)
    return found


def virtual(rig: OpenRig) -> VirtualRig:
    assert rig.virtual is not None
    return rig.virtual


def same(one: list[Transfer], other: list[Transfer], late: float = 1e-3) -> bool:
    """The same bytes in the same order at the same times, to a share of the time since the start."""
    pairs = list(zip(one, other, strict=True))
    assert [(each.direction, each.data) for each in one] == [(each.direction, each.data) for each in other]
    return all(abs(each.t - again.t) <= late * each.t + 1e-3 for each, again in pairs)
