"""Noise, lamp, gains and modules by what the lit readings show, on made readings whose truth is known.

The readings are drawn here, not by the virtual rig: light, its noise and the converter's step are a few lines, so that what the
reduction finds can be compared with what was drawn.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.measurement_model.quantity import Terms
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.drift_checks import compare_signals
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.etalon import comparable_signals
from goniotwin.app.campaign.reduction.evidence import SignalEvidence
from goniotwin.app.campaign.reduction.reading_inputs import Numbers
from goniotwin.app.campaign.reduction.readings import DarkHistory, collect
from goniotwin.app.campaign.reduction.row_signals import RowSignals
from goniotwin.app.campaign.reduction.settings import reduction_settings
from goniotwin.app.campaign.reduction.signals import stack_signals
from goniotwin.app.campaign.row import CommittedRow, Reading, Row, RowData, reading_table
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import RigFile, inputs, read_rig
from goniotwin.arrays import Floats
from goniotwin.drivers import PhotodiodeSettings
from tests.app.campaign.reduction.made_points import made_points
from tests.conftest import RIG
from tests.conftest import SMALL as SCHEDULE

RIG_FILE = read_rig(RIG).file
LOW, HIGH = 1e8, 1e10
N = RIG_FILE.photodiodes.count
NOISE_V, OFFSET_V, MONITOR_A, PERIOD_S = 4e-4, 1e-3, 1e-7, 0.08
DARK_EVERY = 40


def evidence_of(history: DarkHistory, rows: Sequence[CommittedRow]) -> SignalEvidence:
    """What rows show."""
    return collect(history.sums(), [reading_table(each.data.readings for each in rows)])


@dataclass
class Drawn:
    """Rows with drawn readings, and the true photocurrents (rows, photodiodes) in A at a monitor's current of MONITOR_A.

    `own` is the relative noise of each photodiode's reading, `lamp` that of all of a row's, `spread` that of the gains about
    the nominal ones, `settling_s` the amplifiers' time constant, `bend` how much a voltage of 10 V is too low, of module 2,
    `crosstalk` the share of the volts (12 at most) of a module's other channels.
    """

    seed: int = 1
    rows: int = 100
    own: float = 0.0
    lamp: float = 0.0
    spread: float = 0.0
    settling_s: float = 0.01
    bend: float = 0.0
    crosstalk: float = 0.0
    currents_a: tuple[float, float] = (1e-13, 8e-10)
    gains: tuple[float, ...] = (LOW, HIGH)
    readings: int = 4
    dark_readings: int = 16
    lit: list[CommittedRow] = field(default_factory=list)
    dark: list[CommittedRow] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)
        self.deviation = {gain: self.spread * self.random.normal(size=N) for gain in self.gains}
        low, high = self.currents_a
        self.truth_a = 10.0 ** self.random.uniform(math.log10(low), math.log10(high), (self.rows, N))
        t = 0.0
        for k, current in enumerate(self.truth_a):
            if k % DARK_EVERY == 0:
                self._add_dark(t)
                t += 10.0
            order = self.gains[:: 1 if k % 2 else -1]  # as in a campaign: two rows share a gain
            level = 1.0 + 0.01 * self.random.normal()
            before, taken = None, []
            for at, gain in enumerate(order):
                taken.append(self._read(t + at, gain, current, self.readings, level, before))
                before = gain
            readings = tuple(sorted(taken, key=lambda each: each.gain_v_per_a))
            self.lit.append(CommittedRow(Row(1000 + k, f"row {k}", "measure", "paint"), RowData(t, t + 2.0, None, readings)))
            t += 3.0
        self._add_dark(t)

    def _add_dark(self, t: float) -> None:
        readings = tuple(
            self._read(t + k, gain, np.zeros(N), self.dark_readings, 0.0, None) for k, gain in enumerate(self.gains)
        )
        self.dark.append(CommittedRow(Row(len(self.dark), "dark", "dark", "paint"), RowData(t, t + 2.0, None, readings)))

    def _read(self, t: float, gain: float, current: Floats, count: int, level: float, before: float | None) -> Reading:
        normal = self.random.normal
        light = current * level * (1.0 + self.lamp * normal(size=(count, 1))) * (1.0 + self.own * normal(size=(count, N)))
        real = gain * (1.0 + self.deviation[gain])
        if before is not None:
            assert isinstance(RIG_FILE.photodiodes, PhotodiodeSettings)
            since = RIG_FILE.photodiodes.settling_s + PERIOD_S * np.arange(count)[:, None]
            left = np.exp(-since / self.settling_s)
            real = real + (before * (1.0 + self.deviation[before]) - real) * left
        volts = light * real
        module = np.arange(N) // RIG_FILE.photodiodes.module_channels
        volts = np.where(module == 2, volts * (1.0 - self.bend * volts / 10.0), volts)
        held = np.minimum(volts, 12.0)
        of_module = np.stack([held[:, module == each].sum(axis=1) for each in module], axis=1)
        volts = volts + self.crosstalk * (of_module - held)
        volts = volts + OFFSET_V + NOISE_V * normal(size=(count, N))
        counts = RIG_FILE.photodiodes.range.raw(volts).astype(np.uint16)
        return Reading(gain, t, PERIOD_S, level * MONITOR_A, counts)

    @property
    def history(self) -> DarkHistory:
        """The dark readings, without evidence of the lit ones."""
        return DarkHistory(self.dark, RIG_FILE)

    @property
    def evidence(self) -> SignalEvidence:
        """What the lit readings show."""
        return evidence_of(self.history, self.lit)

    def signals(self, evidence: SignalEvidence) -> Signal:
        """The signals (rows, photodiodes) of all rows."""
        history = self.history.with_evidence(evidence)
        return stack_signals([history.signal(row) for row in self.lit])


def plain(drawn: Drawn) -> SignalEvidence:
    """What the rig file states alone."""
    return drawn.history.evidence


def deviations(drawn: Drawn, evidence: SignalEvidence) -> Floats:
    """Errors of the values with light over their standard uncertainties, without that of the gains: these are exact."""
    signal = drawn.signals(replace(evidence, deviation=plain(drawn).deviation))
    u = np.sqrt(signal.reading_variance - signal.components["crosstalk"])
    z: Floats = (signal.value - drawn.truth_a / MONITOR_A) / u
    return z[np.isfinite(z) & (signal.value > 20.0 * np.sqrt(signal.components["dark"]))]


CASES = {
    "its amplifiers' noise": Drawn(rows=150),
    "each photodiode's own": Drawn(rows=50, own=0.02),
    "the lamp": Drawn(rows=50, lamp=0.02),
    "both": Drawn(rows=150, own=0.01, lamp=0.01),
}


SLOW = [pytest.param(name, marks=pytest.mark.long) for name in ("its amplifiers' noise", "both")]


@pytest.mark.parametrize("name", ["each photodiode's own", "the lamp", *SLOW])
def test_intervals_hold_the_truth_whatever_makes_the_noise(name: str) -> None:
    drawn = CASES[name]
    evidence = drawn.evidence
    z = deviations(drawn, evidence)
    assert z.size > 1000
    assert 0.87 < float(np.mean(z**2)) < 1.15
    assert float(np.mean(np.abs(z) < 1.96)) == pytest.approx(0.95, abs=0.02)
    if drawn.own or drawn.lamp:  # the dark readings do not know of it
        assert float(np.mean(np.abs(deviations(drawn, plain(drawn))) < 1.96)) < 0.88
    assert math.sqrt(evidence.own) == pytest.approx(drawn.own, rel=0.05, abs=2e-3)
    assert math.sqrt(evidence.lamp) == pytest.approx(drawn.lamp, rel=0.1, abs=2e-3)
    assert (evidence.verdicts, evidence.notes) == ((), ())


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_over_many_seeds_the_mean_square_is_that_of_the_law(name: str) -> None:
    """Of one seed it has a standard deviation of 0.04 to 0.10: values share dark readings, lamp and scatter.

    It is rather below 1: dark readings of few degrees of freedom count for more, and what is never below 0 is above it in the
    mean.
    """
    case = CASES[name]
    drawn = [Drawn(seed, rows=case.rows, own=case.own, lamp=case.lamp) for seed in range(1, 25)]
    z = [deviations(each, each.evidence) for each in drawn]
    squares = [float(np.mean(each**2)) for each in z]
    print(f"\n  {name}: {np.mean(squares):.3f}, sd {np.std(squares, ddof=1):.3f}")
    assert 0.9 < float(np.mean(squares)) < 1.03
    assert 0.945 < float(np.mean(np.abs(np.concatenate(z)) < 1.96)) < 0.965


def test_shot_noise_is_expected_and_not_counted_twice() -> None:
    """Photodiodes of so low a bandwidth that the light's own noise is the largest: its variance is as the current."""

    class Shot(Drawn):
        def _read(self, t: float, gain: float, current: Floats, count: int, level: float, before: float | None) -> Reading:
            plain_reading = super()._read(t, gain, current, count, level, before)
            u = np.sqrt(RIG_FILE.photodiodes.shot_variance_a2(current * level)) * gain
            volts = current * level * gain + OFFSET_V + np.hypot(u, NOISE_V) * self.random.normal(size=(count, N))
            return replace(plain_reading, counts=RIG_FILE.photodiodes.range.raw(volts).astype(np.uint16))

    drawn = Shot(gains=(1e11,), currents_a=(1e-12, 8e-11))
    shot_v = math.sqrt(float(RIG_FILE.photodiodes.shot_variance_a2(np.array([4e-11]))[0])) * 1e11
    assert shot_v > 1.0 * NOISE_V
    evidence = drawn.evidence
    assert evidence.factor == pytest.approx(np.ones(N), abs=0.05)
    assert float(np.mean(np.abs(deviations(drawn, evidence)) < 1.96)) == pytest.approx(0.95, abs=0.015)


