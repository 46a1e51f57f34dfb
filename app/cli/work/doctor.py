"""Examination of this computer for `goniotwin doctor`: no device is opened and nothing is changed.

Each library is tried in a process of its own, so that one that is broken breaks its line alone. Modules of this program that
need libraries are loaded where they are used.
"""

import contextlib
import getpass
import os
import platform
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal

from goniotwin.app.errors import UserError, one_line
from goniotwin.app.log_file import log_folder
from goniotwin.own_files import cache_folder, state_folder
from goniotwin.version import __version__

Level = Literal["ok", "note", "problem"]
PACKAGES = {
    "numpy": "numpy",
    "numba": "numba",
    "h5py": "h5py",
    "pydantic": "pydantic",
    "matplotlib": "matplotlib",
    "Jinja2": "jinja2",
    "pyserial": "serial",
    "pymodbus": "pymodbus.client",
    "pyusb": "usb.core",
    "libusb-package": "libusb_package",
    "pyqtgraph": "pyqtgraph",
    "PySide6-Essentials": "PySide6.QtWidgets",
}
"""The module to import, by the name of its package."""
QT = "PySide6-Essentials"
WINDOW_ONLY = (QT, "pyqtgraph")
REINSTALL = "install goniotwin again"
QT_LIBRARIES = (
    "on Debian and Ubuntu: sudo apt-get install -y libegl1 libgl1 libxkbcommon0 libdbus-1-3 libfontconfig1 libglib2.0-0 "
    "libxkbcommon-x11-0 libxcb-cursor0 libxcb-icccm4 libxcb-image0 libxcb-keysyms1 libxcb-randr0 libxcb-render-util0 "
    "libxcb-shape0 libxcb-xkb1"
)
X11_PLUGIN = """import ctypes, pathlib, sys, PySide6
found = pathlib.Path(PySide6.__file__).parent / "Qt/plugins/platforms/libqxcb.so"
if sys.platform == "linux" and found.exists():
    ctypes.CDLL(str(found))
"""
"""Loads what shows a window under X11, which an import of Qt does not need."""
ADMINISTRATORS = ("root", "wheel")
"""Groups with rights over the whole computer."""
MONITOR = ("1313", "8078")
"""USB vendor and product of the monitor's power meter."""
UDEV_RULE = (
    f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{MONITOR[0]}", ATTR{{idProduct}}=="{MONITOR[1]}", MODE="0660", TAG+="uaccess"'
)
UDEV_REMEDY = f"write {UDEV_RULE} to /etc/udev/rules.d/70-goniotwin.rules, then plug the instrument in again"
USB_DEVICES = Path("/sys/bus/usb/devices")
LEAST_FREE, LITTLE_FREE = 100e6, 2e9
"""Free bytes below which no campaign fits, and below which a long one may not."""
IMPORT_S, ANSWER_S = 120.0, 5.0


@dataclass(frozen=True)
class Finding:
    """One line: what was examined, whether it is well, what was found, and the remedy, empty without one.

    A `problem` prevents measuring; a `note` does not.
    """

    topic: str
    level: Level
    text: str
    remedy: str = ""


def examine(rig: Path | None = None) -> list[Finding]:
    """All findings about this computer and, if given, about the ports of a rig file, without the user's and the host's name."""
    groups: tuple[Callable[[], Iterable[Finding]], ...] = (
        versions,
        serial_ports,
        monitor,
        folders,
        compiled_code,
        sleep,
        clock,
        logs,
    )
    at_rig = [] if rig is None else list(rig_ports(rig))  # what is refused is not waited for
    found: list[Finding] = []
    for group in groups:
        try:
            found += group()
        except Exception as error:  # noqa: BLE001  (a library that is broken in any way must not end the examination)
            found.append(Finding(group.__name__.replace("_", " "), "note", f"not examined: {type(error).__name__}: {error}"))
    return [Finding(each.topic, each.level, anonymous(each.text), anonymous(each.remedy)) for each in [*found, *at_rig]]


def findings_text(findings: list[Finding]) -> str:
    """One line for each finding, with its remedy below it."""
    lines = []
    for each in findings:
        lines.append(f"{each.level:8}{each.topic:19}{each.text}")
        if each.remedy:
            lines.append(f"{'':27}-> {each.remedy}")
    problems = sum(each.level == "problem" for each in findings)
    lines.append(f"{problems} problem{'' if problems == 1 else 's'} that prevent{'s' if problems == 1 else ''} measuring")
    return "\n".join(lines)


def exit_status(findings: list[Finding]) -> int:
    """1 if a problem prevents measuring, else 0."""
    return int(any(each.level == "problem" for each in findings))


