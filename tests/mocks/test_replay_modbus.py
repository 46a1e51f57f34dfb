"""Replay of Modbus transcripts: to the twin's modules, and to the driver in their place. RTU: one file per unit."""

from pathlib import Path

import pytest

from goniotwin.drivers import DeviceError, wait
from goniotwin.mocks.replay import LineReplay, RecordedDevice, replay_all, replay_to_device
from goniotwin.mocks.transcript import Transfer, merge_transcripts
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.line import BITS_A_BYTE, SerialDevice
from goniotwin.twin.devices.modbus import GAP_CHARACTERS, TcpStation
from tests.conftest import Change
from tests.drivers.photodiode_bench import NARROW
from tests.mocks.replay_bench import (
    BOTH,
    QUIET,
    RTU,
    TCP,
    UNITS,
    RigMaker,
    read_photodiodes,
    same,
    transcripts,
    virtual,
)
from tests.mocks.replay_bench import rig_of as rig_of


def record(rig_of: RigMaker, folder: Path, *changes: Change) -> tuple[list[list[Transfer]], list[list[int]]]:
    """Record the connection and readings of the photodiodes; return one transcript per unit, and the counts."""
    rig = rig_of(*changes, transcript=folder)
    rig.rig.photodiodes.connect()
    counts = read_photodiodes(rig.rig)
    rig.close()
    found = transcripts(folder, "photodiodes")
    assert len(found) == UNITS
    return found, counts


def end(rig: VirtualRig, index: int) -> tuple[SerialDevice, float]:
    """Where a unit's wire ends, and how long the way there is."""
    module = rig.modbus[f"adc-{index}"]
    return (rig.serial["adcs"], 0.0) if module.model.serial else (TcpStation(module), 0.5 * module.latency_s)


def put_in_place(rig: VirtualRig, recorded: list[list[Transfer]]) -> list[RecordedDevice]:
    """Recorded devices instead of the twin's modules."""
    line = rig.serial.get("adcs")
    if line is not None:
        gap_s = GAP_CHARACTERS * BITS_A_BYTE / line.baudrate  # after which an answer is known to be over
        rig.serial["adcs"] = device = RecordedDevice(merge_transcripts(recorded), line.baudrate, gap_s)
        return [device]
    devices = [RecordedDevice(each, way_s=0.5 * rig.modbus["adc-0"].latency_s) for each in recorded]
    for index, each in enumerate(devices):
        rig.modbus_wires[f"adc-{index}"] = lambda station, each=each: each  # type: ignore[misc]
    return devices


@BOTH
def test_the_same_modules_give_the_same_answers_again(rig_of: RigMaker, tmp_path: Path, changes: tuple[Change, ...]) -> None:
    recorded, _ = record(rig_of, tmp_path, *changes)
    rig = virtual(rig_of(*changes))
    for index, transcript in enumerate(recorded):
        device, way_s = end(rig, index)
        assert replay_to_device(device, transcript, way_s) == []


def test_noise_is_the_same_at_the_same_times(rig_of: RigMaker, tmp_path: Path) -> None:
    recorded, counts = record(rig_of, tmp_path)
    assert len({tuple(row) for row in counts}) > 1
    device, way_s = end(virtual(rig_of()), 0)
    assert replay_to_device(device, recorded[0], way_s) == []


@BOTH
def test_a_module_with_other_settings_is_detected_byte_by_byte(
    rig_of: RigMaker, tmp_path: Path, changes: tuple[Change, ...]
) -> None:
    recorded, _ = record(rig_of, tmp_path, *changes)
    rig = virtual(rig_of(*changes))
    serial = "adcs" in rig.serial  # an ADAM-4117, with the codes of its series
    rig.modbus["adc-2"].write_registers(200, [0x09 if serial else 0x0142], 0.0)
    device, way_s = end(rig, 2)
    first = replay_to_device(device, recorded[2], way_s)[0]
    header, found = (3, "08 recorded, 09 now") if serial else (9, "43 recorded, 42 now")
    assert str(first).startswith(f"photodiodes-2.txt, line {first.line}, from the device: byte {header + 1}: {found}")
    assert first.asked[-5 if serial else -3] == 200
    rest = {index: replay_to_device(end(rig, index)[0], recorded[index], way_s) for index in (0, 1, 3, 4)}
    assert rest == {0: [], 1: [], 3: [], 4: []}


