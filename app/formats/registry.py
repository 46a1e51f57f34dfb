"""Registry of file formats: what each is called, how a file of it is recognised, and what it can hold.

A file is recognised by its content first, then by its suffix. A format is one module, its codec, and one line in `BUILT_IN`.
What is exchanged is a `BsdfFile`, in 1/sr and degrees, or a `Rayset`. Uncertainties, and the mask of what was not measured, go
to files of the same grid beside the one that has no room for them.
Another package offers formats as entry points of the group `goniotwin.formats`, each a `Format` or a tuple of them. No codec is
imported before a file is read or written, because the help of the commands lists the formats.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import FormatError, begins_as, check_writable, describe, read_head

if TYPE_CHECKING:
    from goniotwin.app.formats.content import BsdfFile

GROUP = "goniotwin.formats"
HDF5, TENSORS = b"\x89HDF\r\n\x1a\n", b"tensor_file"
"""What the binary formats begin with: the reader of a damaged one names its fault."""
HEAD_BYTES = 1 << 20
"""A file is recognised by so many bytes: comments at the top of a table can be long."""
ABOUT_UNCERTAINTY = "standard uncertainties of the values in "
ABOUT_MASK = "mask of the values that were not measured in "
"""A comment of every file of uncertainties, or of a mask, begins with this; the name of the table follows."""


class Holds(StrEnum):
    """What a file of a format can hold. The first four are the kinds of content; a format has at least one of them."""

    GRID = "a grid on specular coordinates"
    POINTS = "scattered points"
    REGULAR = "regular reflectance or transmittance"
    RAYS = "rays of a light source"
    COLUMNS = "columns of any names"
    SAMPLES = "several samples"
    SIGMAS = "several sigmas"
    WAVELENGTHS = "several wavelengths"
    RGB = "red, green and blue"
    XYZ = "tristimulus values X, Y and Z"
    COLOURS = "colours of any names"
    PSI = "several azimuths of the light (psi)"
    REFLECTED = "reflected light"
    TRANSMITTED = "transmitted light"
    LIGHTS = "reflected and transmitted light in one file"
    SIDES = "both sides of the sample"
    UNCERTAINTY = "the uncertainty of each value"
    MASK = "the mask of what was not measured"
    FLAGS = "flags of each value"
    METADATA = "metadata in fields of their own"
    COMMENTS = "comments"


BSDF = frozenset({Holds.GRID, Holds.POINTS, Holds.REGULAR})
"""The kinds of content of a `BsdfFile`."""
KINDS = BSDF | {Holds.RAYS}
PRIMARIES = {frozenset({"red", "green", "blue"}): Holds.RGB, frozenset({"X", "Y", "Z"}): Holds.XYZ}
"""Colours that formats have keywords for."""


class Codec(Protocol):
    """Reader and writer of a format; a module with these functions is one.

    The content is a `BsdfFile`, or a `Rayset` (RAYS); a format of COLUMNS writes a `PointStream`, too. A codec
    that only reads needs no `write`. Whatever else a codec of another package raises is reported as its fault.
    """

    def recognise(self, head: bytes) -> bool:
        """Whether a file that begins with `head` is of this format; never raises."""

    def read(self, path: Path) -> Any:
        """Read a file. Raises FormatError."""

    def write(self, path: Path, content: Any) -> Sequence[str] | None:
        """Write a file completely or not at all; returns what is to be reported about it, if anything. Raises FormatError."""


@dataclass(frozen=True)
class Format:
    """A file format. `name` is one word, as in `export --format NAME`; `title` is one line for lists.

    `suffixes` are in lower case, with the dot; a file of a format without any is found by its content alone. `codec` may be the
    name of its module. With `folders`, a folder of files is one table: its reader takes the folder, too, and the first of its
    files is recognised. One that `resamples` has a grid of its own in each file, so that no uncertainties and no mask of the
    same grid can be beside it. Raises ValueError for a name, suffix or content that is not possible.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    holds: frozenset[Holds]
    codec: Codec | str
    reads: bool = True
    writes: bool = True
    folders: bool = False
    resamples: bool = False

    def __post_init__(self) -> None:
        """Check the fields."""
        if not self.name.isidentifier() or not KINDS & self.holds or (Holds.RAYS in self.holds and BSDF & self.holds):
            kinds = join_words(each for each in Holds if each in BSDF)
            raise ValueError(f"format {self.name!r}: give one word as its name, and what it holds: {kinds}; or {Holds.RAYS}")
        if (self.writes and not self.suffixes) or not all(
            each.startswith(".") and each == each.lower() for each in self.suffixes
        ):
            raise ValueError(f"format {self.name!r}: suffixes are in lower case and begin with a dot, not {self.suffixes}")
        if Holds.COLOURS in self.holds:
            object.__setattr__(self, "holds", self.holds | {Holds.RGB, Holds.XYZ})

    def __str__(self) -> str:
        return f"{self.name} ({', '.join(self.suffixes)})" if self.suffixes else self.name

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
            if Holds.RAYS not in self.holds:
                # Loads 102 modules, numpy among them: 95 ms, which help, that lists the formats, does without.
                from goniotwin.app.formats.content import BsdfFile, read_gaps

                if not isinstance(content, BsdfFile):
                    raise TypeError(f"it read a {type(content).__name__}, not BsdfFile")
                return read_gaps(content)
            return content

    def write(self, path: Path, content: Any) -> Sequence[str]:
        """Write a file, see `Codec`. Raises FormatError."""
        with self._faults_named(path):
            return self.load().write(path, content) or ()

    @contextmanager
    def _faults_named(self, path: Path) -> Iterator[None]:
        """Raise FormatError, which names the format, where the codec of another package raises anything else."""
        try:
            yield
        except UserError:
            raise
        except Exception as error:
            if self in BUILT_IN:  # a fault of this program
                raise
            wrong = f"the codec of the format {self.name} failed ({type(error).__name__}: {error})"
            raise FormatError(path, wrong, "correct its installation, or use another format") from error


