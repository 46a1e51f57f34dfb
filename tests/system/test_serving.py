"""`goniotwin serve`, `usb` and `devices`, as other programs use them."""

import json
import os
import signal
import socket
from pathlib import Path

import pytest
import serial
from pymodbus.client import ModbusTcpClient

from goniotwin.mocks.control import OrderRefused
from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter
from tests.conftest import RIG
from tests.system.command import CALLS, Call, goniotwin
from tests.system.conftest import ForkedServe, Serve, Served, at, control_client, until


@pytest.fixture
def served(serve: Serve) -> Served:
    return serve(RIG, "--speed", 20)


def test_all_devices_share_one_plant_and_the_control_port_refuses_wrong_commands_with_a_message(
    forked_serve: ForkedServe,
) -> None:
    """A move over the serial port changes what the Modbus registers read."""
    lines = forked_serve(RIG, "--speed", 20)
    control = control_client(lines)
    with pytest.raises(OrderRefused, match="no sample 'satin'"):
        control.mount("satin")
    with pytest.raises(OrderRefused, match="an order is"):
        control.do("dance")
    with pytest.raises(OrderRefused, match="deg is a number"):
        control.do("tilt", deg="much")
    control.mount("etalon")
    mono = serial.serial_for_url(f"socket://127.0.0.1:{at(lines, 'mono', 'port')['port']}", timeout=5.0)
    mono.write(b"SHUTTER O\n")
    mono.read_until(b"\n")
    mono.close()
    modbus = ModbusTcpClient("127.0.0.1", port=at(lines, "adc-0", "port")["port"])
    modbus.write_coils(16, [True, True])
    axes = serial.serial_for_url(f"socket://127.0.0.1:{at(lines, 'axes', 'port')['port']}", timeout=5.0)

    def counts_at(angle_deg: float) -> int:
        axes.write(CommandFrame(1, Command.SAP, AxisParameter.UNIT_MODE, 4, 1).encode())
        axes.read(9)
        axes.write(CommandFrame(1, Command.SAP, AxisParameter.MAX_ACCELERATION, 4, 500_000).encode())
        axes.read(9)
        axes.write(CommandFrame(1, Command.MVP, 0, 4, round(angle_deg * 5120)).encode())
        assert ReplyFrame.decode(axes.read(9)).status == 100
        until(lambda: bool(control.do("state")["angles_deg"]["sigma"] == pytest.approx(angle_deg, abs=1e-3)))
        start = control.do("state")["t_s"]
        until(lambda: bool(control.do("state")["t_s"] >= start + 1.0))  # the amplifiers have settled
        return int(modbus.read_holding_registers(1, count=1).registers[0])

    assert counts_at(30.0) > 1.2 * (counts_at(75.0) - 32768) + 32768
    axes.close()
    modbus.close()
    control.close()


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_it_ends_with_status_0_and_releases_ports_and_names(served: Served, number: int) -> None:
    process, lines = served
    os.kill(process.pid, number)
    process.communicate(timeout=30.0)
    assert process.returncode == 0
    for line in lines:
        if "port" in line:
            with socket.create_server(("127.0.0.1", line["port"])):
                pass
        else:
            assert not Path(line["path"]).is_symlink()


def test_an_unmodified_pyusb_program_finds_the_monitor(tmp_path: Path) -> None:
    program = tmp_path / "ask.py"
    program.write_text("import sys, usbtmc\nprint(usbtmc.Instrument(0x1313, 0x8078).ask(sys.argv[1]))\n", encoding="utf-8")
    done = goniotwin("usb", "--rig", RIG, program, "*IDN?")
    assert done.stdout == "Thorlabs,PM100D,TWIN0001,2.8.0\n"
    assert done.returncode == 0


@pytest.mark.parametrize("call", CALLS)
def test_devices_of_a_rig_are_listed_with_their_identity(call: Call) -> None:
    done = call("devices", "--rig", RIG, "--json")
    assert done.returncode == 0, done.stderr
    answers = {each["address"]: each["answers"] for each in json.loads(done.stdout)["devices"]}
    assert answers["axes"] == "TMCM-6214"
    assert answers["monitor"].endswith("2.8.0")


@pytest.mark.parametrize("call", CALLS)
def test_devices_of_this_computer_can_be_listed(call: Call) -> None:
    assert call("devices").returncode == 0
