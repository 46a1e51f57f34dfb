"""Raysets: recorded rays agree with the unit's light, and invalid raysets are refused."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from goniotwin.twin.optics.geometry.deviation import Deviation
from goniotwin.twin.optics.geometry.instrument import Instrument
from goniotwin.twin.optics.geometry.mirrors import pupil
from goniotwin.twin.optics.illumination.forward import forward_illumination
from goniotwin.twin.optics.illumination.rayset import Rayset, record, replay
from goniotwin.twin.optics.illumination.unit import IlluminationUnit
from tests.twin.optics.agreement import agree

UNIT = IlluminationUnit()
AWRY = replace(UNIT, deviations={"output_condenser": Deviation(5.0, 0.0, 2.0, 0.05, 0.3, 0.0), "arc": Deviation(x_mm=0.3)})


@pytest.mark.long
@pytest.mark.parametrize("unit", [pytest.param(UNIT, id="straight"), pytest.param(AWRY, id="awry")])
def test_replayed_rays_light_the_sample_as_rays_from_the_arc(unit: IlluminationUnit) -> None:
    forward = forward_illumination(unit, rays=8_000_000, seed=5)
    source = replay(record(unit, 100_000, seed=6), unit)
    place, along = source.rays[:, :3], source.rays[:, 3:]
    landing = place + ((800.0 - place[:, 1]) / along[:, 1])[:, None] * along
    inside = np.all(np.abs(landing[:, [0, 2]]) < 2.5, axis=1)
    angle = np.degrees(np.arctan2(np.hypot(along[:, 0], along[:, 2]), along[:, 1]))

    def spread(values: Any, weights: Any) -> tuple[Any, Any]:
        total, square = np.histogramdd(values, edges, weights=weights)[0], np.histogramdd(values, edges, weights=weights**2)[0]
        count = len(weights)
        return total, np.sqrt(count / (count - 1) * (square - total**2 / count))

    cell_m2 = 1e-6
    edges = [np.linspace(-2.5, 2.5, 6)] * 2
    flux, error = spread(landing[:, [0, 2]], source.flux)
    agree(flux / cell_m2, error / cell_m2, forward.irradiance, forward.irradiance_error)
    edges = [forward.angle_edges_deg]
    flux, error = spread(angle[:, None], np.where(inside, source.flux, 0.0))
    agree(flux, error, forward.angular_flux, forward.angular_flux_error)


def test_a_rayset_contains_all_light_that_leaves_the_unit() -> None:
    rayset = record(AWRY, 50_000, seed=1)
    leaving = forward_illumination(AWRY, rays=4_000_000, side_mm=40.0, cells=1)
    error = math.hypot(rayset.total_flux_error, leaving.flux_error)
    assert rayset.total_flux == pytest.approx(leaving.flux, abs=4.0 * error)
    assert rayset.emitted_flux == leaving.emitted_flux
    assert rayset.unit == "W"


def test_the_wavelengths_are_those_of_the_passband() -> None:
    rayset = record(replace(UNIT, wavelength_nm=450.0, bandwidth_nm=8.0), 20_000, seed=2)
    assert 442.0 < rayset.wavelength_nm.min() < 443.0
    assert 457.0 < rayset.wavelength_nm.max() < 458.0
    assert rayset.wavelength_nm.mean() == pytest.approx(450.0, abs=0.3)


def test_one_seed_gives_the_same_rays_and_a_longer_rayset_starts_with_them() -> None:
    few, many = record(UNIT, 100, seed=9), record(UNIT, 200, seed=9)
    assert np.array_equal(few.positions_mm, many.positions_mm[:100])
    assert np.array_equal(few.wavelength_nm, record(UNIT, 100, seed=9).wavelength_nm)
    assert not np.array_equal(few.positions_mm, record(UNIT, 100, seed=10).positions_mm)


def test_a_source_is_at_the_instruments_exit_pupil() -> None:
    centre = pupil(Instrument())[0]
    rayset = record(UNIT, 1000, seed=0)
    # Directions need not be unit vectors: the source's are.
    longer = replace(rayset, directions=3.0 * rayset.directions)
    source = replay(longer, UNIT, tuple(centre))
    assert np.all(np.abs(source.rays[:, 1] - centre[1]) < 1e-9)
    assert np.max(np.hypot(source.rays[:, 0], source.rays[:, 2])) <= 5.0
    assert np.linalg.norm(source.rays[:, 3:], axis=1) == pytest.approx(1.0)
    assert source.rays.flags.c_contiguous


def test_a_rayset_of_another_geometry_is_refused() -> None:
    rayset, other = record(UNIT, 10, seed=0), replace(UNIT, slit_width_mm=0.6)
    with pytest.raises(ValueError, match=f"another geometry.*{UNIT.fingerprint}.*{other.fingerprint}"):
        replay(rayset, other)
    with pytest.raises(ValueError, match="another geometry"):
        replay(rayset, AWRY)


def invalid_rayset(column: str, ray: Any, value: Any) -> Rayset:
    rayset = record(UNIT, 10, seed=0)
    changed = getattr(rayset, column).copy()
    changed[ray] = value
    return replace(rayset, **{column: changed})


@pytest.mark.parametrize(
    ("column", "value", "wrong"),
    [
        ("positions_mm", np.nan, "ray 4: positions_mm .* is not finite"),
        ("positions_mm", [0.0, 1.0, 0.0], "ray 4: positions_mm .* is not on the plane y = 0 mm"),
        ("directions", 0.0, "ray 4: directions .* has no length"),
        ("directions", np.inf, "ray 4: directions .* is not finite"),
        ("directions", [0.0, -1.0, 0.0], "ray 4: directions .* does not go along the light"),
        ("wavelength_nm", 0.0, "ray 4: wavelength_nm 0.0 is no wavelength"),
        ("wavelength_nm", np.nan, "ray 4: wavelength_nm nan is not finite"),
        ("flux", -1e-9, "ray 4: flux -1e-09 is negative"),
        ("flux", np.nan, "ray 4: flux nan is not finite"),
        ("flux", 1.0, "of 0.2052 emitted"),
    ],
)
def test_invalid_rays_are_refused(column: str, value: Any, wrong: str) -> None:
    with pytest.raises(ValueError, match=wrong):
        invalid_rayset(column, 4, value)


def test_invalid_columns_and_numbers_are_refused() -> None:
    rayset = record(UNIT, 10, seed=0)
    for wrong, what in (
        (dict(flux=rayset.flux[:9]), r"positions_mm has the shape \(10, 3\): 9 rays need \(9, 3\)"),
        (dict(flux=np.zeros(0)), "a rayset without rays"),
        (dict(unit="mW"), "unit is 'mW'"),
        (dict(plane_mm=math.nan), "plane_mm is nan"),
        (dict(emitted_flux=0.0), "emitted_flux is 0.0"),
        (dict(geometry=""), "geometry is empty"),
        (dict(seed=-1), "seed is -1"),
    ):
        with pytest.raises(ValueError, match=what):
            replace(rayset, **wrong)
    with pytest.raises(ValueError, match="rays is 1"):
        record(UNIT, 1, seed=0)
    with pytest.raises(ValueError, match="seed is -1"):
        record(UNIT, 10, seed=-1)
    with pytest.raises(ValueError, match="emits nothing"):
        record(replace(UNIT, wavelength_nm=1000.0), 10, seed=0)
    with pytest.raises(ValueError, match="read-only"):
        rayset.flux[0] = 1.0
