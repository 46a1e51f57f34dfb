"""The finite field of view: the directions that one value is a mean of, and the correction of what that does to it.

Every ray from the exit pupil over the spot to a photodiode has an offset of its own, the observed direction less the mirrored
light's. C, the covariance of these offsets in the plane tangent at the nominal direction, follows from the rig's nominal
dimensions and from the pose. For a lobe whose logarithm is a parabola the mean over them is known exactly, and so is its
inverse: nothing but the parabola of the *measured* values is needed.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from goniotwin.app.campaign.measurement_model.slopes import Directions
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Instrument

LEAST_DETERMINANT = 0.25
"""Of I + C H: a lobe narrower than this is more of the field's making than the sample's, and is not corrected."""
MOST = math.log(2.0)
"""Largest modulus of a correction of ln y. A larger one is an extrapolation."""
POLAR_NODES = np.radians(np.linspace(0.0, 90.0, 19))
TURN_NODES = np.radians([0.0, 22.5, 45.0, 67.5])
SPOT_NODES = 16
DISTANCES = 48
CHORDS = 200


class Derivatives(Protocol):
    """First and second derivatives (n,) of a logarithm, along the arc and across it, per rad."""

    @property
    def first_along(self) -> Floats: ...
    @property
    def first_across(self) -> Floats: ...
    @property
    def second_along(self) -> Floats: ...
    @property
    def second_across(self) -> Floats: ...
    @property
    def mixed(self) -> Floats: ...


@dataclass(frozen=True)
class FieldCorrection:
    """What the field of view does (n,), and what is left without it.

    `logarithm` is to be added to ln y. `gradient` (n, 2) and `bend` (n, 2) are first and second derivatives of the corrected
    ln f, along and across, and `mixed` (n,) is its mixed derivative. `sensitivity` (n, 5), with the other sign, is the
    derivative of `logarithm` by those of ln y, in the order of `Slopes`. All are NaN where there is no correction.
    """

    logarithm: Floats
    gradient: Floats
    bend: Floats
    mixed: Floats
    sensitivity: Floats


def correct_logarithm(slopes: Derivatives, covariance: Floats) -> FieldCorrection:
    """The correction for directions of the `covariance` (n, 3): along, across, and of both, in rad^2.

    With gradient b and second derivatives H of ln y, and S = (1/C + H)^-1: ln f = ln y - 1/2 ln det(I + C H) - 1/2 b S b, the
    gradient of ln f is (I - H S) b, and its second derivatives are H - H S H. On one axis, with c = -H and q = 1 - C c, that is
    ln f = ln y - 1/2 ln q - C b^2 / (2 q), with the slope b / q and the second derivative -c / q.

    With the negative covariance it is the inverse: what the field adds to the logarithm of f, from the derivatives of ln f.
    """
    b1, b2, h1, h2, h12 = slopes.first_along, slopes.first_across, slopes.second_along, slopes.second_across, slopes.mixed
    c1, c2, c12 = covariance.T
    of_c, of_h = c1 * c2 - c12**2, h1 * h2 - h12**2
    trace = c1 * h1 + c2 * h2 + 2.0 * c12 * h12
    determinant = 1.0 + trace + of_c * of_h
    known = (determinant >= LEAST_DETERMINANT) & (trace > -2.0)
    one = 1.0 / np.where(known, determinant, np.nan)
    s1, s2, s12 = (c1 + of_c * h2) * one, (c2 + of_c * h1) * one, (c12 - of_c * h12) * one
    g1, g2 = s1 * b1 + s12 * b2, s12 * b1 + s2 * b2
    logarithm = 0.5 * np.log(one) - 0.5 * (b1 * g1 + b2 * g2)
    sensitivity = np.stack([g1, g2, 0.5 * (s1 - g1**2), 0.5 * (s2 - g2**2), s12 - g1 * g2], axis=1)
    gradient = np.stack([b1 - h1 * g1 - h12 * g2, b2 - h12 * g1 - h2 * g2], axis=1)
    bend = np.stack(
        [
            h1 - (h1 * (s1 * h1 + s12 * h12) + h12 * (s12 * h1 + s2 * h12)),
            h2 - (h12 * (s1 * h12 + s12 * h2) + h2 * (s12 * h12 + s2 * h2)),
        ],
        axis=1,
    )
    mixed = h12 - (h1 * (s1 * h12 + s12 * h2) + h12 * (s12 * h12 + s2 * h2))
    logarithm = np.where(np.abs(logarithm) <= MOST, logarithm, np.nan)
    return FieldCorrection(logarithm, gradient, bend, mixed, sensitivity)


def directions_covariance(instrument: Instrument, directions: Directions, sigma: Floats, transmitted: Flags) -> Floats:
    """Covariance (n, 3) of the directions that a value is a mean of: along, across, and of both, in rad^2.

    `sigma` (n,), in rad, is the rig's. The instrument is at its nominal position. A ray from the place s of the spot meets a
    photodiode under the slope k to its axis: the cone limits k, and the disc R k + s. The pupil's image is at the distance L,
    so that the light's direction changes by -s / L over the spot, and by the ray's own place in the pupil. Turning the mirrored
    light one way does what turning the observer the other way does.
    """
    cos_a, sin_a = np.cos(directions.azimuth), np.sin(directions.azimuth)
    cos_p, sin_p, up = np.cos(directions.polar), np.sin(directions.polar), directions.up
    cos_s, sin_s = np.cos(sigma), np.sin(sigma)
    sign = np.where(transmitted, -1.0, 1.0)
    along = np.stack([cos_p * cos_a, cos_p * sin_a, -up * sin_p])
    across = np.stack([-up * sin_a, up * cos_a, np.zeros_like(up)])
    centre = np.stack([-sin_s, np.zeros_like(up), sign * cos_s])
    # The offset from a turn of the mirrored light by a small vector o is (o . across, -o . along): for a place s of the spot
    # o = sign (-s_x cos(sigma) y + s_y e) / L, e = (cos(sigma), 0, sign sin(sigma)).
    far = sign / instrument.pupil_distance_mm
    across_e, along_e = cos_s * across[0] + sign * sin_s * across[2], cos_s * along[0] + sign * sin_s * along[2]
    of_x = far * np.stack([-cos_s * across[1], cos_s * along[1]])
    of_y = far * np.stack([across_e, -along_e])
    # In the spot's coordinates towards the photodiode, 1, and at right angles, 2.
    of_1, of_2 = cos_a * of_x + sin_a * of_y, -sin_a * of_x + cos_a * of_y
    polar = np.abs(directions.polar)
    slopes, with_places, places = (
        (np.interp(polar, POLAR_NODES, along), np.interp(polar, POLAR_NODES, across))
        for along, across in acceptance_moments(instrument).reshape(3, 2, -1)
    )
    (k1, k2), (k1_1, k2_2), (spot_1, spot_2) = slopes, with_places, places
    k2_2 = up * k2_2  # across the lower arc is the other way
    pupil = (instrument.pupil_radius_mm / instrument.pupil_distance_mm) ** 2 / 4.0
    a, c = np.sum(across * centre, axis=0), np.sum(along * centre, axis=0)
    return np.stack(
        [
            k1 + 2.0 * of_1[0] * k1_1 + of_1[0] ** 2 * spot_1 + of_2[0] ** 2 * spot_2 + pupil * (1.0 - a**2),
            k2 + 2.0 * of_2[1] * k2_2 + of_1[1] ** 2 * spot_1 + of_2[1] ** 2 * spot_2 + pupil * (1.0 - c**2),
            of_1[1] * k1_1 + of_2[0] * k2_2 + of_1[0] * of_1[1] * spot_1 + of_2[0] * of_2[1] * spot_2 + pupil * a * c,
        ],
        axis=1,
    )


@lru_cache(maxsize=8)
def acceptance_moments(instrument: Instrument) -> Floats:
    """Second moments (6, polar angles) of slopes and places that a photodiode accepts, at POLAR_NODES.

    Slopes k along and across, k with the place in the spot in each of both directions, mm, and the places towards the
    photodiode and at right angles, mm^2. Mean over all turns of the square spot against the photodiode's half plane.
    """
    half, radius = 0.5 * instrument.spot_side_mm, 0.5 * instrument.detector_diameter_mm
    cone = instrument.arc_radius_mm * math.tan(math.radians(0.5 * instrument.field_deg))
    distance = np.linspace(0.0, 1.5 * half, DISTANCES)
    common = np.array([_common_area(float(each), cone, radius) for each in distance])
    nodes, weights = np.polynomial.legendre.leggauss(SPOT_NODES)
    x, y = (each.ravel() for each in np.meshgrid(half * nodes, half * nodes))
    weight = np.outer(weights, weights).ravel()
    total = np.zeros((7, POLAR_NODES.size))
    for turn in TURN_NODES.tolist():
        towards, aside = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
        for n, polar in enumerate(POLAR_NODES.tolist()):
            seen = towards * math.cos(polar)
            away = np.hypot(seen, aside)
            area, first, own, other = (weight * np.interp(away, distance, each) for each in common.T)
            share = np.where(away > 0.0, 1.0 / np.maximum(away, 1e-12), 0.0)
            cos2, sin2 = (seen * share) ** 2, (aside * share) ** 2
            total[:, n] += [
                float(np.sum(each))
                for each in (
                    own * cos2 + other * sin2,
                    own * sin2 + other * cos2,
                    first * seen * share * towards,
                    first * aside * share * aside,
                    area * towards**2,
                    area * aside**2,
                    area,
                )
            ]
    moments = total[:6] / total[6]
    moments[:4] /= instrument.arc_radius_mm
    moments[:2] /= instrument.arc_radius_mm
    return np.asarray(moments)


def _common_area(away: float, cone: float, radius: float) -> tuple[float, float, float, float]:
    """Of rays that leave at `away`, mm, from the axis and meet the disc within the cone, in the disc's plane: the area.

    And its moments about the ray parallel to the axis: first and second away from the axis, and second at right angles.
    """
    low, high = max(-cone, -radius - away), min(cone, radius - away)
    if low >= high:
        return 0.0, 0.0, 0.0, 0.0
    # The area's ends are those of a circle: nodes like the cosine take their square roots.
    angle = (np.arange(CHORDS) + 0.5) * (math.pi / CHORDS)
    x = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(angle)
    width = 0.5 * (high - low) * np.sin(angle) * (math.pi / CHORDS)
    chord = np.sqrt(np.maximum(np.minimum(cone**2 - x**2, radius**2 - (x + away) ** 2), 0.0))
    sums = (2.0 * chord, 2.0 * chord * x, 2.0 * chord * x**2, chord**3 / 1.5)
    area, first, own, other = (float(np.sum(width * each)) for each in sums)
    return area, first, own, other
