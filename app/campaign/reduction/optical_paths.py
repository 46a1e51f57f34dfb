"""The optical paths of a value: the sample's light, and that of each standard with its share in the scale.

A value is S / sum_k w_k (E_k / rho_k): the light of the sample over the mean of that of the standards, each over its certified
radiance factor. So its logarithm changes by 1 with the sample's light and by -w_k with that of a standard. The shares are those
of the least variance by what each standard has alone: certificate, age, and what every mounting has.
"""

from typing import NamedTuple

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import OpticalPath, ReductionSettings
from goniotwin.app.rig.inputs import ETALON_AGE, ETALON_EDGE, MOUNTING, REPEATABILITY, UNIFORMITY
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG
from goniotwin.twin.plant.disturbances import ETALON, SAMPLE, SECOND

OF_MOUNTING = (ETALON_EDGE, MOUNTING, UNIFORMITY, REPEATABILITY)


class PathOfPoints(NamedTuple):
    """A path of points: its `kind`, the `rows` (n,) in which its light was read, and its `weight` (n,) in the logarithm.

    `piece` is what gives the light: of a second standard that is the etalon, turned, this.
    """

    kind: OpticalPath
    piece: OpticalPath
    rows: Ints
    weight: Floats


def paths_of_points(points: BsdfPoints, settings: ReductionSettings) -> list[PathOfPoints]:
    """The paths of points, their own first. The etalon's own points have the etalon's."""
    ones = np.ones(points.size)
    own: OpticalPath = ETALON if settings.sample == settings.schedule.etalon else SAMPLE
    if settings.second is None:
        return [PathOfPoints(own, own, points.row, ones), PathOfPoints(ETALON, ETALON, points.etalon_row, -ones)]
    share = share_of_points(points, settings)
    piece: OpticalPath = ETALON if settings.second.turned else SECOND
    rows = np.where(points.second_row < 0, points.etalon_row, points.second_row)
    return [
        PathOfPoints(own, own, points.row, ones),
        PathOfPoints(ETALON, ETALON, points.etalon_row, share - 1.0),
        PathOfPoints(SECOND, piece, rows, -share),
    ]


def share_of_points(points: BsdfPoints, settings: ReductionSettings) -> Floats:
    """The share (n,) of the second standard in the scale of points; 0 where it has none."""
    if settings.second is None:
        return np.zeros(points.size)
    polar = polar_from_zenith(points.zenith_deg)
    share = second_share(settings, points.wavelength_nm, incidence_deg(points), polar, points.azimuth_deg)
    return np.where(points.second_row < 0, 0.0, share)


def incidence_deg(points: BsdfPoints) -> Floats:
    """Incidence at the standards that scale each point, from the normal of their lit side."""
    return np.minimum(points.sigma_deg, HALF_TURN_DEG - points.sigma_deg)


def second_share(
    settings: ReductionSettings, wavelength_nm: Floats, incidence_deg: Floats, polar_deg: Floats, azimuth_deg: Floats
) -> Floats:
    """The share of the second standard in the scale at directions; 0 where its certificate has no value."""
    second, table = settings.second, settings.rig.uncertainty
    assert second is not None
    known, relative = second.certificate.interpolate(wavelength_nm, incidence_deg, polar_deg, azimuth_deg)
    if second.share is not None or second.turned:
        return np.where(np.isfinite(known), 0.5 if second.share is None else second.share, 0.0)
    _, of_etalon = settings.certificate.interpolate(wavelength_nm, incidence_deg, polar_deg, azimuth_deg)
    mounted = sum(table.u(each) ** 2 for each in OF_MOUNTING)
    age = table.u(ETALON_AGE)
    own = np.nan_to_num(of_etalon) ** 2 + (age * settings.etalon_years) ** 2 + mounted
    others = relative**2 + (age * second.years) ** 2 + mounted
    total = np.where(own + others > 0.0, own + others, 1.0)
    return np.where(np.isfinite(known), np.where(own + others > 0.0, own / total, 0.5), 0.0)
