"""Shutter, wavelength and lamp, as far as the station knows them: at rest and during a run."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.app.campaign.running.events import LightChanged, State
from goniotwin.app.station.messages import LampRead, Message, RowSaved
from goniotwin.drivers import Monochromator, NoAnswer
from tests.app.campaign.campaign_bench import QUIET
from tests.app.station.station_bench import HurriedClock, StationBench
from tests.conftest import SMALL, Writer

Light = tuple[str, float | None, bool | None]


@pytest.fixture
def bench(write_rig: Writer) -> Iterator[StationBench]:
    bench = StationBench(write_rig(*QUIET), HurriedClock())
    yield bench
    bench.station.close_rig()


def test_at_rest_the_lamp_is_known_from_a_reading_with_the_shutter_open(bench: StationBench) -> None:
    station = bench.station
    assert station.snapshot.bench.shutter_open is False
    station.read()
    bench.work()
    assert bench.work().lamp is None  # nothing is known by what a closed shutter lets through
    commands: tuple[Callable[[], None], ...] = (
        lambda: station.read(1, True),
        lambda: station.wavelength(550.0),
        lambda: station.shutter(True),
        lambda: station.read(),
    )
    for command in commands:
        command()
        bench.work()
    now = station.snapshot
    assert (now.bench.shutter_open, now.bench.wavelength_nm) == (True, 550.0)
    assert now.lamp is not None
    assert now.reading is not None
    assert (now.lamp.current_a, now.lamp.light) == (now.reading.monitor_a, True)
    bench.virtual.plant.set_lamp(bench.clock.now(), level=0.0)
    station.read()
    dark = bench.work().lamp
    assert dark is not None
    assert not dark.light


def test_in_a_run_shutter_and_wavelength_are_those_of_the_row(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    seen: list[Light] = []

    def note(message: Message) -> None:
        if isinstance(message, RowSaved):
            now = bench.station.snapshot.bench
            seen.append((message.row.kind, now.wavelength_nm, now.shutter_open))

    bench.reactions.append(note)
    text = SMALL.replace("wavelength_nm = [550]", "wavelength_nm = [500, 600]")
    bench.station.start(write_schedule(text=text), tmp_path)
    assert bench.work().state is State.DONE
    measured = {(nm, shutter) for kind, nm, shutter in seen if kind == "measure"}
    assert measured == {(500.0, True), (600.0, True)}
    assert {shutter for kind, _, shutter in seen if kind in ("dark", "mount")} == {False}
    lamps = bench.of(LampRead)
    assert len(lamps) == sum(kind == "measure" for kind, *_ in seen)
    assert all(each.light for each in lamps if isinstance(each, LampRead))
    assert bench.station.snapshot.bench.shutter_open is False  # asked for after the run


def test_a_fault_of_the_monochromator_makes_both_unknown(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = Monochromator.start_wavelength
    failed: list[bool] = []

    def once(monochromator: Monochromator, nm: float) -> object:
        if not failed:
            failed.append(True)
            raise NoAnswer("monochromator", "GOWAVE", "no reply")
        return start(monochromator, nm)

    monkeypatch.setattr(Monochromator, "start_wavelength", once)
    bench.station.start(write_schedule(text=SMALL), tmp_path)
    assert bench.work().state is State.DONE
    assert LightChanged(None, None) in bench.events
