"""Archives: written without loss, checked for damage before HDF5 opens them, readable by h5py alone."""

import contextlib
import tracemalloc
import zlib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from goniotwin.app.formats import BsdfTable, FormatError, archive
from goniotwin.app.formats.content import INTERVAL_COLUMNS, BsdfFile, Part, RegularTable, ScatteredBsdf
from goniotwin.app.formats.metadata import Metadata, QualityMetadata, SampleMetadata
from goniotwin.protocols.clock import RealClock

FINITE = st.floats(-1e6, 1e6)
TEXT = st.text(st.characters(exclude_categories=["C"]), max_size=12)
COMMENTS = st.lists(TEXT, max_size=3).map(tuple)


def angles(high: float, most: int = 4) -> st.SearchStrategy[Any]:
    found = st.lists(st.integers(0, int(8 * high)), min_size=1, max_size=most, unique=True)
    return found.map(lambda each: np.array(sorted(each)) / 8.0)


@st.composite
def parts(draw: st.DrawFn) -> Part:
    about: dict[str, Any] = {"sample": draw(TEXT), "generated": draw(st.booleans()), "comments": draw(COMMENTS)}
    kind = draw(st.sampled_from(["table", "scattered", "regular"]))
    if kind == "scattered":
        n = draw(st.integers(0, 6))
        columns: dict[str, Any] = {
            each: draw(arrays(np.float64, n, elements=st.floats(0.0, 90.0))) for each in ("sigma_deg", "polar_deg")
        }
        columns |= {each: draw(arrays(np.float64, n, elements=st.floats(0.0, 360.0))) for each in ("psi_deg", "azimuth_deg")}
        values = draw(arrays(np.float64, n, elements=FINITE | st.just(np.nan)))
        words = np.array(draw(st.lists(TEXT, min_size=n, max_size=n)), dtype=np.str_)
        more: dict[str, Any] = {each: draw(arrays(np.bool_, n)) for each in ("transmitted", "back")}
        return ScatteredBsdf(
            **columns,
            values=values,
            u=np.abs(values),
            low95=values - 1.0,
            high95=values + 1.0,
            interval=words,
            flags=words,
            channel=words[::-1],
            **more,
            photodiode=draw(arrays(np.int64, n, elements=st.integers(-1, 40))),
            isotropic=draw(st.booleans()),
            **about,
        )
    psi, sigma = draw(angles(360.0)), draw(angles(90.0))
    about |= {"psi_deg": psi, "transmitted": draw(st.booleans()), "back": draw(st.booleans())}
    colours = draw(st.sampled_from([(), ("red", "green", "blue"), ("X",)]))
    if colours:
        about["colours"] = colours
    elif draw(st.booleans()):
        about["wavelengths_nm"] = tuple(draw(angles(1000.0)) + 1.0)
    channels = len(about.get("wavelengths_nm", colours or (None,)))
    if kind == "regular":
        shape: tuple[int, ...] = (channels, psi.size, sigma.size)
        return RegularTable(sigma, draw(arrays(np.float64, shape, elements=FINITE)), **about)
    phi, theta = draw(angles(360.0)), draw(angles(180.0))
    shape = (channels, psi.size, sigma.size, phi.size, theta.size)
    values = draw(arrays(np.float64, shape, elements=FINITE))
    known = draw(st.none() | arrays(np.bool_, shape))
    return BsdfTable(sigma, phi, theta, values, u=draw(st.none() | st.just(np.abs(values))), known=known, **about)


def same(first: Any, second: Any) -> bool:
    if type(first) is not type(second):
        return False
    for field in fields(first):
        one, other = getattr(first, field.name), getattr(second, field.name)
        if isinstance(one, np.ndarray):
            if one.shape != other.shape or not (np.array_equal(one, other, equal_nan=one.dtype.kind == "f")):
                return False
        elif one != other:
            return False
    return True


