"""The campaigns of a folder, listed in a thread. No Qt."""

import queue
import sqlite3
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.journal.summary import CampaignSummary, campaign_summaries
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.resume import changed_keys, recorded_rig
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription

UNFINISHED = ("stopped", "failed", "killed", "empty")
"""States of a campaign that can be resumed."""


@dataclass(frozen=True)
class Campaign:
    """A campaign of a folder. `schedule` is the text of its schedule and `rig` its rig, for one that is not finished."""

    summary: CampaignSummary
    schedule: str = ""
    rig: RigDescription | None = None

    @property
    def unfinished(self) -> bool:
        """Whether it can be resumed."""
        return self.summary.state in UNFINISHED

    @property
    def path(self) -> Path:
        """The journal."""
        return Path(self.summary.journal)


@dataclass(frozen=True)
class CampaignsListed:
    """The campaigns of a folder, the latest first, and an error message for each file that cannot be read."""

    folder: Path
    campaigns: tuple[Campaign, ...]
    errors: tuple[str, ...]

    @property
    def interrupted(self) -> Campaign | None:
        """The latest campaign, if it can be resumed: an older one was left on purpose."""
        return self.campaigns[0] if self.campaigns and self.campaigns[0].unfinished else None

    def unfinished(self, plan: Plan) -> Campaign | None:
        """The latest unfinished campaign of the schedule of a plan, by its text, on its rig, whose ports may be others."""
        same = (each for each in self.campaigns if each.unfinished and each.schedule == plan.schedule.text)
        return next((each for each in same if each.rig is not None and not changed_keys(each.rig, plan.rig)), None)


def list_campaigns(folder: Path) -> CampaignsListed:
    """List the campaigns of a folder; none where there is no folder yet."""
    try:
        summaries, errors = campaign_summaries(folder) if folder.is_dir() else ([], [])
    except (UserError, OSError) as error:
        return CampaignsListed(folder, (), (str(error),))
    latest = sorted(summaries, key=lambda each: each.begun or "", reverse=True)
    return CampaignsListed(folder, tuple(map(_campaign, latest)), tuple(errors))


def _campaign(summary: CampaignSummary) -> Campaign:
    if summary.state not in UNFINISHED:
        return Campaign(summary)
    try:
        with JournalFollower(Path(summary.journal)).reading() as journal:
            return Campaign(summary, journal.value("schedule"), recorded_rig(journal))
    except (UserError, OSError, sqlite3.Error):  # listed among the errors already
        return Campaign(summary)


class CampaignList:
    """Lists folders, the latest wish only; `send` is called from a thread."""

    def __init__(self, send: Callable[[CampaignsListed], None]) -> None:
        self._send = send
        self._folders: queue.SimpleQueue[Path | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="campaigns")
        self._thread.start()

    def refresh(self, folder: Path) -> None:
        """List a folder; return at once."""
        self._folders.put(folder)

    def close(self) -> None:
        """End the thread."""
        self._folders.put(None)
        self._thread.join()

    def _work(self) -> None:
        while (folder := self._folders.get()) is not None:
            while not self._folders.empty():
                folder = self._folders.get()
                if folder is None:
                    return
            self._send(list_campaigns(folder))
