"""Tables for property tests of the text formats."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from goniotwin.app.formats import BsdfTable
from goniotwin.app.formats.content import RegularTable
from goniotwin.app.formats.coverage import INTERPOLATED
from goniotwin.app.formats.numerals import NUMBER
from goniotwin.arrays import Floats

COLOURS = {"rgb": ("red", "green", "blue"), "xyz": ("X", "Y", "Z")}
# Keywords among the words of comments, and other alphabets.
COMMENTS = st.lists(
    st.text(max_size=12) | st.sampled_from(["wl 450", "def", "# phi 2", ";; DATA_TYPE btdf", "TIS 1", "sigma 30 \u00b0"]),
    max_size=3,
)


def angles(end: float, most: int = 4) -> st.SearchStrategy[Floats]:
    """Lists in steps of 0.001 deg: far wider than the ninth digit, so no two angles become one."""
    steps = st.sets(st.integers(0, round(end * 1000)), min_size=1, max_size=most)
    return steps.map(lambda numbers: np.array(sorted(numbers)) / 1000.0)


@st.composite
def channels(draw: st.DrawFn, colours: tuple[str, ...]) -> tuple[tuple[float, ...] | None, tuple[str, ...], int]:
    """Wavelengths, colours and their count."""
    kind = draw(st.sampled_from(["grey", "spectral", *colours]))
    if kind in COLOURS:
        return None, COLOURS[kind], 3
    if kind == "grey":
        return None, (), 1
    numbers = draw(st.sets(st.integers(200_000, 2_500_000), min_size=1, max_size=3))
    return tuple(sorted(number / 1000.0 for number in numbers)), (), len(numbers)


@st.composite
def bsdf_tables(draw: st.DrawFn, *colours: str, transmitted: bool | None = None) -> BsdfTable:
    """Any table of phi 0 to 180 or 0 to 360."""
    wavelengths, names, count = draw(channels(colours))
    end = draw(st.sampled_from([180.0, 360.0]))
    inner = draw(angles(end))
    phi = np.unique(np.concatenate([[0.0], inner, [end]]))
    if end == 360.0 and phi.size == 2:
        phi = np.array([0.0, 180.5, 360.0])
    sigma, theta = draw(angles(90.0)), draw(angles(180.0))
    psi = draw(st.just(np.zeros(1)) | angles(360.0) | st.sampled_from([np.array([0.0, 120, 240]), np.array([0.0, 90])]))
    shape = count, psi.size, sigma.size, phi.size, theta.size
    numbers = st.floats(-1e6, 1e6).map(lambda number: 0.0 if abs(number) < 1e-30 else number)
    return BsdfTable(
        sigma,
        phi,
        theta,
        draw(arrays(np.float64, shape, elements=numbers)),
        wavelengths,
        psi,
        transmitted=draw(st.booleans()) if transmitted is None else transmitted,
        generated=draw(st.booleans()),
        comments=tuple(draw(COMMENTS)),
        colours=names,
        back=draw(st.booleans()),
        sample=draw(st.sampled_from(["", "paint 3"])),
    )


@st.composite
def regular_tables(draw: st.DrawFn, *colours: str, isotropic: bool, transmitted: bool = False) -> RegularTable:
    """Any table of regular factors."""
    wavelengths, names, count = draw(channels(colours))
    sigma, psi = draw(angles(90.0)), np.zeros(1) if isotropic else draw(angles(360.0))
    values = draw(arrays(np.float64, (count, psi.size, sigma.size), elements=st.integers(0, 10**9).map(lambda n: n / 1e9)))
    return RegularTable(
        sigma,
        values,
        wavelengths,
        names,
        psi,
        transmitted,
        back=draw(st.booleans()),
        generated=draw(st.booleans()),
        sample=draw(st.sampled_from(["", "paint 3"])),
        comments=tuple(draw(COMMENTS)),
    )


def check_same_text(again: str, first: str, largest: float) -> None:
    """Check that a file which was read is written alike: but for the last digit where an azimuth has values between others.

    They are interpolated from values that are rounded in the file; `largest` is the largest of all.
    """
    if INTERPOLATED.search(first) is None:
        assert again == first, "writing what was read gives the same file"
        return
    words, numbers = _words(first)
    words_again, numbers_again = _words(again)
    assert words_again == words
    np.testing.assert_allclose(numbers_again, numbers, rtol=1e-8, atol=1e-8 * largest)


def _words(text: str) -> tuple[list[str], list[float]]:
    """The words of a text that are no numbers, and the numbers."""
    numbers = [word for word in text.split() if NUMBER.fullmatch(word)]
    return [word for word in text.split() if not NUMBER.fullmatch(word)], [float(each) for each in numbers]
