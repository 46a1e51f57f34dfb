"""The site: it is built without a warning and without a network, and its reference has every key, command and public name."""

import html
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer.main

import goniotwin
from goniotwin.app.cli.main import app
from tests.conftest import REPOSITORY
from tests.docs.reference import reference
from tests.docs.snippets import DOCS
from tests.system.command import invoke

pytestmark = pytest.mark.xdist_group("site")
LOADED = re.compile(r"<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href|srcset)=\"(?:https?:)?//[^\"]*\"")
LOADED_BY_STYLES = re.compile(r"(?:@import\s+|url\()[\"']?(?:https?:)?//")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("site"))


def build(folder: Path, *options: str, source: Path = DOCS) -> Path:
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", *options, str(source), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def shown(path: Path) -> str:
    """The text of a page as one reads it."""
    return html.unescape(re.sub(r"<[^>]+>", "", path.read_text(encoding="utf-8")))


def test_no_page_loads_anything_from_a_network(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 60
    for page in pages:
        assert LOADED.findall(page.read_text(encoding="utf-8")) == [], page
    for style in site.rglob("*.css"):
        assert LOADED_BY_STYLES.findall(style.read_text(encoding="utf-8")) == [], style


@pytest.mark.parametrize("kind", ["rig", "schedule", "tolerances"])
def test_the_reference_has_each_key_of_a_file(kind: str, site: Path) -> None:
    schema = json.loads(invoke("schema", kind).stdout)
    page = (site / "reference" / f"{kind}-keys.html").read_text(encoding="utf-8")
    for table in (schema, *schema["$defs"].values()):
        for key in table["properties"]:
            assert f'<span class="pre">{key}</span>' in page, (table["title"], key)
    assert "exclusiveMinimum" not in page


def test_the_reference_states_type_bounds_unit_and_default_of_a_key(site: Path) -> None:
    text = shown(site / "reference" / "rig-keys.html")
    row = re.search(r"^power_down_s\n(.*)\n(.*)\n", text, re.MULTILINE)
    assert row is not None
    assert row[1] == "number ≥ 0.01 and ≤ 655, s"
    assert row[2] == "2.0"


def test_the_reference_has_each_command_with_its_options(site: Path) -> None:
    text = shown(site / "reference" / "commands.html")
    group = typer.main.get_command(app)
    for name, command in group.commands.items():  # type: ignore[attr-defined]  # a group has them
        if not command.hidden:
            assert f"goniotwin {name}" in text
            assert [
                option for each in command.params for option in each.opts if each.name != "help" and option not in text
            ] == []


def test_the_reference_has_each_public_name_and_each_table_of_the_journal(site: Path) -> None:
    api = (site / "reference" / "api.html").read_text(encoding="utf-8")
    for name in dir(goniotwin):
        assert f'id="goniotwin.{name}"' in api or name in ("__version__", "open", "open_dataset"), name
    assert [name for name in reference().INNER if f'id="goniotwin.Dataset.{name}"' in api or f"{name}: " in api] == []
    journal = shown(site / "reference" / "journal-schema.html")
    assert set(re.findall(r"CREATE TABLE (\w+)", journal)) == {
        "campaign",
        "session",
        "plan",
        "attempt",
        "reading",
        "event",
        "chain",
    }


def test_diagrams_are_in_the_page_in_its_own_colours(site: Path) -> None:
    page = (site / "extend" / "architecture.html").read_text(encoding="utf-8")
    assert page.count("<svg style=") == 2
    drawn = "".join(re.findall(r"<svg style=.*?</svg>", page, re.DOTALL))
    assert drawn.count(">app.campaign</text>") == 1
    assert set(re.findall(r'(?:fill|stroke)="([^"]*)"', drawn)) == {"currentColor", "none"}


@pytest.mark.long
def test_a_link_to_a_source_is_a_plain_path_without_an_address_and_a_link_with_one(tmp_path: Path) -> None:
    pages = tmp_path / "docs"
    pages.mkdir()
    (pages / "index.md").write_text(
        "# A\n\n[`Engine`](../src/engine.py) and [src/engine.py](../src/engine.py)\n", encoding="utf-8"
    )
    (tmp_path / "src").mkdir()
    (tmp_path / "src" / "engine.py").touch()
    (pages / "conf.py").write_bytes((DOCS / "conf.py").read_bytes())
    (pages / "extensions").symlink_to(DOCS / "extensions")
    plain = build(tmp_path / "plain", source=pages)
    assert "Engine in src/engine.py and src/engine.py" in shown(plain / "index.html")
    assert not (plain / "_downloads").exists()
    linked = build(tmp_path / "linked", "-D", "source_address=https://example.org/main", source=pages)
    assert (linked / "index.html").read_text(encoding="utf-8").count('href="https://example.org/main/src/engine.py"') == 2


def test_the_site_of_the_repository_states_no_address(site: Path) -> None:
    assert re.search(r'^source_address = ""$', (DOCS / "conf.py").read_text(encoding="utf-8"), re.MULTILINE)
    assert REPOSITORY.as_posix() not in "".join(page.read_text(encoding="utf-8") for page in site.rglob("*.html"))