def test_a_photodiode_with_a_loose_contact_does_not_make_the_others_uncertain() -> None:
    drawn = Drawn()
    loose = []
    for each in drawn.lit:
        readings = [replace(one, counts=one.counts.copy()) for one in each.data.readings]
        for one in readings:
            one.counts[:, 5] = np.clip(one.counts[:, 5] + drawn.random.normal(0.0, 60.0, len(one.counts)), 0, 65535)
        loose.append(CommittedRow(each.row, replace(each.data, readings=tuple(readings))))
    evidence = evidence_of(drawn.history, loose)
    assert evidence.factor[5] > 100.0
    assert np.delete(evidence.factor, 5) == pytest.approx(np.ones(N - 1), abs=0.1)
    assert math.sqrt(evidence.own) < 2e-3


def test_a_count_that_was_changed_on_a_wire_makes_one_value_uncertain_and_no_other() -> None:
    """Modbus over TCP has no checksum of its own."""
    drawn = Drawn(rows=50, currents_a=(1e-11, 8e-11))
    before = drawn.signals(drawn.evidence)
    drawn.lit[20].data.readings[1].counts[2, 5] += 4000
    after = drawn.signals(drawn.evidence)
    changed = np.zeros(before.value.shape, dtype=bool)
    changed[20, 5] = True
    assert abs(after.value - before.value)[20, 5] > 100.0 * math.sqrt(before.variance[20, 5])
    assert abs(after.value - before.value)[20, 5] < 2.0 * math.sqrt(after.variance[20, 5])
    assert np.sqrt(after.variance)[~changed] == pytest.approx(np.sqrt(before.variance)[~changed], rel=0.02)


