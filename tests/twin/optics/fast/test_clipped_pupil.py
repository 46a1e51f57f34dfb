"""What a mirror leaves of the exit pupil: closed forms, and counted rays."""

import math

import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, Instrument
from goniotwin.twin.optics.fast.clipped_pupil import CORNERS, fill_disc_moments, left_polygon
from goniotwin.twin.optics.fast.detector_block import CLIPPED
from goniotwin.twin.optics.geometry.scene import scene_at
from goniotwin.twin.optics.illumination.slit_image import cut_polygon
from tests.twin.optics.fast.plain_rays import PlainScene

AXIS = np.linspace(-1.0, 1.0, 1001)
DISC = np.stack([each[AXIS[:, None] ** 2 + AXIS**2 < 1.0] for each in np.meshgrid(AXIS, AXIS)], axis=1)
SQUARE = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


def counted(points: Floats) -> Floats:
    """Moments of those points of DISC, over their number of all."""
    a, b = points.T
    return np.array([each.sum() for each in (a * 0.0 + 1.0, a, b, a * a, a * b, b * b)]) / len(DISC)


@pytest.mark.parametrize(
    "lines",
    [[], [(0.3, 1.0, 0.0)], [(0.2, -1.0, 0.7), (0.4, 0.1, 1.0)], [(0.1, 1.0, 1.0), (0.1, -1.0, -1.0)], [(-2.0, 1.0, 0.0)]],
)
def test_moments_of_a_cut_disc_are_those_of_counted_points(lines: list[tuple[float, float, float]]) -> None:
    points, room, result, left = np.empty((CORNERS, 2)), np.empty((CORNERS, 2)), np.empty(CLIPPED), DISC
    points[:4], count = SQUARE, 4
    for a, b, c in lines:
        count = cut_polygon(points, count, room, a, b, c)
        left = left[a + left @ [b, c] >= 0.0]
    fill_disc_moments(points, count, result)
    np.testing.assert_allclose(result, counted(left), atol=1e-3)
    if not lines:
        np.testing.assert_allclose(result, [1.0, 0.0, 0.0, 0.25, 0.0, 0.25], atol=1e-15)
    if len(lines) == 1:  # a segment
        cut = max(-1.0, -lines[0][0])
        area = math.acos(cut) - cut * math.sqrt(1.0 - cut * cut) if cut < 1.0 else 0.0
        assert result[0] == pytest.approx(area / math.pi, abs=1e-14)


@pytest.mark.parametrize("point", [(0.0, 0.0), (2.3, -1.7), (-2.5, 2.5)])
def test_the_rays_that_pass_are_those_that_meet_each_mirror_on_their_way(point: tuple[float, float]) -> None:
    rig = Instrument(mirror_side_mm=6.0, deviations={"mirror_2": Deviation(rx_deg=0.1, ry_deg=-0.15, x_mm=0.4)})
    points, result = np.empty((CORNERS, 2)), np.empty(CLIPPED)
    fill_disc_moments(points, left_polygon(scene_at(rig, 30.0).arrays, 3.0, *point, points, np.empty((CORNERS, 2))), result)
    plain, disc = PlainScene(rig, 30.0, 0.0), DISC[::7]
    on_sample = np.tile([*point, 0.0], (len(disc), 1)) @ plain.to_rig[:3, :3].T + plain.to_rig[:3, 3]
    _, meets = plain.passes(on_sample, plain.pupil + disc @ plain.pupil_axes)
    assert 0.05 < result[0] < 0.95
    np.testing.assert_allclose(result, 7.0 * counted(disc[meets]), atol=3e-3)
