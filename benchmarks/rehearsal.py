"""What a row of a rehearsal costs, through all the wires; and how much memory a long one takes.

    python -m benchmarks.rehearsal [--rounds 5] [--json]
    python -m benchmarks.rehearsal --memory 10000 100000 [--json]

The rows are those of `quick.toml`: 36 photodiodes, four axes, two gains of four readings; the journal does not wait for the
disk (synchronous=OFF). The first rehearsal warms everything up and is not counted. The wall time of each row is taken from
commit to commit; the figure is the median of all rows that measure. Beside it stand what part of it is pymodbus's own: as
many reads of eight registers through its client and its server's framing and PDUs, with nothing behind them; and the
measure that stands for the machine, nine bytes through pyserial's own `loop://`. Compare machines, or versions, by the ratio.

With `--memory` a schedule of so many rows (shifts and wavelengths, one gain, one reading) is rehearsed, each in a process of
its own, as the command does it, with the forecast of every direction as CSV: how much more memory that has at the most, until
its very end, than at the thousandth row, the plan being there from the beginning (Linux).
"""

import argparse
import json
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import serial
from pymodbus.client import ModbusTcpClient
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU
from pymodbus.pdu.register_message import ReadHoldingRegistersResponse

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.rehearsal import performed, prepared, rehearse
from goniotwin.app.campaign.rehearsal.row_statistics import Watch
from goniotwin.app.campaign.rehearsal.warnings import heeded
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.rig import photodiode_settings, read_rig
from goniotwin.drivers.photodiodes.modbus import ModbusBus

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
RIG = EXAMPLES / "rigs" / "virtual.toml"
QUICK = EXAMPLES / "schedules" / "quick.toml"
STATM, STATUS, CLEAR_REFS = (Path("/proc/self") / name for name in ("statm", "status", "clear_refs"))
FRAME = bytes(9)
FROM_ROW = 1000
LONG = """
name = "long"
samples = ["gaussian-5"]
etalon = "etalon"
sigma_deg = [30]
beta_deg = [180]
shift_deg = {{ start = 0.0, stop = 4.0, step = 1.0 }}
wavelength_nm = {{ start = 400.0, stop = 700.0, step = {step} }}
gains_v_per_a = [1e8]
readings = 1
dark_readings = 4
dark_every_s = 600
"""
WAVELENGTHS_NM, MEASURED = 300.0, 2 * 5
"""The span of the wavelengths; the rows at each: two samples, five shifts."""


class Rows:
    """A listener: the wall time of each row that measures."""

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self._last = time.perf_counter()

    def __call__(self, event: Event) -> None:
        """Heeds the commits."""
        if isinstance(event, RowCommitted):
            now = time.perf_counter()
            if event.row.kind == "measure":
                self.seconds.append(now - self._last)
            self._last = now


class NothingBehind(ModbusTcpClient):
    """pymodbus's client, answered by pymodbus's framing and PDUs with eight zeros."""

    def __init__(self) -> None:
        super().__init__("nowhere", retries=0)
        self._framer, self._decoder, self._answer = FramerSocket(DecodePDU(True)), DecodePDU(True), b""

    def connect(self) -> bool:
        """There is nobody to connect to."""
        return True

    def send(self, request: bytes, addr: tuple[str, int] | None = None) -> int:
        """Has the answer made."""
        del addr
        _, unit, transaction, pdu = self._framer.decode(request)
        assert self._decoder.decode(pdu) is not None
        answer = ReadHoldingRegistersResponse(registers=[0] * 8, dev_id=unit, transaction_id=transaction)
        self._answer = self._framer.buildFrame(answer)
        return len(request)

    def recv(self, size: int | None) -> bytes:
        """The answer."""
        del size
        return self._answer


@dataclass(frozen=True)
class Figures:
    """Milliseconds of wall time; `exchanges` are of Modbus, a row, and `floor_ms` what they cost in pymodbus alone."""

    rows: int
    median_ms: float
    lowest_ms: float
    highest_ms: float
    exchanges: float
    floor_ms: float
    loop_us: float

    @property
    def of_loop(self) -> float:
        """The median over the measure that stands for the machine."""
        return 1e3 * self.median_ms / self.loop_us


def once(plan: Plan) -> list[float]:
    """One rehearsal: seconds of its rows."""
    rows = Rows()
    with tempfile.TemporaryDirectory() as folder:
        performed(
            plan, Path(folder) / "rehearsal.journal", Watch(photodiode_settings(plan.rig.file), partial(heeded, plan)), [rows]
        )
    return rows.seconds


def modbus_exchanges_a_row(plan: Plan) -> float:
    """Counted where the drivers ask."""
    asked = 0
    exchange = ModbusBus.exchange

    def counted(self: ModbusBus, *arguments: object) -> object:
        nonlocal asked
        asked += 1
        return exchange(self, *arguments)  # type: ignore[arg-type]

    ModbusBus.exchange = counted  # type: ignore[method-assign, assignment]
    try:
        rows = len(once(plan))
    finally:
        ModbusBus.exchange = exchange  # type: ignore[method-assign]
    return asked / rows