def test_what_all_photodiodes_of_a_row_share_is_in_its_mean_too() -> None:
    """Their mean is no better known than the lamp was: noise of its own would average out."""
    drawn = Drawn(lamp=0.02, currents_a=(2e-11, 8e-10))
    signal = drawn.signals(drawn.evidence)
    relative = np.nanmean(signal.value / (drawn.truth_a / MONITOR_A) - 1.0, axis=1)
    lamp = np.nanmean(signal.components["lamp"] / signal.value**2, axis=1)
    assert float(np.mean(relative**2 / lamp)) == pytest.approx(1.0, abs=0.35)
    check = compare_signals(one_row(signal, 0), one_row(signal, 1), RIG_FILE, 0.005)
    assert check.u_change > 0.9 * math.sqrt(lamp[0] + lamp[1])
    assert not check.beyond


def one_row(signal: Signal, row: int) -> Signal:
    """One row of signals, with values of 1: another pose would not be compared."""
    here = signal.each(lambda array: array[row])
    return here.scaled(1.0 / here.value)


# ---- gains ----


def ratio_variance(evidence: SignalEvidence, one: int, other: int) -> Floats:
    """Relative variance (photodiodes,) of the ratio of two gains."""
    return np.asarray(np.sum((evidence.gains[:, one] - evidence.gains[:, other]) ** 2, axis=1))


