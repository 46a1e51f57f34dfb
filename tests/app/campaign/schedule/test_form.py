"""The form of a schedule: fields are keys of the file, and what is typed becomes a value of the file."""

import tomllib
from typing import Any

import pytest

from goniotwin import examples
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.schedule.form import FIELDS, FormField
from goniotwin.app.errors import UserError

QUICK = (examples.FOLDER / "schedules" / "quick.toml").read_text(encoding="utf-8")
FIELD = {each.key: each for each in FIELDS}


def typed(key: str, words: str, text: str = QUICK) -> dict[str, Any]:
    """The content of a schedule after words are typed into a field; it is a valid schedule."""
    edited = FIELD[key].edited(text, words, "quick.toml")
    parse_schedule(edited, "quick.toml")
    return tomllib.loads(edited)


def test_a_form_has_at_most_fifteen_fields_with_a_label_and_the_keys_help() -> None:
    assert len(FIELDS) <= 15
    assert len({each.label for each in FIELDS}) == len(FIELDS)
    helps = [each.help for each in FIELDS]
    assert len(set(helps)) == len(helps)  # each is of its own key
    assert all(len(each) > 10 for each in helps)
    assert FIELD["symmetry"].choices == ("isotropic", "plane-symmetric", "anisotropic")
    assert FIELD["name"].choices == ()


def test_a_field_shows_the_value_as_typed_or_the_default_and_as_shown_changes_nothing() -> None:
    shown = {each.key: each.shown(QUICK, "x") for each in FIELDS}
    assert shown == {
        "name": "quick",
        "samples": "gaussian-5",
        "etalon": "etalon",
        "side": "front",
        "symmetry": "isotropic",
        "sigma_deg": "0, 30, 60",
        "gamma_deg": "0",
        "beta_deg": "0, 180",
        "shift_deg": "0.0 to 4.5 step 0.5",
        "wavelength_nm": "550",
        "gains_v_per_a": "1e8, 1e10",
        "readings": "4",
        "target.relative_u": "",
        "target.longest_h": "",
        "drift.every_s": "",
    }
    for field in FIELDS:
        assert field.edited(QUICK, f" {shown[field.key]} ", "x") == QUICK


@pytest.mark.parametrize(
    ("key", "words", "value"),
    [
        ("name", "paint, batch 7", "paint, batch 7"),
        ("samples", "satin, gaussian-5", ["satin", "gaussian-5"]),
        ("side", "back", "back"),
        ("sigma_deg", "45", [45]),
        ("sigma_deg", "0 to 75 step 15", {"start": 0, "stop": 75, "step": 15}),
        ("sigma_deg", "0 to 60 step 20, 75", [{"start": 0, "stop": 60, "step": 20}, 75]),
        ("sigma_deg", "[10, 20]", [10, 20]),
        ("sigma_deg", "{ start = 0, stop = 60, step = 20 }", {"start": 0, "stop": 60, "step": 20}),
        ("gains_v_per_a", "automatic", "automatic"),
        ("gains_v_per_a", "1e8, 1e11", [1e8, 1e11]),
        ("readings", "8", 8),
    ],
)
def test_what_is_typed_becomes_a_value_of_the_file_and_is_shown_again(key: str, words: str, value: object) -> None:
    assert typed(key, words)[key] == value
    edited = FIELD[key].edited(QUICK, words, "x")
    if words[0] not in "[{":
        assert FIELD[key].shown(edited, "x") == words
    assert sum(old != new for old, new in zip(QUICK.split("\n"), edited.split("\n"), strict=True)) == 1


def test_numbers_stay_as_typed() -> None:
    assert "gains_v_per_a = [1e8, 1.50e10]" in FIELD["gains_v_per_a"].edited(QUICK, "1e8, 1.50e10", "x")


def test_a_field_of_a_table_adds_and_removes_it() -> None:
    assert typed("target.relative_u", "0.01")["target"] == {"relative_u": 0.01}
    both = FIELD["target.longest_h"].edited(FIELD["target.relative_u"].edited(QUICK, "0.01", "x"), "8", "x")
    assert tomllib.loads(both)["target"] == {"relative_u": 0.01, "longest_h": 8}
    assert typed("target.relative_u", "", both)["target"] == {"longest_h": 8}
    with_drift = FIELD["drift.every_s"].edited(QUICK, "300", "x")
    drift = {"every_s": 300, "sigma_deg": 0, "beta_deg": 180, "wavelength_nm": 550}
    assert tomllib.loads(with_drift)["drift"] == drift
    assert tomllib.loads(FIELD["drift.every_s"].edited(with_drift, "600", "x"))["drift"] == {**drift, "every_s": 600}
    assert "drift" not in typed("drift.every_s", "", with_drift)
    assert "gamma_deg" not in typed("gamma_deg", "")


@pytest.mark.parametrize(
    ("field", "words", "reason"),
    [
        (FIELD["readings"], "many", "Readings: 'many' is no number; write one such as 0.01 or 1e10"),
        (FIELD["sigma_deg"], "30; 60", "'30; 60' is neither numbers nor a range; write 30, 60 or 0 to 350 step 10"),
        (FIELD["sigma_deg"], "30, ", "is neither numbers nor a range"),
        (FIELD["target.relative_u"], "0,02", "'0,02' is no number; write one such as 0.01 or 1e10"),
        (FIELD["sigma_deg"], "22,5", "'22,5' may be one number or two; write 22.5 or 22, 5"),
        (FIELD["sigma_deg"], "[30", "is neither numbers nor a range"),
    ],
)
def test_what_is_no_value_is_refused_with_the_label(field: FormField, words: str, reason: str) -> None:
    with pytest.raises(UserError) as refusal:
        field.edited(QUICK, words, "x")
    assert reason in str(refusal.value)
