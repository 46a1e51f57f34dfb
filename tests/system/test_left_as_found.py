"""Devices of a served rig are as they were after `devices`, after `run`, and after a killed `run` followed by `devices`.

Another program sets and reads them: pyserial and pymodbus alone, with bytes of the manuals (MCS260 p. 50, 51).
"""

from pathlib import Path
from typing import Any

import pytest
import serial
from pymodbus.client import ModbusTcpClient

from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter, GlobalParameter
from tests.conftest import RIG, Writer
from tests.system.command_process import FORKED, CommandProcess
from tests.system.conftest import Serve, at

pytestmark = [*FORKED, pytest.mark.long]
ROWS_BEFORE_THE_KILL = 2


class OtherProgram:
    """Reads and writes the settings of a served rig."""

    def __init__(self, endpoints: list[dict[str, Any]]) -> None:
        self._ports = {device: at(endpoints, device, "port")["port"] for device in ("mono", "axes", "adc-0", "adc-4")}

    def mono(self, statement: bytes) -> bytes:
        """A statement, and the line after its echo, if it is a query."""
        with serial.serial_for_url(f"socket://127.0.0.1:{self._ports['mono']}", timeout=20.0) as port:
            port.write(statement + b"\n")
            assert port.read_until(b"\n") == statement + b"\n"
            return bytes(port.read_until(b"\n")) if b"?" in statement else b""

    def axes(self, command: Command, number: int, motor: int, value: int = 0) -> int:
        with serial.serial_for_url(f"socket://127.0.0.1:{self._ports['axes']}", timeout=20.0) as port:
            port.write(CommandFrame(1, command, number, motor, value).encode())
            return ReplyFrame.decode(port.read(9)).value

    def modbus(self, device: str) -> ModbusTcpClient:
        return ModbusTcpClient("127.0.0.1", port=self._ports[device], timeout=20.0)

    def set_up(self) -> None:
        """The settings of another program, all of them other than this one's."""
        self.mono(b"UNITS UM")
        for device in ("adc-0", "adc-4"):
            with self.modbus(device) as client:
                assert not client.write_registers(200, [0x0147] * 8).isError()
                assert not client.write_coils(16, [True, False]).isError()
        self.axes(Command.SAP, AxisParameter.RUN_CURRENT, 4, 77)

    def state(self) -> dict[str, Any]:
        state: dict[str, Any] = {each: self.mono(each.encode()) for each in ("HANDSHAKE?", "UNITS?")}
        for device in ("adc-0", "adc-4"):
            with self.modbus(device) as client:
                state[device] = (client.read_holding_registers(200, count=8).registers, client.read_coils(16, count=2).bits)
        for each in (AxisParameter.RUN_CURRENT, AxisParameter.MAX_VELOCITY, AxisParameter.UNIT_MODE):
            state[each.name] = self.axes(Command.GAP, each, 4)
        return {**state, "heartbeat": self.axes(Command.GGP, GlobalParameter.HEARTBEAT, 0)}


def test_a_served_rig_is_left_as_it_was_found(serve: Serve, write_schedule: Writer, tmp_path: Path) -> None:
    rig, schedule = tmp_path / "served.toml", write_schedule()
    _, endpoints = serve(RIG, "--speed", 10, "--write-rig", rig)
    other = OtherProgram(endpoints)
    other.set_up()
    before = other.state()
    assert (before["HANDSHAKE?"], before["UNITS?"]) == (b"0\r\n", b"UM\r\n")

    def devices() -> None:
        asked = CommandProcess(tmp_path, "devices", "--rig", rig)
        assert asked.wait() == 0, asked.output

    devices()
    assert other.state() == before
    measured = CommandProcess(tmp_path, "run", schedule, "--rig", rig, "--out", tmp_path / "whole.journal")
    assert measured.wait() == 0, measured.errors
    assert other.state() == before
    killed = CommandProcess(tmp_path, "run", schedule, "--rig", rig, "--out", tmp_path / "killed.journal")
    killed.wait_for_rows(ROWS_BEFORE_THE_KILL)
    killed.kill()
    changed = other.mono(b"UNITS?")
    assert changed != before["UNITS?"]
    devices()
    assert other.state() == before
