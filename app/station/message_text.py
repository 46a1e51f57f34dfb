"""Messages of a station in words, for its output and for logs."""

from goniotwin.app.campaign.running.events import EventLogged, SafetyOrder, StateChanged
from goniotwin.app.errors import one_line
from goniotwin.app.station.messages import (
    ActivityChanged,
    DeviceChanged,
    Message,
    OperatorChanged,
    RigClosed,
    RigOpened,
    RunBegun,
    RunEnded,
    RunRefused,
)
from goniotwin.drivers.errors import FaultText


def message_text(message: Message) -> str:
    """One line about a message that a person can use; empty for what a screen shows alone, such as positions."""
    match message:
        case RigOpened(devices=devices):
            silent = " and ".join(message.not_responding)
            text = f"rig opened; {f'not responding: {silent}' if silent else f'{len(devices)} devices respond'}"
        case RigClosed(reason):
            text = f"rig closed {reason}"
        case RunBegun(journal, name):
            text = f"run of {name} into {journal}"
        case RunEnded(state, reason, journal):
            text = f"run ended: {state} {reason}: {journal}"
        case RunRefused(reason):
            text = f"run refused: {reason}"
        case StateChanged(state, reason):
            text = f"{state} {reason}"
        case EventLogged(kind, what, where, consequence, detail):
            text = f"{kind}: {where}: {FaultText(what, detail)} {consequence}"
        case SafetyOrder():
            text = f"SAFETY: {message.text}"
        case DeviceChanged(device, status):
            text = f"{device}: {status.contact}: {FaultText(status.text, '' if status.connected else status.detail)}"
        case ActivityChanged(activity, error, detail=detail) if activity or error:
            text = activity or f"failed: {FaultText(error, detail)}"
        case OperatorChanged(client):
            text = f"operated by {client or 'no client'}"
        case _:
            return ""
    return one_line(text)
