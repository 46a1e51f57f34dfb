"""Zemax .bsdf files: reading, refusals with their lines, and writing without loss."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from goniotwin.app.formats import BsdfTable, FormatError, ZemaxBsdf, read_zemax, write_zemax
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.zemax import read, write

# One rotation, two incidences, azimuths 0 and 180, radials 0, 10, 90: the smallest file with every list.
GOOD = """\
# black paint
#    second line
Source\tMeasured
Symmetry\tPlaneSymmetrical
SpectralContent\tMonochrome
ScatterType\tBRDF
SampleRotation\t1
0
AngleOfIncidence\t2
10\t30
ScatterAzimuth\t2
0\t180
ScatterRadial\t3
0\t10\t90

Monochrome
DataBegin
TIS\t0.02
0.3\t0.2\t0.1
0.3\t0.25\t0.1
TIS\t0.03
1.5e-3\t0.2\t0
1.5e-3\t0.25\t-1e-6
DataEnd
"""
VALUES = [[[[[0.3, 0.2, 0.1], [0.3, 0.25, 0.1]], [[1.5e-3, 0.2, 0], [1.5e-3, 0.25, -1e-6]]]]]


def good(tmp_path: Path, text: str = GOOD) -> Path:
    path = tmp_path / "paint.bsdf"
    path.write_bytes(text.encode())
    return path


def refusal(path: Path) -> str:
    with pytest.raises(FormatError) as caught:
        read_zemax(path)
    text = str(caught.value)
    assert text.isprintable(), "one line"
    assert text.startswith(str(path))
    return text.removeprefix(str(path))


def test_all_fields_of_a_file_are_read(tmp_path: Path) -> None:
    table = read_zemax(good(tmp_path))
    assert (table.source, table.symmetry, table.scatter_type) == ("Measured", "PlaneSymmetrical", "BRDF")
    assert table.sample_rotation_deg.tolist() == [0]
    assert table.incidence_deg.tolist() == [10, 30]
    assert table.azimuth_deg.tolist() == [0, 180]
    assert table.radial_deg.tolist() == [0, 10, 90]
    assert table.values.tolist() == VALUES
    assert table.tis.tolist() == [[[0.02, 0.03]]]
    assert table.comments == ("black paint", "   second line")


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace("\t", "   "),
        lambda text: text.replace("\n", "\n\n"),
        lambda text: "".join(line + " # a comment\n" for line in text.splitlines()),
        lambda text: text.upper(),
        lambda text: text.lower(),
        lambda text: text.replace("\n0.3", " 0.3").replace("10\t30", "10\n30"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("black paint", "schwarz, 20 °C"),
        lambda text: text.rstrip("\n"),
    ],
    ids=["CRLF", "CR", "spaces", "blank lines", "comments", "upper", "lower", "wrapped", "BOM", "UTF-8", "no line end"],
)
def test_white_space_case_and_encoding_do_not_matter(tmp_path: Path, change: object) -> None:
    assert callable(change)
    table = read_zemax(good(tmp_path, change(GOOD)))
    assert table.values.tolist() == VALUES
    assert table.symmetry == "PlaneSymmetrical"


def test_comments_in_an_older_alphabet_are_read(tmp_path: Path) -> None:
    path = tmp_path / "old.bsdf"
    path.write_bytes(GOOD.replace("black paint", "20 °C").encode("latin-1"))
    assert read_zemax(path).comments[0] == "20 °C"


@pytest.mark.parametrize("spelling", ["ASymmetrical", "Asymmetrical"])
def test_both_spellings_of_asymmetrical_are_read(tmp_path: Path, spelling: str) -> None:
    assert read_zemax(good(tmp_path, GOOD.replace("PlaneSymmetrical", spelling))).symmetry == "Asymmetrical"


@pytest.mark.parametrize("word", ["ASymmetrical4D", "ASymmetrical 4D"])
def test_sample_rotations_are_the_first_dimension(tmp_path: Path, word: str) -> None:
    head, data = (
        GOOD.replace("PlaneSymmetrical", word).replace("SampleRotation\t1\n0", "SampleRotation 2\n0 90").split("DataBegin\n")
    )
    blocks = data.removesuffix("DataEnd\n")
    table = read_zemax(good(tmp_path, f"{head}DataBegin\n{blocks}{blocks.replace('0.3', '0.7')}DataEnd\n"))
    assert table.symmetry == "ASymmetrical4D"
    assert table.values.shape == (1, 2, 2, 2, 3)
    assert table.values[0, :, 0, 0, 0].tolist() == [0.3, 0.7]
    assert table.tis.shape == (1, 2, 2)


def rotated(rotations: str, count: int, word: str = "ASymmetrical4D") -> str:
    head, data = GOOD.replace("SampleRotation\t1\n0", f"SampleRotation {count}\n{rotations}").split("DataBegin\n")
    blocks = data.removesuffix("DataEnd\n")
    turned = "".join(blocks.replace("0.3", f"0.{3 + n}") for n in range(count))
    return f"{head.replace('PlaneSymmetrical', word)}DataBegin\n{turned}DataEnd\n"


def test_sample_rotations_are_psi_and_a_comment_states_it(tmp_path: Path) -> None:
    """As libbsdf takes them: inPhi is the sample rotation (ZemaxBsdfReader.cpp)."""
    table = read(good(tmp_path, rotated("0 90", 2))).only_table()
    assert table.psi_deg.tolist() == [0, 90]
    assert table.values[0, :, 0, 0, 0].tolist() == [0.3, 0.4]
    assert any("does not state which way the sample is turned" in line for line in table.comments)
    negative = read(good(tmp_path, rotated("-90 0 90", 3))).only_table()
    assert negative.psi_deg.tolist() == [0, 90, 270]
    assert negative.values[0, :, 0, 0, 0].tolist() == [0.4, 0.5, 0.3]
    round_turn = read(good(tmp_path, rotated("0 180 360", 3))).only_table()  # IMX455.bsdf of ua-loft/bsdf-tools
    assert round_turn.psi_deg.tolist() == [0, 180, 360]
    with pytest.raises(FormatError, match="two sample rotations are the same azimuth of the light; leave one"):
        read(good(tmp_path, rotated("-90 270", 2)))
    assert read(good(tmp_path, rotated("90", 1, "PlaneSymmetrical"))).only_table().psi_deg.tolist() == [0]
    assert read(good(tmp_path, rotated("90", 1))).only_table().psi_deg.tolist() == [90]


@pytest.mark.parametrize("word", ["NaN", "-nan(ind)", "1.#QNAN", "-1.#IND"])
def test_a_missing_value_is_spelled_as_programs_do(tmp_path: Path, word: str) -> None:
    table = read_zemax(good(tmp_path, GOOD.replace("0.25\t0.1\n", f"0.25\t{word}\n") + "\x1a"))  # with DOS's mark of the end
    assert table.known is not None
    assert np.count_nonzero(~table.known) == 1
    assert "'inf' is not finite" in refusal(good(tmp_path, GOOD.replace("0.25\t0.1\n", "0.25\tinf\n")))


@pytest.mark.parametrize("word", ["N/A", "nan"])
def test_a_share_that_was_not_computed_is_not_known(tmp_path: Path, word: str) -> None:
    table = read_zemax(good(tmp_path, GOOD.replace("TIS\t0.02", f"TIS\t{word}")))
    np.testing.assert_array_equal(table.tis, [[[np.nan, 0.03]]])
    assert table.values.tolist() == VALUES
    with pytest.raises(FormatError, match="of some blocks is not known; compute it"):
        write_zemax(tmp_path / "again.bsdf", table)


def test_the_share_of_an_ideal_diffuser_is_not_above_1(tmp_path: Path) -> None:
    sigma, phi, theta = np.array([0.0, 90.0]), np.array([0.0, 90.0, 180.0]), np.array([0.0, 60.0, 180.0])
    white = BsdfTable(sigma, phi, theta, np.full((1, 1, 2, 3, 3), 1.0 / np.pi))
    write(tmp_path / "white.bsdf", BsdfFile((white,)))
    assert read_zemax(tmp_path / "white.bsdf").tis.tolist() == [[[1.0, 1.0]]]


def test_nodes_without_a_value_are_held_and_marked(tmp_path: Path) -> None:
    """As below the horizon in data/processed/zemax/test.bsdf of https://github.com/ua-loft/bsdf-tools."""
    text = GOOD.replace("0.3\t0.25\t0.1", "0.3\tNaN\tNaN").replace("1.5e-3\t0.25\t-1e-6", "NaN\tnan\tNaN")
    table = read(good(tmp_path, text)).only_table()
    assert table.values[0, 0, :, 1].tolist() == [[0.3, 0.3, 0.3], [0.0, 0.0, 0.0]]
    assert table.known is not None
    assert table.known[0, 0, :, 1].tolist() == [[True, False, False], [False, False, False]]
    assert table.known.sum() == 7
    odd = text.replace("0.3\tNaN\tNaN", "0.3\tNaN\tNaN\tNaN")
    with pytest.raises(FormatError, match=r"line 20: .* has too many numbers: 7"):
        read(good(tmp_path, odd))


