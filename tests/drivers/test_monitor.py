"""The monitor's driver: means, settings, and a wire that fails."""

import contextlib
from collections.abc import Callable

import pytest
import usb.core

from drivers import BadAnswer, DeviceError, Forgotten, Monitor, MonitorSettings, NoAnswer, Refused, wait
from drivers.usbtmc import UsbTmc
from mocks.faults import ON_USB, Fault, Misfortune, corrupted, truncated
from protocols.clock import VirtualClock
from protocols.usbtmc import HEADER_BYTES
from tests.conftest import RigOpener
from twin import VirtualRig
from twin.devices.scpi_instrument import Command, ScpiInstrument
from twin.devices.usbtmc import BULK_IN, BULK_OUT, UsbTmcDevice
from twin.doors import TwinUsbBackend
from twin.doors.usb import gone

TRUTH_A = 1.4e-7


class Bench:
    """A monitor on a virtual rig with the shutter open, and what can be done to its wire."""

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

    def fail_once(self, name: str, fault: Callable[[bytes], bytes]) -> None:
        """The next answer over bulk IN becomes another one."""
        real = self.device.bulk_in

        def broken(size: int | None = None) -> bytes:
            self.device.bulk_in = real  # type: ignore[method-assign]
            return fault(real(size))

        self.device.bulk_in = broken  # type: ignore[method-assign]


@pytest.fixture
def bench(opened: RigOpener) -> Bench:
    opened_rig = opened(clock=VirtualClock(1.0))
    assert opened_rig.virtual is not None
    opened_rig.rig.monitor.close()
    bench = Bench(opened_rig.virtual)
    bench.monitor.connect()
    return bench


def test_it_measures_current_and_power(bench: Bench) -> None:
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    power = bench.monitor.start_mean(0.1, "power")
    wait(bench.clock, [power])
    assert power.power_w == pytest.approx(TRUTH_A / 0.08, rel=0.02)  # 0.08 A/W at 550 nm, half way from 0.06 to 0.1
    bench.monitor.set_wavelength(600.0)
    power = bench.monitor.start_mean(0.1, "power")
    wait(bench.clock, [power])
    assert power.power_w == pytest.approx(TRUTH_A / 0.1, rel=0.02)
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_ranges_filter_and_zero(bench: Bench) -> None:
    bench.monitor.set_range(None)
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    bench.monitor.set_low_pass(True)
    with pytest.raises(Refused, match="-222"):
        bench.monitor.set_range(1.0)
    bench.rig.plant.shutter_open.set(bench.clock.now(), False)
    wait(bench.clock, [bench.monitor.start_zero()])
    assert bench.monitor.zero_a() == pytest.approx(1e-11, rel=0.01)
    bench.rig.plant.shutter_open.set(bench.clock.now(), True)
    with pytest.raises(Refused, match="too much light"):
        wait(bench.clock, [bench.monitor.start_zero()])


def test_the_status_byte_is_read_beside_a_measurement(bench: Bench) -> None:
    mean = bench.monitor.start_mean(0.5)
    assert bench.monitor.status_byte() == 0
    bench.clock.sleep_until(mean.due)
    assert bench.monitor.status_byte() == 0x10
    wait(bench.clock, [mean])


def test_a_measurement_that_nobody_waited_for_disturbs_nothing(bench: Bench) -> None:
    bench.monitor.start_mean(1.0)
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    bench.monitor.start_mean(1.0)
    bench.monitor.abort()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    assert not bench.device.complaints


