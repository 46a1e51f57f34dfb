"""Components and inputs of a budget in words: no identifier, and which element, row, move or mounting it is."""

import re

import pytest

from goniotwin.app.campaign.reduction.components import kinds, words_of
from goniotwin.app.rig.inputs import inputs


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("noise", "noise of the readings"),
        ("certificate[level]", "certificate of the etalon (level)"),
        ("dark[3, 1e+11 V/A]@dark 6", "dark readings (photodiode 3, 1e+11 V/A, dark reading 6)"),
        ("etalon_reading[0]@row 12", "noise of the reading of the etalon (photodiode 0, row 12)"),
        ("position@sigma#6", "position of the axes after a move (sigma, move 6)"),
        ("repeatability@#4", "change of the signal of sample and etalon when a pose is reached again (move 4)"),
        ("mirror_2_tilt_x", "mirror 2 tilt about x"),
        ("arc_shift_z", "arc shift along z"),
        ("sample_tilt_y@a paint@2#1", "sample tilt about y (a paint@2, mounting 1)"),
        (
            "etalon_height*sensor_tilt_y@etalon#1",
            "lift of the etalon along its normal times sensor tilt about y (etalon, mounting 1)",
        ),
        ("alignment[3]", "alignment (3)"),
        ("not_known[", "not_known["),
    ],
)
def test_a_name_of_a_budget_in_words(name: str, words: str) -> None:
    assert words_of(name) == words


def test_no_component_and_no_declared_input_is_an_identifier() -> None:
    for name in (*kinds(), *(target for each in inputs() for target in each.targets)):
        assert not re.search(r"\w_\w", words_of(name)), name
