"""The registry of file formats: recognition by content, then by suffix; what a format holds; formats of other packages."""

import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.formats import BsdfTable, FormatError, PointStream, registry, writing
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.coverage import covered
from goniotwin.app.formats.registry import BUILT_IN, KINDS, Format, Holds
from tests.conftest import REPOSITORY

DDR, DDT, ZEMAX, CSV, RAYSET = (each for each in BUILT_IN if each.name in ("ddr", "ddt", "zemax", "csv", "rayset"))
AXES = np.array([0.0, 60.0, 90.0]), np.array([0.0, 90.0, 180.0]), np.array([0.0, 45.0, 180.0])


def table(**changes: Any) -> BsdfTable:
    values = np.linspace(0.1, 0.3, 27).reshape(1, 1, 3, 3, 3)
    return replace(BsdfTable(*AXES, values, comments=("a note",)), **changes)


def content(**changes: Any) -> BsdfFile:
    return BsdfFile((table(**changes),))


def read_table(path: Path) -> BsdfTable:
    return registry.read(path).only_table()


@pytest.fixture
def add() -> Iterator[Callable[[Format], object]]:
    """Adds formats for one test."""
    with registry.registered():
        yield registry.register


@pytest.fixture
def clean() -> Iterator[None]:
    """Formats of other packages are looked for again, before and after."""
    registry.plug_ins.cache_clear()
    yield
    registry.plug_ins.cache_clear()


# ---- recognition ----


