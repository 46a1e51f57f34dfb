"""The values of a run in progress, and what the twin predicts of them: computed in workers. No Qt."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.rehearsal.without_wires import expected_model, rows_without_wires
from goniotwin.app.campaign.row import NO_SAMPLE, CommittedRow
from goniotwin.app.campaign.running.events import RowCommitted, RowStarted
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule
from goniotwin.app.desktop.model.live_scan import LiveScan, ScanData, ScanKey, Setting, scan_key
from goniotwin.app.desktop.model.watch import RunWatch
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.protocols.clock import RealClock

SCAN_EVERY_S = 0.1
"""Shortest time between two reductions of the scan in progress."""
MORE_READINGS = 16
"""Predicted values are means of so many times the planned readings."""


@dataclass(frozen=True)
class PlanTexts:
    """A plan as texts, from which a worker makes it again: the classes of a rig's tables are made while the program runs."""

    schedule: tuple[str, str]
    certificate: str | None
    rig: tuple[str, Path, str, str | None]

    @classmethod
    def of(cls, plan: Plan) -> "PlanTexts":
        """The texts of a plan."""
        schedule, rig = plan.schedule, plan.rig
        return cls((schedule.text, schedule.name), schedule.certificate, (rig.text, rig.folder, rig.name, rig.alignment))

    @property
    def same(self) -> tuple[str, str | None, str, str | None]:
        """What is equal for plans with the same rows, wherever their files are."""
        return self.schedule[0], self.certificate, self.rig[0], self.rig[3]

    def plan(self) -> Plan:
        """The plan without its rows."""
        return Plan(*self.files(), ())

    def plan_with_rows(self) -> Plan:
        """The plan, made anew. Raises UserError."""
        return make_plan(*self.files())

    def files(self) -> tuple[ScheduleDescription, RigDescription]:
        """Schedule and rig, read anew."""
        return replace(parse_schedule(*self.schedule), certificate=self.certificate), parse_rig(*self.rig)


@dataclass(frozen=True)
class Begin:
    """Request: a run, or a prediction, begins. `number` is in all its answers. No `texts`: there is nothing to compute."""

    number: int
    texts: PlanTexts | None


@dataclass(frozen=True)
class Finish:
    """Request: no more rows will come."""


@dataclass(frozen=True)
class ScanComputed:
    """Answer: a scan of run `number`; `current` if it is the one in progress."""

    number: int
    scan: ScanData
    current: bool


@dataclass(frozen=True)
class DirectionsPlanned:
    """Answer: the number of directions that a plan measures, by setting and whether they are of the transmitted light."""

    number: int
    counts: dict[tuple[Setting, bool], int]


@dataclass(frozen=True)
class ScanPredicted:
    """Answer: the twin's prediction of a scan, all of whose points it has."""

    number: int
    scan: ScanData


@dataclass(frozen=True)
class PredictionEnded:
    """Answer: there are no more predictions; `missing` is the reason why there are none, or empty."""

    number: int
    missing: str = ""


@dataclass(frozen=True)
class WatchRun:
    """Request: watch the rows of run `number` for a misalignment; they follow. No `texts`: there is no run."""

    number: int
    texts: PlanTexts | None


@dataclass(frozen=True)
class MisalignmentFound:
    """Answer: what the residuals of run `number` show, as text, and of which sample; no text: why it is not watched."""

    number: int
    text: str
    where: str


@dataclass(frozen=True)
class Failed:
    """Answer: an error in run `number`, of which no more is computed."""

    number: int
    error: str


