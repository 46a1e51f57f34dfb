"""What errors of angles and places do to a value: the displacement of the lobe from where it is looked at, and a diffuse part.

By geometry alone: small turns as vectors, from the rig's nominal dimensions. A value depends on the direction d that a
photodiode looks along and on the middle of the lobe r: the specular direction or, of transmitted light, the direction straight
through. An input moves d or r; what counts is p = d - r, with r carried along the great circle to d. In degrees for each unit
of the input: `along` the arc, towards growing polar angle, and `across` it, towards d x along: growing azimuth on the upper
arc. With the lobe's slopes it is a relative change of the value. A sample without slopes, and the etalon, which has none,
change with the cosines of incidence and of observation alone: the `diffuse` part, relative for each unit. Sample and etalon
have it in common where an input acts on both.

The light comes from the image of the exit pupil in the mirrors; a mirror's tilt moves that image by its lever arm.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from goniotwin.app.campaign.measurement_model.inputs import InputQuantity, quantity
from goniotwin.app.rig.inputs import BACKLASH, PHOTODIODE_ACROSS, PHOTODIODE_ANGLE, POSITION, input_named
from goniotwin.app.rig.uncertainty import UncertaintyTable
from goniotwin.arrays import Flags, Floats
from goniotwin.keys import ORIGINS
from goniotwin.twin.optics import Instrument
from goniotwin.twin.plant.disturbances import SAMPLE

RAD = math.pi / 180.0
MIRRORS = (1, 2, 3)
LIGHT = (
    "sigma_zero",
    *(f"mirror_{m}_{each}" for m in MIRRORS for each in ("tilt_x", "tilt_y", "shift_z")),
    "illumination_shift_x",
    "illumination_shift_z",
    "beam_tilt_x",
    "beam_tilt_z",
)
"""Inputs that move the light, and with it the middle of the lobe."""
VIEW = (
    "beta_zero",
    "shift_zero",
    "arc_tilt_x",
    "arc_tilt_y",
    "arc_tilt_z",
    "arc_shift_x",
    "arc_shift_y",
    "arc_shift_z",
    "sensor_tilt_x",
    "sensor_tilt_y",
    "sensor_shift_x",
    "sensor_shift_y",
)
"""Inputs that move the directions that photodiodes look along."""
OF_ETALON = "all values that divide by this mounting"
MOUNTED = ("tilt_x", "tilt_y", "height")
"""Inputs of each mounting of a sample or of the etalon: turns about x and y of a frame that turns with gamma, and a lift."""
ASIDE = ("arc_shift_x", "arc_shift_y", "arc_shift_z", "sensor_tilt_y", "sensor_shift_x")
"""Inputs of VIEW that move a photodiode's disc along the arc against its cone: a lift does so too, and counts the more."""
POSITIONS = ("gamma", "sigma", "beta", "shift")
"""Axes with an error of their own after each move."""
NEAREST = 1e-3
"""Least sum 1 + cos of the angle between lobe and photodiode: opposite directions have no great circle of their own."""
GRAZING = 1e-3
"""Least cosine of incidence and observation: at the horizon no value is finite."""
GRID_DEG = np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 65.0, 70.0, 75.0, 80.0, 82.5, 85.0, 87.5, 89.0])
"""Polar angles at which the acceptance is computed; between them it is interpolated."""
NODES = 24
STEP = 1e-3
"""Relative step of a derivative."""
BEND_STEP = 0.1
"""Step of the second derivative over the disc's radius: about as far as discs are off."""


@dataclass(frozen=True)
class Views:
    """Directions (n,) that are looked at. `polar` is from the pole of the photodiode's own arc, never negative, in rad.

    `azimuth` is in rad. `lower`: on the lower arc. `reverse`: the arc is at the opposite azimuth, the shift has brought the
    photodiode beyond the pole.
    """

    sigma_deg: Floats
    gamma_deg: Floats
    polar: Floats
    azimuth: Floats
    lower: Flags
    transmitted: Flags
    reverse: Flags


