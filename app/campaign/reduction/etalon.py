"""Comparison with the etalon (formula 1): signature, quotient and certificate, each a step on the rows of one arc.

Reflected light: each photodiode's signal is divided by the signal of the same photodiode at the etalon. Transmitted light:
formula 1 has no etalon for it. The signal is divided by that of the same photodiode at the etalon lit from the photodiode's own
side, at 180 deg - sigma. Without such a measurement there is no scale, and there are no points. The signature is not subtracted
from transmitted light: without a sample it is the direct beam.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.geometry.arcs import ArcView, arc_views
from goniotwin.app.campaign.geometry.directions import PoseAngles
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.reduction.components import Estimate, Signal, total_variance
from goniotwin.app.campaign.reduction.overlaps import CalibrationFactors
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints, join_points, pack_flags
from goniotwin.app.campaign.reduction.row_history import RowHistory
from goniotwin.app.campaign.reduction.signals import mean_signal
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.certificate import Certificate
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.uncertainty.alignment import Alignment
from goniotwin.app.campaign.uncertainty.pose import Views, pose_moments
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import incidence_deg, round_deg

ETALON_SIGNAL = 5.0
"""An etalon's signal below so many standard uncertainties is too low to divide by."""
BRIGHT = 20.0
"""A photodiode is dead if its signal at the etalon is too low but should be above so many standard uncertainties."""
GRAZING_DEG = 85.0
"""Photodiodes at larger polar angles are not judged as dead."""
MOST_POSES = 4096
"""Poses whose geometry is kept: some 10 MB."""
PoseKey = tuple[float, PoseAngles]


class ArcGeometry:
    """What the arcs of a rig see in a pose; kept for some thousand poses, because every wavelength has the same ones."""

    def __init__(self, rig: RigFile) -> None:
        self._rig = rig
        self._kept: dict[PoseAngles, list[tuple[ArcView, Flags]]] = {}
        self._sums: dict[PoseAngles, Floats] = {}

    def views(self, pose: PoseAngles) -> list[tuple[ArcView, Flags]]:
        """The views of the arcs, with the photodiodes whose light the mirror unit blocks at the sample or at the etalon."""
        if pose not in self._kept:
            if len(self._kept) >= MOST_POSES:
                self._kept.clear()
            self._kept[pose] = [(view, self._blocked(view, pose)) for view in arc_views(self._rig, pose)]
        return self._kept[pose]

    def pose_sums(self, poses: Sequence[PoseAngles]) -> Floats:
        """What the variances by the errors of angles need at poses, whatever the slopes: (poses, photodiodes, 2, 6).

        Of the dense inputs, and of the axes' positions: see `moments`. NaN for photodiodes without an arc.
        """
        missing = [pose for pose in dict.fromkeys(poses) if pose not in self._sums]
        if len(self._sums) + len(missing) > MOST_POSES:
            self._sums.clear()
            missing = list(dict.fromkeys(poses))
        if missing:
            views = [(k, pose, view) for k, pose in enumerate(missing) for view, _ in self.views(pose)]
            sums = np.full((len(missing), self._rig.photodiodes.count, 2, 6), np.nan)
            at = np.concatenate([np.full(view.channels.size, k) for k, _, view in views])
            sums[at, np.concatenate([view.channels for _, _, view in views])] = pose_moments(self._rig, views_of_arcs(views))
            self._sums.update(zip(missing, sums, strict=True))
        return np.stack([self._sums[pose] for pose in poses])

    def _blocked(self, view: ArcView, pose: PoseAngles) -> Flags:
        # For transmitted light the mirror unit has another position at the etalon, and blocks other directions there.
        sigmas = {pose[1], view.etalon_pose(pose)[1]}
        blocked = [blocked_by_mirrors(self._rig, at, view.zenith, view.azimuth, pose[0]) for at in sigmas]
        return np.asarray(np.any(blocked, axis=0))


def views_of_arcs(views: Sequence[tuple[int, PoseAngles, ArcView]]) -> Views:
    """The directions of all photodiodes of views, one after the other."""
    each = [view.channels.size for _, _, view in views]
    beta = np.repeat([pose[2] for _, pose, _ in views], each)
    azimuth = np.concatenate([view.azimuth for _, _, view in views])
    return Views(
        sigma_deg=np.repeat([pose[1] for _, pose, _ in views], each),
        gamma_deg=np.repeat([pose[0] for _, pose, _ in views], each),
        polar=np.radians(np.concatenate([view.polar for _, _, view in views])),
        azimuth=np.radians(azimuth),
        lower=np.repeat([view.transmitted != view.back for _, _, view in views], each),
        transmitted=np.repeat([view.transmitted for _, _, view in views], each),
        reverse=np.cos(np.radians(azimuth - beta)) < 0.0,
    )


