"""The numbers of TMCL: axis parameters, global parameters, flags, reference searches.

Source: PyTrinamic's maps of the TMCM-6214 and TMCM-1240; meanings from the manuals of TMCM-142, TMCM-1021 and TMCM-6214.
Those marked (*) are to be confirmed on hardware.
"""

from enum import IntEnum, IntFlag


class AxisParameter(IntEnum):
    """Axis parameters (AP). Positions in microsteps, velocities in pps, accelerations in pps/s."""

    TARGET_POSITION = 0
    ACTUAL_POSITION = 1
    TARGET_VELOCITY = 2
    ACTUAL_VELOCITY = 3
    MAX_VELOCITY = 4
    MAX_ACCELERATION = 5
    RUN_CURRENT = 6
    STANDBY_CURRENT = 7
    POSITION_REACHED = 8
    HOME_SWITCH = 9
    RIGHT_SWITCH = 10
    LEFT_SWITCH = 11
    RIGHT_SWITCH_DISABLED = 12
    LEFT_SWITCH_DISABLED = 13
    SWAP_SWITCHES = 14
    MAX_DECELERATION = 17
    RIGHT_SWITCH_POLARITY = 24
    LEFT_SWITCH_POLARITY = 25
    SOFT_STOP = 26
    RELATIVE_REFERENCE = 127  # (*) for 2
    MICROSTEP_RESOLUTION = 140
    STALL_VELOCITY = 181  # (*) stop on stall above this velocity; 0 is off
    REFERENCE_SEARCH_MODE = 193
    REFERENCE_SEARCH_SPEED = 194
    REFERENCE_SWITCH_SPEED = 195
    SWITCH_DISTANCE = 196
    LAST_REFERENCE_POSITION = 197
    FREEWHEELING = 204
    LOAD_VALUE = 206  # (*) 0 at a stall
    ERROR_FLAGS = 207
    DRIVER_FLAGS = 208  # (*)
    ENCODER_POSITION = 209
    ENCODER_RESOLUTION = 210  # (*) counts a motor turn; on the TMCM-1240 PyTrinamic has "clear on null" here
    MAX_ENCODER_DEVIATION = 212
    POWER_DOWN_DELAY = 214
    REVERSE_SHAFT = 251
    UNIT_MODE = 255


class GlobalParameter(IntEnum):
    """Global parameters of bank 0."""

    EEPROM_LOCK = 73  # (*) 1234 locks, 4321 unlocks
    BAUD_RATE = 65
    ADDRESS = 66
    HEARTBEAT = 68
    TELEGRAM_PAUSE = 75
    HOST_ADDRESS = 76
    AUTOSTART = 77
    PROTECTION = 81
    COORDINATES_IN_EEPROM = 84
    APPLICATION_STATUS = 128
    DOWNLOAD_MODE = 129
    PROGRAM_COUNTER = 130
    TICK_TIMER = 132
    RANDOM_NUMBER = 133
    SUPPRESS_REPLY = 255


USER_BANK = 2
"""The bank of the user's variables 0 to 255, of which those from 56 on are lost with the power (*)."""

BAUD_RATES = (9600, 14400, 19200, 28800, 38400, 57600, 76800, 115200)
"""By the value of global parameter 65 (*)."""


class ErrorFlag(IntFlag):
    """Axis parameter 207."""

    STALL = 1
    DEVIATION = 2


class DriverFlag(IntFlag):
    """Axis parameter 208 (*)."""

    STALL = 1
    OVERTEMPERATURE = 2
    OVERTEMPERATURE_WARNING = 4
    SHORT_A = 8
    SHORT_B = 16
    OPEN_A = 32
    OPEN_B = 64
    STANDSTILL = 128


class SearchCommand(IntEnum):
    """The types of RFS."""

    START = 0
    STOP = 1
    STATUS = 2


class SearchMode(IntEnum):
    """Axis parameter 193. `SWAPPED` and `INVERTED` are added to it."""

    LEFT = 1
    RIGHT_THEN_LEFT = 2
    RIGHT_THEN_LEFT_BOTH_SIDES = 3
    LEFT_BOTH_SIDES = 4
    HOME_NEGATIVE = 5
    HOME_POSITIVE = 6
    HOME_POSITIVE_NO_STOPS = 7  # (*) some revisions of the manual exchange 7 and 8
    HOME_NEGATIVE_NO_STOPS = 8


SWAPPED, INVERTED = 64, 128
