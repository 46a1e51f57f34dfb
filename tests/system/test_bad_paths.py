"""Every path that a command takes, given a bad one: one line with what, where and the remedy, and status 2.

The commands and their paths are those of the command line itself: a new one without a case fails the test.
"""

import inspect
import multiprocessing
import os
import re
import shutil
import sys
import tempfile
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path

import pytest
import typer
from typer.main import get_command_name

from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from tests.conftest import REPOSITORY, RIG, SCHEDULE
from tests.system.command import invoke
from tests.system.full_disks import PAGE, small_disks

JOURNAL = REPOSITORY / "tests" / "golden" / "data" / "finished.journal"
STUDY = REPOSITORY / "examples" / "tolerances" / "quick.toml"
TWO_PATHS = {"compare": ("first", "second")}
"""Paths that are texts on the command line, since they may be something else."""
IN_THE_WINDOW = {("desktop", "rig"), ("desktop", "schedule"), ("desktop", "out")}
"""Paths whose faults the window shows (tests/app/desktop)."""
NOT_STOPPED = {("run", "transcript"), ("demo", "transcript"), ("serve", "ptys"), ("verify-device", "transcript")}
"""What a full disk does not stop: the measurement goes on without its transcript, and links need no room."""
if find_spec("mitsuba") is None:
    NOT_STOPPED.add(("render", "out"))  # there is no picture to write
ANOTHER_USER = 65_534


@dataclass(frozen=True)
class Case:
    """Arguments of a command, with `{path}` in the place of a path that it reads, or writes (`out`): a file, or a `folder`."""

    command: str
    parameter: str
    arguments: str
    out: bool = False
    folder: bool = False
    suffix: str = ""

    def run(self, path: Path) -> str:
        """Run the command in this process; what is wrong with its answer, else empty."""
        given = {"JOURNAL": JOURNAL, "RIG": RIG, "SCHEDULE": SCHEDULE, "STUDY": STUDY, "{path}": path, "TABLE": "table.ddr"}
        done = invoke(*self.command.split(), *(given.get(each, each) for each in self.arguments.split()))
        lines = [line for line in done.stderr.splitlines() if line.startswith(("goniotwin: ", "Traceback"))]
        lines = [line for line in lines if not line.startswith("goniotwin: preparing the virtual rig of")]  # a note
        named = str(path.parent if self.out else path)  # a full disk is that of the folder
        proper = len(lines) == 1 and "unexpected error" not in lines[0] and named in lines[0]
        proper = proper and ("; " in lines[0] or re.search(r"\. See: goniotwin .*--help$", lines[0]) is not None)
        good = proper and done.returncode == UserError.status
        return "" if good else f"{self.command} {self.arguments}: {path}: {done.returncode} {done.stderr}"


def read(command: str, parameter: str, arguments: str, *, folder: bool = False) -> Case:
    return Case(command, parameter, arguments, folder=folder)


def write(command: str, parameter: str, arguments: str, suffix: str = "", *, folder: bool = False) -> Case:
    return Case(command, parameter, arguments, out=True, folder=folder, suffix=suffix)


