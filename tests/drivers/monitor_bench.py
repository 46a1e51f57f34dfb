"""Test bench: the monitor of a virtual rig, and faults of its wire."""

from collections.abc import Callable

import pytest
import usb.core

from goniotwin.drivers import Monitor, MonitorSettings, wait
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.doors import TwinUsbBackend
from tests.conftest import RigOpener

TRUTH_A = 1.4e-7


class MonitorBench:
    """The monitor with the shutter open."""

    def __init__(self, rig: VirtualRig, settings: MonitorSettings | None = None) -> None:
        self.rig = rig
        self.clock = rig.clock
        self.backend = TwinUsbBackend(rig)
        self.monitor = Monitor(lambda: usb.core.find(backend=self.backend), settings or MonitorSettings(), rig.clock)
        self.device = rig.usb["monitor"]
        rig.plant.shutter_open.set(0.0, True)

    def mean(self, seconds: float = 0.1) -> float:
        mean = self.monitor.start_mean(seconds)
        wait(self.clock, [mean])
        return mean.current_a

    def change_next_reply(self, change: Callable[[bytes], bytes]) -> None:
        """Change the next reply on bulk IN."""
        read = self.device.bulk_in

        def changed(size: int | None = None) -> bytes:
            self.device.bulk_in = read  # type: ignore[method-assign]
            return change(read(size))

        self.device.bulk_in = changed  # type: ignore[method-assign]

    def hang(self) -> None:
        """From now on there is nothing to read."""
        self.device.bulk_in_ready = lambda: None  # type: ignore[method-assign]


@pytest.fixture
def bench(opened: RigOpener) -> MonitorBench:
    opened_rig = opened(clock=VirtualClock(1.0))
    assert opened_rig.virtual is not None
    opened_rig.rig.monitor.close()
    bench = MonitorBench(opened_rig.virtual)
    bench.monitor.connect()
    return bench
