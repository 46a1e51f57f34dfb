"""`[[monochromator.filters]]`, what the operator believes to stand in the filter wheel, and `[[twin.filters]]`, what does."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated

from pydantic import Field, PositiveFloat, model_validator

from goniotwin.app.toml_file import Table
from goniotwin.drivers import FilterWheel, OrderFilter
from goniotwin.twin.plant import WheelFilter

Position = Annotated[int, Field(ge=1, le=6)]
TINY_NM = 1e-6


class OrderFilterTable(Table):
    """A position of the wheel and the band for which it is put in, the lower end included, the upper where no other begins.

    `cut_on_nm` is from where on it lets light through; without it, as in a position that is empty, it is not taken to hold
    anything back.
    """

    position: Position
    name: Annotated[str, Field(min_length=1)]
    from_nm: PositiveFloat
    to_nm: PositiveFloat
    cut_on_nm: PositiveFloat | None = None

    @model_validator(mode="after")
    def _lets_its_band_through(self) -> "OrderFilterTable":
        if not self.from_nm < self.to_nm:
            raise ValueError(f"from_nm {self.from_nm:g} is not below to_nm {self.to_nm:g}; exchange them")
        if self.cut_on_nm is not None and self.cut_on_nm > self.from_nm:
            raise ValueError(
                f"cut_on_nm {self.cut_on_nm:g} is above from_nm {self.from_nm:g}, so it would hold back the very light that it "
                "is put in for; let its band begin higher, or take another filter"
            )
        return self

    def __str__(self) -> str:
        return f"{self.name!r} ({self.from_nm:g} to {self.to_nm:g} nm)"


class WheelFilterTable(Table):
    """A filter in the virtual rig's wheel: see `twin.plant.WheelFilter`. A position without one is open."""

    position: Position
    cut_on_nm: PositiveFloat
    transmittance: Annotated[float, Field(gt=0.0, le=1.0)] = WheelFilter.transmittance

    def filter(self) -> WheelFilter:
        """For the model."""
        return WheelFilter(**self.model_dump())


def refuse_positions_taken_twice(filters: Sequence[OrderFilterTable | WheelFilterTable]) -> None:
    """Raises ValueError, naming the position."""
    positions = [each.position for each in filters]
    for position in positions:
        if (count := positions.count(position)) > 1:
            raise ValueError(f"filters: position {position} is given {count} times; there is one filter in each, so leave one")


def refuse_bands(filters: Sequence[OrderFilterTable], lowest_nm: float, highest_nm: float) -> None:
    """Raises ValueError where bands overlap, or leave a gap between `lowest_nm` and `highest_nm`, naming the keys."""
    ordered = sorted(filters, key=lambda each: each.from_nm)
    for below, above in pairwise(ordered):
        if above.from_nm < below.to_nm - TINY_NM:
            raise ValueError(f"filters: the bands of {below} and {above} overlap; let one's to_nm be the other's from_nm")
    ends = [(0.0, ordered[0].from_nm), *((a.to_nm, b.from_nm) for a, b in pairwise(ordered)), (ordered[-1].to_nm, float("inf"))]
    for end, begin in ends:
        missing = max(end, lowest_nm), min(begin, highest_nm)
        if missing[1] - missing[0] > TINY_NM:
            raise ValueError(
                f"filters: from {missing[0]:g} to {missing[1]:g} nm there is none; widen a band with from_nm or to_nm, name "
                "the empty position that belongs there, or narrow lowest_nm and highest_nm"
            )


def filter_wheel(filters: Sequence[OrderFilterTable]) -> FilterWheel:
    """For the driver."""
    ordered = sorted(filters, key=lambda each: each.from_nm)
    return FilterWheel(tuple(OrderFilter(each.position, each.name, each.from_nm, each.cut_on_nm) for each in ordered))
