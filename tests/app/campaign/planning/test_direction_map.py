"""The directions of a plan for its picture: each direction of the grids is measured, blocked or omitted, and each but once."""

import numpy as np
import pytest

from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.direction_map import DirectionMap, direction_maps
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import read_rig
from tests.conftest import RIG, SMALL

WHOLE = SMALL.replace("[180]", "{ start = 0, stop = 330, step = 30 }").replace("shift_deg = [0, 1]", "shift_deg = [0]")


def plan_of(text: str) -> NewPlan:
    return make_plan(parse_schedule(text, "a.toml"), read_rig(RIG))


def every(found: DirectionMap) -> list[tuple[float, float]]:
    parts = (found.measured, found.blocked, found.omitted, found.checks, found.images)
    return [tuple(each) for each in np.round(np.concatenate(parts), 6).tolist()]


@pytest.mark.parametrize("symmetry", ["isotropic", "anisotropic"])
def test_a_whole_hemisphere_is_measured_or_follows_by_symmetry(symmetry: str) -> None:
    plan = plan_of(f'{WHOLE}symmetry = "{symmetry}"\n')
    (found,) = direction_maps(plan)
    angles = plan.rig.file.photodiodes.upper_deg
    expected = {
        (abs(polar), azimuth % 360.0 if polar else 0.0) for polar in angles for azimuth in np.arange(0.0, 360.0, 30.0).tolist()
    }
    assert set(every(found)) == expected
    assert len(every(found)) == len(expected)
    check = check_plan(plan)
    assert len(found.measured) + len(found.blocked) == check.directions
    assert len(found.blocked) == check.shadowed
    assert (len(found.omitted) > 0) == (symmetry == "isotropic")
    assert not len(found.images)
    if symmetry == "isotropic":
        assert (found.omitted[:, 1] > 180.0).all() or (found.omitted[:, 1] < 180.0).all()


def test_half_of_a_hemisphere_has_its_images_and_the_checks_of_them() -> None:
    text = WHOLE.replace("stop = 330", "stop = 180").replace("start = 0,", "start = 90,")
    (found,) = direction_maps(plan_of(f'{text}symmetry = "isotropic"\n[symmetry_check]\npoints = 2\n'))
    assert not len(found.omitted)
    assert len(found.checks)
    off_plane = found.measured[np.abs(np.sin(np.radians(found.measured[:, 1]))) > 1e-6]
    assert set(map(tuple, np.round(found.images, 6).tolist())) == {
        (round(polar, 6), round(-azimuth % 360.0, 6)) for polar, azimuth in off_plane.tolist()
    }
    assert set(map(tuple, np.round(found.checks, 6).tolist())) <= set(map(tuple, np.round(found.images, 6).tolist()))
