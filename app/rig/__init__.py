"""The rig file: addresses and nominal properties of the devices; opening the devices of a rig file."""

from goniotwin.app.rig.axes import AXES as AXES
from goniotwin.app.rig.file import RigFile as RigFile
from goniotwin.app.rig.file import arc_clearance as arc_clearance
from goniotwin.app.rig.file import axis_settings as axis_settings
from goniotwin.app.rig.file import axis_timings as axis_timings
from goniotwin.app.rig.file import nominal_instrument as nominal_instrument
from goniotwin.app.rig.file import rig_file_table as rig_file_table
from goniotwin.app.rig.opening import OpenRig as OpenRig
from goniotwin.app.rig.opening import RigDescription as RigDescription
from goniotwin.app.rig.opening import open_rig as open_rig
from goniotwin.app.rig.opening import parse_rig as parse_rig
from goniotwin.app.rig.opening import read_rig as read_rig
