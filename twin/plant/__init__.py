"""State of the instrument at a given time: mechanics, light, electronics; without threads and without ticks."""

from goniotwin.twin.plant.disturbances import Disturbances, Drawn
from goniotwin.twin.plant.model import (
    AxisController,
    ControllerModel,
    DeviceModel,
    Electronics,
    Estimator,
    LightSource,
    Mechanics,
    ModuleKind,
    MonitorPhotodiode,
    MonochromatorDrive,
    OrderSorting,
    Parts,
    Photodiodes,
    SecondOrder,
    TwinModel,
    WheelFilter,
)
from goniotwin.twin.plant.plant import ExpectedPose, Plant

__all__ = [
    "AxisController",
    "ControllerModel",
    "DeviceModel",
    "Disturbances",
    "Drawn",
    "Electronics",
    "Estimator",
    "ExpectedPose",
    "LightSource",
    "Mechanics",
    "ModuleKind",
    "MonitorPhotodiode",
    "MonochromatorDrive",
    "OrderSorting",
    "Parts",
    "Photodiodes",
    "Plant",
    "SecondOrder",
    "TwinModel",
    "WheelFilter",
]