@dataclass(frozen=True)
class Displacement:
    """What inputs do at directions: `along` and `across` in deg and `diffuse` relative, arrays (n, inputs), for one unit."""

    along: Floats
    across: Floats
    diffuse: Floats

    def relative(self, slope_along: Floats, slope_across: Floats) -> Floats:
        """Relative change (n, inputs) of values for one unit of each input; slopes (n,) per degree, without NaN."""
        return slope_along[:, None] * self.along + slope_across[:, None] * self.across + self.diffuse

    def where(self, chosen: Flags) -> "Displacement":
        """The same at some directions (n,), and nothing at the others."""
        return Displacement(*(np.where(chosen[:, None], each, 0.0) for each in vars(self).values()))

    def times(self, matrix: Floats) -> "Displacement":
        """What combinations (inputs, m) of the inputs do."""
        return Displacement(*(each @ matrix for each in vars(self).values()))


@dataclass(frozen=True)
class PoseEffects:
    """The effects of all inputs of pose at some directions, columns in the order of the names.

    `common`: LIGHT and VIEW, which act on sample and etalon. `sample` and `etalon`: MOUNTED of each. `position`: POSITIONS at
    the sample's row, and `etalon_position` at the etalon's. `photodiode`: its own angle along the arc and across it.
    `lifted`: the height of the sample's mounting times each of ASIDE, per mm and unit; for the etalon's it has the other sign.
    """

    common: Displacement
    sample: Displacement
    etalon: Displacement
    position: Displacement
    etalon_position: Displacement
    photodiode: Displacement
    lifted: Displacement


def pose_effects(instrument: Instrument, views: Views) -> PoseEffects:
    """The effects of all inputs of pose on the values at `views`."""
    up = np.where(views.lower, -1.0, 1.0)
    frame, ahead = _frame(views)
    cos = np.cos(views.polar)
    accepted = acceptance(instrument).at(views.polar)
    light, at_etalon = _lights(instrument, views)
    moved = _light_displacement(frame, light, views.transmitted)
    seen = _seen(instrument, frame, accepted, ahead, light, views.transmitted)
    viewed = _view_displacement(instrument, frame, seen, views)
    none = np.zeros((cos.size, 1))
    of_views = np.zeros((cos.size, len(VIEW)))  # the etalon has the same cosine of observation
    common = Displacement(
        np.concatenate([moved.along, viewed.along], axis=1),
        np.concatenate([moved.across, viewed.across], axis=1),
        np.concatenate([light.level - at_etalon.level, of_views], axis=1),
    )
    # An axis is at the etalon's row where it was not at the sample's: the cosines do not cancel.
    shifted = (accepted.share * frame.slope_n / frame.cos_n * frame.sign * RAD)[:, None]
    turned = _turned_lobe(frame, light, views.transmitted)
    position = Displacement(
        np.concatenate([turned[0], moved.along[:, :1], viewed.along[:, :2]], axis=1),
        np.concatenate([turned[1], moved.across[:, :1], viewed.across[:, :2]], axis=1),
        np.concatenate([none, light.level[:, :1], none, shifted], axis=1),
    )
    still = np.zeros_like(position.along)
    etalon_position = Displacement(still, still, -np.concatenate([none, at_etalon.level[:, :1], none, shifted], axis=1))
    return PoseEffects(
        common=common,
        sample=_mounted(instrument, frame, seen, views, light, lobe=True),
        etalon=_mounted(instrument, frame, seen, views, at_etalon, lobe=False),
        position=position,
        etalon_position=etalon_position,
        photodiode=Displacement(
            np.concatenate([frame.sign[:, None], none], axis=1),
            np.concatenate([none, (frame.sign * up)[:, None]], axis=1),
            np.concatenate([none, none], axis=1),
        ),
        lifted=_lifted(instrument, frame, accepted, views),
    )


