"""What all values of a sample owe to the etalon and to the mountings: inputs of the measurement model that many values share.

Each function gives the effects of one family of inputs on points, or None where its uncertainty is 0. The pipeline makes the
component of each family from them, and a budget its named inputs. The errors of the etalon's certificate are uncorrelated
modes: a level, a slope over wavelength, one over the angle of observation, and what these leave, by entry of the table. An
error of the etalon is how much more light it gives than the certificate states: the values are lower by as much.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.reduction.etalon import ReductionSettings
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.polarisation import light_state
from goniotwin.app.campaign.reduction.spectrum import bandwidth_effects, stray_effects, wavelength_effects
from goniotwin.app.campaign.schedule.certificate import Certificate, known_angles
from goniotwin.app.campaign.uncertainty.effects import Dense, Effects, Group
from goniotwin.app.campaign.uncertainty.inputs import Input
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG

EffectsOf = Callable[[BsdfPoints, ReductionSettings], Effects | None]
ALL, FILE, RIG = "all values", "the certificate's file", "the rig file"


def certificate_effects(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """The certificate's modes, what its geometry leaves unknown, and what they leave, by entry."""
    certificate = settings.certificate
    incidence, polar = _incidence_deg(points), polar_from_zenith(points.zenith_deg)
    shared = {
        "level": (certificate.level, np.ones(points.size)),
        "wavelength": (certificate.wavelength, certificate.slope("wavelength_nm", points.wavelength_nm)),
        "angle": (certificate.angle, certificate.slope("zenith_deg", polar)),
        "geometry": (certificate.shape, shape_of(certificate.geometry, incidence, polar)),
    }
    dense = [
        _shared(f"certificate[{mode}]", u, -sensitivity, ALL, FILE, "certificate_level" if mode == "level" else "")
        for mode, (u, sensitivity) in shared.items()
        if u
    ]
    entries = _entries(points, certificate, incidence, polar)
    if not dense and entries is None:
        return None
    return Effects(points.bsdf, {}, () if entries is None else (entries,), dense)


def shape_of(geometry: str | None, incidence_deg: Floats, zenith_deg: Floats) -> Floats:
    """How far an etalon's deviation from the ideal diffuser, 1 at the normal, changes values that a geometry has scaled (n,).

    The deviation is e (p(incidence) + p(zenith)) with p = 3 cos - 2: it is reciprocal, and leaves the reflectance into (or
    from) all directions as it is. A certificate of a geometry knows the sum of the p of its angles; that of a diffuse side
    is 0.
    """
    if geometry is None:
        return np.zeros(zenith_deg.shape)
    known = math.fsum(_deviation(np.array(each)) for each in known_angles(geometry))
    return np.asarray(_deviation(incidence_deg) + _deviation(zenith_deg) - known)


def _deviation(angle_deg: Floats) -> Floats:
    return np.asarray(3.0 * np.cos(np.radians(angle_deg)) - 2.0)


def _entries(points: BsdfPoints, certificate: Certificate, incidence: Floats, polar: Floats) -> Group | None:
    """What the modes leave of the uncertainty at each value, shared by all values that are nearest to one entry."""
    if np.all(certificate.relative_uncertainty <= certificate.level):
        return None
    place = points.wavelength_nm, incidence, polar, points.azimuth_deg
    _, relative = certificate.interpolate(*place)
    left = np.sqrt(np.maximum(relative**2 - certificate.common_variance(points.wavelength_nm, polar), 0.0))
    member = certificate.nearest(*place)
    largest = float(np.max(certificate.relative_uncertainty))
    inputs = {
        number: _input(f"certificate[{certificate.entry(number)}]", largest, "the values nearest to an entry", FILE)
        for number in np.unique(member).tolist()
    }
    return Group("certificate", inputs, member[:, None], -(left / largest if largest else left)[:, None])


