"""Clients of a served rig, each a process of its own: `python -m tests.system.serve_clients KIND SECONDS ADDRESS ...`.

A client connects, sends requests, checks the answers, disconnects (every other time in the middle of a request), and starts
again. It prints TALKING after its first exchange, and at the end its counts as JSON. The clients do not use the drivers of
the program: they send plain bytes with pyserial and sockets.
"""

import contextlib
import hmac
import json
import secrets
import socket
import struct
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager

import serial

from goniotwin.protocols.clock import RealClock
from goniotwin.protocols.tmcl import Command, CommandFrame, FrameError, ReplyFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter

QUESTIONS = 25
TALKING = "talking"
TIMEOUT_S = 2.0
PAUSE_S = 0.002
"""Of a client in a process of its own, after each exchange: four of them would take the processor from other tests."""
LINGER_NOT = struct.pack("ii", 1, 0)
Line = AbstractContextManager[serial.Serial]


class WrongAnswer(Exception):
    """A wrong answer, or no answer."""


def open_line(address: str, baudrate: int) -> Line:
    """Open `HOST:PORT` over TCP, or the serial port of another name."""
    host, separator, port = address.rpartition(":")
    url = f"socket://{host}:{port}" if separator and port.isdigit() else address
    return contextlib.closing(serial.serial_for_url(url, baudrate=baudrate, timeout=TIMEOUT_S))


def tmcl(address: str, abrupt: bool) -> Iterator[None]:
    """Move the arc and read its position."""
    with open_line(address, 115200) as port:
        port.reset_input_buffer()
        for number in range(QUESTIONS):
            move = CommandFrame(1, Command.MVP, 0, 5, 100 * number)
            request = (
                CommandFrame(1, Command.GGP, 254, 2),
                CommandFrame(1, Command.GAP, AxisParameter.ACTUAL_POSITION, 5),
                move,
            )[number % 3]
            port.write(request.encode())
            answer = port.read(9)
            try:
                if ReplyFrame.decode(answer).command != request.command:
                    raise WrongAnswer(f"{request}: {answer.hex(' ')}")
            except FrameError as error:
                raise WrongAnswer(f"{request}: {answer.hex(' ')}: {error}") from None
            yield
        if abrupt:
            port.write(request.encode()[:4])


def cornerstone(address: str, abrupt: bool) -> Iterator[None]:
    """Read the wavelength; the line echoes."""
    with open_line(address, 9600) as port:
        port.write(b"\n")  # ends an unfinished command of an earlier client
        port.reset_input_buffer()
        for _ in range(QUESTIONS):
            port.write(b"WAVE?\n")
            lines = [port.read_until(b"\n") for _ in range(2)]
            while lines[0] != b"WAVE?\n":  # the answer to the unfinished command
                lines = [lines[1], port.read_until(b"\n")]
                if not lines[1]:
                    raise WrongAnswer(f"WAVE?: {lines}")
            if not 0.0 < float(lines[1]) < 1000.0:
                raise WrongAnswer(f"WAVE?: {lines}")
            yield
        if abrupt:
            port.write(b"WAV")


def modbus(address: str, abrupt: bool) -> Iterator[None]:
    """Read eight channels."""
    host, _, port = address.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=TIMEOUT_S) as connection:
        for number in range(QUESTIONS):
            connection.sendall(struct.pack(">HHHBBHH", number, 0, 6, 1, 3, 0, 8))
            answer = b""
            while len(answer) < 25:
                piece = connection.recv(64)
                if not piece:
                    raise WrongAnswer(f"closed after {answer.hex(' ')}")
                answer += piece
            if answer[:9] != struct.pack(">HHHBBB", number, 0, 19, 1, 3, 16):
                raise WrongAnswer(answer.hex(" "))
            yield
        if abrupt:
            connection.sendall(b"\0\1\0\0\0\6\1\3")
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER_NOT)


def control(address: str, abrupt: bool) -> Iterator[None]:
    """Read the state from the simulation control port at `HOST:PORT/TOKEN`, and mount a sample."""
    place, _, token = address.partition("/")
    host, _, port = place.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=TIMEOUT_S) as connection, connection.makefile("rb") as answers:
        own = secrets.token_hex(32)
        connection.sendall(json.dumps({"protocol": 2, "nonce": own}).encode() + b"\n")
        first = json.loads(answers.readline())
        right, mine = (
            hmac.digest(token.encode(), f"goniotwin 2 {role} {port} {own} {first['nonce']}".encode(), "sha256").hex()
            for role in ("server", "client")
        )
        if first["protocol"] != 2 or first["proof"] != right:
            raise WrongAnswer("it does not have the token")
        connection.sendall(json.dumps({"proof": mine}).encode() + b"\n")
        for number in range(QUESTIONS):
            connection.sendall(b'{"do": "state"}\n' if number % 2 else b'{"do": "mount", "sample": "etalon"}\n')
            if json.loads(answers.readline()).get("ok") is not True:
                raise WrongAnswer("refused")
            yield
        if abrupt:
            connection.sendall(b'{"do": "sta')
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER_NOT)


KINDS: dict[str, Callable[[str, bool], Iterator[None]]] = {
    "tmcl": tmcl,
    "cornerstone": cornerstone,
    "modbus": modbus,
    "control": control,
}


def talk(kind: str, seconds: float, addresses: list[str], pause_s: float = 0.0) -> dict[str, int]:
    """Visit the addresses in turn; count exchanges, connections, and failures caused by killed clients on the same line."""
    clock, done = RealClock(), Counter[str](exchanges=0, connections=0, disturbed=0)
    while clock.now() < seconds:
        number = done["connections"]
        done["connections"] += 1
        abrupt = bool(number // len(addresses) % 2)
        try:
            for _ in KINDS[kind](addresses[number % len(addresses)], abrupt):
                if not done["exchanges"]:
                    print(TALKING, flush=True)
                done["exchanges"] += 1
                clock.sleep_until(clock.now() + pause_s)
        except (WrongAnswer, OSError, ValueError) as error:
            done["disturbed"] += 1
            print(f"{kind} at {addresses[number % len(addresses)]}: {error}", file=sys.stderr)
            abrupt = True
        if abrupt:
            clock.sleep_until(clock.now() + 0.1)  # longer than an incomplete frame is kept
    return dict(done)


if __name__ == "__main__":
    print(json.dumps(talk(sys.argv[1], float(sys.argv[2]), sys.argv[3:], PAUSE_S)))
