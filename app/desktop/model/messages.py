"""What the rig's thread tells the window, besides the engine's own events."""

from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import Event, State
from goniotwin.app.rig import RigDescription

DEVICES = ("axes", "monochromator", "photodiodes", "monitor")


@dataclass(frozen=True)
class DeviceStatus:
    """Whether a device answers; `text` is who it is, or why it does not."""

    answers: bool
    text: str


@dataclass(frozen=True)
class RigOpened:
    """A rig is open, with whatever of its devices answers. `paced` where its time may be made to pass faster."""

    description: RigDescription
    devices: dict[str, DeviceStatus]
    paced: bool

    @property
    def silent(self) -> list[str]:
        """The devices that do not answer."""
        return [device for device, status in self.devices.items() if not status.answers]


@dataclass(frozen=True)
class RigClosed:
    """There is no rig: `reason` says why in a line, where it is not plain."""

    reason: str = ""


@dataclass(frozen=True)
class DeviceLost:
    """A device that answered does not answer any more."""

    device: str
    reason: str


@dataclass(frozen=True)
class PlanMade:
    """A schedule was read and fits the rig: it can be started."""

    plan: Plan


@dataclass(frozen=True)
class PlanRefused:
    """There is no plan: `reason` is one line for a person."""

    reason: str


@dataclass(frozen=True)
class RunBegan:
    """A run of a plan begins, into a journal."""

    plan: Plan
    journal: Path


@dataclass(frozen=True)
class RunEnded:
    """It has ended: done, failed, or idle where it was stopped; the journal is closed."""

    state: State
    reason: str
    journal: Path


@dataclass(frozen=True)
class RunRefused:
    """It did not begin, and nothing was written: `reason` is one line for a person."""

    reason: str


@dataclass(frozen=True)
class MountWanted:
    """A person has to mount something; the run waits for `RigThread.mounted`."""

    text: str


@dataclass(frozen=True)
class StopFailed:
    """Axes that could not be told to stop. The main switch is the person's."""

    reasons: tuple[str, ...]


Message = (
    Event | RigOpened | RigClosed | DeviceLost | PlanMade | PlanRefused | RunBegan | RunEnded | RunRefused | MountWanted
    | StopFailed
)  # fmt: skip
