"""TOML files: reading, validation against the tables of the program, error messages of one line, and JSON Schema.

A table is a frozen dataclass, often the one that the code uses for the thing itself, or a `TomlTable`. Pydantic reads either as
JSON in its strict mode: unknown keys are refused, a number between quotation marks is text, and an array becomes a tuple.
"""

import difflib
import inspect
import json
import math
import re
import secrets
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import is_dataclass
from datetime import date, datetime
from functools import cache
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

from pydantic import BaseModel, BeforeValidator, ConfigDict, TypeAdapter, ValidationError
from pydantic.json_schema import GenerateJsonSchema

from goniotwin.app.errors import UserError

TABLE = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)
"""Of the dataclass of a whole file, too: the dataclasses in it inherit this."""
KEY_FIRST = re.compile(r"([a-z]\w*(?:\.\w+)*): ")
"""The key that the message of a rule between several keys begins with."""
SENTENCE_END = re.compile(r"(?<=\.)\s+(?=[^a-z])")
FIRST_KEYS = re.compile(r"`\w+`(?:(?:, and |, | and | or )`\w+`)*(:\s+)?")
"""The keys that a sentence begins with, and the colon after which it says what they are."""
FIRST_TABLE = re.compile(r"`\[+[\w.]+\]+`:\s+")
EXCEPTIONS = re.compile(r"\s*Raises ValueError.*?\.(?=\s|$)", re.DOTALL)
MOST_BYTES = 1_000_000
"""A list of a hundred thousand numbers fits in."""
MOST_LEVELS = 10
"""Twice as many levels of tables and lists as a rig file has."""
LONGEST_WORD = 200
"""Characters of a number, or of a key without quotes."""
SMALLEST, LARGEST = 1e-24, 1e24
"""Magnitudes of numbers other than 0. Currents of 1e-15 A and gains of 1e12 V/A are far within."""
TOKEN = re.compile(
    r'''(?P<text>"""(?:\\.|[^\\])*?(?:"{3,5}|\\?\Z)|"(?:\\.|[^"\\\n])*"?|'{3}.*?(?:'{3,5}|\Z)|'[^'\n]*'?)'''
    r"|(?P<comment>#[^\n]*)|(?P<opening>[\[{])|(?P<closing>[\]}])|(?P<dot>\.)|(?P<end>[\n=,])|(?P<word>[\w+-]+)",
    re.DOTALL,
)
"""The parts of a TOML text; a text without its end reaches to the end of the file, so that no character is read twice."""
TYPES = {
    "dataclass_type": "table",
    "model_type": "table",
    "dict_type": "table",
    "tuple_type": "list",
    "list_type": "list",
    "union_tag_not_found": "table",
}
DATE = secrets.token_hex()
"""Key of the JSON object that a date becomes, so that text is no date, and a date no text: one that no file has."""


def _read_day(value: Any) -> Any:
    """The day of a date. Raises ValueError for one in quotation marks, and for a date with a time."""
    if isinstance(value, str):
        raise ValueError(f"should be a date, not text: {value} without the quotes")
    try:
        return date.fromisoformat(value[DATE]) if isinstance(value, dict) and DATE in value else value
    except ValueError:
        raise ValueError(f"should be a date without a time, not {value[DATE]}") from None


def _read_moment(value: Any) -> Any:
    """A time of the calendar as text, ISO 8601, of a date-time or a text. Raises ValueError for one without its zone."""
    text = value[DATE] if isinstance(value, dict) and DATE in value else value
    try:
        if text and isinstance(text, str) and datetime.fromisoformat(text).tzinfo is None:
            raise ValueError
    except ValueError:
        raise ValueError(f"should be a time with its offset from UTC, such as 2026-01-31T14:05:00+01:00, not {text}") from None
    return text


Day = Annotated[date, BeforeValidator(_read_day)]
Moment = Annotated[str, BeforeValidator(_read_moment)]
"""A time, to the second or finer, ISO 8601 with the offset from UTC; empty where none is stated."""


