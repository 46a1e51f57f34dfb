"""Messages from the rig's thread to the window; the events of the engine are among them."""

from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import Event, State
from goniotwin.app.campaign.running.question import Question
from goniotwin.app.rig import RigDescription


@dataclass(frozen=True)
class DeviceStatus:
    """Whether a device is connected. `text` is its identity, or the reason why it does not respond."""

    connected: bool
    text: str


@dataclass(frozen=True)
class RigOpened:
    """A rig is open, with the status of each device. `virtual` if all devices are: then the simulation speed can be set."""

    description: RigDescription
    devices: dict[str, DeviceStatus]
    virtual: bool

    @property
    def not_responding(self) -> list[str]:
        """The devices that do not respond."""
        return [device for device, status in self.devices.items() if not status.connected]


@dataclass(frozen=True)
class RigClosed:
    """No rig is open. `reason` is one line for the operator, or empty."""

    reason: str = ""


@dataclass(frozen=True)
class DeviceFault:
    """A connected device does not respond any more."""

    device: str
    reason: str


@dataclass(frozen=True)
class PlanMade:
    """A schedule was read and the rig can do it: the plan can be started."""

    plan: Plan


@dataclass(frozen=True)
class PlanRefused:
    """There is no plan. `reason` is one line for the operator."""

    reason: str


@dataclass(frozen=True)
class RunStarted:
    """A run of a plan has started, into a journal."""

    plan: Plan
    journal: Path


@dataclass(frozen=True)
class RunEnded:
    """A run has ended: done, failed, or idle if it was stopped. Its journal is closed."""

    state: State
    reason: str
    journal: Path


@dataclass(frozen=True)
class RunRefused:
    """A run was not started and nothing was written. `reason` is one line for the operator."""

    reason: str


@dataclass(frozen=True)
class QuestionAsked:
    """The run waits for the operator's answer: `RigThread.answer` with the question's number."""

    number: int
    question: Question


Message = (
    Event | RigOpened | RigClosed | DeviceFault | PlanMade | PlanRefused | RunStarted | RunEnded | RunRefused | QuestionAsked
)
