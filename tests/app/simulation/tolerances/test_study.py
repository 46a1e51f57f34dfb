"""Study files: what they give, and the one line with which a wrong one is refused."""

import math
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.tolerances.study import (
    InstrumentTable,
    StudyFile,
    component_matrix,
    levels_of_parameters,
    parameters_of,
    read_study,
)
from goniotwin.app.toml_file import json_schema
from goniotwin.twin.optics.geometry.instrument import ELEMENTS
from tests.conftest import REPOSITORY

FOLDER = REPOSITORY / "examples" / "tolerances"
QUICK = (FOLDER / "quick.toml").read_text(encoding="utf-8")


def study_of(text: str, folder: Path) -> StudyFile:
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return read_study(path)


def test_the_examples_have_the_deviations_of_the_papers_tables() -> None:
    one, two = (read_study(FOLDER / f"table{number}.toml") for number in (1, 2))
    unit, rig = (parameters_of(study.deviations, InstrumentTable().instrument()) for study in (one, two))
    assert (len(unit), len(rig)) == (30, 12)
    assert {(each.unit, each.limit) for each in unit} == {("deg", 0.05), ("mm", 0.025)}
    assert {(each.unit, each.limit) for each in rig} == {("deg", 0.05)}
    assert {each.element for each in rig} == {"mirror_1", "mirror_2", "mirror_3", "sample", "arc", "beam"}
    counts = [len(parameters_of(two.of_variant(each), InstrumentTable().instrument())) for each in two.variants]
    assert counts == [
        12,
        12,
        10,
        27,
        15,
    ]  # with the slit's image, collimated, the paper's own elements, with the shifts of +-0.1 mm, these alone
    assert math.prod(each.size for each in levels_of_parameters(rig)) == 531_441


def test_a_tilt_of_the_beam_turns_the_pupil_about_the_sample(tmp_path: Path) -> None:
    study = study_of(QUICK, tmp_path)
    instrument = study.instrument.instrument()
    parameters = parameters_of(study.deviations, instrument)
    matrix = component_matrix(parameters, ELEMENTS).reshape(4, len(ELEMENTS), 6)
    moved = matrix[3, ELEMENTS.index("pupil")]
    assert moved[2] == 1.0  # rz
    assert moved[3] == pytest.approx(math.radians(800.0))  # x, mm per degree
    assert np.count_nonzero(matrix[3]) == 2
    assert [np.count_nonzero(row) for row in matrix[:3]] == [1, 1, 1]


def test_a_collimated_beam_has_the_same_divergence() -> None:
    near, far = InstrumentTable().instrument(), InstrumentTable(collimated=True).instrument()
    assert far.divergence_deg == pytest.approx(near.divergence_deg)
    assert far.pupil_distance_mm > 1e6


BAD = [
    (("limit_deg = 0.05", "limit_dge = 0.05"), r"there is no such key; did you mean 'limit_deg'\?"),
    (("limit_deg = 0.05\n", "\n"), r"deviations\.0\.limit_deg: is missing; give the range of the angles"),
    (('angles = ["ry"]\n', "\n"), r"deviations\.0\.limit_deg: has no angles to limit"),
    (('"sample"', '"smaple"'), r"deviations\.0\.elements: there is no 'smaple' .*known are pupil, mirror_1"),
    (('kind = "gaussian"', 'kind = "flux"'), r"criterion\.sigma_deg: there is no such key in this table"),
    (('kind = "gaussian"', 'kind = "gauss"'), r"criterion: .*gauss"),
    (("step_deg = 0.025", "step_deg = 0.1"), r"deviations\.0\.step_deg: 0\.1 is not from 0\.001 to the limit"),
    (('angles = ["rz"]', 'angles = ["ry"]'), r"deviations\.1: the beam turns about the sample by rx and rz alone"),
    (('"mirror_3", "sample"', '"sample", "sample"'), r"deviations: the study has sample ry twice"),
    (("draws = 2000", "draws = 3"), r"yields\.draws: .*100"),
    (("within_percent = [5]", "within_percent = [500]"), r"criterion\.within_percent\.0: .*less than 100"),
    (("limit_deg = 0.05", "limit_deg = 60"), r"deviations\.0\.limit_deg: 60 is more than 20 deg, no deviation"),
    (("[criterion]", "[alone]\nlargest_deg = 0.01\n[criterion]"), r"alone\.largest_deg: 0\.01 is less than a limit, 0\.05 deg"),
    (("[criterion]", '[[variants]]\nname = "v"\n[criterion]'), r"variants\.0: 'v' is the study itself"),
    (("[criterion]", '[[variants]]\nname = "v"\nwithout = ["mirror_1"]\n[criterion]'), r"variants\.0\.without: .*'mirror_1'"),
    (
        ("[criterion]", 2 * '[[variants]]\nname = "v"\nwithout = ["beam"]\n' + "[criterion]"),
        r"variants\.1\.name: 'v' is the name",
    ),
    (("[criterion]", "[criterion"), r"is not TOML: .*line 4"),
]


