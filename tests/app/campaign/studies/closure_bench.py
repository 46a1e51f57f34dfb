"""Scans of the open beam, and rigs drawn from their uncertainties, for tests of the closure."""

import math
from dataclasses import astuple, replace

import numpy as np

from goniotwin.app.campaign.geometry.open_beam import BeamScan, beam_scans
from goniotwin.app.campaign.measurement_model.effects import Component
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.measurement_model.lit_share import SLIT_IMAGE
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.etalon import comparable_signals
from goniotwin.app.campaign.reduction.evidence import add_gains, stated
from goniotwin.app.campaign.reduction.row_signals import RowSignals
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.closure import (
    Closure,
    ScannedBeam,
    compare,
    scanned_beam,
)
from goniotwin.app.rig import RigFile, read_rig
from goniotwin.app.rig.inputs import POSITION
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, Instrument, arc_direction, lambertian, regular, throughput
from tests.conftest import RIG

OPEN, WHITE = regular(transmits=True, side="both"), lambertian(1.0, side="both")


FILE = read_rig(RIG).file


HEAD = """
name = "closure"
samples = ["gaussian-5"]
etalon = "etalon"
beta_deg = [180]
readings = 2
dark_readings = 4
"""


CERTIFICATE = Component("certificate", 0.002, 1.0, InputQuantity("certificate", "1", 0.002, "normal", "all values", "", ""))


def scans_of(sigmas: str, table: str = "") -> list[BeamScan]:
    text = f"{HEAD}sigma_deg = {sigmas}\nwavelength_nm = [550]\ngains_v_per_a = [1e6]\n[open_beam]\n{table}"
    return beam_scans(parse_schedule(text, "x.toml").file, FILE)


def as_read(seen: Floats, gain: int, first_row: int) -> Signal:
    """The signals (n,) of one photodiode in rows, without noise, with the effects that readings at a gain have."""
    n = seen.size
    signal = Signal(seen[:, None], {"noise": np.zeros((n, 1))}, gain=np.full((n, 1), gain))
    rows = np.arange(first_row, first_row + n)
    number = rows.astype(np.int32)[:, None, None]
    signal = signal.with_grouped("monitor", number, -FILE.monitor.relative_uncertainty * seen[:, None, None])
    signal, zero = add_gains(signal, FILE, stated(FILE)), np.zeros(n)
    columns = RowSignals(rows, np.zeros((n, 5)), zero > 0.0, signal, {}, zero, zero)
    return comparable_signals(columns, np.zeros(1, dtype=np.int64), FILE).each(lambda array: array[:, 0])


def beam_signal(
    scan: BeamScan,
    instrument: Instrument,
    along_deg: float | Floats = 0.0,
    across_deg: float | Floats = 0.0,
    sigma_deg: float = 0.0,
) -> Signal:
    """The open beam at all poses of a scan, without wires; the photodiode is off by two angles, the mirror unit by one."""
    azimuth = scan.azimuth_deg + across_deg / math.sin(math.radians(scan.at_deg))
    directions = arc_direction(scan.polar_deg + along_deg, azimuth, scan.arc == "lower")
    seen = throughput(instrument, scan.poses[0, 1] + sigma_deg, directions, OPEN)
    return as_read(seen, 0, 1000 * scan.photodiode)


def etalon_signal(
    scan: BeamScan, instrument: Instrument, along_deg: float = 0.0, across_deg: float = 0.0, sigma_deg: float = 0.0
) -> Signal:
    """The etalon (reflectance 1) in the pose that belongs to a scan."""
    azimuth = 180.0 + across_deg / math.sin(math.radians(scan.at_deg))
    directions = arc_direction(np.array([scan.at_deg + along_deg]), azimuth, scan.arc == "lower")
    seen = throughput(instrument, scan.etalon_pose[1] + sigma_deg, directions, WHITE)
    return as_read(seen, 3, 1000 * scan.photodiode + 999)


