"""What a motion controller of any make is to the rig: its wire, its axes, and the stop of all of them."""

from collections.abc import Mapping
from typing import Protocol

from goniotwin.drivers.device import Device
from goniotwin.drivers.motion.axis import Axis
from goniotwin.drivers.motion.stop import StopSteps


class MotionController(Device, Protocol):
    """A motion controller and its axes, on one wire.

    Connecting writes the settings of the controller and its axes; nothing moves. A controller that has reset since the last
    connection has lost its positions: its axes are unreferenced from then on.
    """

    @property
    def axes(self) -> Mapping[str, Axis]:
        """The axes of this controller, by name."""

    @property
    def stop_count(self) -> int:
        """Number of stop requests so far: a move with an older count is not sent."""

    def begin_stop(self) -> StopSteps:
        """Request a stop of all axes over their ramps; return its steps. Thread-safe. From now on no move is sent.

        The steps send the stop frames before anything else, and end only when each is confirmed or has failed twice.
        """

    def set_heartbeat(self, seconds: float) -> None:
        """From the next connection on the motors stop after a silence of this time, or the longest possible one."""
