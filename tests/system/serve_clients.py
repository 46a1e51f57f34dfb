"""Clients of a served rig, each a process of its own: `python -m tests.system.serve_clients KIND SECONDS PLACE ...`.

They connect, ask, check the answers, leave (every other time without a word, in the midst of a question), and begin again.
They print a word once they have been answered, and in the end as JSON how often. They are none of our drivers: plain
bytes, on pyserial and sockets.
"""

import contextlib
import json
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
LINGER_NOT = struct.pack("ii", 1, 0)
Line = AbstractContextManager[serial.Serial]


class Wrong(Exception):
    """An answer that is none, or none at all."""


def opened(place: str, baudrate: int) -> Line:
    """`HOST:PORT` over TCP, anything else is a port's name."""
    host, separator, port = place.rpartition(":")
    url = f"socket://{host}:{port}" if separator and port.isdigit() else place
    return contextlib.closing(serial.serial_for_url(url, baudrate=baudrate, timeout=TIMEOUT_S))


def tmcl(place: str, rude: bool) -> Iterator[None]:
    """Sends the arc about and asks where it is."""
    with opened(place, 115200) as port:
        port.reset_input_buffer()
        for number in range(QUESTIONS):
            moved = CommandFrame(1, Command.MVP, 0, 5, 100 * number)
            asked = (
                CommandFrame(1, Command.GGP, 254, 2),
                CommandFrame(1, Command.GAP, AxisParameter.ACTUAL_POSITION, 5),
                moved,
            )[number % 3]
            port.write(asked.encode())
            answer = port.read(9)
            try:
                if ReplyFrame.decode(answer).command != asked.command:
                    raise Wrong(f"{asked}: {answer.hex(' ')}")
            except FrameError as error:
                raise Wrong(f"{asked}: {answer.hex(' ')}: {error}") from None
            yield
        if rude:
            port.write(asked.encode()[:4])


def cornerstone(place: str, rude: bool) -> Iterator[None]:
    """Asks for the wavelength; the line echoes."""
    with opened(place, 9600) as port:
        port.write(b"\n")  # ends what somebody else has left unfinished
        port.reset_input_buffer()
        for _ in range(QUESTIONS):
            port.write(b"WAVE?\n")
            lines = [port.read_until(b"\n") for _ in range(2)]
            while lines[0] != b"WAVE?\r\n":  # what the unit had to say to the unfinished line
                lines = [lines[1], port.read_until(b"\n")]
                if not lines[1]:
                    raise Wrong(f"WAVE?: {lines}")
            if not 0.0 < float(lines[1]) < 1000.0:
                raise Wrong(f"WAVE?: {lines}")
            yield
        if rude:
            port.write(b"WAV")


def modbus(place: str, rude: bool) -> Iterator[None]:
    """Reads eight channels."""
    host, _, port = place.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=TIMEOUT_S) as connection:
        for number in range(QUESTIONS):
            connection.sendall(struct.pack(">HHHBBHH", number, 0, 6, 1, 3, 0, 8))
            answer = b""
            while len(answer) < 25:
                piece = connection.recv(64)
                if not piece:
                    raise Wrong(f"closed after {answer.hex(' ')}")
                answer += piece
            if answer[:9] != struct.pack(">HHHBBB", number, 0, 19, 1, 3, 16):
                raise Wrong(answer.hex(" "))
            yield
        if rude:
            connection.sendall(b"\0\1\0\0\0\6\1\3")
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER_NOT)


def control(place: str, rude: bool) -> Iterator[None]:
    """Asks the back door for the state, and mounts."""
    host, _, port = place.rpartition(":")
    with socket.create_connection((host, int(port)), timeout=TIMEOUT_S) as connection, connection.makefile("rb") as answers:
        for number in range(QUESTIONS):
            connection.sendall(b'{"do": "state"}\n' if number % 2 else b'{"do": "mount", "sample": "etalon"}\n')
            if json.loads(answers.readline()).get("ok") is not True:
                raise Wrong("refused")
            yield
        if rude:
            connection.sendall(b'{"do": "sta')
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER_NOT)


KINDS: dict[str, Callable[[str, bool], Iterator[None]]] = {
    "tmcl": tmcl, "cornerstone": cornerstone, "modbus": modbus, "control": control,
}  # fmt: skip


def talk(kind: str, seconds: float, places: list[str]) -> dict[str, int]:
    """Visits the places in turns; what others have disturbed (they are killed on the same line) is counted, and gone over."""
    clock, done = RealClock(), Counter[str](exchanges=0, connections=0, disturbed=0)
    while clock.now() < seconds:
        number = done["connections"]
        done["connections"] += 1
        rude = bool(number // len(places) % 2)
        try:
            for _ in KINDS[kind](places[number % len(places)], rude):
                if not done["exchanges"]:
                    print(TALKING, flush=True)
                done["exchanges"] += 1
        except (Wrong, OSError, ValueError) as error:
            done["disturbed"] += 1
            print(f"{kind} at {places[number % len(places)]}: {error}", file=sys.stderr)
            rude = True
        if rude:
            clock.sleep_until(clock.now() + 0.1)  # longer than half a frame lives
    return dict(done)


if __name__ == "__main__":
    print(json.dumps(talk(sys.argv[1], float(sys.argv[2]), sys.argv[3:])))
