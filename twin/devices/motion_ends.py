"""Early ends of a movement: a limit switch, a stall, a deviation between encoder and counter."""

from collections.abc import Callable
from dataclasses import dataclass

from goniotwin.protocols.tmcl_parameters import ErrorFlag
from goniotwin.twin.devices.encoder import MICROSTEPS
from goniotwin.twin.devices.switches import Switch, when_switched, when_true
from goniotwin.twin.optics.geometry.coordinates import TURN_DEG
from goniotwin.twin.plant.shaft import Drive

NO_FLAG = ErrorFlag(0)
STALL_HORIZON_S = 1.0


@dataclass(frozen=True)
class MotionEnd:
    """Cause and time of the end of a movement: `soft` over a ramp, else at once."""

    t: float
    flag: ErrorFlag = NO_FLAG
    soft: bool = False


@dataclass(frozen=True)
class Guards:
    """Limits that a motor obeys: its switches where they are enabled, the speed (pps) above which a stall stops it (0: never),
    by how much the encoder may deviate (0: at all), and the encoder's reading at an angle."""

    right: Switch | None
    left: Switch | None
    soft: bool
    stall_pps: float
    deviation: int
    encoder: Callable[[float], float] | None


def next_motion_end(drive: Drive, t: float, guards: Guards) -> MotionEnd | None:
    """The first early end of a movement; None without any."""
    halts: list[MotionEnd] = []
    for switch, side in ((guards.right, 1), (guards.left, -1)):
        met = when_switched(drive, t, switch, True, side) if switch is not None else None
        if met is not None:
            halts.append(MotionEnd(met, soft=guards.soft))
    if guards.stall_pps > 0.0 and drive.jammed:
        met = when_true(drive, t, lambda t: abs(drive.trajectory.velocity(t)) >= guards.stall_pps, STALL_HORIZON_S)
        if met is not None:
            halts.append(MotionEnd(met, ErrorFlag.STALL))
    if guards.deviation and guards.encoder is not None:
        met = _deviation(drive, t, guards.encoder, guards.deviation)
        if met is not None:
            halts.append(MotionEnd(met, ErrorFlag.DEVIATION))
    return min(halts, key=lambda halt: halt.t, default=None)


def _deviation(drive: Drive, t: float, encoder: Callable[[float], float], most: int) -> float | None:
    scale = MICROSTEPS / abs(drive.per_full)

    def deviates(t: float) -> bool:
        return abs(encoder(drive.angle_deg(t)) - drive.counter(t) * scale) > most

    # A steady movement that has not deviated after a turn and twice the allowed way never will.
    speed = abs(drive.trajectory.pieces[-1].velocity)
    way = abs(TURN_DEG / drive.mechanics.deg_per_full_step * drive.per_full) + 2.0 * most / scale
    return when_true(drive, t, deviates, way / speed if speed else 0.0)
