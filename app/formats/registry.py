"""Registry of file formats: what each is called, how a file of it is recognised, and what it can hold.

A file is recognised by its content first, then by its suffix. A format is one module, its codec, and one line in `BUILT_IN`.
Another package offers formats as entry points of the group `goniotwin.formats`, each a `Format` or a tuple of them. No codec is
imported before a file is read or written, because the help of the commands lists the formats.
"""

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import FormatError, check_writable, read_head

if TYPE_CHECKING:
    from goniotwin.app.formats.table import BsdfTable

GROUP = "goniotwin.formats"
HEAD_BYTES = 1 << 20
"""A file is recognised by so many bytes: comments at the top of a table can be long."""
ABOUT_UNCERTAINTY = "standard uncertainties of the values in "
"""A comment of every file of uncertainties begins with this; the name of the table follows."""


class Holds(StrEnum):
    """What a file of a format can hold. The first three are the kinds of content; a format has exactly one of them."""

    GRID = "a grid on specular coordinates"
    POINTS = "scattered points"
    RAYS = "rays of a light source"
    COLUMNS = "columns of any names"
    SIGMAS = "several sigmas"
    WAVELENGTHS = "several wavelengths"
    PSI = "several azimuths of the light (psi)"
    REFLECTED = "reflected light"
    TRANSMITTED = "transmitted light"
    SIDES = "both sides of the sample"
    UNCERTAINTY = "the uncertainty of each value"
    FLAGS = "flags of each value"
    COMMENTS = "comments"


CONTENT = {
    Holds.GRID: ("goniotwin.app.formats.table", "BsdfTable"),
    Holds.POINTS: ("goniotwin.app.formats.points", "Points"),
    Holds.RAYS: ("goniotwin.twin.optics.illumination.rayset", "Rayset"),
}
"""Module and class of each kind of content, as a codec returns it."""
KINDS = frozenset(CONTENT)


class Codec(Protocol):
    """Reader and writer of a format; a module with these functions is one.

    The content is a `BsdfTable` (GRID), `Points` (POINTS; written as a `PointStream`) or a `Rayset` (RAYS). Whatever else a
    codec of another package raises is reported as its fault.
    """

    def recognise(self, head: bytes) -> bool:
        """Whether a file that begins with `head` is of this format; never raises."""

    def read(self, path: Path) -> Any:
        """Read a file. Raises FormatError."""

    def write(self, path: Path, content: Any) -> None:
        """Write a file completely or not at all. Raises FormatError."""


@dataclass(frozen=True)
class Format:
    """A file format. `name` is one word, as in `export --format NAME`; `title` is one line for lists.

    `suffixes` are in lower case, with the dot. `codec` may be the name of its module. Raises ValueError for a name, suffix or
    content that is not possible.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    holds: frozenset[Holds]
    codec: Codec | str
    reads: bool = True
    writes: bool = True

    def __post_init__(self) -> None:
        """Check the fields."""
        if not self.name.isidentifier() or len(KINDS & self.holds) != 1:
            raise ValueError(f"format {self.name!r}: give one word as its name, and one of {', '.join(sorted(KINDS))}")
        if not self.suffixes or not all(each.startswith(".") and each == each.lower() for each in self.suffixes):
            raise ValueError(f"format {self.name!r}: suffixes are in lower case and begin with a dot, not {self.suffixes}")

    def __str__(self) -> str:
        return f"{self.name} ({', '.join(self.suffixes)})"

    def load(self) -> Codec:
        """The codec; its module is imported now. Raises FormatError if that fails, whatever the module raises."""
        try:
            return cast(Codec, import_module(self.codec)) if isinstance(self.codec, str) else self.codec
        except Exception as error:
            wrong = f"its codec cannot be loaded ({error})"
            raise FormatError(f"format {self.name!r}", wrong, "correct its installation") from error

    def read(self, path: Path) -> Any:
        """The content of a file, see `Codec`. Raises FormatError."""
        with self._faults_named(path):
            content = self.load().read(path)
            module, name = next(CONTENT[kind] for kind in CONTENT if kind in self.holds)
            if not isinstance(content, getattr(import_module(module), name)):
                raise TypeError(f"it read a {type(content).__name__}, not {name}")
            return content

    def write(self, path: Path, content: Any) -> None:
        """Write a file, see `Codec`. Raises FormatError."""
        with self._faults_named(path):
            self.load().write(path, content)

    @contextmanager
    def _faults_named(self, path: Path) -> Iterator[None]:
        """Raise FormatError, which names the format, where the codec of another package raises anything else."""
        try:
            yield
        except (FormatError, UserError):
            raise
        except Exception as error:
            if self in BUILT_IN:  # a fault of this program
                raise
            wrong = f"the codec of the format {self.name} failed ({type(error).__name__}: {error})"
            raise FormatError(path, wrong, "correct its installation, or use another format") from error


_TABLE = frozenset({Holds.GRID, Holds.SIGMAS, Holds.WAVELENGTHS, Holds.PSI, Holds.COMMENTS})
_CSV = frozenset(set(Holds) - {Holds.GRID, Holds.RAYS, Holds.PSI})

BUILT_IN = (
    Format("ddr", "Lumicept table of a BRDF", (".ddr",), _TABLE | {Holds.REFLECTED}, "goniotwin.app.formats.ddr"),
    Format("ddt", "Lumicept table of a BTDF", (".ddt",), _TABLE | {Holds.TRANSMITTED}, "goniotwin.app.formats.ddr"),
    Format(
        "zemax", "Zemax tabular BRDF or BTDF, Monochrome", (".bsdf",),
        (_TABLE - {Holds.WAVELENGTHS, Holds.PSI}) | {Holds.REFLECTED, Holds.TRANSMITTED}, "goniotwin.app.formats.zemax",
    ),
    Format("csv", "every point, with its uncertainty and flags", (".csv",), _CSV, "goniotwin.app.formats.points"),
    Format(
        "rayset", "recorded rays of the illumination", (".h5", ".hdf5"),
        frozenset({Holds.RAYS, Holds.WAVELENGTHS}), "goniotwin.app.formats.rayset",
    ),
)  # fmt: skip
_registered: list[Format] = []


def register(added: Format) -> None:
    """Add a format for as long as the program runs. Raises ValueError for a name that exists."""
    _refuse_name(added, formats())
    _registered.append(added)


def formats() -> tuple[Format, ...]:
    """All formats: the program's own first, then those of other packages."""
    return (*BUILT_IN, *_plug_ins()[0], *_registered)


