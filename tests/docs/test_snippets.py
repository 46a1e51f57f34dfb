"""Each command and each snippet of README and site runs, on what the demo and the tutorial left, or states why it cannot."""

import contextlib
import json
import re
import shlex
import shutil
import tomllib
from pathlib import Path
from typing import Any

import pytest
import typer.main

from goniotwin.app.cli.main import app
from tests.conftest import REPOSITORY
from tests.docs.snippets import COMMAND_LANGUAGES, DOCS, blocks, pages, run_page, takes_long
from tests.system.command import invoke


def name(page: Path) -> str:
    return page.relative_to(REPOSITORY).as_posix()


pytestmark = pytest.mark.xdist_group("pages")
TUTORIAL = DOCS / "tutorial.md"
BEGIN_EMPTY = (TUTORIAL, DOCS / "operate" / "procedures.md")
WITH_OWN_TEST = (DOCS / "analyse" / "python.md", DOCS / "analyse" / "figures.md")
"""In test_pages.py."""
STARTS = {
    REPOSITORY / "tests" / "golden" / "data" / "finished.journal": "my.journal",
    REPOSITORY / "examples" / "proof" / "rig.toml": "rig.toml",
    REPOSITORY / "examples" / "proof" / "alignment.toml": "alignment.toml",
}
"""Files that a page's commands begin with, and their names there."""
LANGUAGES = {*COMMAND_LANGUAGES, "python", "toml", "json", "text", "mermaid", "sql"}
WITH_RUNS = [page for page in pages() if page not in WITH_OWN_TEST and any(block.runs for block in blocks(page))]
CASES = [pytest.param(page, marks=pytest.mark.long if takes_long(page) else (), id=name(page)) for page in WITH_RUNS]
SPAN = re.compile(r"(?<!`)`(goniotwin (?!rayset`)[a-z][^`]*)`(?!`)")  # `goniotwin rayset` is the name of a file format


@pytest.fixture(scope="session")
def left_by_tutorial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the example files and the data file that the tutorial makes. Tests only read it."""
    base = tmp_path_factory.mktemp("tutorial")
    lines = [words for block in blocks(TUTORIAL) for words in block.lines] if TUTORIAL.exists() else []
    with contextlib.chdir(base):
        for words in lines:
            if words[:2] in (["goniotwin", "examples"], ["goniotwin", "run"]):
                assert invoke(*words[1:]).returncode == 0, words
    return base


@pytest.fixture
def folder(
    request: pytest.FixtureRequest,
    demo_run: tuple[Path, dict[str, Any]],
    left_by_tutorial: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> Path:
    """The current folder of a page: what demo and tutorial left, and the files that pages call `my` and `rig.toml`.

    Those of BEGIN_EMPTY begin in an empty one.
    """
    monkeypatch.chdir(tmp_path)
    callspec = getattr(request.node, "callspec", None)
    if callspec is not None and callspec.params["page"] in BEGIN_EMPTY:
        return tmp_path
    shutil.copytree(left_by_tutorial, tmp_path, dirs_exist_ok=True)
    shutil.copytree(demo_run[0], tmp_path / "demo", ignore=shutil.ignore_patterns("wires", "lock", "result.json"))
    for source, own in STARTS.items():
        shutil.copy(source, tmp_path / own)
    assert invoke("export", "my.journal", "--out", "my.h5").returncode == 0
    return tmp_path


@pytest.mark.parametrize("page", CASES)
def test_the_blocks_of_a_page_run(page: Path, folder: Path) -> None:
    assert run_page(page) > 0


def test_every_block_has_a_language_that_is_checked_and_commands_that_are_known() -> None:
    for page in pages():
        for block in blocks(page):
            assert block.language in LANGUAGES, f"{block}: {block.language!r}: none of {', '.join(sorted(LANGUAGES))}"
            for words in block.lines:
                if words[0] == "goniotwin":
                    check_options(str(block), words[1:])


def test_the_commands_in_sentences_are_known_with_their_options() -> None:
    found = [(page, span) for page in pages() for span in SPAN.findall(page.read_text(encoding="utf-8"))]
    assert len(found) > 50
    for page, span in found:
        check_options(f"{name(page)}: `{span}`", span.split()[1:])


def check_options(where: str, words: list[str]) -> None:
    """Fails where there is no such command or option."""
    command: Any = typer.main.get_command(app)
    while words and hasattr(command, "commands") and re.fullmatch(r"[a-z][a-z0-9-]*", words[0]):
        assert words[0] in command.commands, f"{where}: there is no command {words[0]}"
        command, words = command.commands[words[0]], words[1:]
    known = {"--help", *(option for each in command.params for option in (*each.opts, *each.secondary_opts))}
    for option in re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", " ".join(words)):
        assert option in known, f"{where}: there is no option {option}"


def test_the_blocks_of_json_and_toml_can_be_read() -> None:
    for page in pages():
        for block in blocks(page):
            if block.mark.startswith("not run"):
                continue
            if block.language == "toml":
                tomllib.loads(block.text)
            if block.language == "json":
                for part in [block.text] if block.text.count("\n{") == 0 else block.text.splitlines():
                    json.loads(part)


def report() -> str:
    """By page what runs, and each command that does not, with its reason: `python -m tests.docs.test_snippets`."""
    lines = []
    for page in pages():
        found = blocks(page)
        commands = [(block, words, block.reason(words)) for block in found for words in block.lines]
        snippets = sum(block.language == "python" and block.runs for block in found)
        tables = sum(block.language in ("toml", "json") for block in found)
        late = takes_long(page)
        if found:
            running = sum(not reason for _, _, reason in commands)
            lines.append(f"{name(page):40} {running:4} commands {snippets:3} Python {tables:3} TOML, JSON{'  (long)' * late}")
        lines += [f"    line {block.line}: {shlex.join(words)[:80]}: {reason}" for block, words, reason in commands if reason]
    return "\n".join(lines)


if __name__ == "__main__":
    print(report())
