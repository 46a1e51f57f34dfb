"""The reduction: from a journal's counts to the BSDF at each direction, with its standard uncertainty.

f = (sample over monitor) / (etalon over monitor) * f of the etalon's certificate (the paper's formula 1, in 1/sr), each
photodiode against itself. The uncertainty is from four parts: dark and noise, monitor, gain, etalon.
"""

import math
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from app.campaign.journal import Journal
from app.campaign.row import Row
from app.campaign.schedule import parse_schedule
from app.campaign.shadow import shadowed
from app.campaign.signals import Signal, darks_by_gain, signal
from app.errors import UserError
from app.rig import RigDescription, parse_rig, photodiode_settings
from twin.optics import arc_direction, to_specular

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
ETALON_SIGNAL = 5.0
"""An etalon's signal below so many standard uncertainties is none: there is nothing to divide by."""


@dataclass(frozen=True)
class BsdfPoints:
    """A BSDF at the directions in which it was measured; arrays of one length, a point each.

    Angles in degrees: `zenith` and `azimuth` of the observation in the rig's frame, `theta` and `phi` about the specular
    direction. `bsdf` and its standard uncertainty `u_bsdf` in 1/sr; NaN where there is no value, and then a flag says
    why. A shadowed point has a value where there was light, but what it says of the sample is not to be trusted.
    """

    wavelength_nm: Floats
    sigma_deg: Floats
    gamma_deg: Floats
    beta_deg: Floats
    shift_deg: Floats
    photodiode: npt.NDArray[np.int64]
    zenith_deg: Floats
    azimuth_deg: Floats
    theta_deg: Floats
    phi_deg: Floats
    bsdf: Floats
    u_bsdf: Floats
    shadowed: Flags
    clipped: Flags
    no_etalon: Flags

    def where(self, chosen: Flags) -> "BsdfPoints":
        """Some of the points."""
        return BsdfPoints(*(getattr(self, field.name)[chosen] for field in fields(self)))

    @property
    def good(self) -> Flags:
        """Which have a value that may be trusted."""
        return np.isfinite(self.bsdf) & ~self.shadowed

    @property
    def luminance_factor(self) -> Floats:
        """pi times the BSDF: 1 for the ideal diffuser."""
        return math.pi * self.bsdf


@dataclass(frozen=True)
class Reduced:
    """What a journal comes to: points by sample, and whether they are simulated."""

    name: str
    rig: RigDescription
    simulated: bool
    samples: dict[str, BsdfPoints]


def reduce_journal(journal: Journal) -> Reduced:
    """All samples of a journal, as far as it goes. Raises UserError for one that has too little in it."""
    rig = parse_rig(journal.value("rig"), Path(), f"{journal.path} (rig)")
    schedule = parse_schedule(journal.value("schedule"), f"{journal.path} (schedule)").file
    settings = photodiode_settings(rig.file)
    rows = list(journal.rows())
    darks = darks_by_gain(rows, settings)
    measured = [each for each in rows if each.row.kind == "measure"]
    try:
        signals = {each.row.identity: (each.row, signal(each.data, darks, settings)) for each in measured}
    except UserError as error:
        raise UserError(f"{journal.path}: {error}") from None
    etalon = {_pose_key(row): found for row, found in signals.values() if row.sample == schedule.etalon}
    if not etalon:
        raise UserError(f"{journal.path}: the etalon has not been measured yet, so there is nothing to compare with")
    samples = {}
    for sample in schedule.samples:
        blocks = [
            row_points(rig, row, found, etalon[_pose_key(row)])
            for row, found in signals.values()
            if row.sample == sample and _pose_key(row) in etalon
        ]
        if blocks:
            samples[sample] = _joined(blocks)
    return Reduced(journal.value("name"), rig, journal.simulated, samples)


def _pose_key(row: Row) -> tuple[object, ...]:
    return (row.wavelength_nm, row.pose)


def row_points(rig: RigDescription, row: Row, sample: Signal, etalon: Signal) -> BsdfPoints:
    """The upper arc's photodiodes in one row: reflection of the front side."""
    assert row.pose is not None
    assert row.wavelength_nm is not None
    file = rig.file
    settings = photodiode_settings(file)
    upper = len(settings.upper_deg)
    gamma, sigma, beta, shift = row.pose
    zenith = np.array(settings.upper_deg) + shift
    azimuth = np.full(upper, beta)
    # The arc at a zenith below 0 looks at the other side of the normal.
    azimuth = np.mod(np.where(zenith < 0.0, azimuth + 180.0, azimuth), 360.0)
    zenith = np.abs(zenith)
    theta, phi = to_specular(sigma, arc_direction(zenith, azimuth))
    bsdf, u_bsdf, no_etalon = _ratio(rig, sample, etalon, upper)
    return BsdfPoints(
        wavelength_nm=np.full(upper, row.wavelength_nm),
        sigma_deg=np.full(upper, sigma),
        gamma_deg=np.full(upper, gamma),
        beta_deg=np.full(upper, beta),
        shift_deg=np.full(upper, shift),
        photodiode=np.arange(upper),
        zenith_deg=zenith,
        azimuth_deg=azimuth,
        theta_deg=theta,
        phi_deg=phi,
        bsdf=bsdf,
        u_bsdf=u_bsdf,
        shadowed=shadowed(file, sigma, zenith, azimuth, gamma),
        clipped=(sample.clipped | etalon.clipped)[:upper],
        no_etalon=no_etalon,
    )


def _ratio(rig: RigDescription, sample: Signal, etalon: Signal, upper: int) -> tuple[Floats, Floats, Flags]:
    """BSDF, its standard uncertainty, and where the etalon gave nothing to divide by."""
    certificate, file = rig.file.etalon, rig.file
    s, e = sample.ratio[:upper], etalon.ratio[:upper]
    var_s, var_e = sample.variance[:upper], etalon.variance[:upper]
    no_etalon = np.isfinite(e) & ~(e > ETALON_SIGNAL * np.sqrt(var_e))
    e = np.where(no_etalon, np.nan, e)
    scale = certificate.radiance_factor / math.pi
    bsdf = s / e * scale
    noise = (var_s + (s / e) ** 2 * var_e) * (scale / e) ** 2
    monitor = 2.0 * file.monitor.relative_uncertainty**2
    other_gain = sample.gain[:upper] != etalon.gain[:upper]
    gain = np.where(other_gain, 2.0 * file.photodiodes.gain_uncertainty**2, 0.0)
    u_bsdf = np.sqrt(noise + bsdf**2 * (monitor + gain + certificate.relative_uncertainty**2))
    return bsdf, u_bsdf, no_etalon


def _joined(blocks: list[BsdfPoints]) -> BsdfPoints:
    return BsdfPoints(*(np.concatenate([getattr(block, field.name) for block in blocks]) for field in fields(BsdfPoints)))
