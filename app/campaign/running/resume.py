"""Going on with a campaign that was stopped, failed, or killed: at the first row that is not in its journal."""

import json
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.durations import Timing
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import NO_SAMPLE, RESUME_PREFIX, Row
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.protocols.clock import calendar_stamp

PORT_KEYS = (
    ("axes", "port"),
    ("monochromator", "port"),
    ("photodiodes", "units"),
    ("monitor", "usb"),
    ("simulated", "control_port"),
    ("simulated", "speed"),
)
"""What of a rig file may change while a campaign is interrupted: where its devices are reached."""


@dataclass(frozen=True)
class RemainingWork:
    """What is left of a campaign, rows that were skipped too. In `work` are also rows that nobody has planned: a sample that
    was mounted is mounted again, its dark taken, and the light compared with what it was. `start_s` is when it goes on, on
    the rig's clock.
    """

    plan: Plan
    work: tuple[Row, ...]
    start_s: float

    @property
    def added(self) -> tuple[Row, ...]:
        """The rows that nobody has planned."""
        return tuple(row for row in self.work if row.added)


def remaining_work(journal: Journal, rig: RigDescription | None) -> RemainingWork:
    """What is left of a journal's campaign, on the rig of its file or on `rig`, the same at other ports.

    Raises UserError for a campaign that is done, and for a rig that is not the same.
    """
    recorded = recorded_rig(journal)
    check_same_rig(journal, recorded, rig or recorded)
    schedule = parse_schedule(journal.value("schedule"), f"{journal.path} (schedule)")
    plan = Plan(schedule, rig or recorded, journal.planned())
    done = journal.committed()
    left = [row for row in plan.rows if row.number not in done]
    if not left:
        raise UserError(f"{journal.path}: all of its {len(plan.rows)} rows are measured; there is nothing to go on with")
    work = _work(journal, plan, done, left) if done else left
    return RemainingWork(plan, tuple(work), _start(journal, plan.rig))


def recorded_rig(journal: JournalReader) -> RigDescription:
    """The rig as it was when the campaign began; its files are looked for where they were."""
    return parse_rig(journal.value("rig"), Path(journal.value("rig_folder")), f"{journal.path} (rig)")


def check_same_rig(journal: JournalReader, recorded: RigDescription, rig: RigDescription) -> None:
    """Raises UserError, naming the keys, where anything but ports has changed."""
    changed = sorted(_differences(_without_ports(recorded), _without_ports(rig)))
    if recorded.seed != rig.seed or recorded.simulated != rig.simulated:
        changed.append("simulated")
    if changed:
        told = ", ".join(changed[:5]) + (", ..." if len(changed) > 5 else "")
        raise UserError(
            f"{rig.name}: is not the rig that {journal.path} was begun on: {told} changed, and only ports may; "
            "go on with the rig as it was, or begin a new campaign"
        )
    if recorded.simulated and not _same_model(journal.value("model"), recorded, rig):
        raise UserError(
            f"{rig.name}: its virtual rig is not the one that {journal.path} was begun on (the model's hash differs); "
            "go on with the [twin] as it was, or begin a new campaign"
        )


def _same_model(stated: str, recorded: RigDescription, rig: RigDescription) -> bool:
    """Whether a rig's model is the one whose hash a journal states, as JSON.

    The journal and a rig file without [twin] may state it in different versions. Then the rig that the journal has recorded
    decides, where it has a [twin]: if that gives the hash which the journal states, its other hashes are of the same model.
    """
    hashes = [json.dumps(each) for each in rig.model_hashes()]
    if stated in hashes:
        return True
    try:
        known = [json.dumps(each) for each in recorded.model_hashes()]
    except UserError:  # files of samples that are not there any more
        return False
    return stated in known and not set(known).isdisjoint(hashes)


def _without_ports(rig: RigDescription) -> dict[str, Any]:
    content = rig.file.model_dump(exclude={"twin", "simulated"})
    for table, key in PORT_KEYS:
        if table in content:
            del content[table][key]
    return content


def _differences(old: dict[str, Any], new: dict[str, Any], place: str = "") -> list[str]:
    found = []
    for key in old.keys() | new.keys():
        before, after = old.get(key), new.get(key)
        if isinstance(before, dict) and isinstance(after, dict):
            found += _differences(before, after, f"{place}{key}.")
        elif before != after:
            found.append(f"{place}{key}")
    return found


def _work(journal: JournalReader, plan: Plan, done: set[int], left: list[Row]) -> list[Row]:
    """The rows that are left, and before those of a sample that has been mounted already what has to be done again."""
    beginning = f"{RESUME_PREFIX}{len(journal.sessions()) + 1}"
    number, timing = journal.last_number() + 1, Timing(plan.rig.file)
    mounted: str | None = None
    work: list[Row] = []

    def add(row: Row) -> None:
        nonlocal number
        identity = f"{beginning}/{row.sample}/{row.kind}"
        if any(each.identity == identity for each in work):
            identity = f"{identity} {number}"
        work.append(replace(row, number=number, identity=identity, seconds=timing.row_seconds(row)))
        number += 1

    if plan.rows[0].kind == "warm-up" and plan.rows[0].number in done:
        add(plan.rows[0])  # the lamp may have been out
    for row in left:
        if row.kind not in ("mount", "warm-up") and row.sample != mounted:
            for each in _again(plan, done, row):
                add(each)
        mounted = row.sample
        work.append(row)
    return work


def _again(plan: Plan, done: set[int], first: Row) -> list[Row]:
    """Before a row: its sample may be out, its last dark is old, and the light may have changed."""
    sample = first.sample
    added = [Row(0, "", "mount", sample)]
    dark = next((row for row in plan.rows if row.kind == "dark"), None)
    if dark is not None and first.kind != "dark":
        added.append(replace(dark, sample=sample))
        if (again := _compared_with(plan, done, first)) is not None:
            added.append(replace(again, kind="drift"))
    return added


def _compared_with(plan: Plan, done: set[int], first: Row) -> Row | None:
    """The row that is done again to see whether the light has changed: the last drift check since the sample was mounted, or
    where there are none the last measurement. None where there is neither, or it comes next anyway.
    """
    if first.sample == NO_SAMPLE or first.kind == "drift":
        return None
    latest: Row | None = None
    for row in plan.rows[: first.number]:
        if row.kind == "mount":
            latest = None
        elif row.number in done and (
            row.kind == "drift" or (row.kind == "measure" and (latest is None or latest.kind == "measure"))
        ):
            latest = row
    return latest


def _start(journal: JournalReader, rig: RigDescription) -> float:
    """A virtual rig in this process goes on when it was left; any other has lived on meanwhile."""
    sessions = journal.sessions()
    if not sessions:
        return 0.0
    last = sessions[-1]
    if all(address.startswith("twin://") for address in rig.file.addresses):
        return last.ended_s
    speed = rig.file.simulated.speed if rig.file.simulated is not None else 1.0
    begun, now = (datetime.fromisoformat(each).astimezone(UTC) for each in (last.wall_started, calendar_stamp()))
    return max(last.ended_s, last.started_s + (now - begun).total_seconds() * speed)