def _frame(views: Views) -> "tuple[_Frame, Floats]":
    """The viewing directions with those along the arc and across it, and the level directions (n, 3) away from the pole."""
    up = np.where(views.lower, -1.0, 1.0)
    cos, sin = np.cos(views.polar), np.sin(views.polar)
    level = np.stack([-np.sin(views.azimuth), np.cos(views.azimuth), np.zeros_like(cos)], axis=1)
    ahead = np.stack([level[:, 1], -level[:, 0], np.zeros_like(cos)], axis=1)
    d = _mix(sin, ahead, cos * up)
    along = _mix(cos, ahead, -sin * up)
    cosine = up * np.where(np.abs(cos) < GRAZING, np.copysign(GRAZING, cos), cos)
    return _Frame(d, along, up[:, None] * level, cosine, -up * sin, np.where(views.reverse, -1.0, 1.0)), ahead


def disc_moves(instrument: Instrument, views: Views) -> tuple[Floats, Floats]:
    """The views' directions (n, 3), and the way (n, inputs, 3) of the disc against the cone for one unit of VIEW, in mm.

    Both are in the rig's frame.
    """
    frame, _ = _frame(views)
    _, disc = _view_moves(instrument, frame, views)
    return frame.d, disc[0][:, :, None] * frame.along[:, None] + disc[1][:, :, None] * frame.across[:, None]


def _mix(horizontal: Floats, ahead: Floats, vertical: Floats) -> Floats:
    vectors = horizontal[:, None] * ahead
    vectors[:, 2] = vertical
    return vectors


@dataclass(frozen=True)
class _Frame:
    """Viewing directions d (n, 3) with the directions along the arc and across it.

    `cos_n` is d's cosine to the upper normal, `slope_n` the change of it along the arc, `sign` that of an angle on the arc.
    """

    d: Floats
    along: Floats
    across: Floats
    cos_n: Floats
    slope_n: Floats
    sign: Floats


# The light.


@dataclass(frozen=True)
class _Light:
    """The light at n views: towards it, `l` (n, 3), and for each of LIGHT the change of `l`, (n, inputs, 3), in deg a unit.

    `level` (n, inputs): relative change of the irradiance. `distance_mm` is that of the pupil's image.
    """

    towards: Floats
    change: Floats
    level: Floats
    distance_mm: float


def _lights(instrument: Instrument, views: Views) -> tuple[_Light, _Light]:
    """The light at the sample and at the etalon. That of transmitted light is lit from the photodiode's own side."""
    sigmas, which = np.unique(views.sigma_deg, return_inverse=True)
    each = [light_at(instrument, float(sigma)) for sigma in sigmas]
    # The etalon's pose is at 180 deg - sigma, the mirror image of the sample's light.
    opposite = [light_at(instrument, 180.0 - float(sigma)) for sigma in sigmas]
    towards, change, level = (np.stack(column) for column in zip(*each, strict=True))
    there = [np.stack(column) for column in zip(*opposite, strict=True)]
    distance = _distance_mm(instrument)
    here = _Light(towards[which], change[which], level[which], distance)
    far = views.transmitted
    etalon = _Light(
        np.where(far[:, None], there[0][which], here.towards),
        here.change,
        np.where(far[:, None], there[2][which], here.level),
        distance,
    )
    return here, etalon


def _distance_mm(instrument: Instrument) -> float:
    """Length of the beam from the exit pupil over three mirrors to the sample."""
    return instrument.pupil_to_mirror_mm + 3.0 * instrument.mirror_distance_mm


