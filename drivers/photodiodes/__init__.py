"""Photodiodes: the photodiodes of the arc behind Advantech converter modules on Modbus.

`ConverterDescription` is what the operator's table has for converters of any make. `PhotodiodeArray` is the array, `Readings`
a series of readings in progress. `AdamModule` is one module, on a `ModbusUnit`.
"""

from goniotwin.drivers.photodiodes.adam import AdamModule
from goniotwin.drivers.photodiodes.array import PhotodiodeArray, PhotodiodeSettings, Readings
from goniotwin.drivers.photodiodes.description import ConverterDescription, ConverterRange
from goniotwin.drivers.photodiodes.modbus import ModbusBus, ModbusUnit

__all__ = [
    "AdamModule",
    "ConverterDescription",
    "ConverterRange",
    "ModbusBus",
    "ModbusUnit",
    "PhotodiodeArray",
    "PhotodiodeSettings",
    "Readings",
]
