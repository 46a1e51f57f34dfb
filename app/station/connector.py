"""The connector of an open rig's devices, which then looks at what it finds: settings of the bench, and a shutter left open."""

from pathlib import Path

from goniotwin.app.campaign.running.events import EventLogged, left_order, shutter_found_open
from goniotwin.app.guardian.record import Record
from goniotwin.app.rig import RigDescription
from goniotwin.app.rig.last_rig import remember_rig
from goniotwin.app.station.board import Board, Publish
from goniotwin.app.station.messages import RigOpened
from goniotwin.app.station.orders import SafetyOrders, end_shutter_orders
from goniotwin.app.station.poller import Poller
from goniotwin.drivers import DeviceError


class Connector:
    """Connects the devices of the rig of a poller, and reports them; nothing moves. In the engine's thread."""

    def __init__(
        self, poller: Poller, description: RigDescription, board: Board, publish: Publish, orders: SafetyOrders
    ) -> None:
        self._poller = poller
        self._opened = poller.bench.opened
        self._description = description
        self._board = board
        self._publish = publish
        self._orders = orders

    def report(self, outcome: dict[str, DeviceError | None], *, closing: bool = False) -> None:
        """Report the devices with the errors, or None, of their first connections; `closing` as in `_look`."""
        description = self._description
        if not any(outcome.values()):
            remember_rig(description.file)
        devices = self._poller.contacts.first_statuses(outcome)
        controllers = {axis: each.name for each in self._opened.rig.controllers for axis in each.axes}
        self._publish(
            RigOpened(
                description.file.name,
                Path(description.name),
                description.digest,
                description.simulated,
                description.seed,
                description.file.in_process,
                devices,
                controllers,
            )
        )
        self._look(closing=closing)

    def connect(self, device: str) -> None:
        """Connect a device anew; without a name all that do not respond."""
        rig = self._board.snapshot.rig
        for name in [device] if device else (rig.not_responding if rig is not None else []):
            if self._poller.contacts.connect(name) is None:
                self._look_after(name)

    def connect_lost(self) -> None:
        """Connect an idle device again that was lost, if that is due."""
        self._look_after(self._poller.contacts.connect_lost())

    def _look_after(self, device: str) -> None:
        """Ask for the settings of the bench again where a device of them was connected: light and gain may be others."""
        rig = self._board.snapshot.rig
        if device and rig is not None and device not in rig.controllers.values():
            self._look()

    def _look(self, *, closing: bool = False) -> None:
        """Ask for the settings of the bench; `closing` closes a shutter that is open, also one that was opened by hand."""
        bench, left = self._poller.bench, self._opened.guard.left
        bench.look()
        self._see_to_shutter(left, closing=closing)
        self._publish(bench.settings)
        self._poller.report_references()

    def _see_to_shutter(self, left: Record | None, *, closing: bool) -> None:
        """Close the shutter that a program which died has left open; order a person to, where that fails.

        A shutter that is open for another reason is left as it is, with an order, unless `closing`.
        """
        bench, guard = self._poller.bench, self._opened.guard
        is_open = bench.settings.shutter_open
        if left is not None and left.done:
            self._publish(EventLogged("guardian", left.outcome, left.device))
            guard.settle()
            end_shutter_orders(left)
            left = None
        if left is None and (bench.opened_shutter or not is_open):
            return
        if left is None and not closing:
            self._orders.give(shutter_found_open())
            return
        found = left_order(left) if left is not None else shutter_found_open()
        try:
            if is_open is not False:
                bench.close_left_open()
        except DeviceError as error:
            self._poller.contacts.note_fault(error)
            self._orders.give(found)
        else:
            how = "found closed" if is_open is False else "closed now"
            self._publish(EventLogged("guardian", f"Shutter {how}: {found.reason}", self._opened.rig.monochromator.name))
            guard.settle()
            self._orders.withdraw(found)
            if left is not None:
                end_shutter_orders(left)
