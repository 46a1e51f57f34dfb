"""The fast estimator: for a sample with a known BSDF, rays from the detectors back to the exit pupil.

Sample and etalon have the same rays, and so have all wavelengths: rays that frame and mirrors block cancel in their ratio
(paper, formula 1).
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.scatterer import Scatterer
from goniotwin.twin.optics.fast.scenes import Pose, Scenes
from goniotwin.twin.optics.geometry.instrument import Instrument


def throughput(
    instrument: Instrument,
    sigma_deg: float,
    directions: npt.ArrayLike,
    scatterer: Scatterer,
    rays: int | None = None,
    gamma_deg: float = 0.0,
    wavelength_nm: float | None = None,
) -> Floats:
    """Throughput (n,) in m^2 sr of detectors in `directions` (n, 3): their flux over the radiance of the exit pupil.

    Includes the mirrors' reflectance, all cosines, the hole of the frame on the sample, the detectors' discs and acceptance
    cones, every deviation, and, with the instrument's `obstruction`, the directions hidden by the mirrors. Detectors below the
    sample's plane receive transmitted light. `gamma_deg` turns the sample unit. Light and detectors at `sigma_deg` beyond 90
    deg are on the sample's back.

    Seven rays per detector, placed by the moments of its accepted rays; 1024 where a mirror blocks some of them. With `rays` it
    is that number for every detector, from its disc within its cone to the hole and on to the pupil, always the same: slower,
    and the check of the seven. Detectors are independent of each other, so results are bit-identical for any number of threads.
    Raises ValueError for a wrong shape, a vector of length zero, a number of rays that is not a multiple of 4, or a sensor that
    is not a simple detector, a disc with an acceptance cone: the forward estimator alone traces such a sensor.
    """
    pose = Pose(sigma_deg, directions, gamma_deg)
    found: Floats = Scenes(instrument, [pose], [scatterer], wavelength_nm, rays).throughputs()[0, 0, 0]
    return found


def spectral_throughput(
    instrument: Instrument,
    sigma_deg: float,
    directions: npt.ArrayLike,
    scatterer: Scatterer,
    wavelengths_nm: npt.ArrayLike,
    rays: int | None = None,
    gamma_deg: float = 0.0,
) -> Floats:
    """Throughput (w, n) in m^2 sr at wavelengths (w,), from one set of rays: there is no fluorescence (paper, 3.2)."""
    wavelengths = np.atleast_1d(np.asarray(wavelengths_nm, dtype=np.float64))
    return throughputs_of(instrument, Pose(sigma_deg, directions, gamma_deg), [scatterer], rays, wavelengths)[0]


def throughputs_of(
    instrument: Instrument,
    pose: Pose,
    scatterers: Sequence[Scatterer],
    rays: int | None = None,
    wavelengths_nm: Floats | None = None,
) -> list[Floats]:
    """Throughputs (w, n) of several samples from one set of rays; without wavelengths (1, n)."""
    return list(Scenes(instrument, [pose], scatterers, wavelengths_nm, rays).throughputs()[0])


def luminance_factor(
    instrument: Instrument,
    sigma_deg: float,
    directions: npt.ArrayLike,
    scatterer: Scatterer,
    rays: int | None = None,
    gamma_deg: float = 0.0,
    wavelength_nm: float | None = None,
) -> Floats:
    """Luminance factor (n,), as the instrument measures it against an ideal diffuser (paper, formula 1).

    The diffuser scatters equally to either side and from either side. NaN where it gives no signal: a direction that the
    mirrors hide has no value.
    """
    (factors,) = luminance_factors(instrument, [Pose(sigma_deg, directions, gamma_deg)], scatterer, rays, wavelength_nm)
    return factors


def luminance_factors(
    instrument: Instrument,
    poses: Sequence[Pose],
    scatterer: Scatterer,
    rays: int | None = None,
    wavelength_nm: float | None = None,
) -> list[Floats]:
    """`luminance_factor` of many poses at once, (n,) each: a whole BSDF in one call."""
    scenes = Scenes(instrument, poses, [scatterer], wavelength_nm, rays)
    factors = scenes.ratios()[0, 0, 0]
    return [factors[piece] for piece in scenes.pieces]
