"""Stray light of frames and mirrors: compared with closed forms, and as a map for the fast estimator."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from goniotwin.twin.optics import (
    Instrument,
    Scatterer,
    arc_direction,
    forward_throughput,
    light_direction,
    regular,
    throughput,
)
from goniotwin.twin.optics.forward.stray_light import PATHS, stray_map, stray_throughput
from goniotwin.twin.optics.geometry.instrument import SampleFrames
from tests.sizes import parted
from tests.twin.optics.models import gaussian, lambertian

OPEN = Instrument(obstruction=False)
# One detector that receives all light above the sample.
ALL = replace(OPEN, detector_diameter_mm=1e7, field_deg=179.9)
WIDE = Instrument(detector_diameter_mm=12.0, field_deg=3.0)
UP = [0.0, 0.0, 1.0]
BLACK = SampleFrames(reflectance=0.0)


@pytest.mark.parametrize("sigma_deg", [0.0, 60.0])
def test_a_lit_frame_scatters_its_share_of_the_light_beside_the_hole(sigma_deg: float) -> None:
    frames = SampleFrames(reflectance=0.3, lit=1.5)
    result = forward_throughput(ALL, sigma_deg, [UP], lambertian(0.6), 400_000, seed=1, sample_frames=frames)
    # The irradiance of the larger square equals that of the hole: to 1e-3 over 7.5 mm at 800 mm, and at 60 deg to 1 %.
    expected = 0.3 * (1.5**2 - 1.0) / 0.6 * result.single_m2sr[0]
    assert result.stray_m2sr[0] == pytest.approx(expected, abs=5.0 * result.stray_error[0] + 1e-3 * expected)
    assert result.stray_error[0] < 5e-3 * expected


@parted(4)
def test_light_scattered_by_a_frame_is_the_same_with_any_sample_and_without(part: int) -> None:
    # Frames on the sample receive almost no light of it: the difference is noise, which is 4 % of a bin, and cancels.
    none = stray_map(Instrument(), 30.0, None, PATHS // part).values[0]
    for sample in (gaussian(15.0, reflectance=0.9), lambertian(0.03)):
        assert stray_map(Instrument(), 30.0, sample, PATHS // part).values[0] == pytest.approx(none, rel=5e-3)


def test_without_frames_mirrors_and_a_second_scattering_there_is_no_stray_light() -> None:
    result = forward_throughput(ALL, 30.0, [UP], lambertian(), 100_000, seed=1, sample_frames=BLACK)
    assert result.stray_m2sr[0] == 0.0
    assert result.stray_error[0] == 0.0
    assert np.array_equal(result.throughput_m2sr, result.single_m2sr)


def back_and_forth(share: float) -> float:
    """Light of a small spot between two parallel Lambertian planes that leaves by a small hole above it.

    Ratio of the light that has returned to the sample to the light that has not. `share` is the product of both reflectances.
    Each passage from plane to plane is a convolution with g^2 / (pi (r^2 + g^2)^2), whose Fourier transform is x K1(x), with x
    the wave number times the gap g.
    """
    x = np.linspace(1e-4, 30.0, 1000)
    # K1(x) = integral over t of exp(-x cosh t) cosh t, from 0
    t = np.linspace(0.0, 16.0, 801)
    k1 = np.array([np.trapezoid(np.exp(-each * np.cosh(t)) * np.cosh(t), t) for each in x])
    passage = x * k1
    once = np.trapezoid(passage * x, x)
    again = np.trapezoid(passage * x * share * passage**2 / (1.0 - share * passage**2), x)
    return float(again / once)


@parted(8)
def test_light_between_sample_and_frame_agrees_with_two_parallel_planes(part: int) -> None:
    # A hole of a tenth of the gap: the missing part of the frame is about 1 % of the returned light. Beside frames of this
    # width 1e-6 of the light escapes, compared with 3e-3 through the hole.
    narrow = replace(ALL, spot_side_mm=0.1, pupil_radius_mm=2.0)
    frames = SampleFrames(gap_mm=1.0, side_mm=4000.0, reflectance=0.8, lit=1.0)
    result = forward_throughput(
        narrow, 0.0, [UP], lambertian(0.9), 2_500_000 // part, seed=1, sample_frames=frames, max_interactions=200
    )
    expected = back_and_forth(0.8 * 0.9)
    ratio = result.stray_m2sr[0] / result.single_m2sr[0]
    error = ratio * math.hypot(result.stray_error[0] / result.stray_m2sr[0], result.single_error[0] / result.single_m2sr[0])
    assert error < 0.05 * math.sqrt(part) * expected
    assert ratio == pytest.approx(expected, abs=4.0 * error + 0.015 * expected)


def test_a_limit_of_interactions_omits_the_later_ones() -> None:
    frames = SampleFrames(gap_mm=2.0, reflectance=0.9)
    result = [
        forward_throughput(
            ALL, 30.0, [UP], lambertian(0.9), 200_000, seed=1, sample_frames=frames, max_interactions=most
        ).stray_m2sr[0]
        for most in (1, 2, 3, 20)
    ]
    # One interaction gives the light scattered by the frame itself; a second one, on the frame, returns light to the sample.
    assert 0.0 < result[0] == pytest.approx(result[1], rel=0.02)
    assert result[1] < 0.9 * result[2] < 0.9 * result[3]


def test_a_gap_moves_the_spot_and_shadows_oblique_light() -> None:
    def seen(gap_mm: float, polar_deg: float) -> float:
        frames = SampleFrames(gap_mm=gap_mm, reflectance=0.0)
        directions = arc_direction([polar_deg], [0.0])
        result = forward_throughput(
            replace(WIDE, obstruction=False), 0.0, directions, lambertian(), 2_000_000, seed=1, sample_frames=frames
        )
        return float(result.single_m2sr[0])

    assert seen(0.5, 0.0) == pytest.approx(seen(0.0, 0.0), rel=0.02)
    # At 60 deg the frame hides gap times tan(60 deg) of the 5 mm.
    assert seen(0.5, 60.0) / seen(0.0, 60.0) == pytest.approx(1.0 - 0.5 * math.tan(math.radians(60.0)) / 5.0, abs=0.02)


def test_mirror_2_returns_light_to_the_sample_unit() -> None:
    # Mirror 2 faces the sample: its light returns as from 566 mm, onto frame and sample, and is scattered up once more.
    towards = (light_direction(30.0) - np.array([0.0, 1.0, 0.0])) / math.sqrt(2.0)
    upwards = replace(ALL, obstruction=True, mirror_side_mm=60.0, field_deg=40.0)
    frames = SampleFrames(reflectance=1.0, lit=1.0, side_mm=200.0)
    result = forward_throughput(upwards, 30.0, [UP], lambertian(), 2_000_000, seed=1, sample_frames=frames)
    share = towards[2] / math.pi * 60.0**2 / (2.0 * 200.0**2) * 0.95
    # The mirror is 12 deg wide; light to it over mirror 3 returns beside the frames, to mirror 1.
    assert result.stray_m2sr[0] / result.single_m2sr[0] == pytest.approx(share, rel=0.1)


@parted(4)
@pytest.mark.parametrize(
    "scatterer",
    [
        pytest.param(lambertian(0.9), id="bright"),
        pytest.param(gaussian(5.0), id="lobe", marks=pytest.mark.long),
        pytest.param(lambertian(0.02), id="dark", marks=pytest.mark.long),
        pytest.param(regular(0.5), id="mirror"),
    ],
)
def test_the_fast_estimator_plus_the_stray_map_agrees_with_the_forward_one(scatterer: Scatterer, part: int) -> None:
    frames = SampleFrames(reflectance=0.5)
    polar, azimuth = np.meshgrid(np.arange(4.0, 88.0, 7.0), np.arange(3.0, 360.0, 24.0))
    directions = arc_direction(polar.ravel(), azimuth.ravel())
    result = forward_throughput(WIDE, 30.0, directions, scatterer, 10_000_000 // part, seed=1, sample_frames=frames)
    added = stray_throughput(
        stray_map(WIDE, 30.0, scatterer, 8 * PATHS // part, seed=2, sample_frames=frames), directions, WIDE
    )
    fast = throughput(WIDE, 30.0, directions, scatterer, rays=1 << 14)
    # Few hits give no estimate of the error; a map of 5 by 10 deg blurs by a few percent of the stray light.
    seen = result.standard_error < 0.2 * result.throughput_m2sr
    assert np.count_nonzero(seen) > 100
    error = np.hypot(result.standard_error, 0.02 * added + 1.2e-3 * fast)
    deviation = ((result.throughput_m2sr - fast - added) / error)[seen]
    assert np.mean(deviation**2) < 1.0 + 3.3 * math.sqrt(2.0 / deviation.size)
    assert np.max(np.abs(deviation)) < 5.5
    assert result.throughput_m2sr[seen].sum() == pytest.approx((fast + added)[seen].sum(), rel=0.01)
    assert result.stray_m2sr.sum() == pytest.approx(added.sum(), rel=0.02)


def test_a_map_is_refused_for_other_detectors() -> None:
    result = stray_map(WIDE, 30.0, lambertian(), 10_000)
    with pytest.raises(ValueError, match="the map is for arc, disc and field"):
        stray_throughput(result, [UP], Instrument())
    assert np.array_equal(result.values, stray_map(WIDE, 30.0, lambertian(), 10_000).values)
    with pytest.raises(ValueError, match="paths is 1"):
        stray_map(WIDE, 30.0, lambertian(), 1)


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (dict(gap_mm=-0.1), "gap_mm is -0.1"),
        (dict(gap_mm=1e-6), "gap_mm is 1e-06"),
        (dict(side_mm=0.0), "side_mm is 0.0"),
        (dict(reflectance=1.1), "reflectance is 1.1"),
        (dict(reflectance=math.nan), "reflectance is nan"),
        (dict(lit=0.9), "lit is 0.9"),
    ],
)
def test_invalid_frames_are_refused(change: dict[str, Any], wrong: str) -> None:
    with pytest.raises(ValueError, match=wrong):
        SampleFrames(**change)
