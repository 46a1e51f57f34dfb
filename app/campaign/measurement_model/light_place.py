"""The light's place on the sample: what a slit's image that leaves part of the hole dark does to the direction of the light.

Mirrors that are tilted move the slit's image on the sample. Where an edge of it comes to lie within the hole, the middle of
what is lit is no longer the sample's centre: the light comes from another direction, and the photodiodes look at another place.
The lit part is that of the twin's own scenes, as the values of the inputs have them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from goniotwin.app.campaign.measurement_model.pose import (
    LIGHT,
    RAD,
    Displacement,
    Views,
    common_disc,
    image_shifts,
    light_at,
)
from goniotwin.app.rig.inputs import element_deviations
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics import Instrument
from goniotwin.twin.optics.geometry.field import scale_field
from goniotwin.twin.optics.geometry.scene import scene_at
from goniotwin.twin.optics.illumination.slit_image import lit_corners, slit_image

MOVES_IMAGE = tuple(name for name in LIGHT if name.startswith(("mirror_", "illumination_")))
"""Inputs that move the slit's image."""
PROBES = ("mirror_1_tilt_x", "mirror_1_tilt_y")
STEP_DEG = 0.01
"""Step of a derivative."""
FIELD_STEP = 0.1
KEPT = 4096
NODES = 8
"""Of an integral over the hole, along either direction."""
LEAST_CORNERS = 3
CELLS = 20
"""Cells of the hole along either side, for a search."""
DISC_STEP_MM, PLACE_STEP_MM = 0.05, 0.1
"""Steps of derivatives over the place of a photodiode's disc, and of the slit's image."""
PLACES, ORDERS = 31, 30
"""Places along either direction in a law of the image's place, and terms of its series."""
SMALLEST = 1e-12


@dataclass(frozen=True)
class LitSpot:
    """The lit part of the hole at some poses (m,): its `share`, and the `middle` (m, 3) of its light in mm, in the rig's frame.

    The middle is the place that light alone would have to come from to do to a lobe what the lit part does: points near the
    hole's edges count less, for the photodiode's disc cuts off part of its cone, and what is left of the cone is turned.
    """

    share: Floats
    middle: Floats


def lit_spots(instrument: Instrument, poses: Floats, rig: Mapping[str, float]) -> LitSpot:
    """The lit parts at `poses` (m, 2) of sigma and gamma, with values of the rig's inputs."""
    values = tuple(rig.get(name, 0.0) for name in MOVES_IMAGE)
    zero = rig.get("sigma_zero", 0.0)
    off = element_deviations(dict(zip(MOVES_IMAGE, values, strict=True)), instrument.pupil_distance_mm)
    moved = replace(instrument, deviations=off)
    found = [lit_spot(moved, sigma + zero, gamma) for sigma, gamma in poses.tolist()]
    return LitSpot(np.array([share for share, _ in found]), np.array([middle for _, middle in found]).reshape(-1, 3))


@lru_cache(maxsize=KEPT)
def lit_spot(instrument: Instrument, sigma_deg: float, gamma_deg: float) -> tuple[float, tuple[float, ...]]:
    """Share and middle at one pose; the middle of the hole where no light reaches it."""
    scene = scene_at(instrument, sigma_deg, gamma_deg)
    if slit_image(instrument, scene).everywhere:
        return 1.0, (0.0, 0.0, 0.0)
    corners = lit_corners(instrument, scene)
    if len(corners) < LEAST_CORNERS or math.isinf(np.ptp(corners)):
        return 0.0, (0.0, 0.0, 0.0)
    points, weight = _nodes(corners)
    area, moved = _seen_of(instrument, points, scene.pupil[0])
    middle = (weight * moved) @ points / (weight @ area)
    share = float(weight.sum()) / instrument.spot_side_mm**2
    return share, tuple((np.append(middle, 0.0) @ scene.to_sample).tolist())


def _nodes(corners: Floats) -> tuple[Floats, Floats]:
    """Points (n, 2) and weights (n,), in mm^2, of the integral over a convex polygon: strips, and nodes along each."""
    here, there = corners, np.roll(corners, -1, axis=0)
    low, high = float(corners[:, 0].min()), float(corners[:, 0].max())
    places, along = np.polynomial.legendre.leggauss(NODES)
    edges = np.unique(np.concatenate([corners[:, 0], [low, high]]))
    points, weights = [], []
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        if end - begin < SMALLEST:
            continue
        u = 0.5 * (begin + end) + 0.5 * (end - begin) * places
        steep = np.abs(there[:, 0] - here[:, 0]) > SMALLEST
        one, other = here[steep], there[steep]
        crossed = one[:, 1] + (u[:, None] - one[:, 0]) * (other[:, 1] - one[:, 1]) / (other[:, 0] - one[:, 0])
        on_edge = (u[:, None] > np.minimum(one[:, 0], other[:, 0])) & (u[:, None] < np.maximum(one[:, 0], other[:, 0]))
        bottom = np.min(np.where(on_edge, crossed, np.inf), axis=1)
        top = np.max(np.where(on_edge, crossed, -np.inf), axis=1)
        v = 0.5 * (bottom + top)[:, None] + 0.5 * (top - bottom)[:, None] * places
        points.append(np.stack([np.broadcast_to(u[:, None], v.shape), v], axis=-1).reshape(-1, 2))
        weights.append((0.25 * (end - begin) * (top - bottom)[:, None] * along[:, None] * along).ravel())
    return np.concatenate(points), np.concatenate(weights)


