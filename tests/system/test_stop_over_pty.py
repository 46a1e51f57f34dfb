"""Stop from a second thread, in real time, with axes and monochromator behind pseudo-terminals."""

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
from tests.drivers.busy_rig import BusyRig, Stop
from tests.drivers.test_stop_times import MOST_S, in_words

pytestmark = [
    pytest.mark.long,
    pytest.mark.endpoint,
    pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals"),
]
STOPS = {"nobody": 100, "the monochromator": 50, "mute axes": 50}
WITHIN_S = 60.0
Work = Callable[[], BusyRig]


@pytest.fixture
def busy(write_rig: Writer, tmp_path: Path) -> Iterator[BusyRig]:
    """Drivers of a rig whose axes, monochromator and converters are real endpoints; the monitor has a twin of its own."""
    clock = RealClock()
    model = read_rig(write_rig()).model()
    assert model is not None
    virtual = VirtualRig.build(model, clock)
    lines, modules = SerialEndpoints(clock, virtual.lock), ModbusEndpoints(virtual)
    for name in virtual.modbus:
        modules.add_tcp(name)
    with modules:
        addresses = [(f'"twin://virtual/{name}"', f'"{modules.address[name]}"') for name in virtual.modbus]
        ports = [(f'"twin://virtual/{name}"', f'"{tmp_path / name}"') for name in ("axes", "mono")]
        rig = open_rig(read_rig(write_rig(*ports, *addresses, name="served.toml")), clock)
        watched = BusyRig(rig.rig, virtual, 1, reach_s=1.5, rest_s=1.5)
        for name, device in virtual.serial.items():
            lines.add_pty(name, device, tmp_path / name)
        lines.start()
        try:
            rig.connect()
            yield watched
        finally:
            rig.close()
            lines.stop()


def stopped_once(busy: BusyRig, silent: str) -> Stop:
    """Another thread drives the rig; this one presses the button at a moment drawn by lot."""
    clock, lots = busy.clock, busy.random
    wire = busy.mono if silent == "the monochromator" else busy.axes
    fallen = threading.Event()

    def fall(t: float) -> None:
        wire.mute = silent == "mute axes"
        wire.deaf = silent == "the monochromator"
        fallen.set()

    wire.call_at(int(lots.integers(1, 6 if wire is busy.mono else 40)), fall)
    worker = threading.Thread(target=busy.work)
    worker.start()
    try:
        assert fallen.wait(WITHIN_S)
        clock.sleep_until(clock.now() + float(lots.uniform(0.0, (0.003, 0.5)[int(lots.integers(2))])))
    finally:
        busy.stop()
        worker.join(WITHIN_S)
    assert not worker.is_alive()
    stop = busy.outcome()
    assert len(stop.failures) == (4 if silent == "mute axes" else 0)
    busy.recover()
    return stop


@pytest.mark.parametrize("silent", STOPS)
def test_of_a_hundred_stops_over_pseudo_terminals_none_is_late(
    busy: BusyRig, silent: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The bound is the product's promise to whoever presses the button, so here it is held against real time."""
    stops = [stopped_once(busy, silent) for _ in range(STOPS[silent])]
    with capsys.disabled():
        print(f"\nstop over pseudo-terminals, {in_words(silent, stops)}")
    assert max(stop.last_frame_s for stop in stops) < MOST_S
    # An axis that was set in motion meanwhile, and one that got faster until it heard the stop, brakes a little longer.
    assert all(stop.rest_s <= stop.ramp_s + 2.0 * MOST_S for stop in stops)
