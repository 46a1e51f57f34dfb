"""SSDD files: the forms of the specification's examples, other parameters at their directions, refusals."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.formats import BsdfTable, FormatError
from goniotwin.app.formats.content import BsdfFile, RegularTable, ScatteredBsdf
from goniotwin.app.formats.metadata import InstrumentMetadata, Metadata
from goniotwin.app.formats.ssdd import read, recognise, write
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import arc_direction

# The four quantities in the order of the specification's second example (doc/SsddFileFormatSpecification.md of libbsdf).
FOUR = """\
VERSION 0.2

# blue
DATA_TYPE brdf
COLOR_MODEL rgb
PARAM_TYPE half_difference_coordinate_system
REDUCTION_TYPE bilateral_symmetry reciprocity
PARAM0_LIST 0 45
PARAM2_LIST 0 30
PARAM3_LIST 0 90
NAME metallic paint
DEVICE GCMS-4
DATA ascii
# PARAM3: 0
# PARAM2: 0
0 1 10
0 2 20
# PARAM2: 30
0 3 30
0 4 40
# PARAM3: 90
0 5 50
0 6 60
0 7 70
0 8 80

# orange
DATA_TYPE btdf
COLOR_MODEL xyz
PARAM_TYPE specular_coordinate_system
REDUCTION_TYPE bilateral_symmetry
PARAM0_LIST 0 90
PARAM2_LIST 0 180
PARAM3_LIST 0 180
SOURCE_TYPE generated
DATA ascii
1 0 0
2 0 0
3 0 0
4 0 0
5 0 0
6 0 0
7 0 0
8 0 1e-3

DATA_TYPE specular_reflectance
COLOR_MODEL spectrum
WAVELENGTH_LIST 400 550 700
PARAM0_LIST 0 90
MEASUREMENT_DATE 2019-12-26
DATA ascii
0.04 0.05 0.06
1 1 1

DATA_TYPE specular_transmittance
COLOR_MODEL monochrome
PARAM0_LIST 0 90
PARAM1_LIST 0 90 180
DATA ascii
0.1
0.2
0.3
0.4
0.5
0.6
"""


def saved(folder: Path, text: str | bytes) -> Path:
    path = folder / "paint.ssdd"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def refusal(path: Path) -> str:
    with pytest.raises(FormatError) as caught:
        read(path)
    text = str(caught.value)
    assert text.isprintable(), "one line"
    assert text.startswith(str(path))
    return text.removeprefix(str(path))


def test_the_four_quantities_of_a_file_are_its_parts(tmp_path: Path) -> None:
    content = read(saved(tmp_path, FOUR))
    assert recognise(FOUR.encode())
    brdf, btdf, reflectance, transmittance = content.parts
    assert isinstance(brdf, ScatteredBsdf)
    assert (brdf.sample, brdf.isotropic, brdf.generated) == ("metallic paint", True, False)
    assert brdf.comments == ("blue", "half_difference_coordinate_system of the file, at its directions")
    assert isinstance(btdf, BsdfTable)
    assert (btdf.transmitted, btdf.generated, btdf.colours, btdf.comments) == (True, True, ("X", "Y", "Z"), ("orange",))
    # PARAM0 (sigma) is fastest, then PARAM2 (theta), then PARAM3 (phi).
    assert btdf.values[0, 0].tolist() == [[[1, 3], [5, 7]], [[2, 4], [6, 8]]]
    assert btdf.values[2, 0, 1, 1, 1] == 1e-3
    assert isinstance(reflectance, RegularTable)
    assert (reflectance.wavelengths_nm, reflectance.transmitted) == ((400.0, 550.0, 700.0), False)
    assert reflectance.values.tolist() == [[[0.04, 1]], [[0.05, 1]], [[0.06, 1]]]
    assert isinstance(transmittance, RegularTable)
    assert transmittance.transmitted
    assert transmittance.psi_deg.tolist() == [0, 90, 180]
    assert transmittance.values.tolist() == [[[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]]]
    assert (content.metadata.instrument.name, content.metadata.date) == ("GCMS-4", "2019-12-26")


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: "# a comment before VERSION\n\n" + text,
        lambda text: text.replace("PARAM0_LIST 0 90", "PARAM0_LIST\t0   90 # deg"),
        lambda text: text.replace("5 0 0\n", "  5\t0 0 # here\n\n# there\n"),
        lambda text: text.rstrip("\n"),
    ],
    ids=["CRLF", "BOM", "comment first", "white space", "comments in data", "no line end"],
)
def test_white_space_and_comments_do_not_matter(tmp_path: Path, change: object) -> None:
    assert callable(change)
    expected, found = read(saved(tmp_path, FOUR)), read(saved(tmp_path, change(FOUR)))
    for one, other in zip(expected.parts, found.parts, strict=True):
        np.testing.assert_array_equal(one.values, other.values)


def test_a_single_value_is_a_diffuser(tmp_path: Path) -> None:
    """The specification's first example: values are in 1/sr, so that a white diffuser is 1 / pi."""
    head = "VERSION 0.2\nDATA_TYPE brdf\nCOLOR_MODEL monochrome\nPARAM_TYPE spherical_coordinate_system\n"
    path = saved(tmp_path, head + "PARAM0_LIST 0\nPARAM2_LIST 0\nPARAM3_LIST 0\nDATA ascii\n0.3183\n")
    (part,) = read(path).parts
    assert isinstance(part, ScatteredBsdf)
    assert (part.size, part.values[0], part.polar_deg[0]) == (1, 0.3183, 0.0)


