"""The virtual prototype: optics, the plant at a given time, devices that answer their protocols, doors to the buses."""

from goniotwin.twin.plant import Plant, TwinModel
from goniotwin.twin.rig import VirtualRig

__all__ = ["Plant", "TwinModel", "VirtualRig"]
