"""The points of a row: formula 1 for each photodiode of an arc, with the flags of each value."""

import math

import numpy as np

from goniotwin.app.campaign.geometry.arcs import ArcView, arc_views
from goniotwin.app.campaign.geometry.directions import incidence_deg
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.readings import PoseKey, RowSignal, pose_key
from goniotwin.app.campaign.reduction.signals import EtalonRatio, Signal, divide_by_etalon
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.certificate import Certificate, constant_certificate
from goniotwin.app.rig import RigDescription
from goniotwin.arrays import Flags

ETALON_SIGNAL = 5.0
"""An etalon's signal below so many standard uncertainties is too low to divide by."""
BRIGHT = 20.0
"""A photodiode is dead if its signal at the etalon is too low but should be above so many standard uncertainties."""
DETECTED = 3.0
"""A sample's signal below so many standard uncertainties is lost in its noise."""
GRAZING_DEG = 85.0
"""Photodiodes at larger polar angles are not judged as dead."""


def live_points(rig: RigDescription, row: Row, sample: Signal, etalon: Signal) -> BsdfPoints:
    """The points of the upper arc in one row during a run: with the rig file's etalon, without signature, drift and field."""
    assert row.pose is not None
    none = np.zeros(len(sample.ratio), dtype=bool)
    table = rig.file.etalon
    certificate = constant_certificate(table.radiance_factor, table.relative_uncertainty)
    measured, reference = (RowSignal(row, each, none, none) for each in (sample, etalon))
    return _arc_points(rig, measured, arc_views(rig.file, row.pose)[0], reference, (None, None), certificate)


def row_points(
    rig: RigDescription,
    sample: RowSignal,
    etalon: dict[PoseKey, RowSignal],
    signature: dict[PoseKey, RowSignal],
    certificate: Certificate,
) -> list[BsdfPoints]:
    """The points of each arc whose photodiodes have a signal of the etalon."""
    row = sample.row
    assert row.pose is not None
    arcs = []
    for view in arc_views(rig.file, row.pose):
        pose = view.etalon_pose(row.pose)
        reference = etalon.get(pose_key(row, pose))
        if reference is not None:
            own = None if view.transmitted else signature.get(pose_key(row, row.pose))
            at_etalon = signature.get(pose_key(row, pose))
            arcs.append(_arc_points(rig, sample, view, reference, (own, at_etalon), certificate))
    return arcs


def _arc_points(
    rig: RigDescription,
    sample: RowSignal,
    view: ArcView,
    etalon: RowSignal,
    signature: tuple[RowSignal | None, RowSignal | None],
    certificate: Certificate,
) -> BsdfPoints:
    row, c, n = sample.row, view.channels, len(view.channels)
    assert row.pose is not None
    assert row.wavelength_nm is not None
    assert etalon.row.pose is not None
    gamma, sigma, beta, shift = row.pose
    incidence = incidence_deg(etalon.row.pose[1])
    factor, u_factor = certificate.interpolate(row.wavelength_nm, incidence, view.polar, view.azimuth)
    own, at_etalon = (None if each is None else each.signal for each in signature)
    ratio = divide_by_etalon(rig, sample.signal, etalon.signal, own, at_etalon, channels=c)
    # For transmitted light the mirror unit has another position at the etalon, and blocks other directions there.
    sigmas = {sigma, etalon.row.pose[1]}
    blocked = np.any([blocked_by_mirrors(rig.file, each, view.zenith, view.azimuth, gamma) for each in sigmas], axis=0)
    no_etalon = np.isfinite(ratio.etalon) & ~(ratio.etalon > ETALON_SIGNAL * np.sqrt(ratio.var_etalon))
    scale = np.where(no_etalon, np.nan, factor / math.pi)
    bsdf = ratio.value * scale
    u_bsdf = np.sqrt(ratio.variance * scale**2 + bsdf**2 * (ratio.relative_variance + u_factor**2))
    return BsdfPoints(
        wavelength_nm=np.full(n, row.wavelength_nm),
        sigma_deg=np.full(n, sigma),
        gamma_deg=np.full(n, gamma),
        beta_deg=np.full(n, beta),
        shift_deg=np.full(n, shift),
        photodiode=c,
        zenith_deg=view.zenith,
        azimuth_deg=view.azimuth,
        theta_deg=view.theta,
        phi_deg=view.phi,
        bsdf=bsdf,
        u_bsdf=u_bsdf,
        shadowed=blocked,
        clipped=ratio.clipped,
        no_etalon=no_etalon,
        dead=sample.dead[c] | etalon.dead[c] | _dead(ratio, view, no_etalon & ~blocked),
        uncertified=np.isnan(factor),
        drifted=sample.drifted[c] | etalon.drifted[c],
        under_range=np.isfinite(ratio.sample) & (ratio.sample < DETECTED * np.sqrt(ratio.var_sample)),
        back=np.full(n, view.back),
        transmitted=np.full(n, view.transmitted),
        signature=ratio.signature,
        mirrored=np.full(n, row.mirrored),
        u_field=np.full(n, np.nan),
    )


def _dead(ratio: EtalonRatio, view: ArcView, too_low: Flags) -> Flags:
    """The photodiodes without a signal of the etalon that should have one.

    Expected is the median of all photodiodes' signals over the cosines of their polar angles, times the photodiode's cosine.
    """
    cosine = np.cos(np.radians(view.polar))
    lit = (view.polar <= GRAZING_DEG) & (cosine > 0.0)
    brightness = float(np.nanmedian(np.where(lit, ratio.etalon / cosine, np.nan))) if lit.any() else 0.0
    dead: Flags = too_low & lit & (brightness * cosine > BRIGHT * np.sqrt(ratio.var_etalon))
    return dead
