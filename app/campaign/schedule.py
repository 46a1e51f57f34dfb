"""The schedule: what the operator wants measured, one TOML file a campaign."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Discriminator, Field, PositiveFloat, Tag, field_validator, model_validator

from app.tables import Table, checked, parse_toml, read_toml

MOST_POINTS = 100_000
HIGHEST_SIGMA_DEG = 87.0
Name = Annotated[str, Field(min_length=1, pattern=r"^[^/\s][^/\r\n\t]*$")]


class GridRange(Table):
    """Evenly spaced values, both ends included."""

    start: float
    stop: float
    step: PositiveFloat

    @model_validator(mode="after")
    def _fits(self) -> "GridRange":
        if self.stop < self.start:
            raise ValueError(f"stop {self.stop:g} is below start {self.start:g}; exchange them")
        steps = (self.stop - self.start) / self.step
        if steps > MOST_POINTS:
            raise ValueError(f"makes {steps:.0f} steps, more than {MOST_POINTS}; take a greater step")
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


def _kind_of_grid(value: object) -> str:
    return "range" if isinstance(value, dict | GridRange) else "list"


Grid = Annotated[
    Annotated[GridRange, Tag("range")] | Annotated[list[float], Field(min_length=1), Tag("list")],
    Discriminator(_kind_of_grid),
]


class ScheduleFile(Table):
    """The whole file. Angles in degrees, wavelengths in nanometres, times in seconds."""

    name: Name
    side: Literal["front"] = "front"
    samples: Annotated[list[Name], Field(min_length=1)]
    etalon: Name
    sigma_deg: Grid
    gamma_deg: Grid = [0.0]
    beta_deg: Grid
    shift_deg: Grid = [0.0]
    wavelength_nm: Grid
    gains_v_per_a: Annotated[list[PositiveFloat], Field(min_length=1)]
    readings: Annotated[int, Field(ge=1, le=10_000)] = 4
    dark_every_s: PositiveFloat = 60.0
    dark_readings: Annotated[int, Field(ge=4, le=10_000)] = 16

    @field_validator("sigma_deg", "gamma_deg", "beta_deg", "shift_deg", "wavelength_nm", "gains_v_per_a", "samples")
    @classmethod
    def _nothing_twice(cls, value: object) -> object:
        if isinstance(value, list):
            seen: set[object] = set()
            for each in value:
                kept = round(each, 6) if isinstance(each, float) else each
                if kept in seen:
                    raise ValueError(f"{each!r} stands there twice (to six decimals); keep one")
                seen.add(kept)
        return value

    @field_validator("sigma_deg")
    @classmethod
    def _from_the_front(cls, value: Grid) -> Grid:
        outside = [each for each in grid_values(value) if not 0.0 <= each <= HIGHEST_SIGMA_DEG]
        if outside:
            raise ValueError(
                f"{outside[0]:g} deg is not from 0 to {HIGHEST_SIGMA_DEG:g}: beyond, light only grazes the front side"
            )
        return value

    @model_validator(mode="after")
    def _etalon_is_no_sample(self) -> "ScheduleFile":
        if self.etalon in self.samples:
            raise ValueError(f"the etalon {self.etalon!r} stands among the samples; it is measured anyway, so remove it")
        return self


@dataclass(frozen=True)
class ScheduleDescription:
    """A schedule file that has been read: its text and what it says."""

    text: str
    file: ScheduleFile
    name: str


def grid_values(grid: Grid) -> tuple[float, ...]:
    """The values of a grid, in the order of the file."""
    return grid.values() if isinstance(grid, GridRange) else tuple(grid)


def read_schedule(path: Path) -> ScheduleDescription:
    """A schedule file. Raises UserError: file, key, reason."""
    text, content = read_toml(path)
    return ScheduleDescription(text, checked(ScheduleFile, content, str(path)), str(path))


def parse_schedule(text: str, name: str) -> ScheduleDescription:
    """A schedule's text, such as a journal holds. Raises UserError."""
    return ScheduleDescription(text, checked(ScheduleFile, parse_toml(text, name), name), name)