def light_at(instrument: Instrument, sigma_deg: float) -> tuple[Floats, Floats, Floats]:
    """Towards the light (3,), its change (inputs, 3) in deg a unit of each of LIGHT, and that of the irradiance, relative."""
    sigma = math.radians(sigma_deg)
    cosine = math.cos(sigma)
    cosine = cosine if abs(cosine) > GRAZING else math.copysign(GRAZING, cosine)
    light = np.array([math.sin(sigma), 0.0, cosine])
    side, total = instrument.mirror_distance_mm, _distance_mm(instrument)
    legs, seconds, first, normals = _beam(light)
    # The arm of a mirror's tilt is that from the pupil's image.
    arms = [instrument.pupil_to_mirror_mm + k * side for k in range(len(MIRRORS))]
    images: list[Floats] = [total * np.array([light[2], 0.0, -light[0]])]  # the mirror unit turned about y by a radian
    for k, normal in enumerate(normals):
        back = -arms[k] * legs[k][0]  # from the mirror to the image of the pupil that it sees
        for turned in (-seconds[k] / math.sqrt(2.0), first):
            images.append(_onward(-2.0 * ((back @ turned) * normal + (back @ normal) * turned), normals[k + 1 :]))
        images.append(_onward(2.0 * normal, normals[k + 1 :]))
    images += [_onward(np.eye(3)[axis], normals) for axis in (0, 2)]
    # The unit turned about the sample's centre, unfolded, about x and z.
    images += [_onward(np.array(each), normals) for each in ((0.0, 0.0, -total), (total, 0.0, 0.0))]
    moved = np.stack(images)
    in_mm = np.array(["shift" in name for name in LIGHT])
    ahead = moved @ light
    # Angles in deg a deg, or deg a mm; relative changes a deg, or a mm.
    change = (moved - ahead[:, None] * light) / total * np.where(in_mm, 1.0 / RAD, 1.0)[:, None]
    level = change[:, 2] * RAD / light[2] - 2.0 * ahead / total * np.where(in_mm, 1.0, RAD)
    return light, change, level


def image_shifts(instrument: Instrument, sigma_deg: float) -> Floats:
    """The way (inputs, 3) of the slit's image on the sample for one unit of each of LIGHT, in mm, in the rig's frame.

    The image stays where the light is aimed at: a tilt of the beam, or of the mirror unit as a whole, does not move it.
    """
    sigma = math.radians(sigma_deg)
    legs, seconds, first, normals = _beam(np.array([math.sin(sigma), 0.0, math.cos(sigma)]))
    moved: list[Floats] = [np.zeros(3)]
    for k, normal in enumerate(normals):
        ahead = (len(MIRRORS) - k) * instrument.mirror_distance_mm * legs[k][0]  # from the mirror to the image that it sees
        for turned in (-seconds[k] / math.sqrt(2.0), first):
            turn = -2.0 * RAD * ((ahead @ turned) * normal + (ahead @ normal) * turned)
            moved.append(_onward(turn, normals[k + 1 :]))
        moved.append(_onward(2.0 * normal, normals[k + 1 :]))
    moved += [_onward(np.eye(3)[axis], normals) for axis in (0, 2)]
    return np.stack([*moved, np.zeros(3), np.zeros(3)])


def _beam(light: Floats) -> tuple[list[tuple[Floats, Floats]], list[Floats], Floats, list[Floats]]:
    """Directions of the beam before and after each mirror; the mirrors' sides `second` and `first`; their normals.

    `light` (3,) is towards it. `first` is level in all three mirrors; a turn about one side moves the normal along the other.
    """
    y = np.array([0.0, 1.0, 0.0])
    legs, seconds = [(y, light), (light, y), (y, -light)], [y + light, -y - light, y - light]
    normals = [(after - before) / math.sqrt(2.0) for before, after in legs]
    return legs, seconds, np.array([-light[2], 0.0, light[0]]), normals


def _onward(vector: Floats, normals: list[Floats]) -> Floats:
    """A vector after the reflection in further mirrors."""
    for normal in normals:
        vector = vector - 2.0 * (vector @ normal) * normal
    return vector


def _middle(towards: Floats, transmitted: Flags) -> Floats:
    """The middle of the lobe (..., 3): the specular direction, or straight through; and likewise a change of it."""
    far = transmitted.reshape(transmitted.shape + (1,) * (towards.ndim - 1))
    return np.where(far, -towards, towards * [-1.0, -1.0, 1.0])


