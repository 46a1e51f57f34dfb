"""One value with all of its inputs, from raw counts on, by GTC: it differentiates the formula of the value by itself.

The formula has the counts, the monitor and the times of a journal, and no step of the reduction. Taken from the program is what
other tests hold against the virtual rig: slopes and displacements, the modes of the slit's image, what the campaign shows of
the readings' scatter and of the gains; and what a value has alone by these (`second_order`, `slope_unresolved`, `field_noise`,
`field_unresolved`).
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import GTC
import numpy as np
import pytest

from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.lit_share import RigLaw, height_effects, lit_effects
from goniotwin.app.campaign.measurement_model.pose import ASIDE, MOUNTED, POSITIONS, Views, pose_effects, rig_inputs
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.row import CommittedRow, Reading
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import nominal_instrument, parse_rig
from tests.app.campaign.studies.test_standards import ETALON
from tests.conftest import RIG, SMALL, changed

WHITE = 'model = "lambertian"\nreflectance = 0.99\nside = "both"\n'
BETAS = ("beta_deg = [180]", "beta_deg = { start = 160, stop = 180, step = 5 }"), ("readings = 2", "readings = 5")
SECOND = '[second_standard]\nname = "second"\nradiance_factor = 0.99\nrelative_uncertainty = 0.004\n'
CHARGE_C = 1.602176634e-19
STEP = 1.0 / 12.0
"""Variance of a count by the converter's step."""
OWN = ("second_order", "slope_unresolved", "field_noise", "field_unresolved")


