"""Advantech's converter modules: ADAM-6017, whose digital outputs choose the amplifiers' gain, and ADAM-4117, without any.

An ADAM-4117 stands behind amplifiers of one fixed gain, the first of the plant's list. Registers of the 4X table are
read by functions 03 and 04 alike, coils of the 0X table by 01 and 02 alike.

The eight inputs have ranges, counts, a maximum and a minimum; a change of range loses one reading.
"""

import math
import struct
from collections import deque

import numpy as np

from goniotwin.arrays import Floats, Ints
from goniotwin.protocols import adam
from goniotwin.twin.plant import Plant
from goniotwin.twin.plant.converter import CONVERTED

LOOK_BACK = 64
"""So many conversions before a question about maximum or minimum are looked at; older ones count if they were read."""


class Inputs:
    """The inputs of module `index` of the plant, at a time t. `changes` is the number of changes of a range."""

    def __init__(self, plant: Plant, index: int, power_on: int) -> None:
        self._plant = plant
        self._index = index
        self._power_on = power_on
        self.changes = 0
        self._change = self._first = 0
        self._coming: Ints = np.empty((0, adam.CHANNELS), dtype=np.int64)
        self._period = plant.conversion_period_s
        self.reset(0.0)

    def reset(self, t: float) -> None:
        """As after power-on: all inputs enabled, the range `power_on`, no maximum and no minimum yet."""
        self.ranges = [self._power_on] * adam.CHANNELS
        self.enabled = adam.ALL_CHANNELS
        self.held: dict[int, tuple[int, int]] = {}
        self._scale()
        self._seen_until = self._conversion(adam.CHANNELS - 1, t)
        self._highest = np.full(adam.CHANNELS + 1, -1)
        self._lowest = np.full(adam.CHANNELS + 1, adam.FULL_SCALE + 1)

    def counts(self, t: float) -> list[int]:
        """The raw values of all channels; 0 for one that is not enabled. The same until the next conversion."""
        raw = self._converted(t)
        for channel, (value, until) in list(self.held.items()):
            if self._conversion(channel, t) < until:
                raw[channel] = value
            else:
                del self.held[channel]
        if self.enabled != adam.ALL_CHANNELS:
            raw = [value if self.enabled >> channel & 1 else 0 for channel, value in enumerate(raw)]
        return raw

    def _converted(self, t: float) -> list[int]:
        """The raw values of the last conversions. While nothing changes those of coming readings are kept."""
        tick = self._plant.tick(t)
        if self._change != self._plant.changes.number or not 0 <= tick - self._first < len(self._coming):
            coming = self._plant.coming_readings(tick)
            if coming is None or not coming.steady[self._index]:
                alone: list[int] = self._quantised(self._plant.volts(self._index, t)).tolist()
                return alone
            counts = coming.counts.get(ranges := tuple(self.ranges))
            if counts is None:
                counts = coming.counts[ranges] = self._quantised(coming.volts)
            self._change, self._first, self._coming = coming.change, coming.first, counts[self._index]
        found: list[int] = self._coming[tick - self._first].tolist()
        return found

    def _quantised(self, volts: Floats) -> Ints:
        """The raw values of voltages (..., 8) in the ranges that are set."""
        return adam.quantise(volts, self._lows, self._steps)

    def average(self, t: float) -> int:
        """The mean raw value of the enabled channels, 0 where there is none."""
        return self._mean(self.counts(t))

    def set_range(self, channel: int, code: int, t: float) -> None:
        """Set a range. The next reading is lost: the register keeps its value until the reading after that is finished."""
        if code == self.ranges[channel]:
            return
        held = self.counts(t)[channel]
        self.ranges[channel] = code
        self.changes += 1
        self.held[channel] = (held, self._conversion(channel, t) + 2)
        self._seen_until = self._conversion(adam.CHANNELS - 1, t)
        self._scale()

    def shown(self, t: float) -> list[float]:
        """Values of the float registers: eight channels and the average (that of the raw values, in channel 0's range)."""
        counts = self.counts(t)
        values = [adam.RANGES[code].shown(raw) for code, raw in zip(self.ranges, counts, strict=True)]
        return [*values, adam.RANGES[self.ranges[0]].shown(self._mean(counts))]

    def broken(self, t: float) -> list[bool]:
        """Of each channel: a 4-20 mA input with less than 4 mA is taken for a broken wire."""
        ranges = [adam.RANGES[code] for code in self.ranges]
        volts = self._plant.volts(self._index, t)
        return [each.current and each.low_v > 0.0 and bool(volt < each.low_v) for each, volt in zip(ranges, volts, strict=True)]

    def highest(self, t: float) -> list[int]:
        """The highest raw values since the last reset, of the channels and of the average."""
        self._look(t)
        return [int(value) for value in self._highest]

    def lowest(self, t: float) -> list[int]:
        """The lowest raw values since the last reset, of the channels and of the average."""
        self._look(t)
        return [int(value) for value in self._lowest]

    def forget_highest(self, channel: int, t: float) -> None:
        """Reset the maximum of a channel (8: of the average)."""
        self._look(t)
        self._highest[channel] = -1

    def forget_lowest(self, channel: int, t: float) -> None:
        """Reset the minimum of a channel (8: of the average)."""
        self._look(t)
        self._lowest[channel] = adam.FULL_SCALE + 1

    def _look(self, t: float) -> None:
        """Update maximum and minimum with the conversions since the last update, `LOOK_BACK` at most, and the present one."""
        last = self._conversion(adam.CHANNELS - 1, t)
        held = dict(self.held)
        for conversion in range(max(self._seen_until + 1, last - LOOK_BACK), last):
            self._see((conversion + 2.0) * self._period)
            self.held = dict(held)
        self._see(t)
        self._seen_until = last

    def _see(self, t: float) -> None:
        counts = self.counts(t)
        row = np.array([*counts, self._mean(counts)])
        self._highest = np.maximum(self._highest, row)
        self._lowest = np.minimum(self._lowest, row)

    def _mean(self, counts: list[int]) -> int:
        enabled = [value for channel, value in enumerate(counts) if self.enabled >> channel & 1]
        return round(sum(enabled) / len(enabled)) if enabled else 0

    def _conversion(self, channel: int, t: float) -> int:
        """The number of the last conversion of a channel that is finished at `t`, as the plant counts them."""
        return math.floor(t / self._period + CONVERTED - (channel + 1) / adam.CHANNELS)

    def _scale(self) -> None:
        self._lows = np.array([adam.RANGES[code].low_v for code in self.ranges])
        self._steps = np.array([adam.RANGES[code].lsb_v for code in self.ranges])
        self._coming = self._coming[:0]