def test_binary_data_are_floats_of_32_bits(tmp_path: Path) -> None:
    """As libbsdf's SsddWriter::outputBinaryData writes them, with its line end before the next block."""
    head, rest = FOUR.split("DATA ascii\n1 0 0\n")
    numbers = [1, 0, 0, 2, 0, 0, 3, 0, 0, 4, 0, 0, 5, 0, 0, 6, 0, 0, 7, 0, 0, 8, 0, 1e-3]
    after = rest.partition("8 0 1e-3\n")[2]
    content = f"{head}DATA binary\n".encode() + struct.pack("<24f", *numbers) + after.encode()
    expected, found = read(saved(tmp_path, FOUR)), read(saved(tmp_path, content))
    for one, other in zip(expected.parts, found.parts, strict=True):
        np.testing.assert_allclose(one.values, other.values, rtol=1e-7)
    short = content[: content.index(b"DATA binary") + 40]
    assert "bytes of data, and the lists ask for 96" in refusal(saved(tmp_path, short))


# ---- directions ----


def block(system: str, lists: list[list[float]], values: Floats, more: str = "") -> str:
    names = [f"PARAM{n}_LIST {' '.join(map(str, each))}" for n, each in enumerate(lists) if n != 1 or each != [0]]
    data = "\n".join(f"{each:.9g}" for each in values.ravel())
    head = f"VERSION 0.2\nDATA_TYPE brdf\nCOLOR_MODEL monochrome\nPARAM_TYPE {system}_coordinate_system\n{more}"
    return head + "\n".join(names) + f"\nDATA ascii\n{data}\n"


def test_spherical_parameters_are_directions(tmp_path: Path) -> None:
    lists: list[list[float]] = [[0, 30], [0, 90], [0, 45, 90], [0, 170, 360]]
    values = np.arange(36.0).reshape(3, 3, 2, 2)
    (part,) = read(saved(tmp_path, block("spherical", lists, values))).parts
    assert isinstance(part, ScatteredBsdf)
    assert not part.isotropic
    at = part.values.astype(int)
    phi, theta, psi, sigma = np.unravel_index(at, values.shape)
    assert part.sigma_deg.tolist() == [lists[0][n] for n in sigma]
    assert part.psi_deg.tolist() == [lists[1][n] for n in psi]
    assert part.polar_deg.tolist() == [lists[2][n] for n in theta]
    assert part.azimuth_deg.tolist() == [lists[3][n] % 360 for n in phi]


def test_bilateral_symmetry_gives_both_sides_of_the_plane_of_incidence(tmp_path: Path) -> None:
    lists: list[list[float]] = [[40], [0], [30], [0, 60, 180]]
    text = block("spherical", lists, np.array([1.0, 2.0, 3.0]), "REDUCTION_TYPE bilateral_symmetry\n")
    (part,) = read(saved(tmp_path, text)).parts
    assert isinstance(part, ScatteredBsdf)
    found = sorted(zip(part.azimuth_deg.tolist(), part.values.tolist(), strict=True))
    assert found == [(0, 1), (0, 1), (60, 2), (180, 3), (300, 2)]  # 0 is at 360, too


