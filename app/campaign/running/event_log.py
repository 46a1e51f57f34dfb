"""The log of a run: a listener of its events. The journal is the record of the campaign; the log has what the events say."""

import logging

from goniotwin.app.campaign.running.events import (
    DeviceFailed,
    Event,
    EventLogged,
    Listener,
    RowCommitted,
    SafetyOrder,
    StateChanged,
)
from goniotwin.drivers.errors import FaultText

LOG = logging.getLogger(__name__)


def log_listeners() -> list[Listener]:
    """The listener of a run that begins now; none where nothing is logged, so that a rehearsal makes no calls for it."""
    return [log_event] if LOG.isEnabledFor(logging.INFO) else []


def log_event(event: Event) -> None:
    """Log an event: rows and single attempts at level DEBUG, what the run does at INFO, orders at WARNING."""
    match event:
        case RowCommitted(row, data, done, total, seconds_left):
            gains = "/".join(f"{each.gain_v_per_a:g}" for each in data.readings) or "none"
            LOG.debug(
                "row %d of %d, %s: rig's clock %.3f to %.3f s, gains %s V/A, flags %s, left %.0f s",
                done,
                total,
                row.identity,
                data.started_s,
                data.ended_s,
                gains,
                ",".join(data.flags) or "none",
                seconds_left,
            )
        case StateChanged(state, reason):
            LOG.info("run %s%s", state, f": {reason}" if reason else "")
        case EventLogged(kind, what, where, consequence, detail):
            place, then = f"{where}: " if where else "", f": {consequence}" if consequence else ""
            LOG.info("%s: %s%s%s", kind, place, FaultText(what, detail), then)
        case DeviceFailed(error):
            LOG.debug("fault of a device: %s", error)
        case SafetyOrder():
            LOG.warning("SAFETY: %s", event.text)
        case _:
            pass
