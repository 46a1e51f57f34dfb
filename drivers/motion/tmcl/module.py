"""Trinamic motion modules on their serial line: one exchange at a time; each reply is checked before it is accepted.

Checks of a reply: nine bytes, checksum, host address, module address, command and, for a request that sets something, the
echo of its value. A reply to GAP does not name its parameter and motor. Therefore:
- Before each request, unrequested bytes are discarded. Between two GAP in quick succession (or two SAP of one value) a GGP
  is sent, whose reply has another command, so that a repeated reply is never taken for the next one.
- After a timeout or a corrupted reply, a marker must come back first: a user variable is set to a value that was never on
  this line before, and everything before its echo is discarded.
Undetectable: a reply with two wrong bytes whose checksum fits (1 in 255 at random; two bytes exchanged: always) while host,
module, command and status stay right, so that the value is wrong; or such a request, which the module carries out.
Limits of the damage: about 1 frame in 1000 is corrupted on USB, mostly in one byte, which is always detected; the echo of
MVP and SAP shows a wrong value; positions are read back by counter and encoder in every row; soft limits restrict targets,
limit switches and the encoder deviation restrict the motor.

`connect` writes a canary, the number of this session, to a user variable that is lost with the power. A missing canary means
that the module has reset and lost its settings; that of another session, that another program has connected since, past all
locks: from another computer, or another network of this one. The module is left to it, and nothing but a stop is sent any
more. The heartbeat makes the module stop its motors after 2 s without a request: four times the interval
between two polls of a moving axis, longer than the 1 s for which another bus may block the engine.
A computer, a cable and a network are late in real time. So on a clock that is `speed` times as fast, waits for replies are that
much longer, and the heartbeat is too, as far as a module can count.
(*) Firmware keeps the heartbeat in EEPROM: it is written only if it differs. At the end it gets back the value that was found.
"""

import contextlib
from collections import deque
from collections.abc import Iterator, Sequence
from functools import partial

from goniotwin.drivers.device import PortOpener
from goniotwin.drivers.errors import BadAnswer, DeviceError, Forgotten, Interrupted, NoAnswer, Taken, WrongDevice, unless_late
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.motion.stop import StopPhase, StopSteps
from goniotwin.drivers.motion.stop_lock import StopLock
from goniotwin.drivers.motion.tmcl.port import FRAME_S_BITS, PORT_FAULTS, SLICE_S, Targets, TmclPort
from goniotwin.drivers.motion.tmcl.rules import (
    CANARY,
    CANARY_VARIABLE,
    FIRST_MARKER,
    MARKER_VARIABLE,
    WRITES,
    check_reply,
    is_repeatable,
    read_request,
    reset_marks,
    setting_name,
    starts_motion,
)
from goniotwin.drivers.tap import Tap, no_tap
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import HOST_ADDRESS, Command, CommandFrame, ReplyFrame, ReplyStatus
from goniotwin.protocols.tmcl_parameters import USER_BANK, AxisParameter, GlobalParameter

MODELS = (6214, 1240)
TIMEOUT_S = 0.06
SLOW_LINE_TIMEOUT_S = 0.5
PATIENT_TIMEOUT_S = 0.5
SLOW_LINE_BAUDRATE = 57_600
ATTEMPTS, PATIENT_ATTEMPTS = 2, 3
HEARTBEAT_S = 2.0
LONGEST_HEARTBEAT_S = 65.0
"""The silence counter of a module has 16 bits of ms."""
STOPPING_S = 1.0
TURNING_S = 0.1
"""Time between two questions whether a motor turns."""
RESYNCHRONISATIONS = 2
EVENTS_KEPT = 100


def default_reply_timeout_s(baudrate: int) -> float:
    """The longest wait for a reply on a serial line, s."""
    return TIMEOUT_S if baudrate >= SLOW_LINE_BAUDRATE else SLOW_LINE_TIMEOUT_S


