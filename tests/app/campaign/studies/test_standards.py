"""Two reference standards: they are compared, values are scaled by both, and a difference of theirs is found or in u.

Virtual rigs without wires, off by what the rig file states, with an etalon or a second standard that is low beside it.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import GTC
import numpy as np
import pytest

from goniotwin.app.campaign.campaign import resume_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.quantity import Terms
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.proof.virtual_rigs import DrawnRigs
from goniotwin.app.campaign.reduction.components import COVERAGE, Signal, total_variance
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.etalon import ReferenceSignals
from goniotwin.app.campaign.reduction.pipeline import reduce_rows
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.row_signals import RowSignals
from goniotwin.app.campaign.reduction.settings import reduction_settings
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.budget import freedom_of
from goniotwin.app.campaign.studies.closure import TROUBLES
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset, reduce_journal
from goniotwin.app.campaign.studies.standards import StandardsReport, expected_comparison
from goniotwin.app.campaign.studies.theory import deviations_in_u, theoretical_bsdf
from goniotwin.app.campaign.studies.verification import verify_journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig import parse_rig
from goniotwin.arrays import Floats
from goniotwin.twin.plant import Plant
from tests.app.campaign.campaign_bench import run_until
from tests.conftest import RIG
from tests.sizes import some
from tests.system.command import invoke

pytestmark = pytest.mark.xdist_group("standards")

SCHEDULE = """
name = "two standards"
samples = ["gaussian-5"]
etalon = "etalon"
sigma_deg = [20, 62]
beta_deg = [0, 180]
wavelength_nm = [640]
gains_v_per_a = [1e8, 1e10]
readings = 4
dark_readings = 8
"""
CERTIFICATE = "radiance_factor = 0.99\nrelative_uncertainty = 0.002\n"
TURNED = "turned = true\n"
ETALON = '[twin.samples.etalon]\nmodel = "lambertian"\nreflectance = 0.99\n'
GOOD_RIGS, LOW_RIGS = {CERTIFICATE: 16, TURNED: 8}, 4


def rig_text(etalon: float = 0.99, second: float = 0.99) -> str:
    """The example rig with two standards of these reflectances, both certified as 0.99."""
    text = RIG.read_text(encoding="utf-8")
    assert ETALON in text
    text = text.replace(ETALON, ETALON.replace("0.99", f"{etalon:g}"))
    return f'{text}\n[twin.samples.second]\nmodel = "lambertian"\nreflectance = {second:g}\n'


def schedule_text(stated: str = CERTIFICATE, wavelengths: str = "[640]") -> str:
    second = f'[second_standard]\nname = "second"\n{stated}' if stated else ""
    return SCHEDULE.replace("[640]", wavelengths) + second


def plans(
    seeds: range, etalon: float = 0.99, second: float = 0.99, stated: str = CERTIFICATE, wavelengths: str = "[640]"
) -> Iterator[NewPlan]:
    """The plans on rigs of these seeds."""
    rig = parse_rig(rig_text(etalon, second), RIG.parent, "rig")
    schedule = parse_schedule(schedule_text(stated, wavelengths), "two.toml")
    of = reduction_settings(rig.file, schedule.file, None, "two.toml")
    drawn = DrawnRigs(rig, "etalon", level=of.certificate.level, years=of.etalon_years, second=of.second)
    plan = make_plan(schedule, drawn.rig(seeds[0]))
    yield from (replace(plan, rig=drawn.rig(seed)) for seed in seeds)


@dataclass(frozen=True)
class Found:
    """What a campaign shows of its standards, the deviations of its values from the truth in u, and its failed verdicts."""

    report: StandardsReport
    z: Floats
    fails: list[str]
    notes: list[str]


@cache
def campaigns(
    seeds: range, etalon: float = 0.99, second: float = 0.99, stated: str = CERTIFICATE, wavelengths: str = "[640]"
) -> list[Found]:
    found = []
    for plan in plans(seeds, etalon, second, stated, wavelengths):
        with TemporaryDirectory() as folder:
            path = Path(folder) / "a.journal"
            run_without_wires(plan, path)
            with Journal.open(path) as journal:
                evaluation, data = evaluate_journal(journal), reduce_journal(journal)
                fails = [each.name for each in verify_journal(evaluation) if each.verdict == "fails"]
        z = deviations(data)
        assert evaluation.standards is not None
        found.append(Found(evaluation.standards, z, fails, list(data.notes)))
    return found


def deviations(data: BsdfDataset) -> Floats:
    """The deviations of the judged values from the truth, in u."""
    (points,) = data.samples.values()
    judged = points.good & ~points.flag("field") & ~points.flag("steep")
    return deviations_in_u(points, theoretical_bsdf(data.rig, "gaussian-5", points))[judged]


def differences(found: list[Found]) -> Floats:
    """The differences of the standards in their u."""
    together = [each.report.together for each in found]
    return np.array([each.z for each in together if each is not None])


def is_chance(chi_square: float, freedom: int) -> bool:
    """Whether a chi-square is within four standard deviations of its law, by its cube root (Wilson and Hilferty)."""
    spread = 2.0 / (9.0 * freedom)
    return abs(math.cbrt(chi_square / freedom) - (1.0 - spread)) < 4.0 * math.sqrt(spread)


# On virtual rigs.


@pytest.mark.long
@pytest.mark.parametrize("stated", [CERTIFICATE, TURNED])
def test_on_good_rigs_the_difference_is_chance(stated: str) -> None:
    found = campaigns(range(1, 1 + GOOD_RIGS[stated]), stated=stated)
    z = differences(found)
    assert is_chance(float(np.sum(z**2)), z.size)
    assert all(each.report.alike for each in found)
    assert not any(each.fails for each in found)
    scaled = [each for each in found if any("are scaled by both" in note for note in each.notes)]
    assert len(scaled) == np.sum(np.abs(z) <= 2.0)


@pytest.mark.parametrize(("etalon", "second"), some([(0.9702, 0.99), (0.99, 0.9405)]))
def test_a_standard_that_is_low_is_found_and_half_of_the_difference_is_in_u(etalon: float, second: float) -> None:
    """2 or 5 % low, and it may be either of the two. With the etalon alone a quarter of the values is beyond 5 u."""
    found = campaigns(range(1, 1 + LOW_RIGS), etalon, second)
    z, size = differences(found), abs(etalon - second) / 0.99
    reports = [each.report for each in found]
    assert np.all(np.sign(z) == np.sign(second - etalon))
    assert np.abs(np.mean([each.difference for each in reports])) == pytest.approx(size, abs=3.0 * 0.0045 / LOW_RIGS**0.5)
    assert all(each.differs for each in reports)
    assert [each.apart for each in reports] == [abs(each) > 4.0 for each in z.tolist()]
    assert [("standards" in each.fails) for each in found] == [each.apart for each in reports]
    assert np.median(np.abs(z)) > 4.0
    deviations = np.concatenate([each.z for each in found])
    assert np.mean(np.abs(deviations) < COVERAGE) > 0.93
    assert not np.any(np.abs(deviations) > 5.0)


@pytest.mark.long
@pytest.mark.parametrize("low", [0.01, 0.02, 0.05])
def test_an_etalon_that_is_low_is_silent_alone(low: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a second standard no value is beyond 5 u; with the etalon alone, without a scan, no verdict shows it."""
    alone, fails = [], []
    for k, plan in enumerate(plans(range(1, 1 + LOW_RIGS), 0.99 * (1.0 - low), stated="")):
        run_without_wires(plan, tmp_path / f"{k}.journal")
        with Journal.open(tmp_path / f"{k}.journal") as journal:
            alone.append(deviations(reduce_journal(journal)))
            fails += [each.name for each in verify_journal(evaluate_journal(journal)) if each.verdict == "fails"]
    found = campaigns(range(1, 1 + LOW_RIGS), 0.99 * (1.0 - low))
    one, two = np.abs(np.concatenate(alone)), np.abs(np.concatenate([each.z for each in found]))
    apart = sum(each.report.apart for each in found)
    rows = [f"{np.sum(each > 5.0)} of {each.size} beyond 5 u, {np.mean(each < COVERAGE):.1%} covered" for each in (one, two)]
    with capsys.disabled():
        print(f"\n{low:.0%} low: alone {rows[0]}; with a second standard {rows[1]}, apart on {apart} of {LOW_RIGS} rigs")
    assert fails == []
    assert not np.any(two > 5.0)
    assert np.mean(two < COVERAGE) > np.mean(one < COVERAGE)
    if low >= 0.02:
        assert np.any(one > 5.0)
        assert apart >= LOW_RIGS // 2
        assert np.mean(two < COVERAGE) > 0.93