@dataclass(frozen=True)
class ReductionSettings:
    """What the steps of a reduction go by: rig, schedule, certificate, and the calibration factors of the sample, if any.

    `history`, of a journal, has the mountings, moves and dark readings before each row.
    `sample` is the name of the sample; `etalon_years` the time since the etalon's calibration; `repeatability` the relative
    standard uncertainty that the repeats of the campaign show, None where there are too few of them.
    `absolute` has, by wavelength, incidence and whether the arc is the lower one, the ratio of the open beam's scale to that of
    the certificate, and the relative standard uncertainty of the former; where it has one, it scales transmitted light.
    `doubted`: the scan of the open beam contradicts the etalon's scale. `alignment` is what is known of the rig's
    misalignments, by which the values are corrected; None without one.
    """

    rig: RigFile
    geometry: ArcGeometry
    schedule: ScheduleFile
    certificate: Certificate
    calibration: CalibrationFactors | None = None
    history: RowHistory | None = None
    sample: str = ""
    etalon_years: float = 1.0
    repeatability: float | None = None
    absolute: Mapping[tuple[float, float, bool], tuple[float, float]] = field(default_factory=dict)
    doubted: bool = False
    alignment: Alignment | None = None

    @property
    def calibrates(self) -> bool:
        """Whether the values are multiplied by the calibration factors of the overlaps."""
        return self.schedule.overlap is not None and self.schedule.overlap.calibrate


@dataclass(frozen=True)
class RowSignal:
    """A measured row, or the mean of several rows of one pose: its signal, and the photodiodes (n,) that are flagged.

    `flags` by their names in files. drift: the row lies in a drift interval of the photodiode. dead: the photodiode has lost
    its dark current. module: its module has not passed the tests of the signals. monitor: this has no range left. `hours` is
    when the row began, on the rig's clock, and `monitor_decades` the logarithm of base ten of the monitor's current in A.
    """

    row: Row
    signal: Signal
    flags: Mapping[str, Flags]
    hours: float
    monitor_decades: float


def mean_row(rows: Sequence[RowSignal]) -> RowSignal:
    """The mean of repeated measurements of one pose."""
    return RowSignal(
        rows[0].row,
        mean_signal([each.signal for each in rows]),
        {name: np.any([each.flags[name] for each in rows], axis=0) for name in rows[0].flags},
        math.fsum(each.hours for each in rows) / len(rows),
        math.fsum(each.monitor_decades for each in rows) / len(rows),
    )


def pose_key(row: Row, pose: PoseAngles) -> PoseKey:
    """A row's wavelength with a pose, rounded: 180 deg - sigma may differ in the last bits from the planner's sigma."""
    assert row.wavelength_nm is not None
    wavelength_nm, gamma, sigma, beta, shift = round_deg([row.wavelength_nm, *pose]).tolist()
    return (wavelength_nm, (gamma, sigma, beta, shift))


@dataclass(frozen=True)
class ReferenceSignals:
    """The signals of the etalon and of the instrument signature, by wavelength and pose, as far as they were measured."""

    etalon: Mapping[PoseKey, RowSignal]
    signature: Mapping[PoseKey, RowSignal]


def reference_keys(rows: Sequence[Row], geometry: ArcGeometry) -> tuple[list[PoseKey], list[PoseKey]]:
    """Where rows were measured, and where their photodiodes need a signal of the etalon."""
    own, etalon = [], []
    for row in rows:
        assert row.pose is not None
        own.append(pose_key(row, row.pose))
        etalon += [pose_key(row, view.etalon_pose(row.pose)) for view, _ in geometry.views(row.pose)]
    return own, etalon


