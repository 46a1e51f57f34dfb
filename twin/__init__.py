"""The virtual prototype: optics, the plant (state of the instrument over time), devices with their protocols, doors to the
buses.
"""

from goniotwin.twin.plant import Plant, TwinModel
from goniotwin.twin.rig import VirtualRig

__all__ = ["Plant", "TwinModel", "VirtualRig"]
