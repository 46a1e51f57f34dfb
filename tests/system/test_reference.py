"""References of the axes across processes of a served rig."""

from pathlib import Path

import pytest

from goniotwin.app.rig import AXES
from tests.conftest import RIG, Writer
from tests.system.command_process import FORKED, CommandProcess
from tests.system.conftest import ForkedServe, control_client

pytestmark = FORKED


@pytest.mark.long
def test_after_a_reset_between_two_runs_nothing_is_measured_until_the_positions_are_set(
    forked_serve: ForkedServe, write_schedule: Writer, tmp_path: Path
) -> None:
    anywhere = tmp_path / "anywhere.toml"
    lines = RIG.read_text(encoding="utf-8").splitlines()
    anywhere.write_text("\n".join(line for line in lines if not line.startswith("power_up_at_reference")), encoding="utf-8")
    rig, schedule = tmp_path / "served.toml", write_schedule()
    endpoints = forked_serve(anywhere, "--speed", 10, "--write-rig", rig)
    control = control_client(endpoints)

    def status(*arguments: object) -> int:
        return CommandProcess(tmp_path, *arguments).wait()

    def refused(name: str) -> None:
        done = CommandProcess(tmp_path, "run", schedule, "--rig", rig, "--out", tmp_path / name)
        assert done.wait() == 2
        assert len(done.errors.strip().splitlines()) == 1
        assert f"goniotwin here --rig {rig}" in done.errors
        assert not (tmp_path / name).exists()

    refused("0.journal")
    for axis in AXES:
        assert status("here", "--rig", rig, axis, 0) == 0
    assert status("run", schedule, "--rig", rig, "--out", tmp_path / "1.journal") == 0
    angle = control.do("state")["angles_deg"]["sigma"]
    assert angle == pytest.approx(30.0, abs=0.01)
    control.do("unplug", device="axes")
    control.do("replug", device="axes", reset=True)
    refused("2.journal")
    refused("3.journal")
    for axis, angle in control.do("state")["angles_deg"].items():
        assert status("here", "--rig", rig, axis, angle) == 0
    assert status("run", schedule, "--rig", rig, "--out", tmp_path / "4.journal") == 0
    assert control.do("state")["angles_deg"]["sigma"] == pytest.approx(30.0, abs=0.01)
    control.close()