XYZ = GOOD.replace("SpectralContent\tMonochrome", "SpectralContent\tXYZ").replace("\nMonochrome\n", "\nTristimulusX\n")
DATA = GOOD[GOOD.index("DataBegin") :]


@pytest.mark.parametrize("between", ["DataEnd\n", ""])
def test_three_tristimulus_values_are_colours(tmp_path: Path, between: str) -> None:
    first = XYZ.removesuffix("DataEnd\n") + between
    second = DATA.replace("0.3\t", "0.6\t").removesuffix("DataEnd\n") + between
    third = DATA.replace("0.3\t", "0.9\t")
    if not between:
        second, third = second.removeprefix("DataBegin\n"), third.removeprefix("DataBegin\n")
    path = good(tmp_path, f"{first}TristimulusY\n{second}TristimulusZ\n{third}")
    content = read(path)
    table = content.only_table()
    assert table.colours == ("X", "Y", "Z")
    assert table.values[:, 0, 0, 0, 0].tolist() == [0.3, 0.6, 0.9]
    write(tmp_path / "again.bsdf", content)
    again = read(tmp_path / "again.bsdf").only_table()
    assert again.colours == table.colours
    np.testing.assert_allclose(again.values, table.values, rtol=5e-9)
    text = path.read_text()
    for old, new, message in (
        ("TristimulusZ", "TristimulusY", "expected TristimulusZ, found 'TristimulusY'"),
        (f"TristimulusZ\n{third}", "", "the file ends before"),
    ):
        assert message in refusal(good(tmp_path, text.replace(old, new)))


