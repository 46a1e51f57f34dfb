"""Drivers: the devices of the goniophotometer on their wires, and the rig that they form.

A driver blocks for one exchange at most: an action is started, and then polled (`Pending`, `wait`). Drivers open nothing by
name: they are given openers. `Rig` has all devices; `DeviceError` is the base of their errors; `Transcript` records the
bytes on their wires.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.drivers.device import Device as Device
    from goniotwin.drivers.device import Pending as Pending
    from goniotwin.drivers.device import Poll as Poll
    from goniotwin.drivers.device import Until as Until
    from goniotwin.drivers.device import wait as wait
    from goniotwin.drivers.errors import BadAnswer as BadAnswer
    from goniotwin.drivers.errors import DeviceError as DeviceError
    from goniotwin.drivers.errors import Forgotten as Forgotten
    from goniotwin.drivers.errors import LimitError as LimitError
    from goniotwin.drivers.errors import NoAnswer as NoAnswer
    from goniotwin.drivers.errors import Refused as Refused
    from goniotwin.drivers.monitor.monitor import Monitor as Monitor
    from goniotwin.drivers.monitor.settings import MonitorDescription as MonitorDescription
    from goniotwin.drivers.monitor.settings import MonitorSettings as MonitorSettings
    from goniotwin.drivers.monochromator.monochromator import Monochromator as Monochromator
    from goniotwin.drivers.monochromator.settings import FilterWheel as FilterWheel
    from goniotwin.drivers.monochromator.settings import MonochromatorDescription as MonochromatorDescription
    from goniotwin.drivers.monochromator.settings import MonochromatorSettings as MonochromatorSettings
    from goniotwin.drivers.monochromator.settings import OrderFilter as OrderFilter
    from goniotwin.drivers.motion.axis import Axis as Axis
    from goniotwin.drivers.motion.axis import AxisDescription as AxisDescription
    from goniotwin.drivers.motion.axis import check_limits as check_limits
    from goniotwin.drivers.motion.clearance import ArcClearance as ArcClearance
    from goniotwin.drivers.motion.controller import MotionController as MotionController
    from goniotwin.drivers.motion.settings import AxisSettings as AxisSettings
    from goniotwin.drivers.motion.settings import Homing as Homing
    from goniotwin.drivers.motion.tmcl import TmclAxis as TmclAxis
    from goniotwin.drivers.motion.tmcl import TmclController as TmclController
    from goniotwin.drivers.motion.tmcl import TmclModule as TmclModule
    from goniotwin.drivers.photodiodes.array import PhotodiodeArray as PhotodiodeArray
    from goniotwin.drivers.photodiodes.description import ConverterDescription as ConverterDescription
    from goniotwin.drivers.photodiodes.description import ConverterRange as ConverterRange
    from goniotwin.drivers.photodiodes.settings import PhotodiodeSettings as PhotodiodeSettings
    from goniotwin.drivers.rig import Rig as Rig
    from goniotwin.drivers.tap import Transcript as Transcript
else:
    __getattr__, __dir__ = first_use(__name__)
