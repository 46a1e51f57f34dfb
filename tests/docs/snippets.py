"""The blocks of README and site: commands, Python, TOML, JSON; and the running of a page's blocks in their order.

A comment above a block, `<!-- not run: REASON -->`, keeps it from running where it cannot: a real port, another shell.
`<!-- status 2 -->` is the exit status of its last command. `<!-- output -->` above a block of text: its lines are in the output
of the block before, in this order. `<!-- file NAME -->`: the block is the content of that file. `make test-long` runs them.

Without a mark these are not run, only held against the commands and options that there are: a synopsis, which is a line with
brackets or with a word in capitals in the place of a file; and what opens a window or serves until it is stopped. Lines of
other programs are not run.

    python -m tests.docs.snippets PAGE...

runs pages in the current folder: Python in this process, and the command `goniotwin` that is on the path.
"""

import contextlib
import doctest
import io
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.conftest import REPOSITORY
from tests.system.command import Call, invoke

README = REPOSITORY / "README.md"
DOCS = REPOSITORY / "docs"
FENCE = re.compile(r"^( *)(`{3,})([^\n`]*)\n(.*?)^ *\2 *$", re.DOTALL | re.MULTILINE)
MARK = re.compile(r"<!-- (not run: [^>]+|output|status \d+|file \S+) -->\s*\Z")
SYNOPSIS = re.compile(r"^[A-Z]{2,}|[\[\]|]|^\.\.\.$")
SERVING = ("serve", "station", "usb")
LANGUAGE = {"pycon": "python"}
COMMAND_LANGUAGES = ("sh", "bash", "console", "powershell", "bat")


@dataclass(frozen=True)
class Block:
    """A block of a page: its line there, its language, its text without indentation, and the mark above it."""

    page: Path
    line: int
    language: str
    text: str
    mark: str

    def __str__(self) -> str:
        return f"{self.page.relative_to(REPOSITORY).as_posix()}:{self.line}"

    @property
    def lines(self) -> list[list[str]]:
        """The words of each command line, without a prompt and comments."""
        text = self.text.replace("\\\n", " ") if self.language in COMMAND_LANGUAGES else ""
        if self.language == "powershell":
            text = text.replace("\\", "/")
        return [words for line in text.splitlines() if (words := shlex.split(line.removeprefix("$ "), comments=True))]

    def reason(self, words: list[str]) -> str:
        """Why a command line is not run; empty for one that is."""
        if self.mark.startswith("not run"):
            return self.mark.removeprefix("not run: ")
        if words[0] != "goniotwin":
            return f"the program {words[0]}"
        if words[1:] in (["--version"], ["--help"]):
            return ""
        if any(SYNOPSIS.search(word) for word in words):
            return "a synopsis"
        command = next((word for word in words[1:] if not word.startswith("-")), "desktop")
        return {"desktop": "opens a window"}.get(command, "serves until it is stopped" if command in SERVING else "")

    @property
    def runs(self) -> bool:
        """Whether something of the block is run."""
        if self.language == "python":
            return not self.mark.startswith("not run")
        return any(not self.reason(words) for words in self.lines)


def pages() -> list[Path]:
    return [README, *sorted(DOCS.rglob("*.md"))]


def blocks(page: Path) -> list[Block]:
    """The fenced blocks of a page in their order. A block without a language has the language `""`."""
    text = page.read_text(encoding="utf-8")
    return [
        Block(
            page,
            text.count("\n", 0, match.start()) + 1,
            LANGUAGE.get(name := match[3].strip(), name),
            unindented(match[4], match[1]),
            mark_before(text[: match.start()]),
        )
        for match in FENCE.finditer(text)
        if not match[3].startswith("{")
    ]


def without_fences(page: Path) -> str:
    """The text of a page between its fenced blocks."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def unindented(text: str, indent: str) -> str:
    return "".join(line.removeprefix(indent) for line in text.splitlines(keepends=True))


def mark_before(text: str) -> str:
    match = MARK.search(text)
    return match[1] if match else ""


def toml_parts(page: Path, files: dict[str, tuple[set[str], Path]]) -> Iterator[tuple[str, dict[str, Any]]]:
    """The TOML blocks of a page that are parts of our files, each with the rest of an example: kind and content.

    `files` has by kind the keys of a whole file, and an example. A block belongs to the first kind that has all of its keys.
    """
    for block in blocks(page):
        if block.language != "toml" or block.mark.startswith("not run"):
            continue
        content = tomllib.loads(block.text)
        kind = next((kind for kind, (known, _) in files.items() if content.keys() <= known), None)
        assert kind is not None, f"{block}: its keys {sorted(content)} are of no file; mark it as not run, with the reason"
        whole = tomllib.loads(files[kind][1].read_text(encoding="utf-8"))
        for key, value in content.items():
            whole[key] = {**whole.get(key, {}), **value} if isinstance(value, dict) else value
        yield kind, whole


def run_page(page: Path, outputs: list[str] | None = None, call: Call = invoke) -> int:
    """Run the blocks of a page in the current folder, in order; returns the number of commands and blocks of Python.

    `outputs` gets what each command prints. `call` runs a command.
    """
    names: dict[str, Any] = {}
    count = 0
    output = ""
    for block in blocks(page):
        if block.mark == "output":
            check_output(block, output)
        elif block.mark.startswith("file "):
            Path(block.mark.removeprefix("file ")).write_text(block.text, encoding="utf-8")
        elif block.runs and block.language == "python":
            output = run_python(block, names)
            count += 1
        elif block.runs:
            commands = [words for words in block.lines if not block.reason(words)]
            done = [call(*words[1:]) for words in commands]
            expected = int(block.mark.removeprefix("status ")) if block.mark.startswith("status") else 0
            for words, each in zip(commands, done, strict=True):
                status = expected if each is done[-1] else 0
                assert each.returncode == status, f"{block}: {shlex.join(words)}: {each.returncode}\n{each.stderr}"
            output = "".join(each.stdout for each in done)
            if outputs is not None:
                outputs += [each.stdout for each in done]
            count += len(done)
    return count


def run_python(block: Block, names: dict[str, Any]) -> str:
    """Run a block of Python, as an example with `>>>` or as it is; returns what it prints."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        if ">>> " in block.text:
            example = doctest.DocTestParser().get_doctest(block.text, names, str(block), str(block.page), block.line)
            doctest.DocTestRunner(verbose=False).run(example, clear_globs=False)
            failed = [line for line in printed.getvalue().splitlines() if line]
            names.update(example.globs)
            assert not failed, "\n".join(failed)
        else:
            exec(compile(block.text, str(block), "exec"), names)
    return printed.getvalue()


def check_output(block: Block, output: str) -> None:
    """Each line of a block of text is in the output, in this order. Spaces count as one; a line `...` stands for some lines."""
    lines = [" ".join(line.split()) for line in output.splitlines()]
    place = 0
    for line in filter(None, (" ".join(line.split()) for line in block.text.splitlines())):
        if line not in ("...", "…"):
            assert line in lines[place:], f"{block}: {line!r} is not in the output there:\n{output}"
            place = lines.index(line, place) + 1


def installed(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command `goniotwin` that is on the path."""
    return subprocess.run(["goniotwin", *map(str, arguments)], capture_output=True, text=True, check=False)


if __name__ == "__main__":
    for each in sys.argv[1:]:
        print(each, run_page(REPOSITORY / each, call=installed), flush=True)
