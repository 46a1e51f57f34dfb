"""Which controls are enabled now. During a run only those that cannot disturb it."""

from dataclasses import dataclass

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import State
from goniotwin.app.desktop.model.messages import RigOpened

BUSY = (State.RUNNING, State.PAUSING, State.PAUSED, State.RECOVERING, State.STOPPING)


@dataclass(frozen=True)
class Permissions:
    """Whether each control is enabled. `no_start` is the reason why Start is not, in one line; empty if it is."""

    no_start: str
    pause: bool
    resume: bool
    stop: bool
    open: bool


def permissions(rig: RigOpened | None, plan: Plan | None, no_plan: str, state: State, opening: bool) -> Permissions:
    """The permissions for a rig, a plan (or the reason why there is none), and a state of the engine.

    `opening` is True while a rig is being opened.
    """
    busy = state in BUSY
    if opening:
        no_start = "the rig is being opened"
    elif busy:
        no_start = f"a run is {state}"
    elif rig is None:
        no_start = "no rig is open"
    elif rig.not_responding:
        no_start = f"not responding: {' and '.join(rig.not_responding)}"
    elif plan is None:
        no_start = no_plan or "no schedule is open"
    else:
        no_start = ""
    return Permissions(
        no_start=no_start,
        pause=state in (State.RUNNING, State.RECOVERING),
        resume=state in (State.PAUSING, State.PAUSED),
        stop=rig is not None,
        open=not busy and not opening,
    )
