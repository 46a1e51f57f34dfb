"""docs/extend/architecture.md: its picture is that of the imports, and its links lead somewhere."""

import ast
import functools
import re
from datetime import date
from importlib import import_module
from pathlib import Path

from tests.conftest import REPOSITORY

DOCUMENT = REPOSITORY / "docs" / "extend" / "architecture.md"
ROOMS = (
    "app.cli",
    "app.desktop",
    "app.data",
    "app.station",
    "app.campaign",
    "app.simulation",
    "app.sweeps",
    "app.rig",
    "app.guardian",
    "app.figures",
    "app.formats",
    "mocks",
    "twin.doors",
    "twin.devices",
    "twin.plant",
    "twin.optics",
    "drivers",
    "protocols",
)
CAMPAIGN = (
    "campaign",
    "proof",
    "rehearsal",
    "running",
    "studies",
    "reduction",
    "journal",
    "planning",
    "geometry",
    "schedule",
    "readout",
    "row",
    "measurement_model",
    "wording",
)

Graph = dict[str, set[str]]


def sources(name: str) -> list[Path]:
    """The sources of the product with a name, a pattern."""
    return [path for folder in ("app", "drivers", "mocks", "protocols", "twin") for path in (REPOSITORY / folder).rglob(name)]


def imports(rooms: tuple[str, ...]) -> Graph:
    """Which rooms each room imports, by the sources; `if TYPE_CHECKING` and imports inside functions count."""
    graph: Graph = {room: set() for room in rooms}
    for path in sources("*.py"):
        here = room_of(".".join(path.relative_to(REPOSITORY).with_suffix("").parts), rooms)
        if here is None:
            continue
        graph[here] |= {room for name in own_imports(path) if (room := room_of(name, rooms)) is not None}
    return {room: others - {room} for room, others in graph.items()}


@functools.cache
def own_imports(path: Path) -> list[str]:
    """The names that a source imports from goniotwin, without that of the package."""
    nodes = [each for each in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(each, ast.ImportFrom)]
    own = [each for each in nodes if each.module is not None and each.module.startswith("goniotwin")]
    return [f"{each.module}.{alias.name}".removeprefix("goniotwin.") for each in own for alias in each.names]


def room_of(module: str, rooms: tuple[str, ...]) -> str | None:
    return next((room for room in rooms if module == room or module.startswith(f"{room}.")), None)


def reduced(graph: Graph) -> Graph:
    """The arrows that no longer way replaces (the transitive reduction of a graph without cycles)."""

    def reached(room: str) -> set[str]:
        return {room}.union(*(reached(other) for other in graph[room]))

    return {
        room: {other for other in others if not any(other in reached(way) for way in others - {other})}
        for room, others in graph.items()
    }


def drawn(name: str) -> Graph:
    """The arrows of a mermaid picture under a heading of the document."""
    text = DOCUMENT.read_text(encoding="utf-8")
    match = re.search(rf"^## {re.escape(name)}$.*?```mermaid\n(.*?)```", text, re.DOTALL | re.MULTILINE)
    assert match is not None, f"no picture under {name!r}"
    graph: Graph = {}
    for line in match[1].splitlines():
        if arrow := re.fullmatch(r"\s*([\w.]+) --> ([\w. &]+)", line):
            graph.setdefault(arrow[1], set()).update(other.strip() for other in arrow[2].split("&"))
    return graph


def test_the_picture_of_the_rooms_is_that_of_the_imports() -> None:
    assert drawn("The packages") == {room: others for room, others in reduced(imports(ROOMS)).items() if others}


def test_the_picture_of_a_campaign_is_that_of_the_imports() -> None:
    rooms = tuple(f"app.campaign.{name}" for name in CAMPAIGN)
    found = {
        room.removeprefix("app.campaign."): {other.removeprefix("app.campaign.") for other in others}
        for room, others in reduced(imports(rooms)).items()
        if others
    }
    assert drawn("A campaign") == found


