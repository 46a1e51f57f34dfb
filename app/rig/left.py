"""What programs that died have left as it must not be, on this computer: found by its records, without asking a device."""

from pathlib import Path

from goniotwin.app.guardian.guard import read_record, record_folder, remove_record
from goniotwin.app.guardian.record import Record
from goniotwin.app.rig.lock import holder_of


def left_unsafe(journal: Path | None = None) -> list[Record]:
    """Records of devices that nothing controls now and that were not seen safe since; only those of a run into `journal`.

    What is recorded of a rig that a program holds, a guardian too, is left to that program.
    """
    found = [record for path in sorted(record_folder().glob("*.json")) if (record := read_record(path)) is not None]
    wanted = "" if journal is None else str(journal.resolve())
    return [
        each
        for each in found
        if not each.done
        and (journal is None or each.journal == wanted)
        and all(holder_of(Path(lock)) is None for lock in each.locks)
    ]


def acknowledge_left(text: str) -> list[Record]:
    """Remove and return the records with the order of this text, which a person has acknowledged."""
    found = [each for each in left_unsafe() if each.text == text]
    for each in found:
        remove_record(Path(each.path))
    return found
