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
        return len(next(self._arrays())[1])

    def where(self, chosen: Flags | Ints | slice) -> Self:
        """Some of the rows, or all in another order."""
        return self.each(lambda array: array[chosen])

    def each(self, part: Callable[[Array], Array]) -> Self:
        """The table with a function of each array in its place."""
        return self.mapped(lambda array, _: part(array))

    def known_at(self, known: Flags) -> Self:
        """The table with `absent` in all columns where a mask of its rows, or of its values of several axes, is false."""

        def masked(array: Array, column: Column) -> Array:
            return np.where(known.reshape(*known.shape, *[1] * (array.ndim - known.ndim)), array, column.absent)

        return self.mapped(masked)

    def mapped(self, part: Callable[[Array, Column], Array]) -> Self:
        """The table with a function of each array, and of what its column is, in its place."""
        held = vars(self)
        return type(self)(**{name: kind.mapped(held[name], part) for name, kind in _layout(type(self)).items()})

    def columns(self) -> dict[str, Array]:
        """All columns by name. Those of a field with several begin with its name and a blank."""
        return dict(self._arrays())

    def of_columns(self, columns: Mapping[str, Array]) -> Self:
        """A table of these columns, by the names of `columns`, with all that belongs to this whole table."""
        held = vars(self)
        return type(self)(**{name: kind.found(name, held[name], columns) for name, kind in _layout(type(self)).items()})

    @classmethod
    def join(cls, tables: Sequence[Self]) -> Self:
        """The rows of all tables, of which there is at least one; what belongs to the whole table is that of the first one.

        A column that a table does not have is `absent` there, and so is the rest of a shorter axis.
        """
        if len(tables) == 1:
            return tables[0]
        sizes = [table.size for table in tables]
        every = [vars(table) for table in tables]
        layout = _layout(cls).items()
        return cls(**{name: kind.joined([held[name] for held in every], sizes) for name, kind in layout})

    @classmethod
    def declared(cls) -> dict[str, Column]:
        """What the columns of a table of this class are, by name; without those that are in tables of its own."""
        return {name: kind.column for name, kind in _layout(cls).items() if isinstance(kind, _One)}

    def _arrays(self) -> Iterator[tuple[str, Array]]:
        held = vars(self)
        return (each for field, kind in _layout(type(self)).items() for each in kind.columns(field, held[field]))


class _Whole:
    """A field that belongs to the whole table."""

    def mapped(self, held: Any, part: Callable[[Array, Column], Array]) -> Any:
        """The field with a function of its arrays in their place."""
        del part
        return held

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array]]:
        """The arrays of the field with their names."""
        del field, held
        return iter(())

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        """The field of a table with these columns."""
        del field, columns
        return held

    def joined(self, every: Sequence[Any], sizes: Sequence[int]) -> Any:
        """The field of several tables of such sizes, joined."""
        del sizes
        return every[0]


@dataclass(frozen=True)
class _One(_Whole):
    """A field that is a column."""

    column: Column

    def mapped(self, held: Any, part: Callable[[Array, Column], Array]) -> Any:
        return None if held is None else part(held, self.column)

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array]]:
        if held is not None:
            yield field, held

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        del held
        return columns.get(field)

    def joined(self, every: Sequence[Any], sizes: Sequence[int]) -> Any:
        return None if all(each is None for each in every) else _joined(every, sizes, self.column.absent)


class _Table(_Whole):
    """A field that is a table, or None."""

    def mapped(self, held: Any, part: Callable[[Array, Column], Array]) -> Any:
        return None if held is None else held.mapped(part)

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array]]:
        if held is not None:
            yield from ((f"{field} {name}", array) for name, array in held.columns().items())

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        return None if held is None else held.of_columns(_of(field, columns))

    def joined(self, every: Sequence[Any], sizes: Sequence[int]) -> Any:
        del sizes
        there = [each for each in every if each is not None]
        if there and len(there) < len(every):
            raise ValueError("some of the tables to join have a table that others do not have")
        return type(there[0]).join(there) if there else None


@dataclass(frozen=True)
class _Named(_Whole):
    """A field with columns by name."""

    column: Column

    def mapped(self, held: Any, part: Callable[[Array, Column], Array]) -> Any:
        return {name: part(array, self.column) for name, array in held.items()}

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array]]:
        return ((f"{field} {name}", array) for name, array in held.items())

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        del held
        return _of(field, columns)

    def joined(self, every: Sequence[Any], sizes: Sequence[int]) -> Any:
        names = dict.fromkeys(name for held in every for name in held)
        return {name: _joined([held.get(name) for held in every], sizes, self.column.absent) for name in names}


@dataclass(frozen=True)
class _NamedTables(_Whole):
    """A field with tables by name, of a class without fields that belong to the whole table."""

    of: type[ColumnTable]

    def mapped(self, held: Any, part: Callable[[Array, Column], Array]) -> Any:
        return {name: table.mapped(part) for name, table in held.items()}

    def columns(self, field: str, held: Any) -> Iterator[tuple[str, Array]]:
        return ((f"{field} {inner} {name}", array) for name, table in held.items() for inner, array in table.columns().items())

    def found(self, field: str, held: Any, columns: Mapping[str, Array]) -> Any:
        del held
        tables: dict[str, dict[str, Array]] = {}
        for name, array in _of(field, columns).items():
            inner, _, key = name.partition(" ")
            tables.setdefault(key, {})[inner] = array
        return {key: self.of(**found) for key, found in tables.items()}

    def joined(self, every: Sequence[Any], sizes: Sequence[int]) -> Any:
        tables = {}
        for name in dict.fromkeys(name for held in every for name in held):
            there = [vars(held[name]) if name in held else {} for held in every]
            declared = self.of.declared().items()
            columns = {inner: _joined([each.get(inner) for each in there], sizes, each.absent) for inner, each in declared}
            tables[name] = self.of(**columns)
        return tables


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
