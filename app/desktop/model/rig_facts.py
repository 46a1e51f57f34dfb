"""What is known of a rig before a run, collected from the events of its station, its file, and the plan. No Qt."""

import math
import shutil
from datetime import date
from pathlib import Path

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.readout import WarmUpTrace
from goniotwin.app.campaign.row import Row, RowData
from goniotwin.app.campaign.running.events import EventLogged, RowCommitted
from goniotwin.app.campaign.running.stop import BEYOND_LIMIT
from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop.model.messages import Attached, PastRead
from goniotwin.app.desktop.model.preflight import Facts
from goniotwin.app.desktop.model.readings import BenchReadings
from goniotwin.app.rig import RigFile
from goniotwin.app.station.messages import BenchReading, Message, RigClosed, RowSaved, Snapshot, advance
from goniotwin.protocols.clock import ScaledClock, calendar_stamp

ROW_BYTES = 2000
"""Room of a row in a journal beside its counts."""
COUNT_BYTES = 2
DARK_MARGIN = 1.2
"""A dark reading may be older than planned by as much: rows do not last exactly as long as estimated."""


class RigFacts:
    """The facts of one rig at a time. Ages of data count simulated time, whatever the simulation speed was meanwhile."""

    def __init__(self) -> None:
        self._rig_clock = ScaledClock()
        self._ahead_s = 0.0
        self._rig: RigFile | None = None
        self._readings: BenchReadings | None = None
        self._plan: Plan | None = None
        self._folder: Path | None = None
        self.station = Snapshot()
        self._forget()

    def _forget(self) -> None:
        self._dark_s: float | None = None
        self._monitor_s: float | None = None
        self._drift, self._drift_beyond = "", False

    def set_rig(self, rig: RigFile | None) -> None:
        """Take the tables of the open rig; without one, what was known of it is forgotten."""
        self._rig = rig
        self._readings = None if rig is None else BenchReadings(rig)
        self._monitor_s = None
        if rig is None:
            self._forget()

    def set_plan(self, plan: Plan | None) -> None:
        """Take the plan of the run that is prepared."""
        self._plan = plan

    def set_folder(self, folder: Path | None) -> None:
        """Take the folder of data files."""
        self._folder = folder

    def take(self, message: Message | Snapshot) -> None:
        """Take an event of the station, or the snapshot of one that is new."""
        self.station = message if isinstance(message, Snapshot) else advance(self.station, message)
        speed = self.station.speed if self.station.rig is not None and self.station.rig.virtual else 1.0
        if speed != self._rig_clock.speed:
            self._rig_clock.set_speed(speed)
        now = self._rig_clock.now()
        match message:
            case BenchReading(dark=True):
                self._dark_s = now
            case BenchReading(monitor_a=float() as current) if self._readings is not None:
                self._readings.add_monitor(message.t_s, current, message.wavelength_nm)
                self._monitor_s = now
            case RowSaved() if message.row.kind == "dark":
                self._dark_s = now
            case EventLogged(what=what) if is_drift(message):
                self._drift, self._drift_beyond = what, BEYOND_LIMIT in what
            case RigClosed():
                self._forget()

    def add_row(self, row: RowCommitted) -> None:
        """Take the monitor's current of a row that was read with light."""
        if self._readings is not None and row.row.kind in ("measure", "drift") and row.data.readings:
            last = row.data.readings[-1]
            self._readings.add_monitor(last.first_s, last.monitor_a, row.row.wavelength_nm)
            self._monitor_s = min(last.first_s - self._ahead_s, self._rig_clock.now())

    def begin(self, attached: Attached) -> None:
        """Take the state of a station that is new to this window; what was known of another one is forgotten."""
        self._forget()
        self.take(attached.snapshot)
        self._ahead_s = attached.t_s - self._rig_clock.now()
        reading = attached.snapshot.reading
        if reading is not None and reading.dark:
            self._dark_s = reading.t_s - self._ahead_s

    def take_past(self, past: PastRead) -> None:
        """Take what the journal has of the time before; what has been seen since is later."""
        if past.dark_s is not None:
            self._dark_s = max(past.dark_s - self._ahead_s, -math.inf if self._dark_s is None else self._dark_s)
        if past.drift is not None and not self._drift:
            self.take(past.drift)

    def facts(self) -> Facts:
        """The facts now."""
        now = self._rig_clock.now()
        station, rig = self.station, self._rig
        plan, folder = self._plan, self._folder
        schedule = None if plan is None else plan.schedule.file
        certificate = None if schedule is None else schedule.certificate
        axes = {} if rig is None else rig.axes.by_name
        trace: WarmUpTrace | None = None if self._readings is None else self._readings.trend
        return Facts(
            today=date.fromisoformat(calendar_stamp()[:10]),
            devices=station.rig.devices if station.rig else {},
            silent_axes=station.rig.silent_axes if station.rig else (),
            limits_deg={name: (axis.lower_deg, axis.upper_deg) for name, axis in axes.items()},
            positions_deg=station.positions,
            unreferenced=station.unreferenced,
            homes=tuple(name for name, axis in axes.items() if axis.homing is not None),
            monitor=trace,
            monitor_age_s=None if self._monitor_s is None else now - self._monitor_s,
            warm_percent=schedule.warm_up.percent_per_10min if schedule is not None and schedule.warm_up is not None else None,
            dark_age_s=None if self._dark_s is None else now - self._dark_s,
            dark_every_s=None if schedule is None else schedule.dark_every_s,
            speed=self._rig_clock.speed,
            drift=self._drift,
            drift_beyond=self._drift_beyond,
            drift_planned=None if schedule is None else schedule.drift is not None,
            certificate="" if certificate is None else certificate.file,
            expires=None if certificate is None else certificate.expires,
            accepted_by="" if certificate is None else certificate.accept_expired_by or "",
            calibrated=None if rig is None else rig.etalon.calibrated,
            virtual=rig is not None and rig.in_process,
            folder="" if folder is None else str(folder),
            free_bytes=None if folder is None else free_bytes(folder),
            needed_bytes=0 if plan is None else needed_bytes(plan),
        )


