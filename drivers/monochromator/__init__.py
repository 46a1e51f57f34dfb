"""Monochromator: the Oriel Cornerstone 260 on its serial line, with its order-sorting filters.

`Monochromator` is the device, `MonochromatorSettings` its configuration, `FilterWheel` the filter for each wavelength.
"""

from goniotwin.drivers.monochromator.monochromator import Monochromator
from goniotwin.drivers.monochromator.settings import FilterWheel, MonochromatorDescription, MonochromatorSettings, OrderFilter

__all__ = ["FilterWheel", "Monochromator", "MonochromatorDescription", "MonochromatorSettings", "OrderFilter"]
