"""Whether the devices of an open rig answer: the state of each in the station's snapshot, which follows from its last answer.

An idle device is asked now and then. A question without an answer is repeated; then the device counts as lost, and is
connected again after a while, unless another program has taken it. All of it is done in the engine's thread.
"""

import contextlib
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace

from goniotwin.app.station.board import Board
from goniotwin.app.station.messages import Contact, DeviceChanged, DevicesAnswered, DeviceStatus
from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, NoAnswer, Rig
from goniotwin.drivers.errors import FaultText, Taken
from goniotwin.protocols.clock import Clock, calendar_stamp

ASK_S = 5.0
"""Real time between two questions to a device that nothing else uses."""
REPEATS, REPEAT_S = 2, 1.0
"""A question to an idle device is repeated so often, after so much real time, before the device counts as lost."""
CONNECT_S = 5.0
"""Real time until a lost idle device is connected again, and between two attempts."""
CONNECT_SHARE = 5.0
"""The same as a multiple of the duration of the last attempt: commands wait for it."""
ANSWERED_S = 2.0
"""Real time between two reports of when the devices last answered."""


class Contacts:
    """The states of a rig's devices, published on a board. `wall` is real time."""

    def __init__(self, rig: Rig, board: Board, wall: Clock) -> None:
        self._rig, self._board, self._wall = rig, board, wall
        self._answered: dict[str, str] = {}
        """Calendar time of each device's last answer."""
        self._failures: defaultdict[str, int] = defaultdict(int)
        """Questions in succession that a device has not answered."""
        self._taken: set[str] = set()
        """Devices that another program has taken: they are not connected again unasked."""
        self._ask_at, self._connect_at = defaultdict[str, float](float), defaultdict[str, float](float)
        self._report_at = 0.0

    def first_statuses(self, outcome: dict[str, DeviceError | None]) -> dict[str, DeviceStatus]:
        """The states after the first connection, by its error, or None, of each device."""
        now = calendar_stamp()
        faults = {device: self._rig.in_words(error) for device, error in outcome.items() if error is not None}
        return {
            device: DeviceStatus(Contact.CONNECTED, self._rig.identities[device], now)
            if device not in faults
            else DeviceStatus(Contact.DISCONNECTED, error=faults[device].headline, detail=faults[device].detail, failed=now)
            for device in outcome
        }

    def ask_now_and_then(self, device: str, question: Callable[[], object], *, recovered: bool = False) -> None:
        """Ask an idle device, if that is due; `recovered` as in `ask`."""
        if self._wall.now() >= self._ask_at[device]:
            self.ask(device, question, recovered=recovered)

    def ask(self, device: str, question: Callable[[], object], *, recovered: bool = False) -> None:
        """Ask an idle device, unless it is disconnected or has not answered just now; one that a run recovers is never lost."""
        status = self._status(device)
        if status is None or status.contact is Contact.DISCONNECTED:
            return
        if self._failures[device] and self._wall.now() < self._ask_at[device]:
            return
        self._ask_at[device] = self._wall.now() + ASK_S
        try:
            question()
        except (NoAnswer, BadAnswer) as error:
            self._failures[device] += 1
            if self._failures[device] > REPEATS and not recovered:
                self.note_lost(device, error)
            else:
                self._ask_at[device] = self._wall.now() + REPEAT_S
                self._change(device, Contact.SILENT, self._rig.in_words(error))
        except DeviceError as error:
            self.note_fault(error, recovered=recovered)
        else:
            self.note_answers(device)

    def note_answers(self, *devices: str) -> None:
        """Devices have answered, and so are connected; all of them without a name."""
        for device in devices or [each.name for each in self._rig.devices]:
            status = self._status(device)
            if status is not None and not status.connected:
                self._note_connected(device)
            else:
                self._failures.pop(device, None)
                self._answered[device] = calendar_stamp()

    def note_fault(self, fault: DeviceError, *, recovered: bool = False) -> None:
        """Take a fault: one of the wire shows that its device is lost, or only silent where a run recovers it."""
        if isinstance(fault, NoAnswer | BadAnswer | Forgotten):
            with contextlib.suppress(KeyError):
                device = self._rig.device(fault.device).name
                if recovered and not isinstance(fault, Forgotten):
                    self._change(device, Contact.SILENT, self._rig.in_words(fault))
                else:
                    self.note_lost(device, fault)

    def note_lost(self, device: str, fault: DeviceError) -> None:
        """A device is disconnected."""
        self._failures.pop(device, None)
        self._connect_at[device] = self._wall.now() + CONNECT_S
        if isinstance(fault, Taken):
            self._taken.add(device)
        self._change(device, Contact.DISCONNECTED, self._rig.in_words(fault))

    def connect(self, device: str) -> DeviceError | None:
        """Connect a device anew; nothing moves. Returns the error, or None."""
        error = self._rig.connect_device(device)
        if error is None:
            self._note_connected(device)
        else:
            self.note_lost(device, error)
        return error

    def connect_lost(self) -> str:
        """Connect one idle device that was lost, if that is due; return its name if it is connected again, else nothing."""
        rig = self._board.snapshot.rig
        for device, status in rig.devices.items() if rig is not None else ():
            due = status.contact is Contact.DISCONNECTED and bool(status.identity) and device not in self._taken
            if due and self._wall.now() >= self._connect_at[device]:
                begun = self._wall.now()
                error = self._rig.connect_device(device)
                now = self._wall.now()
                self._connect_at[device] = now + max(CONNECT_S, CONNECT_SHARE * (now - begun))
                if error is None:
                    self._note_connected(device)
                elif isinstance(error, Taken):
                    self.note_lost(device, error)
                return device if error is None else ""
        return ""

    def report_answers_now_and_then(self) -> None:
        """Report when the devices have answered, if that is due."""
        if self._wall.now() >= self._report_at:
            self._report_at = self._wall.now() + ANSWERED_S
            rig = self._board.snapshot.rig
            if rig is not None and any(rig.devices[name].answered != time for name, time in self._answered.items()):
                self._board.publish(DevicesAnswered(dict(self._answered)))

    def _note_connected(self, device: str) -> None:
        self._failures.pop(device, None)
        self._taken.discard(device)
        self._answered[device] = calendar_stamp()
        self._change(device, Contact.CONNECTED)

    def _status(self, device: str) -> DeviceStatus | None:
        rig = self._board.snapshot.rig
        return None if rig is None else rig.devices.get(device)

    def _change(self, device: str, contact: Contact, fault: FaultText | None = None) -> None:
        """Publish another state of a device, with its fault if there is one."""
        before = self._status(device)
        if before is not None:
            identity = self._rig.identities.get(device, before.identity)
            status = replace(before, contact=contact, identity=identity, answered=self._answered.get(device, before.answered))
            if fault is not None:
                status = replace(status, error=fault.headline, detail=fault.detail, failed=calendar_stamp())
            self._board.publish(DeviceChanged(device, status))
