"""Readings that contradict the others of their row: a count that a wire has changed is no count of the instrument."""

from dataclasses import replace
from functools import cache, partial
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.readout import READING_ATTEMPTS, ReadingComparison, contradictions, dark_level, min_readings
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.readings import DarkHistory
from goniotwin.app.campaign.row import CONTRADICTION, Reading, Row
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import OpenRig, parse_rig
from goniotwin.arrays import Counts, Floats
from goniotwin.drivers.photodiodes.settings import PhotodiodeSettings
from goniotwin.mocks.faults import Fault, FaultPlan
from tests.app.campaign.campaign_bench import RunResult, run_plan
from tests.app.campaign.running.faulty_campaign import POLICIES, run_with_faults
from tests.conftest import RIG, SMALL, changed
from tests.sizes import some

pytestmark = pytest.mark.xdist_group("contradictions")

GAIN_V_PER_A = 1e8
SETTINGS = PhotodiodeSettings((5.0, 15.0, 25.0, 35.0, 45.0), (10.0, 20.0, 30.0), (GAIN_V_PER_A,), "adam-6017")
ZERO = SETTINGS.range.zero
READ_NOISE = 0.6
"""Of a conversion of the twin's amplifiers, in steps: `noise_v` of 0.15 mV over 0.305 mV, and the rounding."""


def drawn(seed: int, signal: Floats, readings: int, lamp: float = 0.0, common: Floats | None = None) -> Counts:
    """Counts of lit photodiodes: noise of the amplifiers, of the lamp for each conversion, and what all have in common."""
    rng = np.random.default_rng(seed)
    light = 1.0 + lamp * rng.standard_normal((readings, signal.size))
    light *= 1.0 if common is None else 1.0 + common[:, None]
    return np.rint(ZERO + light * signal + READ_NOISE * rng.standard_normal(light.shape)).astype(np.uint16)


def comparison(rows: int = 0, lamp: float = 0.0) -> ReadingComparison:
    """A comparison that has seen a dark reading, and some rows of a lamp."""
    found = ReadingComparison(SETTINGS)
    found.remember([reading(drawn(1, np.zeros(SETTINGS.count), 16))], lit=False)
    for k in range(rows):
        found.remember([reading(drawn(100 + k, LAMBERTIAN, 4, lamp))], lit=True)
    return found


def reading(counts: Counts) -> Reading:
    return Reading(GAIN_V_PER_A, 0.0, 0.08, 1e-6, counts)


LAMBERTIAN = np.linspace(6000.0, 20000.0, SETTINGS.count)
LOBE = np.array([5.0, 40.0, 24000.0, 900.0, 20.0, 3.0, 0.0, 0.0])
BEAM = np.array([0.0, 0.0, 24000.0, 0.0, 0.0, 0.0, 0.0, 0.0])
DARK = np.zeros(SETTINGS.count)
SCENES = {"lambertian": LAMBERTIAN, "lobe": LOBE, "beam": BEAM, "dark": DARK}


# ---- the rule ----


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("readings", [2, 3, 4, 16])
def test_a_bit_that_a_wire_has_changed_is_found(scene: str, readings: int) -> None:
    """Any bit of any count that changes the mean by more than five standard uncertainties of a known noise."""
    lamp = 5e-4
    known = comparison(20, lamp)
    rng = np.random.default_rng(readings)
    sizes = []
    for seed in range(300):
        counts = drawn(seed, SCENES[scene], readings, lamp)
        place = int(rng.integers(readings)), int(rng.integers(SETTINGS.count))
        changed_counts = counts.copy()
        changed_counts[place] ^= np.uint16(1 << int(rng.integers(16)))
        change = abs(int(changed_counts[place]) - int(counts[place]))
        found = known.contradictions(reading(changed_counts), lit=scene != "dark")
        noise = np.hypot(READ_NOISE, lamp * SCENES[scene][place[1]])
        if not found[:, place[1]].any():
            sizes.append(change / readings / (noise * np.sqrt(1.0 / readings + 1.0 / 16.0)))
    # 6 / sqrt(n - 1) of the deviations of a mean, and of the dark reading under it. The scatter is known to 15 %, where most
    # photodiodes have the same that of the row itself: to a factor of two for a median of eight with one degree of freedom.
    known_to = 1.15 if scene in ("lobe", "beam") else 1.0 + 1.0 / np.sqrt(readings - 1.0)
    assert max(sizes, default=0.0) < known_to * 6.0 / np.sqrt(readings - 1.0) / np.sqrt(1.0 + readings / 16.0)


