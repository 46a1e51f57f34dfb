"""The axis parameters of Trinamic's modules: value after power-on, range, and storage in EEPROM.

Numbers are PyTrinamic's maps of the TMCM-6214 and TMCM-1240. Defaults and ranges are those of the manuals where these state
them; of the chopper's and coolStep's parameters, which do nothing here but hold their value, they are assumptions.
"""

from dataclasses import dataclass

from goniotwin.protocols.tmcl_parameters import AxisParameter

MAX_VELOCITY_PPS = 7_999_774
MAX_ACCELERATION = 2_147_418_111
MAX_MICROSTEP_EXPONENT = 8
MAX = 2**31 - 1
MIN = -(2**31)


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter that holds a value: `lowest` to `highest`, `stored` where STAP keeps it."""

    value: int
    lowest: int
    highest: int
    stored: bool = True


COMPUTED = frozenset(
    {
        AxisParameter.TARGET_POSITION,
        AxisParameter.ACTUAL_POSITION,
        AxisParameter.ACTUAL_VELOCITY,
        AxisParameter.POSITION_REACHED,
        AxisParameter.HOME_SWITCH,
        AxisParameter.RIGHT_SWITCH,
        AxisParameter.LEFT_SWITCH,
        AxisParameter.SWITCH_DISTANCE,
        AxisParameter.LAST_REFERENCE_POSITION,
        AxisParameter.LOAD_VALUE,
        AxisParameter.ERROR_FLAGS,
        AxisParameter.DRIVER_FLAGS,
        AxisParameter.ENCODER_POSITION,
        29,  # measured speed
        180,  # coolStep's present current
        198,  # latched positions
        199,
    }
)
"""Parameters that are worked out when asked. Of these only the two positions and the encoder can be written."""

_FLAG = Parameter(0, 0, 1)
_MOTION: dict[int, Parameter] = {
    AxisParameter.TARGET_VELOCITY: Parameter(0, -MAX_VELOCITY_PPS, MAX_VELOCITY_PPS, stored=False),
    AxisParameter.MAX_VELOCITY: Parameter(51_200, 0, MAX_VELOCITY_PPS),
    AxisParameter.MAX_ACCELERATION: Parameter(51_200, 1, MAX_ACCELERATION),
    AxisParameter.MAX_DECELERATION: Parameter(51_200, 1, MAX_ACCELERATION),
    AxisParameter.RUN_CURRENT: Parameter(128, 0, 255),
    AxisParameter.STANDBY_CURRENT: Parameter(8, 0, 255),
    AxisParameter.RIGHT_SWITCH_DISABLED: Parameter(1, 0, 1),
    AxisParameter.LEFT_SWITCH_DISABLED: Parameter(1, 0, 1),
    AxisParameter.SWAP_SWITCHES: _FLAG,
    AxisParameter.RIGHT_SWITCH_POLARITY: _FLAG,
    AxisParameter.LEFT_SWITCH_POLARITY: _FLAG,
    AxisParameter.SOFT_STOP: _FLAG,
    AxisParameter.RELATIVE_REFERENCE: Parameter(0, 0, 2),
    AxisParameter.MICROSTEP_RESOLUTION: Parameter(8, 0, MAX_MICROSTEP_EXPONENT),
    AxisParameter.STALL_VELOCITY: Parameter(0, 0, MAX_VELOCITY_PPS),
    AxisParameter.REFERENCE_SEARCH_MODE: Parameter(1, 1, 8 + 64 + 128),
    AxisParameter.REFERENCE_SEARCH_SPEED: Parameter(51_200, 0, MAX_VELOCITY_PPS),
    AxisParameter.REFERENCE_SWITCH_SPEED: Parameter(5_120, 0, MAX_VELOCITY_PPS),
    AxisParameter.FREEWHEELING: Parameter(0, 0, 3),
    AxisParameter.MAX_ENCODER_DEVIATION: Parameter(0, 0, MAX),
    AxisParameter.POWER_DOWN_DELAY: Parameter(200, 1, 65_535),
    AxisParameter.REVERSE_SHAFT: _FLAG,
    AxisParameter.UNIT_MODE: Parameter(0, 0, 1),
}
_HELD = {
    number: Parameter(0, MIN, MAX)
    for number in (15, 16, 18, 19, 20, 21, 22, 23, 27, 28, 31, 32, 33, *range(162, 175), 182, 184, 185, *range(186, 193))
}

TMCM_6214: dict[int, Parameter] = (
    _MOTION
    | _HELD
    | {
        AxisParameter.ENCODER_RESOLUTION: Parameter(51_200, 1, MAX),
        202: Parameter(200, 1, 65_535),  # full steps a turn; nothing depends on it here
        **{number: Parameter(0, MIN, MAX) for number in (40, 41, 42, 43, 177, 179, 201, 213, 240)},
    }
)
TMCM_1240: dict[int, Parameter] = (
    _MOTION
    | _HELD
    | {
        AxisParameter.ENCODER_RESOLUTION: _FLAG,  # "clear on null" there
        202: Parameter(200, 1, 65_535),
        254: Parameter(0, 0, 5),
        **{number: Parameter(0, MIN, MAX) for number in (160, 161, 178, 215, 216, 217, 218)},
    }
)
