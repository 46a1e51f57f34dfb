"""Motion: the axes of the goniophotometer and their controllers, the stop of all of them, the clearance of the arc.

`MotionController` and `Axis` are what a controller of any make and its axes are to the rig, `AxisTiming` what an axis is to
the planner. `tmcl` is the first make; `StopLock` and `stop_all` are for every make. `ArcClearance` decides which positions of
the arc would block the incoming beam.
"""

from goniotwin.drivers.motion.axis import (
    Axis,
    AxisDescription,
    AxisTiming,
    PendingMove,
    check_limits,
    limit_violation,
    within_limits,
)
from goniotwin.drivers.motion.clearance import ArcClearance
from goniotwin.drivers.motion.controller import MotionController
from goniotwin.drivers.motion.settings import AxisSettings, Homing
from goniotwin.drivers.motion.stop import StopPhase, StopSteps, stop_all
from goniotwin.drivers.motion.stop_lock import StopLock
from goniotwin.drivers.motion.tmcl import TmclController

__all__ = [
    "ArcClearance",
    "Axis",
    "AxisDescription",
    "AxisSettings",
    "AxisTiming",
    "Homing",
    "MotionController",
    "PendingMove",
    "StopLock",
    "StopPhase",
    "StopSteps",
    "TmclController",
    "check_limits",
    "limit_violation",
    "stop_all",
    "within_limits",
]
