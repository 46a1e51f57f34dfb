"""Events of a station, small enough for a line of its channel: the values of rows are in the journal."""

from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, get_args

from pydantic import TypeAdapter, ValidationError

from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.events import (
    EventLogged,
    LightChanged,
    Positions,
    RowStarted,
    SafetyOrder,
    State,
    StateChanged,
)
from goniotwin.app.campaign.running.question import Answer, Question

LONGEST_TEXT = 2000
"""Characters of a text in an event; the journal has all of it."""


class Contact(StrEnum):
    """Whether a device answers. Silent: it has not answered the last question, and is asked again."""

    CONNECTED = "connected"
    SILENT = "silent"
    DISCONNECTED = "disconnected"


@dataclass(frozen=True)
class DeviceStatus:
    """The state of a device, from its last answer: the only place that has it.

    `identity` is empty before the first connection. `error` is its last fault, and `detail` what the wire has shown of it.
    `answered` and `failed` are the calendar times of its last answer and of that fault, UTC, ISO 8601; empty before the first
    one.
    """

    contact: Contact
    identity: str = ""
    answered: str = ""
    error: str = ""
    detail: str = ""
    failed: str = ""

    @property
    def connected(self) -> bool:
        """Whether it has answered the last question."""
        return self.contact is Contact.CONNECTED

    @property
    def text(self) -> str:
        """Its identity, or the reason why it does not respond."""
        return self.identity if self.connected else self.error


@dataclass(frozen=True)
class RigOpened:
    """A rig is open, with the status of each device by its name.

    `name` is that in the rig file, `path` the rig file or the journal that it was read from, `digest` the SHA-256 of its text.
    `virtual` if all devices are: then the simulation speed can be set, and samples are mounted by the program. `controllers`
    has the device of each axis.
    """

    name: str
    path: Path
    digest: str
    simulated: bool
    seed: int | None
    virtual: bool
    devices: dict[str, DeviceStatus]
    controllers: dict[str, str] = field(default_factory=dict)

    @property
    def not_responding(self) -> list[str]:
        """The devices that do not respond: silent or disconnected."""
        return [device for device, status in self.devices.items() if not status.connected]

    @property
    def silent_axes(self) -> list[str]:
        """The axes whose controller does not respond: where they are, and whether they are referenced, is unknown."""
        silent = self.not_responding
        return [axis for axis, device in self.controllers.items() if device in silent]


@dataclass(frozen=True)
class RigClosed:
    """No rig is open. `reason` is one line for the operator, or empty; `fault` if it was closed because of one."""

    reason: str = ""
    fault: bool = False


@dataclass(frozen=True)
class DeviceChanged:
    """The status of a device has changed."""

    device: str
    status: DeviceStatus


@dataclass(frozen=True)
class DevicesAnswered:
    """Calendar times of the last answers, by device."""

    times: dict[str, str]


@dataclass(frozen=True)
class ReferencesChanged:
    """Why axes are unreferenced, by axis; empty if all are referenced."""

    unreferenced: dict[str, str]


@dataclass(frozen=True)
class ActivityChanged:
    """What the station does now, apart from the rows of a run, in words; empty if nothing.

    `error` is the fault or the refusal with which the activity before ended, empty if it is done, and `detail` what the wire
    has shown of it. `starts` if a run begins with it: it can be paused and ended before its first row.
    """

    activity: str
    error: str = ""
    starts: bool = False
    detail: str = ""


@dataclass(frozen=True)
class BenchChanged:
    """Settings of the bench, or of the run, as far as they are known: None is unknown. `live` while live readings are taken."""

    wavelength_nm: float | None = None
    shutter_open: bool | None = None
    gain_v_per_a: float | None = None
    sample: str | None = None
    live: bool = False


@dataclass(frozen=True)
class LampRead:
    """The monitor's current with the shutter open, A, whether it shows `light`, and the calendar time of the reading."""

    current_a: float
    light: bool
    read: str


@dataclass(frozen=True)
class BenchReading:
    """A reading of all photodiodes on the bench, each the mean over `readings` conversions.

    `volts` has None for a photodiode that is `saturated` in one of them. `dark` if the shutter was closed for it; `live` if it
    is one of the live readings. `t_s` is on the rig's clock.
    """

    t_s: float
    readings: int
    gain_v_per_a: float
    counts: tuple[float, ...]
    volts: tuple[float | None, ...]
    saturated: tuple[bool, ...]
    monitor_a: float | None
    wavelength_nm: float | None
    dark: bool
    live: bool


@dataclass(frozen=True)
class RunBegun:
    """A run has begun, into a journal. `done` of the `total` planned rows are measured already; `seconds_left` is estimated.

    `person` if a person is the operator of a virtual rig.
    """

    journal: Path
    name: str
    done: int
    total: int
    seconds_left: float
    person: bool = False