NEW = "--template plane --sample gaussian-5 --target-u 0.1 --longest-h 1"
CASES = [
    read("devices", "rig", "--rig {path}"),
    read("home", "rig", "--rig {path}"),
    read("here", "rig", "beta 0 --rig {path}"),
    read("move", "rig", "beta 0 --rig {path}"),
    read("read", "rig", "--rig {path}"),
    read("station", "rig", "--rig {path}"),
    read("new", "rig", f"none.toml --rig {{path}} {NEW}"),
    write("new", "schedule", f"{{path}} --rig RIG {NEW}", ".toml"),
    read("check", "schedule", "{path} --rig RIG"),
    read("check", "rig", "SCHEDULE --rig {path}"),
    read("rehearse", "schedule", "{path} --rig RIG"),
    read("rehearse", "rig", "SCHEDULE --rig {path}"),
    write("rehearse", "out", "SCHEDULE --rig RIG --out {path}", ".journal"),
    write("rehearse", "points", "SCHEDULE --rig RIG --points {path}", ".csv"),
    read("prove", "schedule", "{path} --rig RIG"),
    read("prove", "rig", "SCHEDULE --rig {path}"),
    write("prove", "out", "SCHEDULE --rig RIG --rigs 1 --out {path}", folder=True),
    read("run", "schedule", "{path} --rig RIG --out none.journal"),
    read("run", "rig", "SCHEDULE --rig {path} --out none.journal"),
    write("run", "out", "SCHEDULE --rig RIG --out {path}", ".journal"),
    read("run", "resume", "--resume {path}"),
    write("run", "transcript", "SCHEDULE --rig RIG --out none.journal --transcript {path}", folder=True),
    read("runs", "folder", "{path}", folder=True),
    read("export", "journal", "{path} --out none.csv"),
    write("export", "out", "JOURNAL --out {path}", ".csv"),
    read("convert", "source", "{path} none.csv"),
    write("convert", "out", "JOURNAL {path}", ".ddr"),
    read("info", "file", "{path}"),
    read("budget", "journal", "{path} --at theta=1,phi=0"),
    read("align", "journal", "{path}"),
    write("align", "output", "JOURNAL --output {path}", ".toml"),
    read("align", "rig", "SCHEDULE --plan --minutes 5 --rig {path}"),
    read("verify", "journal", "{path}"),
    read("closure", "journal", "{path}"),
    read("copy", "journal", "{path} none.journal"),
    write("copy", "file", "JOURNAL {path}", ".journal"),
    read("plot", "data", "{path} --out none.png"),
    write("plot", "out", "JOURNAL --out {path}", ".png"),
    read("compare", "first", "{path} theory"),
    read("compare", "second", "JOURNAL {path}"),
    write("compare", "out", "JOURNAL theory --out {path}", ".png"),
    read("report", "journal", "{path}"),
    write("report", "out", "JOURNAL --out {path}", ".html"),
    read("render", "first", "{path} TABLE --out none.png"),
    read("render", "second", "TABLE {path} --out none.png"),
    write("render", "out", "TABLE TABLE --out {path}", ".png"),
    read("serve", "rig", "--rig {path}"),
    write("serve", "write_rig", "--rig RIG --write-rig {path}", ".toml"),
    write("serve", "ptys", "--rig RIG --ptys {path}", folder=True),
    read("usb", "rig", "--rig {path} -- none.py"),
    read("usb", "program", "--rig RIG {path}"),
    read("replay", "transcripts", "{path} --rig RIG"),
    read("replay", "rig", "none.txt --rig {path}"),
    read("tolerances", "study", "{path}"),
    write("tolerances", "out", "STUDY --out {path}", folder=True),
    read("simulate sample", "rig", "--sample lambertian:reflectance=0.9 --out none.csv --rig {path}"),
    read("simulate sample", "source", "--sample lambertian:reflectance=0.9 --out none.csv --estimator forward --source {path}"),
    write("simulate sample", "out", "--sample lambertian:reflectance=0.9 --rays 64 --out {path}", ".csv"),
    write(
        "simulate sample",
        "folder",
        "--sample lambertian:reflectance=0.9 --estimator forward --out none.csv --paths 1000 --folder {path}",
        folder=True,
    ),
    read("simulate rigs", "rig", "--sample lambertian:reflectance=0.9 --out none.csv --rig {path}"),
    write("simulate rigs", "out", "--sample lambertian:reflectance=0.9 --rigs 1 --out {path}", ".csv"),
    write(
        "simulate rigs",
        "folder",
        "--sample lambertian:reflectance=0.9 --rigs 1 --out none.csv --folder {path}",
        folder=True,
    ),
    read("simulate illumination", "rig", "--out none.csv --rig {path}"),
    write("simulate illumination", "out", "--error 0.5 --out {path}", ".csv"),
    write("simulate illumination", "rayset", "--error 0.5 --out none.csv --rays 1000 --rayset {path}", ".h5"),
    write("simulate table3", "out", "--out {path}", folder=True),
    read("simulate shadow", "rig", "--out none.csv --rig {path}"),
    write("simulate shadow", "out", "--step 10 --out {path}", ".csv"),
    write("demo", "out", "--out {path}", folder=True),
    write("demo", "transcript", "--out none --transcript {path}", folder=True),
    read("doctor", "rig", "--rig {path}"),
    read("verify-device", "rig", "--rig {path}"),
    write("verify-device", "report", "monitor --rig RIG --report {path}", ".txt"),
    write("verify-device", "transcript", "monitor --rig RIG --transcript {path}", folder=True),
    write("examples", "folder", "{path}", folder=True),
    write("schema", "out", "rig --out {path}", ".json"),
]


