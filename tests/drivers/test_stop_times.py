"""Stop during a campaign, as an event of the virtual clock: time until its frames are sent, and until all axes rest."""

import contextlib
from collections.abc import Callable

import numpy as np
import pytest

from goniotwin.drivers import DeviceError, LimitError, wait
from goniotwin.drivers.errors import Interrupted
from goniotwin.drivers.motion.tmcl.module import HEARTBEAT_S
from goniotwin.protocols.clock import VirtualClock
from tests.conftest import RigOpener
from tests.drivers.busy_rig import RESOLUTION_S, BusyRig, RecordingWire, StopTimes

MOST_S = 0.2
"""DESIGN: from any thread, the stop frames of all axes are on their wires within 200 ms."""
LONGEST_RAMP_S = 1.0
"""Of the example rig's axes: sigma from 10 deg/s with 10 deg/s^2, beta from 30 with 30."""
SILENT = ("none", "the monochromator", "a converter module", "deaf axes", "mute axes")
Work = Callable[[str], BusyRig]


@pytest.fixture
def work(opened: RigOpener) -> Work:
    def begin(silent: str) -> BusyRig:
        rig = opened(clock=VirtualClock())
        assert rig.virtual is not None
        busy = BusyRig(rig.rig, rig.virtual, SILENT.index(silent))
        rig.rig.close()
        rig.connect()
        return busy

    return begin


def stopped_once(busy: BusyRig, silent: str) -> StopTimes:
    """A device becomes silent at a random request; the stop comes at a random time until well after the driver's timeout.

    With no silent device it comes during an exchange, or within 2 s. The axes must rest in time, and then nothing moves.
    """
    clock, random = busy.clock, busy.random
    wires = [busy.axes, busy.mono, busy.module]
    silenced = {
        "the monochromator": busy.mono,
        "a converter module": busy.module,
        "deaf axes": busy.axes,
        "mute axes": busy.axes,
    }
    wire: RecordingWire = silenced[silent] if silent in silenced else wires[int(random.integers(len(wires)))]
    delay = float(random.uniform(0.0, 1.3 if silent in silenced else (0.003, 2.0)[int(random.integers(2))]))

    def silence(t: float) -> None:
        wire.mute = silent == "mute axes"
        wire.deaf = silent in silenced and not wire.mute
        clock.at(t + delay, busy.stop)

    wire.call_at(int(random.integers(1, 120 if wire is busy.axes else 25)), silence)
    busy.work()
    stop = busy.outcome()
    angles = busy.angles_deg()
    clock.sleep_until(clock.now() + 30.0)
    assert busy.angles_deg() == angles
    if silent != "the monochromator":
        soon, late = busy.wavelengths_since_nm()
        assert soon == late
    assert stop.last_frame_s < MOST_S
    if silent == "deaf axes":
        assert stop.rest_s <= HEARTBEAT_S + LONGEST_RAMP_S
    else:
        # Until it receives the frame an axis may accelerate, which takes as long again on the ramp.
        assert stop.rest_s <= stop.ramp_s + 2.0 * stop.last_frame_s + 2.0 * RESOLUTION_S
    named = list(busy.rig.axes) if wire is busy.axes and silent in silenced else []
    assert [failure.device for failure in stop.failures] == named
    busy.recover()
    return stop


@pytest.mark.parametrize("silent", SILENT)
def test_stop_frames_are_sent_in_time_and_all_axes_rest_whichever_device_is_silent(work: Work, silent: str) -> None:
    busy = work(silent)
    for _ in range(6 if silent == "none" else 3):
        stopped_once(busy, silent)


@pytest.mark.parametrize("where", [pytest.param(each, marks=[] if each % 2 else pytest.mark.long) for each in range(40)])
def test_a_stop_while_a_start_reads_the_other_axes_prevents_the_move(opened: RigOpener, where: int) -> None:
    """Before a move of the arc its position and shift are read, about 20 ms; a stop is tried at each millisecond (half a
    millisecond in the long run)."""
    opened_rig = opened(clock=VirtualClock())
    rig, clock = opened_rig.rig, opened_rig.rig.clock
    clock.at(clock.now() + 0.0005 * where, rig.stop)
    with contextlib.suppress(DeviceError):
        rig.start("beta", 90.0)
    clock.sleep_until(clock.now() + 30.0)
    assert opened_rig.virtual is not None
    assert opened_rig.virtual.plant.angle_deg("beta", clock.now()) < 0.1


@pytest.mark.parametrize("after_s", [0.01, 0.2, 0.4, 0.6])
def test_a_stop_during_a_resynchronisation_of_the_monochromator_prevents_its_slew(opened: RigOpener, after_s: float) -> None:
    made = opened()
    rig, virtual = made.rig, made.virtual
    assert virtual is not None
    before = rig.monochromator.wavelength_nm()
    virtual.serial["mono"].outbox.append((rig.clock.now(), b"unasked\r\n"))
    rig.clock.sleep_until(rig.clock.now() + 0.1)
    rig.clock.at(rig.clock.now() + after_s, rig.stop)
    with pytest.raises(Interrupted, match="a stop was requested"):
        rig.monochromator.start_wavelength(before + 50.0)
    rig.clock.sleep_until(rig.clock.now() + 5.0)
    assert rig.monochromator.wavelength_nm() == pytest.approx(before, abs=0.01)


def test_while_an_axis_brakes_after_a_stop_no_move_starts_that_depends_on_its_rest_position(opened: RigOpener) -> None:
    """The arc is stopped just before the incoming beam and rests in it, so that its shift is then blocked."""
    opened_rig = opened(clock=VirtualClock())
    rig, clock, virtual = opened_rig.rig, opened_rig.rig.clock, opened_rig.virtual
    assert virtual is not None
    wait(clock, [rig.start("beta", 200.0)])
    sweep = rig.start("beta", 340.0)
    while virtual.plant.angle_deg("beta", clock.now()) < 258.0:
        clock.sleep_until(clock.now() + 0.01)
        if clock.now() >= sweep.due:
            sweep.poll()
    assert rig.stop() == []
    with pytest.raises(LimitError, match="it is moving"):
        rig.start("shift", 5.0)
    clock.sleep_until(clock.now() + 2.0)
    assert 264.0 < virtual.plant.angle_deg("beta", clock.now()) < 276.0
    with pytest.raises(LimitError, match="incoming beam"):
        rig.start("shift", 5.0)


@pytest.mark.long
@pytest.mark.parametrize("silent", SILENT)
def test_a_thousand_stops_are_all_in_time(work: Work, silent: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A thousand stops without a silent device, a thousand with one."""
    busy = work(silent)
    busy.random = np.random.default_rng(1000 + SILENT.index(silent))
    stops = [stopped_once(busy, silent) for _ in range(1000 if silent == "none" else 250)]
    with capsys.disabled():
        print(f"\nstop on the virtual clock, {summary(silent, stops)}")


def summary(silent: str, stops: list[StopTimes]) -> str:
    """Worst and median times of many stops, as text."""
    frames = 1e3 * np.array([stop.last_frame_s for stop in stops])
    rests = np.array([stop.rest_s for stop in stops])
    returned = 1e3 * max(stop.returned_s for stop in stops)
    turned = sum(stop.ramp_s > 0.0 for stop in stops)
    return (
        f"{silent} silent: worst of {len(stops)} ({turned} of them while axes turned): last stop frame after "
        f"{frames.max():.1f} ms (median {np.median(frames):.1f}), return after {returned:.0f} ms, at rest after "
        f"{rests.max():.3f} s (longest ramp {max(stop.ramp_s for stop in stops):.3f})"
    )
