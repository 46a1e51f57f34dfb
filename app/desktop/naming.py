"""Where the next journal goes: a name that no file has, without a date in it."""

import re
from itertools import count
from pathlib import Path

SUFFIX = ".journal"


def next_journal(folder: Path, name: str) -> Path:
    """`NAME-001.journal` in a folder, or the first number that is free after the highest one there.

    Numbers are not used again after a journal has been taken away, as long as a later one is there.
    """
    stem = re.sub(r"[^\w.-]+", "-", name).strip("-.") or "campaign"
    pattern = re.compile(rf"{re.escape(stem)}-(\d+){re.escape(SUFFIX)}")
    taken = [int(found[1]) for each in folder.glob(f"*{SUFFIX}") if (found := pattern.fullmatch(each.name))]
    paths = (folder / f"{stem}-{number:03d}{SUFFIX}" for number in count(max(taken, default=0) + 1))
    return next(path for path in paths if not path.exists())
