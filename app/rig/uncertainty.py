"""The tables `[uncertainty]` and `[twin.disturbances]` of a rig file: a key for each declared input (inputs.py)."""

from collections.abc import Mapping
from dataclasses import dataclass, field, make_dataclass, replace
from functools import cache
from typing import Any, Self, TypeVar, cast

from goniotwin.app.rig.inputs import HASHED, Input
from goniotwin.keys import LATER
from goniotwin.twin.plant import Disturbances

Table = TypeVar("Table")
ASSUMED, STATED = "assumed", "stated"
KEYS = "A key in deg or mm is the half width of a rectangular distribution, every other one a standard"


class Width(float):
    """An uncertainty that the rig file does not state, with its `origin`: ASSUMED, or in words by what it was measured."""

    origin: str

    def __new__(cls, value: float, origin: str = ASSUMED) -> Self:
        """A number with an origin."""
        made = super().__new__(cls, value)
        made.origin = origin
        return made


@dataclass(frozen=True)
class UncertaintyTable:
    """The uncertainties of the inputs of a rig, asked by input; without keys, all defaults."""

    def width(self, each: Input) -> float:
        """The uncertainty as the file states it: a half width of an input in deg or mm, else a standard uncertainty."""
        return float(getattr(self, each.key, each.u or 0.0))

    def u(self, each: Input) -> float:
        """The standard uncertainty of an input: of a rectangular distribution the half width over the root of 3."""
        return self.width(each) if each.distribution == "normal" else self.width(each) / 3.0**0.5

    def source(self, each: Input) -> str:
        """Where the uncertainty is from: stated by the file, assumed, or measured."""
        origin = getattr(getattr(self, each.key, Width(0.0)), "origin", STATED)
        return f"[uncertainty] {each.key} ({origin})" if origin in (ASSUMED, STATED) else origin

    def measured(self, each: Input, width: float, by: str) -> Self:
        """The table with an uncertainty that was measured, `by` what."""
        return replace(self, **{each.key: Width(width, by)})


@cache
def uncertainty_table(known: tuple[Input, ...]) -> type[UncertaintyTable]:
    """`[uncertainty]`, with keys for some inputs."""
    words = f"Uncertainties of the rig's inputs. {KEYS} uncertainty, relative where its name has no unit."
    return _table(UncertaintyTable, words, {each: field(default=Width(each.u)) for each in known if each.u is not None})


@cache
def disturbances_table(known: tuple[Input, ...]) -> type[Disturbances]:
    """`[twin.disturbances]`, with keys for those of some inputs that the virtual rig can be off by."""
    words = f"How far the virtual rig is off; 0 is not at all. {KEYS} deviation, relative where its name has no unit."
    metadata = {each: {"disturbance": each, **({} if each in HASHED else LATER)} for each in known if each.targets}
    return _table(Disturbances, words, {each: field(default=0.0, metadata=own) for each, own in metadata.items()})


def _table(base: type[Table], words: str, keys: Mapping[Input, Any]) -> type[Table]:
    """A table that extends a base with keys."""
    text = " ".join([words, *(f"`{each.key}`: {each.text}." for each in keys)])
    entries = [(each.key, each.bounds, default) for each, default in keys.items()]
    namespace = {"__doc__": text, "__module__": __name__}
    made: Any = make_dataclass(base.__name__, entries, bases=(base,), namespace=namespace, frozen=True)
    return cast(type[Table], made)
