"""Lumicept .ddr files: written byte for byte as other programs read them; inconsistent files are refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from goniotwin.app.formats import BsdfTable, DdrTable, FormatError, bsdf, read_ddr, write_ddr
from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.ddr import RGB, read, recognise, write
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import arc_direction
from tests.app.formats.tables import bsdf_tables, check_same_text

SPECTRAL = """\
;; our own comment, wl 1 and sigma in it
;; all of it at the top
Source Measured
TypeSym PlaneSymmetrical
TypeColorModel spectral 2
TypeData Luminance Absolute
sigma 2
 0 90
phi 3
 0 90 180
theta 3
 0 90 180
wl 450
 kbdf
  1.0 1.0
 def
;; Sigma = 0
 0.9 0.5 0.5
 0.9 0.5 0.5
 0.9 0.5 0.5
;; Sigma = 90
 0.95 0.5 0.5
 0.95 0.5 0.5
 0.95 0.5 0.5
 enddef
wl 650
 kbdf
  1.0 1.0
 def
;; Sigma = 0
 1 0 0.333333333
 1 0 0.333333333
 1 0 0.333333333
;; Sigma = 90
 1 0 0.25
 1 0 0.25
 1 0 0.125
 enddef
"""
BLACK_AND_WHITE_4D = """\
Source Generated
TypeSym ASymmetrical 4D
TypeColorModel BW
TypeData Luminance Absolute
psi 2
 0 180
sigma 1
 0
phi 2
 0 360
theta 1
 0
bw
 kbdf
  1.0
  1.0
 def
;; Psi = 0, Sigma = 0
 1
 2
;; Psi = 180, Sigma = 0
 3
 4
 enddef
