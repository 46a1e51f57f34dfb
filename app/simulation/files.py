"""Files of a simulation: .ddr or .ddt of the output grid, CSV of all detectors, pictures; and the assumptions in them.

Every file states that it is simulated.
"""

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from goniotwin.app.errors import UserError
from goniotwin.app.formats import DdrTable, FormatError, write_ddr, write_points_csv
from goniotwin.app.formats.file import write_file
from goniotwin.app.simulation.simulate import Simulation, Task
from goniotwin.arrays import Floats
from goniotwin.twin.optics import to_specular
from goniotwin.twin.optics.bsdf.models import GAUSSIAN

SUFFIXES = (".ddr", ".ddt", ".csv")
LONGEST_LIST = 2000


def check_suffix(path: Path, suffixes: Sequence[str]) -> None:
    """Raise UserError for a file name whose suffix is not one of `suffixes`, or whose folder does not exist."""
    if path.suffix.lower() not in suffixes:
        raise UserError(f"{path}: the format is unknown; give a name that ends with {_list_words(suffixes)}")
    if not path.parent.is_dir():
        raise UserError(f"{path}: there is no folder {path.parent}; make it, or choose another name")


def _list_words(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} or {words[-1]}"


def check_file_names(paths: list[Path], tables: list[Path], transmitted: bool) -> bool:
    """Whether the files are of transmitted light: with `transmitted`, or if one is a .ddt.

    `tables` are the files that the sample is read from. Raises UserError for a name that cannot be written.
    """
    for path in paths:
        check_suffix(path, SUFFIXES)
        if any(path.resolve() == table.resolve() for table in tables):
            raise UserError(f"{path}: is a table of the sample; choose another name")
    if len({path.resolve() for path in paths}) < len(paths):
        raise UserError(f"{paths[0]}: is given twice; give each file its own name")
    suffixes = {path.suffix.lower() for path in paths}
    if ".ddr" in suffixes and (".ddt" in suffixes or transmitted):
        raise UserError("a .ddr is of reflected light, a .ddt of transmitted: simulate them one after the other")
    return transmitted or ".ddt" in suffixes


def write_simulation(simulation: Simulation, path: Path) -> None:
    """Write one file, in the format of its suffix. Raises UserError."""
    try:
        if path.suffix.lower() == ".csv":
            write_points_csv(path, _heading(simulation, every_detector=True), _columns(simulation))
        else:
            write_ddr(path, ddr_table(simulation))
    except FormatError as error:
        raise UserError(str(error)) from None


def ddr_table(simulation: Simulation) -> DdrTable:
    """Luminance factors over the full ranges that readers expect: the first and the last sigma are held to 0 and 90."""
    sigma, values = simulation.task.sigma_deg, simulation.table
    if sigma[0] > 0.0:
        sigma, values = np.concatenate([[0.0], sigma]), np.concatenate([values[:, :1], values], axis=1)
    sigma, values = np.concatenate([sigma, [90.0]]), np.concatenate([values, values[:, -1:]], axis=1)
    wavelengths = simulation.wavelengths_nm
    return DdrTable(
        source="Generated",
        symmetry="PlaneSymmetrical" if simulation.mirrored else "ASymmetrical",
        psi_deg=np.zeros(1),
        sigma_deg=sigma,
        phi_deg=simulation.phi_deg,
        theta_deg=simulation.theta_deg,
        channels=(None,) if wavelengths is None else tuple(wavelengths.tolist()),
        values=values[:, None],
        comments=(*_heading(simulation, every_detector=False), *_continued_nodes(simulation)),
    )


def summary(simulation: Simulation, paths: list[Path]) -> dict[str, Any]:
    """The result for JSON. Errors are in percent, over the values of at least a hundredth of the largest."""
    task, kind = simulation.task, simulation.task.estimator.kind
    relative = np.concatenate([each.ratio.relative_error for each in simulation.at])
    counts = {f"{each.sigma_deg:g}": each.ratio.count for each in simulation.at}
    unit = "rays" if kind == "fast" else "paths"
    rows = 1 if simulation.wavelengths_nm is None else int(simulation.wavelengths_nm.size)
    return {
        "file": str(paths[0]),
        "files": [str(path) for path in paths],
        "sample": task.sample.name,
        "sigma": task.sigma_deg.tolist(),
        "side": "back" if task.back else "front",
        "transmitted": task.transmitted,
        "stray": task.stray,
        "regular": [each.regular.as_dict() for each in simulation.at if each.regular is not None],
        "source": None if task.source is None else task.source.as_dict(),
        "wavelengths_nm": None if simulation.wavelengths_nm is None else simulation.wavelengths_nm.tolist(),
        "estimator": kind,
        unit: max(counts.values()),
        f"{unit}_by_sigma": counts,
        **({"seed": task.estimator.seed} if kind == "forward" or task.stray else {}),
        "values": sum(int(np.isfinite(each.ratio.factor).sum()) for each in simulation.at),
        "detectors": {f"{each.sigma_deg:g}": int(each.obstructed.size) * rows for each in simulation.at},
        "largest_relative_standard_error_percent": 100.0 * float(relative.max()) if relative.size else None,
        "median_relative_standard_error_percent": 100.0 * float(np.median(relative)) if relative.size else None,
        "obstruction": task.instrument.obstruction,
        "hidden_directions": {f"{each.sigma_deg:g}": int(each.obstructed.sum()) for each in simulation.at},
        "directions_without_hits": {f"{each.sigma_deg:g}": int(each.missed.sum()) for each in simulation.at},
        "nodes": int(simulation.table.size),
        "continued_nodes": int(simulation.table.size - simulation.known.sum()),
        "assumptions": assumptions(simulation),
        "simulated": True,
    }


