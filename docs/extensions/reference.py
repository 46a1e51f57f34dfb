"""Pages of the reference, made from the program at build time: keys of files, commands, API, tables of the journal."""

import json
import re
import typing
from collections.abc import Callable, Iterator
from typing import Any

import typer.main
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import goniotwin
from goniotwin.app.campaign.journal.schema import CREATED, SCHEMA_VERSION
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.cli.main import app
from goniotwin.app.rig import rig_file_table
from goniotwin.app.simulation.tolerances.study import StudyFile
from goniotwin.app.toml_file import SENTENCE_END, json_schema

TABLES: dict[str, Callable[[], Any]] = {
    "rig": rig_file_table,
    "schedule": lambda: ScheduleFile,
    "tolerances": lambda: StudyFile,
}
BOUNDS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
UNITS = {
    "v_per_a": "V/A",
    "nm_per_s": "nm/s",
    "deg_s2": "deg/s²",
    "deg_s": "deg/s",
    "per_year": "1/year",
    "per_hour": "1/h",
    "per_decade": "1/decade",
    "percent": "%",
    "deg": "deg",
    "mm": "mm",
    "nm": "nm",
    "hz": "Hz",
    "h": "h",
    "s": "s",
    "v": "V",
    "a": "A",
    "k": "K",
}
"""By the end of a key, the unit of its value."""


class Generated(SphinxDirective):
    """Markdown that a function makes, in the place of the directive. Its optional argument is the function's."""

    optional_arguments = 1
    make: Callable[..., str]

    def run(self) -> list[nodes.Node]:
        return self.parse_text_to_nodes(type(self).make(*self.arguments), allow_section_headings=True)


def directive(function: Callable[..., str]) -> type[SphinxDirective]:
    """The directive of a function that gives Markdown."""
    return type(function.__name__, (Generated,), {"make": staticmethod(function)})


def keys(kind: str) -> str:
    """The tables of a file and their keys, from the JSON Schema that `goniotwin schema` prints."""
    schema = json_schema(TABLES[kind](), kind)
    tables = schema["$defs"]
    places: dict[str, list[str]] = {}
    for place, name in places_of(schema, tables):
        places.setdefault(name, []).append(place)
    parts = ["## Keys outside tables", about(schema), key_table(schema, places)]
    for name, found in places.items():
        first, *others = dict.fromkeys(found)
        constants = [f'`{key} = "{value["const"]}"`' for key, value in tables[name]["properties"].items() if "const" in value]
        title = f"`{first}`" + (f" with {constants[0]}" if constants else "")
        also = f"The same keys are in {', '.join(f'`{each}`' for each in others)}." if others else ""
        parts += [f"({anchor(kind, name)})=", f"## {title}", also, about(tables[name]), key_table(tables[name], places)]
    return "\n\n".join(each for each in parts if each).replace("(#", f"(#{kind}-")


def anchor(kind: str, name: str) -> str:
    return f"{kind}-{name.lower()}"


def places_of(schema: Any, tables: Any, place: str = "") -> Iterator[tuple[str, str]]:
    """The places of tables below one, as TOML has them, each with the name of its declaration."""
    for key, value in schema["properties"].items():
        for name, mark in references(value):
            inner = f"{place}.{key}".lstrip(".") + {"array": "", "object": ".NAME", "": ""}[mark]
            yield (f"[[{inner}]]" if mark == "array" else f"[{inner}]"), name
            yield from places_of(tables[name], tables, inner)


def references(value: Any, mark: str = "") -> list[tuple[str, str]]:
    """The tables that a value can be, each with what it is in: an array, an object whose keys are names, or nothing."""
    if "$ref" in value:
        return [(value["$ref"].rpartition("/")[2], mark)]
    found = [each for one in value.get("oneOf", ()) for each in references(one, mark)]
    for inner, kind in (("items", "array"), ("additionalProperties", "object")):
        if isinstance(value.get(inner), dict):
            found += references(value[inner], kind)
    return found


def about(table: Any) -> str:
    """The sentences of a table's description that are not in the meaning of a key."""
    taken = " ".join(each.get("description", "") for each in table["properties"].values())
    return " ".join(each for each in SENTENCE_END.split(table["description"]) if each not in taken).replace("$", r"\$")


