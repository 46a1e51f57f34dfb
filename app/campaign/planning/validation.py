"""Validation of a schedule against a rig, before anything is built: limits of the axes, gains, samples, number of rows,
certificate. Errors state file, key, reason and remedy.
"""

import math
from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np

from goniotwin.app.campaign.geometry.arcs import ArcDirections, lit_sides, observed_directions
from goniotwin.app.campaign.geometry.directions import rig_sigma_deg
from goniotwin.app.campaign.geometry.symmetry import unique_pose_mask
from goniotwin.app.campaign.planning.durations import Timing, min_intervals
from goniotwin.app.campaign.planning.mountings import Pass
from goniotwin.app.campaign.planning.timeline import RowTemplates
from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.campaign.schedule.certificate import Certificate, constant_certificate, parse_certificate, today
from goniotwin.app.campaign.schedule.file import ScheduleDescription, ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, RigDescription, RigFile, axis_settings
from goniotwin.arrays import Floats
from goniotwin.drivers import AxisDescription
from goniotwin.drivers.motion import limit_violation
from goniotwin.twin.optics.geometry.coordinates import incidence_deg

MAX_ROWS = 1_000_000
"""Limit of the number of rows of a campaign."""
LONGEST_CAMPAIGN_S = 366 * 86400.0


def refuse_too_many_rows(schedule: ScheduleDescription) -> None:
    """Raises UserError with the arithmetic if the grids alone give more than MAX_ROWS rows."""
    file = schedule.file
    counts = {
        "samples and etalon": len(file.mounted) + file.signature,
        "sides": len(lit_sides(file)),
        "sigma_deg": len(grid_values(file.sigma_deg)),
        **_turns(file),
        "shift_deg": len(grid_values(file.shift_deg)),
        "wavelength_nm": len(grid_values(file.wavelength_nm)),
        "repeats": file.repeats,
    }
    rows = math.prod(counts.values())
    if rows > MAX_ROWS:
        product = " x ".join(f"{count} {key}" for key, count in counts.items() if count > 1)
        raise UserError(f"{schedule.name}: {product} = {rows} rows, more than {MAX_ROWS}; take coarser grids")
    betas = len(grid_values(file.beta_deg))
    if file.overlap is not None and file.overlap.points > betas:
        raise UserError(
            f"{schedule.name}: overlap.points: {file.overlap.points} betas at each sigma, but beta_deg has {betas}; take fewer"
        )


def _turns(file: ScheduleFile) -> dict[str, int]:
    """Numbers of gammas and betas without those that the symmetry makes superfluous, by key."""
    gammas, betas = grid_values(file.gamma_deg), grid_values(file.beta_deg)
    if file.symmetry == "isotropic":
        poses = np.zeros((len(betas), 4))
        poses[:, 2] = betas
        return {"beta_deg": int(unique_pose_mask(poses, file.symmetry).sum())}
    if file.symmetry == "plane-symmetric" and len(gammas) * len(betas) <= MAX_ROWS:
        poses = np.zeros((len(gammas) * len(betas), 4))
        poses[:, 0], poses[:, 2] = np.repeat(gammas, len(betas)), np.tile(betas, len(gammas))
        return {"pairs of gamma_deg and beta_deg": int(unique_pose_mask(poses, file.symmetry).sum())}
    return {"gamma_deg": len(gammas), "beta_deg": len(betas)}


def refuse_too_many_poses(schedule: ScheduleDescription, mounted: list[list[Pass]]) -> None:
    """Raises UserError if there are too many rows with near_specular, overlap, symmetry_check and open_beam."""
    rows = sum(len(each.grid) for passes in mounted for each in passes)
    if rows > MAX_ROWS:
        wavelengths = len(mounted[0][0].grid.wavelengths_nm)
        passes_of = Counter((each.sample, len(each.grid.poses)) for passes in mounted for each in passes)
        terms = " + ".join(
            f"{sample}: {poses} poses x {wavelengths} wavelengths x {passes} passes"
            for (sample, poses), passes in passes_of.items()
        )
        raise UserError(
            f"{schedule.name}: {terms} = {rows} rows, more than {MAX_ROWS}; take coarser grids, a narrower near_specular, "
            "or less of overlap and symmetry_check"
        )


