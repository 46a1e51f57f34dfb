"""A campaign without wires: the journal of a plan on a virtual rig, without any device and without waiting.

The plant is set to each row's pose, and its converters are read at times a planned row apart: the light of the fast estimator
with everything that is drawn, its noise, dark currents, gains and drifts, as counts. From there on all is the same, from the
journal to the values. What only devices have is not in it: their statements, ramps and faults.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.readout import GainSequence, further_readings, min_readings
from goniotwin.app.campaign.row import NO_SAMPLE, CommittedRow, Reading, Row, RowData
from goniotwin.app.rig import AXES
from goniotwin.arrays import Counts, Floats
from goniotwin.twin.plant import Plant, TwinModel
from goniotwin.twin.plant.motion import Piece, Trajectory

FULL_STEP = 256
"""Microsteps of a full step of the axes without wires."""
MOVE_S = 0.5
"""Duration of a move without wires; the light is not read during it."""


def run_without_wires(plan: Plan, path: Path) -> None:
    """Write the journal of a plan's campaign on its virtual rig, without any device."""
    model = plan.rig.model()
    assert model is not None
    with Journal.create(path, plan, software_versions(), durable=False) as journal:
        session, now = journal.begin_session(0.0, plan.rig.text, software_versions()), 0.0
        for each in rows_without_wires(plan, model):
            journal.commit(each.row, each.data)
            now = each.data.ended_s
        journal.end_session(session, now, "done")


def rows_without_wires(plan: Plan, model: TwinModel) -> Iterator[CommittedRow]:
    """The rows of a plan, as read from a model."""
    readout = _Readout(plan, model)
    for row in plan.rows:
        yield CommittedRow(row, readout.execute(row))


class _Readout:
    """Rows of a plan, read from the plant itself; `now` is the time on the rig's clock."""

    def __init__(self, plan: Plan, model: TwinModel) -> None:
        self._plant = Plant(model)
        self._settings = plan.rig.file.photodiodes
        self._axes = plan.rig.file.axes.by_name
        self._wheel = plan.rig.file.monochromator.wheel
        self._dark: dict[int, Floats] = {}
        self._gain: int | None = None
        self._pose: dict[str, float] = {}
        self.now = 0.0

    def execute(self, row: Row) -> RowData:
        """The data of one row."""
        started, plant = self.now, self._plant
        if row.kind == "mount":
            plant.mount(None if row.sample == NO_SAMPLE else row.sample, started)
            self.now += 1.0
            return RowData(started, self.now, None, ())
        plant.shutter_open.set(started, row.kind != "dark")
        positions = None if row.kind == "dark" or row.pose is None else self._move(row)  # a warm-up has no pose
        self.now += self._settings.wait_s
        if row.kind == "warm-up":
            self.now += row.longest_s
            return RowData(started, self.now, positions, ())
        gains = GainSequence(row, self._settings, self._gain)
        taken: dict[int, Reading] = {}
        for gain in gains:
            taken[gain] = self._read(row, gain, gains)
            gains.add(taken[gain].counts)
        readings = tuple(taken[gain] for gain in sorted(taken))
        if row.kind == "dark":
            self._dark = {gain: reading.counts.mean(axis=0) for gain, reading in taken.items()}
        self.now = max(self.now, started + row.seconds)
        return RowData(started, self.now, positions, readings, gains.flags)

    def _move(self, row: Row) -> dict[str, float | None]:
        assert row.pose is not None
        assert row.wavelength_nm is not None
        arrived = self.now
        for name, target in zip(AXES, row.pose, strict=True):
            if self._pose.get(name) != target:
                overshoot = self._axes[name].overshoot_deg
                turns_round = (target - self._pose.get(name, 0.0)) * overshoot > 0.0
                legs = [target + overshoot, target] if turns_round else [target]
                for k, at in enumerate(legs):
                    self._drive(name, self.now + k * MOVE_S, at)
                arrived = max(arrived, self.now + len(legs) * MOVE_S)
                self._pose[name] = target
        glass = self._wheel.at(row.wavelength_nm)
        if glass is not None:
            self._plant.wheel.set(self.now, float(glass.position))
        self._plant.wavelength_nm.set(self.now, row.wavelength_nm)
        self.now = arrived
        return dict(self._pose)

    def _drive(self, name: str, t: float, target_deg: float) -> None:
        """One move of an axis: its counter is at the target then, and its true angle is that of its mechanics."""
        shaft = self._plant.shafts[name]
        drive = shaft.drive(t)
        here = drive.counter(t)
        goal = float(round(target_deg / shaft.mechanics.deg_per_full_step * FULL_STEP))
        if goal != here:
            pieces = (Piece(t, here, (goal - here) / MOVE_S, 0.0), Piece(t + MOVE_S, goal, 0.0, 0.0))
            shaft.follow(t, Trajectory(pieces))

    def _read(self, row: Row, gain: int, gains: GainSequence) -> Reading:
        if gain != self._gain:
            for module in self._plant.gain:
                module.set(self.now, gain)
            self._gain, self.now = gain, self.now + self._settings.wait_s
        counts = self._counts(min_readings(row))
        zero = np.full(self._settings.count, self._settings.range.zero)
        first, period = self.now, self._settings.period_s
        while further := further_readings(row, counts, self._dark.get(gain, zero), gains.saturated, self._settings):
            counts = np.concatenate([counts, self._counts(further, len(counts))])
        end = first + (len(counts) - 1) * period
        monitor_a = self._plant.monitor_a(first - period, end)
        self.now = end + period
        return Reading(self._settings.gains_v_per_a[gain], first, period, monitor_a, counts)

    def _counts(self, readings: int, before: int = 0) -> Counts:
        """Counts (readings, photodiodes) from the next conversion on, after so many `before`."""
        plant, settings = self._plant, self._settings
        volts = [
            np.concatenate(
                [plant.volts(module, self.now + (before + k) * settings.period_s) for module in range(plant.modules)]
            )
            for k in range(readings)
        ]
        return np.asarray(settings.range.raw(np.array(volts)[:, : settings.count])).astype(np.uint16)