def key_table(table: Any, places: dict[str, list[str]]) -> str:
    required = set(table.get("required", ()))
    lines = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for key, value in table["properties"].items():
        default = "required" if key in required else shown(value["default"]) if "default" in value else ""
        if references(value) and key not in required:
            default = ""
        cells = (f"`{key}`", kind_of(key, value, places), default, value.get("description", ""))
        lines.append("| " + " | ".join(each.replace("|", r"\|").replace("\n", " ") for each in cells) + " |")
    return "\n".join(lines)


def shown(value: object) -> str:
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def kind_of(key: str, value: Any, places: dict[str, list[str]]) -> str:
    """What a value is, in words: its type or choices, bounds and unit."""
    if found := references(value):
        linked = [f"[`{places[name][0]}`](#{name.lower()})" for name, _ in dict.fromkeys(found)]
        further = [kind_of(key, each, places) for each in value.get("oneOf", ()) if not references(each)]
        return "table " + " or ".join([*linked, *further])
    if "oneOf" in value or "anyOf" in value:
        return " or ".join(dict.fromkeys(kind_of(key, each, places) for each in value.get("oneOf", value.get("anyOf"))))
    if "enum" in value:
        return ", ".join(shown(each) for each in value["enum"])
    if "const" in value:
        return shown(value["const"])
    if value.get("type") == "array":
        inner = kind_of(key, value["items"], places) if "items" in value else "values"
        return f"list of: {inner}"
    if value.get("format") == "date":
        return "date"
    words = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true or false", "object": "table"}
    bounds = " and ".join(f"{sign} {value[name]:g}" for name, sign in BOUNDS.items() if name in value)
    unit = next((each for end, each in UNITS.items() if key.endswith(f"_{end}")), "") if value.get("type") == "number" else ""
    return ", ".join(each for each in (f"{words[value['type']]} {bounds}".strip(), unit) if each)


def commands() -> str:
    """Each command of the program with its options, as its own help has them."""
    group = typer.main.get_command(app)
    return "\n\n".join(each for name, command in subcommands(group) for each in command_section(name, command))


def subcommands(group: Any, prefix: str = "goniotwin") -> Iterator[tuple[str, Any]]:
    for name in group.list_commands(None):
        command = group.commands[name]
        if not command.hidden:
            yield f"{prefix} {name}", command
        if hasattr(command, "commands"):
            yield from subcommands(command, f"{prefix} {name}")


def command_section(name: str, command: Any) -> Iterator[str]:
    context = command.make_context(name, [], resilient_parsing=True)
    yield f"## `{name}`"
    yield f"```text\n{name} {' '.join(command.collect_usage_pieces(context))}\n```"
    yield escaped(command.help or "")
    records = [each.get_help_record(context) for each in command.get_params(context) if each.name != "help"]
    rows = [(re.sub(r" <.*>$", "", names), text) for names, text in filter(None, records)]  # without the type of Python
    if rows:
        yield "\n".join(["| option | meaning |", "|---|---|", *(f"| `{names}` | {cell(text)} |" for names, text in rows)])


def escaped(text: str) -> str:
    """Plain text of a help as Markdown."""
    return re.sub(r"([\\`*_<>\[\]$])", r"\\\1", text)


def cell(text: str) -> str:
    return escaped(" ".join(text.split())).replace("|", r"\|")


def journal() -> str:
    """The statements that make an empty journal."""
    return "\n\n".join(f"```sql\n{each};\n```" for each in CREATED[SCHEMA_VERSION])


def api() -> str:
    """The public names of the package, by autodoc."""
    names = [each for each in dir(goniotwin) if each not in ("__version__", "open_dataset", "open")]
    parts = []
    for name in names:
        kind = "autofunction" if not isinstance(getattr(goniotwin, name), type) else "autoclass"
        members = "\n   :members:" if kind == "autoclass" else ""
        parts.append(f"## {name}\n\n```{{eval-rst}}\n.. {kind}:: goniotwin.{name}{members}\n```")
    return "\n\n".join(parts)


def setup(app: Sphinx) -> dict[str, typing.Any]:
    """The directives `keys`, `commands`, `journal` and `api`."""
    for function in (keys, commands, journal, api):
        app.add_directive(f"generated-{function.__name__}", directive(function))
    return {"parallel_read_safe": True, "version": goniotwin.__version__}
