"""A campaign on a rig of two makes, and what the product does for an axis of a make that it does not know."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal
from goniotwin.app.campaign.running.recovery import Recovery
from goniotwin.app.campaign.running.stop import StopRequest
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.cli.work.referencing import home_axes
from goniotwin.app.errors import UserError
from goniotwin.app.rig import axis_timings, open_rig, parse_rig, read_rig
from goniotwin.app.rig.kinds import unregister
from goniotwin.app.rig.served_file import served_rig
from goniotwin.drivers import Forgotten, LimitError, NoAnswer, wait
from goniotwin.mocks.control import ControlClient
from goniotwin.mocks.served import ServedRig
from goniotwin.protocols.clock import RealClock, VirtualClock
from tests.app.campaign.planning.planner_bench import HEAD
from tests.conftest import REPOSITORY, SCHEDULE, Writer
from tests.system.another_make.conftest import STEADY
from tests.system.another_make.driver import ESP

MixedRig = Callable[..., Path]
RESOLUTION_DEG = 0.02 / 100
"""A count of the shift's controller: a full step of the motor in 100."""


@pytest.mark.long
def test_quick_has_the_values_of_the_rig_with_one_make(
    mixed_rig: MixedRig, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """At one sigma, for the axis of this make is the shift."""
    points, outcomes = [], []
    schedule = read_schedule(write_schedule(("[0, 30, 60]", "[30]"), text=SCHEDULE.read_text(encoding="utf-8")))
    for name, rig in (("mixed", mixed_rig(*STEADY)), ("tmcl", write_rig(*STEADY))):
        plan, path = make_plan(schedule, read_rig(rig)), tmp_path / f"{name}.journal"
        outcome = run_campaign(plan, path, transcript=tmp_path / name)
        assert (outcome.faults, outcome.skipped) == ((), 0)
        assert outcome.seconds == pytest.approx(plan.seconds, rel=0.01)
        outcomes.append(outcome)
        with Journal.open(path) as journal:
            points.append(reduce_journal(journal).samples["gaussian-5"])
            shifts = [row.data.positions["shift"] for row in journal.rows() if row.data.positions is not None]
        assert sorted({round(shift or 0.0, 3) for shift in shifts}) == pytest.approx(np.arange(10) * 0.5)
    mixed, tmcl = points
    assert outcomes[0].rows == outcomes[1].rows > 0
    assert np.max(np.abs(mixed.zenith_deg - tmcl.zenith_deg)) <= RESOLUTION_DEG
    # The Gaussian of 5 deg changes in a degree by less than its value.
    assert mixed.bsdf == pytest.approx(tmcl.bsdf, rel=RESOLUTION_DEG, nan_ok=True)
    assert {each.name for each in (tmp_path / "mixed").iterdir()} >= {"axes.txt", "axes-shift.txt", "monitor.txt"}
    unregister(ESP)  # as on a computer without this package
    with (
        Journal.open(tmp_path / "mixed.journal") as journal,
        pytest.raises(UserError, match=r"shift\.kind: 'esp' is not .*, or install the package that has this kind"),
    ):
        reduce_journal(journal)


def test_the_plan_has_the_duration_of_this_axis(mixed_rig: MixedRig) -> None:
    """From 0 to 5 deg at 5 deg/s with 10 deg/s^2: 1 s and a ramp of 0.5 s, besides settling and exchanges."""
    timing = axis_timings(read_rig(mixed_rig()).file)["shift"]
    travel = float(timing.travel_seconds(np.array([0.0]), np.array([5.0]))[0])
    assert travel == pytest.approx(1.5, abs=0.01)
    with open_rig(read_rig(mixed_rig()), VirtualClock()) as opened:
        opened.connect()
        started = opened.rig.clock.now()
        wait(opened.rig.clock, [opened.rig.axes["shift"].start(5.0)])
        assert opened.rig.clock.now() - started == pytest.approx(timing.starting_s + travel + timing.ending_s, abs=0.01)


def test_the_settling_time_of_this_axis_is_in_the_plan(mixed_rig: MixedRig) -> None:
    """0.3 s more for each row that moves the shift; 0.2 s where another axis moves too, which settles in 0.2 s."""
    schedule, slow = read_schedule(SCHEDULE), ("number = 1\n", "number = 1\nsettling_s = 0.4\n")
    plan, slower = (make_plan(schedule, read_rig(mixed_rig(*changes))) for changes in ((), (slow,)))
    poses, in_slower = ([row.pose for row in each.rows if row.pose is not None] for each in (plan, slower))
    assert in_slower == poses
    shifts = [pose[3] for pose in poses]
    moves = sum(before != after for before, after in pairwise(shifts))
    assert 0.2 * moves <= slower.seconds - plan.seconds <= 0.3 * (moves + 1)


def test_the_arc_keeps_clear_of_the_beam_with_this_axis(mixed_rig: MixedRig) -> None:
    with open_rig(read_rig(mixed_rig()), VirtualClock()) as opened:
        opened.connect()
        rig = opened.rig
        wait(rig.clock, [rig.start("shift", 3.0)])
        with pytest.raises(LimitError, match="incoming beam"):
            rig.start("beta", 280.0)
        lowering = rig.start("shift", 0.0)
        with pytest.raises(LimitError, match="incoming beam"):
            rig.start("beta", 280.0)  # it is still on its way
        wait(rig.clock, [lowering])
        wait(rig.clock, [rig.start("beta", 270.0)])
        with pytest.raises(LimitError, match="incoming beam"):
            rig.start("shift", 3.0)
        with pytest.raises(LimitError, match=r"shift.*limits -0\.5 to 5\.5"):
            rig.start("shift", 5.6)


def test_the_axis_homes(mixed_rig: MixedRig) -> None:
    lines: list[str] = []
    home_axes(mixed_rig(), ["shift"], lines.append)
    assert lines == ["shift: homed, at -1.000 deg (reference found at 0.000 deg of the previous count)"]


def test_a_reset_is_noticed_and_concerns_this_controller_alone(mixed_rig: MixedRig, tmp_path: Path) -> None:
    with open_rig(read_rig(mixed_rig()), VirtualClock(), tmp_path / "wires") as opened:
        opened.connect()
        rig, virtual = opened.rig, opened.virtual
        assert virtual is not None
        wait(rig.clock, [rig.start("shift", 2.0), rig.start("gamma", 20.0)])
        virtual.serial["esp"].reset(rig.clock.now())
        with pytest.raises(Forgotten, match="shift"):
            rig.axes["shift"].read_back()
        assert [name for name, axis in rig.axes.items() if axis.unreferenced_reason] == ["shift"]
        before = (tmp_path / "wires" / "axes.txt").read_text(encoding="utf-8")
        rig.reconnect("shift")
        assert (tmp_path / "wires" / "axes.txt").read_text(encoding="utf-8") == before
        assert rig.axes["shift"].unreferenced_reason == "its controller has reset"
        failures = Recovery(rig, StopRequest(rig), lambda *started: wait(rig.clock, started)).recover("shift")
        assert failures == []
        assert not rig.axes["shift"].unreferenced_reason
        assert virtual.plant.angle_deg("shift", rig.clock.now()) == pytest.approx(-1.0, abs=RESOLUTION_DEG)
        assert rig.axes["shift"].position_deg() == pytest.approx(-1.0, abs=RESOLUTION_DEG)
        assert rig.axes["gamma"].position_deg() == pytest.approx(20.0, abs=1e-3)


@pytest.mark.long
@pytest.mark.endpoint
def test_the_device_is_served_with_its_plug_and_faults(mixed_rig: MixedRig, tmp_path: Path) -> None:
    description = read_rig(mixed_rig(*STEADY))
    model = description.model()
    assert model is not None
    server = ServedRig(model, 1.0, tmp_path / "ptys")
    server.start()
    control = ControlClient(server.endpoints[-1].port or 0, server.endpoints[-1].token or "")
    text = served_rig(description, server.endpoints, 1.0)
    with open_rig(parse_rig(text, tmp_path, "served.toml"), RealClock()) as opened:
        opened.connect()
        assert opened.rig.identities["axes-shift"] == "ESP301 Version 3.09 virtual"
        assert opened.rig.axes["shift"].position_deg() == 0.0
        control.do("faults", device="esp", script=["lost"])
        with pytest.raises(NoAnswer, match="axes-shift"):
            opened.rig.axes["shift"].position_deg()
        control.do("unplug", device="esp")
        assert [name for name, error in opened.rig.connect().items() if error is not None] == ["axes-shift"]
    control.close()
    server.stop()


def test_protocol_driver_and_twin_are_at_most_600_lines_and_the_product_knows_none_of_them() -> None:
    here = Path(__file__).parent
    files = [here / f"{name}.py" for name in ("__init__", "protocol", "driver", "twin")]
    assert sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files) <= 600
    for folder in ("app", "drivers", "mocks", "protocols", "twin", "package"):
        for path in (REPOSITORY / folder).rglob("*.py"):
            assert "esp301" not in path.read_text(encoding="utf-8").lower(), path


@pytest.mark.parametrize("light", ['gains_v_per_a = "automatic"\n', "[averaging]\nrelative_uncertainty = 0.01\n"])
def test_a_real_rig_of_which_no_twin_can_be_described_is_planned(mixed_rig: MixedRig, tmp_path: Path, light: str) -> None:
    """Without the expected signal, so that each reading takes its longest time."""
    text = mixed_rig().read_text(encoding="utf-8").partition("# ---- what the virtual rig is")[0]
    text = (
        text.replace("[simulated]\nseed = 1\n", "")
        .replace("twin://virtual/monitor", "1313:8078")
        .replace("twin://virtual/", "/dev/")
    )
    real = parse_rig(text, tmp_path, "real.toml")
    gains = "" if "gains" in light else "gains_v_per_a = [1e10]\n"
    schedule = parse_schedule(f"{HEAD}sigma_deg = [0]\nbeta_deg = [0, 90]\nwavelength_nm = [500]\n{gains}{light}", "x.toml")
    assert make_plan(schedule, real).seconds > 0.0
    with pytest.raises(UserError, match=r"axes\.shift: there is no description of a twin for the kind 'esp'"):
        plan_rehearsal(schedule, real, {})
