"""The scheme of the paper's figure 7: etalon and sample at every sigma, their ratio, and the ratio on the output grid."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from app.errors import UserError
from app.simulation.estimate import Effort, Ratio, ratio_at
from app.simulation.grid import Detectors, detectors_at, output_phi, output_theta
from app.simulation.regridded import regridded
from twin.optics import Instrument, Scatterer, visible_fraction

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Progress = Callable[[float, str], None]
"""Told the share of the work that is done, and what is done now."""
WHOLE = 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class Task:
    """What is to be simulated.

    `sigma_deg` (s,), 0 to less than 90, ascending; light comes from the front. `wavelengths_nm` (w,), or None for a grey
    table (a sample with a spectrum then has its own list). `transmitted` looks at the other side. `polar_deg` and
    `azimuth_deg` are the detectors' grid, together or neither; without them it is fine near the specular direction of each
    sigma. `theta_deg` and `phi_deg` are the output grid.
    """

    sample: Scatterer
    sigma_deg: Floats
    instrument: Instrument = field(default_factory=Instrument)
    effort: Effort = field(default_factory=Effort)
    wavelengths_nm: Floats | None = None
    transmitted: bool = False
    polar_deg: Floats | None = None
    azimuth_deg: Floats | None = None
    theta_deg: Floats | None = None
    phi_deg: Floats | None = None


@dataclass(frozen=True, eq=False)
class AtSigma:
    """At one sigma: detectors (n), their ratios (w, n), and which of them (n,) mirrors hide in part or altogether.

    `unmet` (n,) are those that are not hidden and that no path has met, of the sample or of the etalon.
    """

    sigma_deg: float
    detectors: Detectors
    directions: Floats
    ratio: Ratio
    hidden: Flags

    @property
    def unmet(self) -> Flags:
        """Of the forward estimator only; where the etalon was not met there is no value, else the value is 0."""
        unknown: Flags = ~np.isfinite(self.ratio.standard_error[0]) & ~self.hidden
        return unknown


@dataclass(frozen=True, eq=False)
class Simulation:
    """Luminance factors `table` (w, s, phi, theta) on the output grid; `known` where they rest on detectors all around."""

    task: Task
    wavelengths_nm: Floats | None
    at: tuple[AtSigma, ...]
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
        wavelengths = np.array(task.sample.spectrum.wavelengths_nm)
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
        tables.append([regridded(found.detectors, row, sigma, phi, theta) for row in found.ratio.factor])
    progress(1.0, "done")
    table = np.array([[values for values, _ in each] for each in tables]).swapaxes(0, 1)
    known = np.array([[flags for _, flags in each] for each in tables]).swapaxes(0, 1)
    return Simulation(task, wavelengths, tuple(at), phi, theta, table, known)


def _at_sigma(task: Task, sigma: float, wavelengths: Floats | None, mirrored: bool, told: Callable[[float], None]) -> AtSigma:
    if task.polar_deg is not None and task.azimuth_deg is not None:
        detectors = Detectors(task.polar_deg, task.azimuth_deg, mirrored)
    else:
        detectors = detectors_at(sigma, mirrored)
    directions = detectors.directions(task.transmitted)
    ratio = ratio_at(task.instrument, sigma, directions, task.sample, wavelengths, task.transmitted, task.effort, told)
    hidden = np.zeros(directions.shape[0], dtype=bool)
    if task.instrument.obstruction:
        # A detector of which a sliver is left looks elsewhere than it stands for.
        hidden = visible_fraction(task.instrument, sigma, directions) < WHOLE
        ratio = ratio.without(hidden)
    if not np.isfinite(ratio.factor).any():
        raise UserError(f"sigma {sigma:g}: no detector has a value: all are hidden, or more paths are needed (--paths)")
    return AtSigma(sigma, detectors, directions, ratio, hidden)


def _check(task: Task) -> None:
    if (task.polar_deg is None) != (task.azimuth_deg is None):
        raise UserError("--polar and --azimuth: give both, or neither")
    if task.polar_deg is not None and task.azimuth_deg is not None:
        if min(task.polar_deg.size, task.azimuth_deg.size) < 2:
            raise UserError("--polar and --azimuth: give at least two angles each, to interpolate between")
        whole = 180.0 if _is_mirrored(task.sample) else 360.0
        if task.azimuth_deg[-1] > whole:
            raise UserError(f"--azimuth: this sample is its own mirror image in the plane of incidence; give 0 to {whole:g}")
    if not any(lobe.incident == 1 and lobe.transmits == task.transmitted for lobe in task.sample.lobes):
        way, other = ("transmits", ".ddr") if task.transmitted else ("reflects", ".ddt")
        raise UserError(f"--sample {task.sample.name!r}: {way} nothing; write a {other} file for its other way")


def _is_mirrored(sample: Scatterer) -> bool:
    """Whether the sample has its mirror image in the plane of incidence."""
    return all(lobe.psi_deg.size <= 1 and lobe.phi_deg[-1] <= 180.0 for lobe in sample.lobes)


def assumptions(found: Simulation) -> list[str]:
    """What a reader has to know about the numbers, in words."""
    task, instrument = found.task, found.task.instrument
    hidden = "off: no direction is hidden, as if the mirrors let light pass"
    if instrument.obstruction:
        hidden = "on: directions of which the mirrors hide any part have no value"
    way = "transmitted" if task.transmitted else "reflected"
    grid = "as given" if task.polar_deg is not None else "steps of 0.5 deg near the specular direction to 5 deg"
    estimator = "fast: sample, etalon and all wavelengths with the same rays; errors are differences to another set of rays"
    if task.effort.kind == "forward":
        estimator = "forward Monte Carlo: sample and etalon with paths of their own; errors are standard errors of the paths"
    return [
        f"quantity: luminance factor of {way} light (pi times the BSDF), against an ideal diffuser",
        f"spot: {instrument.spot_side_mm:g} x {instrument.spot_side_mm:g} mm on the sample, set by its frame",
        f"divergence: {instrument.divergence_deg:.3f} deg full width",
        f"field: {instrument.field_deg:g} deg full width, discs of {instrument.detector_diameter_mm:g} mm at "
        f"{instrument.arc_radius_mm:g} mm",
        f"detectors: virtual ones over azimuth and polar angle, {grid}; a monotone cubic between them",
        f"deviations: {'none' if not instrument.deviations else ', '.join(instrument.deviations)}",
        f"obstruction: {hidden}",
        f"estimator: {estimator}",
        "noise: none but the estimator's; fluorescence: none",
    ]
