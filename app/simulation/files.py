"""Files of a simulation: tables of the output grid, points of all detectors, pictures; and the assumptions in them.

Every file states that it is simulated.
"""

import io
import math
import os
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable, PointStream, registry, writing
from goniotwin.app.formats.content import BsdfFile, Part, RegularTable, ScatteredBsdf
from goniotwin.app.formats.file import check_writable, write_file
from goniotwin.app.formats.registry import Format, Holds
from goniotwin.app.formats.specular_grid import SpecularCut, specular_table
from goniotwin.app.simulation.simulate import SigmaResult, Simulation, Task, check_task
from goniotwin.twin.optics import to_specular
from goniotwin.twin.optics.bsdf.kinds import GAUSSIAN
from goniotwin.twin.optics.geometry.coordinates import (
    mirror_in_plane_of_incidence,
    mirror_in_sample_plane,
    round_deg,
    wrap_azimuth,
)

if TYPE_CHECKING:  # tables need nothing that draws
    from matplotlib.figure import Figure

KINDS = registry.BSDF
"""A simulation is written as a table of the output grid, as points of all detectors, or as the regular component alone."""
SCATTERED_OMITTED = "the scattered part is omitted: a table or points (--out FILE.ddr, .ddt or .csv) have it"


def check_suffix(path: Path, kind: Holds, *others: str) -> None:
    """Raise UserError for a suffix that is neither of a format of this kind nor of `others`, and for what cannot be written."""
    suffixes = [*registry.suffixes(registry.writers(kind)), *others]
    if path.suffix.lower() not in suffixes:
        raise UserError(f"{path}: the format is unknown; give a name that ends with {registry.join_words(suffixes)}")
    check_writable(path)


def check_file_names(paths: list[Path], tables: list[Path], transmitted: bool, name: str | None = None) -> bool:
    """Whether the files are of transmitted light: with `transmitted`, or if the format of one holds no other.

    `tables` are the files that the sample is read from, `name` is the format of the files that have one of its suffixes. Raises
    UserError for a name that cannot be written.
    """
    found = {path: _format(path, name=name) for path in paths}
    if name is not None and name not in {form.name for form in found.values()}:
        raise UserError(
            f"--format: no --out has a suffix of {name}: {registry.join_words(registry.format_named(name, KINDS).suffixes)}"
        )
    reflecting = [each for each in found.values() if Holds.TRANSMITTED not in each.holds]
    transmitting = [each for each in found.values() if Holds.REFLECTED not in each.holds]
    written = [os.path.realpath(path) for path in paths]
    written += [os.path.realpath(beside) for path in paths for beside in registry.files_beside(path, found[path]).values()]
    for path in paths:
        registry.check_files(path, found[path])
    for real in written:
        if any(real == os.path.realpath(table) for table in tables):
            raise UserError(f"{real}: is a table of the sample; choose another name")
        if written.count(real) > 1:
            raise UserError(f"{real}: is given twice; give each file its own name")
    if reflecting and (transmitting or transmitted):
        wrong = f"a {reflecting[0].suffixes[0]} is of reflected light only, and transmitted light is asked for"
        raise UserError(f"{wrong}: simulate them one after the other")
    return transmitted or bool(transmitting)


