"""Stray light as a map over directions, to be added to the fast estimator, which does not include it.

Stray light is defined in `Estimate`: light of the frames, and light that met a mirror, a frame or the sample again. It changes
slowly with direction, so one forward run gives it for detectors everywhere: see twin.optics.forward.spread for the method.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.scatterer import Scatterer
from goniotwin.twin.optics.fast.obstruction import visible_fraction
from goniotwin.twin.optics.forward.estimator import run_sums
from goniotwin.twin.optics.forward.setting import set_up
from goniotwin.twin.optics.forward.spread import (
    AZIMUTH_BINS,
    AZIMUTH_STEP_DEG,
    POLAR_BINS,
    POLAR_STEP_DEG,
    projected_solid_angles,
)
from goniotwin.twin.optics.geometry.instrument import Instrument, SampleFrames
from goniotwin.twin.optics.geometry.scene import scene_at
from goniotwin.twin.optics.illumination.rayset import RaySource
from goniotwin.twin.optics.montecarlo import check_seed

PATHS = 1 << 20


@dataclass(frozen=True, eq=False)
class StrayMap:
    """Stray throughput over the cosine of a detector's polar angle, in m^2 sr, as means over bins of the sample's frame.

    `values` and their standard errors `errors` are (2, 18, 36): the side of the light and the other one, polar angle in steps
    of 5 deg, azimuth in steps of 10 deg. `detector` has arc radius and diameter in mm and field in deg, for which the map
    holds. Light that returns over the mirrors towards the lamp is not included: it is as narrow as the beam, and no photodiode
    can stand there.
    """

    sigma_deg: float
    gamma_deg: float
    values: Floats
    errors: Floats
    paths: int
    detector: tuple[float, float, float]


def stray_map(
    instrument: Instrument,
    sigma_deg: float,
    scatterer: Scatterer | None,
    paths: int = PATHS,
    seed: int = 0,
    gamma_deg: float = 0.0,
    wavelength_nm: float | None = None,
    source: RaySource | None = None,
    max_interactions: int = 8,
    sample_frames: SampleFrames | None = None,
) -> StrayMap:
    """Stray light map of a sample at one position of mirror unit and sample unit; arguments as in `forward_throughput`.

    Half of the paths land on a frame first. Raises ValueError as `forward_throughput` does, and for a sensor that is not a
    simple detector, because the map holds for discs with acceptance cones: see `Instrument.simplified`.
    """
    instrument = instrument.simplified()
    check_seed(seed)
    if paths < 2:
        raise ValueError(f"paths is {paths}: give at least 2; a standard error needs two")
    setting = set_up(
        instrument,
        sigma_deg,
        np.zeros((0, 3)),
        scatterer,
        gamma_deg,
        wavelength_nm,
        source,
        max_interactions,
        sample_frames or SampleFrames(),
        spread=True,
    )
    sums, done = run_sums(setting, paths, seed)
    mean, square = sums[:, 2] / done, sums[:, 3] / done
    error = np.sqrt(np.maximum(square - mean**2, 0.0) / (done - 1))
    shape = (2, POLAR_BINS, AZIMUTH_BINS)
    scale = 1.0 / (setting.radiance * projected_solid_angles()[:, None])
    return StrayMap(
        sigma_deg, gamma_deg, mean.reshape(shape) * scale, error.reshape(shape) * scale, done, _detector(instrument)
    )


def stray_throughput(stray: StrayMap, directions: npt.ArrayLike, instrument: Instrument) -> Floats:
    """Stray throughput (n,) in m^2 sr of detectors in `directions` (n, 3), to be added to that of the fast estimator.

    Linear between the centres of the map's bins, times the share of the detector that no mirror hides. Raises ValueError for
    vectors without a direction, and for an instrument with other detectors than the map's.
    """
    instrument = instrument.simplified()
    if _detector(instrument) != stray.detector:
        raise ValueError(f"the map is for arc, disc and field {stray.detector}, the instrument has {_detector(instrument)}")
    _, axes = scene_at(instrument, stray.sigma_deg, stray.gamma_deg).detectors(instrument, directions)
    polar = np.degrees(np.arccos(np.clip(np.abs(axes[:, 2]), 0.0, 1.0))) / POLAR_STEP_DEG - 0.5
    azimuth = np.degrees(np.arctan2(axes[:, 1], axes[:, 0])) / AZIMUTH_STEP_DEG - 0.5
    polar = np.clip(polar, 0.0, POLAR_BINS - 1.0)
    low = np.minimum(np.floor(polar).astype(int), POLAR_BINS - 2)
    first = np.floor(azimuth).astype(int)
    side = (axes[:, 2] < 0.0).astype(int)
    result = np.zeros(axes.shape[0])
    for i, share in ((low, 1.0 - (polar - low)), (low + 1, polar - low)):
        for j, weight in ((first, 1.0 - (azimuth - first)), (first + 1, azimuth - first)):
            result += share * weight * stray.values[side, i, j % AZIMUTH_BINS]
    result *= np.abs(axes[:, 2])
    if instrument.obstruction:
        result *= visible_fraction(instrument, stray.sigma_deg, directions, gamma_deg=stray.gamma_deg)
    return result


def _detector(instrument: Instrument) -> tuple[float, float, float]:
    return instrument.arc_radius_mm, instrument.detector_diameter_mm, instrument.field_deg
