"""A station without a run: it knows its rig, does one thing at a time, moves and reads."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest

from goniotwin.app.campaign.running.events import Positions
from goniotwin.app.station.contacts import ASK_S
from goniotwin.app.station.messages import ActivityChanged, BenchReading, DeviceChanged, Message, RunRefused
from goniotwin.app.station.permissions import CommandRefused, allowed
from goniotwin.drivers.photodiodes.array import PhotodiodeArray
from tests.app.campaign.campaign_bench import QUIET
from tests.app.station.station_bench import HurriedClock, Idle, StationBench
from tests.conftest import Writer


def test_a_station_knows_its_rig(bench: StationBench) -> None:
    now = bench.station.snapshot
    assert now.rig is not None
    assert list(now.rig.devices) == ["axes", "monochromator", "photodiodes", "monitor"]
    assert all(each.connected and each.answered for each in now.rig.devices.values())
    assert now.rig.simulated
    assert now.bench.shutter_open is False
    assert now.activity == ""
    assert allowed(now)["start"] == allowed(now)["move"] == ""


def test_a_move_moves_the_axis_and_is_refused_beyond_the_limits(bench: StationBench) -> None:
    bench.station.move("sigma", 30.0)
    assert bench.station.snapshot.activity == "moving sigma to 30 deg"
    assert bench.work().activity == ""
    assert bench.error == ""
    assert bench.virtual.plant.angle_deg("sigma", bench.clock.now()) == pytest.approx(30.0, abs=0.1)
    for axis, target, reason in (("sigma", 4000.0, "outside its soft limits"), ("tau", 1.0, "is no axis")):
        with pytest.raises(CommandRefused, match=reason):
            bench.station.move(axis, target)
    assert bench.station.snapshot.activity == ""


def test_unreferenced_axes_are_reported_until_their_position_is_set(write_rig: Writer) -> None:
    bench = StationBench(write_rig(*QUIET, ("settling_s = 0.2\npower_up_at_reference = true", "settling_s = 0.2")))
    unreferenced = bench.work().unreferenced
    assert set(unreferenced) == {"sigma", "beta"}
    assert all(unreferenced.values())
    bench.station.set_position("sigma", 0.0)
    assert set(bench.work().unreferenced) == {"beta"}
    bench.station.close_rig()
    assert bench.station.snapshot.unreferenced == {}


def test_positions_are_reported_while_an_axis_moves(write_rig: Writer) -> None:
    bench = StationBench(write_rig(*QUIET), HurriedClock())
    bench.station.move("sigma", 30.0)
    bench.work()
    seen = [each.degrees["sigma"] for each in bench.events if isinstance(each, Positions)]
    assert len(seen) > 3
    assert seen == sorted(seen)
    bench.station.close_rig()


def test_one_thing_at_a_time(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    bench.station.move("sigma", 30.0)
    commands: tuple[Callable[[], None], ...] = (
        lambda: bench.station.move("beta", 10.0),
        lambda: bench.station.read(),
        lambda: bench.station.shutter(True),
        lambda: bench.station.start(write_schedule(), tmp_path),
    )
    for command in commands:
        with pytest.raises(CommandRefused, match="moving sigma to 30 deg"):
            command()
    bench.work()
    bench.station.read()


def test_live_readings_switched_on_before_a_move_do_not_end_it(bench: StationBench) -> None:
    bench.station.live(True)
    bench.station.move("sigma", 30.0)
    bench.work()
    busy = [each.activity for each in bench.events if isinstance(each, ActivityChanged)]
    assert busy == ["moving sigma to 30 deg", ""]
    assert bench.station.snapshot.positions["sigma"] == pytest.approx(30.0, abs=0.1)


def test_a_move_that_is_asked_for_at_the_end_of_a_start_is_in_progress_until_it_has_arrived(
    bench: StationBench, tmp_path: Path
) -> None:
    """The end of one activity is not that of the next: a second motion would begin, and SIGTERM would stop neither."""
    at_end: list[float] = []

    def react(message: Message) -> None:
        if isinstance(message, RunRefused):
            bench.station.move("sigma", 30.0)
        if isinstance(message, ActivityChanged) and not message.activity:
            at_end.append(bench.station.snapshot.positions.get("sigma", 0.0))

    bench.reactions.append(react)
    bench.station.start(tmp_path / "none.toml", tmp_path)
    bench.work()
    assert at_end == [pytest.approx(30.0, abs=0.1)]


def test_wavelength_shutter_gain_and_reading(bench: StationBench) -> None:
    station = bench.station
    commands: tuple[Callable[[], None], ...] = (
        lambda: station.mount("etalon"),
        lambda: station.move("beta", 180.0),
        lambda: station.wavelength(600.0),
        lambda: station.gain(1e10),
        lambda: station.read(4, dark=True),
        lambda: station.shutter(True),
        lambda: station.read(4),
    )
    for command in commands:
        command()
        bench.work()
        assert bench.error == ""
    now = station.snapshot.bench
    assert (now.wavelength_nm, now.shutter_open, now.gain_v_per_a, now.sample) == (600.0, True, 1e10, "etalon")
    dark, light = [each for each in bench.events if isinstance(each, BenchReading)]
    assert (dark.dark, light.dark) == (True, False)
    assert len(dark.counts) == len(light.volts) == 36
    assert light.monitor_a is not None
    assert dark.monitor_a is not None
    assert light.monitor_a > 10.0 * abs(dark.monitor_a)
    assert max(light.counts) > max(dark.counts) + 10.0
    with pytest.raises(CommandRefused, match="is no gain"):
        station.gain(3.0)


def test_a_sample_that_the_rig_does_not_have(bench: StationBench) -> None:
    bench.station.mount("cheese")
    bench.work()
    assert "cheese" in bench.error
    assert bench.station.snapshot.bench.sample is None


def test_a_dark_reading_leaves_the_shutter_as_it_was(bench: StationBench) -> None:
    bench.station.shutter(True)
    bench.work()
    bench.station.read(dark=True)
    assert bench.work().bench.shutter_open is True
    bench.station.close_rig()
    assert bench.station.snapshot.rig is None


def test_homing_and_setting_the_position(bench: StationBench) -> None:
    with pytest.raises(CommandRefused, match="homing"):
        bench.station.home("sigma")
    with pytest.raises(CommandRefused, match="soft limits"):
        bench.station.set_position("sigma", 4000.0)
    bench.station.set_position("sigma", 5.0)
    bench.work()
    assert bench.error == ""
    assert bench.opened.rig.axes["sigma"].position_deg() == pytest.approx(5.0, abs=0.01)


def test_the_photodiodes_are_asked_when_nothing_else_reads_them(idle: Idle, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that it is known when they last answered; live readings show it themselves."""
    asked: list[PhotodiodeArray] = []
    check = PhotodiodeArray.check

    def note(photodiodes: PhotodiodeArray) -> None:
        check(photodiodes)
        asked.append(photodiodes)

    monkeypatch.setattr(PhotodiodeArray, "check", note)
    idle.wait(1.5 * ASK_S)
    assert len(asked) == 2
    idle.station.live(True)
    idle.work()
    idle.wait(1.5 * ASK_S)
    assert len(asked) == 2


