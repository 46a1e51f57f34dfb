"""A simulation as files: .ddr or .ddt on the output grid, CSV with every detector. Each says that it is simulated.

What a reader has to know about a simulation's numbers, in words.
"""

import io
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from goniotwin.app.errors import UserError
from goniotwin.app.formats import DdrTable, FormatError, write_ddr, write_points_csv
from goniotwin.app.formats.file import write_file
from goniotwin.app.simulation.simulate import Simulation, Task, acting_lobes, refracted_axes
from goniotwin.arrays import Floats
from goniotwin.twin.optics import to_specular
from goniotwin.twin.optics.bsdf.models import GAUSSIAN


def assumptions(found: Simulation) -> list[str]:
    """One line each, for heads of files and for programs."""
    task, instrument = found.task, found.task.instrument
    hidden = "off: no direction is hidden, as if the mirrors let light pass"
    if instrument.obstruction:
        hidden = "on: directions of which the mirrors hide any part have no value"
    way = "transmitted" if task.transmitted else "reflected"
    grid = "as given" if task.polar_deg is not None else "steps of 0.5 deg near the specular direction to 5 deg"
    estimator = "fast: sample, etalon and all wavelengths with the same rays; errors are differences to another set of rays"
    if task.estimator.kind == "forward":
        estimator = "forward Monte Carlo: sample and etalon with paths of their own; errors are standard errors of the paths"
    return [
        f"quantity: luminance factor of {way} light (pi times the BSDF), against an ideal diffuser",
        *_gaussians(task),
        f"side: {_side(task)}",
        *_regular(found),
        *_refracted(task),
        f"stray light: {_stray(task)}",
        f"source: {_source(task)}",
        f"spot: {instrument.spot_side_mm:g} x {instrument.spot_side_mm:g} mm on the sample, set by its frame",
        f"divergence: {instrument.divergence_deg:.3f} deg full width",
        f"field: {instrument.field_deg:g} deg full width, {'discs' if instrument.sensor is None else 'sensors with lenses'} of "
        f"{instrument.detector_diameter_mm:g} mm at {instrument.arc_radius_mm:g} mm",
        f"detectors: virtual ones over azimuth and polar angle, {grid}; a monotone cubic between them",
        f"deviations: {'none' if not instrument.deviations else ', '.join(instrument.deviations)}",
        f"obstruction: {hidden}",
        f"estimator: {estimator}",
        "noise: none but the estimator's; fluorescence: none",
    ]


def _side(task: Task) -> str:
    arc = f"detectors on the {'lower' if task.lower else 'upper'} arc"
    if not task.back:
        return f"light on the front, {arc}"
    turned = "phi is that of the sample turned about x"
    return f"light on the back, the mirror unit at 180 deg - sigma, {arc}; sigma is the incidence on the back, {turned}"


def _regular(found: Simulation) -> list[str]:
    peaks = [each.regular for each in found.at if each.regular is not None]
    if not peaks:
        return []
    least, most = (f"{pick(peak.share for peak in peaks):g}" for pick in (min, max))
    share = least if least == most else f"{least} to {most}"
    way = "straight through" if found.task.transmitted else "in the mirror direction"
    lines = [
        f"regular component: {share} of the light goes {way}, theta = 0; its luminance factor is no property of the sample, it "
        "depends on beam, spot, aperture and field",
        f"regular component: what is in this table of it is what these detectors see, within {peaks[0].within_deg:.2f} deg of "
        "theta = 0",
    ]
    gone = [f"{peak.sigma_deg:g}" for peak in peaks if peak.largest_factor is None]
    if gone:
        lines.append(f"regular component: no detector has it at sigma {', '.join(gone)}: hidden, or between them")
    return lines


def _gaussians(task: Task) -> list[str]:
    """Each lobe without doubt, whichever form and quantity its width was given in."""
    lines = []
    for lobe in acting_lobes(task):
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


def _refracted(task: Task) -> list[str]:
    axes = [(sigma, axis) for sigma in task.sigma_deg.tolist() for axis in refracted_axes(task, sigma)]
    bent = [f"{axis:.2f} at sigma {sigma:g}" for sigma, axis in axes if axis is not None]
    gone = [f"{sigma:g}" for sigma, axis in axes if axis is None]
    lines = []
    if bent:
        lines.append(
            f"refraction: lobes about the polar angles {', '.join(bent)} deg; theta = 0 stays the straight-through direction, "
            "so give --theta and --phi fine enough there"
        )
    if gone:
        lines.append(f"refraction: total reflection at sigma {', '.join(gone)}: nothing of that lobe is transmitted")
    return lines


def _stray(task: Task) -> str:
    if not task.stray:
        return "left out: only light that was scattered once, by the sample, counts"
    frames = task.frames
    told = (
        f"in: that of frames of {frames.side_mm:g} mm that scatter {frames.reflectance:g} of the light and are lit "
        f"{frames.lit:g} times as wide as their hole, and light that met mirrors, frames or sample again; of sample and etalon"
    )
    if task.estimator.kind == "fast":
        told += "; from a map over 5 by 10 deg"
    return told


def _source(task: Task) -> str:
    if task.source is None:
        return "a uniform exit pupil"
    source = task.source
    return f"rayset {source.name} of {source.rays.flux.size} rays, geometry {source.geometry}, at {source.wavelength_nm:g} nm"


LONGEST_LIST = 2000
SUFFIXES = (".ddr", ".ddt", ".csv")


def check_file_names(paths: list[Path], tables: list[Path], transmitted: bool) -> bool:
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


def write_simulation(found: Simulation, path: Path) -> None:
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
    task, kind = found.task, found.task.estimator.kind
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
        **({"seed": task.estimator.seed} if kind == "forward" or task.stray else {}),
        "values": sum(int(np.isfinite(each.ratio.factor).sum()) for each in found.at),
        "detectors": {f"{each.sigma_deg:g}": int(each.obstructed.size) * rows for each in found.at},
        "largest_relative_standard_error_percent": 100.0 * float(relative.max()) if relative.size else None,
        "median_relative_standard_error_percent": 100.0 * float(np.median(relative)) if relative.size else None,
        "obstruction": task.instrument.obstruction,
        "hidden_directions": {f"{each.sigma_deg:g}": int(each.obstructed.sum()) for each in found.at},
        "directions_without_hits": {f"{each.sigma_deg:g}": int(each.missed.sum()) for each in found.at},
        "nodes": int(found.table.size),
        "continued_nodes": int(found.table.size - found.known.sum()),
        "assumptions": assumptions(found),
        "simulated": True,
    }


def _about(found: Simulation, every_detector: bool) -> list[str]:
    ratios = [each.ratio for each in found.at]
    task = found.task
    made = "rays a detector" if task.estimator.kind == "fast" else "paths"
    made += f", seed {task.estimator.seed}" if task.estimator.kind == "forward" or task.stray else ""
    lines = [
        "SIMULATED: computed with the virtual prototype; nothing in this file is measured",
        f"sample: {task.sample.name}",
        f"estimator: {task.estimator.kind}, {', '.join(sorted({str(ratio.count) for ratio in ratios}))} {made}",
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
    count = at.obstructed.size
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
        "flags": np.where(at.obstructed, "hidden", np.where(at.missed, "no-hits", "")),
    }


def write_figure(figure: Figure, path: Path, dots_an_inch: int | None = None) -> None:
    """With the figure's own resolution unless told. Raises UserError where no file can be written."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi="figure" if dots_an_inch is None else dots_an_inch)
    try:
        write_file(path, content.getvalue())
    except FormatError as error:
        raise UserError(str(error)) from None
