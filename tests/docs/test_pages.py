"""What particular pages state, beyond that their commands and snippets run: numbers, pictures, and that nothing is missing."""

import inspect
import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import goniotwin
from goniotwin.app.data.values import COLUMNS
from goniotwin.app.figures.style import SIMULATED
from tests.docs.reference import reference
from tests.docs.snippets import DOCS, blocks, run_page
from tests.docs.test_snippets import TUTORIAL
from tests.docs.words import prose
from tests.system.command import invoke

pytestmark = pytest.mark.xdist_group("pages")
PYTHON = DOCS / "analyse" / "python.md"
MOST_NAMES = 60
LEAVING = ("examples", "run", "export")
"""Commands of the tutorial whose files other pages begin with."""


@pytest.fixture
def folder(demo_run: tuple[Path, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with what demo and tutorial leave."""
    monkeypatch.chdir(tmp_path)
    for words in (words for block in blocks(TUTORIAL) for words in block.lines):
        if words[1] in LEAVING:
            assert invoke(*words[1:]).returncode == 0, words
    shutil.copytree(demo_run[0], tmp_path / "demo", ignore=shutil.ignore_patterns("wires", "lock", "result.json"))
    return tmp_path


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that `goniotwin.plot` draws."""
    drawn: list[Figure] = []
    plot = goniotwin.plot

    def kept(*given: Any, **named: Any) -> Figure:
        drawn.append(plot(*given, **named))
        return drawn[-1]

    monkeypatch.setattr(goniotwin, "plot", kept)
    return drawn


@pytest.mark.long
def test_each_figure_of_the_python_page_is_marked_as_simulated(folder: Path, figures: list[Figure]) -> None:
    run_page(PYTHON)
    assert len(figures) == 2
    for each in figures:  # on a figure of its own
        words = [*each.texts, *(text for axes in each.axes for text in axes.texts)]
        assert [text.get_text() for text in words].count(SIMULATED) == 1


def test_each_public_name_has_an_example_and_they_are_few() -> None:
    of_dataset = {name for name in dir(goniotwin.Dataset) if not name.startswith("_")} | {"name", "origin", "notes", "findings"}
    names = (of_dataset | set(dir(goniotwin)) - {"__version__"}) - set(reference().INNER)
    used = set(re.findall(r"\w+", "\n".join(block.text for block in blocks(PYTHON))))
    assert names <= used
    assert set(COLUMNS) <= names
    assert len(names) <= MOST_NAMES


def test_no_sentence_on_the_page_of_the_api_is_long() -> None:
    public = [getattr(goniotwin, name) for name in dir(goniotwin) if name != "__version__"]
    public += [value for each in public for name, value in vars(each).items() if not name.startswith("_")]
    for each in public:
        assert prose(inspect.getdoc(each) or "").long == [], each


@pytest.mark.long
def test_the_cycle_measures_a_measured_table_again_within_its_uncertainty(folder: Path) -> None:
    """docs/analyse/figures.md: measure, convert, rehearse with the table as a sample, compare."""
    outputs: list[str] = []
    run_page(DOCS / "analyse" / "figures.md", outputs)
    found = next(json.loads(each) for each in outputs if '"formula_5"' in each)
    assert [each["sigma_deg"] for each in found["lights"]] == [0.0, 30.0, 60.0]
    assert all(each["share_within_2_u"] == 1.0 for each in found["lights"])
    assert all(each["largest_abs_z"] < 1.0 for each in found["lights"])
    assert found["formula_5"]["percent"] < 1.0
    assert sum(each["directions"] for each in found["lights"]) >= 100
    assert (folder / "cycle.png").stat().st_size > 10_000
    assert (folder / "measured.html").exists()
