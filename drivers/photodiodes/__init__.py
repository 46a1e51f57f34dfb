"""Photodiodes: the photodiodes of the arc behind Advantech converter modules on Modbus.

`PhotodiodeArray` is the array, `Readings` a series of readings in progress. `AdamModule` is one module, on a `ModbusUnit`.
"""

from goniotwin.drivers.photodiodes.adam import AdamModule
from goniotwin.drivers.photodiodes.array import PhotodiodeArray, PhotodiodeSettings, Readings
from goniotwin.drivers.photodiodes.modbus import ModbusBus, ModbusUnit

__all__ = ["AdamModule", "ModbusBus", "ModbusUnit", "PhotodiodeArray", "PhotodiodeSettings", "Readings"]