def _carried(frame: _Frame, middle: Floats) -> tuple[Floats, Floats]:
    """Vectors (n, 3): their product with a change of the lobe's middle is that change, carried to d, along and across."""
    cosine = np.maximum(1.0 + np.einsum("ni,ni->n", frame.d, middle), NEAREST)
    along, across = (
        each - (np.einsum("ni,ni->n", each, middle) / cosine)[:, None] * frame.d for each in (frame.along, frame.across)
    )
    return along, across


def _light_displacement(frame: _Frame, light: _Light, transmitted: Flags) -> Displacement:
    """The inputs LIGHT."""
    change = _middle(light.change, transmitted)
    along, across = _carried(frame, _middle(light.towards, transmitted))
    moved = [-np.einsum("ni,nki->nk", each, change) for each in (along, across)]
    return Displacement(moved[0], moved[1], light.level)


def _turned_lobe(frame: _Frame, light: _Light, transmitted: Flags) -> tuple[Floats, Floats]:
    """A turn of the sample about its normal, which turns the lobe about its middle: (n, 1) along and across, deg a deg."""
    middle = _middle(light.towards, transmitted)
    moved = -middle[:, 2:] * np.cross(middle, frame.d)
    along, across = (np.einsum("ni,ni->n", each, moved)[:, None] for each in (frame.along, frame.across))
    return along, across


# The photodiodes.


@dataclass(frozen=True)
class Acceptance:
    """What a photodiode accepts of the rays from the spot, at some polar angles, along the arc and across it.

    Disc and spot cut the cone. With the disc moved aside, and the cone's axis as it was, the mean direction turns by
    `turn` of the angle by which the disc has moved, and the mean point of the spot moves by `spot` of the disc's way.
    `share`: relative change of the light for one of the spot's width as it is seen. `nearer`: the same for the distance, with
    the opposite sign. `bend`: the light's second derivative over the disc's way along the arc, relative, per mm^2.
    """

    turn_along: Floats
    turn_across: Floats
    spot_along: Floats
    spot_across: Floats
    share: Floats
    nearer: Floats
    bend: Floats

    def at(self, polar: Floats) -> "Acceptance":
        """The acceptance at polar angles (n,), rad."""
        return Acceptance(*(np.interp(np.degrees(polar), GRID_DEG, each) for each in vars(self).values()))


@lru_cache(maxsize=8)
def acceptance(instrument: Instrument) -> Acceptance:
    """The acceptance at GRID_DEG: the rays from each point of the spot that meet both the photodiode's disc and its cone.

    From a point of the spot both are discs of directions; what they have in common is the lens between two circles.
    """
    half, distance = 0.5 * instrument.spot_side_mm, instrument.arc_radius_mm
    cone = math.tan(math.radians(0.5 * instrument.field_deg))
    disc = 0.5 * instrument.detector_diameter_mm
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    weight = weights[:, None] * weights
    columns = []
    for width in np.cos(np.radians(GRID_DEG)):

        def rays(a: float, b: float, stretch: float = 1.0, away: float = distance, width: float = width) -> Floats:
            """Number of rays, sums of their slopes and of the points that they come from, with the disc moved by (a, b)."""
            u, v = half * stretch * nodes[:, None], half * nodes[None, :]
            x, y = (a - u * width) / away, (b - v) / away
            apart = np.hypot(x, y)
            area, towards = common_disc(cone, disc / away, apart)
            towards = towards / np.maximum(apart, 1e-300)
            return stretch * np.array([np.sum(weight * each) for each in (area, towards * x, towards * y, area * u, area * v)])

        e, middle = STEP * disc, rays(0.0, 0.0)[0]
        along, across = (rays(e, 0.0) - rays(-e, 0.0)) / (2.0 * e), (rays(0.0, e) - rays(0.0, -e)) / (2.0 * e)
        wider = rays(0.0, 0.0, 1.0 + STEP) - rays(0.0, 0.0, 1.0 - STEP)
        nearer = rays(0.0, 0.0, 1.0, distance * (1.0 - STEP)) - rays(0.0, 0.0, 1.0, distance * (1.0 + STEP))
        turned = [distance * along[1], distance * across[2], along[3], across[4]]
        far = BEND_STEP * disc
        bend = (rays(far, 0.0)[0] + rays(-far, 0.0)[0] - 2.0 * middle) / far**2
        columns.append(np.array([*turned, wider[0] / (2.0 * STEP), nearer[0] / (2.0 * STEP), bend]) / middle)
    return Acceptance(*np.array(columns).T)


