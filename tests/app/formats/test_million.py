"""A million values of each format, written and read in a process of its own, as `python -m benchmarks.formats` measures it."""

import pytest

from tests.app.formats.million import FORMATS, VALUES, measure_apart

MOST_MB = 1000.0


@pytest.mark.long
@pytest.mark.parametrize("name", FORMATS)
def test_a_million_values_take_less_than_a_gigabyte(name: str) -> None:
    found = measure_apart(name, VALUES)
    assert found["values"] > 0.99 * VALUES
    assert found["peak_mb"] < MOST_MB
