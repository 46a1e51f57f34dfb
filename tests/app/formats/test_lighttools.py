"""LightTools .bsdf files, read by libbsdf's convention (src/Reader/LightToolsBsdfReader.cpp)."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.formats import FormatError, zemax
from goniotwin.app.formats.content import ScatteredBsdf
from goniotwin.app.formats.lighttools import read, recognise

HEADER = """\
# a diffuser
Symmetry Asymmetric
SpectralContent Monochrome
ScatterAzimuth 4
0 90 180 270
ScatterRadial 2
0 60
DataBegin
"""


def block(aoi: float, first: float, side: str = "Front", kind: str = "BRDF", more: str = "") -> str:
    rows = "\n".join(f"{first} {first + azimuth}" for azimuth in (1, 2, 3, 4))
    return f"AOI {aoi}\nPOI 0\nSide {side}\nWavelength 550\nScatterType {kind}\n{more}TIS 0.5\n{rows}\n"


def saved(folder: Path, text: str) -> Path:
    path = folder / "diffuser.bsdf"
    path.write_text(text)
    return path


def part_of(path: Path) -> ScatteredBsdf:
    (part,) = read(path).parts
    assert isinstance(part, ScatteredBsdf)
    return part


def test_every_block_is_read_with_its_side_and_light(tmp_path: Path) -> None:
    blocks = block(0, 10) + block(30, 20) + block(30, 30, "Back") + block(30, 40, "Front", "BTDF")
    part = part_of(saved(tmp_path, HEADER + blocks + "DataEnd\n"))
    assert part.size == 4 * 8
    assert part.sigma_deg.tolist() == [0.0] * 8 + [30.0] * 24
    assert np.asarray(part.back).tolist() == [False] * 16 + [True] * 8 + [False] * 8
    assert np.asarray(part.transmitted).tolist() == [False] * 24 + [True] * 8
    assert set(np.asarray(part.wavelength_nm).tolist()) == {550.0}
    assert part.values[8:16].tolist() == [20, 21, 20, 22, 20, 23, 20, 24]
    assert part.polar_deg[8:16].tolist() == [0, 60] * 4
    assert any("libbsdf's convention" in line for line in part.comments)
    assert part.comments[0] == "a diffuser"


def test_the_light_comes_from_azimuth_90_of_the_file(tmp_path: Path) -> None:
    """libbsdf turns the data by -90 deg: what is at azimuth 270 of the file is in the specular half plane, at 180."""
    part = part_of(saved(tmp_path, HEADER + block(30, 20) + "DataEnd\n"))
    assert part.azimuth_deg[[1, 3, 5, 7]].tolist() == [270, 0, 90, 180]
    assert part.values[[1, 3, 5, 7]].tolist() == [21, 22, 23, 24]
    assert set(part.psi_deg) == {0.0}


def test_half_the_azimuths_of_plane_symmetric_data_have_a_mirror_image(tmp_path: Path) -> None:
    text = (HEADER + block(30, 20)).replace("Asymmetric", "PlaneSymmetrical").replace("0 90 180 270", "90 150 210 270")
    part = part_of(saved(tmp_path, text + "DataEnd\n"))
    found = sorted(zip(part.azimuth_deg[1::2].tolist(), part.values[1::2].tolist(), strict=True))
    assert found == [(0, 21), (60, 22), (120, 23), (180, 24), (240, 23), (300, 22)]


def test_tristimulus_values_are_colours(tmp_path: Path) -> None:
    blocks = "".join(block(15, 10 * n, more=f"TristimulusValue Tris{axis}\n") for n, axis in enumerate("XYZ", 1))
    part = part_of(saved(tmp_path, HEADER.replace("Monochrome", "XYZ") + blocks + "DataEnd\n"))
    assert np.asarray(part.channel).tolist() == ["X"] * 8 + ["Y"] * 8 + ["Z"] * 8
    assert part.values[[0, 8, 16]].tolist() == [10, 20, 30]


def test_an_angle_of_incidence_above_90_is_0(tmp_path: Path) -> None:
    assert set(part_of(saved(tmp_path, HEADER + block(180, 10) + "DataEnd\n")).sigma_deg) == {0.0}


def test_zemax_and_lighttools_are_distinguished() -> None:
    other = b"Source Measured\nSymmetry PlaneSymmetrical\nSpectralContent Monochrome\nScatterType BRDF\nSampleRotation 1\n0\n"
    other += b"AngleOfIncidence 1\n0\nScatterAzimuth 1\n0\nScatterRadial 1\n0\nMonochrome\nDataBegin\nTIS 1\n1\nDataEnd\n"
    ours = (HEADER + block(0, 1)).encode()
    assert (recognise(ours), zemax.recognise(ours)) == (True, False)
    assert (recognise(other), zemax.recognise(other)) == (False, True)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ScatterRadial 2\n0 60\n", "", "ScatterRadial is missing"),
        ("Asymmetric", "Round", "line 2: Symmetry 'Round' is not known; write PlaneSymmetrical or Asymmetric"),
        ("Monochrome", "RGB", "line 3: SpectralContent 'RGB' is not known"),
        ("ScatterRadial 2", "ScatterRadials 2", "line 6: 'ScatterRadials' is not a keyword of a LightTools file; did you mean"),
        ("Side Front", "Side Left", "line 11: Side 'Left' is not known; write Front or Back"),
        ("AOI 30\n", "", "a block has no AOI"),
        ("AOI 30", "AOI -30", "AOI -30 is below 0"),
        ("20 22", "20", "line 16: BSDF at AOI 30 has too few numbers: 7, not 4 rows of 2"),
        ("20 22", "20 nan", "line 16: BSDF at AOI 30: 'nan' is not finite"),
        ("DataEnd\n", block(30, 50) + "DataEnd\n", "there are two blocks of AOI 30 with the same words"),
        ("DataEnd\n", block(30, 50, "Back").replace("POI 0", "POI 90") + "DataEnd\n", "it has 2 planes of incidence (POI)"),
        ("DataEnd\n", "DataEnd\nAOI 1\n", "'AOI' follows DataEnd"),
        ("DataEnd\n", "", "the file ends before DataEnd"),
        ("Wavelength 550\n", "Wavelength 550\nTristimulusValue TrisX\n", "TristimulusValue is of SpectralContent XYZ"),
    ],
)
def test_a_broken_file_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = HEADER + block(30, 20) + "DataEnd\n"
    assert old in text
    with pytest.raises(FormatError) as caught:
        read(saved(tmp_path, text.replace(old, new, 1)))
    assert message in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_file_without_a_block_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="there is no block of data"):
        read(saved(tmp_path, HEADER + "DataEnd\n"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lighttools")


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([0.0, 12.5, 60.0, 90.0]),
            st.sampled_from(["Front", "Back"]),
            st.sampled_from(["BRDF", "BTDF"]),
            st.floats(0.0, 1e6),
        ),
        min_size=1,
        max_size=6,
        unique_by=lambda each: each[:3],
    )
)
def test_the_values_of_any_blocks_are_read(folder: Path, stated: list[tuple[float, str, str, float]]) -> None:
    text = HEADER + "".join(block(aoi, first, side, kind) for aoi, side, kind, first in stated) + "DataEnd\n"
    part = part_of(saved(folder, text))
    np.testing.assert_allclose(part.values[::8], [each[3] for each in stated])
    assert part.sigma_deg[::8].tolist() == [each[0] for each in stated]
    assert np.asarray(part.back)[::8].tolist() == [each[1] == "Back" for each in stated]
    assert np.asarray(part.transmitted)[::8].tolist() == [each[2] == "BTDF" for each in stated]