@cache
def _plug_ins() -> tuple[tuple[Format, ...], tuple[str, ...]]:
    """The formats of other packages, and what is wrong with those that cannot be used: these must not stop the others."""
    found: list[Format] = []
    faults = []
    for entry in entry_points(group=GROUP):
        try:
            loaded = entry.load()
            for each in loaded if isinstance(loaded, tuple | list) else (loaded,):
                if not isinstance(each, Format):
                    raise TypeError(f"it is a {type(each).__name__}, not a Format")
                _refuse_name(each, (*BUILT_IN, *found))
                found.append(each)
        except Exception as error:  # noqa: BLE001  (the code of another package can raise anything)
            package = "another package" if entry.dist is None else f"the package {entry.dist.name}"
            faults.append(f"{entry.name} of {package} cannot be used: {error}")
    return tuple(found), tuple(faults)


def _refuse_name(added: Format, others: Iterable[Format]) -> None:
    if added.name in {each.name for each in others}:
        raise ValueError(f"there is a format {added.name!r} already")


def writers(*holds: Holds) -> list[Format]:
    """The formats that can be written and hold all of these."""
    return [each for each in formats() if each.writes and each.holds.issuperset(holds)]


def readers(*holds: Holds) -> list[Format]:
    """The formats that can be read and hold all of these."""
    return [each for each in formats() if each.reads and each.holds.issuperset(holds)]


def suffixes(found: Iterable[Format]) -> list[str]:
    """The suffixes of formats, each once."""
    return list(dict.fromkeys(suffix for each in found for suffix in each.suffixes))


def join_words(words: Iterable[str], last: str = "or") -> str:
    """Words as in a sentence: a, b or c."""
    *first, final = words
    return f"{', '.join(first)} {last} {final}" if first else final


def _unknown(place: Path | str, wrong: str, remedy: str) -> FormatError:
    return FormatError(place, "; ".join([wrong, *_plug_ins()[1]]), remedy)


# ---- reading ----


def recognise(path: Path, kind: Holds) -> Format:
    """The format of a file with this kind of content, by the file's content first, then by its suffix. Raises FormatError."""
    head, suffix = read_head(path, HEAD_BYTES), path.suffix.lower()
    alike = [each for each in formats() if each.reads and _is_like(each, head)]
    named = [each for each in formats() if each.reads and suffix in each.suffixes]
    if not (alike or named):
        wanted = join_words(map(str, readers(kind)))
        raise _unknown(path, "neither its content nor its suffix is of a known format", f"give {wanted}")
    found = [each for each in named if each in alike] or alike or named
    found = [each for each in found if kind in each.holds] or found[:1]
    if kind not in found[0].holds:
        wrong = f"it is a {found[0].name} file, which does not hold {kind}"
        raise _unknown(path, wrong, f"give {join_words(map(str, readers(kind)))}")
    if len(found) > 1 and found[0] not in named:
        wrong = f"its content is that of {join_words(map(str, found))}, and only the suffix distinguishes them"
        raise FormatError(path, wrong, "rename the file")
    return found[0]


def _is_like(found: Format, head: bytes) -> bool:
    """Whether a file that begins with `head` is of a format; a codec that fails must not stop the others."""
    try:
        return bool(found.load().recognise(head))
    except Exception:  # noqa: BLE001  (the code of another package can raise anything)
        return False


