"""TMCL: Trinamic motion modules on a serial line.

`TmclController` is one line with its axes. `TmclModule` exchanges requests and replies, checks them, and carries out a stop
before anything else. `TmclAxis` is one motor as an angle; it starts a `Move` or a `HomingSearch`, which the engine polls.
`axis_timing` gives the durations of its moves, `explain` a frame as text for transcripts.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.drivers.motion.tmcl.axis import TmclAxis as TmclAxis
    from goniotwin.drivers.motion.tmcl.axis import axis_timing as axis_timing
    from goniotwin.drivers.motion.tmcl.controller import TmclController as TmclController
    from goniotwin.drivers.motion.tmcl.controller import TmclSettings as TmclSettings
    from goniotwin.drivers.motion.tmcl.homing import HomingSearch as HomingSearch
    from goniotwin.drivers.motion.tmcl.module import TmclModule as TmclModule
    from goniotwin.drivers.motion.tmcl.module import default_reply_timeout_s as default_reply_timeout_s
    from goniotwin.drivers.motion.tmcl.move import Move as Move
    from goniotwin.drivers.motion.tmcl.port import exchange_seconds as exchange_seconds
    from goniotwin.drivers.motion.tmcl.registers import Switches as Switches
    from goniotwin.drivers.motion.tmcl.rules import CANARY as CANARY
    from goniotwin.drivers.motion.tmcl.rules import explain as explain
else:
    __getattr__, __dir__ = first_use(__name__)