def half_difference(light: Floats, seen: Floats) -> tuple[Floats, Floats, Floats]:
    """Rusinkiewicz (1998), from two directions: theta_h, theta_d, and phi_d from the plane of normal and half vector."""
    half = (light + seen) / np.linalg.norm(light + seen, axis=-1, keepdims=True)
    theta_h = np.degrees(np.arccos(np.clip(half[:, 2], -1.0, 1.0)))
    theta_d = np.degrees(np.arccos(np.clip(np.sum(light * half, axis=1), -1.0, 1.0)))
    down = np.cross(np.cross([0.0, 0.0, 1.0], half), half)  # the direction of increasing theta_h
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    across = np.cross(half, down)
    phi_d = np.degrees(np.arctan2(np.sum(light * across, axis=1), np.sum(light * down, axis=1))) % 360.0
    return theta_h, theta_d, phi_d


def test_half_difference_parameters_are_directions(tmp_path: Path) -> None:
    """A reciprocal function of the half-difference angles, read at directions, is that function of the directions."""
    theta_h, theta_d, phi_d = [10.0, 25.0], [5.0, 40.0], [0.0, 30.0, 75.0, 90.0]

    def function(h: Floats, d: Floats, p: Floats) -> Floats:
        return 1.0 + 0.1 * h + 0.01 * d + 0.3 * np.cos(np.radians(2.0 * p))

    grid = np.meshgrid(phi_d, theta_d, [0.0], theta_h, indexing="ij")
    values = function(grid[3], grid[1], grid[0])
    text = block("half_difference", [theta_h, [0], theta_d, phi_d], values, "REDUCTION_TYPE bilateral_symmetry reciprocity\n")
    (part,) = read(saved(tmp_path, text)).parts
    assert isinstance(part, ScatteredBsdf)
    assert part.isotropic
    assert np.all(part.psi_deg == 0.0)
    assert part.size == 2 * 2 * 13  # 0 to 360 with both ends
    light, seen = (
        arc_direction(polar, azimuth) for polar, azimuth in ((part.sigma_deg, part.psi_deg), (part.polar_deg, part.azimuth_deg))
    )
    np.testing.assert_allclose(part.values, function(*half_difference(light, seen)), rtol=1e-7)
    whole = sorted({*phi_d, *(180.0 - angle for angle in phi_d)})
    grid = np.meshgrid(whole, theta_d, [0.0], theta_h, indexing="ij")
    text = block("half_difference", [theta_h, [0], theta_d, whole], function(grid[3], grid[1], grid[0]))
    for reduction in ("reciprocity", "bilateral_symmetry"):
        (again,) = read(saved(tmp_path, text.replace("PARAM0", f"REDUCTION_TYPE {reduction}\nPARAM0"))).parts
        assert isinstance(again, ScatteredBsdf)
        assert sorted(again.values.round(9)) == sorted(part.values.round(9))


def test_an_offset_turns_the_axis(tmp_path: Path) -> None:
    text = block("specular", [[0, 60], [0], [0, 20], [0, 180, 360]], np.arange(12.0))
    with_offsets = text.replace("DATA ascii", "PARAM4_LIST 0 -24.74\nDATA ascii").replace("DATA_TYPE brdf", "DATA_TYPE btdf")
    (part,) = read(saved(tmp_path, with_offsets)).parts
    assert isinstance(part, ScatteredBsdf)
    on_axis = (part.sigma_deg == 60.0) & (part.values == 1.0)
    np.testing.assert_allclose(part.polar_deg[on_axis], 35.26)
    np.testing.assert_allclose(part.azimuth_deg[on_axis], 180.0)
    (plain,) = read(saved(tmp_path, text.replace("DATA ascii", "PARAM4_LIST 0 0\nDATA ascii"))).parts
    assert isinstance(plain, BsdfTable)


