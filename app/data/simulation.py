"""Simulation for scripts and notebooks: the arguments are checked, and the result is a dataset."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.data.values import as_numbers, flag, quoted, with_names
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import BsdfFile, Part
from goniotwin.app.rig.samples import parse_sample
from goniotwin.app.simulation.files import assumptions, scattered
from goniotwin.app.simulation.simulate import WAVELENGTH_LIMITS_NM, Simulation, Task
from goniotwin.app.simulation.simulate import simulate as simulate_task
from goniotwin.arrays import Floats

SIGMA_LIMITS_DEG = (0.0, 90.0)


@with_names
def simulate(
    sample: str,
    sigma_deg: Sequence[float] = (0.0, 30.0, 60.0),
    *,
    wavelengths_nm: Sequence[float] | None = None,
    psi_deg: Sequence[float] | None = None,
    back: bool = False,
    transmitted: bool = False,
    regular_apart: bool = False,
) -> Dataset:
    """Simulate the BSDF of a sample as the instrument measures it, by the fast estimator (paper, figure 7).

    `sample` is a model as in `goniotwin simulate sample`. `sigma_deg` are angles of incidence in degrees, from 0 to less than
    90. `wavelengths_nm` are wavelengths from 200 to 2500 nm; without them the values are grey. `psi_deg` are azimuths of the
    light in the frame of an anisotropic sample, from 0 to less than 360. Without them they are those of its table, or every 15
    deg. All of these lists ascend.

    With `back` the light is on the back of the sample. With `transmitted` the detectors are on the other side of the sample.
    The values are those of the virtual detectors, and `u` are their standard errors. They include what the detectors see of a
    regular component (a mirror's). With `regular_apart` this component is a regular factor of its own. Raises GoniotwinError
    for a model or a grid that cannot be simulated.
    """
    if not isinstance(sample, str):
        raise UserError(f"sample: {quoted(sample)} is not a text; give a model such as 'gaussian:width_deg=5'")
    sigmas = _ascending("sigma_deg", sigma_deg, *SIGMA_LIMITS_DEG)
    wavelengths = None if wavelengths_nm is None else _ascending("wavelengths_nm", wavelengths_nm, *WAVELENGTH_LIMITS_NM)
    if sigmas[-1] == SIGMA_LIMITS_DEG[1]:
        raise UserError(f"sigma_deg: {sigmas[-1]:g}: give angles below 90 deg")
    psi = None if psi_deg is None else _ascending("psi_deg", psi_deg, 0.0, 360.0)
    back, transmitted = bool(flag("back", back)), bool(flag("transmitted", transmitted))
    task = Task(
        parse_sample(sample),
        sigmas,
        wavelengths_nm=wavelengths,
        back=back,
        transmitted=transmitted,
        psi_deg=psi,
        regular="apart" if flag("regular_apart", regular_apart) else "seen",
    )
    return dataset_of_simulation(simulate_task(task))


def dataset_of_simulation(simulation: Simulation) -> Dataset:
    """The values of all detectors of a simulation, and the regular component that is taken apart."""
    parts: list[Part] = [scattered(simulation)] if simulation.at else []
    parts += [] if simulation.regular is None else [simulation.regular]
    notes = tuple(assumptions(simulation))
    content = BsdfFile(tuple(replace(each, comments=notes) for each in parts))
    return dataset_of_file(content, simulation.task.sample.name, "simulation")


def _ascending(name: str, values: Sequence[float], lowest: float, highest: float) -> Floats:
    """An argument as an array. Raises UserError for anything but ascending numbers within the limits."""
    array = as_numbers(values)
    if array is None or array.ndim != 1 or not array.size or array.min() < lowest or array.max() > highest:
        array = None
    if array is None or (np.diff(array) <= 0.0).any():
        raise UserError(f"{name}: {quoted(values)}: give a list of numbers from {lowest:g} to {highest:g}, ascending")
    return array