"""


def spectral_table() -> DdrTable:
    short = [[[0.9, 0.5, 0.5]] * 3, [[0.95, 0.5, 0.5]] * 3]
    long = [[[1, 0, 1 / 3]] * 3, [[1, 0, 0.25], [1, 0, 0.25], [1, 0, 0.125]]]
    return DdrTable(
        source="Measured",
        symmetry="PlaneSymmetrical",
        psi_deg=np.zeros(1),
        sigma_deg=np.array([0.0, 90]),
        phi_deg=np.array([0.0, 90, 180]),
        theta_deg=np.array([0.0, 90, 180]),
        channels=(450.0, 650.0),
        values=np.array([[short], [long]]),
        comments=("our own comment, wl 1 and sigma in it", "all of it at the top"),
    )


def saved(folder: Path, text: str) -> Path:
    path = folder / "table.ddr"
    path.write_bytes(text.encode())
    return path


def refusal(path: Path) -> str:
    with pytest.raises(FormatError) as caught:
        read_ddr(path)
    text = str(caught.value)
    assert text.isprintable(), "one line"
    assert text.startswith(str(path))
    return text.removeprefix(str(path))


def test_a_spectral_table_is_written_in_the_format(tmp_path: Path) -> None:
    write_ddr(tmp_path / "out.ddr", spectral_table())
    assert (tmp_path / "out.ddr").read_bytes() == SPECTRAL.encode()


def test_a_spectral_table_is_read(tmp_path: Path) -> None:
    table = read_ddr(saved(tmp_path, SPECTRAL))
    assert (table.source, table.symmetry, table.channels) == ("Measured", "PlaneSymmetrical", (450.0, 650.0))
    assert table.psi_deg.tolist() == [0]
    assert table.sigma_deg.tolist() == [0, 90]
    assert table.phi_deg.tolist() == [0, 90, 180]
    assert table.theta_deg.tolist() == [0, 90, 180]
    assert table.values.shape == (2, 1, 2, 3, 3)
    np.testing.assert_allclose(table.values, spectral_table().values, rtol=5e-9)
    assert table.comments == spectral_table().comments


def test_a_black_and_white_table_of_an_anisotropic_sample_is_read_and_written(tmp_path: Path) -> None:
    table = read_ddr(saved(tmp_path, BLACK_AND_WHITE_4D))
    assert (table.symmetry, table.channels) == ("ASymmetrical 4D", (None,))
    assert table.psi_deg.tolist() == [0, 180]
    assert table.values.tolist() == [[[[[1], [2]]], [[[3], [4]]]]]
    write_ddr(tmp_path / "out.ddr", table)
    assert (tmp_path / "out.ddr").read_text() == BLACK_AND_WHITE_4D


def test_a_perfect_white_diffuser_is_one_over_pi_per_steradian() -> None:
    white = replace(spectral_table(), values=np.ones((2, 1, 2, 3, 3)))
    np.testing.assert_allclose(bsdf(white), 0.3183098861837907, rtol=1e-15)  # 1 / pi


def test_kbdf_multiplies_the_values_sigma_fastest(tmp_path: Path) -> None:
    table = read_ddr(saved(tmp_path, SPECTRAL.replace("  1.0 1.0", "  2.0 10.0", 1)))
    assert table.values[0, 0, 0, 0].tolist() == [1.8, 1.0, 1.0]
    assert table.values[0, 0, 1, 0].tolist() == [9.5, 5.0, 5.0]
    np.testing.assert_allclose(table.values[1], spectral_table().values[1], rtol=5e-9)
    psi = read_ddr(saved(tmp_path, BLACK_AND_WHITE_4D.replace("  1.0\n  1.0", "  1.0\n  10.0")))
    assert psi.values.ravel().tolist() == [1, 2, 30, 40]


@pytest.mark.parametrize(
    "text",
    [
        SPECTRAL.replace("\n", "\r\n"),
        SPECTRAL.replace("TypeSym PlaneSymmetrical\n", ""),
        SPECTRAL.replace("Source Measured\n", ""),
        SPECTRAL.replace("phi 3\n", "sigmat 0 90\nphi 3\n"),
        SPECTRAL.replace("TypeData Luminance Absolute\n", ""),
        SPECTRAL.replace(" kbdf\n  1.0 1.0\n", ""),
        SPECTRAL.upper(),
        "\n".join(line for line in SPECTRAL.splitlines() if not line.startswith(";;")).replace("\n", " "),
    ],
    ids=[
        "CRLF",
        "default symmetry",
        "no source",
        "axis in the specular direction",
        "default data",
        "no kbdf",
        "upper case",
        "one line",
    ],
)
def test_variants_that_other_readers_accept_are_read(tmp_path: Path, text: str) -> None:
    np.testing.assert_allclose(read_ddr(saved(tmp_path, text)).values, spectral_table().values, rtol=5e-9)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("sigma 2\n", "sigma 3\n", "line 7: sigma: the count is 3, but the list has 2 angles"),
        ("phi 3\n", "phi 2\n", "line 9: phi: the count is 2, but the list is longer"),
        (" 0 90 180\ntheta", " 180 90 0\ntheta", "line 10: phi 90 follows 180: the list does not ascend"),
        (" 0 90\n", " 90 0\n", "line 8: sigma 0 follows 90: the list does not ascend"),
        (" 0 90\n", " 0 91\n", "line 8: sigma 91 is outside 0 to 90 deg"),
        (" 0 90 180\ntheta", " 0 90 270\ntheta", "PlaneSymmetrical has 0 to 180 only"),
        (" 0.9 0.5 0.5\n", " 0.9 0.5\n", "line 18: def of wl 450 has too few numbers: 17, not 6 rows of 3"),
        (" 0.9 0.5 0.5\n", " 0.9 0.5 0.5 0.5\n", "line 18: def of wl 450 has too many numbers: 19, not 6 rows of 3"),
        (" 0.9 0.5 0.5\n", " 0.9 0.5 0,5\n", "line 18: def of wl 450: '0,5' has a decimal comma"),
        (" 0.9 0.5 0.5\n", " 0.9 0.5 nan\n", "line 18: def of wl 450: 'nan' is not finite"),
        ("  1.0 1.0\n", "  1.0\n", "line 15: kbdf of wl 450 has too few numbers"),
        ("  1.0 1.0\n", "  1.0 -1.0\n", "line 15: kbdf of wl 450 has a negative factor"),
        (" enddef\nwl", "wl", "line 25: expected enddef, found 'wl'"),
        (" enddef\nwl", " enddef 1\nwl", "line 25: expected wl, found '1'"),
        ("spectral 2", "spectral 3", "line 38: the file ends after 2 of the 3 blocks of TypeColorModel"),
        ("spectral 2", "spectral 1", "line 26: 'wl' follows the last of the 1 blocks of TypeColorModel"),
        ("spectral 2", "spectral", "line 6: 'TypeData' is not a possible number of wavelengths"),
        ("spectral 2", "BW", "line 13: expected bw, found 'wl'"),
        ("spectral 2", "RGB", "line 13: expected red, found 'wl'"),
        ("spectral 2", "XYZ", "line 5: TypeColorModel 'XYZ' is not supported"),
        ("TypeColorModel spectral 2\n", "", "TypeColorModel is missing"),
        ("wl 650", "wl 450", "line 26: wl 450 does not ascend"),
        ("Luminance Absolute", "Luminance Percent", "line 6: TypeData 'Percent' is not supported"),
        ("Luminance Absolute", "Radiance Absolute", "line 6: TypeData 'Radiance' is not supported"),
        ("PlaneSymmetrical", "AxiSymmetrical", "TypeSym AxiSymmetrical with 3 phi is not supported: its meaning is not public"),
        ("PlaneSymmetrical", "DirSymmetrical", "line 4: TypeSym 'DirSymmetrical' is not supported"),
        ("PlaneSymmetrical", "Symmetric", "line 4: TypeSym 'Symmetric' is not supported"),
        ("Source Measured", "Source Guessed", "line 3: Source 'Guessed' is not supported"),
        ("phi 3\n", "phy 3\n", "line 9: 'phy' is not a keyword of a .ddr file; did you mean phi?"),
        ("phi 3\n", "sigmat 0\nphi 3\n", "line 9: sigmat has too few numbers: 1, not 1 rows of 2"),
        ("phi 3\n", "sigmat 0 91\nphi 3\n", "sigmat has numbers outside 0 to 90"),
        ("sigma 2\n", "sigmat 0 90\nsigma 2\n", "line 7: sigmat comes before sigma"),
        ("phi 3\n", "psi 2\n0 90\nphi 3\n", "psi is [0] unless the symmetry is ASymmetrical 4D"),
        ("phi 3\n", "sigma 1\n0\nphi 3\n", "line 9: sigma is given twice"),
        (";; our", "our", "line 1: 'our' is not a keyword of a .ddr file"),
    ],
)
def test_a_file_that_other_programs_misread_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in SPECTRAL
    assert message in refusal(saved(tmp_path, SPECTRAL.replace(old, new, 1)))


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    for length in range(len(SPECTRAL.rstrip())):  # the last line end may be missing
        refusal(saved(tmp_path, SPECTRAL[:length]))


def test_a_missing_or_unreadable_file_is_refused(tmp_path: Path) -> None:
    assert "there is no such file" in refusal(tmp_path / "absent.ddr")
    assert "is a folder" in refusal(tmp_path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ddr")


def read_or_refused(path: Path) -> None:
    try:
        table = read_ddr(path)
    except FormatError:
        refusal(path)
    else:
        write_ddr(path, table)  # a table that is read can be written


@settings(deadline=None)
@given(content=st.one_of(st.binary(), st.text().map(lambda text: text.encode("utf-8", "surrogatepass"))))
def test_arbitrary_bytes_are_refused_and_raise_nothing_else(folder: Path, content: bytes) -> None:
    path = folder / "any.ddr"
    path.write_bytes(content)
    with pytest.raises(FormatError):
        read_ddr(path)


@settings(deadline=None)
@given(data=st.data())
def test_a_mutated_file_is_a_valid_table_or_refused(folder: Path, data: st.DataObject) -> None:
    text = data.draw(st.sampled_from([SPECTRAL, BLACK_AND_WHITE_4D])).encode()
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(len(text), start + 12)))
        words = st.sampled_from([b"", b" ", b"9", b"-", b".", b"e308", b"nan ", b"wl ", b"enddef\n", b";;", b"4D "])
        text = text[:start] + data.draw(words | st.binary(max_size=4)) + text[end:]
    path = folder / "mutated.ddr"
    path.write_bytes(text)
    read_or_refused(path)


@settings(deadline=None)
@given(data=st.data())
def test_a_file_with_words_exchanged_is_a_valid_table_or_refused(folder: Path, data: st.DataObject) -> None:
    words = data.draw(st.sampled_from([SPECTRAL, BLACK_AND_WHITE_4D])).split("\n", 2)[2].split()
    index = st.integers(0, len(words) - 1)
    for _ in range(data.draw(st.integers(1, 3))):
        words[data.draw(index)] = words[data.draw(index)]
    path = folder / "exchanged.ddr"
    path.write_text("\n".join(words))
    read_or_refused(path)


def angle_lists(end: float) -> st.SearchStrategy[list[float]]:
    # In steps of 0.001 deg: far wider than the ninth digit, so no two angles become one.
    steps = st.sets(st.integers(0, round(end * 1000)), min_size=1, max_size=4)
    return steps.map(lambda numbers: [number / 1000 for number in sorted(numbers)])


@st.composite
def tables(draw: st.DrawFn) -> DdrTable:
    symmetry = draw(st.sampled_from(["PlaneSymmetrical", "ASymmetrical", "ASymmetrical 4D"]))
    psi = draw(angle_lists(360)) if symmetry == "ASymmetrical 4D" else [0.0]
    lists = [np.array(psi), *(np.array(draw(angle_lists(end))) for end in (90, 180, 180))]
    wavelengths = st.sets(st.integers(200_000, 2_500_000), min_size=1, max_size=3)
    spectral = wavelengths.map(lambda numbers: tuple(number / 1000 for number in sorted(numbers)))
    channels = draw(st.just((None,)) | spectral)
    shape = (len(channels), *(angles.size for angles in lists))
    return DdrTable(
        source=draw(st.sampled_from(["Measured", "Generated", "Edited", "Morphed"])),
        symmetry=symmetry,
        psi_deg=lists[0],
        sigma_deg=lists[1],
        phi_deg=lists[2],
        theta_deg=lists[3],
        channels=channels,
        values=draw(arrays(np.float64, shape, elements=st.floats(-1e9, 1e9))),
        comments=tuple(draw(st.lists(st.text(max_size=20), max_size=3))),
    )


@settings(deadline=None)
@given(table=tables())
def test_reading_returns_the_written_table_to_nine_digits(folder: Path, table: DdrTable) -> None:
    path = folder / "round.ddr"
    write_ddr(path, table)
    again = read_ddr(path)
    assert (again.source, again.symmetry, again.channels) == (table.source, table.symmetry, table.channels)
    for name in ("psi_deg", "sigma_deg", "phi_deg", "theta_deg"):
        assert getattr(again, name).tolist() == getattr(table, name).tolist()
    # Half a unit of the ninth digit is at most 5e-9 of the number.
    np.testing.assert_allclose(again.values, table.values, rtol=5e-9, atol=5e-324)
    first = path.read_bytes()
    write_ddr(path, again)
    assert path.read_bytes() == first, "writing the table read gives the same bytes"
    assert first.isascii()


@settings(deadline=None)
@given(comments=st.lists(st.text() | st.sampled_from(["wl 450", "a\nsigma 2\n0 90", "\r;; phi", "\x85def"]), max_size=4))
def test_no_comment_changes_the_table(folder: Path, comments: list[str]) -> None:
    path = folder / "commented.ddr"
    write_ddr(path, replace(spectral_table(), comments=tuple(comments)))
    top, mark, rest = path.read_bytes().partition(b"Source Measured\n")
    assert all(line.startswith(b";;") for line in top.splitlines())
    assert mark + rest == SPECTRAL.encode().split(b"at the top\n")[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values": np.zeros((1, 1, 2, 3, 3))}, "shape"),
        ({"values": np.full((2, 1, 2, 3, 3), np.inf)}, "36 of 36 values that are not finite"),
        ({"sigma_deg": np.array([90.0, 0])}, "sigma does not ascend"),
        ({"theta_deg": np.array([0.0, 90, 181])}, "theta has numbers outside 0 to 180"),
        ({"phi_deg": np.array([0.0, 90, 360])}, "PlaneSymmetrical has 0 to 180 only"),
        ({"psi_deg": np.array([10.0])}, "psi is"),
        ({"channels": (650.0, 450.0)}, "channels does not ascend"),
        ({"channels": (None, 450.0)}, "channels"),
        ({"symmetry": "AxiSymmetrical"}, "symmetry is one of"),
        ({"source": "measured"}, "source is one of"),
    ],
)
def test_an_inconsistent_table_is_refused(change: dict[str, object], message: str) -> None:
    fields: dict[str, object] = {**vars(spectral_table()), **change}
    with pytest.raises(ValueError, match=message):
        DdrTable(**fields)  # type: ignore[arg-type]


def test_a_table_that_cannot_be_written_raises_a_format_error(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="cannot be written"):
        write_ddr(tmp_path / "absent" / "out.ddr", spectral_table())
    with pytest.raises(FormatError, match="sigma has two angles that are both written 30"):
        write_ddr(tmp_path / "out.ddr", replace(spectral_table(), sigma_deg=np.array([30, 30 + 1e-12])))
    assert list(tmp_path.iterdir()) == []


# ---- what other programs write: by libbsdf's DdrReader.cpp ----

COLOURED = """\
TypeColorModel RGB
TypeSym PlaneSymmetrical
sigma 1 0
phi 2 0 180
theta 2 0 90
red def 1 2 3 4 enddef
gre def 5 6 7 8 enddef
blu def 9 10 11 12 enddef
"""


@pytest.mark.parametrize(
    "text",
    [COLOURED, COLOURED.replace("TypeColorModel RGB\n", ""), COLOURED.replace("gre ", "green ").replace("blu ", "Blue ")],
    ids=["RGB", "without TypeColorModel", "long words"],
)
def test_three_colours_are_read(tmp_path: Path, text: str) -> None:
    table = read(saved(tmp_path, text)).only_table()
    assert (table.colours, table.wavelengths_nm) == (RGB, None)
    np.testing.assert_allclose(np.pi * table.values.ravel(), np.arange(1.0, 13.0), rtol=1e-15)
    path = tmp_path / "again.ddr"
    write(path, BsdfFile((table,)))
    assert [line for line in path.read_text().splitlines() if line in ("red", "gre", "blu")] == ["red", "gre", "blu"]
    np.testing.assert_allclose(read(path).only_table().values, table.values, rtol=5e-9)


def test_colours_in_another_order_are_refused(tmp_path: Path) -> None:
    assert "line 6: expected red, found 'blu'" in refusal(saved(tmp_path, COLOURED.replace("red ", "blu ")))
    grey = COLOURED.replace("TypeColorModel RGB\n", "").replace("red ", "bw ")
    assert "line 5: TypeColorModel is missing, which means RGB; expected red, found 'bw'" in refusal(saved(tmp_path, grey))


def of_type(data: str, phi: str, values: str, kbdf: str = "", sigma: str = "2 0 60") -> str:
    lists = f"sigma {sigma}\nphi {phi}\ntheta 3 0 90 180\n"
    return f"TypeSym ASymmetrical\nTypeColorModel BW\nTypeData {data}\n{lists}bw {kbdf} def {values} enddef\n"


def test_relative_values_are_scaled_to_the_reflectance_kbdf(tmp_path: Path) -> None:
    """A diffuser of any scale has the BSDF kbdf / pi; a lobe has the integral that is its reflectance."""
    constant = of_type("Luminance Relative", "3 0 180 360", "7 " * 9 + "0.2 " * 9, "kbdf 0.8 0.5")
    table = read(saved(tmp_path, constant)).only_table()
    np.testing.assert_allclose(table.values[0, 0, 0], 0.8 / np.pi, rtol=1e-4)
    np.testing.assert_allclose(table.values[0, 0, 1], 0.5 / np.pi, rtol=1e-4)
    assert "TypeData Luminance Relative of the file, as luminance factors" in table.comments
    # f = c (1 - t) with t = theta / 90 deg: the integral is 2 pi c int (1 - t) sin(theta) cos(theta) dtheta.
    lobe = of_type("Luminance Relative", "3 0 180 360", "5 0 0 " * 3 + "1 1 1 " * 3, "kbdf 1 1")
    steps = (np.arange(200_000) + 0.5) / 200_000
    integral = np.pi**2 * np.mean((1.0 - steps) * np.sin(np.pi * steps / 2) * np.cos(np.pi * steps / 2))
    assert read(saved(tmp_path, lobe)).only_table().values[0, 0, 0, 0, 0] == pytest.approx(1.0 / integral, rel=1e-4)
    unscaled = read(saved(tmp_path, of_type("Luminance Relative", "1 0", "1 1 1 2 2 2"))).only_table()
    np.testing.assert_allclose(np.pi * unscaled.values[0, 0, :, 0, 0], [1.0, 2.0])
    assert "no kbdf: the scale of the values is not known" in unscaled.comments
    dark = of_type("Luminance Relative", "1 0", "1 1 1 0 0 0", "kbdf 1 1")
    assert "the relative values at sigma 60 have no positive sum" in refusal(saved(tmp_path, dark))
    assert read(saved(tmp_path, dark.replace("kbdf 1 1", "kbdf 1 0"))).only_table().values[0, 0, 1].max() == 0.0


def test_an_intensity_is_divided_by_the_cosine_and_not_by_pi(tmp_path: Path) -> None:
    text = of_type("Intensity Absolute", "3 0 180 360", "0.5 9 9 " * 3 + "0.5 9 9 " * 3, "kbdf 2 4")
    table = read(saved(tmp_path, text)).only_table()
    assert table.values[0, 0, 0, 0].tolist() == pytest.approx([1.0, 1.0, 1.0])  # the rest is at the horizon, or below it
    assert table.values[0, 0, 1, 0, 0] == pytest.approx(4.0 * 0.5 / np.cos(np.radians(60.0)))
    # theta 90 towards the normal is 30 deg beyond it: the cosine is cos(30 deg).
    assert table.values[0, 0, 1, 0, 1] == pytest.approx(4.0 * 9.0 / np.cos(np.radians(30.0)))
    assert any("at the horizon and below it" in line for line in table.comments)
    # A constant BSDF up to 80 deg has the reflectance pi f sin(80 deg)^2.
    relative = of_type("Intensity Relative", "1 0", f"4 2 {4.0 * np.cos(np.radians(80.0))}", "kbdf 0.3", "1 0")
    table = read(saved(tmp_path, relative.replace("theta 3 0 90 180", "theta 3 0 60 80"))).only_table()
    np.testing.assert_allclose(table.values, 0.3 / (np.pi * np.sin(np.radians(80.0)) ** 2), rtol=1e-4)


def test_one_row_of_an_axisymmetrical_lobe_is_all_of_it(tmp_path: Path) -> None:
    text = of_type("Luminance Absolute", "1 0", "3 2 1 6 5 4").replace("TypeSym ASymmetrical", "TypeSym AxiSymmetrical")
    table = read(saved(tmp_path, text)).only_table()
    assert table.phi_deg.tolist() == [0, 180]
    np.testing.assert_allclose(np.pi * table.values[0, 0, 0], [[3, 2, 1], [3, 2, 1]])


def test_a_refracted_axis_gives_values_at_their_directions(tmp_path: Path) -> None:
    """theta = 0 is at sigmat; the rest turns with it, as in libbsdf's SpecularCoordinateSystem with an offset."""
    lists = "TypeSym PlaneSymmetrical\nTypeColorModel BW\nsigma 2 0 60\nsigmat 0 35.26\nphi 3 0 90 180\ntheta 2 0 20\n"
    numbers = " ".join(map(str, range(1, 13)))
    path = tmp_path / "a.ddt"
    path.write_text(f"{lists}bw def {numbers} enddef\n")
    (part,) = read(path).parts
    assert isinstance(part, ScatteredBsdf)
    assert np.all(np.asarray(part.transmitted))
    assert part.isotropic
    assert part.size == 2 * 4 * 2  # phi 270 is the mirror image of 90
    found = arc_direction(part.polar_deg, part.azimuth_deg)
    expected = {
        (0.0, 1): (0.0, 0.0, 0.0),
        (60.0, 7): (35.26, 0.0, 0.0),
        (60.0, 8): (35.26, 20.0, 0.0),
        (60.0, 12): (35.26, 20.0, 180.0),
    }
    for (sigma, value), angles in expected.items():
        at = np.flatnonzero((part.sigma_deg == sigma) & np.isclose(np.pi * part.values, value))
        np.testing.assert_allclose(found[at], np.broadcast_to(from_specular(*angles), found[at].shape), atol=1e-12)
    sides = found[np.isclose(np.pi * part.values, 10.0)]
    np.testing.assert_allclose(sides[0], sides[1] * [1.0, -1.0, 1.0], atol=1e-12)
    assert any("0, 35.26 deg, one for each sigma" in line for line in part.comments)
    path.write_text(f"{lists.replace('sigmat 0 35.26', 'sigmat 0 60')}bw def {numbers} enddef\n")
    assert isinstance(read(path).parts[0], BsdfTable)