@pytest.mark.parametrize("scene", SCENES)
@pytest.mark.parametrize("readings", [2, 4, 16])
@pytest.mark.parametrize("lamp", [0.0, 5e-4, 0.02])
def test_noise_is_no_contradiction(scene: str, readings: int, lamp: float) -> None:
    """2e-9 of the counts is stated, and 7e-6 of two: none of the 200,000 here."""
    known = comparison(20, lamp)
    for seed in range(300):
        counts = drawn(seed, SCENES[scene], readings, lamp)
        assert not known.contradictions(reading(counts), lit=scene != "dark").any(), seed


@pytest.mark.parametrize("scene", ["lambertian", "lobe"])
@pytest.mark.parametrize("step", [-0.5, -0.1, 0.01, 0.3, 5.0])
@pytest.mark.parametrize("lit_before", [1, 2, 5, 15])
def test_a_step_of_the_lamp_is_common_to_all_channels_and_no_contradiction(scene: str, step: float, lit_before: int) -> None:
    known = comparison(20, 5e-4)
    common = np.where(np.arange(16) < lit_before, 0.0, step)
    counts = drawn(3, SCENES[scene], 16, 5e-4, common)
    assert not known.contradictions(reading(counts), lit=True).any()


def test_a_lamp_that_begins_to_flicker_contradicts_nothing() -> None:
    known = comparison(20, 5e-4)
    for seed in range(100):
        assert not known.contradictions(reading(drawn(seed, LAMBERTIAN, 4, 0.05)), lit=True).any()


def test_a_beam_whose_light_begins_to_flicker_is_known_after_some_rows() -> None:
    """One photodiode alone has light: its first rows may contradict, and are taken again; later ones do not."""
    known = comparison(20, 5e-4)
    for seed in range(20):
        known.remember([reading(drawn(seed, BEAM, 4, 0.05))], lit=True)
    late = [known.contradictions(reading(drawn(seed, BEAM, 4, 0.05)), lit=True).any() for seed in range(1000, 1200)]
    assert not any(late)


def test_a_changed_count_is_not_taken_for_the_lamp() -> None:
    """A count that is changed in a reading in which the lamp steps, too: most photodiodes do not show the change."""
    known = comparison(20, 5e-4)
    counts = drawn(3, LAMBERTIAN, 16, 5e-4)
    counts[7, 2] ^= 1 << 14
    assert np.argwhere(known.contradictions(reading(counts), lit=True)).tolist() == [[7, 2]]


def test_two_changed_counts_in_one_reading_are_no_light() -> None:
    for scene, signal in SCENES.items():
        counts = drawn(3, signal, 16)
        counts[5, [1, 6]] ^= 1 << 13
        found = comparison().contradictions(reading(counts), lit=scene != "dark")
        assert np.argwhere(found).tolist() == [[5, 1], [5, 6]], scene


def test_the_first_dark_reading_is_compared_with_itself() -> None:
    counts = drawn(3, DARK, 4)
    fresh = ReadingComparison(SETTINGS)
    assert not fresh.contradictions(reading(counts), lit=False).any()
    counts[2, 5] ^= 1 << 5
    assert np.argwhere(fresh.contradictions(reading(counts), lit=False)).tolist() == [[2, 5]]


def test_a_single_reading_contradicts_nothing_and_is_never_taken() -> None:
    dark = dark_level(drawn(1, DARK, 16))
    assert not contradictions(drawn(2, LAMBERTIAN, 1), GAIN_V_PER_A, dark, 1e-6, SETTINGS).any()
    assert min_readings(Row(0, "a", "measure", "a", gains=(0,), readings=1)) == 2


