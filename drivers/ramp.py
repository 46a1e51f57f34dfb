"""How long a stepper axis takes for a way: the trapezoid that motion controllers drive."""

import math


def move_seconds(way: float, speed: float, acceleration: float, deceleration: float | None = None) -> float:
    """Seconds from rest to rest over `way` (any sign); the units of way, speed and accelerations belong together."""
    distance = abs(way)
    down = acceleration if deceleration is None else deceleration
    ramps = 0.5 * speed * speed * (1.0 / acceleration + 1.0 / down)
    if distance >= ramps:
        return speed / acceleration + speed / down + (distance - ramps) / speed
    peak = math.sqrt(2.0 * distance * acceleration * down / (acceleration + down))
    return peak / acceleration + peak / down
