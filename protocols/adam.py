"""Register map and scaling of Advantech's eight-channel converters: ADAM-6017 (Modbus TCP) and ADAM-4117 (Modbus RTU).

Addresses are those of the PDU (4X reference less 40001, 0X reference less 1). Framing and PDUs are pymodbus's.
Source: Advantech, "ADAM-6000 Series User Manual", appendix B, and "ADAM-4100 Series User's Manual", appendix B.

The two series have the same registers, but not the same codes of their input ranges. Which fact is proven and which is
assumed: docs/rig/interoperability.md.
"""

from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from goniotwin.arrays import Counts, Flags, Floats, Ints

CHANNELS = 8
UNIT = 1
LAST_UNIT = 247
"""On a serial line."""
LAST_TCP_UNIT = 255
TCP_UNITS = (UNIT, 0, LAST_TCP_UNIT)
"""Units of a module over TCP: its own, and the two that clients send to a server that needs no unit."""
FULL_SCALE = 65535
BAUDRATE = 9600
MBAP = 7
"""Bytes of the header of a Modbus TCP frame, the unit included."""
RTU_EXCHANGE_S = 0.04
"""Reading eight registers at 9600 baud: 8 and 21 characters of ten bits, two gaps, and the module's thinking."""

AI_VALUE = 0
AVERAGE = 8
MAXIMUM = 10
MINIMUM = 20
FLOAT_VALUE = 30
RANGE_CODE = 200
MODULE_NAME = 210
FIRMWARE_VERSION = 212
COMM_SAFETY_ENABLE = 214
COMM_SAFETY_FLAG = 215
CHANNEL_ENABLE = 220
ALL_CHANNELS = 0x00FF

DIGITAL_OUTPUT = 16
DIGITAL_OUTPUTS = 2
RESET_MAXIMUM = 100
RESET_MINIMUM = 110
HIGH_ALARM = 130
LOW_ALARM = 140

ILLEGAL_FUNCTION = 1
ILLEGAL_ADDRESS = 2
ILLEGAL_VALUE = 3
DEVICE_FAILURE = 4
BUSY = 6

SHUNT_OHM = 120.0


Value = TypeVar("Value", float, Floats)


def quantise(volts: Floats | float, low_v: Floats | float, lsb_v: Floats | float) -> Ints:
    """The raw values of voltages with a converter's step `lsb_v` from `low_v`: rounded, and clipped at the ends."""
    return np.minimum(np.maximum(np.rint((volts - low_v) / lsb_v), 0.0), FULL_SCALE).astype(np.int64)


@dataclass(frozen=True, slots=True)
class Range:
    """An input range: raw 0 is `low_v`, raw 65535 is `high_v`.

    A current range measures the voltage over `SHUNT_OHM`; its limits are given as that voltage.
    """

    code: int
    low_v: float
    high_v: float
    current: bool = False

    @property
    def lsb_v(self) -> float:
        """The step of the converter, V."""
        return (self.high_v - self.low_v) / FULL_SCALE

    def volts(self, raw: Value) -> Value:
        """The voltages of raw values (or of means of raw values)."""
        return self.low_v + raw * self.lsb_v

    @property
    def zero(self) -> float:
        """The raw value of 0 V."""
        return -self.low_v / self.lsb_v

    def raw(self, volts: Floats | float) -> Ints:
        """The raw values that the converter gives for voltages."""
        return quantise(volts, self.low_v, self.lsb_v)

    @property
    def highest(self) -> int:
        """The highest raw value."""
        return FULL_SCALE

    def saturated(self, counts: Counts) -> Flags:
        """Raw counts at an end of the converter's range, shape of `counts`: they are bounds, not readings."""
        return np.asarray((counts == 0) | (counts == FULL_SCALE))

    def shown(self, raw: float) -> float:
        """The number in the float registers: V, mV in the ranges below 1 V, mA in those of currents."""
        volts = self.volts(raw)
        if self.current:
            return 1e3 * volts / SHUNT_OHM
        return volts if self.high_v >= 1.0 else 1e3 * volts

    def equals(self, other: "Range") -> bool:
        """Whether it is the same range, by whatever code."""
        return (self.low_v, self.high_v, self.current) == (other.low_v, other.high_v, other.current)


def _current(code: int, low_ma: float, high_ma: float) -> Range:
    return Range(code, 1e-3 * low_ma * SHUNT_OHM, 1e-3 * high_ma * SHUNT_OHM, current=True)