@dataclass(frozen=True)
class LightPlace:
    """What the light's place does at some views: `along` and `across` (n,) in deg, and the change of both with each of LIGHT.

    The latter are (n, inputs). `by_field` (n, 2) is the change of along and across with the logarithm of the variance of the
    field of view.
    """

    along: Floats
    across: Floats
    change_along: Floats
    change_across: Floats
    by_field: Floats

    def added_to(self, common: Displacement) -> Displacement:
        """What LIGHT and VIEW do, with the light's place."""
        along, across = common.along.copy(), common.across.copy()
        along[:, : len(LIGHT)] += self.change_along
        across[:, : len(LIGHT)] += self.change_across
        return replace(common, along=along, across=across)


def light_place(instrument: Instrument, views: Views, common: Displacement, rig: Mapping[str, float]) -> LightPlace:
    """What the light's place does with values of the rig's inputs; `common` is that of `PoseEffects` at the views."""
    poses, which = distinct_poses(views)
    along, across = of_centres(instrument, poses, which, common)
    centre = lit_spots(instrument, poses, rig).middle[which]
    change = np.zeros((len(LIGHT), len(poses), 3))
    probes = []
    for name in PROBES:
        steps = ({**rig, name: rig.get(name, 0.0) + sign * STEP_DEG} for sign in (1.0, -1.0))
        there, back = (lit_spots(instrument, poses, each).middle for each in steps)
        probes.append((there - back) / (2.0 * STEP_DEG))
    for k, sigma in enumerate(poses[:, 0].tolist()):
        # What two inputs do, that move the image along either direction, all others do by as much as they move it.
        ways = image_shifts(instrument, sigma) @ across_beam(sigma).T
        of_place = np.linalg.solve(ways[[LIGHT.index(name) for name in PROBES]], np.stack([each[k] for each in probes]))
        change[:, k] = ways @ of_place
    wider, narrower = (lit_spots(scale_field(instrument, s * FIELD_STEP), poses, rig).middle[which] for s in (1.0, -1.0))
    by_field = (wider - narrower) / (2.0 * FIELD_STEP)
    moved = change[:, which]
    return LightPlace(
        np.einsum("ni,ni->n", along, centre),
        np.einsum("ni,ni->n", across, centre),
        np.einsum("ni,kni->nk", along, moved),
        np.einsum("ni,kni->nk", across, moved),
        np.stack([np.einsum("ni,ni->n", each, by_field) for each in (along, across)], axis=1),
    )


def across_beam(sigma_deg: float) -> Floats:
    """Unit vectors (2, 3) across the beam: in the plane of incidence, and along y."""
    sigma = math.radians(sigma_deg)
    return np.array([[math.cos(sigma), 0.0, -math.sin(sigma)], [0.0, 1.0, 0.0]])


def distinct_poses(views: Views) -> tuple[Floats, Ints]:
    """The distinct poses (m, 2) of sigma and gamma, and which of them each view has."""
    poses, which = np.unique(np.stack([views.sigma_deg, views.gamma_deg], axis=1), axis=0, return_inverse=True)
    return poses, which.ravel()


def of_centres(instrument: Instrument, poses: Floats, which: Ints, common: Displacement) -> tuple[Floats, Floats]:
    """What a middle of the light beside the sample's centre does, for each mm along the rig's axes: (n, 3) along and across.

    The light from the exit pupil to there has the direction of a beam that is tilted.
    """
    tilts = [LIGHT.index(f"beam_tilt_{axis}") for axis in "xz"]
    tilted = np.empty((len(poses), 2, 3))
    for k, sigma in enumerate(poses[:, 0].tolist()):
        towards, change, _ = light_at(instrument, sigma)
        # The two tilts turn the light by unit vectors at right angles to each other and to it.
        across = np.eye(3) - np.outer(towards, towards)
        tilted[k] = change[tilts] @ across * (-1.0 / (RAD * instrument.pupil_distance_mm))
    turned = tilted[which]
    return np.einsum("nk,nki->ni", common.along[:, tilts], turned), np.einsum("nk,nki->ni", common.across[:, tilts], turned)


