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
from goniotwin.protocols.script import EIGHT_REGISTERS, HEADER, Exchanged, ModbusExchange, read_registers
from goniotwin.twin.devices.adam import ConverterModule
from goniotwin.twin.devices.line import BITS_A_BYTE, SerialDevice
from goniotwin.twin.devices.modbus import GAP_CHARACTERS, TcpStation, answered
from goniotwin.twin.doors.registry import NoSuchTwin, find, missing, split
from goniotwin.twin.rig import CONVERTER_LINE

Trace = Callable[[bool, bytes], bytes]
CHUNK = 256
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

    def run_script(self, script: Sequence[ModbusExchange], slack_s: float) -> list[Exchanged]:
        """Make the first exchanges of a script: see `ModbusScripts`. None on a clock of real time, or on a wire between."""
        clock = self._clock
        if not isinstance(clock, VirtualClock):
            return []
        with self._rig.lock:
            run = _Script(clock.now(), clock.next_event(), slack_s)
            for exchange in script:
                if not run.add(exchange):
                    break
            return run.made()

    @property
    def station(self) -> TcpStation | None:
        """The module's end of the connection where nothing is between, nothing on its way and the module answers plainly."""
        wire = self._wire
        if type(wire) is not TcpStation or self._answers or not wire.idle or self.comm_params.timeout_connect < LEAST_TIMEOUT_S:
            return None
        return wire

    def next_transaction(self) -> int:
        """The identifier of the next request, which counts as answered: the state of pymodbus after an exchange."""
        self.transaction.count_until_disconnect = self.transaction.max_until_disconnect
        return int(self.transaction.getNextTID())


class _Script:
    """A script in progress on stations of one rig, which began at `now`, s; an event is due at `until`."""

    def __init__(self, now: float, until: float, slack_s: float) -> None:
        self._now, self._until, self._slack_s = now, until, slack_s
        self._stations: dict[object, TcpStation | None] = {}
        self._free: dict[object, float] = {}
        self._made: list[Exchanged] = []
        self._readings: list[tuple[ModbusExchange, float, float, float]] = []
        self._modules: list[ConverterModule] = []

    def add(self, exchange: ModbusExchange) -> bool:
        """Make an exchange, or read its registers later with those of others; False where it has to be made singly."""
        due, client, unit, request, expected = exchange
        if client not in self._stations:
            station = self._stations[client] = client.station if isinstance(client, TwinModbusClient) else None
            self._free[client] = station.free if station is not None else 0.0
        else:
            station = self._stations[client]
        sent = max(self._now, due)
        if station is None or unit not in station.device.units or sent > due + self._slack_s:
            return False
        device = station.device
        begins = max(self._free[client], sent + 0.5 * device.latency_s)
        arrived = begins + 0.5 * device.latency_s
        if arrived >= self._until:
            return False
        if expected is None:
            if request != READ_INPUTS:
                return False
            self._readings.append((exchange, sent, begins, arrived))
            self._modules.append(device)
        else:
            if not self._read() or not self._exchange(exchange, device, sent, begins, arrived):
                return False
        self._now = self._free[client] = arrived
        return True

    def made(self) -> list[Exchanged]:
        """The exchanges that were made."""
        self._read()
        return self._made

    def _exchange(self, exchange: ModbusExchange, device: ConverterModule, sent: float, begins: float, arrived: float) -> bool:
        """One exchange. A module refuses before it changes anything, so that another reply than the expected has no effect."""
        reply = answered(device, exchange.request, begins)
        if reply != exchange.expected:
            return False
        self._note(exchange, sent, arrived, reply)
        return True

    def _read(self) -> bool:
        """The registers that are still to be read, all at once; False where they change meanwhile."""
        if not self._readings:
            return True
        data = ConverterModule.read_together(self._modules, [begins for _, _, begins, _ in self._readings])
        if data is not None:
            for k, (exchange, sent, _, arrived) in enumerate(self._readings):
                self._note(exchange, sent, arrived, EIGHT_REGISTERS + data[16 * k : 16 * k + 16])
        self._readings, self._modules = [], []
        return data is not None

    def _note(self, exchange: ModbusExchange, sent: float, arrived: float, reply: bytes) -> None:
        client, unit, request = exchange.client, exchange.unit, exchange.request
        station = self._stations[client]
        assert isinstance(client, TwinModbusClient)
        assert station is not None
        station.free = arrived
        transaction = client.next_transaction()
        self._made.append(
            Exchanged(
                sent, HEADER.pack(transaction, 0, 1 + len(request), unit) + request,
                arrived, HEADER.pack(transaction, 0, 1 + len(reply), unit) + reply,
            )
        )  # fmt: skip


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
