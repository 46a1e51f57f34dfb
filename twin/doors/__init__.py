"""The in-process ends of the three buses, each by its library's own door for a second backend.

Serial: `protocol_twin`, a URL handler of pyserial. Modbus: a subclass of pymodbus's client. USB: a backend of pyusb.
"""

import serial

from goniotwin.twin.doors.modbus import TwinModbusClient as TwinModbusClient
from goniotwin.twin.doors.modbus import TwinRtuClient as TwinRtuClient
from goniotwin.twin.doors.registry import NoSuchTwin as NoSuchTwin
from goniotwin.twin.doors.registry import register as register
from goniotwin.twin.doors.registry import unregister as unregister
from goniotwin.twin.doors.usb import TwinUsbBackend as TwinUsbBackend

if __name__ not in serial.protocol_handler_packages:
    serial.protocol_handler_packages.append(__name__)
