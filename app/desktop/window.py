"""The main window: passes on what the operator does, asks questions, and closes in order.

It shows itself first. Then what makes plans and plots is imported, in a thread; `complete` attaches to the rig's station, or
starts one. The window may be closed during a campaign, which goes on in the station.
"""

import contextlib
import os
import threading
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PySide6.QtCore import QEvent, Qt, QTimer, Signal, Slot
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QApplication, QMainWindow, QPushButton

from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.desktop.campaigns.screen import CampaignsScreen
from goniotwin.app.desktop.close_question import CloseQuestion
from goniotwin.app.desktop.dialogs import TextBox, close_dialog
from goniotwin.app.desktop.event_loop import GarbageCollector
from goniotwin.app.desktop.file_chooser import FileChooser
from goniotwin.app.desktop.menu import Menus, about_text, keys_text
from goniotwin.app.desktop.operator_question import OperatorQuestion
from goniotwin.app.desktop.remembered import Remembered
from goniotwin.app.desktop.run.screen import RunScreen
from goniotwin.app.desktop.setup.screen import SetupScreen
from goniotwin.app.desktop.theme import Scheme, Theme
from goniotwin.app.desktop.view import MainView

if TYPE_CHECKING:
    from goniotwin.app.campaign.planning.plan import Plan
    from goniotwin.app.campaign.running.events import SafetyOrder
    from goniotwin.app.desktop.model.campaigns import Campaign, CampaignsListed
    from goniotwin.app.desktop.model.connection import Connection, Stations
    from goniotwin.app.desktop.model.permissions import Permissions
    from goniotwin.app.desktop.presenter import Presenter
    from goniotwin.app.desktop.run.conclusion import ConclusionControl
    from goniotwin.app.desktop.run.rehearsal import RehearsalControl
    from goniotwin.app.station.messages import QuestionAsked

CLICK_MS = 150
"""Time after which a button whose letter was pressed has been clicked."""
WIDTH, HEIGHT = 1180, 760
"""Size of the first start in logical pixels, on a screen that has it."""
DESKTOP = "goniotwin.app.desktop"
LATER = (
    f"{DESKTOP}.presenter",
    f"{DESKTOP}.model.connection",
    f"{DESKTOP}.run.live_plot",
    f"{DESKTOP}.run.rehearsal",
    f"{DESKTOP}.run.conclusion",
    f"{DESKTOP}.results.panels",
    "qtawesome",
)
"""Modules that are imported after the window has been shown."""


