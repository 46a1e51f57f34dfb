"""The plan: the rows that follow from a schedule on one rig, in order, each with a stable identity.

A row is a commit point. Darks and mountings are rows like any other.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

from app.campaign.row import Row
from app.campaign.schedule import ScheduleDescription, ScheduleFile, grid_values
from app.campaign.timing import Timing
from app.errors import UserError
from app.rig import AXES, RigDescription, arc_clearance, axis_settings
from drivers import LimitError
from drivers.axis import Axis, AxisSettings

MOST_ROWS = 1_000_000


@dataclass(frozen=True)
class Plan:
    """Rows with their foretold durations, on the rig's clock."""

    schedule: ScheduleDescription
    rig: RigDescription
    rows: tuple[Row, ...]

    @property
    def seconds(self) -> float:
        """The whole duration foretold, without the time that a person takes to mount samples."""
        return sum(row.seconds for row in self.rows)


def make_plan(schedule: ScheduleDescription, rig: RigDescription) -> Plan:
    """The rows of a schedule on a rig. Raises UserError for what the rig cannot do, naming file and key."""
    file = schedule.file
    _check_count(schedule)
    _check_limits(schedule, rig)
    gains = _gain_numbers(schedule, rig)
    _check_samples(schedule, rig)
    plan = Plan(schedule, rig, tuple(_timed(_rows(file, gains), file, gains, Timing(rig.file))))
    _check_clearance(plan)
    return plan


def _rows(file: ScheduleFile, gains: tuple[int, ...]) -> Iterator[Row]:
    """Etalon first, then the samples; within each the slowest axis outermost, the wavelength inside."""
    for sample in (file.etalon, *file.samples):
        yield Row(0, f"{sample}/mount", "mount", sample)
        grids = (file.sigma_deg, file.gamma_deg, file.beta_deg, file.shift_deg, file.wavelength_nm)
        for sigma, gamma, beta, shift, wavelength in product(*(grid_values(grid) for grid in grids)):
            identity = f"{sample}/sigma {sigma:.9g}/gamma {gamma:.9g}/beta {beta:.9g}/shift {shift:.9g}/{wavelength:.9g} nm"
            pose = (gamma, sigma, beta, shift)
            yield Row(0, identity, "measure", sample, 0.0, wavelength, pose, gains, file.readings)


def _timed(rows: Iterator[Row], file: ScheduleFile, gains: tuple[int, ...], timing: Timing) -> Iterator[Row]:
    """The rows with numbers and durations, and with the darks between them: at each sample's start and end, and
    wherever the last one would be older than the schedule allows."""
    number = darks = 0
    since_dark = usual = 0.0
    last: Row | None = None

    def dark(sample: str) -> Row:
        nonlocal darks, since_dark
        darks += 1
        since_dark = 0.0
        return Row(0, f"{sample}/dark {darks}", "dark", sample, gains=gains, readings=file.dark_readings)

    def placed(row: Row) -> Row:
        nonlocal number
        timed = replace(row, number=number, seconds=timing.row_seconds(row))
        number += 1
        return timed

    for row in rows:
        if row.kind == "mount":
            if last is not None:
                yield placed(dark(last.sample))
            yield placed(row)
            yield placed(dark(row.sample))
        else:
            # The next row is taken to last as long as the one before.
            if since_dark + usual > file.dark_every_s:
                yield placed(dark(row.sample))
            timed = placed(row)
            since_dark += timed.seconds
            usual = timed.seconds
            yield timed
        last = row
    if last is not None:
        yield placed(dark(last.sample))


def _check_count(schedule: ScheduleDescription) -> None:
    file = schedule.file
    counts = {
        "samples and etalon": len(file.samples) + 1,
        **{
            key: len(grid_values(getattr(file, key)))
            for key in ("sigma_deg", "gamma_deg", "beta_deg", "shift_deg", "wavelength_nm")
        },
    }
    rows = 1
    for count in counts.values():
        rows *= count
    if rows > MOST_ROWS:
        sums = " x ".join(f"{count} {key}" for key, count in counts.items() if count > 1)
        raise UserError(f"{schedule.name}: {sums} = {rows} rows, more than {MOST_ROWS}; take coarser grids")


def _check_limits(schedule: ScheduleDescription, rig: RigDescription) -> None:
    settings = axis_settings(rig.file)
    for axis in AXES:
        for value in grid_values(getattr(schedule.file, f"{axis}_deg")):
            _check_axis(schedule, rig, settings[axis], value)
    table = rig.file.monochromator
    for wavelength in grid_values(schedule.file.wavelength_nm):
        if not table.lowest_nm <= wavelength <= table.highest_nm:
            raise UserError(
                f"{schedule.name}: wavelength_nm: {wavelength:g} nm is outside the monochromator's "
                f"{table.lowest_nm:g} to {table.highest_nm:g} nm in {rig.name}; take it out of the schedule"
            )


def _check_axis(schedule: ScheduleDescription, rig: RigDescription, settings: AxisSettings, value: float) -> None:
    try:
        Axis.check_limits(settings, value)
    except LimitError as error:
        raise UserError(
            f"{schedule.name}: {settings.name}_deg: {value:g} deg is {error.happened} in {rig.name}; "
            "take it out of the schedule"
        ) from None


def _check_clearance(plan: Plan) -> None:
    """No row may have the arc sweep through what it must keep clear of, on its way from the row before."""
    clearance = arc_clearance(plan.rig.file)
    before: Row | None = None
    for row in plan.rows:
        if row.pose is None:
            continue
        last = row.pose if before is None or before.pose is None else before.pose
        reason = clearance.veto((last[2], row.pose[2]), (last[3], row.pose[3]))
        if reason is not None:
            raise UserError(f"{plan.schedule.name}: on the way to {row.identity}: {reason}; change beta_deg or shift_deg")
        before = row


def _gain_numbers(schedule: ScheduleDescription, rig: RigDescription) -> tuple[int, ...]:
    known = rig.file.photodiodes.gains_v_per_a
    for gain in schedule.file.gains_v_per_a:
        if gain not in known:
            has = ", ".join(f"{each:g}" for each in known)
            raise UserError(f"{schedule.name}: gains_v_per_a: {gain:g} is not among those of {rig.name}: {has}; take one")
    return tuple(sorted(known.index(gain) for gain in schedule.file.gains_v_per_a))


def _check_samples(schedule: ScheduleDescription, rig: RigDescription) -> None:
    if rig.file.twin is None:
        return  # what a person mounts has whatever name the person gives it
    known = rig.file.twin.samples
    for sample in (schedule.file.etalon, *schedule.file.samples):
        if sample not in known:
            has = ", ".join(sorted(known)) or "none"
            raise UserError(f"{schedule.name}: there is no sample {sample!r} in {rig.name}: it has {has}; take one")