class TomlTable(BaseModel):
    """A table of a file: unknown keys and numbers that are not finite are refused; the fields are frozen."""

    model_config = TABLE


Model = TypeVar("Model")


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """The text of a TOML file and its content. Raises UserError."""
    text = read_text(path, MOST_BYTES)
    return text, parse_toml(text, str(path))


def read_text(path: Path, most_bytes: int) -> str:
    """The text of a file in UTF-8, with or without a byte order mark, and at most so long. Raises UserError."""
    try:
        if path.exists() and not path.is_file():  # a pipe blocks, and a device such as /dev/zero has no end
            raise UserError(f"{path}: is a folder or a device, not a file; check the name")
        with path.open("rb") as file:
            content = file.read(most_bytes + 1)
    except (OSError, ValueError) as error:  # ValueError: a name with a null character
        reason = error.strerror if isinstance(error, OSError) else error
        raise UserError(f"{path}: cannot be read: {reason}; check the name") from None
    if len(content) > most_bytes:
        raise UserError(f"{path}: has more than {most_bytes} bytes, too many for such a file; check the name")
    try:
        text = content.decode("utf-8-sig")  # some editors write a byte order mark
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not a text file in UTF-8; check the name, or save it as UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """The content of a TOML text. Raises UserError with the line of a syntax error, and for what no rig or schedule needs."""
    _refuse_extremes(text, name)
    try:
        return tomllib.loads(text)
    except ValueError as error:  # also an impossible date
        raise UserError(f"{name}: is not TOML: {error}; correct that line") from None


def _refuse_extremes(text: str, name: str) -> None:
    """Raise UserError for a text on which a TOML parser takes gigabytes, minutes, or all of the stack."""
    if len(text) > MOST_BYTES:
        raise UserError(f"{name}: has more than {MOST_BYTES} characters, too many for such a file; make it shorter")
    depth = levels = 0
    for token in TOKEN.finditer(text):
        kind, length = token.lastgroup, token.end() - token.start()
        depth = max(0, depth + (kind == "opening") - (kind == "closing"))
        levels = levels + 1 if kind == "dot" else 0 if kind in ("opening", "closing", "end") else levels
        if depth > MOST_LEVELS or levels > MOST_LEVELS or (kind == "word" and length > LONGEST_WORD):
            wrong = (
                f"a word of {length} characters" if kind == "word" else f"more than {MOST_LEVELS} levels of tables and lists"
            )
            line = text.count("\n", 0, token.start()) + 1
            raise UserError(f"{name}: {wrong} (at line {line}), more than such a file needs; correct that line")


