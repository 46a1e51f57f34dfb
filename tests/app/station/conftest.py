"""Stations on the virtual clock, given back after every test."""

from collections.abc import Iterator

import pytest

from tests.app.campaign.campaign_bench import QUIET
from tests.app.station.station_bench import Idle, StationBench
from tests.conftest import Writer


@pytest.fixture
def bench(write_rig: Writer) -> Iterator[StationBench]:
    bench = StationBench(write_rig(*QUIET))
    yield bench
    bench.station.close_rig()


@pytest.fixture
def idle(write_rig: Writer) -> Iterator[Idle]:
    idle = Idle(write_rig(*QUIET))
    yield idle
    idle.station.close_rig()
