"""The scan of the open beam in a plan: its poses, the etalon's pose that belongs to it, and refusals."""

import numpy as np
import pytest

from goniotwin.app.campaign.geometry.open_beam import beam_scans
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import parse_rig, read_rig
from goniotwin.twin.optics import arc_direction, light_direction, specular_direction
from tests.conftest import RIG

HEAD = """
name = "scan"
samples = ["gaussian-5"]
etalon = "etalon"
gains_v_per_a = "automatic"
beta_deg = [0, 90]
wavelength_nm = [450, 550, 650]
"""
WIDE = RIG.read_text(encoding="utf-8").replace("lower_deg = -0.5\nupper_deg = 5.5", "lower_deg = -2.0\nupper_deg = 5.5")
NARROW = RIG.read_text(encoding="utf-8").replace("lower_deg = -0.5\nupper_deg = 5.5", "lower_deg = -0.5\nupper_deg = 1.5")


def planned(text: str, rig: str = "") -> NewPlan:
    return make_plan(parse_schedule(HEAD + text, "scan.toml"), parse_rig(rig, RIG.parent, "rig.toml") if rig else read_rig(RIG))


def refused(text: str, rig: str = "") -> str:
    with pytest.raises(UserError) as caught:
        planned(text, rig)
    message = str(caught.value)
    assert message.startswith("scan.toml: ")
    assert "\n" not in message
    return message


def rows_of(plan: NewPlan, sample: str) -> list[Row]:
    return [row for row in plan.rows if row.kind == "measure" and row.sample == sample]


def test_the_scan_is_thirteen_by_thirteen_directions_about_the_beam() -> None:
    plan = planned("sigma_deg = [40]\n[open_beam]\n", WIDE)
    rows = rows_of(plan, NO_SAMPLE)
    assert all(row.identity.startswith("nothing/open beam/") for row in rows)
    scan = [row for row in rows if row.wavelength_nm == 550.0]
    assert (len(scan), len(rows), len({row.pose for row in scan})) == (169, 171, 169)
    (planned_scan,) = beam_scans(plan.schedule.file, plan.rig.file)
    # From the rows alone: photodiode 8 is at 40 deg; the light goes against its own direction, into that of a mirror.
    poses = np.array(sorted(row.pose for row in scan if row.pose is not None))
    assert set(poses[:, 1]) == {140.0}
    beam = -light_direction(140.0)
    assert beam == pytest.approx(specular_direction(40.0), abs=1e-12)
    seen = arc_direction(40.0 + poses[:, 3], poses[:, 2])
    middle = [row.pose for row in rows if row.wavelength_nm != 550.0]
    assert middle == [(0.0, 140.0, 180.0, 0.0)] * 2
    apart = np.degrees(np.arccos(np.clip(seen @ seen.T, -1.0, 1.0)))
    nearest = np.sort(apart, axis=1)[:, 1]
    side = 0.2 * (1.0 + 1.0 / 12.0**2) ** 0.5
    assert nearest.min() > 0.97 * side
    assert nearest.max() < 1.001 * side
    assert np.degrees(np.arccos(np.clip(seen @ beam, -1.0, 1.0))).max() == pytest.approx(6.0 * side * 2**0.5, rel=0.02)
    # Turned: no two neighbours have the same shift or beta, and only the corners of two lines meet.
    assert all(len(set(poses[:, axis])) == 13 * 12 + 1 for axis in (2, 3))
    # The solid angles of all poses fill the square.
    square = np.radians(13 * side) ** 2
    assert planned_scan.solid_angle_sr.sum() == pytest.approx(square, rel=1e-3)
    assert len(planned_scan.edge) == 4 * 12
    assert planned_scan.offset_deg[planned_scan.middle] == pytest.approx([0.0, 0.0])


