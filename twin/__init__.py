"""The virtual prototype: optics, the plant (state of the instrument over time), devices with their protocols, doors to the
buses.
"""

from typing import TYPE_CHECKING

from goniotwin.first_use import first_use

if TYPE_CHECKING:
    from goniotwin.twin.plant import Plant as Plant
    from goniotwin.twin.plant import TwinModel as TwinModel
    from goniotwin.twin.rig import VirtualRig as VirtualRig
else:
    __getattr__, __dir__ = first_use(__name__)
