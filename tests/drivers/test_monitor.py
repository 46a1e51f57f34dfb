"""The monitor driver: means, settings, instruments of another make."""

import pytest

from goniotwin.drivers import MonitorSettings, NoAnswer, Refused, wait
from goniotwin.drivers.usb.usbtmc import UsbTmc
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin.devices.scpi_instrument import Command, ScpiInstrument
from goniotwin.twin.devices.usbtmc import UsbTmcDevice
from tests.conftest import RigOpener
from tests.drivers.monitor_bench import TRUTH_A, MonitorBench, bench

__all__ = ["bench"]


def test_means_of_current_and_power(bench: MonitorBench) -> None:
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    power = bench.monitor.start_mean(0.1, "power")
    wait(bench.clock, [power])
    assert power.power_w == pytest.approx(TRUTH_A / 0.08, rel=0.02)  # 0.08 A/W at 550 nm, interpolated from 0.06 and 0.1
    bench.monitor.set_wavelength(600.0)
    power = bench.monitor.start_mean(0.1, "power")
    wait(bench.clock, [power])
    assert power.power_w == pytest.approx(TRUTH_A / 0.1, rel=0.02)
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_ranges_filter_and_zero(bench: MonitorBench) -> None:
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


def test_the_status_byte_can_be_read_during_a_measurement(bench: MonitorBench) -> None:
    mean = bench.monitor.start_mean(0.5)
    assert bench.monitor.status_byte() == 0
    bench.clock.sleep_until(mean.due)
    assert bench.monitor.status_byte() == 0x10
    wait(bench.clock, [mean])


def test_an_abandoned_measurement_does_not_disturb_the_next_one(bench: MonitorBench) -> None:
    bench.monitor.start_mean(1.0)
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    bench.monitor.start_mean(1.0)
    bench.monitor.abort()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    assert not bench.device.complaints


def test_a_read_without_a_query_is_an_error(bench: MonitorBench) -> None:
    wire = UsbTmc("monitor", lambda: None, VirtualClock())
    with pytest.raises(NoAnswer, match="not connected"):
        wire.query("*IDN?")
    with pytest.raises(NoAnswer, match="not connected"):
        wire.connect()
    with pytest.raises(NoAnswer, match="no query was sent"):
        bench.monitor.wire.read("READ?")


class Picoammeter(ScpiInstrument):
    """An instrument of another make: the commands of the B2980 family that the driver uses."""

    vendor_id, product_id = 0x0957, 0x9118
    manufacturer, product, serial_number = "Keysight Technologies", "B2981A", "TWIN0981"

    def __init__(self) -> None:
        self.received: list[str] = []
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
            command: Command = (pattern, False, lambda unit: self.received.append(unit.header[-1]))
            yield command
        yield "[SENSe]:CURRent[:DC]:APERture", False, lambda unit: setattr(self, "aperture", float(unit.parameters[0]))
        yield "[SENSe]:CURRent[:DC]:APERture", True, lambda _: f"{self.aperture:.6E}".encode()
        yield "READ", True, lambda _: self._reading()

    def _reading(self) -> bytes:
        self._now += self.aperture
        return b"+1.400000E-07"


def test_a_picoammeter_of_another_make_needs_only_a_dialect(opened: RigOpener) -> None:
    opened_rig = opened(clock=VirtualClock(1.0))
    assert opened_rig.virtual is not None
    opened_rig.rig.monitor.close()
    instrument = Picoammeter()
    opened_rig.virtual.usb["monitor"] = UsbTmcDevice(instrument, 5e-4)
    bench = MonitorBench(opened_rig.virtual, MonitorSettings(dialect="b2980"))
    assert bench.monitor.connect() == "Keysight Technologies,B2981A,TWIN0981,1.0"
    start = bench.clock.now()
    assert bench.mean(0.5) == pytest.approx(TRUTH_A)
    assert bench.clock.now() - start == pytest.approx(0.5, abs=0.02)
    assert instrument.received == ["FORM", "SENS", "INP", "FUNC", "RANG"]
    with pytest.raises(Refused, match="no power"):
        bench.monitor.start_mean(0.1, "power")