_TABLE = frozenset({Holds.GRID, Holds.SIGMAS, Holds.WAVELENGTHS, Holds.PSI, Holds.COMMENTS})
_LUMICEPT = _TABLE | {Holds.RGB}
_FACTORS = frozenset({Holds.REGULAR, Holds.SIGMAS, Holds.WAVELENGTHS, Holds.RGB, Holds.COMMENTS})
_BOTH = frozenset({Holds.REFLECTED, Holds.TRANSMITTED})
_LIST = frozenset({Holds.POINTS, Holds.SIGMAS, Holds.PSI, Holds.REFLECTED, Holds.COMMENTS})
_MEASURED = frozenset({Holds.POINTS, Holds.SIGMAS, Holds.SAMPLES, Holds.REFLECTED, Holds.COMMENTS})
_CSV = frozenset(set(Holds) - {Holds.GRID, Holds.REGULAR, Holds.RAYS, Holds.METADATA})

BUILT_IN = (
    Format("ddr", "Lumicept table of a BRDF", (".ddr",), _LUMICEPT | {Holds.REFLECTED}, "goniotwin.app.formats.ddr"),
    Format("ddt", "Lumicept table of a BTDF", (".ddt",), _LUMICEPT | {Holds.TRANSMITTED}, "goniotwin.app.formats.ddr"),
    Format("sdr", "Lumicept regular reflectance", (".sdr",), _FACTORS | {Holds.REFLECTED}, "goniotwin.app.formats.sdr"),
    Format("sdt", "Lumicept regular transmittance", (".sdt",), _FACTORS | {Holds.TRANSMITTED}, "goniotwin.app.formats.sdr"),
    Format(
        "ssdd",
        "BRDF, BTDF and regular factors of a sample",
        (".ssdd",),
        _TABLE | _FACTORS | _BOTH | {Holds.XYZ, Holds.LIGHTS, Holds.METADATA},
        "goniotwin.app.formats.ssdd",
    ),
    Format(
        "zemax",
        "Zemax tabular BRDF or BTDF, Monochrome or XYZ",
        (".bsdf",),
        (_TABLE - {Holds.WAVELENGTHS}) | _BOTH | {Holds.XYZ},
        "goniotwin.app.formats.zemax",
    ),
    Format(
        "lighttools",
        "LightTools tabular BSDF, by libbsdf's convention",
        (".bsdf",),
        (_LIST - {Holds.PSI}) | _BOTH | {Holds.WAVELENGTHS, Holds.XYZ, Holds.LIGHTS, Holds.SIDES},
        "goniotwin.app.formats.lighttools",
        writes=False,
    ),
    Format("csv", "every point, with its uncertainty and flags", (".csv",), _CSV, "goniotwin.app.formats.points"),
    Format(
        "astm",
        "list in the style of ASTM E1392",
        (".astm",),
        _LIST | {Holds.WAVELENGTHS, Holds.RGB, Holds.XYZ, Holds.TRANSMITTED},
        "goniotwin.app.formats.astm",
    ),
    Format(
        "bird",
        "BiRD's universal BRDF format (JSON)",
        (".brdf", ".json"),
        _LIST | {Holds.WAVELENGTHS, Holds.UNCERTAINTY, Holds.METADATA},
        "goniotwin.app.formats.bird",
    ),
    Format(
        "spectral_list",
        "list of spectral samples, Cornell's gonioreflectometer",
        (".brdf",),
        _LIST | {Holds.WAVELENGTHS},
        "goniotwin.app.formats.spectral_list",
        writes=False,
    ),
    Format("fred", "FRED's text of a tabulated BSDF", (), _LIST, "goniotwin.app.formats.fred", writes=False),
    Format(
        "eds",
        "engineered diffusers of VIAVI (RPC Photonics)",
        (),
        (_LIST - {Holds.REFLECTED}) | {Holds.SAMPLES, Holds.TRANSMITTED},
        "goniotwin.app.formats.eds",
        writes=False,
        folders=True,
    ),
    Format(
        "pab",
        "text of pab's goniophotometers, by description",
        (),
        _LIST | {Holds.SAMPLES, Holds.XYZ, Holds.TRANSMITTED, Holds.LIGHTS, Holds.SIDES},
        "goniotwin.app.formats.pab",
        writes=False,
        folders=True,
    ),
    Format("reflet", "text export of a REFLET goniophotometer", (), _MEASURED, "goniotwin.app.formats.reflet", writes=False),
    Format("speos_rtd", "Speos export of it", (".rtd",), _MEASURED, "goniotwin.app.formats.speos_rtd", writes=False),
    Format(
        "reflectance_factors",
        "list of reflectance factors in bands",
        (),
        _LIST | {Holds.WAVELENGTHS},
        "goniotwin.app.formats.reflectance_factors",
        writes=False,
    ),
    Format(
        "rgl",
        "tensor file for Mitsuba 3, as of the RGL",
        (".bsdf",),
        _TABLE | {Holds.REFLECTED},
        "goniotwin.app.formats.rgl",
        resamples=True,
    ),
    Format(
        "merl",
        "MERL's binary files",
        (".binary",),
        frozenset({Holds.GRID, Holds.SIGMAS, Holds.RGB, Holds.REFLECTED}),
        "goniotwin.app.formats.merl",
        writes=False,
    ),
    Format(
        "archive",
        "HDF5 archive; for a journal, with all inputs of its uncertainties",
        (".h5", ".hdf5", ".nxs"),
        frozenset(set(Holds) - {Holds.RAYS, Holds.COLUMNS}),
        "goniotwin.app.formats.archive",
    ),
    Format(
        "rayset",
        "recorded rays of the illumination",
        (".h5", ".hdf5"),
        frozenset({Holds.RAYS, Holds.WAVELENGTHS}),
        "goniotwin.app.formats.rayset",
    ),
)
_registered: list[Format] = []


