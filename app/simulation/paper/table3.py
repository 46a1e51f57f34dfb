"""The paper's Table 3 beside ours: noise-free, with the sample tilted, and at the worst corner of the deviations."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.simulation.paper.explanation import (
    FORMS,
    RANGES,
    SIGMAS_DEG,
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
"""How often `table3` calls `step`."""
FAR_MM = 1e6
POINT_MM = 0.01
Step = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Table3:
    """Relative RMS in percent, (3, 4) each: sigma 0, 30, 60 by widths of 2, 5, 15, 30 deg; and what explains them.

    `sagittal` is with the sample tilted out of the plane, `point` with a spot as small as a point.
    `corners` has the worst corner of each cell, row by row. `collimated` is the worst corner at sigma 30, width 5 with the
    exit pupil at infinity, `shifted` that of this instrument with the shifts of 0.1 mm added. `needed_deg` is the tilt of
    the sample that supplies each of the paper's numbers, `floor` the noise-free table with counting noise of
    `floor_percent`, `etalon_rise` the factor (4,) by which the etalon's own counting noise rises from sigma 0 to 60.
    """

    instrument: Instrument
    noise_free: Floats
    tilted: Floats
    sagittal: Floats
    point: Floats
    worst: Floats
    corners: tuple[Corner, ...]
    collimated: Corner
    shifted: Corner
    floor_percent: float
    floor: Floats
    etalon_rise: Floats
    needed_deg: Floats
    half_way: Floats
    closest: ClosestSettings

    def corner(self, sigma_deg: float, width_deg: float) -> Corner:
        """The worst one of a cell."""
        return self.corners[SIGMAS_DEG.index(sigma_deg) * len(WIDTHS_DEG) + WIDTHS_DEG.index(width_deg)]


def table3(step: Step = lambda _: None, rays: int | None = None) -> Table3:
    """Everything, by the fast estimator and without obstruction; `step` is told what comes next, `STEPS` times.

    `rays` as `twin.optics.throughput` has it, for the noise-free table alone.
    """
    instrument = Instrument(obstruction=False)
    step("noise-free, tilted")
    blur, tilted = rms_table(instrument, rays=rays), rms_table(with_tilt(instrument, TILT_DEG))
    sagittal = rms_table(with_tilt(instrument, 0.0, TILT_DEG))
    corners = []
    for sigma in SIGMAS_DEG:
        for width in WIDTHS_DEG:
            step(f"worst corner at sigma {sigma:g}, width {width:g} deg")
            corners.append(worst_corner(instrument, sigma, width, tilts(instrument)))
    far = _collimated(instrument)
    variance, alone = counting_variance(instrument), counting_variance(instrument, etalon_alone=True)
    percent, floor = noise_floor(blur, variance)
    worst = np.array([corner.relative_rms_percent for corner in corners]).reshape(blur.shape)
    middle = SIGMAS_DEG.index(30.0) * len(WIDTHS_DEG) + WIDTHS_DEG.index(5.0)
    return Table3(
        instrument=instrument,
        noise_free=blur,
        tilted=tilted,
        sagittal=sagittal,
        point=rms_table(replace(instrument, spot_side_mm=POINT_MM)),
        worst=worst,
        corners=tuple(corners),
        collimated=worst_corner(far, 30.0, 5.0, tilts(far)),
        shifted=with_shifts(instrument, 30.0, 5.0, corners[middle]),
        floor_percent=percent,
        floor=floor,
        etalon_rise=np.sqrt(alone[-1] / alone[0]),
        needed_deg=required_tilt_deg(blur, tilted, TILT_DEG),
        half_way=interpolation_error(0.5),
        closest=closest_settings(instrument, lambda: step("what comes closest to the paper")),
    )


def _collimated(instrument: Instrument) -> Instrument:
    """The same divergence from an exit pupil at infinity, with mirrors that do not cut the tilted beam."""
    distance = FAR_MM + 3.0 * instrument.mirror_distance_mm
    radius = instrument.pupil_radius_mm * distance / instrument.pupil_distance_mm
    return Instrument(pupil_radius_mm=radius, pupil_to_mirror_mm=FAR_MM, mirror_side_mm=60.0, obstruction=False)
