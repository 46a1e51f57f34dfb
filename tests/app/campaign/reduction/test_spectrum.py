"""Wavelength and band: closed forms of spectra through a triangular band, and what too few wavelengths leave unknown."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial

from goniotwin.app.campaign.journal.block_sizes import BlockSizes
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.quantity import Quantity
from goniotwin.app.campaign.reduction.arc_geometry import ArcGeometry
from goniotwin.app.campaign.reduction.arc_rows import ArcRows
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.reduction.spectrum import (
    bandwidth_effects,
    correct_band,
    stencil,
    stray_effects,
    wavelength_effects,
)
from goniotwin.app.campaign.schedule.certificate import constant_certificate
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.file import EtalonTable
from goniotwin.app.rig.inputs import MONOCHROMATOR_STRAY, WAVELENGTH
from goniotwin.app.rig.light import LightTable
from goniotwin.arrays import Floats
from tests.app.campaign.reduction.long_journal import write_long_journal
from tests.app.campaign.reduction.made_points import made_points
from tests.app.campaign.reduction.test_point_blocks import bits
from tests.conftest import RIG, SMALL

BAND = 6.0
AT = np.arange(500.0, 561.0, 5.0)
ONE = np.ones((AT.size, 1))
RIG_FILE = read_rig(RIG).file
SETTINGS = ReductionSettings(
    RIG_FILE,
    ArcGeometry(RIG_FILE),
    parse_schedule(SMALL, "small.toml").file,
    constant_certificate(EtalonTable()),
    sample="gaussian-5",
)


def settings(band: float | None = BAND) -> ReductionSettings:
    return replace(SETTINGS, rig=replace(RIG_FILE, light=LightTable(bandwidth_nm=band)))


def arc_rows(values: Floats, etalon: Floats, at: Floats = AT, noise: float = 1e-6, shift: Floats | None = None) -> ArcRows:
    """Quotients (rows, photodiodes) of these relative noises, and signals of the etalon, at wavelengths (rows,)."""
    unknown, none = np.full(values.shape, np.nan), np.zeros(values.shape, dtype=bool)
    shifts = np.zeros(at.size) if shift is None else shift
    places = np.stack(np.broadcast_arrays(at, 0.0, 30.0, 180.0, shifts), axis=1)
    signal = Signal(etalon, {"noise": np.zeros(values.shape)}, gain=np.zeros(values.shape, dtype=np.int64))
    estimate = Quantity(values, {"noise": (noise * values) ** 2})
    return ArcRows(
        np.arange(at.size),
        places,
        none[:, 0],
        np.arange(at.size),
        (),
        np.zeros(at.size, dtype=np.int64),
        np.full((at.size, 1), 30.0),
        none,
        estimate,
        signal,
        signal,
        signal,
        signal,
        none[:, :1],
        unknown,
        unknown,
        unknown,
        unknown,
        {},
    )


def through_band(f: Polynomial, s: Polynomial, at: Floats, band: float) -> tuple[Floats, Floats]:
    """The quotient's mean over a triangle of this full width at half maximum, and the etalon's signal: Gaussian quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    x, w = np.concatenate([0.5 * band * (nodes - 1.0), 0.5 * band * (nodes + 1.0)]), np.tile(0.5 * band * weights, 2)
    t = w * (1.0 - np.abs(x) / band) / band
    here = at[:, None] + x
    signal = np.sum(t * s(here), axis=1)
    return (np.sum(t * s(here) * f(here), axis=1) / signal)[:, None], signal[:, None]


def polynomial(*coefficients: float) -> Polynomial:
    """In the wavelength over 30 nm from 530 nm on."""
    return Polynomial(coefficients, domain=[500.0, 560.0], window=[-1.0, 1.0])


@given(st.floats(-0.4, 0.4), st.floats(-0.5, 0.5))
def test_a_quadratic_spectrum_is_corrected_exactly(slope: float, bend: float) -> None:
    f = polynomial(1.0, slope, bend)
    measured, signal = through_band(f, polynomial(1.0), AT, BAND)
    corrected = correct_band(arc_rows(measured, signal), settings())
    assert corrected.estimate.value[:, 0] == pytest.approx(f(AT), rel=1e-11)
    # Of the measured values, which differ from the true ones by half the variance of the band times the second derivative.
    assert measured[:, 0] - f(AT) == pytest.approx(np.full(AT.size, BAND**2 / 12.0 * 2.0 * bend / 900.0), abs=1e-12)
    assert corrected.band_correction == pytest.approx(np.log(f(AT)[:, None] / measured), abs=1e-12)
    assert corrected.wavelength_slope[:, 0] == pytest.approx(f.deriv()(AT) / measured[:, 0], abs=1e-9)


