"""A computer that is late connects to its rig all the same: no device is taken for one that is not responding."""

from pathlib import Path

import pytest

from goniotwin.app.rig import RigDescription, open_rig, read_rig
from goniotwin.mocks.faults import Fault, FaultPlan
from goniotwin.mocks.faulty_line import FaultyLine
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock
from tests.conftest import RIG
from tests.system.busy_computer import busy_processes
from tests.system.conftest import Serve


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
