"""All components of points as effects of named inputs: they sum to u, and have the covariances of an independent program.

The program is GTC, the GUM Tree Calculator of the Measurement Standards Laboratory of New Zealand: it differentiates the
formula of a value by itself.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import GTC
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from goniotwin.app.campaign.journal.reading import ExecutedRow
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.effects import Effects
from goniotwin.app.campaign.measurement_model.lit_share import RigLaw, height_effects
from goniotwin.app.campaign.measurement_model.pose import (
    ASIDE,
    POSITIONS,
    Displacement,
    Views,
    lifted_inputs,
    pose_effects,
    position_u_deg,
    rig_inputs,
)
from goniotwin.app.campaign.measurement_model.quantity import Quantity
from goniotwin.app.campaign.reduction.angles import add_pose
from goniotwin.app.campaign.reduction.arc_geometry import ArcGeometry
from goniotwin.app.campaign.reduction.components import kinds
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.pipeline import add_shared
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.reading_inputs import Numbers
from goniotwin.app.campaign.reduction.row_history import RowHistory, history_of
from goniotwin.app.campaign.reduction.settings import ReductionSettings, SecondStandard, reduction_settings
from goniotwin.app.campaign.schedule.certificate import parse_certificate
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.campaign.studies.reflectance import components_of_sum, quadrature
from goniotwin.app.rig import nominal_instrument, read_rig
from goniotwin.arrays import Floats, Ints
from tests.app.campaign.reduction.made_points import made_points
from tests.conftest import RIG, SMALL
from tests.rig_tables import stated

FILE = read_rig(RIG).file
SETTINGS = reduction_settings(FILE, parse_schedule(SMALL, "small.toml").file, None, "")
POLAR = np.array(FILE.photodiodes.upper_deg)
LINES = (180.0, 150.0, 20.0)
COUNT = POLAR.size * len(LINES)
U_MONITOR, U_GAIN = FILE.monitor.relative_uncertainty, FILE.photodiodes.gain_uncertainty
CERTIFICATE = float(SETTINGS.certificate.relative_uncertainty.min())
CORRECTION = 0.1 * np.cos(np.arange(COUNT))
GAIN = np.arange(COUNT) % 2
TABLE: Any = stated(uniformity=0.002, repeatability=0.003, mounting=0.004)
KEYS: Any = FILE.uncertainty  # its numbers by key: the formula of a value knows nothing of declared inputs
CERTIFIED = """level = 0.002
wavelength_nm, radiance_factor, relative_uncertainty
400, 1.0, 0.004
700, 1.0, 0.003
"""
ALL_SETTINGS = replace(
    SETTINGS,
    rig=replace(FILE, uncertainty=TABLE),
    geometry=ArcGeometry(replace(FILE, uncertainty=TABLE)),
    certificate=parse_certificate(CERTIFIED, "c"),
    sample="paint",
    schedule=SETTINGS.schedule.model_copy(update={"diattenuation": {"paint": 0.3}}),
)
"""With every component that a rig file, certificate and schedule can state of one standard."""
TWO_STANDARDS = replace(
    ALL_SETTINGS,
    second=SecondStandard("second", parse_certificate(CERTIFIED.replace("0.003", "0.005"), "s"), 2.0, False, difference=0.02),
)
"""The second one is read in two of three rows, and does not agree with the etalon."""


def measured(
    bsdf: Floats, slope: Floats, relative: dict[str, Floats] | None = None, settings_of: ReductionSettings = SETTINGS
) -> BsdfPoints:
    """Points (COUNT,) of three rows, with slopes (COUNT, 2); two of them divide by one reading of the etalon."""
    parts = []
    for k, azimuth in enumerate(LINES):
        here = slice(k * POLAR.size, (k + 1) * POLAR.size)
        made = made_points(30.0, POLAR, np.full(POLAR.size, azimuth), bsdf[here], 0.0)
        rows = np.full(POLAR.size, 10 + k), np.full(POLAR.size, 5 if k < 2 else 7)
        second = np.full(POLAR.size, 6 if k < 2 else -1)
        parts.append(replace(made, row=rows[0], etalon_row=rows[1], second_row=second))
    points = BsdfPoints.join(parts)
    given = replace(
        points.with_quantity(divided(points, relative or {})),
        slope_along=slope[:, 0],
        slope_across=slope[:, 1],
        gain=GAIN,
        field_correction=CORRECTION,
        wavelength_slope=0.01 * CORRECTION,
        band_correction=0.02 * CORRECTION,
    )
    return add_pose(add_shared(given, settings_of), settings_of)


def divided(points: BsdfPoints, relative: dict[str, Floats]) -> Quantity:
    """The values of points as signals over those of the etalon, with effects of these relative sizes."""
    one, numbers = np.ones(COUNT), Numbers.of(FILE)

    def signal(value: Floats, rows: Ints, gain: Ints, names: dict[str, str]) -> Quantity:
        """One with the effects of `names`, by what they are called in `relative`."""
        of_row = numbers.row(rows, gain)
        members = {
            "dark": (rows * numbers.gains + gain) * numbers.photodiodes + points.photodiode,
            "lamp": of_row,
            "monitor": of_row,
            "gain": numbers.gain(points.photodiode, gain),
            "signature_reading": numbers.reading(rows, points.photodiode),
        }
        result = Quantity(value)
        for name, called in names.items():
            if called in relative:
                effect = (-1.0 if name in ("dark", "monitor", "gain", "signature_reading") else 1.0) * relative[called] * value
                if name in members:
                    result = result.with_grouped(name, members[name].astype(np.int32)[:, None], effect[:, None])
                elif name in COMMON:
                    result = result.with_common(name, effect)
                else:
                    result = result.with_own(name, effect**2)
        return result

    alike = {name: name for name in ("monitor", "gain")}
    own = {name: name for name in ("noise", "resolution", "ray_tracing", *COMMON, "dark", "lamp", "signature_reading")}
    sample = signal(points.bsdf, points.row, GAIN, {**alike, **own})
    at_etalon = {"dark": "etalon_dark", "lamp": "etalon_lamp", "reading": "etalon_reading", "crosstalk": "etalon_crosstalk"}
    etalon = signal(one, points.etalon_row, np.zeros(COUNT, dtype=np.int64), {**alike, **at_etalon})
    quotient = sample / etalon.own_as("etalon_reading", numbers.reading(points.etalon_row, points.photodiode))
    for name in ("second_order", "slope_unresolved", "field_noise", "field_unresolved"):
        quotient = quotient.with_own(name, (relative.get(name, 0.0) * points.bsdf) ** 2)
    if "calibration" in relative:
        effect = relative["calibration"] * points.bsdf
        quotient = quotient.with_grouped("calibration", points.photodiode.astype(np.int32)[:, None], effect[:, None])
    if "band_shape" in relative:
        effect = relative["band_shape"] * points.bsdf
        quotient = quotient.with_grouped("band_shape", np.full((COUNT, 1), 550_000, dtype=np.int32), effect[:, None])
    return quotient.with_common("field", -KEYS.field_of_view * CORRECTION * points.bsdf)


def relative_of(noise: Floats) -> dict[str, Floats]:
    """Relative standard uncertainties (COUNT,) of signals, and of what comes in later; `signature` falls with the light."""
    one = np.ones(COUNT)
    photodiode: Floats = np.tile(np.arange(POLAR.size, dtype=np.float64), len(LINES))
    etalon: Floats = np.repeat(np.array([0.0, 0.0, 1.0]), POLAR.size)
    return {
        "noise": noise,
        "resolution": 0.1 * noise,
        "dark": 0.5 * noise,
        "etalon_dark": 1e-4 * (2.0 + photodiode),
        "monitor": U_MONITOR * one,
        "monitor_drift": 0.3 * noise,
        "monitor_linearity": 0.1 * noise,
        "gain": U_GAIN * one,
        "etalon_reading": 1e-4 * (1.0 + photodiode + 20.0 * etalon),
        "calibration": 1e-4 * (1.0 + photodiode),
        "lamp": 0.4 * noise,
        "etalon_lamp": 1e-3 * (1.0 + etalon),
        "linearity": 0.6 * noise,
        "crosstalk": 0.7 * noise,
        "etalon_crosstalk": 1e-3 * one,
        "band_shape": 0.25 * noise,
        "second_order": 0.8 * noise,
        "slope_unresolved": 0.9 * noise,
        "field_noise": 0.3 * noise,
        "field_unresolved": 0.45 * noise,
        "ray_tracing": 0.2 * noise,
        "signature": -0.2 * noise,
        "signature_reading": 0.15 * noise,
    }


def total(effects: Effects) -> Floats:
    """The sum of all variances (n,)."""
    return np.asarray(np.sum(list(effects.variances().values()), axis=0))


def values(least: float, most: float) -> st.SearchStrategy[Floats]:
    return arrays(np.float64, COUNT, elements=st.floats(least, most))


SLOPES = arrays(np.float64, (COUNT, 2), elements=st.one_of(st.floats(-5.0, 5.0), st.just(np.nan)))


@settings(max_examples=25, deadline=None)
@given(values(-3.0, 3.0), SLOPES, values(0.0, 1.0))
def test_the_parts_of_any_points_sum_to_their_uncertainty(bsdf: Floats, slope: Floats, noise: Floats) -> None:
    bsdf = np.where(np.abs(bsdf) < 1e-6, 0.0, bsdf)
    points = measured(bsdf, slope, relative_of(noise), TWO_STANDARDS)
    assert set(points.components) == {*kinds()} - {"open_beam", "slit_image"}  # those of transmitted light
    effects = effects_of(points, TWO_STANDARDS)
    expected = points.u_bsdf**2
    assert np.abs(total(effects) - expected).max() <= 1e-12 * expected.max()
    assert np.all(np.abs(total(effects) - expected) <= 1e-12 * expected)
    k = int(np.argmax(expected))
    assert sum(each.u**2 for each in effects.budget(k)) == pytest.approx(expected[k], rel=1e-12)
    every = np.arange(COUNT)
    covariance = effects.covariance(every, every)
    assert np.array_equal(covariance, covariance.T) or np.abs(covariance - covariance.T).max() <= 1e-15 * expected.max()
    assert np.diag(covariance) == pytest.approx(expected, rel=1e-12, abs=1e-300)
    assert np.linalg.eigvalsh(covariance).min() >= -1e-12 * max(expected.sum(), 1e-300)


def test_a_point_without_a_slope_has_the_diffuse_part_alone() -> None:
    none = measured(np.ones(COUNT), np.full((COUNT, 2), np.nan))
    assert np.all(none.components["photodiode_angle"] == 0.0)
    # Sample and etalon are tilted by angles of their own: the root of 2 times tan(theta_i) and tan(theta_r) together.
    u_tilt = np.radians(KEYS.sample_tilt_deg / np.sqrt(3.0))
    at_80 = np.flatnonzero(none.zenith_deg == 80.0)[0]
    tilts = np.hypot(np.tan(np.radians(30.0)) - np.tan(np.radians(80.0)), 0.0) * u_tilt * np.sqrt(2.0)
    # Each of the two heights, times what moves the photodiodes' discs against their cones, and times the image's place.
    sigma, gamma, polar, azimuth = (np.array([each]) for each in (30.0, 0.0, np.radians(80.0), np.pi))
    no = np.zeros(1, dtype=bool)
    views = Views(sigma, gamma, polar, azimuth, lower=no, transmitted=no, reverse=no)
    u = np.array([each.u for each in lifted_inputs(TABLE, "sample", "a")])
    lifted = np.sqrt(2.0) * np.linalg.norm(pose_effects(nominal_instrument(FILE), views).lifted.diffuse[0] * u)
    by_image = np.sqrt(2.0) * np.linalg.norm(height_effects(RigLaw.of(FILE), views)["sample"]) * half_width("sample_height_mm")
    assert 0.0005 < by_image < 0.0015
    assert lifted > 0.3 * tilts
    assert np.sqrt(none.components["pose"][at_80]) == pytest.approx(np.hypot(np.hypot(tilts, lifted), by_image), rel=0.05)
    steep = measured(np.ones(COUNT), np.full((COUNT, 2), 1.0))
    assert np.all(steep.components["pose"] > none.components["pose"])


def test_the_pipeline_and_the_effects_agree_on_what_is_a_family() -> None:
    points = measured(np.ones(COUNT), np.ones((COUNT, 2)), relative_of(np.full(COUNT, 0.01)))
    effects = effects_of(points, SETTINGS)
    assert set(effects.independent) == OWN
    assert sorted(group.name for group in effects.groups) == [
        "band_shape",
        "calibration",
        "dark",
        "etalon_reading",
        "gain",
        "lamp",
        "monitor",
        "photodiode_angle",
        "position",
        "signature_reading",
    ]
    names = [each.name for part in effects.dense for each in part.inputs]
    assert {"certificate[level]", "field", "signature", "sigma_zero", "sample_tilt_x@sample#1"} <= set(names)
    assert len(names) == len(set(names))


def test_one_gain_at_sample_and_etalon_cancels() -> None:
    points = measured(np.ones(COUNT), np.full((COUNT, 2), np.nan), relative_of(np.full(COUNT, 0.01)))
    effects = effects_of(points, SETTINGS)
    gains = {k: sum(each.u for each in effects.budget(k) if each.name.startswith("gain_ratio")) for k in (0, 1)}
    assert gains[0] == pytest.approx(0.0, abs=1e-18)
    assert gains[1] == pytest.approx(2.0 * U_GAIN, rel=1e-12)


# Covariances against GTC.


@pytest.mark.parametrize("settings_of", [SETTINGS, ALL_SETTINGS], ids=["defaults", "all that can be stated"])
def test_covariances_are_those_that_gtc_finds_from_the_formula_of_a_value(settings_of: ReductionSettings) -> None:
    rng = np.random.default_rng(3)
    bsdf, slope = rng.uniform(0.1, 9.0, COUNT), rng.normal(0.0, 0.5, (COUNT, 2))
    relative = relative_of(rng.uniform(0.002, 0.02, COUNT))
    names = GTC_NAMES if settings_of is SETTINGS else set(relative)
    points = measured(bsdf, slope, {name: relative[name] for name in names}, settings_of)
    effects = effects_of(points, settings_of)
    chosen = rng.choice(COUNT, 20, replace=False)
    formula = Formula(points, relative, None if settings_of is SETTINGS else settings_of.sample)
    found = [formula.value(int(k)) for k in chosen]
    covariance = effects.covariance(chosen, chosen)
    scale = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    expected = np.array([[GTC.get_covariance(one, other) for other in found] for one in found])
    assert [each.u for each in found] == pytest.approx(points.u_bsdf[chosen].tolist(), rel=1e-9)
    assert np.abs((covariance - expected) / scale).max() < 1e-9
    assert np.abs(expected / scale)[~np.eye(20, dtype=bool)].max() > 0.5  # some do have much in common
    # Their mean, and a budget of it by the same names.
    weight = np.zeros(COUNT)
    weight[chosen] = 1.0 / 20.0
    mean = sum(found) / 20.0
    components = effects.of_sum(weight)
    assert np.sqrt(sum(each.u**2 for each in components)) == pytest.approx(mean.u, rel=1e-9)
    for each in components:
        if each.input is not None and each.u > 1e-6:
            assert each.u == pytest.approx(abs(GTC.component(mean, formula.inputs[each.name])), rel=1e-6), each.name


GTC_NAMES = (
    "noise",
    "monitor",
    "lamp",
    "etalon_lamp",
    "gain",
    "crosstalk",
    "etalon_crosstalk",
    "etalon_reading",
    "calibration",
    "dark",
    "etalon_dark",
)
COMMON = ("linearity", "crosstalk", "signature", "monitor_drift", "monitor_linearity", "field")
OWN = {"noise", "resolution", "ray_tracing", "field_noise", "field_unresolved", "second_order", "slope_unresolved"}


def half_width(key: str) -> float:
    """The standard uncertainty of a rectangular distribution."""
    return float(getattr(KEYS, key) / np.sqrt(3.0))


class Formula:
    """The value of a point as a formula of its inputs, each an uncertain number of GTC under its name."""

    def __init__(self, points: BsdfPoints, relative: dict[str, Floats], sample: str | None) -> None:
        """All of ALL_SETTINGS for a named `sample`."""
        self._points, self._relative, self._sample = points, relative, sample
        self.inputs: dict[str, GTC.lib.UncertainReal] = {}
        views = Views(
            points.sigma_deg,
            points.gamma_deg,
            np.radians(points.zenith_deg),
            np.radians(points.azimuth_deg),
            points.back,
            points.transmitted,
            points.back,
        )
        self._effects, self._by_image = pose_effects(nominal_instrument(FILE), views), height_effects(RigLaw.of(FILE), views)

    def value(self, k: int) -> GTC.lib.UncertainReal:
        """exp(g . p) S / E: each signal with its gain, its lamp and its reading."""
        points, c = self._points, int(self._points.photodiode[k])
        row, etalon_row, gain = int(points.row[k]), int(points.etalon_row[k]), int(points.gain[k])
        volts = FILE.photodiodes.gains_v_per_a
        signal = (1.0 + self._input(f"noise of {k}", self._relative["noise"][k])) * (
            1.0 - self._relative["dark"][k] * self._input(f"dark[{c}, {volts[gain]:g} V/A]@dark {row}", 1.0)
        )
        signal = signal / self._gain(c, gain) / self._monitor(row, gain)
        reading = 1.0 + self._input(f"etalon_reading[{c}]@row {etalon_row}", self._relative["etalon_reading"][k])
        dark = self._relative["etalon_dark"][k] * self._input(f"dark[{c}, {volts[0]:g} V/A]@dark {etalon_row}", 1.0)
        etalon = reading * (1.0 - dark) / self._gain(c, 0) / self._monitor(etalon_row, 0)
        factor = 1.0 + self._input(f"calibration[{c}]@sample 0", self._relative["calibration"][k])
        table = KEYS
        u_crosstalk = table.crosstalk
        signal = signal * (1.0 + self._relative["crosstalk"][k] / u_crosstalk * self._input("crosstalk", u_crosstalk))
        etalon = etalon * (1.0 + self._relative["etalon_crosstalk"][k] / u_crosstalk * self._input("crosstalk", u_crosstalk))
        signal = signal * (1.0 + self._relative["lamp"][k] * self._input(f"lamp@row {row}, {volts[gain]:g} V/A", 1.0))
        of_etalon_row = self._input(f"lamp@row {etalon_row}, {volts[0]:g} V/A", 1.0)
        etalon = etalon * (1.0 + self._relative["etalon_lamp"][k] * of_etalon_row)
        # More light of the etalon than certified, whatever the reason.
        of_etalon = {
            "certificate[level]": CERTIFICATE,
            "etalon_age": table.etalon_age_per_year,
            "etalon_edge": table.etalon_edge,
        }
        for name, u in of_etalon.items():
            etalon = etalon * (1.0 + self._input(name, u))
        light = (
            float(points.wavelength_slope[k]) * self._input("wavelength", table.wavelength_nm)
            + float(points.band_correction[k]) * self._input("bandwidth", 1.0)
            + self._input("monochromator_stray", table.monochromator_stray)
            - float(CORRECTION[k]) * self._input("field", table.field_of_view)
        )
        moved = self._angles(k, c, row, etalon_row)
        if self._sample is not None:
            signal, etalon = self._with_all(k, row, etalon_row, signal, etalon)
        return float(points.bsdf[k]) * signal / etalon * factor * GTC.exp(light + moved)

    def _with_all(
        self, k: int, row: int, etalon_row: int, signal: GTC.lib.UncertainReal, etalon: GTC.lib.UncertainReal
    ) -> tuple[GTC.lib.UncertainReal, GTC.lib.UncertainReal]:
        """The signals with what the defaults do not have: 0.4 % and 0.3 % of the certificate are 0.35 % at 550 nm."""
        etalon = etalon * (1.0 + self._input("certificate[400 nm]", np.sqrt(0.0035**2 - 0.002**2)))
        for name, u in (("uniformity", TABLE.uniformity), ("mounting", TABLE.mounting)):
            signal = signal * (1.0 + self._input(f"{name}@{self._sample}#1", u))
            etalon = etalon * (1.0 + self._input(f"{name}@etalon#1", u))
        signal = signal * (1.0 + self._input(f"repeatability@#{row}", TABLE.repeatability))
        etalon = etalon * (1.0 + self._input(f"repeatability@#{etalon_row}", TABLE.repeatability))
        s, p = FILE.light.mirror_p**3, FILE.light.mirror_s**3  # of unpolarised light, over three mirrors
        signal = signal * (1.0 + (s - p) / (s + p) * self._input(f"polarisation@{self._sample}", 0.3))
        for name, key in (
            ("linearity", "linearity_per_decade"),
            ("monitor_drift", "monitor_drift_per_hour"),
            ("monitor_linearity", "monitor_linearity_per_decade"),
        ):
            u = getattr(KEYS, key)
            signal = signal * (1.0 + self._relative[name][k] / u * self._input(name, u))
        signal = signal * (1.0 + self._relative["signature"][k] * self._input("signature", 1.0))
        reading = self._input(f"signature_reading[{self._points.photodiode[k]}]@row {row}", 1.0)
        signal = signal * (1.0 - self._relative["signature_reading"][k] * reading)
        signal = signal * (1.0 + self._relative["band_shape"][k] * self._input("band_shape[550 nm]@sample 0", 1.0))
        for name in ("resolution", "ray_tracing", "second_order", "slope_unresolved", "field_noise", "field_unresolved"):
            signal = signal * (1.0 + self._input(f"{name} of {k}", self._relative[name][k]))
        return signal, etalon

    def _angles(self, k: int, c: int, row: int, etalon_row: int) -> GTC.lib.UncertainReal:
        table, effects = KEYS, self._effects
        terms = [(each.name, each.u, effects.common, i) for i, each in enumerate(rig_inputs(table))]
        for kind, part in (("sample", effects.sample), ("etalon", effects.etalon)):
            for i, (each, unit) in enumerate((("tilt_x", "deg"), ("tilt_y", "deg"), ("height", "mm"))):
                at = self._sample if self._sample is not None and kind == "sample" else kind
                terms.append((f"{kind}_{each}@{at}#1", half_width(f"{kind}_{each.split('_')[0]}_{unit}"), part, i))
        for kind, sign in (("sample", 1.0), ("etalon", -1.0)):
            at = self._sample if self._sample is not None and kind == "sample" else kind
            part = replace(effects.lifted, diffuse=sign * effects.lifted.diffuse)
            for i, (each, key) in enumerate(
                zip(ASIDE, ("arc_shift_mm",) * 3 + ("sensor_tilt_deg", "sensor_shift_mm"), strict=True)
            ):
                u = half_width(f"{kind}_height_mm") * half_width(key)
                terms.append((f"{kind}_height*{each}@{at}#1", u, part, i))
            none = np.zeros_like(self._by_image[kind])
            part = Displacement(none, none, sign * self._by_image[kind])
            for i in range(none.shape[1]):
                terms.append((f"{kind}_height*slit_image[{i + 1}]@{at}#1", half_width(f"{kind}_height_mm"), part, i))
        for i, each in enumerate(("angle", "across")):
            terms.append((f"photodiode_{each}[{c}]", half_width(f"photodiode_{each}_deg"), effects.photodiode, i))
        for i, axis in enumerate(POSITIONS):
            for number, part in ((row, effects.position), (etalon_row, effects.etalon_position)):
                terms.append((f"position@{axis}#{number}", position_u_deg(table), part, i))
        result = 0.0
        for name, u, part, i in terms:
            moved = self._points.slope_along[k] * part.along[k, i] + self._points.slope_across[k] * part.across[k, i]
            result = result + float(moved + part.diffuse[k, i]) * self._input(name, u)
        return result

    def _monitor(self, row: int, gain: int) -> GTC.lib.UncertainReal:
        return 1.0 + self._input(f"monitor@row {row}, {FILE.photodiodes.gains_v_per_a[gain]:g} V/A", U_MONITOR)

    def _gain(self, c: int, gain: int) -> GTC.lib.UncertainReal:
        return 1.0 + self._input(f"gain_ratio[{c}, {FILE.photodiodes.gains_v_per_a[gain]:g} V/A]", U_GAIN)

    def _input(self, name: str, u: float) -> GTC.lib.UncertainReal:
        if name not in self.inputs:
            self.inputs[name] = GTC.ureal(0.0, float(u), label=name)
        return self.inputs[name]


# Which rows share what.


def executed(
    number: int, kind: str, sample: str, pose: tuple[float, float, float, float] | None = None, session: int = 1
) -> ExecutedRow:
    return ExecutedRow(number, kind, sample, session, pose)


def test_the_history_counts_mountings_and_moves() -> None:
    one, two = (0.0, 30.0, 0.0, 0.0), (0.0, 30.0, 45.0, 0.0)
    rows = [
        executed(0, "mount", "etalon"),
        executed(1, "dark", "etalon"),
        executed(2, "measure", "etalon", one),
        executed(3, "measure", "etalon", two),
        executed(4, "mount", "paint"),
        executed(5, "dark", "paint"),
        executed(6, "measure", "paint", two),
        executed(7, "measure", "paint", (0.0, 30.0, 45.0 + 1e-9, 0.0)),
        executed(9, "mount", "paint", session=2),
        executed(8, "measure", "paint", two, session=2),
    ]
    names, table = history_of(rows)
    assert names[1:] == ["etalon#1", "paint#1", "paint#2"]
    by_row = {each[0]: each[1:] for each in table.tolist()}
    assert by_row[2] == [1, 1, 1, 1, 1]
    assert by_row[3] == [1, 1, 1, 2, 1]
    assert by_row[6] == by_row[7] == [2, 2, 2, 3, 2]
    assert by_row[8] == [3, 3, 3, 4, 3]
    assert [each[0] for each in table.tolist()] == sorted(by_row)


def test_repeatability_is_shared_from_one_move_to_the_next_as_in_the_twin() -> None:
    pose, other = (0.0, 30.0, 0.0, 0.0), (0.0, 30.0, 45.0, 0.0)
    poses = {5: pose, 7: other, 10: pose, 11: pose, 12: other}
    history = RowHistory(cast(Any, None))
    rows = [executed(4, "mount", "etalon"), *(executed(number, "measure", "paint", each) for number, each in poses.items())]
    history.__dict__["_read"] = history_of(rows)
    points = measured(np.ones(COUNT), np.full((COUNT, 2), np.nan), {}, replace(ALL_SETTINGS, history=history))
    groups = effects_of(points, replace(ALL_SETTINGS, history=history)).groups
    (group,) = [each for each in groups if each.name == "repeatability"]
    of_rows = [[group.inputs[k].name for k in each] for each in group.member[:: POLAR.size].T.tolist()]
    assert of_rows == [[f"repeatability@#{k}" for k in moves] for moves in ((6, 6, 7), (4, 4, 5))]
    assert points.components["repeatability"] == pytest.approx(np.full(COUNT, 2.0 * TABLE.repeatability**2))


def test_a_campaigns_points_sum_and_share_what_its_journal_states(tmp_path: Path) -> None:
    path = tmp_path / "finished.journal"
    path.write_bytes((Path(__file__).parents[3] / "golden" / "data" / "finished.journal").read_bytes())
    with Journal.open(path) as journal:
        reduction = evaluate_journal(journal).reduction
        (name, points), *_ = reduce_journal(journal).samples.items()
        good = points.where(points.good)
        effects = effects_of(good, reduction.settings)
        assert total(effects) == pytest.approx(good.u_bsdf**2, rel=1e-12)
        assert {"pose", "position", "photodiode_angle"} <= set(good.components)
        names = {each.name for each in effects.budget(0)}
        assert {f"sample_tilt_x@{name}#1", "etalon_tilt_x@etalon#1", "sigma_zero", "certificate[level]"} <= names
        assert any(each.startswith("position@beta#") for each in names)
        rows = {row.number: row for row in journal.executed_rows()}
        assert {rows[number].sample for number in good.row.tolist()} == {name}
        assert {rows[number].sample for number in good.etalon_row.tolist()} == {"etalon"}
        poses = np.array([rows[number].pose for number in good.row.tolist()])
        assert np.array_equal(poses[:, 1], good.sigma_deg)
        # The monitor: its drift over the time between the two rows, its linearity over the change of the light.
        committed = {each.row.number: each.data for each in journal.rows("measure")}
        pairs = list(zip(good.row.tolist(), good.etalon_row.tolist(), strict=True))
        hours = [(committed[one].started_s - committed[other].started_s) / 3600.0 for one, other in pairs]
        light = {number: np.mean([each.monitor_a for each in data.readings]) for number, data in committed.items()}
        decades = [np.log10(light[one] / light[other]) for one, other in pairs]
        table: Any = reduction.rig.file.uncertainty
        for name, u, change in (
            ("monitor_drift", table.monitor_drift_per_hour, hours),
            ("monitor_linearity", table.monitor_linearity_per_decade, decades),
        ):
            assert np.sqrt(good.components[name]) == pytest.approx(
                u * np.abs(np.array(change) * good.bsdf), rel=1e-9, abs=1e-15
            )
            assert name in names


# Integrals.


def test_a_reflectance_has_the_covariance_of_its_points_in_whatever_parts() -> None:
    rng = np.random.default_rng(5)
    points = measured(np.full(COUNT, 0.3), rng.normal(0.0, 0.1, (COUNT, 2)), relative_of(np.full(COUNT, 0.004)))
    every = np.arange(COUNT)
    rule = quadrature(points, "isotropic")
    variance = rule.weight @ effects_of(points, SETTINGS).covariance(every, every) @ rule.weight

    def u(*at_once: int) -> float:
        return float(np.sqrt(sum(each.u**2 for each in components_of_sum(points, rule.weight, SETTINGS, *at_once))))

    assert rule.weight @ points.bsdf == pytest.approx(0.3 * np.pi, rel=1e-9)
    assert u() == pytest.approx(np.sqrt(variance), rel=1e-12)
    assert u() > CERTIFICATE * 0.3 * np.pi
    assert u(7) == pytest.approx(np.sqrt(variance), rel=1e-12)
    # Three lines, up to 130 deg apart, are no half sphere.
    assert not rule.hemisphere