def paths_of_commands(group: typer.Typer = app, above: str = "") -> Iterator[tuple[str, str]]:
    """Each command with each parameter that is a path."""
    for each in group.registered_groups:
        assert each.typer_instance is not None
        below = f"{above} {each.name}".strip() if isinstance(each.name, str) else above
        yield from paths_of_commands(each.typer_instance, below)
    found = [
        (each.name or get_command_name(each.callback.__name__), each.callback)
        for each in group.registered_commands
        if each.callback
    ]
    if above and group.registered_callback is not None and group.registered_callback.callback is not None:
        found.append(("", group.registered_callback.callback))
    for name, callback in found:
        command = f"{above} {name}".strip()
        for parameter, kind in typing.get_type_hints(callback).items():
            if parameter in inspect.signature(callback).parameters and "Path" in str(kind):
                yield command, parameter
        yield from ((command, parameter) for parameter in TWO_PATHS.get(command, ()))


def test_every_path_of_every_command_has_a_case() -> None:
    assert sorted(set(paths_of_commands())) == sorted({(each.command, each.parameter) for each in CASES} | IN_THE_WINDOW)


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The working folder, which every user can read, with a table."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        monkeypatch.chdir(name)
        assert invoke("convert", JOURNAL, "table.ddr").returncode == 0
        yield Path(name)


def wrong_paths(case: Case, folder: Path) -> Iterator[Path]:
    """Paths that a command cannot read or write: missing, a folder in the place of a file, a file in the place of a folder."""
    if case.folder:
        file = folder / "file"
        file.touch()
        yield from (file, file / "below")
        return
    yield folder / "missing" / f"a{case.suffix}"
    there = folder / f"folder{case.suffix}"
    there.mkdir(exist_ok=True)
    yield there


def closed_path(case: Case, folder: Path) -> Path:
    """What a command may not read, or a place in a folder that it may not write to."""
    closed = folder / ("closed-folder" if case.folder or case.out else "closed-file")
    if not closed.exists():
        if case.folder or case.out:
            closed.mkdir()
        else:
            closed.touch()
        closed.chmod(0o500 if case.out else 0)
    return closed / f"a{case.suffix}" if case.out else closed


@pytest.mark.parametrize("command", sorted({each.command for each in CASES}))
def test_a_missing_file_and_a_folder_in_its_place_are_one_line(command: str, folder: Path) -> None:
    cases = [each for each in CASES if each.command == command]
    assert [fault for case in cases for path in wrong_paths(case, folder) if (fault := case.run(path))] == []


@pytest.mark.parametrize("command", sorted({each.command for each in CASES if not each.folder and not each.out}))
def test_an_empty_path_is_one_line(command: str, folder: Path) -> None:
    """As of a script's variable without a value: the folder where it runs."""
    cases = [each for each in CASES if each.command == command and not each.folder and not each.out]
    assert [fault for case in cases if (fault := case.run(Path()))] == []


def faults_without_permission(pipe: Connection, folder: Path) -> None:
    """Run all commands without the permission to read or write what they are given; send what is wrong with their answers.

    A process of the system's administrator, which may do everything, becomes one of another user.
    """
    os.chdir(folder)
    if os.geteuid() == 0:
        for case in CASES:  # so that each has loaded what another user may not be able to read
            case.run(next(wrong_paths(case, folder)))
        own = folder / "own"
        own.mkdir()
        os.chown(own, ANOTHER_USER, ANOTHER_USER)
        os.environ.update(TMPDIR=str(own), XDG_STATE_HOME=str(own))
        tempfile.tempdir = None
        paths = [(case, closed_path(case, folder)) for case in CASES]
        os.chdir(own)
        shutil.copy(folder / "table.ddr", own)
        os.setgroups([])
        os.setgid(ANOTHER_USER)
        os.setuid(ANOTHER_USER)
    else:
        paths = [(case, closed_path(case, folder)) for case in CASES]
    pipe.send([fault for case, path in paths if (fault := case.run(path))])


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="a folder has no permissions that refuse its owner")
def test_an_unreadable_file_and_a_read_only_folder_are_one_line(folder: Path) -> None:
    context = multiprocessing.get_context("forkserver")
    ours, theirs = context.Pipe()
    process = context.Process(target=faults_without_permission, args=(theirs, folder))
    process.start()
    theirs.close()
    assert ours.recv() == []
    process.join()


@pytest.mark.long
def test_a_full_disk_is_one_line(folder: Path) -> None:
    place = folder / "disk"
    place.mkdir()
    with small_disks(place) as disk:
        if disk is None:
            pytest.skip("mounting a disk is not permitted here")
        found = []
        for case in CASES:
            if case.out:
                (disk(PAGE) / "filled").write_bytes(bytes(PAGE))
                found.append(case.run(place / f"a{case.suffix}"))
        assert list(filter(None, found)) == []
