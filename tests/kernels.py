"""Compiles once what each worker of the tests would compile again: the kernels, and the modules of the tests.

    python -m tests.kernels [fast] [forward]

What the product does with its optics and its planner, each once and as small as it can be, fills numba's cache. `forward` and
`fast` are compiled at the same time (see the Makefile). What is missing here is compiled by the first test that
needs it: that costs time and nothing else.
"""

import gc
import sys

import numpy as np
import pytest

from goniotwin import examples
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli.work import compilation
from goniotwin.app.rig import read_rig
from goniotwin.protocols.clock import RealClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.optics import (
    Deviation,
    IlluminationUnit,
    Instrument,
    RealSensor,
    adjoint_illumination,
    albedo,
    draw_directions,
    evaluate,
    field_fluxes,
    forward_illumination,
    forward_throughput,
    from_specular,
    light_direction,
    record,
    regular,
    shadow_map,
    throughput,
)
from goniotwin.twin.optics.bsdf.sampling import density_all, scatter_all
from goniotwin.twin.optics.forward.stray_light import stray_map, stray_throughput
from tests.twin.optics.models import MODELS

RIG, SCHEDULE = examples.RIG, examples.SCHEDULE
SIGMA_DEG = 30.0
PATHS = 10_000
DIRECTIONS = from_specular(SIGMA_DEG, np.array([1.0, 5.0]), np.array([0.0, 90.0]))


def rig() -> None:
    """The light and the electronics of the virtual rig, and the uncertainties of a reduction."""
    model = read_rig(RIG).model()
    assert model is not None
    VirtualRig.build(model, RealClock())
    for name in ("rig", "shadows", "uncertainties", "sequences"):
        compilation.PARTS[name].call()


def plan() -> None:
    """The planner's shortening."""
    make_plan(read_schedule(SCHEDULE.with_name("transmission.toml")), read_rig(RIG))


def seen() -> None:
    """The fast estimator, with every model of the tests."""
    for model in MODELS:
        throughput(Instrument(), SIGMA_DEG, DIRECTIONS, model)
        throughput(Instrument(field_deg=20.0, detector_diameter_mm=60.0), SIGMA_DEG, DIRECTIONS, model)
    shifted = Instrument(illumination={"arc": Deviation(x_mm=0.1)})
    for model in (MODELS[0], regular()):
        throughput(shifted, SIGMA_DEG, DIRECTIONS, model)


def samples() -> None:
    """Every model of the tests: values, drawing, densities."""
    light, uniform = light_direction(SIGMA_DEG), np.random.default_rng(1).random((10, 4))
    for model in MODELS:
        evaluate(model, light, DIRECTIONS)
        draw_directions(model, light, uniform)
        albedo(model, SIGMA_DEG, False)
        for lobe in model.lobes:
            kind, params, sigma, phi, theta, psi, _ = lobe.kernel_arguments
            x, y, z = (float(c) for c in light)
            scatter_all(*lobe.kernel_arguments, lobe.cells, 1, False, x, y, z, uniform[:, :3].copy())
            density_all(kind, params, sigma, phi, theta, psi, lobe.cells, x, y, z, DIRECTIONS)


def traced() -> None:
    """The forward estimator with both kinds of detectors, stray light, and the unit before the exit pupil.

    Any sample has arguments of the same types, and the kernels are compiled for types.
    """
    for instrument in (Instrument(), Instrument(sensor=RealSensor())):
        forward_throughput(instrument, SIGMA_DEG, DIRECTIONS, MODELS[0], PATHS, seed=1)
    stray_throughput(stray_map(Instrument(), SIGMA_DEG, MODELS[0], PATHS), DIRECTIONS, Instrument())
    shadow_map(Instrument(), SIGMA_DEG, 10.0)
    forward_illumination(IlluminationUnit(), rays=PATHS)
    adjoint_illumination(IlluminationUnit(), rays=PATHS)
    field_fluxes(IlluminationUnit(), np.zeros((1, 6, 6)))
    record(IlluminationUnit(), rays=PATHS, seed=1)


def modules() -> None:
    """The modules of the tests, with their assertions as pytest rewrites them."""
    if status := pytest.main(["--collect-only", "-qq"]):
        sys.exit(status)


PARTS = {"fast": (seen, rig), "forward": (traced, samples, plan, modules)}


def main() -> None:
    """Compiles the parts that are named, or all of them.

    The compiler makes millions of objects, and searching them for garbage is a tenth of its time: there is little to find.
    """
    gc.disable()
    for name in sys.argv[1:] or PARTS:
        for part in PARTS[name]:
            part()


if __name__ == "__main__":
    main()