@given(st.lists(parts(), max_size=3), COMMENTS, TEXT, TEXT)
@settings(deadline=None, max_examples=20)
def test_reading_returns_the_written_content(found: list[Part], comments: tuple[str, ...], title: str, maker: str) -> None:
    quality = QualityMetadata(findings=comments, repeats=3)
    content = BsdfFile(tuple(found), Metadata(title=title, sample=SampleMetadata(maker=maker), quality=quality), comments)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "all.h5"
        archive.write(path, content)
        read = archive.read(path)
        assert list(Path(folder).iterdir()) == [path]
        assert archive.recognise(path.read_bytes()[:100])
    assert (read.metadata, read.comments) == (content.metadata, content.comments)
    assert len(read.parts) == len(found)
    assert all(same(one, other) for one, other in zip(found, read.parts, strict=True))


def table() -> BsdfTable:
    sigma, phi, theta = np.array([0.0, 30.0]), np.array([0.0, 180.0]), np.linspace(0.0, 180.0, 7)
    values = np.arange(2.0 * 2 * 2 * 7).reshape(2, 1, 2, 2, 7)
    return BsdfTable(sigma, phi, theta, values, (450.0, 650.0), u=0.01 * values, generated=True, sample="paint")


def test_h5py_alone_reads_a_table_as_nexus_has_it(tmp_path: Path) -> None:
    """The attributes of NXdata by the manual of NeXus: signal, axes, and NAME_errors for the uncertainties."""
    archive.write(tmp_path / "table.h5", BsdfFile((table(),), comments=("by hand",)))
    with h5py.File(tmp_path / "table.h5") as file:
        entry = file[file.attrs["default"]]
        assert (file.attrs["NX_class"], entry.attrs["NX_class"], entry.attrs["simulated"]) == ("NXroot", "NXentry", True)
        data = entry[entry.attrs["default"]]
        assert data.attrs["NX_class"] == "NXdata"
        signal = data[data.attrs["signal"]]
        assert [data[axis].size for axis in data.attrs["axes"]] == list(signal.shape) == [2, 1, 2, 2, 7]
        assert np.array_equal(data["values_errors"][()], 0.01 * signal[()])
        assert (signal.attrs["units"], data["sigma_deg"].attrs["units"]) == ("1/sr", "deg")
        assert entry["comments"].asstr()[()].tolist() == ["by hand"]