def _refuse_magnitudes(value: Any, name: str, place: tuple[str, ...] = ()) -> None:
    """Raise UserError for a number that no quantity has: products of such numbers are infinite, or zero."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            _refuse_magnitudes(inner, name, (*place, str(key)))
    elif isinstance(value, int | float) and value and not SMALLEST <= abs(value) <= LARGEST and math.isfinite(value):
        wrong = f"{value:g} is not from {SMALLEST:g} to {LARGEST:g}, as the quantities of an instrument are"
        raise UserError(f"{name}: {'.'.join(place)}: {wrong}; correct it")


def validate_table(table: type[Model], content: dict[str, Any], name: str) -> Model:
    """The content as a table. Raises UserError with the file, the key, the reason, and the number of further errors."""
    _refuse_magnitudes(content, name)
    try:
        return cast(Model, _reader(table).validate_json(json.dumps(content, default=lambda each: {DATE: each.isoformat()})))
    except ValidationError as error:
        # A mistyped key is reported as unknown and as missing; the unknown one has the text that was typed.
        errors = sorted(error.errors(include_url=False), key=lambda detail: not _is_unknown(detail))
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        known = _known_keys(cast(Any, table))
        place, reason = _place(content, errors[0]), _reason(known, errors[0])
        if (key := KEY_FIRST.match(reason)) and key[1].partition(".")[0] in known:
            place, reason = [*place, key[1]], reason[key.end() :]
        raise UserError(f"{name}: {'.'.join(place) or 'the file'}: {reason}{more}") from None


def json_schema(table: Any, title: str) -> dict[str, Any]:
    """JSON Schema (2020-12) of a file, with the docstrings of the tables as descriptions of tables and keys.

    `key_sentences` gives each its own. A key without any, whose value is a table, has the first sentence of that table.
    """
    schema = _reader(table).json_schema(schema_generator=_FileSchema)
    tables = (schema, *schema["$defs"].values())
    texts = [each["description"] for each in tables]
    for each, text in zip(tables, texts, strict=True):
        each["description"] = _about_table(text, [*each["properties"]])
    for each, text in zip(tables, texts, strict=True):
        own = key_sentences(text, [*each["properties"]])
        for key, value in each["properties"].items():
            if about := own[key] or _first_sentences(value, schema["$defs"]):
                value["description"] = " ".join(about)
    return {"$schema": _FileSchema.schema_dialect, **schema, "title": title}


def key_sentences(text: str, keys: Sequence[str]) -> dict[str, list[str]]:
    """The sentences of a table's docstring by key, and those of the table itself under "".

    A sentence that begins with keys is theirs, and so are the sentences after it, up to the next one that begins with keys or
    to the end of the paragraph. Key or table before a colon, as in "`speed_deg_s`: the greatest speed", are left out. A key
    that begins no sentence has those of the table that name it.
    """
    found: dict[str, list[str]] = {"": [], **{key: [] for key in keys}}
    for _, named, meaning in _attributed(text, keys):
        for key in named:
            found[key] += [] if meaning in found[key] else [meaning]
    for key in keys:
        found[key] = found[key] or [each for each in found[""] if f"`{key}`" in each]
    return found


def _attributed(text: str, keys: Sequence[str]) -> Iterator[tuple[int, Sequence[str], str]]:
    """Each sentence of a docstring: the number of its paragraph, its keys ("" for those of the table), and what it says."""
    for number, paragraph in enumerate(re.split(r"\n\s*\n", text.strip())):
        named = [""]
        for sentence in SENTENCE_END.split(" ".join(paragraph.split())):
            meaning = _capitalized(sentence[title.end() :]) if (title := FIRST_TABLE.match(sentence)) else sentence
            if (first := FIRST_KEYS.match(sentence)) and (known := set(re.findall(r"\w+", first[0])) & set(keys)):
                named = [key for key in keys if key in known]
                meaning = _capitalized(sentence[first.end() :]) if first[1] else meaning
            if meaning:
                yield number, named, meaning


def _about_table(text: str, keys: Sequence[str]) -> str:
    """The sentences of a docstring that are those of the table, each once, in its paragraphs; all of them if there are none."""
    paragraphs: dict[int, list[str]] = {}
    for number, named, meaning in _attributed(text, keys):
        if named == [""] and not any(meaning in each for each in paragraphs.values()):
            paragraphs.setdefault(number, []).append(meaning)
    return "\n\n".join(" ".join(each) for each in paragraphs.values()) or " ".join(text.split())


def _capitalized(text: str) -> str:
    return text[:1].upper() + text[1:]


def _first_sentences(value: Any, tables: Any) -> list[str]:
    """The first sentences of the tables that a key can be, each once; none for a key that is no table."""
    inner = value.get("items") or value.get("additionalProperties") or value
    names = [each["$ref"].rpartition("/")[2] for each in inner.get("oneOf", [inner]) if "$ref" in each]
    return [*dict.fromkeys(SENTENCE_END.split(tables[name]["description"])[0] for name in names)]


class _FileSchema(GenerateJsonSchema):
    """JSON Schema for TOML, which has no null; without fields that are no keys.

    A table that extends another has the descriptions of both, without the exceptions of Python.
    """

    def field_is_present(self, field: Any) -> bool:
        return bool(field.get("init", True))

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002
        return False

    def nullable_schema(self, schema: Any) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: Any) -> dict[str, Any]:
        found = super().default_schema(schema)
        return {key: value for key, value in found.items() if (key, value) != ("default", None)}

    def encode_default(self, dft: Any) -> Any:
        return super().encode_default(float(dft) if isinstance(dft, float) else dft)  # an uncertainty may have an origin

    def get_defs_ref(self, core_mode_ref: Any) -> Any:
        name, mode = core_mode_ref
        return super().get_defs_ref((name.partition("[")[0], mode))  # of a table, without the kinds that can be in it

    def dataclass_schema(self, schema: Any) -> dict[str, Any]:
        return {**super().dataclass_schema(schema), "description": _documented(schema["cls"], is_dataclass)}

    def model_schema(self, schema: Any) -> dict[str, Any]:
        described = _documented(schema["cls"], lambda each: each is not TomlTable and issubclass(each, TomlTable))
        return {**super().model_schema(schema), "description": described}


def _documented(table: type, is_table: Callable[[type], bool]) -> str:
    """The docstrings of a table and of those that it extends, as paragraphs, without the exceptions of Python."""
    documented = dict.fromkeys(inspect.getdoc(each) or "" for each in table.__mro__ if is_table(each))
    return EXCEPTIONS.sub("", "\n\n".join(documented))


_reader: Callable[[Any], TypeAdapter[Any]] = cache(TypeAdapter)


def _place(content: dict[str, Any], detail: Any) -> list[str]:
    """The path of keys to an error, without pydantic's names of the members of a union, which are not keys of the file."""
    here: Any = content
    place = []
    for depth, part in enumerate(detail["loc"], 1):
        try:
            here = here[part]
        except (KeyError, IndexError, TypeError):
            if detail["type"] != "missing" or depth < len(detail["loc"]):
                continue
        place.append(str(part))
    return place


