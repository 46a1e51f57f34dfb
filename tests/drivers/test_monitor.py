"""The monitor's driver: means, settings, instruments of other makes."""

import pytest

from goniotwin.drivers import MonitorSettings, NoAnswer, Refused, wait
from goniotwin.drivers.usb.usbtmc import UsbTmc
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin.devices.scpi_instrument import Command, ScpiInstrument
from goniotwin.twin.devices.usbtmc import UsbTmcDevice
from tests.conftest import RigOpener
from tests.drivers.monitor_bench import TRUTH_A, Bench, bench

__all__ = ["bench"]


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


def test_a_question_that_was_not_asked_has_no_answer(bench: Bench) -> None:
    wire = UsbTmc("monitor", lambda: None)
    with pytest.raises(NoAnswer, match="not connected"):
        wire.query("*IDN?")
    with pytest.raises(NoAnswer, match="not connected"):
        wire.connect()
    with pytest.raises(NoAnswer, match="no query was sent"):
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
    with pytest.raises(Refused, match="no power"):
        bench.monitor.start_mean(0.1, "power")
