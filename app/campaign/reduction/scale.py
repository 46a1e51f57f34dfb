"""What all values of a sample owe to the etalon and to the mountings: inputs of the measurement model that many values share.

Each function gives the effects of one family of inputs on points, or None where its uncertainty is 0; one of them serves all
declared factors on the light of sample and etalon. The pipeline makes the component of each family from them, and a budget its
named inputs. The errors of the etalon's certificate are uncorrelated modes: a level, a slope over wavelength, one over the
angle of observation, and what these leave, by entry of the table. An error of the etalon is how much more light it gives than
the certificate states: the values are lower by as much.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.measurement_model.effects import Dense, Effects, Group, dense_of
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity, quantity
from goniotwin.app.campaign.measurement_model.lit_share import SLIT_IMAGE
from goniotwin.app.campaign.measurement_model.pose import OF_ETALON
from goniotwin.app.campaign.reduction.lit_hole import (
    correct_slit_image,
    deviate_by_modes,
    interval_by_modes,
    slit_image_effects,
)
from goniotwin.app.campaign.reduction.optical_paths import incidence_deg, paths_of_points, share_of_points
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.polarisation import light_state
from goniotwin.app.campaign.reduction.settings import OpticalPath, ReductionSettings, mounted
from goniotwin.app.campaign.reduction.spectrum import bandwidth_effects, stray_effects, wavelength_effects
from goniotwin.app.campaign.schedule.certificate import Certificate
from goniotwin.app.rig.file import known_angles
from goniotwin.app.rig.inputs import CERTIFICATE_LEVEL, MONOCHROMATOR_STRAY, SECOND_LEVEL, WAVELENGTH, Input, factors
from goniotwin.arrays import Floats, Ints
from goniotwin.keys import MEASURED, STATED, Origin, origin_of
from goniotwin.twin.optics.geometry.coordinates import round_deg
from goniotwin.twin.plant.disturbances import ETALON, LIGHT, SAMPLE, SECOND, SharedBy

EffectsOf = Callable[[BsdfPoints, ReductionSettings], Effects | None]
ALL, FILE, RIG_FILE = "all values", "the certificate's file", "[etalon] relative_uncertainty"
STANDARDS = "standards"
"""The component of two standards that do not agree."""
OF_SECOND = "[second_standard] of the schedule"


def certificate_effects(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """The modes of each standard's certificate, what its geometry leaves unknown, and what they leave, by entry."""
    weights: dict[str, Floats] = {}
    for path in paths_of_points(points, settings):
        if path.piece != SAMPLE:
            weights[path.piece] = weights.get(path.piece, 0.0) + path.weight
    by_certificate = _by_certificate(points, settings)
    source, origin = FILE, STATED
    if settings.schedule.certificate is None:
        source, origin = RIG_FILE, origin_of(settings.rig.etalon.relative_uncertainty)
    stated = [("certificate", settings.certificate, weights[ETALON], source, CERTIFICATE_LEVEL.key, origin)]
    if settings.second is not None and SECOND in weights:
        weight = weights[SECOND]
        stated.append(("second_certificate", settings.second.certificate, weight, OF_SECOND, SECOND_LEVEL.key, STATED))
    parts = [
        _certificate_modes(points, name, of, -weight * by_certificate, source, twin, origin)
        for name, of, weight, source, twin, origin in stated
    ]
    groups, dense = [group for each, _ in parts for group in each], [one for _, each in parts for one in each]
    return Effects(points.bsdf, {}, groups, dense) if groups or dense else None


def _certificate_modes(
    points: BsdfPoints, name: str, certificate: Certificate, scaled: Floats, source: str, twin: str, origin: Origin
) -> tuple[list[Group], list[Dense]]:
    """The modes of a certificate that scales points in so far (n,)."""
    incidence, polar = incidence_deg(points), polar_from_zenith(points.zenith_deg)
    shared = {
        "level": (certificate.level, np.ones(points.size)),
        "wavelength": (certificate.wavelength, certificate.slope("wavelength_nm", points.wavelength_nm)),
        "angle": (certificate.angle, certificate.slope("zenith_deg", polar)),
        "geometry": (certificate.shape, shape_of(certificate.geometry, incidence, polar)),
    }
    dense = [
        _shared(f"{name}[{mode}]", u, -sensitivity * scaled, ALL, source, twin if mode == "level" else "", origin)
        for mode, (u, sensitivity) in shared.items()
        if u
    ]
    entries = _entries(points, name, certificate, incidence, polar, scaled)
    return [] if entries is None else [entries], dense


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