FIRMWARE = (0x0506, 0x0000)
INPUT_REGISTERS = 40


class ModbusFault(Exception):
    """A request that the module answers with an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}")
        self.code = code


class ConverterModule:
    """Module `index` of the plant: registers and coils at a time t.

    `units` are those to which it responds, `unit` on a serial line. `multiple_writes`: whether it has function 16.

    For tests, not on the wire: `silent`, `reset`, and `refusals`, exception codes for the next requests.
    """

    model = adam.ADAM_6017

    def __init__(self, plant: Plant, index: int, unit: int = adam.UNIT) -> None:
        electronics = plant.model.electronics
        self.units = (unit,) if self.model.serial else electronics.tcp_units
        self.multiple_writes = electronics.multiple_writes
        self._sign_bit = adam.sign_bit(electronics.raw_format)
        self.silent = False
        self.refusals: deque[int] = deque()
        self.latency_s = electronics.latency_s
        self._settings_replies: dict[tuple[bytes, int, int, int], bytes] = {}
        self.inputs = Inputs(plant, index, self.model.power_on)
        self._plant = plant
        self._index = index
        self._outputs, self._gain = [False] * self.model.outputs, 0
        self._safety = 0
        self._writable = {*range(adam.DIGITAL_OUTPUT, adam.DIGITAL_OUTPUT + self.model.outputs)}
        if self.model.statistics:
            for first in (adam.RESET_MAXIMUM, adam.RESET_MINIMUM):
                self._writable |= {*range(first, first + adam.CHANNELS + 1)}

    @property
    def unit(self) -> int:
        """The first unit to which it responds; the only one on a serial line."""
        return self.units[0]

    def reset(self, t: float) -> None:
        """As after power-on: ranges, outputs and so the gain, enabled channels, maximum and minimum are forgotten."""
        self.inputs.reset(t)
        self._settings_replies.clear()
        self._safety = 0
        if self.model.outputs:
            self._switch([False] * self.model.outputs, t)

    def registers(self, address: int, count: int, t: float) -> list[int]:
        """Holding (and input) registers. Raises ModbusFault for an address without a register."""
        self._refuse()
        if address == adam.AI_VALUE and count <= adam.CHANNELS:
            counts = self.inputs.counts(t)[:count]
            return [raw ^ self._sign_bit for raw in counts] if self._sign_bit else counts
        wanted = range(address, address + count)
        held = self._measured(t) if address < adam.FLOAT_VALUE + INPUT_REGISTERS else {}
        held |= self._settings()
        if not all(at in held for at in wanted):
            raise ModbusFault(adam.ILLEGAL_ADDRESS)
        return [held[at] for at in wanted]

    def write_registers(self, address: int, values: list[int], t: float) -> None:
        """Raises ModbusFault for an address that cannot be written, or a value that means nothing; nothing is changed then."""
        self._refuse()
        places = list(enumerate(values, address))
        for at, value in places:
            if adam.RANGE_CODE <= at < adam.RANGE_CODE + adam.CHANNELS:
                if value not in self.model.ranges:
                    raise ModbusFault(adam.ILLEGAL_VALUE)
            elif at == adam.CHANNEL_ENABLE:
                if value > adam.ALL_CHANNELS:
                    raise ModbusFault(adam.ILLEGAL_VALUE)
            elif not (self.model.serial and at in (adam.COMM_SAFETY_ENABLE, adam.COMM_SAFETY_FLAG)):
                raise ModbusFault(adam.ILLEGAL_ADDRESS)
        self._settings_replies.clear()
        for at, value in places:
            if at == adam.CHANNEL_ENABLE:
                self.inputs.enabled = value
            elif at == adam.COMM_SAFETY_ENABLE:
                self._safety = value
            elif at != adam.COMM_SAFETY_FLAG:
                self.inputs.set_range(at - adam.RANGE_CODE, value, t)

    def coils(self, address: int, count: int, t: float) -> list[bool]:
        """Outputs and flags; a coil that is only written reads 0. Raises ModbusFault for an address without a coil."""
        self._refuse()
        wanted = range(address, address + count)
        held = dict(enumerate(self._outputs, adam.DIGITAL_OUTPUT))
        if not held.keys() >= set(wanted):
            held |= self._flags(t)
        if not all(at in held for at in wanted):
            raise ModbusFault(adam.ILLEGAL_ADDRESS)
        return [held[at] for at in wanted]

    def settings_reply(self, request: bytes) -> bytes | None:
        """The reply to a read of settings, if it was made before with the same settings."""
        if self.refusals:
            return None
        return self._settings_replies.get((request, self._gain, self.inputs.enabled, self.inputs.changes))

    def keep_reply(self, request: bytes, address: int, count: int, reply: bytes) -> None:
        """Keep the reply to a read, if that is of settings alone."""
        if request[0] >= 3:
            settings = address >= adam.RANGE_CODE
        else:
            settings = address >= adam.DIGITAL_OUTPUT and address + count <= adam.DIGITAL_OUTPUT + len(self._outputs)
        if settings:
            self._settings_replies[request, self._gain, self.inputs.enabled, self.inputs.changes] = reply

    def write_coils(self, address: int, values: list[bool], t: float) -> None:
        """Outputs (0 is the low bit of the gain's number), and the resets of maximum and minimum. Raises ModbusFault."""
        self._refuse()
        if address == adam.DIGITAL_OUTPUT and len(values) == len(self._outputs):
            self._switch(list(values), t)
            return
        places = list(enumerate(values, address))
        if not all(at in self._writable for at, _ in places):
            raise ModbusFault(adam.ILLEGAL_ADDRESS)
        outputs = list(self._outputs)
        for at, value in places:
            if at < adam.RESET_MAXIMUM:
                outputs[at - adam.DIGITAL_OUTPUT] = value
            elif value and at < adam.RESET_MINIMUM:
                self.inputs.forget_highest(at - adam.RESET_MAXIMUM, t)
            elif value:
                self.inputs.forget_lowest(at - adam.RESET_MINIMUM, t)
        if places[0][0] < adam.RESET_MAXIMUM:
            self._switch(outputs, t)

    def _switch(self, outputs: list[bool], t: float) -> None:
        self._outputs = outputs
        self._gain = sum([1 << bit for bit, on in enumerate(outputs) if on])
        highest = len(self._plant.model.electronics.gains_v_per_a) - 1
        self._plant.gain[self._index].set(t, min(self._gain, highest))

    def _refuse(self) -> None:
        if self.refusals:
            raise ModbusFault(self.refusals.popleft())

    def _measured(self, t: float) -> dict[int, int]:
        """The input registers by their addresses."""
        held = dict(enumerate((raw ^ self._sign_bit for raw in self.inputs.counts(t)), adam.AI_VALUE))
        if self.model.statistics:
            held[adam.AVERAGE] = self.inputs.average(t)
            held |= enumerate(self.inputs.highest(t), adam.MAXIMUM)
            held |= enumerate(self.inputs.lowest(t), adam.MINIMUM)
            words = [half for value in self.inputs.shown(t) for half in low_word_first(value)]
            held |= enumerate(words, adam.FLOAT_VALUE)
        return held

    def _settings(self) -> dict[int, int]:
        """The registers that do not measure, by their addresses."""
        held = dict(enumerate(self.inputs.ranges, adam.RANGE_CODE))
        held |= enumerate(self.model.name, adam.MODULE_NAME)
        held |= enumerate(FIRMWARE, adam.FIRMWARE_VERSION)
        held[adam.CHANNEL_ENABLE] = self.inputs.enabled
        if self.model.serial:
            held |= {adam.COMM_SAFETY_ENABLE: self._safety, adam.COMM_SAFETY_FLAG: 0}
        return held

    def _flags(self, t: float) -> dict[int, bool]:
        """The coils that are no outputs, by their addresses. No alarm limits can be set over Modbus, so no alarm is ever on."""
        held = dict(enumerate(self.inputs.broken(t), self.model.burn_out))
        if self.model.statistics:
            for first in (adam.RESET_MAXIMUM, adam.RESET_MINIMUM):
                held |= {first + channel: False for channel in range(adam.CHANNELS + 1)}
            for first in (adam.HIGH_ALARM, adam.LOW_ALARM):
                held |= {first + channel: False for channel in range(adam.CHANNELS)}
        return held


class Adam6017(ConverterModule):
    """Eight inputs, two outputs, Modbus TCP."""

    model = adam.ADAM_6017


class Adam4117(ConverterModule):
    """Eight inputs, Modbus RTU."""

    model = adam.ADAM_4117


def low_word_first(value: float) -> tuple[int, int]:
    """An IEEE 754 number in two registers."""
    high, low = struct.unpack(">HH", struct.pack(">f", value))
    return low, high