@pytest.mark.parametrize("suffix", ["", ".txt", ".bsdf", ".ddr", ".csv", ".h5"])
def test_a_table_is_read_by_its_content_whatever_its_suffix(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"table{suffix}"
    ZEMAX.load().write(path, content())
    np.testing.assert_allclose(read_table(path).values, table().values, rtol=1e-8)


def test_the_suffix_distinguishes_reflected_and_transmitted_light(tmp_path: Path) -> None:
    for each in (DDR, DDT):
        path = tmp_path / f"table{each.suffixes[0].upper()}"
        each.load().write(path, content())
        assert registry.recognise(path) is each
        assert read_table(path).transmitted == (each is DDT)
    lost = path.rename(tmp_path / "table.bsdf")
    with pytest.raises(FormatError, match=r"its content is that of ddr \(\.ddr\) or ddt \(\.ddt\), .* rename the file"):
        registry.read(lost)


def test_a_file_of_another_kind_is_refused_with_what_it_is(tmp_path: Path) -> None:
    path = tmp_path / "table.ddr"
    CSV.load().write(path, PointStream(["a comment"], [{"theta_deg": [1.0, 2.0], "flags": ["", "dead"]}]))
    with pytest.raises(FormatError, match=r"it is a csv file, which does not hold a grid .*; give ddr \(\.ddr\), ddt"):
        registry.recognise(path, {Holds.GRID})
    with pytest.raises(FormatError, match=r"does not hold rays of a light source; give rayset \(\.h5, \.hdf5\)"):
        registry.recognise(path, {Holds.RAYS})
    with pytest.raises(FormatError, match=r"table\.ddr: the column bsdf_per_sr is missing; give a CSV of a BSDF"):
        registry.read(path)


@pytest.mark.parametrize(
    ("head", "what"),
    [
        (b"1 2 3\n4 5 6\n", "text that begins with '1 2 3'"),
        (b"\x89PNG\r\n", r"a picture \(PNG\)"),
        (b"", "empty"),
        (b"\x00\x01", "binary data"),
        (b"SQLite format 3\0", r"a data file \(journal\) or another database"),
    ],
)
def test_an_unknown_file_is_refused_with_what_it_is_and_what_can_be_read(head: bytes, what: str, tmp_path: Path) -> None:
    unknown = tmp_path / "a.xyz"
    unknown.write_bytes(head)
    with pytest.raises(FormatError, match=f"is {what}: neither its content nor its suffix is of a known format; give ddr"):
        registry.read(unknown)


@pytest.mark.parametrize(
    ("head", "what"), [(b"<?xml version='1.0'?>", "XML"), (b"<!DOCTYPE html>", r"a page of the web \(HTML\)")]
)
def test_what_is_of_no_format_is_refused_as_what_it_is_whatever_its_suffix(head: bytes, what: str, tmp_path: Path) -> None:
    unknown = tmp_path / "a.bsdf"
    unknown.write_bytes(head)
    with pytest.raises(FormatError, match=f"is {what}: its content is of no known format; give ddr"):
        registry.read(unknown)
    unknown.write_bytes(b"OPTIS - brdf surface file v8.0\n")  # as Ansys describes it: Structure of BRDF files, row 1
    with pytest.raises(FormatError, match=r"it begins with 'OPTIS - brdf surface file v8\.0', and of Speos only"):
        registry.read(unknown.rename(tmp_path / "a.brdf"))


def test_a_folder_is_a_table_of_a_format_that_has_such(tmp_path: Path) -> None:
    class Cuts:
        """One file an incidence."""

        def recognise(self, head: bytes) -> bool:
            return head.startswith(b"!!cut")

        def read(self, path: Path) -> BsdfFile:
            return content(comments=tuple(sorted(each.name for each in path.iterdir())))

        def write(self, path: Path, content: BsdfFile) -> None:
            raise NotImplementedError

    cuts = Format("cuts", "a cut an incidence", (".cut",), frozenset({Holds.GRID}), Cuts(), writes=False, folders=True)
    folder = tmp_path / "cuts"
    folder.mkdir()
    with registry.registered(cuts):
        with pytest.raises(FormatError, match="is a folder without files"):
            registry.read(folder)
        for name in ("30", "0"):
            (folder / name).write_bytes(b"!!cut")
        assert read_table(folder).comments == ("0", "30")
    with pytest.raises(FormatError, match=r"is a folder, and its files are no table of a known format"):
        registry.read(folder)


def test_a_damaged_file_is_read_by_its_suffix_and_refused_with_its_fault(tmp_path: Path) -> None:
    path = tmp_path / "a.ddr"
    path.write_text("Sorce Measured\n", encoding="utf-8")
    with pytest.raises(FormatError, match=r"line 1: 'Sorce' is not a keyword of a \.ddr file; did you mean Source"):
        registry.read(path)


def test_long_comments_at_the_top_do_not_hide_the_content(tmp_path: Path) -> None:
    for each, path in ((DDR, tmp_path / "a.ddr"), (ZEMAX, tmp_path / "b.txt"), (CSV, tmp_path / "c.txt")):
        comments = tuple(f"range {k} of TypeSym, ScatterType, a,b,c" for k in range(3000))
        if each is CSV:
            each.load().write(path, PointStream(comments, [{"a": [1.0], "b": [2.0]}]))
        else:
            each.load().write(path, content(comments=comments))
        with path.open("rb") as file:
            head = file.read(registry.HEAD_BYTES)
        assert [found.name for found in BUILT_IN if found.load().recognise(head)] == {
            DDR: ["ddr", "ddt"],
            ZEMAX: ["zemax"],
            CSV: ["csv"],
        }[each]


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_recognition_never_raises(head: bytes) -> None:
    for each in BUILT_IN:
        assert each.load().recognise(head) in (True, False)


# ---- round trips ----

grids = st.tuples(
    st.lists(st.integers(0, 900), min_size=1, max_size=4, unique=True).map(sorted),
    st.sampled_from([(0, 1800), (0, 900, 1800), (0, 900, 3600)]),
    st.lists(st.integers(0, 1800), min_size=1, max_size=4, unique=True).map(sorted),
    st.sampled_from([None, (450.0,), (450.0, 650.5)]),
    st.integers(0, 2**32 - 1),
)


@settings(deadline=None)
@given(grids, st.booleans(), st.booleans())
def test_a_table_is_read_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory,
    grid: tuple[list[int], tuple[int, ...], list[int], tuple[float, ...] | None, int],
    transmitted: bool,
    generated: bool,
) -> None:
    sigma, phi, theta = (np.array(tenths) / 10.0 for tenths in grid[:3])
    wavelengths, seed = grid[3:]
    shape = len(wavelengths or (None,)), 1, sigma.size, phi.size, theta.size
    values = np.random.default_rng(seed).random(shape) * 10.0 ** np.random.default_rng(seed + 1).integers(-9, 3)
    written = BsdfTable(
        sigma, phi, theta, values, wavelengths, transmitted=transmitted, generated=generated, comments=("ein µ",)
    )
    folder = tmp_path_factory.mktemp("tables")
    for each in registry.writers(Holds.GRID):
        if each.name == "rgl":  # it resamples; test_rgl.py
            continue
        given = BsdfFile((written,))
        if not writing.content_needs(given) <= each.holds:
            with pytest.raises(FormatError, match=f"the format {each.name} does not hold"):
                writing.write(folder / "a", given, each)
            continue
        path = folder / f"a{each.suffixes[0]}"
        assert writing.write(path, given, each) == (path,)
        found = read_table(path)
        for name in ("sigma_deg", "phi_deg", "theta_deg", "psi_deg"):
            np.testing.assert_allclose(getattr(found, name), getattr(written, name), rtol=1e-8)
        np.testing.assert_allclose(found.values, written.values, rtol=1e-8)
        assert (found.transmitted, found.generated) == (transmitted, generated)
        assert found.wavelengths_nm == wavelengths


