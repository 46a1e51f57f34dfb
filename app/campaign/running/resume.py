"""Resuming a campaign that was stopped, failed, or killed: at the first planned row that is not in its journal."""

import json
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.journal.reading import USE_A_COPY, DamagedJournal, JournalReader
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.durations import UNKNOWN_STATE, Timing
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import NO_SAMPLE, RESUME_PREFIX, Row
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.app.rig.file import tables_without_ports
from goniotwin.protocols.clock import calendar_stamp


@dataclass(frozen=True)
class RemainingWork:
    """Remaining work of a campaign: `work` are the rows to execute, skipped ones included.

    `work` also has unplanned rows: a sample that was mounted before the interruption is mounted again, a dark reading is taken,
    and a drift check compares the light with the value before. `start_s` is the time of the resume on the rig's clock.
    """

    plan: Plan
    work: tuple[Row, ...]
    start_s: float

    @property
    def unplanned(self) -> tuple[Row, ...]:
        """The unplanned rows."""
        return tuple(row for row in self.work if row.unplanned)


def remaining_work(journal: Journal, rig: RigDescription | None) -> RemainingWork:
    """The remaining work of a journal's campaign, on the recorded rig or on `rig`, which may differ in its ports only.

    Damaged rows are measured again. There is no row where a program was killed, or failed, after the last one: then the shutter
    may be open. Raises UserError for a campaign that is complete, for a different rig, and where more than rows is damaged.
    """
    if journal.chain.parts:
        raise DamagedJournal(f"{journal.path}: is damaged: {', '.join(journal.chain.parts)}; {USE_A_COPY}")
    recorded = recorded_rig(journal)
    check_same_rig(journal, recorded, rig or recorded)
    schedule = parse_schedule(journal.value("schedule"), f"{journal.path} (schedule)")
    plan = Plan(schedule, rig or recorded, journal.planned_rows())
    done = journal.committed_numbers()
    left = [row for row in plan.rows if row.number not in done]
    sessions = journal.sessions()
    if not left and sessions and sessions[-1].outcome == "done":
        raise UserError(f"{journal.path}: all of its {len(plan.rows)} rows are measured; there is nothing to resume")
    work = _work(journal, plan, done, left) if done and left else left
    return RemainingWork(plan, tuple(work), _start(journal, plan.rig))


def recorded_rig(journal: JournalReader) -> RigDescription:
    """The rig as recorded at the start of the campaign; paths in it are relative to the folder recorded then."""
    name, alignment = f"{journal.path} (rig)", journal.optional_value("alignment")
    return parse_rig(journal.value("rig"), Path(journal.value("rig_folder")), name, alignment)


def check_same_rig(journal: JournalReader, recorded: RigDescription, rig: RigDescription) -> None:
    """Raise UserError with the changed keys where `rig` differs from the `recorded` rig in more than its ports."""
    if changed := changed_keys(recorded, rig):
        keys = ", ".join(changed[:5]) + (", ..." if len(changed) > 5 else "")
        raise UserError(
            f"{rig.name}: is not the rig with which {journal.path} started: {keys} changed, and only ports may change; "
            "resume with the rig as it was, or start a new campaign"
        )
    if recorded.simulated and not _same_model(journal.value("model"), recorded, rig):
        raise UserError(
            f"{rig.name}: its virtual rig is not the one with which {journal.path} started (the model's hash differs); "
            "resume with the [twin] as it was, or start a new campaign"
        )


def changed_keys(recorded: RigDescription, rig: RigDescription) -> list[str]:
    """The keys, other than of ports, in which a rig differs from the one of a journal, without those of its [twin]."""
    changed = sorted(_differences(tables_without_ports(recorded.file), tables_without_ports(rig.file)))
    if recorded.alignment != rig.alignment and "alignment" not in changed:
        changed.append("alignment")
    return changed if (recorded.seed, recorded.simulated) == (rig.seed, rig.simulated) else [*changed, "simulated"]


def _same_model(stated: str, recorded: RigDescription, rig: RigDescription) -> bool:
    """Return whether a rig has the model whose hash the journal states, as JSON.

    Journal and rig file may state hashes of different versions: a rig file without [twin] has only one. Then the recorded rig
    decides, if it has a [twin]: if one of its hashes is the stated one, all of its hashes are of the same model.
    """
    hashes = [json.dumps(each) for each in rig.model_hashes()]
    if stated in hashes:
        return True
    try:
        known = [json.dumps(each) for each in recorded.model_hashes()]
    except UserError:  # files of samples that do not exist any more
        return False
    return stated in known and not set(known).isdisjoint(hashes)


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
    """The rows that are left, with unplanned rows before those of a sample that was mounted before the interruption."""
    prefix = f"{RESUME_PREFIX}{len(journal.sessions()) + 1}"
    number, timing, state = journal.last_number() + 1, Timing(plan.rig.file), UNKNOWN_STATE
    mounted: str | None = None
    work: list[Row] = []

    def add(row: Row) -> None:
        nonlocal number, state
        seconds, state = timing.row(state, row)
        identity = f"{prefix}/{row.sample}/{row.kind}"
        if any(each.identity == identity for each in work):
            identity = f"{identity} {number}"
        work.append(replace(row, number=number, identity=identity, seconds=seconds))
        number += 1

    if plan.rows[0].kind == "warm-up" and plan.rows[0].number in done:
        add(plan.rows[0])  # the lamp may have been off
    for row in left:
        if row.kind not in ("mount", "warm-up") and row.sample != mounted:
            for each in _preparation(plan, done, row):
                add(each)
        mounted = row.sample
        work.append(row)
    return work


def _preparation(plan: Plan, done: set[int], first: Row) -> list[Row]:
    """Unplanned rows before `first`: mount its sample, take a dark reading, and repeat a row as a drift check."""
    sample = first.sample
    rows = [Row(0, "", "mount", sample)]
    dark = next((row for row in plan.rows if row.kind == "dark"), None)
    if dark is not None and first.kind != "dark":
        rows.append(replace(dark, sample=sample))
        if (reference := _reference_row(plan, done, first)) is not None:
            rows.append(replace(reference, kind="drift"))
    return rows


def _reference_row(plan: Plan, done: set[int], first: Row) -> Row | None:
    """The row to repeat as a drift check before `first`: the last drift check since the sample was mounted, else the last
    measurement. None where there is neither, or where `first` is a drift check itself or has no sample.
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
    """Time of the resume on the rig's clock, s.

    A virtual rig in this process continues at the end of the last session; for any other rig time has passed meanwhile.
    """
    sessions = journal.sessions()
    if not sessions:
        return 0.0
    last = sessions[-1]
    if rig.file.in_process:
        return last.ended_s
    started, now = (datetime.fromisoformat(each).astimezone(UTC) for each in (last.wall_started, calendar_stamp()))
    return max(last.ended_s, last.started_s + (now - started).total_seconds() * rig.file.speed)