def test_ratios_of_gains_are_adjusted_together_with_their_certificate() -> None:
    drawn = Drawn(spread=RIG_FILE.photodiodes.gain_uncertainty, rows=200, currents_a=(2e-10, 9e-10), dark_readings=64)
    evidence = drawn.evidence
    low, high = (RIG_FILE.photodiodes.gains_v_per_a.index(gain) for gain in (LOW, HIGH))
    drawn_ratio = drawn.deviation[HIGH] - drawn.deviation[LOW]
    found = evidence.deviation[high] - evidence.deviation[low]
    u = np.sqrt(ratio_variance(evidence, low, high))
    certified = math.sqrt(2.0) * RIG_FILE.photodiodes.gain_uncertainty
    assert u.max() < 0.6 * certified
    assert float(np.mean(((found - drawn_ratio) / u) ** 2)) < 1.3
    assert float(np.std(found - drawn_ratio)) < 0.5 * float(np.std(drawn_ratio))
    assert (evidence.verdicts, evidence.notes) == ((), ())
    assert ratio_variance(evidence, low, 0) == pytest.approx(certified**2, rel=0.6)  # no row was read at the first gain


def test_gains_that_are_not_those_of_the_rig_file_are_found_and_corrected() -> None:
    drawn = Drawn(spread=0.02, rows=40, currents_a=(1e-10, 5e-9))
    evidence = drawn.evidence
    (note,) = evidence.notes
    assert "gain_uncertainty of 0.1 %" in note
    assert "correct gain_uncertainty" in note
    assert not evidence.verdicts

    def rms(known: SignalEvidence) -> float:
        signal = drawn.signals(known)
        at_high = signal.gain == RIG_FILE.photodiodes.gains_v_per_a.index(HIGH)
        real = np.log(signal.value * MONITOR_A / drawn.truth_a)
        scale = {
            gain: np.array([np.median(real[here[:, c], c]) if here[:, c].any() else np.nan for c in range(N)])
            for gain, here in ((HIGH, at_high), (LOW, ~at_high))
        }
        return float(np.nanstd(scale[HIGH] - scale[LOW]))

    assert rms(plain(drawn)) > 0.02
    assert rms(evidence) < 0.002


def test_a_few_rows_at_two_gains_change_nothing() -> None:
    drawn = Drawn(spread=0.001, rows=3)
    assert np.array_equal(drawn.evidence.deviation, plain(drawn).deviation)
    assert np.array_equal(drawn.evidence.gains, plain(drawn).gains)


@pytest.mark.parametrize("settling_s", [0.06, 0.3])
def test_amplifiers_that_are_not_at_rest_are_a_verdict_on_their_modules(settling_s: float) -> None:
    drawn = Drawn(settling_s=settling_s, rows=40)
    evidence = drawn.evidence
    assert evidence.unsound.all()
    assert all("not at rest; increase settling_s" in each.text for each in evidence.verdicts)
    flagged = drawn.history.with_evidence(evidence).row_signal(drawn.lit[3], one_row(drawn.signals(evidence), 3), [])
    assert flagged.flags["module"].all()


def test_a_module_that_is_not_linear_is_a_verdict_on_it_alone() -> None:
    evidence = Drawn(bend=0.03, rows=200, currents_a=(5e-11, 9e-10), dark_readings=64).evidence
    assert np.flatnonzero(evidence.unsound).tolist() == list(range(16, 24))
    (verdict,) = evidence.verdicts
    assert verdict.text.startswith("photodiodes module 2: the ratio of the gains 1e+08 and 1e+10 V/A changes with the signal")


