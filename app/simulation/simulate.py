"""Simulation of a BSDF measurement (paper, figure 7): etalon and sample at each sigma, their ratio, the output grid.

The regular component of a sample (a mirror, a clear sheet) has no finite BSDF, so a table cannot represent it by itself: its
luminance factor is that of the pupil's image, and depends on beam, aperture and field. A table contains what its own detectors
see of it, or the component is taken apart: its share of the light at each incidence.

What an anisotropic sample scatters depends on psi, the azimuth of the light in its own frame. There is a table for each psi,
with the sample unit turned by gamma, as in a campaign.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.app.formats import registry
from goniotwin.app.formats.content import RegularTable, psi_of_gamma
from goniotwin.app.formats.registry import Holds
from goniotwin.app.formats.specular_grid import SpecularCut, resample
from goniotwin.app.simulation.detectors import HIGHEST_POLAR_DEG, Detectors, detector_grid, output_phi, output_theta
from goniotwin.app.simulation.estimate import (
    EstimatorSettings,
    MeasurementSetup,
    Ratio,
    ReportFraction,
    TraceBatch,
    estimate_ratio,
    trace_batch,
)
from goniotwin.app.simulation.source import Source
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Instrument, Lobe, SampleFrames, Scatterer, arc_direction, visible_fraction
from goniotwin.twin.optics.bsdf.kinds import ANISOTROPIC, GAUSSIAN, REGULAR
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, TURN_DEG, opposite_sigma_deg, round_deg
from goniotwin.twin.optics.geometry.deviation import NO_DEVIATION

WAVELENGTH_LIMITS_NM = (200.0, 2500.0)
"""Wavelengths of a simulation."""
UNOBSTRUCTED = 1.0 - 1e-9
PSI_STEP_DEG = 15.0
"""Default step of psi for a formula; a table has its own psi."""
ReportProgress = Callable[[float, str], None]
"""Receives the finished fraction of the work, 0 to 1, and the name of the present step."""


@dataclass(frozen=True, eq=False)
class Task:
    """The definition of a simulation.

    `sigma_deg` (s,), 0 to less than 90, ascending, are incidences on the lit side: the front, or with `back` the back, with
    the mirror unit at 180 deg - sigma. With `transmitted` the detectors are on the other side. `wavelengths_nm` is (w,), or
    None for a grey table (a sample with a spectrum then has its own list). `polar_deg` and `azimuth_deg` are the grid of the
    detectors, both or neither; the default is fine near the specular direction of each sigma. `theta_deg` and `phi_deg` are
    the output grid. Where sample and rig are symmetric about the plane of incidence, azimuths and phi are 0 to 180. With
    `stray` the light of the `frames`, and light that was scattered more than once, counts. A `source` replaces the uniform exit
    pupil. `psi_deg` (p,), 0 to less than 360, ascending, are azimuths of the light in the frame of an anisotropic sample; by
    default those of its tables, and steps of 15 deg for formulas. The `regular` component is in the values as "seen" by the
    detectors, or "apart" from them; "alone" there are no others.
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
    psi_deg: Floats | None = None
    regular: Literal["seen", "apart", "alone"] = "seen"

    @property
    def lower(self) -> bool:
        """Whether the detectors are on the lower arc."""
        return self.back != self.transmitted

    @property
    def acting_lobes(self) -> list[Lobe]:
        """Lobes of the sample from the lit side to the side of the detectors."""
        incident = -1 if self.back else 1
        return [lobe for lobe in self.sample.lobes if lobe.incident == incident and lobe.transmits == self.transmitted]

    @property
    def has_regular(self) -> bool:
        """Whether the sample has a regular component from the lit side to the side of the detectors."""
        return any(lobe.kind == REGULAR for lobe in self.acting_lobes)

    @property
    def has_scattered(self) -> bool:
        """Whether it has anything else there."""
        return any(lobe.kind != REGULAR for lobe in self.acting_lobes)

    @property
    def scatters(self) -> bool:
        """Whether there are values at detectors: not of a regular component alone."""
        return self.regular == "seen" or (self.regular == "apart" and self.has_scattered)

    @property
    def counted_lobes(self) -> list[Lobe]:
        """The lobes that the values depend on: light that is scattered more than once may meet all of them."""
        return list(self.sample.lobes) if self.stray else self.acting_lobes

    @property
    def period_deg(self) -> float:
        """Turn of the sample after which it is the same, deg; 0 for an isotropic one."""
        return max((lobe.period_deg for lobe in self.counted_lobes), default=0.0)

    @property
    def tabulated_wavelengths_nm(self) -> Floats | None:
        """The wavelengths (w,) of the values, None for grey ones."""
        if self.wavelengths_nm is not None or self.sample.spectrum is None:
            return self.wavelengths_nm
        return np.array(self.sample.spectrum.wavelengths_nm if self.source is None else [self.source.wavelength_nm])

    @property
    def psis_deg(self) -> Floats:
        """The azimuths of the light that are simulated; 0 alone for an isotropic sample."""
        if self.period_deg == 0.0:
            return np.zeros(1)
        if self.psi_deg is not None:
            return self.psi_deg
        found = []
        for lobe in self.counted_lobes:
            own = np.arange(0.0, TURN_DEG, PSI_STEP_DEG)
            if lobe.kind == ANISOTROPIC:
                own = np.concatenate([lobe.psi_deg, -lobe.psi_deg]) if lobe.params[1] else lobe.psi_deg
                own = np.concatenate([own, own + lobe.period_deg])
            found.append(own if lobe.period_deg else np.zeros(0))
        # On a back that is lit, psi is counted in the frame of the turned sample, as the lobe's own is.
        return np.unique(np.mod(round_deg(np.concatenate(found)), TURN_DEG))

    def refracted_axes(self, sigma_deg: float) -> list[float | None]:
        """Polar angles, deg, of the axes of refracted lobes; None in total reflection, where there is no lobe."""
        ratios = [float(lobe.params[4]) for lobe in self.acting_lobes if lobe.kind == GAUSSIAN and lobe.params[4] != 1.0]
        sines = [math.sin(math.radians(sigma_deg)) / ratio for ratio in ratios]
        return [math.degrees(math.asin(sine)) if sine < 1.0 else None for sine in sines]