def test_distorted_parameters_go_from_the_specular_direction_to_the_horizon(tmp_path: Path) -> None:
    """By libbsdf's DistortedSphericalCoordinateSystem.h: theta 0 is the specular direction, theta 90 the horizon."""
    text = block("distorted_spherical", [[0, 50], [0], [0, 45, 90], [0, 90, 180]], np.arange(18.0))
    (part,) = read(saved(tmp_path, text)).parts
    assert isinstance(part, ScatteredBsdf)
    phi, theta, _, sigma = np.unravel_index(part.values.astype(int), (3, 3, 1, 2))
    np.testing.assert_allclose(part.polar_deg[theta == 0], [0.0, 50.0] * 3, atol=1e-6)
    np.testing.assert_allclose(part.azimuth_deg[(theta == 0) & (sigma == 1)], 180.0)
    np.testing.assert_allclose(part.polar_deg[theta == 2], 90.0, atol=1e-6)
    half = (theta == 1) & (sigma == 1)
    np.testing.assert_allclose(part.polar_deg[half & (phi == 2)], 70.0)  # half way between 50 and 90
    np.testing.assert_allclose(part.polar_deg[half & (phi == 0)], 20.0)  # and to 90 on the light's side


# ---- refusals ----


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("VERSION 0.2\n", "", "line 3: expected VERSION, found 'DATA_TYPE'"),
        ("VERSION 0.2", "VERSION 1.0", "line 1: VERSION '1.0' is not supported"),
        ("VERSION 0.2", "VERSION 0.2\nAUTHOR x", "line 2: 'AUTHOR' is not an entry of the file's header"),
        ("DATA_TYPE brdf", "DATA_TYPE bssrdf", "DATA_TYPE 'bssrdf' is not supported"),
        ("DATA_TYPE btdf", "DATA_TYPE brdf", "there are two blocks of 'brdf'"),
        ("COLOR_MODEL rgb\n", "", "COLOR_MODEL is missing"),
        ("COLOR_MODEL rgb", "COLOR_MODEL cmyk", "COLOR_MODEL 'cmyk' is not supported"),
        ("COLOR_MODEL rgb", "COLOR_MODEL rgb\nCOLOR_MODEL rgb", "line 6: COLOR_MODEL is given twice"),
        ("WAVELENGTH_LIST 400 550 700\n", "", "WAVELENGTH_LIST is missing"),
        ("400 550 700", "400 700 550", "WAVELENGTH_LIST does not ascend"),
        ("half_difference_coordinate", "cylindrical_coordinate", "PARAM_TYPE 'cylindrical_coordinate_system' is not supported"),
        ("symmetry reciprocity", "symmetry rotation", "REDUCTION_TYPE 'rotation' is not supported"),
        ("bilateral_symmetry\nPARAM0_LIST 0 90", "reciprocity\nPARAM0_LIST 0 90", "reciprocity is of half_difference"),
        ("PARAM3_LIST 0 90", "PARAM3_LIST 0 180", "PARAM3_LIST has 180, outside 0 to 90"),
        ("PARAM0_LIST 0 45", "PARAM0_LIST 0 95", "PARAM0_LIST has 95, outside 0 to 90"),
        ("PARAM0_LIST 0 45", "PARAM0_LIST", "PARAM0_LIST has no number"),
        ("PARAM0_LIST 0 45", "PARAM0_LIST 0 4,5", "PARAM0_LIST: '4,5' has a decimal comma"),
        ("PARAM2_LIST 0 30\n", "", "PARAM2_LIST is missing"),
        ("PARAM2_LIST 0 180", "PARAM2_LIST 0 90 180", "line 46: 4 colours are missing before DATA_TYPE"),
        ("PARAM2_LIST 0 180", "PARAM2_LIST 0", "line 41: '5' is not an entry of a block"),
        ("PARAM3_LIST 0 180\n", "PARAM3_LIST 0 180\nPARAM4_LIST 0\n", "PARAM4_LIST has 1 angles, and PARAM0_LIST 2"),
        ("PARAM3_LIST 0 180\n", "PARAM3_LIST 0 180\nPARAM4_LIST 0 5\n", "PARAM4_LIST turns the axis beyond 0 to 90"),
        ("0 2 20", "0 2", "line 17: a colour has 2 numbers, not 3"),
        ("0 2 20", "0 2 20 20", "line 17: a colour has 4 numbers, not 3"),
        ("0 2 20", "0 2 nan", "line 17: 'nan' is not finite"),
        ("0 2 20", "0 2 2_0", "line 17: '2_0' is not a number"),
        ("0 2 20", "0 2 2-0", "line 17: '2-0' is not a number"),
        ("0 2 20", "0 2 1e999", "larger than a 64-bit float"),
        ("SOURCE_TYPE generated", "SOURCE_TYPE guessed", "SOURCE_TYPE 'guessed' is not supported"),
        ("DATA ascii\n0.1", "DATA base64\n0.1", "DATA 'base64' is not supported"),
        ("NAME metallic", "TITLE metallic", "line 11: 'TITLE' is not an entry of a block"),
        ("PARAM0_LIST 0 45", f"PARAM0_LIST {' '.join(str(n / 100) for n in range(9000))}", "the file is too short"),
    ],
)
def test_a_broken_file_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in FOUR
    assert message in refusal(saved(tmp_path, FOUR.replace(old, new, 1)))


