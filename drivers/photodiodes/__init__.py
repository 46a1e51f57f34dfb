"""Photodiodes: the photodiodes of the arc behind Advantech converter modules on Modbus.

`ConverterDescription` is what the operator's table has for converters of any make. `PhotodiodeArray` is the array, `Readings`
a series of readings in progress. `AdamModule` is one module, on a `ModbusUnit`.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.drivers.photodiodes.adam import AdamModule as AdamModule
    from goniotwin.drivers.photodiodes.array import PhotodiodeArray as PhotodiodeArray
    from goniotwin.drivers.photodiodes.array import Readings as Readings
    from goniotwin.drivers.photodiodes.description import ConverterDescription as ConverterDescription
    from goniotwin.drivers.photodiodes.description import ConverterRange as ConverterRange
    from goniotwin.drivers.photodiodes.modbus import ModbusBus as ModbusBus
    from goniotwin.drivers.photodiodes.modbus import ModbusUnit as ModbusUnit
    from goniotwin.drivers.photodiodes.settings import PhotodiodeSettings as PhotodiodeSettings
else:
    __getattr__ = first_use(
        __name__,
        {
            "adam": ("AdamModule",),
            "array": ("PhotodiodeArray", "Readings"),
            "description": ("ConverterDescription", "ConverterRange"),
            "modbus": ("ModbusBus", "ModbusUnit"),
            "settings": ("PhotodiodeSettings",),
        },
    )