def test_every_link_of_the_documents_leads_to_a_file_and_every_name_in_it_is_defined_there() -> None:
    for document in [REPOSITORY / "README.md", *(REPOSITORY / "docs").rglob("*.md")]:
        for name, target in re.findall(r"\[([^\]]+)\]\(([^)#:]+)\)", document.read_text(encoding="utf-8")):
            path = Path(document.parent, target)
            assert path.exists(), f"{document.name}: {target}"
            if path.suffix == ".py" and (symbol := re.fullmatch(r"`(\w+)(?:\.(\w+))?`", name)):
                defined = {
                    node.name
                    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
                    if isinstance(node, ast.ClassDef | ast.FunctionDef)
                }
                wanted = {part for part in symbol.groups() if part}
                assert wanted <= defined, f"{document.name}: {name} is not in {target}"


def test_every_decision_states_its_date_and_its_status() -> None:
    paths = {int(path.name[:4]): path for path in (REPOSITORY / "docs" / "decisions").glob("0*.md")}
    form = r"# (\d+)\. [^\n]+\n\nDate: (\d{4}-\d\d-\d\d)\. Status: (accepted|superseded by \[(\d+)\]\(([^)]+)\))\.\n\n"
    assert len(paths) > 40
    for number, path in paths.items():
        header = re.match(form, path.read_text(encoding="utf-8"))
        assert header is not None, f"{path.name}: its header is not a number and a title, then date and status"
        assert int(header[1]) == number, path.name
        date.fromisoformat(header[2])
        if header[4] is not None:
            later = paths[int(header[4])]
            assert later.name == header[5], path.name
            assert f"({path.name})" in later.read_text(encoding="utf-8"), f"{later.name} does not name {path.name}"


def test_no_test_imports_a_benchmark() -> None:
    """What both use is with the tests; benchmarks import it from there."""
    for path in (REPOSITORY / "tests").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if "benchmarks" in text else ():
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.partition(".")[0] == "benchmarks"], path


def test_each_import_within_a_function_has_its_reason() -> None:
    """In a comment at it or above it, or at the module's imports for types, of a library that the whole module loads late.

    Those of `app/cli` have one reason, which is that of the folder: in its `__init__.py`.
    """
    silent = []
    for path in [*sources("*.py"), *(REPOSITORY / "package").glob("*.py")]:
        text = path.read_text(encoding="utf-8")
        lines = text.splitlines()
        if path.parent == REPOSITORY / "app" / "cli" or re.search(r"^if TYPE_CHECKING:  # \S", text, re.MULTILINE):
            continue
        reason = 0  # the last line of imports with a reason
        for number in late_imports(text):
            above = lines[number - 2].strip()
            if "#" in lines[number - 1] or above.startswith("#") or (reason and all(map(is_import, lines[reason:number]))):
                reason = number
            else:
                silent.append(f"{path.relative_to(REPOSITORY)}:{number}")
    assert silent == []


def late_imports(text: str) -> list[int]:
    """The lines of imports within functions."""
    if re.search(r"^ +(from|import) ", text, re.MULTILINE) is None:
        return []
    functions = [each for each in ast.walk(ast.parse(text)) if isinstance(each, ast.FunctionDef)]
    return sorted({each.lineno for one in functions for each in ast.walk(one) if isinstance(each, ast.Import | ast.ImportFrom)})


def is_import(line: str) -> bool:
    """Whether a line belongs to a block of imports, one of several lines included."""
    return re.match(r"\s*(from|import) |\s*\w+,$|\s*\)$|\s*$", line) is not None


def test_a_package_loads_each_name_that_it_imports_for_types_and_no_other() -> None:
    packages = [path for path in sources("__init__.py") if "first_use(" in path.read_text(encoding="utf-8")]
    assert len(packages) > 5
    for path in packages:
        package = import_module(".".join(("goniotwin", *path.parent.relative_to(REPOSITORY).parts)))
        (choice,) = (node for node in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(node, ast.If))
        typed = {
            alias.asname: node.module
            for node in choice.body
            if isinstance(node, ast.ImportFrom) and node.module is not None
            for alias in node.names
        }
        assert dir(package) == sorted(map(str, typed)), path
        for name, module in typed.items():
            assert getattr(package, str(name)) is getattr(import_module(module), str(name)), (path, name)


def test_a_function_of_the_fast_estimator_is_one_page() -> None:
    functions = [
        (path.name, node.name, (node.end_lineno or 0) - node.lineno + 1)
        for path in (REPOSITORY / "twin" / "optics" / "fast").glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
    ]
    assert len(functions) > 50
    assert [each for each in functions if each[2] > 60] == []
