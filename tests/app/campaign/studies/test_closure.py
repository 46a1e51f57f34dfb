"""The scale by the open beam and that by the etalon: the sum over a scan, its field of view, its u, in closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.reduction.settings import reduction_settings
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.closure import (
    ClosureReport,
    JointClosure,
    closure_text,
    compare,
    is_own_of_a_scan,
    moment_deg2,
    pose_effects,
    pose_inputs,
    scanned_beam,
    scanned_crosstalk,
    scanned_field,
    signed,
)
from goniotwin.app.campaign.studies.evaluation import scan_settings
from goniotwin.app.rig.inputs import element_deviations
from goniotwin.twin.optics import Deviation, Instrument
from tests.app.campaign.studies.closure_bench import (
    CERTIFICATE,
    FILE,
    as_read,
    beam_signal,
    etalon_signal,
    lit_everywhere,
    plain_ratio,
    scans_of,
)
from tests.conftest import SMALL


@pytest.mark.parametrize("sigma_deg", [22.0, 62.0])
def test_the_sum_over_an_ideal_beam_is_its_flux_in_closed_form(sigma_deg: float) -> None:
    """Discs so wide that the cone alone limits: each ray is then seen over the solid angle of the cone, wherever it is.

    The flux of the beam over the pupil's radiance: area of the hole, its cosine, the projected solid angle of a disc
    in the direction of its axis, pi R^2 / (R^2 + D^2), times three mirrors.
    """
    instrument = Instrument(detector_diameter_mm=20.0, field_deg=1.0, obstruction=False)
    (scan,) = scans_of(f"[{sigma_deg}]", "poses = 13\nstep_deg = 0.2\n")
    beam = scanned_beam(scan, 550.0, beam_signal(scan, instrument))
    pupil, away, hole = 5.0, 800.0, 5.0
    etendue_mm2sr = hole**2 * math.cos(math.radians(sigma_deg)) * math.pi * pupil**2 / (pupil**2 + away**2)
    cone_sr = 2.0 * math.pi * (1.0 - math.cos(math.radians(0.5)))
    flux = 1e-6 * etendue_mm2sr * instrument.mirror_reflectance**3  # type: ignore[operator]
    assert beam.total == pytest.approx(flux * cone_sr, rel=1e-3)
    assert beam.edge == 0.0
    # Of a uniform disc of radius r the second moment is r^2 / 4 along each axis: pupil and cone. Of the hole of side a, seen
    # from the pupil, a^2 / 12, foreshortened along the arc.
    discs = (math.degrees(math.atan(pupil / away)) ** 2 + 0.5**2) / 4.0
    square = math.degrees(hole / away) ** 2 / 12.0
    along = discs + square * math.cos(math.radians(sigma_deg)) ** 2
    assert np.diag(beam.moment_deg2) == pytest.approx([along, discs + square], rel=3e-3)


def test_the_width_of_the_instrument_function_is_that_of_the_design() -> None:
    """Prototype: 0.237 deg for a field of 0.5 deg, 0.397 deg for 1.5 deg, along the arc at 40 deg."""
    (scan,) = scans_of("[41]")
    for field_deg, expected in ((0.5, 0.237), (1.5, 0.397)):
        beam = scanned_beam(scan, 550.0, beam_signal(scan, Instrument(field_deg=field_deg)))
        assert math.sqrt(beam.moment_deg2[0, 0]) == pytest.approx(expected, abs=3e-3)
        assert beam.centroid_deg == pytest.approx([0.0, 0.0], abs=2e-3)


@pytest.mark.parametrize("sigma_deg", [22.0, 62.0])
def test_the_effects_of_the_pose_are_those_of_the_twin(sigma_deg: float) -> None:
    """Finite differences of the twin's own geometry, with a field so wide that the steps of the scan do not show."""
    (scan,) = scans_of(f"[{sigma_deg}]")
    known = {each.input.name: (each.of_value, each.of_centroid) for each in pose_inputs(scan, FILE)}
    step = 0.1

    def difference(deviations: dict[str, Deviation], mounted: bool = True, **off: float) -> tuple[float, float]:
        found = []
        for sign in (1.0, -1.0):
            turned = {name: Deviation(*(sign * way for way in vars(each).values())) for name, each in deviations.items()}
            # The slit's image would leave the hole at this step of mirror 1, far beyond its uncertainty.
            instrument = Instrument(field_deg=1.5, deviations=turned, lit_everywhere=True)
            angles = {name: sign * angle for name, angle in off.items()}
            beam = scanned_beam(scan, 550.0, beam_signal(scan, instrument, **angles))
            etalon = etalon_signal(scan, instrument if mounted else Instrument(field_deg=1.5), **angles)
            found.append((plain_ratio(scan, beam, etalon), float(beam.centroid_deg[0])))
        (one, of_one), (other, of_other) = found
        return (one - other) / (2.0 * step), (of_one - of_other) / (2.0 * step)

    turn = Deviation(ry_deg=step)
    cases: dict[str, tuple[float, float]] = {
        "mirror_1_tilt_y": difference({"mirror_1": turn}),
        "mirror_3_tilt_y": difference({"mirror_3": turn}),
        "sigma_zero": difference({}, sigma_deg=step),
        "shift_zero": difference({}, along_deg=step),
        "arc_tilt_y": difference({"arc": turn}),
        "sample_tilt_y@nothing": difference({"sample": turn}, mounted=False),
    }
    for name in ("beam_tilt_x", "beam_tilt_z", "illumination_shift_z"):
        cases[name] = difference(element_deviations({name: step}, Instrument().pupil_distance_mm))
    # Of the largest: 2 tan(sigma) a radian, or cot(sigma).
    scale = math.radians(2.0 * math.tan(math.radians(sigma_deg)) + 1.0 / math.tan(math.radians(sigma_deg)))
    for name, (of_value, of_centroid) in cases.items():
        assert known[name][1] == pytest.approx(of_centroid, abs=0.02), name
        assert known[name][0] == pytest.approx(of_value, abs=0.06 * scale), name
    assert difference({}, across_deg=step)[0] == pytest.approx(0.0, abs=0.02 * scale)


