"""What may be said twice on a TMCL line, what sets a motor in motion, which reply is believed, and frames in words.

The user variables of which the driver makes use are lost with the power: the canary, the marker, and for each motor a mark
whether somebody knows where its axis is.
"""

from collections.abc import Callable

from goniotwin.drivers.errors import BadAnswer, Refused
from goniotwin.drivers.tap import TO_DEVICE
from goniotwin.protocols.tmcl import HOST_ADDRESS, Axis, Command, FrameError, MoveType, Reply, Request, Status
from goniotwin.protocols.tmcl_parameters import USER_BANK, Search

ECHOING = frozenset({Command.SAP, Command.SGP, Command.ROR, Command.ROL, Command.MST})
REPEATABLE = frozenset({Command.GAP, Command.GGP, Command.SAP, Command.SGP, Command.MST, Command.FIRMWARE_VERSION})

FIRST_MARK_VARIABLE, CANARY_VARIABLE, MARKER_VARIABLE = 248, 254, 255
MOTORS = 6
CANARY, FIRST_MARKER = 0x676F_6E69, 0x4D41_0000
KNOWN, DOUBTED = 0x6B6E_6F77, 0x646F_7562
"""What a mark may be; after a power-up it is neither."""


def mark(address: int, motor: int, value: int | None = None) -> Request:
    """Asks for the mark of a motor, or sets it."""
    command = Command.GGP if value is None else Command.SGP
    return Request(address, command, FIRST_MARK_VARIABLE + motor, USER_BANK, value or 0)


def doubts(address: int) -> list[Request]:
    """Sets the marks of all motors of a module to in doubt."""
    return [mark(address, motor, DOUBTED) for motor in range(MOTORS)]


def repeatable(request: Request) -> bool:
    """Whether a request may happen twice. Reading the error flags clears them, so that they are read once."""
    match request.command:
        case Command.MVP:
            return request.type == MoveType.ABSOLUTE
        case Command.RFS:
            return request.type != Search.START
        case Command.GAP:
            return request.type != Axis.ERROR_FLAGS
    return request.command in REPEATABLE


def moves(request: Request) -> bool:
    """Whether a request sets a motor in motion."""
    match request.command:
        case Command.MVP | Command.ROR | Command.ROL:
            return True
        case Command.RFS:
            return request.type == Search.START
        case Command.SAP:
            return request.type in (Axis.TARGET_POSITION, Axis.TARGET_VELOCITY)
    return False


def believed(request: Request, frame: bytes, words: Callable[[Request], str]) -> Reply | None:
    """The reply to a request, or None for one that belongs to another. Raises BadAnswer and Refused, in its `words`."""
    try:
        reply = Reply.decode(frame)
    except FrameError as error:
        raise BadAnswer("axes", words(request), str(error)) from None
    if reply.host != HOST_ADDRESS or reply.address != request.address:
        return None
    if reply.status == Status.WRONG_CHECKSUM:
        raise BadAnswer("axes", words(request), "the request was garbled on its way")
    if reply.command != request.command or reply.status == Status.TARGET_REACHED:
        return None
    if reply.status != Status.OK:
        raise Refused("axes", words(request), f"the module answers: {reply}")
    echoes = request.command in ECHOING or (request.command == Command.MVP and request.type == MoveType.ABSOLUTE)
    return None if echoes and reply.value != request.value else reply


def explain(direction: str, data: bytes) -> str:
    """A frame in words, for transcripts."""
    try:
        return str(Request.decode(data) if direction == TO_DEVICE else Reply.decode(data))
    except FrameError as error:
        return str(error)
