"""The hash of a virtual rig's model: of every field, without names of classes; and version 1, which does not change."""

import re
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, make_dataclass, replace
from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from goniotwin.app.rig import parse_rig, read_rig
from goniotwin.app.rig.model_hash import canonical_text, model_hash, model_hashes, old_model_hash
from goniotwin.app.rig.twin_file import twin_model
from goniotwin.keys import LATER
from goniotwin.twin import TwinModel
from goniotwin.twin.optics import spectral_table
from tests.conftest import ONE_WAY, RIG, Change, changed

LIGHT = "[twin.light]"
SIGMA = "sigma = { motor = 4, gear = 36.0 }"
DEVIATIONS = "[twin.deviations]\nsample = { ry_deg = 0.05, z_mm = 0.1 }\nmirror_1 = { rx_deg = -0.02 }\n\n"
FRAMES = "[twin.frames]\ngap_mm = 0.5\n\n"
SENSOR = "[twin.sensor]\naperture_mm = 0.5\n\n"
TRACED = '[twin.optics]\nestimator = "forward"\nstray = true\nforward_error = 0.1\n\n'
MORE_OF_SIGMA = (
    "sigma = { motor = 4, gear = 36, sense = -1, zero_deg = 1.5, backlash_deg = 0.1, lower_switch_deg = -2.0, home_deg = 0.0, "
    "module = 2 }"
)
SUM = (
    '[twin.samples.mirror]\nmodel = "sum"\nlobes = [{ model = "regular", reflectance = [0.04, 0.1], sigma_deg = [0.0, 60.0] }, '
    '{ model = "gaussian", width_deg = 3.0, transmits = true, refraction = 1.5, reflectance = 0.2 }]\n\n'
)
ELECTRONICS = (
    "[twin.electronics]\ngains_v_per_a = [1e6, 1e8]\nnoise_v = 2e-4\n\n"
    '[twin.controller]\nwire = "rs485"\nbaudrate = 9600\n\n'
    "[twin.monochromator]\necho = false\nfilters = 0\n\n"
    "[twin.photodiodes]\nupper_deg = [0, 10]\nlower_deg = []\n\n"
)
ANGLES = "[0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 85]"
ONE_CONVERTER: tuple[Change, ...] = (
    (", ".join(f'"twin://virtual/adc-{k}"' for k in range(5)), '"twin://virtual/adc-0"'),
    (f"upper_deg = {ANGLES}", "upper_deg = [0, 10]"),
    (f"lower_deg = {ANGLES}", "lower_deg = []"),
)
"""The operator's table of these photodiodes, of which the model has nothing."""
FORMER: dict[str, tuple[str, tuple[Change, ...], str]] = {
    "as it is": ("virtual", (), "6de96dc27f0d8393"),
    "filters": ("filters", (), "1aabc88211ff0e97"),
    "deviations": ("virtual", ((LIGHT, DEVIATIONS + FRAMES + LIGHT),), "a6d19e93cc1ef3d8"),
    "sensor": ("virtual", ((LIGHT, SENSOR + TRACED + LIGHT),), "1b78d1f074f18dcf"),
    "mechanics": ("virtual", ((SIGMA, MORE_OF_SIGMA), ("noise = true", "noise = false")), "33a64db868dc7bc5"),
    "samples": ("virtual", (("[twin.samples.etalon]", SUM + "[twin.samples.etalon]"),), "e72907c310bf3629"),
    "electronics": ("virtual", ((LIGHT, ELECTRONICS + LIGHT), *ONE_CONVERTER), "3eed4352e4bc670e"),
}
"""Rigs of the examples with changes, and their hashes by the last release that had only version 1."""


def model_of(rig: str, *changes: Change) -> TwinModel:
    path = RIG.with_name(f"{rig}.toml")
    model = parse_rig(changed(path.read_text(encoding="utf-8"), (ONE_WAY, *changes)), path.parent, rig).model()
    assert model is not None
    return model


