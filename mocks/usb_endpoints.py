"""The twin's USB devices for other programs: a USB/IP server on loopback.

Programs with a USB/IP client of their own use it as it is. On Linux `usbip attach` makes of it a device of the system,
which any program finds. A device is one client's at a time; pulling its plug ends that client's connection.

In this process, programs that use pyusb find the twin's devices through `install_backend`.
"""

import errno
import select
import socket
import socketserver
import struct
import threading
from array import array
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import usb.backend.libusb1
import usb.core
from usb.backend import IBackend

from goniotwin.protocols import usbip
from goniotwin.protocols.loopback import LoopbackServer
from goniotwin.protocols.usb_descriptors import decode_configuration
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.usb_standard import ENDPOINTS, configuration_descriptor
from goniotwin.twin.doors import TwinUsbBackend

CHUNK = 65_536
NAK_MS = 2
"""How long a read asks the device before the client is listened to again."""
LEAVING_S = 0.3
"""How long an import waits for one that is ending: a client that has hung up may not have been missed yet."""
MOST_PENDING = 64
LONGEST_READ = 65_536
"""More than any answer of these instruments; clients ask for room of megabytes."""
STALLED, TIMED_OUT, GONE, TAKEN_BACK = -32, -110, -19, -104
STATUS = {errno.EPIPE: STALLED, errno.EOVERFLOW: -75, errno.ETIMEDOUT: TIMED_OUT, errno.ENODEV: GONE}
"""By pyusb's errno: on the wire the numbers are Linux's."""
STATUS |= {32: STALLED, 75: -75, 110: TIMED_OUT, 19: GONE}
PORT_FEATURE, SET_CONFIGURATION = (0x23, 3), (0x00, 9)
BUS = 1


class UsbEndpoints:
    """All USB devices of a rig on one port. `bus_ids` has the id of each."""

    def __init__(self, rig: VirtualRig, port: int = 0) -> None:
        self._rig = rig
        self._backend = TwinUsbBackend(rig)
        self._lock = threading.Condition()
        self._imported: dict[str, socket.socket] = {}
        self._open: set[socket.socket] = set()
        self.bus_ids = {name: f"{BUS}-{k + 1}" for k, name in enumerate(rig.usb)}
        endpoints = self

        class UsbIpHandler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                endpoints.serve(self.request)

        self._server = LoopbackServer("USB endpoints", UsbIpHandler, port)

    @property
    def port(self) -> int:
        """Port number."""
        return self._server.port

    def start(self) -> None:
        """Start serving."""
        self._server.start()

    def stop(self) -> None:
        """Stop: close connections and release the port."""
        self._server.stop()
        with self._lock:
            for connection in self._open:
                _hang_up(connection)

    def unplug(self, name: str) -> None:
        """Pull a device's cable. Raises KeyError for an unknown device."""
        self._backend.unplug(name)
        with self._lock:
            connection = self._imported.get(self.bus_ids[name])
            if connection is not None:
                _hang_up(connection)

    def replug(self, name: str, reset: bool = False) -> None:
        """Plug the cable in again; with `reset` the instrument loses its settings. Raises KeyError."""
        self._backend.replug(name, reset=reset)

    def serve(self, connection: socket.socket) -> None:
        """Serve one connection until it ends."""
        with self._lock:
            self._open.add(connection)
        bus_id = None
        try:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            buffer = bytearray()
            while (request := usbip.take_request(buffer)) is None:
                buffer += _received(connection)
            if isinstance(request, usbip.ListRequest):
                connection.sendall(usbip.listed([self._exported(name) for name, each in self._rig.usb.items() if each.plugged]))
                return
            name = self._taken(request.bus_id, connection)
            connection.sendall(usbip.Imported(self._exported(name) if name is not None else None).encode())
            if name is not None:
                bus_id = request.bus_id
                _Import(connection, self._backend, self._rig, name, buffer).serve()
        except (OSError, usbip.UsbIpError):
            return  # a client that does not speak USB/IP, or has gone, is disconnected
        finally:
            with self._lock:
                self._open.discard(connection)
                if bus_id is not None:
                    del self._imported[bus_id]
                    self._lock.notify_all()

    def _taken(self, bus_id: str, connection: socket.socket) -> str | None:
        """Claim a device for this connection, free now or soon; return its name."""
        names = [name for name, each in self.bus_ids.items() if each == bus_id]
        with self._lock:
            self._lock.wait_for(lambda: bus_id not in self._imported, LEAVING_S)
            if not names or bus_id in self._imported or not self._rig.usb[names[0]].plugged:
                return None
            self._imported[bus_id] = connection
            return names[0]

    def _exported(self, name: str) -> usbip.ExportedDevice:
        instrument = self._rig.usb[name].instrument
        address = list(self._rig.usb).index(name) + 1
        configuration = decode_configuration(configuration_descriptor())
        kinds = tuple(
            (each.fields.bInterfaceClass, each.fields.bInterfaceSubClass, each.fields.bInterfaceProtocol)
            for each in configuration.settings
        )
        return usbip.ExportedDevice(
            f"/goniotwin/{name}",
            self.bus_ids[name],
            BUS,
            address,
            usbip.FULL_SPEED,
            instrument.vendor_id,
            instrument.product_id,
            0x0100,
            (0, 0, 0),
            1,
            1,
            len(kinds),
            kinds,
        )


