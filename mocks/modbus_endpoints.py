"""Twin converter modules on real Modbus endpoints: a TCP port a module, and serial lines with several units each.

pymodbus's servers listen, accept and open ports. What a module does with the bytes is decided where it is in process too
(`twin.devices.modbus`): pymodbus's own handler answers functions that these modules lack, loses pipelined requests, and
returns "device failure" for a foreign unit where a module is silent.

The modules' limits of eight connections and of idle time (to be confirmed on hardware) are not kept here.
"""

import asyncio
import threading
from collections.abc import Callable
from functools import partial
from typing import Any

from pymodbus.framer import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.server.base import ModbusBaseServer
from pymodbus.server.requesthandler import ServerRequestHandler
from pymodbus.simulator import DataType, SimData, SimDevice

from goniotwin.mocks.serial_ends import HEARD_AT_ONCE, OWED_AT_MOST, owed
from goniotwin.protocols import adam
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.loopback import LOOPBACK, listening_socket
from goniotwin.twin import VirtualRig
from goniotwin.twin.addresses import CONVERTER_LINE
from goniotwin.twin.devices.line import SerialDevice
from goniotwin.twin.devices.modbus import RtuStation, TcpStation

GAP_S = 0.02
"""What ends a frame on an endpoint: its bytes come when the system brings them, not when the baud rate would."""
UNREAD_LIMIT = 4096
"""Limit of bytes that wait to be read; on a serial line, which has no flow control, more is lost."""
FULL_WAIT_S = 0.02
NO_DEVICE = SimDevice(id=0, simdata=[SimData(0, values=0, datatype=DataType.REGISTERS)])
Station = Callable[[], SerialDevice]