def full_model() -> TwinModel:
    """A model with a value in nearly every field."""
    model = model_of("filters", (LIGHT, DEVIATIONS + LIGHT), ("[twin.samples.etalon]", SUM + "[twin.samples.etalon]"))
    table = spectral_table([450.0, 650.0], [0.0, 60.0], [0.0, 180.0], [0.0, 90.0], np.full((2, 2, 2, 2), 0.1), "coloured")
    return replace(model, samples={**model.samples, "coloured": table})


@pytest.mark.parametrize(("rig", "changes", "former"), FORMER.values(), ids=FORMER)
def test_version_1_does_not_change(rig: str, changes: tuple[Change, ...], former: str) -> None:
    model = model_of(rig, *changes)
    assert old_model_hash(model) == former
    assert model_hashes(model) == (model_hash(model), former)


def test_both_versions_differ_for_different_rigs_and_the_new_one_has_its_prefix() -> None:
    digests = [model_hashes(model_of(rig, *changes)) for rig, changes, _ in FORMER.values()]
    assert len({each for hashes in digests for each in hashes}) == 2 * len(FORMER)
    assert all(re.fullmatch(r"2:[0-9a-f]{16}", hashes[0]) for hashes in digests)


def _default(entry: Any) -> dict[str, Any]:
    """The default of a field, or what makes it."""
    return {"default": entry.default} if entry.default_factory is MISSING else {"default_factory": entry.default_factory}


def renamed(value: Any) -> Any:
    """The same value with every dataclass replaced by one of another name, with its fields in another order."""
    if is_dataclass(value) and not isinstance(value, type):
        content = {entry.name: renamed(getattr(value, entry.name)) for entry in reversed(fields(value))}
        columns = [
            (entry.name, Any, field(**_default(entry), metadata=entry.metadata, kw_only=True))
            for entry in reversed(fields(value))
        ]
        return make_dataclass(f"Other{type(value).__name__[::-1]}", columns, frozen=True, eq=False)(**content)
    if isinstance(value, tuple):
        return tuple(renamed(each) for each in value)
    if isinstance(value, MappingProxyType | dict):
        return type(value)({key: renamed(each) for key, each in value.items()})
    return value


@pytest.mark.parametrize(("rig", "changes", "former"), FORMER.values(), ids=FORMER)
def test_names_of_classes_and_the_order_of_fields_do_not_matter(rig: str, changes: tuple[Change, ...], former: str) -> None:
    model = model_of(rig, *changes)
    other = renamed(model)
    assert repr(other.light).startswith(f"Other{type(model.light).__name__[::-1]}(")
    assert model_hashes(other) == (model_hash(model), former)


def variants(value: Any, place: str) -> Iterator[tuple[str, Any]]:
    """Copies of a value with one number, text, flag or entry changed each, and the place of the change."""
    if is_dataclass(value) and not isinstance(value, type):
        for entry in fields(value):
            for where, other in variants(getattr(value, entry.name), f"{place}.{entry.name}"):
                yield where, _with(value, entry.name, other)
    elif isinstance(value, tuple):
        for k, each in enumerate(value):
            for where, other in variants(each, f"{place}[{k}]"):
                yield where, (*value[:k], other, *value[k + 1 :])
        yield f"{place} longer", (*value, value[0] if value else 1.0)
    elif isinstance(value, MappingProxyType | dict):
        for key, each in value.items():
            for where, other in variants(each, f"{place}[{key!r}]"):
                yield where, type(value)({**value, key: other})
            yield f"{place} without {key}", type(value)({name: other for name, other in value.items() if name != key})
            moved = {f"{name}'" if name == key else name: other for name, other in value.items()}
            yield f"{place}: {key} renamed", type(value)(moved)
    elif isinstance(value, np.ndarray):
        other = value.copy()
        other.flat[-1] += 1e-12
        yield f"{place} other", other
        yield f"{place} reshaped", value.reshape(1, *value.shape)
    else:
        yield f"{place} other", _other(value)


def _with(value: Any, name: str, other: Any) -> Any:
    """A copy of a frozen dataclass with one field replaced, without the checks of its constructor."""
    copy = object.__new__(type(value))
    for entry in fields(value):
        object.__setattr__(copy, entry.name, other if entry.name == name else getattr(value, entry.name))
    return copy


