"""Switches of an axis, and the times in a movement at which their states change."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from goniotwin.twin.optics.geometry.coordinates import TURN_DEG
from goniotwin.twin.plant.model import Mechanics
from goniotwin.twin.plant.motion import Trajectory, turning_points
from goniotwin.twin.plant.shaft import Drive

BISECTIONS = 80
EDGES = 10_000
SAMPLES = 64
PAST_EDGE_DEG = 1e-9


class Place(Enum):
    """Kind of switch."""

    LOWER = "lower"
    UPPER = "upper"
    HOME = "home"


@dataclass(frozen=True)
class Switch:
    """A switch of an axis; `inverted` inverts its logic."""

    mechanics: Mechanics
    place: Place
    inverted: bool = False

    def active(self, angle_deg: float) -> bool:
        """Its logical state with the axis at an angle. One that is not fitted is open."""
        return self._closed(angle_deg) is not self.inverted

    def edge_deg(self, angle_deg: float, direction: int) -> float | None:
        """The next angle upwards (1) or downwards (-1) at which it changes; None where there is none."""
        mechanics = self.mechanics
        if self.place is Place.HOME:
            if mechanics.home_deg is None or not 0.0 < mechanics.home_width_deg < TURN_DEG:
                return None
            edges = [mechanics.home_deg, mechanics.home_deg + mechanics.home_width_deg]
            return angle_deg + direction * min(_ahead(edge, angle_deg, direction) for edge in edges)
        at = mechanics.lower_switch_deg if self.place is Place.LOWER else mechanics.upper_switch_deg
        if at is None:
            return None
        leaving = direction == (1 if self.place is Place.LOWER else -1)  # it is closed at the very edge
        way = (at - angle_deg) * direction
        return at if way > 0.0 or (way == 0.0 and leaving) else None

    def _closed(self, angle_deg: float) -> bool:
        mechanics = self.mechanics
        match self.place:
            case Place.LOWER:
                return mechanics.lower_switch_deg is not None and angle_deg <= mechanics.lower_switch_deg
            case Place.UPPER:
                return mechanics.upper_switch_deg is not None and angle_deg >= mechanics.upper_switch_deg
            case Place.HOME:
                return mechanics.home_deg is not None and (angle_deg - mechanics.home_deg) % TURN_DEG < mechanics.home_width_deg


def _ahead(edge: float, angle: float, direction: int) -> float:
    """Distance to an edge in a direction, more than 0 and at most a turn."""
    way = ((edge - angle) * direction) % TURN_DEG
    # At the very edge it is as it is above it: downwards it changes there, upwards it has changed.
    return way if way > 0.0 or direction < 0 else TURN_DEG


def when_switched(drive: Drive, start: float, switch: Switch, wanted: bool, direction: int = 0) -> float | None:
    """From `start` on the first time at which a switch is as wanted while the counter runs in a direction (0: in any).

    A moment just after the edge is given, so that the switch is then as wanted. None: it never is.
    """
    trajectory = drive.trajectory
    times = turning_points(trajectory, start)
    for begin, end in zip(times, [*times[1:], math.inf], strict=True):
        runs = _sign(trajectory, begin, end)
        if runs == 0 or (direction and runs != direction):
            continue
        found = _in_segment(drive, begin, end, switch, wanted)
        if found is not None:
            return found
    return None


def when_true(drive: Drive, start: float, condition: Callable[[float], bool], longest_s: float) -> float | None:
    """From `start` on the first time at which something holds, by sampling each piece of the movement and bisecting."""
    times = turning_points(drive.trajectory, start)
    for begin, end in zip(times, [*times[1:], times[-1] + longest_s], strict=True):
        before = begin
        for k in range(SAMPLES + 1):
            t = begin + (end - begin) * k / SAMPLES
            if condition(t):
                return t if t == begin else _bisected(before, t, condition)
            before = t
    return None


def _in_segment(drive: Drive, begin: float, end: float, switch: Switch, wanted: bool) -> float | None:
    """First time in a segment of one direction; there the angle is monotonic."""
    angle = drive.angle_deg(begin)
    if switch.active(angle) is wanted:
        return begin
    speed = abs(drive.trajectory.pieces[-1].velocity / drive.per_full * drive.mechanics.deg_per_full_step)
    up = 1 if _moved(drive, begin, end) > 0.0 else -1
    for _ in range(EDGES):
        edge = switch.edge_deg(angle, up)
        if edge is None or drive.jammed:
            return None
        last = end if end < math.inf else begin + (abs(edge - angle) + drive.mechanics.backlash_deg) / speed + 1.0
        if (drive.angle_deg(last) - edge) * up < 0.0:
            return None
        t = _bisected(begin, last, lambda t, edge=edge: (drive.angle_deg(t) - edge) * up > 0.0)  # type: ignore[misc]
        if switch.active(drive.angle_deg(t)) is wanted:
            return t
        begin, angle = t, edge + up * PAST_EDGE_DEG
    return None


def _moved(drive: Drive, begin: float, end: float) -> float:
    """Direction of the axis, by the sign."""
    last = end if end < math.inf else begin + 1.0
    return (drive.counter(last) - drive.counter(begin)) / drive.per_full * drive.mechanics.deg_per_full_step


def _sign(trajectory: Trajectory, begin: float, end: float) -> int:
    velocity = trajectory.velocity(begin + 1.0 if end == math.inf else 0.5 * (begin + end))
    return (velocity > 0.0) - (velocity < 0.0)


def _bisected(before: float, after: float, condition: Callable[[float], bool]) -> float:
    """The first time at which a condition holds that does not hold before and does after."""
    for _ in range(BISECTIONS):
        middle = 0.5 * (before + after)
        if middle in (before, after):
            break
        if condition(middle):
            after = middle
        else:
            before = middle
    return after
