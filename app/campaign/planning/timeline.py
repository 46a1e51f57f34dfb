"""Passes laid out in time: mountings, darks, drift checks and the warm-up between the measurements, each when it is due.

The rows of a plan: counted and timed at once, made one by one when somebody wants them.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import repeat
from typing import overload

import numpy as np

from goniotwin.app.campaign.geometry.collision import crosses_beam_between
from goniotwin.app.campaign.planning.durations import Timing
from goniotwin.app.campaign.planning.mountings import Pass, drift_point
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.drivers import ArcClearance


@dataclass(frozen=True)
class MeasurementBlock:
    """Measurements without a break: points of a pass by their numbers, in order, with their seconds."""

    scan_pass: Pass
    points: Ints
    seconds: Floats


@dataclass(frozen=True)
class RowTemplates:
    """How every measurement is read, and what a dark after it is."""

    file: ScheduleFile
    gains: tuple[int, ...]

    def measurement(self, sample: str) -> Row:
        """A measurement without a place yet."""
        file, averaging = self.file, self.file.averaging
        return Row(
            0, "", "measure", sample, 0.0, None, None, self.gains, file.readings, file.gains_v_per_a == "automatic",
            None if averaging is None else averaging.relative_uncertainty, 0.0 if averaging is None else averaging.longest_s,
        )  # fmt: skip

    def dark(self, sample: str, number: int) -> Row:
        """Always at every gain: any of them may be needed."""
        return Row(0, f"{sample}/dark {number}", "dark", sample, gains=self.gains, readings=self.file.dark_readings)


@dataclass
class PlanTimeline:
    """Grows piece by piece; a piece is a single row (its number still 0) or a run."""

    file: ScheduleFile
    templates: RowTemplates
    timing: Timing
    clearance: ArcClearance
    pieces: list[Row | MeasurementBlock] = field(default_factory=list)
    oldest_dark_s: float = 0.0
    _darks: int = 0
    _drifts: int = 0
    _since_dark: float = 0.0
    _since_drift: float = 0.0
    _lit_since_dark: bool = False
    _measured_since_drift: bool = False

    def warm_up(self, wavelength_nm: float) -> None:
        """Before anything is mounted."""
        table = self.file.warm_up
        if table is not None:
            target = 0.01 * table.percent_per_10min
            self._add(
                Row(0, "warm-up", "warm-up", NO_SAMPLE, wavelength_nm=wavelength_nm, target=target, longest_s=table.longest_s)
            )

    def mount(self, sample: str) -> None:
        """With a dark and a drift check to begin with."""
        self._add(Row(0, f"{sample}/mount", "mount", sample))
        self._dark(sample)
        self._drift(sample)

    def dismount(self, sample: str) -> None:
        """With a drift check and a dark to end with."""
        self._drift(sample)
        self._dark(sample)

    def measure(self, scan_pass: Pass, sequence: Ints) -> None:
        """All points of a pass in that order. A dark or a drift check comes first wherever it would be overdue afterwards.

        A drift check where the arc would meet the beam on its way there, or back, comes sooner, or later if that cannot be.
        """
        points = scan_pass.grid.points[sequence]
        timing, row = self.timing, self.templates.measurement(scan_pass.sample)
        reading = timing.typical_reading_s(row) + timing.readback_s
        moving = timing.moves.seconds(np.concatenate([timing.here[None], points[:-1]]), points)
        seconds = moving + reading
        ends = np.cumsum(seconds)
        free = self._free_for_a_check(scan_pass.sample, points)
        places = np.array([-1, *np.flatnonzero(free[1:]) + 1, len(points)])
        begin, away, checking = 0, False, False
        while begin < len(points):
            # What came between has closed the shutter, or left the axes elsewhere, or the amplifiers at another gain.
            first = timing.shutter_seconds(opened=True) + timing.next_reading_s(row) - timing.typical_reading_s(row)
            if away:
                back = timing.moves.seconds(timing.here[None], points[begin : begin + 1])
                first += float(back[0] - moving[begin])
            until_dark = self.file.dark_every_s - self._since_dark
            until_drift = self._until_drift(scan_pass.sample)
            next_s = float(seconds[begin]) + first
            # A row that takes longer than either may be old is done all the same, right after it.
            overdue = next_s > until_drift and self._measured_since_drift
            if checking or (overdue and free[begin]):
                self._drift(scan_pass.sample)
                away, checking = True, False
                continue
            if next_s > until_dark and self._lit_since_dark:
                self._dark(scan_pass.sample)
                continue
            began = float(ends[begin]) - next_s
            dark, check = np.searchsorted(ends, (began + until_dark, began + until_drift), side="right").tolist()
            sooner = int(np.searchsorted(places, check, side="right")) - 1
            check = int(places[sooner] if places[sooner] > begin else places[sooner + 1])
            end = max(begin + 1, min(dark, check))
            checking = end == check < len(points)
            timing.switch_shutter(opened=True)
            timing.here = points[end - 1]
            timing.advance(row, end - begin)
            taken = seconds[begin:end].copy()
            taken[0] += first
            self._pass_by(float(taken.sum()))
            self.pieces.append(MeasurementBlock(scan_pass, sequence[begin:end], taken))
            self._measured_since_drift = self._lit_since_dark = True
            begin, away = end, False

    def _free_for_a_check(self, sample: str, points: Floats) -> Flags:
        """Before which of the points (n,) the arc keeps clear of the beam on its way to the pose of the checks and back."""
        there = drift_point(self.file)
        if there is None or sample == NO_SAMPLE:
            return np.ones(len(points), dtype=bool)
        drift = np.broadcast_to(there, points.shape)
        back = ~crosses_beam_between(self.clearance, drift, points)
        back[1:] &= ~crosses_beam_between(self.clearance, points[:-1], drift[1:])
        return back

    def _until_drift(self, sample: str) -> float:
        return float("inf") if self.file.drift is None or sample == NO_SAMPLE else self.file.drift.every_s - self._since_drift

    def _dark(self, sample: str) -> None:
        self._darks += 1
        self._add(self.templates.dark(sample, self._darks))
        self._since_dark = 0.0
        self._lit_since_dark = False

    def _drift(self, sample: str) -> None:
        table = self.file.drift
        if table is None or sample == NO_SAMPLE:  # which sends no light anywhere that could change
            return
        pose = (table.gamma_deg, table.sigma_deg, table.beta_deg, table.shift_deg)
        like = self.templates.measurement(sample)
        row = Row(
            0, f"{sample}/drift {self._drifts + 1}", "drift", sample, 0.0, table.wavelength_nm, pose,
            like.gains, like.readings, like.automatic, like.target, like.longest_s,
        )  # fmt: skip
        taken = copy(self.timing).row_seconds(row)
        if self._lit_since_dark and self._since_dark + taken > self.file.dark_every_s:
            self._dark(sample)
        self._drifts += 1
        self._add(row)
        self._lit_since_dark, self._measured_since_drift = True, False
        self._since_drift = 0.0

    def _add(self, row: Row) -> None:
        seconds = self.timing.row_seconds(row)
        self._pass_by(0.0 if row.kind in ("dark", "mount") else seconds)
        self._since_drift += seconds if row.kind == "dark" else 0.0
        self.pieces.append(replace(row, seconds=seconds))

    def _pass_by(self, seconds: float) -> None:
        self._since_drift += seconds
        if self._darks:
            self._since_dark += seconds
            self.oldest_dark_s = max(self.oldest_dark_s, self._since_dark)


class PlannedRows(Sequence[Row]):
    """Like a tuple of rows. Until one of them is asked for there is none, so that a million can be checked in no time."""

    def __init__(self, pieces: list[Row | MeasurementBlock], templates: RowTemplates) -> None:
        self._pieces = pieces
        self._templates = templates

    @cached_property
    def kinds(self) -> dict[str, int]:
        """How many rows there are of each kind."""
        counted: Counter[str] = Counter()
        for piece in self._pieces:
            counted.update({"measure": len(piece.points)} if isinstance(piece, MeasurementBlock) else {piece.kind: 1})
        return dict(counted)

    @cached_property
    def seconds(self) -> float:
        """The whole duration foretold."""
        return sum(
            float(piece.seconds.sum()) if isinstance(piece, MeasurementBlock) else piece.seconds for piece in self._pieces
        )

    @property
    def pieces(self) -> list[Row | MeasurementBlock]:
        """Single rows, their numbers still 0, and runs of measurements."""
        return self._pieces

    def __len__(self) -> int:
        return sum(self.kinds.values())

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, index: int | slice) -> Row | tuple[Row, ...]:
        return self._rows[index]

    def __iter__(self) -> Iterator[Row]:
        return iter(self._rows)

    def __eq__(self, other: object) -> bool:
        return self._rows == (other._rows if isinstance(other, PlannedRows) else other)

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def _rows(self) -> tuple[Row, ...]:
        rows: list[Row] = []
        for piece in self._pieces:
            if isinstance(piece, MeasurementBlock):
                rows += self._made(piece, len(rows))
            else:
                rows.append(replace(piece, number=len(rows)))
        return tuple(rows)

    def _made(self, run: MeasurementBlock, number: int) -> Iterator[Row]:
        like = self._templates.measurement(run.scan_pass.sample)
        poses, wavelengths = run.scan_pass.poses.angles.tolist(), run.scan_pass.grid.wavelengths_nm.tolist()
        which, when = divmod(run.points, len(wavelengths))
        return map(
            Row, range(number, number + len(run.points)), run.scan_pass.identities(run.points), repeat(like.kind),
            repeat(like.sample),
            run.seconds.tolist(), [wavelengths[k] for k in when.tolist()], [tuple(poses[k]) for k in which.tolist()],
            repeat(like.gains), repeat(like.readings), repeat(like.automatic), repeat(like.target), repeat(like.longest_s),
        )  # fmt: skip
