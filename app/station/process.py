"""The process of a station, `goniotwin station`: until it is disconnected, has no clients, or a signal comes."""

import contextlib
import logging
import threading
from collections.abc import Callable
from pathlib import Path

from goniotwin.app.campaign.running.events import Event
from goniotwin.app.end_signals import call_on_end_signal
from goniotwin.app.rig import read_rig
from goniotwin.app.station.hosting import serving
from goniotwin.app.station.message_text import message_text
from goniotwin.app.station.messages import Message
from goniotwin.app.station.station import Station
from goniotwin.protocols.clock import calendar_stamp

LOG = logging.getLogger(__name__)
UNATTENDED_S = 60.0
"""A station without a client, and with nothing in progress, gives its rig back after this time."""
WAIT_S = 0.1
Log = Callable[[str], None]


def run_station(rig: Path, speed: float, log: Log, unattended_s: float = UNATTENDED_S) -> bool:
    """Be the station of a rig until it is disconnected, has no clients, or a signal comes: True then.

    Raises UserError where the rig cannot be opened, or another program has it.
    """
    description = read_rig(rig)
    station = Station(speed)
    ended = threading.Event()

    def note(text: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # a full disk
            log(text)

    note(f"{calendar_stamp()} station of {description.file.name} ({rig})")
    station.board.subscribe(lambda _number, message: _note_message(note, message))
    with contextlib.ExitStack() as stack:
        signals = stack.enter_context(call_on_end_signal(ended.set))
        station.open(description)
        stack.callback(station.close_rig)
        server = stack.enter_context(serving(station, description))
        engine = threading.Thread(target=station.serve, name="engine")
        station.do(station.connect_all)
        engine.start()
        reason = ""
        try:
            note(f"{calendar_stamp()} serving at port {server.port}")
            # In pieces: on Windows a wait without a limit hears no signal.
            while not ended.wait(WAIT_S) and not station.disconnected.is_set() and engine.is_alive():
                if server.unattended_s > unattended_s and not station.busy:
                    reason = f"no client for {unattended_s:g} s"
                    note(f"{calendar_stamp()} {reason}")
                    break
        finally:
            station.end("the station was ended by a signal" if ended.is_set() else reason)
            engine.join()
    for order in station.orders.open:
        note(f"SAFETY: {order.text}")
    note(f"{calendar_stamp()} ended")
    return signals.received


def _note_message(note: Log, message: Message) -> None:
    if text := message_text(message):
        if not isinstance(message, Event):  # the engine logs its events
            LOG.info("%s", text)
        note(f"{calendar_stamp()} {text}")
