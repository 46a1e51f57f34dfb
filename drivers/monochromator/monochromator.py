"""An Oriel Cornerstone 260: wavelength, grating, shutter, filter wheel, slits.

The unit answers only when it has arrived, so it is told and asked later. That it has arrived is told by handshake mode's
status or, where the unit refuses that mode, by the answer to an `STB?` that waits behind the move. Then it is asked where
it is, and only the place it was sent to counts. A relative STEP is sent once, whatever happens.

What ASCII without a checksum cannot show, and what limits the damage:
- a digit changed in an answer: a number that is not the expected one is asked for twice, and both must agree; one that
  is damaged into the expected one is lost on us, and it then is right;
- a statement changed on its way into another that is legal: the echo shows it where the line echoes, the question
  after each move (`WAVE?`, `SHUTTER?`, ...) everywhere;
- a status byte 20 or 32 changed into 00 (or the other way round): the question after the move, too;
- a line that comes twice, or late, for the next one: echo and number of lines show it; without echo and handshake
  mode it shows where it is of another kind than the answer expected, and after each timeout the line is drained and two
  markers are asked. In that poorest dialect a reset between two moves shows only by the question after the next one;
- a reset: handshake mode is off then, so the canary is read with each exchange (its status line is missing).
The filter wheel is asked where it is before it is turned, and left alone where it is there already.
To be confirmed on hardware: error 7 (already there), the statements of slits and labels, steps, the wheel's way round.
"""

import threading
from collections import deque
from collections.abc import Callable

from goniotwin.drivers.device import Pending
from goniotwin.drivers.errors import BadAnswer, DeviceError, Refused
from goniotwin.drivers.monochromator.line import CHECK_LINE, NAME, CornerstoneWire
from goniotwin.drivers.monochromator.settings import MonochromatorSettings
from goniotwin.drivers.monochromator.statement import ABORT, STATUS_MARGIN_S, Move
from goniotwin.drivers.motion.tmcl.module import PortOpener
from goniotwin.drivers.tap import Tap, no_tap
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.cornerstone import NO_ERROR, Grating, Statement, StatementError, decode_number, encode_nm

__all__ = ["STATUS_MARGIN_S", "Monochromator"]