def plain_ratio(scan: BeamScan, beam: ScannedBeam, etalon: Signal) -> float:
    """ln of the absolute radiance factor without any correction."""
    return math.log(math.pi * float(etalon.value[0]) / (math.cos(math.radians(scan.at_deg)) * beam.total))


def lit_everywhere(closure: Closure) -> Closure:
    """The closure with a hole that is known to be lit everywhere."""
    parts = tuple(each for each in closure.components if not each.name.startswith(SLIT_IMAGE))
    return replace(closure, components=parts, light=replace(closure.light, components=(), effect=0.0 * closure.light.effect))


class DrawnRig:
    """A rig within Table 2: all deviations, zeros and the photodiode's angles drawn from what the rig file states.

    With the slit's image, which does not cover the hole any more where mirrors are tilted; or with a hole that is `lit`
    everywhere. `times`: all mirrors are off by as much more than the rig file states.
    """

    def __init__(self, seed: int, file: RigFile = FILE, *, lit: bool = False, times: float = 1.0) -> None:
        self._rng, self._table = np.random.default_rng(seed), file.uncertainty
        tilts = ("mirror_tilt_deg", "mirror_shift_mm")
        mirrors = {f"mirror_{k}": self._deviation(*tilts, "xy", "z") for k in (1, 2, 3)}
        common = {name: Deviation(*(times * each for each in astuple(off))) for name, off in mirrors.items()}
        common["pupil"] = self._deviation("mirror_tilt_deg", "illumination_shift_mm", "", "xy")
        common["arc"] = self._deviation("arc_tilt_deg", "arc_shift_mm", "xyz", "xyz")
        common["sensor"] = self._deviation("sensor_tilt_deg", "sensor_shift_mm", "xy", "xyz")
        etalon = self._deviation("etalon_tilt_deg", "etalon_height_mm", "xy", "z")
        empty = self._deviation("sample_tilt_deg", "sample_height_mm", "xy", "z")
        self.with_etalon = Instrument(deviations={**common, "sample": etalon}, lit_everywhere=lit)
        self.empty = Instrument(deviations={**common, "sample": empty}, lit_everywhere=lit)
        self.zeros = {name: self._draw(f"{name}_zero_deg") for name in ("sigma", "beta", "shift")}

    def _draw(self, key: str) -> float:
        return float(self._rng.uniform(-1.0, 1.0) * getattr(self._table, key))

    def _deviation(self, tilt: str, shift: str, about: str, along: str) -> Deviation:
        angles = {f"r{axis}_deg": self._draw(tilt) for axis in about}
        return Deviation(**angles, **{f"{axis}_mm": self._draw(shift) for axis in along})

    def closure(self, scan: BeamScan, *, stops: bool = False) -> tuple[Closure, float]:
        """The closure of a scan, without errors of the signals, and ln of its value before the correction.

        With `stops` shift and beta stop elsewhere in each pose of the scan.
        """
        along = self.zeros["shift"] + self._draw("photodiode_angle_deg")
        across = self._draw("photodiode_across_deg") + self.zeros["beta"] * math.sin(math.radians(scan.at_deg))
        sigma = self.zeros["sigma"]
        of_open = sigma + self._draw("position_deg")
        off = self._rng.uniform(-1.0, 1.0, (2, len(scan.poses))) * self._table.width(POSITION) * stops
        signal = beam_signal(scan, self.empty, along + off[0], across + off[1] * math.sin(math.radians(scan.at_deg)), of_open)
        beam = scanned_beam(scan, 550.0, signal)
        etalon = etalon_signal(
            scan, self.with_etalon, along + self._draw("position_deg"), across, sigma + self._draw("position_deg")
        )
        found = compare(beam, 550.0, signal, None, etalon, 1.0, (CERTIFICATE,), FILE)
        return found, plain_ratio(scan, beam, etalon)