def read(path: Path, kind: Holds) -> Any:
    """The content of a file, see `Codec`. Raises FormatError."""
    return recognise(path, kind).read(path)


# ---- writing ----


def format_named(name: str, kinds: Collection[Holds]) -> Format:
    """The format of this name to write one of these kinds in. Raises FormatError."""
    possible = {each.name: each for each in formats() if each.writes and each.holds.intersection(kinds)}
    if name not in possible:
        wrong = f"there is no such format for {join_words(each for each in Holds if each in kinds)}"
        raise _unknown(f"format {name!r}", wrong, f"give {join_words(possible)}")
    return possible[name]


def format_for(path: Path, kinds: Collection[Holds], needs: Collection[Holds] = ()) -> Format:
    """The format to write a file in, by its suffix: one of these kinds that holds all of `needs`. Raises FormatError."""
    possible = [each for each in formats() if each.writes and each.holds.intersection(kinds)]
    named = [each for each in possible if path.suffix.lower() in each.suffixes]
    if not named:
        other = next((each for each in formats() if path.suffix.lower() in each.suffixes), None)
        wrong = "the format is unknown" if other is None else f"a {other.name} file is not written here"
        raise _unknown(path, wrong, f"give a name that ends with {join_words(suffixes(possible))}")
    found = next((each for each in named if each.holds.issuperset(needs)), named[0])
    check_holds(path, found, needs)
    return found


def check_holds(path: Path | str, found: Format, needs: Collection[Holds]) -> None:
    """Raise FormatError, with the formats to use instead, if a format cannot be written or does not hold all of `needs`."""
    missing = [each for each in Holds if each in needs and each not in found.holds]
    if not missing and found.writes:
        return
    wrong = f"a {found.name} file does not hold {join_words(missing, 'and')}" if missing else f"{found.name} is only read"
    others = writers(*set(needs) - KINDS)
    points_and_tables = [each for each in others if Holds.RAYS not in each.holds]
    remedy = f"use {join_words(map(str, points_and_tables))}" if points_and_tables else "write it in several files"
    raise FormatError(path, wrong, remedy)


def table_needs(table: "BsdfTable") -> frozenset[Holds]:
    """What a format has to hold for a table; its uncertainties may go to a second file."""
    several = {
        Holds.SIGMAS: table.sigma_deg.size,
        Holds.WAVELENGTHS: len(table.wavelengths_nm or (0.0,)),
        Holds.PSI: table.psi_deg.size,
    }
    light = Holds.TRANSMITTED if table.transmitted else Holds.REFLECTED
    return frozenset({Holds.GRID, light, *(each for each, count in several.items() if count > 1)})


def uncertainty_path(path: Path) -> Path:
    """The file of the uncertainties beside a table that cannot hold them: NAME.u.ddr beside NAME.ddr."""
    return path.with_suffix(f".u{path.suffix}")


def described_table(table: "BsdfTable") -> str | None:
    """The name of the table whose uncertainties this one has in the place of values; None for a table of values."""
    marked = (line.partition(ABOUT_UNCERTAINTY)[2] for line in table.comments if line.startswith(ABOUT_UNCERTAINTY))
    return next((rest.partition(", in the place of ")[0] for rest in marked), None)


def check_files(path: Path, found: Format) -> tuple[Path, ...]:
    """The files of a result with uncertainties: one, or a table and that of its uncertainties.

    Raises FormatError, before anything is written, for a codec that cannot be loaded, a file that cannot be written, or another
    file in the place of the uncertainties.
    """
    found.load()
    check_writable(path)
    if Holds.GRID not in found.holds or Holds.UNCERTAINTY in found.holds:
        return (path,)
    beside = uncertainty_path(path)
    check_writable(beside)
    if beside.exists() and ABOUT_UNCERTAINTY.encode() not in read_head(beside, HEAD_BYTES):
        wrong = f"the uncertainties go to {beside}, and another file is there"
        raise FormatError(path, wrong, "choose another name, or move that file")
    return path, beside


def write_table(path: Path, table: "BsdfTable", found: Format) -> tuple[Path, ...]:
    """Write a table; its uncertainties go to a second file of the same grid if the format cannot hold them.

    Returns the files. Raises FormatError.
    """
    check_holds(path, found, table_needs(table))
    if table.u is None:
        found.write(path, table)
        return (path,)
    files = check_files(path, found)
    if len(files) == 1:
        found.write(path, table)
        return files
    beside = files[1]
    about = f"{ABOUT_UNCERTAINTY}{path.name}, in the place of the values: same unit, same grid"
    found.write(beside, replace(table, values=table.u, u=None, comments=(about, *table.comments)))
    note = f"standard uncertainties of the values: in {beside.name}, on the same grid"
    found.write(path, replace(table, u=None, comments=(*table.comments, note)))
    return files