class Monochromator:
    """The device on its serial line."""

    def __init__(self, open_port: PortOpener, settings: MonochromatorSettings, clock: Clock, tap: Tap = no_tap) -> None:
        self._wire = CornerstoneWire(open_port, settings.baudrate, clock, tap)
        self._clock = clock
        self._lock = threading.RLock()
        self._move: Move | None = None
        self._stops = 0
        self._believed: dict[str, str] = {}
        self.settings = settings

    @property
    def said(self) -> deque[str]:
        """What the driver did of its own accord (opened the port again, restored settings), newest last."""
        return self._wire.said

    def connect(self) -> str:
        """Opens the port, finds out about echo and handshake mode; returns who answers. Nothing moves. Raises DeviceError."""
        with self._lock:
            self._move = None
            self._believed.clear()
            identity = self._wire.open()
            self.wavelength_nm()
            return identity

    def close(self) -> None:
        """Gives the port back. Nothing is sent."""
        self._wire.close()

    # ---- questions ----

    def wavelength_nm(self) -> float:
        """Asks where the grating is. Raises DeviceError."""
        return self._number("WAVE", 0.0, 10_000.0)

    def shutter_is_open(self) -> bool:
        """Asks the shutter. Raises DeviceError."""
        answer = self._confirmed("SHUTTER", lambda text: text.upper() in ("O", "C"), "neither O nor C")
        return answer.upper() == "O"

    def filter(self) -> int:
        """Asks the filter wheel for its position; 0 where there is none. Raises DeviceError."""
        return round(self._number("FILTER", 0.0, 9.0))

    def grating(self) -> Grating:
        """Asks for the grating in the beam. Raises DeviceError."""
        answer = self._confirmed("GRAT", _is_grating, "no grating")
        return Grating.decode(answer.encode("ascii"))

    def slit_um(self, slit: int) -> float:
        """Asks for a slit's width, micrometres. Raises DeviceError."""
        return self._number(f"SLIT{slit}MICRONS", 0.0, 10_000.0)

    def step(self) -> int:
        """Asks for the position of the grating's motor, steps. Raises DeviceError."""
        return round(self._number("STEP", -1e9, 1e9))

    def check(self) -> None:
        """Asks whether it still has its settings: the canary. Raises Forgotten after a reset, DeviceError for no answer."""
        self._ask("UNITS")

    # ---- moves ----

    def start_wavelength(self, wavelength_nm: float) -> Pending:
        """Sends the grating to a wavelength. Raises DeviceError, before anything is sent where it is out of range."""
        lowest, highest = self.settings.lowest_nm, self.settings.highest_nm
        if not lowest <= wavelength_nm <= highest:
            raise DeviceError(
                NAME, f"go to {wavelength_nm:g} nm", f"outside {lowest:g} to {highest:g} nm", "change the schedule"
            )
        known = self._believed.get("WAVE")
        way = highest - lowest if known is None else wavelength_nm - float(known)
        target = encode_nm(wavelength_nm)

        def arrived() -> bool:
            return abs(self.wavelength_nm() - wavelength_nm) <= self.settings.tolerance_nm

        seconds = self.settings.slew_seconds(way)
        return self._start(Statement("GOWAVE", parameter=target), seconds, "WAVE", target, arrived)

    def start_shutter(self, *, opened: bool) -> Pending:
        """Opens or closes the shutter. Raises DeviceError."""
        letter = "O" if opened else "C"
        return self._start(
            Statement("SHUTTER", parameter=letter), self.settings.shutter_s, "SHUTTER", letter,
            lambda: self.shutter_is_open() is opened,
        )  # fmt: skip

    def start_filter(self, position: int) -> Pending:
        """Turns the filter wheel, unless it is there already. Raises DeviceError."""

        def seconds() -> float | None:
            here = self.filter()
            if here == 0:
                raise DeviceError(
                    NAME, f"turn the filter wheel to {position}", "it has none", "remove monochromator.filters of the rig file"
                )
            if here == position:
                return None
            self._believed.pop("FILTER", None)
            return abs(position - here) * self.settings.filter_s

        return self._start(
            Statement("FILTER", parameter=str(position)), 0.0, "FILTER", str(position), lambda: self.filter() == position,
            seconds,
        )  # fmt: skip

    def start_grating(self, number: int) -> Pending:
        """Turns the turret to a grating; the unit goes back to its wavelength. Raises DeviceError."""
        self._believed.pop("WAVE", None)
        return self._start(
            Statement("GRAT", parameter=str(number)), self.settings.grating_s, "GRAT", None,
            lambda: self.grating().number == number,
        )  # fmt: skip

    def start_slit(self, slit: int, width_um: float) -> Pending:
        """Sets the width of slit 1, 2 or 3, whole micrometres. Raises DeviceError."""
        word, width = f"SLIT{slit}MICRONS", str(round(width_um))
        known = self._believed.get(word)
        way = 3000.0 if known is None else abs(round(width_um) - float(known))
        return self._start(
            Statement(word, parameter=width), way / self.settings.slit_um_per_s, word, width,
            lambda: self.slit_um(slit) == round(width_um),
        )  # fmt: skip

    def start_step(self, steps: int) -> Pending:
        """Turns the grating by so many steps from where it is; never sent a second time. Raises DeviceError."""
        target = self.step() + steps
        self._believed.pop("WAVE", None)
        way = self.settings.highest_nm - self.settings.lowest_nm
        statement = Statement("STEP", parameter=str(steps))
        return self._start(statement, self.settings.slew_seconds(way), "STEP", str(target), lambda: self.step() == target)

    def abort(self) -> None:
        """Stops what moves, from any thread and in the middle of it. Where it stands then has to be asked."""
        move = self._move
        if move is not None:
            move.aborted = True
        self._believed.clear()
        self._wire.send_now(ABORT)

    def stop(self) -> None:
        """Aborts what moves, and what is just being started does not begin; from any thread. Raises DeviceError."""
        self._stops += 1
        if self.moving:
            self.abort()

    @property
    def moving(self) -> bool:
        """Whether something has been started of which nobody has heard the end."""
        return self._move is not None and not self._move.done

    def _start(
        self, statement: Statement, seconds: float, word: str, target: str | None, arrived: Callable[[], bool],
        ask_first: Callable[[], float | None] | None = None,
    ) -> Pending:  # fmt: skip
        with self._lock:
            before = self._move if self.moving else None
            if ask_first is None:
                self._believed.pop(word, None)

            def confirmed() -> bool:
                if target is not None:
                    self._believed[word] = target
                good = arrived()
                if not good:
                    self._believed.pop(word, None)
                return good

            text = str(statement)
            on_the_wire = self.settings.statement_seconds(text) + STATUS_MARGIN_S
            move = Move(
                self._wire, self._clock, statement, seconds, on_the_wire, confirmed, before, lambda: self._stops, ask_first
            )
            self._move = move
            return move

    # ---- exchanges ----

    def _ask(self, word: str) -> str:
        """One question and its answer; the status after it must say that all is well."""
        statement = Statement(word, query=True)
        with self._lock:
            move = self._move
            if move is not None and not move.done and move.silent:
                if not move.aborted:
                    raise DeviceError(NAME, str(statement), "it moves, and answers only when it has arrived", "wait for it")
                move.done = True
            answer, status = self._wire.exchange(statement)
            if status != NO_ERROR:
                raise Refused(NAME, str(statement), self._wire.last_error())
            try:
                return answer.decode("ascii").strip()
            except UnicodeDecodeError:
                self._wire.in_step = False
                raise BadAnswer(NAME, str(statement), f"not ASCII: {answer!r}", CHECK_LINE) from None

    def _confirmed(self, word: str, plausible: Callable[[str], bool], otherwise: str) -> str:
        """An answer that is what was expected, or that is given twice. Raises DeviceError."""
        answer = self._ask(word)
        if answer != self._believed.get(word):
            again = self._ask(word)
            if again == self._believed.get(word):
                answer = again
            elif again != answer:
                self._wire.in_step = False
                raise BadAnswer(NAME, f"{word}?", f"{answer!r} once and {again!r} then", CHECK_LINE)
        if not plausible(answer):
            self._wire.in_step = False
            raise BadAnswer(NAME, f"{word}?", f"{answer!r} is {otherwise}", CHECK_LINE)
        self._believed[word] = answer
        return answer

    def _number(self, word: str, lowest: float, highest: float) -> float:
        def plausible(text: str) -> bool:
            try:
                return lowest <= decode_number(text.encode("ascii")) <= highest
            except StatementError:
                return False

        return decode_number(self._confirmed(word, plausible, "no number that it can be").encode("ascii"))


def _is_grating(text: str) -> bool:
    try:
        Grating.decode(text.encode("ascii"))
    except StatementError:
        return False
    return True
