"""The Cornerstone's statements."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols import cornerstone as cs

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