class TmclModule:
    """The serial line of one motion module, or of several on one bus by their addresses.

    Exchanges come from the engine's thread. A stop may come from any thread, or from an event of the clock in the middle of
    an exchange. A lock serialises them, and a stop goes first: an exchange without reply gives way to it.
    `events` are the driver's own actions (port reopened, line resynchronised), newest last.
    """

    def __init__(
        self,
        open_port: PortOpener,
        clock: Clock,
        baudrate: int = 115200,
        tap: Tap = no_tap,
        addresses: Sequence[int] = (1,),
        heartbeat_s: float = HEARTBEAT_S,
        name: str = "axes",
        session: int = CANARY,
        found: FoundSettings | None = None,
        reply_timeout_s: float | None = None,
        speed: float = 1.0,
    ) -> None:
        """`speed` is the time of the clock in a second of real time, in which `heartbeat_s` and `reply_timeout_s` are."""
        self.name = name
        self.model = ""
        """That of the first module, once it has been identified."""
        self.found = found or FoundSettings(asks=False)
        self._session = session
        self._taken: Taken | None = None
        self._open_port = open_port
        self._clock = clock
        self._baudrate = baudrate
        self._timeout_s = speed * (reply_timeout_s or default_reply_timeout_s(baudrate))
        self._patient_s = max(self._timeout_s, speed * PATIENT_TIMEOUT_S)
        self.reply_s, self._attempts = self._timeout_s, ATTEMPTS
        """The longest wait for a reply now, s of the clock, and the number of attempts."""
        self._frame_s = FRAME_S_BITS / baudrate
        self._patience_s = 3.0 * self._frame_s + SLICE_S
        self._alike_s = 4.0 * self._frame_s + SLICE_S
        self._tap = tap
        self.addresses = tuple(sorted(set(addresses)))
        self.heartbeat_s = min(speed * heartbeat_s, LONGEST_HEARTBEAT_S)
        self.events: deque[str] = deque(maxlen=EVENTS_KEPT)
        self._lock = StopLock()
        self._port: TmclPort | None = None
        self._out_of_step, self._marker = False, FIRST_MARKER
        self._last: tuple[int, int, float] = (0, 0, float("-inf"))
        self._connected, self._reset = set[int](), set[int]()
        self._resets = dict.fromkeys(self.addresses, 0)

    @property
    def timeout_s(self) -> float:
        """Longest wait for a reply, s of the clock."""
        return self._timeout_s

    @property
    def keep_alive_s(self) -> float:
        """Longest interval between two requests to a module with moving motors, s; infinity without a heartbeat."""
        return self.heartbeat_s / 4.0 if self.heartbeat_s > 0.0 else float("inf")

    @property
    def stop_count(self) -> int:
        """Number of stop requests so far."""
        return self._lock.requested

    def resets(self, address: int) -> int:
        """Number of resets of a module that were detected."""
        return self._resets[address]

    def connect(self) -> int:
        """Open the port, identify the modules, set canary and heartbeat; return the first module's number, such as 6214.

        Nothing moves. Raises DeviceError if the port cannot be opened, a module does not respond or has a wrong number.
        """
        self._open()
        with self._lock.hold(), self.patiently():
            numbers = [self._initialise(address) for address in self.addresses]
        return numbers[0]

    def identify(self) -> int:
        """Open the port and read the numbers of the modules; return the first. Nothing is written. Raises DeviceError."""
        self._open()
        with self.patiently():
            numbers = [self._number(address) for address in self.addresses]
        return numbers[0]

    def restore(self, motors: Sequence[tuple[int, int]]) -> None:
        """Restore the settings that were found, when the motors (module, motor) rest. Raises DeviceError.

        One that turns is stopped by the heartbeat, in a silence that is waited for.
        """
        if not self.found.changes:
            return
        with self.patiently():
            stopped = self._clock.now() + STOPPING_S
            while (turning := self._turning(motors)) and self._clock.now() < stopped:  # a stop may be bringing it to rest
                self._clock.sleep_until(self._clock.now() + TURNING_S)
            if turning:
                self._clock.sleep_until(self._clock.now() + self.heartbeat_s + STOPPING_S)
                if turning := self._turning(motors):
                    raise DeviceError(self.name, "restore its settings", f"motor {turning[0]} turns", "connect it again")
            requests = {name: read_request(name) for name in self.found.changes}
            # A module of the note may have left the line since.
            own = {name: each for name, each in requests.items() if each.address in self.addresses}
            present = {name: str(self.exchange(each)) for name, each in own.items()}
            for name, value in present.items():
                if (found := self.found.value_to_restore(name, value)) is not None:
                    self.exchange(own[name]._replace(command=WRITES[own[name].command], value=int(found)))
        self.found.clear()

    @contextlib.contextmanager
    def patiently(self) -> Iterator[None]:
        """Exchanges that wait longer for a reply and are repeated more often. A stop does not wait for them any longer.

        For connecting: no motion is watched by it, and a computer that is busy, or serves the module itself, is often late.
        """
        self.reply_s, self._attempts = self._patient_s, PATIENT_ATTEMPTS
        try:
            yield
        finally:
            self.reply_s, self._attempts = self._timeout_s, ATTEMPTS

    def close(self) -> None:
        """Close the port. Nothing is sent; the heartbeat stops motors that still turn."""
        with self._lock.hold():
            if self._port is not None:
                self._port.close()
                self._port = None

    def exchange(self, request: CommandFrame, stop_count: int | None = None) -> int:
        """Send a request and return the value of its reply.

        A repeatable request is repeated once after a fault, `patiently` twice. A request that starts a motion is not sent, or
        not sent again, if a stop was requested after `stop_count` was read (default: after this call). Takes seven timeouts at
        most.
        Raises NoAnswer, BadAnswer, Refused or Interrupted.
        """
        limit = self._lock.requested if stop_count is None else stop_count
        with self._lock.hold():
            if self._taken is not None:
                raise self._taken
            for attempt in range(1, self._attempts + 1):
                try:
                    if self._out_of_step and request.command != Command.FIRMWARE_VERSION:
                        self._resynchronise(request)  # an unknown module is identified before anything is written to it
                    if starts_motion(request):
                        if limit != self._lock.requested:
                            raise Interrupted(self.name, self._describe(request), "not sent because a stop was requested")
                        if attempt > 1:
                            self._check_before_repeating(request)
                    return self._once(request)
                except (NoAnswer, BadAnswer):
                    self._out_of_step = True
                    if attempt == self._attempts or not is_repeatable(request) or self._lock.stop_waiting:
                        raise
        raise AssertionError("not reached")

    def read_confirmed(self, request: CommandFrame) -> int:
        """Value of a reply, followed by a read of the canary: the module had its settings. Raises Forgotten as well."""
        return self.read_all_confirmed([request])[0]

    def read_all_confirmed(self, requests: Sequence[CommandFrame]) -> list[int]:
        """Values of the replies to GAP requests, each followed by a read of the canary, as in `read_confirmed`."""
        values = []
        for request in requests:
            values.append(self.exchange(request))
            self.check_canary(request.address)
        return values

    def check_canary(self, address: int) -> None:
        """Raise Forgotten if a module has reset since it was connected, until it is connected again, and Taken for good."""
        value = self.exchange(CommandFrame(address, Command.GGP, CANARY_VARIABLE, USER_BANK))
        if value != self._session:
            self._check_not_taken(address, value)
            self._note_reset(address)
            raise Forgotten(
                self.name,
                f"check the canary of module {address}",
                "the module has reset and lost its settings",
                "connect again, then home its axes or set their positions (goniotwin home, goniotwin here)",
            )

    def begin_stop(self, targets: Targets) -> StopSteps:
        """Request a stop of axes, by their names, before anything else; return its steps. Thread-safe.

        The last frame is sent after one short wait for the exchange in progress and one for each earlier frame without
        reply, 20 ms each at 115200 Bd and 40 ms at 9600 Bd. Frames without reply are sent once more after the first attempt.
        """
        return self._lock.begin_stop(self._stop(sorted(targets, key=lambda target: target[1].command != Command.MST)))

    def _stop(self, targets: Targets) -> StopSteps:
        port = self._port
        if port is None:
            return [NoAnswer(name, "stop", "the port is not open", "cut the motors' power") for name, _ in targets]
        silent, broken = list(targets), ""
        for first in (True, False):
            try:
                silent, broken = (yield from port.send_all(silent, self._patience_s, self._timeout_s)), ""
            except PORT_FAULTS as error:
                broken = str(error)  # the port is opened again
            if first:
                yield StopPhase.ATTEMPTED
            if not silent:
                break
            self._out_of_step = True
        self._last = (Command.MST, 0, self._clock.now())
        if broken:
            return [NoAnswer(name, "stop", f"the port failed: {broken}", "cut the motors' power") for name, _ in silent]
        happened, remedy = "the module has not confirmed it", "cut the motors' power if the axis still turns"
        return [NoAnswer(name, "stop", happened, remedy) for name, _ in silent]

    def _check_before_repeating(self, move: CommandFrame) -> None:
        """A module that reset after the failed attempt has lost its position; raise Forgotten."""
        try:
            self.check_canary(move.address)
        except Forgotten:
            raise
        except DeviceError as error:
            raise NoAnswer(self.name, self._describe(move), f"not sent again: {error.happened}", error.remedy) from None

    def _open(self) -> None:
        self.close()
        try:
            opened = TmclPort(lambda: self._open_port(self._baudrate, SLICE_S), self._clock, self._tap, TIMEOUT_S, self.events)
        except (*PORT_FAULTS, ValueError) as error:
            raise DeviceError(self.name, "open the port", str(error), "check the port in the rig file") from None
        with self._lock.hold():
            self._port = opened
            self._out_of_step = False

    def _initialise(self, address: int) -> int:
        """Identify a module, set its canary and heartbeat; return its number. Raises DeviceError."""
        number = self._number(address)
        if number not in MODELS:
            raise WrongDevice(
                self.name,
                f"identify module {address}",
                f"it is a TMCM-{number}",
                f"this driver supports {' and '.join(f'TMCM-{each}' for each in MODELS)}",
            )
        if address == self.addresses[0]:
            self.found.take_up(f"TMCM-{number}")
        canary = CommandFrame(address, Command.SGP, CANARY_VARIABLE, USER_BANK, self._session)
        if (found := self.exchange(canary._replace(command=Command.GGP, value=0))) != self._session:
            if address in self._connected:
                self._check_not_taken(address, found)
                self._note_reset(address)
            self.exchange(canary)
        heartbeat = CommandFrame(address, Command.SGP, GlobalParameter.HEARTBEAT, 0, round(self.heartbeat_s * 1000.0))
        if (present := self.exchange(heartbeat._replace(command=Command.GGP, value=0))) != heartbeat.value:
            self.found.note({setting_name(heartbeat): (str(present), str(heartbeat.value))})
            self.exchange(heartbeat)
        self._connected.add(address)
        self._reset.discard(address)
        return number

    def _turning(self, motors: Sequence[tuple[int, int]]) -> list[int]:
        """Those of the motors (module, motor) that turn."""
        requests = [CommandFrame(address, Command.GAP, AxisParameter.ACTUAL_VELOCITY, motor) for address, motor in motors]
        return [each.motor for each in requests if self.exchange(each) != 0]

    def _number(self, address: int) -> int:
        number = self.exchange(CommandFrame(address, Command.FIRMWARE_VERSION, 1, 0)) >> 16
        if address == self.addresses[0]:
            self.model = f"TMCM-{number}"
        return number

    def _check_not_taken(self, address: int, value: int) -> None:
        """Raise Taken for the canary of another session, if it is read twice: a value can be corrupted unnoticed."""
        again = CommandFrame(address, Command.GGP, CANARY_VARIABLE, USER_BANK)
        if value != 0 and self.exchange(again) == value:
            self._taken = Taken(
                self.name,
                f"check the canary of module {address}",
                "another program has taken the controller",
                "end that program, on this computer or another, then start again",
            )
            raise self._taken

    def _note_reset(self, address: int) -> None:
        """Count a reset, and mark the axes unreferenced in the module, if the line works, for the next process."""
        if address not in self._reset:
            self._reset.add(address)
            self._resets[address] += 1
            with contextlib.suppress(DeviceError):
                for each in reset_marks(address):
                    self.exchange(each)

    def _once(self, request: CommandFrame) -> int:
        port = self._opened(request)
        command, value, when = self._last
        alike = command == request.command and (command == Command.GAP or (command == Command.SAP and value == request.value))
        if alike and self._clock.now() - when < self._alike_s:
            self._once(CommandFrame(request.address, Command.GGP, CANARY_VARIABLE, USER_BANK))
        try:
            stops = self._lock.acquired
            port.send(request.encode())
            started = self._clock.now()  # a computer that is late before it sends does not shorten the module's time
            while True:
                frame = port.frame(started + self.reply_s, lambda: self._gives_way(stops, started))
                if stops != self._lock.acquired:
                    raise NoAnswer(self.name, self._describe(request), "a stop came between request and reply", "try again")
                if frame is None:
                    missing = unless_late(port.late_s, self.reply_s, port.describe_missing(started))
                    raise NoAnswer(self.name, self._describe(request), *missing)
                reply = check_reply(request, frame, self.name, self._describe)
                if reply is not None:
                    self._last = (request.command, request.value, self._clock.now())
                    return reply.value
        except PORT_FAULTS as error:
            raise NoAnswer(self.name, self._describe(request), f"the port failed: {error}", "check cable and power") from None

    def _gives_way(self, stops: int, started: float) -> bool:
        """True if a stop was carried out within this exchange, or has waited long enough for its end."""
        return stops != self._lock.acquired or (self._lock.stop_waiting and self._clock.now() >= started + self._patience_s)

    def _resynchronise(self, request: CommandFrame) -> None:
        """Wait for late bytes, then exchange a marker. Raises NoAnswer if the marker does not come back."""
        port = self._opened(request)
        try:
            for _ in range(RESYNCHRONISATIONS):
                stops = self._lock.acquired
                self._clock.sleep_until(self._clock.now() + 2.0 * self._frame_s + SLICE_S)
                self._marker += 1
                marker = CommandFrame(request.address, Command.SGP, MARKER_VARIABLE, USER_BANK, self._marker)
                port.send(marker.encode())
                started = self._clock.now()
                echo = ReplyFrame(HOST_ADDRESS, request.address, ReplyStatus.OK, Command.SGP, self._marker).encode()
                if port.await_bytes(echo, started + self.reply_s, partial(self._gives_way, stops, started)):
                    self._out_of_step = False
                    self.events.append("line resynchronised")
                    self._last = (Command.SGP, self._marker, self._clock.now())
                    return
                if self._lock.stop_waiting:
                    break
        except PORT_FAULTS as error:
            raise NoAnswer(self.name, self._describe(request), f"the port failed: {error}", "check cable and power") from None
        silent = unless_late(port.late_s, self.reply_s, "not responding, not even to a marker", "check cable and power")
        raise NoAnswer(self.name, self._describe(request), *silent)

    def _opened(self, request: CommandFrame) -> TmclPort:
        if self._port is None:
            raise NoAnswer(self.name, self._describe(request), "the port is not open", "connect first")
        return self._port

    def _describe(self, request: CommandFrame) -> str:
        return str(request) if len(self.addresses) == 1 else f"{request} of module {request.address}"
