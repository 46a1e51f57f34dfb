"""Firmware: devices that answer the wires' protocols from the plant that they share. Each is asked with a time."""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.twin.devices.adam import Adam4117 as Adam4117
    from goniotwin.twin.devices.adam import Adam6017 as Adam6017
    from goniotwin.twin.devices.adam import ConverterModule as ConverterModule
    from goniotwin.twin.devices.cornerstone260 import Cornerstone260 as Cornerstone260
    from goniotwin.twin.devices.modbus import RtuStation as RtuStation
    from goniotwin.twin.devices.modbus import TcpStation as TcpStation
    from goniotwin.twin.devices.pm100d import Pm100d as Pm100d
    from goniotwin.twin.devices.tmcl_line import FurtherTmclLine as FurtherTmclLine
    from goniotwin.twin.devices.tmcl_line import TmclLine as TmclLine
    from goniotwin.twin.devices.tmcm6214 import MODULE_KINDS as MODULE_KINDS
    from goniotwin.twin.devices.usbtmc import UsbTmcDevice as UsbTmcDevice
else:
    __getattr__, __dir__ = first_use(__name__)