def test_the_beam_is_scanned_at_some_of_the_sigmas_alone() -> None:
    plan = planned("sigma_deg = [17, 42, 67]\n[open_beam]\nsigma_deg = [42]\n")
    assert [each.at_deg for each in beam_scans(plan.schedule.file, plan.rig.file)] == [42.0]
    assert "open_beam.sigma_deg: 40 is not in sigma_deg" in refused("sigma_deg = [42]\n[open_beam]\nsigma_deg = [40]\n")


def test_the_slopes_of_a_scan_are_those_of_what_it_sees() -> None:
    """Along the arc and across it, of a Gaussian as narrow as the beam, 0.24 deg, that is not in the middle."""
    (scan,) = beam_scans(planned("sigma_deg = [42]\n[open_beam]\n").schedule.file, read_rig(RIG).file)
    x, y = (scan.offset_deg - [0.07, -0.04]).T
    seen = np.exp(-(x**2) / (2.0 * 0.24**2) - y**2 / (2.0 * 0.3**2))
    expected = np.stack([-x / 0.24**2 * seen, -y / 0.3**2 * seen], axis=1)
    found = scan.slopes(seen)
    assert np.abs(found - expected).max() < 0.1 * np.abs(expected).max()
    assert np.sum(found**2, axis=0) == pytest.approx(np.sum(expected**2, axis=0), rel=0.1)


def test_the_etalon_is_measured_on_the_same_photodiode_at_every_wavelength() -> None:
    """The grid has neither the plane of incidence nor, where the shift cannot scan about sigma, that sigma."""
    plan = planned("sigma_deg = [17, 40]\n[open_beam]\n")
    found = {(row.pose, row.wavelength_nm) for row in rows_of(plan, "etalon")}
    scans = beam_scans(plan.schedule.file, plan.rig.file)
    assert [(each.sigma_deg, each.at_deg, each.photodiode) for each in scans] == [(17.0, 17.0, 3), (40.0, 40.8, 8)]
    for each in scans:
        gamma, sigma, beta, shift = each.etalon_pose
        assert (gamma, sigma, beta) == (0.0, each.at_deg, 180.0)
        assert 5.0 * each.photodiode + shift == pytest.approx(each.at_deg, abs=1e-9)
        assert {((gamma, sigma, beta, shift), each) for each in (450.0, 550.0, 650.0)} <= found
        assert each.poses[:, 3].min() >= -0.5
        assert {row.pose for row in rows_of(plan, NO_SAMPLE)} >= {tuple(pose) for pose in each.poses.tolist()}
    assert not any(row.pose is not None and row.pose[2] == 180.0 for row in rows_of(plan, "gaussian-5"))
    (note,) = [each for each in check_plan(plan).warnings if "open beam" in each]
    assert "40.8 in place of 40 deg" in note


def test_transmitted_light_and_the_back_are_scanned_on_the_arc_that_is_scaled() -> None:
    head = "sigma_deg = [32]\n[open_beam]\nposes = 9\nstep_deg = 0.3\n"
    for text, arc, etalon, beam in (
        ("", "upper", 32.0, 148.0),
        ('light = "transmitted"\n', "lower", 148.0, 32.0),
        ('side = "back"\n', "lower", 148.0, 32.0),
    ):
        plan = planned(text + head)
        (scan,) = beam_scans(plan.schedule.file, plan.rig.file)
        assert (scan.arc, scan.etalon_pose[1], set(scan.poses[:, 1])) == (arc, etalon, {beam})
        assert scan.photodiode == 6 + 18 * (arc == "lower")
        straight = -light_direction(beam)
        middle = arc_direction(scan.polar_deg, scan.azimuth_deg, scan.arc == "lower")[scan.middle]
        assert middle == pytest.approx(straight, abs=1e-12)
    both = planned('light = "both"\nside = "both"\n' + head)
    assert len(beam_scans(both.schedule.file, both.rig.file)) == 2


