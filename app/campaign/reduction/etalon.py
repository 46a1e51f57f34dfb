"""Comparison with the etalon (formula 1): signature, quotient and certificate, each a step on the rows of one arc.

Reflected light: each photodiode's signal is divided by the signal of the same photodiode at the etalon. Transmitted light:
formula 1 has no etalon for it. The signal is divided by that of the same photodiode at the etalon lit from the photodiode's own
side, at 180 deg - sigma. Without such a measurement there is no scale, and there are no points. The signature is not subtracted
from transmitted light: without a sample it is the direct beam.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.measurement_model.quantity import Quantity
from goniotwin.app.campaign.reduction.arc_geometry import ArcGeometry
from goniotwin.app.campaign.reduction.arc_rows import SIGMA, WAVELENGTH, ArcRows, ArcViews, arcs_of_rows, etalon_places
from goniotwin.app.campaign.reduction.components import COVERAGE, Signal
from goniotwin.app.campaign.reduction.optical_paths import second_share
from goniotwin.app.campaign.reduction.points import BsdfPoints, pack_flags, points_of_quantity
from goniotwin.app.campaign.reduction.reading_inputs import Numbers
from goniotwin.app.campaign.reduction.row_signals import PlaceIndex, PoseKey, RowSignals, pose_key
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.row import Row
from goniotwin.app.rig import RigFile
from goniotwin.app.rig.inputs import LINEARITY, MONITOR_DRIFT, MONITOR_LINEARITY
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import incidence_deg, round_deg

ETALON_SIGNAL = 5.0
"""An etalon's signal below so many standard uncertainties is too low to divide by."""
BRIGHT = 20.0
"""A photodiode is dead if its signal at the etalon is too low but should be above so many standard uncertainties."""
GRAZING_DEG = 85.0
"""Photodiodes at larger polar angles are not judged as dead."""
SIGNATURE, SIGNATURE_READING = "signature", "signature_reading"
"""Components of the instrument signature: of what it is with a sample mounted, and of its own readings."""


@dataclass(frozen=True)
class ReferenceSignals:
    """The signals of the standards and of the instrument signature, one row for each wavelength and pose; None without any."""

    etalon: RowSignals | None
    signature: RowSignals | None
    second: RowSignals | None = None


def reference_keys(rows: Sequence[Row], geometry: ArcGeometry) -> tuple[list[PoseKey], list[PoseKey]]:
    """Where rows were measured, and where their photodiodes need a signal of the etalon."""
    own, etalon = [], []
    for row in rows:
        assert row.pose is not None
        own.append(pose_key(row, row.pose))
        etalon += [pose_key(row, view.etalon_pose(row.pose)) for view, _ in geometry.views(row.pose)]
    return own, etalon


def join_references(rows: RowSignals, references: ReferenceSignals, settings: ReductionSettings) -> list[tuple[Ints, ArcRows]]:
    """For each arc, the rows whose photodiodes have a signal of the etalon, with their indices and all signals they need."""
    etalon, signature = references.etalon, references.signature
    if etalon is None:
        return []
    of_etalon = PlaceIndex(etalon.places)
    of_second = None if references.second is None else PlaceIndex(references.second.places)
    of_signature = None if signature is None else PlaceIndex(signature.places)
    arcs = []
    for index, views in arcs_of_rows(rows.places, settings.geometry):
        at_etalon = etalon_places(rows.places[index], views)
        found = of_etalon.find(at_etalon)
        known = found >= 0
        if not known.any():
            continue
        index, view, found, at_etalon = index[known], views.view[known], found[known], at_etalon[known]
        own = with_etalon = np.full(index.size, -1)
        if of_signature is not None:
            transmitted = np.array([each.transmitted for each in views.views])[view]
            own = np.where(transmitted, -1, of_signature.find(rows.places[index]))
            with_etalon = of_signature.find(at_etalon)
        seen = replace(views, view=view)
        data = _arc_rows(rows.where(index), seen, etalon, found, signature, own, with_etalon, settings.rig)
        if references.second is not None and of_second is not None:
            data = _with_second(data, references.second, of_second.find(at_etalon), settings.rig)
        arcs.append((index, data))
    return arcs


