"""The variance of the directions that one detector accepts, and an instrument with another one."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.instrument import Instrument

POINTS = 4096
LARGEST = 8.0
"""Largest factor by which pupil and cone are scaled."""


@lru_cache(maxsize=16)
def scale_field(instrument: Instrument, log_variance: float) -> Instrument:
    """The instrument with exit pupil and acceptance cone scaled alike, so that ln(variance) grows by `log_variance`.

    The variance is that of the directions of a detector's rays about the specular one, at normal incidence; it is as near as a
    factor of eight in scale allows. Raises ValueError for an instrument with a sensor: its field is that of its parts.
    """
    if log_variance == 0.0:
        return instrument
    if instrument.sensor is not None:
        raise ValueError("disturbances.field_of_view: a [twin.sensor] has the field of its parts; change these, or set 0")
    wanted = math.exp(log_variance) * field_variance(instrument)
    low, high = 1.0 / LARGEST, LARGEST
    for _ in range(50):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if field_variance(_scaled(instrument, middle)) < wanted else (low, middle)
    return _scaled(instrument, low)


def field_variance(instrument: Instrument) -> float:
    """Variance along one axis, rad^2, of the directions of a virtual detector's rays about the specular one."""
    pupil = (instrument.pupil_radius_mm / instrument.pupil_distance_mm) ** 2 / 4.0
    points = _points()
    hole = instrument.spot_side_mm * points[:, :2]
    radius, turn = np.sqrt(points[:, 2] + 0.5), 2.0 * math.pi * points[:, 3]
    cone = math.tan(math.radians(0.5 * instrument.field_deg)) * radius[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    on_disc = hole + instrument.arc_radius_mm * cone
    counted = np.hypot(on_disc[:, 0], on_disc[:, 1]) <= 0.5 * instrument.detector_diameter_mm
    if not counted.any():
        return pupil
    offsets = cone[counted] - hole[counted] / instrument.pupil_distance_mm
    return pupil + 0.5 * float(np.mean(np.sum(offsets**2, axis=1)))


def _scaled(instrument: Instrument, scale: float) -> Instrument:
    return replace(
        instrument,
        pupil_radius_mm=scale * instrument.pupil_radius_mm,
        field_deg=2.0 * math.degrees(math.atan(scale * math.tan(math.radians(0.5 * instrument.field_deg)))),
    )


@lru_cache(maxsize=1)
def _points() -> Floats:
    """Points (n, 4) spread evenly over the cube of -0.5 to 0.5: multiples of the powers of a root (Roberts' sequence)."""
    root = 1.1673039782614187  # of x^5 = x + 1
    steps = root ** -np.arange(1.0, 5.0)
    points: Floats = np.mod(0.5 + np.arange(1.0, POINTS + 1.0)[:, None] * steps, 1.0) - 0.5
    return points
