"""What an axis of any motion controller is to the rig, the engine and the planner."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from goniotwin.arrays import Flags, Floats
from goniotwin.drivers.device import Pending
from goniotwin.drivers.errors import LimitError


class AxisDescription(Protocol):
    """An axis as its driver knows it without a wire: the operator's table of it. Angles in degrees.

    Every move arrives from `approach_from`, if necessary after an overshoot of `overshoot_deg` (signed; 0 without backlash).
    `homing` is the reference search, None for an axis that cannot home.
    """

    @property
    def lower_deg(self) -> float: ...
    @property
    def upper_deg(self) -> float: ...
    @property
    def speed_deg_s(self) -> float: ...
    @property
    def settling_s(self) -> float: ...
    @property
    def encoder(self) -> bool: ...
    @property
    def backlash_deg(self) -> float: ...
    @property
    def overshoot_deg(self) -> float: ...
    @property
    def approach_from(self) -> Literal["below", "above"]: ...
    @property
    def homing(self) -> object | None: ...
    @property
    def homing_required(self) -> bool: ...
    @property
    def power_up_at_reference(self) -> bool: ...


@dataclass(frozen=True)
class AxisTiming:
    """Durations of the moves of an axis of any make, s.

    While a move starts and ends (`starting_s`, `ending_s`) the computer exchanges with the controller and does nothing else;
    in between other devices move too. `travel_seconds` gives the time (n,) in between from the starts (n,) and targets (n,) in
    degrees; NaN is an unknown start. `settling_s` follows. `read_back_s`: to read the position back. `approach`: direction of
    the last leg of each move, +1 or -1, or 0 where it does not matter.
    """

    starting_s: float
    ending_s: float
    settling_s: float
    read_back_s: float
    approach: int
    travel_seconds: Callable[[Floats, Floats], Floats]


class PendingMove(Pending, Protocol):
    """A move in progress. `arrival` is its estimated end, s."""

    arrival: float


class Axis(Protocol):
    """An axis. It moves to an angle only while it is *referenced*: while its counter is known to give its angle.

    All methods raise DeviceError. No call lasts longer than a few exchanges on the wire.
    """

    name: str
    last_reference_deg: float | None
    """The reference by the counter before the last homing: the error of the old reference; None if it was not homed."""

    @property
    def settings(self) -> AxisDescription: ...

    @property
    def unreferenced_reason(self) -> str:
        """Why the axis is unreferenced; empty if it is referenced."""

    def check_limits(self, target_deg: float) -> None:
        """Raise LimitError for a target outside the soft limits; nothing is sent."""

    def start(self, target_deg: float, stop_count: int | None = None) -> PendingMove:
        """Start a move to an angle, unless a stop was requested after `stop_count` of the controller was read.

        Raises LimitError or Unreferenced before anything is sent.
        """

    def start_homing(self) -> Pending:
        """Start the reference search; at its end the axis is referenced."""

    def set_position(self, angle_deg: float | None = None) -> None:
        """Set the current position of an axis at rest (manual referencing); None accepts its counter."""

    def position_deg(self) -> float:
        """Position by the motor's counter. Raises Forgotten if the controller has reset."""

    def encoder_deg(self) -> float | None:
        """Position by the encoder. Raises Forgotten if the controller has reset.

        None for an axis without encoder, and after a reset until it is referenced: the encoder's counter is lost too.
        """

    def is_moving(self) -> bool:
        """True while the motor turns."""

    def read_back(self) -> tuple[float, float | None]:
        """Counter and encoder of a referenced axis at rest; an axis where they disagree becomes unreferenced.

        Raises Unreferenced, and Forgotten if the controller has reset.
        """


def within_limits(axis: AxisDescription, target_deg: Floats | float) -> Flags:
    """Whether moves to angles (n,) stay within the soft limits of an axis, the approach against backlash included."""
    approach_deg = target_deg + axis.overshoot_deg
    low, high = np.minimum(target_deg, approach_deg), np.maximum(target_deg, approach_deg)
    return np.asarray((axis.lower_deg <= low) & (high <= axis.upper_deg))


def limit_violation(axis: AxisDescription, target_deg: float) -> str | None:
    """What is outside the soft limits in a move to an angle; None if nothing is."""
    start_deg = target_deg + axis.overshoot_deg
    if axis.lower_deg <= min(target_deg, start_deg) and max(target_deg, start_deg) <= axis.upper_deg:
        return None  # `within_limits` of one target
    limits = f"outside its soft limits {axis.lower_deg:g} to {axis.upper_deg:g} deg"
    if not axis.lower_deg <= target_deg <= axis.upper_deg:
        return limits
    start = f"starting at {start_deg:g} deg, which is {limits}"
    return f"against backlash it approaches from {axis.approach_from}, {start}"


def check_limits(name: str, axis: AxisDescription, target_deg: float) -> None:
    """Raise LimitError for a target outside the soft limits of an axis, the approach against backlash included."""
    if (violation := limit_violation(axis, target_deg)) is not None:
        raise LimitError(name, f"move to {target_deg:g} deg", violation, "change the angle, or the limits in the rig file")
