"""Firmware: devices that answer the wires' protocols from the plant that they share. Each is asked with a time."""

from twin.devices.adam6017 import Adam6017
from twin.devices.cornerstone260 import Cornerstone260
from twin.devices.pm100d import Pm100d
from twin.devices.tmcm6214 import Tmcm6214
from twin.devices.usbtmc import UsbTmcDevice

__all__ = ["Adam6017", "Cornerstone260", "Pm100d", "Tmcm6214", "UsbTmcDevice"]