def test_a_missing_module_is_silent(rig_of: RigMaker, tmp_path: Path) -> None:
    recorded, _ = record(rig_of, tmp_path, *RTU)
    rig = virtual(rig_of(*RTU))
    rig.modbus["adc-1"].silent = True
    differences = replay_to_device(rig.serial["adcs"], recorded[1])
    answers = [each for each in recorded[1] if each.direction == "<"]
    assert [(each.line, each.recorded, each.replayed) for each in differences] == [
        (each.line, each.data, b"") for each in answers
    ]
    assert "byte 0: 02 recorded, nothing now" in str(differences[0])


def test_the_files_of_one_line_are_merged_in_the_order_on_the_line(rig_of: RigMaker, tmp_path: Path) -> None:
    recorded, _ = record(rig_of, tmp_path, *RTU)
    line = merge_transcripts(recorded)
    assert [each.direction for each in line] == [">", "<"] * (len(line) // 2)  # request and answer alternate
    assert sorted(line, key=lambda each: each.t) == line
    assert all(request.data[0] == answer.data[0] for request, answer in zip(line[::2], line[1::2], strict=True))
    rig = virtual(rig_of(*RTU))
    assert replay_to_device(rig.serial["adcs"], line) == []
    rig = virtual(rig_of(*RTU))
    rig.modbus["adc-4"].write_registers(220, [0x7F], 0.0)
    assert {each.file for each in replay_to_device(rig.serial["adcs"], line)} == {"photodiodes-4.txt"}


@BOTH
def test_the_driver_gets_the_same_from_recorded_modules(rig_of: RigMaker, tmp_path: Path, changes: tuple[Change, ...]) -> None:
    recorded, counts = record(rig_of, tmp_path / "first", *changes)
    again = rig_of(*changes, transcript=tmp_path / "again")
    devices = put_in_place(virtual(again), recorded)
    again.rig.photodiodes.connect()
    assert read_photodiodes(again.rig) == counts
    again.close()
    assert all(device.finished for device in devices)
    late = 0.1 if changes == RTU else 0.0  # an RTU client knows only some time later that an answer is over
    for one, other in zip(recorded, transcripts(tmp_path / "again", "photodiodes"), strict=True):
        assert same(one, other, late)


@BOTH
def test_a_driver_that_sends_other_requests_is_detected(rig_of: RigMaker, tmp_path: Path, changes: tuple[Change, ...]) -> None:
    recorded, _ = record(rig_of, tmp_path, *changes)
    other = rig_of(*changes, NARROW)  # it writes another range
    devices = put_in_place(virtual(other), recorded)
    with pytest.raises(DeviceError, match="photodiodes module 0"):
        other.rig.photodiodes.connect()
    (difference,) = devices[0].differences
    assert difference.direction == ">"
    assert difference.places
    assert str(difference).startswith("photodiodes-0.txt, line ")
    assert not devices[0].finished


def test_wires_of_one_rig_are_replayed_in_the_order_of_their_times(rig_of: RigMaker, tmp_path: Path) -> None:
    rig = rig_of(*TCP, transcript=tmp_path)
    virtual(rig).mount("gaussian-5")
    rig.rig.connect()
    wait(rig.rig.clock, [rig.rig.monochromator.start_shutter(opened=True)])
    bright = read_photodiodes(rig.rig, gain=2)
    assert max(bright[0]) > 33000
    rig.close()
    (light,), (counted, *_) = transcripts(tmp_path, "monochromator"), transcripts(tmp_path, "photodiodes")

    def replayed(*, with_light: bool) -> int:
        fresh = virtual(rig_of(QUIET))
        fresh.mount("gaussian-5")
        device, way_s = end(fresh, 0)
        replays = [LineReplay(device, counted, way_s)]
        if with_light:
            replays.append(LineReplay(fresh.serial["mono"], light))
        replay_all(replays)
        return sum(len(each.differences()) for each in replays)

    assert replayed(with_light=True) == 0
    assert replayed(with_light=False) == 2  # two readings, in the dark
