"""Drivers: the devices of the goniophotometer on their wires, and the rig that they form.

A driver blocks for one exchange at most: an action is started, and then polled (`Pending`, `wait`). Drivers open nothing by
name: they are given openers. `Rig` has all devices; `DeviceError` is the base of their errors; `Transcript` records the
bytes on their wires.
"""

from goniotwin.drivers.device import Device, Pending, Poll, Until, wait
from goniotwin.drivers.errors import BadAnswer, DeviceError, Forgotten, LimitError, NoAnswer, Refused
from goniotwin.drivers.monitor.monitor import Monitor, MonitorDescription, MonitorSettings
from goniotwin.drivers.monochromator.monochromator import Monochromator
from goniotwin.drivers.monochromator.settings import FilterWheel, MonochromatorDescription, MonochromatorSettings, OrderFilter
from goniotwin.drivers.motion.axis import Axis, AxisDescription, check_limits
from goniotwin.drivers.motion.clearance import ArcClearance
from goniotwin.drivers.motion.controller import MotionController
from goniotwin.drivers.motion.settings import AxisSettings, Homing
from goniotwin.drivers.motion.tmcl import TmclAxis, TmclController, TmclModule
from goniotwin.drivers.photodiodes.array import PhotodiodeArray, PhotodiodeSettings
from goniotwin.drivers.photodiodes.description import ConverterDescription, ConverterRange
from goniotwin.drivers.rig import Rig
from goniotwin.drivers.tap import Transcript

__all__ = [
    "ArcClearance",
    "Axis",
    "AxisDescription",
    "AxisSettings",
    "BadAnswer",
    "ConverterDescription",
    "ConverterRange",
    "Device",
    "DeviceError",
    "FilterWheel",
    "Forgotten",
    "Homing",
    "LimitError",
    "Monitor",
    "MonitorDescription",
    "MonitorSettings",
    "Monochromator",
    "MonochromatorDescription",
    "MonochromatorSettings",
    "MotionController",
    "NoAnswer",
    "OrderFilter",
    "Pending",
    "PhotodiodeArray",
    "PhotodiodeSettings",
    "Poll",
    "Refused",
    "Rig",
    "TmclAxis",
    "TmclController",
    "TmclModule",
    "Transcript",
    "Until",
    "check_limits",
    "wait",
]