def min_rows(mounted: list[list[Pass]], templates: RowTemplates, timing: Timing) -> dict[str, int]:
    """Least number of rows of a plan by kind, for any order; from the least time that its rows take to read."""
    file = templates.file
    kinds = {"measure": 0, "drift": 0, "dark": 0}
    for passes in mounted:
        row = templates.measurement(passes[0].sample)
        reading = timing.least_row_s(row)
        rows = sum(len(each.grid) for each in passes)
        checks = 0
        if file.drift is not None and passes[0].sample != NO_SAMPLE:
            checks = 1 + min_intervals(rows, reading, file.drift.every_s)
        kinds["measure"] += rows
        kinds["drift"] += checks
        kinds["dark"] += 1 + min_intervals(rows + checks, reading, file.dark_every_s)
    return kinds


def refuse_too_many_checks(schedule: ScheduleDescription, kinds: Mapping[str, int], about: str = "") -> None:
    """Raises UserError if there are too many rows with dark readings and drift checks; `kinds` has the rows by kind.

    `about` stands before the numbers of dark readings and drift checks, such as "at least ".
    """
    measured, dark_readings, checks = (kinds.get(kind, 0) for kind in ("measure", "dark", "drift"))
    rows = sum(kinds.values())
    if rows > MAX_ROWS:
        file = schedule.file
        terms = [f"{measured} measurements", f"{about}{dark_readings} dark readings (dark_every_s = {file.dark_every_s:g})"]
        if file.drift is not None:
            terms.append(f"{about}{checks} drift checks (drift.every_s = {file.drift.every_s:g})")
        terms += [f"{count} {kind}" for kind, count in kinds.items() if kind not in ("measure", "dark", "drift")]
        raise UserError(
            f"{schedule.name}: {' + '.join(terms)} = {rows} rows, more than {MAX_ROWS}; take longer intervals or coarser grids"
        )


def refuse_too_long(schedule: ScheduleDescription, rig: RigDescription, seconds: float) -> None:
    """Raises UserError for a campaign of more than a year: a speed or a time is wrong, and a rehearsal would have no end."""
    if seconds > LONGEST_CAMPAIGN_S:
        raise UserError(
            f"{schedule.name}: would take {seconds / 86400.0:.3g} days, more than a year; correct the times in it, or the "
            f"speeds and times in {rig.name}"
        )


def refuse_beyond_limits(schedule: ScheduleDescription, rig: RigDescription) -> None:
    """Raises UserError for an angle or a wavelength that the rig does not reach."""
    settings = axis_settings(rig.file)
    for key, axis, value in _angles(schedule.file):
        _check_axis(schedule, rig, key, settings[axis], value)
    table = rig.file.monochromator
    drift = schedule.file.drift
    wavelengths = [("wavelength_nm", each) for each in grid_values(schedule.file.wavelength_nm)]
    for key, wavelength in [*wavelengths, *([("drift.wavelength_nm", drift.wavelength_nm)] if drift else [])]:
        if not table.lowest_nm <= wavelength <= table.highest_nm:
            raise UserError(
                f"{schedule.name}: {key}: {wavelength:g} nm is outside the monochromator's range of "
                f"{table.lowest_nm:g} to {table.highest_nm:g} nm in {rig.name}; remove it from the schedule"
            )


def _angles(file: ScheduleFile) -> Iterator[tuple[str, str, float]]:
    """Key, axis and angle in degrees of all positions of the axes in a schedule."""
    for axis in AXES:
        for value in grid_values(getattr(file, f"{axis}_deg")):
            for angle in [rig_sigma_deg(value, side) for side in lit_sides(file)] if axis == "sigma" else [value]:
                yield f"{axis}_deg", axis, angle
    if file.near_specular is not None and file.near_specular.shift_deg is not None:
        for value in grid_values(file.near_specular.shift_deg):
            yield "near_specular.shift_deg", "shift", value
    if file.drift is not None:
        for axis in AXES:
            yield f"drift.{axis}_deg", axis, getattr(file.drift, f"{axis}_deg")


