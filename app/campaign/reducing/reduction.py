"""The reduction: from a journal's counts to the BSDF at each direction, with its standard uncertainty.

f = (sample over monitor) / (etalon over monitor) * f of the etalon's certificate (the paper's formula 1, in 1/sr), each
photodiode against itself. Where the instrument without a sample was measured in the same pose (its signature), that is
subtracted from both first. The uncertainty is from six parts: dark and noise, monitor, gain, signature, etalon, field; and of
a virtual rig whose light was traced, from the paths.

Formula 1 has no etalon for transmitted light. There the same photodiode is compared with what it sees of the etalon when
that is lit from the photodiode's own side, at 180 deg - sigma; where that was not measured, transmission has no scale and no
points. Nothing is subtracted from transmitted light: without a sample there is the beam itself.
"""

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from app.campaign.journal.recorded import Committed
from app.campaign.journal.writing import Journal
from app.campaign.planning.shadow import shadowed
from app.campaign.reducing.arcs import ArcView, Pose, arc_views
from app.campaign.reducing.drifting import drifts
from app.campaign.reducing.field import with_field
from app.campaign.reducing.overlaps import Overlaps, overlaps
from app.campaign.reducing.points import BsdfPoints as BsdfPoints
from app.campaign.reducing.points import Flags, Floats, joined
from app.campaign.reducing.signals import Ints, Signal, darks_by_gain, dead_since, mean_signal, middle, signal
from app.campaign.reducing.traced import tracing_error, with_tracing_error
from app.campaign.row import NOTHING, Row
from app.campaign.schedule.certificate import Certificate, constant, parse_certificate
from app.campaign.schedule.file import ScheduleFile, parse_schedule
from app.errors import UserError
from app.rig import RigDescription, parse_rig, photodiode_settings

ETALON_SIGNAL = 5.0
"""An etalon's signal below so many standard uncertainties is none: there is nothing to divide by."""
BRIGHT = 20.0
"""An etalon's signal that should be above so many standard uncertainties, and is none, is that of a dead photodiode."""
DETECTED = 3.0
"""A sample's signal below so many standard uncertainties is lost in its noise."""
GRAZING_DEG = 85.0
DECIMALS = 6
Key = tuple[float | None, Pose]


@dataclass(frozen=True)
class Reduced:
    """What a journal comes to: points by sample, and whether they are simulated. `overlaps` say by sample how well photodiodes
    agree that saw the same direction; `notes` what a reader has to know about how it was reduced.
    """

    name: str
    rig: RigDescription
    simulated: bool
    samples: dict[str, BsdfPoints]
    overlaps: dict[str, Overlaps]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Measured:
    """A row, or the mean of several of one pose: its signal, and which of its photodiodes (n,) had drifted, or were dead."""

    row: Row
    signal: Signal
    drifted: Flags
    dead: Flags


def reduce_journal(journal: Journal) -> Reduced:
    """All samples of a journal, as far as it goes. Raises UserError for one that has too little in it."""
    rig = parse_rig(journal.value("rig"), Path(), f"{journal.path} (rig)")
    schedule = parse_schedule(journal.value("schedule"), f"{journal.path} (schedule)").file
    certificate = _certificate(journal, schedule, rig)
    try:
        measured, notes = _measured(list(journal.rows()), schedule, rig)
    except UserError as error:
        raise UserError(f"{journal.path}: {error}") from None
    etalon = _by_pose(each for each in measured if each.row.sample == schedule.etalon)
    if not etalon:
        raise UserError(f"{journal.path}: the etalon has not been measured yet, so there is nothing to compare with")
    signature = _by_pose(each for each in measured if each.row.sample == NOTHING)
    samples = {}
    for sample in schedule.samples:
        rows = [each for each in measured if each.row.sample == sample]
        if blocks := [block for each in rows for block in _row_points(rig, each, etalon, signature, certificate)]:
            samples[sample] = joined(blocks)
    if signature:
        known = rig.file.sample_unit.signature_uncertainty
        taken = "the instrument's own light was measured without a sample and has been subtracted from reflected light"
        notes.append(f"{taken}; with a sample it is taken to be the same to {100.0 * known:.2g} %")
    if any(points.transmitted.any() for points in samples.values()):
        notes.append("transmitted light is scaled by what the same photodiode sees of the etalon lit from its own side")
    if schedule.certificate is not None and schedule.certificate.accept_expired_by is not None:
        who = schedule.certificate.accept_expired_by
        notes.append(f"the etalon's certificate holds until {schedule.certificate.expires}; {who} answers for it after that")
    if (traced := tracing_error(rig.file)) is not None:
        notes.append(f"the light was traced by the forward estimator, to {traced:.2g} in the median, which the uncertainty has")
    common = float(np.min(certificate.relative_uncertainty))
    seen = {name: overlaps(points, common) for name, points in samples.items()}
    # After the overlaps: what the field does to a value it does to all photodiodes that see the direction.
    samples = {name: with_field(points, rig.file) for name, points in samples.items()}
    return Reduced(journal.value("name"), rig, journal.simulated, samples, seen, tuple(notes))


