"""The example rig with the arc's shift on a controller of another make, all other axes on TMCL."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.app.rig.kinds import register, unregister
from tests.conftest import Writer
from tests.system.another_make.driver import ESP

SHIFT = (
    """motor = 0
gear = 90.0
lower_deg = -0.5
upper_deg = 5.5
speed_deg_s = 5.0
acceleration_deg_s2 = 10.0
power_up_at_reference = true
encoder = false
""",
    """kind = "esp"
port = "twin://virtual/esp"
number = 1
lower_deg = -0.5
upper_deg = 5.5
speed_deg_s = 5.0
acceleration_deg_s2 = 10.0
power_up_at_reference = true
homing = { speed_deg_s = 2.0, angle_deg = -1.0 }
""",
)
TWIN = (
    "shift = { motor = 0, gear = 90.0, encoder = false }\n",
    """shift = { motor = 0, gear = 90.0, encoder = false, lower_switch_deg = -1.0 }

[twin.controllers.esp]
kind = "esp-301"
axes = ["shift"]
""",
)
STEADY = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))
"""Without noise and drift a value does not depend on the time of its measurement."""


@pytest.fixture(autouse=True)
def _registered() -> Iterator[None]:
    register(ESP)
    yield
    unregister(ESP)


@pytest.fixture
def mixed_rig(write_rig: Writer) -> Callable[..., Path]:
    """Writes the rig with further changes; returns its path."""

    def write(*changes: tuple[str, str], name: str = "mixed.toml") -> Path:
        return write_rig(SHIFT, TWIN, *changes, name=name)

    return write
