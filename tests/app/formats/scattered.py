"""Scattered values for the tests of formats that hold them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st

from goniotwin.app.formats import FormatError
from goniotwin.app.formats.content import ANGLES, BsdfFile, ScatteredBsdf
from goniotwin.arrays import Floats


def angles_deg(high: int) -> st.SearchStrategy[float]:
    """Angles with six decimals: those that agree to these are equal in this program."""
    return st.integers(0, high * 10**6).map(lambda each: each / 10**6)


@st.composite
def scattered(draw: st.DrawFn, lowest: float = -1e3, **stated: Any) -> ScatteredBsdf:
    """A value of each of a few wavelengths, or of none, at each of a few directions."""
    size = draw(st.integers(1, 6))
    wavelengths = draw(st.lists(st.integers(300, 2500), unique=True, max_size=3)) or [np.nan]
    columns = {
        name: np.tile(draw(st.lists(angles_deg(high), min_size=size, max_size=size)), len(wavelengths))
        for name, high in zip(ANGLES, (90, 359, 90, 359), strict=True)
    }
    number = st.floats(lowest, 1e6).map(lambda each: float(f"{each:.9g}"))
    values = draw(st.lists(number, min_size=size * len(wavelengths), max_size=size * len(wavelengths)))
    return ScatteredBsdf(**columns, values=np.array(values), wavelength_nm=np.repeat(wavelengths, size), **stated)


def rows(values: ScatteredBsdf, *names: str) -> Floats:
    """The values with their directions, in an order that does not depend on that of the file."""
    found = np.array([getattr(values, name) for name in (*ANGLES, "wavelength_nm", *names, "values")])
    return found[:, np.lexsort(np.nan_to_num(found))]


def only_list(content: BsdfFile) -> ScatteredBsdf:
    """The only part of a content."""
    (part,) = content.parts
    assert isinstance(part, ScatteredBsdf)
    return part


def refusal(read: Callable[[Path], object], path: Path, text: str | bytes | None = None) -> str:
    """The message about a file, without its name."""
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(FormatError) as caught:
        read(path)
    message = str(caught.value)
    assert message.isprintable(), "one line"
    assert message.startswith(str(path.parent))
    return message.replace(str(path), "")
