"""Tables: columns of one length, each with a name and a unit. The only code that selects, orders, joins and names columns.

A table is a frozen dataclass. The types of its fields declare its columns, once:

    @dataclass(frozen=True)
    class Angles(ColumnTable):
        sigma_deg: Degrees                # a column
        own: Mapping[str, NumberColumn]          # columns by name
        signal: Signal | None = None      # a table of the same length, which may be absent
        isotropic: bool = True            # what belongs to the whole table

Every array has the length of the table along its first axis.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from types import NoneType, UnionType
from typing import Annotated, Any, Self, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from goniotwin.arrays import Flags, Floats, Indices, Ints, Texts

Array = NDArray[Any]


@dataclass(frozen=True)
class Column:
    """What a column is: its `unit`, empty for texts, flags and counts; `absent` is what stands where there is nothing."""

    unit: str = ""
    absent: float | str = 0


Degrees = Annotated[Floats, Column("deg")]
Hours = Annotated[Floats, Column("h")]
Nanometres = Annotated[Floats, Column("nm", np.nan)]
PerDegree = Annotated[Floats, Column("1/deg")]
PerNanometre = Annotated[Floats, Column("1/nm")]
PerSteradian = Annotated[Floats, Column("1/sr")]
KnownPerSteradian = Annotated[Floats, Column("1/sr", np.nan)]
"""NaN where it is not known."""
Seconds = Annotated[Floats, Column("s")]
Amperes = Annotated[Floats, Column("A")]
VoltsPerAmpere = Annotated[Floats, Column("V/A")]
Ratios = Annotated[Floats, Column("1")]
NumberColumn = Annotated[Floats, Column()]
"""Numbers in the unit of the values that they belong to."""
MemberColumn = Annotated[Indices, Column(absent=-1)]
"""Numbers of inputs; -1 for none."""
NumberedColumn = Annotated[Ints, Column(absent=-1)]
"""Numbers of things; -1 for none."""
IntegerColumn = Annotated[Ints, Column()]
IndexColumn = Annotated[Indices, Column()]
BitColumn = Annotated[NDArray[np.uint16], Column()]
FlagColumn = Annotated[Flags, Column(absent=False)]
TextColumn = Annotated[Texts, Column(absent="")]


class ColumnTable:
    """Base of all tables; a subclass is a frozen dataclass, whose fields are columns by their types."""

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(next(self._columns())[1])

    def where(self, chosen: Flags | Ints | slice) -> Self:
        """Some of the rows, or all in another order."""
        return self.each(lambda array: array[chosen])

    def each(self, part: Callable[[Array], Array]) -> Self:
        """The table with a function of each array in its place."""
        return self.of_columns({name: part(array) for name, array, _ in self._columns()})

    def known_at(self, known: Flags) -> Self:
        """The table with `absent` in all columns where a mask of its rows, or of its values of several axes, is false."""

        def masked(array: Array, absent: float | str) -> Array:
            return np.where(known.reshape(*known.shape, *[1] * (array.ndim - known.ndim)), array, absent)

        return self.of_columns({name: masked(array, column.absent) for name, array, column in self._columns()})

    def columns(self) -> dict[str, Array]:
        """All columns by name. Those of a field with several begin with its name and a blank."""
        return {name: array for name, array, _ in self._columns()}

    def of_columns(self, columns: Mapping[str, Array]) -> Self:
        """A table of these columns, by the names of `columns`, with all that belongs to this whole table.

        Raises KeyError for a column that is missing, and ValueError for one that has no place.
        """
        held = vars(self)
        made = type(self)(**{name: kind.found(name, held[name], columns) for name, kind in _layout(type(self)).items()})
        if without_place := columns.keys() - made.columns().keys():
            raise ValueError(f"{type(self).__name__} has no place for the columns {', '.join(sorted(without_place))}")
        return made

    @classmethod
    def join(cls, tables: Sequence[Self]) -> Self:
        """The rows of all tables, of which there is at least one; what belongs to the whole table is that of the first one.

        A column that a table does not have is `absent` there, and so is the rest of a shorter axis. Raises ValueError where the
        first has no table and another one has it.
        """
        if len(tables) == 1:
            return tables[0]
        declared = {name: column for table in tables for name, _, column in table._columns()}
        every, sizes = [table.columns() for table in tables], [table.size for table in tables]
        joined = {name: _joined([has.get(name) for has in every], sizes, each.absent) for name, each in declared.items()}
        return tables[0].of_columns(joined)

    @classmethod
    def declared(cls) -> dict[str, Column]:
        """What the columns of a table of this class are, by name; without those that are in tables of its own."""
        return {name: kind.column for name, kind in _layout(cls).items() if isinstance(kind, _One)}

    def _columns(self) -> Iterator[tuple[str, Array, Column]]:
        held = vars(self)
        return (each for field, kind in _layout(type(self)).items() for each in kind.columns(field, held[field]))


class _Whole:
    """A field that belongs to the whole table."""

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array, Column]]:
        """The arrays of the field, with their names and what they are."""
        del field, held
        return iter(())

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        """The field of a table with these columns."""
        del field, columns
        return held


@dataclass(frozen=True)
class _One(_Whole):
    """A field that is a column, or None."""

    column: Column

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array, Column]]:
        if held is not None:
            yield field, held, self.column

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        return columns.get(field) if held is None else columns[field]


class _Table(_Whole):
    """A field that is a table, or None."""

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array, Column]]:
        if held is not None:
            yield from ((f"{field} {name}", array, column) for name, array, column in held._columns())

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        return None if held is None else held.of_columns(_of(field, columns))


@dataclass(frozen=True)
class _Named(_Whole):
    """A field with columns by name."""

    column: Column

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array, Column]]:
        return ((f"{field} {name}", array, self.column) for name, array in held.items())

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        del held
        return _of(field, columns)


@dataclass(frozen=True)
class _NamedTables(_Whole):
    """A field with tables by name, of a class that has columns alone."""

    of: type[ColumnTable]

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array, Column]]:
        for name, table in held.items():
            yield from ((f"{field} {inner} {name}", array, column) for inner, array, column in table._columns())

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        del held
        tables: dict[str, dict[str, Array]] = {}
        for name, array in _of(field, columns).items():
            inner, _, key = name.partition(" ")
            tables.setdefault(key, {})[inner] = array
        return {key: self.of(**found) for key, found in tables.items()}


def _of(field: str, columns: Mapping[str, Array]) -> dict[str, Array]:
    """The columns whose names begin with that of a field, without it."""
    return {name[len(field) + 1 :]: array for name, array in columns.items() if name.startswith(f"{field} ")}


_LAYOUTS: dict[type[ColumnTable], dict[str, _Whole]] = {}


def _layout(table: type[Any]) -> dict[str, _Whole]:
    """The fields of a class of tables that its constructor takes, by name."""
    if table not in _LAYOUTS:
        types = get_type_hints(table, include_extras=True)
        _LAYOUTS[table] = {each.name: _kind(types[each.name]) for each in fields(table) if each.init}
    return _LAYOUTS[table]


def _kind(stated: Any) -> _Whole:
    origin, inner = get_origin(stated), get_args(stated)
    if origin in (Union, UnionType):
        (stated,) = (each for each in inner if each is not NoneType) if len(inner) == 2 and NoneType in inner else (object,)
        return _kind(stated)
    if origin is Annotated:
        return next((_One(each) for each in inner[1:] if isinstance(each, Column)), _Whole())
    if isinstance(stated, type) and issubclass(stated, ColumnTable):
        return _Table()
    if isinstance(origin, type) and issubclass(origin, Mapping):
        of = _kind(inner[1])
        if isinstance(of, _One):
            return _Named(of.column)
        if isinstance(of, _Table):
            return _NamedTables(inner[1])
    return _Whole()


def _joined(parts: Sequence[Array | None], sizes: Sequence[int], absent: float | str) -> Array:
    """One column of several tables; of a table without it, and in the rest of shorter axes, `absent`."""
    there = [each for each in parts if each is not None]
    shape = tuple(np.max([each.shape[1:] for each in there], axis=0, initial=0).astype(int).tolist())
    if len(there) == len(parts) and all(each.shape[1:] == shape for each in there):
        return np.concatenate(there)
    joined = np.full((sum(sizes), *shape), absent, dtype=np.result_type(*there))
    end = 0
    for each, size in zip(parts, sizes, strict=True):
        if each is not None:
            joined[(slice(end, end + size), *(slice(0, n) for n in each.shape[1:]))] = each
        end += size
    return joined
