"""Values of one sample: columns of one length, with what belongs to them; and the choice of some of them."""

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from inspect import signature
from typing import Any, ParamSpec, Self, TypeVar

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.columns import ColumnTable, Degrees
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import UNTRUSTED, RegularTable, ScatteredBsdf, flagged
from goniotwin.app.formats.metadata import Metadata
from goniotwin.arrays import Flags, Floats, Ints, ReadOnlyArrays, read_only
from goniotwin.twin.optics.geometry.coordinates import DECIMALS, TOLERANCE_DEG, TURN_DEG

ROUND = {"psi_deg": None, "phi_deg": "theta_deg", "azimuth_deg": "polar_deg"}
"""Columns whose values repeat after 360 deg, and the polar angle at whose pole, 0 or 180 deg, all of them are one direction."""
EQUAL = 1.01 * TOLERANCE_DEG
"""Numbers that differ by no more are one angle or wavelength: a rounding of the last decimal that is kept."""
MOST_LISTED = 6

Number = float | Sequence[float] | Floats
"""One number, or several."""
P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class Measured(ColumnTable):
    """What a journal has beyond the columns: the reduced `points`, one for each value, and the settings of their reduction."""

    points: BsdfPoints
    settings: ReductionSettings

    def __post_init__(self) -> None:
        """Keep the points as arrays that cannot be written."""
        object.__setattr__(self, "points", self.points.read_only())

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over what a copy has."""
        vars(self).update(state)
        self.__post_init__()


@dataclass(frozen=True, eq=False)
class LightSetting(ReadOnlyArrays):
    """The light of some values, `index`: its wavelength (NaN: grey, or the colour `channel`), direction, side, and the side
    that it leaves the sample on.
    """

    wavelength_nm: float
    channel: str
    sigma_deg: float
    psi_deg: float
    transmitted: bool
    back: bool
    index: Ints

    def __str__(self) -> str:
        channel = self.channel or ("" if math.isnan(self.wavelength_nm) else f"{self.wavelength_nm:g} nm")
        psi = f", psi {self.psi_deg:g}" if self.psi_deg else ""
        words = [*([channel] if channel else []), f"sigma {self.sigma_deg:g}{psi} deg"]
        words += [*(["transmitted"] if self.transmitted else []), *(["lit on the back"] if self.back else [])]
        return ", ".join(words)


@dataclass(frozen=True, eq=False)
class SampleData(ReadOnlyArrays, ColumnTable):
    """One sample: its `values`, with their specular coordinates (n,) in degrees.

    `gridded` values are the nodes of tables. `regular` factors have no place among values in 1/sr. `measured`: of a journal.
    `metadata`: what is known about the measurement. `grids` are those that the interpolation has made so far, by light.
    """

    values: ScatteredBsdf
    theta_deg: Degrees
    phi_deg: Degrees
    gridded: bool = False
    regular: tuple[RegularTable, ...] = ()
    measured: Measured | None = None
    metadata: Metadata = field(default_factory=Metadata)
    grids: dict[LightSetting, Any] = field(default_factory=dict, init=False)

    @cached_property
    def good(self) -> Flags:
        """The values (n,) to be trusted: there is a number, and no flag against it."""
        return read_only(np.isfinite(self.values.values) & ~flagged(np.asarray(self.values.flags), UNTRUSTED))

    @cached_property
    def lights(self) -> tuple[LightSetting, ...]:
        """The lights of the values, in the order of channel, wavelength, sides, psi and sigma."""
        keys, tables = np.zeros(self.values.size, dtype=np.int64), []
        for name in ("channel", "wavelength_nm", "back", "transmitted", "psi_deg", "sigma_deg"):
            column = self.column(name)
            column = np.round(column, DECIMALS) if column.dtype.kind == "f" else column
            there, which = np.unique(column, return_inverse=True)
            keys = keys * there.size + which.ravel()
            tables.append(there.tolist())
        distinct, place = np.unique(keys, return_inverse=True)
        order = np.argsort(place.ravel(), kind="stable")
        edges = np.searchsorted(place.ravel()[order], np.arange(1, distinct.size))
        found = []
        for key, index in zip(distinct.tolist(), np.split(order, edges), strict=False):
            at = []
            for table in reversed(tables):
                key, k = divmod(key, len(table))
                at.append(table[k])
            sigma, psi, transmitted, back, nm, channel = at
            found.append(LightSetting(nm, channel, sigma, psi, transmitted, back, index))
        return tuple(found)

    def where(self, chosen: Flags | Ints | slice) -> Self:
        """Some of the values, or all in another order."""
        everything = isinstance(chosen, np.ndarray) and chosen.dtype == bool and bool(chosen.all())
        return self if everything else super().where(chosen)  # a long journal is not copied

    @classmethod
    def join(cls, tables: Sequence[Self]) -> Self:
        """The values of all parts of a sample."""
        return replace(super().join(tables), values=ScatteredBsdf.join([table.values for table in tables]))

    def column(self, name: str) -> npt.NDArray[Any]:
        """An array (n,) by its name in `COLUMNS`, which cannot be written."""
        if name in ("theta_deg", "phi_deg"):
            return np.asarray(getattr(self, name))
        return np.asarray(getattr(self.values, "values" if name == "bsdf" else name))


COLUMNS = (
    "wavelength_nm",
    "channel",
    "sigma_deg",
    "psi_deg",
    "theta_deg",
    "phi_deg",
    "polar_deg",
    "azimuth_deg",
    "transmitted",
    "back",
    "photodiode",
    "bsdf",
    "u",
    "u_shared",
    "low95",
    "high95",
    "interval",
    "flags",
)
"""The arrays of a dataset, all of one length."""


@dataclass(frozen=True)
class ValueWithU(ReadOnlyArrays):
    """A value with its standard uncertainty `u`, both in `unit`. Write `value, u = result` to get both.

    For several directions they are arrays. `about` are remarks: what the value is of, and what u assumes.
    """

    value: Any
    u: Any
    unit: str
    about: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[Any]:
        yield self.value
        yield self.u

    def __str__(self) -> str:
        if np.ndim(self.value):
            return repr(self)
        return f"{self.value:.6g}{'' if self.unit == '1' else f' {self.unit}'}, u {self.u:.2g}"


def with_names(function: Callable[P, R]) -> Callable[P, R]:
    """A public function whose call with other arguments than its own is a UserError, which names those that it has."""

    @wraps(function)
    def called(*arguments: P.args, **named: P.kwargs) -> R:
        try:
            return function(*arguments, **named)
        except TypeError:
            own = signature(function)
            try:
                own.bind(*arguments, **named)
            except TypeError as error:
                names = ", ".join(name for name in own.parameters if name != "self")
                what = str(error).replace("got an unexpected keyword argument", "there is no argument")
                by_name = [f"{each.name}=..." for each in own.parameters.values() if each.kind is each.KEYWORD_ONLY]
                if by_name and "too many positional" in what:
                    what = f"name the arguments, as in {function.__name__}({', '.join(by_name[:2])})"
                raise UserError(f"{function.__name__.removesuffix('_dataset')}: {what}; it takes {names}") from None
            raise

    return called


def as_numbers(value: object) -> Floats | None:
    """An argument as an array of floating-point numbers; None if it is none, or has a number that is not finite."""
    if isinstance(value, str | bytes | bool):
        return None
    try:
        with warnings.catch_warnings(action="error"):
            found = np.asarray(value, dtype=np.float64)
    except Exception:  # noqa: BLE001  (an object of any class may raise anything)
        return None
    return found if np.isfinite(found).all() else None


def numbers(name: str, value: object) -> list[float]:
    """The numbers of an argument. Raises UserError."""
    found = as_numbers(value)
    if found is None or found.ndim > 1 or not found.size:
        raise UserError(f"{name}: {quoted(value)}: give a number, or a list of numbers")
    return [float(each) for each in np.atleast_1d(found)]


def quoted(value: object) -> str:
    """An argument in a message; of one that has no text its class."""
    try:
        return repr(value)
    except Exception:  # noqa: BLE001  (an object of any class may raise anything)
        return f"a {type(value).__name__}"


def flag(name: str, value: object) -> bool | None:
    """An argument that is True, False or None. Raises UserError."""
    if value is None or isinstance(value, bool | np.bool_):
        return None if value is None else bool(value)
    raise UserError(f"{name}: {quoted(value)}: give True or False")


def is_at(data: SampleData, name: str, number: float) -> Flags:
    """Whether values (n,) are at an angle or a wavelength."""
    column = data.column(name)
    if name not in ROUND:
        return np.asarray(np.abs(column - number) <= EQUAL)
    apart = np.mod(column - number, TURN_DEG)
    chosen = np.minimum(apart, TURN_DEG - apart) <= EQUAL
    pole = ROUND[name]
    if pole is not None:
        polar = data.column(pole)
        chosen |= (polar <= EQUAL) | (polar >= 180.0 - EQUAL)
    return np.asarray(chosen)


def neighbours(column: npt.NDArray[Any], number: float) -> str:
    """The nearest numbers below and above, in words."""
    there = np.unique(np.round(column[np.isfinite(column)].astype(np.float64), DECIMALS))
    if not there.size:
        return "its values have none"
    place = int(np.searchsorted(there, number))
    near = [f"{each:.9g}" for each in there[max(place - 1, 0) : place + 1].tolist()]
    return f"the nearest {'are' if len(near) > 1 else 'is'} {' and '.join(near)}"


def listed(values: Floats, unit: str) -> str:
    """Distinct numbers in words; the first and the last of many."""
    there = np.unique(np.round(values[np.isfinite(values)], DECIMALS)).tolist()
    if not there:
        return ""
    if len(there) > MOST_LISTED:
        return f"{len(there)} from {there[0]:g} to {there[-1]:g} {unit}"
    return f"{', '.join(f'{each:g}' for each in there)} {unit}"