@dataclass(frozen=True)
class SpotWeights:
    """The hole at one pose in cells, for many places of the slit's image at once.

    `across` (n, 2): the cells' places along the image's sides, which turn with sigma against the plane of incidence. `sides`
    (2, 2): the image's sides by the directions in the plane of incidence and along y. `points` (n, 3) are the cells in the
    rig's frame. `weight` (n,) is what a photodiode at the lobe's middle sees of a cell, `moment` (n, 2) its part in the middle
    of the light, along x and y of the rig. `half` is half the image's side, `cell` (2,) what a cell measures along the image's
    sides, mm.
    """

    across: Floats
    points: Floats
    weight: Floats
    moment: Floats
    sides: Floats
    half: float
    cell: Floats

    def lit(self, places: Floats) -> tuple[Floats, Floats]:
        """Share (n,) of the light that a photodiode sees, and its middle (n, 2), with the image at `places` (n, 2)."""
        lit = self.lit_cells(places)
        whole = float(self.weight.sum())
        some = np.maximum(lit @ self.weight, SMALLEST * whole)
        return some / whole, lit @ self.moment / some[:, None]

    def lit_cells(self, places: Floats) -> Floats:
        """Lit part (n, cells) of each cell, with the image at `places` (n, 2)."""
        lit = np.ones((len(places), len(self.weight)))
        moved = places @ self.sides.T
        for k in (0, 1):
            inside = self.half - np.abs(self.across[:, k] - moved[:, k, None])
            lit *= np.clip(inside / self.cell[k] + 0.5, 0.0, 1.0)
        return lit


@lru_cache(maxsize=KEPT)
def spot_weights(instrument: Instrument, sigma_deg: float, gamma_deg: float) -> SpotWeights:
    """The weights of a rig without deviations."""
    scene, half = scene_at(instrument, sigma_deg, gamma_deg), 0.5 * instrument.spot_side_mm
    along = half * ((2.0 * np.arange(CELLS) + 1.0) / CELLS - 1.0)
    points = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
    weight, moved = _seen_of(instrument, points, scene.pupil[0])
    at_rig = np.concatenate([points, np.zeros((len(points), 1))], axis=1) @ scene.to_sample
    # The image has the directions of the pupil's axes.
    axes = scene.pupil[1:3] / np.linalg.norm(scene.pupil[1:3], axis=1)[:, None]
    sides = across_beam(sigma_deg) @ scene.to_sample.T @ axes.T
    # A turned cell ends over a range as wide as its shadow.
    cell = 2.0 * half / CELLS * np.sum(np.abs(axes[:, :2]), axis=1)
    size = float(np.mean(slit_image(instrument, scene).edges[:, 0, 0]))
    return SpotWeights(points @ axes[:, :2].T, at_rig, weight, moved[:, None] * at_rig[:, :2], sides.T, size, cell)


def _seen_of(instrument: Instrument, points: Floats, pupil: Floats) -> tuple[Floats, Floats]:
    """What a photodiode at the lobe's middle sees of `points` (n, 2) of the hole: area, and weight in the light's middle."""
    towards = pupil / np.linalg.norm(pupil)
    apart, area, turned = _cone_and_disc(instrument, points, towards[:2] * [-1.0, -1.0])
    return area, area + instrument.pupil_distance_mm / instrument.arc_radius_mm * turned / apart


def _cone_and_disc(instrument: Instrument, points: Floats, view: Floats) -> tuple[Floats, Floats, Floats]:
    """How far a photodiode's cone and disc are apart, the area that they have in common, and its sum towards the disc (..., n).

    Seen from `points` (..., n, k), against the disc's place, mm, both are circles of directions about the unit vector `view`
    (..., k).
    """
    ahead = (points @ view[..., None])[..., 0]
    apart = np.sqrt(np.maximum(np.sum(points**2, axis=-1) - ahead**2, SMALLEST)) / instrument.arc_radius_mm
    cone = math.tan(math.radians(0.5 * instrument.field_deg))
    return apart, *common_disc(cone, 0.5 * instrument.detector_diameter_mm / instrument.arc_radius_mm, apart)


@dataclass(frozen=True)
class SeenLight:
    """What a photodiode at the lobe's middle sees of a diffuser or of the open beam, at places (n, 2) of the slit's image.

    `logarithm` (n,) of the light, against a hole that is lit everywhere; its change `by_place` (n, 2) for a mm of the image, in
    the plane of incidence and along y; and `by_disc` (n, 3) for a mm of the photodiode's disc against its cone, along the rig's
    axes.
    """

    logarithm: Floats
    by_place: Floats
    by_disc: Floats


