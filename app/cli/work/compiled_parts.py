"""What calls the kernels of each part of `goniotwin compile`, once and as small as can be."""

import numpy as np

from goniotwin import examples
from goniotwin.app.campaign.measurement_model.kernels import call_kernels
from goniotwin.app.campaign.planning.path_search import shorten_path
from goniotwin.app.rig import read_rig
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.optics import (
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
    gaussian,
    light_direction,
    pupil_image,
    record,
    regular,
    shadow_map,
    throughput,
    ward,
)
from goniotwin.twin.optics.bsdf.point_samples import plane_through_points
from goniotwin.twin.optics.fast.surrogate import fill_relative_rms
from goniotwin.twin.optics.forward.stray_light import stray_map
from goniotwin.twin.optics.geometry.mirrors import mirrors_at
from goniotwin.twin.optics.geometry.scene import scene_at
from goniotwin.twin.optics.illumination.slit_image import lit_corners
from goniotwin.twin.plant.lamp import lamp_constants, lamp_mean
from goniotwin.twin.plant.noise import mix
from goniotwin.twin.plant.process_key import process_key

UPWARDS = [[0.0, 0.0, 1.0]]


def scenes() -> None:
    """Light on the detectors by the kernel over scenes."""
    throughput(Instrument(), 30.0, UPWARDS, gaussian(5.0))


def every_scene() -> None:
    """Samples of every kind."""
    evaluate(ward(1.0, 0.1, 0.2), light_direction(30.0), UPWARDS)
    albedo(regular(1.0), 30.0)
    albedo(gaussian(5.0, transmits=True, refraction=1.5), 30.0, transmitted=True)


def rig() -> None:
    """Samples, lamp and electronics of a virtual rig."""
    evaluate(gaussian(5.0), light_direction(30.0), UPWARDS)
    model = read_rig(examples.RIG).model()
    assert model is not None
    plant = VirtualRig.build(model, VirtualClock()).plant  # on a real clock the light on the photodiodes would be computed
    plant.volts(0, 0.0)
    plant.coming_readings(1000)
    lamp_mean(0.0, plant.conversion_period_s, *lamp_constants(model.light, model.seed, model.noise))
    mix(process_key(model.seed, "encoder"), np.int64(0))


def shadows() -> None:
    """What the mirror unit hides."""
    shadow_map(Instrument(), 30.0, 45.0)
    mirrors_at(Instrument(), 30.0)


def uncertainties() -> None:
    """Slopes of values, and the lit share of the hole."""
    call_kernels()


def forward() -> None:
    """The forward estimator, with both kinds of detectors."""
    for instrument in (Instrument(), Instrument(sensor=RealSensor())):
        forward_throughput(instrument, 30.0, UPWARDS, gaussian(5.0), 2)
    stray_map(Instrument(), 30.0, gaussian(5.0), 2)
    draw_directions(gaussian(5.0), light_direction(30.0), np.full((1, 4), 0.5))


def illumination() -> None:
    """The unit before the exit pupil."""
    forward_illumination(IlluminationUnit(), rays=2)
    adjoint_illumination(IlluminationUnit(), rays=2)
    field_fluxes(IlluminationUnit(), np.zeros((1, 6, 6)))
    record(IlluminationUnit(), rays=2, seed=1)
    pupil_image(Instrument(), 30.0)
    lit_corners(Instrument(), scene_at(Instrument(), 30.0))


def sequences() -> None:
    """Path search, measured points, tolerances."""
    shorten_path(np.arange(3), np.ones((4, 4)), 10)
    plane_through_points(np.array(UPWARDS), np.array(UPWARDS), np.ones(1), 1.0)
    fill_relative_rms(np.zeros((1, 1)), np.zeros((3, 4)), np.zeros((4, 1)), np.empty(1))