class Formula:
    """The value of one point of a journal as a formula of its inputs, each an uncertain number of GTC under its name."""

    def __init__(self, journal: JournalReader, reduction: Reduction, points: BsdfPoints, k: int, sample: str) -> None:
        self._rows = {each.row.number: each for each in journal.rows()}
        self._reduction, self._points, self._k, self._sample = reduction, points, k, sample
        self._rig, self._c = reduction.rig.file, int(points.photodiode[k])
        self._keys: Any = self._rig.uncertainty
        self.inputs: dict[str, GTC.lib.UncertainReal] = {}
        dark = [each for each in self._rows.values() if each.row.kind == "dark"]
        self._dark = {
            gain: [(n, one) for n, each in enumerate(dark, 1) for one in each.data.readings if one.gain_v_per_a == gain]
            for gain in self._rig.photodiodes.gains_v_per_a
        }

    def value(self) -> GTC.lib.UncertainReal:
        """S / (w1 E1 / rho1 + w2 E2 / rho2) / pi, times what files and angles do to it."""
        points, k = self._points, self._k
        sample = self._signal(self._rows[int(points.row[k])], "of the value")
        rows = [self._rows[int(each[k])] for each in (points.etalon_row, points.second_row)]
        # What the two standards' readings have alone is one line of a budget, by the etalon's row.
        standards = [self._signal(row, own) for row, own in zip(rows, self.readings_of_standards, strict=True)]
        # By the certificates alone, whose other inputs are alike: weights of the least variance.
        alike = 2.0 * self._keys.etalon_edge**2 / 2.0 + self._keys.etalon_age_per_year**2
        variances = [0.002**2 + alike, 0.004**2 + alike]
        weights = [variances[1] / sum(variances), variances[0] / sum(variances)]
        reference = sum(w * each / 0.99 for w, each in zip(weights, standards, strict=True))
        return sample / reference / math.pi * GTC.exp(self._logarithm(weights) + sum(self._alone()))

    @property
    def readings_of_standards(self) -> tuple[str, str]:
        """The names of the inputs that the readings of etalon and second standard have alone."""
        etalon, second = (int(each[self._k]) for each in (self._points.etalon_row, self._points.second_row))
        return f"of the etalon in row {etalon}", f"of the second standard in row {second}"

    def _signal(self, row: CommittedRow, own: str) -> GTC.lib.UncertainReal:
        """Photocurrent over the monitor's current, at the highest gain that is not saturated."""
        range_, c, keys = self._rig.photodiodes.range, self._c, self._keys
        usable = [each for each in row.data.readings if not range_.saturated(each.counts)[:, c].any()]
        reading = max(usable, key=lambda each: each.gain_v_per_a)
        gain, lsb = reading.gain_v_per_a, range_.lsb_v
        numbers = self._rig.photodiodes.gains_v_per_a
        volts = [reading.counts[:, j].mean() * lsb - self._dark_volts(reading, j) for j in self._module]
        clipped = np.any(range_.saturated(reading.counts), axis=0).tolist()
        others = sum(
            (1.5 if clipped[j] else 1.0) * GTC.value(each) for j, each in zip(self._module, volts, strict=True) if j != c
        )
        evidence, n = self._reduction.measurements.evidence, self._conversions(reading)
        mine = volts[self._module.index(c)] + others * self._input("crosstalk", keys.crosstalk)
        current = mine / gain
        size = GTC.value(current)
        shot = 2.0 * CHARGE_C * abs(size) * 0.5 / self._rig.photodiodes.period_s
        variance = evidence.factor[c] * ((self._reading_v2(gain, c) / gain**2 + shot) / n + evidence.own * size**2 / n)
        variance += evidence.slow * size**2
        current = current + math.sqrt(variance) * self._input(f"noise {own}", 1.0)
        # Of the lit and of the dark reading: the converter's step, which the noise smooths as dither.
        step = 2.0 * STEP * math.exp(-4.0 * math.pi**2 * max(self._pooled(gain, c) - STEP, 0.0)) * lsb**2
        current = current + math.sqrt(step) / gain * self._input(f"resolution {own}", 1.0)
        lamp = self._input(f"lamp@row {row.row.number}, {gain:g} V/A", 1.0)
        current = current + size * math.sqrt(evidence.lamp / n) * lamp
        index = numbers.index(gain)
        current = current / (1.0 + float(evidence.deviation[index, c]))
        for mode, each in enumerate(numbers):
            u = self._rig.photodiodes.gain_uncertainty
            of_mode = self._input(f"gain_ratio[{c}, {each:g} V/A]", u)
            current = current / (1.0 + float(evidence.gains[c, index, mode]) / u * of_mode)
        dark_monitor = GTC.value(self._interpolated(reading, lambda each: each.monitor_a))
        u_monitor = self._rig.monitor.relative_uncertainty
        monitor = (reading.monitor_a - dark_monitor) * (
            1.0 + self._input(f"monitor@row {row.row.number}, {gain:g} V/A", u_monitor)
        )
        signal = current / monitor
        monitor_decades = math.log10(np.mean([each.monitor_a for each in row.data.readings]))
        decades, hours = math.log10(abs(GTC.value(signal))), row.data.started_s / 3600.0
        return signal * GTC.exp(
            decades * self._input("linearity", keys.linearity_per_decade)
            - hours * self._input("monitor_drift", keys.monitor_drift_per_hour)
            - monitor_decades * self._input("monitor_linearity", keys.monitor_linearity_per_decade)
        )

    @cached_property
    def _module(self) -> list[int]:
        """The photodiodes that share the value's module."""
        size = self._rig.photodiodes.module_channels
        first = self._c - self._c % size
        return [*range(first, min(first + size, self._rig.photodiodes.count))]

    def _dark_volts(self, reading: Reading, j: int) -> Any:
        """The dark reading at the time of a reading, of the value's photodiode with its inputs."""
        found = self._interpolated(reading, lambda each: each.counts[:, j].mean() * self._rig.photodiodes.range.lsb_v, j)
        return found if j == self._c else GTC.value(found)

    def _interpolated(self, reading: Reading, of: Any, channel: int | None = None) -> Any:
        """What dark readings have, linearly in time."""
        gain, at = reading.gain_v_per_a, self._middle_s(reading)
        known = self._dark[gain]
        times = [self._middle_s(each) for _, each in known]
        weights = [float(np.interp(at, times, np.eye(len(known))[i])) for i in range(len(known))]
        total: Any = sum(w * of(each) for w, (_, each) in zip(weights, known, strict=True))
        if channel is not None and channel == self._c:
            for w, (number, each) in zip(weights, known, strict=True):
                noise = math.sqrt(self._reading_v2(gain, channel) / self._conversions(each))
                total = total + w * noise * self._input(f"dark[{channel}, {gain:g} V/A]@dark {number}", 1.0)
        return total

    def _reading_v2(self, gain: float, c: int) -> float:
        """Variance of one reading, by the scatter of the dark readings; at least that of the converter's step."""
        return max(self._pooled(gain, c), STEP) * self._rig.photodiodes.range.lsb_v**2

    def _pooled(self, gain: float, c: int) -> float:
        """Variance of one reading's counts, widened as Student's distribution is."""
        counts = [each.counts[:, c] for _, each in self._dark[gain]]
        freedom = sum(len(each) - 1 for each in counts)
        return sum(float(((each - each.mean()) ** 2).sum()) for each in counts) / (freedom - 2.0)

    @staticmethod
    def _middle_s(reading: Reading) -> float:
        return reading.first_s + 0.5 * (len(reading.counts) - 1) * reading.period_s

    @staticmethod
    def _conversions(reading: Reading) -> int:
        return 1 + int(np.any(np.diff(reading.counts.astype(int), axis=0) != 0, axis=1).sum())

    def _logarithm(self, weights: list[float]) -> Any:
        """What inputs of files and of the pose do to the logarithm of the value."""
        points, k, keys = self._points, self._k, self._keys
        total: Any = float(points.field_correction[k]) - float(points.field_correction[k]) * self._input(
            "field", keys.field_of_view
        )
        for w, piece, u in ((weights[0], "", 0.002), (weights[1], "second_", 0.004)):
            names = (f"{piece}certificate[level]", u), (f"{piece or 'etalon_'}age", keys.etalon_age_per_year)
            for name, size in (*names, (f"{piece or 'etalon_'}edge", keys.etalon_edge)):
                total = total - w * self._input(name, size)
        total = total + self._input("monochromator_stray", keys.monochromator_stray)
        for name, effect, u in self._moved(weights):
            total = total + effect * self._input(name, u)
        return total

    def _moved(self, weights: list[float]) -> Iterator[tuple[str, float, float]]:
        """Inputs of the pose: name, change of the logarithm for one unit, and standard uncertainty."""
        points, k = self._points, self._k
        instrument = nominal_instrument(self._rig)
        lower = points.transmitted != points.back
        polar = np.radians(np.where(lower, 180.0 - points.zenith_deg, points.zenith_deg))
        reverse = np.cos(np.radians(points.azimuth_deg - points.beta_deg)) < 0.0
        views = Views(
            points.sigma_deg, points.gamma_deg, polar, np.radians(points.azimuth_deg), lower, points.transmitted, reverse
        )
        effects = pose_effects(instrument, views)
        slopes = np.nan_to_num([points.slope_along[k], points.slope_across[k]])

        def width(key: str) -> float:
            return float(getattr(self._keys, key)) / math.sqrt(3.0)

        def change(part: Any, i: int) -> float:
            return float(slopes[0] * part.along[k, i] + slopes[1] * part.across[k, i] + part.diffuse[k, i])

        for i, each in enumerate(rig_inputs(self._rig.uncertainty)):
            yield each.name, change(effects.common, i), each.u
        for place, kind, part, sign in (
            (self._sample, "sample", effects.sample, 1.0),
            ("etalon", "etalon", effects.etalon, weights[0]),
            ("second", "etalon", effects.etalon, weights[1]),
        ):
            for i, name in enumerate(MOUNTED):
                key = f"{kind}_height_mm" if name == "height" else f"{kind}_tilt_deg"
                yield f"{kind}_{name}@{place}#1", sign * change(part, i), width(key)
            for i, name in enumerate(ASIDE):
                u = width(f"{kind}_height_mm") * width("sensor_tilt_deg" if name == "sensor_tilt_y" else f"{name[:-2]}_mm")
                yield f"{kind}_height*{name}@{place}#1", (1.0 if kind == "sample" else -sign) * change(effects.lifted, i), u
        for i, name in enumerate(("angle", "across")):
            yield f"photodiode_{name}[{self._c}]", change(effects.photodiode, i), width(f"photodiode_{name}_deg")
        rows = int(points.row[k]), int(points.etalon_row[k]), int(points.second_row[k])
        for i, axis in enumerate(POSITIONS):
            for row, part, sign in zip(
                rows, (effects.position, effects.etalon_position, effects.etalon_position), (1.0, *weights), strict=True
            ):
                yield f"position@{axis}#{self._moves(i, row)}", sign * change(part, i), width("position_deg")
        law = RigLaw.of(self._rig)
        by_image = height_effects(law, views)
        for place, kind, sign in (
            (self._sample, "sample", 1.0),
            ("etalon", "etalon", -weights[0]),
            ("second", "etalon", -weights[1]),
        ):
            for i, effect in enumerate(by_image[kind][k].tolist(), 1):
                yield f"{kind}_height*slit_image[{i}]@{place}#1", sign * effect, width(f"{kind}_height_mm")
        if points.transmitted[k]:
            modes = lit_effects(law, views, views.sigma_deg) - lit_effects(law, views, 180.0 - views.sigma_deg)
            for i, effect in enumerate(modes[k].tolist(), 1):
                yield f"slit_image[{i}]", effect, 1.0

    def _moves(self, axis: int, number: int) -> int:
        """How often an axis has moved before a row: it has where a sample is mounted, by hand."""
        at, moves = None, 0
        for each in self._rows.values():
            at = None if each.row.kind == "mount" else at
            if each.row.pose is not None:
                moves += each.row.pose[axis] != at
                at = each.row.pose[axis]
            if each.row.number == number:
                break
        return moves

    def _alone(self) -> Iterator[GTC.lib.UncertainReal]:
        """What the value has alone, by the program."""
        value = float(self._points.bsdf[self._k])
        for name in OWN:
            if name in self._points.own:
                u = math.sqrt(float(self._points.own[name][self._k])) / value
                yield self._input(f"{name} of the value", u)

    def _input(self, name: str, u: float) -> GTC.lib.UncertainReal:
        if name not in self.inputs:
            self.inputs[name] = GTC.ureal(0.0, float(u), label=name)
        return self.inputs[name]


