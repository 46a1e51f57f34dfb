"""The safety orders of a station: each is in the snapshot and in its run's journal until a person acknowledges it."""

import contextlib
import threading
from pathlib import Path

from goniotwin.app.campaign.journal.place import JournalError
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.running.events import EventLogged, SafetyOrder
from goniotwin.app.errors import UserError
from goniotwin.app.guardian.record import Record
from goniotwin.app.station.board import Board
from goniotwin.app.station.messages import OrderAcknowledged
from goniotwin.app.station.permissions import CommandRefused
from goniotwin.drivers.guard import CLOSE_SHUTTER
from goniotwin.protocols.clock import Clock


class RunRecord:
    """The journal of a run, for events from any thread, also after the run has closed it."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal = journal
        self._clock = clock
        self._open = True
        self._lock = threading.Lock()

    def event(self, kind: str, text: str) -> None:
        """Write an event. Raises JournalError, UserError."""
        t = self._clock.now()
        with self._lock:
            if self._open:
                self._journal.event(t, kind, text)
            else:
                with Journal.reopen(self._journal.path) as journal:
                    journal.event(t, kind, text)

    def close(self) -> None:
        """Close the journal."""
        with self._lock:
            self._open = False
            self._journal.close()


class SafetyOrders:
    """The orders that are not acknowledged, each with the record of its run; None without a run. From any thread."""

    def __init__(self, board: Board) -> None:
        self._board = board
        self._records: dict[SafetyOrder, RunRecord | None] = {}

    @property
    def open(self) -> list[SafetyOrder]:
        """The orders that are not acknowledged."""
        return list(self._records)

    def give(self, order: SafetyOrder, record: RunRecord | None = None) -> None:
        """Give an order, during the run of a record if there is one."""
        self._records[order] = record
        self._board.publish(order)

    def acknowledge(self, text: str) -> SafetyOrder:
        """A person has carried out the order of a text: return it. Raises CommandRefused where there is none."""
        with self._board.deciding() as now:
            order = next((each for each in now.orders if each.text == text), None)
            if order is None:
                raise CommandRefused(f"no such safety order is open: {text}")
            record = self._records.pop(order, None)
            self._board.publish(OrderAcknowledged(order))
        self._write(record, order)
        return order

    def withdraw(self, order: SafetyOrder) -> None:
        """An order has no object any more. Windows that show one of a program that died take it away too."""
        record = self._records.pop(order, None)
        self._board.publish(OrderAcknowledged(order))
        self._write(record, order)

    def withdraw_shutter(self) -> None:
        """The shutter is closed: withdraw the orders to close it."""
        for each in [order for order in self.open if order.order == CLOSE_SHUTTER]:
            self.withdraw(each)

    def _write(self, record: RunRecord | None, order: SafetyOrder) -> None:
        if record is not None:
            try:
                record.event("acknowledged", order.text)
            except (JournalError, UserError) as error:
                self._board.publish(EventLogged("fault", f"the acknowledgement is not in the journal: {error}", "journal"))


def end_shutter_orders(left: Record) -> None:
    """What a program has left is seen to: end the orders about the shutter in its journal too, if that can be written."""
    if left.journal:
        with contextlib.suppress(JournalError, UserError, OSError), Journal.reopen(Path(left.journal)) as journal:
            for text in journal.open_orders():
                if text.startswith(CLOSE_SHUTTER):
                    journal.event(journal.sessions()[-1].ended_s, "acknowledged", text)
