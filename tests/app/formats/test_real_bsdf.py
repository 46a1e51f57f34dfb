"""Measured files of another laboratory; skipped where they are absent."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.formats import fred, read_zemax, reflectance_factors, reflet, speos_rtd, write_zemax

ROOT = Path(__file__).resolve().parents[3]
FOLDER = ROOT.parent / "shared" / "data" / "real_bsdf"


@pytest.fixture
def files() -> list[Path]:
    if not FOLDER.is_dir():
        pytest.skip("the measured files are absent: no folder ../shared/data/real_bsdf beside the repository")
    paths = sorted(FOLDER.glob("*.bsdf"))
    assert paths, "the folder has .bsdf files"
    return paths


def test_every_measured_file_is_read_as_a_plain_parser_reads_it(files: list[Path]) -> None:
    for path in files:
        table = read_zemax(path)
        lines = path.read_text().partition("DataBegin")[2].split("DataEnd")[0].strip().splitlines()
        tis = [float(line.split()[1]) for line in lines if line.startswith("TIS")]
        values = [[float(word) for word in line.split()] for line in lines if not line.startswith("TIS")]
        assert table.tis.ravel().tolist() == tis
        assert table.values.reshape(-1, table.radial_deg.size).tolist() == values
        assert (table.source, table.symmetry, table.scatter_type) == ("Measured", "PlaneSymmetrical", "BRDF")
        assert table.sample_rotation_deg.tolist() == [0]


def test_every_measured_file_can_be_written_and_read_again(files: list[Path], tmp_path: Path) -> None:
    for path in files:
        table = read_zemax(path)
        write_zemax(tmp_path / path.name, table)
        again = read_zemax(tmp_path / path.name)
        np.testing.assert_allclose(again.values, table.values, rtol=5e-9)
        np.testing.assert_array_equal(again.radial_deg, table.radial_deg)
        assert again.comments == tuple(comment.replace("\t", " ") for comment in table.comments)


def test_the_black_paint_has_a_bsdf_of_3e_3_per_sr_in_the_specular_direction(files: list[Path]) -> None:
    table = read_zemax(next(path for path in files if path.name == "aeroglaze.bsdf"))
    assert table.incidence_deg.tolist() == [10, 30, 50, 70]
    assert table.radial_deg.tolist() == list(range(161))
    assert table.values[0, 0, 0, 0, 0] == 0.003198128380011332  # the first number of the file


def test_files_of_other_formats_in_the_folder_are_refused(files: list[Path]) -> None:
    others = [path for path in FOLDER.iterdir() if path not in files]
    for path in others:
        with pytest.raises(ValueError, match=r"keyword|missing|not finite"):
            read_zemax(path)


def test_every_number_of_freds_text_is_read(files: list[Path]) -> None:
    path = FOLDER / "AnoBlackEC1onAlum.txt"
    (found,) = fred.read(path).scattered
    words = [[float(word) for word in line.split()] for line in path.read_text().splitlines()[2:]]
    assert found.values.tolist() == [each[2] for each in words if len(each) == 3]
    assert found.polar_deg.tolist() == [each[0] for each in words if len(each) == 3]
    assert np.unique(found.sigma_deg).tolist() == [each[0] for each in words if len(each) == 2]


def test_freds_text_and_zemaxs_file_of_a_sample_agree(files: list[Path]) -> None:
    # Two ways to average one measurement: they are a few percent apart where both have a direction in the plane of incidence,
    # up to 24 % beside the peak of 70 deg. Azimuths that were counted from the light would be a factor of 2 off, and up to 49.
    (found,) = fred.read(FOLDER / "AnoBlackEC1onAlum.txt").scattered
    table = read_zemax(FOLDER / "AnoBlackEC1onAlum.bsdf")
    theta, phi = found.specular()
    ratios = []
    for k in range(found.size):
        i, a, r = (
            np.flatnonzero(np.abs(axis - at) < 1e-6)
            for axis, at in (
                (table.incidence_deg, found.sigma_deg[k]),
                (table.azimuth_deg, phi[k]),
                (table.radial_deg, theta[k]),
            )
        )
        if i.size and a.size and r.size:
            ratios.append(table.values[0, i[0], a[0], r[0]] / found.values[k])
    assert len(ratios) > 50
    assert np.median(np.abs(np.log(ratios))) < 0.03
    assert np.max(np.abs(np.log(ratios))) < 0.25


def test_the_two_exports_of_an_instrument_agree(files: list[Path]) -> None:
    text, speos = reflet.read(FOLDER / "test_lighttools.txt"), speos_rtd.read(FOLDER / "test_speos.rtd")
    assert text.samples == ("OJN / ART-90-050B-87106_long", "OJN / ART-90-050B-87106_long, measurement 2")
    names = ["Sample 0", "Sample 60", "Sample 0, measurement 2", "Sample 60, measurement 2"]
    assert [name for name in speos.samples if "table" not in name] == names
    for part, pair in zip(text.scattered, (names[:2], names[2:]), strict=True):
        of_speos = [each for name in pair for each in speos.of(name).scattered]
        for column in ("sigma_deg", "polar_deg", "azimuth_deg", "values"):
            assert getattr(part, column).tolist() == np.concatenate([getattr(each, column) for each in of_speos]).tolist()
    words = (FOLDER / "test_lighttools.txt").read_bytes().replace(b"\r", b"\n").split()
    negative = sorted(float(word) for word in words if word.startswith(b"-") and b"." in word and word != b"-90.0")
    assert sorted(text.scattered[1].values.tolist()) == negative
    assert len(negative) == 12


def test_every_reflectance_factor_is_read(files: list[Path]) -> None:
    path = FOLDER / "20250210_S7_sample_final.txt"
    (found,) = reflectance_factors.read(path).scattered
    words = np.array([[float(word) for word in line.split()] for line in path.read_text().splitlines()[6:]])
    np.testing.assert_allclose(np.pi * found.values.reshape(11, -1).T, words[:, 4:], rtol=1e-15)
    assert found.sigma_deg[: len(words)].tolist() == words[:, 0].tolist()
    assert (found.sample, found.wavelength_nm[0]) == ("RSG Spectralon 7, (2 inch dia) aperture in wall", 385.65)
    # 0:45 was measured first and last.
    assert np.count_nonzero((found.sigma_deg == 0.0) & (found.polar_deg == 45.0)) == 2 * 11
