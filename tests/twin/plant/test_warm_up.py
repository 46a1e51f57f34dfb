"""Warm-up of a virtual rig: kernels are compiled before the first reading, and nothing else is changed."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.rig import read_rig
from goniotwin.protocols.clock import RealClock, VirtualClock
from goniotwin.twin import TwinModel, VirtualRig
from goniotwin.twin.optics import throughput
from goniotwin.twin.plant import Plant
from goniotwin.twin.plant.view import OPEN_BEAM
from tests.conftest import RIG

FIRST_LIGHT = """
import sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from goniotwin.app.rig import read_rig
from goniotwin.protocols.clock import RealClock
from goniotwin.twin import VirtualRig

rig = VirtualRig.build(read_rig(Path(sys.argv[1])).model(), RealClock())
modules = [module for name, module in sorted(sys.modules.items()) if name.startswith("goniotwin.twin")]


def signatures():
    return [each.signatures for module in modules for each in vars(module).values() if isinstance(each, Dispatcher)]


compiled = signatures()
stopwatch = RealClock()
rig.mount("etalon")
rig.plant.shutter_open.set(rig.clock.now(), True)
rig.plant.volts(0, rig.clock.now() + 1.0)
rig.plant.monitor_a(rig.clock.now(), rig.clock.now() + 0.1)
print(stopwatch.now(), sum(map(bool, compiled)), compiled == signatures())
"""


@pytest.fixture
def model() -> TwinModel:
    result = read_rig(RIG).model()
    assert result is not None
    return result


def test_a_rig_on_a_real_clock_has_computed_the_light_of_each_sample(model: TwinModel, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def record(instrument: object, sigma: object, directions: object, scatterer: object, **how: object) -> object:
        seen.append(scatterer)
        return throughput(instrument, sigma, directions, scatterer, **how)  # type: ignore[arg-type]

    monkeypatch.setattr("goniotwin.twin.plant.view.throughput", record)
    VirtualRig.build(model, VirtualClock())
    assert seen == []
    VirtualRig.build(model, RealClock())
    assert seen == [*model.samples.values(), OPEN_BEAM]


def test_a_warm_up_does_not_change_any_reading(model: TwinModel) -> None:
    plants = Plant(model), Plant(model)
    plants[0].warm_up()
    for plant in plants:
        plant.mount("gaussian-5", 1.0)
        plant.shutter_open.set(1.0, True)
    for module in range(plants[0].modules):
        np.testing.assert_array_equal(plants[0].volts(module, 2.0), plants[1].volts(module, 2.0))
        np.testing.assert_array_equal(plants[0].volts(module, 0.5), plants[1].volts(module, 0.5))
    assert plants[0].monitor_a(2.0, 2.1) == plants[1].monitor_a(2.0, 2.1)


def first_light(**environment: str) -> list[str]:
    """Time of the first reading after the warm-up, number of compiled kernels, and whether these are all that it needs."""
    done = subprocess.run(
        [sys.executable, "-c", FIRST_LIGHT, str(RIG)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=True,
        timeout=300.0,
    )
    return done.stdout.split()


@pytest.mark.long
def test_the_warm_up_compiles_all_kernels_of_the_first_reading() -> None:
    _, count, complete = first_light()
    assert int(count) > 5  # those that are called from Python
    assert complete == "True"


@pytest.mark.long
def test_with_an_empty_cache_of_kernels_the_first_light_is_there_at_once(tmp_path: Path) -> None:
    assert float(first_light(NUMBA_CACHE_DIR=str(tmp_path))[0]) < 0.1  # compiling takes seconds
