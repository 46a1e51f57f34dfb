"""Timeline of a plan: passes laid out in time, with mountings, warm-up, dark readings and drift checks where they are due.

The rows are counted and timed at once, and built only when they are read.
"""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import repeat
from typing import NamedTuple, overload

import numpy as np

from goniotwin.app.campaign.geometry.collision import crosses_beam_between
from goniotwin.app.campaign.planning.durations import UNKNOWN_STATE, RigState, Timing
from goniotwin.app.campaign.planning.mountings import Pass, drift_point
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.drivers import ArcClearance


class MeasurementBlock(NamedTuple):
    """Consecutive measurements: points of a pass, given by number, in order, with their seconds."""

    scan_pass: Pass
    points: Ints
    seconds: Floats

    @property
    def total_s(self) -> float:
        """Seconds of all of them."""
        return float(self.seconds.sum() if len(self.seconds) > 1 else self.seconds[0])


class DarkReading(NamedTuple):
    """A dark reading of a mounting, with its `number` among those of the plan and its seconds."""

    sample: str
    number: int
    seconds: float


Piece = Row | MeasurementBlock | DarkReading
"""A part of a plan. Rows are built of it when they are read: every second row may be a dark reading."""
TimeOfDark = tuple[float, int | None]
"""Seconds of a dark reading, and the gain after it."""


@dataclass(frozen=True)
class RowTemplates:
    """Templates of rows: how every measurement is read, and every dark reading. `gains` are numbers in the rig's list."""

    file: ScheduleFile
    gains: tuple[int, ...]

    def measurement(self, sample: str) -> Row:
        """A measurement without number, identity, pose and wavelength."""
        file, averaging = self.file, self.file.averaging
        return Row(
            0,
            "",
            "measure",
            sample,
            0.0,
            None,
            None,
            self.gains,
            file.readings,
            file.gains_v_per_a == "automatic",
            None if averaging is None else averaging.relative_uncertainty,
            0.0 if averaging is None else averaging.longest_s,
        )

    def dark(self, reading: DarkReading, number: int = 0) -> Row:
        """A dark reading as row `number`; always at every gain, because any of them may be needed."""
        sample, identity = reading.sample, f"{reading.sample}/dark {reading.number}"
        return Row(number, identity, "dark", sample, reading.seconds, gains=self.gains, readings=self.file.dark_readings)


