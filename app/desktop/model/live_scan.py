"""The scan in progress: the data of the live plot. Plain numbers, no Qt.

A scan is one half plane and the opposite one, at one sample, sigma, gamma and wavelength. Its values come from the steps of the
journal's reduction, applied to the rows committed so far. These are read from the journal once (`model.connection`), and kept
here.

The work for a row does not grow with the rows: the shown scan is reduced, from signals that are kept as long as they are
shown. A new dark reading, and what the rows before it show of noise and gains, change every signal a little; they are computed
again a few at a time. It grows with the drift checks, which are all compared again after a dark reading (a thousand: a quarter
of a second). At the end of the run the values become those of the journal: the evidence of all rows, the field of view from all
half planes, the correction for the band from other wavelengths, and the calibration by overlaps, which needs every scan of the
sample. What the journal alone has: the scale and the field of an open beam's scan, and a repeatability from repeats.
"""

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from goniotwin.app.campaign.geometry.arcs import etalon_sigma_deg, far_arc, lit_arc
from goniotwin.app.campaign.geometry.directions import polar_from_zenith, scan_plane_deg, zenith_deg
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.journal.block_sizes import BlockSizes
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.reduction.calibration import CalibrationFactors
from goniotwin.app.campaign.reduction.components import Signal, mostly_added
from goniotwin.app.campaign.reduction.drift_checks import DriftInterval, drift_intervals
from goniotwin.app.campaign.reduction.etalon import ReferenceSignals, reference_keys
from goniotwin.app.campaign.reduction.evidence import RunningEvidence
from goniotwin.app.campaign.reduction.overlaps import overlap_check
from goniotwin.app.campaign.reduction.pipeline import finish_points, reduce_rows
from goniotwin.app.campaign.reduction.points import BITS, BsdfPoints, pack_flags
from goniotwin.app.campaign.reduction.readings import DarkHistory
from goniotwin.app.campaign.reduction.row_signals import PoseKey, RowSignal, RowSignals, mean_row, pose_key, rows_in_columns
from goniotwin.app.campaign.reduction.settings import reduction_settings
from goniotwin.app.campaign.row import NO_SAMPLE, CommittedRow, Row, reading_table
from goniotwin.app.campaign.running.events import RowCommitted, RowStarted
from goniotwin.app.columns import BitColumn, ColumnTable, Degrees, FlagColumn, NumberColumn
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import ANGLE_LIMITS, PLANE_AXIS, POSITIVE, plane_angle, quantity
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics.geometry.coordinates import incidence_deg, is_lit_from_behind, polar_and_azimuth

Setting = tuple[str, float, float, float]
"""Sample, wavelength, sigma and gamma."""
ScanKey = tuple[Setting, float]
"""A setting and the half plane, 0 to below 180 deg."""
SignalOf = Callable[[CommittedRow], Signal | None]
SIGNALS_AT_ONCE = 64
"""Signals computed for one repaint: some 20 ms."""
MOST_OTHER_ROWS = 1000
GRID_DEG = 0.5
ENDED = object()
PER_SR = "1/sr"
"""The unit of values, as against signals."""


@dataclass(frozen=True, eq=False)
class ScanPoints(ColumnTable):
    """Points of a scan (n,): `x_deg`, and values with their standard uncertainty.

    They may be `blocked` by the mirror unit, `untrusted` for this or another reason, of `transmitted` light, or with a signal
    that is `lost` in its noise, which is the flag under-range of the journal. `added`: their uncertainty is for the most part
    noise (`mostly_added`). `marks` are all flags, as `pack_flags` has them. `directions` (n, 4) are zenith and azimuth from the
    normal, and theta and phi from the specular direction, in degrees.
    """

    x_deg: Degrees
    values: NumberColumn
    u_values: NumberColumn
    blocked: FlagColumn
    untrusted: FlagColumn
    transmitted: FlagColumn
    lost: FlagColumn
    added: FlagColumn
    marks: BitColumn
    directions: Degrees = field(default_factory=lambda: np.empty((0, 4)))

    @property
    def steep(self) -> Flags:
        """The points (n,) that were measured too far apart: their u may be too small."""
        return np.asarray((self.marks & BITS["steep"]) != 0)


