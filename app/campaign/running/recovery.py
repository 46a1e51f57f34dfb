"""Faults of devices: their kinds, the schedule's policy for each kind, and the recovery of the rig."""

from collections.abc import Callable
from functools import partial
from typing import Literal

from goniotwin.app.campaign.running.question import PositionGiven, Reply, UnreferencedAxis
from goniotwin.app.campaign.running.stop import StopRequest
from goniotwin.app.campaign.schedule.file import FaultsTable, Policy
from goniotwin.app.rig import AXES
from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, LimitError, NoAnswer, Poll, Refused, Rig
from goniotwin.drivers.errors import Interrupted, Taken, Unreferenced
from goniotwin.drivers.motion import Axis

FaultKind = Literal["wire", "reset", "refused", "axis"]
"""Kinds of faults: the keys of the table `[faults]`."""
POLICY_TEXT: dict[Policy, str] = {
    "retry": "retry",
    "reconnect": "reconnect the devices and retry",
    "skip": "skip the row",
    "ask": "ask the operator",
    "stop": "stop the run",
}
POLL_PERIOD_S = 0.1
"""Time between two checks of whether an axis still moves."""
MAX_STOP_TIME_S = 60.0
"""Longest time in which an axis comes to rest."""
Wait = Callable[..., None]
"""Function that waits until some pending actions are done."""


def fault_kind(error: DeviceError) -> FaultKind:
    """The kind of a fault."""
    match error:
        case Unreferenced():
            return "axis"
        case Forgotten():
            return "reset"
        case NoAnswer() | BadAnswer():
            return "wire"
        case Refused() | LimitError():
            return "refused"
    return "axis" if error.device in AXES else "refused"  # an axis stalled, was stopped, or does not come to rest


class FaultPolicies:
    """Policies for the faults of one row. A schedule without a table `[faults]` has its defaults."""

    def __init__(self, table: FaultsTable | None) -> None:
        self._table = table if table is not None else FaultsTable()
        self._attempt = 1

    def policy_for(self, error: DeviceError, *, slept: bool = False) -> Policy:
        """The policy for the fault that ended the current attempt. Counts the attempts: after the last one it is `then`.

        An attempt in which the computer `slept` does not count.
        """
        table = self._table
        if isinstance(error, Interrupted | Taken):
            return "stop"  # an axis was stopped on purpose and must not move again; or the controller is another program's
        if slept:
            return "reconnect"
        policy: Policy = getattr(table, fault_kind(error))
        if policy in ("retry", "reconnect"):
            if self._attempt >= table.attempts:
                policy = table.then
            else:
                self._attempt += 1
        if policy == "ask":
            self._attempt = 1
        return policy

    @property
    def wait_s(self) -> float:
        """Time to wait before a retry."""
        return self._table.wait_s


class Recovery:
    """Recovery of one rig after a fault: reconnect the device, wait until all axes are at rest, home unreferenced axes.

    Steps that fail are returned as DeviceErrors. A device that could not be reconnected is tried again before the next row.
    """

    def __init__(self, rig: Rig, stop_request: StopRequest, wait: Wait) -> None:
        self._rig = rig
        self._stop_request = stop_request
        self._wait = wait
        self._disconnected: list[str] = []

    @property
    def disconnected(self) -> tuple[str, ...]:
        """The devices that could not be reconnected."""
        return tuple(dict.fromkeys(self._rig.device(name).name for name in self._disconnected))

    def recover(self, failed: str, *, homing: bool = True) -> list[DeviceError]:
        """Reconnect the device that failed, wait until all axes are at rest, and with `homing` home the unreferenced ones."""
        self._disconnected.append(failed)
        return [*self._try(self.reconnect), *self.wait_for_rest(), *(self._home_unreferenced() if homing else [])]

    def reconnect(self) -> None:
        """Reconnect the devices that are still disconnected, if any. Raises DeviceError where that fails again."""
        while self._disconnected:
            self._rig.reconnect(self._disconnected[0])
            del self._disconnected[0]

    def wait_for_rest(self) -> list[DeviceError]:
        """Wait until no axis moves any more."""
        return [error for axis in self._rig.axes for error in self._try(partial(self._wait_for_axis, axis))]

    @property
    def homeable_axes(self) -> list[Axis]:
        """Unreferenced axes that can home: the rig file has a [homing] table for them."""
        return [axis for axis in self._rig.axes.values() if axis.unreferenced_reason and axis.settings.homing is not None]

    def unreferenced_axis(self, failed: str) -> UnreferencedAxis | None:
        """The axis that an error names, if it is unreferenced."""
        axis = self._rig.axes.get(failed)
        if axis is None or not axis.unreferenced_reason:
            return None
        table = axis.settings
        return UnreferencedAxis(failed, table.lower_deg, table.upper_deg, table.homing is not None)

    def reference(self, axis: UnreferencedAxis, reply: Reply) -> None:
        """Home an axis, or set its position, as a person has replied; nothing else moves. Raises DeviceError."""
        self._rig.reconnect(axis.name)  # a controller that has reset has lost its settings
        for error in self.wait_for_rest():
            raise error
        if isinstance(reply, PositionGiven):
            self._rig.axes[axis.name].set_position(reply.angle_deg)
        else:
            self.home(self._rig.axes[axis.name])

    def home(self, axis: Axis) -> None:
        """Home an axis. Raises DeviceError."""
        self._wait(self._stop_request.start(axis.start_homing))

    def _wait_for_axis(self, name: str) -> None:
        clock = self._rig.clock
        deadline = clock.now() + MAX_STOP_TIME_S
        axis = self._rig.axes[name]

        def at_rest() -> bool:
            moving = axis.is_moving()
            if moving and clock.now() > deadline:
                raise DeviceError(name, "wait until it is at rest", f"it still turns after {MAX_STOP_TIME_S:g} s", "stop it")
            return not moving

        self._wait(Poll(clock, clock.now(), POLL_PERIOD_S, at_rest))

    def _home_unreferenced(self) -> list[DeviceError]:
        return [error for axis in self.homeable_axes for error in self._try(partial(self.home, axis))]

    @staticmethod
    def _try(action: Callable[[], object]) -> list[DeviceError]:
        try:
            action()
        except DeviceError as error:
            return [error]
        return []