def test_a_slope_in_a_light_with_a_slope_is_corrected_to_second_order() -> None:
    f, s = polynomial(1.0, 0.5), polynomial(1.0, 0.4)
    errors, effects = [], []
    for band in (3.0, 6.0, 12.0):
        measured, signal = through_band(f, s, AT, band)
        corrected = correct_band(arc_rows(measured, signal), settings(band))
        errors.append(float(np.max(np.abs(corrected.estimate.value[:, 0] / f(AT) - 1.0))))
        effects.append(float(np.max(np.abs(measured[:, 0] / f(AT) - 1.0))))
    assert effects[1] == pytest.approx(4.0 * effects[0], rel=0.01)  # s^2 f' S' / (f S)
    assert effects[1] > 1e-3
    assert errors[1] < 0.01 * effects[1]
    assert errors[2] > 12.0 * errors[1]  # what is left is of the fourth order


def test_without_a_stated_band_nothing_is_corrected_and_all_of_the_effect_is_in_u() -> None:
    measured, signal = through_band(polynomial(1.0, 0.3, 0.4), polynomial(1.0, 0.2), AT, 5.0)
    rows = arc_rows(measured, signal)
    assumed, stated = correct_band(rows, settings(None)), correct_band(rows, settings(5.0))
    assert assumed.estimate.value.tobytes() == measured.tobytes()
    assert assumed.band_correction == pytest.approx(stated.band_correction)
    points = replace(
        made_points(30.0, np.zeros(AT.size), np.zeros(AT.size), measured[:, 0], 0.0),
        band_correction=assumed.band_correction[:, 0],
        wavelength_slope=assumed.wavelength_slope[:, 0],
    )
    for band, share in ((None, 1.0), (5.0, 0.5)):
        effects = bandwidth_effects(points, settings(band))
        assert effects is not None
        assert np.sqrt(effects.variances()["bandwidth"]) == pytest.approx(share * np.abs(points.band_correction) * points.bsdf)
    effects = wavelength_effects(points, settings())
    assert effects is not None
    of_nm = RIG_FILE.uncertainty.u(WAVELENGTH) * np.abs(points.wavelength_slope) * points.bsdf
    assert np.sqrt(effects.variances()["wavelength"]) == pytest.approx(of_nm)
    # One error for all: the covariance of two values is the product of what each changes.
    covariance = effects.covariance(np.array([0]), np.array([9]))[0, 0]
    assert abs(covariance) == pytest.approx(of_nm[0] * of_nm[9])


@pytest.mark.parametrize(
    ("at", "slopes", "bands"),
    [
        ([550.0], 0, 0),
        ([550.0, 560.0], 2, 0),
        ([450.0, 550.0, 650.0], 0, 0),
        ([500.0, 540.0, 580.0], 3, 0),  # 80 nm: more than four bands
        ([500.0, 512.0, 524.0], 3, 3),
        ([500.0, 512.0, 525.0], 3, 0),
        ([500.0, 510.0, 520.0, 700.0], 3, 3),
    ],
)
def test_too_few_wavelengths_leave_slope_and_band_unknown(at: list[float], slopes: int, bands: int) -> None:
    here = np.array(at)
    corrected = correct_band(arc_rows(1.0 + 1e-3 * here[:, None], np.ones((here.size, 1)), here), settings())
    assert np.isfinite(corrected.wavelength_slope).sum() == slopes
    assert np.isfinite(corrected.band_correction).sum() == bands
    known = np.isfinite(corrected.wavelength_slope)
    assert corrected.wavelength_slope[known] == pytest.approx((1e-3 / (1.0 + 1e-3 * here[:, None]))[known], rel=1e-6)


def test_poses_are_apart_repeats_are_averaged_and_what_is_lost_in_noise_is_no_evidence() -> None:
    at = np.tile([540.0, 545.0, 550.0, 555.0], 3)
    shift = np.repeat([0.0, 1.0, 0.0], 4)  # the last four repeat the first
    values = np.stack([1.0 + 1e-3 * (at - 540.0), np.full(at.size, 1.0)], axis=1)
    values[4:8, 0] = 3.0
    values[:4, 0] *= 1.01
    values[8:, 0] *= 0.99
    values[5, 1] = 1e-9
    order = np.random.default_rng(3).permutation(at.size)
    rows = arc_rows(values[order], np.ones(values.shape), at[order], shift=shift[order])
    rows = replace(rows, estimate=Quantity(rows.estimate.value, {"noise": np.full(values.shape, 1e-12)}))
    found = correct_band(rows, settings())
    slope = np.empty(values.shape)
    slope[order] = found.wavelength_slope
    assert slope[:4, 0] == pytest.approx(1e-3 / (1.0 + 1e-3 * (at[:4] - 540.0)), rel=1e-9)
    assert slope[8:, 0] == pytest.approx(slope[:4, 0])
    assert slope[4:8, 0] == pytest.approx(np.zeros(4), abs=1e-12)
    assert np.isnan(slope[4:8, 1]).all()  # the second photodiode, where one wavelength has no light
    assert np.isfinite(np.delete(slope[:, 1], range(4, 8))).all()