@pytest.mark.long
def test_false_alarms_of_verify_are_chance() -> None:
    """Of 60 rigs as the rig file states them: a verdict fails where chance does as much on one in 500."""
    found = campaigns(range(101, 161))
    by_name = Counter(name for each in found for name in each.fails)
    assert max(by_name.values(), default=0) <= 2  # more has a chance of 0.03 %
    assert sum(bool(each.fails) for each in found) <= 3
    z = np.concatenate([each.z for each in found])
    assert np.mean(np.abs(z) < COVERAGE) == pytest.approx(0.95, abs=0.03)
    assert not np.any(np.abs(z) > 5.0)


def test_a_certificate_that_is_wrong_at_one_wavelength_fails() -> None:
    """By 1 % at one of two: in the mean the standards differ by half of it, which is within 2 u."""
    table = "wavelength_nm,radiance_factor,relative_uncertainty\n640,0.99,0.002\n700,1.0,0.002\n"
    stated = f"level = 0.002\n{table}"
    (found,) = campaigns(range(1, 2), stated=f'table = """\n{stated}"""\n', wavelengths="[640, 700]")
    report = found.report
    assert not report.differs
    assert report.apart
    assert found.fails == ["standards"]
    assert [each.wavelength_nm for each in report.by_light] == [640.0, 640.0, 700.0, 700.0]
    ratios = np.array([each.ratio for each in report.by_light])
    assert np.mean(ratios[:2]) / np.mean(ratios[2:]) == pytest.approx(1.0 / 0.99, abs=1e-3)
    assert any("over wavelengths and incidences they do NOT agree" in each for each in found.notes)
    # Either may be wrong, by the largest of the differences: half of that is in u.
    assert report.difference == pytest.approx(float(ratios[np.argmax(np.abs(ratios - 1.0))]) - 1.0)
    assert abs(report.difference) > 0.007