def register(added: Format) -> None:
    """Add a format for as long as the program runs. Raises ValueError for a name that exists."""
    _refuse_name(added, formats())
    _registered.append(added)


@contextmanager
def registered(*added: Format) -> Iterator[None]:
    """Formats that are there within the block alone. Raises ValueError for a name that exists."""
    before = list(_registered)
    try:
        for each in added:
            register(each)
        yield
    finally:
        _registered[:] = before


def formats() -> tuple[Format, ...]:
    """All formats: the program's own first, then those of other packages."""
    return (*BUILT_IN, *plug_ins()[0], *_registered)


@cache
def plug_ins() -> tuple[tuple[Format, ...], tuple[str, ...]]:
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
    return FormatError(place, "; ".join([wrong, *plug_ins()[1]]), remedy)


# ---- reading ----


def recognise(path: Path, kinds: Collection[Holds] = BSDF) -> Format:
    """The format of a file with one of these kinds of content, by its content first, then by its suffix. Raises FormatError.

    A damaged file, whose content is of no format, is of the first format with its suffix, whose reader names the fault.
    """
    folder = path.is_dir()
    head, suffix = read_head(_first_file(path) if folder else path, HEAD_BYTES), path.suffix.lower()
    possible = [each for each in formats() if each.reads and (each.folders or not folder)]
    alike = [each for each in possible if _is_like(each, head)]
    named = [each for each in possible if suffix in each.suffixes]
    wanted = f"give {join_words(str(each) for each in formats() if each.reads and each.holds.intersection(kinds))}"
    if not alike and begins_as(head) not in (None, begins_as(HDF5), begins_as(TENSORS)):
        named = []  # a picture, a page of the web: of no format, whatever its suffix
    if not (alike or named) and folder:
        raise FormatError(path, "is a folder, and its files are no table of a known format", "give a file of it")
    if not (alike or named):
        of_none = "its content is of no" if suffix in suffixes(possible) else "neither its content nor its suffix is of a"
        raise _unknown(path, f"is {describe(head)}: {of_none} known format", wanted)
    found = [each for each in named if each in alike] or alike or named[:1]
    found = [each for each in found if each.holds.intersection(kinds)] or found[:1]
    if not found[0].holds.intersection(kinds):
        wrong = f"it is a {found[0].name} file, which does not hold {join_words(each for each in Holds if each in kinds)}"
        raise _unknown(path, wrong, wanted)
    if len(found) > 1:
        wrong = f"its content is that of {join_words(map(str, found))}, and only the suffix distinguishes them"
        raise FormatError(path, wrong, "rename the file")
    return found[0]