@pytest.mark.parametrize("step", [3.0, 6.0, 10.0])
def test_the_noise_of_a_corrected_value_is_that_of_the_sum_that_it_is(step: float) -> None:
    at = np.linspace(500.0, 500.0 + 8.0 * step, 9)
    signal = np.exp(0.01 * (at - at[0]))[:, None]
    flat = np.ones((at.size, 1))
    change = 1e-6
    steps = [
        correct_band(arc_rows(flat + change * (np.arange(at.size) == k)[:, None], signal, at), settings()).estimate.value[:, 0]
        for k in range(at.size)
    ]
    jacobian = (np.stack(steps, axis=1) - 1.0) / change
    corrected = correct_band(arc_rows(flat, signal, at, noise=0.01), settings())
    assert corrected.estimate.components["noise"][:, 0] == pytest.approx(1e-4 * np.sum(jacobian**2, axis=1), rel=1e-4)


def kinked_through_band(at: Floats, kink_nm: float, band: float) -> tuple[Floats, Floats]:
    """A spectrum that rises by 4 % a nm to this wavelength and is flat from there on, through the band; and the spectrum."""
    x = np.linspace(-band, band, 4001)
    weight = (1.0 - np.abs(x) / band) / np.sum(1.0 - np.abs(x) / band)

    def f(nm: Floats) -> Floats:
        return np.asarray(1.0 + 0.04 * np.minimum(nm - kink_nm, 0.0))

    return (f(at[:, None] + x) @ weight)[:, None], f(at)[:, None]


@pytest.mark.parametrize(
    ("at", "band", "stated"),
    [
        (np.arange(510.0, 536.0, 2.5), 5.0, True),
        (np.arange(510.0, 536.0, 5.0), 5.0, True),
        (np.arange(510.0, 536.0, 5.0), 5.0, False),
        (np.arange(510.0, 541.0, 5.0), 10.0, True),
        (np.arange(510.0, 541.0, 10.0), 5.0, True),  # three wavelengths: what two lines would do
    ],
)
def test_a_kink_in_the_spectrum_is_in_u_and_flagged(at: Floats, band: float, stated: bool) -> None:
    kink = int(np.argmin(np.abs(at - 520.0)))
    measured, true = kinked_through_band(at, float(at[kink]), band)
    rows = correct_band(arc_rows(measured, np.ones(measured.shape), at, noise=1e-4), settings(band if stated else None))
    points = replace(
        made_points(30.0, np.zeros(at.size), np.zeros(at.size), rows.estimate.value[:, 0], 0.0),
        band_correction=rows.band_correction[:, 0],
    )
    effects = bandwidth_effects(points, settings(band if stated else None))
    assert effects is not None
    variance = effects.variances()["bandwidth"] + rows.estimate.components["band_shape"][:, 0]
    error = np.abs(rows.estimate.value - true)[kink, 0]
    assert error > 2.0 * np.sqrt(effects.variances()["bandwidth"])[kink]  # without it
    assert error < 1.5 * np.sqrt(variance)[kink]
    assert rows.flags["steep"][kink, 0]
    # Of both slopes the larger one: an error of the wavelength may be on either side.
    before = (measured[kink, 0] - measured[kink - 1, 0]) / (at[kink] - at[kink - 1])
    assert rows.wavelength_slope[kink, 0] == pytest.approx(before / measured[kink, 0])


