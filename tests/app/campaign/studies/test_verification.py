"""Budgets of values and reflectances, and verdicts on a journal: on small campaigns of a virtual rig without wires."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.effects import Component
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies import verification
from goniotwin.app.campaign.studies.budget import (
    Line,
    budget_of_reflectance,
    budget_of_value,
    effective_degrees_of_freedom,
    parse_place,
)
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.journals import check_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.campaign.studies.verification import Verdict, reciprocal_pairs, verify_journal
from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from tests.app.campaign.reduction.made_points import made_points
from tests.conftest import Change, Writer

PAIRS = (("sigma_deg = [30]", "sigma_deg = [30, 35]"), ("beta_deg = [180]", "beta_deg = [0, 180]"))
HALF_SPHERE = (
    ("beta_deg = [180]", "beta_deg = { start = 0, stop = 180, step = 45 }"),
    ("shift_deg = [0, 1]", "shift_deg = [0]"),
    ('samples = ["gaussian-5"]', 'samples = ["paint"]'),
)
PAINT = ("[twin.samples.etalon]", '[twin.samples.paint]\nmodel = "lambertian"\nreflectance = 0.6\n\n[twin.samples.etalon]')
SPREAD = ("[twin.light]", "[twin.electronics]\ngain_spread = 0.02\n\n[twin.light]")
TURNED = ("sigma = { motor = 4, gear = 36.0 }", "sigma = { motor = 4, gear = 36.0, zero_deg = 1.0 }")
Measure = Callable[..., Path]


@pytest.fixture
def measure(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> Measure:
    def run(schedule: tuple[Change, ...], *rig: Change) -> Path:
        path = tmp_path / "a.journal"
        run_without_wires(make_plan(read_schedule(write_schedule(*schedule)), read_rig(write_rig(*rig))), path)
        return path

    return run


def verdicts(path: Path) -> dict[str, Verdict]:
    with Journal.open(path) as journal:
        return {each.name.partition(" of ")[0]: each for each in verify_journal(evaluate_journal(journal))}


def test_the_components_of_a_value_add_up_to_its_uncertainty(measure: Measure, capsys: pytest.CaptureFixture[str]) -> None:
    path = measure(PAIRS)
    with Journal.open(path) as journal:
        points = reduce_journal(journal).samples["gaussian-5"]
        found = budget_of_value(evaluate_journal(journal).reduction, parse_place("sigma=30, zenith=36, azimuth=180"))
    (k,) = np.flatnonzero((points.sigma_deg == 30.0) & (points.zenith_deg == 36.0) & (points.azimuth_deg == 180.0))[:1]
    assert found.value == points.bsdf[k]
    assert found.u == pytest.approx(points.u_bsdf[k], rel=1e-12)
    assert math.fsum(each.u**2 for each in found.components) == pytest.approx(found.u**2, rel=1e-12)
    sizes = [each.u for each in found.components]
    assert sizes == sorted(sizes, reverse=True)
    assert found.components[0].name == "sample_tilt_y@gaussian-5#1"  # on the flank of a lobe of 5 deg
    result = found.listed
    assert sum(each.share for each in result.components) == pytest.approx(1.0, rel=1e-12)
    assert result.components[0].shared_by
    app(["budget", str(path), "--at", "sigma=30,theta=6,phi=180"], standalone_mode=False)
    text = capsys.readouterr().out
    assert "SIMULATED, gaussian-5, 550 nm, sigma 30" in text
    assert "sample_tilt_y@gaussian-5#1" in text


def line(name: str, u: float, degrees: float = math.inf, estimate: str = "") -> Line:
    return Line(Component(name, u, 1.0, None), "measured", degrees, estimate or name)


def test_effective_degrees_of_freedom_are_those_of_the_guides_example() -> None:
    """GUM, G.4.2: y = b X1 X2 X3, relative u of 0.25, 0.57 and 0.82 % by 10, 5 and 15 observations: u 1.03 %, 19.0 degrees."""
    lines = [line("X1", 0.25, 9), line("X2", 0.57, 4), line("X3", 0.82, 14)]
    assert effective_degrees_of_freedom(lines) == pytest.approx(19.0, abs=0.05)
    exact = [*lines, line("b", 2.0)]  # as large again, and known: those of u grow with the fourth power
    u_squared = 0.25**2 + 0.57**2 + 0.82**2
    expected = effective_degrees_of_freedom(lines) * (1.0 + 2.0**2 / u_squared) ** 2
    assert effective_degrees_of_freedom(exact) == pytest.approx(expected, rel=1e-12)
    assert math.isinf(effective_degrees_of_freedom([line("b", 2.0)]))


def test_components_of_one_estimate_have_its_degrees_of_freedom_together() -> None:
    """Each of two has half of a variance: by one estimate u has its degrees of freedom, by two of them twice as many."""
    one = [line(name, 1.0, 7, "noise") for name in ("noise", "dark")]
    two = [line(name, 1.0, 7) for name in ("noise", "dark")]
    assert effective_degrees_of_freedom(one) == pytest.approx(7.0)
    assert effective_degrees_of_freedom(two) == pytest.approx(14.0)


def test_a_budget_marks_what_is_measured_stated_and_assumed(measure: Measure) -> None:
    """Stated is what stands in the rig file, at whatever number; noise has the degrees of freedom of the readings."""
    stated = ("range_a = 500e-9", "range_a = 500e-9\nrelative_uncertainty = 3e-4")
    table = ("[twin.light]", "[uncertainty]\netalon_edge = 2e-3\n\n[twin.light]")
    at = parse_place("sigma=30, zenith=36, azimuth=180")
    with Journal.open(measure(PAIRS, stated, table)) as journal:
        reduction = evaluate_journal(journal).reduction
        found = budget_of_value(reduction, at)
        dark = [each for row in journal.rows("dark") for each in row.data.readings]
        degrees = min(
            sum(len(each.counts) - 1 for each in dark if each.gain_v_per_a == gain)
            for gain in {each.gain_v_per_a for each in dark}
        )
        lit = [each.counts for row in journal.rows("measure", "drift") for each in row.data.readings]
        saturated = reduction.rig.file.photodiodes.range.saturated
        of_lit = sum((len(each) - 1) * ~np.any(saturated(each), axis=0) for each in lit)
        degrees = 1.0 / (1.0 / degrees + 1.0 / np.sum(of_lit))
    lines = {each.component.name.partition("@")[0].partition("[")[0]: each for each in found.lines}
    origins = {name: each.origin for name, each in lines.items()}
    assert [origins[name] for name in ("noise", "dark", "etalon_reading")] == 3 * ["measured"]
    assert [origins[name] for name in ("monitor", "etalon_edge", "gain_ratio")] == 3 * ["stated"]
    assert [origins[name] for name in ("etalon_age", "sample_tilt_y", "crosstalk")] == 3 * ["assumed"]
    of_noise = [lines[name].degrees_of_freedom for name in ("noise", "dark", "etalon_reading")]
    assert of_noise == pytest.approx(3 * [degrees], rel=1e-12)
    assert math.isinf(lines["sample_tilt_y"].degrees_of_freedom)
    noise, lamp = (
        math.fsum(each.component.u**2 for each in found.lines if each.estimate == name) for name in ("noise", "lamp")
    )
    spread = noise**2 / degrees + lamp**2 / np.max(of_lit)
    assert found.degrees_of_freedom == pytest.approx(found.u**4 / spread, rel=1e-12)
    result = found.listed
    assert found.degrees_of_freedom > 1e6
    assert result.degrees_of_freedom is None  # no other than infinitely many
    assert {each.origin for each in result.components} <= {"measured", "stated", "assumed", ""}


@pytest.mark.parametrize(
    ("at", "words"),
    [
        ("sigma=30,zenith=36", "--at: a direction is missing; give zenith and azimuth, or theta and phi"),
        ("zenith=36,azimuth=180", "--at: sigma is missing; gaussian-5 was measured at 30, 35 deg"),
        ("sigma=31,zenith=36,azimuth=180", "--at sigma=31: gaussian-5 was not measured there, but at 30, 35 deg"),
        ("sigma=30,zenith=36.4,azimuth=180", r"no direction within 0.05 deg .* the nearest are zenith 36, azimuth 180"),
        ("sigma=30,zenith=36,theta=6,phi=180", "--at zenith: give either theta and phi, or zenith and azimuth"),
        ("sigma=30,zenith=36,azimuth=180,light=transmitted", "gaussian-5 has no such values there, only reflected light"),
        ("sigma=30,zenith=36,azimuth=180,photodiode=3.5", r"photodiode=3.5: gaussian-5 has no values of it there, but of \d"),
        ("sample=paint,sigma=30,zenith=36,azimuth=180", "--at sample=paint: choose one of the journal's samples: gaussian-5"),
    ],
)
def test_a_place_without_a_value_is_refused_with_its_neighbours(at: str, words: str, measure: Measure) -> None:
    with Journal.open(measure(PAIRS)) as journal, pytest.raises(UserError, match=words):
        budget_of_value(evaluate_journal(journal).reduction, parse_place(at))


@pytest.mark.parametrize("at", ["sigma", "sigma=x", "sigma=nan", "colour=1", "sigma=1,sigma=2", "light=green"])
def test_a_place_that_is_none_is_one_line(at: str) -> None:
    with pytest.raises(UserError, match=r"^--at "):
        parse_place(at)


def test_a_half_sphere_has_a_reflectance_with_its_budget(measure: Measure) -> None:
    path = measure(HALF_SPHERE, PAINT)
    with Journal.open(path) as journal:
        found = budget_of_reflectance(evaluate_journal(journal).reduction, parse_place("sigma=30"))
    assert abs(found.value - 0.6) < 3.0 * found.u < 0.1
    assert math.fsum(each.u**2 for each in found.components) == pytest.approx(found.u**2, rel=1e-12)
    energy = verdicts(path)["energy"]
    assert energy.verdict == "holds"
    assert energy.figures["reflectances"][0]["value"] == found.value


def test_more_light_than_arrives_fails(measure: Measure, capsys: pytest.CaptureFixture[str]) -> None:
    """The certificate states half as much again as the etalon has."""
    path = measure(
        HALF_SPHERE, (PAINT[0], PAINT[1].replace("0.6", "0.95")), ("radiance_factor = 0.99", "radiance_factor = 1.4")
    )
    assert verdicts(path)["energy"].verdict == "fails"
    assert "more light than arrives" in verdicts(path)["energy"].text
    status = app(["verify", str(path)], standalone_mode=False)
    assert status == 1
    assert "energy of paint: fails" in capsys.readouterr().out


def test_reciprocity_holds_and_a_wrong_zero_of_sigma_breaks_it(measure: Measure) -> None:
    """A degree, twenty times as much as the rig file states: light and view are not the other way round any more."""
    found = verdicts(path := measure(PAIRS))
    assert found["reciprocity"].verdict == "holds"
    assert found["reciprocity"].figures["pairs"] >= 1
    unasked = ("energy", "symmetry", "overlaps", "drift", "closure")
    assert {found[name].verdict for name in unasked} == {"nothing to judge"}
    path.unlink()
    assert verdicts(measure(PAIRS, TURNED))["reciprocity"].verdict == "fails"


def test_gains_that_are_not_those_of_the_rig_file_reach_the_operator(
    measure: Measure, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """By the run itself, by an export and by `verify`; and sound gains are no finding."""
    schedule = (*HALF_SPHERE, ("[1e8, 1e10]", "[1e10, 1e11]"))
    sound = measure(schedule, PAINT)
    assert check_journal(sound).findings == ()
    assert verdicts(sound)["gain linkage"].verdict == "holds"
    journal, words = tmp_path / "b.journal", "the gains are not those of the rig file"
    rig, plan = str(write_rig(PAINT, SPREAD)), str(write_schedule(*schedule))
    command = ["run", plan, "--rig", rig, "--out", str(journal), "--json"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0
    assert f"goniotwin: {words}" in done.stderr
    assert words in json.loads(done.stdout)["checks"]["findings"][0]
    found = verdicts(journal)["gain linkage"]
    assert (found.verdict, found.text[: len(words)]) == ("fails", words)
    done = CliRunner().invoke(app, ["export", str(journal), "--format", "csv", "--out", str(tmp_path / "b.csv")])
    assert words in done.stderr
    assert (tmp_path / "b.csv").read_text(encoding="utf-8").count(words) == 1
    CliRunner().invoke(app, ["export", str(journal), "--format", "ddr", "--out", str(tmp_path / "b.ddr")])
    assert words in " ".join((tmp_path / "b.ddr").read_text(encoding="utf-8").replace(";;", " ").split())


def test_the_small_components_are_listed_where_asked_for(measure: Measure, monkeypatch: pytest.MonkeyPatch) -> None:
    """In 80 columns each component has a line of its own, and no number or key is cut."""
    command = ["budget", str(measure(PAIRS)), "--at", "sigma=30,theta=6,phi=180"]
    for columns in ("80", "120"):
        monkeypatch.setenv("COLUMNS", columns)
        text, whole = (CliRunner().invoke(app, [*command, *more]).stdout for more in ((), ("--all",)))
        assert all(key in text for key in ("sample_tilt_y@gaussian-5#1", "photodiode_angle_deg", "[etalon]", "smaller ones"))
        assert "photodiode_across_deg" not in text
        assert "photodiode_across_deg" in whole
        assert "smaller ones" not in whole
        assert all(len(line) <= int(columns) for line in whole.splitlines()[2:])


def test_missing_directions_are_counted_by_their_reason(measure: Measure) -> None:
    """The peak of a narrow lobe is saturated at the gain of this schedule."""
    peak = (HALF_SPHERE[0], HALF_SPHERE[1], ("gains_v_per_a = [1e8, 1e10]", "gains_v_per_a = [1e11]"))
    found = verdicts(path := measure(peak))["missing directions"]
    assert found.verdict == "warns"
    assert found.figures["missing"] == {"shadowed": 1, "clipped": 3}
    reasons = "1 is blocked by the mirror unit, 3 are saturated at every gain"
    assert f"4 of 90 directions have no trusted value: {reasons}; " in found.text
    assert found.text.endswith("saturated directions have more than that")
    with Journal.open(path) as journal:
        about = budget_of_reflectance(evaluate_journal(journal).reduction, parse_place("sigma=30")).about
    assert f"of directions without a trusted value ({reasons})" in about[0]


@pytest.mark.parametrize(("share", "verdict"), [(0.1, "holds"), (1e-4, "warns")])
def test_missing_directions_warn_by_their_energy(
    share: float, verdict: str, measure: Measure, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verification, "MOST_NOT_MEASURED", share)
    found = verdicts(measure(HALF_SPHERE, PAINT))["missing directions"]
    assert found.verdict == verdict
    assert found.figures["missing"].keys() == {"shadowed"}


def test_a_cut_has_no_reflectance(measure: Measure) -> None:
    with Journal.open(measure(PAIRS)) as journal, pytest.raises(UserError, match="do not cover the half sphere"):
        budget_of_reflectance(evaluate_journal(journal).reduction, parse_place("sigma=30"))


@pytest.mark.parametrize(
    ("fault", "verdict", "words"),
    [
        ("", "holds", "ratios of gains were measured, the worst is"),
        ("gain_spread = 0.02", "fails", "the gains are not those of the rig file"),
        ("settling_s = 0.06", "fails", "the amplifiers are not at rest"),
    ],
)
def test_gains_that_do_not_fit_fail_the_verification(fault: str, verdict: str, words: str, measure: Measure) -> None:
    rows = (("beta_deg = [180]", "beta_deg = [0, 180]"), ("shift_deg = [0, 1]", "shift_deg = [0, 1, 2, 3, 4]"))
    changes = (("[twin.light]", f"[twin.electronics]\n{fault}\n\n[twin.light]"),) if fault else ()
    found = verdicts(measure(rows, *changes))["gain linkage"]
    assert found.verdict == verdict
    assert words in found.text
    assert found.figures["ratios"] > 0 or fault.startswith("settling")
    if not fault.startswith("settling"):
        assert found.evidence is not None
        assert found.evidence.observations == found.figures["ratios"]
        assert found.evidence.rank < found.evidence.observations
        assert (found.evidence.chance < 1e-3) == bool(fault)


def test_a_campaign_at_one_gain_has_no_gain_linkage(measure: Measure) -> None:
    found = verdicts(measure((("gains_v_per_a = [1e8, 1e10]", "gains_v_per_a = [1e8]"),)))["gain linkage"]
    assert found.verdict == "nothing to judge"


def test_pairs_have_light_and_view_exchanged() -> None:
    """At sigma 30, zenith 50, azimuth 70 the partner is sigma 50, zenith 30; -70, with gamma turned by -70, if anisotropic."""
    one = made_points(30.0, np.array([50.0]), np.array([70.0]), np.ones(1), 0.1)
    other = made_points(50.0, np.array([30.0]), np.array([290.0]), np.ones(1), 0.1)

    def pairs(gamma: float, symmetry: str) -> int:
        turned = other.places.copy()
        turned[:, 1] = gamma
        columns: dict[str, Any] = {
            name: np.concatenate([getattr(one, name), getattr(other, name)])
            for name in vars(one)
            if name not in ("places", "place", "own", "common", "grouped", "stated")
        }
        both = replace(
            one,
            places=np.concatenate([one.places, turned]),
            place=np.array([0, 1], dtype=np.int32),
            own={"noise": np.zeros(2)},
            **columns,
        )
        return int(reciprocal_pairs(both, symmetry)[0].size)  # type: ignore[arg-type]

    assert pairs(0.0, "isotropic") == 1
    assert pairs(0.0, "anisotropic") == 0
    assert pairs(290.0, "anisotropic") == 1
    assert pairs(290.0, "plane-symmetric") == 1


@pytest.mark.parametrize(("drift_per_hour", "verdict"), [(0.0, "holds"), (1.0, "fails")])
def test_drift_checks_together_show_a_monitor_that_drifts_within_their_limit(
    drift_per_hour: float, verdict: str, measure: Measure
) -> None:
    """Each check is within a limit of 5 %; all together are the drift of the virtual rig's monitor, which is not stated."""
    checks = "[drift]\nevery_s = 10\nsigma_deg = 30\nbeta_deg = 180\nwavelength_nm = 550\nlimit = 0.05\n"
    rows = (
        ("shift_deg = [0, 1]", "shift_deg = { start = 0, stop = 4.5, step = 0.25 }"),
        ("dark_readings = 4\n", f"dark_readings = 4\n{checks}"),
    )
    found = verdicts(measure(rows, ("[twin.light]", f"[twin.monitor]\ndrift_per_hour = {drift_per_hour}\n\n[twin.light]")))
    drift = found["drift"]
    assert drift.verdict == verdict
    assert drift.text.startswith("every check is within the limit")
    assert drift.evidence is not None
    assert 0.0 < drift.evidence.rank < 0.1  # the campaign takes minutes
    if drift_per_hour:
        size = float(drift.text.partition("the monitor drift by ")[2].partition(" %")[0])
        u = float(drift.text.partition("(u ")[2].partition(" %")[0])
        assert size == pytest.approx(100.0 * drift_per_hour, abs=3.0 * u + 3.0)  # per cent an hour
        assert "state that" in drift.text
    else:
        assert drift.evidence.chance > 0.05
