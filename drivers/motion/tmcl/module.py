"""Trinamic motion modules on their serial line: one exchange at a time, each answer checked before it is believed.

What is checked of a reply: nine bytes, checksum, host address, module address, command, and where a request sets something
the echo of its value. A reply to GAP does not say of which parameter and motor it speaks, so
- before each request what has come unasked is thrown away, and between two GAP in quick succession (or two SAP of one
  value) a GGP is asked, whose reply has another command: a reply that comes twice is never taken for the next one's;
- after a timeout or a garbled reply nothing is believed before a marker has come back: a user variable is set to a value
  that has never been on this line, and all that comes before its echo belongs to the past.
What cannot be detected: a reply of which two bytes are wrong such that the sum fits (1 in 255 at random; two bytes
exchanged: always) where host, module, command, status stay right, so that the error is in the value; or such a request,
which a module then carries out. What limits the damage: about 1 in 1000 frames is garbled on USB, mostly in one byte,
which is always noticed; MVP's and SAP's echo tell a wrong value; positions are read back by counter and encoder in every
row; soft limits keep targets, limit switches and the encoder's deviation the motor.

`connect` puts a value into a user variable that is lost with the power (the canary). Where it is gone, the module has
reset and forgotten its settings. The heartbeat has the module stop its motors when nothing is said to it for 2 s: four
times the pause between two questions to a moving axis, longer than the 1 s for which another bus may hold up the engine.
(*) Firmware keeps the heartbeat in EEPROM: it is written only where it is not that already.
"""

import contextlib
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from serial import Serial

from goniotwin.drivers.errors import BadAnswer, DeviceError, Forgotten, Interrupted, NoAnswer
from goniotwin.drivers.motion.tmcl.port import FRAME_S_BITS, PORT_FAULTS, SLICE_S, TmclPort
from goniotwin.drivers.motion.tmcl.rules import (
    CANARY,
    CANARY_VARIABLE,
    FIRST_MARKER,
    MARKER_VARIABLE,
    believed,
    doubts,
    moves,
    repeatable,
)
from goniotwin.drivers.motion.tmcl.rules import explain as explain
from goniotwin.drivers.motion.tmcl.stop_lock import Turnstile
from goniotwin.drivers.tap import Tap, no_tap
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import HOST_ADDRESS, Command, Reply, Request, Status
from goniotwin.protocols.tmcl_parameters import USER_BANK, Global

PortOpener = Callable[[int, float], Serial]
"""Opens a serial port: baud rate, timeout in s."""

MODELS = (6214, 1240)
TIMEOUT_S = 0.06
SLOW_LINE_TIMEOUT_S = 0.5
HEARTBEAT_S = 2.0
RESYNCHRONISATIONS = 2
SAID_KEPT = 100


