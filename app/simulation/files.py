"""A simulation as files: .ddr or .ddt on the output grid, CSV with every detector. Each says that it is simulated."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.errors import UserError
from goniotwin.app.formats import DdrTable, FormatError, write_ddr, write_points_csv
from goniotwin.app.simulation.assumptions import assumptions
from goniotwin.app.simulation.simulate import Simulation
from goniotwin.arrays import Floats
from goniotwin.twin.optics import to_specular

LONGEST_LIST = 2000
SUFFIXES = (".ddr", ".ddt", ".csv")


def check_names(paths: list[Path], tables: list[Path], transmitted: bool) -> bool:
    """Whether the files are of transmitted light, which .ddt says too. Raises UserError for names that will not do."""
    for path in paths:
        if path.suffix.lower() not in SUFFIXES:
            raise UserError(f"{path}: what should be written? give a name that ends with .ddr, .ddt or .csv")
        if not path.parent.is_dir():
            raise UserError(f"{path}: there is no folder {path.parent}; make it, or choose another name")
        if any(path.resolve() == table.resolve() for table in tables):
            raise UserError(f"{path}: is the sample's own table; choose another name")
    if len({path.resolve() for path in paths}) < len(paths):
        raise UserError(f"{paths[0]}: is to be written twice; give each file a name of its own")
    suffixes = {path.suffix.lower() for path in paths}
    if ".ddr" in suffixes and (".ddt" in suffixes or transmitted):
        raise UserError("a .ddr is of reflected light, a .ddt of transmitted: simulate them one after the other")
    return transmitted or ".ddt" in suffixes


def write(found: Simulation, path: Path) -> None:
    """Writes one file, as its name says. Raises UserError."""
    try:
        if path.suffix.lower() == ".csv":
            write_points_csv(path, _about(found, every_detector=True), _columns(found))
        else:
            write_ddr(path, ddr_table(found))
    except FormatError as error:
        raise UserError(str(error)) from None


def ddr_table(found: Simulation) -> DdrTable:
    """Luminance factors over the whole ranges that readers expect: the first and last sigma are held to 0 and 90."""
    sigma, values = found.task.sigma_deg, found.table
    if sigma[0] > 0.0:
        sigma, values = np.concatenate([[0.0], sigma]), np.concatenate([values[:, :1], values], axis=1)
    sigma, values = np.concatenate([sigma, [90.0]]), np.concatenate([values, values[:, -1:]], axis=1)
    wavelengths = found.wavelengths_nm
    return DdrTable(
        source="Generated",
        symmetry="PlaneSymmetrical" if found.mirrored else "ASymmetrical",
        psi_deg=np.zeros(1),
        sigma_deg=sigma,
        phi_deg=found.phi_deg,
        theta_deg=found.theta_deg,
        channels=(None,) if wavelengths is None else tuple(wavelengths.tolist()),
        values=values[:, None],
        comments=(*_about(found, every_detector=False), *_continued(found)),
    )


def summary(found: Simulation, paths: list[Path]) -> dict[str, Any]:
    """The result for programs. Errors are in percent, over the values of at least a hundredth of the largest."""
    task, kind = found.task, found.task.effort.kind
    relative = np.concatenate([each.ratio.relative_error for each in found.at])
    counts = {f"{each.sigma_deg:g}": each.ratio.count for each in found.at}
    made = "rays" if kind == "fast" else "paths"
    rows = 1 if found.wavelengths_nm is None else int(found.wavelengths_nm.size)
    return {
        "file": str(paths[0]),
        "files": [str(path) for path in paths],
        "sample": task.sample.name,
        "sigma": task.sigma_deg.tolist(),
        "side": "back" if task.back else "front",
        "transmitted": task.transmitted,
        "stray": task.stray,
        "regular": [each.regular.as_dict() for each in found.at if each.regular is not None],
        "source": None if task.source is None else task.source.as_dict(),
        "wavelengths_nm": None if found.wavelengths_nm is None else found.wavelengths_nm.tolist(),
        "estimator": kind,
        made: max(counts.values()),
        f"{made}_by_sigma": counts,
        **({"seed": task.effort.seed} if kind == "forward" or task.stray else {}),
        "values": sum(int(np.isfinite(each.ratio.factor).sum()) for each in found.at),
        "detectors": {f"{each.sigma_deg:g}": int(each.hidden.size) * rows for each in found.at},
        "largest_relative_standard_error_percent": 100.0 * float(relative.max()) if relative.size else None,
        "median_relative_standard_error_percent": 100.0 * float(np.median(relative)) if relative.size else None,
        "obstruction": task.instrument.obstruction,
        "hidden_directions": {f"{each.sigma_deg:g}": int(each.hidden.sum()) for each in found.at},
        "directions_without_hits": {f"{each.sigma_deg:g}": int(each.unmet.sum()) for each in found.at},
        "nodes": int(found.table.size),
        "continued_nodes": int(found.table.size - found.known.sum()),
        "assumptions": assumptions(found),
        "simulated": True,
    }


def _about(found: Simulation, every_detector: bool) -> list[str]:
    ratios = [each.ratio for each in found.at]
    task = found.task
    made = "rays a detector" if task.effort.kind == "fast" else "paths"
    made += f", seed {task.effort.seed}" if task.effort.kind == "forward" or task.stray else ""
    lines = [
        "SIMULATED: computed with the virtual prototype; nothing in this file is measured",
        f"sample: {task.sample.name}",
        f"estimator: {task.effort.kind}, {', '.join(sorted({str(ratio.count) for ratio in ratios}))} {made}",
        *assumptions(found),
    ]
    if every_detector:
        lines += [
            "a row for each detector: polar and azimuth in the rig's frame; theta, phi about the specular direction, deg",
            "standard_error is that of luminance_factor",
            "flags: hidden (by the mirrors, be it in part), no-hits (no path has met it)",
        ]
    return lines


def _continued(found: Simulation) -> list[str]:
    """What in the table rests on no detector, for its heading."""
    lines = [
        f"simulated at sigma {', '.join(f'{sigma:g}' for sigma in found.task.sigma_deg)} deg only; held to sigma 0 and 90",
        "nodes without detectors around them (hidden by the mirrors, beyond the last polar angle, below the horizon) are",
        "interpolated along theta, or hold the nearest, or are the mean of the other rows; these are, in degrees:",
    ]
    gaps = [
        f"sigma {sigma:g}, phi {phi:g}: theta {start:g} to {stop:g}"
        for k, sigma in enumerate(found.task.sigma_deg)
        for m, phi in enumerate(found.phi_deg)
        for start, stop in _runs(found.theta_deg, np.logical_not(found.known[:, k, m].all(axis=0)))
    ]
    more = [f"and {len(gaps) - LONGEST_LIST} more such ranges"] if len(gaps) > LONGEST_LIST else []
    return [*lines, *gaps[:LONGEST_LIST], *more]


def _runs(values: Floats, chosen: npt.NDArray[Any]) -> list[tuple[float, float]]:
    """First and last value of each run of chosen ones."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    return [(float(values[start]), float(values[stop - 1])) for start, stop in edges.reshape(-1, 2)]


