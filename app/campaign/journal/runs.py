"""The campaigns of a folder: what each is, how it ended, and what is left of it."""

from dataclasses import asdict, dataclass
from pathlib import Path

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig.lock import holder_of

SUFFIX = ".journal"


@dataclass(frozen=True)
class CampaignSummary:
    """A journal in short. `state` is done, stopped, failed or killed (its program ended without a word), running where a
    program has it, empty where nothing was begun. `rows` are done; `skipped` were left out for faults and not done since.
    `seconds_left` is the rig's time foretold for the rows that are left, skipped ones too.
    """

    journal: str
    name: str
    state: str
    rows: int
    skipped: int
    planned: int
    seconds: float
    seconds_left: float
    simulated: bool
    begun: str | None
    ended: str | None
    sessions: int
    faults: list[str]

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def campaign_summary(path: Path) -> CampaignSummary:
    """Of one journal. Raises UserError for a file that is none, or is damaged."""
    held = holder_of(str(path.absolute()))
    with Journal.open(path) as journal:
        sessions = journal.sessions()
        done = journal.committed()
        planned = journal.planned()
        left = [row for row in planned if row.number not in done]
        last = sessions[-1] if sessions else None
        return CampaignSummary(
            journal=str(path),
            name=journal.value("name"),
            state="running" if held else "empty" if last is None else last.outcome or "killed",
            rows=len(planned) - len(left),
            skipped=len(journal.skipped()),
            planned=len(planned),
            seconds=journal.seconds,
            seconds_left=sum(row.seconds for row in left),
            simulated=journal.simulated,
            begun=sessions[0].wall_started if sessions else None,
            ended=last.wall_ended if last is not None and not held else None,
            sessions=len(sessions),
            faults=journal.faults(),
        )


def campaign_summaries(folder: Path) -> tuple[list[CampaignSummary], list[str]]:
    """All of a folder's `.journal` files, by name, and why others cannot be read. Raises UserError where there is no folder."""
    if not folder.is_dir():
        raise UserError(f"{folder}: there is no such folder; name the one that the journals are in")
    found, refused = [], []
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        try:
            found.append(campaign_summary(path))
        except UserError as error:
            refused.append(str(error))
    return found, refused
