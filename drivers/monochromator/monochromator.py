"""An Oriel Cornerstone 260: wavelength, grating, shutter, filter wheel, slits.

The unit replies only when it has arrived, so a motion is started and polled. Its end is shown by the status of handshake
mode or, if the unit does not support that mode, by the reply to an `STB?` queued behind the motion. Then the unit is queried
for its position, and only the target counts. A relative STEP is never sent twice.

Undetectable in ASCII without a checksum, and limits of the damage:
- a digit changed in a reply: an unexpected number is queried twice, and both replies must agree; a corruption that yields
  the expected value is undetectable, and harmless;
- a statement changed into another legal one: the echo shows it if the line echoes, the query after each motion (`WAVE?`,
  `SHUTTER?`, ...) always;
- a status byte 20 or 32 changed into 00, or the reverse: the query after the motion, too;
- a line that is repeated or late: echo and number of lines show it. Without echo and handshake mode it shows if it is of
  another kind than the expected reply, and after each timeout the line is drained and two markers are queried. In this case
  a reset between two motions shows only by the query after the next one;
- a reset: handshake mode is then off, so that the canary is read with each exchange (its status line is missing).
The filter wheel is queried before it is turned, and not turned if it is at its target already.
`identify` sends `INFO?` alone. `close` restores handshake mode and units as they were found.
To be confirmed on hardware: error 7 (already there), the statements of slits and labels, steps, the wheel's direction.
"""

import contextlib
import re
import threading
from collections import deque
from collections.abc import Callable

from goniotwin.drivers.device import Pending, PortOpener
from goniotwin.drivers.errors import BadAnswer, DeviceError
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.guard import CLOSE_SHUTTER, Guard, LastWill, NoGuard
from goniotwin.drivers.monochromator.line import CHECK_LINE, LINE_END, NAME, CornerstoneLine
from goniotwin.drivers.monochromator.settings import MonochromatorSettings
from goniotwin.drivers.monochromator.statement import ABORT, PendingStatement
from goniotwin.drivers.tap import Tap, no_tap
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.cornerstone import NO_ERROR, Grating, Statement, StatementError, decode_number, encode_nm

SHUTTER = Statement("SHUTTER", query=True)
LONGEST_WAIT_S = 10.0
"""Longest time for which `close` waits for a motion."""


