"""The figure of the elements: its path of the light, and arrows in the sense in which the twin moves the elements."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from goniotwin.app.simulation.tolerances.elements_figure import (
    arrow,
    illumination_elements,
    instrument_elements,
    light_path,
    view_from,
    write_elements,
)
from goniotwin.app.simulation.tolerances.study import parameters_of, read_study
from goniotwin.twin.optics import Deviation, IlluminationUnit, Instrument
from goniotwin.twin.optics.geometry.deviation import rotation_and_shift
from goniotwin.twin.optics.geometry.mirrors import mirrors_at
from tests.conftest import REPOSITORY


@pytest.mark.parametrize("sigma", [0.0, 30.0, 120.0])
def test_the_light_goes_round_the_papers_square_to_the_sample(sigma: float) -> None:
    path = light_path(Instrument(), sigma)
    steps = np.diff(path, axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 200.0)  # the paper's distance, and ours to the exit pupil
    np.testing.assert_allclose(np.sum(steps[1:] * steps[:-1], axis=1), 0.0, atol=1e-9)  # each mirror turns it by 90 deg
    towards = np.array([np.sin(np.radians(sigma)), 0.0, np.cos(np.radians(sigma))])
    np.testing.assert_allclose(path[3], 200.0 * towards, atol=1e-9)


@pytest.mark.parametrize("name", ["sample", "arc"])
@pytest.mark.parametrize("angle", ["rx", "ry", "rz"])
def test_an_arrow_of_an_angle_is_the_path_of_a_point_that_the_twin_turns(name: str, angle: str) -> None:
    line = arrow(instrument_elements(Instrument(), 30.0)[name], angle)
    turn, _ = rotation_and_shift(Deviation(**{f"{angle}_deg": 1.0}))
    start = line[0]
    along = (turn @ start - start) @ (line[1] - start)
    assert along / np.linalg.norm(turn @ start - start) / np.linalg.norm(line[1] - start) > 0.99
    np.testing.assert_allclose(np.linalg.norm(line, axis=1), np.linalg.norm(start))


@pytest.mark.parametrize("number", [1, 2, 3])
@pytest.mark.parametrize("angle", ["rx", "ry"])
def test_an_arrow_of_a_mirror_turns_as_its_normal_does(number: int, angle: str) -> None:
    name, sigma = f"mirror_{number}", 30.0
    element = instrument_elements(Instrument(), sigma)[name]
    off = Instrument(deviations={name: Deviation(**{f"{angle}_deg": 1.0})})
    normals = [mirrors_at(each, sigma).normals[number - 1] for each in (Instrument(), off)]
    line = arrow(element, angle) - element.reference
    about = np.cross(line[0], line[1])
    assert np.cross(*normals) @ about > 0.99 * np.linalg.norm(np.cross(*normals)) * np.linalg.norm(about)


@pytest.mark.parametrize("shift", ["x", "y", "z"])
def test_an_arrow_of_a_shift_is_along_the_shift_of_the_twin(shift: str) -> None:
    for name, element in illumination_elements(IlluminationUnit()).items():
        unit = IlluminationUnit(deviations={name: Deviation(**{f"{shift}_mm": 1.0})})
        moved = illumination_elements(unit)
        # The unit itself turns about the exit pupil, which it takes along.
        place = moved["output_condenser" if name == "unit" else name].reference - element.reference
        line = arrow(element, shift)
        np.testing.assert_allclose(place, (line[1] - line[0]) / np.linalg.norm(line[1] - line[0]), atol=1e-12)


def test_a_view_keeps_distances_across_it() -> None:
    view = view_from(-35.0, 24.0)
    np.testing.assert_allclose(view.of(np.stack([view.right, view.up])), np.eye(2), atol=1e-12)
    assert view.of(np.array([0.0, 0.0, 1.0]))[1] > 0.0


@pytest.mark.parametrize("number", [1, 2])
def test_the_figures_of_both_tables_are_the_pictures_of_the_page(number: int, tmp_path: Path) -> None:
    study = read_study(REPOSITORY / "examples" / "tolerances" / f"table{number}.toml")
    instrument = study.instrument.instrument()
    cases = [SimpleNamespace(parameters=parameters_of(study.of_variant(each), instrument)) for each in (None, *study.variants)]
    result: Any = SimpleNamespace(study=study, cases=cases)
    write_elements(result, tmp_path / "elements.png")
    kept = REPOSITORY / "docs" / "pictures" / f"table{number}-elements.png"
    drawn = (tmp_path / "elements.png").read_bytes()
    assert drawn[:8] == kept.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert drawn[16:24] == kept.read_bytes()[16:24]  # width and height