@dataclass(frozen=True)
class ArcRows:
    """Rows of one sample as one arc sees them: the dataset of the steps. Arrays (rows, photodiodes), or (rows, 1) for a row.

    `estimate` is the value so far: the signal of the sample, its quotient by that of the etalon, the BSDF in 1/sr. `flags` are
    those so far, by their names in files. `sample`, `etalon` and the two signatures are the signals; a signature is 0 where it
    was not measured. `common_signature`: both signatures are one measurement, and their error is common to sample and etalon.
    `etalon_rows` are the numbers of the etalon's rows, of several of one pose the first one. `share` is the signature's share
    of the sample's signal, NaN where it was not measured. `hours` and `monitor_decades` are the changes of those of `RowSignal`
    from the etalon's row to the sample's. `wavelength_slope`, `band_correction` and `stray_contrast` are those
    of BsdfPoints, NaN where they are unknown.
    """

    rows: tuple[Row, ...]
    etalon_rows: tuple[int, ...]
    views: tuple[ArcView, ...]
    incidence_deg: Floats
    blocked: Flags
    estimate: Estimate
    sample: Signal
    etalon: Signal
    signature: Signal
    signature_at_etalon: Signal
    signature_measured: Flags
    common_signature: Flags
    share: Floats
    wavelength_slope: Floats
    band_correction: Floats
    stray_contrast: Floats
    flags: Mapping[str, Flags]
    hours: Floats
    monitor_decades: Floats

    def column(self, name: str) -> Floats:
        """An array of the views: `polar`, `zenith`, `azimuth`, `theta`, `phi`."""
        return np.stack([getattr(view, name) for view in self.views])

    def with_component(self, name: str, variance: Floats) -> "ArcRows":
        """The rows with a further component of the estimate's uncertainty: a variance, in its unit squared."""
        return replace(self, estimate=self.estimate.with_component(name, variance))

    def flagged(self, flags: Mapping[str, Flags]) -> "ArcRows":
        """The rows with further flags, by their names in files."""
        return replace(self, flags={**self.flags, **flags})


def join_references(
    rows: Sequence[RowSignal], references: ReferenceSignals, settings: ReductionSettings
) -> list[tuple[Ints, ArcRows]]:
    """For each arc, the rows whose photodiodes have a signal of the etalon, with their indices and all signals they need."""
    arcs: dict[bool, list[_Joined]] = {}  # the upper arc is False
    for k, each in enumerate(rows):
        assert each.row.pose is not None
        own_key = pose_key(each.row, each.row.pose)
        for view, blocked in settings.geometry.views(each.row.pose):
            key = pose_key(each.row, view.etalon_pose(each.row.pose))
            etalon = references.etalon.get(key)
            if etalon is not None:
                own = None if view.transmitted else references.signature.get(own_key)
                joined = _Joined(k, each, view, blocked, etalon, own, references.signature.get(key))
                arcs.setdefault(view.transmitted != view.back, []).append(joined)
    return [(np.array([each.index for each in arc]), _arc_rows(arc)) for _, arc in sorted(arcs.items())]


@dataclass(frozen=True)
class _Joined:
    """A row of an arc with its references; `index` is its place in the block."""

    index: int
    sample: RowSignal
    view: ArcView
    blocked: Flags
    etalon: RowSignal
    signature: RowSignal | None
    signature_at_etalon: RowSignal | None


def _arc_rows(arc: list[_Joined]) -> ArcRows:
    c = arc[0].view.channels
    sample = _stack([each.sample for each in arc], c)
    unknown = np.broadcast_to(np.nan, sample.value.shape)
    measured = np.array([[each.signature is not None] for each in arc])
    flags = {
        name: _taken([each.sample.flags[name] | each.etalon.flags[name] for each in arc], c) for name in arc[0].sample.flags
    }
    return ArcRows(
        rows=tuple(each.sample.row for each in arc),
        etalon_rows=tuple(each.etalon.row.number for each in arc),
        views=tuple(each.view for each in arc),
        incidence_deg=np.array([[incidence_deg(each.etalon.row.pose[1])] for each in arc if each.etalon.row.pose is not None]),
        blocked=np.stack([each.blocked for each in arc]),
        estimate=Estimate(sample.value, sample.components),
        sample=sample,
        etalon=_stack([each.etalon for each in arc], c),
        signature=_stack([each.signature for each in arc], c),
        signature_at_etalon=_stack([each.signature_at_etalon for each in arc], c),
        signature_measured=measured,
        common_signature=measured & [[each.signature is each.signature_at_etalon] for each in arc],
        share=unknown,
        wavelength_slope=unknown,
        band_correction=unknown,
        stray_contrast=unknown,
        flags=flags,
        hours=np.array([[each.sample.hours - each.etalon.hours] for each in arc]),
        monitor_decades=np.array([[each.sample.monitor_decades - each.etalon.monitor_decades] for each in arc]),
    )


