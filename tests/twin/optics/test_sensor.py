"""The sensor unit as it is built against the simplified one: where they are the same, and where they are not."""

import math

import numpy as np
import pytest

from twin.optics import Instrument, RealSensor
from twin.optics.sensor import passes


def counted(sensor: RealSensor, rays: np.ndarray) -> np.ndarray:
    """Which of rays (n, 4) of places and slopes reach the detector."""
    return np.array([passes(x, y, p, q, sensor.constants) for x, y, p, q in rays])


def rays(count: int = 20_000) -> np.ndarray:
    """About the lens and its field, within and beyond."""
    random = np.random.Generator(np.random.Philox(5))
    return np.column_stack([random.uniform(-3.0, 3.0, (count, 2)), random.uniform(-0.01, 0.01, (count, 2))])


def simplified(instrument: Instrument, given: np.ndarray) -> np.ndarray:
    """A disc and a cone."""
    tangent = math.tan(math.radians(0.5 * instrument.field_deg))
    on_the_disc = np.hypot(given[:, 0], given[:, 1]) <= 0.5 * instrument.detector_diameter_mm
    return np.asarray(on_the_disc & (np.hypot(given[:, 2], given[:, 3]) <= tangent))


@pytest.mark.parametrize("aperture_mm", [0.1, 2.0 * 20.0 * math.tan(math.radians(0.25)), 0.8])
def test_with_the_diaphragm_in_the_focal_plane_it_is_a_disc_with_an_acceptance_cone(aperture_mm: float) -> None:
    sensor = RealSensor(aperture_mm=aperture_mm)
    given = rays()
    expected = simplified(sensor.simplified(Instrument()), given)
    assert 100 < np.sum(expected) < len(given)
    assert np.array_equal(counted(sensor, given), expected)


def test_the_default_has_the_papers_finest_field() -> None:
    assert RealSensor().field_deg == pytest.approx(0.5)
    assert RealSensor().simplified(Instrument()) == Instrument()


@pytest.mark.parametrize(
    "other", [RealSensor(diaphragm_mm=18.0), RealSensor(detector_side_mm=0.1), RealSensor(detector_mm=40.0)],
    ids=["diaphragm out of focus", "small detector", "detector far behind"],
)  # fmt: skip
def test_elsewhere_it_is_not_and_says_so(other: RealSensor) -> None:
    given = rays()
    assert not np.array_equal(counted(other, given), simplified(Instrument(), given))
    with pytest.raises(ValueError, match="no simple detector"):
        other.simplified(Instrument())


@pytest.mark.parametrize("wrong", [{"focal_length_mm": 0.0}, {"aperture_mm": math.nan}, {"detector_mm": 5.0}])
def test_what_cannot_be_built_is_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        RealSensor(**wrong)
