"""JournalReader wires told to the twin's devices: where do these answer otherwise?"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription
from goniotwin.app.rig.addresses import RTU, rtu_address
from goniotwin.drivers.motion import tmcl
from goniotwin.drivers.photodiodes.modbus import explain, explain_rtu
from goniotwin.drivers.tap import Explain, as_text
from goniotwin.drivers.usb import usbtmc
from goniotwin.mocks.replay import LineReplay, Replay, replay_all
from goniotwin.mocks.replay_difference import Difference
from goniotwin.mocks.replay_usb import UsbReplay
from goniotwin.mocks.transcript import TO_DEVICE, Passed, TranscriptError, merged, read_transcript
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.modbus import TcpStation
from goniotwin.twin.rig import AXES, CONVERTER, CONVERTER_LINE, MONITOR, MONOCHROMATOR

_PHOTODIODES = re.compile(r"photodiodes-(0|[1-9][0-9]{0,3})")
TWIN = "twin://"


@dataclass(frozen=True)
class Replayed:
    """What came of it: which device each file is of, how much it was told, the differences with the words for their bytes."""

    devices: dict[str, str]
    told: int
    differences: list[tuple[Difference, Explain]]

    def as_dict(self) -> dict[str, Any]:
        """For programs; bytes in hexadecimal."""
        return {
            "transcripts": self.devices,
            "told": self.told,
            "differences": [
                {
                    "file": each.file,
                    "line": each.line,
                    "asked": each.asked.hex(" "),
                    "recorded": each.recorded.hex(" "),
                    "now": each.replayed.hex(" "),
                    "bytes": [{"at": at, "recorded": one, "now": other} for at, one, other in each.places],
                }
                for each, _ in self.differences
            ],
        }

    def in_words(self) -> str:
        """For people: each difference byte by byte, with what was asked, recorded and said now."""
        lines = []
        for each, words in self.differences:
            lines.append(str(each))
            lines.append(_line("asked", each.asked, words, ">"))
            lines.append(_line("recorded", each.recorded, words, "<"))
            lines.append(_line("now", each.replayed, words, "<"))
        count = len(self.differences)
        how_many = {0: "no difference", 1: "1 difference"}.get(count, f"{count} differences")
        return "\n".join([*lines, f"{how_many}; told {self.told} times: {', '.join(self.devices)}"])


def replay_transcripts(paths: Sequence[Path], rig: RigDescription, device: str | None, mount: str | None) -> Replayed:
    """Tells the devices of a rig's [twin] what was recorded, all wires together in the order of the times.

    `device` names the device of a single file, which else its name tells; `mount` a sample that is in before it begins.
    Raises UserError for what is no transcript, for a device or sample that the rig does not have.
    """
    model = rig.model()
    if model is None:
        raise UserError(f"{rig.name}: has no [twin] table, so there is no twin to tell it to; name another rig file")
    if device is not None and len(paths) > 1:
        raise UserError(f"--device names the device of one transcript, and there are {len(paths)}; leave it out")
    virtual = VirtualRig.build(model, VirtualClock())
    transcripts: dict[str, list[Passed]] = {}
    for path in paths:
        name = device if device is not None else path.stem
        _checked(name, rig, virtual, path, told_by_name=device is None)
        if name in transcripts:
            raise UserError(f"{path}: another transcript is of {name} already; name each device once")
        transcripts[name] = _read(path)
    if mount is not None:
        try:
            virtual.plant.mount(mount, min(each[0].t for each in transcripts.values()) - 1.0)
        except KeyError as error:
            raise UserError(f"{rig.name}: {error.args[0]}") from None
    wires = _wires(rig, virtual, transcripts)
    replay_all([replay for replay, _ in wires])
    return Replayed(
        {path.name: name for path, name in zip(paths, transcripts, strict=True)},
        sum(passed.direction == TO_DEVICE for each in transcripts.values() for passed in each),
        [(difference, words) for replay, words in wires for difference in replay.differences()],
    )


def _wires(rig: RigDescription, virtual: VirtualRig, transcripts: dict[str, list[Passed]]) -> list[tuple[Replay, Explain]]:
    wires: list[tuple[Replay, Explain]] = []
    on_line: list[list[Passed]] = []
    for name, transcript in transcripts.items():
        if name == "axes":
            wires.append((LineReplay(virtual.serial[AXES], transcript), tmcl.explain))
        elif name == "monochromator":
            wires.append((LineReplay(virtual.serial[MONOCHROMATOR], transcript), as_text))
        elif name == "monitor":
            wires.append((UsbReplay(virtual.usb[MONITOR], transcript), usbtmc.explain))
        else:
            module = virtual.modbus[_converter(name, rig)]
            if module.model.serial:
                on_line.append(transcript)
            else:
                wires.append((LineReplay(TcpStation(module), transcript, 0.5 * module.latency_s), explain))
    if on_line:
        # What passed on one line is in a file for each unit.
        wires.append((LineReplay(virtual.serial[CONVERTER_LINE], merged(on_line)), explain_rtu))
        _address_units(rig, virtual)
    return wires


def _address_units(rig: RigDescription, virtual: VirtualRig) -> None:
    """The twin's modules answer to the unit numbers that those of a real line have in the rig file."""
    for index, address in enumerate(rig.file.photodiodes.units):
        if address.startswith(RTU) and CONVERTER.format(index) in virtual.modbus:
            virtual.modbus[CONVERTER.format(index)].unit = rtu_address(address)[1]


def _converter(name: str, rig: RigDescription) -> str:
    """The twin's module that has the place of `photodiodes-K` in the rig file; an empty string for another name."""
    match = _PHOTODIODES.fullmatch(name)
    units = rig.file.photodiodes.units
    if match is None or int(match[1]) >= len(units):
        return ""
    address = units[int(match[1])]
    return address.rsplit("/", 1)[1] if address.startswith(TWIN) else CONVERTER.format(int(match[1]))


def _checked(name: str, rig: RigDescription, virtual: VirtualRig, path: Path, *, told_by_name: bool) -> None:
    if name in ("axes", "monochromator", "monitor") or _converter(name, rig) in virtual.modbus:
        return
    converters = [f"photodiodes-{k}" for k in range(len(rig.file.photodiodes.units))]
    known = ", ".join(["axes", "monochromator", *converters, "monitor"])
    if told_by_name:
        raise UserError(f"{path}: its name tells no device of {rig.name}; name it with --device: {known}")
    raise UserError(f"{rig.name}: has no device {name!r}; it has {known}")


def _read(path: Path) -> list[Passed]:
    try:
        transcript = read_transcript(path)
    except TranscriptError as error:
        raise UserError(str(error)) from None
    if not transcript:
        raise UserError(f"{path}: nothing passed in it; name a transcript that --transcript has written")
    return transcript


def _line(what: str, data: bytes, words: Explain, direction: str) -> str:
    return f"    {what:9} {f'{data.hex(chr(32))}  | {words(direction, data)}' if data else 'nothing'}"
