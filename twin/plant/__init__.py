"""State of the instrument at a given time: mechanics, light, electronics; without threads and without ticks.

Names are loaded at their first use: settings are read without numba.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.twin.plant.disturbances import Disturbances as Disturbances
    from goniotwin.twin.plant.disturbances import Drawn as Drawn
    from goniotwin.twin.plant.model import AxisController as AxisController
    from goniotwin.twin.plant.model import ControllerModel as ControllerModel
    from goniotwin.twin.plant.model import DeviceModel as DeviceModel
    from goniotwin.twin.plant.model import Electronics as Electronics
    from goniotwin.twin.plant.model import Estimator as Estimator
    from goniotwin.twin.plant.model import LightSource as LightSource
    from goniotwin.twin.plant.model import Mechanics as Mechanics
    from goniotwin.twin.plant.model import ModuleKind as ModuleKind
    from goniotwin.twin.plant.model import MonitorPhotodiode as MonitorPhotodiode
    from goniotwin.twin.plant.model import MonochromatorDrive as MonochromatorDrive
    from goniotwin.twin.plant.model import OrderSorting as OrderSorting
    from goniotwin.twin.plant.model import Parts as Parts
    from goniotwin.twin.plant.model import Photodiodes as Photodiodes
    from goniotwin.twin.plant.model import SecondOrder as SecondOrder
    from goniotwin.twin.plant.model import TwinModel as TwinModel
    from goniotwin.twin.plant.model import WheelFilter as WheelFilter
    from goniotwin.twin.plant.noise import mix as mix
    from goniotwin.twin.plant.noise import normal as normal
    from goniotwin.twin.plant.plant import ExpectedPose as ExpectedPose
    from goniotwin.twin.plant.plant import Plant as Plant
else:
    __getattr__, __dir__ = first_use(__name__)
