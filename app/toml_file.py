"""TOML files: reading, validation against a model, and error messages of one line."""

import difflib
import tomllib
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from goniotwin.app.errors import UserError


class TomlTable(BaseModel):
    """A table of a file: unknown keys and numbers that are not finite are refused; the fields are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=TomlTable)


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """The text of a TOML file and its content. Raises UserError."""
    try:
        text = path.read_text(encoding="utf-8-sig")  # some editors write a byte order mark
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}; check the name") from None
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not a text file in UTF-8; check the name, or save it as UTF-8") from None
    return text, parse_toml(text, str(path))


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """The content of a TOML text. Raises UserError with the line of a syntax error."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{name}: is not TOML: {error}; correct that line") from None


def validate_table(model: type[Model], content: dict[str, Any], name: str) -> Model:
    """The content as a model. Raises UserError with the file, the key, the reason, and the number of further errors."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        # A mistyped key is reported as unknown and as missing; the unknown one has the text that was typed.
        errors = sorted(error.errors(include_url=False), key=lambda detail: detail["type"] != "extra_forbidden")
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        where = ".".join(_place(content, errors[0]))
        raise UserError(f"{name}: {where or 'the file'}: {_reason(model, errors[0])}{more}") from None


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


def _reason(model: type[TomlTable], detail: Any) -> str:
    if detail["type"] == "extra_forbidden":
        close = difflib.get_close_matches(str(detail["loc"][-1]), _known_keys(model), n=1)
        return "there is no such key" + (f"; did you mean {close[0]!r}?" if close else "; remove it, or correct its name")
    if detail["type"] == "missing":
        return "is missing; add it"
    if detail["type"] == "value_error":
        return str(detail["ctx"]["error"])
    given = detail["input"]
    if detail["type"] == "union_tag_invalid":
        return f"should be a {' or a '.join(_tag_names(detail['ctx']['expected_tags']))}, not a {detail['ctx']['tag']}"
    if detail["type"].startswith("date_") and isinstance(given, str):
        return f"should be a date, not text: {given} without the quotes"
    shown = "" if isinstance(given, dict | list) else f", not {given!r}"
    return f"{detail['msg'][0].lower()}{detail['msg'][1:]}{shown}"


def _tag_names(tags: str) -> list[str]:
    return [tag.strip(" '") for tag in tags.split(",")]


def _known_keys(model: Any, seen: frozenset[Any] = frozenset()) -> list[str]:
    """All keys of a model and of the models in it: the candidates for a correction of a mistyped key."""
    if model in seen:
        return []
    if isinstance(model, type) and issubclass(model, BaseModel):
        keys = list(model.model_fields)
        for field in model.model_fields.values():
            keys += _known_keys(field.annotation, seen | {model})
        return keys
    return [key for part in get_args(model) for key in _known_keys(part, seen)]
