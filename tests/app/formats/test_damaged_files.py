"""Every reader of the registry on damaged files: a result, or one line; in bounded time and memory."""

import contextlib
import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.formats import BsdfTable, FormatError, registry, write_rayset, writing
from goniotwin.app.formats.content import BsdfFile, Part, RegularTable, ScatteredBsdf
from goniotwin.app.formats.file import read_head
from goniotwin.app.formats.numerals import NotANumber, parse_number
from goniotwin.app.formats.registry import BUILT_IN, Format, Holds
from goniotwin.twin.optics.illumination.rayset import record
from goniotwin.twin.optics.illumination.unit import IlluminationUnit
from tests.app.formats.test_measured_lists import EDS, FACTORS, FRED, PAB, REFLET, RTD
from tests.app.formats.test_spectral_list import TEXT as SPECTRAL_LIST
from tests.system.mutations import MEMORY_BYTES, TooLong, with_changed_bytes, with_changed_words

CPU_S = 10
"""For one file of the usual size; a file of tens of MB has ten times as much."""
READ_ONLY = {
    "eds": EDS,
    "fred": FRED,
    "pab": PAB,
    "reflet": REFLET,
    "speos_rtd": RTD,
    "reflectance_factors": FACTORS,
    "spectral_list": SPECTRAL_LIST,
    "lighttools": "Symmetry Asymmetric\nSpectralContent Monochrome\nScatterAzimuth 2\n0 180\nScatterRadial 2\n0 60\nDataBegin\n"
    "AOI 30\nPOI 0\nSide Front\nWavelength 550\nScatterType BRDF\nTIS 0.5\n1 2\n3 4\nDataEnd\n",
}
"""A small file of each format that is not written."""
READERS = [each for each in BUILT_IN if each.reads and each.name != "merl"]
"""A file of MERL has 35 MB: test_merl.py has its damaged ones."""


def original(found: Format, folder: Path) -> bytes:
    """A small file of a format."""
    if found.name in READ_ONLY:
        return READ_ONLY[found.name].encode()
    path = folder / f"original{found.suffixes[0]}"
    if Holds.RAYS in found.holds:
        write_rayset(path, record(IlluminationUnit(), 20, seed=1))
        return path.read_bytes()
    grid = (np.array([0.0, 30.0]), np.array([0.0, 90.0, 180.0]), np.array([0.0, 10.0, 90.0]))
    through = Holds.REFLECTED not in found.holds
    table = BsdfTable(*grid, np.full((1, 1, 2, 3, 3), 0.2), transmitted=through, generated=True)
    points = ScatteredBsdf(
        np.array([0.0, 30.0]),
        np.zeros(2),
        np.array([10.0, 30.0]),
        np.array([0.0, 180.0]),
        np.array([0.2, 0.3]),
        np.array([0.01, 0.02]),
        transmitted=np.full(2, through),
    )
    regular = RegularTable(np.array([0.0, 60.0]), np.array([[[0.04, 0.09]]]), transmitted=through)
    possible: dict[Holds, Part] = {Holds.GRID: table, Holds.POINTS: points, Holds.REGULAR: regular}
    parts = tuple(part for kind, part in possible.items() if kind in found.holds)
    assert found.writes, f"no small file of the format {found.name}: add one to READ_ONLY"
    writing.write(path, BsdfFile(parts[:1]), found)
    return path.read_bytes()


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Format, bytes]]:
    folder = tmp_path_factory.mktemp("originals")
    return [(found, original(found, folder)) for found in READERS]


def changed(content: bytes, numbers: np.random.Generator) -> bytes:
    """One to three changes, of words where it is text."""
    for _ in range(int(numbers.integers(1, 4))):
        if numbers.random() < 0.5 or b"\0" in content:
            content = with_changed_bytes(content, numbers)
        else:
            text = with_changed_words(content.decode("utf-8", "replace"), numbers)
            content = text.encode("utf-8", "replace")
    return content


@contextlib.contextmanager
def limited(seconds: int) -> Iterator[None]:
    """Raise TooLong, which no reader catches, after so many seconds of the processor."""

    def interrupt(number: int, frame: object) -> None:
        raise TooLong

    before = signal.signal(signal.SIGPROF, interrupt)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def fault(found: Format, path: Path, seconds: int = CPU_S, *, everywhere: bool = True) -> str | None:
    """What is wrong with how a reader ends; None for a result, which checks itself, and for one line.

    The file may be recognised by its own format alone, or `everywhere`: no format must take long to refuse it.
    """
    try:
        with limited(seconds):
            head = read_head(path, registry.HEAD_BYTES)
            for each in READERS if everywhere else (found,):
                each.load().recognise(head)
            found.read(path)
    except FormatError as error:
        line = str(error)
        return None if line.isprintable() and line.startswith(str(path)) and "; " in line else f"has the message {line!r}"
    except TooLong:
        return f"takes more than {seconds} s"
    except Exception as error:  # noqa: BLE001  (whatever it is, it is a fault)
        return f"raises {type(error).__name__}: {str(error)[:300]}"
    return None


def check(originals: list[tuple[Format, bytes]], path: Path, seeds: range) -> None:
    """Read a mutated file for each seed."""
    for seed in seeds:
        found, content = originals[seed % len(originals)]
        numbers = np.random.default_rng(seed)
        path.write_bytes(changed(content, numbers))
        wrong = fault(found, path, everywhere=numbers.random() < 0.1)
        assert wrong is None, f"seed {seed}: {found.name} {wrong}"


def test_every_original_is_read_and_recognised(originals: list[tuple[Format, bytes]], tmp_path: Path) -> None:
    for found, content in originals:
        path = tmp_path / f"file{found.suffixes[0] if found.suffixes else '.txt'}"
        path.write_bytes(content)
        assert found.read(path), found.name
        assert registry.recognise(path, {*registry.BSDF, Holds.RAYS}) is found


def test_a_damaged_file_is_read_or_refused_in_one_line(originals: list[tuple[Format, bytes]], tmp_path: Path) -> None:
    check(originals, tmp_path / "damaged", range(12 * len(originals)))


def test_a_number_of_very_many_digits_is_refused_at_once() -> None:
    with limited(CPU_S), pytest.raises(NotANumber):
        parse_number("1" * 100_000 + "x")


@pytest.mark.long
def test_a_hundred_thousand_damaged_files_are_read_or_refused(originals: list[tuple[Format, bytes]], tmp_path: Path) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    check(originals, tmp_path / "damaged", range(100_000))
    assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) < MEMORY_BYTES


@pytest.mark.long
@pytest.mark.parametrize("found", READERS, ids=lambda found: str(found.name))
def test_a_file_that_goes_on_and_on_is_read_or_refused(found: Format, tmp_path: Path) -> None:
    """Files of 60 MB: their last lines again and again, one line without end, one number, lists in lists."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    content = original(found, tmp_path)
    half = content[len(content) // 2 :]
    path = tmp_path / "damaged"
    for size, endless in ((60, half), (60, b"1 "), (60, b"1"), (60, b"[["), (60, b"\n")):
        path.write_bytes(content + endless * (size * 1_000_000 // len(endless)))
        wrong = fault(found, path, 10 * CPU_S)
        assert wrong is None, f"{endless[:20]!r} without end: {wrong}"
    assert 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) < MEMORY_BYTES
