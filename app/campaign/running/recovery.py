"""After a fault: what has failed is connected again, all axes come to rest, those that are lost look for their reference.

Faults in a row: of which kind each is, and what the schedule's policies say is done about it.
"""

from collections.abc import Callable
from functools import partial
from typing import Literal

from goniotwin.app.campaign.running.stop_request import StopRequest
from goniotwin.app.campaign.schedule.file import FaultsTable, Policy
from goniotwin.app.rig import AXES
from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, LimitError, NoAnswer, Poll, Refused, Rig
from goniotwin.drivers.errors import Interrupted, Unreferenced
from goniotwin.drivers.motion import Axis

LOOK_S = 0.1
LONGEST_REST_S = 60.0
Wait = Callable[..., None]
"""Until all of some pending things are done."""


class Recovery:
    """On one rig. What it cannot mend it reports, as DeviceErrors; a row begins with what is left to connect (`again`)."""

    def __init__(self, rig: Rig, halt: StopRequest, wait: Wait) -> None:
        self._rig = rig
        self._halt = halt
        self._wait = wait
        self._lost: list[str] = []

    def reconnect(self, failed: str) -> list[DeviceError]:
        """Of the device that has failed; and axes in doubt are homed, where the rig file says how."""
        self._lost.append(failed)
        return [*self._tried(self.again), *self.rest(), *self._home()]

    def again(self) -> None:
        """What could not be connected is connected, if there is anything. Raises DeviceError where that fails again."""
        while self._lost:
            self._connect(self._lost[0])
            del self._lost[0]

    def rest(self) -> list[DeviceError]:
        """Waits until no axis turns any more."""
        return [error for axis in self._rig.axes for error in self._tried(partial(self._comes_to_rest, axis))]

    def _connect(self, failed: str) -> None:
        rig = self._rig
        if failed == "axes" or failed in AXES:
            rig.reconnect_axes()
        elif failed == "monochromator":
            rig.monochromator.connect()
        elif failed == "monitor":
            rig.monitor.connect()
        else:
            rig.photodiodes.reconnect()

    def _comes_to_rest(self, name: str) -> None:
        clock = self._rig.clock
        latest = clock.now() + LONGEST_REST_S
        axis = self._rig.axes[name]

        def rests() -> bool:
            turns = axis.is_moving()
            if turns and clock.now() > latest:
                raise DeviceError(name, "wait for it", f"it still turns after {LONGEST_REST_S:g} s", "stop it")
            return not turns

        self._wait(Poll(clock, clock.now(), LOOK_S, rests))

    @property
    def lost_axes(self) -> list[Axis]:
        """Those in doubt that can look for their reference."""
        return [axis for axis in self._rig.axes.values() if axis.unreferenced_reason and axis.settings.homing is not None]

    def home(self, axis: Axis) -> None:
        """Has it look for its reference. Raises DeviceError."""
        self._wait(self._halt.start(axis.start_homing))

    def _home(self) -> list[DeviceError]:
        return [error for axis in self.lost_axes for error in self._tried(partial(self.home, axis))]

    @staticmethod
    def _tried(action: Callable[[], object]) -> list[DeviceError]:
        try:
            action()
        except DeviceError as error:
            return [error]
        return []


FaultKind = Literal["wire", "reset", "refused", "axis"]
POLICY_TEXT: dict[Policy, str] = {
    "retry": "the row is done again",
    "reconnect": "the devices are connected again, and the row is done again",
    "skip": "the row is left out",
    "ask": "somebody is asked to mend it",
    "stop": "the run stops",
}


def fault_kind(error: DeviceError) -> FaultKind:
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


class FaultPolicies:
    """What is done about the faults of one row; without a table all of them stop the run."""

    def __init__(self, table: FaultsTable | None) -> None:
        self._table = table
        self._begun = 1

    def about(self, error: DeviceError) -> Policy:
        """What is done now that this has ended an attempt; an attempt that follows is counted."""
        table = self._table
        if table is None or isinstance(error, Interrupted):  # whoever has stopped an axis wants it to stand
            return "stop"
        policy: Policy = getattr(table, fault_kind(error))
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