def row_points(rig: RigDescription, row: Row, sample: Signal, etalon: Signal) -> BsdfPoints:
    """The upper arc's photodiodes in one row by the rig file's etalon, as far as can be said while a run goes on."""
    assert row.pose is not None
    well = np.zeros(len(sample.ratio), dtype=bool)
    table = rig.file.etalon
    certificate = constant(table.radiance_factor, table.relative_uncertainty)
    measured, reference = (Measured(row, found, well, well) for found in (sample, etalon))
    return _arc_points(rig, measured, arc_views(rig.file, row.pose)[0], reference, (None, None), certificate)


def _certificate(journal: Journal, schedule: ScheduleFile, rig: RigDescription) -> Certificate:
    if schedule.certificate is not None:
        return parse_certificate(journal.value("certificate"), f"{journal.path} (certificate)")
    return constant(rig.file.etalon.radiance_factor, rig.file.etalon.relative_uncertainty)


def _measured(rows: list[Committed], schedule: ScheduleFile, rig: RigDescription) -> tuple[list[Measured], list[str]]:
    """Each row that has readings, in order, and what is to be said of drift. Raises UserError."""
    settings = photodiode_settings(rig.file)
    darks = darks_by_gain(rows, settings)
    since = dead_since(rows, settings)
    lit = [each for each in rows if each.row.kind in ("measure", "drift") and each.data.readings]
    signals = {each.row.number: with_tracing_error(signal(each.data, darks, settings), rig.file) for each in lit}
    found = drifts(rows, signals, rig.file, None if schedule.drift is None else schedule.drift.limit)
    none = np.zeros(settings.count, dtype=bool)
    measured = [
        Measured(
            each.row,
            signals[each.row.number],
            np.any([none, *(drift.of(each.data.started_s) for drift in found)], axis=0),
            since < middle(each.data.readings[0]),
        )
        for each in lit
        if each.row.kind == "measure"
    ]
    return measured, [str(drift) for drift in found]


def _key(row: Row, pose: Pose) -> Key:
    """180 deg - sigma is not always what a planner has rounded."""
    gamma, sigma, beta, shift = (round(angle, DECIMALS) for angle in pose)
    return (row.wavelength_nm, (gamma, sigma, beta, shift))


def _by_pose(measured: Iterable[Measured]) -> dict[Key, Measured]:
    """The mean of those of one wavelength and pose."""
    groups: dict[Key, list[Measured]] = defaultdict(list)
    for each in measured:
        assert each.row.pose is not None
        groups[_key(each.row, each.row.pose)].append(each)
    return {
        key: Measured(
            group[0].row,
            mean_signal([each.signal for each in group]),
            np.any([each.drifted for each in group], axis=0),
            np.any([each.dead for each in group], axis=0),
        )
        for key, group in groups.items()
    }


def _row_points(
    rig: RigDescription, sample: Measured, etalon: dict[Key, Measured], signature: dict[Key, Measured], certificate: Certificate
) -> list[BsdfPoints]:
    """Of each arc whose photodiodes have seen the etalon, too."""
    row = sample.row
    assert row.pose is not None
    blocks = []
    for view in arc_views(rig.file, row.pose):
        pose = view.etalon_pose(row.pose)
        reference = etalon.get(_key(row, pose))
        if reference is not None:
            own = None if view.transmitted else signature.get(_key(row, row.pose))
            at_etalon = signature.get(_key(row, pose))
            blocks.append(_arc_points(rig, sample, view, reference, (own, at_etalon), certificate))
    return blocks