class ModbusEndpoints:
    """Endpoints served by one thread with a loop of its own. Also a context manager."""

    def __init__(self, rig: VirtualRig) -> None:
        self._rig = rig
        self._tcp: dict[str, int] = {}
        self._rtu: dict[str, tuple[list[str], int]] = {}
        self._servers: dict[str, ModbusBaseServer] = {}
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None
        self._unplugged: set[str] = set()
        self.ports: dict[str, int] = {}

    @property
    def address(self) -> dict[str, str]:
        """Of each module that is served, as a rig file writes it: `127.0.0.1:PORT` or `rtu:PORT?unit=N&baudrate=B`."""
        found = {name: f"{LOOPBACK}:{port}" for name, port in self.ports.items()}
        for port, (names, baudrate) in self._rtu.items():
            found |= {name: f"rtu:{port}?unit={self._rig.modbus[name].unit}&baudrate={baudrate}" for name in names}
        return found

    def add_tcp(self, name: str, port: int = 0) -> None:
        """A module on a port of loopback, 0 for a free one; `ports` has it after `start`. Raises KeyError."""
        self._known(name)
        self._tcp[name] = port

    def add_rtu(self, port: str, names: list[str] | None = None, baudrate: int = adam.BAUDRATE) -> None:
        """Modules (all that have a serial line, if not given) on a serial port or pseudo-terminal. Raises KeyError."""
        chosen = [name for name, device in self._rig.modbus.items() if device.model.serial] if names is None else names
        for name in chosen:
            self._known(name)
        self._rtu[port] = (chosen, baudrate)

    def start(self) -> None:
        """Start serving. Raises OSError for a port that cannot be opened; then nothing is served."""
        self._loop = _Loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="Modbus endpoints", daemon=True)
        self._thread.start()
        try:
            asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result()
        except BaseException:
            self.stop()
            raise

    def stop(self) -> None:
        """Stop: close connections and release the ports."""
        if self._loop is None or self._thread is None:
            return
        asyncio.run_coroutine_threadsafe(self._close(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        self._loop = self._thread = None
        self._servers = {}
        self.ports = {}

    def unplug(self, name: str) -> None:
        """Pull the plug of a module on TCP: close its connections, and new ones at once. Raises KeyError."""
        server = self._servers[name]
        assert self._loop is not None
        self._unplugged.add(name)

        async def cut() -> None:
            for connection in list(server.active_connections.values()):
                connection.close()

        done = asyncio.run_coroutine_threadsafe(cut(), self._loop)
        if threading.current_thread() is not self._thread:
            done.result()

    def replug(self, name: str) -> None:
        """Plug the module in again. Raises KeyError."""
        self._known(name)
        self._unplugged.discard(name)

    def __enter__(self) -> "ModbusEndpoints":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _known(self, name: str) -> None:
        if name not in self._rig.modbus:
            raise KeyError(f"the virtual rig has no module {name!r}; it has: {', '.join(self._rig.modbus)}")

    async def _listen(self) -> None:
        for name, port in self._tcp.items():
            self._servers[name] = tcp = _TcpServer(
                self._rig, self._station(name), port, partial(self._unplugged.__contains__, name)
            )
            await _serve(tcp, f"{LOOPBACK}:{port}")
            transport: asyncio.Server = tcp.transport  # type: ignore[assignment]  # pymodbus: Any transport
            self.ports[name] = int(transport.sockets[0].getsockname()[1])
        for path, (names, baudrate) in self._rtu.items():
            self._servers[path] = rtu = _RtuServer(self._rig, self._line(names, baudrate), path, baudrate)
            await _serve(rtu, path)

    async def _close(self) -> None:
        for server in self._servers.values():
            await server.shutdown()
        ModbusBaseServer.active_server = None
        for _ in range(3):  # transports close their sockets in a later turn of the loop
            await asyncio.sleep(0)

    def _station(self, name: str) -> Station:
        """Factory of the module's end of a new connection."""

        def station() -> SerialDevice:
            between = self._rig.modbus_wires.get(name)
            end = TcpStation(self._rig.modbus[name])
            return between(end) if between is not None else end

        return station

    def _line(self, names: list[str], baudrate: int) -> Station:
        def station() -> SerialDevice:
            between = self._rig.modbus_wires.get(CONVERTER_LINE)
            gap_s = GAP_S * float(getattr(self._rig.clock, "speed", 1.0))
            end = RtuStation([self._rig.modbus[name] for name in names], baudrate, gap_s)
            return between(end) if between is not None else end

        return station


class _Loop(asyncio.SelectorEventLoop):
    """A loop whose servers have their ports alone: pymodbus asks for one that is shared on Windows."""

    async def create_server(self, *args: Any, **options: Any) -> asyncio.Server:
        """Listen at the port of `(protocol_factory, host, port)` on loopback. Raises OSError."""
        factory, _, port = args
        return await super().create_server(factory, sock=listening_socket(port), **{**options, "reuse_address": None})


class _Handler(ServerRequestHandler):
    """One connection: pymodbus brings the bytes, a station answers them."""

    def __init__(self, owner: ModbusBaseServer, rig: VirtualRig, station: SerialDevice, *, refused: bool = False) -> None:
        super().__init__(owner, None, None, None)  # type: ignore[no-untyped-call]  # pymodbus gives it no types
        self._refused = refused
        self._rig = rig
        self._station = station
        self._unheard = b""
        self._next: asyncio.TimerHandle | None = None
        self._clock: Clock = rig.clock
        self._speed = float(getattr(rig.clock, "speed", 1.0))

    def data_received(self, data: bytes) -> None:
        """Receive parts of requests. Over TCP, reading pauses while received bytes wait for processing."""
        if self._refused:
            self.close()
            return
        crowded = bool(self._unheard)
        if len(self._unheard) < UNREAD_LIMIT:
            self._unheard += data
        if not crowded:
            self._take_turn()

    def callback_disconnected(self, exc: Exception | None) -> None:
        """Discard requests of a client that has gone."""
        super().callback_disconnected(exc)
        self._forget()

    def _take_turn(self) -> None:
        """Process some bytes, send the replies that are due, in order, and continue after the other connections."""
        if self._next is not None:
            self._next.cancel()
            self._next = None
        transport: asyncio.Transport | None = self.transport  # type: ignore[assignment]  # None after the end
        if transport is None or transport.is_closing():
            self._forget()
            return
        outbox = self._station.outbox
        heard = bool(self._unheard) and owed(self._station) + transport.get_write_buffer_size() < OWED_AT_MOST
        if heard:
            piece, self._unheard = self._unheard[:HEARD_AT_ONCE], self._unheard[HEARD_AT_ONCE:]
            with self._rig.lock:
                self._station.receive(piece, self._clock.now())
        while outbox and outbox[0][0] <= self._clock.now() and not transport.is_closing():
            transport.write(outbox.popleft()[1])
        if self._unheard:
            transport.pause_reading()
        else:
            transport.resume_reading()
        waits = [max(0.0, outbox[0][0] - self._clock.now()) / self._speed] if outbox else []
        if self._unheard:
            waits.append(0.0 if heard else FULL_WAIT_S)
        if waits:
            self._next = self.loop.call_later(min(waits), self._take_turn)

    def _forget(self) -> None:
        self._unheard = b""
        self._station.outbox.clear()
        if self._next is not None:
            self._next.cancel()
            self._next = None


class _TcpServer(ModbusTcpServer):
    def __init__(self, rig: VirtualRig, station: Station, port: int, unplugged: Callable[[], bool]) -> None:
        super().__init__(NO_DEVICE, address=(LOOPBACK, port))
        self._rig, self._station, self._unplugged = rig, station, unplugged

    def callback_new_connection(self) -> _Handler:
        """A connection has a station of its own; there is no reply behind a plug that has been pulled."""
        handler = _Handler(self, self._rig, self._station(), refused=self._unplugged())
        if self._unplugged():
            self.loop.call_soon(handler.close)
        return handler


class _RtuServer(ModbusSerialServer):
    def __init__(self, rig: VirtualRig, station: Station, port: str, baudrate: int) -> None:
        super().__init__(NO_DEVICE, framer=FramerType.RTU, port=port, baudrate=baudrate)
        self._rig, self._station = rig, station

    def callback_new_connection(self) -> _Handler:
        """A serial line is a single connection."""
        return _Handler(self, self._rig, self._station())


async def _serve(server: ModbusBaseServer, where: str) -> None:
    if not await server.listen():
        raise OSError(f"{where} cannot be opened: it does not exist, or another program has it")
