"""Wires of a served rig with faults on demand: the orders of the control port about faults and plugs.

    {"do": "faults", "device": "axes", "kinds": ["late", "lost"], "share": 0.2, "seed": 3, "exchanges": 100}
    {"do": "faults", "device": "adc-0", "script": ["none", "exception"]}
    {"do": "faults", "device": "axes", "share": 0}
    {"do": "unplug", "device": "monitor"}          {"do": "replug", "device": "monitor", "reset": true}

Without `kinds` a wire has all faults that its bus can have; their names are those of `mocks.faults.Fault`, in small
letters. Of `exchanges` from now on the `share` fails. The answer lists the faults that the order before it has `met`. A late
reply comes after the driver has given up, and a plug that a fault has pulled is out for a second.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from goniotwin.mocks.control import Order, OrderRefused, number, truth_value
from goniotwin.mocks.faults import (
    ON_A_SERIAL_LINE,
    ON_A_TEXT_LINE,
    ON_MODBUS,
    ON_MODBUS_RTU,
    ON_USB,
    Fault,
    FaultPlan,
    ScriptedFaults,
)
from goniotwin.mocks.faulty_line import (
    ExceptionReply,
    FaultyLine,
    ForeignReply,
    exception_rtu,
    exception_tcp,
    foreign_rtu,
    foreign_tcp,
    foreign_tmcl,
)
from goniotwin.mocks.faulty_usb import FaultyUsb
from goniotwin.protocols.clock import Clock
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices import RtuStation, TmclLine
from goniotwin.twin.devices.line import SerialDevice

NAMES = {fault.name.lower(): fault for fault in Fault}
BY_LINE: dict[type, tuple[tuple[Fault, ...], float, ForeignReply | None, ExceptionReply | None]] = {
    TmclLine: (ON_A_SERIAL_LINE, 0.1, foreign_tmcl, None),
    RtuStation: (ON_MODBUS_RTU, 1.05, foreign_rtu, exception_rtu),
}
AWAY_S = 1.0
LATE_S = 1.5


class CurrentOrder(FaultPlan):
    """The current order; another one replaces it while the wire is in use."""

    def __init__(self) -> None:
        super().__init__(0, ())
        self.order: FaultPlan = ScriptedFaults(())

    def next(self) -> Fault:
        """Fault of the next exchange."""
        return self.order.next()

    def draw(self, number: int, below: int) -> int:
        """A number from 0 to `below` - 1."""
        return self.order.draw(number, below)

    @property
    def exchanges(self) -> int:
        """Number of exchanges since the order."""
        return self.order.exchanges


@dataclass
class ServedWire:
    """A served wire: the faults that it can have, and its plug."""

    kinds: tuple[Fault, ...]
    unplug: Callable[[], None]
    replug: Callable[[bool], None]
    late_s: float
    misfortune: CurrentOrder = field(default_factory=CurrentOrder)


class FaultyWires:
    """The wires by device. Without an order they have no faults."""

    def __init__(self, rig: VirtualRig, clock: Clock) -> None:
        self._rig, self._clock = rig, clock
        self._wires: dict[str, ServedWire] = {}

    def line(self, name: str, device: SerialDevice, unplug: Callable[[], None], replug: Callable[[], None]) -> SerialDevice:
        """A serial line, to be served in the place of `device`."""
        kinds, late_s, foreign, refusal = BY_LINE.get(type(device), (ON_A_TEXT_LINE, LATE_S, None, None))
        wire = self._wires[name] = ServedWire(kinds, unplug, self._powered(device, replug), late_s)
        return self._faulty(wire, device, foreign, refusal)

    def connections(self, name: str, unplug: Callable[[], None], replug: Callable[[], None]) -> None:
        """A module on TCP: every connection to it from now on."""
        wire = self._wires[name] = ServedWire(ON_MODBUS, unplug, self._powered(self._rig.modbus[name], replug), LATE_S)
        self._rig.modbus_wires[name] = lambda station: self._faulty(wire, station, foreign_tcp, exception_tcp)

    def usb(self, name: str, unplug: Callable[[], None], replug: Callable[[bool], None]) -> None:
        """A USB device."""
        wire = self._wires[name] = ServedWire(ON_USB, unplug, replug, LATE_S)
        self._rig.usb[name] = FaultyUsb(self._rig.usb[name], wire.misfortune, self._clock, wire.late_s, AWAY_S)

    @property
    def orders(self) -> dict[str, Callable[[Order], dict[str, Any] | None]]:
        """Orders for the control port."""
        return {"faults": self._faults, "unplug": self._unplug, "replug": self._replug}

    def _faults(self, order: Order) -> dict[str, Any]:
        wire = self._wire(order)
        met = [fault.name.lower() for fault in wire.misfortune.order.met]
        seed = int(number(order, "seed")) if "seed" in order else 1
        share = number(order, "share") if "share" in order else 0.2
        count = int(number(order, "exchanges")) if "exchanges" in order else 1 << 30
        if not 0.0 <= share <= 1.0:
            raise OrderRefused(f"share is the part of the exchanges that fail, 0 to 1, not {share:g}")
        if "script" in order:
            wire.misfortune.order = ScriptedFaults(self._kinds(wire, order["script"]))
            return {"met": met}
        kinds = self._kinds(wire, order["kinds"]) if "kinds" in order else wire.kinds
        wire.misfortune.order = FaultPlan(seed, tuple(kinds), share if kinds else 0.0, until=count)
        return {"met": met, "kinds": [kind.name.lower() for kind in kinds]}

    def _unplug(self, order: Order) -> None:
        self._wire(order).unplug()

    def _replug(self, order: Order) -> None:
        self._wire(order).replug(truth_value(order, "reset", default=False))

    def _wire(self, order: Order) -> ServedWire:
        wire = self._wires.get(str(order.get("device")))
        if wire is None:
            raise OrderRefused(f"device is one of: {', '.join(self._wires)}")
        return wire

    @staticmethod
    def _kinds(wire: ServedWire, names: object) -> list[Fault]:
        possible = {kind.name.lower() for kind in (*wire.kinds, Fault.NONE)}
        if not isinstance(names, list) or not all(isinstance(each, str) and each in possible for each in names):
            raise OrderRefused(f"{names!r}: the faults of this wire are {', '.join(sorted(possible))}")
        return [NAMES[each] for each in names]

    def _powered(self, device: Any, replug: Callable[[], None]) -> Callable[[bool], None]:
        """Action that plugs a device in again, with or without a loss of power in between."""

        def again(reset: bool) -> None:
            if reset:
                device.reset(self._clock.now())
            replug()

        return again

    def _faulty(
        self, wire: ServedWire, device: SerialDevice, foreign: ForeignReply | None, refusal: ExceptionReply | None
    ) -> FaultyLine:
        def pulled() -> None:
            wire.unplug()
            self._clock.at(self._clock.now() + AWAY_S, lambda: wire.replug(False))

        return FaultyLine(device, wire.misfortune, wire.late_s, foreign, refusal, pulled)