# libbsdf's ZemaxBsdfReader.cpp takes these words in exactly this spelling, and nothing else.
LIBBSDF_SYMMETRIES = ("PlaneSymmetrical", "Asymmetrical", "ASymmetrical4D")


@pytest.mark.parametrize(
    ("phi", "psi", "symmetry", "last"),
    [
        ([0, 90, 180], [0], "PlaneSymmetrical", 180),
        ([0, 90, 360], [0], "Asymmetrical", 360),
        ([0, 90, 270], [0], "Asymmetrical", 360),
        ([0, 90, 170], [0], "Asymmetrical", 360),
        ([0, 90, 360], [0, 45], "ASymmetrical4D", 360),
        ([0, 90, 180], [0, 45], "ASymmetrical4D", 360),
    ],
)
def test_a_table_is_written_in_words_that_a_public_reader_takes(
    tmp_path: Path, phi: list[float], psi: list[float], symmetry: str, last: float
) -> None:
    axes = np.array([0.0, 40]), np.array(phi, dtype=float), np.array([0.0, 10, 90])
    shape = (1, len(psi), 2, len(phi), 3)
    values = np.arange(np.prod(shape), dtype=float).reshape(shape)
    table = BsdfTable(*axes, values, (550.0,), psi_deg=np.array(psi), sample="paint 3", back=True, comments=("a note",))
    path = tmp_path / "a.bsdf"
    write(path, BsdfFile((table,)))
    words = dict(line.split("\t")[:2] for line in path.read_text().splitlines() if line[:1].isalpha() and "\t" in line)
    assert words["Symmetry"] == symmetry
    assert words["Symmetry"] in LIBBSDF_SYMMETRIES
    assert words["SampleRotation"] == str(len(psi))
    again = read(path).only_table()
    assert again.phi_deg[-1] == last
    np.testing.assert_allclose(again.values[..., : len(phi), :], values, rtol=5e-9)
    np.testing.assert_allclose(again.values[..., -1, :], values[..., -1 if last == phi[-1] else 0, :], rtol=5e-9)
    assert (again.sample, again.back, again.wavelengths_nm) == ("paint 3", True, (550.0,))
    assert "a note" in again.comments


