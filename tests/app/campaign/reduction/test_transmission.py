"""Transmitted light: the etalon is lit from the photodiodes' side, where the mirror unit blocks other directions."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.pose import rig_inputs
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import NewPlan, Plan, make_plan
from goniotwin.app.campaign.reduction.settings import ReductionSettings, reduction_settings
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset, reduce_journal
from goniotwin.app.campaign.studies.theory import theoretical_bsdf
from goniotwin.app.rig import read_rig
from tests.app.campaign.campaign_bench import QUIET
from tests.conftest import REPOSITORY, RIG, Writer

EXAMPLE = REPOSITORY / "examples" / "schedules" / "transmission.toml"
HEAD = """
name = "through"
light = "transmitted"
samples = ["opal"]
etalon = "white-tile"
wavelength_nm = [550]
gains_v_per_a = "automatic"
"""
NEAR = "sigma_deg = SIGMAS\nbeta_deg = [0, 2, 4, 6, 8, 10, 180]\nshift_deg = { start = 0, stop = 4.5, step = 0.5 }\n"
COARSE = "sigma_deg = [0, 30]\nbeta_deg = [0, 90, 180]\n"


def planned(text: str, rig: Path = RIG) -> NewPlan:
    return make_plan(parse_schedule(text, "x.toml"), read_rig(rig))


def measure(plan: Plan, path: Path) -> BsdfDataset:
    run_campaign(plan, path)
    with Journal.open(path) as journal:
        return reduce_journal(journal)


@pytest.mark.parametrize(
    ("rig_changes", "sigmas"),
    [
        pytest.param((), [20], id="one sigma, with noise", marks=pytest.mark.long),
        pytest.param((), [20, 40], id="two, with noise", marks=pytest.mark.long),
        pytest.param(QUIET, [20, 40], id="two, without", marks=pytest.mark.long),
    ],
)
def test_directions_blocked_at_the_etalon_are_flagged_and_all_others_are_right(
    rig_changes: tuple[tuple[str, str], ...], sigmas: list[int], write_rig: Writer, tmp_path: Path
) -> None:
    """Fine steps across the edges of the shadow, where a part of a photodiode's field is blocked."""
    plan = planned(HEAD + NEAR.replace("SIGMAS", str(sigmas)), write_rig(*rig_changes))
    result = measure(plan, tmp_path / "a.journal")
    points = result.samples["opal"]
    assert not points.flag("dead").any()
    good = points.where(points.good)
    z = np.abs(good.bsdf - theoretical_bsdf(result.rig, "opal", good)) / good.u_bsdf
    assert z.max() < 5.0
    assert np.mean(z < 2.0) > 0.95
    assert good.bsdf.size > 1150 * len(sigmas)
    checked = check_plan(plan)
    expected = {
        (round(each.sigma, 3), round(zenith, 3), round(azimuth, 3))
        for each in checked.shadowed_deg
        for zenith, azimuth in each.zenith_azimuth
    }
    flagged = points.where(points.flag("shadowed"))
    keys = zip(flagged.sigma_deg.tolist(), (180.0 - flagged.zenith_deg).tolist(), flagged.azimuth_deg.tolist(), strict=True)
    assert {(sigma, round(zenith, 3), round(azimuth % 360.0, 3)) for sigma, zenith, azimuth in keys} == expected
    assert checked.shadowed_only_for_etalon == len(expected) > 50 * len(sigmas)


