"""A sample in one line, as `goniotwin simulate` takes it, as the table that a rig file has for it."""

from pathlib import Path
from typing import Any

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.sample import FILE_SIDE, PLUS, parse_sample


def sample_table(text: str) -> dict[str, Any]:
    """The entries of `[twin.samples.NAME]`. Raises UserError for a model that is none, or that a rig file cannot name."""
    parse_sample(text)  # says in its own words what is wrong with it
    lobes = [_lobe(part.strip()) for part in PLUS.split(text)]
    return lobes[0] if len(lobes) == 1 else {"model": "sum", "lobes": lobes}


def _lobe(part: str) -> dict[str, Any]:
    name, _, rest = (word.strip() for word in part.partition(":"))
    if name == "table":
        return _file(rest)
    entries = (entry.partition("=") for entry in rest.split(",") if rest)
    return {"model": name, **{key.strip(): _value(value.strip()) for key, _, value in entries}}


def _file(text: str) -> dict[str, Any]:
    side = FILE_SIDE.search(text)
    path = Path(text if side is None else text[: side.start()].strip())
    if path.suffix.lower() in (".ddr", ".ddt"):
        raise UserError(f"--sample table:{path}: a virtual rig's samples are .bsdf tables; convert it, or give a formula")
    return {"model": "zemax", "file": str(path.absolute()), **({} if side is None else {"side": side[1]})}


def _value(text: str) -> bool | float | str:
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text)
    except ValueError:
        return text
