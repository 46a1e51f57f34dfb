"""Time per row of a rehearsal, through all the wires; and the memory of a long rehearsal.

    python -m benchmarks.rehearsal [--rounds 5] [--json]
    python -m benchmarks.rehearsal --memory 10000 100000 [--json]

Time: the rows of `quick.toml`, with 36 photodiodes, four axes and two gains of four readings; the journal does not wait for the
disk (synchronous=OFF). The first rehearsal is a warm-up and does not count. The wall time of a row is taken from commit to
commit; the result is the median of all rows that measure. Two reference times are reported with it: pymodbus's own share, that
is, as many reads of eight registers through its client and its server's framing and PDUs, with no device behind them; and a
measure of the machine, nine bytes through pyserial's own `loop://`. Compare machines or versions by the ratio to the latter.

Memory (`--memory`, Linux): a schedule of so many rows (shifts and wavelengths, one gain, one reading) is rehearsed, each in a
process of its own, as the command does it, with the forecast of every direction as CSV. The result is the largest increase of
the resident memory after row 1000, up to the end of the process. The plan exists from the beginning, so it is not counted.
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
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse, run_on_twin
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.rehearsal.warnings import relevant_photodiodes
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.rig import read_rig
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
"""Range of the wavelengths in nm; rows at each wavelength: two samples, five shifts."""


class RowTimes:
    """A listener that records the wall time of each row that measures."""

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self._last = time.perf_counter()

    def __call__(self, event: Event) -> None:
        """Take the commits; other events are ignored."""
        if isinstance(event, RowCommitted):
            now = time.perf_counter()
            if event.row.kind == "measure":
                self.seconds.append(now - self._last)
            self._last = now


class ClientWithoutDevice(ModbusTcpClient):
    """pymodbus's client; pymodbus's framing and PDUs answer each request with eight zeros."""

    def __init__(self) -> None:
        super().__init__("nowhere", retries=0)
        self._framer, self._decoder, self._answer = FramerSocket(DecodePDU(True)), DecodePDU(True), b""

    def connect(self) -> bool:
        """There is no device to connect to."""
        return True

    def send(self, request: bytes, addr: tuple[str, int] | None = None) -> int:
        """Take a request, and make the answer to it."""
        del addr
        _, unit, transaction, pdu = self._framer.decode(request)
        assert self._decoder.decode(pdu) is not None
        answer = ReadHoldingRegistersResponse(registers=[0] * 8, dev_id=unit, transaction_id=transaction)
        self._answer = self._framer.buildFrame(answer)
        return len(request)

    def recv(self, size: int | None) -> bytes:
        """The answer to the last request."""
        del size
        return self._answer


@dataclass(frozen=True)
class Figures:
    """Wall times in ms; `exchanges` is the number of Modbus exchanges in a row, `floor_ms` their time in pymodbus alone."""

    rows: int
    median_ms: float
    lowest_ms: float
    highest_ms: float
    exchanges: float
    floor_ms: float
    loop_us: float

    @property
    def of_loop(self) -> float:
        """The median over the measure of the machine."""
        return 1e3 * self.median_ms / self.loop_us


def row_seconds(plan: Plan) -> list[float]:
    """Run one rehearsal; the wall times of its rows in s."""
    rows = RowTimes()
    with tempfile.TemporaryDirectory() as folder:
        run_on_twin(
            plan,
            Path(folder) / "rehearsal.journal",
            RowStatistics(plan.rig.file.photodiodes, partial(relevant_photodiodes, plan)),
            [rows],
        )
    return rows.seconds


def modbus_exchanges_per_row(plan: Plan) -> float:
    """Modbus exchanges per row, counted in the drivers."""
    asked = 0
    exchange = ModbusBus.exchange

    def counted(self: ModbusBus, *arguments: object) -> object:
        nonlocal asked
        asked += 1
        return exchange(self, *arguments)  # type: ignore[arg-type]  # passed on as they are

    ModbusBus.exchange = counted  # type: ignore[method-assign, assignment]  # counts, then does the same
    try:
        rows = len(row_seconds(plan))
    finally:
        ModbusBus.exchange = exchange  # type: ignore[method-assign]  # as it was
    return asked / rows


def seconds_per_call(call: object, calls: int = 2000) -> float:
    """Mean wall time of a call, s."""
    assert callable(call)
    start = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - start) / calls


def measure(rounds: int) -> Figures:
    """Measure the rehearsals, interleaved with the reference times."""
    plan, _ = plan_rehearsal(read_schedule(QUICK), read_rig(RIG), {})
    exchanges = modbus_exchanges_per_row(plan)
    client = ClientWithoutDevice()
    port = serial.serial_for_url("loop://", timeout=1.0)
    rows, floors, loops = [], [], []
    for _ in range(rounds):
        rows.append(row_seconds(plan))
        floors.append(seconds_per_call(lambda: client.read_holding_registers(0, count=8, device_id=1)))
        loops.append(seconds_per_call(lambda: (port.write(FRAME), port.read(len(FRAME)))))
    medians = [1e3 * statistics.median(each) for each in rows]
    return Figures(
        sum(len(each) for each in rows), statistics.median(medians), min(medians), max(medians), exchanges,
        1e3 * exchanges * statistics.median(floors), 1e6 * statistics.median(loops),
    )  # fmt: skip


def resident_bytes() -> int:
    """Resident memory of this process now. Linux only: other systems report only the largest value so far."""
    return int(STATM.read_text(encoding="ascii").split()[1]) * resource.getpagesize()


def peak_bytes() -> int:
    """Largest resident memory of this process since `reset_peak`. Linux only."""
    line = next(each for each in STATUS.read_text(encoding="ascii").splitlines() if each.startswith("VmHWM:"))
    return 1024 * int(line.split()[1])


def reset_peak() -> None:
    """Start a new search for the largest resident memory."""
    CLEAR_REFS.write_text("5", encoding="ascii")


def memory(rows: int) -> dict[str, float]:
    """Rehearse a schedule of about so many rows in this process, as the command does it; the memory it takes."""
    step = WAVELENGTHS_NM / max(1, round(rows / MEASURED) - 1)
    plan, _ = plan_rehearsal(parse_schedule(LONG.format(step=step), "long.toml"), read_rig(RIG), {})
    at: dict[int, int] = {}

    def record_memory(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done in (FROM_ROW, event.total):
            at[event.done] = resident_bytes()
            if event.done == FROM_ROW:
                reset_peak()

    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        rehearse(plan, points=Path(folder) / "points.csv", listeners=[record_memory])
    seconds = time.perf_counter() - start
    last, most = len(plan.rows), peak_bytes()
    return {
        "rows": last, "seconds": seconds, "most_mb": most / 1e6, "grown_in_rows_mb": (at[last] - at[FROM_ROW]) / 1e6,
        "grown_mb": (most - at[FROM_ROW]) / 1e6, "bytes_a_row": (most - at[FROM_ROW]) / (last - FROM_ROW),
    }  # fmt: skip


def main() -> None:
    """Print a table, or JSON."""
    parser = argparse.ArgumentParser(description="Time per row and memory of a rehearsal.")
    parser.add_argument("--rounds", type=int, default=5, help="number of rehearsals")
    parser.add_argument("--memory", type=int, nargs="+", metavar="ROWS", help="rehearse so many rows and print the memory")
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
            peak = f"peak {found['most_mb']:.0f} MB, {found['grown_mb']:.1f} MB more than at row {FROM_ROW}"
            each = f"{found['bytes_a_row']:.0f} bytes per row; {found['grown_in_rows_mb']:.1f} MB more at the last row"
            print(f"{found['rows']:.0f} rows in {found['seconds']:.0f} s: {peak}, {each}")
        return
    figures = measure(options.rounds)
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
