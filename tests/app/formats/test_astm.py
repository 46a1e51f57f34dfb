"""Lists in the style of ASTM E1392: what an independent reader finds in ours, and what ours finds in others."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.formats import BsdfTable, FormatError, astm
from goniotwin.app.formats.content import BsdfFile, RegularTable, ScatteredBsdf
from goniotwin.app.formats.metadata import Metadata
from goniotwin.arrays import Floats

from .scattered import only_list, refusal, rows, scattered

# Two lines of Cornell's layout, with the line ends and blanks that files have.
CORNELL = """Measured at Cornell\r
Sample: blue paint\r
NUM_POINTS 2\r
VARS theta_i,phi_i,theta_s,phi_s,R,G,B\r
0.523599,0.000000,0.523599,3.141593,0.1,0.2,0.3\r
0.523599, 0.000000, 1.047198, -1.570796, 1e-3, -2e-3, 0\r
"""


def as_libbsdf_reads(path: Path) -> tuple[list[str], Floats]:
    """The names and the numbers, read in the steps of libbsdf (src/Reader/AstmReader.cpp, commit 232971f).

    It takes words up to VARS, wherever they are, then the rest of that line between commas, then lines of numbers.
    """
    text = path.read_bytes().decode("ascii")
    at = 0
    while (word := text[at:].split(maxsplit=1)[0]) != "VARS":
        at = text.index(word, at) + len(word)
    names, _, data = text[text.index("VARS", at) + 5 :].partition("\n")
    return names.rstrip("\r").split(","), np.array(
        [[float(each) for each in line.split(",")] for line in data.splitlines() if line]
    )


def test_cornells_layout_is_read_with_its_colours_and_signs(tmp_path: Path) -> None:
    path = tmp_path / "paint.astm"
    path.write_text(CORNELL, newline="")
    assert astm.recognise(CORNELL.encode())
    found = only_list(astm.read(path))
    assert found.sample == "blue paint"
    assert found.sigma_deg.tolist() == [30.0] * 6
    assert found.polar_deg.tolist() == [30.0, 60.0] * 3
    assert found.azimuth_deg.tolist() == [180.0, 270.0] * 3
    assert found.channel.tolist() == ["red"] * 2 + ["green"] * 2 + ["blue"] * 2
    assert found.values.tolist() == [0.1, 1e-3, 0.2, -2e-3, 0.3, 0.0]
    assert "Measured at Cornell" in found.comments
    assert any("does not state" in line for line in found.comments)
    assert found.isotropic


@pytest.mark.parametrize("ends", ["\n", "\r", "\r\n"])
def test_line_ends_and_separators_may_differ(tmp_path: Path, ends: str) -> None:
    path = tmp_path / "a.astm"
    text = "num_points: 1\n vars theta_i, phi_i, theta_s, phi_s, 550 nm\n\n0.1\t0 0.2  0 7\n\n"
    path.write_bytes(text.replace("\n", ends).encode())
    assert astm.recognise(path.read_bytes())
    found = only_list(astm.read(path))
    assert (found.values.tolist(), found.wavelength_nm.tolist()) == ([7.0], [550.0])


def test_colours_may_be_named_in_full(tmp_path: Path) -> None:
    path = tmp_path / "paint.astm"
    path.write_text(CORNELL.replace("R,G,B", "Red,Green,Blue"))
    assert only_list(astm.read(path)).channel.tolist() == ["red"] * 2 + ["green"] * 2 + ["blue"] * 2


def test_an_independent_reader_finds_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a.astm"
    values = ScatteredBsdf(
        np.array([30.0, 60.0] * 2),
        np.zeros(4),
        np.array([30.0, 5.0] * 2),
        np.array([180.0, 90.0] * 2),
        np.array([0.1, 0.2, 0.3, 0.4]),
        wavelength_nm=np.array([550.0, 550.0, 450.5, 450.5]),
        comments=("the words VARS and NUM_POINTS 3 are no trap", "n = 1.5 \u00b0"),
    )
    astm.write(path, BsdfFile((values,), Metadata(operator="A. Person")))
    names, found = as_libbsdf_reads(path)
    assert names == ["theta_i", "phi_i", "theta_s", "phi_s", "450.5nm", "550nm"]
    sixth = math.pi / 6
    expected = [[sixth, 0, sixth, math.pi, 0.3, 0.1], [2 * sixth, 0, math.pi / 36, math.pi / 2, 0.4, 0.2]]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert "operator: A. Person" in path.read_text()


@given(values=scattered(), transmitted=st.booleans(), back=st.booleans(), generated=st.booleans())
@settings(deadline=None)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, values: Any, transmitted: bool, back: bool, generated: bool
) -> None:
    path = tmp_path_factory.mktemp("astm") / "a.astm"
    flags = np.full(values.size, True)
    values = replace(
        values,
        transmitted=flags & transmitted,
        back=flags & back,
        generated=generated,
        sample="paper 3",
        isotropic=False,
        comments=("one", "two: 2"),
    )
    astm.write(path, BsdfFile((values,)))
    again = only_list(astm.read(path))
    np.testing.assert_array_equal(rows(again, "transmitted", "back"), rows(values, "transmitted", "back"))
    assert (again.sample, again.isotropic, again.generated) == ("paper 3", False, generated)
    assert {"one", "two: 2"} <= set(again.comments)


def test_a_table_is_written_as_its_nodes(tmp_path: Path) -> None:
    table = BsdfTable(
        np.array([0.0, 60.0]), np.array([0.0, 180.0]), np.array([0.0, 40.0]), np.arange(8.0).reshape(1, 1, 2, 2, 2)
    )
    astm.write(tmp_path / "a.astm", BsdfFile((table,)))
    again = only_list(astm.read(tmp_path / "a.astm"))
    assert again.size == 7, "the node beyond the horizon (sigma 60, theta 40, phi 180) is not there"


def test_a_table_has_each_direction_once_and_no_polar_angle_above_a_right_one(tmp_path: Path) -> None:
    """A strict reader refuses 1.570796327, which is above pi / 2, and libbsdf leaves out what is "Already defined"."""
    sigma, phi, theta, psi = (
        np.array(each) for each in ([0.0, 90.0], [0.0, 90.0, 360.0], [0.0, 30.0, 180.0], [0.0, 90.0, 360.0])
    )
    values = np.full((2, 3, 2, 3, 3), 0.3)
    values[1, 0, 0, 1, 0] = 0.4  # another value at theta 0: both are there
    table = BsdfTable(sigma, phi, theta, values, (450.0, 550.0), psi, known=np.full(values.shape, True))
    path = tmp_path / "a.astm"
    astm.write(path, BsdfFile((table,)))
    found = as_libbsdf_reads(path)[1]
    assert found[:, [0, 2]].max() <= math.pi / 2
    directions, counts = np.unique(found[:, :4].astype(np.float32), axis=0, return_counts=True)
    assert directions[counts > 1].tolist() == [[0.0, 0.0, 0.0, 0.0]]
    assert counts.max() == 2
    np.testing.assert_array_equal(np.unique(only_list(astm.read(path)).sigma_deg), sigma)


def test_a_direction_that_was_measured_twice_is_written_twice(tmp_path: Path) -> None:
    twice = ScatteredBsdf(np.zeros(3), np.zeros(3), np.array([5.0, 5.0, 1.0]), np.zeros(3), np.array([1.0, 2.0, np.nan]))
    astm.write(tmp_path / "a.astm", BsdfFile((twice,)))
    again = only_list(astm.read(tmp_path / "a.astm"))
    assert again.values.tolist() == [1.0, 2.0]
    assert "1 directions without a value are not written" in again.comments


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"wavelength_nm": np.array([1.0, 2.0, 2.0])}, "a value of each wavelength at each direction"),
        ({"wavelength_nm": np.array([np.nan, 2.0, 2.0])}, "no room for 2nm, BSDF together"),
        ({"channel": np.array(["X", "Y", ""])}, "no room for the colours '', 'X', 'Y'"),
        ({"transmitted": np.array([True, True, False])}, "there are both"),
        ({"values": np.full(3, np.nan)}, "no value to write"),
    ],
)
def test_what_a_list_cannot_hold_is_refused(tmp_path: Path, change: dict[str, Any], wanted: str) -> None:
    values = ScatteredBsdf(np.zeros(3), np.zeros(3), np.arange(3.0), np.zeros(3), np.arange(3.0))
    with pytest.raises(FormatError, match=wanted):
        astm.write(tmp_path / "a.astm", BsdfFile((replace(values, **change),)))
    assert not (tmp_path / "a.astm").exists()


def test_several_samples_and_regular_factors_are_refused(tmp_path: Path) -> None:
    values = ScatteredBsdf(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros(1), np.ones(1))
    with pytest.raises(FormatError, match="holds one sample, and there are 2; choose one of '', 'b'"):
        astm.write(tmp_path / "a.astm", BsdfFile((values, replace(values, sample="b"))))
    with pytest.raises(FormatError, match="no regular reflectance"):
        astm.write(tmp_path / "a.astm", BsdfFile((RegularTable(np.zeros(1), np.ones((1, 1, 1))),)))


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        ("0.1,0.2,0.3", "0.1,0.2", "line 5: 6 numbers in a line of 7"),
        ("0.1,0.2,0.3", "0.1,,0.3", "line 5: 6 numbers in a line of 7"),
        ("0.1,0.2,0.3", "0.1,0.x,0.3", "line 5: '0.x' is not a number"),
        ("0.1,0.2,0.3", "nan,0,0.3", "line 5: 'nan' is not finite"),
        ("NUM_POINTS 2", "NUM_POINTS 3", "NUM_POINTS is 3, but 2 lines"),
        ("NUM_POINTS 2", "NUM_POINTS many", "line 3: NUM_POINTS 'many' is not a count"),
        ("1.047198", "60", "line 6: theta_s 3437.75 deg is outside -180 to 180 deg; write radians"),
        ("VARS theta_i,phi_i", "VARS phi_i,theta_i", "line 4: VARS begins with"),
        ("R,G,B", "a,b,c", "are not known"),
        ("R,G,B", "500nm,500nm,600nm", "one twice"),
        ("VARS", "COLUMNS", "no line of VARS"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, old: str, new: str, wanted: str) -> None:
    assert wanted in refusal(astm.read, tmp_path / "a.astm", CORNELL.replace(old, new, 1))


def test_light_beyond_the_horizon_and_a_btdf_are_transmitted(tmp_path: Path) -> None:
    path = tmp_path / "a.astm"
    path.write_text("NUM_POINTS 1\nVARS theta_i,phi_i,theta_s,phi_s,BTDF\n0.1,0,2.617993878,0,1\n")
    found = only_list(astm.read(path))
    assert (found.polar_deg.tolist(), found.transmitted.tolist()) == ([30.0], [True])
    path.write_text("a BTDF\nNUM_POINTS 1\nVARS theta_i,phi_i,theta_s,phi_s,value\n0.1,0,0.523598776,0,1\n")
    found = only_list(astm.read(path))
    assert (found.polar_deg.tolist(), found.transmitted.tolist()) == ([30.0], [True])
