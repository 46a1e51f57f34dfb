"""The event of a mounting: the record of the sample as the operator has stated it, as JSON."""

import json

from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable
from goniotwin.app.toml_file import validate_table

MOUNTED = "mounted"
"""Kind of the event."""


def mounting_text(sample: str, record: SampleMetadataTable) -> str:
    """The text of the event."""
    return json.dumps({"sample": sample, **record.given}, ensure_ascii=False)


def event_words(kind: str, text: str) -> str:
    """The text of any event as a person reads it. One that is damaged stays as it is."""
    if kind != MOUNTED:
        return text
    try:
        record = dict(json.loads(text))
        sample, _at = record.pop("sample"), record.pop("mounted_at", None)
    except (ValueError, TypeError, KeyError):
        return text
    stated = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in record.items())
    return f"Mounted {sample}{f': {stated}' if stated else ''}"


def read_mounting(text: str, name: str) -> tuple[str, SampleMetadataTable]:
    """The sample and its record of the text of an event. Raises UserError, ValueError, and what a wrong type raises."""
    record = dict(json.loads(text))
    sample = str(record.pop("sample"))
    return sample, validate_table(SampleMetadataTable, record, f"{name}, mounting of {sample!r}")