@dataclass
class PlanTimeline:
    """The timeline while it is built: single rows (their number still 0) and blocks of measurements.

    `state` is the state of the rig at its end.
    """

    file: ScheduleFile
    templates: RowTemplates
    timing: Timing
    clearance: ArcClearance
    pieces: list[Piece] = field(default_factory=list)
    oldest_dark_s: float = 0.0
    state: RigState = UNKNOWN_STATE
    _dark_times: dict[tuple[bool | None, int | None], TimeOfDark] = field(default_factory=dict)
    _dark_count: int = 0
    _drift_count: int = 0
    _since_dark: float = 0.0
    _since_drift: float = 0.0
    _lit_since_dark: bool = False
    _measured_since_drift: bool = False

    def warm_up(self, wavelength_nm: float) -> None:
        """Add the warm-up, before the first mounting."""
        table = self.file.warm_up
        if table is not None:
            target = 0.01 * table.percent_per_10min
            self._add(
                Row(0, "warm-up", "warm-up", NO_SAMPLE, wavelength_nm=wavelength_nm, target=target, longest_s=table.longest_s)
            )

    def mount(self, sample: str) -> None:
        """Add a mounting, followed by a dark reading and a drift check."""
        self._add(Row(0, f"{sample}/mount", "mount", sample))
        self._dark(sample)
        self._drift(sample)

    def dismount(self, sample: str) -> None:
        """Add the drift check and the dark reading at the end of a mounting."""
        self._drift(sample)
        self._dark(sample)

    def measure(self, scan_pass: Pass, sequence: Ints) -> None:
        """Add all points of a pass in the order of `sequence`.

        A dark reading or a drift check is inserted before a row at whose end it would be overdue. A drift check that the arc
        cannot reach, or cannot leave, without a collision comes sooner, or later where sooner is impossible.
        """
        points = scan_pass.grid.points[sequence]
        timing, row = self.timing, self.templates.measurement(scan_pass.sample)
        similar = timing.similar_reading_s(row)
        moving = timing.moves.seconds(np.concatenate([self.state.point[None], points[:-1]]), points)
        of_rows = moving + (similar + timing.read_back_s)
        timed = of_rows.copy()
        # As lists: there may be as many blocks as rows, and a list is read in a tenth of the time of an array's element.
        seconds, ends = of_rows.tolist(), np.cumsum(of_rows).tolist()
        check_possible = self._check_possible(scan_pass.sample, points)
        check_places = [-1, *(np.flatnonzero(check_possible[1:]) + 1).tolist(), len(points)]
        # There are as many dark readings as rows at most, and the same few states before them.
        extra_s: dict[tuple[bool | None, int | None], float] = {}
        dark_every_s, drift_every_s = self.file.dark_every_s, self._drift_every_s(scan_pass.sample)
        begin, moved_away, check_due = 0, False, False
        while begin < len(points):
            # What came before has closed the shutter, moved the axes away, or left another gain.
            _, shutter_open, gain = self.state
            if (shutter_open, gain) not in extra_s:
                reading_s = timing.reading_s(row, gain)
                extra_s[shutter_open, gain] = timing.shutter_s(self.state, opened=True) + reading_s - similar
            extra = extra_s[shutter_open, gain]
            if moved_away:
                back = timing.moves.seconds(self.state.point[None], points[begin : begin + 1])
                extra += float(back[0] - moving[begin])
            until_dark, until_drift = dark_every_s - self._since_dark, drift_every_s - self._since_drift
            next_s = seconds[begin] + extra
            # A row that takes longer than one of the intervals is measured directly after the dark reading or drift check.
            overdue = next_s > until_drift and self._measured_since_drift
            if check_due or (overdue and check_possible[begin]):
                self._drift(scan_pass.sample)
                moved_away, check_due = True, False
                continue
            if next_s > until_dark and self._lit_since_dark:
                self._dark(scan_pass.sample)
                continue
            start = ends[begin] - next_s
            dark, check = bisect_right(ends, start + until_dark), bisect_right(ends, start + until_drift)
            sooner = bisect_right(check_places, check) - 1
            check = check_places[sooner] if check_places[sooner] > begin else check_places[sooner + 1]
            end = max(begin + 1, min(dark, check))
            check_due = end == check < len(points)
            self.state = RigState(points[end - 1], True, timing.gain_after(row, gain, end - begin))
            timed[begin] = next_s
            block = MeasurementBlock(scan_pass, sequence[begin:end], timed[begin:end])
            self._advance(next_s if end == begin + 1 else block.total_s)
            self.pieces.append(block)
            self._measured_since_drift = self._lit_since_dark = True
            begin, moved_away = end, False

    def _check_possible(self, sample: str, points: Floats) -> Flags:
        """Before which of the points (n,) the arc can go to the pose of the drift checks and back without a collision."""
        check = drift_point(self.file)
        if check is None or sample == NO_SAMPLE:
            return np.ones(len(points), dtype=bool)
        checks = np.broadcast_to(check, points.shape)
        possible = ~crosses_beam_between(self.clearance, checks, points)
        possible[1:] &= ~crosses_beam_between(self.clearance, points[:-1], checks[1:])
        return possible

    def _drift_every_s(self, sample: str) -> float:
        return float("inf") if self.file.drift is None or sample == NO_SAMPLE else self.file.drift.every_s

    def _dark(self, sample: str) -> None:
        self._dark_count += 1
        point, shutter_open, gain = self.state
        if (shutter_open, gain) not in self._dark_times:  # which are those of any dark reading
            seconds, after = self.timing.row(self.state, self.templates.dark(DarkReading(sample, 0, 0.0)))
            self._dark_times[shutter_open, gain] = seconds, after.gain
        seconds, gain = self._dark_times[shutter_open, gain]
        self.state = RigState(point, False, gain)
        self._since_drift += seconds
        self.pieces.append(DarkReading(sample, self._dark_count, seconds))
        self._advance(0.0)
        self._since_dark = 0.0
        self._lit_since_dark = False

    def _drift(self, sample: str) -> None:
        table = self.file.drift
        if table is None or sample == NO_SAMPLE:  # without a sample there is no signal that could drift
            return
        pose = (table.gamma_deg, table.sigma_deg, table.beta_deg, table.shift_deg)
        template = self.templates.measurement(sample)
        row = Row(
            0,
            f"{sample}/drift {self._drift_count + 1}",
            "drift",
            sample,
            0.0,
            table.wavelength_nm,
            pose,
            template.gains,
            template.readings,
            template.automatic,
            template.target,
            template.longest_s,
        )
        seconds, _ = self.timing.row(self.state, row)
        if self._lit_since_dark and self._since_dark + seconds > self.file.dark_every_s:
            self._dark(sample)
        self._drift_count += 1
        self._add(row)
        self._lit_since_dark, self._measured_since_drift = True, False
        self._since_drift = 0.0

    def _add(self, row: Row) -> None:
        seconds, self.state = self.timing.row(self.state, row)
        self._advance(0.0 if row.kind == "mount" else seconds)
        self.pieces.append(replace(row, seconds=seconds))

    def _advance(self, seconds: float) -> None:
        self._since_drift += seconds
        if self._dark_count:
            self._since_dark += seconds
            self.oldest_dark_s = max(self.oldest_dark_s, self._since_dark)


