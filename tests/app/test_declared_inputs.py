"""Inputs that are declared here alone, and what follows from that: keys, draws, budgets, covariances, closure and documents."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.proof.virtual_rigs import DrawnRigs
from goniotwin.app.campaign.reduction.components import kinds
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.budget import budget_of_value
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig, rig_file_table
from goniotwin.app.rig.inputs import Input, element_deviations, factor_of, inputs, inputs_of_block
from goniotwin.app.toml_file import json_schema
from goniotwin.twin.plant import Plant
from goniotwin.twin.plant.disturbances import ETALON, SAMPLE, SharedBy, Target
from goniotwin.twin.plant.view import Aspect
from tests.conftest import RIG, changed
from tests.input_list import DOCUMENT, renewed

pytestmark = pytest.mark.xdist_group("declared inputs")

STATED = "[uncertainty]\nsample_frame = 0.03\n"
OFF = "[twin.disturbances]\nsample_frame = 0.03\netalon_stain = 0.02\n"
SCHEDULE = """
name = "declared"
samples = ["gaussian-5"]
etalon = "etalon"
beta_deg = [180]
readings = 2
dark_readings = 4
sigma_deg = [22]
wavelength_nm = [550]
gains_v_per_a = [1e6, 1e8, 1e10]
[open_beam]
poses = 9
step_deg = 0.25
"""
TEXT = DOCUMENT.read_text(encoding="utf-8")
MODEL = DOCUMENT.with_name("uncertainty.md")
TEXT_OF_MODEL = MODEL.read_text(encoding="utf-8")
DECLARED_HERE = frozenset({"sample_frame", "etalon_stain"})


@pytest.fixture(scope="module", autouse=True)
def declared() -> Iterator[None]:
    """A factor on the light of each mounting of a sample, and one on the etalon's light."""
    with inputs_of_block():
        Input("sample_frame", 0.0, "light lost at the sample's frame", factor_of(SAMPLE), SharedBy.MOUNTING)
        Input("etalon_stain", 0.01, "stain on the etalon", factor_of(ETALON))
        yield


def rig(tables: str) -> RigDescription:
    """The example rig with further tables."""
    return parse_rig(changed(RIG.read_text(encoding="utf-8"), (("[twin.light]", f"{tables}[twin.light]"),)), RIG.parent, "rig")


SOME_TABLES = "", "[twin.disturbances]\nmirror_tilt_deg = 0.1\n"
HASHES = [rig(each).model_hash() for each in SOME_TABLES]
"""Before the declarations of this module."""


def input_of(key: str) -> Input:
    (found,) = [each for each in inputs() if each.key == key]
    return found


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory, declared: None) -> Path:
    path = tmp_path_factory.mktemp("declared") / "a.journal"
    run_without_wires(make_plan(parse_schedule(SCHEDULE, "declared.toml"), rig(STATED)), path)
    return path


def test_the_rig_file_has_its_keys_with_bounds_and_defaults() -> None:
    tables = json_schema(rig_file_table(), "rig")["$defs"]
    stated, off = (tables[name]["properties"]["etalon_stain"] for name in ("UncertaintyTable", "Disturbances"))
    assert stated == {
        "type": "number",
        "minimum": 0,
        "exclusiveMaximum": 1,
        "default": 0.01,
        "description": "Stain on the etalon.",
    }
    assert off == {**stated, "default": 0.0}
    table = rig(STATED).file.uncertainty
    assert (table.u(input_of("sample_frame")), table.u(input_of("etalon_stain"))) == (0.03, 0.01)
    for place in ("uncertainty", "twin.disturbances"):
        with pytest.raises(UserError, match=rf"rig: {place}\.sample_frame: input should be less than 1, not 1.5"):
            rig(f"[{place}]\nsample_frame = 1.5\n")


def test_at_zero_the_hash_of_a_model_is_what_it_was_before_the_declaration() -> None:
    assert [rig(each).model_hash() for each in SOME_TABLES] == HASHES
    assert rig(OFF).model_hash() not in HASHES


def test_the_virtual_rig_draws_it_and_its_light_changes() -> None:
    models = [rig(tables).model() for tables in ("", OFF)]
    plain, off = (Plant(each) for each in models if each is not None)
    at = Aspect("gaussian-5", 0.0, 550.0, 30.0, 20.0, 150.0, 1.0)
    for sample, name in (("gaussian-5", "sample_frame@gaussian-5#2"), ("etalon", "etalon_stain")):
        aspect = at._replace(sample=sample, mounting=2)
        before, after = (each.steady_photocurrents_a(aspect) for each in (plain, off))
        lit = before > 0.0
        assert off.drawn[name] != 0.0 == plain.drawn[name]
        assert after[lit] / before[lit] == pytest.approx(np.full(lit.sum(), 1.0 + off.drawn[name]), rel=1e-12)


def test_prove_draws_it_as_wide_as_it_is_stated() -> None:
    drawn = DrawnRigs(rig(STATED), "etalon", level=0.005, years=1.0)
    models = [drawn.rig(seed).model() for seed in (3, 4)]
    widths: list[Any] = [{key: width for key, (_, width) in each.disturbances.widths.items()} for each in models if each]
    assert [(each["sample_frame"], each["etalon_stain"]) for each in widths] == 2 * [(0.03, 0.01)]
    assert len({Plant(each).drawn["sample_frame@paint#1"] for each in models if each is not None}) == 2