def test_every_truncated_file_is_refused_or_ends_with_a_whole_block(tmp_path: Path) -> None:
    whole = {0}
    for length in range(0, len(FOUR.rstrip()), 17):
        try:
            whole.add(len(read(saved(tmp_path, FOUR[:length])).parts))
        except FormatError:
            refusal(tmp_path / "paint.ssdd")
    assert whole <= {0, 1, 2, 3, 4}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ssdd")


@settings(deadline=None)
@given(data=st.data())
def test_a_mutated_file_is_read_or_refused(folder: Path, data: st.DataObject) -> None:
    content = FOUR.encode()
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(content)))
        end = data.draw(st.integers(start, min(len(content), start + 12)))
        words = st.sampled_from([b"", b" ", b"9", b"-", b"e308", b"nan ", b"#", b"DATA binary\n", b"\r", b"spherical"])
        content = content[:start] + data.draw(words | st.binary(max_size=4)) + content[end:]
    path = saved(folder, content)
    recognise(content)
    try:
        read(path)
    except FormatError:
        refusal(path)


def test_what_the_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    axes = np.array([0.0, 90]), np.array([0.0, 180]), np.array([0.0, 180])
    table = BsdfTable(*axes, np.zeros((1, 1, 2, 2, 2)))
    back = BsdfTable(*axes, np.zeros((1, 1, 2, 2, 2)), transmitted=True, back=True)
    colours = BsdfTable(*axes, np.zeros((1, 1, 2, 2, 2)), colours=("V",))
    points = ScatteredBsdf(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1), np.ones(1))
    for parts, message in (
        ((table, table), "two parts that are a brdf, and a .ssdd holds one"),
        ((table, back), "several samples or sides"),
        ((colours,), "has the colours V"),
        ((points,), "scattered values, .*; convert it to a grid"),
        ((), "nothing to write"),
    ):
        with pytest.raises(FormatError, match=message):
            write(tmp_path / "a.ssdd", BsdfFile(parts))
    assert list(tmp_path.iterdir()) == []


def test_metadata_are_entries_and_comments(tmp_path: Path) -> None:
    axes = np.array([0.0, 90]), np.array([0.0, 180]), np.array([0.0, 180])
    table = BsdfTable(*axes, np.zeros((1, 1, 2, 2, 2)), sample="Probe µ", back=True, comments=("of the table",))
    metadata = Metadata("A title", "2026-11-22T20:15:00Z", instrument=InstrumentMetadata("rig 7", "goniotwin 1.2"))
    write(tmp_path / "a.ssdd", BsdfFile((table,), metadata, ("of the file", "")))
    lines = (tmp_path / "a.ssdd").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "VERSION 0.2"
    for line in ("SOFTWARE goniotwin 1.2", "NAME Probe µ", "DEVICE rig 7", "MEASUREMENT_DATE 2026-11-22", "# title: A title"):
        assert line in lines
    assert lines.index("# of the file") < lines.index("SOFTWARE goniotwin 1.2") < lines.index("# of the table")
    content = read(tmp_path / "a.ssdd")
    (again,) = content.parts
    assert isinstance(again, BsdfTable)
    assert (again.sample, again.back, again.comments) == ("Probe µ", True, ("of the table",))
    assert {"of the file", "title: A title"} <= set(content.comments)
