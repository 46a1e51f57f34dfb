"""Messages to the window: the events of a station, and what the window's own process makes of its journal."""

from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.journal.samples import KnownSample
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import EventLogged, RowCommitted
from goniotwin.app.desktop.model.time_left import Mounting
from goniotwin.app.rig import RigFile
from goniotwin.app.station.messages import Message as StationMessage
from goniotwin.app.station.messages import Snapshot


@dataclass(frozen=True)
class Attached:
    """The window is a client of a station, by this name; `snapshot` is the state from which its events lead on.

    `found` if the station was there already; `dropped` is why it ended an earlier connection of this window, or empty. `t_s` is
    the time of the rig's clock.
    """

    name: str
    snapshot: Snapshot
    found: bool
    dropped: str = ""
    t_s: float = 0.0


@dataclass(frozen=True)
class PastRead:
    """What the journal has of the time before this window was attached, of the run in progress or the last one.

    `events` are those of a run in progress; `dark_s` is the end of the last dark reading on the rig's clock, `drift` the event
    of the last drift check; None where there is none.
    """

    events: tuple[EventLogged, ...]
    dark_s: float | None
    drift: EventLogged | None


@dataclass(frozen=True)
class NotAttached:
    """There is no station. `reason` is one line for the operator."""

    reason: str


@dataclass(frozen=True)
class StationLost:
    """The station has ended, unasked by this window. `last` is the last that is known of it.

    A run in progress stays in its journal. Where the rig was given back before, nothing is open.
    """

    last: Snapshot


@dataclass(frozen=True)
class RigRead:
    """The tables of the rig that the station has, as this process has read them; None where they cannot be read."""

    rig: RigFile | None


@dataclass(frozen=True)
class PlanBegun:
    """A schedule is being read: PlanMade or PlanRefused follows, unless another one is opened meanwhile."""

    name: str


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
    """The plan of a run in progress, from its journal: its values follow. `mountings` are in the order of the rows."""

    plan: Plan
    journal: Path
    mountings: tuple[Mounting, ...] = ()


@dataclass(frozen=True)
class SamplesRead:
    """What is known of the sample that the question `number` is about: its record in the campaign, and other samples."""

    number: int
    own: KnownSample | None
    known: tuple[KnownSample, ...]


@dataclass(frozen=True)
class ValuesMissing:
    """The journal of the run cannot be read here. The run is not affected."""

    reason: str


@dataclass(frozen=True)
class CommandRefused:
    """The station does not carry out a command. `reason` is one line for the operator."""

    command: str
    reason: str


@dataclass(frozen=True)
class StopReport:
    """What is known of a stop: `confirmed` by all axes, `lost` where it has not reached the station."""

    confirmed: bool
    lost: bool = False
    failures: tuple[str, ...] = ()


Message = (
    StationMessage
    | RowCommitted
    | Attached
    | PastRead
    | NotAttached
    | StationLost
    | RigRead
    | PlanBegun
    | PlanMade
    | PlanRefused
    | RunStarted
    | SamplesRead
    | ValuesMissing
    | CommandRefused
    | StopReport
)