def test_uncertainties_and_mask_are_in_files_of_the_same_grid_beside(tmp_path: Path) -> None:
    known = np.ones((1, 1, 3, 3, 3), dtype=bool)
    known[0, 0, 1, 2] = False
    given = content(u=0.1 * table().values, known=known)
    for each in (DDR, ZEMAX):
        path = tmp_path / f"my.paint{each.suffixes[0]}"
        files = writing.write(path, given, each)
        assert files == tuple(tmp_path / f"my.paint{word}{each.suffixes[0]}" for word in ("", ".u", ".mask"))
        values, u, mask = (read_table(file) for file in files)
        np.testing.assert_allclose(u.values, 0.1 * values.values, rtol=1e-8)
        np.testing.assert_allclose(mask.values, np.where(known, 0.0, 1.0), rtol=1e-8)
        for beside, what in ((u, "the uncertainties"), (mask, "the mask")):
            assert registry.described_table(BsdfFile((beside,))) == f"{what} of my.paint{each.suffixes[0]}"
            for name in ("sigma_deg", "phi_deg", "theta_deg"):
                assert np.array_equal(getattr(beside, name), getattr(values, name))
        for word in ("u", "mask"):
            assert any(f"in my.paint.{word}{each.suffixes[0]}" in line for line in values.comments)
        # Of a later result without them the old ones would be wrong.
        assert writing.write(path, content(), each) == (path,)
        assert not files[1].exists()
        assert not files[2].exists()


def test_the_total_scatter_of_a_lambertian_table_is_its_reflectance(tmp_path: Path) -> None:
    axes = np.array([0.0, 30.0, 60.0]), np.arange(0.0, 181.0, 2.0), np.arange(0.0, 181.0, 1.0)
    flat = BsdfTable(*axes, np.full((1, 1, 3, 91, 181), 0.5 / np.pi))
    path = tmp_path / "a.bsdf"
    ZEMAX.load().write(path, BsdfFile((flat,)))
    found = [float(each) for each in re.findall(r"TIS\s+(\S+)", path.read_text(encoding="utf-8"))]
    np.testing.assert_allclose(found, 0.5, rtol=1e-3)  # of the trapezoidal rule


# ---- what formats hold ----


def test_a_file_name_gives_the_format_and_a_refusal_names_the_others(tmp_path: Path) -> None:
    assert registry.format_for(tmp_path / "A.DDR", {Holds.GRID}) is DDR
    with pytest.raises(FormatError, match=r"the format is unknown; give a name that ends with \.ddr, \.ddt, .* or \.\w+$"):
        registry.format_for(tmp_path / "a.txt", {Holds.GRID, Holds.POINTS})
    assert registry.format_for(tmp_path / "a.h5", {Holds.GRID}).name == "archive"
    with pytest.raises(
        FormatError, match=r"the format zemax does not hold several wavelengths; use ddr \(\.ddr\), ddt .* csv \(\.csv\)"
    ):
        registry.format_for(tmp_path / "a.bsdf", {Holds.GRID}, {Holds.WAVELENGTHS})