@dataclass(frozen=True)
class RowSaved:
    """A row is on the disk: `done` of the `total` planned rows are measured. Its values are in the journal, by its number."""

    row: Row
    flags: tuple[str, ...]
    done: int
    total: int
    seconds_left: float


@dataclass(frozen=True)
class RunEnded:
    """A run has ended: done, failed, or idle if it was stopped. Its journal is closed; `journal` is the file with all rows."""

    state: State
    reason: str
    journal: Path


@dataclass(frozen=True)
class RunRefused:
    """A run was not started and nothing was measured. `reason` is one line for the operator."""

    reason: str


@dataclass(frozen=True)
class QuestionAsked:
    """The run waits for the operator's answer: the command `answer` with the question's number."""

    number: int
    question: Question


@dataclass(frozen=True)
class QuestionClosed:
    """A question does not wait any more. `answer` is None where a stop ended it."""

    number: int
    answer: Answer | None


@dataclass(frozen=True)
class OrderAcknowledged:
    """A safety order has been acknowledged."""

    order: SafetyOrder


@dataclass(frozen=True)
class SpeedChanged:
    """The simulation speed of a virtual rig."""

    speed: float


@dataclass(frozen=True)
class OperatorChanged:
    """The client that operates; empty if the place is free."""

    client: str


@dataclass(frozen=True)
class StopReceived:
    """A stop has been carried out. What was asked for before it does not begin any more."""


Message = (
    StateChanged
    | RowStarted
    | Positions
    | EventLogged
    | SafetyOrder
    | RigOpened
    | RigClosed
    | DeviceChanged
    | DevicesAnswered
    | ReferencesChanged
    | ActivityChanged
    | BenchChanged
    | BenchReading
    | RunBegun
    | RowSaved
    | RunEnded
    | RunRefused
    | QuestionAsked
    | QuestionClosed
    | OrderAcknowledged
    | SpeedChanged
    | OperatorChanged
    | StopReceived
    | LightChanged
    | LampRead
)
NEWEST_ONLY = (Positions, BenchReading, DevicesAnswered, LampRead)
"""Of these a client needs only the newest."""


@dataclass(frozen=True)
class Snapshot:
    """The station as its events so far give it; `number` is that of the last one.

    `journal` is that of the run in progress, or of the last one, and `person` its operator; `starting` until its engine is in a
    state; `row` the row in progress; `reason` why the state was entered; `unreferenced` why axes are so; `positions` are from
    the axes' counters, `encoders` from the encoders of those at rest, None after a reset; `stops` counts those so far.
    """

    number: int = 0
    rig: RigOpened | None = None
    closed: str = ""
    state: State = State.IDLE
    reason: str = ""
    journal: Path | None = None
    campaign: str = ""
    done: int = 0
    total: int = 0
    seconds_left: float = 0.0
    person: bool = False
    starting: bool = False
    row: Row | None = None
    activity: str = "opening the rig"
    bench: BenchChanged = field(default_factory=BenchChanged)
    positions: dict[str, float] = field(default_factory=dict)
    encoders: dict[str, float | None] = field(default_factory=dict)
    unreferenced: dict[str, str] = field(default_factory=dict)
    reading: BenchReading | None = None
    lamp: LampRead | None = None
    question: QuestionAsked | None = None
    orders: tuple[SafetyOrder, ...] = ()
    speed: float = 1.0
    operator: str = ""
    stops: int = 0

    @property
    def busy(self) -> bool:
        """Whether a run is in progress."""
        return self.state in BUSY

    @property
    def given_back(self) -> bool:
        """Whether the rig has been closed in good order."""
        return self.rig is None and not self.activity

    def place(self, axis: str) -> tuple[float | None, float | None, bool]:
        """Counter and encoder of an axis, deg, None is unknown; and whether the encoder has lost its reference in a reset."""
        return self.positions.get(axis), self.encoders.get(axis), self.encoders.get(axis, 0.0) is None

    def operated_by(self, client: str) -> bool:
        """Whether a client operates the rig, or takes the free place with its next command."""
        return self.operator in ("", client)


BUSY = (State.RUNNING, State.PAUSING, State.PAUSED, State.RECOVERING, State.STOPPING)


