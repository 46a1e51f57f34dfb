"""Register map and scaling of the Advantech ADAM-6017 (eight analogue inputs, two digital outputs; Modbus TCP).

Addresses are those of the PDU (4X reference less 40001, 0X reference less 1). Framing and PDUs are pymodbus's.
Source: Advantech, "ADAM-6000 Series User Manual", appendix B. To be confirmed on hardware: the word order of floats and
the average's registers, which nothing here uses.
"""

from dataclasses import dataclass

CHANNELS = 8
UNIT = 1
FULL_SCALE = 65535

AI_VALUE = 0
RANGE_CODE = 200
MODULE_NAME = 210
FIRMWARE_VERSION = 212
CHANNEL_ENABLE = 220

DIGITAL_OUTPUT = 16
DIGITAL_OUTPUTS = 2

NAME_6017 = (0x6017, 0x0000)


@dataclass(frozen=True, slots=True)
class Range:
    """An input range: raw 0 is `low_v`, raw 65535 is `high_v`."""

    code: int
    low_v: float
    high_v: float

    @property
    def lsb_v(self) -> float:
        """The step of the converter, V."""
        return (self.high_v - self.low_v) / FULL_SCALE

    def volts(self, raw: float) -> float:
        """The voltage of a raw value (or of a mean of raw values)."""
        return self.low_v + raw * self.lsb_v

    def raw(self, volts: float) -> int:
        """The raw value that the converter gives for a voltage: rounded, and clipped at the ends."""
        return round(min(max((volts - self.low_v) / self.lsb_v, 0.0), float(FULL_SCALE)))


RANGES = {
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
    )
}
PLUS_MINUS_10_V = 0x0143


def clipped(raw: int) -> bool:
    """Whether the converter stands at an end of its range: the value is then a bound, not a reading."""
    return raw <= 0 or raw >= FULL_SCALE
