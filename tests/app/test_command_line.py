"""The command line: the order of its commands, the cost of its help, and the message after Ctrl-C."""

import subprocess
import sys

import pytest

from goniotwin.app.cli import device_search
from goniotwin.app.cli.main import COMMANDS, INTERRUPTED, app

HEAVY = ("numpy", "numba", "PySide6", "matplotlib", "h5py")
HELP = f"""
import sys
from goniotwin.app.cli.main import app

for command in sys.argv[1:]:
    app([*command.split(), "--help"], standalone_mode=False)
loaded = [name for name in {HEAVY} if name in sys.modules]
assert not loaded, loaded
"""
SUBCOMMANDS = ("simulate illumination", "simulate table3", "simulate shadow")


def test_help_lists_the_commands_in_the_order_of_a_day(capsys: pytest.CaptureFixture[str]) -> None:
    app(["--help"], standalone_mode=False)
    lines = capsys.readouterr().out.partition("Commands:")[2].splitlines()
    assert tuple(line.split()[0] for line in lines if line) == COMMANDS


def test_help_fits_a_terminal_of_80_columns(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """No line is longer, and the sentence of no command is cut off."""
    monkeypatch.setenv("COLUMNS", "80")
    for command in ("", *COMMANDS, *SUBCOMMANDS):
        app([*command.split(), "--help"], standalone_mode=False)
        text = capsys.readouterr().out
        assert max(map(len, text.splitlines())) <= 80, command
        for line in text.partition("Commands:")[2].splitlines():
            assert not line.endswith("..."), line


def test_help_loads_no_heavy_library() -> None:
    done = subprocess.run(
        [sys.executable, "-c", HELP, "", *COMMANDS, *SUBCOMMANDS], capture_output=True, text=True, timeout=300, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_ctrl_c_in_a_command_is_one_line_and_status_130(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(device_search, "find_devices", interrupt)
    assert app(["devices"], standalone_mode=False) == INTERRUPTED
    assert capsys.readouterr().err == "goniotwin: stopped\n"