# ---- campaigns ----


DARK_READINGS = 16
"""Of the dark reading above which the signal of a row is: its part of the signal's uncertainty."""


@cache
def plan_of(readings: int, light: str = "", dark_readings: int = DARK_READINGS) -> Plan:
    rig = changed(RIG.read_text(encoding="utf-8"), (("drift_per_hour = 0.02", f"drift_per_hour = 0.0\n{light}"),))
    number = (("dark_readings = 4", f"dark_readings = {dark_readings}"), ("\nreadings = 2", f"\nreadings = {readings}"))
    schedule = changed(SMALL, (*number, ("[550]", "[550, 600]"), ("[0, 1]", "[0, 1, 2]")))
    return make_plan(parse_schedule(schedule + POLICIES, "contradictions"), parse_rig(rig, RIG.parent, "contradicting rig"))


def reduced(path: Path) -> BsdfPoints:
    with Journal.open(path) as journal:
        return reduce_journal(journal).samples["gaussian-5"]


def flipped(readings: int, seed: int, share: float, path: Path) -> tuple[RunResult, int]:
    """A run in which replies of the converters are changed, and how many."""
    storm = FaultPlan(seed, (Fault.CORRUPTED,), share)
    run, _ = run_with_faults(plan_of(readings), path, {"adc": storm})
    return run, len(storm.met)


WANDER = 2e-3
"""Of the twin's lamp within minutes: rows that are taken again are read under another light."""


def place_of(row: Row) -> str:
    """Rows of one place have the same light; all dark readings are of one."""
    return row.kind if row.kind == "dark" else row.identity


def wrong_rows(run: RunResult, expected: RunResult) -> list[str]:
    """Rows without the flag whose mean counts differ from those of many readings by more than five standard uncertainties."""
    levels = {(place_of(each.row), found.gain_v_per_a): found.counts for each in expected.rows for found in each.data.readings}
    wrong = []
    for each in run.rows:
        for found in each.data.readings if CONTRADICTION not in each.data.flags else ():
            many = levels[place_of(each.row), found.gain_v_per_a]
            mean, signal = many.mean(axis=0), np.abs(many.mean(axis=0) - ZERO)
            means = 1.0 / len(found.counts) + 1.0 / DARK_READINGS + 1.0 / len(many)
            variance = np.maximum(many.var(axis=0, ddof=1), 0.25) * means
            u = np.sqrt(variance + 2.0 * (WANDER * signal) ** 2)
            if np.any(np.abs(found.counts.mean(axis=0) - mean) > 5.0 * u):
                wrong.append(f"{each.row.identity} at {found.gain_v_per_a:g} V/A")
    return wrong


def flips_without_a_wrong_value(readings: int, flips: int, share: float, folder: Path) -> dict[str, float]:
    """Run campaigns until so many replies were changed; how many rows were taken again, and how many stayed flagged.

    The values are compared with those of 64 readings without a fault. What the rig is off by is the same in both.
    """
    many = run_plan(plan_of(64, dark_readings=64), folder / "undisturbed.journal")
    expected = reduced(folder / "undisturbed.journal")
    found = dict.fromkeys(("flips", "rows", "again", "flagged", "worst"), 0.0)
    for seed in count():
        if found["flips"] >= flips:
            return found
        path = folder / f"{seed}.journal"
        run, met = flipped(readings, seed, share, path)
        assert run.state is State.DONE, (seed, run.faults)
        assert wrong_rows(run, many) == [], seed
        points = reduced(path)
        good = points.good & expected.good
        worst = float(np.max(np.abs(points.bsdf - expected.bsdf)[good] / points.u_bsdf[good], initial=0.0))
        assert worst < 5.0, (seed, worst, [text for kind, text in run.events if kind == CONTRADICTION])
        found["worst"] = max(found["worst"], worst)
        found["flips"] += met
        found["rows"] += len(run.rows)
        found["again"] += sum(kind == CONTRADICTION for kind, _ in run.events)
        found["flagged"] += sum(CONTRADICTION in each.data.flags for each in run.rows)
    raise AssertionError


