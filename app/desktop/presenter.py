"""The presenter: receives the messages of the connection, keeps the state of rig, plan and run, and shows it in the view."""

from dataclasses import replace
from pathlib import Path

from PySide6.QtCore import QObject, Qt, Signal, Slot

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.running.events import (
    EventLogged,
    Positions,
    RowCommitted,
    RowStarted,
    SafetyOrder,
    State,
    StateChanged,
)
from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop.events.event_log import EventLog
from goniotwin.app.desktop.model.messages import (
    Attached,
    CommandRefused,
    Message,
    NotAttached,
    PastRead,
    PlanBegun,
    PlanMade,
    PlanRefused,
    RunStarted,
    StationLost,
    StopReport,
    ValuesMissing,
)
from goniotwin.app.desktop.model.permissions import Permissions, permissions
from goniotwin.app.desktop.run.countdown import Countdown
from goniotwin.app.desktop.run.live_plot import LivePlot
from goniotwin.app.desktop.run.screen import RunScreen
from goniotwin.app.desktop.view import MainView
from goniotwin.app.station.messages import (
    BUSY,
    ActivityChanged,
    Contact,
    DeviceChanged,
    OperatorChanged,
    OrderAcknowledged,
    QuestionAsked,
    QuestionClosed,
    ReferencesChanged,
    RigClosed,
    RigOpened,
    RowSaved,
    RunBegun,
    RunEnded,
    RunRefused,
    Snapshot,
    SpeedChanged,
    advance,
)
from goniotwin.app.station.messages import Message as StationMessage

MAIN_SWITCH = "Stop did not get through: use the main switch"
STATUS = {
    State.RUNNING: "Running.",
    State.PAUSING: "Pausing after this row.",
    State.PAUSED: "Paused, with the shutter closed. Resume continues with the next row.",
    State.RECOVERING: "Device fault: reconnecting.",
    State.STOPPING: "Stopping.",
}
READY = "Ready to start."
STOPPED_RUN = "Stopped after"
"""Begins the status of a run that was stopped; the axes may report their stop after it."""
END = {State.DONE: "done", State.IDLE: "stopped", State.FAILED: "failed"}