def test_what_the_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    axes = np.array([0.0, 40]), np.array([0.0, 180]), np.array([0.0, 90])
    spectral = BsdfTable(*axes, np.zeros((2, 1, 2, 2, 2)), (450.0, 550.0))
    coloured = BsdfTable(*axes, np.zeros((3, 1, 2, 2, 2)), colours=("red", "green", "blue"))
    for parts, message in (
        ((spectral,), "it has 2 wavelengths, and a .bsdf has one"),
        ((coloured,), "it has the colours red, green, blue, and a .bsdf has XYZ"),
        ((spectral, spectral), "it has 2 parts"),
    ):
        with pytest.raises(FormatError, match=message):
            write(tmp_path / "a.bsdf", BsdfFile(parts))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("ScatterRadial\t3\n0\t10\t90\n", "", "ScatterRadial is missing"),
        ("Source\tMeasured\n", "", "Source is missing"),
        ("Source\tMeasured\n", "Source\n", "line 3: Source has no value"),
        (
            "ScatterRadial",
            "ScaterRadial",
            "line 13: 'ScaterRadial' is not a keyword of a .bsdf file; did you mean ScatterRadial?",
        ),
        ("AngleOfIncidence\t2", "AngleOfIncidence\t3", "line 9: AngleOfIncidence: the count is 3, but the list has 2 angles"),
        ("AngleOfIncidence\t2", "AngleOfIncidence\t1", "line 9: AngleOfIncidence: the count is 1, but the list is longer"),
        ("AngleOfIncidence\t2", "AngleOfIncidence\ttwo", "line 9: 'two' is not a possible number of AngleOfIncidence"),
        ("AngleOfIncidence\t2", "AngleOfIncidence\t0", "line 9: '0' is not a possible number"),
        ("10\t30", "30\t10", "line 10: AngleOfIncidence 10 follows 30: the list does not ascend"),
        ("10\t30", "10\t10", "line 10: AngleOfIncidence 10 follows 10: the list does not ascend"),
        ("10\t30", "10\t95", "line 10: AngleOfIncidence 95 is outside 0 to 90 deg"),
        ("0\t180", "0\t270", "PlaneSymmetrical has 0 to 180 only"),
        (
            "0.3\t0.25\t0.1",
            "0.3\t0.25",
            "line 20: BSDF at rotation 0, incidence 10 deg has too few numbers: 5, not 2 rows",
        ),
        (
            "0.3\t0.25\t0.1",
            "0.3\t0.25\t0.1\t0.1",
            "line 20: BSDF at rotation 0, incidence 10 deg has too many numbers: 7",
        ),
        (
            "0.3\t0.25\t0.1",
            "0.3\t0,25\t0.1",
            "line 20: BSDF at rotation 0, incidence 10 deg: '0,25' has a decimal comma",
        ),
        ("0.3\t0.25\t0.1", "0.3\t-inf\t0.1", "'-inf' is not finite"),
        ("0.3\t0.25\t0.1", "0.3\t1e999\t0.1", "'1e999' is larger than a 64-bit float"),
        ("0.3\t0.25\t0.1", "0.3\t1_0\t0.1", "'1_0' is not a number"),
        ("0.3\t0.25\t0.1", "0.3\t٣\t0.1", "is not a number"),
        ("TIS\t0.03", "", "line 22: BSDF at rotation 0, incidence 10 deg has too many numbers"),
        ("TIS\t0.03\n1.5e-3\t0.2\t0\n1.5e-3\t0.25\t-1e-6\n", "", "line 21: 1 blocks of data, but SampleRotation and"),
        ("DataEnd", "TIS 1\n1 1 1\n1 1 1\nDataEnd", "line 24: more blocks of data than the 2"),
        ("DataEnd\n", "", "line 23: the file ends before DataEnd"),
        ("DataEnd", "DataEnd\nDataBegin", "line 25: 'DataBegin' follows DataEnd"),
        ("Monochrome\nDataBegin", "TristimulusX\nDataBegin", "line 16: expected Monochrome, found 'TristimulusX'"),
        ("SpectralContent\tMonochrome", "SpectralContent\tXYZ", "line 16: expected TristimulusX, found 'Monochrome'"),
        ("Monochrome\nDataBegin", "DataBegin", "line 16: expected Monochrome, found 'DataBegin'"),
        ("PlaneSymmetrical", "Round", "line 4: Symmetry 'Round' is not known"),
        ("BRDF", "BSSRDF", "line 6: ScatterType 'BSSRDF' is not known; write BRDF or BTDF"),
        ("BRDF", "BRDF\nScatterType BRDF", "line 7: ScatterType is given twice"),
        ("# black", "\x00 black", "line 1: contains binary data"),
    ],
)
def test_a_broken_file_is_refused_with_its_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    assert message in refusal(good(tmp_path, GOOD.replace(old, new, 1)))


