"""The last will of the monochromator: when it is armed, and that it closes the shutter of the unit in whatever state it is."""

import re

import pytest

from goniotwin.drivers import Monochromator, wait
from goniotwin.drivers.guard import Guarded, LastWill
from goniotwin.drivers.monochromator.settings import MonochromatorSettings
from goniotwin.drivers.tap import TO_DEVICE
from tests.conftest import RigOpener
from tests.drivers.monochromator_bench import DIALECTS, MonochromatorBench

HALF_SENT = (b"SHUTTER O\n", b"SHUTTER C\n", b"GOWAVE 600.000\n", b"GRAT 2\n", b"SHUTTER?\n", b"HANDSHAKE 1\n")
LONGEST_S = 2.0


class Recorder:
    """A guard and a tap that note what happens, in order."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def arm(self, will: LastWill) -> None:
        self.calls.append("arm")

    def disarm(self) -> None:
        self.calls.append("disarm")

    def tap(self, direction: str, data: bytes) -> None:
        if direction == TO_DEVICE and data == b"SHUTTER O\n":
            self.calls.append("opened")


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_the_guard_is_armed_before_the_shutter_opens_and_disarmed_when_it_is_seen_closed(
    opened: RigOpener, echo: bool, handshake: bool
) -> None:
    bench, guard = MonochromatorBench(opened, echo, handshake), Recorder()
    bench.driver.close()
    driver = Monochromator(
        bench.wires.serial("twin://virtual/mono"), MonochromatorSettings(), bench.clock, guard.tap, guard=guard
    )
    driver.connect()
    assert guard.calls == []
    wait(bench.clock, [driver.start_shutter(opened=True)])
    assert guard.calls[:2] == ["arm", "opened"]
    assert "disarm" not in guard.calls
    wait(bench.clock, [driver.start_wavelength(600.0)])
    wait(bench.clock, [driver.start_shutter(opened=False)])
    assert guard.calls[-1] == "disarm"
    bench.plant.shutter_open.set(bench.clock.now(), True)  # by hand
    assert driver.shutter_is_open()
    assert guard.calls[-1] == "disarm"
    driver.close()


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
@pytest.mark.parametrize("statement", HALF_SENT, ids=bytes.decode)
def test_the_will_closes_the_shutter_after_each_byte_of_a_statement(
    opened: RigOpener, echo: bool, handshake: bool, statement: bytes
) -> None:
    """The unit is asked after its last answer to what was before, as the guardian does. MCS260 p. 50: echo and handshake."""
    bench = MonochromatorBench(opened, echo, handshake)
    will, unit, plant = bench.driver.last_will(), bench.unit, bench.plant
    t = bench.clock.now() + 10.0
    for kept in range(len(statement) + 1):
        unit.receive(b"SHUTTER O\n", t)
        t += LONGEST_S
        assert plant.shutter_open.at(t)
        unit.receive(will.question, t)
        assert not re.search(will.safe, answered(bench, t + 1.0))
        t += LONGEST_S
        unit.receive(statement[:kept], t)
        t += 0.01
        unit.receive(will.ending + will.order, t)
        answered(bench, t + LONGEST_S)
        t += LONGEST_S
        assert not plant.shutter_open.at(t)
        unit.receive(will.question, t)
        assert re.search(will.safe, answered(bench, t + 1.0))
        t += LONGEST_S


def answered(bench: MonochromatorBench, t: float) -> str:
    """What the unit sends until a time."""
    sent = b""
    while bench.unit.outbox and bench.unit.outbox[0][0] <= t:
        sent += bench.unit.outbox.popleft()[1]
    return sent.decode("latin-1")


def test_a_unit_that_is_identified_is_asked_without_a_setting_changed(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    bench.driver.close()
    bench.driver.identify()
    assert isinstance(bench.driver, Guarded)
    for is_open in (True, False):
        bench.plant.shutter_open.set(bench.clock.now(), is_open)
        assert bench.driver.is_safe() is not is_open
    assert not bench.unit.state.handshake
