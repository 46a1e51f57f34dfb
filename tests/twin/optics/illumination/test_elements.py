"""Effect of each element of the illumination unit on a ray, compared with geometry."""

import math
from typing import Any

import numpy as np
import pytest

from goniotwin.twin.optics.illumination.elements import bend, chord, reflect_at_sphere, to_plane

FRAME = np.vstack([np.zeros(3), np.eye(3)])
FRAMES = FRAME[None]
COUNTER = np.random.Generator(np.random.Philox(key=7))


def directions(count: int) -> Any:
    drawn = COUNTER.normal(size=(count, 3))
    return drawn / np.linalg.norm(drawn, axis=1)[:, None]


def test_the_mean_chord_of_the_arc_is_four_volumes_over_its_surface_area() -> None:
    radius, half, ball = 0.5, 1.1, 1.3
    # Lines uniform over all positions and directions: through a disc about the origin, normal to each direction.
    rays = directions(400_000)
    place = np.cross(rays, directions(len(rays)))
    place *= (ball * np.sqrt(COUNTER.random(len(rays))) / np.linalg.norm(place, axis=1))[:, None]
    lengths = np.array([chord(FRAMES, 0, radius, half, *x, *w) for x, w in zip(place, rays, strict=True)])
    hit = lengths[lengths > 0.0]
    volume, surface = math.pi * radius**2 * 2 * half, 2 * math.pi * radius * (2 * half + radius)
    # Cauchy: 4 V / S for any convex body.
    assert hit.mean() == pytest.approx(4.0 * volume / surface, abs=4.0 * hit.std() / math.sqrt(hit.size))
    # The share of the lines that meet the body is its mean projected area, S / 4, over the disc's area.
    share = 0.25 * surface / (math.pi * ball**2)
    assert hit.size / len(rays) == pytest.approx(share, abs=4.0 * math.sqrt(share / len(rays)))


@pytest.mark.parametrize(
    ("place", "direction", "length"),
    [
        ([0.0, -9.0, 0.0], [0.0, 1.0, 0.0], 1.0),
        ([0.3, -9.0, 0.5], [0.0, 1.0, 0.0], 0.8),
        ([0.6, -9.0, 0.0], [0.0, 1.0, 0.0], 0.0),
        ([0.0, -9.0, 1.2], [0.0, 1.0, 0.0], 0.0),
        ([0.1, 0.2, -9.0], [0.0, 0.0, 1.0], 2.2),
        ([0.6, 0.2, -9.0], [0.0, 0.0, 1.0], 0.0),
        ([0.0, 3.0, 0.0], [0.0, 1.0, 0.0], 1.0),
    ],
)
def test_known_chords(place: list[float], direction: list[float], length: float) -> None:
    assert chord(FRAMES, 0, 0.5, 1.1, *place, *direction) == pytest.approx(length)


def test_an_ideal_lens_images_a_point_and_conserves_the_flux() -> None:
    source, near, far = np.array([1.0, -50.0, 0.7]), 50.0, 250.0
    focal = near * far / (near + far)
    for u, v in ((0.0, 0.0), (20.0, 3.0), (-7.0, -22.0)):
        x, w = source.copy(), np.array([u, 0.0, v]) - source
        w /= np.linalg.norm(w)
        before = w[1]
        *met, s, t = to_plane(FRAMES, 0, *x, *w)
        assert (s, t) == pytest.approx((u, v))
        *bent, gain = bend(FRAMES, 0, u, v, 1.0 / focal, *w)
        x, w = np.array(met), np.array(bent)
        assert gain == pytest.approx((before / w[1]) ** 4)
        assert x + far / w[1] * w == pytest.approx([-5.0, 250.0, -3.5])
        # Backwards.
        *back, inverse = bend(FRAMES, 0, u, v, -1.0 / focal, *-w)
        assert inverse == pytest.approx(1.0 / gain)
        assert x + near / abs(back[1]) * np.array(back) == pytest.approx(source)


def test_the_reflector_images_its_centre_onto_itself() -> None:
    frame = FRAME.copy()
    frame[0] = [0.0, -50.0, 0.0]
    for angle, on in ((0.0, True), (59.0, True), (61.0, False)):
        ray = reflect_at_sphere(
            frame[None], 0, 50.0, 0.5, 0.0, 0.0, 0.0, math.sin(math.radians(angle)), -math.cos(math.radians(angle)), 0.0
        )
        x, w = np.array(ray[1]), np.array(ray[2])
        assert ray[0] == on
        assert np.linalg.norm(x) == pytest.approx(50.0)
        assert x + 50.0 * w == pytest.approx(np.zeros(3), abs=1e-12)
    # A point beside the centre is imaged upside down.
    ray = reflect_at_sphere(frame[None], 0, 50.0, 0.5, 0.1, 0.0, 0.2, 0.0, -1.0, 0.0)
    x, w = np.array(ray[1]), np.array(ray[2])
    assert ray[0]
    assert x - x[1] / w[1] * w == pytest.approx([-0.1, 0.0, -0.2], rel=1e-4)
