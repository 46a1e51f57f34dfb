"""Grids of angles and wavelengths: numbers, evenly spaced ranges, or a list of both."""

import math
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, PositiveFloat, Tag, model_validator

from goniotwin.app.toml_file import TomlTable
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import round_deg

MAX_GRID_VALUES = 100_000
SPACING_DECIMALS = 9
"""Decimals of the values of a range: enough for every step that people write, too few for the rounding errors of a sum."""
WHOLE = 1e-6
"""A number of steps that differs by no more than this from a whole number is that number."""
Item = TypeVar("Item")


def evenly_spaced(start: float, step: float, steps: int) -> Floats:
    """`steps` + 1 values, each computed from `start`, so that rounding errors do not accumulate."""
    return np.round(start + step * np.arange(steps + 1), SPACING_DECIMALS)


class GridRange(TomlTable):
    """An evenly spaced range of values.

    `start`: first value. `stop`: last value, a whole number of steps from the first. `step`: distance of two values.
    """

    start: float
    stop: float
    step: PositiveFloat

    @model_validator(mode="after")
    def _check_steps(self) -> "GridRange":
        if self.stop < self.start:
            raise ValueError(f"stop {self.stop:g} is below start {self.start:g}; exchange them")
        steps = (self.stop - self.start) / self.step
        if steps > MAX_GRID_VALUES:
            raise ValueError(f"makes {steps:.0f} steps, more than {MAX_GRID_VALUES}; take a greater step")
        if abs(steps - round(steps)) > WHOLE:
            raise ValueError(
                f"stop {self.stop:g} is not a whole number of steps of {self.step:g} from start {self.start:g}; "
                f"the grid would end at {self.start + math.floor(steps) * self.step:g}"
            )
        return self

    @property
    def count(self) -> int:
        """The number of values."""
        return round((self.stop - self.start) / self.step) + 1

    def values(self) -> tuple[float, ...]:
        """The values in ascending order."""
        return tuple(evenly_spaced(self.start, self.step, self.count - 1).tolist())


def _kind(value: object) -> str:
    return "range" if isinstance(value, dict | GridRange) else "list" if isinstance(value, list) else "number"


def _refuse_duplicate_numbers(grid: Any) -> Any:
    """The grid. Ranges may meet and overlap; a single number that is listed twice is a typing error: raises ValueError."""
    if isinstance(grid, list):
        points = sum(1 if isinstance(each, float) else each.count for each in grid)
        refuse_duplicates([each for each in grid if isinstance(each, float)])
        if points > MAX_GRID_VALUES:
            raise ValueError(f"has {points} values, more than {MAX_GRID_VALUES}; take greater steps")
    return grid


def refuse_duplicates(values: list[Item]) -> list[Item]:
    """The list, unchanged. Raises ValueError for a value that is listed twice."""
    keys: set[object] = set()
    for each in values:
        key = float(round_deg(each)) if isinstance(each, float) else each
        if key in keys:
            raise ValueError(f"{each!r} is listed twice (numbers are compared to six decimals); remove one")
        keys.add(key)
    return values


Part = Annotated[Annotated[GridRange, Tag("range")] | Annotated[float, Tag("number")], Discriminator(_kind)]
Grid = Annotated[
    Annotated[GridRange, Tag("range")] | Annotated[list[Part], Field(min_length=1), Tag("list")],
    Discriminator(lambda value: "range" if _kind(value) == "range" else "list"),
    AfterValidator(_refuse_duplicate_numbers),
]


def grid_values(grid: Grid) -> tuple[float, ...]:
    """The values of a grid in the order of the file, without duplicates."""
    if isinstance(grid, GridRange):
        return grid.values()
    listed = [value for part in grid for value in (part.values() if isinstance(part, GridRange) else (part,))]
    values: dict[float, float] = {}
    for key, value in zip(round_deg(listed).tolist(), listed, strict=True):
        values.setdefault(key, value)
    return tuple(values.values())