def etalon_age(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """The etalon's drift since its calibration."""
    u = settings.rig.uncertainty.etalon_age_per_year * settings.etalon_years
    return _of_all("etalon_age", u, points, "etalon_age_per_year")


def etalon_edge(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """Light that a diffuser loses at the edges of the frames: the certificate was measured with another spot."""
    return _of_all("etalon_edge", settings.rig.uncertainty.etalon_edge, points, "etalon_edge")


def mounting(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """What is another at each mounting, of the sample and of the etalon."""
    return _of_mountings("mounting", settings.rig.uncertainty.mounting, points, settings)


def uniformity(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """The place of the spot on the surface of the sample and of the etalon, at each mounting."""
    return _of_mountings("uniformity", settings.rig.uncertainty.uniformity, points, settings)


def repeatability(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """What is another each time a pose is reached again: of the row at the sample and of the row at the etalon."""
    u = settings.rig.uncertainty.repeatability if settings.repeatability is None else settings.repeatability
    if not u:
        return None
    source = RIG if settings.repeatability is None else "the repeats of this campaign"
    _, pose = np.unique(points.places, axis=0, return_inverse=True)
    words = [", ".join(f"{value:g}" for value in place) for place in points.places.tolist()]
    again = _occurrences(pose.ravel())
    at_sample = {k: f"{settings.sample} {words[k]}#{again[k]}" for k in range(len(words))}
    at_etalon = {number: f"{settings.schedule.etalon} {words[k]}" for k, number in enumerate(pose.ravel().tolist())}
    members = points.place.astype(np.int64), pose.ravel()[points.place]
    groups = [
        Group(
            "repeatability",
            {number: _input(f"repeatability@{name}", u, "a row", source, "repeatability") for number, name in names.items()},
            member[:, None],
            np.full((points.size, 1), sign),
        )
        for names, member, sign in zip((at_sample, at_etalon), members, (1.0, -1.0), strict=True)
    ]
    return Effects(points.bsdf, {}, groups, ())


def _occurrences(values: Ints) -> Ints:
    """How often each value has been there before it, from 1."""
    order = np.argsort(values, kind="stable")
    first = np.flatnonzero(np.diff(values[order], prepend=-1))
    result = np.empty(values.size, dtype=np.int64)
    result[order] = 1 + np.arange(values.size) - np.repeat(first, np.diff(first, append=values.size))
    return result


def polarisation(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """That the light is polarised, for a sample whose diattenuation the schedule states: without it this is not in u."""
    diattenuation = settings.schedule.diattenuation.get(settings.sample, 0.0)
    if not diattenuation:
        return None
    q, _ = light_state(settings.rig.light, points.sigma_deg)
    return Effects(points.bsdf, {}, (), [_shared("polarisation", diattenuation, q, "all values of the sample", "schedule", "")])


def _of_all(name: str, u: float, points: BsdfPoints, twin: str) -> Effects | None:
    if not u:
        return None
    return Effects(points.bsdf, {}, (), [_shared(name, u, np.full(points.size, -1.0), ALL, RIG, twin)])


def _of_mountings(name: str, u: float, points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    if not u:
        return None
    mounted = ((settings.sample, "all values of the sample", 1.0), (settings.schedule.etalon, ALL, -1.0))
    dense = [_shared(f"{name}@{of}#1", u, np.full(points.size, sign), shared_by, RIG, name) for of, shared_by, sign in mounted]
    return Effects(points.bsdf, {}, (), dense)


def _shared(name: str, u: float, sensitivity: Floats, shared_by: str, source: str, twin: str) -> Dense:
    return Dense([_input(name, u, shared_by, source, twin)], sensitivity[:, None])


def _input(name: str, u: float, shared_by: str, source: str, twin: str = "") -> Input:
    return Input(name, "1", u, "normal", shared_by, source, twin)


def _incidence_deg(points: BsdfPoints) -> Floats:
    """Incidence at the etalon that scales each point, from the normal of its lit side."""
    return np.minimum(points.sigma_deg, HALF_TURN_DEG - points.sigma_deg)


SHARED: Mapping[str, EffectsOf] = {
    "certificate": certificate_effects,
    "etalon_age": etalon_age,
    "etalon_edge": etalon_edge,
    "mounting": mounting,
    "uniformity": uniformity,
    "repeatability": repeatability,
    "wavelength": wavelength_effects,
    "bandwidth": bandwidth_effects,
    "monochromator_stray": stray_effects,
    "polarisation": polarisation,
}
"""Families of inputs that points share, each a component. None of them needs the points nearby."""
