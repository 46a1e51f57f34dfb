"""Each command and each snippet of README and site runs, on what the demo and the tutorial left, or states why it cannot."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer.main

from goniotwin.app.cli.main import app
from tests.conftest import REPOSITORY
from tests.docs.snippets import COMMAND_LANGUAGES, DOCS, README, Block, blocks, pages, without_fences
from tests.test_package import wheel as wheel  # a fixture


def name(page: Path) -> str:
    return page.relative_to(REPOSITORY).as_posix()


pytestmark = pytest.mark.xdist_group("pages")
TUTORIAL = DOCS / "tutorial.md"
LEAVING = (README, TUTORIAL)
"""They run one after the other in an empty folder. The other pages begin with what they leave, but for BEGIN_EMPTY."""
BEGIN_EMPTY = (DOCS / "install.md", DOCS / "operate" / "procedures.md", DOCS / "rig" / "arrival.md")
OTHERS = [page for page in pages() if page not in LEAVING and any(block.runs for block in blocks(page))]
Run = Callable[..., str]
"""Runs a command in a folder, and returns what it prints."""
LANGUAGES = {*COMMAND_LANGUAGES, "python", "toml", "json", "text", "mermaid", "sql"}
SPAN = re.compile(r"(?<!`)`(goniotwin (?!rayset`)[a-z][^`]*)`(?!`)")  # `goniotwin rayset` is the name of a file format


@pytest.fixture(scope="session")
def run_installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """The commands are those of the program of an installed wheel, and Python has its package."""
    prefix = tmp_path_factory.mktemp("installed")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--disable-pip-version-check"]
    subprocess.run([*pip, "--target", str(prefix), str(wheel)], check=True)
    environment = {
        **os.environ,
        "MPLBACKEND": "Agg",
        "PATH": os.pathsep.join([str(prefix / "bin"), os.environ["PATH"]]),
        "PYTHONPATH": os.pathsep.join([str(prefix), str(REPOSITORY)]),  # the tests are in the repository
    }

    def run(folder: Path, *command: str) -> str:
        done = subprocess.run(
            [sys.executable, *command], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    assert Path(run(prefix, "-c", "import goniotwin; print(goniotwin.__file__)").strip()).is_relative_to(prefix)
    return run


@pytest.fixture(scope="session")
def left(run_installed: Run, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that README and tutorial leave. Tests only read it."""
    folder = tmp_path_factory.mktemp("left")
    run_installed(folder, "-m", "tests.docs.snippets", *map(name, LEAVING))
    return folder


@pytest.mark.long
def test_readme_and_tutorial_run_in_an_empty_folder(left: Path) -> None:
    assert (left / "demo" / "first.journal").exists()
    assert (left / "first.journal").exists()


@pytest.mark.long
@pytest.mark.parametrize("page", OTHERS, ids=name)
def test_the_blocks_of_a_page_run(page: Path, run_installed: Run, left: Path, tmp_path: Path) -> None:
    if page not in BEGIN_EMPTY:
        shutil.copytree(left, tmp_path, dirs_exist_ok=True)
    _name, count = run_installed(tmp_path, "-m", "tests.docs.snippets", name(page)).split()
    assert int(count) > 0


def test_every_block_has_a_language_that_is_checked_and_commands_that_are_known() -> None:
    for page in pages():
        for block in blocks(page):
            assert block.language in LANGUAGES, f"{block}: {block.language!r}: none of {', '.join(sorted(LANGUAGES))}"
            for words in block.lines:
                if words[0].rpartition("/")[2] == "goniotwin":
                    check_options(str(block), words[1:])


def test_no_command_is_in_an_indented_block_or_in_a_block_of_text() -> None:
    """There it would not be run."""
    commands = "|".join(typer.main.get_command(app).commands)  # type: ignore[attr-defined]  # a group has them
    line = re.compile(rf"^ *(?:\$ )?goniotwin (?:--version|(?:{commands})(?: |$))", re.MULTILINE)
    for page in pages():
        assert [block for block in blocks(page) if not block.lines and line.search(block.text)] == []
        indented = [each for each in without_fences(page).splitlines() if each.startswith("    ")]
        assert [each for each in indented if line.search(each)] == [], page


def test_each_block_of_python_can_be_compiled_also_one_that_is_not_run() -> None:
    found = [block for page in pages() for block in blocks(page) if block.language == "python" and not block.runs]
    assert found
    for block in found:
        compile(block.text, str(block), "exec")


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
    known = {"--help", "--log-file", *(option for each in command.params for option in (*each.opts, *each.secondary_opts))}
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


def counted(block: Block) -> int:
    """How many commands and snippets of a block are run."""
    return int(block.language == "python" and block.runs) + sum(not block.reason(words) for words in block.lines)


def report() -> str:
    """By page what runs, and each command that does not, with its reason: `python -m tests.docs.test_snippets`."""
    lines = []
    run = 0
    reasons: dict[str, int] = {}
    for page in pages():
        found = blocks(page)
        commands = [(block, shlex.join(words)[:80], block.reason(words)) for block in found for words in block.lines]
        unused = [block for block in found if block.language == "python" and not block.runs]
        commands += [(block, "Python", block.mark.removeprefix("not run: ")) for block in unused]
        snippets = sum(block.language == "python" and block.runs for block in found)
        tables = sum(block.language in ("toml", "json") for block in found)
        run += sum(map(counted, found))
        if found:
            running = sum(not reason for _, _, reason in commands)
            lines.append(f"{name(page):40} {running:4} commands {snippets:3} Python {tables:3} TOML, JSON")
        lines += [f"    line {block.line}: {text}: {reason}" for block, text, reason in commands if reason]
        for reason in (reason for _, _, reason in commands if reason):
            reasons[reason] = reasons.get(reason, 0) + 1
    lines.append(f"run: {run}; not run: {sum(reasons.values())}")
    lines += [f"    {count:3} {reason}" for reason, count in sorted(reasons.items())]
    return "\n".join(lines)


if __name__ == "__main__":
    print(report())