def anonymous(text: str) -> str:
    """One printable line without this user's home, the user's name and this computer's name."""
    names = {"HOST": socket.gethostname()}
    with contextlib.suppress(OSError, KeyError, ImportError):
        names["USER"] = getpass.getuser()
    home = os.path.expanduser("~")  # noqa: PTH111  (pathlib raises where there is none)
    if len(home) > 1:
        text = re.sub(rf"{re.escape(home)}(?![^/\\\s:;,'\"])", "~", text)
    for word, name in names.items():
        if name and name not in ("root", "localhost"):
            text = re.sub(rf"(?<![A-Za-z0-9]){re.escape(name)}(?![A-Za-z0-9])", word, text)
    return one_line(text)


def versions() -> Iterator[Finding]:
    """Program, Python, system, and the libraries, each imported in a process of its own."""
    yield Finding("goniotwin", "ok", f"{__version__}, Python {platform.python_version()}, {platform.platform()}")
    for package, module in PACKAGES.items():
        window_only = package in WINDOW_ONLY
        level: Level = "note" if window_only else "problem"
        try:
            version = metadata.version(package)
        except metadata.PackageNotFoundError:
            yield Finding(package, level, "is not installed", REINSTALL)
            continue
        if fault := import_fault(f"import {module}"):
            text = "the window cannot open, commands measure without it: " if window_only else ""
            yield Finding(package, level, f"{version}: {text}{fault}", QT_LIBRARIES if window_only else REINSTALL)
        else:
            yield Finding(package, "ok", version)
            if package == QT:
                fault = import_fault(X11_PLUGIN)
                text = f"the window cannot open under X11: {fault}" if fault else "Qt's system libraries are there"
                yield Finding("display", "note" if fault else "ok", text, QT_LIBRARIES if fault else "")


def import_fault(code: str) -> str:
    """Why a line of Python that loads a library fails, in a process of its own; empty if it does not."""
    command = [sys.executable, "-c", code]
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=IMPORT_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    if done.returncode == 0:
        return ""
    return (done.stderr.strip().splitlines() or [f"its import ended with status {done.returncode}"])[-1]


def serial_ports() -> Iterator[Finding]:
    """Whether this user may open the serial ports of this computer."""
    # A library that is broken ends this part of the examination alone.
    from serial.tools import list_ports

    ports = sorted(each.device for each in list_ports.comports())
    if not ports:
        yield Finding("serial", "note", "no serial port; connect the controllers, unless they are on the network")
    for port in ports:
        yield port_finding("serial", port)


def port_finding(topic: str, port: str) -> Finding:
    """Whether this user may open a serial port, which is not opened."""
    if sys.platform == "win32":
        return Finding(topic, "ok", port)
    path = Path(port)
    if not path.exists():
        return Finding(topic, "problem", f"{port}: does not exist", "connect the device, or correct the rig file")
    if not os.access(path, os.R_OK | os.W_OK):
        group = group_of(path)
        remedy = f"sudo usermod -aG {group} $USER, then log in again"
        if group in ADMINISTRATORS:  # nobody needs their rights to measure
            remedy = f"the port belongs to {group}: give it to the group dialout by a rule of udev, and join that group"
        return Finding(topic, "problem", f"{port}: this user may not open it", remedy)
    return Finding(topic, "ok", f"{port}: this user may open it")


def group_of(path: Path) -> str:
    """The group of a device's file; `dialout` where it has no name."""
    with contextlib.suppress(OSError, KeyError, NotImplementedError, ImportError):
        return path.group()
    return "dialout"


def monitor() -> Iterator[Finding]:
    """Whether this user may open the monitor's USB instrument (Linux)."""
    if not USB_DEVICES.is_dir():
        return
    nodes = [usb_node(each) for each in sorted(USB_DEVICES.iterdir()) if usb_ids(each) == MONITOR]
    if not nodes:
        yield Finding("monitor", "note", f"no USB instrument {':'.join(MONITOR)} is connected")
    for node in nodes:
        if os.access(node, os.R_OK | os.W_OK):
            yield Finding("monitor", "ok", f"{node}: this user may open it")
        else:
            yield Finding("monitor", "problem", f"{node}: this user may not open it", UDEV_REMEDY)


def usb_ids(device: Path) -> tuple[str, str] | None:
    """Vendor and product of a device of `USB_DEVICES`, None for what has none."""
    try:
        return (device / "idVendor").read_text().strip(), (device / "idProduct").read_text().strip()
    except OSError:
        return None


def usb_node(device: Path) -> Path:
    """The file by which a program opens a USB device."""
    bus, number = (int((device / each).read_text()) for each in ("busnum", "devnum"))
    return Path(f"/dev/bus/usb/{bus:03}/{number:03}")


def folders() -> Iterator[Finding]:
    """Whether this program's folders and the current one can be written to, their size, and the space that is left."""
    yield from folder_findings("state", state_folder(), needed=True)
    yield from folder_findings("cache", cache_folder(), needed=False)
    yield from folder_findings("data", Path.cwd(), needed=False, count=False)