def test_a_certificate_that_covers_nothing_is_refused() -> None:
    stated = (
        'table = """\nlevel = 0.002\nwavelength_nm,radiance_factor,relative_uncertainty\n900,0.99,0.002\n950,1.0,0.002\n"""\n'
    )
    schedule = parse_schedule(schedule_text(stated), "two.toml")
    with pytest.raises(UserError, match=r"second_standard\.table covers none of the schedule's wavelengths"):
        make_plan(schedule, parse_rig(rig_text(), RIG.parent, "rig"))


# The scale.


def reduced(
    etalon: Floats, second: Floats, own: float, stated: str = CERTIFICATE, uncertainty: str = ""
) -> tuple[BsdfPoints, list[str]]:
    """Values of one pose from signals of 1 and these of the standards, all of a relative noise; and their inputs' names."""
    zeros = "".join(f"{key} = 0.0\n" for key in ("linearity_per_decade", "monitor_drift_per_hour", "etalon_edge"))
    rig = parse_rig(f"{rig_text()}\n[uncertainty]\n{zeros}{uncertainty}", RIG.parent, "rig").file
    settings = reduction_settings(rig, parse_schedule(schedule_text(stated), "two.toml").file, None, "two.toml")
    settings = replace(settings, sample="gaussian-5")

    def rows(number: int, value: Floats) -> RowSignals:
        values = np.broadcast_to(value, (1, rig.photodiodes.count))
        signal = Signal(values, {"noise": (own * values) ** 2}, gain=np.zeros(values.shape, dtype=np.int64))
        none = np.zeros(values.shape, dtype=bool)
        place = np.array([[640.0, 0.0, 20.0, 180.0, 0.0]])
        return RowSignals(
            np.array([number]), place, none[:, 0], signal, dict.fromkeys(TROUBLES, none), np.zeros(1), np.zeros(1)
        )

    found = reduce_rows(rows(9, np.ones(1)), ReferenceSignals(rows(3, etalon), None, rows(6, second)), settings)
    assert found is not None
    points = found[1].where(~found[1].transmitted & ~found[1].flag("shadowed"))
    effects = effects_of(points, settings)
    assert set(effects.variances()) >= {"noise"}
    total = total_variance(effects.variances())
    assert total == pytest.approx(points.u_bsdf**2, rel=1e-9)
    return points, [each.name for each in effects.budget(0)]


