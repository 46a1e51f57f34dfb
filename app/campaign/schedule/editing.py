"""A TOML text edited value by value: what is not edited keeps every byte, comments, blank lines and the order of keys included.

A key is given by its path, such as `("target", "relative_u")`. Values are those that `parse_toml` gives, or items of tomlkit,
which keep the text of their numbers. Every edit is read back, so that a text that cannot be edited here is refused.
"""

import copy
import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from difflib import SequenceMatcher
from typing import Any

import tomlkit
from tomlkit.container import Container, OutOfOrderTableProxy
from tomlkit.exceptions import NonExistentKey
from tomlkit.items import Array, InlineTable, Item

from goniotwin.app.errors import UserError
from goniotwin.app.toml_file import parse_toml

Path = tuple[str, ...]
MARK = "\0"
"""A character that no TOML text has."""
LONG_EXPONENT, EXACT_DIGITS = 5, 15
"""Powers of ten from which on a number is written with an exponent: where this is shorter, and always."""


def set_value(text: str, path: Path, value: object, name: str) -> str:
    """The text with a value at a path; a missing table is added at the end.

    The text of the file `name` stays as it is where it has that value. Raises UserError for a text that is not TOML, with the
    line, and for one in which the value has to be set by hand.
    """
    content = parse_toml(text, name)
    expected = copy.deepcopy(content)
    table: Any = expected
    for part in path[:-1]:
        table = table.setdefault(part, {}) if isinstance(table, dict) else None
    if not isinstance(table, dict):
        raise UserError(f"{name}: {'.'.join(path[:-1])}: is no table, so that it has no key {path[-1]}; correct the text")
    plain = _unwrapped(value)
    if path[-1] in table and _same(table[path[-1]], plain):
        return text
    table[path[-1]] = plain
    document = tomlkit.parse(text)
    holder, old = _find(document, path[:-1]), _find(document, path)
    if old is None and isinstance(holder, InlineTable):
        return set_value(text, path[:-1], {**holder, path[-1]: value}, name)
    if old is not None:
        _keys(holder)[path[-1]] = _merged(old, value)
        edited = document.as_string()
    else:
        edited = _with_line(text, document, path, f"{tomlkit.key(path[-1]).as_string()} = {literal(value)}\n")
    return _read_back(edited, expected, path, name)


def remove_value(text: str, path: Path, name: str) -> str:
    """The text without the key at a path, and without a table that then has no key. Comments in lines of their own stay.

    Raises as `set_value`.
    """
    expected = parse_toml(text, name)
    tables: list[Any] = [expected]
    for part in path:
        if not isinstance(tables[-1], dict) or part not in tables[-1]:
            return text
        tables.append(tables[-1][part])
    item = _find(tomlkit.parse(text), path)
    if isinstance(tables[-1], dict) and not isinstance(item, InlineTable):
        for key in tables[-1]:
            text = remove_value(text, (*path, key), name)
        return text if tables[-1] else _read_back(_without_line(text, path), _without(expected, path), path, name)
    while len(path) > 1 and len(tables[len(path) - 1]) == 1:  # what would be left empty is removed with its key
        text = _without_line(text, path)
        path = path[:-1]
    holder = _find(tomlkit.parse(text), path[:-1])
    if isinstance(holder, InlineTable):
        return set_value(text, path[:-1], {key: each for key, each in holder.items() if key != path[-1]}, name)
    return _read_back(_without_line(text, path), _without(expected, path), path, name)


def key_span(text: str, path: Path) -> tuple[int, int] | None:
    """Where the lines of a key, or the line of a table's heading, begin and end in a TOML text; None if there are none."""
    document = tomlkit.parse(text)
    item = _find(document, path)
    if not isinstance(item, Item):
        return None
    trail = item.trivia.trail
    item.trivia.indent, item.trivia.trail = MARK + item.trivia.indent, MARK + trail
    marks = [each.start() for each in re.finditer(MARK, document.as_string())]
    return (marks[0], marks[1] - 1 + len(trail)) if len(marks) == 2 else None


def literal(value: object, like: str = "") -> str:
    """A value as TOML. A number has the form of the number `like`, if given; an item of tomlkit has its own text."""
    if isinstance(value, Item):
        return value.as_string()
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return _number_text(value, like)
    if isinstance(value, str):
        return tomlkit.string(value).as_string()
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{tomlkit.key(key).as_string()} = {literal(each)}' for key, each in value.items())} }}"
    if isinstance(value, Sequence):
        return f"[{', '.join(literal(each, like) for each in value)}]"
    return str(value)  # a date


def _number_text(value: int | float, like: str) -> str:
    """A number as short as it can be written, with an exponent or decimals where `like` has them."""
    number = Decimal(repr(value)).normalize()
    plain = format(number, "f")
    with_exponent = f"{format(number.scaleb(-number.adjusted()), 'f')}e{number.adjusted()}"
    size = abs(number.adjusted()) if isinstance(value, float) else 0
    shorter = size >= LONG_EXPONENT and len(with_exponent) < len(plain)
    if "e" in like.lower() or shorter or size >= EXACT_DIGITS:
        return with_exponent
    return f"{plain}.0" if "." in like and "." not in plain else plain