def _joined(blocks: list[MeasurementBlock]) -> MeasurementBlock:
    """Blocks of one pass as one."""
    points, seconds = np.concatenate([each.points for each in blocks]), np.concatenate([each.seconds for each in blocks])
    return MeasurementBlock(blocks[0].scan_pass, points, seconds)


class PlannedRows(Sequence[Row]):
    """Rows of a plan, like a tuple. They are built at the first access, so that a million can be counted and timed quickly."""

    def __init__(self, pieces: list[Piece], templates: RowTemplates) -> None:
        self._pieces = pieces
        self._templates = templates

    @cached_property
    def kinds(self) -> dict[str, int]:
        """Number of rows of each kind."""
        counts: dict[str, int] = {}
        for piece in self._pieces:
            if isinstance(piece, MeasurementBlock):
                kind, rows = "measure", len(piece.points)
            else:
                kind, rows = "dark" if isinstance(piece, DarkReading) else piece.kind, 1
            counts[kind] = counts.get(kind, 0) + rows
        return counts

    @cached_property
    def seconds(self) -> float:
        """Estimated duration of all rows."""
        return sum(piece.total_s if isinstance(piece, MeasurementBlock) else piece.seconds for piece in self._pieces)

    @cached_property
    def ways(self) -> list[Row | MeasurementBlock]:
        """The pieces with a pose or a wavelength; blocks of one pass, with nothing but dark readings between them, are one."""
        found: list[Row | MeasurementBlock] = []
        blocks: list[MeasurementBlock] = []
        for piece in self._pieces:
            if isinstance(piece, MeasurementBlock):
                if blocks and blocks[-1].scan_pass is not piece.scan_pass:
                    found.append(_joined(blocks))
                    blocks = []
                blocks.append(piece)
            elif isinstance(piece, DarkReading):
                continue
            elif piece.pose is not None or piece.wavelength_nm is not None:
                found += [_joined(blocks), piece] if blocks else [piece]
                blocks = []
        return [*found, _joined(blocks)] if blocks else found

    @property
    def pieces(self) -> list[Piece]:
        """Single rows (their number still 0), dark readings, and blocks of measurements."""
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

    @cached_property
    def _rows(self) -> tuple[Row, ...]:
        rows: list[Row] = []
        for piece in self._pieces:
            if isinstance(piece, MeasurementBlock):
                rows += self._block_rows(piece, len(rows))
            elif isinstance(piece, DarkReading):
                rows.append(self._templates.dark(piece, len(rows)))
            else:
                rows.append(replace(piece, number=len(rows)))
        return tuple(rows)

    def _block_rows(self, block: MeasurementBlock, number: int) -> Iterator[Row]:
        """The rows of a block; the first has this number."""
        template, scan_pass = self._templates.measurement(block.scan_pass.sample), block.scan_pass
        poses, wavelengths = scan_pass.poses.angles.tolist(), scan_pass.grid.wavelengths_nm.tolist()
        pose, wavelength = divmod(block.points, len(wavelengths))
        return map(
            Row,
            range(number, number + len(block.points)),
            scan_pass.identities(block.points),
            repeat(template.kind),
            repeat(template.sample),
            block.seconds.tolist(),
            [wavelengths[k] for k in wavelength.tolist()],
            [tuple(poses[k]) for k in pose.tolist()],
            repeat(template.gains),
            repeat(template.readings),
            repeat(template.automatic),
            repeat(template.target),
            repeat(template.longest_s),
        )
