"""An Advantech ADAM-6017: eight converters behind registers, two digital outputs that choose the amplifiers' gain."""

import numpy as np

from protocols import adam
from twin.plant import Plant

ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3


class ModbusFault(Exception):
    """A request that the module answers with an exception code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"Modbus exception {code}")
        self.code = code


class Adam6017:
    """Module `index` of the plant: registers and coils at a time t."""

    unit = adam.UNIT

    def __init__(self, plant: Plant, index: int) -> None:
        self._plant = plant
        self._index = index
        self.latency_s = plant.model.electronics.latency_s
        self._ranges = [adam.PLUS_MINUS_10_V] * adam.CHANNELS
        self._outputs = [False] * adam.DIGITAL_OUTPUTS
        self._enabled = 0xFF

    def registers(self, address: int, count: int, t: float) -> list[int]:
        """Holding (and input) registers. Raises ModbusFault for an address without a register."""
        if address == adam.AI_VALUE and count <= adam.CHANNELS:
            return self._counts(t)[:count]
        return [self._register(at, t) for at in range(address, address + count)]

    def write_registers(self, address: int, values: list[int], t: float) -> None:
        """Raises ModbusFault for an address that cannot be written, or a range code that does not exist."""
        del t
        for at, value in enumerate(values, address):
            if adam.RANGE_CODE <= at < adam.RANGE_CODE + adam.CHANNELS:
                if value not in adam.RANGES:
                    raise ModbusFault(ILLEGAL_VALUE)
                self._ranges[at - adam.RANGE_CODE] = value
            elif at == adam.CHANNEL_ENABLE:
                self._enabled = value & 0xFF
            else:
                raise ModbusFault(ILLEGAL_ADDRESS)

    def coils(self, address: int, count: int) -> list[bool]:
        """The digital outputs. Raises ModbusFault for an address without a coil."""
        first = address - adam.DIGITAL_OUTPUT
        if first < 0 or first + count > adam.DIGITAL_OUTPUTS:
            raise ModbusFault(ILLEGAL_ADDRESS)
        return self._outputs[first : first + count]

    def write_coils(self, address: int, values: list[bool], t: float) -> None:
        """Sets digital outputs: output 0 is the low bit of the gain's number. Raises ModbusFault."""
        self.coils(address, len(values))
        first = address - adam.DIGITAL_OUTPUT
        self._outputs[first : first + len(values)] = values
        gain = sum(1 << bit for bit, on in enumerate(self._outputs) if on)
        highest = len(self._plant.model.electronics.gains_v_per_a) - 1
        self._plant.gain[self._index].set(t, min(gain, highest))

    def _register(self, address: int, t: float) -> int:
        if adam.AI_VALUE <= address < adam.AI_VALUE + adam.CHANNELS:
            return self._counts(t)[address]
        if adam.RANGE_CODE <= address < adam.RANGE_CODE + adam.CHANNELS:
            return self._ranges[address - adam.RANGE_CODE]
        named = {
            adam.MODULE_NAME: adam.NAME_6017[0],
            adam.MODULE_NAME + 1: adam.NAME_6017[1],
            adam.FIRMWARE_VERSION: 0x0506,
            adam.FIRMWARE_VERSION + 1: 0x0000,
            adam.CHANNEL_ENABLE: self._enabled,
        }
        if address not in named:
            raise ModbusFault(ILLEGAL_ADDRESS)
        return named[address]

    def _counts(self, t: float) -> list[int]:
        volts = self._plant.volts(self._index, t)
        lows = np.array([adam.RANGES[code].low_v for code in self._ranges])
        steps = np.array([adam.RANGES[code].lsb_v for code in self._ranges])
        counts = np.clip(np.rint((volts - lows) / steps), 0, adam.FULL_SCALE).astype(int)
        return [int(count) if self._enabled >> c & 1 else 0 for c, count in enumerate(counts)]
