"""Rayset files: written without loss, readable by other HDF5 programs, and checked for damage before HDF5 opens them."""

import hashlib
import math
import tracemalloc
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from goniotwin.app.formats import FormatError, read_rayset, write_rayset
from goniotwin.app.formats.hdf5 import BLOCK
from goniotwin.app.formats.rayset import HEADING
from goniotwin.twin.optics.illumination.rayset import Rayset, record
from goniotwin.twin.optics.illumination.unit import IlluminationUnit

UNIT = IlluminationUnit()
FINITE = st.floats(-1e6, 1e6)


@st.composite
def raysets(draw: st.DrawFn) -> Rayset:
    count, plane = draw(st.integers(1, 20)), draw(FINITE)
    positions = draw(arrays(np.float64, (count, 3), elements=FINITE))
    positions[:, 1] = plane
    directions = draw(arrays(np.float64, (count, 3), elements=FINITE))
    directions[:, 1] = draw(arrays(np.float64, count, elements=st.floats(1e-3, 1e3)))
    flux = draw(arrays(np.float64, count, elements=st.floats(0.0, 1e3)))
    return Rayset(
        positions_mm=positions,
        directions=directions,
        wavelength_nm=draw(arrays(np.float64, count, elements=st.floats(1.0, 1e4))),
        flux=flux,
        unit=draw(st.sampled_from(["W", "lm"])),
        plane_mm=plane,
        geometry=draw(st.text("0123456789abcdef", min_size=1, max_size=16)),
        emitted_flux=draw(st.floats(2e4, 1e6)),
        seed=draw(st.integers(0, 2**64 - 1)),
    )


def same(first: Rayset, second: Rayset) -> bool:
    return all(np.array_equal(getattr(first, field.name), getattr(second, field.name)) for field in fields(Rayset))


@given(raysets())
@settings(deadline=None)
def test_reading_returns_the_written_rayset(rayset: Rayset) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "beam.h5"
        write_rayset(path, rayset)
        assert same(read_rayset(path), rayset)
        assert list(Path(folder).iterdir()) == [path]


@pytest.fixture
def beam(tmp_path: Path) -> Path:
    path = tmp_path / "beam.h5"
    write_rayset(path, record(UNIT, 50, seed=1))
    return path


def test_other_hdf5_programs_find_columns_units_and_the_simulated_mark(beam: Path) -> None:
    with h5py.File(beam) as file:
        assert bool(file.attrs["simulated"]) is True
        assert file.attrs["format"] == "goniotwin rayset"
        assert file.attrs["geometry"] == UNIT.fingerprint
        assert file.attrs["emitted_flux"] == UNIT.band_flux
        assert {name: file[name].attrs["unit"] for name in file} == {
            "position": "mm",
            "direction": "1",
            "wavelength": "nm",
            "flux": "W",
        }
        assert file["position"].shape == file["direction"].shape == (50, 3)
    assert beam.read_bytes().startswith(b"goniotwin rayset, simulated;")


def test_the_same_rayset_gives_the_same_bytes(beam: Path) -> None:
    again = beam.with_name("again.h5")
    write_rayset(again, record(UNIT, 50, seed=1))
    assert again.read_bytes() == beam.read_bytes()


def refusal(path: Path, *most_bytes: int) -> str:
    with pytest.raises(FormatError) as caught:
        read_rayset(path, *most_bytes)
    text = str(caught.value)
    assert text.isprintable(), "one line"
    assert text.startswith(str(path))
    return text.removeprefix(str(path))


@given(st.data())
@settings(deadline=None)
def test_any_damage_is_detected(data: st.DataObject) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "beam.h5"
        write_rayset(path, record(UNIT, 5, seed=1))
        content = bytearray(path.read_bytes())
        place = data.draw(st.integers(0, len(content) - 1))
        if data.draw(st.booleans()):
            content[place] ^= data.draw(st.integers(1, 255))
        else:
            del content[place:]
        path.write_bytes(content)
        assert "is damaged" in (message := refusal(path)) or "is not a rayset" in message


def test_another_kind_of_file_is_refused(tmp_path: Path) -> None:
    assert "there is no such file" in refusal(tmp_path / "absent.h5")
    assert "is a folder" in refusal(tmp_path)
    text = tmp_path / "note.h5"
    for content in (b"", b"hello", b"\x89HDF\r\n\x1a\n" + bytes(900)):
        text.write_bytes(content)
        assert "is not a rayset" in refusal(text)
    with pytest.raises(FormatError, match="cannot be written"):
        write_rayset(tmp_path / "absent" / "beam.h5", record(UNIT, 2, seed=0))


def changed(path: Path, change: Callable[[h5py.File], None]) -> Path:
    """The file after a change by a program that keeps the stated SHA-256 right."""
    with h5py.File(path, "r+") as file:
        change(file)
    content = path.read_bytes()
    digest = hashlib.sha256(content[512:]).hexdigest().encode()
    start = content.index(b"sha256=") + 7
    path.write_bytes(content[:start] + digest + content[start + 64 :])
    return path


def without(name: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del (file if name in file else file.attrs)[name]

    return change


def attribute(name: str, value: object) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file.attrs[name] = value

    return change


def column(name: str, value: object, unit: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file.create_dataset(name, data=value).attrs["unit"] = unit

    return change


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (without("flux"), "the column flux is missing"),
        (without("simulated"), "the attribute simulated is missing"),
        (without("geometry"), "the attribute geometry is missing"),
        (attribute("simulated", False), "is not marked as simulated"),
        (attribute("simulated", "no"), "the attribute simulated is 'no', not of type bool"),
        (attribute("version", 2), "is a rayset of version 2, not 1"),
        (attribute("format", "other"), "its format is 'other'"),
        (attribute("flux_unit", "lm"), "the column flux is in 'W', not lm"),
        (attribute("emitted_flux", math.nan), "emitted_flux is nan"),
        (column("flux", np.full(50, -1.0), "W"), "ray 0: flux -1.0 is negative"),
        (column("flux", np.full(49, 1e-9), "W"), "49 rays need"),
        (column("flux", np.full((50, 1), 1e-9), "W"), r"not numbers (n,)"),
        (column("flux", np.full(50, 1e-3, dtype="<f2"), "W"), r"has float16 (50,), not numbers (n,)"),
        (column("direction", np.full((50, 3), "x", dtype="S1"), "1"), "not numbers (n, 3)"),
        (column("direction", np.zeros((50, 3)), "1"), "ray 0: directions [0. 0. 0.] has no length"),
        (column("wavelength", np.full(50, 5.55e-7), "m"), "the column wavelength is in 'm', not nm"),
    ],
)
def test_an_undamaged_file_with_a_wrong_field_is_refused(beam: Path, change: Callable[[h5py.File], None], wrong: str) -> None:
    assert wrong in refusal(changed(beam, change))


def test_a_file_changed_without_error_is_read(beam: Path) -> None:
    assert same(read_rayset(changed(beam, lambda _file: None)), replace(record(UNIT, 50, seed=1)))


def test_a_large_file_is_checked_without_being_in_memory(tmp_path: Path) -> None:
    path = tmp_path / "large.h5"
    path.write_bytes(f"{HEADING}{'0' * 64}\n".encode().ljust(BLOCK - 1) + b"\n" + bytes(10_000_000))
    tracemalloc.start()
    assert "its content does not match the sha256" in refusal(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 2_000_000
    assert "has more than 10000000 bytes" in refusal(path, 10_000_000)
