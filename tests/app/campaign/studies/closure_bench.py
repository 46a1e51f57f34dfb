"""Scans of the open beam, and rigs drawn from their uncertainties, for tests of the closure."""

import math
from dataclasses import replace

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
)
from goniotwin.app.rig import read_rig
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, arc_direction, lambertian, regular, throughput
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