def assumptions(simulation: Simulation) -> list[str]:
    """The assumptions behind the numbers, one line each, for the headings of files and for JSON."""
    task, instrument = simulation.task, simulation.task.instrument
    obstruction = "off: no direction is blocked, as if the mirrors transmitted light"
    if instrument.obstruction:
        obstruction = "on: directions blocked by the mirror unit, also in part, have no value"
    reflected = "transmitted" if task.transmitted else "reflected"
    grid = "as given" if task.polar_deg is not None else "steps of 0.5 deg near the specular direction to 5 deg"
    estimator = (
        "fast: sample, etalon and all wavelengths with the same rays; standard errors are differences from other sets of rays"
    )
    if task.estimator.kind == "forward":
        estimator = "forward Monte Carlo: sample and etalon with different paths; standard errors are those of the paths"
    return [
        f"quantity: luminance factor of {reflected} light (pi times the BSDF), relative to an ideal diffuser",
        *_gaussian_lines(task),
        f"side: {_side(task)}",
        *_regular_lines(simulation),
        *_refraction_lines(task),
        f"stray light: {_stray(task)}",
        f"source: {_source(task)}",
        f"spot: {instrument.spot_side_mm:g} x {instrument.spot_side_mm:g} mm on the sample, limited by its frame",
        f"divergence: {instrument.divergence_deg:.3f} deg full width",
        f"field: {instrument.field_deg:g} deg full width, {'discs' if instrument.sensor is None else 'sensors with lenses'} of "
        f"{instrument.detector_diameter_mm:g} mm at {instrument.arc_radius_mm:g} mm",
        f"detectors: virtual detectors over azimuth and polar angle, {grid}; a monotone cubic between them",
        f"deviations: {'none' if not instrument.deviations else ', '.join(instrument.deviations)}",
        f"obstruction: {obstruction}",
        f"estimator: {estimator}",
        "noise: only that of the estimator; fluorescence: none",
    ]


def _side(task: Task) -> str:
    arc = f"detectors on the {'lower' if task.lower else 'upper'} arc"
    if not task.back:
        return f"light on the front, {arc}"
    turned = "phi is that of the sample turned about x"
    return f"light on the back, the mirror unit at 180 deg - sigma, {arc}; sigma is the incidence on the back, {turned}"


def _regular_lines(simulation: Simulation) -> list[str]:
    peaks = [each.regular for each in simulation.at if each.regular is not None]
    if not peaks:
        return []
    lowest, highest = (f"{pick(peak.fraction for peak in peaks):g}" for pick in (min, max))
    fraction = lowest if lowest == highest else f"{lowest} to {highest}"
    direction = "straight through" if simulation.task.transmitted else "in the mirror direction"
    lines = [
        f"regular component: {fraction} of the light leaves {direction}, theta = 0; its luminance factor is not a property of "
        "the sample, it depends on beam, spot, aperture and field",
        "regular component: the table contains what these detectors see of it, within "
        f"{peaks[0].half_angle_deg:.2f} deg of theta = 0",
    ]
    unseen = [f"{peak.sigma_deg:g}" for peak in peaks if peak.largest_factor is None]
    if unseen:
        lines.append(f"regular component: no detector sees it at sigma {', '.join(unseen)}: it is blocked, or between them")
    return lines


def _gaussian_lines(task: Task) -> list[str]:
    """Each Gaussian lobe in the same terms, whichever form and quantity its width was given in."""
    lines = []
    for lobe in task.acting_lobes:
        if lobe.kind == GAUSSIAN:
            peak, exponent, intensity = lobe.params[:3]
            falls = ", ".join(
                f"to {name} at {math.degrees(math.sqrt(level / exponent)):.4g} deg"
                for name, level in (("1/e", 1.0), ("a half", math.log(2.0)))
            )
            lines.append(
                f"gaussian: the {'intensity' if intensity == 1.0 else 'luminance'} falls {falls}; "
                f"the peak is {peak:.4g} /sr, and {lobe.albedo(0.0):.4g} of the light at normal incidence is scattered"
            )
    return lines