def test_an_impossible_format_is_refused() -> None:
    for change in (
        {"name": "two words"},
        {"suffixes": ()},
        {"suffixes": ("DDR",)},
        {"holds": frozenset({Holds.FLAGS})},
        {"holds": KINDS},
    ):
        with pytest.raises(ValueError, match=r"format '.*': "):
            replace(DDR, **change)
    with pytest.raises(ValueError, match="there is a format 'ddr' already"):
        registry.register(replace(DDR, title="another"))


def test_the_page_on_formats_has_a_row_for_each_format() -> None:
    text = (REPOSITORY / "docs" / "exchange" / "formats.md").read_text(encoding="utf-8")
    for each in BUILT_IN:
        done = " and ".join(word for word, does in (("read", each.reads), ("written", each.writes)) if does)
        holds = ", ".join(found.name.lower() for found in Holds if found in each.holds)
        assert f"\n| `{each.name}` | {', '.join(each.suffixes) or 'any'} | {done} | {holds} |\n" in text
    for found in Holds:
        assert f"\n| {found.name.lower()} | {found} |\n" in text


# ---- formats of other packages ----


def install(folder: Path, name: str, code: str) -> None:
    """A package with a module and an entry point of the group, as an installer leaves it."""
    (folder / f"{name}.py").write_text(code, encoding="utf-8")
    about = folder / f"{name}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", encoding="utf-8")
    (about / "entry_points.txt").write_text(f"[{registry.GROUP}]\n{name} = {name}:FORMATS\n", encoding="utf-8")


@pytest.mark.usefixtures("clean")
def test_an_installed_package_offers_formats_and_a_faulty_one_does_not_stop_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = """
from goniotwin.app.formats.registry import BUILT_IN
from dataclasses import replace
FORMATS = (replace(BUILT_IN[0], name="mine", suffixes=(".mine",)),)
"""
    for name, text in (
        ("good_tables", code),
        ("bad_tables", "raise OSError('no licence')"),
        ("odd_tables", "FORMATS = 3"),
        ("same_tables", code.replace('"mine"', '"ddr"')),
    ):
        install(tmp_path, name, text)
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    assert [each.name for each in registry.formats()] == [*(each.name for each in BUILT_IN), "mine"]
    with pytest.raises(FormatError) as refused:
        registry.format_named("theirs", KINDS)
    for fault in (
        "bad_tables of the package bad_tables cannot be used: no licence",
        "it is a int, not a Format",
        "there is a format 'ddr' already",
        "give ddr, ddt, ",
        "rayset or mine",
    ):
        assert fault in str(refused.value)


def test_the_content_decides_between_formats_that_share_a_suffix(tmp_path: Path, add: Callable[[Format], object]) -> None:
    class Other:
        """Another format with the suffix .bsdf, as there are several in the field."""

        def recognise(self, head: bytes) -> bool:
            return head.startswith(b"tensor_file")

        def read(self, path: Path) -> BsdfFile:
            return content(comments=("other",))

        def write(self, path: Path, content: Any) -> None:
            raise NotImplementedError

    other = Format("other", "another .bsdf", (".bsdf",), frozenset({Holds.GRID}), Other(), writes=False)
    add(other)
    path = tmp_path / "a.bsdf"
    path.write_bytes(b"tensor_file\0\1\0")
    assert read_table(path).comments == ("other",)
    ZEMAX.load().write(path, content())
    assert read_table(path).comments != ("other",)
    assert registry.format_for(path, {Holds.GRID}) is ZEMAX
    with pytest.raises(FormatError, match="other is only read; use ddr"):
        registry.check_holds(path, other, {Holds.GRID})


def test_a_format_that_cannot_be_loaded_stops_no_other(tmp_path: Path, add: Callable[[Format], object]) -> None:
    lost = Format("lost", "a table without its module", (".lost",), frozenset({Holds.GRID}), "no_such_package.tables")
    add(lost)
    path = tmp_path / "a.txt"
    ZEMAX.load().write(path, content())
    assert registry.recognise(path) is ZEMAX
    path = tmp_path / "a.lost"
    path.write_text("1 2 3", encoding="utf-8")
    with pytest.raises(
        FormatError, match=r"format 'lost': its codec cannot be loaded \(No module .*; correct its installation"
    ):
        registry.read(path)


