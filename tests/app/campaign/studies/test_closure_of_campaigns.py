"""The closure of measured campaigns: in the verification, in the command, and as the scale of transmitted light."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.campaign.journal.block_sizes import BlockSizes
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.points import BsdfPoints, Tally
from goniotwin.app.campaign.reduction.readings import ReferenceMeasurements
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.closure import (
    ClosureReport,
    is_own_of_a_scan,
    journal_closure,
)
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.notes import reduction_notes
from goniotwin.app.campaign.studies.verification import verify_journal
from goniotwin.app.rig import read_rig
from tests import rig_tables
from tests.app.campaign.campaign_bench import run_plan
from tests.app.campaign.studies.closure_bench import HEAD, lit_everywhere
from tests.conftest import RIG, SMALL
from tests.system.command import invoke

pytestmark = pytest.mark.xdist_group("closure of campaigns")

SMALL_SCAN = """
sigma_deg = [5, 22]
wavelength_nm = [450, 550]
gains_v_per_a = [1e6, 1e8, 1e10]
[open_beam]
poses = 9
step_deg = 0.25
"""


SATURATED = """
sigma_deg = [22]
wavelength_nm = [550]
gains_v_per_a = [1e10]
[open_beam]
poses = 5
step_deg = 0.4
"""


@pytest.fixture(scope="module")
def closed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ClosureReport]:
    """The journal of a small campaign with noise, and its closures."""
    return measured(SMALL_SCAN, tmp_path_factory.mktemp("closure"))


def measured(table: str, folder: Path) -> tuple[Path, ClosureReport]:
    path = folder / "a.journal"
    run_plan(make_plan(parse_schedule(HEAD + table, "closure.toml"), read_rig(RIG)), path)
    with Journal.open(path) as journal:
        return path, evaluate_journal(journal).closure


def test_the_closure_has_what_the_etalon_owes_to_its_mounting_and_its_pose(closed: tuple[Path, ClosureReport]) -> None:
    """The scan is made without the etalon, so that nothing of it cancels. Another scan has the same mounting, not the pose."""
    keys = {"mounting": 0.02, "uniformity": 0.03, "repeatability": 0.04}
    with Journal.open(closed[0]) as journal:
        reduction = evaluate_journal(journal).reduction
        rig = replace(reduction.settings.rig, uncertainty=rig_tables.stated(**keys))
        found = journal_closure(replace(reduction, settings=replace(reduction.settings, rig=rig))).closures
    for each, before in zip(found, closed[1].closures, strict=True):
        more = {part.name.partition("@")[0]: part for part in each.components if part.name.partition("@")[0] in keys}
        assert {name: part.u for name, part in more.items()} == pytest.approx(keys)
        assert each.u**2 - before.u**2 == pytest.approx(0.02**2 + 0.03**2 + 0.04**2)
        assert each.u_absolute == pytest.approx(before.u_absolute)  # it is of the route by the etalon
        assert [name for name, part in more.items() if is_own_of_a_scan(part)] == ["repeatability"]
        assert more["mounting"].name == "mounting@etalon#1"


def test_a_campaign_closes_at_the_scans_wavelength_and_at_the_other(closed: tuple[Path, ClosureReport]) -> None:
    _, report = closed
    assert [(each.beam.scan.at_deg, each.wavelength_nm) for each in report.closures] == [(22.0, 450.0), (22.0, 550.0)]
    assert report.not_planned == ("sigma 5 deg: below 10 deg beta cannot scan the open beam",)
    assert (report.missing, report.alarms) == ((), [])
    for each in report.closures:
        assert each.ratio == pytest.approx(1.0, abs=0.004)  # the virtual rig has no errors of angles, holes or linearity
        assert 0.006 < lit_everywhere(each).u < 0.01 < each.u < 0.016
        assert each.u_absolute == pytest.approx(
            math.sqrt(each.u**2 - 0.002**2 - 0.001**2 - 0.002**2), rel=1e-9
        )  # certificate, age, edge
        assert each.verdict == "the two scales agree"
        parts = {part.name: part for part in each.components}
        assert parts["certificate"].u == pytest.approx(0.002)
        assert [parts["beam_hole@upper"].u, parts["beam_hole@lower"].u] == [0.004, 0.004]
        # The etalon is read at 1e10, the beam at 1e6 and its flanks at 1e8.
        of_gains = {name: part.sensitivity for name, part in parts.items() if name.startswith("gain_ratio")}
        assert list(of_gains) == [f"gain_ratio[4, {volts} V/A]" for volts in ("1e+10", "1e+06", "1e+08")]
        assert of_gains["gain_ratio[4, 1e+10 V/A]"] == pytest.approx(-1.0, abs=0.01)
        assert 0.6 < of_gains["gain_ratio[4, 1e+06 V/A]"] < 0.9
        assert 3.5 < abs(parts["linearity"].sensitivity) < 5.0
        assert all(part.input is None or part.u == abs(part.sensitivity) * part.input.u for part in each.components)
    (beam,) = report.beams
    assert beam.centroid_deg == pytest.approx([0.0, 0.0], abs=0.01)
    assert sorted(beam.neighbours) == [3, 5]
    for value, u in beam.neighbours.values():  # the virtual rig has no cross-talk
        assert abs(value) < 4.0 * u < 4e-4


def test_an_etalon_that_is_ten_percent_low_is_found(closed: tuple[Path, ClosureReport]) -> None:
    """And one of 5 % where the hole is known to be lit: at sigma 22 a dark corner does as much on one rig in a hundred."""
    _, report = closed
    low = replace(report, closures=tuple(replace(each, certified=each.certified / 0.9) for each in report.closures))
    for each in report.closures:
        less = replace(each, certified=each.certified / 0.95)
        assert less.word == "differ"
        assert lit_everywhere(less).word == "do NOT agree"
    for each in low.closures:
        assert each.z < -4.0
        assert "% below the certificate" in each.verdict
        assert "do NOT agree" in each.verdict
    assert len(low.alarms) == 2
    assert "do NOT agree" in low.verdict
    slightly = replace(low.closures[0], certified=report.closures[0].absolute * (1.0 + 3.0 * low.closures[0].u))
    assert "more than expected" in slightly.verdict


def test_the_verification_of_a_journal_has_its_closure(closed: tuple[Path, ClosureReport]) -> None:
    with Journal.open(closed[0]) as journal:
        (found,) = [each for each in verify_journal(evaluate_journal(journal)) if each.name == "closure"]
    assert found.verdict == "holds"
    assert "the two scales agree in all 2 comparisons" in found.text
    assert found.text.endswith("they agree")


def command(path: Path) -> dict[str, Any]:
    done = invoke("closure", path, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_the_command_lists_ratio_u_z_and_verdict(closed: tuple[Path, ClosureReport]) -> None:
    path, report = closed
    result = command(path)
    assert result["simulated"] is True
    assert [each["z"] for each in result["closures"]] == pytest.approx([each.z for each in report.closures])
    for each in result["closures"]:
        assert each["u"] ** 2 == pytest.approx(math.fsum(u**2 for u in each["components"].values()), rel=1e-12)
        assert each["ratio"] == pytest.approx(each["absolute"] / each["certified"])
    assert result["missing"] == list(report.not_planned)
    text = invoke("closure", path).stdout
    assert text.startswith("SIMULATED, closure of ")
    assert "none: sigma 5 deg: below 10 deg" in text
    assert text.rstrip().endswith(report.verdict)


def test_a_schedule_without_a_scan_has_no_closure(tmp_path: Path) -> None:
    path = tmp_path / "plain.journal"
    run_plan(make_plan(parse_schedule(SMALL, "small.toml"), read_rig(RIG)), path)
    result = command(path)
    assert (result["closures"], result["scans"], result["verdict"]) == ([], [], "there is no closure")
    assert "the schedule has no scan of the open beam" in result["missing"][0]
    assert "there is no closure" in invoke("closure", path).stdout


def test_a_saturated_open_beam_has_no_scale_and_the_reason_is_given(tmp_path: Path) -> None:
    _, report = measured(SATURATED, tmp_path)
    assert report.closures == ()
    (reason,) = report.missing
    assert "photodiode 4 is saturated at every gain in" in reason
    assert report.alarms == [f"no closure: {reason}"]


def test_a_scan_that_has_not_been_measured_is_listed(closed: tuple[Path, ClosureReport]) -> None:
    with Journal.open(closed[0]) as journal:
        reduction = evaluate_journal(journal).reduction
        nothing = ReferenceMeasurements(reduction.measurements, "not mounted")
        without_scan = journal_closure(replace(reduction, signature=nothing))
        without_etalon = journal_closure(replace(reduction, etalon=nothing))
    assert without_scan.missing == ("sigma 22 deg: 0 of 81 poses of the scan have been measured",)
    assert [each.partition(": ")[2] for each in without_etalon.missing] == [
        "the etalon has not been measured in the pose of the scan"
    ] * 2
    assert len(without_etalon.beams) == 1


@pytest.mark.long
def test_transmitted_light_can_be_scaled_by_the_open_beam_and_the_export_states_it(tmp_path: Path) -> None:
    """The same journal with either scale: the values differ by the ratio of the closure, and the component is another."""
    text = HEAD.replace("gaussian-5", "opal").replace('"etalon"', '"white-tile"') + 'light = "transmitted"\n' + SMALL_SCAN
    path = tmp_path / "a.journal"
    run_plan(make_plan(parse_schedule(text + 'scale = "open beam"\n', "closure.toml"), read_rig(RIG)), path)
    with Journal.open(path, BlockSizes(block=10_000)) as journal:
        evaluation = evaluate_journal(journal)
        reduction = evaluation.reduction
        own = reduction.finish("opal", next(reduction.blocks("opal")).points, None)
        closures = {(each.wavelength_nm, each.beam.scan.sigma_deg): each for each in evaluation.closure.closures}
        notes = reduction_notes(evaluation, {"opal": tally_of(own)})
        variances = effects_of(own.where(own.good), reduction.settings).variances()
        reduction = replace(reduction, settings=replace(reduction.settings, absolute={}))
        by_etalon = reduction.finish("opal", next(reduction.blocks("opal")).points, None)
    assert sorted(closures) == [(450.0, 22.0), (550.0, 22.0)]
    assert sum("is that of the open beam" in each for each in notes) == 2
    for (wavelength, sigma), closure in closures.items():
        at = own.transmitted & own.good & (own.wavelength_nm == wavelength) & (own.sigma_deg == sigma)
        assert at.any()
        assert own.bsdf[at] == pytest.approx(by_etalon.bsdf[at] * closure.ratio, rel=1e-12)
        assert own.budget["open_beam"][at] == pytest.approx(closure.u_scale * own.bsdf[at], rel=1e-12)
        for name in ("certificate", "etalon_age", "etalon_edge"):
            assert not own.budget[name][at].any()
    assert np.sum(list(variances.values()), axis=0) == pytest.approx(own.u_bsdf[own.good] ** 2, rel=1e-12)
    low = own.sigma_deg == 5.0
    assert own.bsdf[low] == pytest.approx(by_etalon.bsdf[low], rel=1e-15, nan_ok=True)


def tally_of(points: BsdfPoints) -> Tally:
    tally = Tally()
    tally.add(points)
    return tally