def test_cross_talk_that_the_rig_file_states_is_no_verdict() -> None:
    """A dark channel's volts at the higher gain are for the most part its neighbours': a ratio that depends on the signal."""
    drawn = Drawn(rows=120, gains=(HIGH, 1e11), currents_a=(2e-13, 1e-9), crosstalk=2.5e-5, readings=16, dark_readings=256)
    assert (drawn.evidence.verdicts, drawn.evidence.notes) == ((), ())
    assert np.array_equal(drawn.evidence.crosstalk, plain(drawn).crosstalk)


CROSSTALK = 1.5e-4


def crossed(stated: float, **keys: float) -> tuple[Drawn, SignalEvidence]:
    """Readings with more cross-talk than is stated, and what they show."""
    drawn = Drawn(**{"rows": 60, "gains": (HIGH, 1e11), "currents_a": (2e-13, 1e-9), "crosstalk": CROSSTALK, **keys})  # type: ignore[arg-type]
    return drawn, evidence_of(DarkHistory(drawn.dark, with_uncertainty(crosstalk=stated)), drawn.lit)


@pytest.mark.parametrize("stated", [0.0, 1e-5])
def test_cross_talk_beyond_what_is_stated_is_in_u_and_a_note(stated: float) -> None:
    """A share of 1.5e-4 of saturated neighbours: it is no error of a gain, and no amplifier that is not linear."""
    drawn, evidence = crossed(stated)
    (note,) = evidence.findings
    assert "has up to 1.5e-04 of the volts" in note or "has up to 1.6e-04" in note
    assert f"states a crosstalk of {stated:.1e}" in note
    assert evidence.crosstalk == pytest.approx(np.full(N, CROSSTALK), rel=0.15)
    assert np.max(np.abs(evidence.deviation)) < 5.0 * RIG_FILE.photodiodes.gain_uncertainty

    def coverage(known: SignalEvidence) -> float:
        signal = drawn.signals(known)
        z = (signal.value - drawn.truth_a / MONITOR_A) / np.sqrt(signal.variance)
        return float(np.mean(np.abs(z[np.isfinite(z)]) < 1.96))

    assert coverage(evidence) > 0.97
    assert coverage(replace(evidence, crosstalk=np.full(N, stated))) < 0.8


def test_cross_talk_is_found_of_one_module_and_the_others_are_cleared() -> None:
    drawn = Drawn(rows=60, gains=(HIGH, 1e11), currents_a=(2e-13, 1e-9))
    other = Drawn(rows=60, gains=(HIGH, 1e11), currents_a=(2e-13, 1e-9), crosstalk=CROSSTALK)
    for each, crosstalk in zip(drawn.lit, other.lit, strict=True):
        for one, another in zip(each.data.readings, crosstalk.data.readings, strict=True):
            one.counts[:, 8:16] = another.counts[:, 8:16]
    evidence = drawn.evidence
    (note,) = evidence.notes
    assert "(photodiodes module 1)" in note
    assert evidence.crosstalk[8:16] == pytest.approx(np.full(8, CROSSTALK), rel=0.15)
    assert np.all(np.delete(evidence.crosstalk, np.s_[8:16]) == RIG_FILE.uncertainty.u(inputs.CROSSTALK))


@pytest.mark.parametrize("fault", [{"settling_s": 0.06}, {"lamp": 0.02, "own": 0.02}, {"spread": 0.02}, {}])
def test_other_faults_are_not_taken_for_cross_talk(fault: dict[str, float]) -> None:
    _, evidence = crossed(1e-5, crosstalk=0.0, **fault)
    assert np.all(evidence.crosstalk == 1e-5)
    assert not any("crosstalk" in each for each in evidence.findings)


def test_cross_talk_that_is_not_stated_has_one_input_all_the_same() -> None:
    points = made_points(30.0, np.linspace(0.0, 55.0, 5), np.zeros(5), np.full(5, 0.01), 1e-3)
    points = replace(points, common={"crosstalk": 0.02 * points.bsdf})
    rig = with_uncertainty(crosstalk=0.0)
    effects = effects_of(points, reduction_settings(rig, parse_schedule(SCHEDULE, "small.toml").file, None, ""))
    assert effects.variances()["crosstalk"] == pytest.approx((0.02 * points.bsdf) ** 2, rel=1e-12)