@pytest.mark.parametrize(
    ("code", "fault"),
    [
        ("def recognise(head:", "was never closed"),
        ("x = undefined", "name 'undefined' is not"),
        ("raise OSError('no licence')", "no licence"),
    ],
)
def test_a_codec_with_a_fault_of_its_own_stops_no_other(
    code: str, fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, add: Callable[[Format], object]
) -> None:
    (tmp_path / "faulty_codec.py").write_text(code, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    faulty = Format("faulty", "a format of the test", (".faulty",), frozenset({Holds.GRID}), "faulty_codec")
    add(faulty)
    path = tmp_path / "a.txt"
    ZEMAX.load().write(path, content())
    assert registry.recognise(path) is ZEMAX
    for ask in (faulty.load, lambda: registry.check_files(tmp_path / "b.faulty", faulty)):
        with pytest.raises(FormatError, match=f"format 'faulty': its codec cannot be loaded .*{fault}"):
            ask()


def test_a_codec_that_fails_is_named_and_no_file_is_blamed(tmp_path: Path, add: Callable[[Format], object]) -> None:
    class Faulty:
        """A codec that keeps to none of the rules."""

        def recognise(self, head: bytes) -> bool:
            raise ValueError("no head")

        def read(self, path: Path) -> Any:
            return {"values": 1}

        def write(self, path: Path, content: Any) -> None:
            raise KeyError("abc")

    faulty = Format(
        "faulty", "a format of the test", (".faulty",), frozenset({Holds.GRID, Holds.REFLECTED, Holds.SIGMAS}), Faulty()
    )
    add(faulty)
    path = tmp_path / "a.ddr"
    DDR.load().write(path, content())
    assert registry.recognise(path) is DDR
    own = path.rename(tmp_path / "a.faulty")
    own.write_text("1 2 3", encoding="utf-8")
    with pytest.raises(FormatError, match=r"the codec of the format faulty failed \(TypeError: it read a dict, not BsdfFile\)"):
        registry.read(own)
    for written in (content(), content(u=table().values)):
        with pytest.raises(
            FormatError, match=r"b\..*faulty: the codec of the format faulty failed \(KeyError: 'abc'\); correct"
        ):
            writing.write(tmp_path / "b.faulty", written, faulty)


@pytest.mark.parametrize("suffix", [".ddr", ".ssdd", ".bsdf"])
def test_a_list_of_azimuths_that_goes_round_without_0_is_closed_and_read_as_it_was(suffix: str, tmp_path: Path) -> None:
    """Other programs extrapolate linearly beyond a list: a light at psi 0 is between 345 and 15."""
    psi, phi, theta = np.arange(15.0, 360.0, 30.0), np.arange(10.0, 360.0, 20.0), np.arange(0.0, 181.0, 30.0)
    values = 1.0 + np.broadcast_to(psi[:, None, None, None] + phi[:, None] / 7.0, (1, psi.size, 2, phi.size, theta.size))
    table = BsdfTable(np.array([0.0, 90.0]), phi, theta, values, psi_deg=psi)
    path = tmp_path / f"a{suffix}"
    form = registry.format_for(path, {Holds.GRID})
    writing.write(path, BsdfFile((table,)), form)
    again = registry.read(path).only_table()
    assert again.psi_deg.tolist() == psi.tolist()
    assert again.phi_deg.tolist() == phi.tolist()
    np.testing.assert_allclose(again.values, table.values, rtol=1e-8)
    closed = covered(table)
    assert closed.psi_deg[[0, -1]].tolist() == closed.phi_deg[[0, -1]].tolist() == [0.0, 360.0]
    np.testing.assert_allclose(closed.values[0, 0, 0, 1, 0], 1.0 + 180.0 + 10.0 / 7.0)
    np.testing.assert_array_equal(closed.values[:, 0], closed.values[:, -1])
    assert "psi interpolated at 0 and 360" in path.read_text()
