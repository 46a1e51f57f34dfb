"""A campaign without wires: the journal of a plan on a virtual rig, without any device and without waiting.

The plant is set to each row's pose, and its converters are read at times a planned row apart: the light of the fast estimator
with everything that is drawn, its noise, dark currents, gains and drifts, as counts. From there on all is the same, from the
journal to the values. What only devices have is not in it: their statements, ramps and faults.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.exposure import exposure_twin
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import NO_SAMPLE, CommittedRow, Reading, Row, RowData
from goniotwin.app.campaign.running.rows import RowExecutor
from goniotwin.app.errors import UserError
from goniotwin.app.rig.alignment import aligned_model, parse_alignment
from goniotwin.arrays import Counts
from goniotwin.drivers import AxisDescription, AxisSettings
from goniotwin.twin.plant import Plant, TwinModel
from goniotwin.twin.plant.motion import Piece, Trajectory
from goniotwin.twin.plant.plant import MODULE_CHANNELS
from goniotwin.twin.plant.shaft import Shaft

FULL_STEP = 256
"""Microsteps of a full step of the virtual rig's axes at their start."""
MOVE_S = 0.5
"""Duration of a move without wires; the light is not read during it."""
MOUNT_S = 1.0
"""Duration of a mounting without wires."""


def run_without_wires(plan: Plan, path: Path, model: TwinModel | None = None) -> None:
    """Write the journal of a plan's campaign, without any device; on its virtual rig, or on a model of one."""
    model = plan.rig.model() if model is None else model
    assert model is not None
    with Journal.create(path, plan, software_versions(), durable=False) as journal:
        session, now = journal.begin_session(0.0, plan.rig.text, software_versions()), 0.0
        for each in rows_without_wires(plan, model):
            journal.commit(each.row, each.data)
            now = each.data.ended_s
        journal.end_session(session, now, "done")


def expected_model(plan: Plan) -> TwinModel:
    """The virtual rig of a plan as its files describe it, with noise of its own. It is off by what an alignment has found.

    Raises UserError where there is none whose signal is computed quickly.
    """
    file = plan.schedule.file
    if plan.rig.file.twin is None:
        raise UserError("the rig file has no [twin] that describes the samples")
    model = exposure_twin(plan.rig, file)
    if model is None:
        raise UserError("the twin of the rig file traces rays, which takes too long")
    if plan.rig.alignment is not None:
        model = aligned_model(model, parse_alignment(plan.rig.alignment, plan.rig.name))
    return replace(model, seed=model.seed + 1, electronics=replace(model.electronics, gain_spread=0.0))


def rows_without_wires(plan: Plan, model: TwinModel) -> Iterator[CommittedRow]:
    """The rows of a plan, as read from a model."""
    executor = PlantExecutor(plan, model)
    for row in plan.rows:
        data = executor.execute(row)
        executor.wait(data.started_s + row.seconds)
        yield CommittedRow(row, replace(data, ended_s=executor.now()))