def test_a_missing_or_unreadable_file_is_refused(tmp_path: Path) -> None:
    assert "there is no such file" in refusal(tmp_path / "absent.bsdf")
    assert "is a folder" in refusal(tmp_path)
    assert "is empty" in refusal(good(tmp_path, " \n"))
    assert "missing" in refusal(good(tmp_path, "# a comment alone\n"))
    (tmp_path / "wide.bsdf").write_bytes(GOOD.encode("utf-16"))
    assert "UTF-16" in refusal(tmp_path / "wide.bsdf")
    with pytest.raises(FormatError, match="there is no such file"):
        read_zemax("a\0b.bsdf")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("zemax")


def read_or_refused(path: Path) -> None:
    try:
        table = read_zemax(path)
    except FormatError:
        refusal(path)
    else:
        assert np.isfinite(table.values).all()


@settings(deadline=None)
@given(content=st.one_of(st.binary(), st.text().map(lambda text: text.encode("utf-8", "surrogatepass"))))
def test_arbitrary_bytes_are_refused_and_raise_nothing_else(folder: Path, content: bytes) -> None:
    path = folder / "any.bsdf"
    path.write_bytes(content)
    with pytest.raises(FormatError):
        read_zemax(path)


@settings(deadline=None)
@given(data=st.data())
def test_a_mutated_file_is_a_valid_table_or_refused(folder: Path, data: st.DataObject) -> None:
    text = GOOD.encode()
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        end = data.draw(st.integers(start, min(len(text), start + 12)))
        words = st.sampled_from([b"", b" ", b"9", b"-", b".", b"e", b"1e400 ", b"nan ", b"TIS ", b"DataEnd\n", b"#"])
        text = text[:start] + data.draw(words | st.binary(max_size=4)) + text[end:]
    path = folder / "mutated.bsdf"
    path.write_bytes(text)
    read_or_refused(path)


