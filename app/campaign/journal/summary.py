"""Summaries of campaigns: how each journal of a folder ended, and how many rows are left."""

import os
from dataclasses import asdict, dataclass
from pathlib import Path

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig.left import left_unsafe
from goniotwin.app.rig.lock import journal_holder

SUFFIX = ".journal"


@dataclass(frozen=True)
class CampaignSummary:
    """A journal in short; the fields are the keys of the JSON output, without `damage`, which is an error message.

    `state`: "done", "stopped" or "failed" as the last session recorded it; where it recorded no end, "done" if all rows are
    measured, else "killed"; "running" while a program has the journal open; "empty" before the first session. `rows` counts
    the measured planned rows, `skipped` those that were skipped because of faults and not repeated since. `seconds` is the
    duration so far and `seconds_left` the estimated duration of the rows that are left, skipped ones included; both on the
    rig's clock. `orders` are the safety orders of the last session that are not acknowledged, and of what it has left unsafe.
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
    orders: list[str]
    damage: str

    def as_dict(self) -> dict[str, object]:
        """The summary as a dictionary, for JSON."""
        return {key: value for key, value in asdict(self).items() if key != "damage"}


def campaign_summary(path: Path) -> CampaignSummary:
    """The summary of one journal. Raises UserError for a file that is not a journal, or is damaged."""
    held = journal_holder(path)
    with Journal.open(path) as journal:
        sessions = journal.sessions()
        rows, planned = journal.row_counts()
        last = sessions[-1] if sessions else None
        ended = "done" if rows == planned else "killed"  # one that was killed after its last row has measured everything
        return CampaignSummary(
            journal=str(path),
            name=journal.value("name"),
            state="running" if held else "empty" if last is None else last.outcome or ended,
            rows=rows,
            skipped=sum(journal.skipped_by_sample().values()),
            planned=planned,
            seconds=journal.seconds,
            seconds_left=journal.seconds_left(),
            simulated=journal.simulated,
            begun=sessions[0].wall_started if sessions else None,
            ended=last.wall_ended if last is not None and not held else None,
            sessions=len(sessions),
            faults=journal.faults(),
            orders=[*journal.open_orders(), *(each.text for each in left_unsafe(path))],
            damage=journal.chain.damage,
        )


def campaign_summaries(folder: Path) -> tuple[list[CampaignSummary], list[str]]:
    """Summaries of all `.journal` files of a folder, by name, and an error message for each that is damaged or no journal.

    Raises UserError where the folder does not exist.
    """
    if not folder.is_dir():
        raise UserError(f"{folder}: there is no such folder; give the folder of the journals")
    os.scandir(folder).close()  # raises the error for one that cannot be listed, which `glob` takes for an empty one
    summaries, errors = [], []
    for path in sorted(folder.glob(f"*{SUFFIX}")):
        try:
            summaries.append(campaign_summary(path))
            if damage := summaries[-1].damage:
                errors.append(f"{path}: differs from what was measured: {damage}")
        except UserError as error:
            errors.append(str(error))
        except Exception as error:  # noqa: BLE001  (whatever is in the folder, the others are listed)
            errors.append(f"{path}: cannot be read: {type(error).__name__}: {error}; is it a journal?")
    return summaries, errors