def test_live_readings_do_not_wait_for_amplifiers_that_have_settled(idle: Idle) -> None:
    """Of the rig's time a reading takes one conversion and the exchanges: ten a second."""
    idle.station.live(True)
    idle.work()
    while len(taken := idle.of(BenchReading)) < 5:
        idle.wait(0.005, 0.005)
    _, *times = [each.t_s for each in taken if isinstance(each, BenchReading)]  # the first one has waited
    assert [after - before for before, after in pairwise(times)] == pytest.approx([0.1] * 3, abs=0.02)


def test_a_device_that_is_lost_and_connected_again(
    bench: StationBench, monkeypatch: pytest.MonkeyPatch, write_schedule: Writer, tmp_path: Path
) -> None:
    modules = bench.virtual.modbus["adc-2"]
    modules.units = (9,)
    bench.station.read()
    now = bench.work()
    assert "Photodiodes module 2 (ADAM-6017) is not responding" in bench.error
    assert now.rig is not None
    assert now.rig.not_responding == ["photodiodes"]
    assert allowed(now)["read"] == allowed(now)["start"] == "not responding: photodiodes"
    assert allowed(now)["move"] == ""
    with pytest.raises(CommandRefused, match="not responding: photodiodes"):
        bench.station.start(write_schedule(), tmp_path)
    modules.units = (1,)
    bench.station.connect()
    now = bench.work()
    assert now.rig is not None
    assert now.rig.not_responding == []
    changed = [each for each in bench.events if isinstance(each, DeviceChanged)]
    assert [each.status.connected for each in changed] == [False, True]
