"""The in-process ends of the three buses, each by its library's own door for a second backend.

Serial: `protocol_twin`, a URL handler of pyserial. Modbus: a subclass of pymodbus's client. USB: a backend of pyusb.
"""

import serial

from goniotwin.twin.doors.modbus import TwinModbusClient, TwinRtuClient
from goniotwin.twin.doors.registry import NoSuchTwin, find, register, unregister
from goniotwin.twin.doors.usb import TwinUsbBackend

if __name__ not in serial.protocol_handler_packages:
    serial.protocol_handler_packages.append(__name__)

__all__ = ["NoSuchTwin", "TwinModbusClient", "TwinRtuClient", "TwinUsbBackend", "find", "register", "unregister"]
