"""The eight inputs of a converter module: ranges, counts, what a change of range loses, the highest and the lowest yet."""

import math

import numpy as np

from goniotwin.protocols import adam
from goniotwin.twin.plant import Plant

LOOK_BACK = 64
"""So many conversions before a question about maximum or minimum are looked at; older ones count if they were read."""


class Inputs:
    """The inputs of module `index` of the plant, at a time t."""

    def __init__(self, plant: Plant, index: int) -> None:
        self._plant = plant
        self._index = index
        self._period = plant.conversion_period_s
        self.reset(0.0)

    def reset(self, t: float) -> None:
        """As after power-on: all inputs enabled, +-10 V, no maximum and no minimum yet."""
        self.ranges = [adam.PLUS_MINUS_10_V] * adam.CHANNELS
        self.enabled = adam.ALL_CHANNELS
        self._held: dict[int, tuple[int, int]] = {}
        self._scale()
        self._seen_until = self._conversion(adam.CHANNELS - 1, t)
        self._highest = np.full(adam.CHANNELS + 1, -1)
        self._lowest = np.full(adam.CHANNELS + 1, adam.FULL_SCALE + 1)

    def counts(self, t: float) -> list[int]:
        """The raw values of all channels; 0 for one that is not enabled. The same until the next conversion."""
        steps = np.rint((self._plant.volts(self._index, t) - self._lows) / self._steps)
        raw: list[int] = np.minimum(np.maximum(steps, 0.0), adam.FULL_SCALE).astype(np.int64).tolist()
        for channel, (value, until) in list(self._held.items()):
            if self._conversion(channel, t) < until:
                raw[channel] = value
            else:
                del self._held[channel]
        if self.enabled != adam.ALL_CHANNELS:
            raw = [value if self.enabled >> channel & 1 else 0 for channel, value in enumerate(raw)]
        return raw

    def average(self, t: float) -> int:
        """The mean raw value of the enabled channels, 0 where there is none."""
        return self._mean(self.counts(t))

    def set_range(self, channel: int, code: int, t: float) -> None:
        """Another range loses the next reading: the register keeps what it has until the one after it is finished."""
        if code == self.ranges[channel]:
            return
        held = self.counts(t)[channel]
        self.ranges[channel] = code
        self._held[channel] = (held, self._conversion(channel, t) + 2)
        self._seen_until = self._conversion(adam.CHANNELS - 1, t)
        self._scale()

    def shown(self, t: float) -> list[float]:
        """What the float registers say: eight channels and the average (that of the raw values, in channel 0's range)."""
        counts = self.counts(t)
        values = [adam.RANGES[code].shown(raw) for code, raw in zip(self.ranges, counts, strict=True)]
        return [*values, adam.RANGES[self.ranges[0]].shown(self._mean(counts))]

    def broken(self, t: float) -> list[bool]:
        """Of each channel: a 4-20 mA input with less than 4 mA is taken for a broken wire."""
        four_to_twenty = adam.RANGES[adam.FOUR_TO_TWENTY_MA]
        volts = self._plant.volts(self._index, t)
        below = [bool(volt < four_to_twenty.low_v) for volt in volts]
        return [code == four_to_twenty.code and low for code, low in zip(self.ranges, below, strict=True)]

    def highest(self, t: float) -> list[int]:
        """The highest raw values since the last reset, of the channels and of the average."""
        self._look(t)
        return [int(value) for value in self._highest]

    def lowest(self, t: float) -> list[int]:
        """The lowest raw values since the last reset, of the channels and of the average."""
        self._look(t)
        return [int(value) for value in self._lowest]

    def forget_highest(self, channel: int, t: float) -> None:
        """The maximum of a channel (8: of the average) begins anew."""
        self._look(t)
        self._highest[channel] = -1

    def forget_lowest(self, channel: int, t: float) -> None:
        """The minimum of a channel (8: of the average) begins anew."""
        self._look(t)
        self._lowest[channel] = adam.FULL_SCALE + 1

    def _look(self, t: float) -> None:
        """Lets maximum and minimum see the conversions since they were last looked at, `LOOK_BACK` at most, and now."""
        last = self._conversion(adam.CHANNELS - 1, t)
        held = dict(self._held)
        for conversion in range(max(self._seen_until + 1, last - LOOK_BACK), last):
            self._see((conversion + 2.0) * self._period)
            self._held = dict(held)
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
        return math.floor(t / self._period + 1e-9 - (channel + 1) / adam.CHANNELS)

    def _scale(self) -> None:
        self._lows = np.array([adam.RANGES[code].low_v for code in self.ranges])
        self._steps = np.array([adam.RANGES[code].lsb_v for code in self.ranges])