def task_of_files(task: Task, paths: list[Path], name: str | None = None) -> Task:
    """The task whose result the files hold: one that has room for the regular component takes it apart, for all of the files.

    Raises UserError, before a long computation, if a file cannot hold the result, or there is nothing for it.
    """
    spectrum = task.sample.spectrum
    given = task.wavelengths_nm if task.wavelengths_nm is not None or spectrum is None else spectrum.wavelengths_nm
    several = given is not None and given.size > 1 and task.source is None
    light = Holds.TRANSMITTED if task.transmitted else Holds.REFLECTED
    needs = {light, Holds.SIGMAS, *([Holds.WAVELENGTHS] if several else [])}
    found = [(path, _format(path, needs, name)) for path in paths]
    if task.has_regular and any(Holds.REGULAR in form.holds for _, form in found):
        alone = not any(form.holds & {Holds.GRID, Holds.POINTS} for _, form in found)
        task = replace(task, regular="alone" if alone else "apart")
    check_task(task)
    for path, form in found:
        if not form.holds & {Holds.GRID, Holds.POINTS}:
            if not task.has_regular:
                wrong = f"the format {form.name} holds {Holds.REGULAR}, and {task.sample.name!r} has none here"
                raise UserError(
                    f"{path}: {wrong}; give a table or points (.ddr, .csv), or a sample with +regular:reflectance=0.04"
                )
        elif not task.scatters and Holds.REGULAR not in form.holds:
            wrong = "the sample has nothing but a regular component, which goes to the other file"
            raise UserError(f"{path}: {wrong}; leave this one out, or simulate it alone")
        elif task.psis_deg.size > 1:
            _format(path, {Holds.PSI}, name)
    return task


def write_content(path: Path, kind: Holds, content: Any) -> None:
    """Write a file in the format of this kind and its suffix; see `registry.Codec`. Raises UserError."""
    registry.format_for(path, {kind}).write(path, content)


def _format(path: Path, needs: Collection[Holds] = (), name: str | None = None) -> Format:
    """The format of a file: the one of this name if it has the suffix, else the first that has it."""
    if name is not None and path.suffix.lower() in (found := registry.format_named(name, KINDS)).suffixes:
        registry.check_holds(path, found, needs)
        return found
    return registry.format_for(path, KINDS, needs)


def write_simulation(simulation: Simulation, path: Path, name: str | None = None) -> tuple[Path, ...]:
    """Write one file, in the format of its suffix or of this name, and the uncertainties of a table beside it.

    Raises UserError.
    """
    found = _format(path, name=name)
    if Holds.COLUMNS in found.holds:
        write_content(path, Holds.POINTS, PointStream(_heading(simulation, every_detector=True), [_columns(simulation)]))
        return (path,)
    return writing.write(path, _content(simulation, found), found)


def _content(simulation: Simulation, found: Format) -> BsdfFile:
    """What a format holds of a simulation: the table or the points, and the regular component where it is taken apart."""
    parts: list[Part] = []
    if simulation.at and Holds.GRID in found.holds:
        parts.append(bsdf_table(simulation))
    if simulation.at and Holds.POINTS in found.holds:
        parts.append(scattered(simulation))
    if simulation.regular is not None and Holds.REGULAR in found.holds:
        about = _heading(simulation, every_detector=False)
        alone = simulation.task.has_scattered and not found.holds & {Holds.GRID, Holds.POINTS}
        parts.append(replace(simulation.regular, comments=(*about, *([SCATTERED_OMITTED] if alone else []))))
    return BsdfFile(tuple(parts))


def scattered(simulation: Simulation) -> ScatteredBsdf:
    """The BSDF at every detector, with its standard error, 1/sr; in the frame of the sample with its lit side in front."""
    task = simulation.task
    columns = _columns(simulation)
    size = columns["sigma_deg"].size
    error = columns["standard_error"]
    return ScatteredBsdf(
        sigma_deg=columns["sigma_deg"],
        psi_deg=columns.get("psi_deg", np.zeros(size)),
        polar_deg=columns["polar_deg"],
        azimuth_deg=columns["azimuth_deg"],
        values=columns["luminance_factor"] / np.pi,
        u=np.where(np.isfinite(error), error, np.nan) / np.pi,
        flags=columns["flags"],
        wavelength_nm=columns["wavelength_nm"],
        transmitted=np.full(size, task.transmitted),
        back=np.full(size, task.back),
        sample=task.sample.name,
        isotropic=simulation.at[0].detectors.mirrored,
        generated=True,
        comments=tuple(_heading(simulation, every_detector=False)),
    )