def test_a_value_and_its_u_are_those_of_the_formula() -> None:
    """GTC differentiates S / (w E1 / rho1 + (1 - w) E2 / rho2) / pi; the weights are those of the least variance."""
    own, stated = 0.004, "radiance_factor = 0.8\nrelative_uncertainty = 0.004\ncalibrated = 2020-01-01\n"
    points, names = reduced(np.full(1, 0.5), np.full(1, 0.42), own, stated, "etalon_age_per_year = 0.0\n")
    weight = 0.004**2 / (0.002**2 + 0.004**2)
    one, two = GTC.ureal(0.5, own * 0.5), GTC.ureal(0.42, own * 0.42)
    rho = GTC.ureal(0.99, 0.002 * 0.99), GTC.ureal(0.8, 0.004 * 0.8)
    value = GTC.ureal(1.0, own) / (weight * one / rho[0] + (1.0 - weight) * two / rho[1]) / math.pi
    assert points.bsdf == pytest.approx(np.full(points.size, GTC.value(value)), rel=1e-12)
    # A share of the scale is not quite a share of the light where the two standards are apart: by 4 % here.
    assert points.u_bsdf == pytest.approx(np.full(points.size, GTC.uncertainty(value)), rel=0.01)
    assert {"certificate[level]", "second_certificate[level]", "etalon_reading[0]@row 3"} <= set(names)


def test_two_equal_certificates_have_the_u_of_one_over_the_root_of_two() -> None:
    points, _ = reduced(np.full(1, 0.5), np.full(1, 0.5), 1e-9, uncertainty="etalon_age_per_year = 0.0\n")
    assert points.budget["certificate"] / points.bsdf == pytest.approx(np.full(points.size, 0.002 / math.sqrt(2.0)))


def test_a_table_of_the_second_standard_gives_it_a_share_of_its_own_at_each_wavelength() -> None:
    table = "wavelength_nm,radiance_factor,relative_uncertainty\n600,0.9,0.004\n680,0.8,0.002\n"
    points, names = reduced(np.full(1, 0.5), np.full(1, 0.5), 1e-9, f'table = """\n{table}"""\n', "etalon_age_per_year = 0.0\n")
    known, of_second = 0.99, 0.85  # at 640 nm, with uncertainties of 0.002 and 0.003
    weight = 0.003**2 / (0.002**2 + 0.003**2)
    expected = 1.0 / (weight * 0.5 / known + (1.0 - weight) * 0.5 / of_second) / math.pi
    assert points.bsdf == pytest.approx(np.full(points.size, expected))
    assert points.budget["certificate"] / points.bsdf == pytest.approx(
        np.full(points.size, (1.0 / 0.002**2 + 1.0 / 0.003**2) ** -0.5)
    )
    assert any(each.startswith("second_certificate[6") for each in names)


def test_a_turned_etalon_has_the_certificate_and_the_age_of_the_etalon_and_mountings_of_its_own() -> None:
    points, names = reduced(np.full(1, 0.5), np.full(1, 0.5), 1e-9, TURNED, "mounting = 0.01\n")
    assert points.budget["certificate"] / points.bsdf == pytest.approx(np.full(points.size, 0.002))
    assert points.budget["etalon_age"] / points.bsdf == pytest.approx(np.full(points.size, 0.001))
    assert points.budget["mounting"] / points.bsdf == pytest.approx(np.full(points.size, 0.01 * math.sqrt(1.5)))
    assert {"mounting@etalon#1", "mounting@second#1", "mounting@gaussian-5#1"} <= set(names)


def test_where_the_second_standard_has_no_light_the_etalon_alone_is_the_scale() -> None:
    both, _ = reduced(np.full(1, 0.5), np.full(1, 0.45), 1e-9)
    light = np.full(both.photodiode.max() + 19, 0.45)
    light[both.photodiode[3]] = 0.0
    points, _ = reduced(np.full(1, 0.5), light, 1e-9)
    alone = points.second_row < 0
    assert np.flatnonzero(alone).tolist() == [3]
    assert points.bsdf[alone] == pytest.approx([0.99 / 0.5 / math.pi])
    assert points.bsdf[~alone] == pytest.approx(np.full(points.size - 1, 0.99 / 0.475 / math.pi))
    assert (points.budget["certificate"] / points.bsdf)[alone] == pytest.approx([0.002])


# Planning, proof, commands.


def test_the_second_standard_is_measured_after_the_etalon_in_all_of_its_poses() -> None:
    (plan,) = plans(range(1, 2))
    assert [passes[0].sample for passes in plan.mountings] == ["etalon", "second", "gaussian-5"]
    poses = [
        [(row.pose, row.wavelength_nm) for row in plan.rows if (row.kind, row.sample) == ("measure", name)]
        for name in ("etalon", "second")
    ]
    assert sorted(poses[0]) == sorted(poses[1])
    identities = [row.identity for row in plan.rows]
    assert len(set(identities)) == len(identities)


