"""The countdown of a run: the time left until its end, and until a person mounts the next sample."""

from collections.abc import Callable

from PySide6.QtCore import QDateTime, QObject, QTimer, Slot

from goniotwin.app.desktop.model.time_left import Mounting, TimeLeft, Wait
from goniotwin.app.desktop.run.panel import RunPanel
from goniotwin.app.station.messages import RowSaved
from goniotwin.protocols.clock import RealClock

NEAR_S = 600.0
"""Calendar times nearer than this have seconds."""


class Countdown(QObject):
    """Shows progress and time left in the run panel, each second from `begin` on.

    `pace` is that of the rows so far. `mountings` are those of the run's plan; `planned_s` is the estimated duration of the
    plan that is open, None without one. `busy` is whether a run is in progress, `stands` whether it waits for a person.
    """

    def __init__(self, panel: RunPanel, busy: Callable[[], bool], stands: Callable[[], bool], parent: QObject) -> None:
        super().__init__(parent)
        self.pace = TimeLeft()
        self.mountings: tuple[Mounting, ...] = ()
        self.planned_s: float | None = None
        self.progress = (0, 0)
        """Rows that are done, and all."""
        self._panel = panel
        self._busy, self._stands = busy, stands
        self._wall = RealClock()
        self._row_number = -1
        self._since = 0.0
        self._every_second = QTimer(self, interval=1000)
        self._every_second.timeout.connect(self.show)

    def begin(self, done: int, total: int, seconds_left: float) -> None:
        """A run begins, or is attached to."""
        self._since = self._wall.now()
        self._row_number = -1
        self.pace.begin(self._since, total - done, seconds_left)
        self.show_progress(done, total, seconds_left)
        self._every_second.start()

    def interrupt(self) -> None:
        """The run waits, or goes on after it has waited."""
        self._since = self._wall.now()
        self.pace.interrupt(self._since)

    def set_speed(self, speed: float) -> None:
        """The simulation speed is another one from now on: 1 for a real rig."""
        self.pace.set_speed(self._wall.now(), speed)

    def begin_row(self, number: int) -> None:
        """A row of the plan begins: mountings up to it are done."""
        self._row_number = number

    def end_row(self, saved: RowSaved) -> None:
        """A row is saved."""
        self._since = self._wall.now()
        self.pace.add_row(self._since, saved.row.seconds, saved.total - saved.done, saved.seconds_left)
        self.show_progress(saved.done, saved.total, saved.seconds_left)
        self.show()

    def show_progress(self, done: int, of: int, left_s: float | None) -> None:
        """Show how many rows are done, and the estimated duration of the rest."""
        self.progress = (done, of)
        self._panel.set_progress(done, of, left_s)

    def end(self) -> None:
        """The run has ended, or is not known any more."""
        self.stop()
        self.show_progress(*self.progress, None)

    def stop(self) -> None:
        """Show nothing by itself any more."""
        self._every_second.stop()

    @property
    def wait(self) -> Wait:
        """The time that is left until the end of the run, from now, as learnt from its pace."""
        left = self.pace.left
        waited = 0.0 if self._stands() else self._wall.now() - self._since
        return Wait(max(left.seconds - waited, 0.0), left.band)

    @Slot()
    def show(self) -> None:
        """Show the time left, when the run ends, and when the next sample is to be mounted by a person.

        Before a run the time that the plan takes, if the pace of rows is known from another one.
        """
        (done, of), busy = self.progress, self._busy()
        if not busy and not done and self.planned_s is not None and self.pace.known:
            self._panel.set_wait(self.pace.of_rows(of, self.planned_s), "")
        if not busy or done >= of:
            self._every_second.stop()
            return
        wait = self.wait
        texts = [f"ends {_clock_text(wait.seconds)}"]
        ahead = next((each for each in self.mountings if each.number > self._row_number), None)
        if ahead is not None:
            until = self.pace.until(ahead)
            waited = self.pace.left.seconds - wait.seconds
            texts.append(f"mount {ahead.sample} {_clock_text(max(until.seconds - waited, 0.0))}")
        elif self.mountings:
            texts.append("no more mounting")
        self._panel.set_wait(wait, ", ".join(texts))


def _clock_text(seconds: float) -> str:
    """The calendar time after so many seconds: with its seconds if it is near, with its day if that is not today."""
    now = QDateTime.currentDateTime()
    then = now.addMSecs(round(1000.0 * seconds))
    if then.date() != now.date():
        return then.toString("ddd HH:mm")
    return then.toString("HH:mm:ss" if seconds < NEAR_S else "HH:mm")
