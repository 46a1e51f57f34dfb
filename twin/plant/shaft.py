"""A shaft: what a motor's microsteps do to the angle of an axis. The motor knows no degrees, the axis no microsteps."""

from dataclasses import dataclass

from twin.plant.model import Mechanics
from twin.plant.motion import Trajectory, resting
from twin.plant.timeline import Timeline


@dataclass(frozen=True, slots=True)
class Drive:
    """A trajectory in microsteps, and how its counter is tied to the shaft: full steps = origin + microsteps / per_full."""

    trajectory: Trajectory
    per_full: int
    origin: float

    def full_steps(self, t: float) -> float:
        """The shaft's place in full steps of the motor."""
        return self.origin + self.trajectory.position(t) / self.per_full


class Shaft:
    """One axis of the plant."""

    def __init__(self, mechanics: Mechanics) -> None:
        self.mechanics = mechanics
        self._drives = Timeline(Drive(resting(0.0), 256, 0.0))

    def angle_deg(self, t: float) -> float:
        """The true angle at `t`."""
        full_steps = self._drives.at(t).full_steps(t)
        return self.mechanics.zero_deg + full_steps * self.mechanics.deg_per_full_step

    def moved_since(self, t: float) -> bool:
        """Whether the axis may have moved after `t`."""
        return t < max(self._drives.last_change, self._drives.at(float("inf")).trajectory.end)

    def follow(self, t: float, trajectory: Trajectory) -> None:
        """From `t` on the motor's counter follows `trajectory`."""
        old = self._drives.at(t)
        self._drives.set(t, Drive(trajectory, old.per_full, old.origin))

    def recount(self, t: float, position: float, per_full: int) -> Trajectory:
        """The counter is set to `position`, in microsteps of `per_full` a full step: nothing moves. Returns the rest."""
        rest = resting(position, t)
        origin = self._drives.at(t).full_steps(t) - position / per_full
        self._drives.set(t, Drive(rest, per_full, origin))
        return rest