def test_the_expected_difference_is_that_of_certificates_edges_and_ages() -> None:
    """The defaults: an edge of 0.2 %, an age of 0.1 %, and by the certificates 0.2 %, of each; angles add a little."""
    (plan,) = plans(range(1, 2))
    expected = expected_comparison(plan)
    assert expected is not None
    assert expected.u == pytest.approx(math.sqrt(2.0) * math.hypot(0.002, 0.002, 0.001), rel=0.02)
    (twice,) = plans(range(1, 2), stated=CERTIFICATE.replace("0.002", "0.02"))
    wider = expected_comparison(twice)
    assert wider is not None
    assert wider.u == pytest.approx(math.hypot(0.002, 0.02, math.sqrt(2.0) * math.hypot(0.002, 0.001)), rel=0.01)


@pytest.mark.long
def test_a_proof_draws_the_second_standard_by_itself_and_a_turned_etalon_with_it() -> None:
    factors = []
    for stated in (CERTIFICATE, TURNED):
        models = [plan.rig.model() for plan in plans(range(1, 41), stated=stated)]
        drawn = [Plant(model).drawn for model in models if model is not None]
        factors.append(np.array([[each.signal_factor(name, 1, 0) - 1.0 for name in ("etalon", "second")] for each in drawn]))
        assert all(each.mounted("etalon", 1) != each.mounted("second", 1) for each in drawn)
    own, turned = factors
    assert np.std(own, axis=0) == pytest.approx(np.full(2, math.hypot(0.002, 0.002, 0.001)), rel=0.3)
    assert abs(np.corrcoef(own.T)[0, 1]) < 0.45
    assert turned[:, 0] == pytest.approx(turned[:, 1], abs=1e-12)
    assert turned[:, 0] == pytest.approx(own[:, 0], abs=1e-12)


def test_the_gain_of_the_second_standard_counts_in_the_degrees_of_freedom() -> None:
    """Its dark reading is the 4th, at the last of four gains; sample and etalon were read at the first."""
    points, _ = reduced(np.full(1, 0.5), np.full(1, 0.42), 0.004)
    rig = parse_rig(rig_text(), RIG.parent, "rig").file
    settings = reduction_settings(rig, parse_schedule(schedule_text(), "two.toml").file, None, "two.toml")
    settings = replace(settings, noise_freedom=(40.0, 30.0, 20.0, 10.0))
    member = ((4 * 4 + 3) * 36 + points.photodiode).astype(np.int32)[:, None]
    with_dark = replace(points, grouped={"dark": Terms(member, np.ones(member.shape))})
    assert (freedom_of(settings, points)["noise"], freedom_of(settings, with_dark)["noise"]) == (40.0, 10.0)


def test_check_states_what_will_be_found_and_closure_what_was(tmp_path: Path) -> None:
    """Through the wires, with an etalon that is 5 % low, and an interruption while the second standard is measured."""
    rig, schedule, path = tmp_path / "rig.toml", tmp_path / "two.toml", tmp_path / "a.journal"
    rig.write_text(rig_text(etalon=0.9405), encoding="utf-8")
    text = schedule_text().replace("[20, 62]", "[20]")
    schedule.write_text(text, encoding="utf-8")
    checked = json.loads(invoke("check", schedule, "--rig", rig, "--json").stdout)
    assert checked["mountings"] == ["etalon", "second", "gaussian-5"]
    assert checked["standards"]["found"] == pytest.approx(0.017, abs=0.001)
    assert "a difference of 1.7 % is certainly detected (4 u)" in invoke("check", schedule, "--rig", rig).stdout
    plan = make_plan(parse_schedule(text, "two.toml"), parse_rig(rig_text(etalon=0.9405), tmp_path, "rig"))
    run_until(plan, path, 0.5 * plan.seconds)
    with Journal.open(path) as journal:
        assert {row.row.sample for row in journal.rows("measure")} == {"etalon", "second"}
        interrupted = evaluate_journal(journal).standards
    assert interrupted is not None
    assert interrupted.together is not None
    assert interrupted.apart
    assert resume_campaign(path).state is State.DONE
    result = invoke("closure", path, "--json")
    assert result.returncode == 1
    found = json.loads(result.stdout)["standards"]
    assert found["apart"]
    assert found["together"]["values"] > interrupted.together.values
    assert found["difference"] == pytest.approx(0.99 / 0.9405 - 1.0, abs=2e-3)
    assert [each["sigma_deg"] for each in found["by_light"]] == [20.0]
    assert "they do NOT agree" in invoke("closure", path).stdout
