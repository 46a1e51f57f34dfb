"""Devices are left as they were found: after a session, and by the next connection after one that was killed.

Another program sets and reads the settings: bytes on the same wires, without the drivers.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.app.rig import OpenRig
from goniotwin.drivers import DeviceError, Monitor, Monochromator, PhotodiodeArray, TmclController, wait
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.motion.stop import stop_all
from goniotwin.drivers.motion.tmcl import TmclSettings
from goniotwin.drivers.motion.tmcl.axis import KEPT
from goniotwin.drivers.photodiodes.modbus import ModbusUnit
from goniotwin.protocols.cornerstone import NO_ERROR, ErrorCode, WavelengthUnit
from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter, GlobalParameter
from tests.conftest import RigOpener
from tests.drivers.monochromator_bench import DIALECTS, MonochromatorBench
from tests.drivers.photodiode_bench import NARROW

State = dict[str, Any]
MONO, AXES = "twin://virtual/mono", "twin://virtual/axes"


@dataclass
class Notes:
    """Notes of one device, which outlive its driver."""

    text: str = ""
    written: list[str] = field(default_factory=list)

    def read(self) -> str:
        return self.text

    def write(self, text: str) -> None:
        self.text = text
        self.written.append(text)


# ---- the rule ----


def test_a_setting_is_restored_by_the_next_session_unless_another_program_has_changed_it() -> None:
    notes = Notes()
    killed = FoundSettings(notes)
    killed.take_up("unit")
    killed.note({"units": ("UM", "NM"), "handshake": ("0", "1"), "gain": ("2", "0")})
    killed.note({"gain": ("0", "3")})
    following = FoundSettings(notes)
    following.take_up("unit")
    assert [following.value_to_restore("gain", present) for present in ("0", "3", "2", "1")] == ["2", "2", None, None]
    following.note({"units": ("NM", "NM"), "handshake": ("0", "1")})  # 0 again: another program, or a power-up
    assert following.value_to_restore("units", "NM") == "UM"
    assert following.value_to_restore("handshake", "1") == "0"
    following.clear()
    assert (notes.text, dict(following.changes)) == ("", {})


def test_what_has_the_wanted_value_is_not_noted_and_nothing_is_restored_for_another_device() -> None:
    notes = Notes()
    found = FoundSettings(notes)
    found.take_up("unit")
    found.note({"units": ("NM", "NM")})
    assert (notes.written, dict(found.changes)) == ([], {})
    found.note({"units": ("UM", "NM")})
    found.note({"units": ("NM", "NM")})
    assert len(notes.written) == 1  # no file for what is noted already
    other = FoundSettings(notes)
    other.take_up("another unit")
    assert not other.changes


def test_of_two_notes_that_one_on_a_full_disk_is_the_older() -> None:
    notes = Notes()
    found = FoundSettings(notes)
    found.take_up("unit")
    found.note({"handshake": ("0", "1")})
    full = notes.text
    found.note({"units": ("UM", "NM")})
    notes.text = full  # the second one could not be written
    found.take_up("unit")  # connected again, after a fault
    assert found.value_to_restore("units", "NM") == "UM"


DAMAGE = {
    "another name": lambda text: text.replace("units", "unite"),
    "another value": lambda text: text.replace("UM", "UN"),
    "an end": lambda text: text[:-1],
    "lists": lambda text: text.partition("\n")[0] + "\n" + 90_000 * "[",
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_nothing_of_a_damaged_note_is_sent(damage: str) -> None:
    notes = Notes()
    found = FoundSettings(notes)
    found.take_up("unit")
    found.note({"units": ("UM", "NM")})
    undamaged, notes.text = notes.text, DAMAGE[damage](notes.text)
    following = FoundSettings(notes)
    following.take_up("unit")
    assert not following.changes
    notes.text = undamaged
    following.take_up("unit")
    assert following.changes


@given(st.text() | st.just('{"identity": "unit", "settings": {"units": {"found": 3, "written": ["NM"]}}}'))
def test_a_damaged_note_is_no_note(text: str) -> None:
    found = FoundSettings(Notes(text))
    found.take_up("unit")
    assert not found.changes


# ---- the devices ----


class Bench:
    """A device that another program has set up; `driver` makes a new driver of it with these notes."""

    notes: tuple[Notes, ...] = ()

    def __init__(self, rig: OpenRig) -> None:
        rig.rig.close()
        assert rig.virtual is not None
        self.rig, self.virtual, self.clock, self.wires = rig.rig, rig.virtual, rig.rig.clock, rig.wires()
        self.set_up()

    def driver(self) -> Any: ...

    def set_up(self) -> None: ...

    def change(self) -> None:
        """Another program changes a setting."""

    def state(self) -> State:
        """What this program changes, as another one reads it."""
        raise NotImplementedError


class MonochromatorSetUp(Bench):
    notes = (Notes(),)

    def driver(self) -> Monochromator:
        found = FoundSettings(self.notes[0])
        return Monochromator(self.wires.serial(MONO), self.rig.monochromator.settings, self.clock, found=found)

    def ask(self, line: bytes) -> bytes:
        port = self.wires.serial(MONO)(9600, 0.2)
        port.write(line + b"\n")
        answer = bytes(port.read(100))
        port.close()
        assert answer.startswith(line + b"\n")
        return answer.removeprefix(line + b"\n").split()[0] if b"?" in line else answer

    def set_up(self) -> None:
        self.ask(b"UNITS UM")

    def change(self) -> None:
        self.ask(b"UNITS WN")

    def state(self) -> State:
        return {word: self.ask(f"{word}?".encode()) for word in ("HANDSHAKE", "UNITS")}


class PhotodiodesSetUp(Bench):
    notes = tuple(Notes() for _ in range(5))

    def driver(self) -> PhotodiodeArray:
        first = self.rig.photodiodes
        units = [
            ModbusUnit(module.bus, module.registers.unit, found=FoundSettings(notes))
            for module, notes in zip(first.modules, self.notes, strict=True)
        ]
        return PhotodiodeArray(units, first.settings, self.clock)

    @property
    def module(self) -> Any:
        return next(iter(self.virtual.modbus.values()))

    def set_up(self) -> None:
        self.module.write_registers(200, [0x0147] * 8, 1.0)  # 0 to 5 V; the rig file has +-5 V
        self.module.write_coils(16, [True, True], 1.0)

    def change(self) -> None:
        self.module.write_registers(200, [0x0148] * 8, self.clock.now())

    def state(self) -> State:
        return {
            "ranges": self.module.registers(200, 8, self.clock.now()),
            "outputs": self.module.coils(16, 2, self.clock.now()),
        }


class MonitorSetUp(Bench):
    notes = (Notes(),)

    def driver(self) -> Monitor:
        found = FoundSettings(self.notes[0])
        return Monitor(self.wires.usb("twin://virtual/monitor"), self.rig.monitor.settings, self.clock, found=found)

    def ask(self, message: bytes) -> bytes:
        instrument = self.virtual.usb["monitor"].instrument
        return b"".join(text for _, text in instrument.execute(message, self.clock.now())).strip()

    def set_up(self) -> None:
        self.ask(b"SENS:AVER:COUN 7;:SENS:CURR:RANG 5E-3;:INP:PDI:FILT:LPAS:STAT 1;:SENS:CORR:WAV 900;:CONF:POW")

    def change(self) -> None:
        self.ask(b"SENS:CURR:RANG 5E-4")

    def state(self) -> State:
        queries = (b"CONF?", b"SENS:CURR:RANG?", b"SENS:CURR:RANG:AUTO?", b"SENS:AVER:COUN?", b"SENS:CORR:WAV?")
        return {query.decode(): self.ask(query) for query in (*queries, b"INP:PDI:FILT:LPAS:STAT?")}


class AxesSetUp(Bench):
    notes = (Notes(),)

    def driver(self) -> TmclController:
        axes = {name: replace(axis.settings, switches=True) for name, axis in self.rig.axes.items()}  # type: ignore[type-var]
        found = FoundSettings(self.notes[0])
        return TmclController("axes", self.wires.serial(AXES), self.clock, TmclSettings(), axes, found=found)  # type: ignore[arg-type]

    def exchange(self, command: Command, number: int, motor: int, value: int = 0) -> int:
        port = self.wires.serial(AXES)(115200, 0.1)
        port.write(CommandFrame(1, command, number, motor, value).encode())
        reply = ReplyFrame.decode(bytes(port.read(9)))
        port.close()
        return reply.value

    def set_up(self) -> None:
        self.exchange(Command.SAP, AxisParameter.MAX_VELOCITY, 4, 1234)
        self.exchange(Command.SAP, AxisParameter.RUN_CURRENT, 4, 77)

    def change(self) -> None:
        self.exchange(Command.SAP, AxisParameter.MAX_VELOCITY, 4, 4321)

    def state(self) -> State:
        measured = (AxisParameter.ENCODER_POSITION, AxisParameter.LOAD_VALUE, AxisParameter.ERROR_FLAGS)
        state = {each.name: self.exchange(Command.GAP, each, 4) for each in AxisParameter if each not in measured}
        return {**state, "heartbeat": self.exchange(Command.GGP, GlobalParameter.HEARTBEAT, 0)}


SET_UPS = [MonochromatorSetUp, PhotodiodesSetUp, MonitorSetUp, AxesSetUp]


@pytest.fixture(params=SET_UPS, ids=lambda each: each.__name__)
def bench(request: pytest.FixtureRequest, opened: RigOpener) -> Bench:
    kind: Callable[[OpenRig], Bench] = request.param
    for each in request.param.notes:
        each.text = ""
    return kind(opened(NARROW))


def use(device: Any, bench: Bench) -> None:
    """Change what a campaign changes."""
    if isinstance(device, PhotodiodeArray):
        wait(bench.clock, [device.start_gain(0)])
        wait(bench.clock, [device.start_gain(1)])
        wait(bench.clock, [device.start_readings(1)])
    if isinstance(device, Monitor):
        wait(bench.clock, [device.start_mean(0.1)])


def test_a_session_leaves_everything_as_it_was(bench: Bench) -> None:
    before = bench.state()
    device = bench.driver()
    device.connect()
    use(device, bench)
    assert bench.state() != before
    device.connect()  # again, as after a fault
    use(device, bench)
    device.close()
    assert bench.state() == before
    assert not any(each.text for each in bench.notes)


def test_identifying_changes_nothing(bench: Bench) -> None:
    before = bench.state()
    device = bench.driver()
    assert device.identify()
    assert bench.state() == before
    device.close()
    assert bench.state() == before


def test_after_a_kill_the_next_connection_restores(bench: Bench) -> None:
    before = bench.state()
    killed = bench.driver()
    killed.connect()
    use(killed, bench)
    assert any(each.text for each in bench.notes)
    identified = bench.driver()  # the killed one sends nothing more
    identified.identify()
    assert bench.state() == before
    identified.close()
    killed_again = bench.driver()
    killed_again.connect()
    use(killed_again, bench)
    following = bench.driver()
    following.connect()
    use(following, bench)
    following.close()
    assert bench.state() == before


def test_what_another_program_sets_after_a_kill_stays(bench: Bench) -> None:
    killed = bench.driver()
    killed.connect()
    bench.change()
    changed = bench.state()
    device = bench.driver()
    device.identify()
    after = bench.state()
    own = {name for name in changed if after[name] != changed[name]}
    before = {name: value for name, value in changed.items() if name not in own}
    assert {name: after[name] for name in before} == before
    bench.change()
    assert bench.state() == after  # what it had set is as it had set it
    device.close()


def test_errors_that_a_killed_program_has_left_in_the_monitor_do_not_fail_the_next_connection(opened: RigOpener) -> None:
    MonitorSetUp.notes[0].text = ""
    bench = MonitorSetUp(opened(NARROW))
    before = bench.state()
    killed = bench.driver()
    killed.connect()
    use(killed, bench)
    for _ in range(3):
        bench.ask(b"SENS:CURR:RANG 9E9")
    assert not bench.ask(b"SYST:ERR?").startswith(b"+0,")
    identified = bench.driver()
    assert identified.identify()
    assert bench.state() == before
    assert bench.ask(b"SYST:ERR?").startswith(b"+0,")
    identified.close()


def test_of_an_axis_the_scales_of_its_counters_and_its_standby_current_stay_and_nothing_else(opened: RigOpener) -> None:
    """docs/rig/interoperability.md has the reasons."""
    AxesSetUp.notes[0].text = ""
    bench = AxesSetUp(opened(NARROW))
    for parameter, value in ((AxisParameter.MICROSTEP_RESOLUTION, 4), (AxisParameter.STANDBY_CURRENT, 3)):
        bench.exchange(Command.SAP, parameter, 4, value)
    before = bench.state()
    device = bench.driver()
    device.connect()
    device.close()
    after = bench.state()
    assert {name for name in before if after[name] != before[name]} == {"MICROSTEP_RESOLUTION", "STANDBY_CURRENT"}
    assert {*KEPT} == {AxisParameter.MICROSTEP_RESOLUTION, AxisParameter.STANDBY_CURRENT, AxisParameter.ENCODER_RESOLUTION}


# ---- the monitor's auto-range, and modules that a line has lost ----


@pytest.mark.parametrize("found", [b"0", b"1"])
def test_an_auto_range_that_another_program_has_switched_on_stays_on(opened: RigOpener, found: bytes) -> None:
    """It may have chosen the range that the killed program had written, and `RANG` ends it (assumed of the PM100D)."""
    bench = MonitorSetUp(opened())
    bench.notes[0].text = ""
    bench.ask(b"SENS:CURR:RANG 5E-3;:SENS:CURR:RANG:AUTO " + found)
    killed = bench.driver()
    killed.connect()
    written = bench.ask(b"SENS:CURR:RANG?")
    bench.ask(b"SENS:CURR:RANG:AUTO 1")
    following = bench.driver()
    following.identify()
    following.close()
    assert (bench.ask(b"SENS:CURR:RANG:AUTO?"), bench.ask(b"SENS:CURR:RANG?")) == (b"1", written)


def test_a_note_of_a_module_that_is_no_longer_on_the_line_does_not_hold_up_the_others(opened: RigOpener) -> None:
    """As after one module was taken away, or with another rig file on the same port: its address is silent."""
    bench = AxesSetUp(opened())
    bench.notes[0].text = ""
    before = bench.state()
    killed = bench.driver()
    killed.connect()
    killed.module.found.note({"SAP 2 4 0": ("1", "2")})
    following = bench.driver()
    asked: list[int] = []
    exchange = following.module.exchange

    def note_address(request: CommandFrame, stop_count: int | None = None) -> int:
        asked.append(request.address)
        return exchange(request, stop_count)

    following.module.exchange = note_address  # type: ignore[method-assign]
    following.identify()
    following.close()
    assert (bench.state(), bench.notes[0].text, set(asked)) == (before, "", {1})


# ---- the monochromator's wire ----


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_identifying_sends_info_alone(opened: RigOpener, echo: bool, handshake: bool) -> None:
    bench = MonochromatorBench(opened, echo, handshake)
    bench.driver.close()
    sent: list[tuple[str, bytes]] = []
    device = Monochromator(
        bench.wires.serial(MONO), bench.driver.settings, bench.clock, lambda way, data: sent.append((way, data))
    )
    assert device.identify() == "Cornerstone 260 virtual"
    device.close()
    assert b"".join(data for way, data in sent if way == ">") == b"INFO?\n"


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_every_unit_is_left_as_it_was(opened: RigOpener, echo: bool, handshake: bool) -> None:
    bench = MonochromatorBench(opened, echo, handshake)
    bench.driver.close()
    bench.unit.receive(b"UNITS WN\n", bench.clock.now())
    bench.unit.outbox.clear()
    before = replace(bench.unit.state, status=NO_ERROR, error=ErrorCode.NONE)
    bench.driver.connect()
    bench.go(600.0)
    slew = bench.driver.start_wavelength(700.0)
    assert slew.poll() is False
    bench.driver.close()  # in the middle of a motion
    assert replace(bench.unit.state, status=NO_ERROR, error=ErrorCode.NONE) == before


def test_units_in_small_letters_are_restored_too(opened: RigOpener) -> None:
    """Case does not matter in statements (MCS260 p. 49); whether replies keep to capitals is stated nowhere."""
    bench = MonochromatorBench(opened, echo=False)
    bench.driver.close()
    receive = bench.unit.receive

    def receive_and_whisper(data: bytes, t: float) -> None:
        receive(data, t)
        replies = [(due, reply.lower()) for due, reply in bench.unit.outbox]
        bench.unit.outbox.clear()
        bench.unit.outbox.extend(replies)

    bench.unit.receive = receive_and_whisper  # type: ignore[method-assign]
    bench.unit.receive(b"UNITS UM\n", bench.clock.now())
    bench.unit.outbox.clear()
    bench.driver.connect()
    units = [bench.unit.state.unit]
    bench.driver.close()
    units.append(bench.unit.state.unit)
    assert units == [WavelengthUnit.NM, WavelengthUnit.UM]


def test_a_dead_unit_does_not_hold_up_the_end(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    bench.unit.receive = lambda data, t: None  # type: ignore[method-assign]
    start = bench.clock.now()
    bench.driver.close()
    assert bench.clock.now() - start < 3.0


def test_an_axis_that_turns_is_stopped_by_its_heartbeat_before_that_is_restored(opened: RigOpener) -> None:
    bench = AxesSetUp(opened())
    bench.notes[0].text = ""
    driver = bench.driver()
    driver.connect()
    driver.axes["sigma"].start_relative(90.0)
    driver.close()
    assert bench.exchange(Command.GAP, AxisParameter.ACTUAL_VELOCITY, 4) == 0
    assert 0 < bench.exchange(Command.GAP, AxisParameter.ACTUAL_POSITION, 4) < 90 * 5120
    assert bench.exchange(Command.GGP, GlobalParameter.HEARTBEAT, 0) == 0
    endless = bench.driver()
    endless.module.heartbeat_s = 0.0
    endless.connect()
    endless.axes["sigma"].start_relative(90.0)
    endless.close()
    assert bench.notes[0].text  # nothing stops it: left to the next connection
    bench.clock.sleep_until(bench.clock.now() + 60.0)
    bench.driver().identify()
    assert not bench.notes[0].text
    with pytest.raises(DeviceError):
        driver.axes["sigma"].position_deg()  # its port is closed


def test_an_axis_that_a_stop_brings_to_rest_does_not_wait_for_a_long_heartbeat(opened: RigOpener) -> None:
    """That of a virtual rig is more than a minute, and its station ends with this."""
    bench = AxesSetUp(opened())
    bench.notes[0].text = ""
    driver = bench.driver()
    driver.set_heartbeat(float("inf"))
    driver.connect()
    driver.axes["sigma"].start_relative(90.0)
    bench.clock.sleep_until(bench.clock.now() + 2.0)
    assert stop_all({"axes": driver.begin_stop()}) == []
    begun = bench.clock.now()
    driver.close()
    assert bench.clock.now() - begun < 2.0
    assert bench.exchange(Command.GAP, AxisParameter.ACTUAL_VELOCITY, 4) == 0
    assert not bench.notes[0].text
