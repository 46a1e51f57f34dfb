"""Illumination of the sample: the paper's figure 8 as files, and its rays as a source."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.formats import read_points_csv, read_rayset, write_rayset
from goniotwin.app.json_document import json_value
from goniotwin.app.rig.samples import parse_sample
from goniotwin.app.simulation.estimate import EstimatorSettings
from goniotwin.app.simulation.files import assumptions
from goniotwin.app.simulation.files import summary as simulated_summary
from goniotwin.app.simulation.illumination import (
    IlluminationResult,
    check_file_names,
    describe_deviations,
    parse_deviations,
    simulate_illumination,
    summary,
    write_illumination,
)
from goniotwin.app.simulation.simulate import Task, simulate
from goniotwin.app.simulation.source import illumination_unit, read_source
from goniotwin.twin.optics import Deviation, IlluminationUnit, Instrument
from tests.twin.optics.agreement import agree

pytestmark = pytest.mark.xdist_group("illumination")

WIDE = Instrument(detector_diameter_mm=30.0, field_deg=6.0)
UNIT = illumination_unit(WIDE, 555.0, 0.0, 5.0)
QUICK = 1e-3
"""Relative error of the adjoint flux, for tests that do not compare it."""


@pytest.fixture(scope="session")
def light() -> IlluminationResult:
    return simulate_illumination(UNIT, error_percent=2.0, seed=1, rays=50_000)


@pytest.fixture
def rays(light: IlluminationResult, tmp_path: Path) -> Path:
    assert light.rayset is not None
    write_rayset(tmp_path / "beam.h5", light.rayset)
    return tmp_path / "beam.h5"


def test_both_estimators_of_the_flux_agree_within_their_errors(light: IlluminationResult) -> None:
    result = summary(light)
    forward, adjoint = result["forward"], result["adjoint"]
    assert 0.0 < forward["standard_error"] <= 0.02 * forward["flux"]
    assert 0.0 < adjoint["standard_error"] <= 1e-4 * adjoint["flux"]
    assert abs(result["difference_over_error"]) < 3.5
    assert (result["unit"], result["simulated"], result["geometry"]) == ("W", True, IlluminationUnit().fingerprint)
    assert result["rayset"]["rays"] == 50_000
    assert 0.5 < result["full_width_deg"] < 1.0  # the paper's divergence


def test_a_wider_passband_has_more_flux() -> None:
    wide = simulate_illumination(illumination_unit(WIDE, 555.0, 20.0, 5.0), 10.0, 1, None, adjoint_error=QUICK)
    narrow = simulate_illumination(UNIT, 10.0, 1, None, adjoint_error=QUICK)
    # A trapezoid of 20 nm with edges of 5 nm over a triangle of 5 nm, of a lamp that changes little.
    assert wide.adjoint.flux / narrow.adjoint.flux == pytest.approx(25.0 / 5.0, rel=0.02)
    assert summary(wide)["rayset"] is None


def test_the_csv_has_map_and_profile_with_errors_and_units(light: IlluminationResult, tmp_path: Path) -> None:
    path = tmp_path / "light.csv"
    write_illumination(light, path)
    points = read_points_csv(path)
    assert points.comments[0].startswith("SIMULATED")
    assert any("forward (" in line and "adjoint (" in line for line in points.comments)
    columns = points.columns
    cells, angles = columns["table"] == "irradiance", columns["table"] == "intensity"
    assert set(columns["unit"][cells]) == {"W/m^2"}
    assert set(columns["unit"][angles]) == {"W/sr"}
    # The integral of the map over the field is the flux.
    inside = cells & (np.abs(columns["x_mm"]) < 2.5) & (np.abs(columns["z_mm"]) < 2.5)
    assert columns["value"][inside].mean() * 25e-6 == pytest.approx(light.adjoint.flux, rel=5e-3)
    assert np.isfinite(columns["angle_deg"][angles]).all()
    assert np.isnan(columns["angle_deg"][cells]).all()


def test_the_picture_is_a_png(light: IlluminationResult, tmp_path: Path) -> None:
    path = tmp_path / "light.png"
    write_illumination(light, path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert path.stat().st_size > 30_000
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(UserError, match="cannot be written"):
        write_illumination(light, tmp_path / "absent" / "light.png")


def test_a_rayset_gives_the_ratios_of_the_uniform_pupil(rays: Path) -> None:
    def ratios(source: bool) -> tuple[np.ndarray, np.ndarray]:
        task = Task(
            parse_sample("gaussian:width_deg=15,reflectance=0.5+lambertian:reflectance=0.3"),
            np.array([30.0]),
            instrument=WIDE,
            estimator=EstimatorSettings("forward", paths=1_500_000),
            source=read_source(rays, UNIT, WIDE) if source else None,
            polar_deg=np.arange(10.0, 80.0, 12.0),
            azimuth_deg=np.array([40.0, 75.0, 110.0, 145.0, 180.0]),
        )
        simulation = simulate(task)
        stated = json_value(simulated_summary(simulation, [Path("a.ddr")]))["source"]
        assert (stated is not None) == source
        if stated is not None:
            assert (stated["file"], stated["rays"], stated["geometry"]) == (str(rays), 50_000, UNIT.fingerprint)
            assert any(line.startswith(f"source: rayset {rays}") for line in assumptions(simulation))
        return simulation.at[0].ratio.factor[0], simulation.at[0].ratio.standard_error[0]

    (factor, error), (uniform, its_error) = ratios(True), ratios(False)
    assert not np.array_equal(factor, uniform)
    seen = (error < 0.15 * factor) & (its_error < 0.15 * uniform)
    assert np.count_nonzero(seen) >= 15
    # The same ratio: sample and etalon have the same light.
    agree(factor[seen], error[seen], uniform[seen], its_error[seen])


def test_the_fast_estimator_refuses_a_source(rays: Path) -> None:
    with pytest.raises(UserError, match=r"^--source: the fast estimator .*; give --estimator forward"):
        simulate(Task(parse_sample("lambertian"), np.array([30.0]), source=read_source(rays, UNIT, WIDE)))


def test_rays_of_another_geometry_and_invalid_files_are_refused_in_one_line(rays: Path, tmp_path: Path) -> None:
    def refusal(path: Path, unit: IlluminationUnit = UNIT) -> str:
        with pytest.raises(UserError) as caught:
            read_source(path, unit, WIDE)
        message = str(caught.value)
        assert message.startswith(f"--source: {path}")
        assert message.isprintable()
        return message

    others = illumination_unit(WIDE, 556.0, 0.0, 5.0), illumination_unit(Instrument(pupil_radius_mm=4.0), 555.0, 0.0, 5.0)
    for other in others:
        assert f"another geometry: recorded for {UNIT.fingerprint}" in refusal(rays, other)
    damaged = tmp_path / "damaged.h5"
    content = bytearray(rays.read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    assert "is damaged" in refusal(damaged)
    assert "there is no such file" in refusal(tmp_path / "absent.h5")
    assert read_rayset(rays).geometry == UNIT.fingerprint


@pytest.mark.parametrize(
    ("error", "seed", "count", "message"),
    [
        (0.0, 1, None, "--error"),
        (float("nan"), 1, None, "--error"),
        (1e-7, 1, None, "illumination: "),
        (1.0, -1, None, "--seed"),
        (1.0, 1, 1, "--rays"),
        (1.0, 1, 10**9, "--rays"),
    ],
)
def test_impossible_settings_are_refused(error: float, seed: int, count: int | None, message: str) -> None:
    with pytest.raises(UserError, match=message):
        simulate_illumination(UNIT, error, seed, count, adjoint_error=QUICK)


def test_deviations_are_given_by_element_and_field_and_stated() -> None:
    given = ["slit.x_mm=0.05", "reflector.rz_deg=-0.1", "slit.ry_deg=1"]
    assert parse_deviations(given) == {"slit": Deviation(x_mm=0.05, ry_deg=1.0), "reflector": Deviation(rz_deg=-0.1)}
    unit = illumination_unit(Instrument(illumination=parse_deviations(given)), 555.0, 0.0, 5.0)
    assert describe_deviations(unit) == {"slit": {"x_mm": 0.05, "ry_deg": 1.0}, "reflector": {"rz_deg": -0.1}}
    assert describe_deviations(UNIT) == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("slit", "'slit' is no deviation; write ELEMENT.FIELD=NUMBER"),
        ("slit=3", "'slit=3' is no deviation"),
        ("lens.x_mm=1", "there is no 'lens' in the illumination unit; it has arc, "),
        ("slit.x=1", "slit has no 'x'; its deviations are rx_deg, "),
        ("slit.x_mm=wide", "'slit.x_mm=wide' has no number"),
        ("slit.x_mm=nan", "'slit.x_mm=nan' has no number"),
    ],
)
def test_impossible_deviations_are_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(UserError, match=f"^--deviation: {message}") as caught:
        parse_deviations([text])
    assert str(caught.value).isprintable()


def test_a_deviation_that_is_given_twice_is_refused() -> None:
    with pytest.raises(UserError, match=r"^--deviation: slit.x_mm is given twice; remove one"):
        parse_deviations(["slit.x_mm=0.1", "slit.y_mm=0.1", "slit.x_mm=0.2"])


def test_a_unit_that_lights_the_sample_no_more_is_stated_with_its_deviations() -> None:
    unit = illumination_unit(Instrument(illumination=parse_deviations(["slit.x_mm=4"])), 555.0, 0.0, 5.0)
    with pytest.raises(UserError, match=r"^illumination: with slit.x_mm=4 no light reaches the sample; give "):
        simulate_illumination(unit, 1.0, 1, None)


def test_impossible_monochromators_and_file_names_are_refused(tmp_path: Path) -> None:
    for wavelength, interval, bandwidth, option in (
        (-1.0, 0.0, 5.0, "--wavelength"),
        (555.0, -1.0, 5.0, "--interval"),
        (555.0, 0.0, 0.0, "--bandwidth"),
        (3.0, 0.0, 5.0, "--wavelength"),
    ):
        with pytest.raises(UserError, match=f"^{option} "):
            illumination_unit(WIDE, wavelength, interval, bandwidth)
    with pytest.raises(UserError, match=r"^--wavelength: no light of the lamp passes at 9000 nm"):
        simulate_illumination(illumination_unit(WIDE, 9000.0, 0.0, 5.0), 1.0, 1, None)
    for out, rayset in (("a.txt", None), ("absent/a.png", None), ("a.png", "b.txt"), ("a.png", "absent/b.h5")):
        with pytest.raises(UserError):
            check_file_names(tmp_path / out, None if rayset is None else tmp_path / rayset)
