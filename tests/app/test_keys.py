"""The keys of rig file and schedule: each is declared once, and JSON Schema comes from the same declarations."""

import copy
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from datetime import date
from importlib import import_module
from inspect import signature
from pathlib import Path
from pkgutil import walk_packages
from types import ModuleType
from typing import Any, TypeVar, get_args

import pytest
from jsonschema import Draft202012Validator
from pydantic import BaseModel, TypeAdapter
from typer.testing import CliRunner

from goniotwin.app.campaign.schedule.file import ScheduleFile, read_schedule
from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, makes, open_rig, read_rig, rig_file_table, twin_file
from goniotwin.app.rig import file as rig_file
from goniotwin.app.rig.inputs import inputs
from goniotwin.app.rig.kinds import register, unregister
from goniotwin.app.simulation.tolerances.study import StudyFile
from goniotwin.app.toml_file import json_schema, key_sentences, validate_table
from goniotwin.drivers import Homing
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import optics
from goniotwin.twin.plant import Parts
from tests.conftest import REPOSITORY, RIG, SCHEDULE, SMALL
from tests.docs.snippets import DOCS, pages, toml_parts
from tests.system.another_make.driver import ESP

OF_ANOTHER_MAKE = DOCS / "extend" / "adding-a-device.md"
"""Its part of a rig file has a kind of device that is not registered."""
FILES: dict[str, Any] = {"rig": rig_file_table(), "schedule": ScheduleFile, "tolerances": StudyFile}
SCHEMAS = {kind: json_schema(table, kind) for kind, table in FILES.items()}
FOLDERS = {kind: REPOSITORY / "examples" / f"{kind.removesuffix('s')}s" for kind in FILES}
PARTS = {
    "rig": (set(SCHEMAS["rig"]["properties"]), RIG),
    "schedule": (set(SCHEMAS["schedule"]["properties"]), SCHEDULE),
    "tolerances": (set(SCHEMAS["tolerances"]["properties"]), FOLDERS["tolerances"] / "table1.toml"),
}
"""By kind the keys of a whole file, and an example."""
EXAMPLES = [(kind, path) for kind, folder in FOLDERS.items() for path in sorted(folder.glob("*.toml"))]


KEYS_ARE_NAMES = [("twin", "samples"), ("twin", "deviations"), ("metadata", "samples")]
"""Tables of files whose keys are any names."""


def as_json(content: Any) -> Any:
    """The content of a TOML file with dates as texts, as JSON has them."""
    return json.loads(json.dumps(content, default=date.isoformat))


def contents() -> list[tuple[str, dict[str, Any]]]:
    examples = [(kind, tomllib.loads(path.read_text(encoding="utf-8"))) for kind, path in EXAMPLES]
    return examples + [part for page in pages() if page != OF_ANOTHER_MAKE for part in toml_parts(page, PARTS)]


def tables(content: Any) -> Iterator[dict[str, Any]]:
    """All tables in a file's content."""
    if isinstance(content, dict):
        yield content
    for part in content.values() if isinstance(content, dict) else content if isinstance(content, list) else ():
        yield from tables(part)


def test_the_schemas_are_json_schema_2020_12_with_descriptions() -> None:
    for schema in SCHEMAS.values():
        Draft202012Validator.check_schema(schema)
        assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
        assert all(each["description"] and each["additionalProperties"] is False for each in schema["$defs"].values())
        for each in (schema, *schema["$defs"].values()):
            assert [key for key, value in each["properties"].items() if "description" not in value] == [], each["title"]
    axis = SCHEMAS["rig"]["$defs"]["AxisSettings"]["properties"]["gear"]
    assert axis == {"type": "number", "exclusiveMinimum": 0, "description": axis["description"]}
    assert axis["description"] == "Motor turns per turn of the axis."