def bsdf_table(simulation: Simulation) -> BsdfTable:
    """The output grid over the full ranges that readers expect, with the standard errors as uncertainties; 1/sr."""
    task = simulation.task
    cuts = [[SpecularCut(cut.values / np.pi, cut.u / np.pi, cut.known) for cut in each] for each in simulation.cuts]
    return specular_table(
        task.sigma_deg,
        simulation.phi_deg,
        simulation.theta_deg,
        cuts,
        None if simulation.wavelengths_nm is None else tuple(simulation.wavelengths_nm.tolist()),
        transmitted=task.transmitted,
        generated=True,
        comments=_heading(simulation, every_detector=False),
        done="simulated",
        psi_deg=task.psis_deg if task.psis_deg.size > 1 else None,
        back=task.back,
        sample=task.sample.name,
    )


def summary(simulation: Simulation, paths: list[Path]) -> dict[str, Any]:
    """The result for JSON. Errors are in percent, over the values of at least a hundredth of the largest."""
    task, kind = simulation.task, simulation.task.estimator.kind
    relative = np.concatenate([np.empty(0), *(each.ratio.relative_error for each in simulation.at)])
    counts = {f"{each.sigma_deg:g}": each.ratio.count for each in simulation.at}
    unit = "rays" if kind == "fast" else "paths"
    first = [each for each in simulation.at if each.psi_deg == task.psis_deg[0]]
    return {
        "file": str(paths[0]),
        "files": [str(path) for path in paths],
        "sample": task.sample.name,
        "sigma": task.sigma_deg.tolist(),
        "side": "back" if task.back else "front",
        "transmitted": task.transmitted,
        "psi": task.psis_deg.tolist() if task.period_deg else [],
        "stray": task.stray,
        "regular": [each.regular.as_dict() for each in first if each.regular is not None],
        "regular_apart": _regular_shares(simulation.regular),
        "notes": _notes(simulation, paths),
        "source": task.source,
        "wavelengths_nm": None if simulation.wavelengths_nm is None else simulation.wavelengths_nm.tolist(),
        "estimator": kind,
        unit: max(counts.values(), default=0),
        f"{unit}_by_sigma": counts,
        **({"seed": task.estimator.seed} if kind == "forward" or task.stray else {}),
        "values": sum(int(np.isfinite(each.ratio.factor).sum()) for each in simulation.at),
        "detectors": {f"{each.sigma_deg:g}": each.ratio.factor.size * task.psis_deg.size for each in first},
        "largest_relative_standard_error_percent": 100.0 * float(relative.max()) if relative.size else None,
        "median_relative_standard_error_percent": 100.0 * float(np.median(relative)) if relative.size else None,
        "obstruction": task.instrument.obstruction,
        "hidden_directions": {f"{each.sigma_deg:g}": int(each.obstructed.sum()) for each in first},
        "directions_without_hits": {
            f"{each.sigma_deg:g}": sum(int(one.missed.sum()) for one in simulation.at if one.sigma_deg == each.sigma_deg)
            for each in first
        },
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
        *_psi_lines(task),
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


def _psi_lines(task: Task) -> list[str]:
    """How the light was turned about an anisotropic sample."""
    if task.period_deg == 0.0:
        return []
    psi = ", ".join(f"{each:g}" for each in task.psis_deg)
    if task.psis_deg.size == 1:
        return [f"psi: the sample is anisotropic, and simulated at psi {psi} deg alone: a table states it for every psi"]
    return [f"psi: azimuths {psi} deg of the light in the frame of the anisotropic sample"]


def _regular_shares(regular: RegularTable | None) -> list[dict[str, Any]]:
    """The regular component that is taken apart, for JSON."""
    if regular is None:
        return []
    shares = regular.values[:, 0].T.tolist()
    return [
        {"sigma": sigma, "share": each[0] if len(each) == 1 else each}
        for sigma, each in zip(regular.sigma_deg.tolist(), shares, strict=True)
    ]


def _notes(simulation: Simulation, paths: list[Path]) -> list[str]:
    """What a file leaves out of a sample with a regular component that is taken apart, one line each."""
    if simulation.regular is None:
        return []
    beside = {each for path in paths for each in registry.files_beside(path, _format(path)).values()}
    holding = [path for path in paths if path not in beside and Holds.REGULAR in _format(path).holds]
    notes = []
    for path in paths:
        if path not in beside and path not in holding:
            notes.append(f"{path}: without the regular component, which is in {registry.join_words(map(str, holding), 'and')}")
        elif path not in beside and simulation.task.has_scattered and not _format(path).holds & {Holds.GRID, Holds.POINTS}:
            notes.append(f"{path}: {SCATTERED_OMITTED}")
    return notes


def _regular_lines(simulation: Simulation) -> list[str]:
    peaks = [each.regular for each in simulation.at if each.regular is not None]
    fractions = [each for peak in peaks for each in peak.fractions]
    if simulation.regular is not None:
        fractions = simulation.regular.values.ravel().tolist()
    if not fractions:
        return []
    lowest, highest = (f"{pick(fractions):g}" for pick in (min, max))
    fraction = lowest if lowest == highest else f"{lowest} to {highest}"
    direction = "straight through" if simulation.task.transmitted else "in the mirror direction"
    if simulation.regular is not None:
        return [
            f"regular component: {fraction} of the light leaves {direction}, theta = 0; it is no part of the values in 1/sr",
            "regular component: in .sdr, .sdt, .ssdd and archives, as the sample's own factor against sigma, without rays",
        ]
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
        *([f"sample: {task.sample.name}"] if every_detector else []),  # a part has the name itself
        f"estimator: {task.estimator.kind}, {', '.join(sorted({str(ratio.count) for ratio in ratios}))} {effort}",
        *assumptions(simulation),
    ]
    if every_detector:
        lines += [
            "one row per detector: polar and azimuth in the frame of the sample with its lit side in front, deg",
            "the light is at the azimuth psi, 0 of an isotropic sample; theta, phi are about the specular direction, deg",
            "standard_error is that of luminance_factor",
            "flags: hidden (blocked by the mirror unit, also in part), no-hits (no path arrived at the detector)",
        ]
    return lines


