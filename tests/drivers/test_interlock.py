"""Clearance of the arc: motions that would collide with the incoming beam are refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.drivers import LimitError, wait
from goniotwin.drivers.motion.clearance import ArcClearance
from tests.conftest import RigOpener

ARC = ArcClearance(top_polar_deg=85.0)
ANGLE = st.floats(-720.0, 720.0)


@given(ANGLE, ANGLE, st.floats(-0.5, 5.5), st.floats(-0.5, 5.5))
def test_a_sweep_is_refused_if_any_position_on_it_would_collide(one: float, two: float, low: float, high: float) -> None:
    places = [one + (two - one) * k / 500 for k in range(501)]
    collides = any(abs((place - 270.0 + 180.0) % 360.0 - 180.0) < 5.9 for place in places)
    if collides and 85.0 + max(low, high) > 87.0:
        assert ARC.collision((one, two), (low, high)) is not None
    clear = all(abs((place - 270.0 + 180.0) % 360.0 - 180.0) > 9.0 for place in places)
    if clear or 85.0 + max(low, high) <= 87.0:
        assert ARC.collision((one, two), (low, high)) is None


def test_the_arc_does_not_pass_the_beam_with_a_high_shift(opened: RigOpener) -> None:
    rig = opened()
    assert rig.virtual is not None
    clock = rig.rig.clock
    wait(clock, [rig.rig.start("beta", 200.0), rig.rig.start("shift", 4.0)])
    with pytest.raises(LimitError, match=r"beta: move to 300 deg: the arc would collide with the incoming beam"):
        rig.rig.start("beta", 300.0)
    assert not rig.virtual.plant.shafts["beta"].moved_since(clock.now())
    wait(clock, [rig.rig.start("shift", 1.0)])
    wait(clock, [rig.rig.start("beta", 300.0)])


def test_the_shift_does_not_rise_while_the_arc_passes_the_beam(opened: RigOpener) -> None:
    rig = opened().rig
    wait(rig.clock, [rig.start("beta", 200.0), rig.start("shift", 0.0)])
    sweep = rig.start("beta", 340.0)
    with pytest.raises(LimitError, match=r"shift: move to 5 deg: the arc would collide"):
        rig.start("shift", 5.0)
    wait(rig.clock, [sweep])
    wait(rig.clock, [rig.start("shift", 5.0)])
