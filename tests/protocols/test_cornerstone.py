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
    # MCS260 p. 58: "00 indicates no error, 20 indicates error condition"; of the 260B p. 62: "set to the value 32".
    assert (cs.encode_status(cs.NO_ERROR), cs.encode_status(cs.ERROR_SINCE_LAST_READ)) == ("00", "20")
    assert cs.encode_status(cs.ERROR_SINCE_LAST_READ, decimal=True) == "32"


@pytest.mark.parametrize("line", [b"gowave   546.07 \r\n", b"GOWAVE 546.07", b"  GoWave 546.07\n"])
def test_case_and_blanks_do_not_matter(line: bytes) -> None:
    assert cs.Statement.decode(line) == cs.Statement("GOWAVE", parameter="546.07")


@given(WORD, st.booleans(), PARAMETER)
def test_a_statement_survives_the_wire(word: str, query: bool, parameter: str) -> None:
    statement = cs.Statement(word, query, parameter)
    assert cs.Statement.decode(statement.encode()) == statement


@pytest.mark.parametrize("status", [cs.NO_ERROR, cs.ERROR_SINCE_LAST_READ])
@pytest.mark.parametrize("digits", [1, 2])
@pytest.mark.parametrize("decimal", [False, True])
def test_a_status_survives_the_wire(status: int, digits: int, decimal: bool) -> None:
    assert cs.decode_status(cs.encode_status(status, digits, decimal=decimal).encode() + cs.FROM_DEVICE) == status


def test_an_echo_and_an_empty_reply_are_lines() -> None:
    assert cs.take_lines(b"", b"WAVE?\n500\r\nERROR?\r\n\r\n0") == ([b"WAVE?", b"500", b"ERROR?", b""], b"0")
    assert cs.take_lines(*cs.take_lines(b"", b"00\r")[1:], b"\n20\r\n") == ([b"20"], b"")


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
    for decode in (cs.Grating.decode, cs.decode_status):
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
