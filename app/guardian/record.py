"""The record of a device that may be unsafe: its last will, what is to be locked for it, and what came of it.

The same JSON object goes to the guardian, through a pipe, and to a file in the user's state folder, which outlives both.
"""

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

BYTES = "latin-1"
"""A character a byte."""
EVENTS_SUFFIX = ".guardian"
"""Of the file beside a journal that has the guardian's events, one JSON object a line."""
FAREWELL = b"farewell\n"
GUARDIAN = "guardian of process"
"""In the note of a lock: another program waits for such a holder, because it is done soon."""


@dataclass(frozen=True)
class Record:
    """A last will (see `drivers.guard.LastWill`) at an `address`, and the program that it is of.

    `rig` is the name of the rig, `pid` the program, `since` the calendar time from which on the device may be unsafe,
    `journal` the journal of the run in progress. `path` is the file of this record, `locks` and `names` are those of the rig.
    `outcome` is what the guardian did, in one line, empty before; `done` if the device was seen safe.
    """

    device: str
    address: str
    baudrate: int
    ending: str
    order: str
    question: str
    safe: str
    danger: str
    remedy: str
    relief: str
    rig: str
    pid: int
    since: str
    path: str
    journal: str
    locks: tuple[str, ...]
    names: tuple[str, ...]
    outcome: str = ""
    done: bool = False

    @property
    def reason(self) -> str:
        """Why a person has to act."""
        of = f"{self.rig}, {Path(self.journal).name}" if self.journal else self.rig
        return f"{self.danger} since {self.since}: process {self.pid} ({of}) ended without making sure" + (
            f"; {self.outcome}" if self.outcome else ""
        )

    @property
    def text(self) -> str:
        """The order to a person, in one line."""
        return f"{self.remedy}: {self.reason}"

    def encode(self) -> str:
        """As one line of JSON."""
        return json.dumps(asdict(self))


def encode_all(records: list[Record]) -> bytes:
    """All records that are armed, as a line to the guardian."""
    return json.dumps([asdict(each) for each in records]).encode() + b"\n"


def decode_all(line: bytes) -> list[Record]:
    """The records of a line. Raises ValueError, TypeError."""
    return [record_of(each) for each in json.loads(line)]


def record_of(content: dict[str, Any]) -> Record:
    """The record of a JSON object; what a later version adds is ignored. Raises TypeError where anything is missing."""
    known = {each.name for each in fields(Record)}
    given: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in content.items() if key in known}
    return Record(**given)
