"""`goniotwin serve`, `usb` and `devices`, as other programs use them."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
from pymodbus.client import ModbusTcpClient

from goniotwin.app.rig import open_rig, read_rig
from goniotwin.app.rig.served_file import served_rig, write_served_rig
from goniotwin.mocks.control import OrderRefused
from goniotwin.mocks.served import ServedRig
from goniotwin.protocols.clock import RealClock
from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter
from tests.conftest import RIG
from tests.system.command import CALLS, Call, goniotwin, invoke
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


@pytest.mark.long
def test_an_unmodified_pyusb_program_finds_the_monitor(tmp_path: Path) -> None:
    program = tmp_path / "ask.py"
    program.write_text("import sys, usbtmc\nprint(usbtmc.Instrument(0x1313, 0x8078).ask(sys.argv[1]))\n", encoding="utf-8")
    done = goniotwin("usb", "--rig", RIG, program, "*IDN?")
    assert done.stdout == "Thorlabs,PM100D,TWIN0001,2.8.0\n"
    assert done.returncode == 0


@pytest.fixture
def served_file(tmp_path: Path) -> Iterator[tuple[Path, ServedRig]]:
    """A rig that this process serves, and the file that `goniotwin serve --write-rig` writes of it."""
    description = read_rig(RIG)
    model = description.model()
    assert model is not None
    served = ServedRig(model, 20.0, tmp_path / "ptys", control=False)
    served.start()
    path = tmp_path / "served.toml"
    write_served_rig(path, served_rig(description, served.endpoints, 20.0))
    yield path, served
    served.stop()


@pytest.mark.endpoint
def test_programs_with_modules_beside_them_reach_the_monitor_of_a_served_rig(
    served_file: tuple[Path, ServedRig], tmp_path: Path
) -> None:
    rig, _ = served_file
    (tmp_path / "power_meter_of_ours.py").write_text("VENDOR, PRODUCT = 0x1313, 0x8078\n", encoding="utf-8")
    program = tmp_path / "program.py"
    program.write_text(
        "import sys, usb.core, usbtmc\n"
        "from power_meter_of_ours import VENDOR, PRODUCT\n"
        "found = list(usb.core.find(find_all=True, idVendor=VENDOR))\n"
        "print([each.serial_number for each in found])\n"  # opens it, and leaves it open, as libusb allows
        "meter = usbtmc.Instrument(VENDOR, PRODUCT)\n"
        "for each in sys.argv[1:]: print(meter.ask(each) if '?' in each else meter.write(each))\n",
        encoding="utf-8",
    )
    path = list(sys.path)
    assert goniotwin_in_process("usb", "--rig", rig, program, "SENS:CORR:WAV 777") == "['TWIN0001']\nNone\n"
    # The served instrument keeps the setting: it is no other one than before.
    assert goniotwin_in_process("usb", "--rig", rig, program, "SENS:CORR:WAV?") == "['TWIN0001']\n7.77000000E+02\n"
    assert sys.path == path


def goniotwin_in_process(*arguments: object) -> str:
    done = invoke(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.endpoint
def test_usb_names_the_program_that_uses_the_monitor_and_keeps_others_from_it(
    served_file: tuple[Path, ServedRig], tmp_path: Path
) -> None:
    rig, _ = served_file
    program = tmp_path / "ask.py"
    program.write_text("import usbtmc\nprint(usbtmc.Instrument(0x1313, 0x8078).ask('*IDN?'))\n", encoding="utf-8")
    with open_rig(read_rig(rig), RealClock()) as opened:
        opened.connect()
        done = invoke("usb", "--rig", rig, program)
        assert (done.returncode, done.stdout) == (2, "")
        message = " ".join(done.stderr.split())
        assert f"is in use by process {os.getpid()} of " in message
        assert "Traceback" not in message
    assert goniotwin_in_process("usb", "--rig", rig, program) == "Thorlabs,PM100D,TWIN0001,2.8.0\n"


@pytest.mark.endpoint
def test_usb_without_a_virtual_rig_behind_it_is_refused_in_one_line(
    served_file: tuple[Path, ServedRig], tmp_path: Path
) -> None:
    rig, served = served_file
    program = tmp_path / "program.py"
    program.write_text("raise AssertionError\n", encoding="utf-8")
    text = rig.read_text(encoding="utf-8")
    with socket.create_server(("127.0.0.1", 0)) as closed:
        no_server = f"usbip:127.0.0.1:{closed.getsockname()[1]}/1-1"
    elsewhere = f"usbip:127.0.0.1:{next(each.port for each in served.endpoints if each.bus_id)}/9-9"
    for address, message in (
        (no_server, "no USB/IP server at 127.0.0.1"),
        (elsewhere, "the server has no device 9-9"),
        ("1313:8078:P1", "the monitor is at 1313:8078:P1"),
    ):
        rig.write_text(re.sub('usb = "usbip.*"', f'usb = "{address}"', text), encoding="utf-8")
        done = invoke("usb", "--rig", rig, program)
        assert (done.returncode, done.stdout) == (2, "")
        assert message in " ".join(done.stderr.split())


def test_serve_states_what_it_does_before_it_loads_the_twin(tmp_path: Path) -> None:
    """Python's list of imports has the note before everything that takes long, compiling above all."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "goniotwin", "serve", "--rig", tmp_path / "none.toml"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    before, note, after = done.stderr.partition("goniotwin: preparing the virtual rig")
    assert note
    assert not re.search(r"\| +(numba|numpy|goniotwin\.(twin|drivers|app\.rig))\b", before)
    assert re.search(r"\| +goniotwin\.twin\b", after)


@pytest.mark.parametrize("call", CALLS)
def test_devices_of_a_rig_are_listed_with_their_identity(call: Call) -> None:
    done = call("devices", "--rig", RIG, "--json")
    assert done.returncode == 0, done.stderr
    answers = {each["address"]: each["answers"] for each in json.loads(done.stdout)["devices"]}
    assert answers["axes"] == "TMCM-6214"
    assert answers["monitor"].endswith("2.8.0")


@pytest.mark.long
@pytest.mark.parametrize("call", CALLS)
def test_devices_of_this_computer_can_be_listed(call: Call) -> None:
    assert call("devices").returncode == 0