@pytest.mark.parametrize("kind", FILES)
def test_the_command_prints_the_schema_or_writes_it(kind: str, tmp_path: Path) -> None:
    written = tmp_path / "schema.json"
    printed = CliRunner().invoke(app, ["schema", kind])
    assert CliRunner().invoke(app, ["schema", kind, "--out", str(written)]).output == ""
    assert printed.stdout == written.read_text(encoding="utf-8")
    assert json.loads(printed.stdout) == {**SCHEMAS[kind], "title": f"goniotwin {kind} file"}
    refused = CliRunner().invoke(app, ["schema", kind, "--out", str(tmp_path / "nowhere" / "schema.json")])
    assert isinstance(refused.exception, UserError)
    assert "cannot be written" in str(refused.exception)


def test_every_key_of_the_examples_and_documents_validates() -> None:
    found = contents()
    assert len(found) >= len(EXAMPLES) + 5  # with the parts of files in documents
    for kind, content in found:
        Draft202012Validator(SCHEMAS[kind]).validate(as_json(content))
        validate_table(FILES[kind], content, kind)


def test_the_page_of_the_inputs_has_the_keys_with_their_defaults() -> None:
    """In its list of keys, and those of other tables that it names."""
    text = (REPOSITORY / "docs" / "physics" / "inputs.md").read_text(encoding="utf-8")
    table, _, after = text.partition("| key | default |")[2].partition("\n\n")
    rows = [line.split("|") for line in table.splitlines()[2:]]
    listed = [(name.strip("` "), float(default)) for _, name, default, *_ in rows]
    known = {each.key: each.u for each in inputs() if each.u is not None}
    assert len(listed) == len(known)
    assert dict(listed) == known
    beside = re.findall(r"`\[(\w+)\] (\w+)` \(([\d.e-]+)\)", after)
    schema = SCHEMAS["rig"]
    tables = {name: each["$ref"].rpartition("/")[2] for name, each in schema["properties"].items() if "$ref" in each}
    defaults = [schema["$defs"][tables[name]]["properties"][key]["default"] for name, key, _ in beside]
    assert len(defaults) >= 3
    assert [float(stated) for *_, stated in beside] == defaults


def test_a_schedule_in_the_place_of_a_rig_file_and_the_reverse_are_named(tmp_path: Path) -> None:
    schedule, rig = tmp_path / "a.toml", tmp_path / "b.toml"
    schedule.write_text(SMALL, encoding="utf-8")
    rig.write_bytes(RIG.read_bytes())
    with pytest.raises(UserError, match=r"a\.toml: looks like a schedule, not like a rig file"):
        read_rig(schedule)
    with pytest.raises(UserError, match=r"b\.toml: looks like a rig file, not like a schedule"):
        read_schedule(rig)


def test_an_unknown_key_validates_in_no_table_of_them() -> None:
    refused = 0
    for kind, content in contents():
        for index, table in enumerate(tables(content)):
            if any(table is content.get(first, {}).get(second) for first, second in KEYS_ARE_NAMES):
                continue
            spoiled = copy.deepcopy(content)
            next(each for k, each in enumerate(tables(spoiled)) if k == index)["unknown_key"] = 1
            assert not Draft202012Validator(SCHEMAS[kind]).is_valid(as_json(spoiled))
            with pytest.raises(UserError, match="unknown_key: there is no such key"):
                validate_table(FILES[kind], spoiled, kind)
            refused += 1
    assert refused > 100  # some thirty in each rig file


def test_the_schema_has_the_tables_of_a_registered_kind_as_long_as_it_is_registered() -> None:
    [(_, content)] = toml_parts(OF_ANOTHER_MAKE, PARTS)
    register(ESP)
    try:
        table = rig_file_table()
        schema = Draft202012Validator(json_schema(table, "rig"))
        schema.validate(as_json(content))
        content["axes"]["shift"]["unknown_key"] = 1
        assert not schema.is_valid(as_json(content))
        del content["axes"]["shift"]["unknown_key"]
    finally:
        unregister(ESP)
    assert not Draft202012Validator(json_schema(rig_file_table(), "rig")).is_valid(as_json(content))


