"""Firmware: devices that answer the wires' protocols from the plant that they share. Each is asked with a time."""

from goniotwin.twin.devices.adam import Adam4117, Adam6017, ConverterModule
from goniotwin.twin.devices.cornerstone260 import Cornerstone260
from goniotwin.twin.devices.modbus import RtuStation, TcpStation
from goniotwin.twin.devices.pm100d import Pm100d
from goniotwin.twin.devices.tmcl_line import FurtherTmclLine, TmclLine
from goniotwin.twin.devices.tmcm6214 import MODULE_KINDS
from goniotwin.twin.devices.usbtmc import UsbTmcDevice

__all__ = [
    "MODULE_KINDS",
    "Adam4117",
    "Adam6017",
    "ConverterModule",
    "Cornerstone260",
    "FurtherTmclLine",
    "Pm100d",
    "RtuStation",
    "TcpStation",
    "TmclLine",
    "UsbTmcDevice",
]
