"""The rig file: addresses and nominal properties of the devices; opening the devices of a rig file."""

from goniotwin.app.rig.axes import AXES
from goniotwin.app.rig.file import (
    RigFile,
    arc_clearance,
    axis_settings,
    axis_timings,
    nominal_instrument,
    rig_file_table,
)
from goniotwin.app.rig.opening import OpenRig, RigDescription, open_rig, parse_rig, read_rig

__all__ = [
    "AXES",
    "OpenRig",
    "RigDescription",
    "RigFile",
    "arc_clearance",
    "axis_settings",
    "axis_timings",
    "nominal_instrument",
    "open_rig",
    "parse_rig",
    "read_rig",
    "rig_file_table",
]