def seconds_each(call: object, calls: int = 2000) -> float:
    """A call, on average."""
    assert callable(call)
    begun = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - begun) / calls


def measured(rounds: int) -> Figures:
    """The rehearsals interleaved with what they are compared to."""
    plan, _ = prepared(read_schedule(QUICK), read_rig(RIG), {})
    exchanges = modbus_exchanges_a_row(plan)
    client = NothingBehind()
    port = serial.serial_for_url("loop://", timeout=1.0)
    rows, floors, loops = [], [], []
    for _ in range(rounds):
        rows.append(once(plan))
        floors.append(seconds_each(lambda: client.read_holding_registers(0, count=8, device_id=1)))
        loops.append(seconds_each(lambda: (port.write(FRAME), port.read(len(FRAME)))))
    medians = [1e3 * statistics.median(each) for each in rows]
    return Figures(
        sum(len(each) for each in rows), statistics.median(medians), min(medians), max(medians), exchanges,
        1e3 * exchanges * statistics.median(floors), 1e6 * statistics.median(loops),
    )  # fmt: skip


def resident_bytes() -> int:
    """Of this process, now. Linux only: elsewhere the system tells no more than the most that there has ever been."""
    return int(STATM.read_text(encoding="ascii").split()[1]) * resource.getpagesize()


def most_bytes() -> int:
    """The most that this process has been resident with since `forget_most`. Linux only."""
    line = next(each for each in STATUS.read_text(encoding="ascii").splitlines() if each.startswith("VmHWM:"))
    return 1024 * int(line.split()[1])


def forget_most() -> None:
    """Begins to look for the most anew."""
    CLEAR_REFS.write_text("5", encoding="ascii")


def memory(rows: int) -> dict[str, float]:
    """Rehearses a schedule of about so many rows in this process, as the command does it."""
    step = WAVELENGTHS_NM / max(1, round(rows / MEASURED) - 1)
    plan, _ = prepared(parse_schedule(LONG.format(step=step), "long.toml"), read_rig(RIG), {})
    at: dict[int, int] = {}

    def weigh(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done in (FROM_ROW, event.total):
            at[event.done] = resident_bytes()
            if event.done == FROM_ROW:
                forget_most()

    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        rehearse(plan, points=Path(folder) / "points.csv", listeners=[weigh])
    seconds = time.perf_counter() - begun
    last, most = len(plan.rows), most_bytes()
    return {
        "rows": last, "seconds": seconds, "most_mb": most / 1e6, "grown_in_rows_mb": (at[last] - at[FROM_ROW]) / 1e6,
        "grown_mb": (most - at[FROM_ROW]) / 1e6, "bytes_a_row": (most - at[FROM_ROW]) / (last - FROM_ROW),
    }  # fmt: skip


def main() -> None:
    """Prints a table, or JSON."""
    parser = argparse.ArgumentParser(description="What a row of a rehearsal costs.")
    parser.add_argument("--rounds", type=int, default=5, help="of one rehearsal each")
    parser.add_argument("--memory", type=int, nargs="+", metavar="ROWS", help="rehearse so many rows and tell the memory")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    machine = {"python": platform.python_version(), "machine": platform.machine(), "system": platform.system()}
    if options.memory and len(options.memory) > 1:
        for rows in options.memory:
            command = [sys.executable, "-m", "benchmarks.rehearsal", "--memory", str(rows)]
            subprocess.run(command + ["--json"] * options.json, check=True)
        return
    if options.memory:
        found = memory(options.memory[0])
        if options.json:
            print(json.dumps({**machine, **found}))
        else:
            told = f"{found['most_mb']:.0f} MB at the most, {found['grown_mb']:.1f} MB more than at row {FROM_ROW}"
            each = f"{found['bytes_a_row']:.0f} bytes a row; until the last row {found['grown_in_rows_mb']:.1f} MB more"
            print(f"{found['rows']:.0f} rows in {found['seconds']:.0f} s: {told}, {each}")
        return
    figures = measured(options.rounds)
    if options.json:
        print(json.dumps({**machine, "rounds": options.rounds, **vars(figures), "of_loop": figures.of_loop}, indent=2))
        return
    print(f"Python {machine['python']}, {machine['machine']}; {options.rounds} rehearsals, {figures.rows} rows that measure")
    print(
        f"a row                 {figures.median_ms:7.2f} ms in the median ({figures.lowest_ms:.2f} to {figures.highest_ms:.2f})"
    )
    print(f"of it, in pymodbus    {figures.floor_ms:7.2f} ms ({figures.exchanges:.0f} exchanges)")
    print(f"9 bytes, loop://      {1e-3 * figures.loop_us:7.4f} ms; a row is {figures.of_loop:.0f} of them")


if __name__ == "__main__":
    main()