def test_the_schema_refuses_a_twin_of_no_kind_and_of_none_that_is_registered() -> None:
    schema = Draft202012Validator(SCHEMAS["rig"])
    content = tomllib.loads(RIG.read_text(encoding="utf-8"))
    content["axes"]["shift"] |= {"kind": "tmcl", "port": "twin://virtual/second"}
    content["twin"]["controllers"] = {"second": {"kind": "tmcm-1240", "axes": ["shift"]}}
    assert schema.is_valid(as_json(content))
    del content["twin"]["controllers"]["second"]["kind"]
    assert not schema.is_valid(as_json(content))
    del content["twin"]["controllers"], content["axes"]["shift"]["kind"], content["axes"]["shift"]["port"]
    assert schema.is_valid(as_json(content))
    content["twin"]["devices"] = {"mono": {"kind": "nonsense", "unknown_key": 1}}
    assert not schema.is_valid(as_json(content))


def test_a_key_has_its_sentences_and_those_after_them() -> None:
    text = """`[stop]`: a table. It is `last` named here.

    `first`: one key, beside `second`. It goes on.
    `second` and `third` share a sentence. `Other`: is no key.

    The table again."""
    assert key_sentences(text, ["first", "second", "third", "last"]) == {
        "": ["A table.", "It is `last` named here.", "The table again."],
        "first": ["One key, beside `second`.", "It goes on."],
        "second": ["`second` and `third` share a sentence.", "`Other`: is no key."],
        "third": ["`second` and `third` share a sentence.", "`Other`: is no key."],
        "last": ["It is `last` named here."],
    }


def test_a_key_that_is_a_table_has_the_first_sentence_of_its_table() -> None:
    schema = SCHEMAS["rig"]
    described = {key: value["description"] for key, value in schema["properties"].items()}
    assert described["monitor"] == "The monitor, on USB."
    assert described["axes"] == "The axes and their motion controllers."
    assert len(set(described.values())) == len(described)
    assert schema["$defs"]["TmclAxesTable"]["properties"]["beta"]["description"] == "Turns the arc about the vertical axis."
    assert [name for name in schema["$defs"] if "goniotwin" in name] == []


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("rig", {"twin": {"light": {"wander_period_s": 30.0}}}),
        ("rig", {"twin": {"optics": {"pupil_to_mirror_mm": 200.0}}}),
        ("rig", {"twin": {"optics": {"kind": "fast"}}}),
        ("rig", {"twin": {"electronics": {"temperature_k": 300.0}}}),
        ("rig", {"axes": {"gamma": {"microstep_exponent": 8}}}),
        ("rig", {"geometry": {"obstruction": True}}),
    ],
)
def test_what_is_in_the_model_and_no_key_of_the_file_is_refused_by_both(kind: str, change: dict[str, Any]) -> None:
    content = tomllib.loads(RIG.read_text(encoding="utf-8"))
    here, part = content, change
    while isinstance(value := next(iter(part.values())), dict):
        here, part = here.setdefault(next(iter(part)), {}), value
    assert Draft202012Validator(SCHEMAS[kind]).is_valid(as_json(content))
    here |= part
    assert not Draft202012Validator(SCHEMAS[kind]).is_valid(as_json(content))
    with pytest.raises(UserError, match=f"{next(iter(part))}: there is no such key"):
        validate_table(FILES["rig"], content, "rig")


def test_drivers_and_twin_use_the_tables_themselves() -> None:
    description = read_rig(RIG)
    file, model = description.file, description.model()
    assert model is not None
    assert file.twin is not None
    with open_rig(description, VirtualClock()) as opened:
        assert all(opened.rig.axes[name].settings is getattr(file.axes, name) for name in AXES)
        devices: list[Any] = [opened.rig.monochromator, opened.rig.photodiodes, opened.rig.monitor]
        assert all(each.settings is getattr(file, each.name) for each in devices)
    assert all(model.axes[name] is getattr(file.twin.axes, name) for name in AXES)
    assert all(getattr(model, each.name) is getattr(file.twin, each.name) for each in fields(Parts))


# ---- keys that are declared twice ----

