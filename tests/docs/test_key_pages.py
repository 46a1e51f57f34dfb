"""The pages of keys: each key has a meaning of its own in short sentences, and its value is shown in the forms that it has."""

import re
from collections import defaultdict
from typing import Any

import pytest

from goniotwin.app.toml_file import SENTENCE_END, json_schema
from tests.docs.reference import reference
from tests.docs.words import LONGEST, prose

KINDS = ["rig", "schedule", "tolerances"]
MOST_SHARED = 4
"""Keys of all files with a sentence that a key of another name has as well, such as tilts about x and about y may."""
GRID = "list of numbers (deg), of tables [`{ start, stop, step }`](#schedule-gridrange), or of both; or one such table"


def tables(kind: str) -> dict[str, Any]:
    """The tables of a file, with the file itself, by name."""
    schema = json_schema(reference().TABLES[kind](), kind)
    return {kind: schema, **schema["$defs"]}


def keys_of(table: Any) -> list[tuple[str, Any]]:
    return [*table["properties"].items()]


def sentences(described: Any) -> set[str]:
    return set(SENTENCE_END.split(described["description"]))


def rows(page: str, key: str) -> list[list[str]]:
    """The rows of a key in the tables of a page, as cells: key, value, default and meaning."""
    return [row.strip("| ").split(" | ") for row in page.splitlines() if row.startswith(f"| `{key}` |")]


def test_few_keys_share_a_sentence_with_another_key() -> None:
    shared = []
    for kind in KINDS:
        described = [(name, key, sentences(value)) for name, table in tables(kind).items() for key, value in keys_of(table)]
        users: dict[str, set[str]] = defaultdict(set)
        for _, key, found in described:
            for each in found:
                users[each].add(key)
        shared += [f"{name}.{key}" for name, key, found in described if any(len(users[each]) > 1 for each in found)]
    assert len(shared) <= MOST_SHARED, shared


@pytest.mark.parametrize("kind", KINDS)
def test_no_sentence_about_a_key_or_a_table_is_long(kind: str) -> None:
    for name, table in tables(kind).items():
        for described in (table, *table["properties"].values()):
            assert prose(described["description"]).long == [], (name, LONGEST)


@pytest.mark.parametrize("key", ["sigma_deg", "gamma_deg", "beta_deg", "shift_deg"])
def test_a_grid_is_a_list_of_numbers_or_of_ranges_or_one_range(key: str) -> None:
    values = {value for _, value, *_ in rows(reference().keys("schedule"), key)}
    assert GRID in values
    assert values <= {GRID, "number, deg"}  # the pose of the drift checks


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [
        ("rig", "axes", 'table with [`kind = "tmcl"`](#rig-tmclaxestable) or [no `kind`](#rig-axestable)'),
        ("rig", "gamma", 'table with [no `kind`](#rig-axissettings) or [`kind = "tmcl"`](#rig-tmclaxistable)'),
        ("rig", "reflectance", "number or list of numbers"),
        ("rig", "rays", "whole number ≥ 16 and ≤ 1048576"),
        ("rig", "deviations", "tables [`[twin.deviations.NAME]`](#rig-deviation), by name"),
        ("schedule", "diattenuation", "numbers ≥ 0 and ≤ 1, by name"),
        ("schedule", "open_beam", "true or false or table [`[open_beam]`](#schedule-openbeamtable)"),
        ("schedule", "gains_v_per_a", '`"automatic"` or list of numbers > 0, V/A'),
        ("tolerances", "variants", "list of tables [`[[variants]]`](#tolerances-varianttable)"),
    ],
)
def test_a_value_is_shown_in_all_its_forms(kind: str, key: str, value: str) -> None:
    assert value in [each for _, each, *_ in rows(reference().keys(kind), key)]


@pytest.mark.parametrize("kind", KINDS)
def test_no_link_stands_for_two_tables_and_each_leads_somewhere(kind: str) -> None:
    page = reference().keys(kind)
    anchors = set(re.findall(r"^\((.*)\)=$", page, re.MULTILINE))
    for row in page.splitlines():
        links = re.findall(r"\[([^]]*`[^`]*`)\]\(#([\w-]+)\)", row)
        assert len({text for text, _ in links}) == len(set(links)), row
        assert {address for _, address in links} <= anchors, row


def test_a_section_names_its_table_and_the_key_that_decides_for_it() -> None:
    titles = re.findall(r"^## (.*)$", reference().keys("rig"), re.MULTILINE)
    assert {"`[simulated]`", "`[axes]`", '`[axes]` with `kind = "tmcl"`', "`[photodiodes]`", "`[twin.controller]`"} <= {*titles}
    assert '`[twin.samples.NAME]` with `model = "table"`' in titles
    assert len(set(titles)) == len(titles)
