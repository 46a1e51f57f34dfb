"""What a rig cannot do of a schedule, said before anything is built: file, key, reason, remedy."""

from collections.abc import Iterator

from goniotwin.app.campaign.planning.sides import lit_sides, rig_sigma_deg
from goniotwin.app.campaign.schedule.file import ScheduleDescription, ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, RigDescription, axis_settings
from goniotwin.drivers import LimitError
from goniotwin.drivers.axis import Axis, AxisSettings


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
                f"{schedule.name}: {key}: {wavelength:g} nm is outside the monochromator's "
                f"{table.lowest_nm:g} to {table.highest_nm:g} nm in {rig.name}; take it out of the schedule"
            )


def _angles(file: ScheduleFile) -> Iterator[tuple[str, str, float]]:
    """Key, axis and angle in degrees of everything that a schedule has an axis go to."""
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


def _check_axis(schedule: ScheduleDescription, rig: RigDescription, key: str, settings: AxisSettings, value: float) -> None:
    try:
        Axis.check_limits(settings, value)
    except LimitError as error:
        raise UserError(
            f"{schedule.name}: {key}: {value:g} deg is {error.happened} in {rig.name}; take it out of the schedule"
        ) from None


def gain_numbers(schedule: ScheduleDescription, rig: RigDescription) -> tuple[int, ...]:
    """The gains to read at, as numbers in the rig's list. Raises UserError for one that the rig does not have."""
    known = rig.file.photodiodes.gains_v_per_a
    wanted = schedule.file.gains_v_per_a
    if wanted == "automatic":
        return tuple(range(len(known)))
    for gain in wanted:
        if gain not in known:
            has = ", ".join(f"{each:g}" for each in known)
            raise UserError(f"{schedule.name}: gains_v_per_a: {gain:g} is not among those of {rig.name}: {has}; take one")
    return tuple(sorted(known.index(gain) for gain in wanted))


def refuse_unknown_samples(schedule: ScheduleDescription, rig: RigDescription) -> None:
    """Raises UserError for a sample that a virtual rig does not have."""
    if rig.file.twin is None:
        return  # what a person mounts has whatever name the person gives it
    known = rig.file.twin.samples
    for sample in (schedule.file.etalon, *schedule.file.samples):
        if sample not in known:
            has = ", ".join(sorted(known)) or "none"
            raise UserError(f"{schedule.name}: there is no sample {sample!r} in {rig.name}: it has {has}; take one")