USED_IN = {
    "axes": "drivers.motion",
    "monochromator": "drivers.monochromator",
    "photodiodes": "drivers.photodiodes",
    "monitor": "drivers.monitor",
    "geometry": "twin.optics.geometry",
    "twin": "twin",
}
"""By table of the rig file, the package whose dataclasses its values become."""


def tables_in(node: Any, definitions: dict[str, Any]) -> set[type]:
    """Dataclasses and models in a part of pydantic's schema."""
    found: set[type] = set()
    if isinstance(node, dict):
        if node.get("type") == "definition-ref":
            return tables_in(definitions[node["schema_ref"]], definitions)
        found |= {node["cls"]} if node.get("type") in ("dataclass", "model") else set()
    for each in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        found |= tables_in(each, definitions)
    return found


def dataclasses_in(package: str) -> set[type]:
    """The dataclasses of a package."""
    root = import_module(f"goniotwin.{package}")
    modules = [import_module(each.name) for each in walk_packages(root.__path__, f"{root.__name__}.")]
    return {each for module in modules for each in vars(module).values() if isinstance(each, type) and is_dataclass(each)}


def has_tables(hint: Any) -> bool:
    """True for the type of a key whose value is a table, or has tables."""
    model = isinstance(hint, type) and issubclass(hint, BaseModel)
    kinds = isinstance(hint, TypeVar)  # one of the tables of the registered kinds
    return model or kinds or is_dataclass(hint) or any(has_tables(each) for each in get_args(hint))


def declared_twice(tables: set[type], used: set[type]) -> list[str]:
    """The keys that a table declares itself, and that a dataclass which it does not extend declares as well."""
    found = []
    for table in tables:
        inherited = {each.name for base in table.__mro__[1:] if is_dataclass(base) for each in fields(base)}
        own = {name for name, hint in vars(table).get("__annotations__", {}).items() if not has_tables(hint)} - inherited
        for other in used - set(table.__mro__):
            found += [
                f"{table.__name__}.{key} and {other.__name__}.{key}" for key in own & {each.name for each in fields(other)}
            ]
    return found


def test_no_key_of_the_rig_file_is_declared_twice() -> None:
    schema: Any = TypeAdapter(FILES["rig"]).core_schema
    definitions = {each["ref"]: each for each in schema["definitions"]}
    sections = {each["name"]: tables_in(each, definitions) for each in schema["schema"]["schema"]["fields"]}
    for section, package in USED_IN.items():
        own = {each for each in sections[section] if each.__module__ in (rig_file.__name__, twin_file.__name__, makes.__name__)}
        assert own
        assert declared_twice(own, dataclasses_in(package)) == []


@pytest.mark.parametrize("name", ["lambertian", "gaussian", "anisotropic-gaussian", "ward", "wide-tailed", "regular"])
def test_the_keys_of_a_sample_are_the_arguments_of_its_function_with_their_defaults(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With other defaults of the function the table, made again, has them too. Each sample has also the keys of a spectrum."""
    function: Any = getattr(optics, name.replace("-", "_"))
    arguments = signature(function).parameters
    monkeypatch.setattr(function, "__defaults__", tuple(f"default {k}" for k in range(len(function.__defaults__))))
    source = (REPOSITORY / "app" / "rig" / "samples.py").read_text(encoding="utf-8")
    changed = ModuleType("changed")
    monkeypatch.setitem(sys.modules, "changed", changed)
    exec(compile(source, "samples.py", "exec", dont_inherit=True), vars(changed))
    further = {"model", *changed.FormulaTable.model_fields}
    keys = {key: field.default for key, field in changed.MODELS[name].model_fields.items() if key not in further}
    assert keys.keys() == arguments.keys()
    expected = {key: each.default for key, each in signature(function).parameters.items() if each.default is not each.empty}
    assert {key: value for key, value in keys.items() if key in expected} == expected


def test_a_second_declaration_is_found() -> None:
    @dataclass
    class Copy:
        gear: float
        homing: Homing

    assert declared_twice({Copy}, dataclasses_in("drivers.motion")) == ["Copy.gear and AxisSettings.gear"]
