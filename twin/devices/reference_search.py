"""Reference searches (RFS): the whole trajectory, computed at the start.

Source: TMCL manuals, axis parameter 193. They leave open where exactly zero is; here it is (*)
- at an end switch (modes 1, 2): where the switch lets go when it is left slowly;
- at an end switch from both sides (modes 3, 4): in the middle between that place and where it closes again, slowly;
- at the home switch (modes 5 to 8): the edge that is met in the search's own first direction, slowly.
"""

from collections.abc import Callable
from dataclasses import dataclass

from goniotwin.protocols.tmcl_parameters import SWAPPED, SearchMode
from goniotwin.twin.devices.switches import Switch, when_switched
from goniotwin.twin.plant.motion import Trajectory, brake_to_rest, cut_off, join, ramp_to_target, ramp_to_velocity
from goniotwin.twin.plant.shaft import Drive

Seen = tuple[Switch, bool]
LAST_STATE = 9


@dataclass(frozen=True)
class ReferenceSearch:
    """A search's whole way. `end` and `zero` (the counter at the reference) are None where it finds nothing.

    `phases` are the times at which its parts begin; `distance` is that between the end switches, where it has seen both.
    """

    trajectory: Trajectory
    phases: tuple[float, ...]
    end: float | None = None
    zero: float | None = None
    distance: float | None = None

    def state(self, t: float) -> int:
        """RFS status: 0 when it is over, else its state."""
        if self.end is not None and t >= self.end:
            return 0
        return min(LAST_STATE, max(1, sum(begun <= t for begun in self.phases)))


@dataclass(frozen=True)
class Means:
    """Inputs of a search: speeds (pps), slopes (pps/s), switches, and the effect of its trajectory on the shaft."""

    fast: float
    slow: float
    acceleration: float
    deceleration: float
    left: Switch
    right: Switch
    home: Switch
    left_disabled: bool
    right_disabled: bool
    driven: Callable[[Trajectory], Drive]


class _NothingFound(Exception):
    """The search finds no reference: it runs, or stands at a switch, until it is stopped."""


def search(mode: int, start: Trajectory, t: float, means: Means) -> ReferenceSearch:
    """The search of a mode (SearchMode and what is added to it), from a movement that ends at once."""
    course = _Course(start, t, means)
    zero, distance = None, None
    try:
        kind = SearchMode(mode & 15)
        zero, distance = _home(course, kind) if kind >= SearchMode.HOME_NEGATIVE else _end_switch(course, kind, mode)
    except _NothingFound:
        return ReferenceSearch(course.trajectory, tuple(course.phases))
    return ReferenceSearch(course.trajectory, tuple(course.phases), course.t, zero, distance)


def known(mode: int) -> bool:
    """Whether the mode exists."""
    kind = mode & 15
    added = mode - kind
    return (1 <= kind <= 4 and added in (0, SWAPPED)) or (5 <= kind <= 8 and added in (0, 128))


def _end_switch(course: "_Course", kind: SearchMode, mode: int) -> tuple[float, float | None]:
    side = 1 if mode & SWAPPED else -1
    fast, slow = course.means.fast, course.means.slow
    stop, other = course.stop(side), course.stop(-side)
    far = None
    if kind in (SearchMode.RIGHT_THEN_LEFT, SearchMode.RIGHT_THEN_LEFT_BOTH_SIDES):
        far = course.run(-side * fast, (other, True))
    course.run(side * fast, (stop, True))
    zero = course.run(-side * slow, (stop, False))
    if kind in (SearchMode.RIGHT_THEN_LEFT_BOTH_SIDES, SearchMode.LEFT_BOTH_SIDES):
        zero = 0.5 * (zero + course.run(side * slow, (stop, True)))
        course.go(zero, slow)
    return zero, None if far is None else abs(far - zero)


def _home(course: "_Course", kind: SearchMode) -> tuple[float, None]:
    side = 1 if kind in (SearchMode.HOME_POSITIVE, SearchMode.HOME_POSITIVE_NO_STOPS) else -1
    ends = kind in (SearchMode.HOME_NEGATIVE, SearchMode.HOME_POSITIVE)
    fast, slow = course.means.fast, course.means.slow
    home, stop = course.means.home, course.stop(side)
    if not course.is_active(home):
        course.run(side * fast, (home, True), *([(stop, True)] if ends else []), brake=True, ends=ends)
    # Now to the side from which the edge is met in the search's own direction, out of the switch or right across it.
    if not course.is_active(home):
        course.run(-side * fast, (home, True), brake=True, ends=ends)
    if course.is_active(home):
        course.run(-side * fast, (home, False), brake=True, ends=ends)
    return course.run(side * slow, (home, True), ends=ends), None


class _Course:
    """A movement made of several, each beginning where the last has ended."""

    def __init__(self, start: Trajectory, t: float, means: Means) -> None:
        self.means = means
        self.trajectory = brake_to_rest(start, t, means.deceleration)
        self.t = max(t, self.trajectory.end)
        self.phases: list[float] = [t]

    def stop(self, side: int) -> Switch:
        """The end switch of a direction."""
        return self.means.right if side > 0 else self.means.left

    def is_active(self, switch: Switch) -> bool:
        """Whether a switch is active at the end of the course."""
        return switch.active(self.means.driven(self.trajectory).angle_deg(self.t))

    def run(self, velocity: float, *seen: Seen, brake: bool = False, ends: bool = True) -> float:
        """Turns until the first of some switches is as wanted, and stops, over a ramp if it is to `brake`.

        Returns the counter at which the switch was seen.
        """
        self.phases.append(self.t)
        means = self.means
        position = self.trajectory.position(self.t)
        ahead = join(self.trajectory, ramp_to_velocity(self.t, position, 0.0, velocity, means.acceleration, means.deceleration))
        drive = means.driven(ahead)
        direction = 1 if velocity > 0.0 else -1
        found = [when_switched(drive, self.t, switch, wanted, direction) for switch, wanted in seen]
        first = min((t for t in found if t is not None), default=None)
        disabled = means.right_disabled if direction > 0 else means.left_disabled
        barrier = None
        if ends and not disabled:
            barrier = when_switched(drive, self.t, self.stop(direction), True, direction)
        if barrier is not None and (first is None or barrier < first):
            self.trajectory = cut_off(ahead, barrier)
            raise _NothingFound
        if first is None:
            self.trajectory = ahead
            raise _NothingFound
        self.trajectory = brake_to_rest(ahead, first, means.deceleration) if brake else cut_off(ahead, first)
        self.t = self.trajectory.end
        return ahead.position(first)

    def go(self, position: float, speed: float) -> None:
        """Move to a position."""
        means, here = self.means, self.trajectory.position(self.t)
        way = ramp_to_target(self.t, here, 0.0, position, speed, means.acceleration, means.deceleration)
        self.trajectory = join(self.trajectory, way)
        self.t = self.trajectory.end