FAULTS: dict[str, Callable[[bytes], bytes]] = {
    "another tag": lambda data: bytes((data[0], data[1] ^ 1, data[2] ^ 1)) + data[3:],
    "a broken header": lambda data: data[:1] + bytes((data[1] ^ 4,)) + data[2:],
    "another message": lambda data: b"\x7f" + data[1:],
    "cut off": lambda data: data[:-6],
    "no header": lambda data: data[:5],
    "empty": lambda data: b"",
    "two at once": lambda data: data + data,
    "no number": lambda data: data[:HEADER_BYTES] + b"x" * (len(data) - HEADER_BYTES),
    "an overrange": lambda data: data[:HEADER_BYTES] + b"9.90000000E+37\n" + data[27:],
    "not a number": lambda data: data[:HEADER_BYTES] + b"9.91000000E+37\n" + data[27:],
    "beyond the range": lambda data: data[:HEADER_BYTES] + b"1.00000000E-03\n" + data[27:],
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_no_answer_is_an_error_and_the_next_call_works(bench: Bench, fault: str) -> None:
    bench.mean()
    mean = bench.monitor.start_mean(0.1)
    bench.fail_once("bulk_in", FAULTS[fault])
    start = bench.clock.now()
    with pytest.raises(DeviceError, match="monitor: READ"):
        wait(bench.clock, [mean])
    assert bench.clock.now() - start < 5.0
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


@pytest.mark.parametrize("endpoint", [BULK_IN, BULK_OUT])
def test_a_stall_is_said_and_released(bench: Bench, endpoint: int) -> None:
    bench.mean()
    bench.device.halt(endpoint)
    with pytest.raises(NoAnswer, match="stall"):
        bench.mean()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    assert "brought into step" in bench.monitor.said[-1]


@pytest.mark.parametrize("keeps_fifo", [False, True])
def test_a_late_answer_is_never_taken_for_the_next_one(bench: Bench, keeps_fifo: bool) -> None:
    """The host gives up after a second; the answer comes after three."""
    bench.device.keeps_fifo = keeps_fifo
    bench.mean()
    wire = bench.monitor._wire
    wire.ask("*OPC?")
    wire.write("SENS:AVER:COUN 9000")
    start = bench.clock.now()
    with pytest.raises(NoAnswer, match="no answer within 1 s"):
        wire.ask("READ?")
    assert bench.clock.now() - start < 1.5
    bench.clock.sleep_until(bench.clock.now() + 5.0)
    assert wire.ask("*IDN?").startswith(b"Thorlabs")
    assert wire.ask("SENS:AVER:COUN?") == b"9000"  # the settings have stayed
    with pytest.raises(Forgotten):  # but they are not the driver's
        bench.mean()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_an_unplugged_one_is_gone_and_works_again_when_it_is_back(bench: Bench) -> None:
    bench.mean()
    bench.backend.unplug("monitor")
    for _ in range(3):
        with pytest.raises(NoAnswer, match="it is not there"):
            bench.mean()
    bench.backend.replug("monitor")
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    assert any("found again" in each for each in bench.monitor.said)


def test_one_that_has_lost_its_power_says_so_once_and_gets_its_settings_back(bench: Bench) -> None:
    bench.mean()
    bench.backend.unplug("monitor")
    with pytest.raises(NoAnswer):
        bench.mean()
    bench.backend.replug("monitor", reset=True)
    with pytest.raises(Forgotten, match="reset itself; its settings are restored"):
        bench.mean()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_a_reset_without_unplugging_is_seen_by_the_canary(bench: Bench) -> None:
    bench.mean()
    bench.device.instrument.power_cycle(bench.clock.now())
    with pytest.raises(Forgotten):
        bench.monitor.check()
    bench.monitor.check()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_another_instrument_in_its_place_is_refused(bench: Bench) -> None:
    bench.mean()
    bench.backend.unplug("monitor")
    with pytest.raises(NoAnswer):
        bench.mean()
    bench.device.instrument.serial_number = "TWIN0002"
    bench.backend.replug("monitor")
    with pytest.raises(BadAnswer, match="TWIN0002"):
        bench.mean()


def test_a_device_that_hangs_is_an_error_in_bounded_time(bench: Bench) -> None:
    bench.mean()
    bench.device.bulk_in_ready = lambda: None  # type: ignore[method-assign]
    for _ in range(3):
        start = bench.clock.now()
        with pytest.raises(NoAnswer):
            bench.mean()
        assert bench.clock.now() - start < 5.0
    del bench.device.bulk_in_ready
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_a_question_that_was_not_asked_has_no_answer(bench: Bench) -> None:
    wire = UsbTmc("monitor", lambda: None)
    with pytest.raises(NoAnswer, match="not open"):
        wire.ask("*IDN?")
    with pytest.raises(NoAnswer, match="it is not there"):
        wire.connect()
    with pytest.raises(NoAnswer, match="was not asked"):
        bench.monitor._wire.read("READ?")


class Picoammeter(ScpiInstrument):
    """An instrument of another make: the strings of the B2980 family, as far as the driver says them."""

    vendor_id, product_id = 0x0957, 0x9118
    manufacturer, product, serial_number = "Keysight Technologies", "B2981A", "TWIN0981"

    def __init__(self) -> None:
        self.said: list[str] = []
        self.aperture = 0.1
        super().__init__()

    def commands(self):  # type: ignore[no-untyped-def]
        for pattern in (
            "[SENSe]:FUNCtion",
            "[SENSe]:CURRent[:DC]:RANGe[:UPPer]",
            "FORMat[:DATA]",
            "FORMat:ELEMents:SENSe",
            "INPut[:STATe]",
        ):
            command: Command = (pattern, False, lambda unit: self.said.append(unit.header[-1]))
            yield command
        yield "[SENSe]:CURRent[:DC]:APERture", False, lambda unit: setattr(self, "aperture", float(unit.parameters[0]))
        yield "[SENSe]:CURRent[:DC]:APERture", True, lambda _: f"{self.aperture:.6E}".encode()
        yield "READ", True, lambda _: self._reading()

    def _reading(self) -> bytes:
        self._now += self.aperture
        return b"+1.400000E-07"


def test_a_picoammeter_of_another_make_is_a_table_of_strings(opened: RigOpener) -> None:
    opened_rig = opened(clock=VirtualClock(1.0))
    assert opened_rig.virtual is not None
    opened_rig.rig.monitor.close()
    instrument = Picoammeter()
    opened_rig.virtual.usb["monitor"] = UsbTmcDevice(instrument, 5e-4)
    bench = Bench(opened_rig.virtual, MonitorSettings(dialect="b2980"))
    assert bench.monitor.connect() == "Keysight Technologies,B2981A,TWIN0981,1.0"
    start = bench.clock.now()
    assert bench.mean(0.5) == pytest.approx(TRUTH_A)
    assert bench.clock.now() - start == pytest.approx(0.5, abs=0.02)
    assert instrument.said == ["FORM", "SENS", "INP", "FUNC", "RANG"]
    with pytest.raises(Refused, match="not power"):
        bench.monitor.start_mean(0.1, "power")


class FaultyUsb(UsbTmcDevice):
    """The instrument behind a bus that fails. A payload is never damaged in silence: the bus has its checksums."""

    misfortune: Misfortune
    fault = Fault.NONE
    late_s = 0.0

    def bulk_out(self, data: bytes, t: float) -> None:
        self.fault = self.misfortune.next()
        self.late_s = 0.0
        match self.fault:
            case Fault.UNHEARD | Fault.HANG:
                return
            case Fault.STALL:
                self.halt(BULK_IN if data[1] % 2 else BULK_OUT)
            case Fault.LATE:
                self.late_s = 1.5
            case Fault.UNPLUGGED:
                self.unplug()
                self.replug()
                raise gone()
        super().bulk_out(data, t)

    def bulk_in_ready(self) -> float | None:
        ready = super().bulk_in_ready()
        return None if ready is None or self.fault in (Fault.NAK, Fault.HANG) else ready + self.late_s

    def bulk_in(self, size: int | None = None) -> bytes:
        data = super().bulk_in(size)
        match self.fault:
            case Fault.LOST:
                return b""
            case Fault.TRUNCATED:
                return truncated(data, self.misfortune)
            case Fault.CORRUPTED:
                return corrupted(data[:HEADER_BYTES], self.misfortune) + data[HEADER_BYTES:]
        return data


@pytest.mark.parametrize("seed", range(50))
def test_a_bus_that_fails_gives_no_wrong_value(opened: RigOpener, seed: int) -> None:
    """A fifth of all transfers fail somehow; then none does, and it works again."""
    opened_rig = opened(("noise = true", "noise = false"), clock=VirtualClock(1.0))
    assert opened_rig.virtual is not None
    opened_rig.rig.monitor.close()
    device = FaultyUsb(opened_rig.virtual.usb["monitor"].instrument, 5e-4)
    device.misfortune = Misfortune(seed, (), 0.0)
    opened_rig.virtual.usb["monitor"] = device
    bench = Bench(opened_rig.virtual)
    bench.monitor.connect()
    truth = bench.mean()
    device.misfortune = Misfortune(seed, ON_USB, until=80)
    for _ in range(12):
        start = bench.clock.now()
        with contextlib.suppress(DeviceError):
            assert bench.mean() == pytest.approx(truth, rel=2e-3)  # the lamp drifts by 2 % an hour
        assert bench.clock.now() - start < 10.0
    device.misfortune = Misfortune(seed, (), 0.0)
    for _ in range(2):  # settings that were lost are told once
        with contextlib.suppress(DeviceError):
            bench.mean()
    assert bench.mean() == pytest.approx(truth, rel=2e-3)  # the lamp drifts by 2 % an hour
