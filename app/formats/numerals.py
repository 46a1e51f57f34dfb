"""How numbers are spelled in files: strictly read, and written with nine significant digits and a decimal point.

The grids of BSDF tables: lists of angles that ascend, and finite values of the shape that the lists say.
"""

import itertools
import math
import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from goniotwin.app.formats.file import FormatError, StrPath, quote_word
from goniotwin.arrays import Floats

NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
COUNT = re.compile(r"[0-9]{1,9}")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
NO_VALUE = re.compile(r"[+-]?(?:nan|inf|infinity|1\.#\w+)", re.IGNORECASE)


class NotANumber(Exception):
    """A word that is no number: what it is instead, and what to do."""

    def __init__(self, wrong: str, remedy: str) -> None:
        super().__init__(wrong, remedy)
        self.wrong = wrong
        self.remedy = remedy


def parse_number(word: str) -> float:
    """The finite number that a word spells; raises NotANumber."""
    if NUMBER.fullmatch(word):
        value = float(word)
        if math.isfinite(value):
            return value
        raise NotANumber(f"{quote_word(word)} is larger than a 64-bit float", "correct the number")
    if DECIMAL_COMMA.fullmatch(word):
        raise NotANumber(f"{quote_word(word)} has a decimal comma", "write a decimal point")
    if NO_VALUE.fullmatch(word):
        raise NotANumber(f"{quote_word(word)} is no value", "write a finite number, or leave that angle out of the grid")
    raise NotANumber(f"{quote_word(word)} is not a number", "correct it")


def format_number(value: float) -> str:
    """A number to nine significant digits."""
    return f"{value:.9g}"


def format_row(values: Iterable[float], separator: str = " ") -> str:
    """Numbers in one line."""
    return separator.join(f"{value:.9g}" for value in values)


def format_angles(path: StrPath, name: str, angles: Floats, separator: str = " ") -> str:
    """A list of angles in one line; raises FormatError if two of them are the same once written."""
    written = [float(format_number(angle)) for angle in angles]
    for before, after in itertools.pairwise(written):
        if not before < after:
            raise FormatError(path, f"{name} has two angles that are both written {format_number(after)}", "leave one out")
    return format_row(written, separator)


def ascending_array(name: str, values: ArrayLike, low: float, high: float) -> Floats:
    """`values` as a copy in float64; raises ValueError unless a list that ascends strictly within low..high."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"{name} has the shape {array.shape}; give a list of one number or more")
    if not bool(np.all((array >= low) & (array <= high))):
        raise ValueError(f"{name} has numbers outside {low:g} to {high:g}; correct them")
    if not bool(np.all(np.diff(array) > 0)):
        raise ValueError(f"{name} does not ascend; sort it and give each number once")
    return array


def finite_array(name: str, values: ArrayLike, shape: Sequence[int]) -> Floats:
    """`values` as a copy in float64; raises ValueError unless all finite and of this shape."""
    array = np.array(values, dtype=np.float64)
    if array.shape != tuple(shape):
        raise ValueError(f"{name} has the shape {array.shape}; the lists of angles say {tuple(shape)}")
    missing = int(np.count_nonzero(~np.isfinite(array)))
    if missing:
        raise ValueError(f"{name} has {missing} of {array.size} that are not finite; fill or leave out these nodes")
    return array