@pytest.mark.parametrize(("change", "message"), BAD)
def test_a_wrong_study_file_is_refused_in_one_line_with_the_key(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    assert change[0] in QUICK
    with pytest.raises(UserError, match=message) as caught:
        study_of(QUICK.replace(*change, 1), tmp_path)
    assert str(caught.value).startswith(str(tmp_path / "study.toml"))


def test_the_elements_of_the_illumination_unit_are_those_of_the_criterion_of_the_flux(tmp_path: Path) -> None:
    text = (FOLDER / "table1.toml").read_text(encoding="utf-8")
    with pytest.raises(UserError, match=r"there is no 'mirror_1' with the criterion .flux.; known are arc, reflector"):
        study_of(text.replace('"arc", ', '"mirror_1", '), tmp_path)


def test_a_flux_has_no_surrogate(tmp_path: Path) -> None:
    text = (FOLDER / "table1.toml").read_text(encoding="utf-8")
    with pytest.raises(UserError, match=r"combinations\.evaluator: a flux has no surrogate; write .exact."):
        study_of(text.replace("[combinations]", '[combinations]\nevaluator = "surrogate"'), tmp_path)


LIGHT = """
[illumination]
[[illumination.deviations]]
elements = ["unit"]
angles = ["rx"]
limit_deg = 0.05
"""
BAD_LIGHT = [
    (
        (LIGHT, '[combinations]\nevaluator = "surrogate"\n[instrument]\nlit_everywhere = false\n'),
        r"instrument\.lit_everywhere: the surrogate knows no edge of the slit's image; write combinations\.evaluator = .exact.",
    ),
    (('["unit"]', '["mirror_1"]'), r"illumination\.deviations\.0\.elements: there is no 'mirror_1' of the illumination unit"),
    (('["unit"]', '["unit", "unit"]'), r"illumination\.deviations: unit rx is in it twice"),
    ((LIGHT, LIGHT + "[instrument]\ncollimated = true\n"), r"illumination: a collimated beam has no illumination unit"),
    (("[illumination]\n", '[illumination]\nlight = ["warm"]\n'), r"illumination\.light\.0: .*anew.*frozen"),
]


@pytest.mark.parametrize(("change", "message"), BAD_LIGHT)
def test_a_light_that_a_study_cannot_have_is_refused_in_one_line(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    assert change[0] in LIGHT
    assert study_of(QUICK + LIGHT, tmp_path).illumination is not None
    with pytest.raises(UserError, match=message):
        study_of(QUICK + LIGHT.replace(*change), tmp_path)


def test_the_illumination_unit_by_itself_has_no_light_of_another(tmp_path: Path) -> None:
    text = (FOLDER / "table1.toml").read_text(encoding="utf-8")
    with pytest.raises(UserError, match=r"illumination: a study with the criterion .flux. is that of the unit itself"):
        study_of(text + LIGHT, tmp_path)


def test_every_key_of_a_study_has_a_description() -> None:
    schema = json_schema(StudyFile, "goniotwin tolerances file")
    for each in (schema, *schema["$defs"].values()):
        assert [key for key, value in each["properties"].items() if "description" not in value] == [], each["title"]