@dataclass(frozen=True)
class RegularPeak:
    """The regular component at one sigma.

    The `fractions` of the light, one for each wavelength, leave in the direction `polar_deg`, `azimuth_deg` of the rig's frame;
    detectors within `half_angle_deg` of it see a part of it. `largest_factor` is the largest luminance factor of a detector,
    None where the mirror unit blocks all of them, or none is near enough.
    """

    sigma_deg: float
    fractions: tuple[float, ...]
    polar_deg: float
    azimuth_deg: float
    half_angle_deg: float
    largest_factor: float | None

    def as_dict(self) -> dict[str, Any]:
        """The peak for JSON."""
        return {
            "sigma": self.sigma_deg,
            "share": self.fractions[0] if len(self.fractions) == 1 else list(self.fractions),
            "theta": 0.0,
            "polar_deg": self.polar_deg,
            "azimuth_deg": self.azimuth_deg,
            "seen_within_deg": self.half_angle_deg,
            "largest_luminance_factor": self.largest_factor,
            "hidden": self.largest_factor is None,
        }


@dataclass(frozen=True, eq=False)
class SigmaResult:
    """The result at one sigma and psi: n detectors, their ratios (w, n), and flags (n,) of those that the mirror unit blocks.

    A detector that is blocked in part is `obstructed`. `regular` is the regular component, if the sample has one.
    """

    sigma_deg: float
    detectors: Detectors
    directions: Floats
    ratio: Ratio
    obstructed: Flags
    regular: RegularPeak | None = None
    psi_deg: float = 0.0

    @property
    def missed(self) -> Flags:
        """Flags (n,) of detectors without any path of sample or etalon; only the forward estimator has such detectors.

        Without a path of the etalon there is no value, without a path of the sample the value is 0.
        """
        unknown: Flags = ~np.isfinite(self.ratio.standard_error[0]) & ~self.obstructed
        return unknown


@dataclass(frozen=True, eq=False)
class Simulation:
    """Luminance factors on the output grid, with their standard errors.

    `at` are the results by sigma and psi (the faster); `cuts` are by wavelength and psi (the faster), then by sigma. There are
    none of a regular component alone. `regular` is that component, where it is taken apart.
    """

    task: Task
    wavelengths_nm: Floats | None
    at: tuple[SigmaResult, ...]
    phi_deg: Floats
    theta_deg: Floats
    cuts: tuple[tuple[SpecularCut, ...], ...]
    regular: RegularTable | None = None

    @cached_property
    def table(self) -> Floats:
        """The luminance factors (w psi, s, phi, theta)."""
        return np.array([[cut.values for cut in each] for each in self.cuts])

    @cached_property
    def known(self) -> Flags:
        """The nodes (w psi, s, phi, theta) that are interpolated between detectors."""
        return np.array([[cut.known for cut in each] for each in self.cuts])


