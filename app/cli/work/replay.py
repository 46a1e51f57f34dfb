"""Replay of recorded transcripts on the devices of the twin, and the differences in their answers."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from goniotwin.app.cli.output import answer
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.app.rig.addresses import RTU, rtu_address
from goniotwin.drivers.photodiodes.modbus import explain_rtu
from goniotwin.drivers.tap import Explain
from goniotwin.mocks.replay import LineReplay, Replay, replay_all
from goniotwin.mocks.replay_difference import Difference
from goniotwin.mocks.replay_usb import UsbReplay
from goniotwin.mocks.transcript import TO_DEVICE, TranscriptError, Transfer, merge_transcripts, read_transcript
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.addresses import CONVERTER_LINE
from goniotwin.twin.devices.modbus import TcpStation


@dataclass(frozen=True)
class ReplayResult:
    """The device of each file, the number of requests, and the differences, each with the function that explains its bytes."""

    devices: dict[str, str]
    requests: int
    differences: list[tuple[Difference, Explain]]

    def as_dict(self) -> dict[str, Any]:
        """For JSON; bytes in hexadecimal."""
        return {
            "transcripts": self.devices,
            "told": self.requests,
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

    def text(self) -> str:
        """Each difference byte by byte: the request, the recorded answer, the answer now."""
        lines = []
        for each, explain_bytes in self.differences:
            lines.append(str(each))
            lines.append(_line("request", each.asked, explain_bytes, ">"))
            lines.append(_line("recorded", each.recorded, explain_bytes, "<"))
            lines.append(_line("now", each.replayed, explain_bytes, "<"))
        count = len(self.differences)
        differences = {0: "no difference", 1: "1 difference"}.get(count, f"{count} differences")
        return "\n".join([*lines, f"{differences} in {self.requests} requests: {', '.join(self.devices)}"])


def print_differences(transcripts: list[Path], rig: Path, device: str | None, mount: str | None, as_json: bool) -> None:
    """Print the differences of a replay. Raises UserError, and Exit."""
    result = replay_transcripts(transcripts, read_rig(rig), device, mount)
    answer(as_json, result, lambda: print(result.text()))
    raise typer.Exit(1 if result.differences else 0)


def replay_transcripts(paths: Sequence[Path], rig: RigDescription, device: str | None, mount: str | None) -> ReplayResult:
    """Replay transcripts on the devices of a rig's [twin], all wires together in the order of the times.

    `device` is the device of a single file; without it the file name is. `mount` is the sample that is mounted at the start.
    Raises UserError for a file that is not a transcript, and for a device or sample that the rig does not have.
    """
    model = rig.model()
    if model is None:
        raise UserError(f"{rig.name}: has no [twin] table, so there is no twin to replay on; name another rig file")
    if device is not None and len(paths) > 1:
        raise UserError(f"--device is for one transcript, and there are {len(paths)}; leave it out")
    virtual = VirtualRig.build(model, VirtualClock())
    transcripts: dict[str, list[Transfer]] = {}
    for path in paths:
        name = device if device is not None else path.stem
        _check_device(name, rig, virtual, path, from_file_name=device is None)
        if name in transcripts:
            raise UserError(f"{path}: there is another transcript of {name}; give each device once")
        transcripts[name] = _read_transcript(path)
    if mount is not None:
        try:
            virtual.plant.mount(mount, min(each[0].t for each in transcripts.values()) - 1.0)
        except KeyError as error:
            raise UserError(f"{rig.name}: {error.args[0]}") from None
    wires = _wires(rig, virtual, transcripts)
    replay_all([replay for replay, _ in wires])
    return ReplayResult(
        {path.name: name for path, name in zip(paths, transcripts, strict=True)},
        sum(passed.direction == TO_DEVICE for each in transcripts.values() for passed in each),
        [(difference, explain_bytes) for replay, explain_bytes in wires for difference in replay.differences()],
    )


def _wires(rig: RigDescription, virtual: VirtualRig, transcripts: dict[str, list[Transfer]]) -> list[tuple[Replay, Explain]]:
    wires: list[tuple[Replay, Explain]] = []
    on_line: list[list[Transfer]] = []
    devices = {device.name: device for device in rig.file.devices}
    for name, transcript in transcripts.items():
        device = devices[name]
        if device.twin in virtual.usb:
            wires.append((UsbReplay(virtual.usb[device.twin], transcript), device.explain))
        elif device.twin in virtual.serial:
            wires.append((LineReplay(virtual.serial[device.twin], transcript), device.explain))
        else:
            module = virtual.modbus[device.twin]
            if module.model.serial:
                on_line.append(transcript)
            else:
                wires.append((LineReplay(TcpStation(module), transcript, 0.5 * module.latency_s), device.explain))
    if on_line:
        # One serial line has a file for each of its units.
        wires.append((LineReplay(virtual.serial[CONVERTER_LINE], merge_transcripts(on_line)), explain_rtu))
        _address_units(rig, virtual)
    return wires


def _address_units(rig: RigDescription, virtual: VirtualRig) -> None:
    """Give the twin's modules the unit numbers that the rig file has for a real line."""
    for device in rig.file.devices:
        if device.address.startswith(RTU) and device.twin in virtual.modbus:
            virtual.modbus[device.twin].units = (rtu_address(device.address)[1],)


def _check_device(name: str, rig: RigDescription, virtual: VirtualRig, path: Path, *, from_file_name: bool) -> None:
    """Check that the rig has a device. Raises UserError."""
    there = {*virtual.serial, *virtual.modbus, *virtual.usb}
    devices = [device.name for device in rig.file.devices if device.twin in there]
    if name in devices:
        return
    known = ", ".join(devices)
    if from_file_name:
        raise UserError(f"{path}: the file name is not a device of {rig.name}; give it with --device: {known}")
    raise UserError(f"{rig.name}: has no device {name!r}; it has {known}")


def _read_transcript(path: Path) -> list[Transfer]:
    try:
        transcript = read_transcript(path)
    except TranscriptError as error:
        raise UserError(str(error)) from None
    if not transcript:
        raise UserError(f"{path}: has no bytes; name a transcript that --transcript wrote")
    return transcript


def _line(name: str, data: bytes, explain_bytes: Explain, direction: str) -> str:
    return f"    {name:9} {f'{data.hex(chr(32))}  | {explain_bytes(direction, data)}' if data else 'nothing'}"
