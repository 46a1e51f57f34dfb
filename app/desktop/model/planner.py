"""The planner of a window: the plan of its schedule for the rig of its station, made in a thread. No Qt."""

import hashlib
import threading
from collections.abc import Callable
from pathlib import Path

from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.resume import recorded_rig
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop.model.messages import PlanBegun, PlanMade, PlanRefused
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.app.station.messages import RigOpened

NO_RIG = "no rig is open"
RECORDED = " (rig)"
"""End of the name of a rig that was read from a journal (`recorded_rig`)."""


class Planner:
    """The plan of `schedule`, the file that was opened last; `plan` is the last one made. `send` gets what comes of it."""

    def __init__(self, send: Callable[[PlanBegun | PlanMade | PlanRefused], None]) -> None:
        self.schedule: Path | None = None
        self.plan: Plan | None = None
        self._send = send
        self._begun = 0
        self._closed = False
        self._lock = threading.Lock()

    def make(self, rig: RigOpened | None) -> None:
        """Make the plan for a rig, if there is a schedule. In a thread of its own, because nothing waits for a long one."""
        if self.schedule is None:
            return
        self.give_up()
        if rig is None:
            self._send(PlanRefused(NO_RIG))
            return
        self._send(PlanBegun(self.schedule.name))
        threading.Thread(target=self._make, args=(self._begun, self.schedule, rig), name="plan", daemon=True).start()

    def give_up(self) -> None:
        """A plan that is being made is not sent any more."""
        with self._lock:
            self._begun += 1

    def close(self) -> None:
        """Send nothing after this."""
        with self._lock:
            self._closed = True

    def _make(self, number: int, path: Path, rig: RigOpened) -> None:
        plan, reason = None, ""
        try:
            plan = make_plan(read_schedule(path), description_of(rig))
        except UserError as error:
            reason = str(error)
        except Exception as error:  # noqa: BLE001  (of any library: reported, and the window stays open)
            reason = f"{path}: unexpected error: {type(error).__name__}: {error}"
        with self._lock:
            if number == self._begun and not self._closed:
                self.plan = plan or self.plan
                self._send(PlanMade(plan) if plan is not None else PlanRefused(reason))


def description_of(rig: RigOpened) -> RigDescription:
    """The rig of a station, from the file or the journal that the station has read. Raises UserError if that has changed."""
    name = str(rig.path)
    if name.endswith(RECORDED):
        with JournalFollower(Path(name.removesuffix(RECORDED))).reading() as journal:
            description = recorded_rig(journal)
    else:
        description = read_rig(rig.path)
    if hashlib.sha256(description.text.encode()).hexdigest() != rig.digest:
        raise UserError(f"{rig.path}: has changed since the rig was connected; connect again")
    return description