def test_below_ten_degrees_there_is_no_scan_and_check_reports_it() -> None:
    plan = planned("sigma_deg = [0, 9, 32]\n[open_beam]\nwavelength_nm = 650\n")
    assert [each.sigma_deg for each in beam_scans(plan.schedule.file, plan.rig.file)] == [32.0]
    assert sum(row.wavelength_nm == 650.0 for row in rows_of(plan, NO_SAMPLE)) == 169
    assert any("not scanned at sigma 0, 9 deg: below 10 deg" in each for each in check_plan(plan).warnings)
    assert "no sigma_deg is 10 deg or more" in refused("sigma_deg = [0, 9]\n[open_beam]\n")


@pytest.mark.parametrize(
    ("table", "rig", "reason"),
    [
        ("poses = 12\n", "", "open_beam.poses: 12 is even, so that there is no middle pose; write 13"),
        ("poses = 3\n", "", "open_beam.poses"),
        ("step_deg = 0\n", "", "open_beam.step_deg"),
        ("steps = 3\n", "", "there is no such key; did you mean"),
        ("wavelength_nm = 500\n", "", "open_beam.wavelength_nm: 500 is not in wavelength_nm"),
        ("", NARROW, "a scan of 13 poses 0.2 deg apart needs 2.6 deg of the shift, and axes.shift has 2"),
    ],
)
def test_refusals_name_the_key(table: str, rig: str, reason: str) -> None:
    assert reason in refused(f"sigma_deg = [40]\n[open_beam]\n{table}", rig)


def test_the_limits_of_an_axis_and_a_gap_between_photodiodes_are_refused() -> None:
    assert "the scan needs beta" in refused(
        "sigma_deg = [12]\n[open_beam]\nposes = 51\nstep_deg = 0.1\n",
        WIDE.replace("lower_deg = -5.0\nupper_deg = 360.0", "lower_deg = -5.0\nupper_deg = 185.0"),
    )
    sparse = NARROW.replace("upper_deg = [0, 5,", "upper_deg = [0, 1,", 1).replace("15, 20, 25,", "15, 16, 17,", 1)
    table = "[open_beam]\nposes = 7\nstep_deg = 0.2\n"
    assert "at sigma 22 deg no photodiode of the upper arc reaches the beam" in refused(f"sigma_deg = [22]\n{table}", sparse)
    assert "open_beam: should be" in refused('sigma_deg = [40]\nopen_beam = "yes"\n')


def test_two_sigmas_that_the_shift_brings_to_one_scan_have_it_once() -> None:
    """40 and 40.5 would both be scanned at 40.8: an identity of a row is there once."""
    plan = planned("sigma_deg = [40, 40.5, 41]\n[open_beam]\n")
    assert [(each.sigma_deg, each.at_deg) for each in beam_scans(plan.schedule.file, plan.rig.file)] == [
        (40.5, 40.8),
        (41.0, 41.0),
    ]
    identities = [row.identity for row in plan.rows]
    assert len(set(identities)) == len(identities)
    assert any("sigma 40 deg has no scan of the open beam of its own" in each for each in check_plan(plan).warnings)


def test_more_poses_than_a_campaign_may_have_are_refused_before_they_are_built() -> None:
    many = "sigma_deg = { start = 20, stop = 60, step = 0.01 }\n[open_beam]\nposes = 17\n"
    assert "open_beam: 4001 scans x 17 x 17 poses are more than 1000000 rows" in refused(many)


def test_one_pose_as_before_stays_one_pose() -> None:
    """`open_beam = true` looks with the far arc, at sigma itself, at all wavelengths."""
    rows = rows_of(planned("sigma_deg = [32]\nopen_beam = true\n"), NO_SAMPLE)
    assert sorted((row.pose, row.wavelength_nm) for row in rows) == [
        ((0.0, 32.0, 180.0, 2.0), each) for each in (450.0, 550.0, 650.0)
    ]
    assert rows_of(planned("sigma_deg = [32]\nopen_beam = false\n"), NO_SAMPLE) == []
