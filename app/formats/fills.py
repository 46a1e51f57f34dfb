"""The names of the ways to fill the holes of a table; see `holes`. The command line shows them without numpy."""

from typing import Literal, get_args

Fill = Literal["hold", "neighbour", "fit", "refuse"]
FILLS: tuple[Fill, ...] = get_args(Fill)