def _columns(found: Simulation) -> dict[str, npt.NDArray[Any]]:
    blocks = [_block(found, k, row) for k in range(len(found.at)) for row in range(found.table.shape[0])]
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def _block(found: Simulation, k: int, row: int) -> dict[str, npt.NDArray[Any]]:
    at = found.at[k]
    count = at.hidden.size
    # Of the sample as the light has it in front of it, and transmitted light mirrored in its plane.
    turned = -1.0 if found.task.back else 1.0
    theta, phi = to_specular(at.sigma_deg, at.directions * [1.0, turned, -1.0 if found.task.lower else 1.0])
    wavelength = np.nan if found.wavelengths_nm is None else found.wavelengths_nm[row]
    return {
        "wavelength_nm": np.full(count, wavelength),
        "sigma_deg": np.full(count, at.sigma_deg),
        "polar_deg": np.repeat(at.detectors.polar_deg, at.detectors.azimuth_deg.size),
        "azimuth_deg": np.tile(at.detectors.azimuth_deg, at.detectors.polar_deg.size),
        "theta_deg": theta,
        "phi_deg": phi,
        "sample_m2sr": at.ratio.sample_m2sr[row],
        "etalon_m2sr": at.ratio.etalon_m2sr[row],
        "luminance_factor": at.ratio.factor[row],
        "standard_error": at.ratio.standard_error[row],
        "flags": np.where(at.hidden, "hidden", np.where(at.unmet, "no-hits", "")),
    }
