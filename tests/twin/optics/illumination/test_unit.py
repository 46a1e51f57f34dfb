"""Dimensions of the illumination unit, positions of its elements, and its fingerprint."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.twin.optics.geometry.deviation import Deviation
from goniotwin.twin.optics.geometry.instrument import Instrument
from goniotwin.twin.optics.illumination.spectrum import xenon_spectrum
from goniotwin.twin.optics.illumination.unit import ARC, ELEMENTS, INPUT, OUTPUT, REFLECTOR, SLIT, IlluminationUnit


def test_the_unit_has_the_beam_of_the_instrument() -> None:
    unit, instrument = IlluminationUnit(), Instrument()
    assert unit.sample_distance_mm == instrument.pupil_distance_mm
    assert unit.exit_pupil_radius_mm == instrument.pupil_radius_mm
    assert unit.field_side_mm == instrument.spot_side_mm


def test_the_elements_are_in_order_along_the_light() -> None:
    frames = IlluminationUnit().frames
    assert not np.any(frames[:, 0, [0, 2]])
    # The lens that enlarges 14 times at 800 mm is 57 mm from the slit.
    assert frames[SLIT, 0, 1] == pytest.approx(-57.143, abs=1e-3)
    assert frames[INPUT, 0, 1] - frames[ARC, 0, 1] == pytest.approx(50.0)
    assert frames[ARC, 0, 1] - frames[REFLECTOR, 0, 1] == pytest.approx(50.0)
    assert not np.any(frames[OUTPUT, 0])
    assert all(np.array_equal(axes, np.eye(3)) for axes in frames[:, 1:])


def test_a_deviation_moves_its_element_alone_and_that_of_the_unit_all_of_them() -> None:
    straight = IlluminationUnit().frames
    moved = IlluminationUnit(deviations={"slit": Deviation(rz_deg=1.0, x_mm=0.2)}).frames
    assert moved[SLIT, 0] - straight[SLIT, 0] == pytest.approx([0.2, 0.0, 0.0])
    assert moved[SLIT, 1] == pytest.approx([math.cos(math.radians(1.0)), math.sin(math.radians(1.0)), 0.0])
    others = [ARC, REFLECTOR, INPUT, OUTPUT]
    assert np.array_equal(moved[others], straight[others])
    turned = IlluminationUnit(deviations={"unit": Deviation(rz_deg=90.0, z_mm=3.0)}).frames
    assert turned[OUTPUT, 0] == pytest.approx([0.0, 0.0, 3.0])
    assert turned[SLIT, 0] == pytest.approx([57.143, 0.0, 3.0], abs=1e-3)
    assert np.linalg.norm(turned[:, 0] - turned[OUTPUT, 0], axis=1) == pytest.approx(np.abs(straight[:, 0, 1]))


@pytest.mark.parametrize(
    "field",
    ["arc_radius_mm", "slit_width_mm", "bandwidth_nm", "exit_pupil_radius_mm", "output_condenser_magnification"],
)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_an_invalid_dimension_is_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{field} is"):
        IlluminationUnit(**{field: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("field", ["arc_transmittance", "bulb_transmittance", "reflector_reflectance"])
@pytest.mark.parametrize("value", [-0.1, 1.1, math.nan])
def test_an_invalid_share_is_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{field} is"):
        IlluminationUnit(**{field: value})  # type: ignore[arg-type]


def test_inconsistent_dimensions_are_refused() -> None:
    with pytest.raises(ValueError, match=r"reflector_radius_mm is 1\.0: the arc alone reaches 1\.21 mm"):
        IlluminationUnit(reflector_radius_mm=1.0)
    with pytest.raises(ValueError, match="reflector_half_angle_deg"):
        IlluminationUnit(reflector_half_angle_deg=91.0)
    with pytest.raises(ValueError, match="wavelength_nm is 100"):
        IlluminationUnit(wavelength_nm=100.0, interval_nm=400.0)
    with pytest.raises(ValueError, match="'mirror': no such element; known are arc, reflector, input_condenser, slit, output"):
        IlluminationUnit(deviations={"mirror": Deviation()})


def test_the_fingerprint_depends_on_everything_that_determines_the_rays() -> None:
    unit = IlluminationUnit()
    assert unit.fingerprint == IlluminationUnit(deviations={"arc": Deviation()}).fingerprint
    assert unit.fingerprint == pickle.loads(pickle.dumps(unit)).fingerprint
    others = [
        replace(unit, wavelength_nm=556.0),
        replace(unit, arc_length_mm=2.3),
        replace(unit, lamp=xenon_spectrum(2999.0)),
        *(replace(unit, deviations={name: Deviation(y_mm=0.01)}) for name in ELEMENTS),
    ]
    assert len({unit.fingerprint, *(other.fingerprint for other in others)}) == 1 + len(others)
