"""The computer's side of the wires: devices with typed interfaces, told and asked, and the rig that they make.

No call lasts longer than one exchange on its wire; what takes time is started and polled. Drivers open nothing by
name: they are given openers.
"""

from drivers.axis import Axis, AxisSettings, Homing
from drivers.errors import BadAnswer, DeviceError, Forgotten, LimitError, NoAnswer, Refused
from drivers.interlock import ArcClearance
from drivers.monitor import Monitor, MonitorSettings
from drivers.monochromator import Monochromator
from drivers.monochromator_settings import MonochromatorSettings
from drivers.order_filters import FilterWheel, OrderFilter
from drivers.pending import Pending, Poll, Until, wait
from drivers.photodiodes import PhotodiodeArray, PhotodiodeSettings
from drivers.rig import Rig
from drivers.tap import Transcript
from drivers.tmcl import TmclModule

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