def _entries(
    points: BsdfPoints, name: str, certificate: Certificate, incidence: Floats, polar: Floats, scaled: Floats
) -> Group | None:
    """What the modes leave of the uncertainty at each value, shared by all values that are nearest to one entry."""
    if np.all(certificate.relative_uncertainty <= certificate.level):
        return None
    place = points.wavelength_nm, incidence, polar, points.azimuth_deg
    _, relative = certificate.interpolate(*place)
    relative = np.where(scaled == 0.0, 0.0, relative)
    left = np.sqrt(np.maximum(relative**2 - certificate.common_variance(points.wavelength_nm, polar), 0.0))
    member = certificate.nearest(*place)
    largest = float(np.max(certificate.relative_uncertainty))
    inputs = {
        number: _input(f"{name}[{certificate.entry(number)}]", largest, "the values nearest to an entry", FILE)
        for number in np.unique(member).tolist()
    }
    return Group(name, inputs, member[:, None], -(scaled * left / largest)[:, None])


def open_beam(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """The scale of the open beam, which takes the place of certificate, age and edge where it scales transmitted light."""
    member = _beam_scale(points, settings)
    if not np.any(member >= 0):
        return None
    scales = list(settings.absolute.items())
    inputs = {
        k: _input(
            f"open_beam[{nm:g} nm, sigma {sigma:g}]{'@lower' if lower else ''}",
            scale.u,
            "all values that it scales",
            "the scan",
            origin=MEASURED,
        )
        for k, ((nm, sigma, lower), scale) in enumerate(scales)
    }
    return Effects(points.bsdf, {}, [Group("open_beam", inputs, member[:, None], np.ones((points.size, 1)))], ())


def _beam_scale(points: BsdfPoints, settings: ReductionSettings) -> Ints:
    """Which of the open beam's scales holds for each point (n,), by its place in `settings.absolute`; -1 for none."""
    member = np.full(points.size, -1, dtype=np.int64)
    if settings.absolute and points.transmitted.any():
        keys = round_deg(np.stack([points.wavelength_nm, incidence_deg(points)], axis=1))
        for k, (nm, sigma, lower) in enumerate(settings.absolute):
            at = (keys[:, 0] == nm) & (keys[:, 1] == sigma)
            member[at & points.transmitted & (points.back != lower)] = k
    return member


def slit_image(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """What the place of the slit's image does to transmitted light."""
    return slit_image_effects(points, settings, _beam_scale(points, settings) >= 0)


def state_interval(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """Correct transmitted light for the place of the slit's image, if an alignment knows it, and state the interval.

    The place gives it another law than the normal one.
    """
    points = correct_slit_image(points, settings, _beam_scale(points, settings) >= 0)
    found = slit_image(points, settings)
    return points if found is None else interval_by_modes(points, found, settings)


def deviate_of_sum(points: BsdfPoints, weight: Floats, u: float, error: float, settings: ReductionSettings) -> float:
    """The normal deviate that has the probability of an `error` of sum(weight * bsdf), whose standard uncertainty is `u`.

    Of a normal law it is the error over u; what the place of the slit's image does to transmitted light has another.
    """
    found = slit_image(points, settings)
    return error / u if found is None else deviate_by_modes(found, weight, u, error, settings)


def _by_certificate(points: BsdfPoints, settings: ReductionSettings) -> Floats:
    """1 (n,) where the etalon's certificate scales a point, 0 where the open beam does."""
    return (_beam_scale(points, settings) < 0).astype(float)


def factor_effects(each: Input, points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """A declared factor on the light of sample, of standards, or of several.

    A value divides by the standards. Where the open beam is the scale, this was divided by the etalon too, and the value has
    its factor once more, with the other sign.
    """
    if not settings.rig.uncertainty.u(each):
        return None
    kinds = [(path.kind, path.rows, path.weight) for path in paths_of_points(points, settings)]
    if settings.absolute:
        of_beam = _beam_scale(points, settings)
        rows = np.array([*(scale.etalon_row for scale in settings.absolute.values()), 0])[of_beam]
        kinds.append((ETALON, np.where(of_beam < 0, points.etalon_row, rows), (of_beam >= 0).astype(float)))
    inputs: dict[str, InputQuantity] = {}
    member, sensitivity = [], []
    for kind, rows, signs in kinds:
        if path_of_factor(each, kind, settings) in each.paths and (not each.per_year or _years(kind, settings)):
            found, which = factor_quantities(each, kind, rows, settings)
            for one in found:
                inputs.setdefault(one.name, one)
            numbers = {name: k for k, name in enumerate(inputs)}
            member.append(np.array([numbers[one.name] for one in found])[which])
            sensitivity.append(signs)
    if not member:
        return None
    group = Group(each.name, dict(enumerate(inputs.values())), np.stack(member, axis=1), np.stack(sensitivity, axis=1))
    many = each.shared_by is SharedBy.MOVE
    return Effects(points.bsdf, {}, [group] if many else (), () if many else [dense_of(group)])


def factor_quantities(
    each: Input, kind: OpticalPath, rows: Ints, settings: ReductionSettings
) -> tuple[list[InputQuantity], Ints]:
    """The quantities of a declared factor on the light of sample or standard in rows (n,), and which of them each row has."""
    table, history = settings.rig.uncertainty, settings.history
    light = LIGHT[path_of_factor(each, kind, settings)]
    names = [name for name, targets in each.targets.items() if light in targets]
    which = np.zeros(rows.size, dtype=np.int64)
    if each.shared_by is SharedBy.MOUNTING:
        mountings, which = mounted(kind, rows, settings)
        names = [f"{each.name}@{name}" for name in mountings]
    elif each.shared_by is SharedBy.MOVE:
        moves, which = np.unique(rows if history is None else np.sum(history.moves(rows), axis=1), return_inverse=True)
        names = [f"{each.name}@#{k}" for k in moves.tolist()]
    words = OF_ETALON if kind != SAMPLE and each.shared_by is SharedBy.MOUNTING else ""
    years = _years(kind, settings) if each.per_year else 1.0
    return [quantity(each, table, name, shared_by=words, times=years) for name in names], which.ravel()


def path_of_factor(each: Input, kind: OpticalPath, settings: ReductionSettings) -> str:
    """The path of whose light a factor is one, for light of a kind.

    A second standard is mounted as an etalon is, and is a piece of its own, if it is not the etalon itself.
    """
    if kind != SECOND or each.shared_by is not SharedBy.ALL:
        return SAMPLE if kind == SAMPLE else ETALON
    return ETALON if settings.second is not None and settings.second.turned else SECOND


def _years(kind: OpticalPath, settings: ReductionSettings) -> float:
    """Years since the calibration of a standard."""
    return settings.second.years if kind == SECOND and settings.second is not None else settings.etalon_years


def standards(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """That two standards are apart by more than chance explains.

    Half of the difference where both have the same share: a value is off by the share of the one that is wrong, and that may
    be either.
    """
    if settings.second is None or not settings.second.difference:
        return None
    share = share_of_points(points, settings)
    off = np.sqrt(2.0 * (share**2 + (1.0 - share) ** 2)) * _by_certificate(points, settings)
    u = 0.5 * abs(settings.second.difference)
    return Effects(
        points.bsdf, {}, (), [_shared(STANDARDS, u, off, ALL, "the two standards of this campaign", origin=MEASURED)]
    )


def polarisation(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """That the light is polarised, for a sample whose diattenuation the schedule states: without it this is not in u."""
    if not any(settings.schedule.diattenuation.values()):
        return None
    names, which = mounted("sample", points.row, settings)
    of_mounting = [name.rpartition("#")[0] for name in names]
    q, _ = light_state(settings.rig.light, points.sigma_deg)
    dense = []
    for sample, u in settings.schedule.diattenuation.items():
        here = np.isin(which, [k for k, each in enumerate(of_mounting) if each == sample])
        if u and here.any():
            source = "the schedule, diattenuation"
            dense.append(_shared(f"polarisation@{sample}", u, np.where(here, q, 0.0), "all values of the sample", source))
    return Effects(points.bsdf, {}, (), dense) if dense else None


def _shared(
    name: str, u: float, sensitivity: Floats, shared_by: str, source: str, twin: str = "", origin: Origin = STATED
) -> Dense:
    return Dense([_input(name, u, shared_by, source, twin, origin)], sensitivity[:, None])


def _input(name: str, u: float, shared_by: str, source: str, twin: str = "", origin: Origin = STATED) -> InputQuantity:
    return InputQuantity(name, "1", u, "normal", shared_by, source, twin and f"disturbances.{twin}", origin=origin)


def shared_families() -> dict[str, EffectsOf]:
    """Families of inputs that points share, by component. None of them needs the points nearby, or a signal."""
    return {
        "certificate": certificate_effects,
        **{each.name: partial(factor_effects, each) for each in factors()},
        STANDARDS: standards,
        "open_beam": open_beam,
        SLIT_IMAGE: slit_image,
        WAVELENGTH.name: wavelength_effects,
        "bandwidth": bandwidth_effects,
        MONOCHROMATOR_STRAY.name: stray_effects,
        "polarisation": polarisation,
    }
