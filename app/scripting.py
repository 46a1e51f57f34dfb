"""The public API: journals and simulations for scripts and notebooks. `import goniotwin` offers these names."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.reduction import BsdfDataset
from goniotwin.app.campaign.reduction.reduction import reduce_journal as reduce_open_journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig.samples import parse_sample
from goniotwin.app.simulation.simulate import WAVELENGTH_LIMITS_NM, Simulation, Task
from goniotwin.app.simulation.simulate import simulate as simulate_task
from goniotwin.arrays import Floats

SIGMA_LIMITS_DEG = (0.0, 90.0)


def open_journal(path: str | Path) -> Journal:
    """Open a campaign's data file (journal) for reading; close it, or use it in a `with` statement.

    Raises UserError for a file that is not a journal, or is damaged.
    """
    if not isinstance(path, str | Path):
        raise UserError(f"journal: {path!r} is not a path; give the name of a journal")
    return Journal.open(Path(path))


def reduce_journal(journal: Journal | str | Path, *, without_damaged: bool = False) -> BsdfDataset:
    """Reduce a journal to the BSDF of each sample (1/sr), its standard uncertainty (1/sr), flags and directions (deg).

    Takes an open journal or a path. Raises UserError for a file that is not a journal, or has no readings of the etalon; and
    for a damaged one, unless `without_damaged`: then the damaged rows have no values.
    """
    if isinstance(journal, Journal):
        return reduce_open_journal(journal, without_damaged=without_damaged)
    with open_journal(journal) as opened:
        return reduce_open_journal(opened, without_damaged=without_damaged)


def simulate(
    sample: str, sigma_deg: Sequence[float] = (0.0, 30.0, 60.0), *, wavelengths_nm: Sequence[float] | None = None,
    back: bool = False, transmitted: bool = False,
) -> Simulation:  # fmt: skip
    """Simulate the luminance factors of a sample as the instrument measures them, by the fast estimator (paper, figure 7).

    `sample` is a model as in `goniotwin simulate --sample`; `sigma_deg` are angles of incidence in degrees, from 0 to less
    than 90, ascending; `wavelengths_nm` in nanometres, from 200 to 2500, ascending, or None for a grey table. With `back` the
    light is on the back of the sample; with `transmitted` the detectors are on the other side of it than the light. Raises
    UserError for a model or a grid that cannot be simulated.
    """
    if not isinstance(sample, str):
        raise UserError(f"sample: {sample!r} is not a text; give a model such as 'gaussian:width_deg=5'")
    sigmas = _ascending("sigma_deg", sigma_deg, *SIGMA_LIMITS_DEG)
    wavelengths = None if wavelengths_nm is None else _ascending("wavelengths_nm", wavelengths_nm, *WAVELENGTH_LIMITS_NM)
    if sigmas[-1] == SIGMA_LIMITS_DEG[1]:
        raise UserError(f"sigma_deg: {sigmas[-1]:g}: give angles below 90 deg")
    task = Task(parse_sample(sample), sigmas, wavelengths_nm=wavelengths, back=back, transmitted=transmitted)
    return simulate_task(task)


def _ascending(name: str, values: Sequence[float], lowest: float, highest: float) -> Floats:
    """An argument as an array. Raises UserError for anything but ascending numbers within the limits."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.ndim != 1 or not array.size or not ((array >= lowest) & (array <= highest)).all() or (np.diff(array) <= 0.0).any():
        raise UserError(f"{name}: {values!r}: give a list of numbers from {lowest:g} to {highest:g}, ascending")
    return array