def test_the_centroid_reduces_the_uncertainty_of_the_pose_as_far_as_it_can() -> None:
    """The components after the correction are those of any other factor at least: it is the best linear one."""
    for scan in scans_of("[17, 41, 67, 82]"):
        inputs = pose_inputs(scan, FILE)
        components, _ = pose_effects(scan, FILE, 0.0)
        best = math.fsum(each.u**2 for each in components)
        _, of_one = pose_effects(scan, FILE, 1.0)
        for factor in (0.0, 0.5 * of_one, -0.9 * of_one, -1.1 * of_one):
            left = math.fsum(((each.of_value - factor * each.of_centroid) * each.input.u) ** 2 for each in inputs)
            assert best < left
        assert math.hypot(*(each.of_centroid * each.input.u for each in inputs)) == pytest.approx(0.075, abs=0.002)


@pytest.mark.parametrize("field_deg", [0.5, 1.5])
def test_the_moments_of_a_scan_are_those_of_the_field_of_view(field_deg: float) -> None:
    """Along the arc and across it, from 17 to 81 deg: the nodes of the virtual rig are another way to the same covariance."""
    for scan in scans_of("[17, 42, 67, 81]"):
        seen = scanned_beam(scan, 550.0, beam_signal(scan, Instrument(field_deg=field_deg))).moment_deg2
        known = moment_deg2(scan, Instrument(field_deg=field_deg))
        assert np.diag(seen) == pytest.approx(np.diag(known), rel=0.03)
        assert np.trace(seen) == pytest.approx(np.trace(known), rel=0.02)
        assert abs(seen[0, 1]) < 0.01 * seen[0, 0]


