"""Photodiodes with a converter of another make: twelve bits, all channels on one serial line; its driver and twin device."""

from collections import deque
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from serial import Serial

from goniotwin.app.rig.kinds import DeviceKind, PhotodiodesEntry
from goniotwin.app.rig.wires import Wires
from goniotwin.arrays import Counts, Flags, Floats, Ints
from goniotwin.drivers import Until
from goniotwin.drivers.device import PortOpener
from goniotwin.protocols.clock import Clock
from goniotwin.twin.plant import Plant

BAUDRATE = 115_200
CHANGE_S, ANSWER_S = 0.35, 0.002
BANDWIDTH_HZ, ELEMENTARY_CHARGE_C = 5.0, 1.602176634e-19


class TwelveBits:
    """Counts 0 to 4095 for -10 to 10 V."""

    highest = 4095
    lsb_v = 20.0 / 4095
    zero = 10.0 / lsb_v

    def raw(self, volts: Floats) -> Ints:
        return np.clip(np.rint(volts / self.lsb_v + self.zero), 0, self.highest).astype(np.int64)

    def saturated(self, counts: Counts) -> Flags:
        return np.asarray((counts == 0) | (counts == self.highest))


@dataclass(frozen=True, kw_only=True)
class TwelveBitTable:
    """The table of the rig file: `units` has the one address, `upper_deg`, `lower_deg` and `gains_v_per_a` as ever."""

    kind: Literal["daq"]
    units: tuple[str, ...]
    upper_deg: tuple[float, ...]
    lower_deg: tuple[float, ...]
    gains_v_per_a: tuple[float, ...]
    gain_uncertainty: float = 1e-3
    range: ClassVar = TwelveBits()
    module_channels: ClassVar = 16
    period_s: ClassVar = 0.1
    wait_s: ClassVar = CHANGE_S
    gain_seconds: ClassVar = ANSWER_S

    @property
    def count(self) -> int:
        return len(self.upper_deg) + len(self.lower_deg)

    def fetching_seconds(self, *, after_change: bool) -> float:
        return ANSWER_S

    def shot_variance_a2(self, current_a: Floats) -> Floats:
        return 2.0 * ELEMENTARY_CHARGE_C * np.abs(current_a) * BANDWIDTH_HZ


class TwelveBitArray:
    """The driver."""

    name = "photodiodes"
    parts: tuple[str, ...] = ()
    _port: Serial

    def __init__(self, open_port: PortOpener, settings: TwelveBitTable, clock: Clock) -> None:
        self._open_port, self.settings, self.clock = open_port, settings, clock

    def connect(self) -> str:
        self._port = self._open_port(BAUDRATE, 1.0)
        return self.ask("ID")

    def reconnect(self) -> None:
        self.connect()

    def close(self) -> None:
        self._port.close()

    def start_gain(self, gain: int) -> Until:
        self.ask(f"GAIN {gain}")
        return Until(self.clock, self.clock.now())

    def start_readings(self, readings: int, *, settled: bool = False) -> "TwelveBitReadings":
        return TwelveBitReadings(self, readings)

    def ask(self, text: str) -> str:
        self._port.write(text.encode() + b"\n")
        return self._port.read_until(b"\n").decode().strip()


class TwelveBitReadings:
    """Readings in progress."""

    def __init__(self, array: TwelveBitArray, readings: int) -> None:
        self._array, self._taken = array, 0
        self.counts: Counts = np.zeros((readings, array.settings.count), dtype=np.uint16)
        self.due = self.started = array.clock.now() + array.settings.wait_s

    def poll(self) -> bool:
        self.counts[self._taken] = np.array(self._array.ask("READ").split(","), dtype=np.uint16)[: self.counts.shape[1]]
        self._taken += 1
        self.due = self.started + self._taken * self._array.settings.period_s
        return self._taken == len(self.counts)


@dataclass(frozen=True, kw_only=True)
class TwelveBitModel:
    """The table of the twin."""

    kind: Literal["daq-12"]

    def build(self, plant: Plant) -> "TwelveBitTwin":
        return TwelveBitTwin(plant)


class TwelveBitTwin:
    """The twin device."""

    baudrate = BAUDRATE

    def __init__(self, plant: Plant) -> None:
        self._plant, self.outbox = plant, deque[tuple[float, bytes]]()

    def receive(self, data: bytes, t: float) -> None:
        for word, _, number in (line.partition(" ") for line in data.decode().splitlines()):
            answer = "TWIN DAQ"
            if word == "GAIN":
                for each in self._plant.gain:
                    each.set(t, int(number))
            elif word == "READ":
                volts = np.concatenate([self._plant.volts(module, t) for module in range(self._plant.modules)])
                answer = ",".join(map(str, TwelveBits().raw(volts)))
            self.outbox.append((t + 0.5 * ANSWER_S, answer.encode() + b"\n"))

    def reset(self, t: float) -> None:
        """It keeps nothing."""


def _open(wires: Wires, table: Any) -> TwelveBitArray:
    return TwelveBitArray(wires.serial(table.units[0]), table, wires.clock)


TABLE: type[PhotodiodesEntry] = TwelveBitTable
"""The table has what the program asks of it: mypy checks that."""
TWELVE_BITS = DeviceKind("photodiodes", "daq", TABLE, _open, twins=(TwelveBitModel,))