def simulate(task: Task, report: ReportProgress = lambda _fraction, _step: None, trace: TraceBatch = trace_batch) -> Simulation:
    """Simulate all sigmas of a task. Raises UserError for a task that is not possible.

    `trace` gives the batches of the forward estimator, which may have been traced before.
    """
    check_task(task)
    wavelengths = task.tabulated_wavelengths_nm
    mirrored = _is_mirrored(task)
    phi, theta = output_phi(task.phi_deg, mirrored), output_theta(task.theta_deg)
    regular = _regular_table(task, wavelengths) if task.regular != "seen" and task.has_regular else None
    if not task.scatters:
        report(1.0, "done")
        return Simulation(task, wavelengths, (), phi, theta, (), regular)
    psis = task.psis_deg.tolist()
    count = task.sigma_deg.size * len(psis)
    at: list[SigmaResult] = []
    cuts: list[list[SpecularCut]] = []
    for sigma in task.sigma_deg.tolist():
        of_sigma: dict[float, tuple[SigmaResult, list[SpecularCut]]] = {}
        for psi in psis:
            name = f"sigma {sigma:g}" + (f", psi {psi:g} deg" if len(psis) > 1 else " deg")

            def report_part(fraction: float, done: int = len(at) + len(of_sigma), name: str = name) -> None:
                report((done + fraction) / count, name)

            report_part(0.0)
            before = _same_psi(task, psi)
            same = None if before is None else of_sigma.get(before)
            if same is None:
                result = _simulate_sigma(task, sigma, psi, trace, report_part)
                grids = map(result.detectors.grid, result.ratio.factor, result.ratio.standard_error)
                same = result, [resample(grid, sigma, phi, theta, back=task.back) for grid in grids]
            of_sigma[float(round_deg(np.array(psi)))] = replace(same[0], psi_deg=psi), same[1]
        at += [result for result, _ in of_sigma.values()]
        cuts.append([cut for row in zip(*(found for _, found in of_sigma.values()), strict=True) for cut in row])
    report(1.0, "done")
    return Simulation(task, wavelengths, tuple(at), phi, theta, tuple(zip(*cuts, strict=True)), regular)


def traced_setups(task: Task) -> Iterator[MeasurementSetup]:
    """The measurements of a task, sigma by sigma and psi by psi, without those that are the same as one before."""
    for sigma in task.sigma_deg.tolist():
        known: set[float] = set()
        for psi in task.psis_deg.tolist():
            if _same_psi(task, psi) not in known:
                yield _setup(task, sigma, psi)[1]
            known.add(float(round_deg(np.array(psi))))


def _same_psi(task: Task, psi: float) -> float | None:
    """The psi before it with the same result, deg; None where there is none.

    Half a turn changes neither the hole of the frame nor, without deviations, anything else of the instrument.
    """
    return None if task.instrument.deviations else float(round_deg(np.array(psi - task.period_deg)))


def _regular_table(task: Task, wavelengths: Floats | None) -> RegularTable:
    """The share of the light at each sigma that leaves regularly: the sample's own, without rays."""
    shares = [
        regular_fractions(task.sample, sigma, task.back, task.transmitted, wavelengths) for sigma in task.sigma_deg.tolist()
    ]
    return RegularTable(
        task.sigma_deg,
        np.array(shares).T[:, None],
        None if wavelengths is None else tuple(wavelengths.tolist()),
        transmitted=task.transmitted,
        back=task.back,
        sample=task.sample.name,
        generated=True,
    )


def _setup(task: Task, sigma: float, psi: float) -> tuple[Detectors, MeasurementSetup]:
    mirrored = _is_mirrored(task)
    if task.polar_deg is not None and task.azimuth_deg is not None:
        detectors = Detectors(task.polar_deg, task.azimuth_deg, mirrored)
    else:
        # There are no detectors near grazing.
        near_axes = [min(HIGHEST_POLAR_DEG, axis) for axis in task.refracted_axes(sigma) if axis is not None]
        detectors = detector_grid(sigma, mirrored, near_axes)
    directions, unit_deg = detectors.directions(task.lower), opposite_sigma_deg(sigma) if task.back else sigma
    setup = MeasurementSetup(
        task.instrument,
        unit_deg,
        directions,
        task.tabulated_wavelengths_nm,
        task.transmitted,
        task.stray,
        task.frames,
        None if task.source is None else task.source.rays,
        float(psi_of_gamma(psi, task.back)),
        regular=task.regular == "seen",
    )
    return detectors, setup


def _simulate_sigma(task: Task, sigma: float, psi: float, trace: TraceBatch, report: ReportFraction) -> SigmaResult:
    detectors, setup = _setup(task, sigma, psi)
    directions, unit_deg, wavelengths = setup.directions, setup.sigma_deg, setup.wavelengths_nm
    ratio = estimate_ratio(setup, task.sample, task.estimator, report, trace)
    obstructed = np.zeros(directions.shape[0], dtype=bool)
    if task.instrument.obstruction:
        # The visible part of a partly blocked detector is not centred on the detector's direction.
        obstructed = visible_fraction(task.instrument, unit_deg, directions) < UNOBSTRUCTED
        ratio = ratio.mask(obstructed)
    if not np.isfinite(ratio.factor).any():
        wrong = f"sigma {sigma:g}: no detector has a value: the mirror unit blocks all of them, or there are too few paths"
        raise UserError(f"{wrong}; give other detectors, or more --paths")
    fractions = regular_fractions(task.sample, sigma, task.back, task.transmitted, wavelengths)
    peak = None
    if fractions.any() and task.regular == "seen":
        peak = regular_peak(task.instrument, sigma, fractions, task.lower, directions, ratio.factor)
    return SigmaResult(sigma, detectors, directions, ratio, obstructed, peak, psi)


