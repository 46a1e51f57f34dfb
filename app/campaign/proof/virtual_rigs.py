"""Virtual rigs that are off by what a rig file states, and their campaigns: through the wires, or without any device.

Without wires the plant is set to each row's pose, and its converters are read at times a planned row apart: the light of the
fast estimator with everything that is drawn, its noise, dark currents, gains and drifts, as counts. From there on all is the
same, from the journal to the values. What only devices have is not in it: their statements, ramps and faults.
"""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import NewPlan
from goniotwin.app.campaign.readout import GainSequence, further_readings, min_readings
from goniotwin.app.campaign.rehearsal.rehearsal import run_on_twin
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.row import NO_SAMPLE, Reading, Row, RowData
from goniotwin.app.campaign.running.events import State
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, RigDescription, parse_rig
from goniotwin.app.rig.uncertainty import UncertaintyTable
from goniotwin.arrays import Counts, Floats
from goniotwin.twin.plant import Disturbances, Plant, TwinModel
from goniotwin.twin.plant.motion import Piece, Trajectory

FULL_STEP = 256
"""Microsteps of a full step of the axes without wires."""
MOVE_S = 0.5
"""Duration of a move without wires; the light is not read during it."""


class DrawnRigs:
    """The virtual rigs of a file: each off by what the file states as uncertain, with everything drawn from its seed.

    Keys that `[twin.disturbances]` has already are kept: a fault of which the rest of the file knows nothing. `etalon`: the
    name of that sample, with the uncertainty of its level by its certificate, and the years since its calibration. Raises
    UserError where the file has no twin.
    """

    def __init__(self, rig: RigDescription, etalon: str, *, level: float, years: float) -> None:
        self._document = tomlkit.parse(rig.text)
        stated: dict[str, Any] = {key: getattr(rig.file.uncertainty, key) for key in _common_keys()}
        stated |= {"etalon": etalon, "certificate_level": level, "etalon_years": years}
        twin = _table(self._document, "twin")
        _add(_table(twin, "disturbances"), stated)
        _add(_table(twin, "electronics"), {"gain_spread": rig.file.photodiodes.gain_uncertainty})
        _add(_table(twin, "monitor"), {"noise": rig.file.monitor.relative_uncertainty})
        self._simulated = _table(self._document, "simulated")
        self._first = parse_rig(tomlkit.dumps(self._document), rig.folder, rig.name)

    def rig(self, seed: int) -> RigDescription:
        """The rig of a seed: its file differs from that of the others in the seed alone."""
        self._simulated["seed"] = seed
        file = self._first.file
        assert file.simulated is not None
        own = replace(file, simulated=replace(file.simulated, seed=seed))
        return replace(self._first, text=tomlkit.dumps(self._document), file=own)


def _common_keys() -> list[str]:
    """The keys of `[uncertainty]` that `[twin.disturbances]` has."""
    known = {each.name for each in fields(Disturbances)}
    return [each.name for each in fields(UncertaintyTable) if each.name in known]


def _table(table: Any, name: str) -> Any:
    if name not in table:
        table[name] = tomlkit.table()
    return table[name]


def _add(table: Any, values: dict[str, Any]) -> None:
    for key, value in values.items():
        if key not in table:
            table[key] = value


def run_with_wires(plan: NewPlan, path: Path) -> None:
    """Run the whole campaign of a plan on its virtual rig, on the virtual clock; the journal is left at `path`.

    Raises UserError where it does not come to its end.
    """
    photodiodes = plan.rig.file.photodiodes
    statistics = RowStatistics(photodiodes, lambda _: np.zeros(photodiodes.count, dtype=bool))
    run = run_on_twin(plan, path, statistics, [])
    if run.state is not State.DONE:
        reason = "; ".join(run.faults) or run.ended_by_schedule
        raise UserError(f"seed {plan.rig.seed}: the campaign ended after {run.rows} of {len(plan.rows)} rows: {reason}")


def run_without_wires(plan: NewPlan, path: Path) -> None:
    """Write the journal of a plan's campaign on its virtual rig, without any device."""
    model = plan.rig.model()
    assert model is not None
    with Journal.create(path, plan, software_versions(), durable=False) as journal:
        session = journal.begin_session(0.0, plan.rig.text, software_versions())
        readout = _Readout(plan, model)
        for row in plan.rows:
            journal.commit(row, readout.execute(row))
        journal.end_session(session, readout.now, "done")


class _Readout:
    """Rows of a plan, read from the plant itself; `now` is the time on the rig's clock."""

    def __init__(self, plan: NewPlan, model: TwinModel) -> None:
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
        positions = None if row.kind == "dark" else self._move(row)
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
