"""The command line: the order of its commands, the cost of its help, and the message after Ctrl-C."""

import io
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import platformdirs
import pytest

from goniotwin.app.campaign.running.events import Event, RowStarted
from goniotwin.app.cli.main import COMMANDS, INTERRUPTED, app, main, run_command
from goniotwin.app.cli.work import device_search
from goniotwin.app.cli.work.row_progress import RowProgress
from goniotwin.drivers import DeviceError, Rig
from tests.conftest import REPOSITORY, RIG, SCHEDULE, Writer
from tests.system.command import goniotwin, invoke

HEAVY = ("numpy", "numba", "PySide6", "matplotlib", "h5py", "rich")
"""What the help of a command does without."""
HEAVIER = (*HEAVY, "pydantic", "importlib.metadata")
"""What the help of the program does without."""
LIGHT = (
    "numba",
    "llvmlite",
    "scipy",
    "PySide6",
    "matplotlib",
    "h5py",
    "rich",
    "pymodbus",
    "asyncio",
    "concurrent",
    "usb",
    "tomlkit",
    "filelock",
    "goniotwin.twin.plant.plant",
    "goniotwin.twin.devices.adam",
    "goniotwin.drivers.rig",
    "goniotwin.twin.optics.forward.estimator",
    "goniotwin.app.formats.registry",
)
"""What a command without light and devices does without."""
TABLE = """
import sys
from goniotwin.app.cli.main import app

app(["simulate", "sample", *sys.argv[1:]], standalone_mode=False)
loaded = [name for name in ("matplotlib", "h5py") if name in sys.modules]
assert not loaded, loaded
"""
HELP = f"""
import sys
from goniotwin.app.cli.main import app

for command in sys.argv[1:]:
    app([*command.split(), "--help"], standalone_mode=False)
    loaded = [name for name in ({HEAVY} if command else {HEAVIER}) if name in sys.modules]
    assert not loaded, (command, loaded)
"""
CHECK = f"""
import sys
from goniotwin.app.cli.main import app

app(["check", *sys.argv[1:]], standalone_mode=False)
loaded = [name for name in {LIGHT} if name in sys.modules]
assert not loaded, loaded
"""
HOST = """
import contextlib, logging, os, signal, sys, threading
from goniotwin.app.cli.main import app
from goniotwin.app.station import process

schedule, rig = sys.argv[1:]
numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
sys.excepthook = lambda *error: sys.__excepthook__(*error)
threading.excepthook = lambda _: None
for number in numbers:
    signal.signal(number, lambda *_: None)

def state():
    logs = [logging.getLogger(name) for name in (None, "goniotwin.compilation", "pymodbus.logging")]
    return [
        sys.excepthook, threading.excepthook, *map(signal.getsignal, numbers), signal.set_wakeup_fd(-1),
        sys.stdout.errors, sys.stderr.errors, *[(log.handlers[:], log.level, log.propagate, log.disabled) for log in logs],
    ]

before = state()
for command in (
    ["--version"], ["schema", "rig", "--out", "a.json"], ["info", "nothing.csv"], ["check", "--no-such-option"],
    ["check", schedule, "--rig", rig], ["run", schedule, "--rig", rig, "--out", "a.journal"],
    ["export", "a.journal", "--out", "a.csv"],
):
    try:
        app(command, standalone_mode=False)
    except Exception as error:
        assert "nothing.csv" in command or "--no-such-option" in command, error
    assert state() == before, command
note = process.Station.serve
process.Station.serve = lambda station: (os.kill(os.getpid(), signal.SIGTERM), note(station))
with contextlib.suppress(SystemExit):
    app(["station", "--rig", rig])
assert state() == before
print("kept")
"""
LATE_CTRL_C = """
import os, signal
from goniotwin.app.cli import main

class Last:
    kill, number, process = os.kill, signal.SIGINT, os.getpid()
    def __del__(self):  # while the interpreter ends, after it has restored the system's handlers
        Last.kill(Last.process, Last.number)

last = Last()
main.run_command = lambda: 1
main.main()
"""
JOURNAL = REPOSITORY / "tests" / "golden" / "data" / "finished.journal"
SUBCOMMANDS = ("simulate sample", "simulate rigs", "simulate illumination", "simulate table3", "simulate shadow")


