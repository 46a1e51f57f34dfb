"""The paper's Table 3 beside ours: noise-free, with the sample tilted, and at the worst corner of the deviations."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.simulation.paper.explanation import (
    FORMS,
    RANGES,
    SIGMAS_DEG,
    TILTS_DEG,
    WIDTHS_DEG,
    ClosestSettings,
    closest_settings,
    counting_variance,
    interpolation_error,
    noise_floor,
    required_tilt_deg,
    rms_table,
    with_tilt,
)
from goniotwin.app.simulation.paper.worst_corner import TILT_DEG, Corner, tilts, with_shifts, worst_corner
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument

CELLS = len(SIGMAS_DEG) * len(WIDTHS_DEG)
STEPS = CELLS + len(FORMS) * len(RANGES) + 1
"""Number of calls of `report` in `compute_table3`."""
FAR_MM = 1e6
POINT_MM = 0.01
ReportStep = Callable[[str], None]
"""Receives the name of the next step."""


@dataclass(frozen=True, eq=False)
class Table3:
    """Relative RMS in percent, (3, 4) each, sigma 0, 30, 60 by widths of 2, 5, 15, 30 deg; and the data of its explanation.

    `tilted` and `sagittal` are with the sample tilted in and out of the plane of incidence, `point_spot` with a spot of nearly
    no size. `corners` has the worst corner of each cell, row by row. `collimated` is the worst corner at sigma 30, width 5
    with the exit pupil at infinity, `shifted` that of this instrument with the shifts of 0.1 mm added. `required_tilt_deg` is
    the tilt of the sample that gives each of the paper's values, `floor` the noise-free table with counting noise of
    `floor_percent`, `etalon_rise` the factor (4,) of the etalon's counting noise from sigma 0 to 60, `interpolation` the error
    of a linear interpolation half way between detectors.
    """

    instrument: Instrument
    noise_free: Floats
    tilted: Floats
    sagittal: Floats
    point_spot: Floats
    worst: Floats
    corners: tuple[Corner, ...]
    collimated: Corner
    shifted: Corner
    floor_percent: float
    floor: Floats
    etalon_rise: Floats
    required_tilt_deg: Floats
    interpolation: Floats
    closest: ClosestSettings

    def corner(self, sigma_deg: float, width_deg: float) -> Corner:
        """The worst corner of a cell."""
        return self.corners[SIGMAS_DEG.index(sigma_deg) * len(WIDTHS_DEG) + WIDTHS_DEG.index(width_deg)]


def compute_table3(
    report: ReportStep = lambda _: None, rays: int | None = None, tilts_deg: Sequence[float] = TILTS_DEG
) -> Table3:
    """Compute the table by the fast estimator, without obstruction; `report` is called `STEPS` times.

    `rays` is that of `twin.optics.throughput`, for the noise-free table alone. `tilts_deg` are those of the sample among which
    the closest settings are looked for.
    """
    instrument = Instrument(obstruction=False)
    report("noise-free, tilted")
    blur, tilted = rms_table(instrument, rays=rays), rms_table(with_tilt(instrument, TILT_DEG))
    sagittal = rms_table(with_tilt(instrument, 0.0, TILT_DEG))
    corners = []
    for sigma in SIGMAS_DEG:
        for width in WIDTHS_DEG:
            report(f"worst corner at sigma {sigma:g}, width {width:g} deg")
            corners.append(worst_corner(instrument, sigma, width, tilts(instrument)))
    far = collimated(instrument)
    variance, alone = counting_variance(instrument), counting_variance(instrument, etalon_alone=True)
    percent, floor = noise_floor(blur, variance)
    worst = np.array([corner.relative_rms_percent for corner in corners]).reshape(blur.shape)
    middle = SIGMAS_DEG.index(30.0) * len(WIDTHS_DEG) + WIDTHS_DEG.index(5.0)
    return Table3(
        instrument=instrument,
        noise_free=blur,
        tilted=tilted,
        sagittal=sagittal,
        point_spot=rms_table(replace(instrument, spot_side_mm=POINT_MM)),
        worst=worst,
        corners=tuple(corners),
        collimated=worst_corner(far, 30.0, 5.0, tilts(far)),
        shifted=with_shifts(instrument, 30.0, 5.0, corners[middle]),
        floor_percent=percent,
        floor=floor,
        etalon_rise=np.sqrt(alone[-1] / alone[0]),
        required_tilt_deg=required_tilt_deg(blur, tilted, TILT_DEG),
        interpolation=interpolation_error(0.5),
        closest=closest_settings(instrument, lambda: report("closest settings to the paper"), tilts_deg),
    )


def collimated(instrument: Instrument) -> Instrument:
    """An instrument of the same divergence, its exit pupil at infinity, all lit; its mirrors hold the tilted beam."""
    distance = FAR_MM + 3.0 * instrument.mirror_distance_mm
    radius = instrument.pupil_radius_mm * distance / instrument.pupil_distance_mm
    return replace(
        instrument, pupil_radius_mm=radius, pupil_to_mirror_mm=FAR_MM, mirror_side_mm=60.0, lit_everywhere=True
    )  # no slit is as far away as this pupil