def _is_unknown(detail: Any) -> bool:
    return detail["type"] in ("extra_forbidden", "unexpected_keyword_argument")


def _reason(known: list[str], detail: Any) -> str:
    if _is_unknown(detail):
        key = str(detail["loc"][-1])
        if key == DATE:
            return f"should be a table, not the date {detail['input']}"
        if key in known:
            return "there is no such key in this table, only in another one; move or remove it"
        close = difflib.get_close_matches(key, known, n=1)
        return "there is no such key" + (f"; did you mean {close[0]!r}?" if close else "; remove it, or correct its name")
    if detail["type"] == "missing":
        return "is missing; add it"
    if detail["type"] == "value_error":
        return str(detail["ctx"]["error"])
    given = detail["input"]
    if detail["type"] == "union_tag_not_found" and isinstance(given, dict):
        return f"{_tag_names(detail['ctx']['discriminator'])[0]}: is missing; add it"
    if detail["type"] == "union_tag_invalid":
        return f"should be a {' or a '.join(_tag_names(detail['ctx']['expected_tags']))}, not a {detail['ctx']['tag']}"
    shown = "" if isinstance(given, dict | list) else f", not {given!r}"
    if isinstance(given, dict) and DATE in given:
        shown = f", not the date {given[DATE]}"
    if detail["type"] in TYPES:
        return f"should be a {TYPES[detail['type']]}{shown}"
    message = detail["msg"].replace("Tuple", "List")
    return f"{message[0].lower()}{message[1:]}{shown}"


def _tag_names(tags: str) -> list[str]:
    return [tag.strip(" '") for tag in tags.split(",")]


@cache
def _known_keys(table: Any) -> list[str]:
    """All keys of a file: the candidates for a correction of a mistyped key."""
    schema = _reader(table).json_schema(schema_generator=_FileSchema)
    return [key for each in (schema, *schema.get("$defs", {}).values()) for key in each.get("properties", ())]
