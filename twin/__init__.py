"""The virtual prototype: optics, the plant at a given time, devices that answer their protocols, doors to the buses."""

from twin.plant import Plant, TwinModel
from twin.rig import VirtualRig

__all__ = ["Plant", "TwinModel", "VirtualRig"]
