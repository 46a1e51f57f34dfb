"""The global parameters of a motion module: its settings, the user's variables, what EEPROM keeps of them."""

from typing import NamedTuple

import numpy as np

from goniotwin.protocols.tmcl import Command, ReplyStatus
from goniotwin.protocols.tmcl_parameters import USER_BANK, GlobalParameter
from goniotwin.twin import plant
from goniotwin.twin.devices.ramp_generator import CommandRejected
from goniotwin.twin.plant.process_key import process_key

USER_VARIABLES, USER_STORED = 256, 56
LOCK, UNLOCK = 1234, 4321
STOPPED, RUNNING, RESET = 0, 1, 3
TIMERS_AND_INTERRUPTS = (0, 1, 2, *range(27, 47))

# Bank 0: number -> (value, lowest, highest). Ranges of what only CAN and programs use are assumptions.
BANK_0: dict[int, tuple[int, int, int]] = {
    GlobalParameter.BAUD_RATE: (0, 0, 11),
    GlobalParameter.ADDRESS: (1, 1, 255),
    GlobalParameter.HEARTBEAT: (0, 0, 65_535),
    69: (8, 0, 8),
    70: (2, 0, 0x7FF),
    71: (1, 0, 0x7FF),
    GlobalParameter.EEPROM_LOCK: (0, 0, 0x7FFF_FFFF),
    GlobalParameter.TELEGRAM_PAUSE: (0, 0, 255),
    GlobalParameter.HOST_ADDRESS: (2, 0, 255),
    GlobalParameter.AUTOSTART: (0, 0, 1),
    GlobalParameter.PROTECTION: (0, 0, 3),
    82: (0, 0, 65_535),
    83: (0, 0, 0x7FF),
    GlobalParameter.COORDINATES_IN_EEPROM: (0, 0, 1),
    85: (0, 0, 1),
    86: (0, 0, 255),
    87: (0, 0, 255),
    GlobalParameter.SUPPRESS_REPLY: (0, 0, 1),
}

REPLY_SETTINGS = (
    GlobalParameter.HOST_ADDRESS,
    GlobalParameter.ADDRESS,
    GlobalParameter.SUPPRESS_REPLY,
    GlobalParameter.TELEGRAM_PAUSE,
    GlobalParameter.HEARTBEAT,
)


class ReplySettings(NamedTuple):
    """What decides on each reply: addresses, whether there is one, the pause before it (ms), and the heartbeat (ms)."""

    host: int
    address: int
    suppressed: int
    pause_ms: int
    heartbeat_ms: int


class Globals:
    """Bank 0 has the module's settings, bank 2 the user's variables, bank 3 timers and interrupts; bank 1 is empty.

    `reply` is what decides on each reply.
    """

    def __init__(self, factory: dict[int, int]) -> None:
        self._factory = {(0, number): value for number, (value, _, _) in BANK_0.items()}
        self._factory |= {(0, int(number)): value for number, value in factory.items()}
        self._eeprom: dict[tuple[int, int], int] = {}
        self._key = process_key(0, "TMCL random number")
        self.reset(0.0)

    def reset(self, t: float) -> None:
        """Power-on: what EEPROM keeps, else what the module came with."""
        self._values = self._factory | self._eeprom
        self._changed()
        self._status = STOPPED
        self._ticks_from = t

    def _changed(self) -> None:
        values = self._values
        self.reply = ReplySettings(*(values[0, number] for number in REPLY_SETTINGS))

    @property
    def locked(self) -> bool:
        """Whether EEPROM may not be written."""
        return self._values[0, GlobalParameter.EEPROM_LOCK] == 1

    def run(self, command: int) -> None:
        """What was done to the stand-alone program."""
        states = {Command.RUN_APPLICATION: RUNNING, Command.STOP_APPLICATION: STOPPED, Command.RESET_APPLICATION: RESET}
        self._status = states[Command(command)]

    def get(self, bank: int, number: int, t: float) -> int:
        """GGP. Raises CommandRejected."""
        held = self._values.get((bank, number))
        if held is not None:
            return held
        if bank == 0:
            match number:
                case GlobalParameter.APPLICATION_STATUS:
                    return self._status
                case GlobalParameter.DOWNLOAD_MODE | GlobalParameter.PROGRAM_COUNTER:
                    return 0
                case GlobalParameter.TICK_TIMER:
                    return round((t - self._ticks_from) * 1000.0) & 0x7FFF_FFFF
                case GlobalParameter.RANDOM_NUMBER:
                    return int(plant.mix(self._key, np.int64(int(t * 1.0e6)))) & 0x7FFF_FFFF
        self._check(bank, number)
        return 0

    def set(self, bank: int, number: int, value: int, t: float) -> None:
        """SGP. Raises CommandRejected."""
        if (bank, number) == (0, GlobalParameter.TICK_TIMER):
            self._ticks_from = t - value / 1000.0
            return
        self._check(bank, number)
        if bank == 0:
            if number == GlobalParameter.EEPROM_LOCK:
                if value not in (LOCK, UNLOCK):
                    raise CommandRejected(ReplyStatus.INVALID_VALUE)
                value = int(value == LOCK)
            elif self.locked and number < GlobalParameter.APPLICATION_STATUS:
                raise CommandRejected(ReplyStatus.EEPROM_LOCKED)
            _, lowest, highest = BANK_0[number]
            if not lowest <= value <= highest:
                raise CommandRejected(ReplyStatus.INVALID_VALUE)
        self._values[bank, number] = value
        self._changed()
        if bank == 0 and number < GlobalParameter.APPLICATION_STATUS:
            self._eeprom[bank, number] = value

    def store(self, bank: int, number: int, *, restore: bool) -> None:
        """STGP and RSGP. Raises CommandRejected for what EEPROM does not keep."""
        self._check(bank, number)
        if bank == 3 or (bank == USER_BANK and number >= USER_STORED):
            raise CommandRejected(ReplyStatus.WRONG_TYPE)
        if restore:
            self._values[bank, number] = self._eeprom.get((bank, number), self._factory.get((bank, number), 0))
            self._changed()
        elif self.locked:
            raise CommandRejected(ReplyStatus.EEPROM_LOCKED)
        else:
            self._eeprom[bank, number] = self._values.get((bank, number), 0)

    def _check(self, bank: int, number: int) -> None:
        if bank not in (0, 1, USER_BANK, 3):
            raise CommandRejected(ReplyStatus.INVALID_VALUE)
        known = {0: number in BANK_0, USER_BANK: number < USER_VARIABLES, 3: number in TIMERS_AND_INTERRUPTS}
        if not known.get(bank, False):
            raise CommandRejected(ReplyStatus.WRONG_TYPE)