def test_help_lists_the_commands_in_the_order_of_a_day(capsys: pytest.CaptureFixture[str]) -> None:
    app(["--help"], standalone_mode=False)
    lines = capsys.readouterr().out.partition("Commands:")[2].splitlines()
    assert tuple(line.split()[0] for line in lines if line) == COMMANDS


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("re", {"read", "rehearse", "report", "render", "replay"}),
        ("simulate s", {"sample", "shadow"}),
        ("simulate sample --sa", {"--sample"}),
        ("--v", {"--version"}),
    ],
)
def test_a_shell_completes_commands_and_options(words: str, expected: set[str]) -> None:
    """As the script of --show-completion asks."""
    wanted = {
        "_GONIOTWIN_COMPLETE": "complete_bash",
        "COMP_WORDS": f"goniotwin {words}",
        "COMP_CWORD": str(words.count(" ") + 1),
    }
    program = [str(Path(sys.executable).with_name("goniotwin"))]
    done = subprocess.run(program, env={**os.environ, **wanted}, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr, set(done.stdout.split())) == (0, "", expected)


def test_simulate_without_the_name_of_a_command_is_that_of_a_sample(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--sample", "lambertian", "--sigma", "30", "--polar", "0,40", "--azimuth", "0,90"]
    for name, command in (("old", ["simulate"]), ("new", ["simulate", "sample"])):
        app([*command, *options, "--out", str(tmp_path / f"{name}.csv")], standalone_mode=False)
    capsys.readouterr()
    old, new = ((tmp_path / f"{name}.csv").read_bytes() for name in ("old", "new"))
    assert old == new
    app(["simulate", "--help"], standalone_mode=False)
    assert "--sample" not in capsys.readouterr().out


def test_help_fits_a_terminal_of_80_columns(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """No line is longer, and the sentence of no command is cut off."""
    monkeypatch.setenv("COLUMNS", "80")
    for name in ("", *COMMANDS, *SUBCOMMANDS):
        app([*name.split(), "--help"], standalone_mode=False)
        text = capsys.readouterr().out
        assert max(map(len, text.splitlines())) <= 80, name
        for line in text.partition("Commands:")[2].splitlines():
            assert not line.endswith("..."), line


def test_help_loads_no_heavy_library() -> None:
    done = subprocess.run(
        [sys.executable, "-c", HELP, "", *COMMANDS, *SUBCOMMANDS], capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_check_loads_no_compiler_and_nothing_that_draws() -> None:
    """Some hundred questions about shadows are answered in less time than it takes to load numba."""
    command = [sys.executable, "-c", CHECK, str(SCHEDULE), "--rig", str(RIG)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "blocked" in done.stdout


def test_a_table_is_simulated_without_what_draws(tmp_path: Path) -> None:
    sample = ["--sample", "lambertian", "--sigma", "30", "--polar", "0,30", "--azimuth", "0,90", "--out", "table.csv"]
    command = [sys.executable, "-c", TABLE, *sample]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            "plot a --out a.png --sigma 30,60",
            "unable to parse string as a number; for several values repeat the option: --sigma A --sigma B. "
            "See: goniotwin plot --help\n",
        ),
        ("simulate sample --zzz", "No such option: --zzz. See: goniotwin simulate sample --help\n"),
        (
            "budget a.journal --reflectance",
            "Missing option '--at': Direction: sigma=30,zenith=35,azimuth=180, or theta and phi. With --reflectance: sigma=30. "
            "Add sample, wavelength, gamma, light or photodiode if the journal has several. See: goniotwin budget --help\n",
        ),
        ("plott", "No such command 'plott'. Did you mean 'plot'? See: goniotwin --help\n"),
    ],
)
def test_arguments_that_do_not_parse_point_to_the_help_of_their_command(
    arguments: str, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["goniotwin", *arguments.split()])
    assert run_command() == 2
    assert capsys.readouterr().err.endswith(message)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a display")
def test_without_a_display_the_window_is_one_line_and_status_2(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
        monkeypatch.delenv(name, raising=False)
    done = goniotwin()
    assert done.returncode == 2
    assert done.stderr.startswith("goniotwin: the window needs a display, and DISPLAY and WAYLAND_DISPLAY are not set; ")
    assert done.stderr.count("\n") == 1


def test_ctrl_c_in_a_command_is_one_line_and_status_130(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(device_search, "find_devices", interrupt)
    assert app(["devices"], standalone_mode=False) == INTERRUPTED
    assert capsys.readouterr().err == "goniotwin: stopped\n"


@pytest.mark.skipif(sys.platform == "win32", reason="this system sends no signals to a process")
def test_ctrl_c_after_the_end_of_a_command_leaves_its_status() -> None:
    done = subprocess.run([sys.executable, "-c", LATE_CTRL_C], capture_output=True, text=True, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_safety_order_is_printed_at_once_and_at_the_end_and_again_before_a_resume(
    write_schedule: Writer, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C in a row, and no stop is confirmed."""
    show = RowProgress.__call__

    def interrupt(progress: RowProgress, event: Event) -> None:
        show(progress, event)
        if isinstance(event, RowStarted) and event.row.number == 4:
            raise KeyboardInterrupt

    order = "SAFETY: Cut the motors' power: the stop is not confirmed by sigma"
    journal = tmp_path / "a.journal"
    with monkeypatch.context() as patch:
        patch.setattr(RowProgress, "__call__", interrupt)
        patch.setattr(Rig, "stop", lambda _rig: [DeviceError("sigma", "MST", "no reply")])
        arguments = ["run", str(write_schedule()), "--rig", str(RIG), "--out", str(journal), "--json"]
        assert app(arguments, standalone_mode=False) == INTERRUPTED
    shown = capsys.readouterr()
    assert json.loads(shown.out)["orders"] == [order.removeprefix("SAFETY: ")]
    lines = [line for line in shown.err.splitlines() if line.startswith(("goniotwin:", "to continue:"))]
    assert lines == [
        f"goniotwin: {order}",
        "goniotwin: sigma: MST: no reply",
        f"to continue: goniotwin run --resume {journal}",
        f"goniotwin: {order}",
    ]
    assert app(["runs", str(tmp_path)], standalone_mode=False) in (None, 0)
    line = order.replace("SAFETY: ", f"SAFETY: of {journal}, not acknowledged: ")
    shown = capsys.readouterr()
    assert shown.err == f"goniotwin: {line}\n"
    assert " UTC" in " ".join(shown.out.split())
    assert app(["run", "--resume", str(journal), "--accept-rig"], standalone_mode=False) in (None, 0)
    line = order.replace("SAFETY: ", "SAFETY: of the last session, not acknowledged: ")
    assert capsys.readouterr().err.splitlines()[0] == f"goniotwin: {line}"


def test_an_unexpected_error_is_one_line_and_a_file_with_the_details(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError("of the\ntest")

    monkeypatch.setattr(device_search, "find_devices", fail)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    done = invoke("devices")
    assert (done.returncode, done.stdout) == (1, "")
    found = re.fullmatch(r"goniotwin: unexpected error: ZeroDivisionError: of the test; the details are in (.*)\n", done.stderr)
    assert found is not None, done.stderr
    details = Path(found[1])
    assert details.is_relative_to(tmp_path)
    assert re.search(r"'devices'\n.*Traceback .*in fail\n.*ZeroDivisionError", details.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize(
    "arguments",
    [
        "export {} --format csv --out a.csv",
        "export {journal} --format csv --out {}",
        "copy {journal} {}",
        "run {schedule} --rig {rig} --out {}.journal",
        "run --resume {}",
        "rehearse {schedule} --rig {rig} --out {}",
        "check {} --rig {}",
        "runs {}",
    ],
)
def test_a_name_that_no_file_can_have_is_bad_input(arguments: str, write_schedule: Writer) -> None:
    words = arguments.format(*["n" * 300] * 2, journal=JOURNAL, schedule=write_schedule(), rig=RIG).split()
    done = invoke(*words)
    assert done.returncode == 2
    assert re.fullmatch(r"goniotwin: .*File name too long.*; check [^\n]*\n", done.stderr), done.stderr


def test_a_letter_that_the_output_does_not_have_is_replaced(
    write_schedule: Writer, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As in a terminal of Windows, or a file name that is no text."""
    schedule = write_schedule()
    schedule.write_text(schedule.read_text(encoding="utf-8").replace('name = "', 'name = "größe '), encoding="utf-8")
    for arguments in (
        ["check", str(schedule)],
        ["run", str(schedule), "--out", str(tmp_path / "\N{GREEK SMALL LETTER MU}.journal")],
    ):
        out = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
        monkeypatch.setattr(sys, "stdout", out)
        monkeypatch.setattr(sys, "argv", ["goniotwin", *arguments, "--rig", str(RIG)])
        with pytest.raises(SystemExit) as ended:
            main()
        out.seek(0)
        assert ended.value.code == 0
        assert ("gr\\xf6\\xdfe" if arguments[0] == "check" else "\\u03bc.journal") in out.read()


def test_where_no_folder_can_be_written_the_line_has_the_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise MemoryError

    (tmp_path / "file").touch()
    monkeypatch.setattr(device_search, "find_devices", fail)
    monkeypatch.setattr(platformdirs, "user_log_path", lambda name: tmp_path / "file" / name)
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path / "file" / "temporary"))
    done = invoke("devices")
    assert done.returncode == 1
    assert re.fullmatch(
        r"goniotwin: unexpected error: there is not enough memory, at fail, line \d+ of .*test_command_line\.py; "
        r"the details cannot be written to any folder\n",
        done.stderr,
    )


def test_an_error_of_another_thread_or_of_a_slot_is_one_line_too() -> None:
    text = "import sys, threading; from goniotwin.app.cli import main; from goniotwin.app.cli.work import device_search\n"
    text += "def fail(*_):\n"
    text += "    thread = threading.Thread(target=lambda: 1 / 0); thread.start(); thread.join()\n"
    text += "    sys.excepthook(IndexError, IndexError('of a slot'), None); sys.exit(5)\n"
    text += "device_search.find_devices = fail; sys.argv = ['goniotwin', 'devices']; main.main()"
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 5
    assert re.fullmatch(
        r"goniotwin: unexpected error: ZeroDivisionError: division by zero; the details are in .*\n"
        r"goniotwin: unexpected error: IndexError: of a slot; the details are in .*\n",
        done.stderr,
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no device of a full disk")
@pytest.mark.parametrize(
    "arguments", ["--help", "--version", *(pytest.param(each, marks=pytest.mark.long) for each in ("runs .", "schema rig"))]
)
def test_an_output_that_cannot_be_written_is_status_1(arguments: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "goniotwin", *arguments.split()]
    with open("/dev/full", "w") as full:  # noqa: PTH123
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, cwd=tmp_path, text=True, timeout=300, check=False)
    assert done.returncode == 1
    assert done.stderr == "goniotwin: standard output: No space left on device; free space on the disk\n"
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as closed:
        assert closed.stdout is not None
        closed.stdout.close()
        assert closed.communicate()[1] == ""
    assert closed.returncode == 1


@pytest.mark.skipif(os.name == "nt", reason="closes streams by their numbers")
@pytest.mark.parametrize(
    "closed", ["<&- >&- 2>&-", *(pytest.param(each, marks=pytest.mark.long) for each in ("<&-", ">&-", "2>&-"))]
)
def test_closed_standard_streams_lead_nowhere(tmp_path: Path, closed: str) -> None:
    text = "import os, sys; from goniotwin.__main__ import main; sys.argv = ['goniotwin', 'runs', '.']\n"
    text += "try: main()\nexcept SystemExit as end: status = end.code\n"
    text += "with open('first', 'w') as file: print(status, file.fileno() > 2, file=file); os.write(1, b'!'); os.write(2, b'!')"
    done = subprocess.run(
        ["/bin/sh", "-c", f'exec "$0" -c "$1" {closed}', sys.executable, text],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert "Error" not in done.stderr
    assert (tmp_path / "first").read_text() == "0 True\n"


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="this system sends no signals to a process")
def test_a_host_process_that_calls_a_command_keeps_its_hooks_signals_streams_and_logs(
    tmp_path: Path, write_schedule: Writer
) -> None:
    """Commands that succeed, that are refused, that measure; and a station that a signal ends."""
    done = subprocess.run(
        [sys.executable, "-c", HOST, str(write_schedule()), str(RIG)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "kept"