def test_ratios_that_are_off_together_and_none_alone_name_the_worst() -> None:
    """Two thirds more than the certificate has, of each photodiode: chance does not make all of them."""
    drawn = Drawn(spread=2.2e-3, rows=60, currents_a=(2e-10, 9e-10), dark_readings=64)
    evidence = drawn.evidence
    assert evidence.worst_ratio < 5.0
    (note,) = evidence.notes
    assert re.search(r"most certainly of photodiodes \d", note)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_sound_modules_have_no_verdict(seed: int) -> None:
    for drawn in (Drawn(seed, 400, spread=1e-3), Drawn(seed, 400, own=0.01, spread=1e-3), Drawn(seed, 400, lamp=0.02)):
        assert (drawn.evidence.verdicts, drawn.evidence.notes) == ((), ())


# ---- properties ----

SMALL = Drawn(rows=24, own=0.01, lamp=0.01, spread=0.002)


def numbers(evidence: SignalEvidence) -> list[Floats]:
    """An evidence in numbers."""
    some = (evidence.own, evidence.lamp, evidence.slow)
    return [np.array(some), evidence.factor, evidence.deviation, evidence.gains]


def in_blocks(rows: Sequence[CommittedRow], size: int) -> SignalEvidence:
    sums = SMALL.history.sums()
    for begin in range(0, len(rows), size):
        sums.add(reading_table(each.data.readings for each in rows[begin : begin + size]))
    return sums.result()


@settings(max_examples=3, deadline=None)
@given(st.integers(1, 30))
def test_blocks_of_rows_of_any_size_give_the_same(size: int) -> None:
    for one, other in zip(numbers(in_blocks(SMALL.lit, size)), numbers(SMALL.evidence), strict=True):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-15)


@settings(max_examples=3, deadline=None)
@given(st.permutations(range(4)))
def test_the_order_of_the_readings_does_not_change_their_noise(order: list[int]) -> None:
    rows = [
        CommittedRow(
            each.row,
            replace(each.data, readings=tuple(replace(one, counts=one.counts[order]) for one in each.data.readings)),
        )
        for each in SMALL.lit
    ]
    for one, other in zip(numbers(in_blocks(rows, 99)), numbers(SMALL.evidence), strict=True):
        assert one == pytest.approx(other, rel=1e-9, abs=1e-15)


@settings(max_examples=3, deadline=None)
@given(st.floats(0.01, 100.0))
def test_the_monitors_scale_does_not_matter(scale: float) -> None:
    rows = [
        CommittedRow(
            each.row,
            replace(each.data, readings=tuple(replace(one, monitor_a=scale * one.monitor_a) for one in each.data.readings)),
        )
        for each in SMALL.lit
    ]
    for one, other in zip(numbers(in_blocks(rows, 99)), numbers(SMALL.evidence), strict=True):
        assert one == pytest.approx(other, rel=1e-6, abs=1e-12)


# ---- cross-talk, linearity, monitor ----


