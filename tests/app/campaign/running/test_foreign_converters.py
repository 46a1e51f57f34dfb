"""A row measured on converters that are not ours: pymodbus's own servers and simulated registers, over TCP and a serial line.

They share nothing with the twin: registers, refusals and framing are pymodbus's, and the codes of the ranges are written here.
"""

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from pymodbus.constants import ExcCodes
from pymodbus.framer import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.server.base import ModbusBaseServer
from pymodbus.simulator import DataType, SimData, SimDevice

from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from goniotwin.mocks.serial_endpoints import ptys_exist
from tests.app.campaign.campaign_bench import change_rows, run_plan
from tests.conftest import Change, Writer
from tests.mocks.test_modbus_endpoints import NullModem

pytestmark = pytest.mark.endpoint
CODES_6017 = {0x0103, 0x0104, 0x0140, 0x0142, 0x0143, 0x0180, 0x0181, 0x0182}
CODES_4117 = {*range(0x07, 0x0E), *range(0x48, 0x4E)}
POSITIVE = [0x8000 + 100 * channel for channel in range(8)]
NEGATIVE = [0x8000 - 100 * channel for channel in range(8)]
ARC = str([*range(0, 90, 5)])
EIGHT = str([*range(0, 40, 5)])


@dataclass
class ForeignModule:
    """A module with a unit, its name, counts, and the only codes of ranges that it knows; it may refuse functions 15 and 16.

    `written` are the functions and addresses of the writes that it has accepted, `codes` the ranges that were written last, and
    `measured` those with which the counts were read last.
    """

    unit: int
    name: int
    counts: list[int]
    known: set[int]
    first_code: int
    refuses_many: bool = False
    written: list[tuple[int, int]] = field(default_factory=list)
    codes: list[int] = field(default_factory=list)
    measured: list[int] = field(default_factory=list)

    def registers(self) -> list[SimData]:
        held = {0: self.counts, 200: [self.first_code] * 8, 210: [self.name, 0, 0xA205, 0], 220: [0x00FF]}
        return [SimData(at, values=values, datatype=DataType.REGISTERS) for at, values in held.items()]

    async def act(
        self, function: int, start: int, address: int, count: int, registers: list[int], values: list[int] | list[bool] | None
    ) -> ExcCodes | None:
        if function in (15, 16) and self.refuses_many:
            return ExcCodes.ILLEGAL_FUNCTION
        if values is not None and 200 <= address < 208:
            if not self.known.issuperset(values):
                return ExcCodes.ILLEGAL_VALUE
            self.codes[address - 200 : address - 200 + len(values)] = list(values)
        if values is not None:
            self.written.append((function, address))
        elif address == 0:
            self.measured = list(self.codes)
        return None

    def over_tcp(self) -> SimDevice:
        """With coils 16 and 17, apart from the registers."""
        coils = [SimData(16, values=[False] * 2, datatype=DataType.BITS)]
        return SimDevice(self.unit, (coils, coils, self.registers(), self.registers()), action=self.act)

    def on_a_line(self) -> SimDevice:
        return SimDevice(self.unit, self.registers(), action=self.act)