def _merged(old: Item, value: object) -> Item:
    """The item `old` with a new value, element by element; or a new one, of the form of the old one."""
    if _same(_unwrapped(old), _unwrapped(value)):
        return old
    if isinstance(old, InlineTable) and isinstance(value, Mapping):
        merged = {key: _merged(_keys(old).item(key), each) if key in old else each for key, each in value.items()}
        if [*old] != [*value]:
            return _literal_item(merged)
        for key, each in merged.items():
            old[key] = each
        return old
    if isinstance(old, Array) and isinstance(value, Sequence) and not isinstance(value, str) and old:
        return _merged_array(old, value)
    return _literal_item(value, old.as_string() if isinstance(_unwrapped(old), int | float) else "")


def _merged_array(old: Array, value: Sequence[object]) -> Item:
    before, after = ([repr(_comparable(_unwrapped(each))) for each in elements] for elements in (old, value))
    in_lines, kept = "\n" in old.as_string(), [*old]
    like = literal(kept[0]) if isinstance(_unwrapped(kept[0]), int | float) else ""
    for tag, first, last, start, stop in reversed(SequenceMatcher(None, before, after, autojunk=False).get_opcodes()):
        if tag == "equal":
            continue
        both = min(last - first, stop - start)
        new = [_literal_item(each, like) for each in value[start:stop]]
        for k in range(both):
            if isinstance(kept[first + k], Item):
                new[k] = _merged(kept[first + k], value[start + k])
            old[first + k] = new[k]
        kept[first:last] = new
        if in_lines:  # with the comments of the lines that stay
            del old[first + both : last]
            for k in range(both, stop - start):
                old.insert(first + k, new[k])
    return old if in_lines or len(before) == len(after) else _literal_item(kept)


def _literal_item(value: object, like: str = "") -> Item:
    return tomlkit.value(literal(value, like))


def _find(document: Container, path: Path) -> Any:
    """The item at a path, the document itself for none; None where there is no such key."""
    here: Any = document
    for part in path:
        try:
            here = here[part] if isinstance(here, OutOfOrderTableProxy) else _keys(here).item(part)
        except (NonExistentKey, AttributeError):
            return None
    return here


def _keys(holder: Any) -> Any:
    """The keys of a document, a table, an inline table, or a table whose parts are not together."""
    return holder if isinstance(holder, Container | OutOfOrderTableProxy) else holder.value


def _with_line(text: str, document: Container, path: Path, line: str) -> str:
    """The text with a line after the last key of its table, or in a new table at the end."""
    holder, span = _find(document, path[:-1]), key_span(text, path[:-1])
    if len(path) > 1 and span is None:
        ended = text if not text or text.endswith("\n") else f"{text}\n"
        heading = ".".join(tomlkit.key(part).as_string() for part in path[:-1])
        return f"{ended}{'' if not text or ended.endswith(chr(10) * 2) else chr(10)}[{heading}]\n{line}"
    at = 0 if span is None else span[1]
    for key in _keys(holder):
        inner = (*path[:-1], key)
        if not _is_heading(_find(document, inner)) and (found := key_span(text, inner)) is not None:
            at = max(at, found[1])
    before = text[:at] if not at or text[at - 1] == "\n" else f"{text[:at]}\n"
    return f"{before}{line}{text[at:]}"


def _is_heading(item: object) -> bool:
    return isinstance(_unwrapped(item), dict) and not isinstance(item, InlineTable)


def _without_line(text: str, path: Path) -> str:
    span = key_span(text, path)
    return text if span is None else text[: span[0]] + text[span[1] :]


def _without(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """The content without the key at a path, and without tables that are empty then."""
    inner = content[path[0]]
    left = _without(inner, path[1:]) if len(path) > 1 else {}
    return {key: left if key == path[0] else each for key, each in content.items() if key != path[0] or left}


def _read_back(text: str, expected: dict[str, Any], path: Path, name: str) -> str:
    """The text, if it has the content that is expected. Raises UserError if not."""
    try:
        if _same(parse_toml(text, name), expected):
            return text
    except UserError:
        pass  # the text before the edit was TOML
    raise UserError(f"{name}: {'.'.join(path)}: cannot be edited by the program as it is written there; edit the text")


def _unwrapped(value: Any) -> Any:
    if isinstance(value, Item | Container):
        return value.unwrap()
    if isinstance(value, Mapping):
        return {key: _unwrapped(each) for key, each in value.items()}
    return [_unwrapped(each) for each in value] if isinstance(value, list | tuple) else value


def _comparable(value: Any) -> Any:
    """The value, equal for equal numbers of any type, except that a truth value is no number."""
    if isinstance(value, dict):
        return {key: _comparable(each) for key, each in sorted(value.items())}
    if isinstance(value, list):
        return [_comparable(each) for each in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _same(one: Any, other: Any) -> bool:
    return repr(_comparable(one)) == repr(_comparable(other))
