"""The scheme of the paper's figure 7: etalon and sample at every sigma, their ratio, and the ratio on the output grid.

The regular component of a sample: where it goes, and what detectors make of it.

It has no BSDF that is finite, so no table can have it as it is: its luminance factor is that of the pupil's image, and
depends on beam, aperture and field. What a file has of it is what its own detectors see.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.detectors import HIGHEST_POLAR_DEG, Detectors, detector_grid, output_phi, output_theta
from goniotwin.app.simulation.estimate import EstimatorSettings, MeasurementSetup, Ratio, estimate_ratio
from goniotwin.app.simulation.source import Source
from goniotwin.app.simulation.specular_grid import interpolate_to_specular
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Instrument, Lobe, SampleFrames, Scatterer, arc_direction, visible_fraction
from goniotwin.twin.optics.bsdf.models import GAUSSIAN, REGULAR


@dataclass(frozen=True)
class RegularPeak:
    """At one sigma: the share of the light that goes on regularly, in a direction of the rig's frame, and within which angle
    of it detectors see any; the largest luminance factor that one sees, None where the mirrors hide all of them.
    """

    sigma_deg: float
    share: float
    polar_deg: float
    azimuth_deg: float
    within_deg: float
    largest_factor: float | None

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        return {
            "sigma": self.sigma_deg,
            "share": self.share,
            "theta": 0.0,
            "polar_deg": self.polar_deg,
            "azimuth_deg": self.azimuth_deg,
            "seen_within_deg": self.within_deg,
            "largest_luminance_factor": self.largest_factor,
            "hidden": self.largest_factor is None,
        }


def regular_fraction(sample: Scatterer, sigma_deg: float, back: bool, transmitted: bool) -> float:
    """Of the light at incidence `sigma_deg`, what goes on regularly to the side that is looked at; 0 without such a lobe."""
    lobes = [lobe for lobe in sample.lobes if lobe.kind == REGULAR and lobe.transmits == transmitted]
    return sum(lobe.albedo(sigma_deg) for lobe in lobes if lobe.incident == (-1 if back else 1))


def regular_half_angle_deg(instrument: Instrument) -> float:
    """The angle from its direction beyond which no detector sees the regular component, without deviations."""
    beam = instrument.pupil_radius_mm + math.sqrt(0.5) * instrument.spot_side_mm
    return math.degrees(math.atan(beam / instrument.pupil_distance_mm)) + 0.5 * instrument.field_deg


def regular_peak(
    instrument: Instrument, sigma_deg: float, share: float, lower: bool, directions: Floats, factor: Floats
) -> RegularPeak:
    """Of a share above 0, for detectors in `directions` (n, 3) with luminance factors (w, n), NaN where hidden."""
    axis = arc_direction(sigma_deg, 180.0, lower)
    within = regular_half_angle_deg(instrument)
    seen = factor[:, directions @ axis >= math.cos(math.radians(within))]
    largest = float(np.nanmax(seen)) if np.isfinite(seen).any() else None
    return RegularPeak(sigma_deg, share, sigma_deg, 180.0, within, largest)


Progress = Callable[[float, str], None]
"""Told the share of the work that is done, and what is done now."""
WHOLE = 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class Task:
    """What is to be simulated.

    `sigma_deg` (s,), 0 to less than 90, ascending, are incidences on the side that is lit: the front, or with `back` the
    back, with the mirror unit at 180 deg - sigma. `transmitted` looks at the other side. `wavelengths_nm` (w,), or None for
    a grey table (a sample with a spectrum then has its own list). `polar_deg` and `azimuth_deg` are the detectors' grid,
    together or neither; without them it is fine near the specular direction of each sigma. `theta_deg` and `phi_deg` are the
    output grid. With `stray` the light of the `frames`, and what met anything else on its way, is in it. A `source` takes the
    uniform exit pupil's place.
    """

    sample: Scatterer
    sigma_deg: Floats
    instrument: Instrument = field(default_factory=Instrument)
    estimator: EstimatorSettings = field(default_factory=EstimatorSettings)
    wavelengths_nm: Floats | None = None
    back: bool = False
    transmitted: bool = False
    stray: bool = False
    frames: SampleFrames = field(default_factory=SampleFrames)
    source: Source | None = None
    polar_deg: Floats | None = None
    azimuth_deg: Floats | None = None
    theta_deg: Floats | None = None
    phi_deg: Floats | None = None

    @property
    def lower(self) -> bool:
        """Whether the light that is looked at leaves to the lower arc."""
        return self.back != self.transmitted


@dataclass(frozen=True, eq=False)
class SigmaResult:
    """At one sigma: detectors (n), their ratios (w, n), and which of them (n,) mirrors hide in part or altogether.

    `missed` (n,) are those that are not hidden and that no path has met, of the sample or of the etalon. `regular` is where
    the regular component is, if the sample has one.
    """

    sigma_deg: float
    detectors: Detectors
    directions: Floats
    ratio: Ratio
    obstructed: Flags
    regular: RegularPeak | None = None

    @property
    def missed(self) -> Flags:
        """Of the forward estimator only; where the etalon was not met there is no value, else the value is 0."""
        unknown: Flags = ~np.isfinite(self.ratio.standard_error[0]) & ~self.obstructed
        return unknown


@dataclass(frozen=True, eq=False)
class Simulation:
    """Luminance factors `table` (w, s, phi, theta) on the output grid; `known` where they rest on detectors all around."""

    task: Task
    wavelengths_nm: Floats | None
    at: tuple[SigmaResult, ...]
    phi_deg: Floats
    theta_deg: Floats
    table: Floats
    known: Flags

    @property
    def mirrored(self) -> bool:
        """Whether the table is of one side of the plane of incidence."""
        return bool(self.phi_deg[-1] == 180.0)


def simulate(task: Task, progress: Progress = lambda _share, _text: None) -> Simulation:
    """All of it. Raises UserError for what cannot be simulated."""
    _check(task)
    wavelengths = task.wavelengths_nm
    if wavelengths is None and task.sample.spectrum is not None:
        own = task.sample.spectrum.wavelengths_nm if task.source is None else [task.source.wavelength_nm]
        wavelengths = np.array(own)
    mirrored = _is_mirrored(task.sample)
    phi, theta = output_phi(task.phi_deg, mirrored), output_theta(task.theta_deg)
    count = task.sigma_deg.size
    at, tables = [], []
    for k, sigma in enumerate(task.sigma_deg.tolist()):

        def told(share: float, k: int = k, sigma: float = sigma) -> None:
            progress((k + share) / count, f"sigma {sigma:g} deg")

        told(0.0)
        found = _at_sigma(task, sigma, wavelengths, mirrored, told)
        at.append(found)
        tables.append(
            [interpolate_to_specular(found.detectors, row, sigma, phi, theta, task.back) for row in found.ratio.factor]
        )
    progress(1.0, "done")
    table = np.array([[values for values, _ in each] for each in tables]).swapaxes(0, 1)
    known = np.array([[flags for _, flags in each] for each in tables]).swapaxes(0, 1)
    return Simulation(task, wavelengths, tuple(at), phi, theta, table, known)


def _at_sigma(
    task: Task, sigma: float, wavelengths: Floats | None, mirrored: bool, told: Callable[[float], None]
) -> SigmaResult:
    if task.polar_deg is not None and task.azimuth_deg is not None:
        detectors = Detectors(task.polar_deg, task.azimuth_deg, mirrored)
    else:
        # Near grazing detectors end.
        near_axes = [min(HIGHEST_POLAR_DEG, axis) for axis in refracted_axes(task, sigma) if axis is not None]
        detectors = detector_grid(sigma, mirrored, near_axes)
    directions, unit_deg = detectors.directions(task.lower), 180.0 - sigma if task.back else sigma
    stand = MeasurementSetup(
        task.instrument, unit_deg, directions, wavelengths, task.transmitted, task.stray, task.frames,
        None if task.source is None else task.source.rays,
    )  # fmt: skip
    ratio = estimate_ratio(stand, task.sample, task.estimator, told)
    hidden = np.zeros(directions.shape[0], dtype=bool)
    if task.instrument.obstruction:
        # A detector of which a sliver is left looks elsewhere than it stands for.
        hidden = visible_fraction(task.instrument, unit_deg, directions) < WHOLE
        ratio = ratio.without(hidden)
    if not np.isfinite(ratio.factor).any():
        raise UserError(f"sigma {sigma:g}: no detector has a value: all are hidden, or more paths are needed (--paths)")
    share = regular_fraction(task.sample, sigma, task.back, task.transmitted)
    peak = regular_peak(task.instrument, sigma, share, task.lower, directions, ratio.factor) if share > 0.0 else None
    return SigmaResult(sigma, detectors, directions, ratio, hidden, peak)


def refracted_axes(task: Task, sigma_deg: float) -> list[float | None]:
    """Polar angles, deg, of the axes of refracted lobes; None beyond total reflection, where there is no lobe."""
    ratios = [float(lobe.params[4]) for lobe in acting_lobes(task) if lobe.kind == GAUSSIAN and lobe.params[4] != 1.0]
    sines = [math.sin(math.radians(sigma_deg)) / ratio for ratio in ratios]
    return [math.degrees(math.asin(sine)) if sine < 1.0 else None for sine in sines]


def acting_lobes(task: Task) -> list[Lobe]:
    """Lobes of the side that is lit to the side that is looked at."""
    incident = -1 if task.back else 1
    return [lobe for lobe in task.sample.lobes if lobe.incident == incident and lobe.transmits == task.transmitted]


def _check(task: Task) -> None:
    if (task.polar_deg is None) != (task.azimuth_deg is None):
        raise UserError("--polar and --azimuth: give both, or neither")
    if task.polar_deg is not None and task.azimuth_deg is not None:
        if min(task.polar_deg.size, task.azimuth_deg.size) < 2:
            raise UserError("--polar and --azimuth: give at least two angles each, to interpolate between")
        whole = 180.0 if _is_mirrored(task.sample) else 360.0
        if task.azimuth_deg[-1] > whole:
            raise UserError(f"--azimuth: this sample is its own mirror image in the plane of incidence; give 0 to {whole:g}")
    if task.source is not None and task.estimator.kind == "fast":
        raise UserError("--source: the fast estimator knows the uniform exit pupil alone; give --estimator forward")
    if not acting_lobes(task):
        way, other = ("transmits", ".ddr") if task.transmitted else ("reflects", ".ddt")
        side, turned = ("back", "front") if task.back else ("front", "back")
        wrong = f"--sample {task.sample.name!r}: {way} nothing of light on its {side}"
        if any(lobe.incident == (-1 if task.back else 1) for lobe in task.sample.lobes):
            raise UserError(f"{wrong}; write a {other} file for its other way")
        raise UserError(f"{wrong}; give its models side={side} or side=both, or light its {turned} with --side {turned}")


def _is_mirrored(sample: Scatterer) -> bool:
    """Whether the sample has its mirror image in the plane of incidence."""
    return all(lobe.psi_deg.size <= 1 and lobe.phi_deg[-1] <= 180.0 for lobe in sample.lobes)
