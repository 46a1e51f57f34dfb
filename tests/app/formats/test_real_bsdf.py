"""Measured .bsdf files of another laboratory; skipped where they are absent."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.formats import read_zemax, write_zemax

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
