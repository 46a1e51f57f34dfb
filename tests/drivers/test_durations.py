"""Durations and exchanges that drivers state are those on the wires of a virtual rig, whose clock is exact."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.app.rig import axis_timings, read_rig
from goniotwin.drivers import Pending, Rig, wait
from goniotwin.drivers.monitor.settings import TRANSFERS_AT_END
from goniotwin.drivers.motion.settings import move_seconds
from tests.app.campaign.filter_rig import RIG_FILTERS, TWIN_FILTERS
from tests.conftest import Change, RigOpener, Writer, tmcl_axis, tmcl_exchange_s

WIDE = ("gear = 36.0\nlower_deg = 0.0", "gear = 36.0\nlower_deg = -20.0")
BACKLASH = (WIDE[0], f"{WIDE[1]}\nbacklash_deg = 0.05")
"""Changes of the axis sigma."""
QUERY_S = 0.02
"""Less than any query of the monochromator: ten characters with their echo at 9600 baud."""
MICROSTEP_S = 1e-4
"""More than the rounding of a target to a microstep changes a duration."""
FRAME_S = 1e-3
"""A frame of USB at full speed."""


@dataclass
class Exchanges:
    """What was sent to one device, and how long that took."""

    sent: int = 0
    seconds: float = 0.0


class Wires:
    """A virtual rig with a transcript of its wires."""

    def __init__(self, opened: RigOpener, folder: Path, *changes: Change) -> None:
        self._folder = folder
        self.rig: Rig = opened(*changes, transcript=folder).rig

    @contextmanager
    def exchanges(self, *devices: str) -> Iterator[Exchanges]:
        """Requests that are sent to the devices within the block."""
        found, before, start = Exchanges(), self._sent(devices), self.rig.clock.now()
        yield found
        found.sent, found.seconds = self._sent(devices) - before, self.rig.clock.now() - start

    def wait(self, pending: Pending) -> None:
        wait(self.rig.clock, [pending])

    def _sent(self, devices: tuple[str, ...]) -> int:
        lines = [line for name in devices for line in (self._folder / f"{name}.txt").read_text(encoding="utf-8").splitlines()]
        return sum(line[14:17] == " > " for line in lines)


@given(way=st.floats(-400.0, 400.0), speed=st.floats(0.1, 60.0), up=st.floats(0.1, 100.0), down=st.floats(0.1, 100.0))
def test_a_ramp_covers_its_distance(way: float, speed: float, up: float, down: float) -> None:
    """At rest, at `speed` unless the way is too short for it, at rest: the area under the trapezium or triangle is the way."""
    seconds = float(move_seconds(way, speed, up, down))
    peak = min(speed, np.sqrt(2.0 * abs(way) * up * down / (up + down)))
    cruising = seconds - peak / up - peak / down
    assert cruising >= -1e-9
    assert 0.5 * peak * (peak / up + peak / down) + peak * cruising == pytest.approx(abs(way), rel=1e-9, abs=1e-9)
    assert move_seconds(np.array([way, -way]), speed, up, down).tolist() == [seconds, seconds]


@pytest.mark.parametrize("change", [WIDE, BACKLASH], ids=["one leg", "against backlash"])
@pytest.mark.parametrize("target", [9.9, 10.1, 60.0, -5.0])
def test_a_move_has_the_stated_exchanges_and_duration(
    change: Change, target: float, opened: RigOpener, write_rig: Writer, tmp_path: Path
) -> None:
    wires = Wires(opened, tmp_path / "wires", change)
    file = read_rig(write_rig(change)).file
    timing, exchange_s = axis_timings(file)["sigma"], tmcl_exchange_s(file)
    wires.wait(wires.rig.axes["sigma"].start(10.0))
    with wires.exchanges("axes") as found:
        wires.wait(wires.rig.axes["sigma"].start(target))
    travel = float(timing.travel_seconds(np.array([10.0]), np.array([target]))[0])
    polled = abs(target - 10.0) > 1.0  # because of the heartbeat; such a poll may delay the one at the end by an exchange
    tolerance = MICROSTEP_S + polled * exchange_s
    assert found.seconds == pytest.approx(timing.starting_s + travel + timing.ending_s, abs=tolerance)
    legs = tmcl_axis(wires.rig, "sigma").settings.legs(10.0, target)
    assert len(legs) == (2 if change is BACKLASH and target < 10.0 else 1)
    if not polled:
        assert found.sent == pytest.approx((timing.starting_s + timing.ending_s) / exchange_s + 2 * (len(legs) - 1))


@pytest.mark.parametrize("axis", ["sigma", "shift"])
def test_a_read_back_has_the_stated_exchanges_and_duration(
    axis: str, opened: RigOpener, write_rig: Writer, tmp_path: Path
) -> None:
    wires, file = Wires(opened, tmp_path / "wires"), read_rig(write_rig()).file
    timing, exchange_s = axis_timings(file)[axis], tmcl_exchange_s(file)
    wires.wait(wires.rig.axes[axis].start(1.0))
    with wires.exchanges("axes") as found:
        wires.rig.axes[axis].read_back()
    assert found.sent == pytest.approx(timing.read_back_s / exchange_s)
    assert found.seconds == pytest.approx(timing.read_back_s, abs=MICROSTEP_S)


@pytest.mark.parametrize("opened_first", [True, False])
def test_the_shutter_takes_the_stated_time(opened_first: bool, opened: RigOpener, tmp_path: Path) -> None:
    wires = Wires(opened, tmp_path / "wires")
    mono = wires.rig.monochromator
    wires.wait(mono.start_shutter(opened=opened_first))
    with wires.exchanges("monochromator") as found:
        wires.wait(mono.start_shutter(opened=not opened_first))
    assert found.sent == 2
    assert found.seconds == pytest.approx(mono.settings.shutter_seconds(opened=not opened_first), abs=QUERY_S)


@pytest.mark.parametrize(
    ("start", "stop", "sent"),
    [(500.0, 510.0, 2), (510.0, 500.0, 2), (500.0, 700.0, 5), (700.0, 500.0, 5), (None, 450.0, 4), (None, 700.0, 6)],
)
def test_a_change_of_wavelength_takes_the_stated_time(
    start: float | None, stop: float, sent: int, opened: RigOpener, tmp_path: Path
) -> None:
    """The statement and the query of the grating; with another filter also query, statement, query of the wheel."""
    wires = Wires(opened, tmp_path / "wires", RIG_FILTERS, TWIN_FILTERS)
    mono = wires.rig.monochromator
    wheel = mono.settings.wheel

    def change(before: float | None, after: float) -> None:
        glass = wheel.at(after)
        assert glass is not None
        if before is None or wheel.at(before) != glass:
            wires.wait(mono.start_filter(glass.position))
        wires.wait(mono.start_wavelength(after))

    if start is not None:
        change(None, start)
    with wires.exchanges("monochromator") as found:
        change(start, stop)
    assert found.sent == sent
    here = np.array([np.nan if start is None else start])
    stated = float(mono.settings.wavelength_seconds(here, np.array([stop]))[0])
    if start is None:  # the planner knows no way for the grating; after a power-up it is at 550 nm
        stated += float(mono.settings.slew_seconds(stop - 550.0))
    assert found.seconds == pytest.approx(stated, abs=QUERY_S)


def test_a_lot_of_readings_takes_the_stated_time(opened: RigOpener, tmp_path: Path) -> None:
    wires = Wires(opened, tmp_path / "wires")
    photodiodes = wires.rig.photodiodes
    settings, modules = photodiodes.settings, [f"photodiodes-{k}" for k in range(photodiodes.settings.modules)]
    for gain, changed in ((3, True), (3, False)):
        if changed:
            with wires.exchanges(*modules) as found:
                wires.wait(photodiodes.start_gain(gain))
            assert found.seconds == pytest.approx(settings.gain_seconds, rel=1e-6)
        with wires.exchanges(*modules) as found:
            wires.wait(photodiodes.start_readings(5))
        stated = settings.wait_s + 4 * settings.period_s + settings.fetching_seconds(after_change=changed)
        assert found.seconds == pytest.approx(stated, rel=1e-6)
        assert found.sent == 4 * settings.modules + round(settings.fetching_seconds(after_change=changed) / settings.request_s)


def test_a_mean_of_the_monitor_ends_with_the_stated_transfers(opened: RigOpener, tmp_path: Path) -> None:
    wires = Wires(opened, tmp_path / "wires")
    monitor = wires.rig.monitor
    wires.wait(monitor.start_mean(0.5))  # the averaging is set
    mean = monitor.start_mean(0.5)
    text = tmp_path / "wires" / "monitor.txt"
    before = len(text.read_text(encoding="utf-8").splitlines())
    started = wires.rig.clock.now()
    wires.wait(mean)
    assert len(text.read_text(encoding="utf-8").splitlines()) - before == TRANSFERS_AT_END
    took_s = wires.rig.clock.now() - started
    assert took_s > 0.5
    # Transfers in the twin take no time: so much more is stated, and at most a frame of USB at full speed for each.
    assert 0.0 < 0.5 + monitor.settings.fetching_seconds - took_s < TRANSFERS_AT_END * FRAME_S
