"""Photodiodes: the photodiodes of the arc behind Advantech converter modules on Modbus.

`ConverterDescription` is what the operator's table has for converters of any make. `PhotodiodeArray` is the array, `Readings`
a series of readings in progress. `AdamModule` is one module, on a `ModbusUnit`.
"""
