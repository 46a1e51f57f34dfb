"""Grids of angles and wavelengths: numbers, evenly spaced ranges, or a list of both."""

import math
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, Discriminator, Field, PositiveFloat, Tag, model_validator

from goniotwin.app.toml_file import TomlTable

MAX_GRID_VALUES = 100_000
DECIMALS = 6
"""Values that agree to so many decimals are one."""
Item = TypeVar("Item")


class GridRange(TomlTable):
    """Evenly spaced values, both ends included."""

    start: float
    stop: float
    step: PositiveFloat

    @model_validator(mode="after")
    def _fits(self) -> "GridRange":
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
        """Computed from the ends, so that no rounding adds up."""
        steps = round((self.stop - self.start) / self.step)
        return tuple(round(self.start + k * self.step, 9) for k in range(steps + 1))


def _kind(value: object) -> str:
    return "range" if isinstance(value, dict | GridRange) else "list" if isinstance(value, list) else "number"


def _refuse_duplicate_numbers(grid: Any) -> Any:
    """Ranges may meet and overlap; a number that stands there by itself twice is a slip of the pen."""
    if isinstance(grid, list):
        refuse_duplicates([each for each in grid if isinstance(each, float)])
        points = sum(1 if isinstance(each, float) else len(each.values()) for each in grid)
        if points > MAX_GRID_VALUES:
            raise ValueError(f"has {points} values, more than {MAX_GRID_VALUES}; take greater steps")
    return grid


def refuse_duplicates(values: list[Item]) -> list[Item]:
    """The list. Raises ValueError where something stands in it twice."""
    seen: set[object] = set()
    for each in values:
        kept = round(each, DECIMALS) if isinstance(each, float) else each
        if kept in seen:
            raise ValueError(f"{each!r} stands there twice (to six decimals); keep one")
        seen.add(kept)
    return values


Part = Annotated[Annotated[GridRange, Tag("range")] | Annotated[float, Tag("number")], Discriminator(_kind)]
Grid = Annotated[
    Annotated[GridRange, Tag("range")] | Annotated[list[Part], Field(min_length=1), Tag("list")],
    Discriminator(lambda value: "range" if _kind(value) == "range" else "list"),
    AfterValidator(_refuse_duplicate_numbers),
]


def grid_values(grid: Grid) -> tuple[float, ...]:
    """The values of a grid in the order of the file, each once."""
    if isinstance(grid, GridRange):
        return grid.values()
    values: dict[float, float] = {}
    for part in grid:
        for value in part.values() if isinstance(part, GridRange) else (part,):
            values.setdefault(round(value, DECIMALS), value)
    return tuple(values.values())
