"""The campaigns of a folder, listed in a thread. No Qt."""

import queue
import sqlite3
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.journal.summary import CampaignSummary, campaign_summaries
from goniotwin.app.errors import UserError

UNFINISHED = ("stopped", "failed", "killed", "empty")
"""States of a campaign that can be resumed."""


@dataclass(frozen=True)
class Campaign:
    """A campaign of a folder. `schedule` is the text of its schedule, for one that is not finished; otherwise empty."""

    summary: CampaignSummary
    schedule: str

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

    def unfinished(self, schedule: str) -> Campaign | None:
        """The latest unfinished campaign of a schedule, by its text."""
        return next((each for each in self.campaigns if each.unfinished and each.schedule == schedule), None)


def list_campaigns(folder: Path) -> CampaignsListed:
    """List the campaigns of a folder; none where there is no folder yet."""
    try:
        summaries, errors = campaign_summaries(folder) if folder.is_dir() else ([], [])
    except (UserError, OSError) as error:
        return CampaignsListed(folder, (), (str(error),))
    latest = sorted(summaries, key=lambda each: each.begun or "", reverse=True)
    return CampaignsListed(folder, tuple(Campaign(each, _schedule(each)) for each in latest), tuple(errors))


def _schedule(summary: CampaignSummary) -> str:
    if summary.state not in UNFINISHED:
        return ""
    try:
        with JournalFollower(Path(summary.journal)).reading() as journal:
            return str(journal.value("schedule"))
    except (UserError, OSError, sqlite3.Error):  # listed among the errors already
        return ""


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
