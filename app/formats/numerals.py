"""Numbers in text files: strict parsing, formatting with nine significant digits, and checks of the grids of BSDF tables."""

import itertools
import math
import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from goniotwin.app.formats.file import FormatError, StrPath, quote_word
from goniotwin.arrays import Floats

NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
COUNT = re.compile(r"[0-9]{1,9}")
DECIMAL_COMMA = re.compile(r"[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
MISSING = re.compile(r"[+-]?(?:nan(?:\(\w*\))?|1\.#(?:qnan|snan|ind)0*)", re.IGNORECASE)
"""A value that is not a number, as programs spell it: nan, -nan(ind), 1.#QNAN, -1.#IND."""
NO_VALUE = re.compile(r"[+-]?(?:nan(?:\(\w*\))?|inf|infinity|1\.#\w+)", re.IGNORECASE)


class NotANumber(Exception):
    """A word that is not a finite number: what is wrong with it, and what to do."""

    def __init__(self, wrong: str, remedy: str) -> None:
        super().__init__(wrong, remedy)
        self.wrong = wrong
        self.remedy = remedy


def parse_number(word: str) -> float:
    """The finite number that a word spells. Raises NotANumber."""
    if NUMBER.fullmatch(word):
        value = float(word)
        if math.isfinite(value):
            return value
        raise NotANumber(f"{quote_word(word)} is larger than a 64-bit float", "correct the number")
    if DECIMAL_COMMA.fullmatch(word):
        raise NotANumber(f"{quote_word(word)} has a decimal comma", "write a decimal point")
    if NO_VALUE.fullmatch(word):
        raise NotANumber(f"{quote_word(word)} is not finite", "write a finite number, or leave that angle out of the grid")
    raise NotANumber(f"{quote_word(word)} is not a number", "correct it")


def format_number(value: float) -> str:
    """A number with nine significant digits and a decimal point."""
    return f"{value:.9g}"


def format_row(values: Iterable[float], separator: str = " ") -> str:
    """Numbers in one line, with nine significant digits each."""
    return separator.join(f"{value:.9g}" for value in values)


def format_angles(path: StrPath, name: str, angles: Floats, separator: str = " ") -> str:
    """A list of angles (n,) in one line. Raises FormatError if two of them are equal after rounding to nine digits."""
    written = [float(format_number(angle)) for angle in angles]
    for before, after in itertools.pairwise(written):
        if not before < after:
            wrong = f"{name} has two angles that are both written {format_number(after)}"
            raise FormatError(path, wrong, "leave one of them out")
    return format_row(written, separator)


def ascending_array(name: str, values: ArrayLike, low: float, high: float) -> Floats:
    """A copy (n,) in float64. Raises ValueError unless it is a list that ascends strictly within low..high."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"{name} has the shape {array.shape}; give a list of one number or more")
    if not bool(np.all((array >= low) & (array <= high))):
        raise ValueError(f"{name} has numbers outside {low:g} to {high:g}; correct them")
    if not bool(np.all(np.diff(array) > 0)):
        raise ValueError(f"{name} does not ascend; sort it and give each number once")
    return array


def finite_array(name: str, values: ArrayLike, shape: Sequence[int]) -> Floats:
    """A copy of this shape in float64. Raises ValueError for another shape, or for values that are not finite."""
    array = np.array(values, dtype=np.float64)
    if array.shape != tuple(shape):
        raise ValueError(f"{name} has the shape {array.shape}; by the lists of angles it is {tuple(shape)}")
    missing = int(np.count_nonzero(~np.isfinite(array)))
    if missing:
        raise ValueError(f"{name} has {missing} of {array.size} values that are not finite; fill or leave out these nodes")
    return array