def _other(value: object) -> object:
    if value is None:
        return 0.0
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return f"{value}'"
    assert isinstance(value, int | float)
    return value + 1 if isinstance(value, int) else float(np.nextafter(value, np.inf))


@pytest.mark.parametrize("model", [full_model(), model_of(*("virtual", FORMER["sensor"][1][0]))], ids=["full", "sensor"])
def test_a_change_of_any_field_changes_both_versions(model: TwinModel) -> None:
    own = model_hash(model)
    seen = {own: "the model"}
    old = old_model_hash(model)
    assert old is not None
    names = [f".samples[{key!r}].name other" for key in model.samples]
    unchanged = []
    for place, other in variants(model, ""):
        digest = model_hash(other)
        if digest == own:
            unchanged.append(place)
            continue
        assert digest not in seen, f"{place} and {seen[digest]} give the same hash"
        seen[digest] = place
        if not place.endswith("reshaped"):  # version 1 covers only the shape of a lobe's values
            assert old_model_hash(other) != old, place
    assert unchanged == [".seed other", *names]
    assert len(seen) > 150


class Kind(StrEnum):
    LAMP = "lamp"


class Number(IntEnum):
    TWO = 2


@dataclass
class Some:
    number: float = 1.0
    more: tuple[float | None, ...] = (None, 2.0)
    table: np.ndarray = field(default_factory=lambda: np.array([[1.0, np.nan]]))


def test_the_canonical_text_depends_only_on_values() -> None:
    text = canonical_text(Some())
    assert text.startswith('{"more": [null, 2.0], "number": 1.0, "table": array (1, 2) <f8 ')
    assert canonical_text(Some(table=np.array([[1.0, np.nan]], dtype=">f8"))) == text
    assert canonical_text(Some(table=np.asfortranarray([[1.0, np.nan]]))) == text
    values = [1, -0.0, True, "1.0", Kind.LAMP, Number.TWO, float("inf")]
    assert canonical_text(values) == '[1.0, 0.0, true, "1.0", "lamp", 2.0, inf]'
    assert canonical_text((np.float64(0.1), np.int64(3))) == "[0.1, 3.0]"
    assert canonical_text(2**60 + 1) == "1152921504606846977"
    assert canonical_text({"b": 1, "a": "é"}) == '{"a": "\\u00e9", "b": 1.0}'


@pytest.mark.parametrize("value", [len, object(), Some, np.array([object()]), {"a": {1.0, 2.0}}])
def test_a_value_that_cannot_be_compared_has_no_canonical_text(value: object) -> None:
    with pytest.raises(TypeError, match="has no canonical text"):
        canonical_text(value)


def test_a_model_that_version_1_cannot_represent_has_no_old_hash() -> None:
    model = model_of("virtual")
    light = make_dataclass("Light", [("later", float, field(default=0.0))], bases=(type(model.light),), frozen=True)
    assert old_model_hash(replace(model, light=light())) == old_model_hash(replace(model, light=type(model.light)()))
    assert old_model_hash(replace(model, light=light(later=0.5))) is None
    assert len(model_hashes(replace(model, light=light(later=0.5)))) == 1


def test_a_later_field_counts_only_where_it_is_not_at_its_default() -> None:
    model = model_of("virtual")
    later = ("later", bool, field(default=False, metadata=LATER))
    light = make_dataclass("Light", [later], bases=(type(model.light),), frozen=True)
    plain = model_hash(replace(model, light=type(model.light)()))
    assert model_hash(replace(model, light=light())) == plain
    assert model_hash(replace(model, light=light(later=True))) != plain


def test_version_2_does_not_change() -> None:
    assert model_hash(model_of("virtual")) == "2:53c954a4394e10c9"


def test_the_hashes_of_a_rig_file_are_those_of_its_model() -> None:
    description = read_rig(RIG)
    model = description.model()
    assert model is not None
    assert description.model_hashes() == model_hashes(model)
    assert description.model_hash() == model_hash(model)
    assert description.file.twin is not None
    assert model_hash(twin_model(description.file.twin, 7, RIG.parent, "rig")) == model_hash(model)
