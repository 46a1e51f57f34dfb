"""Schedules edited value by value: only what is edited changes."""

import copy
import re
import tomllib
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin import examples
from goniotwin.app.campaign.schedule.editing import Path, key_span, literal, remove_value, set_value
from goniotwin.app.errors import UserError

TEXTS = {path.name: path.read_text(encoding="utf-8") for path in sorted((examples.FOLDER / "schedules").glob("*.toml"))}
NUMBERS = st.one_of(
    st.integers(-1000, 1000),
    st.floats(1e-20, 1e20),
    st.integers(-9, 11).map(lambda exponent: float(f"1e{exponent}")),
    st.integers(-500, 500).map(lambda half: half / 2),
)
WORDS = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1, max_size=8)
RANGES = st.fixed_dictionaries({"start": NUMBERS, "stop": NUMBERS, "step": NUMBERS})
VALUES = st.one_of(
    NUMBERS, WORDS, st.booleans(), RANGES, st.lists(st.one_of(NUMBERS, RANGES), max_size=5), st.lists(WORDS, max_size=3)
)
NEW_PATHS = (("target", "longest_h"), ("overlap", "points"), ("gamma_deg",), ("metadata", "samples", "gaussian-5", "maker"))


def leaves(content: dict[str, Any], path: Path = ()) -> list[Path]:
    """The paths of all values, those of inline tables and the inline tables included."""
    found = []
    for key, value in content.items():
        if not isinstance(value, dict) or set(value) <= {"start", "stop", "step"}:
            found.append((*path, key))
        if isinstance(value, dict):
            found += leaves(value, (*path, key))
    return found


def changed(content: dict[str, Any], path: Path, value: Any) -> dict[str, Any]:
    """The content with a value, or without the key for None and then without empty tables, made independently."""
    result = copy.deepcopy(content)
    tables = [result]
    for part in path[:-1]:
        tables.append(tables[-1].setdefault(part, {}))
    if value is not None:
        tables[-1][path[-1]] = value
        return result
    tables[-1].pop(path[-1], None)
    for part, outer, inner in reversed([*zip(path[:-1], tables[:-1], tables[1:], strict=True)]):
        if not inner:
            outer.pop(part)
    return result


def comment_lines(text: str) -> list[str]:
    return [line for line in text.split("\n") if line.lstrip().startswith("#")]


def is_part(lines: list[str], of: list[str]) -> bool:
    """Whether lines are in other lines, in their order."""
    rest = iter(of)
    return all(line in rest for line in lines)


@settings(max_examples=200)
@given(data=st.data())
def test_two_hundred_random_edits_change_the_edited_values_alone(data: st.DataObject) -> None:
    text = TEXTS[data.draw(st.sampled_from(sorted(TEXTS)))]
    content = tomllib.loads(text)
    path = data.draw(st.sampled_from([*leaves(content), *NEW_PATHS]))
    value = data.draw(st.one_of(VALUES, st.none()))
    edited = remove_value(text, path, "x") if value is None else set_value(text, path, value, "x")
    expected = changed(content, path, value)
    assert tomllib.loads(edited) == expected
    assert comment_lines(edited) == comment_lines(text)
    before, after = text.split("\n"), edited.split("\n")
    booleans = [[repr(each).count(word) for word in ("True", "False")] for each in (content, expected)]
    if content == expected and booleans[0] == booleans[1]:  # for Python 1 is True
        assert edited == text
    elif len(before) == len(after):  # one line has another value, and its comment still
        ((old, new),) = [pair for pair in zip(before, after, strict=True) if pair[0] != pair[1]]
        assert old.partition("=")[0] == new.partition("=")[0]
        assert old.partition("#")[1:] == new.partition("#")[1:] or "#" in str(value)
    elif value is None:
        assert is_part(after, before)
        assert len(before) - len(after) <= 2  # with the heading
    else:
        assert is_part(before, after)
        assert len(after) - len(before) in (1, 2, 3)  # the line, a heading, a blank line


@given(name=st.sampled_from(sorted(TEXTS)))
def test_a_value_that_is_there_already_changes_no_byte(name: str) -> None:
    content = tomllib.loads(TEXTS[name])
    for path in leaves(content):
        value: Any = content
        for part in path:
            value = value[part]
        assert set_value(TEXTS[name], path, value, name) == TEXTS[name]
    assert set_value(TEXTS[name], ("gains_v_per_a",), content["gains_v_per_a"], name) == TEXTS[name]