class TmclModule:
    """The wire to one motion module, or to several on one bus, by their addresses.

    Exchanges come from the engine's thread and, for Stop, from any other or from an event of the clock in the middle of an
    exchange. A lock keeps them apart, and Stop goes first: an exchange that hangs gives way to it.
    `said` is what it did of its own accord, newest last.
    """

    def __init__(
        self,
        open_port: PortOpener,
        clock: Clock,
        baudrate: int = 115200,
        tap: Tap = no_tap,
        addresses: Sequence[int] = (1,),
        heartbeat_s: float = HEARTBEAT_S,
    ) -> None:
        self._open_port = open_port
        self._clock = clock
        self._baudrate = baudrate
        self._timeout_s = TIMEOUT_S if baudrate >= 57600 else SLOW_LINE_TIMEOUT_S
        self._frame_s = FRAME_S_BITS / baudrate
        self._patience_s = 3.0 * self._frame_s + SLICE_S
        self._tap = tap
        self.addresses = tuple(sorted(set(addresses)))
        self.heartbeat_s = heartbeat_s
        self.said: deque[str] = deque(maxlen=SAID_KEPT)
        self._turns = Turnstile()
        self._port: TmclPort | None = None
        self._in_doubt, self._marker = False, FIRST_MARKER
        self._last: tuple[int, int, float] = (0, 0, float("-inf"))
        self._greeted, self._gone = set[int](), set[int]()
        self._resets = dict.fromkeys(self.addresses, 0)

    @property
    def alive_s(self) -> float:
        """How often a module has to be spoken to while its motors turn; infinity without a heartbeat."""
        return self.heartbeat_s / 4.0 if self.heartbeat_s > 0.0 else float("inf")

    @property
    def stops(self) -> int:
        """How many stops there have been."""
        return self._turns.asked

    def resets(self, address: int) -> int:
        """How often a module has been found to have forgotten its settings."""
        return self._resets[address]

    def connect(self) -> int:
        """Opens the port, asks who is there and sets canary and heartbeat; returns the first module's number, such as 6214.

        Nothing moves. Raises DeviceError where the port cannot be opened, nobody answers, or somebody else.
        """
        self._open()
        with self._turns.turn():
            numbers = [self._greet(address) for address in self.addresses]
        return numbers[0]

    def identify(self) -> int:
        """Opens the port and asks the first module for its number, and nothing else: nothing is written to it.

        Raises DeviceError.
        """
        self._open()
        return self.exchange(Request(self.addresses[0], Command.FIRMWARE_VERSION, 1, 0)) >> 16

    def close(self) -> None:
        """Gives the port back. Nothing is sent; what still turns stops by its heartbeat."""
        with self._turns.turn():
            if self._port is not None:
                self._port.close()
                self._port = None

    def exchange(self, request: Request, since: int | None = None) -> int:
        """Sends a request and returns the value of its reply.

        A request that may happen twice is repeated once after a fault. One that moves something is not sent, or not sent
        again, where a stop has come after `since` (a former value of `stops`; by default: after this call). Lasts seven
        timeouts at most. Raises NoAnswer, BadAnswer, Refused or Interrupted.
        """
        limit = self._turns.asked if since is None else since
        with self._turns.turn():
            for last in (False, True):
                try:
                    if self._in_doubt and request.command != Command.FIRMWARE_VERSION:
                        self._resynchronise(request)  # but a stranger is asked who he is, and told nothing before
                    if moves(request):
                        if limit != self._turns.asked:
                            raise Interrupted("axes", self._words(request), "a stop has come first: nothing was sent")
                        if last:
                            self._check_before_repeating(request)
                    return self._once(request)
                except (NoAnswer, BadAnswer):
                    self._in_doubt = True
                    if last or not repeatable(request) or self._turns.stop_waits:
                        raise
        raise AssertionError("not reached")

    def confirmed(self, request: Request) -> int:
        """The value of a reply of which the canary says that the module had its settings. Raises Forgotten as well."""
        value = self.exchange(request)
        self.check_canary(request.address)
        return value

    def check_canary(self, address: int) -> None:
        """Raises Forgotten where a module has reset since it was connected, until it is connected again."""
        value = self.exchange(Request(address, Command.GGP, CANARY_VARIABLE, USER_BANK))
        if value != CANARY:
            self._notice_reset(address)
            raise Forgotten(
                "axes", f"look for the canary in module {address}", "the module has reset and forgotten its settings",
                "connect again, then home its axes, or say where they are (goniotwin home, goniotwin here)",
            )  # fmt: skip

    def stop(self, targets: Sequence[tuple[str, Request]], then: Callable[[], None] = lambda: None) -> list[DeviceError]:
        """Sends the stop frames of axes, by their names, before anything else; returns what was not confirmed. Any thread.

        The last frame is on the wire after one short wait for the exchange under way and one for each frame before it that
        nobody answers, 20 ms each at 115200 Bd and 40 ms at 9600 Bd; whoever is silent is told once more, after `then`.
        """
        targets = sorted(targets, key=lambda target: target[1].command != Command.MST)
        with self._turns.stop():
            port = self._port
            if port is None:
                then()
                return [NoAnswer(name, "stop", "the port is not open") for name, _ in targets]
            silent, broken = list(targets), ""
            for first in (True, False):
                try:
                    silent, broken = port.tell_all(silent, self._patience_s, self._timeout_s), ""
                except PORT_FAULTS as error:
                    broken = str(error)  # it is opened again
                if first:
                    then()
                if not silent:
                    break
                self._in_doubt = True
            self._last = (Command.MST, 0, self._clock.now())
            if broken:
                return [NoAnswer(name, "stop", f"the port failed: {broken}", "cut the motors' power") for name, _ in silent]
            told, remedy = "the module has not confirmed it", "cut the motors' power if the axis still turns"
            return [NoAnswer(name, "stop", told, remedy) for name, _ in silent]

    def _check_before_repeating(self, move: Request) -> None:
        """Who has reset meanwhile counts from elsewhere."""
        try:
            self.check_canary(move.address)
        except Forgotten:
            raise
        except DeviceError as error:
            raise NoAnswer("axes", self._words(move), f"not sent again: {error.happened}", error.remedy) from None

    def _open(self) -> None:
        self.close()
        try:
            opened = TmclPort(
                lambda: self._open_port(self._baudrate, SLICE_S), self._clock, self._tap, self._timeout_s, self.said
            )
        except (*PORT_FAULTS, ValueError) as error:
            raise DeviceError("axes", "open the port", str(error), "check the port in the rig file") from None
        with self._turns.turn():
            self._port = opened
            self._in_doubt = False

    def _greet(self, address: int) -> int:
        number = self.exchange(Request(address, Command.FIRMWARE_VERSION, 1, 0)) >> 16
        if number not in MODELS:
            raise BadAnswer(
                "axes", f"ask module {address} who it is", f"it is a TMCM-{number}",
                f"this driver knows {' and '.join(f'TMCM-{each}' for each in MODELS)}",
            )  # fmt: skip
        canary = Request(address, Command.SGP, CANARY_VARIABLE, USER_BANK, CANARY)
        if self.exchange(replace(canary, command=Command.GGP, value=0)) != CANARY:
            if address in self._greeted:
                self._notice_reset(address)
            self.exchange(canary)
        heartbeat = Request(address, Command.SGP, Global.HEARTBEAT, 0, round(self.heartbeat_s * 1000.0))
        if self.exchange(replace(heartbeat, command=Command.GGP, value=0)) != heartbeat.value:
            self.exchange(heartbeat)
        self._greeted.add(address)
        self._gone.discard(address)
        return number

    def _notice_reset(self, address: int) -> None:
        """The next program has to hear of it too, so that the marks say it, as far as the line allows."""
        if address not in self._gone:
            self._gone.add(address)
            self._resets[address] += 1
            with contextlib.suppress(DeviceError):
                for each in doubts(address):
                    self.exchange(each)

    def _once(self, request: Request) -> int:
        port = self._opened(request)
        command, value, when = self._last
        alike = command == request.command and (command == Command.GAP or (command == Command.SAP and value == request.value))
        if alike and self._clock.now() - when < 4.0 * self._frame_s + SLICE_S:
            self._once(Request(request.address, Command.GGP, CANARY_VARIABLE, USER_BANK))
        try:
            done = self._turns.done
            port.send(request.encode())
            started = self._clock.now()
            while True:
                frame = port.frame(started + self._timeout_s, lambda: self._gives_way(done, started))
                if done != self._turns.done:
                    raise NoAnswer("axes", self._words(request), "a stop came between question and answer")
                if frame is None:
                    raise NoAnswer("axes", self._words(request), port.how_little(started))
                reply = believed(request, frame, self._words)
                if reply is not None:
                    self._last = (request.command, request.value, self._clock.now())
                    return reply.value
        except PORT_FAULTS as error:
            raise NoAnswer("axes", self._words(request), f"the port failed: {error}", "check cable and power") from None

    def _gives_way(self, done: int, started: float) -> bool:
        """Whether a stop has been carried out within this exchange, or waits for its end and has waited long enough."""
        return done != self._turns.done or (self._turns.stop_waits and self._clock.now() >= started + self._patience_s)

    def _resynchronise(self, request: Request) -> None:
        """Lets the past arrive, and has a marker come back. Raises NoAnswer where it does not, Interrupted for a stop."""
        port = self._opened(request)
        try:
            for _ in range(RESYNCHRONISATIONS):
                done = self._turns.done
                self._clock.sleep_until(self._clock.now() + 2.0 * self._frame_s + SLICE_S)
                self._marker += 1
                marker = Request(request.address, Command.SGP, MARKER_VARIABLE, USER_BANK, self._marker)
                port.send(marker.encode())
                started = self._clock.now()
                echo = Reply(HOST_ADDRESS, request.address, Status.OK, Command.SGP, self._marker).encode()
                if port.await_bytes(echo, started + self._timeout_s, partial(self._gives_way, done, started)):
                    self._in_doubt = False
                    self.said.append("the line is in step again")
                    self._last = (Command.SGP, self._marker, self._clock.now())
                    return
                if self._turns.stop_waits:
                    break
        except PORT_FAULTS as error:
            raise NoAnswer("axes", self._words(request), f"the port failed: {error}", "check cable and power") from None
        raise NoAnswer("axes", self._words(request), "no answer, not even to a marker", "check cable and power")

    def _opened(self, request: Request) -> TmclPort:
        if self._port is None:
            raise NoAnswer("axes", self._words(request), "the port is not open", "connect first")
        return self._port

    def _words(self, request: Request) -> str:
        return str(request) if len(self.addresses) == 1 else f"{request} of module {request.address}"