class PlantExecutor(RowExecutor[float]):
    """Executes rows of a plan on the plant itself. An action is the time at which it is done.

    No count is changed on its way, so that readings are not compared with each other.
    """

    def __init__(self, plan: Plan, model: TwinModel) -> None:
        file = plan.rig.file
        super().__init__(file.photodiodes, file.monochromator.wheel)
        self._plant = Plant(model)
        self._motors = {name: Motor(axis, self._plant.shafts[name]) for name, axis in file.axes.by_name.items()}
        self._now = 0.0

    def now(self) -> float:
        """The time on the rig's clock, s."""
        return self._now

    def wait(self, *started: float) -> None:
        """Let the time pass until all actions are done."""
        self._now = max((self._now, *started))

    def _wait_until(self, t: float) -> None:
        self.wait(t)

    def remember(self, row: Row, data: RowData) -> None:
        """Use the level of a dark reading for the rows that follow."""
        if row.kind == "dark":
            super().remember(row, data)

    def _mount(self, sample: str) -> None:
        self._plant.mount(None if sample == NO_SAMPLE else sample, self._now)
        self._now += MOUNT_S

    def _start_shutter(self, *, opened: bool) -> float:
        self._plant.shutter_open.set(self._now, opened)
        return self._now

    def _start_axis(self, name: str, target_deg: float) -> float:
        return self._motors[name].move(self._now, target_deg)

    def _start_filter(self, position: int) -> float:
        self._plant.wheel.set(self._now, float(position))
        return self._now

    def _start_wavelength(self, wavelength_nm: float) -> float:
        self._plant.wavelength_nm.set(self._now, wavelength_nm)
        return self._now

    def _settle(self, _axes: Sequence[str]) -> None:
        self._now += self._settings.wait_s

    def _start_gain(self, gain: int) -> float:
        for module in self._plant.gain:
            module.set(self._now, gain)
        return self._now + self._settings.wait_s

    def _take(self, _row: Row, gain: int, count: int, before: Reading | None) -> tuple[Reading, bool]:
        period = self._settings.period_s
        first, taken = (self._now, 0) if before is None else (before.first_s, len(before.counts))
        counts = self._counts(first, taken, count)
        if before is not None:
            counts = np.concatenate([before.counts, counts])
        end = first + (len(counts) - 1) * period
        self._now = end + period
        monitor_a = self._plant.monitor_a(first - period, end)
        return Reading(self._settings.gains_v_per_a[gain], first, period, monitor_a, counts), False

    def _counts(self, first: float, taken: int, count: int) -> Counts:
        """Counts (readings, photodiodes) of the conversions that follow those `taken` since `first`."""
        plant, settings = self._plant, self._settings
        volts = np.empty((count, plant.modules, MODULE_CHANNELS))
        for k in range(count):
            for module in range(plant.modules):
                volts[k, module] = plant.volts(module, first + (taken + k) * settings.period_s)
        return np.asarray(settings.range.raw(volts.reshape(count, -1)[:, : settings.count])).astype(np.uint16)

    def _monitor_mean_a(self, seconds: float) -> float:
        begin = self._now
        self._now += seconds
        return self._plant.monitor_a(begin, self._now)

    def _read_back(self) -> dict[str, float | None]:
        return dict(self._commanded)


class Motor:
    """The motor of an axis without wires, which makes the moves of the axis' driver: `axis` is the operator's table.

    An axis of another make has a motor at the shaft of the virtual rig, whose microstep 0 is at 0 deg.
    """

    def __init__(self, axis: AxisDescription, shaft: Shaft) -> None:
        built = shaft.mechanics
        self._shaft = shaft
        self._settings = (
            axis
            if isinstance(axis, AxisSettings)
            else AxisSettings(
                motor=built.motor,
                gear=built.gear,
                sense=built.sense,
                full_steps=built.full_steps,
                lower_deg=axis.lower_deg,
                upper_deg=axis.upper_deg,
                speed_deg_s=axis.speed_deg_s,
                acceleration_deg_s2=axis.speed_deg_s,
                backlash_deg=axis.backlash_deg,
                approach_from=axis.approach_from,
            )
        )
        self._counter = 0
        self._taken_up = self._settings.approach > 0  # as the virtual rig begins

    def move(self, t: float, target_deg: float) -> float:
        """Move to an angle from `t` on, against backlash in two legs; return the time of arrival, s."""
        settings = self._settings
        for leg_deg in settings.legs(settings.angle_deg(self._counter), target_deg, taken_up=self._taken_up):
            counter = settings.counter(leg_deg)
            if counter != self._counter:
                here, goal = (each * FULL_STEP / settings.microsteps for each in (self._counter, counter))
                pieces = (Piece(t, here, (goal - here) / MOVE_S, 0.0), Piece(t + MOVE_S, goal, 0.0, 0.0))
                self._shaft.follow(t, Trajectory(pieces))
            self._counter, t = counter, t + MOVE_S
        self._taken_up = True
        return t