def common_disc(radius: float, other: float, apart: Floats) -> tuple[Floats, Floats]:
    """Area that two discs have in common, and its sum of the coordinate from the first one's middle towards the other's."""
    most = radius + other
    within = np.clip(apart, abs(radius - other) + 1e-12 * most, most)
    cut = (within**2 + radius**2 - other**2) / (2.0 * within)
    height = np.sqrt(np.maximum(radius**2 - cut**2, 0.0))
    one, two = np.arctan2(height, cut), np.arctan2(height, within - cut)
    area = radius**2 * one + other**2 * two - within * height
    # A segment's sum about its own circle's middle is 2/3 height^3.
    segment = 2.0 / 3.0 * height**3
    first = segment + (other**2 * two - (within - cut) * height) * within - segment
    whole = apart <= abs(radius - other)
    smaller = math.pi * min(radius, other) ** 2
    area = np.where(whole, smaller, np.where(apart >= most, 0.0, area))
    first = np.where(whole, (0.0 if radius <= other else 1.0) * smaller * apart, np.where(apart >= most, 0.0, first))
    return area, first


@dataclass(frozen=True)
class _Seen:
    """What a photodiode sees of the spot where its disc is moved by 1 mm along the arc or across it, n views each.

    `moved` (n, 2, 2): the lobe against the mean direction, in deg, [along or across, of a move along or across]. `level`
    (n, 2): relative change of a diffuser's light.
    """

    moved: Floats
    level: Floats
    accepted: Acceptance


def _seen(
    instrument: Instrument, frame: _Frame, accepted: Acceptance, ahead: Floats, light: _Light, transmitted: Flags
) -> _Seen:
    far, towards = instrument.arc_radius_mm * RAD, light.towards
    # The mean point of the spot, by whose place the light comes from another direction.
    points = accepted.spot_along[:, None] * ahead, accepted.spot_across[:, None] * frame.across
    carried = _carried(frame, _middle(towards, transmitted))
    moved, level = np.zeros((towards.shape[0], 2, 2)), np.zeros((towards.shape[0], 2))
    for k, point in enumerate(points):
        lit, near = np.einsum("ni,ni->n", point, towards), np.einsum("ni,ni->n", point, frame.d)
        change = _middle((lit[:, None] * towards - point) / light.distance_mm / RAD, transmitted)
        for j, each in enumerate(carried):
            moved[:, j, k] = -np.einsum("ni,ni->n", each, change)
        level[:, k] = 3.0 * lit / light.distance_mm + accepted.nearer * near / instrument.arc_radius_mm
    moved[:, 0, 0] += accepted.turn_along / far
    moved[:, 1, 1] += accepted.turn_across / far
    level[:, 0] += accepted.turn_along / instrument.arc_radius_mm * frame.slope_n / frame.cos_n
    return _Seen(moved, level, accepted)


def _view_displacement(instrument: Instrument, frame: _Frame, seen: _Seen, views: Views) -> Displacement:
    """The inputs VIEW: what turns cone and disc together, and what moves the disc against the cone."""
    turned, disc = _view_moves(instrument, frame, views)
    moved = [turned[j] + np.einsum("nk,kni->ni", seen.moved[:, j], disc) for j in (0, 1)]
    return Displacement(moved[0], moved[1], np.zeros((frame.sign.size, len(VIEW))))


