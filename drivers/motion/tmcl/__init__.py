"""TMCL: Trinamic motion modules on a serial line.

`TmclController` is one line with its axes. `TmclModule` exchanges requests and replies, checks them, and carries out a stop
before anything else. `TmclAxis` is one motor as an angle; it starts a `Move` or a `HomingSearch`, which the engine polls.
`axis_timing` gives the durations of its moves, `explain` a frame as text for transcripts.
"""

from goniotwin.drivers.motion.tmcl.axis import TmclAxis, axis_timing
from goniotwin.drivers.motion.tmcl.controller import TmclController, TmclSettings
from goniotwin.drivers.motion.tmcl.homing import HomingSearch
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.drivers.motion.tmcl.move import Move
from goniotwin.drivers.motion.tmcl.port import exchange_seconds
from goniotwin.drivers.motion.tmcl.registers import Switches
from goniotwin.drivers.motion.tmcl.rules import CANARY, explain

__all__ = [
    "CANARY",
    "HomingSearch",
    "Move",
    "Switches",
    "TmclAxis",
    "TmclController",
    "TmclModule",
    "TmclSettings",
    "axis_timing",
    "exchange_seconds",
    "explain",
]
