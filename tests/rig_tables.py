"""The tables `[uncertainty]` and `[twin.disturbances]` with keys of a test."""

from typing import Any

from goniotwin.app.rig.inputs import inputs
from goniotwin.app.rig.uncertainty import UncertaintyTable, disturbances_table, uncertainty_table
from goniotwin.twin.plant import Disturbances


def stated(**keys: float) -> UncertaintyTable:
    """What a rig file states of its inputs, and the defaults."""
    return uncertainty_table(inputs())(**keys)


def disturbances(**keys: Any) -> Disturbances:
    """What a virtual rig is off by."""
    return disturbances_table(inputs())(**keys)