def _view_moves(instrument: Instrument, frame: _Frame, views: Views) -> tuple[Floats, Floats]:
    """The inputs VIEW along the arc and across it, (2, n, inputs): turns, deg a unit, and moves of the disc, mm a unit."""
    n, far = frame.sign.size, instrument.arc_radius_mm * RAD
    turned, disc = np.zeros((2, n, len(VIEW))), np.zeros((2, n, len(VIEW)))
    up = np.where(views.lower, -1.0, 1.0)
    turned[1, :, 0] = up * np.sin(views.polar)
    turned[0, :, 1] = frame.sign
    # w x d along the arc is w . (d x along).
    turned[:, :, 2:5] = np.cross(frame.d, frame.along), np.cross(frame.d, frame.across)
    disc[:, :, 5:8] = frame.along, frame.across
    # A sensor's own axes: along its arc, away from the upper normal, and across it, towards growing beta. They stay beyond the
    # pole, where "along" is towards growing polar angle.
    own = up * frame.sign
    turned[1, :, 8], turned[0, :, 9] = -own, own
    disc[:, :, 8:10] = -far * turned[:, :, 8:10]  # the disc stays where it was
    disc[0, :, 10], disc[1, :, 11] = own, own
    return turned, disc


def _lifted(instrument: Instrument, frame: _Frame, accepted: Acceptance, views: Views) -> Displacement:
    """A lift times each of ASIDE, (n, inputs): what a disc loses that is off already, of the sample and not of the etalon.

    To the first order a disc that is off, off alike for both, cancels; its product with the lift of one of them does not, and
    it is as large as the lift by itself.
    """
    _, disc = _view_moves(instrument, frame, views)
    way = disc[0][:, [VIEW.index(name) for name in ASIDE]]
    none = np.zeros_like(way)
    return Displacement(none, none, (accepted.bend * -frame.slope_n)[:, None] * way)


def _mounted(instrument: Instrument, frame: _Frame, seen: _Seen, views: Views, light: _Light, *, lobe: bool) -> Displacement:
    """The inputs MOUNTED of a sample with a lobe, or of the etalon, by which a value is divided."""
    n, towards, accepted = frame.sign.size, light.towards, seen.accepted
    gamma = np.radians(views.gamma_deg)
    c, s, none = np.cos(gamma), np.sin(gamma), np.zeros(n)
    # The normal's change for a turn about x' and about y'.
    tilted = np.stack([np.stack([s, -c, none], axis=1), np.stack([c, s, none], axis=1)], axis=1)
    at_light, at_view = (np.einsum("ni,nki->nk", each, tilted) for each in (towards, frame.d))
    along, across, diffuse = (np.zeros((n, len(MOUNTED))) for _ in range(3))
    diffuse[:, :2] = (at_light / towards[:, 2:] + (accepted.share / frame.cos_n)[:, None] * at_view) * RAD
    # A lift brings the spot nearer to the light and to the photodiode; seen from the spot, the disc moves along the arc.
    aside = -frame.slope_n
    diffuse[:, 2] = (
        (3.0 * towards[:, 2] - 1.0 / towards[:, 2]) / light.distance_mm
        + accepted.nearer * frame.cos_n / instrument.arc_radius_mm
        + aside * seen.level[:, 0]
    )
    if not lobe:
        return Displacement(along, across, -diffuse)
    change = np.zeros((n, len(MOUNTED), 3))
    # Reflected: 2 (dn . l) n + 2 (n . l) dn. Transmitted: straight through is where it was.
    change[:, :2] = 2.0 * towards[:, None, 2:] * tilted
    change[:, :2, 2] += 2.0 * at_light
    change[views.transmitted, :2] = 0.0
    lift = towards * towards[:, 2:]
    lift[:, 2] -= 1.0
    change[:, 2] = _middle(lift / light.distance_mm / RAD, views.transmitted)
    for j, (part, each) in enumerate(zip((along, across), _carried(frame, _middle(towards, views.transmitted)), strict=True)):
        part[:] = -np.einsum("ni,nki->nk", each, change)
        part[:, 2] += aside * seen.moved[:, j, 0]
    return Displacement(along, across, diffuse)


