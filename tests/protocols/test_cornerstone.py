"""The Cornerstone's statements."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.protocols import cornerstone as cs

WORD = st.from_regex(r"[A-Z][A-Z0-9]{0,10}", fullmatch=True)
PARAMETER = st.from_regex(r"([A-Z0-9.]+( [A-Z0-9.]+)?)?", fullmatch=True)


def test_statements_are_the_manuals_lines() -> None:
    assert cs.Statement("GOWAVE", parameter="546.070").encode() == b"GOWAVE 546.070\n"
    assert cs.Statement("WAVE", query=True).encode() == b"WAVE?\n"
    assert cs.encode_status(cs.ERROR_SINCE_LAST_READ) == b"20\r\n"


@pytest.mark.parametrize("line", [b"gowave   546.07 \r\n", b"GOWAVE 546.07", b"  GoWave 546.07\n"])
def test_case_and_blanks_do_not_matter(line: bytes) -> None:
    assert cs.Statement.decode(line) == cs.Statement("GOWAVE", parameter="546.07")


@given(WORD, st.booleans(), PARAMETER)
def test_a_statement_survives_the_wire(word: str, query: bool, parameter: str) -> None:
    statement = cs.Statement(word, query, parameter)
    assert cs.Statement.decode(statement.encode()) == statement


@given(st.integers(0, 255))
def test_a_status_survives_the_wire(status: int) -> None:
    assert cs.decode_status(cs.encode_status(status)) == status


@given(st.binary(max_size=40))
def test_other_bytes_are_statement_errors(data: bytes) -> None:
    for decode in (cs.Statement.decode, cs.decode_status, cs.decode_number):
        with contextlib.suppress(cs.StatementError):
            decode(data)


@given(st.floats(0.0, 2000.0))
def test_a_wavelength_is_exact_to_its_three_decimals(wavelength_nm: float) -> None:
    assert cs.decode_number(cs.encode_nm(wavelength_nm).encode()) == pytest.approx(wavelength_nm, abs=5.1e-4)


@given(st.lists(st.binary(max_size=30), max_size=20))
def test_lines_are_the_same_however_the_bytes_are_split(pieces: list[bytes]) -> None:
    pending, lines = b"", []
    for piece in pieces:
        found, pending = cs.take_lines(pending, piece)
        lines += found
    assert (lines, pending) == cs.take_lines(b"", b"".join(pieces))


def test_an_endless_line_is_cut_and_is_no_statement() -> None:
    pending = b""
    for _ in range(100):
        lines, pending = cs.take_lines(pending, b"A" * 1000)
        assert lines == []
        assert len(pending) <= cs.MAX_LINE + 1
    (line,), _ = cs.take_lines(pending, b"\n")
    with pytest.raises(cs.StatementError, match="more than 256"):
        cs.Statement.decode(line)


@given(st.binary(max_size=40))
def test_other_bytes_are_neither_gratings_nor_known_statuses(data: bytes) -> None:
    for decode in (cs.Grating.decode, cs.decode_known_status):
        with contextlib.suppress(cs.StatementError):
            decode(data)


@pytest.mark.parametrize("line", [b"nan", b"inf", b"1_0", b"1e999", b"", b"0x10", b"5 5"])
def test_number_formats_of_python_that_the_unit_never_sends_are_none(line: bytes) -> None:
    with pytest.raises(cs.StatementError):
        cs.decode_number(line)


def test_a_grating_survives_the_wire_and_units_agree() -> None:
    assert cs.Grating.decode(b"1,1200,VIS") == cs.Grating(1, 1200, "VIS")
    assert cs.Grating.decode(cs.Grating(2, 600, "").encode().encode()) == cs.Grating(2, 600, "")
    assert (cs.WavelengthUnit.UM.encode(546.07), cs.WavelengthUnit.WN.encode(500.0), cs.WavelengthUnit.NM.encode(546.07)) == (
        "0.546070",
        "20000.00",
        "546.070",
    )
    assert cs.WavelengthUnit.WN.to_nm(20000.0) == pytest.approx(500.0)