class Monochromator:
    """The monochromator on its serial line."""

    name = NAME
    parts: tuple[str, ...] = ()

    def __init__(
        self,
        open_port: PortOpener,
        settings: MonochromatorSettings,
        clock: Clock,
        tap: Tap = no_tap,
        found: FoundSettings | None = None,
        guard: Guard | None = None,
    ) -> None:
        self.model = "Cornerstone"
        """The model, with its number once the identity of the unit has been read."""
        self._wire = CornerstoneLine(open_port, settings.baudrate, clock, tap, found or FoundSettings())
        self._guard = guard or NoGuard()
        self._opening: PendingStatement | None = None
        self._clock = clock
        self._lock = threading.RLock()
        self._motion: PendingStatement | None = None
        self._stop_count = 0
        self._known: dict[str, str] = {}
        self.settings = settings

    @property
    def events(self) -> deque[str]:
        """The driver's own actions (port reopened, settings restored), newest last."""
        return self._wire.events

    @property
    def modes(self) -> str:
        """What was detected of the line: echo and handshake mode, as text."""
        echo, handshake = (("no", "with")[on] for on in (self._wire.echoes, self._wire.handshake))
        return f"{echo} echo, {handshake} handshake mode"

    def identify(self) -> str:
        """Open the port and return the identity; `INFO?` is all that is sent. Raises DeviceError."""
        return self._identified(self._wire.identify())

    def connect(self) -> str:
        """Open the port, detect echo and handshake mode; return the identity. Nothing moves. Raises DeviceError."""
        with self._lock:
            self._motion = None
            self._known.clear()
            identity = self._identified(self._wire.open())
            self.wavelength_nm()
            return identity

    def reconnect(self) -> None:
        """Connect again after a fault. Raises DeviceError."""
        self.connect()

    def close(self) -> None:
        """Restore handshake mode and units as they were found, unless the unit is not responding, and close the port."""
        with self._lock:
            if self._motion is not None and not self._motion.aborted and self.moving:  # it replies when it has arrived
                self._clock.sleep_until(min(self._motion.due, self._clock.now() + LONGEST_WAIT_S))
            with contextlib.suppress(DeviceError):
                self._wire.restore()
            self._wire.close()

    def last_will(self) -> LastWill:
        """Abort the motion in progress, close the shutter, and ask for it."""
        order = ABORT.encode() + Statement("SHUTTER", parameter="C").encode()
        return LastWill(
            NAME,
            self.settings.baudrate,
            LINE_END,
            order,
            SHUTTER.encode(),
            r"(^|[\r\n])[Cc][\r\n]",
            "the shutter may be open",
            CLOSE_SHUTTER,
            "the shutter is closed",
        )

    def is_safe(self) -> bool:
        """Whether the shutter is closed, asked of a unit that is identified only. Raises DeviceError."""
        return self._wire.setting(SHUTTER.word) == "C"

    # ---- queries ----

    def wavelength_nm(self) -> float:
        """Wavelength of the grating, nm. Raises DeviceError."""
        return self._number("WAVE", 0.0, 10_000.0)

    def shutter_is_open(self) -> bool:
        """True if the shutter is open. Raises DeviceError."""
        is_open = self._confirmed(SHUTTER.word, lambda text: text.upper() in ("O", "C"), "neither O nor C").upper() == "O"
        opening = self._opening
        if not is_open and (opening is None or opening.done or opening.querying):  # else it may be opened yet
            self._guard.disarm()
        return is_open

    def filter(self) -> int:
        """Position of the filter wheel; 0 without a wheel. Raises DeviceError."""
        return round(self._number("FILTER", 0.0, 9.0))

    def grating(self) -> Grating:
        """The grating in the beam. Raises DeviceError."""
        return Grating.decode(self._confirmed("GRAT", _is_grating, "not a grating").encode("ascii"))

    def slit_um(self, slit: int) -> float:
        """Width of a slit, micrometres. Raises DeviceError."""
        return self._number(f"SLIT{slit}MICRONS", 0.0, 10_000.0)

    def step(self) -> int:
        """Position of the grating's motor, steps. Raises DeviceError."""
        return round(self._number("STEP", -1e9, 1e9))

    def check(self) -> None:
        """Read the canary. Raises Forgotten after a reset, DeviceError if it is not responding."""
        self._query("UNITS")

    def ask(self) -> None:
        """Ask whether the unit responds, and restore nothing: the next use finds a reset. Raises DeviceError."""
        with self._lock:
            self._wire.ask()

    # ---- motions ----

    def start_wavelength(self, wavelength_nm: float) -> Pending:
        """Start a change of wavelength. Raises DeviceError, for a wavelength out of range before anything is sent."""
        lowest, highest = self.settings.lowest_nm, self.settings.highest_nm
        if not lowest <= wavelength_nm <= highest:
            raise DeviceError(
                NAME, f"go to {wavelength_nm:g} nm", f"outside {lowest:g} to {highest:g} nm", "change the wavelength"
            )
        known = self._known.get("WAVE")
        distance = highest - lowest if known is None else wavelength_nm - float(known)
        target = encode_nm(wavelength_nm)

        def arrived() -> bool:
            return abs(self.wavelength_nm() - wavelength_nm) <= self.settings.tolerance_nm

        seconds = float(self.settings.slew_seconds(distance))
        return self._start(Statement("GOWAVE", parameter=target), seconds, "WAVE", target, arrived)

    def start_shutter(self, *, opened: bool) -> Pending:
        """Start to open or close the shutter. Raises DeviceError."""
        letter = "O" if opened else "C"
        if opened:
            self._guard.arm(self.last_will())  # before a byte of it is sent
        pending = self._start(
            Statement(SHUTTER.word, parameter=letter),
            self.settings.shutter_s,
            SHUTTER.word,
            letter,
            lambda: self.shutter_is_open() is opened,
        )
        if opened:
            self._opening = pending
        return pending

    def start_filter(self, position: int) -> Pending:
        """Start to turn the filter wheel, unless it is at the position already. Raises DeviceError."""

        def seconds() -> float | None:
            here = self.filter()
            if here == 0:
                raise DeviceError(
                    NAME,
                    f"turn the filter wheel to {position}",
                    "it has no filter wheel",
                    "remove monochromator.filters from the rig file",
                )
            if here == position:
                return None
            self._known.pop("FILTER", None)
            return abs(position - here) * self.settings.filter_s

        return self._start(
            Statement("FILTER", parameter=str(position)),
            0.0,
            "FILTER",
            str(position),
            lambda: self.filter() == position,
            seconds,
        )

    def start_grating(self, number: int) -> Pending:
        """Start to turn the turret to a grating; the unit then returns to its wavelength. Raises DeviceError."""
        self._known.pop("WAVE", None)
        return self._start(
            Statement("GRAT", parameter=str(number)),
            self.settings.grating_s,
            "GRAT",
            None,
            lambda: self.grating().number == number,
        )

    def start_slit(self, slit: int, width_um: float) -> Pending:
        """Start to set the width of slit 1, 2 or 3, whole micrometres. Raises DeviceError."""
        word, width = f"SLIT{slit}MICRONS", str(round(width_um))
        known = self._known.get(word)
        distance = 3000.0 if known is None else abs(round(width_um) - float(known))
        return self._start(
            Statement(word, parameter=width),
            distance / self.settings.slit_um_per_s,
            word,
            width,
            lambda: self.slit_um(slit) == round(width_um),
        )

    def start_step(self, steps: int) -> Pending:
        """Start to turn the grating by a number of steps; never sent twice. Raises DeviceError."""
        target = self.step() + steps
        self._known.pop("WAVE", None)
        distance = self.settings.highest_nm - self.settings.lowest_nm
        statement, seconds = Statement("STEP", parameter=str(steps)), float(self.settings.slew_seconds(distance))
        return self._start(statement, seconds, "STEP", str(target), lambda: self.step() == target)

    def abort(self) -> None:
        """Abort the motion in progress; its position is then unknown until it is queried. Thread-safe."""
        motion = self._motion
        if motion is not None:
            motion.aborted = True
        self._known.clear()
        self._wire.send_now(ABORT)

    def stop(self) -> None:
        """Abort the motion in progress, and prevent one that is about to start. Thread-safe. Raises DeviceError."""
        self._stop_count += 1
        if self.moving:
            self.abort()

    @property
    def moving(self) -> bool:
        """True until the end of the last motion has been polled."""
        return self._motion is not None and not self._motion.done

    def _start(
        self,
        statement: Statement,
        seconds: float,
        word: str,
        target: str | None,
        arrived: Callable[[], bool],
        ask_first: Callable[[], float | None] | None = None,
    ) -> PendingStatement:
        with self._lock:
            before = self._motion if self.moving else None
            if ask_first is None:
                self._known.pop(word, None)

            def confirmed() -> bool:
                if target is not None:
                    self._known[word] = target
                good = arrived()
                if not good:
                    self._known.pop(word, None)
                return good

            on_the_wire = self.settings.statement_seconds(str(statement))
            motion = PendingStatement(
                self._wire, self._clock, statement, seconds, on_the_wire, confirmed, before, lambda: self._stop_count, ask_first
            )
            self._motion = motion
            return motion

    def _identified(self, identity: str) -> str:
        """The same identity, whose model is known from here on."""
        found = re.search(r"Cornerstone \d+\w*", identity)
        self.model = self.model if found is None else found[0]
        return identity

    # ---- exchanges ----

    def _query(self, word: str) -> str:
        """Reply to a query; its status must be free of errors. Raises DeviceError."""
        statement = Statement(word, query=True)
        with self._lock:
            motion = self._motion
            if motion is not None and not motion.done and motion.silent:
                if not motion.aborted:
                    raise DeviceError(
                        NAME, f"query ({statement})", "it is moving, and not responding until it arrives", "wait for it"
                    )
                motion.done = True
            reply, status = self._wire.exchange(statement)
            if status != NO_ERROR:
                raise self._wire.refused(statement, self._wire.last_error())
            try:
                return reply.decode("ascii").strip()
            except UnicodeDecodeError:
                self._wire.in_step = False
                raise BadAnswer(NAME, str(statement), f"not ASCII: {reply!r}", CHECK_LINE) from None

    def _confirmed(self, word: str, plausible: Callable[[str], bool], otherwise: str) -> str:
        """A reply with the expected value, or the same value twice. Raises DeviceError."""
        reply = self._query(word)
        if reply != self._known.get(word):
            again = self._query(word)
            if again == self._known.get(word):
                reply = again
            elif again != reply:
                self._wire.in_step = False
                raise BadAnswer(NAME, f"{word}?", f"{reply!r}, then {again!r}", CHECK_LINE)
        if not plausible(reply):
            self._wire.in_step = False
            raise BadAnswer(NAME, f"{word}?", f"{reply!r} is {otherwise}", CHECK_LINE)
        self._known[word] = reply
        return reply

    def _number(self, word: str, lowest: float, highest: float) -> float:
        def plausible(text: str) -> bool:
            try:
                return lowest <= decode_number(text.encode("ascii")) <= highest
            except StatementError:
                return False

        return decode_number(self._confirmed(word, plausible, "not a plausible number").encode("ascii"))


def _is_grating(text: str) -> bool:
    try:
        Grating.decode(text.encode("ascii"))
    except StatementError:
        return False
    return True
