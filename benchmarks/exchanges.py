"""Time of an exchange: each driver against its twin device in this process, on the virtual clock.

    python -m benchmarks.exchanges [--rounds 9] [--json]

The time includes both sides: the driver with its checks, the bus library, the twin device and the plant. A call may take
several exchanges (a position is confirmed by the canary), so that these are counted on the wire. The rounds of all cases
are interleaved with those of a reference: nine bytes through pyserial's `loop://`. Compare machines or versions by the ratio
to the reference; microseconds hold for this machine.
"""

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import serial
import usb.core

from goniotwin.app.rig import parse_rig
from goniotwin.app.rig.file import axis_settings
from goniotwin.app.rig.modbus_units import ModbusUnits
from goniotwin.drivers import (
    AxisSettings,
    Monitor,
    MonitorSettings,
    Monochromator,
    MonochromatorSettings,
    TmclAxis,
    TmclModule,
    wait,
)
from goniotwin.drivers.photodiodes.adam import AdamModule
from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap, no_tap
from goniotwin.protocols import adam
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.doors import TwinUsbBackend, register

RIG = Path(__file__).resolve().parents[1] / "examples" / "rigs" / "virtual.toml"
ON_RTU = (
    ('kind = "adam-6017"', 'kind = "adam-4117"'),
    ("gains_v_per_a = [1e6, 1e8, 1e10, 1e11]", "gains_v_per_a = [1e11]"),
    ("[twin.light]", '[twin.electronics]\nmodule = "adam-4117"\ngains_v_per_a = [1e11]\n\n[twin.light]'),
)
ROUND_S = 0.1
FRAME = bytes(9)
MEAN_S = 0.01
Call = Callable[[], object]


class BenchmarkRig:
    """A virtual rig for the drivers to be timed. `tap` is on their wires."""

    def __init__(self, tap: Tap = no_tap, *changes: tuple[str, str]) -> None:
        text = RIG.read_text(encoding="utf-8")
        for old, new in changes:
            text = text.replace(old, new)
        rig = parse_rig(text, RIG.parent, RIG.name)
        model = rig.model()
        assert model is not None
        self.file, self.tap, self.clock = rig.file, tap, VirtualClock(1.0)
        self.virtual = VirtualRig.build(model, self.clock)
        self.name = register("benchmark", self.virtual)

    def serial(self, device: str) -> Callable[[int, float], serial.Serial]:
        """Opener of a serial line of the rig."""
        return lambda baudrate, timeout: serial.serial_for_url(
            f"twin://{self.name}/{device}", baudrate=baudrate, timeout=timeout
        )


def axis(tap: Tap) -> Call:
    """Position of an axis."""
    bench = BenchmarkRig(tap)
    module = TmclModule(bench.serial("axes"), bench.clock, tap=tap)
    module.connect()
    settings = axis_settings(bench.file)["sigma"]
    assert isinstance(settings, AxisSettings)
    each = TmclAxis("sigma", module, settings, bench.clock)
    each.connect()
    return each.position_deg


def cornerstone(tap: Tap) -> Call:
    """Wavelength of the monochromator."""
    bench = BenchmarkRig(tap)
    settings = bench.file.monochromator
    assert isinstance(settings, MonochromatorSettings)
    monochromator = Monochromator(bench.serial("mono"), settings, bench.clock, tap)
    monochromator.connect()
    return monochromator.wavelength_nm


def modbus_tcp(tap: Tap) -> Call:
    """Eight counts of an ADAM-6017."""
    return _counts(BenchmarkRig(tap), adam.ADAM_6017)


def modbus_rtu(tap: Tap) -> Call:
    """Eight counts of an ADAM-4117."""
    return _counts(BenchmarkRig(tap, *ON_RTU), adam.ADAM_4117)


def _counts(bench: BenchmarkRig, model: adam.Model) -> Call:
    unit = ModbusUnits(bench.virtual).unit(f"twin://{bench.name}/adc-0")
    unit.tap = bench.tap
    module = AdamModule("photodiodes module 0", unit, model, model.power_on, bench.clock)
    module.connect()
    return module.counts


