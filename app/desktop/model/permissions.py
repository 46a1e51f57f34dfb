"""What may be done now, and why not otherwise: while a run goes on only what cannot disturb it."""

from dataclasses import dataclass

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import State
from goniotwin.app.desktop.model.messages import RigOpened

BUSY = (State.RUNNING, State.PAUSING, State.PAUSED, State.RECOVERING, State.STOPPING)


@dataclass(frozen=True)
class Allowed:
    """Whether each control works. `no_start` says in a line why Start does not; empty where it does."""

    no_start: str
    pause: bool
    resume: bool
    stop: bool
    open: bool


def allowed(rig: RigOpened | None, plan: Plan | None, no_plan: str, state: State, opening: bool) -> Allowed:
    """From what is known: the rig, the plan (or why there is none), the engine's state, whether a rig is being opened."""
    busy = state in BUSY
    if opening:
        no_start = "the rig is being opened"
    elif busy:
        no_start = f"a run is {state}"
    elif rig is None:
        no_start = "there is no rig"
    elif rig.silent:
        no_start = f"no answer from {' and '.join(rig.silent)}"
    elif plan is None:
        no_start = no_plan or "there is no schedule"
    else:
        no_start = ""
    return Allowed(
        no_start=no_start,
        pause=state in (State.RUNNING, State.RECOVERING),
        resume=state in (State.PAUSING, State.PAUSED),
        stop=rig is not None,
        open=not busy and not opening,
    )
