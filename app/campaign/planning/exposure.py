"""Expected exposure: how long rows are read whose gains or readings depend on the light, from a twin's signal at some of them.

The photocurrents are those of the twin's fast estimator, at rows spread evenly over the grid of each sample. The engine's own
rules of auto-range and averaging (app.campaign.readout) are applied to counts with the twin's noise.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from goniotwin.app.campaign.planning.durations import SAMPLED_ROWS, ReadingLots, Timing
from goniotwin.app.campaign.planning.mountings import Pass
from goniotwin.app.campaign.planning.scan_grid import ScanGrid
from goniotwin.app.campaign.readout import read_row
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.rig import RigDescription
from goniotwin.app.rig.described_twin import NoDescription, described_twin
from goniotwin.arrays import Counts, Floats, Ints
from goniotwin.drivers.monochromator.settings import POSITION_AFTER_POWER_UP
from goniotwin.twin.plant import Disturbances, Plant, TwinModel
from goniotwin.twin.plant.noise import normal
from goniotwin.twin.plant.process_key import process_key
from goniotwin.twin.plant.view import Aspect

GOLDEN_FRACTION = 0.6180339887498949
"""Golden ratio minus 1: the fractional parts of its multiples are spread evenly, in step with no grid."""
MAX_DRAWS = 1024
"""Number of drawn noise values for each photodiode. A row of more readings has them again."""
DRAW_OFFSET = 37
"""Offset in the drawn noise from one row to the next."""


def exposure_twin(rig: RigDescription, file: ScheduleFile) -> TwinModel | None:
    """The twin of a virtual rig, or the one that a real rig's file describes, with what a schedule mounts.

    It has no disturbances: a plan knows nothing of them. None where the file describes none, or its signal takes long to
    calculate.
    """
    try:
        model = described_twin(rig, file.standard_factors, file.samples, {}).rig.model()
    except NoDescription:
        return None
    if model is None or model.estimator.kind != "fast" or model.estimator.stray:
        return None
    return replace(model, disturbances=Disturbances())


def expected_reading_s(rig: RigDescription, model: TwinModel, passes: list[Pass], row: Row, timing: Timing) -> float:
    """Mean time in s to read a row of these passes after a similar row."""
    signal = ExpectedSignal(rig, model)
    seconds: dict[ScanGrid, float] = {}
    for each in passes:
        if each.grid not in seconds:
            points = each.grid.points[_spread(len(each.grid))]
            rows_of_lots = [signal.lots(row, point, number) for number, point in enumerate(points)]
            seconds[each.grid] = float(np.mean([timing.lots_seconds(lots) for lots in rows_of_lots]))
    rows = sum(len(each.grid) for each in passes)
    return sum(seconds[each.grid] * len(each.grid) for each in passes) / rows


class ExpectedSignal:
    """The expected signal of a twin's photodiodes as counts, and the readings that a row needs with it."""

    def __init__(self, rig: RigDescription, model: TwinModel) -> None:
        self._settings = rig.file.photodiodes
        self._wheel = rig.file.monochromator.wheel
        self._plant = Plant(model)

    def lots(self, row: Row, point: Floats, number: int) -> list[ReadingLots]:
        """For each gain the lots of readings that a row at a point (5,) takes; `number` selects the drawn noise."""
        gamma, sigma, beta, shift, wavelength = point.tolist()
        sample = None if row.sample == NO_SAMPLE else row.sample
        glass = self._wheel.at(wavelength)
        aspect = Aspect(sample, 0.0, wavelength, sigma, gamma, beta, shift)
        signal = self._plant.steady_photocurrents_a(aspect, POSITION_AFTER_POWER_UP if glass is None else glass.position)
        normals, quiet = _normals(len(signal) + 1), np.zeros((1, len(signal) + 1))
        taken: dict[int, Counts] = {}
        lots: dict[int, list[int]] = {}

        def take(gain: int, readings: int) -> Counts:
            before = lots.setdefault(gain, [])
            drawn = normals[np.mod(sum(before) + np.arange(readings) + number * DRAW_OFFSET, MAX_DRAWS)]
            counts = self._counts(signal, gain, drawn)
            taken[gain] = np.concatenate([taken[gain], counts]) if before else counts
            before.append(readings)
            return taken[gain]

        def dark(gain: int) -> Floats:
            counts: Floats = self._counts(np.zeros(len(signal)), gain, quiet)[0].astype(np.float64)
            return counts

        read_row(row, self._settings, None, dark, take)
        return [(gain, tuple(each)) for gain, each in lots.items()]

    def _counts(self, signal_a: Floats, gain: int, drawn: Floats) -> Counts:
        """Counts (readings, photodiodes) at a gain, given by number, with drawn noise.

        The photodiodes are those of the operator's table. A channel without one in the twin is at 0 V, as it is on the wire.
        """
        volts, channels = self._plant.drawn_volts(signal_a, gain, drawn), self._settings.count
        connected = np.zeros((len(volts), channels))
        connected[:, : volts.shape[1]] = volts[:, :channels]
        return self._settings.range.raw(connected).astype(np.uint16)


@lru_cache(maxsize=4)
def _normals(columns: int) -> Floats:
    """Standard normal numbers (MAX_DRAWS, columns); the same in every call."""
    key = process_key(0, "foreseen readings")
    drawn = [normal(key, np.int64(k)) for k in range(MAX_DRAWS * columns)]
    return np.array(drawn).reshape(MAX_DRAWS, columns)


def _spread(rows: int) -> Ints:
    """Numbers of at most SAMPLED_ROWS of the rows, spread evenly."""
    if rows <= SAMPLED_ROWS:
        return np.arange(rows)
    return np.asarray(rows * np.mod(GOLDEN_FRACTION * np.arange(SAMPLED_ROWS), 1.0), dtype=np.int64)