def seen_light(instrument: Instrument, pose: tuple[float, float], view: Floats, places: Floats) -> SeenLight:
    """The light at a pose of sigma and gamma in the direction `view` (3,): of each lit point, as much as cone and disc share.

    An open beam that is scanned has the same weights: each of its rays is seen from a solid angle of the photodiode's
    directions that is what cone and disc share from the ray's point of the hole.
    """
    spot = spot_weights(instrument, *pose)
    steps = DISC_STEP_MM * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    weight = _cone_and_disc(instrument, spot.points - steps[:, None], view)[1].T
    least = SMALLEST * weight.sum(axis=0)

    def logarithm(at: Floats, columns: slice = slice(None)) -> Floats:
        return np.asarray(np.log(np.maximum(spot.lit_cells(at) @ weight[:, columns], least[columns])))

    found = logarithm(places)
    moved = [logarithm(places + sign * PLACE_STEP_MM * way, slice(1))[:, 0] for way in np.eye(2) for sign in (1.0, -1.0)]
    return SeenLight(
        found[:, 0] - math.log(float(weight[:, 0].sum())),
        np.stack([moved[0] - moved[1], moved[2] - moved[3]], axis=1) / (2.0 * PLACE_STEP_MM),
        (found[:, 1:4] - found[:, 4:]) / (2.0 * DISC_STEP_MM),
    )


def seen_logarithm(instrument: Instrument, pose: tuple[float, float], views: Floats, places: Floats, discs: Floats) -> Floats:
    """The logarithm (m, n) of a diffuser's light at a pose of sigma and gamma in the directions `views` (m, 3), with the slit's
    image at `places` (n, 2), against a hole that is lit everywhere; to first order with each photodiode's disc moved against
    its cone by `discs` (m, n, 3), mm along the rig's axes.
    """
    spot = spot_weights(instrument, *pose)
    steps = DISC_STEP_MM * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    weight = _cone_and_disc(instrument, spot.points - steps[:, None], views[:, None])[1]
    whole = weight.sum(axis=2)[..., None]
    found = np.log(np.maximum(weight @ spot.lit_cells(places).T, SMALLEST * whole) / whole)
    by_disc = (found[:, 1:4] - found[:, 4:]) / (2.0 * DISC_STEP_MM)
    return np.asarray(found[:, 0] + np.einsum("mkn,mnk->mn", by_disc, discs))


def change_by_height(instrument: Instrument, pose: tuple[float, float], views: Floats, places: Floats) -> Floats:
    """The change (m, n) of the logarithm of a diffuser's light for a mm of its height, with the image at `places` (n, 2).

    Less that of a hole that is lit everywhere. A hole that is lifted meets the beam beside its middle, and the photodiodes, in
    the directions `views` (m, 3), see it from there.
    """
    spot, up = spot_weights(instrument, *pose), np.array([0.0, 0.0, PLACE_STEP_MM])
    found = []
    for sign in (1.0, -1.0):
        weight = _cone_and_disc(instrument, spot.points + sign * up, views)[1]
        whole = weight.sum(axis=1)[:, None]
        lit = spot.lit_cells(places - sign * across_beam(pose[0]) @ up)
        found.append(np.log(np.maximum(weight @ lit.T, SMALLEST * whole) / whole))
    return np.asarray((found[0] - found[1]) / (2.0 * PLACE_STEP_MM))


@dataclass(frozen=True)
class PlaceLaw:
    """Places (n, 2) of the slit's image across the beam, in the plane of incidence and along y, and their probability (n,)."""

    places: Floats
    probability: Floats


def place_law(ways: Floats, half_widths: Floats) -> PlaceLaw:
    """The law of the place by inputs that move it by `ways` (inputs, 2), mm for one unit, each rectangular with a half width.

    The sum of a few rectangular inputs has no tails, and it is the tails of a place that count: so no normal law. Along either
    direction it is the Fourier series of the characteristic function; no input moves the image along both.
    """
    places, probability = [], []
    for widths in np.abs(ways * half_widths[:, None]).T:
        furthest = float(widths.sum())
        at = furthest * ((2.0 * np.arange(PLACES) + 1.0) / PLACES - 1.0)
        order = np.arange(1, ORDERS)[:, None] / max(furthest, SMALLEST)
        series = 1.0 + 2.0 * np.sum(np.prod(np.sinc(order * widths), axis=1)[:, None] * np.cos(math.pi * order * at), axis=0)
        places.append(at)
        probability.append(np.maximum(series, 0.0))
    both = np.outer(*probability).ravel()
    return PlaceLaw(np.stack(np.meshgrid(*places, indexing="ij"), axis=-1).reshape(-1, 2), both / both.sum())
