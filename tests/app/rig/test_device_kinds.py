"""Another make of the other devices: a monitor with its own kind, twin device and driver, and nothing else changed."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pytest

from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.kinds import DeviceKind, register, unregister
from goniotwin.app.rig.wires import Wires
from goniotwin.arrays import Floats
from goniotwin.drivers import FilterWheel, Monitor, MonitorSettings, Monochromator, MonochromatorSettings, wait
from goniotwin.drivers.tap import as_text
from goniotwin.twin.devices import Pm100d, UsbTmcDevice
from goniotwin.twin.plant import Plant
from tests.app.campaign.planning.planner_bench import HEAD
from tests.app.rig.test_described_twin import real_rig
from tests.conftest import RigOpener, Writer


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

    kind: Literal["mono"]
    port: str
    lowest_nm: float = 380.0
    highest_nm: float = 780.0
    wheel = FilterWheel()

    def wavelength_seconds(self, start_nm: Floats, stop_nm: Floats) -> Floats:
        return np.ones(len(stop_nm))

    def shutter_seconds(self, *, opened: bool) -> float:
        return 0.1


def open_monochromator(wires: Wires, table: Any) -> Monochromator:
    return Monochromator(wires.serial(table.port), MonochromatorSettings(), wires.clock)


@pytest.fixture(autouse=True)
def _registered() -> Iterator[None]:
    kind = DeviceKind("monitor", "other", OtherTable, open_other, twins=(OtherModel,))
    monochromator = DeviceKind("monochromator", "mono", OtherMonochromator, open_monochromator)
    register(kind)
    register(monochromator)
    yield
    unregister(kind)
    unregister(monochromator)


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


@pytest.mark.parametrize("light", ["", 'gains_v_per_a = "automatic"\n', "[averaging]\nrelative_uncertainty = 0.01\n"])
def test_a_real_rig_with_a_monochromator_of_another_make_is_planned_and_has_no_twin(light: str) -> None:
    real = real_rig(('kind = "cornerstone"\n', 'kind = "mono"\n'), ("baudrate = 9600\n", ""))
    gains = "" if "gains" in light else "gains_v_per_a = [1e10]\n"
    schedule = parse_schedule(
        f"{HEAD}sigma_deg = [0]\nbeta_deg = [0, 90]\nwavelength_nm = [500, 600]\n{gains}{light}", "x.toml"
    )
    plan = make_plan(schedule, real)
    # An etalon and a sample, each with two wavelengths at 1 s or more.
    assert check_plan(plan)["duration_s"] > 4.0
    with pytest.raises(UserError, match=r"monochromator: there is no description of a twin for the kind 'mono'"):
        plan_rehearsal(schedule, real, {})
