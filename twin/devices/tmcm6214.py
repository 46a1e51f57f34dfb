"""A Trinamic TMCM-6214: six motors on one serial line, in binary TMCL."""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from protocols.tmcl import (
    FRAME_BYTES,
    HOST_ADDRESS,
    Command,
    FrameError,
    MoveType,
    Reply,
    Request,
    Status,
    encode_version_text,
    version_number,
)
from twin.devices.motor import Motor, Rejected
from twin.plant import Plant
from twin.plant.noise import normal, process_key

MODULE = 6214
FIRMWARE = (1, 17)
MOTORS = 6
IDLE_GAP_S = 0.05
ENCODER_PERIOD_S = 1.0e-3
GLOBALS = {(0, 65): 7, (0, 66): 1, (0, 68): 0, (0, 75): 0, (0, 76): HOST_ADDRESS, (0, 77): 0, (0, 128): 0, (0, 255): 0}


class Tmcm6214:
    """The module's firmware: frames in, frames out. Any module address is answered, as over USB."""

    def __init__(self, plant: Plant) -> None:
        controller = plant.model.controller
        self.baudrate = controller.baudrate
        self.outbox: deque[tuple[float, bytes]] = deque()
        self._latency_s = controller.latency_s
        self._partial = b""
        self._last_byte = -math.inf
        self._globals = dict(GLOBALS)
        self._globals[0, 66] = controller.address
        self.motors = [Motor(None, None) for _ in range(MOTORS)]
        for name, shaft in plant.shafts.items():
            mechanics = shaft.mechanics
            encoder = _encoder(plant, name) if mechanics.encoder else None
            self.motors[mechanics.motor] = Motor(shaft, encoder)

    def receive(self, data: bytes, t: float) -> None:
        """Bytes of which the last has arrived at `t`; a frame begun before a pause is forgotten."""
        if t - self._last_byte > IDLE_GAP_S:
            self._partial = b""
        self._last_byte = t
        self._partial += data
        while len(self._partial) >= FRAME_BYTES:
            frame, self._partial = self._partial[:FRAME_BYTES], self._partial[FRAME_BYTES:]
            self.outbox.append((t + self._latency_s, self._answer(frame, t)))

    def _answer(self, frame: bytes, t: float) -> bytes:
        host, address = self._globals[0, 76], self._globals[0, 66]
        try:
            request = Request.decode(frame)
        except FrameError:
            return Reply(host, address, Status.WRONG_CHECKSUM, frame[1], 0).encode()
        if request.command == Command.FIRMWARE_VERSION and request.type == 0:
            return encode_version_text(host, f"{MODULE}V{FIRMWARE[0]}{FIRMWARE[1]:02d}")
        try:
            value, status = self._execute(request, t), Status.OK
        except Rejected as rejected:
            value, status = 0, rejected.status
        return Reply(host, address, status, request.command, value).encode()

    def _execute(self, request: Request, t: float) -> int:
        match request.command:
            case Command.FIRMWARE_VERSION:
                return version_number(MODULE, *FIRMWARE)
            case Command.SGP | Command.GGP:
                return self._global(request)
        actions: dict[int, Callable[[Motor], int]] = {
            Command.ROR: lambda motor: _turn(motor, request.value, request.value, t),
            Command.ROL: lambda motor: _turn(motor, -request.value, request.value, t),
            Command.MST: lambda motor: _turn(motor, 0, 0, t),
            Command.MVP: lambda motor: _move(motor, request, t),
            Command.SAP: lambda motor: _set(motor, request, t),
            Command.GAP: lambda motor: motor.get(request.type, t),
        }
        action = actions.get(request.command)
        if action is None:
            raise Rejected(Status.INVALID_COMMAND)
        if request.motor >= MOTORS:
            raise Rejected(Status.INVALID_VALUE)
        return action(self.motors[request.motor])

    def _global(self, request: Request) -> int:
        key = (request.motor, request.type)
        if key not in self._globals:
            raise Rejected(Status.WRONG_TYPE)
        if request.command == Command.SGP:
            self._globals[key] = request.value
        return self._globals[key]


def _turn(motor: Motor, velocity: int, answer: int, t: float) -> int:
    motor.turn(velocity, t)
    return answer


def _move(motor: Motor, request: Request, t: float) -> int:
    if request.type == MoveType.ABSOLUTE:
        return motor.move_to(request.value, t)
    if request.type == MoveType.RELATIVE:
        return motor.move_by(request.value, t)
    raise Rejected(Status.WRONG_TYPE)


def _set(motor: Motor, request: Request, t: float) -> int:
    motor.set(request.type, request.value, t)
    return request.value


def _encoder(plant: Plant, axis: str) -> Callable[[float], float]:
    """The encoder of an axis: it sits on the shaft, counts in microsteps of 1/256 of the motor's full step, and is noisy."""
    shaft = plant.shafts[axis]
    noise = plant.model.controller.encoder_noise_microsteps if plant.model.noise else 0.0
    key = process_key(plant.model.seed, f"encoder {axis}")

    def read(t: float) -> float:
        turned = shaft.angle_deg(t) - shaft.mechanics.zero_deg
        microsteps = turned / shaft.mechanics.deg_per_full_step * 256.0
        return microsteps + noise * normal(key, np.int64(math.floor(t / ENCODER_PERIOD_S)))

    return read