class _Import:
    """A device imported by one client: transfers to it at once, transfers from it when data are ready."""

    def __init__(
        self, connection: socket.socket, backend: TwinUsbBackend, rig: VirtualRig, name: str, buffer: bytearray
    ) -> None:
        self._connection, self._backend, self._buffer = connection, backend, buffer
        self._handle = backend.open_device(rig.usb[name])
        self._endpoints = {address & 0x0F: (address, kind) for address, kind in ENDPOINTS if address & 0x80}
        self._out = {address for address, _ in ENDPOINTS if not address & 0x80}
        self._pending: list[usbip.Submit] = []

    def serve(self) -> None:
        """Serve until the client disconnects or the plug is pulled. Raises OSError, UsbIpError."""
        while True:
            if select.select([self._connection], [], [], 0.0 if self._pending else None)[0]:
                self._buffer += _received(self._connection)
            while (command := usbip.take_command(self._buffer)) is not None:
                if isinstance(command, usbip.Unlink):
                    self._unlink(command)
                else:
                    self._submit(command)
            self._read()

    def _unlink(self, command: usbip.Unlink) -> None:
        there = [each for each in self._pending if each.number == command.of]
        for each in there:
            self._pending.remove(each)
        self._connection.sendall(usbip.Unlinked(command.number, TAKEN_BACK if there else 0).encode())

    def _submit(self, command: usbip.Submit) -> None:
        if command.endpoint and command.to_host and command.endpoint in self._endpoints:
            if len(self._pending) == MOST_PENDING:
                raise usbip.UsbIpError(f"{MOST_PENDING} transfers wait already")
            self._pending.append(command)
            return
        try:
            if command.endpoint == 0:
                data = self._control(command)
                self._answer(command, 0, len(data) if command.to_host else command.length, data)
            elif command.endpoint in self._out and not command.to_host:
                sent = self._backend.bulk_write(self._handle, command.endpoint, 0, array("B", command.data), 0)
                self._answer(command, 0, sent)
            else:
                self._answer(command, STALLED)
        except usb.core.USBError as error:
            self._answer(command, _status(error))

    def _control(self, command: usbip.Submit) -> bytes:
        kind, request, value, index, length = struct.unpack("<BBHHH", command.setup)
        if (kind, request) == PORT_FEATURE:
            self._backend.reset_device(self._handle)
            return b""
        if (kind, request) == SET_CONFIGURATION:
            self._backend.set_configuration(self._handle, value)
        data = array("B", bytes(length) if command.to_host else command.data)
        size = self._backend.ctrl_transfer(self._handle, kind, request, value, index, data, 0)
        return data.tobytes()[:size] if command.to_host else b""

    def _read(self) -> None:
        """The first transfer that waits at each endpoint, where there is something for it."""
        for number in dict.fromkeys(each.endpoint for each in self._pending):
            command = next(each for each in self._pending if each.endpoint == number)
            address, kind = self._endpoints[number]
            buffer = array("B", bytes(min(command.length, LONGEST_READ)))
            read = self._backend.intr_read if kind == 3 else self._backend.bulk_read
            try:
                size = read(self._handle, address, 0, buffer, NAK_MS)
            except usb.core.USBTimeoutError:
                continue
            except usb.core.USBError as error:
                self._pending.remove(command)
                self._answer(command, _status(error))
                continue
            self._pending.remove(command)
            self._answer(command, 0, size, buffer.tobytes()[:size])

    def _answer(self, command: usbip.Submit, status: int, length: int = 0, data: bytes = b"") -> None:
        self._connection.sendall(usbip.Submitted(command.number, status, length, data).encode())
        if status == GONE:
            raise ConnectionResetError  # a cable that has been out needs a new import


def _status(error: usb.core.USBError) -> int:
    return STATUS.get(error.errno or 0, -71)


def _received(connection: socket.socket) -> bytes:
    data = connection.recv(CHUNK)
    if not data:
        raise ConnectionResetError
    return data


def _hang_up(connection: socket.socket) -> None:
    try:
        connection.shutdown(socket.SHUT_RDWR)
    except OSError:
        return


@contextmanager
def install_backend(backend: IBackend) -> Iterator[None]:
    """Context in which `usb.core.find()` without an explicit backend finds the devices of `backend`, in this process."""
    real: Callable[..., IBackend | None] = usb.backend.libusb1.get_backend
    usb.backend.libusb1.get_backend = lambda find_library=None: backend  # noqa: ARG005  (pyusb's own signature)
    try:
        yield
    finally:
        usb.backend.libusb1.get_backend = real
