"""SCPI headers and answers."""

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.protocols import scpi

RANGE = "[SENSe]:CURRent[:DC]:RANGe[:UPPer]"


@pytest.mark.parametrize(
    "spelling",
    ["SENS:CURR:RANG", "sense:current:dc:range:upper", "CURR:RANG", ":Sense:Current:Range", "CURRent:DC:RANGe"],
)
def test_every_legal_spelling_is_known(spelling: str) -> None:
    (unit,) = scpi.parse(spelling.encode() + b" 1\n")
    assert unit.header in scpi.spellings(RANGE)
    assert unit.parameters == ("1",)


@pytest.mark.parametrize("spelling", ["SENS:CURRE:RANG", "SEN:CURR:RANG", "CURR:DC", "RANG"])
def test_an_illegal_spelling_is_not(spelling: str) -> None:
    (unit,) = scpi.parse(spelling.encode())
    assert unit.header not in scpi.spellings(RANGE)


def test_semicolons_join_on_the_same_level_and_colons_return_to_the_root() -> None:
    units = scpi.parse(b"SENS:CURR:RANG 1E-6;RANG:AUTO 0;:READ?;*CLS\n")
    assert [unit.header for unit in units] == [
        ("SENS", "CURR", "RANG"),
        ("SENS", "CURR", "RANG", "AUTO"),
        ("READ",),
        ("*CLS",),
    ]
    assert [unit.query for unit in units] == [False, False, True, False]


@given(st.binary(max_size=200))
def test_any_bytes_parse_or_are_a_scpi_error(data: bytes) -> None:
    with contextlib.suppress(scpi.ScpiError):
        scpi.parse(data)
    with contextlib.suppress(scpi.ScpiError):
        scpi.decode_number(data)
    with contextlib.suppress(scpi.ScpiError):
        scpi.decode_error(data)


@given(st.floats(-1e30, 1e30))
def test_a_number_survives_to_nine_digits(value: float) -> None:
    assert scpi.decode_number(scpi.encode_number(value)) == pytest.approx(value, rel=1e-8, abs=1e-300)


@given(st.integers(-999, 999), st.text(st.characters(min_codepoint=32, max_codepoint=126, exclude_characters='"')))
def test_an_error_survives_the_wire(code: int, text: str) -> None:
    assert scpi.decode_error(scpi.encode_error(code, text)) == (code, text)


@pytest.mark.parametrize("value", [9.9e37, 9.91e37, -9.9e37, math.inf, math.nan])
def test_overrange_is_no_number(value: float) -> None:
    assert scpi.overloaded(value)


def test_no_error_looks_as_published() -> None:
    assert scpi.encode_error(0, "No error") == b'+0,"No error"'


@pytest.mark.parametrize(
    ("text", "value"), [("50 uA", 50e-6), ("50E-6", 50e-6), ("5MA", 5e-3), ("-1.5e2 na", -1.5e-7), ("1 E 3", 1e3)]
)
def test_numbers_take_suffixes(text: str, value: float) -> None:
    assert scpi.decode_quantity(text, scpi.suffixes("A")) == pytest.approx(value)


@pytest.mark.parametrize(("text", "code"), [("x", -104), ("5 V", -131), ("", -104), ("1_0", -131)])
def test_other_numbers_are_errors(text: str, code: int) -> None:
    with pytest.raises(scpi.ScpiError) as caught:
        scpi.decode_quantity(text, scpi.suffixes("A"))
    assert caught.value.code == code


def test_separators_within_a_string_separate_nothing() -> None:
    (first, second) = scpi.parse(b"DISP:TEXT 'a;b,c', \"d\";*CLS")
    assert first.parameters == ("'a;b,c'", '"d"')
    assert second.header == ("*CLS",)


@pytest.mark.parametrize("answer", [b"nan", b"inf", b"1_0", b"0x1", b"1,2", b""])
def test_what_python_takes_for_a_number_and_scpi_does_not_is_none(answer: bytes) -> None:
    with pytest.raises(scpi.ScpiError):
        scpi.decode_number(answer)
