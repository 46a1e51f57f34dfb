"""The finite field of view: its correction, and what the slopes of the measured values add to the uncertainty.

Illuminated spot, exit pupil and a photodiode's acceptance make each value a mean over directions. The correction is that of a
lobe whose logarithm is locally a parabola (measurement_model/field.py), from the slopes of the measured values, which
measurement_model/slopes.py has. What is left has three parts: `field`, by the variance of the directions, which all values
share; `field_noise`, by the noise of the slopes; and `field_unresolved`, by neighbours too far apart. A value that is lost in
its noise is not corrected: the field's whole effect on it is within its `field_unresolved`. `second_order` is what an unknown
angle does where there is no slope, and `slope_unresolved` what it does by slopes that the neighbours do not resolve, with what
the correction lacks where nothing was measured across the arc.

See docs/decisions/0030-the-field-is-corrected.md.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from goniotwin.app.campaign.geometry.directions import is_lower, polar_from_zenith, scan_plane_deg
from goniotwin.app.campaign.measurement_model.field import correct_logarithm, directions_covariance
from goniotwin.app.campaign.measurement_model.slopes import MAX_DISTANCE_RAD, WINDOW, Directions, reach, slopes_of
from goniotwin.app.campaign.reduction.angles import aligned_displacement
from goniotwin.app.campaign.reduction.components import ADDED, DETECTED, INDEPENDENT, total_variance
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.rig import inputs as declared
from goniotwin.app.rig import nominal_instrument
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import Instrument
from goniotwin.twin.optics.geometry.coordinates import round_deg, signed_polar

CHUNK_POINTS = 20_000
"""Points processed together; more if they are of one wavelength and incidence."""
TENFOLD = math.log(10.0)
"""Difference of the logarithms of two neighbours from which on they do not resolve the lobe between them."""
CLEAR = 2.0
"""A value below so many of its detection limit is for the most part noise, whatever its slope is."""
PER_DEG = math.pi / 180.0
SMALLEST = 1e-12


def field_variance(instrument: Instrument) -> float:
    """Variance of the directions that one value averages over, along either axis about the specular direction, in rad^2.

    That of normal incidence and observation, without what cone and disc cut of the spot: it sets the neighbourhood of a value,
    and bounds what the field does to values that are lost in their noise.
    """
    pupil = (instrument.pupil_radius_mm / instrument.pupil_distance_mm) ** 2 / 4.0
    cone = math.tan(math.radians(0.5 * instrument.field_deg)) ** 2 / 4.0
    disc = (0.5 * instrument.detector_diameter_mm / instrument.arc_radius_mm) ** 2 / 4.0
    side = instrument.spot_side_mm**2 / 12.0
    near, far = 1.0 / instrument.arc_radius_mm, 1.0 / instrument.pupil_distance_mm
    return pupil + min(cone + side * far**2, disc + side * (near + far) ** 2)


def pose_variance_deg2(points: BsdfPoints, settings: ReductionSettings) -> Floats:
    """Variance (n, 2) of the angle between a value's nominal direction and its true one, along the arc and across it, deg^2.

    In the plane of incidence all tilts are one angle; these are their shares there, taken for both axes: the mirrors by their
    levers, the sample's tilt twice in reflected light and not at all in transmitted light.
    """
    table = settings.rig.uncertainty
    once = declared.ARC_TILT, declared.SENSOR_TILT, declared.SIGMA_ZERO, declared.SHIFT_ZERO, declared.PHOTODIODE_ANGLE
    shared = (
        2.0 * (1.0 + 4.0 + 9.0) / 16.0 * table.u(declared.MIRROR_TILT) ** 2
        + sum(table.u(each) ** 2 for each in once)
        + 2.0 * table.u(declared.POSITION) ** 2
    )
    total = shared + np.where(points.transmitted, 0.0, 4.0 * table.u(declared.SAMPLE_TILT) ** 2)
    return np.stack([total, total], axis=1)


def second_order(bent: Floats) -> Floats:
    """Mean square (n,) of half the sum of c_k p_k^2 over both axes, of p_k of variances V_k; `bent` (n, 2) has V_k c_k."""
    return np.asarray(0.5 * np.sum(bent**2, axis=1) + 0.25 * np.sum(bent, axis=1) ** 2)


@dataclass(frozen=True)
class FieldOfView:
    """What the field of view and the slopes do to values (n,). Relative; NaN where unknown.

    `correction` is added to the logarithm; slopes and `bend` (n, 2), second derivatives, are those of the corrected logarithm,
    per degree, along the arc and across it, `mixed` (n,) is the mixed derivative, and `unresolved` (n, 2) is the standard
    uncertainty of the slopes by neighbours that are too far apart. `noise` is that of the correction by the slopes' noise, with
    that of the known displacement; `departure` by neighbours that are too far apart; `limit` by what was not measured across
    the arc. `estimate`, in the values' unit, is the whole effect on a value that cannot be corrected; of one that is
    `alone`, between darker ones that do not show its lobe, it is a lower limit. `steep`: the directions nearby are too far
    apart for the slope, or there are none across the arc and the lobe need not be round.
    """

    correction: Floats
    slope: Floats
    bend: Floats
    mixed: Floats
    unresolved: Floats
    noise: Floats
    departure: Floats
    limit: Floats
    estimate: Floats
    steep: Flags
    alone: Flags

    @classmethod
    def of(
        cls,
        points: BsdfPoints,
        instrument: Instrument,
        *,
        round_lobe: bool = True,
        moved_deg: Floats | None = None,
        at_once: int = CHUNK_POINTS,
    ) -> Self:
        """Of points in any order, `at_once` together; NaN for those without a trusted value. `round_lobe` as in `slopes_of`.

        `moved_deg` (n, 2) is the displacement along the arc and across it for which the values will be corrected by the slopes.
        """
        n = points.bsdf.size
        correction, mixed, *errors = (np.full(n, np.nan) for _ in range(6))
        slope, bend, unresolved = (np.full((n, 2), np.nan) for _ in range(3))
        result = cls(correction, slope, bend, mixed, unresolved, *errors, *np.zeros((2, n), dtype=bool))
        chosen = np.flatnonzero(points.good)
        # Process per wavelength and incidence, in chunks, to bound memory.
        lights = np.stack([points.wavelength_nm[chosen], points.sigma_deg[chosen]])
        order = chosen[np.lexsort(lights)]
        changes = np.any(np.diff(lights[:, np.lexsort(lights)], axis=1) != 0.0, axis=0)
        begin = 0
        for end in [*(np.flatnonzero(changes) + 1).tolist(), order.size]:
            if end - begin >= at_once or end == order.size > begin:
                part = order[begin:end]
                moved = None if moved_deg is None else moved_deg[part]
                found = _evaluate(merge_directions(points.where(part)), instrument, moved, round_lobe=round_lobe)
                for name, column in vars(found).items():
                    getattr(result, name)[part] = column
                begin = end
        return result


@dataclass(frozen=True)
class MergedDirections:
    """Means of points of one direction and setting, in order along the arcs.

    `u_noise` decides whether a value is below its detection limit. `variance` is that of the part of which neighbouring values
    have errors of their own. `sigma` is in rad. `which` is the index of each point's mean, and
    `opposite` whether a point's own half plane is the one opposite to that of its direction's azimuth.
    """

    directions: Directions
    sigma: Floats
    transmitted: Flags
    bsdf: Floats
    u_noise: Floats
    variance: Floats
    which: Ints
    opposite: Flags

    def of_displacement(self, moved_deg: Floats) -> Floats:
        """By the derivatives of `Slopes` (m, 5), what is subtracted from logarithms for displaced points (n, 2)."""
        signed = np.where(self.opposite, -PER_DEG, PER_DEG)[:, None] * moved_deg
        a, c = (np.bincount(self.which, weights=each) / np.bincount(self.which) for each in signed.T)
        return np.stack([a, c, -0.5 * a * a, -0.5 * c * c, -a * c], axis=1)


def merge_directions(points: BsdfPoints) -> MergedDirections:
    """Average good points of the same direction."""
    plane = scan_plane_deg(points.azimuth_deg)
    signed = round_deg(signed_polar(polar_from_zenith(points.zenith_deg), points.azimuth_deg, plane))
    setting = (points.gamma_deg, points.back, points.transmitted, points.sigma_deg, points.wavelength_nm)
    keys = [signed, plane, *(round_deg(each) for each in setting)]
    order = np.lexsort(keys)
    changes = np.array([np.diff(each[order], prepend=np.nan) != 0.0 for each in keys])
    first = np.any(changes, axis=0)
    number = np.cumsum(first) - 1
    which = np.empty(order.size, dtype=np.int64)
    which[order] = number
    counts = np.bincount(which)
    start = order[first]
    p, a = np.radians(signed[start]), np.radians(plane[start])
    up = np.where(is_lower(points.zenith_deg[start]), -1.0, 1.0)
    sigma = np.radians(points.sigma_deg[start])
    # Specular direction or regular transmission: both have -sin sigma along x.
    x, z = -np.sin(sigma), np.where(points.transmitted[start], -1.0, 1.0) * np.cos(sigma)
    components = points.components
    noise, independent = (
        np.zeros(points.size) + total_variance({name: each for name, each in components.items() if name in names})
        for names in (ADDED | INDEPENDENT, INDEPENDENT)
    )
    return MergedDirections(
        directions=Directions(
            light=np.cumsum(np.any(changes[3:], axis=0))[first],
            setting=np.cumsum(np.any(changes[2:], axis=0))[first],
            plane=np.cumsum(np.any(changes[1:], axis=0))[first],
            polar=p,
            azimuth=a,
            up=up,
            middle=x * np.sin(p) * np.cos(a) + z * up * np.cos(p),
            along=x * np.cos(p) * np.cos(a) - z * up * np.sin(p),
            across=-up * x * np.sin(a),
        ),
        sigma=sigma,
        transmitted=points.transmitted[start],
        bsdf=np.bincount(which, weights=points.bsdf) / counts,
        u_noise=np.sqrt(np.bincount(which, weights=noise) / counts),
        variance=np.bincount(which, weights=independent) / counts**2,
        which=which,
        opposite=np.cos(np.radians(points.azimuth_deg - plane)) < 0.0,
    )


def _evaluate(values: MergedDirections, instrument: Instrument, moved_deg: Floats | None, *, round_lobe: bool) -> FieldOfView:
    """The correction and its parts, for each point of the `values`."""
    directions, n = values.directions, values.bsdf.size
    variance = field_variance(instrument)
    window = WINDOW * math.sqrt(variance)
    limit = DETECTED * values.u_noise
    light = values.bsdf > limit
    lit = directions if light.all() else directions.where(light)
    bsdf = values.bsdf[light]
    relative = (np.sqrt(values.variance[light]) / bsdf) ** 2
    slopes = slopes_of(lit, np.log(bsdf), relative, window, round_lobe=round_lobe)
    covariance = directions_covariance(instrument, lit, values.sigma[light], values.transmitted[light])
    correction = correct_logarithm(slopes, covariance)
    sensitivity = correction.sensitivity
    if moved_deg is not None:
        sensitivity = sensitivity + values.of_displacement(moved_deg)[light]
    noise = np.sqrt(slopes.noise(sensitivity, relative))
    of_slopes = [np.tile(one, (relative.size, 1)) for one in np.eye(2, correction.sensitivity.shape[1])]
    unresolved = np.stack([np.hypot(slopes.unresolved(each), slopes.limits(each)) for each in of_slopes], axis=1)

    def everywhere(column: Floats) -> Floats:
        result = np.full((n, *column.shape[1:]), np.nan)
        result[light] = column
        return result

    fitted = everywhere(slopes.first_along)
    unknown = ~np.isfinite(fitted)
    estimate = np.full(n, np.nan)
    if unknown.any():
        plain = slopes_of(directions, values.bsdf, values.variance, window)
        effect = np.abs(plain.second_along) + np.abs(plain.second_across)
        # A value with light next to one without, further apart than the field is wide: the shape of the lobe is unknown.
        alone = light & ~(reach(directions.plane, directions.polar, window, MAX_DISTANCE_RAD) <= window)
        estimate = np.where(unknown & ~alone, 0.5 * variance * effect, np.nan)
    # A neighbour below the detection limit is at most at that limit.
    logarithm = np.log(np.maximum(np.maximum(values.bsdf, limit), 1e-300))
    change = np.where(np.diff(directions.plane) == 0, np.diff(logarithm), 0.0)
    slope = np.abs(change) / np.maximum(np.diff(directions.polar), SMALLEST)
    step, slope = (np.maximum(np.append(each, 0.0), np.insert(each, 0, 0.0)) for each in (np.abs(change), slope))
    # What a lobe between two directions does is not known; it changes at least as much as from one to the other.
    slope, step = np.fmax(slope, everywhere(slopes.beside)), np.fmax(step, everywhere(slopes.step))
    steep = step > TENFOLD
    alone = steep & light & unknown
    unresolved = np.maximum(np.nan_to_num(everywhere(unresolved)), np.where(alone, slope, 0.0)[:, None])
    bent = 0.5 * variance * (slope**2 + 4.0 * slope**2 / np.maximum(step, SMALLEST))
    estimate = np.where(alone, values.bsdf * bent, estimate)
    steep[light] |= slopes.undecided() | slopes.unknown_across() | lit.beside_gap(window)
    steep |= unknown
    clear = values.bsdf > CLEAR * limit
    steep &= clear
    unresolved = np.where(clear[:, None], unresolved, 0.0)
    sign = np.where(values.opposite, -1.0, 1.0)[:, None]
    which = values.which
    return FieldOfView(
        correction=everywhere(correction.logarithm)[which],
        slope=sign * PER_DEG * everywhere(correction.gradient)[which],
        bend=PER_DEG**2 * everywhere(correction.bend)[which],
        mixed=PER_DEG**2 * everywhere(correction.mixed)[which],
        unresolved=PER_DEG * unresolved[which],
        noise=everywhere(noise)[which],
        departure=everywhere(slopes.unresolved(correction.sensitivity))[which],
        limit=everywhere(slopes.limits(correction.sensitivity))[which],
        estimate=estimate[which],
        steep=(steep & light)[which],
        alone=alone[which],
    )


def correct_field_of_view(points: BsdfPoints, settings: ReductionSettings, at_once: int = CHUNK_POINTS) -> BsdfPoints:
    """Correct the values for the finite field of view, and add slopes, flags, and the components of the uncertainty.

    With an alignment they are also corrected from the directions that they were measured in to the nominal ones. Values that
    cannot be corrected keep the flag `field`, but for those that are lost in their noise.
    """
    # Of a plane-symmetric sample the slope across is 0 in its plane; its lobe is as narrow across as it may be.
    round_lobe = settings.schedule.symmetry == "isotropic"
    aligned = None if settings.alignment is None else aligned_displacement(points, settings)
    moved = None if aligned is None else np.concatenate([aligned[0].along, aligned[0].across], axis=1)
    instrument = nominal_instrument(settings.rig)
    found = FieldOfView.of(points, instrument, round_lobe=round_lobe, moved_deg=moved, at_once=at_once)
    corrected = np.isfinite(found.correction)
    correction = np.where(corrected, found.correction, 0.0)
    slope, total = found.slope, correction
    unresolved = variance = pose_variance_deg2(points, settings)
    if aligned is not None and moved is not None:
        bend, variance = np.concatenate([found.bend, found.mixed[:, None]], axis=1), aligned[1]
        total = correction - aligned[0].diffuse[:, 0] + np.nan_to_num(displacement_effect(found.slope, bend, moved))
        slope = found.slope - found.bend * moved - found.mixed[:, None] * moved[:, ::-1]
        unresolved = variance + moved**2
    scaled = points.scaled(np.exp(total))
    bsdf = scaled.bsdf
    # With more variance of the directions in the field of view more had to be corrected.
    u_field = settings.rig.uncertainty.u(declared.FIELD_OF_VIEW)
    quantity = scaled.quantity.with_common(declared.FIELD_OF_VIEW.name, np.nan_to_num(-u_field * correction * bsdf))
    relative = {
        "field_noise": np.where(corrected, found.noise, 0.0) ** 2,
        "second_order": second_order(variance * np.nan_to_num(found.bend)),
        "slope_unresolved": np.sum(unresolved * np.nan_to_num(found.unresolved) ** 2, axis=1)
        + np.where(corrected, found.limit, 0.0) ** 2,
    }
    for name, each in relative.items():
        quantity = quantity.with_own(name, np.nan_to_num(each * bsdf**2))
    departure = np.where(corrected, found.departure * bsdf, found.estimate)
    quantity = quantity.with_own("field_unresolved", np.nan_to_num(departure) ** 2)
    known = corrected | (np.isfinite(found.estimate) & ~found.alone)
    return scaled.with_quantity(
        quantity,
        slope_along=slope[:, 0],
        slope_across=slope[:, 1],
        field_correction=correction,
    ).flagged({"field": points.good & ~known, "steep": found.steep})


def displacement_effect(slope: Floats, bend: Floats, moved: Floats) -> Floats:
    """What is added to the logarithms (n,) of values that were measured `moved` (n, 2), deg, from their nominal directions.

    `slope` (n, 2) and `bend` (n, 3), along, across and mixed, are those where they were measured.
    """
    first = np.sum(slope * moved, axis=1)
    return np.asarray(0.5 * np.sum(bend[:, :2] * moved**2, axis=1) + bend[:, 2] * moved[:, 0] * moved[:, 1] - first)
