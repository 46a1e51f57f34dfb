"""Grids of angles and wavelengths: numbers, evenly spaced ranges, or a list of both; and how angles are rounded and folded."""

import math
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import AfterValidator, Discriminator, Field, PositiveFloat, Tag, model_validator

from goniotwin.app.toml_file import TomlTable
from goniotwin.arrays import Floats

HALF_TURN_DEG = 180.0
TURN_DEG = 360.0
DECIMALS = 6
"""Angles and wavelengths that agree to this number of decimals are equal."""
MAX_GRID_VALUES = 100_000
Item = TypeVar("Item")


def fold_azimuth(azimuth_deg: Floats) -> Floats:
    """Azimuths from 0 to 180 deg: the two sides of the plane of incidence count as one. Not rounded."""
    wrapped = np.mod(azimuth_deg, TURN_DEG)
    return np.asarray(np.minimum(wrapped, TURN_DEG - wrapped))


class GridRange(TomlTable):
    """Evenly spaced values; start and stop are included."""

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
        if abs(steps - round(steps)) > 1e-6:
            raise ValueError(
                f"stop {self.stop:g} is not a whole number of steps of {self.step:g} from start {self.start:g}; "
                f"the grid would end at {self.start + math.floor(steps) * self.step:g}"
            )
        return self

    def values(self) -> tuple[float, ...]:
        """The values, each computed from `start`, so that rounding errors do not accumulate."""
        steps = round((self.stop - self.start) / self.step)
        return tuple(round(self.start + k * self.step, 9) for k in range(steps + 1))


def _kind(value: object) -> str:
    return "range" if isinstance(value, dict | GridRange) else "list" if isinstance(value, list) else "number"


def _refuse_duplicate_numbers(grid: Any) -> Any:
    """The grid. Ranges may meet and overlap; a single number that is listed twice is a typing error: raises ValueError."""
    if isinstance(grid, list):
        refuse_duplicates([each for each in grid if isinstance(each, float)])
        points = sum(1 if isinstance(each, float) else len(each.values()) for each in grid)
        if points > MAX_GRID_VALUES:
            raise ValueError(f"has {points} values, more than {MAX_GRID_VALUES}; take greater steps")
    return grid


def refuse_duplicates(values: list[Item]) -> list[Item]:
    """The list, unchanged. Raises ValueError for a value that is listed twice."""
    keys: set[object] = set()
    for each in values:
        key = round(each, DECIMALS) if isinstance(each, float) else each
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
    values: dict[float, float] = {}
    for part in grid:
        for value in part.values() if isinstance(part, GridRange) else (part,):
            values.setdefault(round(value, DECIMALS), value)
    return tuple(values.values())