def _with_second(data: ArcRows, second: RowSignals, found: Ints, rig: RigFile) -> ArcRows:
    """The rows with the signals of the second standard, of indices `found` (rows,), -1 for none; none of them is used yet.

    A signal that is saturated, or has a flag, is none.
    """
    channels = data.views[0].channels
    rows = second.where(np.where(found < 0, 0, found))
    signal = comparable_signals(rows, channels, rig)
    usable = (found >= 0)[:, None] & (signal.gain >= 0) & ~np.any([each[:, channels] for each in rows.flags.values()], axis=0)
    signal = replace(signal, value=np.where(usable, signal.value, np.nan))
    return replace(data, second=signal, second_rows=np.broadcast_to(rows.numbers[:, None], signal.value.shape))


def _arc_rows(
    rows: RowSignals,
    views: ArcViews,
    etalon: RowSignals,
    found: Ints,
    signature: RowSignals | None,
    own: Ints,
    with_etalon: Ints,
    rig: RigFile,
) -> ArcRows:
    """The rows of an arc with their references: `found`, `own` and `with_etalon` (rows,) are the indices of these, -1: none."""
    c = views.views[0].channels
    sample = comparable_signals(rows, c, rig)
    unknown = np.broadcast_to(np.nan, sample.value.shape)
    measured = own >= 0
    sigmas, which = np.unique(etalon.places[found, SIGMA], return_inverse=True)
    flags = {name: (each | etalon.flags[name][found])[:, c] for name, each in rows.flags.items()}
    return ArcRows(
        numbers=rows.numbers,
        places=rows.places,
        mirrored=rows.mirrored,
        etalon_rows=etalon.numbers[found],
        views=views.views,
        view=views.view,
        incidence_deg=np.array([incidence_deg(each) for each in sigmas.tolist()])[which.ravel(), None],
        blocked=views.blocked[views.view],
        estimate=sample,
        sample=sample,
        etalon=comparable_signals(etalon.where(found), c, rig),
        signature=_signature(signature, own, c, rig),
        signature_at_etalon=_signature(signature, with_etalon, c, rig),
        signature_measured=measured[:, None],
        share=unknown,
        wavelength_slope=unknown,
        band_correction=unknown,
        stray_contrast=unknown,
        flags=flags,
    )


def comparable_signals(rows: RowSignals, channels: Ints, rig: RigFile) -> Signal:
    """The signals (rows, photodiodes) of the photodiodes `channels`, with the effects that a change between two rows has.

    Drift and linearity of the monitor, and the photodiodes' linearity, are counted from any time and any light: only a quotient
    of two signals has a meaning. Where the monitor gives more, values are lower. A signal below its own uncertainty counts as
    that: its logarithm would be one of noise.
    """
    signal, table = rows.signal.of_photodiodes(channels), rig.uncertainty
    size = np.maximum(np.abs(signal.value), np.sqrt(signal.reading_variance))
    with np.errstate(invalid="ignore", divide="ignore"):
        decades = np.nan_to_num(np.log10(np.where(size > 0.0, size, np.nan)))
    changes = {
        LINEARITY: decades,
        MONITOR_DRIFT: -rows.hours[:, None],
        MONITOR_LINEARITY: -rows.monitor_decades[:, None],
    }
    for each, change in changes.items():
        if u := table.u(each):
            signal = signal.with_common(each.name, u * change * signal.value)
    return signal


def _signature(signature: RowSignals | None, index: Ints, channels: Ints, rig: RigFile) -> Signal:
    """The signals (rows, photodiodes) of the photodiodes `channels`; 0 for a row that was not measured, of index -1.

    What a reading has alone is an input of all values from which it is subtracted.
    """
    known = index >= 0
    if signature is None or not known.any():
        shape = index.size, channels.size
        return Signal(np.broadcast_to(0.0, shape), gain=np.broadcast_to(np.int64(0), shape))
    rows = signature.where(np.where(known, index, 0))
    reading = Numbers.of(rig).reading(rows.numbers[:, None], channels)
    found = comparable_signals(rows, channels, rig).own_as(SIGNATURE_READING, reading)
    return found if known.all() else found.known_at(known)


