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
    "mirror_s": "",
    "um_per_s": "µm/s",
    "deg_per_s": "deg/s",
    "per_s": "1/s",
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
WORDS = {
    "string": ("text", "texts"),
    "number": ("number", "numbers"),
    "integer": ("whole number", "whole numbers"),
    "boolean": ("true or false", "true or false"),
}
"""By type of JSON Schema, the words for one value and for several."""
CHOICES = ("kind", "model")
"""Keys that decide which keys a table has."""
MADE = ("Dataset", "DatasetComparison")
"""Classes whose instances functions of the package make."""
INNER = ("data", "only", "reduced", "whole")
"""Attributes of a dataset that other parts of the program use. They are not public, and not on the page of the API."""
FEW = 3
"""Keys of a table that is shown in one line."""


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
    links = {name: Link(tables[name], found, f"#{anchor(kind, name)}") for name, found in places.items()}
    parts = ["## Keys outside tables", about(schema), key_table(schema, links)]
    for name, link in links.items():
        table = key_table(tables[name], links)
        parts += [f"({anchor(kind, name)})=", f"## {link.title}", link.others, about(tables[name]), table]
    return "\n\n".join(each for each in parts if each)


class Link:
    """A table of a file on its page: the places that have it, and its names in links."""

    def __init__(self, table: Any, places: list[str], address: str) -> None:
        self.places = [*dict.fromkeys(places)]
        self.address = address
        properties = table["properties"]
        chosen = {key: properties[key] for key in CHOICES if key in properties}
        of_several = chosen.get("model", {}).get("enum", [""])[0]  # a model with an older name
        choices = {key: each.get("const", of_several if key == "model" else "") for key, each in chosen.items()}
        self.choice = next((f'`{key} = "{value}"`' for key, value in choices.items() if value), "")
        """The key that decides for this table among several."""
        self.small = ""
        if len(self.places) > 1 and len(properties) <= FEW and set(properties) == set(table.get("required", ())):
            self.small = f"`{{ {', '.join(properties)} }}`"

    @property
    def title(self) -> str:
        return self.small or f"`{self.places[0]}`" + (f" with {self.choice}" if self.choice else "")

    @property
    def others(self) -> str:
        """A sentence on the places that the title does not name."""
        places = ", ".join(f"`{each}`" for each in self.places[0 if self.small else 1 :])
        return f"These keys are in {places}." if self.small else f"The same keys are in {places}." if places else ""

    def text(self, *, among: bool) -> str:
        """A link to the table, by its place; `among` others by the key that decides for it."""
        name = self.small or f"`{self.places[0]}`"
        if among:
            name = self.choice or f"no `{CHOICES[0]}`"
        return f"[{name}]({self.address})"


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
        return [(name_of(value), mark)]
    found = [each for one in value.get("oneOf", ()) for each in references(one, mark)]
    for inner, kind in (("items", "array"), ("additionalProperties", "object")):
        if isinstance(value.get(inner), dict):
            found += references(value[inner], kind)
    return found


def name_of(reference: Any) -> str:
    return str(reference["$ref"].rpartition("/")[2])


def about(table: Any) -> str:
    """The sentences of a table's description that are not the meaning of a key as well."""
    meanings = " ".join(each.get("description", "") for each in table["properties"].values())
    paragraphs = [SENTENCE_END.split(each) for each in table["description"].split("\n\n")]
    own = [" ".join(each for each in paragraph if each not in meanings) for paragraph in paragraphs]
    return "\n\n".join(filter(None, own)).replace("$", r"\$")


def key_table(table: Any, links: dict[str, Link]) -> str:
    required = set(table.get("required", ()))
    lines = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for key, value in table["properties"].items():
        default = "required" if key in required else shown(value["default"]) if "default" in value else ""
        if isinstance(value.get("default"), dict):
            default = ""
        cells = (f"`{key}`", kind_of(key, value, links), default, value.get("description", ""))
        lines.append("| " + " | ".join(each.replace("|", r"\|").replace("\n", " ") for each in cells) + " |")
    return "\n".join(lines)


