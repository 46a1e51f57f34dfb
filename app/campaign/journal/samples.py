"""Records of samples: what the schedule states, and what the operator has stated as the sample was mounted."""

import sqlite3
from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.journal.copies import known_version
from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.journal.summary import SUFFIX
from goniotwin.app.campaign.schedule.file import ScheduleFile, parse_schedule
from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable
from goniotwin.app.errors import UserError


@dataclass(frozen=True)
class KnownSample:
    """A sample of a campaign by its name in the schedule, with its record, and the journal; `begun`: ISO 8601, or empty."""

    name: str
    record: SampleMetadataTable
    journal: Path
    begun: str


def sample_record_of(journal: JournalReader, schedule: ScheduleFile, sample: str) -> SampleMetadataTable:
    """The record of a sample of a journal. What was stated at the mounting is of what was really mounted: it has priority."""
    stated = schedule.metadata.samples.get(sample, SampleMetadataTable())
    return stated.updated(journal.sample_records().get(sample, SampleMetadataTable()))


def samples_of(path: Path) -> list[KnownSample]:
    """The samples of a journal; none of one that cannot be read, as `campaign_summaries` names it. No row is read."""
    try:
        known_version(path)
        with JournalFollower(path).reading() as journal:
            schedule = parse_schedule(journal.value("schedule"), f"{path} (schedule)").file
            begun = next((each.wall_started for each in journal.sessions()), "")
            return [KnownSample(name, sample_record_of(journal, schedule, name), path, begun) for name in schedule.samples]
    except (UserError, OSError, sqlite3.Error):
        return []


def known_samples(folder: Path) -> list[KnownSample]:
    """The samples of all journals of a folder, of those with one name and identifier the latest alone, the latest first."""
    found = [each for path in sorted(folder.glob(f"*{SUFFIX}")) for each in samples_of(path)]
    latest = {(each.name, each.record.identifier): each for each in sorted(found, key=lambda each: each.begun)}
    return sorted(latest.values(), key=lambda each: each.begun, reverse=True)