def test_a_budget_has_it_with_its_source_and_two_values_share_it(journal: Path) -> None:
    with Journal.open(journal) as opened:
        reduction = evaluate_journal(opened).reduction
        points = reduce_journal(opened).samples["gaussian-5"]
        good = points.where(points.good)
        brightest = int(np.argmax(good.bsdf))
        place = {"zenith": float(good.zenith_deg[brightest]), "azimuth": float(good.azimuth_deg[brightest])}
        budget = budget_of_value(reduction, place)
        lines = {each.name: each for each in budget.components}
        frame, stain = lines["sample_frame@gaussian-5#1"], lines["etalon_stain"]
        assert [frame.u, stain.u] == pytest.approx([0.03 * budget.value, 0.01 * budget.value])
        assert (frame.sensitivity > 0.0, stain.sensitivity > 0.0) == (True, False)
        assert frame.input is not None
        assert stain.input is not None
        assert (frame.input.source, frame.input.twin) == ("[uncertainty] sample_frame (stated)", "disturbances.sample_frame")
        assert (stain.input.source, stain.input.shared_by) == ("[uncertainty] etalon_stain (assumed)", "all values")
        assert frame.input.shared_by == "all values of this mounting"
        assert good.budget["sample_frame"] == pytest.approx(0.03 * np.abs(good.bsdf), rel=1e-12)
        without = replace(good, stated={k: v for k, v in good.stated.items() if k not in ("sample_frame", "etalon_stain")})
        pair = np.array([0, good.size - 1])
        shared = [effects_of(each, reduction.settings).covariance(pair, pair) for each in (good, without)]
        assert shared[0] - shared[1] == pytest.approx(1e-3 * np.outer(good.bsdf[pair], good.bsdf[pair]), rel=1e-9)


def test_the_closure_has_what_is_the_etalons(journal: Path) -> None:
    with Journal.open(journal) as opened:
        (closure,) = evaluate_journal(opened).closure.closures
    found = {each.name: each.u for each in closure.components}
    assert found["etalon_stain"] == 0.01
    assert not [name for name in found if name.startswith("sample_frame")]
    without = replace(closure, components=tuple(each for each in closure.components if each.name != "etalon_stain"))
    assert closure.u**2 - without.u**2 == pytest.approx(1e-4)
    assert closure.u_absolute == without.u_absolute  # it is of the route by the certificate


def test_the_lists_of_the_document_have_it() -> None:
    text = renewed(TEXT)
    assert (
        "\n| `sample_frame` | 0 | light lost at the sample's frame | `sample_frame` | all values of this mounting |\n" in text
    )
    assert "\n| `etalon_stain` | 0.01 | stain on the etalon | `etalon_stain` | all values |\n" in text


def test_the_document_is_up_to_date(monkeypatch: pytest.MonkeyPatch) -> None:
    """`make tables` renews it."""
    monkeypatch.setattr(
        "tests.input_list.inputs",
        lambda: tuple(each for each in inputs() if each.key not in DECLARED_HERE),
    )
    assert renewed(TEXT) == TEXT


def test_what_several_inputs_do_to_one_element_adds_up() -> None:
    with inputs_of_block():
        Input("knock_mm", 0.0, "knock", (Target("pupil", "x_mm"), Target("arc", "x_mm")))
        found = element_deviations({"illumination_shift_x": 0.2, "knock": 0.3}, 500.0)
    assert (found["pupil"].x_mm, found["arc"].x_mm) == pytest.approx((0.5, 0.3))


@pytest.mark.parametrize("key", ["etalon_stain", "etalon_stain_per_year", "mirror_2_tilt_x"])
def test_a_second_one_of_a_key_or_of_a_quantity_is_refused(key: str) -> None:
    """The last two keys are others, but what they would be called in a budget and in the virtual rig is there already."""
    with pytest.raises(ValueError, match=f"{key}: there is an input '.*' of that key or quantity already"):
        Input(key, 0.0, "another stain", factor_of(ETALON))


def test_a_factor_of_no_path_is_refused_and_so_is_one_of_the_name_of_a_component() -> None:
    with pytest.raises(ValueError, match="glare: a factor on the light"):
        Input("glare", 0.0, "glare", factor_of(SAMPLE), SharedBy.PHOTODIODE)
    with inputs_of_block():
        Input("dark", 0.0, "shade", factor_of(SAMPLE))
        with pytest.raises(ValueError, match="a declared factor has the name of a component: dark"):
            kinds()


def test_the_document_has_each_component() -> None:
    """Components that follow from a step have no declaration: the table of them is written by hand."""
    table = TEXT_OF_MODEL.partition("| component | what it is |")[2].partition("\n\n")[0]
    names = {*kinds()} - DECLARED_HERE
    assert [name for name in sorted(names) if f"`{name.partition('[')[0]}`" not in table] == []


def test_the_document_explains_each_line_of_a_budget(journal: Path) -> None:
    """Each factor of a product: it is a line of a component, or the input of a key."""
    with Journal.open(journal) as opened:
        lines = budget_of_value(evaluate_journal(opened).reduction, {"zenith": 20.0, "azimuth": 180.0}).components
    words = {word for each in lines for word in re.sub(r"[\[@].*", "", each.name).split("*")}
    of_keys = {name for each in inputs() for name in each.targets}
    assert {"gain_ratio", "etalon_reading"} <= words
    assert [word for word in sorted(words - of_keys) if not re.search(rf"`{word}[`*\[@]", TEXT_OF_MODEL + TEXT)] == []
