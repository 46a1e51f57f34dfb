"""Trinamic's motion modules: the TMCM-6214 with six motors, the TMCM-1240 with one. Their firmware, frame by frame.

Source: TMCL firmware manuals; what of it could not be read there is marked (*) and is to be confirmed on hardware: that
bank 0's parameters 64 to 127 go to EEPROM as they are set, that suppressed replies begin with the command that sets
them, the unit of the telegram pause (ms), and the states of a stand-alone program (there is none, so none runs).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, ClassVar

from goniotwin.protocols.tmcl import (
    HOST_ADDRESS,
    Command,
    CommandFrame,
    FrameError,
    MoveType,
    ReplyFrame,
    ReplyStatus,
    encode_version_text,
    pack,
    unpack,
    version_number,
)
from goniotwin.protocols.tmcl_parameters import BAUD_RATES, GlobalParameter
from goniotwin.twin.devices.axis_table import TMCM_1240, TMCM_6214, Parameter
from goniotwin.twin.devices.encoder import Encoder
from goniotwin.twin.devices.globals import Globals
from goniotwin.twin.devices.motor import Motor
from goniotwin.twin.devices.ramp_generator import CommandRejected
from goniotwin.twin.plant import AxisController
from goniotwin.twin.plant.shaft import Heartbeat

if TYPE_CHECKING:
    from goniotwin.twin.plant import Plant

FACTORY_RESET_CODE, FACTORY_RESET_S = 1234, 5.0
SUPPLY_DECIVOLT, TEMPERATURE_C = 240, 30
COORDINATES = 21
FRAMES_KEPT = 1024
OUTPUTS = 8
EVENT_AFTER_S = 2.0e-3
OK, GAP, GGP = int(ReplyStatus.OK), int(Command.GAP), int(Command.GGP)
Post = Callable[[float, bytes], None]
Withdraw = Callable[[bytes], None]
Answers = list[tuple[float, bytes]]


_fields, _packed = lru_cache(FRAMES_KEPT)(unpack), lru_cache(FRAMES_KEPT)(pack)
"""The host asks the same again and again, and most replies are the same."""


class UnsolicitedReply(bytes):
    """A frame without a preceding request."""


@dataclass(frozen=True)
class ModuleKind:
    """A product."""

    number: int
    firmware: tuple[int, int]
    motors: int
    table: dict[int, Parameter]


MODULE_KINDS = {
    "tmcm-6214": ModuleKind(6214, (1, 17), 6, TMCM_6214),
    "tmcm-1240": ModuleKind(1240, (1, 45), 1, TMCM_1240),
}


class MotionModule:
    """One module, with its axes by the numbers of their motors. On RS485 it answers to its own address only, over USB to any.

    `post` sends unsolicited replies, `withdraw` takes one back.
    """

    def __init__(
        self,
        plant: "Plant",
        controller: AxisController,
        axes: Mapping[int, str],
        address: int,
        post: Post,
        withdraw: Withdraw,
    ) -> None:
        self.kind = MODULE_KINDS[controller.kind]
        self._strict = controller.wire == "rs485"
        self._encoder_noise = controller.encoder_noise_microsteps
        self._post = post
        self._withdraw = withdraw
        self._address = address
        baudrate = controller.baudrate
        self._factory: dict[int, int] = {
            GlobalParameter.ADDRESS: address,
            GlobalParameter.HOST_ADDRESS: HOST_ADDRESS,
            GlobalParameter.BAUD_RATE: BAUD_RATES.index(baudrate) if baudrate in BAUD_RATES else 0,
        }
        self.globals = Globals(dict(self._factory))
        self._heartbeat = Heartbeat()
        self._dead_until = -math.inf
        self._coordinates: dict[tuple[int, int], int] = {}
        self._outputs = [0] * OUTPUTS
        self._event: UnsolicitedReply | None = None
        self._event_mask = 0
        self._event_due = math.inf
        for motor, name in axes.items():
            if motor >= self.kind.motors:
                number, motors = self.kind.number, self.kind.motors
                raise ValueError(f"{name} is motor {motor} of module {address}, and a TMCM-{number} has {motors}")
        self.motors = [self._motor(plant, axes.get(number)) for number in range(self.kind.motors)]

    def _motor(self, plant: "Plant", name: str | None) -> Motor:
        shaft = plant.shafts[name] if name is not None else None
        with_encoder = name is not None and plant.shafts[name].mechanics.encoder
        encoder = Encoder(plant, name, self._encoder_noise) if name is not None and with_encoder else None
        return Motor(shaft, encoder, self.kind.table, self._heartbeat)

    def reset(self, t: float) -> None:
        """The power was away for a moment: EEPROM's settings hold, counters are 0, and nothing turns any more."""
        self.globals.reset(t)
        self._heartbeat.until = math.inf
        self._coordinates.clear()
        self._outputs = [0] * OUTPUTS
        self._event_mask = 0
        for motor in self.motors:
            motor.reset(t)

    def answer(self, frame: bytes, t: float) -> Answers:
        """Reply to a frame that arrived at `t`: none or one, with its delay."""
        settings = self.globals.reply
        if t < self._dead_until or (self._strict and frame[0] != settings.address):  # not for it
            return []
        if t > self._heartbeat.until:
            self._miss_heartbeat()
        self._extend_heartbeat(t, settings.heartbeat_ms)
        if self._event is not None and self._event_due <= t:  # it has been sent, and one is all that was asked for
            self._event, self._event_mask, self._event_due = None, 0, math.inf
        host, address = settings.host & 0xFF, settings.address & 0xFF
        reply = self._reply(frame, t, host, address)
        if self._event_mask or self._event is not None:
            self._plan_event(t, host, address)
        settings = self.globals.reply
        return [] if reply is None or settings.suppressed else [(settings.pause_ms * 1.0e-3, reply)]

    def _reply(self, frame: bytes, t: float, host: int, address: int) -> bytes | None:
        try:
            fields = _fields(frame)
        except FrameError:
            return pack(host, address, ReplyStatus.WRONG_CHECKSUM, frame[1], 0)
        _, command, number, bank, value = fields
        status = OK
        try:
            if command == GGP:
                value = self.globals.get(bank, number, t)
            elif command == GAP and bank < len(self.motors):
                value = self.motors[bank].get(number, t)
            elif command == Command.FIRMWARE_VERSION and number == 0:
                major, minor = self.kind.firmware
                return encode_version_text(host, f"{self.kind.number}V{major}{minor:02d}")
            elif command == Command.FACTORY_RESET and value == FACTORY_RESET_CODE:
                self._factory_reset(t)
                return None
            else:
                value = self._execute(CommandFrame(*fields), t)
        except CommandRejected as rejected:
            value, status = 0, rejected.status
        return _packed(host, address, status, command, value)

    def _factory_reset(self, t: float) -> None:
        self.globals = Globals(dict(self._factory))
        for motor in self.motors:
            motor.factory_reset(t)
        self.reset(t)
        self._dead_until = t + FACTORY_RESET_S

    def _miss_heartbeat(self) -> None:
        """Stop the motors at the time of a missed heartbeat."""
        for motor in self.motors:
            if motor.is_moving(self._heartbeat.until):
                motor.turn(0, self._heartbeat.until)

    def _extend_heartbeat(self, t: float, heartbeat_ms: int) -> None:
        self._heartbeat.until = t + heartbeat_ms * 1.0e-3 if heartbeat_ms > 0 else math.inf

    def _execute(self, request: CommandFrame, t: float) -> int:
        number, bank, value = request.type, request.motor, request.value
        if request.command in self._actions:
            return self._with_motor(request, t)
        match request.command:
            case Command.FIRMWARE_VERSION:
                return version_number(self.kind.number, *self.kind.firmware)
            case Command.SGP:
                self.globals.set(bank, number, value, t)
                self._extend_heartbeat(t, self.globals.reply.heartbeat_ms)
                return value
            case Command.GGP:
                return self.globals.get(bank, number, t)
            case Command.STGP | Command.RSGP:
                self.globals.store(bank, number, restore=request.command == Command.RSGP)
                return 0
            case Command.SIO | Command.GIO:
                return self._port(request)
            case Command.RUN_APPLICATION | Command.STOP_APPLICATION | Command.RESET_APPLICATION:
                self.globals.run(request.command)
                return 0
            case Command.APPLICATION_STATUS:
                return self.globals.get(0, GlobalParameter.APPLICATION_STATUS, t)
            case Command.REQUEST_TARGET_REACHED:
                if not 0 <= value < 1 << len(self.motors):
                    raise CommandRejected(ReplyStatus.INVALID_VALUE)
                self._event_mask = value
                return value
            case Command.GET_INFO:
                raise CommandRejected(ReplyStatus.NOT_AVAILABLE)  # newer firmware has it
            case Command.FACTORY_RESET:
                raise CommandRejected(ReplyStatus.INVALID_VALUE)
        raise CommandRejected(ReplyStatus.INVALID_COMMAND)

    def _with_motor(self, request: CommandFrame, t: float) -> int:
        if request.motor >= len(self.motors):
            raise CommandRejected(ReplyStatus.INVALID_VALUE)
        if request.command == Command.STAP and self.globals.locked:
            raise CommandRejected(ReplyStatus.EEPROM_LOCKED)
        return self._actions[request.command](self, self.motors[request.motor], request, t)

    def _turn(self, motor: Motor, request: CommandFrame, t: float) -> int:
        stop = request.command == Command.MST
        motor.turn(0 if stop else -request.value if request.command == Command.ROL else request.value, t)
        return 0 if stop else request.value

    def _move(self, motor: Motor, request: CommandFrame, t: float) -> int:
        match request.type:
            case MoveType.ABSOLUTE:
                return motor.move_to(request.value, t)
            case MoveType.RELATIVE:
                return motor.move_by(request.value, t)
            case MoveType.COORDINATE if 0 <= request.value < COORDINATES:
                return motor.move_to(self._coordinates.get((request.motor, request.value), 0), t)
            case MoveType.COORDINATE:
                raise CommandRejected(ReplyStatus.INVALID_VALUE)
        raise CommandRejected(ReplyStatus.WRONG_TYPE)

    def _coordinate(self, motor: Motor, request: CommandFrame, t: float) -> int:
        key = (request.motor, request.type)
        if request.type >= COORDINATES:
            raise CommandRejected(ReplyStatus.WRONG_TYPE)
        if request.command == Command.SCO:
            self._coordinates[key] = request.value
        elif request.command == Command.CCO:
            self._coordinates[key] = round(motor.position(t))
        return self._coordinates.get(key, 0)

    def _parameter(self, motor: Motor, request: CommandFrame, t: float) -> int:
        if request.command == Command.GAP:
            return motor.get(request.type, t)
        if request.command == Command.SAP:
            motor.set(request.type, request.value, t)
            return request.value
        motor.store(request.type, restore=request.command == Command.RSAP, t=t)
        return 0

    def _search(self, motor: Motor, request: CommandFrame, t: float) -> int:
        return motor.search(request.type, t)

    _actions: ClassVar[dict[int, Callable[["MotionModule", Motor, CommandFrame, float], int]]] = {
        Command.ROR: _turn,
        Command.ROL: _turn,
        Command.MST: _turn,
        Command.MVP: _move,
        Command.RFS: _search,
        Command.SAP: _parameter,
        Command.GAP: _parameter,
        Command.STAP: _parameter,
        Command.RSAP: _parameter,
        Command.SCO: _coordinate,
        Command.GCO: _coordinate,
        Command.CCO: _coordinate,
    }

    def _port(self, request: CommandFrame) -> int:
        number, bank = request.type, request.motor
        if request.command == Command.SIO:
            if bank not in (0, 2):
                raise CommandRejected(ReplyStatus.INVALID_VALUE)
            if request.value not in (0, 1):
                raise CommandRejected(ReplyStatus.INVALID_VALUE)
            if bank == 2:
                if number >= OUTPUTS:
                    raise CommandRejected(ReplyStatus.WRONG_TYPE)
                self._outputs[number] = request.value
            return request.value
        if bank == 1:
            known = {0: 0, 4: 0, 8: SUPPLY_DECIVOLT, 9: TEMPERATURE_C}
            if number not in known:
                raise CommandRejected(ReplyStatus.WRONG_TYPE)
            return known[number]
        if bank not in (0, 2):
            raise CommandRejected(ReplyStatus.INVALID_VALUE)
        if number >= OUTPUTS:
            raise CommandRejected(ReplyStatus.WRONG_TYPE)
        return self._outputs[number] if bank == 2 else 0

    def _plan_event(self, t: float, host: int, address: int) -> None:
        """The one frame that reports the arrival of all motors of the mask, with its time."""
        if not self._event_mask and self._event is None:
            return
        planned, self._event_due = self._event_due, math.inf
        if self._event is not None:
            self._withdraw(self._event)
            self._event = None
        arrivals = [motor.arrival() for number, motor in enumerate(self.motors) if self._event_mask >> number & 1]
        if not arrivals or any(arrival is None for arrival in arrivals):
            return
        self._event_due = max(min(planned, t + EVENT_AFTER_S), *(arrival for arrival in arrivals if arrival is not None))
        reply = ReplyFrame(host, address, ReplyStatus.TARGET_REACHED, Command.REQUEST_TARGET_REACHED, self._event_mask)
        self._event = UnsolicitedReply(reply.encode())
        self._post(self._event_due, self._event)