@pytest.mark.parametrize(("field_deg", "applied"), [(0.2, True), (0.5, False), (0.55, False), (1.5, True)])
def test_a_field_of_view_that_is_not_that_of_the_rig_file_is_found(field_deg: float, applied: bool) -> None:
    beams = [scanned_beam(scan, 550.0, beam_signal(scan, Instrument(field_deg=field_deg))) for scan in scans_of("[17, 42, 67]")]
    found = scanned_field(beams, FILE)
    assert found is not None
    assert found.applied is applied
    if applied:
        assert found.field_deg == pytest.approx(field_deg, abs=0.03)
        assert f"its field of view is {found.field_deg:.2f} deg, not 0.5" in str(found)
    else:
        assert str(found).endswith("they agree")
    assert ClosureReport((), (), (), field=found).alarms == ([str(found)] if applied else [])


@pytest.mark.parametrize(("share", "found"), [(3e-5, False), (2e-4, True)])
def test_cross_talk_in_the_open_beam_that_is_not_stated_is_a_finding(share: float, found: bool) -> None:
    """Channels of the same module only: beside photodiode 8 those are 9 to 15."""
    (scan,) = scans_of("[42]")
    assert scan.photodiode == 8
    crosstalk, u = np.full(FILE.photodiodes.count, np.nan), np.full(FILE.photodiodes.count, 5e-6)
    crosstalk[7], crosstalk[9] = 1e-2, share
    beam = scanned_beam(scan, 550.0, beam_signal(scan, Instrument()), crosstalk, u)
    text = scanned_crosstalk([beam], FILE)
    assert bool(text) is found
    report = ClosureReport((), (beam,), (), crosstalk=text)
    assert report.alarms == ([text] if found else [])
    if found:
        assert text.startswith("photodiode 9 has 2.0e-04 (u 5e-06) of the volts of photodiode 8")
        assert text in closure_text(report)
    unknown = replace(beam, u_crosstalk=np.full(FILE.photodiodes.count, 1e-4))
    assert scanned_crosstalk([unknown], FILE) == ""


def test_a_difference_of_nothing_has_no_sign() -> None:
    assert [signed(each) for each in (-0.04, 0.04, 0.06, -1.25)] == ["0.0", "0.0", "+0.1", "-1.2"]
    (scan,) = scans_of("[42]")
    signal, etalon = beam_signal(scan, Instrument()), etalon_signal(scan, Instrument())
    each = compare(scanned_beam(scan, 550.0, signal), 550.0, signal, None, etalon, 1.0, (CERTIFICATE,), FILE)
    report = ClosureReport((replace(each, certified=each.absolute * (1.0 + 1e-6)),), (each.beam,), ())
    assert report.verdict.endswith("the largest difference is 0.0 u")
    assert "-0.0  agree" not in closure_text(report)


def test_a_field_of_view_that_nothing_explains_is_not_applied() -> None:
    """A beam narrower than the pupil alone makes it."""
    (scan,) = scans_of("[42]")
    beam = scanned_beam(scan, 550.0, beam_signal(scan, Instrument()))
    narrow = replace(beam, moment_deg2=0.2 * beam.moment_deg2)
    found = scanned_field([narrow], FILE)
    assert found is not None
    assert not found.applied
    assert "no field of view explains it" in str(found)
    assert scanned_field([replace(beam, edge=0.1)], FILE) is None


