"""pymodbus's doors: synchronous clients whose transport ends at a twin device.

Framing, PDUs and transactions are pymodbus's. Its client for serial ports waits by the wall clock between frames, so that of
the RTU line has its own `send` and `recv`, over pyserial's door, where bytes take their time at the line's baud rate.
"""

from collections import deque
from collections.abc import Callable

import serial
from pymodbus.client import ModbusSerialClient
from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.exceptions import ConnectionException
from pymodbus.framer import FramerType
from pymodbus.transport import CommParams, CommType

from goniotwin.protocols import adam
from goniotwin.twin.addresses import CONVERTER_LINE
from goniotwin.twin.devices.line import BITS_A_BYTE, SerialDevice
from goniotwin.twin.devices.modbus import GAP_CHARACTERS, TcpStation
from goniotwin.twin.doors.registry import NoSuchTwin, find, missing, split

Trace = Callable[[bool, bytes], bytes]
CHUNK = 256


class TwinModbusClient(ModbusBaseSyncClient):
    """pymodbus's client for the medium of this process: a Modbus TCP module of a twin, by its `twin://` address.

    Raises NoSuchTwin.
    """

    def __init__(self, address: str, *, timeout: float = 1.0, trace_packet: Trace | None = None) -> None:
        settings = CommParams(comm_type=CommType.TCP, comm_name=address, host=address, timeout_connect=timeout)
        super().__init__(FramerType.SOCKET, 0, settings, trace_packet, None, None)
        self._rig, self._name = find(address)
        if self._name not in self._rig.modbus:
            raise missing(address, {**self._rig.modbus})
        if self._rig.modbus[self._name].model.serial:
            raise NoSuchTwin(f"{address} is on a serial line: open it with TwinRtuClient")
        self._clock = self._rig.clock
        self._device = self._rig.modbus[self._name]
        self._wire: SerialDevice | None = None
        self._answers: deque[tuple[float, bytes]] = deque()

    @property
    def connected(self) -> bool:
        """Whether `connect` has been called and `close` has not."""
        return self._wire is not None

    def connect(self) -> bool:
        """There is nothing to dial: the device takes any connection."""
        if self._wire is None:
            station = TcpStation(self._device)
            between = self._rig.modbus_wires.get(self._name)
            self._wire = between(station) if between is not None else station
        return True

    def close(self) -> None:
        """Answers on their way are lost."""
        self._wire = None
        self._answers.clear()

    def send(self, request: bytes, addr: tuple[str, int] | None = None) -> int:
        """Brings a request's bytes to the device, which answers after its latency. Raises ConnectionException."""
        del addr
        if self._wire is None:
            raise ConnectionException(str(self))
        with self._rig.lock:
            self._wire.receive(request, self._clock.now() + 0.5 * self._device.latency_s)
        return len(request)

    def recv(self, size: int | None) -> bytes:
        """The next answer's bytes; none after the timeout. Raises ConnectionException."""
        del size
        if self._wire is None:
            raise ConnectionException(str(self))
        self._answers += self._wire.outbox
        self._wire.outbox.clear()
        deadline = self._clock.now() + self.comm_params.timeout_connect
        if not self._answers or self._answers[0][0] > deadline:
            self._clock.sleep_until(deadline)
            if not self._answers or self._answers[0][0] > self._clock.now():  # it may be later than asked for
                return b""
        ready, data = self._answers.popleft()
        self._clock.sleep_until(ready)
        return data


class TwinRtuClient(ModbusSerialClient):
    """A Modbus RTU client on the line of a twin device, found by its `twin://` address. Raises NoSuchTwin.

    The address may be that of any device on the line or of the line; which device is asked is the request's unit.
    """

    def __init__(
        self, address: str, *, baudrate: int = adam.BAUDRATE, timeout: float = 1.0, trace_packet: Trace | None = None
    ) -> None:
        rig, name = find(address)
        on_the_line = [CONVERTER_LINE, *(each for each, device in rig.modbus.items() if device.model.serial)]
        if CONVERTER_LINE not in rig.serial or name not in on_the_line:
            raise missing(address, dict.fromkeys(on_the_line) if CONVERTER_LINE in rig.serial else {})
        line = f"twin://{split(address)[0]}/{CONVERTER_LINE}"
        super().__init__(line, baudrate=baudrate, timeout=timeout, retries=0, trace_packet=trace_packet)
        self._clock = rig.clock
        self._gap_s = GAP_CHARACTERS * BITS_A_BYTE / baudrate
        self._quiet_since = float("-inf")

    def send(self, request: bytes, addr: tuple[str, int] | None = None) -> int:
        """Sends after the gap that ends the frame before; what came unasked is thrown away. Raises ConnectionException."""
        del addr
        port = self._port()
        self._clock.sleep_until(self._quiet_since + self._gap_s)
        port.reset_input_buffer()
        port.write(request)
        port.flush()
        self._quiet_since = self._clock.now()
        return len(request)

    def recv(self, size: int | None) -> bytes:
        """The bytes up to the next gap; none after the timeout. Raises ConnectionException."""
        del size
        port = self._port()
        port.timeout = self.comm_params.timeout_connect
        data = bytes(port.read(1))
        if data:
            port.timeout = self._gap_s
            deadline = self._clock.now() + self.comm_params.timeout_connect
            while (chunk := port.read(CHUNK)) and self._clock.now() < deadline:
                data += chunk
            self._quiet_since = self._clock.now() - self._gap_s
        return data

    def _port(self) -> serial.Serial:
        if self.socket is None:
            raise ConnectionException(str(self))
        return self.socket