EMPTY, NONE = np.empty(0), np.empty(0, dtype=bool)
NO_POINTS = ScanPoints(EMPTY, EMPTY, EMPTY, NONE, NONE, NONE, NONE, NONE, np.empty(0, dtype=np.uint16))


@dataclass(frozen=True)
class ScanData:
    """Data of the plot of a scan, `key`. `blocked_deg` are the intervals of the abscissa that are blocked by the mirror unit.

    `findings` are what the run shows so far of modules and gains, `specular_deg` the place of the specular direction, if any.

    `complete`: all rows so far are in it, with the latest dark readings; otherwise the next call has more.
    """

    title: str
    x_label: str
    y_label: str
    range_deg: tuple[float, float]
    blocked_deg: tuple[tuple[float, float], ...]
    points: ScanPoints
    complete: bool = True
    findings: tuple[str, ...] = ()
    key: ScanKey | None = None
    specular_deg: tuple[float, ...] = ()

    @property
    def is_bsdf(self) -> bool:
        """Whether the values are a BSDF, and no signals."""
        return PER_SR in self.y_label


class LiveScan:
    """The scans of a run, from its events."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._schedule = plan.schedule.file
        self._settings = reduction_settings(
            plan.rig.file, self._schedule, plan.schedule.certificate, "certificate", alignment=plan.rig.alignment
        )
        self._drift_limit = None if self._schedule.drift is None else self._schedule.drift.limit
        self._scans: dict[ScanKey, Row] = {}
        self._key: ScanKey | None = None
        self._rows: dict[Setting, list[CommittedRow]] = {}
        self._references: dict[str, dict[PoseKey, list[CommittedRow]]] = {
            name: {} for name in (*self._schedule.standards, NO_SAMPLE)
        }
        self._dark_rows: list[CommittedRow] = []
        self._dark: DarkHistory | None = None
        self._lit_rows: list[CommittedRow] = []
        self._evidence = RunningEvidence(plan.rig.file)
        self._drift_rows: list[CommittedRow] = []
        self._compared: list[object] = []
        self._intervals: list[DriftInterval] = []
        self._last: CommittedRow | None = None
        self._signals: dict[int, tuple[DarkHistory, Signal]] = {}
        self._shown: set[int] = set()
        self._left = 0
        self._omitted = False
        self._finished = False
        self._calibration: Iterator[None] = iter(())
        self._factors: dict[str, CalibrationFactors] = {}

    @property
    def scans(self) -> tuple[ScanKey, ...]:
        """The scans of the rows so far."""
        return tuple(self._scans)

    def add_row(self, event: RowStarted | RowCommitted) -> None:
        """Add a row."""
        row = event.row
        if row.kind == "measure":
            self._key = scan_key(row)
            self._scans[self._key] = row
        if isinstance(event, RowCommitted):
            self._keep(CommittedRow(row, replace(event.data, positions=None)))
            if event.done == event.total:
                self.finish()

    def finish(self) -> None:
        """Take the rows so far as the whole campaign: no more will come."""
        if not self._finished:
            self._finished = True
            self._calibration = self._complete()

    def data(self, key: ScanKey | None = None) -> ScanData | None:
        """A scan as it is now, the latest if none is named; None before its first row. Raises UserError."""
        key = self._key if key is None else key
        if key is None or key not in self._scans:
            return None
        self._left, self._omitted, self._shown = SIGNALS_AT_ONCE, False, set()
        if self._dark is not None:
            self._update_drift()
            self._omitted |= next(self._calibration, ENDED) is not ENDED
        setting, plane = key
        rows = [each for each in self._rows.get(setting, []) if self._finished or scan_key(each.row)[1] == plane]
        bsdf = self._bsdf(setting, rows)
        if bsdf is None:
            y_label, points = self._signal_label(setting[0]), self._signal_points(rows, plane)
        else:
            light = self._schedule.light
            transmitted = None if light == "both" else light == "transmitted"
            y_label = f"{quantity(transmitted, is_lit_from_behind(setting[2]))}{self._note(setting[0])}"
            here = bsdf.where(scan_plane_deg(bsdf.beta_deg) == plane)
            x = _x_deg(here.zenith_deg, here.azimuth_deg, plane)
            blocked, lost = here.flag("shadowed"), here.flag("under-range")
            added = mostly_added(here.components)
            directions = np.stack([here.zenith_deg, here.azimuth_deg, here.theta_deg, here.phi_deg], axis=1)
            points = _sort(
                ScanPoints(
                    x, here.bsdf, here.u_bsdf, blocked, ~here.good, here.transmitted, lost, added, here.marks, directions
                )
            )
        self._signals = {number: each for number, each in self._signals.items() if number in self._shown}
        return self._describe(self._scans[key], y_label, points)

    def directions(self, row: Row) -> dict[bool, int]:
        """How many directions a row measures of reflected light (False) and of transmitted light, without the blocked ones."""
        assert row.pose is not None
        light = "reflected" if row.sample in self._references else self._schedule.light
        counts = {False: 0, True: 0}
        for view, blocked in self._settings.geometry.views(row.pose):
            if light in ("both", "transmitted" if view.transmitted else "reflected"):
                counts[view.transmitted] += int(np.sum(~blocked))
        return counts

    def _describe(self, row: Row, y_label: str, points: ScanPoints) -> ScanData:
        assert row.pose is not None
        gamma, sigma, beta, _shift = row.pose
        plane = _plane(beta)
        place = "plane of incidence" if plane == 0.0 else f"β {plane:g}°"
        rotation = f", γ {gamma:g}°" if gamma else ""
        return ScanData(
            title=f"{row.sample}: σ {sigma:g}°{rotation}, {place}, {row.wavelength_nm:g} nm",
            x_label=PLANE_AXIS.label if plane == 0.0 else f"polar angle at β {plane:g}° and opposite, deg; {POSITIVE}",
            y_label=y_label,
            range_deg=ANGLE_LIMITS,
            blocked_deg=self._blocked_intervals(row),
            points=points,
            complete=not self._omitted,
            findings=() if self._dark is None else self._dark.evidence.findings,
            key=scan_key(row),
            specular_deg=(incidence_deg(sigma),) if plane == 0.0 else (),
        )

    # The rows.

    def _keep(self, committed: CommittedRow) -> None:
        row, readings = committed.row, committed.data.readings
        if row.kind in ("measure", "drift") and readings:
            self._lit_rows.append(committed)
            self._evidence.add(committed)
        match row.kind:
            case "dark":
                self._dark_rows.append(committed)
                try:
                    self._dark = DarkHistory(self._dark_rows, self._plan.rig.file).up_to_date(self._evidence)
                except UserError:  # too few yet for the noise
                    self._dark = None
            case "mount":
                self._drift_rows.append(committed)
            case "drift" if readings:
                if self._drift_limit is None and self._last is not None:
                    self._drift_rows.append(self._last)
                self._drift_rows.append(committed)
            case "measure" if readings:
                assert row.pose is not None
                self._last = committed
                self._rows.setdefault(scan_key(row)[0], []).append(committed)
                if row.sample in self._references:
                    self._references[row.sample].setdefault(pose_key(row, row.pose), []).append(committed)

    # The reduction.

    def _signal(self, row: CommittedRow) -> Signal | None:
        """The signal of a row, perhaps from before the last dark reading; None if too many were computed for this repaint."""
        number, dark = row.row.number, self._dark
        assert dark is not None
        self._shown.add(number)
        computed_with, signal = self._signals.get(number, (None, None))
        if computed_with is not dark:
            if self._left > 0:
                self._left -= 1
                signal = dark.signal(row)
                self._signals[number] = dark, signal
            else:
                self._omitted = True
        return signal

    def _compute(self, rows: Iterable[CommittedRow]) -> None:
        """Compute the signals of rows together, as many as this repaint has left: one by one takes ten times as long."""
        dark = self._dark
        assert dark is not None
        missing = [row for row in rows if self._signals.get(row.row.number, (None, None))[0] is not dark][: self._left]
        self._left -= len(missing)
        for row, signal in zip(missing, dark.signals(missing) if missing else (), strict=True):
            self._signals[row.row.number] = dark, signal

    def _update_drift(self) -> None:
        """Compare the drift checks again where a row or a signal is new."""

        def signal_of(row: CommittedRow) -> Signal:
            signal = self._signal(row)
            if signal is None:
                self._left += 1  # there is no comparison without it
                signal = self._signal(row)
            assert signal is not None
            return signal

        now: list[object] = [signal_of(each) if each.data.readings else each for each in self._drift_rows]
        if len(now) != len(self._compared) or any(one is not other for one, other in zip(now, self._compared, strict=True)):
            self._compared = now
            self._intervals = drift_intervals(self._drift_rows, signal_of, self._plan.rig.file, self._drift_limit)

    def _row_signals(self, rows: Sequence[CommittedRow], signal_of: SignalOf) -> list[RowSignal]:
        dark = self._dark
        if dark is None:
            return []
        pairs = [(row, signal_of(row)) for row in rows]
        return [dark.row_signal(row, signal, self._intervals) for row, signal in pairs if signal is not None]

    def _reduce(self, rows: Sequence[CommittedRow], signal_of: SignalOf) -> BsdfPoints | None:
        """The points of rows of one setting, not finished yet; None where the etalon has not been measured."""

        def measured(sample: str, keys: list[PoseKey]) -> RowSignals | None:
            found = (self._row_signals(self._references[sample].get(key, []), signal_of) for key in dict.fromkeys(keys))
            return rows_in_columns([mean_row(repeats) for repeats in found if repeats])

        signals = self._row_signals(rows, signal_of)
        columns = rows_in_columns(signals)
        if columns is None:
            return None
        at_sample, at_etalon = reference_keys([each.row for each in signals], self._settings.geometry)
        standards = [measured(name, at_etalon) for name in self._schedule.standards]
        references = ReferenceSignals(standards[0], measured(NO_SAMPLE, at_sample + at_etalon), *standards[1:])
        reduced = reduce_rows(columns, references, replace(self._settings, sample=signals[0].row.sample))
        return None if reduced is None else reduced[1]

    def _bsdf(self, setting: Setting, rows: list[CommittedRow]) -> BsdfPoints | None:
        """The BSDF of rows of a setting; None for what is no sample, and before the etalon has been measured."""
        if setting[0] in self._references:
            return None
        rows = [*rows, *self._other_wavelengths(setting, rows)]
        if self._dark is not None:
            self._compute(rows)
            self._compute(self._reference_rows(rows))
        points = self._reduce(rows, self._signal)
        if points is None:
            return None
        points = points.where(points.wavelength_nm == setting[1])
        return finish_points(points, replace(self._settings, calibration=self._factors.get(setting[0])))

    def _complete(self) -> Generator[None, None, None]:
        """Compute what needs the whole campaign: the evidence of its rows, then the calibration; a part at a time."""
        assert self._dark is not None
        sums = self._dark.sums()
        for begin in range(0, len(self._lit_rows), BlockSizes.rows):
            if begin:
                yield
            sums.add(reading_table(each.data.readings for each in self._lit_rows[begin : begin + BlockSizes.rows]))
        self._dark = self._dark.with_evidence(sums.result())
        if self._settings.calibrates:
            yield from self._calibrate()

    def _other_wavelengths(self, setting: Setting, rows: list[CommittedRow]) -> list[CommittedRow]:
        """At the end, the rows of other wavelengths at the poses of a setting's rows, by which these are corrected.

        None if they are too many for a plot: the values of the journal then differ from those shown by what they correct.
        """
        if not self._finished:
            return []
        sample, wavelength, sigma, gamma = setting
        others = [each for each in sorted(self._rows) if each == (sample, each[1], sigma, gamma) and each[1] != wavelength]
        poses = {each.row.pose for each in rows}
        found = [row for each in others for row in self._rows[each] if row.row.pose in poses]
        return found if len(found) <= MOST_OTHER_ROWS else []

    def _calibrate(self) -> Generator[None, None, None]:
        """Compute the calibration factors of all samples, a few signals at a time."""
        for sample in self._schedule.samples:
            check = overlap_check(self._settings)
            for setting in sorted(each for each in self._rows if each[0] == sample):
                points = yield from self._reduce_slowly(self._rows[setting])
                if points is not None:
                    check.add(points)
            self._factors[sample] = check.result().factors

    def _reduce_slowly(self, rows: list[CommittedRow]) -> Generator[None, None, BsdfPoints | None]:
        """The points of a whole setting, not finished yet; a few signals at a time."""
        signals: dict[int, Signal] = {}
        needed = [*rows, *self._reference_rows(rows)]
        for begin in range(0, len(needed), SIGNALS_AT_ONCE):
            if begin:
                yield
            assert self._dark is not None
            some = needed[begin : begin + SIGNALS_AT_ONCE]
            signals.update(zip((row.row.number for row in some), self._dark.signals(some), strict=True))
        return self._reduce(rows, lambda row: signals[row.row.number])

    def _reference_rows(self, rows: list[CommittedRow]) -> Iterator[CommittedRow]:
        """The rows of the etalon and without a sample that rows need."""
        at_sample, at_etalon = reference_keys([each.row for each in rows], self._settings.geometry)
        for sample, keys in (*((name, at_etalon) for name in self._schedule.standards), (NO_SAMPLE, at_sample + at_etalon)):
            for key in dict.fromkeys(keys):
                yield from self._references[sample].get(key, [])

    # What is shown.

    def _signal_label(self, sample: str) -> str:
        return "photocurrent / monitor" + ("" if sample in self._references else ", until the etalon has been measured")

    def _note(self, sample: str) -> str:
        return ", before the calibration by overlaps" if self._settings.calibrates and sample not in self._factors else ""

    def _signal_points(self, rows: Sequence[CommittedRow], plane: float) -> ScanPoints:
        """Photocurrents over the monitor's current, on the arcs that see the schedule's light; the etalon only reflects.

        Their u has that of the gain, which a BSDF has not where sample and etalon are read at one gain.
        """
        parts = []
        for each in self._row_signals([row for row in rows if scan_key(row.row)[1] == plane], self._signal):
            assert each.row.pose is not None
            light = "reflected" if each.row.sample in self._references else self._schedule.light
            u = np.sqrt(each.signal.variance)
            lost, added = each.signal.lost_in_noise, mostly_added(each.signal.components)
            for view, blocked in self._settings.geometry.views(each.row.pose):
                if light in ("both", "transmitted" if view.transmitted else "reflected"):
                    x = _x_deg(view.zenith, view.azimuth, plane)
                    c, transmitted = view.channels, np.full(len(view.channels), view.transmitted)
                    untrusted = blocked | np.any([flags[c] for flags in each.flags.values()], axis=0)
                    values = each.signal.value[c]
                    marks = pack_flags({name: flags[c] for name, flags in each.flags.items()}, len(c))
                    at = np.stack([view.zenith, view.azimuth, view.theta, view.phi], axis=1)
                    parts.append(ScanPoints(x, values, u[c], blocked, untrusted, transmitted, lost[c], added[c], marks, at))
        return _sort(*parts)

    def _blocked_intervals(self, row: Row) -> tuple[tuple[float, float], ...]:
        assert row.pose is not None
        gamma, sigma, beta, _shift = row.pose
        reflected = row.sample in self._references or self._schedule.light != "transmitted"
        arc = lit_arc(sigma) if reflected else far_arc(sigma)
        plane, signed = _plane(beta), np.arange(-90.0, 90.0 + GRID_DEG, GRID_DEG)
        polar, azimuth = polar_and_azimuth(signed, plane)
        zenith, sigmas = zenith_deg(polar, arc), {sigma, etalon_sigma_deg(sigma, arc)}
        blocked = np.any([blocked_by_mirrors(self._plan.rig.file, at, zenith, azimuth, gamma) for at in sigmas], axis=0)
        x = plane_angle(polar, azimuth, plane)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], blocked, [False]]).astype(np.int8)))
        intervals = []
        for first, after in zip(edges[::2], edges[1::2], strict=True):
            ends = sorted((float(x[first]), float(x[after - 1])))
            intervals.append((ends[0] - 0.5 * GRID_DEG, ends[1] + 0.5 * GRID_DEG))
        return tuple(intervals)


def scan_key(row: Row) -> ScanKey:
    """The scan of a row that measures."""
    assert row.pose is not None
    assert row.wavelength_nm is not None
    gamma, sigma, beta, _shift = row.pose
    return (row.sample, row.wavelength_nm, sigma, gamma), _plane(beta)


def _plane(beta_deg: float) -> float:
    return float(scan_plane_deg(np.array(beta_deg)))


def _x_deg(zenith: Floats, azimuth: Floats, plane_deg: float) -> Floats:
    return plane_angle(polar_from_zenith(zenith), azimuth, plane_deg)


def _sort(*parts: ScanPoints) -> ScanPoints:
    """The points of all parts in the order of the abscissa."""
    points = ScanPoints.join([NO_POINTS, *parts])
    return points.where(np.argsort(points.x_deg, kind="stable"))