def test_scans_together_have_the_uncertainty_of_what_they_share() -> None:
    """Holes, linearity and certificate are common, stops and readings are not."""
    closures = []
    for scan in scans_of("[17, 42, 67]"):
        signal, etalon = beam_signal(scan, Instrument()), etalon_signal(scan, Instrument())
        beam = scanned_beam(scan, 550.0, signal)
        closures.append(compare(beam, 550.0, signal, None, etalon, 1.0, (CERTIFICATE,), FILE))
    joint, lit = JointClosure.of(closures), JointClosure.of([lit_everywhere(each) for each in closures])
    assert joint is not None
    assert lit is not None
    assert 0.007 < lit.u < min(lit_everywhere(each).u for each in closures)
    # What a dark corner does at a small sigma has the other sign at a large one.
    assert lit.u < joint.u < 0.7 * min(each.u for each in (closures[0], closures[2]))
    assert JointClosure.of(closures[:1]) is None
    same = JointClosure.of([closures[0], closures[0]])
    assert same is not None
    own = [each.u for each in closures[0].components if is_own_of_a_scan(each)]
    assert same.u == pytest.approx(math.sqrt(closures[0].u ** 2 - 0.5 * math.hypot(*own) ** 2), rel=1e-6)
    low = ClosureReport(tuple(replace(each, certified=1.0 / (1.0 - 5.0 * joint.u)) for each in closures), (), ())
    assert low.contradicts_etalon
    assert "all scans together (sigma 17, 42, 67 deg)" in low.alarms[-1]
    only = [replace(each, certified=each.absolute / (1.0 - 4.3 * joint.u)) for each in closures]
    together = ClosureReport(tuple(only), (), ())
    assert together.apart == []
    assert together.contradicts_etalon
    assert together.verdict.endswith("they do NOT agree")
    assert {each.word for each in together.closures} == {"differ"}
    settings = reduction_settings(FILE, parse_schedule(SMALL, "small.toml").file, None, "")
    assert scan_settings(settings, together).doubted
    assert not scan_settings(settings, ClosureReport(tuple(closures), (), ())).doubted


def test_a_beam_that_is_not_all_within_the_scan_is_found() -> None:
    (scan,) = scans_of("[22]", "poses = 5\nstep_deg = 0.2\n")
    assert scanned_beam(scan, 550.0, beam_signal(scan, Instrument())).edge > 0.1


def test_a_value_at_another_wavelength_follows_the_middle_pose() -> None:
    """A lamp half as bright there, at etalon and beam alike: the same radiance factor; at the etalon alone: half."""
    (scan,) = scans_of("[41]")
    signal, etalon = beam_signal(scan, Instrument()), etalon_signal(scan, Instrument())
    beam = scanned_beam(scan, 550.0, signal)

    def absolute(of_beam: float, of_etalon: float) -> float:
        middle = as_read(of_beam * signal.value[[scan.middle]], 0, 998)
        return compare(beam, 450.0, signal, middle, etalon.scaled(of_etalon), 1.0, (CERTIFICATE,), FILE).absolute

    at_scan = compare(beam, 550.0, signal, None, etalon, 1.0, (CERTIFICATE,), FILE).absolute
    assert at_scan == pytest.approx(1.0, abs=3e-3)
    assert absolute(0.5, 0.5) == pytest.approx(at_scan, rel=1e-12)
    assert absolute(1.0, 0.5) == pytest.approx(0.5 * at_scan, rel=1e-12)


def test_noise_of_the_scan_adds_up_and_dark_readings_are_common() -> None:
    (scan,) = scans_of("[41]")
    exact, etalon = beam_signal(scan, Instrument()), etalon_signal(scan, Instrument())
    beam = scanned_beam(scan, 550.0, exact)
    sd = 1e-3 * float(exact.value.max())
    read = exact.with_own("noise", sd**2).with_grouped("dark", np.zeros(1, dtype=np.int64), np.full((exact.value.size, 1), sd))
    found = {each.name: each.u for each in compare(beam, 550.0, read, None, etalon, 1.0, (CERTIFICATE,), FILE).components}
    rng = np.random.default_rng(5)
    weight = scan.solid_angle_sr
    drawn = [float(weight @ (sd * rng.standard_normal(weight.size))) / beam.total for _ in range(2000)]
    assert found["scan_reading"] == pytest.approx(np.std(drawn), rel=0.06)
    assert found["dark"] == pytest.approx(float(weight.sum()) * sd / beam.total, rel=1e-9)