def _stack(rows: Sequence[RowSignal | None], channels: Ints) -> Signal:
    """The signals (rows, photodiodes) of the photodiodes `channels`; 0 for a row that was not measured."""
    signals = [None if each is None else each.signal for each in rows]
    first = next((each for each in signals if each is not None), None)
    if first is None:
        shape = len(rows), len(channels)
        return Signal(np.broadcast_to(0.0, shape), {}, np.broadcast_to(np.int64(0), shape))
    names = dict.fromkeys(name for each in signals if each is not None for name in each.components)
    none, unsaturated = np.zeros(first.value.shape), np.zeros(first.gain.shape, dtype=np.int64)
    return Signal(
        _taken([none if each is None else each.value for each in signals], channels),
        {name: _taken([none if each is None else each.components[name] for each in signals], channels) for name in names},
        _taken([unsaturated if each is None else each.gain for each in signals], channels),
        _stack_links(signals, channels),
    )


def _stack_links(signals: Sequence[Signal | None], channels: Ints) -> Floats | None:
    known = [each.link for each in signals if each is not None and each.link is not None]
    if not known:
        return None
    none = np.zeros(known[0].shape)
    return _taken([none if each is None or each.link is None else each.link for each in signals], channels)


def _taken(rows: Sequence[npt.NDArray[Any]], channels: Ints) -> npt.NDArray[Any]:
    """Arrays (photodiodes, ...) of rows as one of the photodiodes `channels`."""
    return np.take(np.stack(rows), channels, axis=1)


# The steps.


