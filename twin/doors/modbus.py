"""pymodbus's doors: its synchronous clients with the socket's or the port's place taken by a twin device.

Framing, PDUs and transactions stay pymodbus's, on both sides of the wire. Its client for serial ports waits by the wall
clock between frames, so that of the RTU line has its own `send` and `recv`, over pyserial's door, where bytes take their
time at the line's baud rate.
"""

from collections import deque
from collections.abc import Callable, Sequence

import serial
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ConnectionException

from goniotwin.protocols import adam
from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.script import TRANSACTION, Exchanged, ModbusExchange, ModbusScript, read_registers
from goniotwin.twin.addresses import CONVERTER_LINE
from goniotwin.twin.devices.adam import ConverterModule
from goniotwin.twin.devices.line import BITS_A_BYTE, SerialDevice
from goniotwin.twin.devices.modbus import GAP_CHARACTERS, TcpStation, answered
from goniotwin.twin.doors.registry import NoSuchTwin, find, missing, split

Trace = Callable[[bool, bytes], bytes]
CHUNK = 256
READ_BYTES = 2 * adam.CHANNELS
LAST_TRANSACTION = 65_000
"""pymodbus begins again with 1 after it."""
READ_INPUTS = read_registers(adam.AI_VALUE, adam.CHANNELS)
LEAST_TIMEOUT_S = 0.05
"""A client that waits less may give up on an answer: its exchanges are made singly."""


class TwinModbusClient(ModbusTcpClient):
    """A Modbus TCP client whose server is a twin device, found by its `twin://` address. Raises NoSuchTwin."""

    def __init__(self, address: str, *, timeout: float = 1.0, trace_packet: Trace | None = None) -> None:
        super().__init__(address, timeout=timeout, retries=0, trace_packet=trace_packet)
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

    def run_script(self, script: ModbusScript, slack_s: float) -> list[Exchanged]:
        """Make the first exchanges of a script: see `ModbusScripts`. None on a clock of real time, or on a wire between."""
        clock = self._clock
        if not isinstance(clock, VirtualClock):
            return []
        with self._rig.lock:
            return _carry_out(script, clock.now(), clock.next_event(), slack_s)

    @property
    def station(self) -> TcpStation | None:
        """The module's end of the connection where nothing is between, nothing on its way and the module answers plainly."""
        wire = self._wire
        if type(wire) is not TcpStation or self._answers or not wire.idle or self.comm_params.timeout_connect < LEAST_TIMEOUT_S:
            return None
        return wire


class _End:
    """One client's end of a script, and its station's: `free_s` is when that can take the next request."""

    __slots__ = ("device", "free_s", "half_s", "station", "transactions", "units")

    def __init__(self, client: TwinModbusClient, station: TcpStation) -> None:
        self.station, self.device, self.transactions = station, station.device, client.transaction
        self.half_s, self.free_s, self.units = 0.5 * self.device.latency_s, station.free, self.device.units


_Reading = tuple[_End, ModbusExchange, float, float, float]
"""A reading of registers to be made with others: sent, reached the module, arrived, s."""


def _carry_out(script: ModbusScript, now: float, until: float, slack_s: float) -> list[Exchanged]:
    """Make the first exchanges of a script on stations of one rig, from `now` on; an event is due at `until`.

    A module refuses before it changes anything, so that a reply other than the expected one has no effect. pymodbus and the
    stations are left as after these exchanges.
    """
    made: list[Exchanged] = []
    readings: list[_Reading] = []
    ends: dict[object, _End] = {}
    for due, client, exchange in script:
        end = ends.get(client)
        if end is None:
            station = client.station if isinstance(client, TwinModbusClient) else None
            if station is None:
                break
            assert isinstance(client, TwinModbusClient)
            end = ends[client] = _End(client, station)
        sent = due if due > now else now
        begins = sent + end.half_s
        if begins < end.free_s:
            begins = end.free_s
        arrived = begins + end.half_s
        unit, request, expected, request_frame, reply_frame, _ = exchange
        if sent > due + slack_s or arrived >= until or unit not in end.units:
            break
        if expected is None:
            if request != READ_INPUTS:
                break
            readings.append((end, exchange, sent, begins, arrived))
        else:
            if readings and not _read(readings, made):
                break
            readings = []
            if answered(end.device, request, begins) != expected:
                break
            transactions = end.transactions
            transactions.next_tid = number = transactions.next_tid + 1 if transactions.next_tid < LAST_TRANSACTION else 1
            transaction = number.to_bytes(TRANSACTION, "big")
            end.station.free = arrived
            made.append((sent, transaction + request_frame, arrived, transaction + reply_frame))
        now = end.free_s = arrived
    if readings:
        _read(readings, made)
    for end in ends.values():
        end.transactions.count_until_disconnect = end.transactions.max_until_disconnect
    return made


def _read(readings: Sequence[_Reading], made: list[Exchanged]) -> bool:
    """The registers of many readings at once; False, and none of them, where they change meanwhile."""
    data = ConverterModule.read_together([each[0].device for each in readings], [each[3] for each in readings])
    if data is None:
        return False
    place = 0
    for end, exchange, sent, _, arrived in readings:
        transactions = end.transactions
        transactions.next_tid = number = transactions.next_tid + 1 if transactions.next_tid < LAST_TRANSACTION else 1
        transaction = number.to_bytes(TRANSACTION, "big")
        end.station.free = arrived
        following = place + READ_BYTES
        made.append((sent, transaction + exchange.sent, arrived, transaction + exchange.begins + data[place:following]))
        place = following
    return True


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