def regular_fractions(
    sample: Scatterer, sigma_deg: float, back: bool, transmitted: bool, wavelengths_nm: Floats | None
) -> Floats:
    """Fractions (w,) of the light at `sigma_deg` that leave regularly to the side of the detectors; 0 without such a lobe."""
    weights = sample.weights(None)[:, None] if wavelengths_nm is None else sample.weights(wavelengths_nm)
    found: Floats = np.zeros(weights.shape[1])
    for lobe, weight in zip(sample.lobes, weights, strict=True):
        if lobe.kind == REGULAR and lobe.transmits == transmitted and lobe.incident == (-1 if back else 1):
            found += weight * lobe.albedo(sigma_deg)
    return found


def regular_half_angle_deg(instrument: Instrument) -> float:
    """Largest angle from its direction at which a detector sees a part of the regular component, without deviations."""
    beam = instrument.pupil_radius_mm + math.sqrt(0.5) * instrument.spot_side_mm
    return math.degrees(math.atan(beam / instrument.pupil_distance_mm)) + 0.5 * instrument.field_deg


def regular_peak(
    instrument: Instrument, sigma_deg: float, fractions: Floats, lower: bool, directions: Floats, factor: Floats
) -> RegularPeak:
    """The regular component of detectors in `directions` (n, 3) with luminance factors (w, n), NaN where obstructed."""
    axis = arc_direction(sigma_deg, SPECULAR_AZIMUTH_DEG, lower)
    half_angle = regular_half_angle_deg(instrument)
    seen = factor[:, directions @ axis >= math.cos(math.radians(half_angle))]
    largest = float(np.nanmax(seen)) if np.isfinite(seen).any() else None
    return RegularPeak(sigma_deg, tuple(fractions.tolist()), sigma_deg, SPECULAR_AZIMUTH_DEG, half_angle, largest)


def check_task(task: Task) -> None:
    """Raise UserError for a task that is not possible."""
    if task.psi_deg is not None:
        if task.period_deg == 0.0:
            raise UserError("--psi: this sample is isotropic; leave it out")
        if not (task.psi_deg[0] >= 0.0 and task.psi_deg[-1] < TURN_DEG):
            raise UserError(f"--psi: {task.psi_deg[-1]:g} is out of range; give 0 to less than 360")
    if (task.polar_deg is None) != (task.azimuth_deg is None):
        raise UserError("--polar and --azimuth: give both, or neither")
    if task.polar_deg is not None and task.azimuth_deg is not None:
        if min(task.polar_deg.size, task.azimuth_deg.size) < 2:
            raise UserError("--polar and --azimuth: the values are interpolated; give at least two angles each")
        last = 180.0 if _is_mirrored(task) else 360.0
        if task.azimuth_deg[-1] > last:
            raise UserError(f"--azimuth: sample and rig are symmetric about the plane of incidence; give 0 to {last:g}")
    if task.source is not None and task.estimator.kind == "fast":
        raise UserError("--source: the fast estimator has only the uniform exit pupil; give --estimator forward")
    if not task.acting_lobes:
        act, other = ("transmits", Holds.REFLECTED) if task.transmitted else ("reflects", Holds.TRANSMITTED)
        side, opposite = ("back", "front") if task.back else ("front", "back")
        wrong = f"--sample {task.sample.name!r}: {act} no light from its {side}"
        if any(lobe.incident == (-1 if task.back else 1) for lobe in task.sample.lobes):
            raise UserError(f"{wrong}; write a {registry.writers(Holds.GRID, other)[0].suffixes[0]} file instead")
        raise UserError(f"{wrong}; give its models side={side} or side=both, or light its {opposite} with --side {opposite}")
    if task.regular == "apart" and task.stray and task.estimator.kind == "forward":
        raise UserError("--stray: the forward estimator cannot take the regular component apart; give --estimator fast")


def _is_mirrored(task: Task) -> bool:
    """Whether sample and rig are symmetric about the plane of incidence, so that half of the azimuths are computed.

    A rig with any deviation counts as one that is not.
    """
    return not _is_off(task.instrument) and all(lobe.mirrored for lobe in task.counted_lobes)


def _is_off(instrument: Instrument) -> bool:
    """Whether any element of an instrument is off its place."""
    return any(each != NO_DEVIATION for of in (instrument.deviations, instrument.illumination) for each in of.values())