def folder_findings(topic: str, folder: Path, *, needed: bool, count: bool = True) -> Iterator[Finding]:
    """One folder: without `needed` it can be done without; without `count` its size is not asked for."""
    existing = next((each for each in (folder, *folder.parents) if each.exists()), folder)
    if not existing.is_dir() or not os.access(existing, os.W_OK | os.X_OK):
        other = {"state": "set HOME to", "cache": "set NUMBA_CACHE_DIR to"}.get(topic, "begin in")
        remedy = f"give this user the right to write to {existing}, or {other} another folder"
        yield Finding(topic, "problem" if needed else "note", f"{folder}: cannot be written to", remedy)
        return
    free = shutil.disk_usage(existing).free
    size = f", {sum(each.stat().st_size for each in folder.rglob('*') if each.is_file()) / 1e6:.0f} MB" if count else ""
    level: Level = "problem" if free < LEAST_FREE else "note" if free < LITTLE_FREE else "ok"
    made = "" if folder.exists() else ", made when it is needed"
    remedy = "" if level == "ok" else "free space on the disk"
    yield Finding(topic, level, f"{folder}: can be written to{made}{size}, {free / 1e9:.1f} GB free", remedy)


def compiled_code() -> Iterator[Finding]:
    """Whether compiled optics are kept. Their version is known to the compiler alone, which is not loaded."""
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or cache_folder())
    count = sum(1 for _ in folder.glob("code-*/*/*.nbi"))
    if count:
        yield Finding("kernels", "ok", f"{count} compiled functions, of this version and earlier ones, are in {folder}")
    else:
        yield Finding("kernels", "note", "none is compiled: the first rehearsal takes a minute longer", "goniotwin compile")


def sleep() -> Iterator[Finding]:
    """Whether a run can keep this computer awake; that is asked for and given back."""
    # A library that is broken ends this part of the examination alone.
    from goniotwin.app.campaign.running.sleep import StayAwake

    awake = StayAwake()
    reason = awake.begin("goniotwin doctor")
    awake.end()
    if reason:
        yield Finding("sleep", "note", f"this computer may go to sleep during a run: {reason}", "switch its sleep off")
    else:
        yield Finding("sleep", "ok", "a run keeps this computer awake")


def clock() -> Iterator[Finding]:
    """Whether the calendar clock follows a time server, by systemd."""
    if shutil.which("timedatectl") is None:
        return
    command = ["timedatectl", "show", "--property=NTPSynchronized", "--value"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=ANSWER_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        done = subprocess.CompletedProcess(command, 1, "", str(error))
    answer = done.stdout.strip()
    if answer == "yes":
        yield Finding("clock", "ok", "the clock is synchronised")
    elif answer == "no":
        yield Finding("clock", "note", "the clock is not synchronised: dates may be wrong", "sudo timedatectl set-ntp true")
    else:
        yield Finding("clock", "note", f"it is not known whether the clock is synchronised: {done.stderr.strip()}")


def logs() -> Iterator[Finding]:
    """Where the logs of windows and stations are, and the details of unexpected errors."""
    folder = log_folder()
    kept = (folder / "window.log", folder / "station.log", *sorted(folder.glob("station-*.log"))[-1:])
    names = [each.name for each in kept if each.exists()]
    faults = len(list(folder.glob("fault-*.txt")))
    text = f"{folder}: {', '.join(names) or 'no window.log and no station.log yet'}"
    yield Finding("logs", "ok", f"{text}, {faults} file{'' if faults == 1 else 's'} about unexpected errors")


def rig_ports(rig: Path) -> Iterator[Finding]:
    """The ports of a rig file: whether another program has one, and whether a serial one may be opened. Raises UserError."""
    # A library that is broken ends this part of the examination alone.
    from goniotwin.app.rig import read_rig
    from goniotwin.app.rig.addresses import RTU, TWIN, resolve_port
    from goniotwin.app.rig.lock import port_holder

    for address in dict.fromkeys(read_rig(rig).file.addresses):
        if address.startswith(TWIN):
            yield Finding("rig", "ok", f"{address}: virtual")
            continue
        try:
            port = resolve_port(address).removeprefix(RTU).partition("?")[0]
            holder = port_holder(address)
        except UserError as error:
            yield Finding("rig", "problem", str(error))
            continue
        if holder is not None:
            yield Finding("rig", "note", f"{address}: is in use by {holder}", "wait for it, or end it")
        elif port.startswith("/"):
            yield port_finding("rig", port)
        else:
            yield Finding("rig", "ok", f"{address}: no other goniotwin uses it; ask the device: goniotwin devices --rig {rig}")
