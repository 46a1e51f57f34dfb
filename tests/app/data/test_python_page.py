"""docs/analyse/python.md: its examples run and give what the page states; each name of the public API has one."""

import doctest
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import goniotwin
from goniotwin.app.data.values import COLUMNS
from goniotwin.app.figures.style import SIMULATED
from tests.conftest import REPOSITORY

PAGE = REPOSITORY / "docs" / "analyse" / "python.md"
MOST_NAMES = 60
INNER = {"data", "only", "reduced", "whole", "file"}
"""Attributes of a dataset that other parts of the program use, and a page of the API's does not."""


def names() -> set[str]:
    """The public names: of the package, of a dataset and of the results."""
    of_dataset = {name for name in dir(goniotwin.Dataset) if not name.startswith("_")} | {"name", "origin", "notes", "findings"}
    return (of_dataset | set(dir(goniotwin)) - {"__version__"}) - INNER


def test_the_examples_give_what_the_page_states(journal: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(journal, tmp_path / "my.journal")
    monkeypatch.chdir(tmp_path)
    drawn: list[Figure] = []
    plot = goniotwin.plot

    def kept(*given: Any, **named: Any) -> Figure:
        drawn.append(plot(*given, **named))
        return drawn[-1]

    monkeypatch.setattr(goniotwin, "plot", kept)
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert tried > 30
    assert failed == 0
    assert len(drawn) == 2
    for each in drawn:  # on a figure of its own
        words = [*each.texts, *(text for axes in each.axes for text in axes.texts)]
        assert [text.get_text() for text in words].count(SIMULATED) == 1


def test_each_name_has_an_example_and_they_are_few() -> None:
    examples = "\n".join(line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("    "))
    used = set(re.findall(r"\w+", examples))
    assert names() <= used
    assert set(COLUMNS) <= names()
    assert len(names()) <= MOST_NAMES