# ---- parts of a file ----


@settings(deadline=None)
@given(table=bsdf_tables("rgb"))
def test_a_table_is_read_as_it_was_written(folder: Path, table: BsdfTable) -> None:
    path = folder / ("part.ddt" if table.transmitted else "part.ddr")
    write(path, BsdfFile((table,)))
    again = read(path).only_table()
    assert recognise(path.read_bytes())
    for name in ("transmitted", "generated", "colours", "back", "sample", "wavelengths_nm"):
        assert getattr(again, name) == getattr(table, name)
    for name in ("psi_deg", "sigma_deg", "theta_deg"):
        np.testing.assert_allclose(getattr(again, name), getattr(table, name), rtol=1e-9)
    unfolded = table.phi_deg[-1] <= 180.0 and table.psi_deg.tolist() != [0.0]
    assert again.phi_deg[-1] == (360.0 if unfolded else table.phi_deg[-1])
    np.testing.assert_allclose(again.values[..., : table.phi_deg.size, :], table.values, rtol=1e-8, atol=1e-300)
    first = path.read_text()
    write(path, BsdfFile((again,)))
    check_same_text(path.read_text(), first, float(np.abs(table.values).max()))


def test_parts_that_one_table_cannot_hold_are_refused(tmp_path: Path) -> None:
    axes = np.array([0.0, 90]), np.array([0.0, 180]), np.array([0.0, 90])
    table = BsdfTable(*axes, np.zeros((3, 1, 2, 2, 2)), colours=("X", "Y", "Z"))
    for parts, message in (((table,), "has the colours X, Y, Z, and a .ddr has RGB; use .ssdd"), ((table, table), "2 parts")):
        with pytest.raises(FormatError, match=message):
            write(tmp_path / "a.ddr", BsdfFile(parts))
    assert list(tmp_path.iterdir()) == []