def test_a_file_that_changed_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.h5"
    archive.write(path, BsdfFile((table(),)))
    raw = bytearray(path.read_bytes())
    for place in (600, len(raw) // 2, len(raw) - 1):
        damaged = bytearray(raw)
        damaged[place] ^= 1
        path.write_bytes(damaged)
        with pytest.raises(FormatError, match="does not match the sha256 in its first line"):
            archive.read(path)
    path.write_bytes(raw[:100])
    with pytest.raises(FormatError, match="is not an archive of goniotwin"):
        archive.read(path)


@given(st.data())
@settings(deadline=None, max_examples=25)
def test_a_file_that_others_wrote_is_read_or_refused(data: st.DataObject) -> None:
    """What has the right checksum may still have anything in the place of a dataset."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "strange.h5"
        names = ["values", "values_errors", "sigma_deg", "psi_deg", "comments", "wavelengths_nm"]
        strange = [np.zeros((2, 2)), np.array(3), b"text", np.array([1.0, np.inf]), np.zeros(0), np.array(["a"], dtype="S1")]

        def fill(entry: h5py.Group) -> Iterator[None]:
            archive.put_about(entry, BsdfFile(()))
            group = archive.put_part(entry, "part_1", table())
            name = data.draw(st.sampled_from(names))
            del group[name]
            if data.draw(st.booleans()):
                group[name] = data.draw(st.sampled_from(strange))
            if data.draw(st.booleans()):
                del group.attrs[data.draw(st.sampled_from(["kind", "sample", "transmitted"]))]
            yield

        archive.write_entry(path, fill)
        with contextlib.suppress(FormatError):
            archive.read(path)


def test_a_dataset_without_its_values_takes_no_memory(tmp_path: Path) -> None:
    def fill(entry: h5py.Group) -> Iterator[None]:
        archive.put_about(entry, BsdfFile(()))
        group = archive.put_part(entry, "part_1", table())
        del group["values"]
        group.create_dataset("values", (15_000_000,), "<f8", chunks=(1000,))
        yield

    archive.write_entry(tmp_path / "empty.h5", fill)
    tracemalloc.start()
    with pytest.raises(FormatError, match="has no values in the file"):
        archive.read(tmp_path / "empty.h5")
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


def forge_comments(path: Path, count: int) -> None:
    """An archive with so many empty comments, each stored: as they compress well, 16 bytes of each take next to none."""
    chunk, together = zlib.compress(bytes(16_000_000)), 1_000_000

    def fill(entry: h5py.Group) -> Iterator[None]:
        archive.put_about(entry, BsdfFile(()))
        del entry["comments"]
        data = entry.create_dataset("comments", (count,), archive.TEXT, chunks=(together,), compression="gzip")
        for begin in range(0, count, together):
            data.id.write_direct_chunk((begin,), chunk)
        yield

    archive.write_entry(path, fill)


def test_comments_without_number_are_refused_before_they_take_memory(tmp_path: Path) -> None:
    """The bounds: 0.5 s, of which most is the checksum's, and 150 MB."""
    path = tmp_path / "forged.h5"
    forge_comments(path, 200_000_000)
    assert path.stat().st_size < 5_000_000
    tracemalloc.start()
    clock = RealClock()
    with pytest.raises(FormatError, match=r"/entry/comments: has too many texts \(200000000\)"):
        archive.read(path)
    assert clock.now() < 0.5
    assert tracemalloc.get_traced_memory()[1] < 150_000_000
    tracemalloc.stop()


def test_one_long_text_that_stands_for_many_is_refused(tmp_path: Path) -> None:
    """Texts are references to a heap: all may be to the same one."""
    path = tmp_path / "forged.h5"

    def fill(entry: h5py.Group) -> Iterator[None]:
        archive.put_about(entry, BsdfFile(()))
        del entry["comments"]
        one = entry.create_dataset("one", (1,), archive.TEXT, chunks=(1,))
        one[0] = "x" * 1_000_000
        entry.file.flush()
        _, reference = one.id.read_direct_chunk((0,))
        data = entry.create_dataset("comments", (10_000,), archive.TEXT, chunks=(10_000,))
        data.id.write_direct_chunk((0,), reference * 10_000)
        yield

    archive.write_entry(path, fill)
    with pytest.raises(FormatError, match="has texts of more than 50000000 characters"):
        archive.read(path)


def test_a_list_longer_than_the_values_is_refused(tmp_path: Path) -> None:
    def fill(entry: h5py.Group) -> Iterator[None]:
        archive.put_about(entry, BsdfFile(()))
        group = archive.put_part(entry, "part_1", table())
        del group["sigma_deg"]
        group.create_dataset("sigma_deg", (19_000_000,), "<f8", chunks=(1_000_000,), compression="gzip")[:1] = 1.0
        yield

    archive.write_entry(tmp_path / "long.h5", fill)
    with pytest.raises(FormatError, match="part_1/sigma_deg has float64"):
        archive.read(tmp_path / "long.h5")


def test_a_folder_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="there is no folder"):
        archive.write(tmp_path / "no" / "table.h5", BsdfFile((table(),)))


@pytest.mark.long
def test_a_million_values_are_read_as_they_were_written(tmp_path: Path) -> None:
    n = 1_000_000
    random = np.random.default_rng(1)
    sigma, psi, polar, azimuth = random.uniform(0.0, 90.0, (4, n))
    many = ScatteredBsdf(
        sigma,
        psi,
        polar,
        azimuth,
        random.normal(size=n),
        random.normal(size=n),
        flags=np.array(["", "drift", "drift steep"])[random.integers(0, 3, n)],
    )
    archive.write(tmp_path / "many.h5", BsdfFile((many,)))
    (read,) = archive.read(tmp_path / "many.h5").parts
    assert same(many, read)


def test_an_archive_of_an_older_version_has_no_intervals(tmp_path: Path) -> None:
    ten = np.array([10.0, 20.0])
    values = ScatteredBsdf(ten, ten, ten, ten, ten)

    def fill(entry: h5py.Group) -> Iterator[None]:
        archive.put_about(entry, BsdfFile(()))
        group = archive.put_part(entry, "part_1", values)
        for name in INTERVAL_COLUMNS:
            del group[name]
        yield

    archive.write_entry(tmp_path / "a.h5", fill)
    (found,) = archive.read(tmp_path / "a.h5").scattered
    assert found.values.tolist() == [10.0, 20.0]
    assert np.isnan([found.low95, found.high95]).all()
    assert found.interval.tolist() == ["", ""]