class RunValues:
    """The scans of a run: that in progress first, then the others that have changed, each in small portions."""

    def __init__(self, plan: Plan) -> None:
        self._scan = LiveScan(plan)
        self._standards = plan.schedule.file.standards
        self._stale: dict[ScanKey, None] = {}
        self._signals: set[ScanKey] = set()
        self.current: ScanKey | None = None
        """The scan in progress."""
        self._clock = RealClock()
        self._due = 0.0
        self._finished = False

    def add_row(self, event: RowStarted | RowCommitted) -> None:
        """Add a row."""
        self._scan.add_row(event)
        if event.row.kind == "measure":
            self.current = scan_key(event.row)
            self._stale[self.current] = None
            if isinstance(event, RowCommitted) and event.row.sample in self._standards:
                self._stale.update(dict.fromkeys(self._signals))  # they may become values
        elif isinstance(event, RowCommitted) and event.row.kind == "dark" and self.current is not None:
            self._stale[self.current] = None

    def finish(self) -> None:
        """No more rows will come: all scans become those of the journal."""
        self._scan.finish()
        self._finished = True
        self._stale.update(dict.fromkeys(self._scan.scans))

    @property
    def wait_s(self) -> float | None:
        """Seconds until there is something to do; None until the next row."""
        if not self._stale:
            return None
        others = len(self._stale) > 1 or self.current not in self._stale
        return 0.0 if others else max(self._due - self._clock.now(), 0.0)

    def next(self) -> ScanData | None:
        """A scan as it is now; None if there is nothing to do yet. Raises UserError."""
        now = self._clock.now()
        key: ScanKey | None
        if self.current in self._stale and now >= self._due:
            key, self._due = self.current, now + SCAN_EVERY_S
        else:
            key = next((each for each in self._stale if each != self.current), None)
        if key is None:
            return None
        data = self._scan.data(key)
        if data is None or data.complete:
            del self._stale[key]
        if data is not None:
            (self._signals.discard if data.is_bsdf or key[0][0] in (*self._standards, NO_SAMPLE) else self._signals.add)(key)
        return data


def serve_values(connection: "Connection[Any, Any]") -> None:
    """Reduce the rows of one run after the other; the work of a worker."""
    number, values = 0, None
    while True:
        wait = None if values is None else values.wait_s
        while connection.poll(wait):
            wait = 0.0
            request = connection.recv()
            if request is None:
                return
            try:
                match request:
                    case Begin(number, texts):
                        values = None if texts is None else RunValues(texts.plan())
                    case RowStarted() | RowCommitted() if values is not None:
                        values.add_row(request)
                    case Finish() if values is not None:
                        values.finish()
            except Exception as error:  # noqa: BLE001  (any error of the plot: the measurement goes on)
                values = None
                connection.send(Failed(number, f"{type(error).__name__}: {error}"))
        try:
            scan = None if values is None else values.next()
        except Exception as error:  # noqa: BLE001  (as above)
            values = None
            connection.send(Failed(number, f"{type(error).__name__}: {error}"))
        else:
            if scan is not None and values is not None:
                connection.send(ScanComputed(number, scan, scan.key == values.current))


def serve_predictions(connection: "Connection[Any, Any]") -> None:
    """Predict the scans of one plan after the other; a new one ends that in progress. Between them watch a run's rows.

    The work of a worker.
    """
    watch = _Watching(connection)
    waiting: Begin | None = None
    while True:
        while waiting is None or connection.poll(0.0):
            if waiting is None and watch.due and not connection.poll(0.0):
                watch.look()
                continue
            request = connection.recv()
            if request is None:
                return
            if isinstance(request, Begin):
                waiting = request
            else:
                watch.take(request)
        begun, waiting, missing = waiting, None, ""
        try:
            scans: Iterator[ScanData | None] = iter(())
            if begun.texts is not None:
                plan = begun.texts.plan_with_rows()
                connection.send(DirectionsPlanned(begun.number, planned_directions(plan)))
                scans = predicted_scans(plan)
            for scan in scans:
                while waiting is None and connection.poll(0.0):
                    request = connection.recv()
                    if request is None:
                        return
                    if isinstance(request, Begin):
                        waiting = request
                    else:
                        watch.take(request)
                if waiting is not None:
                    break
                if scan is not None:
                    connection.send(ScanPredicted(begun.number, scan))
        except UserError as error:
            missing = str(error)
        except OSError:
            raise  # the window has gone
        except Exception as error:  # noqa: BLE001  (a prediction that fails disturbs nothing)
            missing = f"{type(error).__name__}: {error}"
        connection.send(PredictionEnded(begun.number, missing))


