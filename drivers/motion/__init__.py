"""Motion: the axes of the goniophotometer, with moves, homing, reference and clearance of the arc.

`Axis` is one motor as an angle; it starts a `Move` or a `HomingSearch`, which the engine polls. `ArcClearance` decides which
positions of the arc would block the incoming beam. `tmcl` is the controller: a `TmclModule` is its serial line.
"""

from goniotwin.drivers.motion.axis import Axis
from goniotwin.drivers.motion.clearance import ArcClearance
from goniotwin.drivers.motion.homing import HomingSearch
from goniotwin.drivers.motion.move import Move
from goniotwin.drivers.motion.registers import Switches
from goniotwin.drivers.motion.settings import AxisSettings, Homing
from goniotwin.drivers.motion.tmcl import TmclModule

__all__ = ["ArcClearance", "Axis", "AxisSettings", "Homing", "HomingSearch", "Move", "Switches", "TmclModule"]
