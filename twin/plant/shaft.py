"""Shaft: from a motor's microsteps to the angle of an axis. The motor works in microsteps, the axis in degrees."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

from goniotwin.twin.plant.history import Changes, History
from goniotwin.twin.plant.model import Mechanics
from goniotwin.twin.plant.motion import Trajectory, brake_to_rest, rest_at, turning_points

ELECTRIC_CYCLE = 4
"""Full steps in one period of a stepper motor's field. A rotor that was held falls back into step at a multiple of it."""


@dataclass(slots=True)
class Heartbeat:
    """Time limit of a movement without a message from the host: at `until` the motor brakes (the module's heartbeat)."""

    until: float = math.inf


@dataclass(frozen=True)
class Drive:
    """Trajectory in microsteps from `since` on, and the relation of its counter to the shaft.

    Full steps of the motor = origin + microsteps / per_full. `per_full` is negative where the shaft is reversed. The axis was
    at `start_deg` at `since`, and stays there while it is jammed. `moves` is the number of its moves so far, this one included.
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
    moves: int = 0

    def angle_deg(self, t: float) -> float:
        """Angle of the axis at `t`."""
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

    def resting_deg(self, counter: float) -> float | None:
        """Angle at which the axis comes to rest at a counter value; None where its way there decides."""
        if self.jammed or self.mechanics.backlash_deg != 0.0:
            return None
        return self.mechanics.zero_deg + (self.origin + counter / self.per_full) * self.mechanics.deg_per_full_step

    def full_steps(self, t: float) -> float:
        """Position of the motor in full steps, without a jam."""
        return self.origin + self.counter(t) / self.per_full

    def counter(self, t: float) -> float:
        """Counter at `t`, microsteps."""
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
    """One axis of the plant. `jam` belongs to simulation control; it notifies `listener` with the time."""

    def __init__(self, mechanics: Mechanics, changes: Changes | None = None) -> None:
        self.mechanics = mechanics
        self.listener: Callable[[float], object] = float
        self._drives = History(Drive(mechanics, rest_at(0.0), start_deg=mechanics.zero_deg), changes=changes)

    @property
    def jammed(self) -> bool:
        """Whether the axis is blocked now."""
        return self._drives.newest.jammed

    def drive(self, t: float) -> Drive:
        """Drive at `t`."""
        return self._drives.at(t)

    def angle_deg(self, t: float) -> float:
        """True angle at `t`."""
        return self._drives.at(t).angle_deg(t)

    @property
    def newest(self) -> Drive:
        """Newest drive."""
        return self._drives.newest

    @property
    def last_change(self) -> float:
        """Time from which the axis is at rest, s; infinity where it turns without end.

        An expired heartbeat does not make it later.
        """
        last = self._drives.newest.trajectory.pieces[-1]
        return max(self._drives.last_change, last.t) if last.velocity == 0.0 else math.inf

    def moved_since(self, t: float) -> bool:
        """Whether the axis may have moved after `t`."""
        return t < self.last_change

    def drive_along(
        self, t: float, trajectory: Trajectory, deceleration: float = math.inf, heartbeat: Heartbeat | None = None
    ) -> Drive:
        """Drive that would result if the motor's counter followed `trajectory` from `t` on."""
        old = self._drives.at(t)
        return replace(
            old,
            trajectory=trajectory,
            since=t,
            start_deg=old.angle_deg(t),
            deceleration=deceleration,
            heartbeat=heartbeat if heartbeat is not None else Heartbeat(),
        )

    def follow(
        self, t: float, trajectory: Trajectory, deceleration: float = math.inf, heartbeat: Heartbeat | None = None
    ) -> None:
        """Let the motor's counter follow `trajectory` from `t` on; an expired `heartbeat` ends it with a ramp."""
        drive, last = self.drive_along(t, trajectory, deceleration, heartbeat), trajectory.pieces[-1]
        moves = last.velocity != 0.0 or last.position != trajectory.position(t)
        self._drives.set(t, replace(drive, moves=drive.moves + 1) if moves else drive)

    def recount(self, t: float, position: float, per_full: int) -> Trajectory:
        """Set the counter to `position`, in microsteps of `per_full` per full step. Nothing moves.

        Returns the trajectory at rest.
        """
        rest = rest_at(position, t)
        old = self._drives.at(t)
        origin = old.full_steps(t) - position / per_full
        self._drives.set(t, replace(self.drive_along(t, rest), per_full=per_full, origin=origin))
        return rest

    def jam(self, t: float, jammed: bool = True) -> None:
        """Block the axis from `t` on, or release it.

        A blocked axis stands still while its motor's counter changes. On release the rotor falls into step at the nearest
        position with the present phase of the motor's field.
        """
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
