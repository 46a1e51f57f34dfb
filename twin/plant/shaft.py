"""A shaft: what a motor's microsteps do to the angle of an axis. The motor knows no degrees, the axis no microsteps."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

from goniotwin.twin.plant.model import Mechanics
from goniotwin.twin.plant.motion import Trajectory, brake_to_rest, rest_at, turning_points
from goniotwin.twin.plant.timeline import History

ELECTRIC_CYCLE = 4
"""Full steps after which a stepper motor's field is the same again: a rotor that was held back falls in at one of these."""


@dataclass(slots=True)
class Heartbeat:
    """How long a movement may go on without news from its host: at `run_until` it brakes (the module's heartbeat)."""

    until: float = math.inf


@dataclass(frozen=True)
class Drive:
    """A trajectory in microsteps from `since` on, and how its counter is tied to the shaft.

    Full steps of the motor = origin + microsteps / per_full; `per_full` is negative where the shaft is reversed. The axis
    was at `start_deg` then, and stays there while it is jammed.
    """

    mechanics: Mechanics
    trajectory: Trajectory
    per_full: int = 256
    origin: float = 0.0
    since: float = -math.inf
    start_deg: float = 0.0
    jammed: bool = False
    deceleration: float = math.inf
    heartbeat: Heartbeat = field(default_factory=Heartbeat)

    def angle_deg(self, t: float) -> float:
        """The axis at `t`."""
        if self.jammed:
            return self.start_deg
        play = self.mechanics.backlash_deg
        if play == 0.0:
            return self._driven_deg(t)
        angle = self.start_deg
        for turn in self._turning_points:
            if turn >= t:
                break
            angle = self._dragged(angle, self._driven_deg(turn))
        return self._dragged(angle, self._driven_deg(t))

    def full_steps(self, t: float) -> float:
        """The motor's place in full steps, if nothing holds it."""
        return self.origin + self.counter(t) / self.per_full

    def counter(self, t: float) -> float:
        """Microsteps."""
        return self._trajectory(t).position(t)

    def _trajectory(self, t: float) -> Trajectory:
        until = self.heartbeat.until
        if t <= until or self.trajectory.velocity(until) == 0.0:
            return self.trajectory
        return brake_to_rest(self.trajectory, until, self.deceleration)

    def _driven_deg(self, t: float) -> float:
        return self.mechanics.zero_deg + self.full_steps(t) * self.mechanics.deg_per_full_step

    def _dragged(self, angle: float, driven: float) -> float:
        return min(max(angle, driven), driven + self.mechanics.backlash_deg)

    @cached_property
    def _turning_points(self) -> list[float]:
        start = max(self.since, self.trajectory.pieces[0].t)
        return [start, *turning_points(self.trajectory, start)]


class Shaft:
    """One axis of the plant. `jam` is its back door, of which `listener` is told."""

    def __init__(self, mechanics: Mechanics) -> None:
        self.mechanics = mechanics
        self.listener: Callable[[float], object] = float
        self._drives = History(Drive(mechanics, rest_at(0.0), start_deg=mechanics.zero_deg))

    @property
    def jammed(self) -> bool:
        """Whether something holds it now."""
        return self._drives.newest.jammed

    def drive(self, t: float) -> Drive:
        """How it is driven at `t`."""
        return self._drives.at(t)

    def angle_deg(self, t: float) -> float:
        """The true angle at `t`."""
        return self._drives.at(t).angle_deg(t)

    @property
    def newest(self) -> Drive:
        """How it is driven now."""
        return self._drives.newest

    @property
    def last_change(self) -> float:
        """From when on it rests, s; infinity where it turns for ever. A heartbeat that runs out has it rest no later."""
        last = self._drives.newest.trajectory.pieces[-1]
        return max(self._drives.last_change, last.t) if last.velocity == 0.0 else math.inf

    def moved_since(self, t: float) -> bool:
        """Whether the axis may have moved after `t`."""
        return t < self.last_change

    def driven(
        self, t: float, trajectory: Trajectory, deceleration: float = math.inf, heartbeat: Heartbeat | None = None
    ) -> Drive:
        """What would become of it if from `t` on the motor's counter followed `trajectory`."""
        old = self._drives.at(t)
        return replace(
            old, trajectory=trajectory, since=t, start_deg=old.angle_deg(t), deceleration=deceleration,
            heartbeat=heartbeat if heartbeat is not None else Heartbeat(),
        )  # fmt: skip

    def follow(
        self, t: float, trajectory: Trajectory, deceleration: float = math.inf, heartbeat: Heartbeat | None = None
    ) -> None:
        """From `t` on the motor's counter follows `trajectory`, on a heartbeat that ends it with a ramp."""
        self._drives.set(t, self.driven(t, trajectory, deceleration, heartbeat))

    def recount(self, t: float, position: float, per_full: int) -> Trajectory:
        """The counter is set to `position`, in microsteps of `per_full` a full step: nothing moves. Returns the rest."""
        rest = rest_at(position, t)
        old = self._drives.at(t)
        origin = old.full_steps(t) - position / per_full
        self._drives.set(t, replace(self.driven(t, rest), per_full=per_full, origin=origin))
        return rest

    def jam(self, t: float, jammed: bool = True) -> None:
        """From `t` on the axis stands, whatever its motor's counter does; or turns again, the rotor falling in at the
        nearest place where the motor's field is what it is now."""
        old = self._drives.at(t)
        if jammed and not old.jammed:
            self._drives.set(t, replace(old, since=t, start_deg=old.angle_deg(t), jammed=True))
            self.listener(t)
        elif old.jammed and not jammed:
            deg_per_cycle = ELECTRIC_CYCLE * self.mechanics.deg_per_full_step
            ahead = self.mechanics.zero_deg + old.full_steps(t) * self.mechanics.deg_per_full_step - old.start_deg
            origin = old.origin - ELECTRIC_CYCLE * round(ahead / deg_per_cycle)
            self._drives.set(t, replace(old, since=t, origin=origin, jammed=False))
            self.listener(t)