def _arc_points(
    rig: RigDescription,
    sample: Measured,
    view: ArcView,
    etalon: Measured,
    signature: tuple[Measured | None, Measured | None],
    certificate: Certificate,
) -> BsdfPoints:
    row, c, n = sample.row, view.channels, len(view.channels)
    assert row.pose is not None
    assert row.wavelength_nm is not None
    assert etalon.row.pose is not None
    gamma, sigma, beta, shift = row.pose
    incidence = 180.0 - etalon.row.pose[1] if etalon.row.pose[1] > 90.0 else etalon.row.pose[1]
    factor, u_factor = certificate.at(row.wavelength_nm, incidence, view.polar, view.azimuth)
    own, at_etalon = (None if each is None else each.signal for each in signature)
    ratio = _Ratio.of(rig, sample.signal, etalon.signal, own, at_etalon, c=c)
    hidden = shadowed(rig.file, sigma, view.zenith, view.azimuth, gamma)
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
        shadowed=hidden,
        clipped=ratio.clipped,
        no_etalon=no_etalon,
        dead=sample.dead[c] | etalon.dead[c] | _dead(ratio, view, no_etalon & ~hidden),
        uncertified=np.isnan(factor),
        drifted=sample.drifted[c] | etalon.drifted[c],
        under_range=np.isfinite(ratio.sample) & (ratio.sample < DETECTED * np.sqrt(ratio.var_sample)),
        back=np.full(n, view.back),
        transmitted=np.full(n, view.transmitted),
        signature=ratio.signature,
        u_field=np.full(n, np.nan),
    )


@dataclass(frozen=True)
class _Ratio:
    """Sample over etalon, both without the signature: `value` with the `variance` of noise and what is relative to it."""

    value: Floats
    variance: Floats
    relative_variance: Floats
    sample: Floats
    var_sample: Floats
    etalon: Floats
    var_etalon: Floats
    clipped: Flags
    signature: Floats

    @classmethod
    def of(
        cls, rig: RigDescription, sample: Signal, etalon: Signal, own: Signal | None, at_etalon: Signal | None, *, c: Ints
    ) -> "_Ratio":
        """Of the photodiodes `c`."""
        g, var_g, cut_g = _taken(own, c)
        h, var_h, cut_h = _taken(at_etalon, c)
        total = sample.ratio[c]
        # With a sample in its place the instrument's own light is not quite what it is without.
        other = rig.file.sample_unit.signature_uncertainty
        s, var_s = total - g, sample.variance[c] + var_g + (other * g) ** 2
        e, var_e = etalon.ratio[c] - h, etalon.variance[c] + var_h + (other * h) ** 2
        value = s / np.where(e == 0.0, np.nan, e)
        # What is subtracted from both is one and the same error.
        shared = 2.0 * value * var_g if own is at_etalon else 0.0
        variance = (var_s + value**2 * var_e - shared) / e**2
        monitor = 2.0 * rig.file.monitor.relative_uncertainty**2
        other_gain = sample.gain[c] != etalon.gain[c]
        gain = np.where(other_gain, 2.0 * rig.file.photodiodes.gain_uncertainty**2, 0.0)
        clipped = sample.clipped[c] | etalon.clipped[c] | cut_g | cut_h
        share = np.full(len(c), np.nan) if own is None else g / np.where(total == 0.0, np.nan, total)
        return cls(value, variance, monitor + gain, s, var_s, e, var_e, clipped, share)


def _taken(signature: Signal | None, c: Ints) -> tuple[Floats, Floats, Flags]:
    if signature is None:
        return np.zeros(len(c)), np.zeros(len(c)), np.zeros(len(c), dtype=bool)
    return signature.ratio[c], signature.variance[c], signature.clipped[c]


def _dead(ratio: _Ratio, view: ArcView, none: Flags) -> Flags:
    """Which of those that see nothing of the etalon should: by what the others see, over the cosine of their zenith angles."""
    cosine = np.cos(np.radians(view.polar))
    lit = (view.polar <= GRAZING_DEG) & (cosine > 0.0)
    brightness = float(np.nanmedian(np.where(lit, ratio.etalon / cosine, np.nan))) if lit.any() else 0.0
    dead: Flags = none & lit & (brightness * cosine > BRIGHT * np.sqrt(ratio.var_etalon))
    return dead
