"""Rules of a TMCL line: which requests may be repeated, which start a motion, which reply is accepted; frames as text.

The driver uses user variables that are lost with the power: the canary, the marker, and for each motor a mark of whether
its axis is referenced.
"""

from collections.abc import Callable

from goniotwin.drivers.errors import BadAnswer, Refused
from goniotwin.drivers.tap import TO_DEVICE
from goniotwin.protocols.tmcl import (
    HOST_ADDRESS,
    Command,
    CommandFrame,
    FrameError,
    MoveType,
    ReplyFrame,
    ReplyStatus,
)
from goniotwin.protocols.tmcl_parameters import USER_BANK, AxisParameter, SearchCommand

WRITES: dict[int, Command] = {Command.GAP: Command.SAP, Command.GGP: Command.SGP}
READS = {write.name: read for read, write in WRITES.items()}
ECHOING = frozenset({Command.SAP, Command.SGP, Command.ROR, Command.ROL, Command.MST})
REPEATABLE = frozenset({Command.GAP, Command.GGP, Command.SAP, Command.SGP, Command.MST, Command.FIRMWARE_VERSION})

FIRST_MARK_VARIABLE, CANARY_VARIABLE, MARKER_VARIABLE = 248, 254, 255
MOTORS = 6
CANARY, FIRST_MARKER = 0x676F_6E69, 0x4D41_0000
"""The canary of a rig in this process, which no other program can take; otherwise it is a random number of the session."""
DISTURBED = "check cable and grounding"
NO_SUCH_COMMAND = "check that the module is a TMCM-6214 or TMCM-1240; update its firmware"
REMEDIES: dict[int, str] = {
    ReplyStatus.INVALID_COMMAND: NO_SUCH_COMMAND,
    ReplyStatus.WRONG_TYPE: f"check the number of the motor in the rig file; {NO_SUCH_COMMAND}",
    ReplyStatus.INVALID_VALUE: "the module does not take this value: correct the table of the axis in the rig file",
    ReplyStatus.EEPROM_LOCKED: "unlock the module's settings: set its global parameter 73 to 4321, with the maker's TMCL-IDE",
    ReplyStatus.NOT_AVAILABLE: "end the program that runs in the module, with the maker's TMCL-IDE",
    ReplyStatus.MAXIMUM_EXCEEDED: "the value is too great for the module: correct the table of the axis in the rig file",
}
"""What to do about the status with which a module refuses a command."""
REFERENCED, UNREFERENCED, RESET = 0x6B6E_6F77, 0x646F_7562, 0x6C6F_7374
"""The values of a mark; after a power-up it has none of them. RESET: unreferenced, and the encoder's counter is lost too."""


def mark(address: int, motor: int, value: int | None = None) -> CommandFrame:
    """The request that reads the mark of a motor, or sets it to `value`."""
    command = Command.GGP if value is None else Command.SGP
    return CommandFrame(address, command, FIRST_MARK_VARIABLE + motor, USER_BANK, value or 0)


def reset_marks(address: int) -> list[CommandFrame]:
    """The requests that mark all motors of a module as unreferenced by a reset."""
    return [mark(address, motor, RESET) for motor in range(MOTORS)]


def setting_name(request: CommandFrame) -> str:
    """The name of the setting that a request sets, for `FoundSettings`."""
    return f"{Command(request.command).name} {request.address} {request.type} {request.motor}"


def read_request(name: str) -> CommandFrame:
    """The request that reads a setting. Raises ValueError for a text that is no name of a setting."""
    command, address, number, motor = name.split(" ")
    return CommandFrame(int(address), READS[command], int(number), int(motor))


def is_repeatable(request: CommandFrame) -> bool:
    """True if a request may be carried out twice. Reading the error flags clears them, so they are read once."""
    match request.command:
        case Command.MVP:
            return request.type == MoveType.ABSOLUTE
        case Command.RFS:
            return request.type != SearchCommand.START
        case Command.GAP:
            return request.type != AxisParameter.ERROR_FLAGS
    return request.command in REPEATABLE


def starts_motion(request: CommandFrame) -> bool:
    """True if a request sets a motor in motion."""
    match request.command:
        case Command.MVP | Command.ROR | Command.ROL:
            return True
        case Command.RFS:
            return request.type == SearchCommand.START
        case Command.SAP:
            return request.type in (AxisParameter.TARGET_POSITION, AxisParameter.TARGET_VELOCITY)
    return False


def check_reply(request: CommandFrame, frame: bytes, device: str, describe: Callable[[CommandFrame], str]) -> ReplyFrame | None:
    """The reply to a request; None for a reply to another one. Raises BadAnswer and Refused.

    `device` is its name and `describe` gives the request as text, for the error.
    """
    try:
        reply = ReplyFrame.decode(frame)
    except FrameError as error:
        raise BadAnswer(device, describe(request), str(error), DISTURBED) from None
    if reply.host != HOST_ADDRESS or reply.address != request.address:
        return None
    if reply.status == ReplyStatus.WRONG_CHECKSUM:
        raise BadAnswer(device, describe(request), "the request was corrupted in transmission", DISTURBED)
    if reply.command != request.command or reply.status == ReplyStatus.TARGET_REACHED:
        return None
    if reply.status != ReplyStatus.OK:
        remedy = REMEDIES.get(reply.status, "update the module's firmware")
        raise Refused(device, describe(request), f"the module replies: {reply}", remedy)
    echoes = request.command in ECHOING or (request.command == Command.MVP and request.type == MoveType.ABSOLUTE)
    return None if echoes and reply.value != request.value else reply


def explain(direction: str, data: bytes) -> str:
    """A frame as text, for transcripts."""
    try:
        return str(CommandFrame.decode(data) if direction == TO_DEVICE else ReplyFrame.decode(data))
    except FrameError as error:
        return str(error)
