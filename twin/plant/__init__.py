"""State of the instrument at a given time: mechanics, light, electronics; without threads and without ticks."""

from goniotwin.twin.plant.model import (
    AxisController,
    Electronics,
    Estimator,
    LightSource,
    Mechanics,
    MonitorPhotodiode,
    MonochromatorDrive,
    OrderSorting,
    Photodiodes,
    TwinModel,
    WheelFilter,
)
from goniotwin.twin.plant.plant import Plant

__all__ = [
    "AxisController",
    "Electronics",
    "Estimator",
    "LightSource",
    "Mechanics",
    "MonitorPhotodiode",
    "MonochromatorDrive",
    "OrderSorting",
    "Photodiodes",
    "Plant",
    "TwinModel",
    "WheelFilter",
]