class MainWindow(QMainWindow):
    """One rig, one schedule, one run at a time. Journals are written to `folder`."""

    presenter: "Presenter"
    connection: "Connection"
    rehearsal: "RehearsalControl"
    conclusion: "ConclusionControl"
    imported = Signal()
    campaigns_listed = Signal(object)

    def __init__(
        self,
        theme: Theme,
        rig: Path,
        schedule: Path | None,
        folder: Path,
        speed: float = 1.0,
        remembered: Remembered | None = None,
        stations: "Stations | None" = None,
    ) -> None:
        super().__init__()
        self.theme = theme
        self._first = rig, schedule, speed
        self._remembered = remembered or Remembered()
        self.files = FileChooser(self, folder, self._remembered)
        self._stations = stations
        self._complete = False
        self._listed: CampaignsListed | None = None
        self._unfinished: Campaign | None = None
        self._interrupted: Campaign | None = None
        self._offers = True
        """Until the first run of this window, an interrupted campaign is offered in the notice."""
        self._permissions: Permissions | None = None
        self._plan: Plan | None = None
        self._closed = False
        self._collector = GarbageCollector(self)
        self._collector.start()
        self._import = threading.Thread(target=self._import_later, name="imports")
        self.view = MainView(theme.colours, folder, speed)
        self.setCentralWidget(self.view)
        self.question = OperatorQuestion(self, self.view.question)
        self.close_question = CloseQuestion(self)
        self.menus = Menus(self, self.view, self._remembered)
        self.setWindowTitle("goniotwin")
        self._set_enabled(False)
        self._restore_layout()
        menus = self.menus
        menus.recent_chosen.connect(self.files.choose_recent)
        menus.folder_wanted.connect(self._show_folder)
        menus.scheme_chosen.connect(self._choose_scheme)
        menus.help_wanted.connect(self._show_keys)
        menus.about_wanted.connect(self._show_about)
        self.view.run.hold.ended.connect(close_dialog)
        self.theme.changed.connect(self._recolour)
        self.close_question.close_wanted.connect(self.close)
        self.imported.connect(self.complete, Qt.ConnectionType.QueuedConnection)

    # The start.

    def event(self, event: QEvent) -> bool:
        """Import the rest when the window has been painted; Qt calls it."""
        handled = super().event(event)
        if event.type() == QEvent.Type.Paint and not self._complete and self._import.ident is None:
            self._import.start()
        return handled

    def _import_later(self) -> None:
        with contextlib.suppress(ImportError):  # `complete` meets it again, and shows it
            for name in LATER:
                import_module(name)
        with contextlib.suppress(RuntimeError):  # the window is gone
            self.imported.emit()

    @Slot()
    def complete(self) -> None:
        """Make what takes long to load, and attach to the station. A second call does nothing."""
        if self._complete or self._closed:
            return
        try:
            # Loads 1069 modules, numba and pymodbus among them: 1.4 s, which the window's first picture does without.
            from goniotwin.app.desktop.model.campaigns import CampaignList
            from goniotwin.app.desktop.model.connection import Connection
            from goniotwin.app.desktop.presenter import Presenter
            from goniotwin.app.desktop.run.conclusion import ConclusionControl
            from goniotwin.app.desktop.run.rehearsal import RehearsalControl

            self.view.complete()
        except ImportError as error:
            self.view.show_status(f"{error}; install goniotwin again, with its requirements", error=True)
            return
        self._complete = True
        rig, schedule, speed = self._first
        self.presenter = Presenter(self.view, rig, self, processes=self._stations is None)
        self.rehearsal = RehearsalControl(self, processes=self._stations is None)
        self.conclusion = ConclusionControl(self, processes=self._stations is None)
        self._connect()
        self.connection = Connection(self.presenter.message_received.emit, speed, self._stations, f"window {os.getpid()}")
        self._campaign_list = CampaignList(self.campaigns_listed.emit)
        self._list_campaigns()
        self._open_rig(rig)
        if schedule is not None:
            self._open_schedule(schedule)

    def _restore_layout(self) -> None:
        remembered = self._remembered
        available = self.screen().availableGeometry()
        self.resize(min(WIDTH, available.width()), min(HEIGHT, available.height()))
        if (geometry := remembered.layout("window")) is not None:
            self.restoreGeometry(geometry)
        if (state := remembered.layout("run")) is not None:
            self.view.screen_of(RunScreen).splitter.restoreState(state)
        titles = [each.title for each in self.view.screens]
        if (shown := remembered.text("screen")) in titles:
            self.view.show_screen(titles.index(shown))
        self.view.navigation.buttons[self.view.shown_screen].setFocus()

    def _remember_layout(self) -> None:
        self._remembered.set_layout("window", self.saveGeometry())
        self._remembered.set_layout("run", self.view.screen_of(RunScreen).splitter.saveState())
        self._remembered.set_text("screen", self.view.screens[self.view.shown_screen].title)

    def _connect(self) -> None:
        self.presenter.changed.connect(self._refresh)
        self.presenter.question_asked.connect(self._ask)
        self.presenter.question_closed.connect(self.question.dismiss)
        self.presenter.answer_refused.connect(self.question.show_refusal)
        self.question.answered.connect(self._answer)
        self.question.stop_wanted.connect(self._stop)
        self.presenter.message_shown.connect(self._show_question_facts)
        self.presenter.message_shown.connect(self.question.show_message)
        self.view.devices.shown.connect(self._show_question_facts)
        self.presenter.run_ended.connect(self._after_run)
        self.presenter.notified.connect(self._notify)
        for screen in self.view.screens:
            self.presenter.message_shown.connect(screen.show_message)
            screen.command.connect(self._command)
        run, rig, schedule = self.view.run, self.view.rig, self.view.schedule
        run.start.connect(self._ask_start)
        run.rehearse.connect(self.rehearsal.toggle)
        self.rehearsal.progressed.connect(self._show_rehearsal)
        self.rehearsal.reported.connect(self._show_report)
        run.pause.connect(self._pause)
        run.resume.connect(self._resume)
        run.stop.connect(self._stop)
        run.finish_cut.connect(self._finish_cut)
        run.resume_journal.connect(self._resume_unfinished)
        run.speed_chosen.connect(self._set_speed)
        self.view.orders.acknowledged.connect(self._acknowledge)
        self.view.notice.pressed.connect(self._act_on_notice)
        rig.open.connect(self._choose_rig)
        rig.connect_again.connect(self._connect_again)
        rig.person.toggled.connect(self._set_person)
        schedule.open.connect(self._choose_schedule)
        schedule.choose_folder.connect(self.files.choose_folder)
        self.files.rig_chosen.connect(self._open_rig)
        self.files.schedule_chosen.connect(self._open_schedule)
        self.files.folder_chosen.connect(self._take_folder)
        self.close_question.stop_wanted.connect(self._stop_to_close)
        self.close_question.acknowledge_wanted.connect(self.view.orders.acknowledge)

        setup = self.view.screen_of(SetupScreen)
        setup.saved.connect(self._open_schedule)
        setup.unsaved_changed.connect(self.presenter.set_unsaved)
        setup.reported.connect(self._show_report)
        campaigns = self.view.screen_of(CampaignsScreen)
        self.campaigns_listed.connect(self._show_campaigns, Qt.ConnectionType.QueuedConnection)
        campaigns.refresh_wanted.connect(self._list_campaigns)
        campaigns.resume_wanted.connect(self._resume_journal)
        campaigns.folder_wanted.connect(self._show_folder)
        campaigns.reported.connect(self._show_report)
        self.conclusion.results_wanted.connect(self.view.show_results)
        self.conclusion.report_wanted.connect(campaigns.report)
        self.conclusion.next_wanted.connect(self._take_next_sample)
        self.conclusion.reported.connect(self._show_report)

    def _set_enabled(self, enabled: bool) -> None:
        """Enable what opens files and changes the set-up; the controls of the run have permissions of their own."""
        run = self.view.run
        for button in (*self.view.rig.buttons, self.view.rig.person, *self.view.schedule.buttons):
            button.setEnabled(enabled)
        if not self._complete:
            for control in (run.start_button, run.rehearse_button, run.pause_button, run.finish_button, run.stop_button):
                control.setEnabled(False)
        self.menus.refresh()

    @Slot()
    def _refresh(self) -> None:
        permissions, plan = self.presenter.permissions, self.presenter.plan
        self.question.set_watching(permissions.watching)
        self.view.screen_of(SetupScreen).set_rig(self.presenter.rig)
        if permissions != self._permissions or plan is not self._plan:  # most of hundreds of messages a second change neither
            self._permissions, self._plan = permissions, plan
            self.view.run.set_permissions(permissions)
            self.rehearsal.set_plan(plan, permissions.no_rehearsal)
            self.view.screen_of(CampaignsScreen).set_resume(permissions.refusals["continue"])
            self._offer_unfinished()
            self._set_enabled(permissions.open)
            for screen in self.view.screens:
                screen.set_refusals(permissions.refusals)
        self.setWindowTitle(self.presenter.title)

    @Slot(str, object)
    def _command(self, command: str, arguments: dict[str, object]) -> None:
        self.connection.command(command, **arguments)

    @Slot()
    def _recolour(self) -> None:
        self.view.set_colours(self.theme.colours)

    # The campaigns of the folder.

    @Slot()
    def _list_campaigns(self) -> None:
        self._campaign_list.refresh(self.files.folder)

    @Slot(object)
    def _show_campaigns(self, listed: "CampaignsListed") -> None:
        self._listed = listed
        self.view.screen_of(CampaignsScreen).show_campaigns(listed)
        self._offer_unfinished()

    def _offer_unfinished(self) -> None:
        """Offer to resume the latest unfinished campaign of the open schedule."""
        plan, listed = self.presenter.plan, self._listed
        self._unfinished = None if plan is None or listed is None else listed.unfinished(plan)
        if self._unfinished is None:
            self.view.run.set_unfinished("")
        else:
            each = self._unfinished.summary
            self.view.run.set_unfinished(f"{self._unfinished.path.name}: {each.rows} of {each.planned} rows are measured")
        self.menus.set_pause(self.view.run.resumes)
        self.menus.refresh()
        self._offers = self._offers and not self.presenter.busy
        offered = self._unfinished or (None if listed is None else listed.interrupted)
        refused, notice = self.presenter.permissions.refusals["continue"], self.view.notice
        if self._offers and offered is not None and not refused and notice.action in ("", "continue"):
            self._interrupted, each = offered, offered.summary
            notice.show_notice(f"Interrupted: {each.name}, {each.rows} of {each.planned} rows. Resume?", "continue")
        elif notice.action == "continue":
            notice.clear()

    @Slot()
    def _resume_unfinished(self) -> None:
        if self._unfinished is not None:
            self._resume_journal(self._unfinished.path)

    @Slot(object)
    def _resume_journal(self, journal: Path) -> None:
        self.close_question.keep_open()
        self.view.show_screen(self.view.screens.index(self.view.screen_of(RunScreen)))
        self.presenter.show_starting()
        self.connection.resume_journal(journal)

    @Slot(str, bool)
    def _show_report(self, text: str, error: bool) -> None:
        self.view.show_status(text, error=error)

    # The run.

    @Slot(str)
    def _show_rehearsal(self, progress: str) -> None:
        self.view.run.set_rehearsal(progress)
        self.menus.set_rehearsing(bool(progress))

    @Slot()
    def _ask_start(self) -> None:
        self.rehearsal.before_start(self._start)

    def _start(self) -> None:
        if self.presenter.plan is not None:
            self.conclusion.end()
            self.close_question.keep_open()
            self.view.show_screen(self.view.screens.index(self.view.screen_of(RunScreen)))
            self.presenter.show_starting()
            self.connection.start(self.presenter.plan, self.files.folder)

    @Slot()
    def _pause(self) -> None:
        self.connection.pause()
        self.presenter.show_pausing()

    @Slot()
    def _resume(self) -> None:
        self.connection.resume()

    @Slot()
    def _finish_cut(self) -> None:
        self.connection.finish_cut()
        self.presenter.show_run_status("The run ends after this cut.")

    @Slot()
    def _stop(self) -> None:
        self.connection.stop()
        self.view.show_status("Stop sent to all axes.")
        for button in self.findChildren(QPushButton):
            if button.isDown() and button is not self.view.run.stop_button:
                # Its letter was pressed before: Qt clicks it 0.1 s later, and it would begin what comes after the stop.
                button.blockSignals(True)
                QTimer.singleShot(CLICK_MS, button, partial(button.blockSignals, False))

    @Slot(float)
    def _set_speed(self, speed: float) -> None:
        self.connection.set_speed(speed)

    @Slot(bool)
    def _set_person(self, person: bool) -> None:
        self.connection.set_person(person)

    @Slot(object)
    def _acknowledge(self, order: "SafetyOrder") -> None:
        self.presenter.acknowledge(order)
        self.connection.acknowledge(order)
        if not self.presenter.busy:
            self.close_question.proceed()

    @Slot(str)
    def _act_on_notice(self, action: str) -> None:
        """Do what the button of the notice offers: operate from here, connect again, or resume what a station has left."""
        if action == "operate":
            self.connection.operate()
        elif action == "connect":
            self._connect_again()
        elif action == "continue" and self._interrupted is not None:
            self._resume_journal(self._interrupted.path)
        elif action == "resume" and self.presenter.journal is not None:
            self.presenter.show_opening(self.presenter.rig_path)
            self.presenter.show_starting()
            self.connection.resume_journal(self.presenter.journal)

    @Slot()
    def _after_run(self) -> None:
        self._list_campaigns()
        if self.presenter.done and self.presenter.journal is not None and self.presenter.operates:
            self.conclusion.begin(self.presenter.journal)
        self.question.dismiss()
        self.close_question.proceed()

    @Slot(str)
    def _take_next_sample(self, schedule: str) -> None:
        setup = self.view.screen_of(SetupScreen)
        self.view.show_screen(self.view.screens.index(setup))
        setup.begin_copy(schedule)

    @Slot(str)
    def _notify(self, _what: str) -> None:
        """Call the operator: a sound, and the window's mark in the task bar where it is not in front."""
        if self.menus.sound:
            QApplication.beep()
        QApplication.alert(self)

    # The questions.

    @Slot(object)
    def _ask(self, asked: "QuestionAsked") -> None:
        self.question.ask(asked, self.presenter.station)

    @Slot(int, object, object, object)
    def _answer(self, number: int, answer: Answer, angle_deg: float | None, sample: dict[str, Any]) -> None:
        self.connection.answer(number, answer, angle_deg, sample)

    @Slot()
    def _show_question_facts(self) -> None:
        self.question.show_facts(self.presenter.station)

    # The files.

    @Slot()
    def _choose_rig(self) -> None:
        self.files.choose_rig(self.presenter.rig_path)

    @Slot()
    def _connect_again(self) -> None:
        self._open_rig(self.presenter.rig_path)

    @Slot(object)
    def _open_rig(self, path: Path) -> None:
        self.files.remember("rig", path)
        self.presenter.show_opening(path)
        self.connection.open(path)

    @Slot()
    def _choose_schedule(self) -> None:
        plan = self.presenter.plan
        self.files.choose_schedule(Path(plan.schedule.name) if plan else self.presenter.rig_path)

    @Slot(object)
    def _open_schedule(self, path: Path) -> None:
        def opened() -> None:
            self.files.remember("schedule", path)
            self.connection.load(path)

        self.view.screen_of(SetupScreen).leave(opened)

    @Slot(object)
    def _take_folder(self, folder: Path) -> None:
        self.view.schedule.set_folder(folder)
        self._list_campaigns()

    @Slot()
    def _show_folder(self) -> None:
        if not self.files.show_folder():
            self.view.show_status(f"There is no folder {self.files.folder} yet; the first run creates it.")

    # The window itself.

    @Slot(object)
    def _choose_scheme(self, scheme: Scheme | None) -> None:
        self._remembered.set_text("scheme", scheme or "")
        self.theme.force(scheme)

    @Slot()
    def _show_keys(self) -> None:
        self._show_text("Keys and screens", keys_text(self.view))

    @Slot()
    def _show_about(self) -> None:
        self._show_text("About goniotwin", about_text())

    def _show_text(self, title: str, text: str) -> None:
        """Show a text in a window of its own, which blocks nothing."""
        TextBox(self, title, text).show()

    # The end.

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask during a run, which may go on, and wait for the acknowledgement of every safety order; then leave the station."""
        self._remember_layout()
        setup = self.view.screen_of(SetupScreen)
        if not self._closed and setup.unsaved and not self.close_question.unattended:
            event.ignore()
            setup.leave(self.close)
            return
        if not self._closed and not self.close_question.allows(self.view.orders.orders, busy=self._busy):
            event.ignore()
            return
        self.hide()  # at once, whatever is waited for
        self.shut_down()
        event.accept()

    @property
    def _busy(self) -> bool:
        """Whether a run is in progress."""
        return self._complete and self.presenter.busy

    @property
    def open_orders(self) -> "list[SafetyOrder]":
        """The safety orders that are not acknowledged."""
        return self.connection.open_orders if self._complete else []

    @Slot()
    def close_unattended(self) -> None:
        """Close without a question: after a signal, perhaps without a person at the window. A run goes on in its station."""
        self.close_question.close_unattended()

    @Slot()
    def _stop_to_close(self) -> None:
        if self._busy:
            self._stop()
        else:
            self.close()

    def shut_down(self) -> None:
        """Leave the station, which goes on; nothing is moved. A second call does nothing."""
        if not self._closed:
            self._closed = True
            if self._import.ident is not None:
                self._import.join()
            if self._complete:
                self.presenter.close()
                self.rehearsal.end("")
                self.conclusion.end()
                self.connection.close()
                self._campaign_list.close()
            for screen in self.view.screens:
                screen.shut_down()
            self._collector.stop()