@settings(deadline=None)
@given(data=st.data())
def test_a_file_with_words_exchanged_is_a_valid_table_or_refused(folder: Path, data: st.DataObject) -> None:
    words = GOOD.split()
    index = st.integers(0, len(words) - 1)
    for _ in range(data.draw(st.integers(1, 3))):
        words[data.draw(index)] = words[data.draw(index)]
    path = folder / "exchanged.bsdf"
    path.write_text("\n".join(words))
    read_or_refused(path)


def angle_lists(end: float) -> st.SearchStrategy[list[float]]:
    # In steps of 0.001 deg: far wider than the ninth digit, so no two angles become one.
    steps = st.sets(st.integers(0, round(end * 1000)), min_size=1, max_size=4)
    return steps.map(lambda numbers: [number / 1000 for number in sorted(numbers)])


@st.composite
def tables(draw: st.DrawFn) -> ZemaxBsdf:
    lists = [np.array(draw(angle_lists(end))) for end in (360, 90, 180, 180)]
    shape = (draw(st.sampled_from([1, 3])), *(angles.size for angles in lists))
    numbers = st.floats(-1e9, 1e9)
    return ZemaxBsdf(
        source=draw(st.sampled_from(["Measured", "Generated", "a b"])),
        symmetry=draw(st.sampled_from(LIBBSDF_SYMMETRIES)),
        scatter_type=draw(st.sampled_from(["BRDF", "BTDF"])),
        sample_rotation_deg=lists[0],
        incidence_deg=lists[1],
        azimuth_deg=lists[2],
        radial_deg=lists[3],
        values=draw(arrays(np.float64, shape, elements=numbers)),
        tis=draw(arrays(np.float64, shape[:3], elements=numbers)),
        comments=tuple(draw(st.lists(st.text(max_size=20), max_size=3))),
    )


@settings(deadline=None)
@given(table=tables())
def test_reading_returns_the_written_table_to_nine_digits(folder: Path, table: ZemaxBsdf) -> None:
    path = folder / "round.bsdf"
    write_zemax(path, table)
    again = read_zemax(path)
    assert (again.source, again.symmetry, again.scatter_type) == (table.source, table.symmetry, table.scatter_type)
    assert again.incidence_deg.tolist() == table.incidence_deg.tolist()
    assert again.radial_deg.tolist() == table.radial_deg.tolist()
    # Half a unit of the ninth digit is at most 5e-9 of the number.
    np.testing.assert_allclose(again.values, table.values, rtol=5e-9, atol=5e-324)
    np.testing.assert_allclose(again.tis, table.tis, rtol=5e-9, atol=5e-324)
    first = path.read_bytes()
    write_zemax(path, again)
    assert path.read_bytes() == first, "writing the table read gives the same bytes"
    assert first.isascii()


def test_an_inconsistent_table_is_refused(tmp_path: Path) -> None:
    table = read_zemax(good(tmp_path))
    with pytest.raises(ValueError, match="shape"):
        replace(table, values=np.zeros((1, 1, 2, 2, 4)))
    with pytest.raises(ValueError, match="not finite"):
        replace(table, values=np.full((1, 1, 2, 2, 3), np.nan))
    with pytest.raises(ValueError, match="ascend"):
        replace(table, radial_deg=np.array([0.0, 10, 10]))
    with pytest.raises(ValueError, match="symmetry"):
        replace(table, symmetry="Round")


def test_a_table_that_the_format_cannot_represent_is_not_written(tmp_path: Path) -> None:
    table = read_zemax(good(tmp_path))
    path = tmp_path / "out.bsdf"
    with pytest.raises(FormatError, match="two angles that are both written 10"):
        write_zemax(path, replace(table, incidence_deg=np.array([10, 10 + 1e-12])))
    with pytest.raises(FormatError, match="source"):
        write_zemax(path, replace(table, source="a\nb"))
    assert not path.exists()
