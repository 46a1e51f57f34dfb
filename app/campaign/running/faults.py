"""Faults in a row: of which kind each is, and what the schedule's policies say is done about it."""

from typing import Literal

from goniotwin.app.campaign.schedule.measuring import FaultsTable, Policy
from goniotwin.app.rig import AXES
from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, LimitError, NoAnswer, Refused
from goniotwin.drivers.errors import Interrupted, Unreferenced

Kind = Literal["wire", "reset", "refused", "axis"]
DONE_ABOUT_IT: dict[Policy, str] = {
    "retry": "the row is done again",
    "reconnect": "the devices are connected again, and the row is done again",
    "skip": "the row is left out",
    "ask": "somebody is asked to mend it",
    "stop": "the run stops",
}


def kind_of(error: DeviceError) -> Kind:
    """Of the four that `[faults]` names."""
    match error:
        case Unreferenced():
            return "axis"
        case Forgotten():
            return "reset"
        case NoAnswer() | BadAnswer():
            return "wire"
        case Refused() | LimitError():
            return "refused"
    return "axis" if error.device in AXES else "refused"  # it has stalled, was stopped, or does not come to rest


class Policies:
    """What is done about the faults of one row; without a table all of them stop the run."""

    def __init__(self, table: FaultsTable | None) -> None:
        self._table = table
        self._begun = 1

    def about(self, error: DeviceError) -> Policy:
        """What is done now that this has ended an attempt; an attempt that follows is counted."""
        table = self._table
        if table is None or isinstance(error, Interrupted):  # whoever has stopped an axis wants it to stand
            return "stop"
        policy: Policy = getattr(table, kind_of(error))
        if policy in ("retry", "reconnect"):
            if self._begun >= table.attempts:
                policy = table.then
            else:
                self._begun += 1
        if policy == "ask":
            self._begun = 1
        return policy

    @property
    def wait_s(self) -> float:
        """Before the row is done again."""
        return self._table.wait_s if self._table is not None else 0.0