# The steps.


def subtract_signature(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Subtract the instrument signature from the signals of sample and etalon, where it was measured in the same pose."""
    if not (settings.schedule.signature or settings.schedule.open_beam):
        return data  # nothing was measured without a sample
    # With a sample mounted the signature is not quite what it is without one.
    u_signature = settings.rig.sample_unit.signature_uncertainty
    total = data.sample.value

    def subtract(signal: Signal, signature: Signal) -> Signal:
        clipped = np.where(signature.gain < 0, -1, signal.gain)
        subtracted = signature.with_common(SIGNATURE, u_signature * signature.value)
        return Signal.of(signal - subtracted, clipped)

    sample = subtract(data.sample, data.signature)
    if data.second is not None:
        data = replace(data, second=subtract(data.second, data.signature_at_etalon))
    share = np.where(data.signature_measured, data.signature.value / np.where(total == 0.0, np.nan, total), np.nan)
    return replace(data, sample=sample, etalon=subtract(data.etalon, data.signature_at_etalon), estimate=sample, share=share)


def divide_by_etalon(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Divide by the signal of the etalon: what its reading has alone is an input of all values that divide by it.

    With a second standard by the mean of both, the second one's as that of an etalon with the first one's radiance factor.
    """
    etalon = data.etalon
    too_low = np.isfinite(etalon.value) & ~(etalon.value > ETALON_SIGNAL * np.sqrt(etalon.reading_variance))
    usable = replace(etalon, value=np.where(too_low | (etalon.value == 0.0), np.nan, etalon.value))
    reading = Numbers.of(settings.rig).reading(data.etalon_rows[:, None], data.views[0].channels)
    reference: Quantity = usable
    if data.second is not None and settings.second is not None:
        data, reference = _mean_of_standards(data, reference, settings)
    return replace(data, estimate=data.estimate / reference.own_as("etalon_reading", reading)).flagged({"no-etalon": too_low})


def _mean_of_standards(data: ArcRows, reference: Quantity, settings: ReductionSettings) -> tuple[ArcRows, Quantity]:
    """The mean of both standards' light where the second one has a share in the scale, and the rows with the numbers of these.

    It has none where it has no light or no certificate, and where the open beam is the scale. Values that divide by a reading
    of the etalon divide by that of the second standard in the same pose: both have one input.
    """
    second, rows = data.second, data.second_rows
    assert second is not None
    assert rows is not None
    assert settings.second is not None
    place = data.places[:, WAVELENGTH, None], data.incidence_deg, data.column("polar"), data.column("azimuth")
    share = second_share(settings, *place)
    factors = [each.interpolate(*place)[0] for each in (settings.certificate, settings.second.certificate)]
    bright = second.value > ETALON_SIGNAL * np.sqrt(second.reading_variance)
    used = bright & (share > 0.0) & np.isfinite(factors[0]) & np.isnan(_absolute_scale(data, settings))
    share = np.where(used, share, 0.0)
    others = second.known_at(used).scaled(np.where(used, -share * factors[0] / factors[1], 0.0))
    return replace(data, second_rows=np.where(used, rows, -1)), reference.scaled(1.0 - share) - others


def apply_certificate(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Multiply by the etalon's certified radiance factor over pi: the BSDF in 1/sr. NaN where the certificate has no value."""
    factor, _ = settings.certificate.interpolate(
        data.places[:, WAVELENGTH, None], data.incidence_deg, data.column("polar"), data.column("azimuth")
    )
    ratio = _absolute_scale(data, settings)
    bsdf = data.estimate.scaled(factor / math.pi * np.where(np.isnan(ratio), 1.0, ratio))
    flags = {"uncertified": np.isnan(factor), "scale": np.broadcast_to(settings.doubted & np.isnan(ratio), factor.shape)}
    return replace(data, estimate=bsdf).flagged(flags)


def _absolute_scale(data: ArcRows, settings: ReductionSettings) -> Floats:
    """Ratio of the open beam's scale to the certificate's (rows, 1); NaN where the certificate holds."""
    ratio = np.full((len(data.numbers), 1), np.nan)
    if settings.absolute:
        at = round_deg(np.stack([data.places[:, WAVELENGTH], data.incidence_deg[:, 0]], axis=1))
        transmitted, lower = data.of_views("transmitted")[:, 0], ~data.of_views("back")[:, 0]
        for (wavelength, sigma, of_lower), scale in settings.absolute.items():
            ratio[transmitted & (lower == of_lower) & (at == [wavelength, sigma]).all(axis=1)] = scale.ratio
    return ratio


def flag_values(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Flag what is blocked, saturated, dead, or below the detection limit."""
    del settings
    sample, etalon = data.sample, data.etalon
    too_low = data.flags["no-etalon"] & ~data.blocked
    return data.flagged(
        {
            "shadowed": data.blocked,
            "clipped": (sample.gain < 0) | (etalon.gain < 0),
            "dead": data.flags["dead"] | _dead(etalon, data.column("polar"), too_low),
            "under-range": sample.lost_in_noise,
        }
    )


def make_points(arcs: Sequence[tuple[Ints, ArcRows]]) -> tuple[Ints, BsdfPoints]:
    """The points of all arcs in the order of the rows, upper arc first; and the index of each point's row."""
    parts = [_points(data) for _, data in arcs]
    index = np.concatenate([np.repeat(at, data.estimate.value.shape[1]) for at, data in arcs])
    if len(parts) == 1:
        return index, parts[0]
    order = np.argsort(index, kind="stable")
    return index[order], BsdfPoints.join(parts).where(order)


def _points(data: ArcRows) -> BsdfPoints:
    n = data.estimate.value.shape[1]
    size = data.estimate.value.size
    rows = len(data.numbers)
    return BsdfPoints(
        places=data.places,
        place=np.repeat(np.arange(rows, dtype=np.int32), n),
        photodiode=np.tile(data.views[0].channels, rows),
        zenith_deg=data.column("zenith").ravel(),
        azimuth_deg=data.column("azimuth").ravel(),
        theta_deg=data.column("theta").ravel(),
        phi_deg=data.column("phi").ravel(),
        back=np.repeat(data.of_views("back"), n),
        transmitted=np.repeat(data.of_views("transmitted"), n),
        mirrored=np.repeat(data.mirrored, n),
        **points_of_quantity(data.estimate.each(lambda array: array.reshape(size, *array.shape[2:]))),
        stated={},
        marks=pack_flags({name: flag.ravel() for name, flag in data.flags.items()}, size),
        signature=data.share.ravel(),
        slope_along=np.full(size, np.nan),
        slope_across=np.full(size, np.nan),
        field_correction=np.zeros(size),
        coverage=np.full((size, 2), COVERAGE),
        row=np.repeat(data.numbers, n),
        etalon_row=np.repeat(data.etalon_rows, n),
        second_row=np.full(size, -1) if data.second_rows is None else data.second_rows.ravel(),
        gain=data.sample.gain.ravel(),
        etalon_gain=data.etalon.gain.ravel(),
        wavelength_slope=data.wavelength_slope.ravel(),
        band_correction=data.band_correction.ravel(),
        stray_contrast=data.stray_contrast.ravel(),
    )


def _dead(etalon: Signal, polar_deg: Floats, too_low: Flags) -> Flags:
    """The photodiodes without a signal of the etalon that should have one.

    Expected is the median of all photodiodes' signals over the cosines of their polar angles, times the photodiode's cosine.
    """
    cosine = np.cos(np.radians(polar_deg))
    lit = (polar_deg <= GRAZING_DEG) & (cosine > 0.0)
    of_normal = np.where(lit, etalon.value / cosine, np.nan)
    some = np.flatnonzero(np.isfinite(of_normal).any(axis=1))
    brightness = np.zeros((len(of_normal), 1))
    brightness[some, 0] = np.nanmedian(of_normal[some], axis=1)
    dead: Flags = too_low & lit & (brightness * cosine > BRIGHT * np.sqrt(etalon.reading_variance))
    return dead