def _first_file(folder: Path) -> Path:
    """The first file of a folder by its name. Raises FormatError."""
    try:
        return next(each for each in sorted(folder.iterdir()) if each.is_file() and not each.name.startswith("."))
    except (OSError, StopIteration):
        raise FormatError(
            folder, "is a folder without files that can be read", "give a file, or a folder of one table"
        ) from None


def _is_like(found: Format, head: bytes) -> bool:
    """Whether a file that begins with `head` is of a format; a codec that fails must not stop the others."""
    try:
        return bool(found.load().recognise(head))
    except Exception:  # noqa: BLE001  (the code of another package can raise anything)
        return False


def read(path: Path) -> "BsdfFile":
    """What a file holds, whatever its format. Raises FormatError."""
    return cast("BsdfFile", recognise(path).read(path))


# ---- writing ----


def format_named(name: str, kinds: Collection[Holds]) -> Format:
    """The format of this name to write one of these kinds in. Raises FormatError."""
    possible = {each.name: each for each in formats() if each.writes and each.holds.intersection(kinds)}
    if name not in possible:
        wrong = f"there is no such format for {join_words(each for each in Holds if each in kinds)}"
        raise _unknown(f"format {name!r}", wrong, f"give {join_words(possible)}")
    return possible[name]


def format_for(path: Path, kinds: Collection[Holds], needs: Collection[Holds] = ()) -> Format:
    """The format to write a file in: the first with its suffix that holds one of these kinds. Raises FormatError.

    It has to hold all of `needs`.
    """
    possible = [each for each in formats() if each.writes and each.holds.intersection(kinds)]
    named = [each for each in possible if path.suffix.lower() in each.suffixes]
    if not named:
        other = next((each for each in formats() if path.suffix.lower() in each.suffixes), None)
        wrong = "the format is unknown" if other is None else f"the format {other.name} is not written here"
        raise _unknown(path, wrong, f"give a name that ends with {join_words(suffixes(possible))}")
    check_holds(path, named[0], needs)
    return named[0]


