"""A jammed axis in a terminal: `goniotwin run` asks on its standard input, and measures on from where the axis is."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from goniotwin.mocks.control import ControlClient
from tests.app.campaign.campaign_bench import QUIET
from tests.app.campaign.jam import ASK, AXIS, COUNTED_DEG, check_undisturbed
from tests.conftest import Writer
from tests.system.command import goniotwin
from tests.system.conftest import ForkedServe, control_client, until

pytestmark = [pytest.mark.long, pytest.mark.endpoint]
SPEED = 10


class Terminal:
    """`goniotwin run` with a pipe for what is typed, and a file for what it prints."""

    def __init__(self, folder: Path, *arguments: object) -> None:
        self._errors = folder / "terminal.txt"
        with self._errors.open("w", encoding="utf-8") as errors:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "goniotwin", "run", *map(str, arguments)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=errors,
                text=True,
                env={**os.environ, "COLUMNS": "400"},
            )

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()

    @property
    def text(self) -> str:
        return self._errors.read_text(encoding="utf-8")

    def wait_for(self, text: str) -> None:
        until(lambda: text in self.text or self.process.poll() is not None)
        assert text in self.text, self.text

    def type(self, line: str) -> None:
        assert self.process.stdin is not None
        print(line, file=self.process.stdin, flush=True)

    def mount(self, control: ControlClient, sample: str) -> None:
        """Mount a sample by hand, and confirm it."""
        self.wait_for(f"Mount {sample}.")
        control.mount(sample)
        self.type("mounted")


def test_a_jammed_axis_is_stated_in_a_terminal_and_the_values_are_those_of_an_undisturbed_rig(
    forked_serve: ForkedServe, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    own = write_rig(*QUIET)
    served = tmp_path / "served.toml"
    lines = forked_serve(own, "--speed", SPEED, "--write-rig", served)
    text = served.read_text(encoding="utf-8")
    served.write_text("\n".join(each for each in text.splitlines() if not each.startswith("control_")), encoding="utf-8")
    schedule, journal = write_schedule(text=ASK), tmp_path / "jammed.journal"
    control = control_client(lines)
    terminal = Terminal(tmp_path, schedule, "--rig", served, "--out", journal)
    with contextlib.ExitStack() as stack:
        stack.callback(terminal.close)
        terminal.mount(control, "etalon")
        terminal.wait_for("Mount gaussian-5.")
        control.do("jam", axis=AXIS)
        terminal.mount(control, "gaussian-5")
        terminal.wait_for("Position of beta unknown")
        terminal.wait_for("beta now: counter 150.000 deg, encoder 180.000 deg, 30.000 deg apart.")
        here = goniotwin("here", "--rig", served, AXIS, 180)
        assert here.returncode == 2
        assert "Set position is an answer of its question" in here.stderr

        control.do("jam", axis=AXIS, jammed=False)
        terminal.type("set 400")
        terminal.wait_for("400 deg is outside")
        terminal.type("set encoder")
        assert terminal.process.wait(120.0) == 0, terminal.text
    assert control.do("state")["angles_deg"][AXIS] == pytest.approx(COUNTED_DEG, abs=0.01)
    control.close()
    check_undisturbed(journal, own, schedule)