def _refraction_lines(task: Task) -> list[str]:
    axes = [(sigma, axis) for sigma in task.sigma_deg.tolist() for axis in task.refracted_axes(sigma)]
    refracted = [f"{axis:.2f} at sigma {sigma:g}" for sigma, axis in axes if axis is not None]
    reflected = [f"{sigma:g}" for sigma, axis in axes if axis is None]
    lines = []
    if refracted:
        lines.append(
            f"refraction: lobes about the polar angles {', '.join(refracted)} deg; theta = 0 stays the straight-through "
            "direction, so give --theta and --phi fine enough there"
        )
    if reflected:
        lines.append(f"refraction: total reflection at sigma {', '.join(reflected)}: that lobe is not transmitted")
    return lines


def _stray(task: Task) -> str:
    if not task.stray:
        return "not included: only light that the sample scatters once counts"
    frames = task.frames
    text = (
        f"included: that of frames of {frames.side_mm:g} mm that scatter {frames.reflectance:g} of the light and are lit "
        f"{frames.lit:g} times as wide as their hole, and light scattered again by mirrors, frames or sample; for sample and "
        "etalon"
    )
    if task.estimator.kind == "fast":
        text += "; from a map with cells of 5 by 10 deg"
    return text


def _source(task: Task) -> str:
    if task.source is None:
        return "a uniform exit pupil"
    source = task.source
    return f"rayset {source.name} of {source.rays.flux.size} rays, geometry {source.geometry}, at {source.wavelength_nm:g} nm"


def _heading(simulation: Simulation, every_detector: bool) -> list[str]:
    ratios = [each.ratio for each in simulation.at]
    task = simulation.task
    effort = "rays a detector" if task.estimator.kind == "fast" else "paths"
    effort += f", seed {task.estimator.seed}" if task.estimator.kind == "forward" or task.stray else ""
    lines = [
        "SIMULATED: computed with the virtual prototype; nothing in this file is measured",
        f"sample: {task.sample.name}",
        f"estimator: {task.estimator.kind}, {', '.join(sorted({str(ratio.count) for ratio in ratios}))} {effort}",
        *assumptions(simulation),
    ]
    if every_detector:
        lines += [
            "one row per detector: polar and azimuth in the rig's frame; theta, phi about the specular direction, deg",
            "standard_error is that of luminance_factor",
            "flags: hidden (blocked by the mirror unit, also in part), no-hits (no path arrived at the detector)",
        ]
    return lines


def _continued_nodes(simulation: Simulation) -> list[str]:
    """Lines for the heading about the nodes of the table without detectors around them."""
    lines = [
        f"simulated at sigma {', '.join(f'{sigma:g}' for sigma in simulation.task.sigma_deg)} deg only; held to sigma 0 and 90",
        "nodes without detectors around them (blocked by the mirror unit, beyond the last polar angle, below the horizon) are",
        "interpolated along theta, or hold the nearest value, or the mean of the other rows; these nodes are, in degrees:",
    ]
    gaps = [
        f"sigma {sigma:g}, phi {phi:g}: theta {start:g} to {stop:g}"
        for k, sigma in enumerate(simulation.task.sigma_deg)
        for m, phi in enumerate(simulation.phi_deg)
        for start, stop in _runs(simulation.theta_deg, np.logical_not(simulation.known[:, k, m].all(axis=0)))
    ]
    more = [f"and {len(gaps) - LONGEST_LIST} more such ranges"] if len(gaps) > LONGEST_LIST else []
    return [*lines, *gaps[:LONGEST_LIST], *more]


def _runs(values: Floats, chosen: npt.NDArray[Any]) -> list[tuple[float, float]]:
    """First and last value of each run of chosen values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    return [(float(values[start]), float(values[stop - 1])) for start, stop in edges.reshape(-1, 2)]


def _columns(simulation: Simulation) -> dict[str, npt.NDArray[Any]]:
    blocks = [_block(simulation, k, row) for k in range(len(simulation.at)) for row in range(simulation.table.shape[0])]
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def _block(simulation: Simulation, k: int, row: int) -> dict[str, npt.NDArray[Any]]:
    at = simulation.at[k]
    count = at.obstructed.size
    # In the frame of the sample with its lit side in front; directions of transmitted light are mirrored in its plane.
    turned = -1.0 if simulation.task.back else 1.0
    theta, phi = to_specular(at.sigma_deg, at.directions * [1.0, turned, -1.0 if simulation.task.lower else 1.0])
    wavelength = np.nan if simulation.wavelengths_nm is None else simulation.wavelengths_nm[row]
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
        "flags": np.where(at.obstructed, "hidden", np.where(at.missed, "no-hits", "")),
    }


def write_figure(figure: Figure, path: Path, dots_per_inch: int | None = None) -> None:
    """Write a figure as a PNG, completely or not at all; by default with the figure's own resolution. Raises UserError."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi="figure" if dots_per_inch is None else dots_per_inch)
    try:
        write_file(path, content.getvalue())
    except FormatError as error:
        raise UserError(str(error)) from None
