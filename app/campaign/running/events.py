"""Events of the engine for its listeners. A listener that fails does not disturb the run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

from goniotwin.app.campaign.row import Row, RowData
from goniotwin.drivers.guard import CLOSE_SHUTTER

if TYPE_CHECKING:  # a window that shows events needs no drivers
    from goniotwin.app.guardian.record import Record
    from goniotwin.drivers import DeviceError, Rig


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
    """A row is on the disk. `seconds_left` is the estimated duration of the rows that are left, unplanned ones included.

    `done` of the `total` planned rows are measured: as `row_counts` of the journal, without skipped and unplanned rows.
    """

    row: Row
    data: RowData
    done: int
    total: int
    seconds_left: float


@dataclass(frozen=True)
class Positions:
    """Positions of the axes from their counters, and of those at rest from their encoders, in degrees, by axis.

    None is an encoder that has lost its reference in a reset.
    """

    degrees: dict[str, float]
    encoders: dict[str, float | None] = field(default_factory=dict)


@dataclass(frozen=True)
class EventLogged:
    """An event was written to the journal: its kind, what happened, where (a row, an axis), and the consequence for the run.

    `detail` is what a device's wire has shown of it.
    """

    kind: str
    what: str
    where: str = ""
    consequence: str = ""
    detail: str = ""


@dataclass(frozen=True)
class SafetyOrder:
    """An order to the persons at the rig, for what the program cannot do itself. It stands until it is acknowledged."""

    order: str
    reason: str

    @property
    def text(self) -> str:
        """Order and reason, as in the journal."""
        return f"{self.order}: {self.reason}"


def left_order(record: "Record") -> SafetyOrder:
    """The order for what a program that died has left."""
    return SafetyOrder(record.remedy, record.reason)


def close_shutter_order(rig: "Rig", error: "DeviceError") -> SafetyOrder:
    """The order where the shutter cannot be closed."""
    return SafetyOrder(CLOSE_SHUTTER, f"it may be open; {rig.in_words(error).headline}")


def shutter_found_open() -> SafetyOrder:
    """The order where the shutter is open and this program has not opened it."""
    return SafetyOrder(CLOSE_SHUTTER, "it is open, and this program has not opened it; or close it on the bench")


def cut_power_order(rig: "Rig", failures: "Sequence[DeviceError]") -> SafetyOrder | None:
    """The order where a stop failed; None where every axis has confirmed it. A grating that turns on is no danger."""
    grating = (rig.monochromator.name, *rig.monochromator.parts)
    axes = [each.device for each in failures if each.device not in grating]
    reason = f"the stop is not confirmed by {', '.join(dict.fromkeys(axes))}"
    return SafetyOrder("Cut the motors' power", reason) if axes else None


@dataclass(frozen=True)
class LightChanged:
    """Wavelength and shutter as the run knows them; None is unknown, as while they change and after a fault."""

    wavelength_nm: float | None
    shutter_open: bool | None


@dataclass(frozen=True)
class DeviceFailed:
    """A device has failed during the run, which follows its policy."""

    error: "DeviceError"


Event = StateChanged | RowStarted | RowCommitted | Positions | EventLogged | SafetyOrder | LightChanged | DeviceFailed
Listener = Callable[[Event], None]
