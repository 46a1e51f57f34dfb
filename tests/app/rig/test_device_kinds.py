"""Another make of the other devices: monitor and converter with kind, twin device and driver, and nothing else changed."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.readout import SATURATED
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig import open_rig, read_rig
from goniotwin.app.rig.kinds import DeviceKind, register, unregister
from goniotwin.app.rig.wires import Wires
from goniotwin.arrays import Floats
from goniotwin.drivers import FilterWheel, Monitor, MonitorSettings, Monochromator, MonochromatorSettings, wait
from goniotwin.drivers.tap import as_text
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices import Pm100d, UsbTmcDevice
from goniotwin.twin.plant import Plant
from tests.app.campaign.campaign_bench import run_plan
from tests.app.campaign.planning.planner_bench import HEAD
from tests.app.rig.test_described_twin import real_rig
from tests.app.rig.twelve_bits import TWELVE_BITS, TwelveBits
from tests.conftest import RIG, RigOpener, Writer


@dataclass(frozen=True, kw_only=True)
class OtherTable(MonitorSettings):
    """The table of the other make: its address has another key than that of the first."""

    kind: Literal["other"]
    usb: str
    filter_transmittance: float = 1.0


class OtherMonitor(Monitor):
    """The driver of the other make."""

    def connect(self) -> str:
        return f"other {super().connect()}"


@dataclass(frozen=True, kw_only=True)
class OtherModel:
    """The twin device of the other make, in place of the usual monitor."""

    kind: Literal["other-100"]
    latency_s: float = 1.0e-3

    def build(self, plant: Plant) -> UsbTmcDevice:
        return UsbTmcDevice(Pm100d(plant), self.latency_s)


def open_other(wires: Wires, table: Any) -> OtherMonitor:
    return OtherMonitor(wires.usb(table.usb), table, wires.clock, wires.tap("monitor", as_text))


@dataclass(frozen=True, kw_only=True)
class OtherMonochromator:
    """The table of a monochromator of another make, with no more than the program asks of it."""

    kind: Literal["mono", "usb-mono", "modbus-mono"]
    port: str
    lowest_nm: float = 380.0
    highest_nm: float = 780.0
    wheel = FilterWheel()

    def wavelength_seconds(self, start_nm: Floats, stop_nm: Floats) -> Floats:
        return np.ones(len(stop_nm))

    def shutter_seconds(self, *, opened: bool) -> float:
        return 0.1


def open_usb(wires: Wires, table: Any) -> Any:
    return wires.usb(table.port)


def open_modbus(wires: Wires, table: Any) -> Any:
    return wires.modbus(table.port, "mono")


def open_monochromator(wires: Wires, table: Any) -> Monochromator:
    return Monochromator(wires.serial(table.port), MonochromatorSettings(), wires.clock)


@pytest.fixture(autouse=True)
def _registered() -> Iterator[None]:
    kind = DeviceKind("monitor", "other", OtherTable, open_other, twins=(OtherModel,))
    monochromator = DeviceKind("monochromator", "mono", OtherMonochromator, open_monochromator)
    usb = DeviceKind("monochromator", "usb-mono", OtherMonochromator, open_usb)
    modbus = DeviceKind("monochromator", "modbus-mono", OtherMonochromator, open_modbus)
    for each in (kind, monochromator, usb, modbus, TWELVE_BITS):
        register(each)
    yield
    for each in (kind, monochromator, usb, modbus, TWELVE_BITS):
        unregister(each)


def test_a_monitor_of_another_make_is_opened_by_its_kind(opened: RigOpener) -> None:
    rig = opened(
        ('kind = "pm100d"', 'kind = "other"\nfilter_transmittance = 0.5'),
        ("[twin.light]\n", '[twin.devices.monitor]\nkind = "other-100"\n\n[twin.light]\n'),
    )
    assert isinstance(rig.rig.monitor, OtherMonitor)
    assert rig.rig.identities["monitor"].startswith("other Thorlabs")
    assert rig.virtual is not None
    assert rig.virtual.plant.model.devices["monitor"].kind == "other-100"
    mean = rig.rig.monitor.start_mean(0.1)
    wait(rig.rig.clock, [mean])
    assert mean.current_a > 0.0


def test_the_first_make_is_opened_as_before(opened: RigOpener) -> None:
    rig = opened()
    assert type(rig.rig.monitor) is Monitor
    assert not rig.rig.identities["monitor"].startswith("other")


def test_a_twin_of_no_device_of_the_rig_is_refused(write_rig: Writer) -> None:
    table = '[twin.devices.monochromator]\nkind = "other-100"\n\n[twin.light]\n'
    with pytest.raises(UserError, match=r"twin\.devices: no device has the address 'monochromator'; give mono or adc-0"):
        read_rig(write_rig(("[twin.light]\n", table)))


def test_a_twin_of_another_bus_takes_the_place_of_the_usual_one() -> None:
    model = read_rig(RIG).model()
    assert model is not None
    virtual = VirtualRig.build(replace(model, devices={"mono": OtherModel(kind="other-100")}), VirtualClock())
    assert ["mono" in bus for bus in (virtual.serial, virtual.modbus, virtual.usb)] == [False, False, True]


@pytest.mark.parametrize("kind", ["usb-mono", "modbus-mono"])
def test_an_invalid_address_is_reported_with_the_key_that_it_has(write_rig: Writer, kind: str) -> None:
    changes = ('kind = "cornerstone"', f'kind = "{kind}"'), ('"twin://virtual/mono"', '"x:99999"'), ("baudrate = 9600\n", "")
    with pytest.raises(UserError, match=r"rig\.toml: monochromator\.port: 'x:99999': is neither"):
        open_rig(read_rig(write_rig(*changes)), VirtualClock())


# ---- a converter of another make ----

ADAM_UNITS = ", ".join(f'"twin://virtual/adc-{k}"' for k in range(5))
DAQ = (
    ('kind = "adam-6017"', 'kind = "daq"'),
    (ADAM_UNITS, '"twin://virtual/adc-0"'),
    ("[twin.light]\n", '[twin.devices.adc-0]\nkind = "daq-12"\n\n[twin.light]\n'),
)
MORE_READINGS = (("readings = 2\n", "readings = 4\n"), ("dark_readings = 4", "dark_readings = 16"))
STEADY_LAMP = ("drift_per_hour = 0.02", "drift_per_hour = 0.0")


@pytest.mark.long
@pytest.mark.parametrize("gains", ["[1e8, 1e10]", '"automatic"'])
def test_a_converter_of_twelve_bits_gives_the_values_of_the_first_make(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, gains: str
) -> None:
    """The peak of the sample is beyond the range at all gains above 1e8 V/A: the reduction has to see that."""
    schedule = read_schedule(write_schedule(*MORE_READINGS, ("[1e8, 1e10]", gains)))
    points = []
    for name, changes in (("first", ()), ("daq", DAQ)):
        plan = make_plan(schedule, read_rig(write_rig(STEADY_LAMP, *changes)))
        rows = run_plan(plan, tmp_path / f"{name}.journal").of("measure", "gaussian-5")
        with Journal.open(tmp_path / f"{name}.journal") as journal:
            points.append(reduce_journal(journal).samples["gaussian-5"])
    assert all(row.data.readings[-1].counts.max() == TwelveBits.highest for row in rows)
    assert all(row.data.readings[0].counts.max() < TwelveBits.highest for row in rows)
    first, daq = points
    both = first.good & daq.good & (first.bsdf > 0.01)
    assert both[np.nanargmax(first.bsdf)]
    assert both.sum() >= 8
    u = np.hypot(first.u_bsdf, daq.u_bsdf)[both]
    assert np.max(np.abs(daq.bsdf - first.bsdf)[both] / u) < 3.5
    assert not daq.flag("clipped").any()


@pytest.mark.long
def test_what_is_beyond_the_range_of_twelve_bits_is_flagged(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    plan = make_plan(read_schedule(write_schedule(*MORE_READINGS, ("[1e8, 1e10]", "[1e10]"))), read_rig(write_rig(*DAQ)))
    settings = plan.rig.file.photodiodes
    statistics = RowStatistics(settings, lambda _: np.ones(settings.count, dtype=bool))
    rows = run_plan(plan, tmp_path / "a.journal", listeners=[statistics]).of("measure", "gaussian-5")
    assert all(row.data.flags == (SATURATED,) for row in rows)
    assert statistics.saturated >= len(rows)
    assert statistics.share_of_range == {1e10: 1.0}
    with Journal.open(tmp_path / "a.journal") as journal:
        points = reduce_journal(journal).samples["gaussian-5"]
    assert points.flag("clipped").any()
    assert np.isnan(points.bsdf[points.flag("clipped")]).all()


@pytest.mark.parametrize("light", ["", 'gains_v_per_a = "automatic"\n', "[averaging]\nrelative_uncertainty = 0.01\n"])
def test_a_real_rig_with_a_monochromator_of_another_make_is_planned_and_has_no_twin(light: str) -> None:
    real = real_rig(('kind = "cornerstone"\n', 'kind = "mono"\n'), ("baudrate = 9600\n", ""))
    gains = "" if "gains" in light else "gains_v_per_a = [1e10]\n"
    schedule = parse_schedule(
        f"{HEAD}sigma_deg = [0]\nbeta_deg = [0, 90]\nwavelength_nm = [500, 600]\n{gains}{light}", "x.toml"
    )
    plan = make_plan(schedule, real)
    # An etalon and a sample, each with two wavelengths at 1 s or more.
    assert check_plan(plan).duration_s > 4.0
    with pytest.raises(UserError, match=r"monochromator: there is no description of a twin for the kind 'mono'"):
        plan_rehearsal(schedule, real, {})