SERIES_6000 = {
    each.code: each
    for each in (
        Range(0x0103, -0.15, 0.15),
        Range(0x0104, -0.5, 0.5),
        Range(0x0105, 0.0, 0.15),
        Range(0x0106, 0.0, 0.5),
        Range(0x0140, -1.0, 1.0),
        Range(0x0142, -5.0, 5.0),
        Range(0x0143, -10.0, 10.0),
        Range(0x0145, 0.0, 1.0),
        Range(0x0147, 0.0, 5.0),
        Range(0x0148, 0.0, 10.0),
        _current(0x0180, 4.0, 20.0),
        _current(0x0181, -20.0, 20.0),
        _current(0x0182, 0.0, 20.0),
    )
}
"""Input ranges of the ADAM-6000 series by their codes."""
SERIES_4100 = {
    each.code: each
    for each in (
        _current(0x07, 4.0, 20.0),
        Range(0x08, -10.0, 10.0),
        Range(0x09, -5.0, 5.0),
        Range(0x0A, -1.0, 1.0),
        Range(0x0B, -0.5, 0.5),
        Range(0x0C, -0.15, 0.15),
        _current(0x0D, -20.0, 20.0),
        Range(0x15, -15.0, 15.0),
        Range(0x48, 0.0, 10.0),
        Range(0x49, 0.0, 5.0),
        Range(0x4A, 0.0, 1.0),
        Range(0x4B, 0.0, 0.5),
        Range(0x4C, 0.0, 0.15),
        _current(0x4D, 0.0, 20.0),
        Range(0x55, 0.0, 15.0),
    )
}
"""Input ranges of the ADAM-4100 series by their codes, which are those of the ASCII commands."""
RANGES = SERIES_6000 | SERIES_4100
PLUS_MINUS_10_V = 0x0143

RawFormat = Literal["unsigned", "twos-complement"]
"""How a register has a raw value: 0 to 65535 over the range, or -32768 to 32767 over it."""
SIGN_BIT = 0x8000


def sign_bit(raw_format: RawFormat) -> int:
    """The bit by which a register differs from the raw value in a format."""
    return SIGN_BIT if raw_format == "twos-complement" else 0


def code_text(code: int) -> str:
    """A code as the manuals write it: 0x0143, 0x08."""
    return f"0x{code:0{4 if code > 0xFF else 2}X}"


@dataclass(frozen=True)
class Model:
    """A kind of module: its name, the text in which it reports it, its ranges, its digital outputs, its wire.

    `ranges` are the codes of its input ranges, and `power_on` is the one that it has at first. `burn_out` is the address of the
    first of eight coils that show broken wires. `statistics`: whether it has registers of average, maximum, minimum and
    floats, and the coils that go with them.
    """

    title: str
    name: tuple[int, int]
    ranges: frozenset[int]
    power_on: int
    outputs: int
    burn_out: int
    serial: bool
    statistics: bool

    def range(self, code: int) -> Range | None:
        """Its input range of a code of either series: rig files of an ADAM-4117 may have those of the 6000 series."""
        named = RANGES.get(code)
        return next((RANGES[own] for own in self.ranges if named is not None and RANGES[own].equals(named)), None)

    def check_raw_format(self, raw_format: RawFormat) -> None:
        """Raise ValueError for a format that its registers cannot have."""
        if raw_format != "unsigned" and not self.serial:
            raise ValueError(f"raw_format: the registers of an {self.title} are unsigned; remove raw_format")


ADAM_6017 = Model(
    "ADAM-6017", (0x6017, 0x0000), frozenset(SERIES_6000), PLUS_MINUS_10_V, DIGITAL_OUTPUTS, 120, serial=False, statistics=True
)
ADAM_4117 = Model("ADAM-4117", (0x4117, 0x0000), frozenset(SERIES_4100), 0x08, 0, 0, serial=True, statistics=False)
ModelName = Literal["adam-6017", "adam-4117"]
MODELS: dict[ModelName, Model] = {"adam-6017": ADAM_6017, "adam-4117": ADAM_4117}


def firmware(words: list[int]) -> str:
    """A firmware version as people write it: 0x0506 is 5.06."""
    return f"{words[0] >> 8:x}.{words[0] & 0xFF:02x}"