@pytest.mark.parametrize(
    ("line", "value", "expected"),
    [
        ("a = 1e10", 1e10, "a = 1e10"),
        ("a = 1e10", 10_000_000_000, "a = 1e10"),
        ("a = 1e10", 1e11, "a = 1e11"),
        ("a = 1e10  # gain", 2.5e11, "a = 2.5e11  # gain"),
        ("a = 550", 600.0, "a = 600"),
        ("a = 550.0", 600, "a = 600.0"),
        ("a = 0.5", 1.0, "a = 1.0"),
        ("a = 5", 1e11, "a = 1e11"),
        ("a = 5", 1e-7, "a = 1e-7"),
        ("a = 5", 123456.5, "a = 123456.5"),
        ("a = 1", True, "a = true"),
        ("a = [1e8, 1e10]", [1e8, 1e10, 1e11], "a = [1e8, 1e10, 1e11]"),
        ("a = [1e8, 1e10]", [1e6, 1e8, 1e10], "a = [1e6, 1e8, 1e10]"),
        ("a = [1e8, 1e10]", [1e10], "a = [1e10]"),
        ("a = [0.0, 30.0]", [0, 45], "a = [0.0, 45.0]"),
        ("a = { start = 0, stop = 4.5, step = 0.5 }", {"start": 0, "stop": 5, "step": 0.5}, None),
        ("a = { start = 0, stop = 9, step = 3 }", [1, 2], "a = [1, 2]"),
        ('a = "x"', 'y "z"', r'a = "y \"z\""'),
    ],
)
def test_a_number_is_written_in_the_manner_of_the_one_that_it_replaces(line: str, value: object, expected: str | None) -> None:
    expected = expected or "a = { start = 0, stop = 5.0, step = 0.5 }"
    assert set_value(f"{line}\n", ("a",), value, "x") == f"{expected}\n"


def test_a_list_of_several_lines_keeps_the_comments_of_its_lines() -> None:
    text = "a = [\n    1,  # one\n    2,  # two\n    # the last\n]\nb = 1\n"
    assert set_value(text, ("a",), [1, 3], "x") == text.replace("2,", "3,")
    longer = set_value(text, ("a",), [1, 2, 3], "x")
    assert tomllib.loads(longer) == {"a": [1, 2, 3], "b": 1}
    assert [re.findall("#.*", each) for each in (text, longer)] == [["# one", "# two", "# the last"]] * 2


def test_a_key_comes_behind_the_last_of_its_table_and_a_table_at_the_end() -> None:
    text = "a = 1 # one\n\n# about b\n[b]\nc = 2"
    assert set_value(text, ("d",), 3, "x") == "a = 1 # one\nd = 3\n\n# about b\n[b]\nc = 2"
    assert set_value(text, ("b", "d"), 3, "x") == f"{text}\nd = 3\n"
    assert set_value(text, ("e", "f g"), 3, "x") == f'{text}\n\n[e]\n"f g" = 3\n'
    assert remove_value(text, ("b", "c"), "x") == "a = 1 # one\n\n# about b\n"
    assert remove_value(text, ("b",), "x") == "a = 1 # one\n\n# about b\n"
    assert remove_value(text, ("e", "f"), "x") == text
    assert set_value("", ("e", "f"), 3, "x") == "[e]\nf = 3\n"
    assert set_value("e = { f = 1 }", ("e", "g"), 3, "x") == "e = { f = 1, g = 3 }"
    assert remove_value("e = { f = 1, g = 3 }", ("e", "f"), "x") == "e = { g = 3 }"
    assert set_value("e.f = 1\ne.g = 2\n", ("e", "g"), 3, "x") == "e.f = 1\ne.g = 3\n"


def test_what_is_no_toml_has_its_line_and_what_cannot_be_edited_is_refused() -> None:
    with pytest.raises(UserError, match=r"x: is not TOML: .*line 2.*; correct that line"):
        set_value("a = 1\nb = = 2\n", ("a",), 2, "x")
    with pytest.raises(UserError, match=r"x: a: is no table, so that it has no key b"):
        set_value("a = 1\n", ("a", "b"), 2, "x")
    with pytest.raises(UserError, match=r"x: e\.h: cannot be edited by the program"):
        set_value("e.f = 1\ne.g = 2\n", ("e", "h"), 3, "x")


def test_the_span_of_a_key_is_its_lines() -> None:
    text = "a = 1\nb = [\n 2\n]  # two\n\n[c] # c\nd = 4"
    spans = {path: key_span(text, path) for path in (("a",), ("b",), ("c",), ("c", "d"), ("e",))}
    texts = {path[-1]: None if span is None else text[slice(*span)] for path, span in spans.items()}
    assert texts == {"a": "a = 1\n", "b": "b = [\n 2\n]  # two\n", "c": "[c] # c\n", "d": "d = 4", "e": None}


def test_a_value_as_toml_is_read_as_that_value() -> None:
    value = {"a b": [1, 2.5, 1e11, True], "c": {"d": "e\\\n"}}
    assert tomllib.loads(f"x = {literal(value)}") == {"x": value}
