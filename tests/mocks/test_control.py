"""The back door's orders."""

import contextlib
import json
from typing import Any

import pytest

from drivers import DeviceError, wait
from mocks.control import BackDoor
from tests.conftest import RigOpener

QUIET = ("noise = true", "noise = false")


def test_a_jammed_axis_does_not_turn_and_the_encoder_tells(opened: RigOpener) -> None:
    rig = opened(QUIET)
    assert rig.virtual is not None
    door = BackDoor(rig.virtual)
    assert door.obey(b'{"do": "jam", "axis": "beta"}') == {"ok": True}
    before = rig.virtual.plant.angle_deg("beta", rig.rig.clock.now())
    with contextlib.suppress(DeviceError):  # an axis that watches its encoder says so
        wait(rig.rig.clock, [rig.rig.start("beta", 20.0)])
    assert rig.rig.axes["beta"].encoder_deg() == pytest.approx(before, abs=0.1)
    assert rig.virtual.plant.angle_deg("beta", rig.rig.clock.now()) == pytest.approx(before, abs=0.1)


@pytest.mark.parametrize(
    "line",
    [b"", b"[]", b"\xff", b'{"do": "mount", "sample": 3}', b'{"do": "jam", "axis": "delta"}', b'{"do": "lamp", "level": "x"}'],
)
def test_a_bad_order_is_answered_in_words(opened: RigOpener, line: bytes) -> None:
    rig = opened(QUIET)
    assert rig.virtual is not None
    answer: dict[str, Any] = BackDoor(rig.virtual).obey(line)
    assert answer["ok"] is False
    assert answer["error"]
    assert json.dumps(answer)
