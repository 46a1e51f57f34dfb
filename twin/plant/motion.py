"""Ramps: the position of a stepper motor as a function of time, after a motion command.

A trajectory is a sequence of pieces of constant acceleration, in microsteps, pps and pps/s. It is evaluated at a time; there
are no ticks.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import NamedTuple


class Piece(NamedTuple):
    """Piece of a trajectory from the time `t` on: position, velocity and a constant acceleration."""

    t: float
    position: float
    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Pieces in order of time. The last one has no acceleration and no end."""

    pieces: tuple[Piece, ...]

    @property
    def end(self) -> float:
        """Start of the last piece, s: from then on the axis rests or turns at constant velocity."""
        return self.pieces[-1].t

    def position(self, t: float) -> float:
        """Position in microsteps at the time `t`."""
        piece = self._piece(t)
        dt = max(0.0, t - piece.t)
        return piece.position + dt * (piece.velocity + 0.5 * dt * piece.acceleration)

    def velocity(self, t: float) -> float:
        """Velocity in pps at the time `t`, signed."""
        piece = self._piece(t)
        return piece.velocity + max(0.0, t - piece.t) * piece.acceleration

    def _piece(self, t: float) -> Piece:
        if t >= self.pieces[-1].t:
            return self.pieces[-1]
        return self.pieces[max(0, bisect_right(self.pieces, t, key=lambda piece: piece.t) - 1)]


def rest_at(position: float, t: float = 0.0) -> Trajectory:
    """Trajectory at rest."""
    return Trajectory((Piece(t, position, 0.0, 0.0),))


def ramp_to_velocity(
    now: float, position: float, velocity: float, wanted: float, acceleration: float, deceleration: float
) -> Trajectory:
    """Ramp from the present velocity to the `wanted` one (0: stop), then at constant velocity."""
    pieces: list[Piece] = []
    if velocity * wanted < 0.0:  # through standstill: first decelerate, then accelerate
        now, position, velocity = _slope(pieces, now, position, velocity, 0.0, deceleration)
    faster = abs(wanted) > abs(velocity)
    now, position, velocity = _slope(pieces, now, position, velocity, wanted, acceleration if faster else deceleration)
    return Trajectory((*pieces, Piece(now, position, velocity, 0.0)))


def ramp_to_target(
    now: float,
    position: float,
    velocity: float,
    target: float,
    speed: float,
    acceleration: float,
    deceleration: float,
) -> Trajectory:
    """Trapezoidal ramp to `target`, from rest or from a movement (which may have to reverse first)."""
    pieces: list[Piece] = []
    way = target - position
    braking = velocity * abs(velocity) / (2.0 * deceleration)
    if velocity * way < 0.0 or abs(braking) > abs(way):
        now, position, velocity = _slope(pieces, now, position, velocity, 0.0, deceleration)
        way = target - position
    direction = math.copysign(1.0, way)
    distance = abs(way)
    if abs(velocity) > speed:
        now, position, velocity = _slope(pieces, now, position, velocity, direction * speed, deceleration)
        distance = abs(target - position)
    peak = math.sqrt(
        (distance + velocity * velocity / (2.0 * acceleration))
        * 2.0
        * acceleration
        * deceleration
        / (acceleration + deceleration)
    )
    peak = min(peak, speed)
    if distance > 0.0:
        now, position, velocity = _slope(pieces, now, position, velocity, direction * peak, acceleration)
        cruise = abs(target - position) - peak * peak / (2.0 * deceleration)
        if cruise > 0.0:
            pieces.append(Piece(now, position, velocity, 0.0))
            now, position = now + cruise / peak, position + direction * cruise
        now, _, _ = _slope(pieces, now, position, velocity, 0.0, deceleration)
    return Trajectory((*pieces, Piece(now, target, 0.0, 0.0)))


def cut_off(trajectory: Trajectory, t: float) -> Trajectory:
    """The trajectory until `t`, then at rest at once."""
    return _append(trajectory, rest_at(trajectory.position(t), t))


def brake_to_rest(trajectory: Trajectory, t: float, deceleration: float) -> Trajectory:
    """The trajectory until `t`, then a ramp to rest."""
    position, velocity = trajectory.position(t), trajectory.velocity(t)
    return _append(trajectory, ramp_to_velocity(t, position, velocity, 0.0, deceleration, deceleration))


def join(first: Trajectory, second: Trajectory) -> Trajectory:
    """The first trajectory until the second starts."""
    return _append(first, second)


def turning_points(trajectory: Trajectory, start: float) -> list[float]:
    """Times from `start` (included) on, between which the direction of movement does not change."""
    times = [start]
    for piece, after in zip(trajectory.pieces, (*trajectory.pieces[1:], None), strict=True):
        if piece.acceleration != 0.0:
            zero = piece.t - piece.velocity / piece.acceleration
            if piece.t < zero and (after is None or zero < after.t) and zero > times[-1]:
                times.append(zero)
        if after is not None and after.t > times[-1]:
            times.append(after.t)
    return times


def _append(first: Trajectory, second: Trajectory) -> Trajectory:
    """The first trajectory until the second starts, then the second."""
    start = second.pieces[0].t
    return Trajectory((*(piece for piece in first.pieces if piece.t < start), *second.pieces))


def _slope(
    pieces: list[Piece], now: float, position: float, velocity: float, wanted: float, slope: float
) -> tuple[float, float, float]:
    """Append the piece from one velocity to another. Returns time, position and velocity at its end."""
    change = wanted - velocity
    if change == 0.0:
        return now, position, velocity
    duration = abs(change) / slope
    pieces.append(Piece(now, position, velocity, math.copysign(slope, change)))
    return now + duration, position + 0.5 * (velocity + wanted) * duration, wanted