def test_lamp_linearity_and_cross_talk_are_divided_among_their_inputs() -> None:
    """The lamp is one input a row, cross-talk one for all, linearity one for all with a sign: darker values fall."""
    n = 12
    points = made_points(30.0, np.linspace(0.0, 55.0, n), np.zeros(n), np.where(np.arange(n) < 6, 0.01, 2.0), 1e-3)
    u = {"lamp": 0.004, "linearity": 0.002, "crosstalk": 0.001}
    row = Numbers.of(RIG_FILE).row(np.arange(n) // 2, np.zeros(n, dtype=np.int64))
    common = {"linearity": np.where(np.arange(n) < 6, -0.002, 0.002) * points.bsdf, "crosstalk": 0.001 * points.bsdf}
    points = replace(points, common=common, grouped={"lamp": Terms(row[:, None], 0.004 * points.bsdf[:, None])})
    effects = effects_of(points, reduction_settings(RIG_FILE, parse_schedule(SCHEDULE, "small.toml").file, None, ""))
    variances = effects.variances()
    for name, each in u.items():
        assert variances[name] == pytest.approx((each * points.bsdf) ** 2, rel=1e-12)
    # Points 0 and 1 are of one row, 0 and 2 of two rows, 0 and 8 on two sides of the etalon's brightness.
    relative = effects.covariance(np.array([0]), np.array([1, 2, 8]))[0] / (points.bsdf[0] * points.bsdf[[1, 2, 8]])
    lamp, linearity, crosstalk = (each**2 for each in u.values())
    assert relative == pytest.approx([lamp + linearity + crosstalk, linearity + crosstalk, crosstalk - linearity], rel=1e-9)


def with_uncertainty(**keys: float) -> RigFile:
    """The rig file with other keys of [uncertainty]."""
    return replace(RIG_FILE, uncertainty=replace(RIG_FILE.uncertainty, **keys))


def test_cross_talk_is_a_share_of_the_volts_of_the_modules_other_channels() -> None:
    drawn = Drawn(rows=12, gains=(HIGH,), currents_a=(1e-11, 8e-10))
    rig, u = with_uncertainty(crosstalk=1e-4), 1e-4
    signal = DarkHistory(drawn.dark, rig).signal(drawn.lit[0])
    level = drawn.lit[0].data.readings[0].monitor_a
    volts = signal.value * level * HIGH
    others = np.array([volts[8 * (c // 8) : 8 * (c // 8) + 8].sum() - volts[c] for c in range(N)])
    assert signal.components["crosstalk"] == pytest.approx((u * others / HIGH / level) ** 2, rel=1e-9)
    assert others[32:].max() < others[:32].max()  # the last module has half of its channels


def test_a_saturated_neighbour_counts_with_what_its_amplifier_may_give() -> None:
    drawn = Drawn(rows=12, gains=(HIGH,), currents_a=(1e-11, 2e-11))
    (reading,) = drawn.lit[0].data.readings
    reading.counts[:, 3] = RIG_FILE.photodiodes.range.highest
    signal = DarkHistory(drawn.dark, RIG_FILE).signal(drawn.lit[0])
    u_volts = np.sqrt(signal.components["crosstalk"][:3]) * reading.monitor_a * HIGH
    assert u_volts == pytest.approx(np.full(3, RIG_FILE.uncertainty.u(inputs.CROSSTALK) * 15.0), rel=0.2)
    assert math.isnan(signal.value[3])


def test_linearity_is_in_proportion_to_the_decades_between_sample_and_etalon() -> None:
    rig = with_uncertainty(linearity_per_decade=2e-3)
    zero = np.zeros(1)

    def row_of(values: list[float]) -> Signal:
        gain = np.zeros((1, len(values)), dtype=np.int64)
        signal = Signal(np.array([values]), {"noise": np.full((1, len(values)), 1e-12)}, gain=gain)
        row = RowSignals(np.zeros(1, dtype=np.int64), np.zeros((1, 5)), zero > 0.0, signal, {}, zero, zero)
        return comparable_signals(row, np.arange(len(values)), rig)

    quotient = row_of([1.0, 0.1, 100.0]) / row_of([1.0, 1.0, 1.0])
    # A value that is darker than the etalon falls where the responsivity grows with the light.
    assert quotient.common["linearity"] / quotient.value == pytest.approx(np.array([[0.0, -2e-3, 4e-3]]), abs=1e-12)


@pytest.mark.parametrize(("share", "flagged"), [(0.5, False), (0.99, True)])
def test_rows_with_the_monitor_at_the_end_of_its_range_are_flagged(share: float, flagged: bool) -> None:
    drawn = Drawn(rows=8)
    row = drawn.lit[0]
    bright = tuple(replace(each, monitor_a=share * RIG_FILE.monitor.largest_a) for each in row.data.readings)
    history = drawn.history
    signal = history.row_signal(CommittedRow(row.row, replace(row.data, readings=bright)), history.signal(row), [])
    assert bool(signal.flags["monitor"].all()) is flagged