def check_holds(path: Path | str, found: Format, needs: Collection[Holds]) -> None:
    """Raise FormatError, with the formats to use instead, if a format cannot be written or does not hold all of `needs`."""
    missing = [each for each in Holds if each in needs and each not in found.holds]
    if not missing and found.writes:
        return
    wrong = f"the format {found.name} does not hold {join_words(missing, 'and')}" if missing else f"{found.name} is only read"
    found_others = others(needs)
    raise FormatError(path, wrong, f"use {found_others}" if found_others else "write it in several files")


def others(needs: Collection[Holds]) -> str:
    """The formats that hold all of these, in words; a grid can be made of points, and points of a grid."""
    scattered = {Holds.GRID, Holds.POINTS}
    kinds = BSDF if Holds.REGULAR in needs else scattered
    found = [str(each) for each in writers(*set(needs) - scattered) if each.holds & kinds]
    return join_words(found) if found else ""


def uncertainty_path(path: Path) -> Path:
    """The file of the uncertainties beside a table that cannot hold them: NAME.u.ddr beside NAME.ddr."""
    return path.with_suffix(f".u{path.suffix}")


def mask_path(path: Path) -> Path:
    """The mask beside a table that cannot hold it: NAME.mask.ddr beside NAME.ddr."""
    return path.with_suffix(f".mask{path.suffix}")


def described_table(content: "BsdfFile") -> str | None:
    """The table whose uncertainties or mask a content has in the place of values, as in "the mask of NAME"; None for values."""
    for line in (line for comments in (content, *content.parts) for line in comments.comments):
        for about, what in ((ABOUT_UNCERTAINTY, "the uncertainties"), (ABOUT_MASK, "the mask")):
            if line.startswith(about):
                return f"{what} of {line.removeprefix(about).partition(', in the place of ')[0]}"
    return None


def files_beside(path: Path, found: Format) -> dict[str, Path]:
    """The files that a result in a format may have beside it, by the comment that marks them."""
    beside: dict[str, Path] = {}
    if found.resamples:
        return beside
    if found.holds & BSDF and Holds.UNCERTAINTY not in found.holds:
        beside[ABOUT_UNCERTAINTY] = uncertainty_path(path)
    if Holds.GRID in found.holds and Holds.MASK not in found.holds:
        beside[ABOUT_MASK] = mask_path(path)
    return beside


def check_files(path: Path, found: Format) -> None:
    """Check the files of a result, so that a long computation does not end without it.

    Raises FormatError for a codec that cannot be loaded, a file that cannot be written, or another file in the place of the
    uncertainties or of the mask.
    """
    found.load()
    check_writable(path)
    table = path.with_name(f"{Path(path.stem).stem}{path.suffix}")
    for about, beside in files_beside(table, found).items():
        if beside == path:
            what = "uncertainties" if about is ABOUT_UNCERTAINTY else "mask"
            raise FormatError(path, f"the {what} of {table.name} would have this name", "choose another one")
    for about, beside in files_beside(path, found).items():
        check_writable(beside)
        if beside.exists() and about.encode() not in read_head(beside, HEAD_BYTES):
            what = "uncertainties go" if about is ABOUT_UNCERTAINTY else "mask goes"
            wrong = f"the {what} to {beside}, and another file is there"
            raise FormatError(path, wrong, "choose another name, or move that file")
