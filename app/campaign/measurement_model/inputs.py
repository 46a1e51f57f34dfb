"""The quantities that a value depends on besides the sample (GUM: input quantities), each with its uncertainty."""

from dataclasses import dataclass
from math import inf

from goniotwin.app.rig.inputs import Distribution, Input
from goniotwin.app.rig.uncertainty import UncertaintyTable
from goniotwin.keys import STATED, Origin


@dataclass(frozen=True)
class InputQuantity:
    """One of them: `name` as in a budget, its `unit` ("deg", "mm", "nm", "1" for a relative one), and standard uncertainty `u`.

    `shared_by` names the values that have it in common, `source` where u is from, and `twin` the key of the rig file with which
    the virtual rig has it as a disturbance; empty where it has none. `origin`: whether u is measured, stated or assumed.
    """

    name: str
    unit: str
    u: float
    distribution: Distribution
    shared_by: str
    source: str
    twin: str
    degrees_of_freedom: float = inf
    origin: Origin = STATED


def quantity(each: Input, table: UncertaintyTable, name: str = "", *, shared_by: str = "", times: float = 1.0) -> InputQuantity:
    """A quantity of a declared input, by the `name` of one where it has several; with so many `times` its uncertainty."""
    return InputQuantity(
        name or each.name,
        each.unit,
        times * table.u(each),
        each.distribution,
        shared_by or each.shared_by.value,
        table.source(each),
        f"disturbances.{each.key}" if each.targets else "",
        table.degrees_of_freedom(each),
        table.origin(each),
    )