class DarkAges:
    """Ages of the dark readings of a run, in the rig's time: they are planned for a computer that keeps up with it.

    A virtual rig in this process has none: where its time is faster, a slow computer makes every reading old.
    """

    def __init__(self, plan: Plan) -> None:
        self._every_s = plan.schedule.file.dark_every_s
        self._virtual = plan.rig.file.in_process
        self._dark_s: float | None = None
        self._stated = False

    def add(self, row: Row, data: RowData) -> EventLogged | None:
        """Take a row; the first that is measured with a dark reading which is too old gives an event."""
        if row.kind == "dark":
            self._dark_s = data.ended_s
        if row.kind not in ("measure", "drift") or self._dark_s is None or self._stated or self._virtual:
            return None
        age_s = data.ended_s - self._dark_s
        if age_s <= DARK_MARGIN * max(self._every_s, row.seconds):
            return None
        self._stated = True
        what = f"the dark reading was {rounded_duration_text(age_s)} old, dark_every_s is {self._every_s:g}"
        return EventLogged("dark", what, row.identity, "")


def is_drift(event: EventLogged) -> bool:
    """Whether an event is that of a drift check."""
    return event.kind == "drift" or (event.kind == "stop" and BEYOND_LIMIT in event.what)


def free_bytes(folder: Path) -> int | None:
    """Free room where a folder is, or will be created; None if that cannot be found out."""
    for place in (folder, *folder.parents):
        if place.is_dir():
            try:
                return shutil.disk_usage(place).free
            except OSError:
                return None
    return None


def needed_bytes(plan: Plan) -> int:
    """Room that the journal of a plan takes, about."""
    photodiodes = plan.rig.file.photodiodes.count
    counts = sum(len(row.gains) * row.readings for row in plan.rows)
    return len(plan.rows) * ROW_BYTES + COUNT_BYTES * photodiodes * counts
