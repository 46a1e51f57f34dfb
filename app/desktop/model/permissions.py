"""Which controls are enabled now: what the station allows, of this window's plan. During a run only what cannot disturb it."""

from dataclasses import dataclass

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import State
from goniotwin.app.station.messages import BUSY, Snapshot
from goniotwin.app.station.permissions import allowed, watching


@dataclass(frozen=True)
class Permissions:
    """Whether each control is enabled. `no_start` is the reason why Start is not, in one line, `no_rehearsal` why Rehearse is
    not; empty if it is.

    `refusals` has the reason for each command of the station, empty where it is allowed for this window; `watching` is why it
    only watches, empty if it operates.
    """

    no_start: str
    no_rehearsal: str
    pause: bool
    resume: bool
    stop: bool
    open: bool
    finish_cut: bool
    refusals: dict[str, str]
    watching: str


def permissions(
    station: Snapshot, name: str, plan: Plan | None, no_plan: str, state: State, *, opening: bool, lost: bool = False
) -> Permissions:
    """The permissions of the client `name` of a station, for a plan (or the reason why there is none) and the state shown.

    `opening` is True while a rig is being opened. After the station was `lost`, Stop is enabled: its answer is that it does
    not get through.
    """
    refusals = {command: reason or watching(station, name, command) for command, reason in allowed(station).items()}
    busy = state in BUSY
    begins = busy and not station.busy and station.operated_by(name)  # from the key on: what is pressed goes after the start
    missing = "" if plan is not None else no_plan or "no schedule is open"
    if opening:
        no_start = "the rig is being opened"
    elif busy:
        no_start = f"a run is {state}"
    elif refusals["start"]:
        no_start = refusals["start"]
    else:
        no_start = missing
    return Permissions(
        no_start=no_start,
        no_rehearsal=f"a run is {state}" if busy else missing,
        pause=begins or not refusals["pause"],
        resume=not refusals["resume"],
        stop=station.rig is not None or lost or begins,
        open=not busy and not opening and station.operated_by(name),
        finish_cut=begins or not refusals["finish_cut"],
        refusals=refusals,
        watching=watching(station, name, "answer"),
    )