@pytest.mark.parametrize(
    ("sample", "light", "theta_deg"),
    [("gaussian-5", "reflected", 5.0), pytest.param("opal", "transmitted", 10.0, marks=pytest.mark.long)],
)
def test_a_value_and_its_budget_are_those_of_gtc(sample: str, light: str, theta_deg: float, tmp_path: Path) -> None:
    rig = changed(RIG.read_text(), ((ETALON, f"[twin.samples.second]\n{WHITE}\n[twin.samples.etalon]\n{WHITE}"),))
    samples = ('samples = ["gaussian-5"]', f'samples = ["{sample}"]\nlight = "{light}"')
    schedule, transmitted = parse_schedule(changed(SMALL, (samples, *BETAS)) + SECOND, "gtc.toml"), light == "transmitted"
    run_without_wires(make_plan(schedule, parse_rig(rig, RIG.parent, "rig.toml")), tmp_path / "a.journal")
    with Journal.open(tmp_path / "a.journal") as opened:
        reduction = evaluate_journal(opened).reduction
        points = BsdfPoints.join(list(reduce_journal(opened).samples[sample].settings()))
        chosen = points.good & (points.transmitted == transmitted) & (points.second_row >= 0) & np.isfinite(points.slope_across)
        beside = np.where(chosen & (points.slope_across != 0.0), np.abs(points.theta_deg - theta_deg), np.inf)
        k = int(np.argmin(beside))
        effects = effects_of(points, replace(reduction.settings, sample=sample))
        formula = Formula(opened, reduction, points, k, sample)
        found = formula.value()
    assert found.x == pytest.approx(float(points.bsdf[k]), rel=1e-9)
    expected = {name: abs(GTC.component(found, each)) for name, each in formula.inputs.items()}
    of_standards = [expected.pop(f"{what} {own}") for what in ("noise", "resolution") for own in formula.readings_of_standards]
    expected[f"etalon_reading[{points.photodiode[k]}]@row {points.etalon_row[k]}"] = math.hypot(*of_standards)
    budget = {each.name: each.u for each in effects.budget(k)}
    alone = {"noise", "resolution", *OWN}
    budget = {f"{name} of the value" if name in alone else name: u for name, u in budget.items()}
    seen = {name: u for name, u in expected.items() if u > 1e-9 * found.u}
    assert seen == {name: pytest.approx(u, rel=1e-7, abs=1e-9 * found.u) for name, u in budget.items() if name in seen}
    assert {name for name, u in budget.items() if u > 1e-8 * found.u} <= seen.keys()
    assert found.u == pytest.approx(float(points.u_bsdf[k]), rel=1e-9)
