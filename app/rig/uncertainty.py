"""The tables `[uncertainty]` and `[twin.disturbances]` of a rig file: a key for each declared input (inputs.py)."""

from collections.abc import Mapping
from dataclasses import dataclass, field, make_dataclass, replace
from functools import cache
from math import inf
from typing import Any, Self, TypeVar, cast

from goniotwin.app.rig.inputs import HASHED, Input, inputs
from goniotwin.keys import LATER, MEASURED, Origin, Width, origin_of
from goniotwin.twin.plant import Disturbances

Table = TypeVar("Table")
KEYS = "A key in deg or mm is the half width of a rectangular distribution. Every other one is a standard"


@dataclass(frozen=True)
class UncertaintyTable:
    """Uncertainties of the rig's inputs."""

    def width(self, each: Input) -> float:
        """The uncertainty as the file states it: a half width of an input in deg or mm, else a standard uncertainty."""
        return float(getattr(self, each.key, each.u or 0.0))

    def u(self, each: Input) -> float:
        """The standard uncertainty of an input: of a rectangular distribution the half width over the root of 3."""
        return self.width(each) if each.distribution == "normal" else self.width(each) / 3.0**0.5

    def source(self, each: Input) -> str:
        """Where the uncertainty is from in words: stated by the file, assumed, or by what it was measured."""
        return getattr(self._entry(each), "by", "") or f"[uncertainty] {each.key} ({self.origin(each)})"

    def origin(self, *inputs: Input) -> Origin:
        """Whether the uncertainty is measured, stated or assumed; of several inputs the weakest."""
        return origin_of(*map(self._entry, inputs))

    def degrees_of_freedom(self, each: Input) -> float:
        """The degrees of freedom of an uncertainty that was measured; infinite of others."""
        return float(getattr(self._entry(each), "degrees_of_freedom", inf))

    def measured(self, each: Input, width: float, by: str, degrees_of_freedom: float = inf) -> Self:
        """The table with an uncertainty that was measured, `by` what."""
        return replace(self, **{each.key: Width(width, MEASURED, by, degrees_of_freedom)})

    def _entry(self, each: Input) -> float:
        return cast(float, getattr(self, each.key, Width(0.0)))


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


def no_uncertainties() -> Any:
    """`[uncertainty]` of a file without it: all defaults."""
    return uncertainty_table(inputs())()


def no_disturbances() -> Any:
    """`[twin.disturbances]` of a file without it: the virtual rig is off by nothing."""
    return disturbances_table(inputs())()


def _made_again(base: type[Any], values: Mapping[str, Any]) -> Any:
    """A table from a pickle, where its class is that of the inputs which this process knows."""
    return {UncertaintyTable: uncertainty_table, Disturbances: disturbances_table}[base](inputs())(**values)


def _table(base: type[Table], words: str, keys: Mapping[Input, Any]) -> type[Table]:
    """A table that extends a base with keys."""
    text = " ".join([words, *(f"`{each.key}`: {each.text}." for each in keys)])
    entries = [(each.key, each.bounds, default) for each, default in keys.items()]
    namespace = {"__doc__": text, "__module__": __name__, "__reduce__": lambda table: (_made_again, (base, vars(table)))}
    made: Any = make_dataclass(base.__name__, entries, bases=(base,), namespace=namespace, frozen=True)
    return cast(type[Table], made)
