"""The rig file: addresses and nominal properties of the devices; opening the devices of a rig file.

What opens them is loaded at its first use: `check` does without the libraries of the buses.
"""

from typing import TYPE_CHECKING

from goniotwin.app.rig.axes import AXES as AXES
from goniotwin.app.rig.description import RigDescription as RigDescription
from goniotwin.app.rig.description import parse_rig as parse_rig
from goniotwin.app.rig.description import read_rig as read_rig
from goniotwin.app.rig.file import RigFile as RigFile
from goniotwin.app.rig.file import arc_clearance as arc_clearance
from goniotwin.app.rig.file import axis_settings as axis_settings
from goniotwin.app.rig.file import axis_timings as axis_timings
from goniotwin.app.rig.file import nominal_instrument as nominal_instrument
from goniotwin.app.rig.file import rig_file_table as rig_file_table
from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.app.rig.opening import OpenRig as OpenRig
    from goniotwin.app.rig.opening import open_rig as open_rig
else:
    __getattr__, __dir__ = first_use(__name__)