@pytest.mark.parametrize("step", [2.5, 5.0, 10.0])
def test_neither_noise_nor_a_smooth_spectrum_has_a_shape(step: float) -> None:
    at = np.arange(500.0, 601.0, step)
    smooth = 1.0 + 0.5 * np.sin(at / 30.0)[:, None]
    noise = 1.0 + 0.02 * np.random.default_rng(3).standard_normal((at.size, 200))
    rows = correct_band(arc_rows(smooth * noise, np.ones(noise.shape), at, noise=0.02), settings(5.0))
    by_chance = [rows.flags.get("steep", np.zeros(1)), rows.estimate.components.get("band_shape", np.zeros(1)) > 0.0]
    assert max(float(np.mean(each)) for each in by_chance) < 0.02
    rows = correct_band(arc_rows(smooth, np.ones(smooth.shape), at), settings(5.0))
    assert "steep" not in rows.flags
    assert float(np.max(rows.estimate.components.get("band_shape", np.zeros(1)))) < 0.002**2


def test_a_large_effect_of_the_band_is_flagged() -> None:
    at = np.arange(500.0, 561.0, 5.0)
    measured, signal = through_band(polynomial(0.05, 0.0, 1.0), polynomial(1.0), at, 15.0)
    rows = correct_band(arc_rows(measured, signal, at), settings(15.0))
    large = np.abs(rows.band_correction[:, 0]) > 0.11
    assert large.any() or np.isnan(rows.band_correction).any()
    assert rows.flags["steep"][large | np.isnan(rows.band_correction[:, 0]), 0].all()
    assert not rows.flags["steep"][np.abs(rows.band_correction[:, 0]) < 0.09, 0].any()


def test_stray_light_changes_coloured_samples_and_no_grey_ones() -> None:
    at = np.array([450.0, 500.0, 550.0, 600.0])
    signal = np.array([1.0, 2.0, 4.0, 5.0])[:, None]
    grey, red = np.full(4, 0.2)[:, None], np.array([0.01, 0.01, 0.02, 0.6])[:, None]
    found = correct_band(arc_rows(np.hstack([grey, red]), np.hstack([signal, signal]), at), settings())
    assert found.stray_contrast[:, 0] == pytest.approx(np.zeros(4), abs=1e-12)
    share = 1e-4  # of the light at the wavelength, with the spectrum of all light
    disturbed = (red + share * np.sum(signal * red) / np.sum(signal)) / (1.0 + share)
    assert found.stray_contrast[:, 1] * share == pytest.approx((disturbed / red - 1.0)[:, 0], rel=1e-3)
    points = made_points(30.0, np.zeros(4), np.zeros(4), red[:, 0], 0.0)
    effects = stray_effects(replace(points, stray_contrast=found.stray_contrast[:, 1]), settings())
    alone = stray_effects(points, settings())
    assert effects is not None
    assert alone is not None
    u = RIG_FILE.uncertainty.u(MONOCHROMATOR_STRAY)
    assert effects.variances()["monochromator_stray"] == pytest.approx((u * found.stray_contrast[:, 1] * red[:, 0]) ** 2)
    assert alone.variances()["monochromator_stray"] == pytest.approx((u * red[:, 0]) ** 2)


def test_of_many_fine_wavelengths_some_are_left_out() -> None:
    at = tuple(np.arange(500.0, 520.0, 0.05).tolist())
    known = stencil(at, BAND)
    assert known.index.shape[1] < 12
    values = Polynomial([2.0, -0.3, 0.05])(np.array(at) - 510.0)
    assert np.sum(known.second * values[known.index], axis=1) == pytest.approx(np.full(len(at), 0.1), rel=1e-6)
    spread = np.array(at)[known.index]
    assert np.all(spread.max(axis=1) - spread.min(axis=1) <= 4.0 * BAND + 1e-6)


@pytest.mark.long
def test_a_journal_of_many_wavelengths_has_the_same_values_for_any_size_of_a_block(tmp_path: Path) -> None:
    write_long_journal(tmp_path / "a.journal", wavelengths=30, shifts=2)
    with Journal.open(tmp_path / "a.journal") as journal:
        whole = reduce_journal(journal)
    found = {}
    for size in (7, 10**9):
        with Journal.open(tmp_path / "a.journal", BlockSizes(block=size)) as journal:
            reduction = evaluate_journal(journal).reduction
            blocks = list(reduction.blocks("gaussian-5"))
            found[size] = BsdfPoints.join([reduction.finish("gaussian-5", block.points, None) for block in blocks])
            ranks = np.concatenate([block.rank for block in blocks])
            assert np.bincount(ranks).tolist() == [2] * 600  # two photodiodes on the lit side
            assert max(np.unique(block.rank).size for block in blocks) < 7 + 10 or size > 7
            assert bits(found[size].where(np.argsort(ranks, kind="stable"))) == bits(whole.samples["gaussian-5"])
    assert bits(found[7]) == bits(found[10**9])
    assert np.isfinite(whole.samples["gaussian-5"].band_correction).all()