def _check_axis(schedule: ScheduleDescription, rig: RigDescription, key: str, axis: AxisDescription, value: float) -> None:
    if (violation := limit_violation(axis, value)) is not None:
        raise UserError(f"{schedule.name}: {key}: {value:g} deg is {violation} in {rig.name}; remove it from the schedule")


def gain_numbers(schedule: ScheduleDescription, rig: RigDescription) -> tuple[int, ...]:
    """The gains of a schedule, as numbers in the rig's list. Raises UserError for a gain that the rig does not have."""
    known = rig.file.photodiodes.gains_v_per_a
    wanted = schedule.file.gains_v_per_a
    if wanted == "automatic":
        return tuple(range(len(known)))
    for gain in wanted:
        if gain not in known:
            available = ", ".join(f"{each:g}" for each in known)
            raise UserError(
                f"{schedule.name}: gains_v_per_a: {gain:g} is not a gain of {rig.name}: {available}; choose one of these"
            )
    return tuple(sorted(known.index(gain) for gain in wanted))


def refuse_unknown_samples(schedule: ScheduleDescription, rig: RigDescription) -> None:
    """Raises UserError for a sample that a virtual rig does not have."""
    if rig.file.twin is None:
        return  # at a real rig samples have any names
    known = rig.file.twin.samples
    for sample in schedule.file.mounted:
        if sample not in known:
            available = ", ".join(sorted(known)) or "none"
            raise UserError(
                f"{schedule.name}: there is no sample {sample!r} in {rig.name}: it has {available}; choose one of these"
            )


def refuse_uncertified(schedule: ScheduleDescription, rig: RigFile, poses: Floats) -> None:
    """Raises UserError if a standard's certificate covers no wavelength, or no direction of `poses` (n, 4) of the samples."""
    file, second = schedule.file, schedule.file.second_standard
    stated = []
    if schedule.certificate is not None and file.certificate is not None:
        name = file.certificate.file
        stated.append((f"certificate.file: {name}", parse_certificate(schedule.certificate, name), "there would be no values"))
    if second is not None and second.table is not None:
        table = parse_certificate(second.table, "second_standard.table")
        stated.append(("second_standard.table", table, "it could not be compared"))
    for key, certificate, effect in stated:
        quantity = "wavelengths"
        if certificate.covers("wavelength_nm", np.array(grid_values(file.wavelength_nm))).any():
            quantity = "directions"
            if certified_directions(certificate, observed_directions(file, rig, poses)):
                continue
        raise UserError(
            f"{schedule.name}: {key} covers none of the schedule's {quantity}, so that {effect}: it is valid for "
            f"{certificate}; name a certificate that covers the measurement"
        )


def refuse_future_calibration(schedule: ScheduleDescription, rig: RigFile) -> None:
    """Raises UserError if a standard is calibrated after today: as an age the date would count all the same."""
    certificate, second = schedule.file.certificate, schedule.file.second_standard
    first = "[etalon] of the rig file", constant_certificate(rig.etalon)
    if schedule.certificate is not None and certificate is not None:
        first = f"certificate.file: {certificate.file}", parse_certificate(schedule.certificate, certificate.file)
    stated = [first] if second is None else [first, ("second_standard", second.certificate(first[1]))]
    for key, each in stated:
        if each.calibrated is not None and each.calibrated > today():
            raise UserError(f"{schedule.name}: {key}: calibrated = {each.calibrated} is in the future; correct the date")


def certified_directions(certificate: Certificate, arcs: list[ArcDirections]) -> int:
    """Number of directions that a certificate covers, at the wavelengths that it has."""
    count = 0
    for each in arcs:
        if certificate.covers("incidence_deg", np.array([incidence_deg(each.sigma_deg)])).all():
            polar, azimuth = each.angles_deg.T
            count += int((certificate.covers("zenith_deg", polar) & certificate.covers("azimuth_deg", azimuth)).sum())
    return count
