"""A mean of the monitor: readings one after the other, and what makes sure that they are what was asked for."""

import math
from collections.abc import Callable

from goniotwin.drivers.errors import BadAnswer, DeviceError
from goniotwin.drivers.usb.usbtmc import UsbTmc
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.scpi import ScpiError, decode_number, overloaded

NAME = "monitor"
ANSWER_MARGIN_S = 2.0e-3


class MonitorMean:
    """A mean under way, of one or more readings; `current_a` (or `power_w`) when it is done.

    In the end the instrument is asked for its canary (`check`): what it read after a reset is not what was asked for.
    """

    def __init__(
        self,
        wire: UsbTmc,
        clock: Clock,
        question: str,
        pieces: int,
        seconds: float,
        limit: float | None,
        check: Callable[[], None],
    ) -> None:
        self._wire = wire
        self._clock = clock
        self._question = question
        self._left = pieces
        self._seconds = seconds
        self._limit = limit
        self._check = check
        self._values: list[float] = []
        self._begin()

    @property
    def current_a(self) -> float:
        """The mean current, A."""
        return math.fsum(self._values) / len(self._values)

    power_w = current_a
    """The mean power, W, where power was asked for."""

    def poll(self) -> bool:
        """Fetches the reading that is due and starts the next one; in the end asks for the canary. Raises DeviceError."""
        if not self._left:
            self._check()
            return True
        answer = self._wire.read(self._question)
        try:
            value = decode_number(answer)
        except ScpiError as error:
            self._wire.in_step = False
            raise BadAnswer(NAME, self._question, str(error), "measure again") from None
        if overloaded(value):
            raise DeviceError(NAME, self._question, "the current is over the range", "set a wider range in the rig file")
        if self._limit is not None and abs(value) > self._limit:
            self._wire.in_step = False
            raise BadAnswer(NAME, self._question, f"{value:g} is beyond the range", "measure again")
        self._values.append(value)
        self._left -= 1
        if self._left:
            self._begin()
        else:
            self.due = self._clock.now()
        return False

    def _begin(self) -> None:
        self._wire.write(self._question, answered=True)
        self.due = self._clock.now() + self._seconds + ANSWER_MARGIN_S