def usbtmc(tap: Tap) -> Call:
    """A mean of 30 samples of a PM100D."""
    bench = BenchmarkRig(tap)
    backend = TwinUsbBackend(bench.virtual)
    settings = bench.file.monitor
    assert isinstance(settings, MonitorSettings)
    monitor = Monitor(lambda: usb.core.find(backend=backend), settings, bench.clock, tap)
    monitor.connect()
    return lambda: wait(bench.clock, [monitor.start_mean(MEAN_S)])


def loop() -> Call:
    """Nine bytes through pyserial's loop."""
    port = serial.serial_for_url("loop://", timeout=1.0)

    def there_and_back() -> None:
        port.write(FRAME)
        port.read(len(FRAME))

    return there_and_back


@dataclass(frozen=True)
class ExchangeCase:
    """A call of a driver; its exchanges are counted by the bytes in one `direction`."""

    name: str
    make: Callable[[Tap], Call]
    direction: str = TO_DEVICE


CASES = (
    ExchangeCase("TMCL, position of an axis", axis),
    ExchangeCase("Cornerstone, wavelength", cornerstone),
    ExchangeCase("Modbus TCP, 8 registers", modbus_tcp),
    ExchangeCase("Modbus RTU, 8 registers", modbus_rtu),
    ExchangeCase("SCPI over USBTMC, mean current", usbtmc, FROM_DEVICE),
)


@dataclass(frozen=True)
class Figure:
    """Microseconds; lowest, median and highest of the rounds. `ratio` is the median of the rounds' ratios to the loop."""

    name: str
    exchanges: float
    low_us: float
    median_us: float
    high_us: float
    ratio: float


def exchanges_a_call(case: ExchangeCase) -> float:
    """Exchanges per call, counted on the wire."""
    calls, count = 100, 0

    def tap(direction: str, data: bytes) -> None:
        nonlocal count
        count += bool(data) and direction == case.direction

    call = case.make(tap)
    call()
    count = 0
    for _ in range(calls):
        call()
    return count / calls


def microseconds(call: Call, calls: int) -> float:
    """Mean duration of a call, microseconds."""
    started = time.perf_counter()
    for _ in range(calls):
        call()
    return 1e6 * (time.perf_counter() - started) / calls


def calls_a_round(call: Call) -> int:
    """Number of calls of a round of ROUND_S."""
    microseconds(call, 50)  # the first are slower
    return max(1, round(1e6 * ROUND_S / microseconds(call, 200)))


def figures(rounds: int) -> list[Figure]:
    """Figures of all cases, the loop first."""
    calls = [loop(), *(case.make(no_tap) for case in CASES)]
    exchanges = [1.0, *(exchanges_a_call(case) for case in CASES)]
    numbers = [calls_a_round(call) for call in calls]
    table = [
        [microseconds(*each) / share for each, share in zip(zip(calls, numbers, strict=True), exchanges, strict=True)]
        for _ in range(rounds)
    ]
    names = ["9 bytes through pyserial's loop://", *(case.name for case in CASES)]
    return [
        Figure(
            name,
            exchanges[k],
            min(row[k] for row in table),
            statistics.median(row[k] for row in table),
            max(row[k] for row in table),
            statistics.median(row[k] / row[0] for row in table),
        )
        for k, name in enumerate(names)
    ]


def main() -> None:
    """Print a table, or JSON."""
    parser = argparse.ArgumentParser(description="Time of an exchange, each driver in process.")
    parser.add_argument("--rounds", type=int, default=9, help="number of rounds of about 0.1 s")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    rows = figures(options.rounds)
    if options.json:
        machine = {"python": platform.python_version(), "machine": platform.machine(), "system": platform.system()}
        print(json.dumps({**machine, "rounds": options.rounds, "figures": [vars(each) for each in rows]}, indent=2))
        return
    print(f"Python {platform.python_version()}, {platform.machine()}; {options.rounds} rounds of {ROUND_S:g} s")
    print(f"{'':36}{'exchanges':>10}{'us an exchange':>16}{'lowest':>9}{'highest':>9}{'of loop://':>12}")
    print(f"{'':36}{'a call':>10}{'(median)':>16}")
    for each in rows:
        print(
            f"{each.name:36}{each.exchanges:10.2f}{each.median_us:16.1f}{each.low_us:9.1f}{each.high_us:9.1f}{each.ratio:12.2f}"
        )


if __name__ == "__main__":
    main()