def shown(value: object) -> str:
    return f"`{json.dumps(value, ensure_ascii=False)}`"


def kind_of(key: str, value: Any, links: dict[str, Link], *, many: bool = False) -> str:
    """What a value is, in words: its type or choices, bounds and unit; of several forms each. `many` of them are in a list."""
    if "oneOf" in value or "anyOf" in value:
        return forms_of(key, value.get("oneOf", value.get("anyOf")), links, many=many)
    if "$ref" in value:
        return f"{'tables' if many else 'table'} {links[name_of(value)].text(among=False)}"
    if "enum" in value:
        return ", ".join(shown(each) for each in value["enum"])
    if "const" in value:
        return shown(value["const"])
    if value.get("type") == "array":
        return f"list of {kind_of(key, value['items'], links, many=True)}"
    if value.get("type") == "object":
        inner = value.get("additionalProperties") or next(iter(value.get("patternProperties", {}).values()), {"not": {}})
        return "table" if "not" in inner else f"{kind_of(key, inner, links, many=True)}, by name"
    if value.get("format") == "date":
        return "date"
    bounds = " and ".join(f"{sign} {exact(value[name])}" for name, sign in BOUNDS.items() if name in value)
    return ", ".join(each for each in (f"{WORDS[value['type']][many]} {bounds}".strip(), unit_of(key, value)) if each)


def exact(number: float) -> str:
    """A bound as text: short, unless that would be another number."""
    short = f"{number:g}"
    return short if float(short) == number else str(number)


def forms_of(key: str, forms: list[Any], links: dict[str, Link], *, many: bool) -> str:
    """The forms of a value in words: tables that a key chooses from; or lists first, and then what may stand alone."""
    tables = [links[name_of(each)] for each in forms if "$ref" in each]
    if len(tables) > 1:
        return f"{'tables' if many else 'table'} with {' or '.join(each.text(among=True) for each in tables)}"
    if many:
        # Tables last: a link is long. A unit in brackets, because commas separate the forms.
        plain = [f"{WORDS[each['type']][True]} ({unit_of(key, each)})".replace(" ()", "") for each in forms if "type" in each]
        each_of = [*plain, *(f"tables {each.text(among=False)}" for each in tables)]
        return f"{', of '.join(each_of)}, or of both"
    lists = [each for each in forms if each.get("type") == "array"]
    named = {name for each in lists for name, _ in references(each)}
    first = [kind_of(key, each, links) for each in lists]
    alone = [
        "one such table" if "$ref" in each and name_of(each) in named else kind_of(key, each, links)
        for each in forms
        if each not in lists
    ]
    joined = "; or " if named else " or "
    return joined.join(dict.fromkeys([*first, *alone] if named else [*alone, *first]))


def unit_of(key: str, value: Any) -> str:
    """The unit of a number, by the end of its key."""
    return (
        next((each for end, each in UNITS.items() if f"_{key}".endswith(f"_{end}")), "")
        if value.get("type") == "number"
        else ""
    )


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
        is_class = isinstance(getattr(goniotwin, name), type)
        made = "()" if name in MADE else ""  # without the arguments of its constructor
        members = f"\n   :members:\n   :exclude-members: {', '.join(INNER)}" if is_class else ""
        kind = "autoclass" if is_class else "autofunction"
        parts.append(f"## {name}\n\n```{{eval-rst}}\n.. {kind}:: goniotwin.{name}{made}{members}\n```")
    return "\n\n".join(parts)


def setup(app: Sphinx) -> dict[str, typing.Any]:
    """The directives `keys`, `commands`, `journal` and `api`."""
    for function in (keys, commands, journal, api):
        app.add_directive(f"generated-{function.__name__}", directive(function))
    return {"parallel_read_safe": True, "version": goniotwin.__version__}
