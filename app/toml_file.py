"""TOML files that people write: read, checked against a model, and complained about in one line."""

import difflib
import tomllib
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from goniotwin.app.errors import UserError


class TomlTable(BaseModel):
    """A table of a file: no key that it does not know, nothing that is not finite, nothing changed afterwards."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Model = TypeVar("Model", bound=TomlTable)


def read_toml(path: Path) -> tuple[str, dict[str, Any]]:
    """The text of a TOML file and what it says. Raises UserError."""
    try:
        text = path.read_text(encoding="utf-8-sig")  # some editors begin with a mark
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}; check the name") from None
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not a text file in UTF-8; is it the right file?") from None
    return text, parse_toml(text, str(path))


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """What TOML text says. Raises UserError with the line where it is none."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{name}: is not TOML: {error}; mend that place") from None


def validate_table(model: type[Model], content: dict[str, Any], name: str) -> Model:
    """The content as a model. Raises UserError: file, key, reason; and how many more there are."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        # A mistyped key is both unknown and missing; what was typed says more.
        faults = sorted(error.errors(include_url=False), key=lambda fault: fault["type"] != "extra_forbidden")
        more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
        where = ".".join(_place(content, faults[0]))
        raise UserError(f"{name}: {where or 'the file'}: {_reason(model, faults[0])}{more}") from None


def _place(content: dict[str, Any], fault: Any) -> list[str]:
    """The keys that lead to a fault, without pydantic's names for the members of a union, which are no keys of the file."""
    here: Any = content
    place = []
    for depth, part in enumerate(fault["loc"], 1):
        try:
            here = here[part]
        except (KeyError, IndexError, TypeError):
            if fault["type"] != "missing" or depth < len(fault["loc"]):
                continue
        place.append(str(part))
    return place


def _reason(model: type[TomlTable], fault: Any) -> str:
    if fault["type"] == "extra_forbidden":
        close = difflib.get_close_matches(str(fault["loc"][-1]), _known_keys(model), n=1)
        return "there is no such key" + (f"; did you mean {close[0]!r}?" if close else "; remove it, or mend its name")
    if fault["type"] == "missing":
        return "is missing; add it"
    if fault["type"] == "value_error":
        return str(fault["ctx"]["error"])
    given = fault["input"]
    if fault["type"] == "union_tag_invalid":
        return f"should be a {' or a '.join(_named(fault['ctx']['expected_tags']))}, not a {fault['ctx']['tag']}"
    if fault["type"].startswith("date_") and isinstance(given, str):
        return f"should be a date, not text: {given} without the quotes"
    shown = "" if isinstance(given, dict | list) else f", not {given!r}"
    return f"{fault['msg'][0].lower()}{fault['msg'][1:]}{shown}"


def _named(tags: str) -> list[str]:
    return [tag.strip(" '") for tag in tags.split(",")]


def _known_keys(model: Any, seen: frozenset[Any] = frozenset()) -> list[str]:
    """All keys of a model and of the models in it: enough for a guess at what was meant."""
    if model in seen:
        return []
    if isinstance(model, type) and issubclass(model, BaseModel):
        keys = list(model.model_fields)
        for field in model.model_fields.values():
            keys += _known_keys(field.annotation, seen | {model})
        return keys
    return [key for part in get_args(model) for key in _known_keys(part, seen)]
