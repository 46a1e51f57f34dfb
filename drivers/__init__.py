"""The computer's side of the wires: devices with typed interfaces, told and asked, and the rig that they make.

No call lasts longer than one exchange on its wire; what takes time is started and polled. Drivers open nothing by
name: they are given openers.
"""

from goniotwin.drivers.axis import Axis, AxisSettings, Homing
from goniotwin.drivers.errors import BadAnswer, DeviceError, Forgotten, LimitError, NoAnswer, Refused
from goniotwin.drivers.interlock import ArcClearance
from goniotwin.drivers.monitor import Monitor, MonitorSettings
from goniotwin.drivers.monochromator import Monochromator
from goniotwin.drivers.monochromator_settings import MonochromatorSettings
from goniotwin.drivers.order_filters import FilterWheel, OrderFilter
from goniotwin.drivers.pending import Pending, Poll, Until, wait
from goniotwin.drivers.photodiodes import PhotodiodeArray, PhotodiodeSettings
from goniotwin.drivers.rig import Rig
from goniotwin.drivers.tap import Transcript
from goniotwin.drivers.tmcl import TmclModule

__all__ = [
    "ArcClearance",
    "Axis",
    "AxisSettings",
    "BadAnswer",
    "DeviceError",
    "FilterWheel",
    "Forgotten",
    "Homing",
    "LimitError",
    "Monitor",
    "MonitorSettings",
    "Monochromator",
    "MonochromatorSettings",
    "NoAnswer",
    "OrderFilter",
    "Pending",
    "PhotodiodeArray",
    "PhotodiodeSettings",
    "Poll",
    "Refused",
    "Rig",
    "TmclModule",
    "Transcript",
    "Until",
    "wait",
]