@pytest.mark.long
def test_values_are_corrected_for_a_dark_corner_that_an_alignment_knows(
    write_rig: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a virtual rig with a tilted mirror, of which the alignment has the tilts. u is then smaller, too."""
    tilts = "[twin.deviations]\nmirror_1 = { rx_deg = 0.05, ry_deg = 0.07 }\n\n[twin.samples.opal]"
    plan = planned(f"{HEAD}sigma_deg = [65]\nbeta_deg = [0, 90, 180]\n", write_rig(*QUIET, ("[twin.samples.opal]", tilts)))
    path, uncertainty = tmp_path / "a.journal", plan.rig.file.uncertainty
    run_without_wires(plan, path)
    inputs = [each for each in rig_inputs(uncertainty) if each.u > 0.0]
    value = np.array([{"mirror_1_tilt_x": 0.05, "mirror_1_tilt_y": 0.07}.get(each.name, 0.0) for each in inputs])
    found = Alignment(tuple(inputs), value, np.diag([(0.05 * each.u) ** 2 for each in inputs]), "known")
    off, u = [], []
    for alignment in (None, found):
        settings = partial(_with_alignment, reduction_settings, alignment)
        monkeypatch.setattr("goniotwin.app.campaign.reduction.reduction.reduction_settings", settings)
        with Journal.open(path) as journal:
            result = reduce_journal(journal)
        points = result.samples["opal"]
        good = points.where(points.good & (points.zenith_deg < 150.0))
        off.append(good.bsdf / theoretical_bsdf(result.rig, "opal", good) - 1.0)
        u.append(good.u_bsdf / good.bsdf)
    assert np.abs(off[0]).mean() > 0.02
    assert np.abs(off[1]).mean() < 0.3 * np.abs(off[0]).mean()
    assert np.median(u[1]) < 0.7 * np.median(u[0])
    assert np.mean(np.abs(off[1]) < 2.0 * u[1]) > 0.95


def _with_alignment(
    settings_of: Callable[..., ReductionSettings], alignment: Alignment | None, *given: Any
) -> ReductionSettings:
    return replace(settings_of(*given), alignment=alignment)


@pytest.mark.long
def test_the_example_has_values_in_nearly_all_directions(tmp_path: Path) -> None:
    """The example, shortened to one wavelength, two sigmas and three betas, and without the open beam."""
    text = re.sub("wavelength_nm = .*", "wavelength_nm = [550]", EXAMPLE.read_text()).replace("open_beam = true", "")
    text = re.sub("beta_deg = .*", "beta_deg = [0, 90, 180]", text)
    text = re.sub("sigma_deg = .*", "sigma_deg = [0, 40]", text)
    result = rehearse(*plan_rehearsal(parse_schedule(text, "t.toml"), read_rig(RIG), {}))
    spread = result.result.relative_uncertainty["opal"]
    assert spread.to_a_tenth > 0.9 * spread.directions
    assert not any("no value" in each for each in result.result.warnings)


def test_check_warns_of_samples_of_a_virtual_rig_that_give_no_light() -> None:
    def warnings(text: str) -> list[str]:
        return [each for each in check_plan(planned(text)).warnings if "when its" in each]

    assert warnings(HEAD + COARSE) == []
    bare, opaque = warnings(HEAD.replace("white-tile", "etalon").replace("opal", "gaussian-5") + COARSE)
    assert "etalon reflects nothing when its back is lit, so that transmitted light has no scale" in bare
    assert "gaussian-5 transmits nothing when its front is lit" in opaque
    assert check_plan(make_plan(read_schedule(EXAMPLE), read_rig(RIG))).shadowed_only_for_etalon == 135


@pytest.mark.long
def test_a_rehearsal_warns_of_a_sample_without_values_and_gives_the_reason() -> None:
    def warnings(text: str) -> list[str]:
        result = rehearse(*plan_rehearsal(parse_schedule(text, "t.toml"), read_rig(RIG), {}))
        return [each for each in result.result.warnings if "has no value" in each]

    (bare,) = warnings(HEAD.replace("white-tile", "etalon") + COARSE)
    assert "opal has no values: of 108 directions 4 are blocked by the mirror unit, 104 are without a signal" in bare
    (opaque,) = warnings(HEAD.replace("opal", "gaussian-5") + COARSE)
    assert "gaussian-5 has no value above its noise" in opaque
    assert warnings(HEAD + COARSE) == []


@pytest.mark.parametrize(
    ("light", "expected"),
    [
        ("reflected", ["from reflected light"]),
        pytest.param("transmitted", ["from the etalon's signal that scales transmitted light"], marks=pytest.mark.long),
        pytest.param(
            "both",
            ["from reflected light and from the etalon's signal that scales transmitted light"],
            marks=pytest.mark.long,
        ),
    ],
)
def test_a_note_names_the_light_from_which_the_signature_was_subtracted(
    light: str, expected: list[str], tmp_path: Path
) -> None:
    text = HEAD.replace('"transmitted"', f'"{light}"') + "signature = true\nsigma_deg = [30]\nbeta_deg = [90]\n"
    notes = measure(planned(text), tmp_path / "a.journal").notes
    assert [each.partition("subtracted ")[2].partition(".")[0] for each in notes if "subtracted" in each] == expected


def test_the_open_beam_is_not_subtracted_as_a_signature(tmp_path: Path) -> None:
    notes = measure(planned(HEAD + "open_beam = true\nsigma_deg = [30]\nbeta_deg = [90]\n"), tmp_path / "a.journal").notes
    assert not any("subtracted" in each for each in notes)