class _Watching:
    """The watch of one run after the other, in a worker."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        self._number = 0
        self._watch: RunWatch | None = None

    @property
    def due(self) -> bool:
        """Whether there is something to look at."""
        return self._watch is not None and self._watch.due

    def take(self, request: object) -> None:
        """Begin with a run, or add a row of it."""
        try:
            match request:
                case WatchRun(number, texts):
                    self._number, self._watch = number, None
                    self._watch = None if texts is None else RunWatch(texts.plan_with_rows())
                case RowCommitted() if self._watch is not None:
                    self._watch.add_row(request)
        except Exception as error:  # noqa: BLE001  (a watch that fails disturbs nothing)
            self._give_up(error)

    def look(self) -> None:
        """Look at the rows so far, and send what was found."""
        try:
            found = [] if self._watch is None else self._watch.look()
        except Exception as error:  # noqa: BLE001  (a watch that fails disturbs nothing)
            self._give_up(error)
        else:
            for each in found:
                self._connection.send(MisalignmentFound(self._number, f"Misalignment: {each.text}", each.sample))

    def _give_up(self, error: Exception) -> None:
        self._watch = None
        self._connection.send(MisalignmentFound(self._number, "", f"{type(error).__name__}: {error}"))


def planned_directions(plan: Plan) -> dict[tuple[Setting, bool], int]:
    """The number of directions that a plan measures, without those that the mirror unit blocks: see `DirectionsPlanned`."""
    live, counts = LiveScan(plan), Counter[tuple[Setting, bool]]()
    for row in plan.rows:
        if row.kind == "measure":
            for transmitted, count in live.directions(row).items():
                counts[scan_key(row)[0], transmitted] += count
    return dict(counts)


def predicted_scans(plan: Plan) -> Iterator[ScanData | None]:
    """The scans of a plan as its twin predicts them: None after a row with which no scan ends.

    They are reduced as those of a run in progress, from the rows before. Their u is that of the planned readings; the values
    are from more of them, because without noise the converter's steps would not average out. Raises UserError.
    """
    model, file = expected_model(plan), plan.schedule.file
    quiet, noisy = LiveScan(plan), LiveScan(plan)
    rows = [replace(row, readings=row.readings * MORE_READINGS) for row in plan.rows]
    longer = Plan(plan.schedule, plan.rig, rows)
    last = {scan_key(row): row.number for row in plan.rows if row.kind == "measure"}
    late: list[ScanKey] = []
    both = zip(rows_without_wires(longer, model), rows_without_wires(plan, model), strict=True)
    for more, planned in both:
        for live, each in ((quiet, more), (noisy, planned)):
            live.add_row(_committed(each))
        row = more.row
        if row.kind != "measure" or last[scan_key(row)] != row.number:
            yield None
            continue
        scan = _predicted(quiet, noisy, scan_key(row))
        if not scan.is_bsdf and row.sample not in (*file.standards, NO_SAMPLE):
            late.append(scan_key(row))
        yield scan
    for key in late:
        yield _predicted(quiet, noisy, key)


def _committed(row: CommittedRow) -> RowCommitted:
    return RowCommitted(row.row, row.data, 0, 1, 0.0)


def _predicted(quiet: LiveScan, noisy: LiveScan, key: ScanKey) -> ScanData:
    values, scatter = (_complete(each, key) for each in (quiet, noisy))
    points = replace(values.points, u_values=scatter.points.u_values, added=scatter.points.added)
    return replace(values, points=points)


def _complete(live: LiveScan, key: ScanKey) -> ScanData:
    while (scan := live.data(key)) is None or not scan.complete:
        pass
    return scan