def advance(before: Snapshot, message: Message) -> Snapshot:
    """The snapshot after an event: the station and its clients keep theirs by this one function."""
    changes: dict[str, Any] = {}
    match message:
        case StateChanged(state, reason):
            changes = {"state": state, "reason": reason, "starting": False}
        case RowStarted(row):
            changes = {"row": row}
        case Positions(degrees, encoders):
            changes = {"positions": {**before.positions, **degrees}, "encoders": encoders}
        case SafetyOrder():
            changes = {"orders": (*(each for each in before.orders if each != message), message)}
        case OrderAcknowledged(order):
            changes = {"orders": tuple(each for each in before.orders if each != order)}
        case RigOpened():
            changes = {"rig": message, "closed": "", "activity": ""}
        case RigClosed(reason):
            changes = {
                "rig": None,
                "closed": reason,
                "state": State.IDLE,
                "activity": "",
                "positions": {},
                "encoders": {},
                "unreferenced": {},
                "row": None,
                "bench": BenchChanged(),
                "reading": None,
                "lamp": None,
                "starting": False,
            }
        case DeviceChanged(device, status) if before.rig is not None:
            rig = _with_devices(before.rig, {device: status})
            changes = {"rig": rig} | {
                each: {axis: angle for axis, angle in getattr(before, each).items() if axis not in rig.silent_axes}
                for each in ("positions", "encoders")
            }
        case DevicesAnswered(times) if before.rig is not None:
            known = before.rig.devices
            changes = {
                "rig": _with_devices(
                    before.rig, {name: replace(known[name], answered=time) for name, time in times.items() if name in known}
                )
            }
        case ReferencesChanged(unreferenced):
            changes = {"unreferenced": unreferenced}
        case ActivityChanged(activity, starts=starts):
            changes = {"activity": activity, "starting": starts}
        case BenchChanged():
            changes = {"bench": message}
        case BenchReading():
            changes = {"reading": message}
        case LightChanged(wavelength_nm, shutter_open):
            changes = {"bench": replace(before.bench, wavelength_nm=wavelength_nm, shutter_open=shutter_open)}
        case LampRead():
            changes = {"lamp": message}
        case RunBegun(journal, name, done, total, seconds_left, person):
            changes = {
                "journal": journal,
                "campaign": name,
                "done": done,
                "total": total,
                "seconds_left": seconds_left,
                "person": person,
                "activity": "",
                "row": None,
                "starting": True,
            }
        case RowSaved(_row, _flags, done, total, seconds_left):
            changes = {"done": done, "total": total, "seconds_left": seconds_left}
        case RunEnded(state, reason, journal):
            changes = {
                "state": state,
                "reason": reason,
                "journal": journal,
                "row": None,
                "question": None,
                "starting": False,
            }
        case RunRefused(reason):
            changes = {"state": State.IDLE, "reason": reason, "activity": "", "starting": False}
        case QuestionAsked():
            changes = {"question": message}
        case QuestionClosed(number) if before.question is not None and before.question.number == number:
            changes = {"question": None}
        case SpeedChanged(speed):
            changes = {"speed": speed}
        case OperatorChanged(client):
            changes = {"operator": client}
        case StopReceived():
            changes = {"stops": before.stops + 1}
    return Snapshot(**{**_content(before), "number": before.number + 1, **changes})


def encode(message: Message | Snapshot) -> dict[str, Any]:
    """A message as a JSON object, with its type; long texts are cut."""
    content: dict[str, Any] = _adapter(type(message)).dump_python(message, mode="json")
    return {"type": type(message).__name__, **_cut(content)}


def decode(content: dict[str, Any]) -> Message | Snapshot | None:
    """The message of a JSON object; None for a type of a later version. Raises ValueError for content that it cannot have."""
    kind = KINDS.get(content.get("type", ""))
    if kind is None:
        return None
    try:
        message: Message | Snapshot = _adapter(kind).validate_python({k: v for k, v in content.items() if k != "type"})
    except ValidationError as error:
        raise ValueError(f"{kind.__name__}: {error.errors()[0]['msg']}") from None
    return message


ADAPTERS: dict[str, TypeAdapter[Any]] = {}
"""By the name of the class, made at its first use."""
KINDS: dict[str, type[Any]] = {each.__name__: each for each in (*get_args(Message), Snapshot)}


def _adapter(kind: Any) -> TypeAdapter[Any]:
    name = kind.__name__
    if name not in ADAPTERS:
        ADAPTERS[name] = TypeAdapter(kind)
    return ADAPTERS[name]


def _cut(content: Any) -> Any:
    if isinstance(content, str):
        return content if len(content) <= LONGEST_TEXT else f"{content[:LONGEST_TEXT]} ..."
    if isinstance(content, dict):
        return {key: _cut(value) for key, value in content.items()}
    return [_cut(each) for each in content] if isinstance(content, list) else content


def _with_devices(rig: RigOpened, devices: dict[str, DeviceStatus]) -> RigOpened:
    return replace(rig, devices={**rig.devices, **devices})


def _content(instance: Any) -> dict[str, Any]:
    return {each.name: getattr(instance, each.name) for each in fields(instance)}
