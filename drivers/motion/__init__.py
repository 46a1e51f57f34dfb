"""Motion: the axes of the goniophotometer and their controllers, the stop of all of them, the clearance of the arc.

`MotionController` and `Axis` are what a controller of any make and its axes are to the rig, `AxisTiming` what an axis is to
the planner. `tmcl` is the first make; `StopLock` and `stop_all` are for every make. `ArcClearance` decides which positions of
the arc would block the incoming beam.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.drivers.motion.axis import Axis as Axis
    from goniotwin.drivers.motion.axis import AxisDescription as AxisDescription
    from goniotwin.drivers.motion.axis import AxisTiming as AxisTiming
    from goniotwin.drivers.motion.axis import PendingMove as PendingMove
    from goniotwin.drivers.motion.axis import check_limits as check_limits
    from goniotwin.drivers.motion.axis import limit_violation as limit_violation
    from goniotwin.drivers.motion.axis import within_limits as within_limits
    from goniotwin.drivers.motion.clearance import ArcClearance as ArcClearance
    from goniotwin.drivers.motion.controller import MotionController as MotionController
    from goniotwin.drivers.motion.settings import AxisSettings as AxisSettings
    from goniotwin.drivers.motion.settings import Homing as Homing
    from goniotwin.drivers.motion.stop import StopPhase as StopPhase
    from goniotwin.drivers.motion.stop import StopSteps as StopSteps
    from goniotwin.drivers.motion.stop import stop_all as stop_all
    from goniotwin.drivers.motion.stop_lock import StopLock as StopLock
    from goniotwin.drivers.motion.tmcl import TmclController as TmclController
else:
    __getattr__, __dir__ = first_use(__name__)
