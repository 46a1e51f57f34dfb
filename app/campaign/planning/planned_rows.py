"""The rows of a plan: counted and timed at once, made one by one when somebody wants them."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import repeat
from typing import overload

from goniotwin.app.campaign.planning.timeline import Measuring, Run
from goniotwin.app.campaign.row import Row


class PlannedRows(Sequence[Row]):
    """Like a tuple of rows. Until one of them is asked for there is none, so that a million can be checked in no time."""

    def __init__(self, pieces: list[Row | Run], measuring: Measuring) -> None:
        self._pieces = pieces
        self._measuring = measuring

    @cached_property
    def kinds(self) -> dict[str, int]:
        """How many rows there are of each kind."""
        counted: Counter[str] = Counter()
        for piece in self._pieces:
            counted.update({"measure": len(piece.points)} if isinstance(piece, Run) else {piece.kind: 1})
        return dict(counted)

    @cached_property
    def seconds(self) -> float:
        """The whole duration foretold."""
        return sum(float(piece.seconds.sum()) if isinstance(piece, Run) else piece.seconds for piece in self._pieces)

    @property
    def pieces(self) -> list[Row | Run]:
        """Single rows, their numbers still 0, and runs of measurements."""
        return self._pieces

    def __len__(self) -> int:
        return sum(self.kinds.values())

    @overload
    def __getitem__(self, index: int) -> Row: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Row, ...]: ...
    def __getitem__(self, index: int | slice) -> Row | tuple[Row, ...]:
        return self._rows[index]

    def __iter__(self) -> Iterator[Row]:
        return iter(self._rows)

    def __eq__(self, other: object) -> bool:
        return self._rows == (other._rows if isinstance(other, PlannedRows) else other)

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def _rows(self) -> tuple[Row, ...]:
        rows: list[Row] = []
        for piece in self._pieces:
            if isinstance(piece, Run):
                rows += self._made(piece, len(rows))
            else:
                rows.append(replace(piece, number=len(rows)))
        return tuple(rows)

    def _made(self, run: Run, number: int) -> Iterator[Row]:
        like = self._measuring.row(run.of.sample)
        poses, wavelengths = run.of.poses.angles.tolist(), run.of.lattice.wavelengths_nm.tolist()
        which, when = divmod(run.points, len(wavelengths))
        return map(
            Row, range(number, number + len(run.points)), run.of.identities(run.points), repeat(like.kind), repeat(like.sample),
            run.seconds.tolist(), [wavelengths[k] for k in when.tolist()], [tuple(poses[k]) for k in which.tolist()],
            repeat(like.gains), repeat(like.readings), repeat(like.automatic), repeat(like.target), repeat(like.longest_s),
        )  # fmt: skip
