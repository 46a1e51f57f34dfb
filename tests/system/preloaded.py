"""Loads what a campaign needs at its start: for the server from which the tests fork the program's processes.

numba takes half a second to load the virtual rig's kernels from its cache, and each of a hundred processes would.
"""

from goniotwin.app.cli import campaign, data
from goniotwin.app.rig import open_rig, read_rig
from goniotwin.protocols.clock import VirtualClock
from tests.conftest import RIG

__all__ = ["campaign", "data"]

with open_rig(read_rig(RIG), VirtualClock()) as opened:
    opened.connect()
    opened.rig.photodiodes.start_readings(1)