@contextmanager
def serving(make: Callable[[], ModbusBaseServer]) -> Iterator[ModbusBaseServer]:
    """A server of pymodbus in a thread with a loop of its own."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, daemon=True)
    thread.start()

    async def listen() -> ModbusBaseServer:
        server = make()
        assert await server.listen()
        return server

    server = asyncio.run_coroutine_threadsafe(listen(), loop).result()
    try:
        yield server
    finally:
        asyncio.run_coroutine_threadsafe(server.shutdown(), loop).result()
        ModbusBaseServer.active_server = None
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


def measure_a_row(write_rig: Writer, write_schedule: Writer, tmp_path: Path, *changes: Change) -> np.ndarray:
    """The counts (readings, 16) of one row of a campaign, all else on the virtual rig."""
    arc = (f"upper_deg = {ARC}\nlower_deg = {ARC}", f"upper_deg = {EIGHT}\nlower_deg = {EIGHT}")
    rig = read_rig(write_rig(arc, *changes))
    plan = make_plan(read_schedule(write_schedule(("[1e8, 1e10]", "[1e10]"))), rig)
    first = next(row for row in plan.rows if row.kind == "measure")
    run = run_plan(change_rows(plan, lambda row: row if row is first else []), tmp_path / "a.journal")
    assert (run.state, run.faults) == (State.DONE, [])
    (row,) = run.rows
    (reading,) = row.data.readings
    return reading.counts


def units(first: str, second: str) -> Change:
    twins = ", ".join(f'"twin://virtual/adc-{k}"' for k in range(5))
    return (f"units = [{twins}]", f'units = ["{first}", "{second}"]')


def test_a_row_on_a_foreign_6017(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """The second one responds to unit 255 alone, and takes functions 05 (Rope Robotics) and 06 (IoTConnect), not 15 and 16."""
    modules = [
        ForeignModule(1, 0x6017, POSITIVE, CODES_6017, 0x0180),
        ForeignModule(255, 0x6017, NEGATIVE, CODES_6017, 0x0142, refuses_many=True),
    ]
    with serving(lambda: ModbusTcpServer([each.over_tcp() for each in modules], address=("127.0.0.1", 0))) as server:
        transport: asyncio.Server = server.transport  # type: ignore[assignment]
        place = f"127.0.0.1:{transport.sockets[0].getsockname()[1]}"
        counts = measure_a_row(write_rig, write_schedule, tmp_path, units(place, f"{place}?unit=255"))
    assert counts.tolist() == [[*POSITIVE, *NEGATIVE]] * 2
    for each in modules:
        assert each.measured == [0x0143] * 8
        assert each.codes == [each.first_code] * 8  # as it was found
        assert {(5, 16), (5, 17)}.issubset(each.written) is each.refuses_many  # the gain, by the digital outputs
        assert ((15, 16) in each.written) is not each.refuses_many


@pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals")
@pytest.mark.parametrize(("raw_format", "flip"), [("unsigned", 0), ("twos-complement", 0x8000)])
def test_a_row_on_foreign_4117s(write_rig: Writer, write_schedule: Writer, tmp_path: Path, raw_format: str, flip: int) -> None:
    """They know the codes 0x07 to 0x0D and 0x48 to 0x4D only, and the second one refuses function 16."""
    modules = [
        ForeignModule(1, 0x4117, [count ^ flip for count in POSITIVE], CODES_4117, 0x0D),
        ForeignModule(2, 0x4117, [count ^ flip for count in NEGATIVE], CODES_4117, 0x07, refuses_many=True),
    ]
    modem = NullModem()

    def server() -> ModbusSerialServer:
        return ModbusSerialServer(
            [each.on_a_line() for each in modules], framer=FramerType.RTU, port=modem.device, baudrate=9600
        )

    kind = (
        ('kind = "adam-6017"', f'kind = "adam-4117"\nraw_format = "{raw_format}"'),
        ("gains_v_per_a = [1e6, 1e8, 1e10, 1e11]", "gains_v_per_a = [1e10]"),
        units(f"rtu:{modem.computer}?unit=1", f"rtu:{modem.computer}?unit=2"),
    )
    with serving(server):
        counts = measure_a_row(write_rig, write_schedule, tmp_path, *kind)
    modem.close()
    assert counts.tolist() == [[*POSITIVE, *NEGATIVE]] * 2
    assert [each.measured for each in modules] == [[0x08] * 8] * 2
    assert [each.codes for each in modules] == [[each.first_code] * 8 for each in modules]  # as they were found
    assert [each.written for each in modules] == [[(16, 200)] * 2, [(6, 200 + channel) for channel in range(8)] * 2]
