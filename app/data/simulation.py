"""Simulation for scripts and notebooks: the arguments are checked, and the result is a dataset."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.values import SampleData, as_numbers, flag, quoted, with_names
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import ScatteredBsdf
from goniotwin.app.rig.samples import parse_sample
from goniotwin.app.simulation.files import assumptions
from goniotwin.app.simulation.simulate import WAVELENGTH_LIMITS_NM, SigmaResult, Simulation, Task
from goniotwin.app.simulation.simulate import simulate as simulate_task
from goniotwin.arrays import Floats
from goniotwin.twin.optics import to_specular
from goniotwin.twin.optics.geometry.coordinates import (
    mirror_in_plane_of_incidence,
    mirror_in_sample_plane,
    round_deg,
    wrap_azimuth,
)

SIGMA_LIMITS_DEG = (0.0, 90.0)


@with_names
def simulate(
    sample: str, sigma_deg: Sequence[float] = (0.0, 30.0, 60.0), *, wavelengths_nm: Sequence[float] | None = None,
    back: bool = False, transmitted: bool = False,
) -> Dataset:  # fmt: skip
    """Simulate the BSDF of a sample as the instrument measures it, by the fast estimator (paper, figure 7).

    `sample` is a model as in `goniotwin simulate --sample`; `sigma_deg` are angles of incidence in degrees, from 0 to less
    than 90, ascending; `wavelengths_nm` in nanometres, from 200 to 2500, ascending, or None for grey values. With `back` the
    light is on the back of the sample; with `transmitted` the detectors are on the other side of it than the light. The values
    are those of the virtual detectors, `u` their standard errors. Raises GoniotwinError for a model or a grid that cannot be
    simulated.
    """
    if not isinstance(sample, str):
        raise UserError(f"sample: {quoted(sample)} is not a text; give a model such as 'gaussian:width_deg=5'")
    sigmas = _ascending("sigma_deg", sigma_deg, *SIGMA_LIMITS_DEG)
    wavelengths = None if wavelengths_nm is None else _ascending("wavelengths_nm", wavelengths_nm, *WAVELENGTH_LIMITS_NM)
    if sigmas[-1] == SIGMA_LIMITS_DEG[1]:
        raise UserError(f"sigma_deg: {sigmas[-1]:g}: give angles below 90 deg")
    back, transmitted = bool(flag("back", back)), bool(flag("transmitted", transmitted))
    task = Task(parse_sample(sample), sigmas, wavelengths_nm=wavelengths, back=back, transmitted=transmitted)
    return dataset_of_simulation(simulate_task(task))


def dataset_of_simulation(simulation: Simulation) -> Dataset:
    """The values of all detectors of a simulation."""
    name = simulation.task.sample.name
    waves = [np.nan] if simulation.wavelengths_nm is None else simulation.wavelengths_nm.tolist()
    columns = [_columns(simulation.task, at, row, nm) for row, nm in enumerate(waves) for at in simulation.at]
    joined: dict[str, Any] = {each: np.concatenate([part[each] for part in columns]) for each in columns[0]}
    theta, phi = joined.pop("theta_deg"), joined.pop("phi_deg")
    mirrored = simulation.at[0].detectors.mirrored
    values = ScatteredBsdf(**joined, sample=name, isotropic=mirrored, generated=True)
    return Dataset(name, "simulation", {name: SampleData(values, theta, phi)}, notes=tuple(assumptions(simulation)))


def _columns(task: Task, at: SigmaResult, row: int, wavelength_nm: float) -> dict[str, Floats]:
    """The columns of one sigma and one wavelength, in the frame of the sample with its lit side in front."""
    directions = mirror_in_plane_of_incidence(at.directions) if task.back else at.directions
    theta, phi = to_specular(at.sigma_deg, mirror_in_sample_plane(directions) if task.lower else directions)
    count = at.obstructed.size
    azimuth = np.tile(at.detectors.azimuth_deg, at.detectors.polar_deg.size)
    return {
        "sigma_deg": np.full(count, at.sigma_deg),
        "psi_deg": np.zeros(count),
        "polar_deg": round_deg(np.repeat(at.detectors.polar_deg, at.detectors.azimuth_deg.size)),
        "azimuth_deg": round_deg(wrap_azimuth(-azimuth if task.back else azimuth)),
        "theta_deg": round_deg(theta),
        "phi_deg": round_deg(phi),
        "values": at.ratio.factor[row] / np.pi,
        "u": np.where(np.isfinite(at.ratio.standard_error[row]), at.ratio.standard_error[row], np.nan) / np.pi,
        "wavelength_nm": np.full(count, wavelength_nm),
        "transmitted": np.full(count, task.transmitted),
        "back": np.full(count, task.back),
        "flags": np.where(at.obstructed, "hidden", np.where(at.missed, "no-hits", "")),
    }


def _ascending(name: str, values: Sequence[float], lowest: float, highest: float) -> Floats:
    """An argument as an array. Raises UserError for anything but ascending numbers within the limits."""
    array = as_numbers(values)
    if array is None or array.ndim != 1 or not array.size or array.min() < lowest or array.max() > highest:
        array = None
    if array is None or (np.diff(array) <= 0.0).any():
        raise UserError(f"{name}: {quoted(values)}: give a list of numbers from {lowest:g} to {highest:g}, ascending")
    return array