def subtract_signature(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Subtract the instrument signature from the signals of sample and etalon, where it was measured in the same pose."""
    if not (settings.schedule.signature or settings.schedule.open_beam):
        return data  # nothing was measured without a sample
    # With a sample mounted the signature is not quite what it is without one.
    u_signature = settings.rig.sample_unit.signature_uncertainty
    total = data.sample.value

    def subtract(signal: Signal, signature: Signal) -> Signal:
        variance = signature.variance + (u_signature * signature.value) ** 2
        clipped = np.where(signature.gain < 0, -1, signal.gain)
        return replace(signal, value=signal.value - signature.value, gain=clipped).with_component("signature", variance)

    sample = subtract(data.sample, data.signature)
    share = np.where(data.signature_measured, data.signature.value / np.where(total == 0.0, np.nan, total), np.nan)
    etalon = subtract(data.etalon, data.signature_at_etalon)
    return replace(data, sample=sample, etalon=etalon, estimate=Estimate(sample.value, sample.components), share=share)


def divide_by_etalon(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Divide by the signal of the etalon. Its components become `etalon_reading`, but for what other readings share."""
    del settings
    etalon = data.etalon
    too_low = np.isfinite(etalon.value) & ~(etalon.value > ETALON_SIGNAL * np.sqrt(etalon.variance))
    quotient = data.estimate.divided(np.where(too_low | (etalon.value == 0.0), np.nan, etalon.value))
    relative = {name: variance * (quotient.value / etalon.value) ** 2 for name, variance in etalon.components.items()}
    if "signature" in relative:
        # The same signature subtracted from both has one common error.
        common = np.where(data.common_signature, data.signature.variance, 0.0)
        of_etalon = relative.pop("signature") - 2.0 * quotient.value * common / etalon.value**2
        quotient = quotient.with_component("signature", of_etalon)
    if "lamp" in relative:
        quotient = quotient.with_component("lamp", relative.pop("lamp"))  # one for all photodiodes of the etalon's row
    if "dark" in relative:
        quotient = quotient.with_component("etalon_dark", relative.pop("dark"))
    quotient = quotient.with_component("etalon_reading", total_variance(relative))
    return replace(data, estimate=quotient).flagged({"no-etalon": too_low})


def apply_certificate(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Multiply by the etalon's certified radiance factor over pi: the BSDF in 1/sr. NaN where the certificate has no value."""
    wavelength_nm = np.array([[row.wavelength_nm] for row in data.rows], dtype=float)
    factor, _ = settings.certificate.interpolate(
        wavelength_nm, data.incidence_deg, data.column("polar"), data.column("azimuth")
    )
    ratio = _absolute_scale(data, settings)
    bsdf = data.estimate.scaled(factor / math.pi).scaled(np.where(np.isnan(ratio), 1.0, ratio))
    flags = {"uncertified": np.isnan(factor), "scale": np.broadcast_to(settings.doubted & np.isnan(ratio), factor.shape)}
    return replace(data, estimate=bsdf).flagged(flags)


def _absolute_scale(data: ArcRows, settings: ReductionSettings) -> Floats:
    """Ratio of the open beam's scale to the certificate's (rows, 1); NaN where the certificate holds."""
    ratio = np.full((len(data.rows), 1), np.nan)
    for k, (row, view) in enumerate(zip(data.rows, data.views, strict=True) if settings.absolute else ()):
        if view.transmitted:
            wavelength, sigma = round_deg([row.wavelength_nm or 0.0, data.incidence_deg[k, 0]]).tolist()
            ratio[k], _ = settings.absolute.get((wavelength, sigma, not view.back), (math.nan, 0.0))
    return ratio


def add_monitor_changes(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Add what drift and linearity of the monitor make of the time, and of the light's change, since the etalon's row."""
    table = settings.rig.uncertainty
    for name, u, change in (
        ("monitor_drift", table.monitor_drift_per_hour, data.hours),
        ("monitor_linearity", table.monitor_linearity_per_decade, data.monitor_decades),
    ):
        if u:
            data = data.with_component(name, (u * change * data.estimate.value) ** 2)
    return data


def flag_values(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Flag what is blocked, saturated, dead, or lost in its noise."""
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


def monitor_variance(rig: RigFile) -> float:
    """Relative variance of a quotient of two rows by the monitor's two readings: one for all photodiodes."""
    return 2.0 * rig.monitor.relative_uncertainty**2


def gain_variance(one: Signal, other: Signal, rig: RigFile) -> Floats:
    """Relative variance of a quotient of two signals by the ratio of their gains: 0 where both were read at the same gain."""
    if one.link is None:
        return np.where(one.gain != other.gain, 2.0 * rig.photodiodes.gain_uncertainty**2, 0.0)
    return np.take_along_axis(one.link, other.gain[..., None], axis=-1)[..., 0]


def linearity_variance(one: Signal, other: Signal, rig: RigFile) -> Floats:
    """Relative variance of a quotient of two signals by the photodiodes' linearity, in proportion to the decades between them.

    A signal below its own uncertainty counts as that: its logarithm would be one of noise.
    """
    values = (np.maximum(np.abs(each.value), np.sqrt(each.variance)) for each in (one, other))
    with np.errstate(invalid="ignore", divide="ignore"):
        decades = np.subtract(*(np.log10(np.where(each > 0.0, each, np.nan)) for each in values))
    return np.asarray(np.nan_to_num((rig.uncertainty.linearity_per_decade * decades) ** 2))


def make_points(arcs: Sequence[tuple[Ints, ArcRows]]) -> tuple[Ints, BsdfPoints]:
    """The points of all arcs in the order of the rows, upper arc first; and the index of each point's row."""
    parts = [_points(data) for _, data in arcs]
    index = np.concatenate([np.repeat(at, data.estimate.value.shape[1]) for at, data in arcs])
    if len(parts) == 1:
        return index, parts[0]
    order = np.argsort(index, kind="stable")
    return index[order], join_points(parts).where(order)


def _points(data: ArcRows) -> BsdfPoints:
    n = data.estimate.value.shape[1]
    size = data.estimate.value.size
    places = np.array([_place(row) for row in data.rows])
    return BsdfPoints(
        places=places,
        place=np.repeat(np.arange(len(places), dtype=np.int32), n),
        photodiode=np.concatenate([view.channels for view in data.views]),
        zenith_deg=data.column("zenith").ravel(),
        azimuth_deg=data.column("azimuth").ravel(),
        theta_deg=data.column("theta").ravel(),
        phi_deg=data.column("phi").ravel(),
        back=np.repeat([view.back for view in data.views], n),
        transmitted=np.repeat([view.transmitted for view in data.views], n),
        mirrored=np.repeat([row.mirrored for row in data.rows], n),
        bsdf=data.estimate.value.ravel(),
        components={name: each.ravel() for name, each in data.estimate.components.items()},
        marks=pack_flags({name: flag.ravel() for name, flag in data.flags.items()}, size),
        signature=data.share.ravel(),
        slope_along=np.full(size, np.nan),
        slope_across=np.full(size, np.nan),
        field_correction=np.zeros(size),
        row=np.repeat([row.number for row in data.rows], n),
        etalon_row=np.repeat(data.etalon_rows, n),
        gain=data.sample.gain.ravel(),
        etalon_gain=data.etalon.gain.ravel(),
        wavelength_slope=data.wavelength_slope.ravel(),
        band_correction=data.band_correction.ravel(),
        stray_contrast=data.stray_contrast.ravel(),
    )


def _place(row: Row) -> list[float]:
    """A row's wavelength and pose, in the order of PLACE."""
    assert row.pose is not None
    assert row.wavelength_nm is not None
    columns = dict(zip(("gamma_deg", "sigma_deg", "beta_deg", "shift_deg"), row.pose, strict=True))
    return [{"wavelength_nm": row.wavelength_nm, **columns}[name] for name in PLACE]


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
    dead: Flags = too_low & lit & (brightness * cosine > BRIGHT * np.sqrt(etalon.variance))
    return dead
