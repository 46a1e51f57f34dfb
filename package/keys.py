"""Types of the values of files: numbers with bounds, the same for a file and for Python.

The tables of a file are the dataclasses that the code uses. annotated-types has the names of the
bounds: pydantic, which reads the files, takes them from there, and these classes do not depend on pydantic.
"""

from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from math import inf, isfinite
from types import MappingProxyType
from typing import Annotated, Any, Literal, Self, get_args, get_type_hints

from annotated_types import Ge, Gt, Le, Lt

Positive = Annotated[float, Gt(0.0)]
NonNegative = Annotated[float, Ge(0.0)]
Fraction = Annotated[float, Ge(0.0), Lt(1.0)]
Share = Annotated[float, Gt(0.0), Le(1.0)]
PolarAngle = Annotated[float, Ge(0.0), Le(90.0)]
Count = Annotated[int, Gt(0)]
Address = Annotated[int, Ge(1), Le(255)]
"""Address of a motion module."""
TcpUnit = Annotated[int, Ge(0), Le(255)]
"""Unit of a Modbus request over TCP."""
MotorNumber = Annotated[int, Ge(0), Le(5)]
WheelPosition = Annotated[int, Ge(1), Le(6)]

LATER: Mapping[str, Any] = MappingProxyType({"later": True})
"""Metadata of a field that was added to the twin's model later: at its default it is not part of the model's hash."""
Origin = Literal["measured", "stated", "assumed"]
MEASURED: Origin = "measured"
STATED: Origin = "stated"
ASSUMED: Origin = "assumed"
ORIGINS = (MEASURED, STATED, ASSUMED)
"""Where an uncertainty is from: the campaign itself, a file, or a default; the weaker the later."""
COMPARISONS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}


class Width(float):
    """An uncertainty that no file states: a default, ASSUMED, or MEASURED, in words `by` what, with degrees of freedom."""

    origin: Origin
    by: str
    degrees_of_freedom: float

    def __new__(cls, value: float, origin: Origin = ASSUMED, by: str = "", degrees_of_freedom: float = inf) -> Self:
        """A number with an origin."""
        made = super().__new__(cls, value)
        made.origin, made.by, made.degrees_of_freedom = origin, by, degrees_of_freedom
        return made


def origin_of(*uncertainties: float) -> Origin:
    """Where an uncertainty is from, or the weakest origin of several; a plain number is stated by a file."""
    return max((getattr(each, "origin", STATED) for each in uncertainties), key=ORIGINS.index)


def check_bounds(value: Any) -> None:
    """Check the numbers of a dataclass: finite, and within the bounds of their types. Raises ValueError with the field."""
    table: Any = type(value)
    for name, bounds in _bounds(table):
        number = getattr(value, name)
        if isinstance(number, float | int):
            if not isfinite(number):
                raise ValueError(f"{name} is {number!r}: give a finite number")
            for sign, limit in bounds:
                if not {"gt": number > limit, "ge": number >= limit, "lt": number < limit, "le": number <= limit}[sign]:
                    raise ValueError(f"{name} is {number!r}: give a number {COMPARISONS[sign]} {limit:g}")


@cache
def _bounds(table: Any) -> tuple[tuple[str, tuple[tuple[str, float], ...]], ...]:
    """Name and bounds (sign, limit) of each field."""
    hints = get_type_hints(table, include_extras=True)
    return tuple((each.name, tuple(_limits(hints[each.name]))) for each in fields(table))


def _limits(hint: Any) -> list[tuple[str, float]]:
    bounds = getattr(hint, "__metadata__", ())
    found = [(sign, getattr(bound, sign)) for bound in bounds for sign in COMPARISONS if hasattr(bound, sign)]
    return found + [limit for part in get_args(hint) for limit in _limits(part)]


def values_of(value: Any, base: type[Any]) -> dict[str, Any]:
    """The values, by name, of those fields of a dataclass that its base class takes."""
    return {each.name: getattr(value, each.name) for each in fields(base) if each.init}