def _columns(simulation: Simulation) -> dict[str, npt.NDArray[Any]]:
    blocks = [_block(simulation, at, row) for at in simulation.at for row in range(at.ratio.factor.shape[0])]
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def _block(simulation: Simulation, at: SigmaResult, row: int) -> dict[str, npt.NDArray[Any]]:
    count = at.obstructed.size
    # In the frame of the sample with its lit side in front; directions of transmitted light are mirrored in its plane.
    directions = mirror_in_plane_of_incidence(at.directions) if simulation.task.back else at.directions
    theta, phi = to_specular(at.sigma_deg, mirror_in_sample_plane(directions) if simulation.task.lower else directions)
    wavelength = np.nan if simulation.wavelengths_nm is None else simulation.wavelengths_nm[row]
    azimuth = np.tile(at.detectors.azimuth_deg, at.detectors.polar_deg.size)
    return {
        "wavelength_nm": np.full(count, wavelength),
        "sigma_deg": np.full(count, at.sigma_deg),
        **({"psi_deg": np.full(count, at.psi_deg)} if simulation.task.period_deg else {}),
        "polar_deg": round_deg(np.repeat(at.detectors.polar_deg, at.detectors.azimuth_deg.size)),
        "azimuth_deg": round_deg(wrap_azimuth((-azimuth if simulation.task.back else azimuth) + at.psi_deg)),
        "theta_deg": theta,
        "phi_deg": phi,
        "sample_m2sr": at.ratio.sample_m2sr[row],
        "etalon_m2sr": at.ratio.etalon_m2sr[row],
        "luminance_factor": at.ratio.factor[row],
        "standard_error": at.ratio.standard_error[row],
        "flags": np.where(at.obstructed, "hidden", np.where(at.missed, "no-hits", "")),
    }


def write_figure(figure: "Figure", path: Path, dots_per_inch: int | None = None) -> None:
    """Write a figure as a PNG, completely or not at all; by default with the figure's own resolution. Raises UserError."""
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi="figure" if dots_per_inch is None else dots_per_inch)
    write_file(path, content.getvalue())
