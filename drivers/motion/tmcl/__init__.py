"""TMCL: Trinamic motion modules on a serial line.

`TmclModule` exchanges requests and replies, checks them, and carries out a stop before anything else. `explain` gives a
frame as text for transcripts.
"""

from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.drivers.motion.tmcl.rules import explain

__all__ = ["TmclModule", "explain"]
