"""What is written, as libbsdf takes it: the same lists and values, which cover the ranges that it would extrapolate."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.formats import BsdfTable, ddr, sdr, ssdd, zemax
from goniotwin.app.formats.content import BsdfFile, RegularTable
from goniotwin.app.formats.metadata import InstrumentMetadata, Metadata
from tests.app.formats import libbsdf
from tests.app.formats.tables import bsdf_tables, check_same_text, regular_tables

METADATA = Metadata(
    title="wl def sigma 3", date="2026-11-22T21:00:00Z", instrument=InstrumentMetadata("rig 1", "goniotwin 1.0")
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("libbsdf")


def check(found: libbsdf.Read, table: BsdfTable, *, covers: bool) -> None:
    """Every node of the table is a node of what was read, with its value; the lists go to their ends."""
    if covers:
        assert (found.sigma[0], found.sigma[-1], found.theta[0], found.theta[-1]) == (0, 90, 0, 180)
    assert (found.phi[0], found.phi[-1]) == (0, 360)
    count = table.psi_deg.size
    first = int(found.psi[0] != pytest.approx(table.psi_deg[0]))  # goes round without 0
    assert found.psi[first : first + count] == pytest.approx(table.psi_deg)
    if first or found.psi[count:]:  # goes round
        assert (found.psi[0], found.psi[first + count :]) == (0, [360])
        np.testing.assert_array_equal(found.values[-1], found.values[0])
    else:
        assert not (table.psi_deg[0] == 0.0 and 180.0 < table.psi_deg[-1] < 360.0)
    rows = [
        [np.abs(np.array(read) - angle).argmin() for angle in angles]
        for read, angles in ((found.sigma, table.sigma_deg), (found.phi, table.phi_deg), (found.theta, table.theta_deg))
    ]
    for read, places, angles in zip(
        (found.sigma, found.phi, found.theta), rows, (table.sigma_deg, table.phi_deg, table.theta_deg), strict=True
    ):
        np.testing.assert_allclose(np.array(read)[places], angles, rtol=1e-8)
    nodes = found.values[np.ix_(range(first, first + count), *rows, range(found.values.shape[4]))]
    np.testing.assert_allclose(nodes, np.moveaxis(table.values, 0, -1), rtol=2e-8, atol=1e-300)
    if table.phi_deg[-1] <= 180.0:  # the mirror image
        turn = np.array(found.phi)
        back = [np.abs(turn - (360.0 - angle)).argmin() for angle in turn]
        np.testing.assert_array_equal(found.values, found.values[:, :, back])


@settings(deadline=None)
@given(bsdf_tables("rgb"))
def test_a_ddr(folder: Path, table: BsdfTable) -> None:
    ddr.write(folder / "a.ddr", BsdfFile((table,), METADATA))
    found = libbsdf.read_ddr(folder / "a.ddr")
    check(found, table, covers=True)
    assert found.source == ("generated" if table.generated else "measured")
    assert found.wavelengths == pytest.approx(table.wavelengths_nm or [])
    assert (found.colours == "rgb") == bool(table.colours)


@settings(deadline=None)
@given(bsdf_tables("xyz").filter(lambda table: len(table.wavelengths_nm or ()) < 2))
def test_a_zemax_bsdf(folder: Path, table: BsdfTable) -> None:
    zemax.write(folder / "a.bsdf", BsdfFile((table,), METADATA))
    found = libbsdf.read_zemax(folder / "a.bsdf")
    check(found, table, covers=False)
    assert found.scatter_type == ("BTDF" if table.transmitted else "BRDF")


@settings(deadline=None)
@given(regular_tables("rgb", isotropic=True))
def test_a_sdr(folder: Path, table: RegularTable) -> None:
    sdr.write(folder / "a.sdr", BsdfFile((table,), METADATA))
    found = libbsdf.read_sdr(folder / "a.sdr")
    assert (found.sigma[0], found.sigma[-1]) == (0, 90)
    places = [np.abs(np.array(found.sigma) - angle).argmin() for angle in table.sigma_deg]
    np.testing.assert_allclose(found.values[places], table.values[:, 0].T, rtol=1e-8)
    assert found.wavelengths == pytest.approx(table.wavelengths_nm or [])


@settings(deadline=None)
@given(st.data())
def test_a_ssdd(folder: Path, data: st.DataObject) -> None:
    makers: dict[str, Callable[[], st.SearchStrategy[Any]]] = {
        "brdf": lambda: bsdf_tables("rgb", "xyz", transmitted=False),
        "btdf": lambda: bsdf_tables("rgb", "xyz", transmitted=True),
        "specular_reflectance": lambda: regular_tables("rgb", "xyz", isotropic=False),
        "specular_transmittance": lambda: regular_tables("rgb", "xyz", isotropic=False, transmitted=True),
    }
    chosen = data.draw(st.lists(st.sampled_from(list(makers)), min_size=1, max_size=4, unique=True))
    parts = {name: data.draw(makers[name]()) for name in chosen}
    for part in parts.values():
        object.__setattr__(part, "sample", "paint 3")
        object.__setattr__(part, "back", False)
    content = BsdfFile(tuple(parts.values()), METADATA, ("DATA_TYPE btdf", "", "last"))
    ssdd.write(folder / "a.ssdd", content)
    found = libbsdf.read_ssdd(folder / "a.ssdd")
    assert set(found) == set(chosen)
    for name, part in parts.items():
        block = found[name]
        assert block.source == ("generated" if part.generated else "measured")
        assert block.wavelengths == pytest.approx(part.wavelengths_nm or [])
        if isinstance(part, BsdfTable):
            check(block, part, covers=True)
        else:
            places = [np.abs(np.array(block.sigma) - angle).argmin() for angle in part.sigma_deg]
            np.testing.assert_allclose(block.values[:, places], np.moveaxis(part.values, 0, -1), rtol=1e-8)
    again = ssdd.read(folder / "a.ssdd")
    for part, read in zip((parts[name] for name in ssdd.QUANTITIES if name in parts), again.parts, strict=True):
        assert type(read) is type(part)
        assert (read.sample, read.generated, read.transmitted) == (part.sample, part.generated, part.transmitted)
        np.testing.assert_allclose(read.values, part.values, rtol=5e-9)
        np.testing.assert_allclose(read.sigma_deg, part.sigma_deg, rtol=1e-8)
    ssdd.write(folder / "b.ssdd", again)
    largest = max(float(np.abs(part.values).max()) for part in parts.values())
    check_same_text((folder / "b.ssdd").read_text(encoding="utf-8"), (folder / "a.ssdd").read_text(encoding="utf-8"), largest)
