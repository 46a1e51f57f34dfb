"""What the engine tells those who listen. Listening cannot disturb a run."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from goniotwin.app.campaign.journal.record import RowData
from goniotwin.app.campaign.row import Row


class State(StrEnum):
    """What the engine is at. Stopped by a person it is idle again, with rows left."""

    IDLE = "idle"
    RUNNING = "running"
    PAUSING = "pausing"
    PAUSED = "paused"
    RECOVERING = "recovering"
    STOPPING = "stopping"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class StateChanged:
    """The engine is in a new state; `reason` says why where that is not plain."""

    state: State
    reason: str = ""


@dataclass(frozen=True)
class RowStarted:
    """A row begins."""

    row: Row


@dataclass(frozen=True)
class RowCommitted:
    """A row is on the disk. `seconds_left` is the rig's time that the rows after it are foretold to take."""

    row: Row
    data: RowData
    done: int
    of: int
    seconds_left: float


@dataclass(frozen=True)
class Positions:
    """Where the axes are by their counters, in degrees, by axis."""

    degrees: dict[str, float]


Event = StateChanged | RowStarted | RowCommitted | Positions
Listener = Callable[[Event], None]
