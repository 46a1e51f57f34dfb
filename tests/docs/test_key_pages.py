"""The pages of keys: a value is shown in all the forms that it has."""

import importlib.util
import re
from types import ModuleType

import pytest

from tests.docs.snippets import DOCS

KINDS = ["rig", "schedule", "tolerances"]
GRID = "list of numbers (deg), of tables [`{ start, stop, step }`](#schedule-gridrange), or of both; or one such table"


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    """The extension of the site that makes these pages."""
    spec = importlib.util.spec_from_file_location("reference", DOCS / "extensions" / "reference.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def rows(page: str, key: str) -> list[list[str]]:
    """The rows of a key in the tables of a page, as cells: key, value, default and meaning."""
    return [row.strip("| ").split(" | ") for row in page.splitlines() if row.startswith(f"| `{key}` |")]


@pytest.mark.parametrize("key", ["sigma_deg", "gamma_deg", "beta_deg", "shift_deg"])
def test_a_grid_is_a_list_of_numbers_or_of_ranges_or_one_range(key: str, reference: ModuleType) -> None:
    values = {value for _, value, *_ in rows(reference.keys("schedule"), key)}
    assert GRID in values
    assert values <= {GRID, "number, deg"}  # the pose of the drift checks


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        ("rig", "axes", 'table with [`kind = "tmcl"`](#rig-tmclaxestable) or [no `kind`](#rig-axestable)'),
        ("rig", "gamma", 'table with [no `kind`](#rig-axissettings) or [`kind = "tmcl"`](#rig-tmclaxistable)'),
        ("rig", "reflectance", "number or list of numbers"),
        ("rig", "deviations", "tables [`[twin.deviations.NAME]`](#rig-deviation), by name"),
        ("schedule", "diattenuation", "numbers ≥ 0 and ≤ 1, by name"),
        ("schedule", "open_beam", "true or false or table [`[open_beam]`](#schedule-openbeamtable)"),
        ("schedule", "gains_v_per_a", '`"automatic"` or list of numbers > 0, V/A'),
        ("tolerances", "variants", "list of tables [`[[variants]]`](#tolerances-varianttable)"),
    ],
)
def test_a_value_is_shown_in_all_its_forms(kind: str, key: str, value: str, reference: ModuleType) -> None:
    assert value in [each for _, each, *_ in rows(reference.keys(kind), key)]


@pytest.mark.parametrize("kind", KINDS)
def test_no_link_stands_for_two_tables_and_each_leads_somewhere(kind: str, reference: ModuleType) -> None:
    page = reference.keys(kind)
    anchors = set(re.findall(r"^\((.*)\)=$", page, re.MULTILINE))
    for row in page.splitlines():
        links = re.findall(r"\[([^]]*`[^`]*`)\]\(#([\w-]+)\)", row)
        assert len({text for text, _ in links}) == len(set(links)), row
        assert {address for _, address in links} <= anchors, row
