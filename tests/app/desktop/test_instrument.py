"""The drawing of the instrument and the readings of the bench, as plain data."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.desktop.model.instrument import InstrumentModel, project
from goniotwin.app.desktop.model.readings import BenchReadings, Signal, current_text, trend_text
from goniotwin.app.rig import RigFile, read_rig
from goniotwin.twin.optics.geometry.coordinates import light_direction
from tests.conftest import RIG

PHOTODIODES = 36


@pytest.fixture(scope="module")
def rig() -> RigFile:
    return read_rig(Path(RIG)).file


@pytest.fixture(scope="module")
def model(rig: RigFile) -> InstrumentModel:
    return InstrumentModel(rig)


def at(sigma: float = 0.0, beta: float = 0.0, shift: float = 0.0, gamma: float = 0.0) -> dict[str, float]:
    return {"gamma": gamma, "sigma": sigma, "beta": beta, "shift": shift}


@pytest.mark.parametrize("sigma", [0.0, 30.0, 120.0])
def test_the_beam_comes_from_the_mirror_unit_at_sigma(model: InstrumentModel, sigma: float) -> None:
    beam = model.drawing(at(sigma)).beam
    assert beam[-1] == pytest.approx(np.zeros(3))
    assert beam[-2] == pytest.approx(200.0 * light_direction(sigma))
    legs = np.diff(beam, axis=0)
    assert np.linalg.norm(legs, axis=1) == pytest.approx([200.0] * 4)
    turned = [float(a @ b) for a, b in pairwise(legs)]
    assert turned == pytest.approx([0.0] * 3, abs=1e-9)  # each mirror turns the beam by 90 deg


def test_side_and_top_view_show_the_arc_where_it_is(model: InstrumentModel) -> None:
    upper, lower = model.drawing(at(beta=90.0, shift=2.5)).arcs
    assert len(upper.photodiodes) + len(lower.photodiodes) == PHOTODIODES
    assert np.linalg.norm(upper.photodiodes, axis=1) == pytest.approx(np.full(18, 300.0))
    assert project(upper.photodiodes, "side")[:, 0] == pytest.approx(np.zeros(18), abs=1e-9)
    assert project(upper.photodiodes, "top")[0] == pytest.approx([0.0, 300.0 * np.sin(np.radians(2.5))])
    assert lower.photodiodes[:, 2] == pytest.approx(-upper.photodiodes[:, 2])


def test_the_zone_is_behind_the_mirrors_and_names_the_photodiodes_in_it(model: InstrumentModel) -> None:
    found = model.obstruction(at(sigma=30.0, beta=0.0))
    middles = found.cells.mean(axis=1)
    nearest = float(np.degrees(np.arccos(np.max(middles @ light_direction(30.0)) / 300.0)))
    assert nearest < 2.0
    assert found.photodiodes == {6}  # at 30 deg of the upper arc, where the last mirror is
    assert model.obstruction(at(sigma=30.0, beta=180.0)).photodiodes == frozenset()


@pytest.mark.parametrize(("shift", "too_high"), [(0.0, False), (2.0, False), (2.5, True)])
def test_the_sector_that_the_arc_must_not_enter_counts_from_87_deg_on(
    model: InstrumentModel, shift: float, too_high: bool
) -> None:
    drawing = model.drawing(at(shift=shift))
    assert drawing.too_high is too_high
    assert np.all(drawing.clearance[1:, 1] < -290.0)  # around the azimuth of 270 deg, on the side of the light


def counts(rig: RigFile, steps: dict[int, float]) -> list[float]:
    return [rig.photodiodes.range.zero + steps.get(channel, 0.0) for channel in range(PHOTODIODES)]


def test_bars_of_light_dark_and_saturation_differ(rig: RigFile) -> None:
    readings = BenchReadings(rig)
    saturated = [channel == 7 for channel in range(PHOTODIODES)]
    bars = readings.bars(counts(rig, {3: 5.0, 4: 4.0, 5: -100.0, 7: 30_000.0, 20: 1000.0}), saturated, 1e8, 2.5)
    assert {bar.channel for bar in bars.bars if bar.state is Signal.LIGHT} == {3, 20}
    assert {bar.channel for bar in bars.bars if bar.state is Signal.SATURATED} == {7}
    assert bars.count(Signal.DARK) == PHOTODIODES - 3
    top = bars.highest
    assert top is not None
    assert (top.channel, top.arc, top.polar_deg) == (20, "lower", 12.5)
    assert top.current_a == pytest.approx(1000.0 * rig.photodiodes.range.lsb_v / 1e8)
    levels = {bar.channel: bars.level(bar) for bar in bars.bars}
    assert levels[7] == 1.0
    assert levels[4] == levels[5] == 0.0
    assert 0.0 < levels[3] < 0.1 < levels[20] < 1.0
    assert "▲ 1 saturated" in bars.text
    assert "no dark reading yet" in bars.text


def test_a_dark_reading_is_subtracted_at_its_own_gain(rig: RigFile) -> None:
    readings = BenchReadings(rig)
    readings.add_dark(1e8, counts(rig, dict.fromkeys(range(PHOTODIODES), 50.0)))
    lit = counts(rig, {**dict.fromkeys(range(PHOTODIODES), 50.0), 2: 150.0})
    none = [False] * PHOTODIODES
    bars = readings.bars(lit, none, 1e8, 0.0)
    assert bars.dark_subtracted
    assert [bar.channel for bar in bars.bars if bar.state is Signal.LIGHT] == [2]
    assert readings.bars(lit, none, 1e10, 0.0).count(Signal.LIGHT) == PHOTODIODES


def test_the_trend_is_of_one_wavelength(rig: RigFile) -> None:
    readings = BenchReadings(rig)
    for k in range(61):
        readings.add_monitor(10.0 * k, 1e-7 * (1.0 + 0.01 * k / 60.0), 550.0)
    readings.add_monitor(600.1, 1e-7, 550.0)  # too soon after the last one
    assert len(readings.trend.times_s) == 61
    assert trend_text(readings.trend) == "101 nA, +1.00 % in 10 min (u 0.00 %)"
    readings.add_monitor(620.0, 2e-7, 600.0)
    assert trend_text(readings.trend) == "200 nA; too few readings for its change"


def test_currents_have_a_prefix() -> None:
    assert [current_text(each) for each in (2.5, 1e-3, -3.21e-7, 1e-13, 0.0)] == ["2.5 A", "1 mA", "−321 nA", "100 fA", "0 fA"]
