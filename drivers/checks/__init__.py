"""Checks of the devices on the day they arrive, in the order in which they are safe: what moves nothing, then what moves.

`checks_of` gives those of a device. docs/rig/arrival.md is made from the same declarations.
"""

from goniotwin.drivers.checks.axes import AXIS_CHECKS
from goniotwin.drivers.checks.check import CheckOutcome, CheckSession, CheckVerdict, DeviceCheck, identity_check
from goniotwin.drivers.checks.monitor import MONITOR_CHECKS
from goniotwin.drivers.checks.monochromator import MONOCHROMATOR_CHECKS
from goniotwin.drivers.checks.photodiodes import PHOTODIODE_CHECKS
from goniotwin.drivers.device import Device
from goniotwin.drivers.monitor.monitor import Monitor
from goniotwin.drivers.monochromator.monochromator import Monochromator
from goniotwin.drivers.photodiodes.array import PhotodiodeArray
from goniotwin.drivers.rig import Rig

CHECKS: dict[str, tuple[DeviceCheck, ...]] = {
    "axes": AXIS_CHECKS,
    "monochromator": MONOCHROMATOR_CHECKS,
    "photodiodes": PHOTODIODE_CHECKS,
    "monitor": MONITOR_CHECKS,
}
"""By the role of a device; within a role what moves nothing comes first."""

OTHER_CHECKS = (identity_check("the device responds"),)


def checks_of(rig: Rig, device: Device) -> tuple[DeviceCheck, ...]:
    """The checks of a device of a rig; of a driver of another package its identity alone, except for a motion controller."""
    if device in rig.controllers:
        return CHECKS["axes"]
    makes = {"monochromator": Monochromator, "photodiodes": PhotodiodeArray, "monitor": Monitor}
    return next((CHECKS[role] for role, make in makes.items() if isinstance(device, make)), OTHER_CHECKS)


__all__ = ["CHECKS", "CheckOutcome", "CheckSession", "CheckVerdict", "DeviceCheck", "checks_of"]