@pytest.mark.parametrize("readings", some([4, 1]))
def test_changed_counts_leave_no_wrong_value_without_a_flag(readings: int, tmp_path: Path) -> None:
    found = flips_without_a_wrong_value(readings, 15, 0.02, tmp_path)
    assert found["again"] > 2


@pytest.mark.long
@pytest.mark.parametrize("share", [0.005, 0.02])
@pytest.mark.parametrize("readings", [1, 4])
def test_a_thousand_changed_replies_leave_no_wrong_value_without_a_flag(readings: int, share: float, tmp_path: Path) -> None:
    found = flips_without_a_wrong_value(readings, 1000, share, tmp_path)
    print(f"readings {readings}, share {share}: {found}")
    assert found["again"] > 100


def test_what_contradicts_is_an_event_with_the_count_and_the_row_has_the_counts_that_were_accepted(tmp_path: Path) -> None:
    run, _ = flipped(4, 1, 0.004, tmp_path / "a.journal")
    texts = [text for kind, text in run.events if kind == CONTRADICTION]
    assert texts
    for text in texts:
        assert "V/A contradict each other: photodiode" in text
        assert text.endswith("(the readings are taken again)")
    assert not any(CONTRADICTION in each.data.flags for each in run.rows)


def test_readings_that_contradict_in_every_attempt_are_kept_and_flagged(tmp_path: Path) -> None:
    """Rows of sixteen readings of five modules have 80 replies in each attempt, of which three in a hundred are changed."""
    run, _ = flipped(16, 3, 0.03, tmp_path / "a.journal")
    flagged = [each for each in run.rows if CONTRADICTION in each.data.flags and each.row.kind == "measure"]
    assert flagged
    assert all(len(each.data.readings[0].counts) == 16 for each in flagged)
    assert any(f"attempt {READING_ATTEMPTS}: kept" in text for kind, text in run.events if kind == CONTRADICTION)
    points = reduced(tmp_path / "a.journal")
    assert points.flag("contradiction").any()
    assert not (points.good & points.flag("contradiction")).any()


def test_values_above_a_dark_reading_that_contradicts_itself_are_flagged(tmp_path: Path) -> None:
    """Those from the dark reading before it to the one after it."""
    plan = plan_of(2)
    run = run_plan(plan, tmp_path / "a.journal")
    dark = run.of("dark")
    assert [each.row.sample for each in dark] == ["etalon", "etalon", "gaussian-5", "gaussian-5"]  # before and after each
    for k, flagged in enumerate(("etalon", "etalon", "gaussian-5", "gaussian-5")):
        rows = [replace(each, data=replace(each.data, flags=(CONTRADICTION,))) if each is dark[k] else each for each in dark]
        history = DarkHistory(rows, plan.rig.file)
        found = {
            each.row.sample
            for each in run.of("measure")
            if history.row_signal(each, history.signal(each), []).flags["contradiction"].all()
        }
        assert found == {flagged}


def flicker(opened: OpenRig, level: float) -> None:
    """The arc jumps between two places, at random times: 0.05 to 1 s on each."""
    assert opened.virtual is not None
    rng, t, clock, plant = np.random.default_rng(5), 0.0, opened.virtual.clock, opened.virtual.plant
    for k in range(3000):
        t += float(rng.uniform(0.05, 1.0))
        clock.at(t, partial(plant.set_lamp, t, level=level if k % 2 else 1.0))


@pytest.mark.parametrize("readings", [1, 4])
@pytest.mark.parametrize(("light", "level"), [("", 0.9), ("", 0.5), ("flicker = 0.02\n", 1.0), ("flicker = 0.1\n", 1.0)])
def test_a_lamp_that_flickers_keeps_its_rows(light: str, level: float, readings: int, tmp_path: Path) -> None:
    run = run_plan(plan_of(readings, light), tmp_path / "a.journal", lambda opened: flicker(opened, level))
    again = [text for kind, text in run.events if kind == CONTRADICTION]
    assert run.state is State.DONE
    assert not any(CONTRADICTION in each.data.flags for each in run.rows)
    assert len(again) <= 1, again