# The inputs.


def rig_inputs(table: UncertaintyTable) -> list[InputQuantity]:
    """The inputs LIGHT and VIEW."""
    return [quantity(input_named(name), table, name) for name in (*LIGHT, *VIEW)]


def mounting_inputs(table: UncertaintyTable, kind: str, mounting: str) -> list[InputQuantity]:
    """The inputs MOUNTED of a mounting of a `sample`, or of the `etalon`."""
    shared_by, names = "" if kind == SAMPLE else OF_ETALON, [f"{kind}_{each}" for each in MOUNTED]
    return [quantity(input_named(name), table, f"{name}@{mounting}", shared_by=shared_by) for name in names]


def lifted_inputs(table: UncertaintyTable, kind: str, mounting: str) -> list[InputQuantity]:
    """The products of the height of a mounting with each of ASIDE: of mean 0, and correlated with no other input."""
    height = mounting_inputs(table, kind, mounting)[MOUNTED.index("height")]
    others = {name: quantity(input_named(name), table, name) for name in ASIDE}
    return [
        InputQuantity(
            f"{kind}_height*{name}@{mounting}",
            f"mm {other.unit}",
            height.u * other.u,
            "normal",
            height.shared_by,
            f"{height.source}, {other.source}",
            height.twin,
            origin=max(height.origin, other.origin, key=ORIGINS.index),
        )
        for name, other in others.items()
    ]


def photodiode_inputs(table: UncertaintyTable, photodiode: int) -> list[InputQuantity]:
    """The own angles of a photodiode, along the arc and across it."""
    return [quantity(each, table, f"{each.name}[{photodiode}]") for each in (PHOTODIODE_ANGLE, PHOTODIODE_ACROSS)]


def position_input(table: UncertaintyTable, axis: str, move: int | str) -> InputQuantity:
    """The position of an axis after its move of this number or name, with the backlash where none is taken up."""
    position = quantity(POSITION, table, f"{POSITION.name}@{axis}#{move}")
    source = f"{position.source}, {table.source(BACKLASH)}" if table.u(BACKLASH) else position.source
    return replace(position, u=position_u_deg(table), source=source)


def position_u_deg(table: UncertaintyTable) -> float:
    """Standard uncertainty of an axis' position, deg."""
    return math.hypot(table.u(POSITION), table.u(BACKLASH))


def standard_uncertainties(inputs: list[InputQuantity]) -> Floats:
    """Their standard uncertainties (inputs,), each in its unit."""
    return np.array([each.u for each in inputs])


def moments(*parts: tuple[Displacement, Floats]) -> Floats:
    """Sums (n, 6) over inputs with standard uncertainties: products of along, across and diffuse; see `variance`."""
    total = np.zeros((parts[0][0].along.shape[0], 6))
    for part, u in parts:
        a, c, s = part.along * u, part.across * u, part.diffuse * u
        pairs = ((a, a), (c, c), (s, s), (a, c), (a, s), (c, s))
        for k, (one, other) in enumerate(pairs):
            total[:, k] += np.einsum("nk,nk->n", one, other)
    return total


def variance(sums: Floats, slope_along: Floats, slope_across: Floats) -> Floats:
    """Relative variance (n,) of values with these slopes, from `moments`."""
    a, c = slope_along, slope_across
    aa, cc, ss = sums[:, :3].T
    ac, as_, cs = sums[:, 3:].T
    found: Floats = np.maximum(a * a * aa + c * c * cc + ss + 2.0 * (a * c * ac + a * as_ + c * cs), 0.0)
    return found
