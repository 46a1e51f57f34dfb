"""Monochromator: the Oriel Cornerstone 260 on its serial line, with its order-sorting filters.

`Monochromator` is the device, `MonochromatorSettings` its configuration, `FilterWheel` the filter for each wavelength.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.drivers.monochromator.monochromator import Monochromator as Monochromator
    from goniotwin.drivers.monochromator.settings import FilterWheel as FilterWheel
    from goniotwin.drivers.monochromator.settings import MonochromatorDescription as MonochromatorDescription
    from goniotwin.drivers.monochromator.settings import MonochromatorSettings as MonochromatorSettings
    from goniotwin.drivers.monochromator.settings import OrderFilter as OrderFilter
else:
    __getattr__, __dir__ = first_use(__name__)
