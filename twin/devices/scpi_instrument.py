"""An instrument that speaks SCPI: parser, error queue, event registers, common commands, status groups.

What an instrument measures it adds with `commands`. Source: IEEE 488.2 chapters 10 to 12; SCPI-99 volumes 1 and 2. The
parser stops at a message's first command error, and goes on after an error of execution. A suffix of 1 may stand at any node.

A status group of SCPI: condition, transition filters, event register, enable mask.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from functools import partial

from goniotwin.protocols.scpi import (
    MAX_MESSAGE,
    MessageUnit,
    ScpiError,
    decode_quantity,
    encode_error,
    parsed,
    spellings,
    words,
)
from goniotwin.protocols.usbtmc import StatusByte


class StatusGroup:
    """Sixteen bits of which the highest is never used. Source: SCPI-99 volume 1, chapter 9."""

    def __init__(self) -> None:
        self.condition = 0
        self.event = 0
        self.preset()

    def preset(self) -> None:
        """STATus:PRESet: nothing enabled, events at rising edges."""
        self.enable = 0
        self.rising = 0x7FFF
        self.falling = 0

    def set(self, bit: int, on: bool) -> None:
        """A condition comes or goes; its edges become events by the filters."""
        mask = 1 << bit
        if on and not self.condition & mask:
            self.event |= mask & self.rising
            self.condition |= mask
        elif not on and self.condition & mask:
            self.event |= mask & self.falling
            self.condition &= ~mask

    def read(self) -> int:
        """The event register, which reading clears."""
        event, self.event = self.event, 0
        return event

    @property
    def summary(self) -> bool:
        """Whether an enabled event has happened."""
        return bool(self.event & self.enable)


THINKING_S = 5.0e-4
ERRORS_KEPT = 10
OUTPUT_QUEUE_BYTES = 16_384
OPERATION_COMPLETE, QUERY_ERROR, DEVICE_ERROR, EXECUTION_ERROR, COMMAND_ERROR = 0x01, 0x04, 0x08, 0x10, 0x20
POWER_ON = 0x80
REGISTERS = {"ENABle": "enable", "PTRansition": "rising", "NTRansition": "falling"}

Action = Callable[[MessageUnit], bytes | None]
Command = tuple[str, bool, Action]


class ScpiInstrument:
    """One input, one output queue, an error queue, a status byte; each answer has the time at which it is ready."""

    manufacturer = "goniotwin"
    product = "SCPI instrument"
    vendor_id = 0x0000
    product_id = 0x0000
    serial_number = "TWIN0000"
    firmware = "1.0"
    version = "1999.0"
    max_message = MAX_MESSAGE
    group_names: tuple[str, ...] = ("OPERation", "QUEStionable")

    def __init__(self) -> None:
        self._errors: deque[tuple[int, str]] = deque()
        self._events = POWER_ON
        self._event_enable = 0
        self.service_enable = 0
        self._now = 0.0
        self._complete_at: float | None = None
        self.groups = {name: StatusGroup() for name in self.group_names}
        self._commands: dict[tuple[tuple[str, ...], bool], Action] = {}
        for pattern, query, action in (*self._common(), *self._status(), *self.commands()):
            for header in spellings(pattern):
                self._commands[header, query] = action
        self.preset()

    # ---- identity and status of an instrument ----

    def commands(self) -> Iterator[Command]:
        """Commands of the instrument: pattern, query or not, action."""
        yield from ()

    def preset(self) -> None:
        """*RST."""

    def pending_until(self) -> float:
        """End time of all running operations, s."""
        return float("-inf")

    def refresh(self, t: float) -> None:
        """Update the status groups to `t`."""

    def abort(self) -> None:
        """Stop all running operations."""

    def trigger(self) -> None:
        """*TRG, or USB488's TRIGGER."""
        raise ScpiError(-211, "Trigger ignored")

    # ---- messages ----

    def execute(self, message: bytes, t: float) -> list[tuple[float, bytes]]:
        """Carries out a whole program message that arrived at `t`; the answers of its queries, when each is ready.

        The answers of one message are one response, joined by `;`. What an earlier message is still busy with comes first.
        """
        self._now = max(t, self._now) + THINKING_S
        answers: list[bytes] = []
        try:
            if len(message) > self.max_message:
                raise ScpiError(-223, "Too much data")
            known, wrong = parsed(message)
            for unit in known:
                self._settle()
                answer = self._perform(unit)
                if answer is not None:
                    answers.append(answer)
            if wrong is not None:
                raise ScpiError(*wrong)
        except ScpiError as error:
            self.report(error.code, error.text)
        self._settle()
        return [(self._now, b";".join(answers) + b"\n")] if answers else []

    def clear(self, t: float) -> None:
        """Device clear: the parser is ready for a new message at `t`; settings and status stay."""
        self._now = min(self._now, t)
        self._complete_at = None
        self.abort()

    def power_cycle(self, t: float) -> None:
        """Power cycle: all settings are lost."""
        self._errors.clear()
        self._events, self._event_enable, self.service_enable = POWER_ON, 0, 0
        self._now, self._complete_at = t, None
        for group in self.groups.values():
            group.preset()
            group.event = 0
        self.preset()

    def report(self, code: int, text: str) -> None:
        """Put an error into the queue; the last place of a full queue reports the overflow."""
        if len(self._errors) >= ERRORS_KEPT:
            self._errors[-1] = (-350, "Queue overflow")
        else:
            self._errors.append((code, text))
        kinds = {1: COMMAND_ERROR, 2: EXECUTION_ERROR, 3: DEVICE_ERROR, 4: QUERY_ERROR}
        self._events |= kinds.get(-code // 100, DEVICE_ERROR)

    def status_byte(self) -> int:
        """IEEE 488.2 without MAV, which is the interface's: error queue, event registers, status groups."""
        status = (StatusByte.EAV if self._errors else 0) | (StatusByte.ESB if self._events & self._event_enable else 0)
        for name, bit in (("OPERation", StatusByte.OPER), ("QUEStionable", StatusByte.QUES)):
            status |= bit if self.groups[name].summary else 0
        return int(status | (StatusByte.SRQ if status & self.service_enable else 0))

    def _perform(self, unit: MessageUnit) -> bytes | None:
        action = self._commands.get((unit.header, unit.query))
        if action is None:
            plain = tuple(node.removesuffix("1") for node in unit.header)
            action = self._commands.get((plain, unit.query))
        if action is None:
            bare = tuple(node.rstrip("0123456789") for node in unit.header)
            if (bare, unit.query) in self._commands:
                raise ScpiError(-114, "Header suffix out of range")
            raise ScpiError(-113, "Undefined header")
        try:
            return action(unit)
        except ScpiError as error:
            if -200 < error.code <= -100:
                raise
            self.report(error.code, error.text)
            return None

    def _settle(self) -> None:
        """Finish operations that have ended."""
        self.refresh(self._now)
        if self._complete_at is not None and self._complete_at <= self._now:
            self._events |= OPERATION_COMPLETE
            self._complete_at = None

    def _wait(self) -> None:
        self._now = max(self._now, self.pending_until())

    # ---- common commands and status ----

    def _common(self) -> Iterator[Command]:
        yield "*IDN", True, bare(self._identity)
        yield "*RST", False, bare(self._restart)
        yield "*CLS", False, bare(self._clear_status)
        yield "*OPC", False, bare(self._when_complete)
        yield "*OPC", True, bare(self._complete)
        yield "*WAI", False, bare(self._wait)
        yield "*TST", True, bare(lambda: b"0")
        yield "*TRG", False, bare(self.trigger)
        yield "*ESR", True, bare(self._read_events)
        yield "*STB", True, bare(lambda: b"%d" % self.status_byte())
        yield "*ESE", False, self._enable_events
        yield "*ESE", True, bare(lambda: b"%d" % self._event_enable)
        yield "*SRE", False, self._enable_service
        yield "*SRE", True, bare(lambda: b"%d" % self.service_enable)
        yield "SYSTem:ERRor[:NEXT]", True, bare(self._next_error)
        yield "SYSTem:ERRor:COUNt", True, bare(lambda: b"%d" % len(self._errors))
        yield "SYSTem:VERSion", True, bare(lambda: self.version.encode())

    def _identity(self) -> bytes:
        return f"{self.manufacturer},{self.product},{self.serial_number},{self.firmware}".encode("ascii")

    def _status(self) -> Iterator[Command]:
        yield "STATus:PRESet", False, bare(self._preset_status)
        for name, group in self.groups.items():
            yield f"STATus:{name}[:EVENt]", True, bare(partial(_read_group, group))
            yield f"STATus:{name}:CONDition", True, bare(partial(_read_register, group, "condition"))
            for node, register in REGISTERS.items():
                yield f"STATus:{name}:{node}", True, bare(partial(_read_register, group, register))
                yield f"STATus:{name}:{node}", False, partial(_set_register, group, register)

    def _preset_status(self) -> None:
        for group in self.groups.values():
            group.preset()

    def _restart(self) -> None:
        self._complete_at = None
        self.preset()

    def _complete(self) -> bytes:
        self._wait()
        return b"1"

    def _when_complete(self) -> None:
        self._complete_at = max(self._now, self.pending_until())

    def _clear_status(self) -> None:
        self._errors.clear()
        self._events = 0
        self._complete_at = None
        for group in self.groups.values():
            group.event = 0

    def _read_events(self) -> bytes:
        events, self._events = self._events, 0
        return b"%d" % events

    def _enable_events(self, unit: MessageUnit) -> None:
        self._event_enable = mask(unit, 0xFF)

    def _enable_service(self, unit: MessageUnit) -> None:
        self.service_enable = mask(unit, 0xFF) & ~StatusByte.SRQ

    def _next_error(self) -> bytes:
        return encode_error(*(self._errors.popleft() if self._errors else (0, "No error")))


def _read_group(group: StatusGroup) -> bytes:
    return b"%d" % group.read()


def _read_register(group: StatusGroup, register: str) -> bytes:
    return b"%d" % getattr(group, register)


def _set_register(group: StatusGroup, register: str, unit: MessageUnit) -> None:
    setattr(group, register, mask(unit, 0x7FFF))


def bare(action: Callable[[], bytes | None]) -> Action:
    """A command that takes no parameter: one that has some is refused with -108, and nothing is done."""

    def act(unit: MessageUnit) -> bytes | None:
        if unit.parameters:
            raise ScpiError(-108, "Parameter not allowed")
        return action()

    return act


def single(unit: MessageUnit) -> str:
    """The one parameter of a command. Raises ScpiError -109 or -108."""
    if not unit.parameters:
        raise ScpiError(-109, "Missing parameter")
    if len(unit.parameters) > 1:
        raise ScpiError(-108, "Parameter not allowed")
    return unit.parameters[0]


def number(unit: MessageUnit, lowest: float, highest: float, default: float, factors: Mapping[str, float]) -> float:
    """The one number of a command with its suffix, or MIN, MAX or DEF. Raises ScpiError."""
    text = single(unit)
    named = {"MINimum": lowest, "MAXimum": highest, "DEFault": default}
    for pattern, value in named.items():
        if text.upper() in words(pattern):
            return value
    value = decode_quantity(text, factors)
    if math.isnan(value) or not lowest <= value <= highest:
        raise ScpiError(-222, "Data out of range")
    return value


def limit(unit: MessageUnit, lowest: float, highest: float, default: float, now: float) -> float:
    """Value for a query: the present value, or with MIN, MAX or DEF a limit. Raises ScpiError."""
    if not unit.parameters:
        return now
    if single(unit).upper() not in (*words("MINimum"), *words("MAXimum"), *words("DEFault")):
        raise ScpiError(-224, "Illegal parameter value")
    return number(unit, lowest, highest, default, {})


def switch(unit: MessageUnit) -> bool:
    """ON, OFF or a number, of which 0 is off. Raises ScpiError."""
    text = single(unit).upper()
    if text in ("ON", "OFF"):
        return text == "ON"
    try:
        return round(decode_quantity(text, {})) != 0
    except (ScpiError, OverflowError):
        raise ScpiError(-224, "Illegal parameter value") from None


def mask(unit: MessageUnit, highest: int) -> int:
    """A register's new value. Raises ScpiError."""
    return round(number(unit, 0, highest, 0, {}))
