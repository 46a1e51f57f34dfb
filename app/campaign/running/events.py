"""Events of the engine for its listeners. A listener that fails does not disturb the run."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from goniotwin.app.campaign.journal.record import RowData
from goniotwin.app.campaign.row import Row


class State(StrEnum):
    """State of the engine. After a stop it is idle again, with rows left."""

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
    """The engine entered a state; `reason` gives the cause of a stop, a failure or a recovery."""

    state: State
    reason: str = ""


@dataclass(frozen=True)
class RowStarted:
    """A row starts."""

    row: Row


@dataclass(frozen=True)
class RowCommitted:
    """A row is on the disk: `done` of `total` rows. `seconds_left` is the estimated duration of the rows that are left."""

    row: Row
    data: RowData
    done: int
    total: int
    seconds_left: float


@dataclass(frozen=True)
class Positions:
    """Positions of the axes from their counters, in degrees, by axis."""

    degrees: dict[str, float]


Event = StateChanged | RowStarted | RowCommitted | Positions
Listener = Callable[[Event], None]
