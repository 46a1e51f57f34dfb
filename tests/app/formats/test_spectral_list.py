"""Lists of spectral samples: numbers over lines of any length."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.formats import spectral_list

from .scattered import only_list, refusal, rows, scattered

# In the layout of scenes/brdfs/mystique.brdf (mmp/pbrt-v2, commit 74070a7); the second sample is its line near the specular
# ray, whose values are a hundred times the others.
TEXT = """# a lacquer

# num wls
3
400 410
420

# theta i, phi i, theta s, phi_s, values
0.872665 0.000000 0.573513 -0.261799 0.014082 0.005146
-0.001381 0.174533 0.000000 0.141539 3.141593
0.317482 0.301716 0.285837
"""


def test_a_list_is_read_whatever_its_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.brdf"
    for text in (TEXT, TEXT.replace("\n", "\r"), TEXT.replace("\n", "\r\n"), TEXT.replace(" 0.", "\t0.")):
        path.write_bytes(text.encode())
        assert spectral_list.recognise(text.encode())
        found = only_list(spectral_list.read(path))
        # 0.872665 rad is 50.00002 deg: the file means 50. 0.573513 rad is no such angle.
        assert found.sigma_deg.tolist() == [50.0, 10.0] * 3
        np.testing.assert_allclose(found.polar_deg[:2], [32.85987, 8.10959], atol=1e-4)
        assert found.azimuth_deg[:2].tolist() == [345.0, 180.0]
        assert found.wavelength_nm.tolist() == [400, 400, 410, 410, 420, 420]
        assert found.values.tolist() == [0.014082, 0.317482, 0.005146, 0.301716, -0.001381, 0.285837]
        assert found.comments == ("a lacquer", "num wls", "theta i, phi i, theta s, phi_s, values")


@given(values=scattered(), width=st.integers(1, 9))
@settings(deadline=None)
def test_any_list_is_read_as_it_was_meant(tmp_path_factory: pytest.TempPathFactory, values: Any, width: int) -> None:
    values = values if np.isfinite(values.wavelength_nm).all() else values.where(values.wavelength_nm == 0.0)
    if not values.size:
        return
    wavelengths = np.unique(values.wavelength_nm)
    size = values.size // wavelengths.size
    by_wavelength = values.values.reshape(-1, size)[np.argsort(values.wavelength_nm[::size])]
    words = [f"{wavelengths.size}", *(f"{each:g}" for each in wavelengths)]
    for k in range(size):
        angles = np.radians([values.sigma_deg[k], values.psi_deg[k], values.polar_deg[k], values.azimuth_deg[k]])
        words += [*(f"{each:.10f}" for each in angles), *(f"{each:.9g}" for each in by_wavelength[:, k])]
    path = tmp_path_factory.mktemp("list") / "a.brdf"
    path.write_text("\n".join(" ".join(words[k : k + width]) for k in range(0, len(words), width)))
    np.testing.assert_array_equal(rows(only_list(spectral_list.read(path))), rows(values))


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("0.285837\n", "\n", "13 numbers follow the wavelengths, and a sample at 3 wavelengths has 7"),
        ("0.285837", "0,285837", "line 11: '0,285837' has a decimal comma"),
        ("0.285837", "1e999", "line 11: '1e999' is larger than a 64-bit float"),
        ("\n3\n", "\n3.5\n", "3.5 is not a possible number of wavelengths"),
        ("\n3\n", "\n4000000000\n", "4e+09 is not a possible number"),
        ("400 410", "410 400", "the wavelengths do not ascend"),
        ("0.872665", "50", "theta_i of sample 1 is 2864.79 deg"),
        ("3.141593", "180", "phi_o of sample 2 is 10313.2 deg"),
    ],
)
def test_a_damaged_list_is_refused(tmp_path: Path, old: str, new: str, wanted: str) -> None:
    assert wanted in refusal(spectral_list.read, tmp_path / "a.brdf", TEXT.replace(old, new, 1))


@pytest.mark.parametrize(
    "text", [b"", b"1 2 3", b"2 400 410", b"2 410 400 1 1 1 1", b"2 400 410 a", b"400 1 2 3 4 5\n", b"\xff\x00"]
)
def test_other_files_are_not_taken_for_a_list(text: bytes) -> None:
    assert not spectral_list.recognise(text)
