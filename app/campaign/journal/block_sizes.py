"""Sizes of the blocks in which a journal is read, checked and reduced: they bound the memory, and change no value."""

from dataclasses import dataclass


@dataclass(frozen=True)
class BlockSizes:
    """Rows, readings or points that are in memory together."""

    checked: int = 512
    """Rows that are compared with their links together, and whose readings are in memory."""
    recorded: int = 1024
    """Readings that are made into columns together, rows that are made into entries of the index, and rows with signals."""
    kept_bytes: int = 1 << 28
    """Memory of the readings of all rows with light; where they take more, they are read from the journal each time."""
    rows: int = 256
    """Rows whose evidence or points are computed together: some megabytes. Another number may round sums otherwise."""
    block: int = 256
    """Rows in a block of points."""
    of_pose: int = 4096
    """Rows of one pose that are reduced together, each at another wavelength."""
    points: int = 20_000
    """Points written in one part: as text a point takes one or two kilobytes."""


DEFAULT_SIZES = BlockSizes()
