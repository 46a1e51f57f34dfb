"""Which commands a station accepts now: one function of its state, for the station to refuse and for a window to grey out."""

from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.errors import UserError
from goniotwin.app.station.messages import Snapshot

STOPPED = "stopped before the start"
"""The reason for what was asked for before a stop and has not begun yet."""
EVERYBODYS = ("stop", "operate", "acknowledge")
"""Commands of clients that only watch too."""
ANYTIME = ("stop", "operate", "disconnect")
"""Commands that do not need a rig at rest."""
OF_RUN = ("pause", "resume", "finish_cut", "answer", "acknowledge", "speed")
OF_BENCH = (
    "start",
    "continue",
    "connect",
    "move",
    "home",
    "set_position",
    "wavelength",
    "shutter",
    "gain",
    "read",
    "live",
    "mount",
)
COMMANDS = (*ANYTIME, *OF_RUN, *OF_BENCH)


class CommandRefused(UserError):
    """A command that the station does not carry out now; the message is the reason, in one line."""


def allowed(station: Snapshot) -> dict[str, str]:
    """For each command the reason why it is refused now, in one line; empty where it is allowed."""
    refusals = dict.fromkeys(COMMANDS, "")
    for command in OF_BENCH:
        refusals[command] = _no_bench(station, command)
    if station.rig is None:
        refusals["stop"] = "no rig is open"
    if station.busy or station.starting:
        refusals["disconnect"] = f"a run is {station.state if station.busy else 'starting'}; stop it first"
    if not station.starting and station.state not in (State.RUNNING, State.RECOVERING):
        refusals["pause"] = f"the run is {station.state}" if station.busy else "no run is in progress"
    if station.state not in (State.PAUSING, State.PAUSED):
        refusals["resume"] = f"the run is {station.state}" if station.busy else "no run is in progress"
    if not station.starting and (not station.busy or station.state is State.STOPPING):
        refusals["finish_cut"] = f"the run is {station.state}" if station.busy else "no run is in progress"
    if station.question is None:
        refusals["answer"] = "no question is open"
    if not station.orders:
        refusals["acknowledge"] = "no safety order is open"
    if station.rig is None or not station.rig.virtual:
        refusals["speed"] = "the rig is not virtual, or none is open"
    return refusals


def watching(station: Snapshot, client: str, command: str) -> str:
    """The reason why a client that only watches is refused a command; empty for one that may operate."""
    if command in EVERYBODYS or station.operated_by(client):
        return ""
    return f"{station.operator} operates this rig; choose Operate from here first"


def _no_bench(station: Snapshot, command: str) -> str:
    rig = station.rig
    if rig is None:
        return station.activity or station.closed or "no rig is open"
    if station.question is not None and (axis := station.question.question.axis) is not None:
        ways = f"{Answer.HOME} and {Answer.SET_POSITION} are answers" if axis.homes else f"{Answer.SET_POSITION} is an answer"
        return f"the run waits for an answer about {axis.name}: {ways} of its question, in the window or the run's terminal"
    if station.busy:
        return f"a run is {station.state}"
    if station.starting:
        return station.activity or "a run is starting"
    if station.activity and command != "live":
        return station.activity
    silent = rig.not_responding
    if command in ("start", "continue") and silent:
        return f"not responding: {' and '.join(silent)}"
    needed = {
        "wavelength": "monochromator",
        "shutter": "monochromator",
        "gain": "photodiodes",
        "read": "photodiodes",
        "live": "photodiodes",
    }.get(command, "")
    if needed in silent:
        return f"not responding: {needed}"
    if command == "mount" and not rig.simulated:
        return "a person mounts the samples of this rig"
    return ""