class Presenter(QObject):
    """The state of rig, plan and run, as the messages so far give it.

    `message_received` is the only signal that crosses threads, and `_handle` its only slot: a function that is not a `@Slot`
    would be called in the connection's thread, and crash. Other listeners connect to `message_shown`, which is emitted
    afterwards in the window's thread.
    """

    message_received = Signal(object)
    message_shown = Signal(object)
    changed = Signal()
    question_asked = Signal(object)
    question_closed = Signal()
    answer_refused = Signal(str)
    run_ended = Signal()
    notified = Signal(str)
    """The operator is needed: the end of a run, a fault, a mounting, a lost station."""

    def __init__(self, view: MainView, rig_path: Path, parent: QObject, *, processes: bool = True) -> None:
        super().__init__(parent)
        self.station = Snapshot(activity="")
        self.name = ""
        """This window at the station."""
        self.rig_path = rig_path
        self.plan: Plan | None = None
        self.journal: Path | None = None
        self._view = view
        self._no_plan = ""
        self._unsaved = ""
        self._opening = True
        self._starting = False
        self._pausing = False
        self._lost = False
        self.countdown = Countdown(view.run, lambda: self.busy, lambda: self._stands, self)
        self._log = EventLog(view.log, self)
        self._live_plot = LivePlot(view.plot, view.hemisphere, self, processes=processes)
        self._live_plot.failed.connect(view.set_plot_error)
        self._live_plot.alarmed.connect(self._log.add_alarm)
        self._live_plot.misaligned.connect(self._log.add_misalignment)
        self._live_plot.prediction_missing.connect(self._log.add_missing_prediction)
        view.screen_of(RunScreen).plane_chosen.connect(self._live_plot.show_plane)
        self.message_received.connect(self._handle, Qt.ConnectionType.QueuedConnection)

    @property
    def state(self) -> State:
        """The state of the run, as it is shown: running from the key that starts it."""
        return State.RUNNING if self._starting or self.station.starting else self.station.state

    @property
    def rig(self) -> RigOpened | None:
        """The rig that is open."""
        return self.station.rig

    @property
    def operates(self) -> bool:
        """Whether this window may operate the rig."""
        return self.station.operated_by(self.name)

    @property
    def busy(self) -> bool:
        """Whether a run is in progress."""
        return self.state in BUSY

    @property
    def done(self) -> bool:
        """Whether the last run has measured all rows."""
        return self.state is State.DONE

    @property
    def permissions(self) -> Permissions:
        """Which controls are enabled now."""
        found = permissions(
            self.station,
            self.name,
            None if self._unsaved else self.plan,
            self._no_plan or self._unsaved,
            self.state,
            opening=self._opening,
            lost=self._lost,
        )
        return replace(found, pause=False, resume=True) if self._pausing else found

    @property
    def title(self) -> str:
        """The window's title: rig and progress, which are visible in a task bar too."""
        done, of = self.countdown.progress
        progress = f"{self.state} {100 * done // max(of, 1)} %" if self.busy else str(self.state)
        name = self.rig.name if self.rig else "no rig"
        order = "SAFETY ORDER" if self._view.orders.orders else ""
        return " – ".join(part for part in (order, self._mark, name, progress, "goniotwin") if part)

    def show_opening(self, path: Path) -> None:
        """Show that a rig is being opened."""
        self._opening, self.rig_path = True, path
        self._view.notice.clear()
        self._view.show_status(f"Connecting the devices of {path} …")
        self.changed.emit()

    @Slot(str)
    def set_unsaved(self, reason: str) -> None:
        """Take why the schedule on the screen cannot be started: it differs from its file. Empty where it does not."""
        if reason != self._unsaved:
            self._unsaved = reason
            if not self.busy and self.plan is not None:
                self._view.show_status(f"Start waits: {reason}" if reason else READY)
            self.changed.emit()

    def show_starting(self) -> None:
        """Show that a run is being started; at once, so that Start is disabled for a second click."""
        self._starting = True
        self._view.set_plot_error("")
        if self.rig is None:
            self._view.notice.clear()
            self._view.show_status("Starting a station …")
        self.changed.emit()

    def show_pausing(self) -> None:
        """Show that a pause is asked for; at once, so that the same key again takes it back."""
        self._pausing = self.station.state in (State.RUNNING, State.RECOVERING)
        self.changed.emit()

    def show_run_status(self, text: str) -> None:
        """Show a status of the run, after the question that it waits for."""
        asked = self.station.question
        if asked is not None and self.station.state is not State.STOPPING:
            text = f"Waiting for the operator: {asked.question.title}. {'' if text == STATUS[State.RUNNING] else text}".strip()
        self._view.show_status(text)

    def acknowledge(self, order: SafetyOrder) -> None:
        """Show that a safety order has been acknowledged."""
        self._log.add(f"Acknowledged: {order.order}")
        self.changed.emit()

    def close(self) -> None:
        """Show no further messages."""
        self.countdown.stop()
        self._live_plot.stop()
        self.message_received.disconnect(self._handle)

    @property
    def _mark(self) -> str:
        return f"SIMULATED (seed {self.rig.seed})" if self.rig is not None and self.rig.simulated else ""

    @Slot(object)
    def _handle(self, message: Message) -> None:
        before = self.station
        if isinstance(message, StationMessage):
            self.station = advance(before, message)
        match message:
            case Positions():
                self._show_positions()
            case RowStarted() | RowSaved():
                self._show_row(message)
            case RowCommitted():
                self._live_plot.add_row(message)
            case StateChanged(state, _reason):
                if state not in (State.RUNNING, State.PAUSING) or before.state not in (State.RUNNING, State.PAUSING):
                    self.countdown.interrupt()
                if state is State.RECOVERING and before.state is not State.RECOVERING:
                    self.notified.emit("Device fault")
                self._log.add_state(before.state, state)
                self._pausing = False
                self.show_run_status(STATUS.get(state, self._view.status))
            case EventLogged():
                self._log.add_event(message)
            case PastRead(events):
                for each in events:
                    self._log.add_event(each)
            case SafetyOrder(order, reason):
                self.notified.emit(order)
                if message not in self._view.orders.orders:
                    where = self.rig.name if self.rig is not None else ""
                    self._view.orders.add(message)
                    self._log.add(f"Safety order: {order}: {reason}", where, "stays until it is acknowledged", serious=True)
            case OrderAcknowledged(order):
                if self._view.orders.remove(order):  # by another client
                    self._log.add(f"Acknowledged: {order.order}")
            case RunBegun(journal, name, done, total, seconds_left, person):
                self._starting = False
                self._view.rig.person.setChecked(person)
                self.journal = journal
                self._begin_countdown(done, total, seconds_left)
                self._view.set_saved(f"Saved row by row in {journal}")
                begun, rows = ("resumed", f"{done} of {total} rows are kept") if done else ("started", f"{total} rows")
                self._log.add(f"Run of {name} {begun}", journal.name, rows)
            case RunStarted(plan, _journal, mountings):
                self.countdown.mountings = mountings
                self._live_plot.start(plan, self._mark)
            case ValuesMissing(reason):
                self._view.set_plot_error(f"The values cannot be shown: {reason}; the run is not affected.")
            case RunEnded():
                self._show_end(message)
            case RunRefused(reason):
                self._starting = False
                self._view.show_status(f"Not started: {reason}", error=True)
                self._log.add(f"Not started: {reason}", serious=True)
                self.run_ended.emit()
            case QuestionAsked(_number, question):
                self.countdown.interrupt()
                self.show_run_status("")
                self._log.add(f"Question to the operator: {question.title}", "", "the run waits")
                self.question_asked.emit(message)
                self.notified.emit(question.title)
            case QuestionClosed():
                self.countdown.interrupt()
                self.show_run_status(STATUS.get(self.state, self._view.status))
                self.question_closed.emit()
            case PlanBegun() | PlanMade() | PlanRefused():
                self._show_plan(message)
            case RigOpened() | RigClosed() | DeviceChanged():
                self._show_rig(message, busy=before.busy or self._starting)
            case Attached() | NotAttached() | StationLost():
                self._show_station(message)
            case CommandRefused(command, reason):
                self._pausing = False
                self._view.show_status(f"Not done: {command}: {reason}", error=True)
                self._view.run.show_speed(self.station.speed)
                if command == "answer" and self.station.question is not None:
                    self.answer_refused.emit(reason)
            case ReferencesChanged():
                self._show_positions()
            case ActivityChanged():
                self._show_activity(before.activity, message)
            case StopReport():
                self._show_stop(message)
            case SpeedChanged(speed):
                self._set_pace_speed()
                self._view.run.show_speed(speed)
                self.countdown.show()
            case OperatorChanged():
                self._show_operator()
        now = self.station
        if now.rig is not before.rig:
            self._show_positions()
        if (now.rig is None, now.bench, now.lamp) != (before.rig is None, before.bench, before.lamp):
            self._view.strip.set_light(now.bench if now.rig is not None else None, now.lamp)
        if not isinstance(message, Positions):
            self.changed.emit()
        self.message_shown.emit(message)

    def _show_station(self, message: Attached | NotAttached | StationLost) -> None:
        """Show that there is a station, or why there is none."""
        self._view.notice.clear()
        match message:
            case Attached(name, snapshot, found, dropped):
                self.station, self.name, self._lost = snapshot, name, False
                self._view.run.show_speed(snapshot.speed)
                self._set_pace_speed()
                if dropped:
                    self._log.add("This window was detached from the station", "", dropped, serious=True)
                if snapshot.rig is not None:
                    self._show_rig(snapshot.rig, busy=False)
                elif snapshot.closed:
                    self._show_rig(RigClosed(snapshot.closed), busy=False)
                if found:
                    self._attach(snapshot)
            case NotAttached(reason):
                self.name = ""
                self.station = _without_station(self.station)
                self._show_closed(reason)
            case StationLost(last):
                self._show_lost(last)

    def _attach(self, snapshot: Snapshot) -> None:
        """Show what a station that was there already does."""
        self._log.add("Attached to a station that was running", snapshot.campaign, str(snapshot.state))
        for order in snapshot.orders:
            self._view.orders.add(order)
        if snapshot.busy and snapshot.journal is not None:
            self.journal = snapshot.journal
            self._view.rig.person.setChecked(snapshot.person)
            self._begin_countdown(snapshot.done, snapshot.total, snapshot.seconds_left)
            self._view.set_saved(f"Saved row by row in {snapshot.journal}")
            self.show_run_status(STATUS.get(snapshot.state, ""))
            if snapshot.row is not None:
                self.countdown.begin_row(-1 if snapshot.row.unplanned else snapshot.row.number)
                self._view.axes.set_targets(snapshot.row.pose)
        if snapshot.question is not None:
            self.question_asked.emit(snapshot.question)
        self._show_operator()

    def _show_lost(self, last: Snapshot) -> None:
        """Show that the station has ended: in good order, or what that means for the instrument, and how to go on."""
        running = last.busy
        self._lost = not last.given_back
        self.station = replace(_without_station(last), closed="the station has ended")
        self._starting = False
        self._show_closed("", keep_plots=True)
        self.question_closed.emit()
        if last.given_back:
            text = f"The rig is free{f': {last.closed}' if last.closed else ''}. No rig is open here."
            self._view.notice.show_notice(text, "connect")
            self._view.show_status(text)
            return
        if running and last.journal is not None:
            kept = f"{last.done} of {last.total} rows are kept in {last.journal.name}"
            text = (
                f"The station has ended during the run: {kept}. The axes stop by the controller's heartbeat; "
                "the shutter may be open."
            )
            self.journal = last.journal
            self._view.notice.show_notice(text, "resume")
            self._live_plot.finish()
            self.run_ended.emit()
        else:
            text = "The station has ended. The axes stop by the controller's heartbeat; the shutter may be open."
            self._view.notice.show_notice(text, "connect")
        self._view.show_status(text, error=True)
        self.notified.emit("The station has ended")
        self._log.add(text, self.rig_path.name, "no rig is open", serious=True)

    def _show_operator(self) -> None:
        if not self.operates:
            text = f"{self.station.operator} operates this rig; this window watches. Stop works from here too."
            self._view.notice.show_notice(text, "operate")
        elif self._view.notice.action == "operate":
            self._view.notice.clear()

    def _show_activity(self, before: str, now: ActivityChanged) -> None:
        activity, error = now.activity, now.error
        if activity:
            self.show_run_status(f"{activity[0].upper()}{activity[1:]} …")
        elif error:
            self._view.show_status(error, error=error != "stopped")
            if error != "stopped":
                self._log.add(error, serious=True, detail=now.detail)
        elif before:
            self.show_run_status(f"Done: {before}.")

    def _show_stop(self, report: StopReport) -> None:
        if report.lost:
            self._view.show_status(MAIN_SWITCH, error=True)
            self._log.add(MAIN_SWITCH, serious=True)
        elif report.confirmed and not self.busy and not self._view.status.startswith(STOPPED_RUN):
            self._view.show_status("All axes have stopped.")

    def _show_plan(self, message: PlanBegun | PlanMade | PlanRefused) -> None:
        if isinstance(message, PlanBegun):
            self._set_plan(None)
            self._no_plan = f"{message.name} is being read"
            if not self.busy:
                self._view.show_status(f"Reading {message.name} …")
            return
        if isinstance(message, PlanMade):
            self._set_plan(message.plan)
            self._no_plan = ""
            if not self.busy:
                self._live_plot.predict(message.plan)
                self.countdown.show_progress(0, len(message.plan.rows), message.plan.seconds)
                self.countdown.show()
                if self.rig is not None and not self._show_not_responding(self.rig):
                    self._view.show_status(READY)
        else:
            self._set_plan(None)
            self._no_plan = message.reason
            if not self.busy:
                self.countdown.show_progress(0, 0, None)
            if self.rig is not None:
                self._view.show_status(message.reason, error=True)
                self._log.add(message.reason, "schedule", "there is no plan to start", serious=True)
        self._view.schedule.set_plan(self.plan)

    def _show_rig(self, message: RigOpened | RigClosed | DeviceChanged, *, busy: bool) -> None:
        match message:
            case RigOpened(name=name, simulated=simulated, seed=seed, devices=devices):
                self._opening = False
                self.rig_path = message.path
                self._set_plan(None)  # made for the previous rig; the plan for this one follows
                self._view.set_simulated(simulated, seed)
                self._view.run.set_virtual(message.virtual)
                if not busy:
                    self._live_plot.start(None, self._mark)
                if self._show_not_responding(message):
                    for device in message.not_responding:
                        status = devices[device]
                        self._log.add(status.text, device, "no run can start", serious=True, detail=status.detail)
                else:
                    self._view.show_status("All devices are connected.")
                    self._log.add("All devices are connected", name)
            case RigClosed(reason, fault):
                self._starting = False
                self._show_closed(reason, fault=fault, keep_plots=True)
                if busy:
                    self.run_ended.emit()
            case DeviceChanged(device, status) if self.rig is not None:
                if status.contact is Contact.DISCONNECTED and not self.busy:  # a run's events have its faults
                    self._view.show_status(status.error, error=True)
                    lost = "no run can start before it is connected again"
                    self._log.add(status.error, device, lost, serious=True, detail=status.detail)
                elif status.connected and not self.busy:
                    self._log.add("Connected", device)
        self._view.rig.set_rig(self.rig, self.rig_path)

    def _show_positions(self) -> None:
        now = self.station
        self._view.axes.set_positions(now.positions, {axis: now.encoders.get(axis) for axis in now.unreferenced})

    def _show_not_responding(self, rig: RigOpened) -> bool:
        """Show which devices do not respond; return whether there are any."""
        if rig.not_responding:
            names = " and ".join(rig.not_responding)
            text = f"Not responding: {names}. See the screen Rig for the reason, then connect again."
            self._view.show_status(text, error=True)
        return bool(rig.not_responding)

    def _show_closed(self, reason: str, *, fault: bool = True, keep_plots: bool = False) -> None:
        """Show that no rig is open. Plots that stay have their mark, in the banner too."""
        self._opening = False
        self.station = replace(
            self.station, rig=None, state=State.IDLE, activity="", question=None, closed=reason or self.station.closed
        )
        self._set_plan(None)
        self._view.axes.set_targets(None)
        self.countdown.end()
        if not keep_plots:
            self._view.set_simulated(False, None)
            self._live_plot.start(None, "")
        self._view.show_status(reason, error=fault)
        if reason:
            self._log.add(reason, self.rig_path.name, "no rig is open", serious=fault)
        self._view.rig.set_rig(None, self.rig_path)

    def _show_row(self, event: RowStarted | RowSaved) -> None:
        if isinstance(event, RowStarted):
            self._view.axes.set_targets(event.row.pose)
            if self.state is State.RUNNING:
                done, of = self.countdown.progress
                self.show_run_status(f"{_row_words(event.row)} (row {min(done + 1, of)} of {of})")
            if not event.row.unplanned:
                self.countdown.begin_row(event.row.number)
            self._live_plot.add_row(event)
        else:
            self.countdown.end_row(event)
            self._log.count_flags(event)

    def _set_plan(self, plan: Plan | None) -> None:
        self.plan = plan
        self.countdown.planned_s = None if plan is None else plan.seconds

    def _begin_countdown(self, done: int, total: int, seconds_left: float) -> None:
        self._set_pace_speed()
        self.countdown.begin(done, total, seconds_left)

    def _set_pace_speed(self) -> None:
        virtual = self.rig is None or self.rig.virtual
        self.countdown.set_speed(self.station.speed if virtual else 1.0)

    @property
    def _stands(self) -> bool:
        """Whether the run waits for a person."""
        return self.station.question is not None or self.state is State.PAUSED

    def _show_end(self, end: RunEnded) -> None:
        self.journal = end.journal
        self._log.add_flags()
        self._live_plot.finish()
        self._view.axes.set_targets(None)
        done, of = self.countdown.progress
        self.countdown.end()
        failed = end.state is State.FAILED
        self._log.add(
            f"Run ended: {END[end.state]} after {done} of {of} rows",
            end.journal.name,
            "measured rows are saved",
            serious=failed,
        )
        if end.state is State.DONE:
            self._view.show_status(f"Done: {done} of {of} rows.")
        elif end.state is State.IDLE:
            why = "" if end.reason in ("", "stopped") else f": {end.reason}"
            self._view.show_status(
                f"{STOPPED_RUN} {done} of {of} rows{why}. They are saved. Resume continues, Start begins a new campaign."
            )
        else:
            self._view.show_status(f"Failed after {done} of {of} rows, which are saved: {end.reason}", error=True)
        self._view.set_saved(f"Saved in {end.journal}")
        self.notified.emit(f"Run {END[end.state]}")
        self.run_ended.emit()


def _without_station(last: Snapshot) -> Snapshot:
    """What stays of the last known state of a station that there is none of any more."""
    return Snapshot(orders=last.orders, speed=last.speed, activity="")


def _row_words(row: Row) -> str:
    """A row in words: `Measuring satin, σ 30°, γ 0°, β 180°, shift 2.5°, 550 nm`."""
    sample = "an empty sample unit" if row.sample == NO_SAMPLE else row.sample
    match row.kind:
        case "mount":
            return f"Mounting {sample}"
        case "dark":
            return f"Dark reading with the shutter closed, at {sample}"
        case "warm-up":
            return f"Warming up the lamp, at most {rounded_duration_text(row.longest_s)}"
    what = "Drift check of" if row.kind == "drift" else "Measuring"
    return ", ".join([f"{what} {sample}", *_pose_words(row)])


def _pose_words(row: Row) -> list[str]:
    wavelength = [] if row.wavelength_nm is None else [f"{row.wavelength_nm:g} nm"]
    if row.pose is None:
        return wavelength
    gamma, sigma, beta, shift = row.pose
    return [f"σ {sigma:g}°", f"γ {gamma:g}°", f"β {beta:g}°", f"shift {shift:g}°", *wavelength]
