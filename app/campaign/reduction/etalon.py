"""Comparison with the etalon (formula 1): signature, quotient and certificate, each a step on the rows of one arc.

Reflected light: each photodiode's signal is divided by the signal of the same photodiode at the etalon. Transmitted light:
formula 1 has no etalon for it. The signal is divided by that of the same photodiode at the etalon lit from the photodiode's own
side, at 180 deg - sigma. Without such a measurement there is no scale, and there are no points. The signature is not subtracted
from transmitted light: without a sample it is the direct beam.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goniotwin.app.campaign.geometry.arcs import ArcView, polar_deg, views_at_sigma
from goniotwin.app.campaign.geometry.directions import ARCS, Arc, PoseAngles
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.pose import Views, pose_moments
from goniotwin.app.campaign.measurement_model.quantity import Quantity
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.overlaps import CalibrationFactors
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints, join_points, pack_flags, points_of_quantity
from goniotwin.app.campaign.reduction.reading_inputs import Numbers
from goniotwin.app.campaign.reduction.row_history import RowHistory
from goniotwin.app.campaign.reduction.signals import join_signals, mean_signals, signals_of_rows, stack_signals
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.certificate import Certificate
from goniotwin.app.campaign.schedule.file import ScheduleFile
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
MOST_POSES = 4096
"""Poses whose geometry is kept: some 10 MB."""
WAVELENGTH, SIGMA = PLACE.index("wavelength_nm"), PLACE.index("sigma_deg")
POSE = [PLACE.index(f"{axis}_deg") for axis in ("gamma", "sigma", "beta", "shift")]
PoseKey = tuple[float, PoseAngles]


class ArcGeometry:
    """What the arcs of a rig see in a pose; kept for some thousand poses, because every wavelength has the same ones."""

    def __init__(self, rig: RigFile) -> None:
        self._rig = rig
        self._kept: dict[PoseAngles, list[tuple[ArcView, Flags]]] = {}
        self._sums: dict[PoseAngles, Floats] = {}

    def views(self, pose: PoseAngles) -> list[tuple[ArcView, Flags]]:
        """The views of the arcs, with the photodiodes whose light the mirror unit blocks at the sample or at the etalon."""
        return self.views_at([pose])[0]

    def views_at(self, poses: Sequence[PoseAngles]) -> list[list[tuple[ArcView, Flags]]]:
        """The same at many poses, which together take a tenth of the time."""
        missing = [pose for pose in dict.fromkeys(poses) if pose not in self._kept]
        if missing and len(self._kept) + len(missing) > MOST_POSES:
            self._kept.clear()
            missing = list(dict.fromkeys(poses))
        alike: dict[tuple[float, float], list[PoseAngles]] = defaultdict(list)
        for pose in missing:
            alike[pose[0], pose[1]].append(pose)
        for same in alike.values():
            self._kept.update((pose, []) for pose in same)
            for arc in ARCS:
                if polar_deg(self._rig, arc):
                    for pose, view, blocked in self._views_of(same, arc):
                        self._kept[pose].append((view, blocked))
        return [self._kept[pose] for pose in poses]

    def _views_of(self, poses: Sequence[PoseAngles], arc: Arc) -> Iterator[tuple[PoseAngles, ArcView, Flags]]:
        """The views of an arc at poses of one gamma and sigma, and what is blocked."""
        gamma, sigma, *_ = poses[0]
        views = views_at_sigma(
            self._rig, sigma, np.array([pose[2] for pose in poses]), np.array([pose[3] for pose in poses]), arc
        )
        zenith, azimuth = (np.stack([getattr(view, name) for view in views]) for name in ("zenith", "azimuth"))
        # For transmitted light the mirror unit has another position at the etalon, and blocks other directions there.
        sigmas = {sigma, views[0].etalon_pose(poses[0])[1]}
        blocked = np.any([blocked_by_mirrors(self._rig, at, zenith, azimuth, gamma) for at in sigmas], axis=0)
        return zip(poses, views, blocked, strict=True)

    def pose_sums(self, poses: Sequence[PoseAngles]) -> Floats:
        """What the variances by the errors of angles need at poses, whatever the slopes: (poses, photodiodes, 2, 6).

        Of the dense inputs, and of the axes' positions: see `moments`. NaN for photodiodes without an arc.
        """
        missing = [pose for pose in dict.fromkeys(poses) if pose not in self._sums]
        if len(self._sums) + len(missing) > MOST_POSES:
            self._sums.clear()
            missing = list(dict.fromkeys(poses))
        if missing:
            seen = enumerate(zip(missing, self.views_at(missing), strict=True))
            views = [(k, pose, view) for k, (pose, arcs) in seen for view, _ in arcs]
            sums = np.full((len(missing), self._rig.photodiodes.count, 2, 6), np.nan)
            at = np.concatenate([np.full(view.channels.size, k) for k, _, view in views])
            sums[at, np.concatenate([view.channels for _, _, view in views])] = pose_moments(self._rig, views_of_arcs(views))
            self._sums.update(zip(missing, sums, strict=True))
        return np.stack([self._sums[pose] for pose in poses])


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
    `sample` is the name of the sample; `etalon_years` the time since the etalon's calibration.
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


@dataclass(frozen=True)
class RowSignals:
    """Rows as `RowSignal`, in columns: `signal` and `flags` are of (rows, photodiodes), all others of (rows,).

    `numbers` are those of the rows; `places` (rows, 5) their wavelengths and poses, in the order of PLACE and not rounded;
    `mirrored` those that only check the symmetry.
    """

    numbers: Ints
    places: Floats
    mirrored: Flags
    signal: Signal
    flags: Mapping[str, Flags]
    hours: Floats
    monitor_decades: Floats

    def __len__(self) -> int:
        return len(self.numbers)

    def at(self, index: Ints | Flags) -> "RowSignals":
        """Some of the rows, or all in another order."""
        return RowSignals(
            self.numbers[index], self.places[index], self.mirrored[index], self.signal.at(index),
            {name: each[index] for name, each in self.flags.items()}, self.hours[index], self.monitor_decades[index],
        )  # fmt: skip


def join_rows(parts: Sequence[RowSignals]) -> RowSignals:
    """The rows of all parts, of which there is at least one, in order."""
    if len(parts) == 1:
        return parts[0]
    return RowSignals(
        np.concatenate([each.numbers for each in parts]),
        np.concatenate([each.places for each in parts]),
        np.concatenate([each.mirrored for each in parts]),
        join_signals([each.signal for each in parts]),
        {name: np.concatenate([each.flags[name] for each in parts]) for name in parts[0].flags},
        np.concatenate([each.hours for each in parts]),
        np.concatenate([each.monitor_decades for each in parts]),
    )


def rows_in_columns(rows: Sequence[RowSignal]) -> RowSignals | None:
    """Rows of one sample in columns; None for none."""
    if not rows:
        return None
    return RowSignals(
        np.array([each.row.number for each in rows]),
        np.array([_place(each.row) for each in rows]),
        np.array([each.row.mirrored for each in rows]),
        stack_signals([each.signal for each in rows]),
        {name: np.stack([each.flags[name] for each in rows]) for name in rows[0].flags},
        np.array([each.hours for each in rows]),
        np.array([each.monitor_decades for each in rows]),
    )


def mean_rows(rows: RowSignals, repeats: Ints) -> RowSignals:
    """The means of repeated measurements: of the first so many rows, of so many more after them, and so on."""
    if (repeats == 1).all():
        return rows
    begin, parts, places = np.cumsum(repeats) - repeats, [], []
    for n in np.unique(repeats).tolist():
        here = np.flatnonzero(repeats == n)
        index = begin[here, None] + np.arange(n)
        first = rows.at(index[:, 0])
        mean = replace(
            first,
            signal=mean_signals(rows.signal, index),
            flags={name: each[index].any(axis=1) for name, each in rows.flags.items()},
            hours=rows.hours[index].mean(axis=1),
            monitor_decades=rows.monitor_decades[index].mean(axis=1),
        )
        parts.append(mean)
        places.append(here)
    return join_rows(parts).at(np.argsort(np.concatenate(places)))


def mean_row(rows: Sequence[RowSignal]) -> RowSignal:
    """The mean of repeated measurements of one pose, of which there is at least one."""
    columns = rows_in_columns(rows)
    assert columns is not None
    mean = mean_rows(columns, np.array([len(rows)]))
    (signal,) = signals_of_rows(mean.signal)
    flags = {name: each[0] for name, each in mean.flags.items()}
    return RowSignal(rows[0].row, signal, flags, float(mean.hours[0]), float(mean.monitor_decades[0]))


class PlaceIndex:
    """Finds rows by wavelength and pose: `places` (rows, 5) in the order of PLACE, compared as `pose_key` rounds them."""

    def __init__(self, places: Floats) -> None:
        self._columns = [np.unique(column) for column in round_deg(places).T]
        codes = self._codes(places)
        self.order: Ints = np.argsort(codes, kind="stable")
        self._sorted = codes[self.order]

    def range_of(self, places: Floats) -> tuple[Ints, Ints]:
        """For each of places (n, 5), begin and end (n,) in `order` of the rows there."""
        codes = self._codes(places)
        return np.searchsorted(self._sorted, codes, side="left"), np.searchsorted(self._sorted, codes, side="right")

    def has(self, places: Floats) -> Flags:
        """At which of places (n, 5) there is a row."""
        begin, end = self.range_of(places)
        return np.asarray(end > begin)

    def find(self, places: Floats) -> Ints:
        """For each of places (n, 5) the first row there, -1 for none."""
        begin, end = self.range_of(places)
        return np.where(end > begin, np.append(self.order, -1)[begin], -1)

    def _codes(self, places: Floats) -> Ints:
        """A number for each of the places (n, 5); -1 where a column has not this value, so that no row is there."""
        codes, known = np.zeros(len(places), dtype=np.int64), np.ones(len(places), dtype=bool)
        for column, values in zip(round_deg(places).T, self._columns, strict=True):
            at = np.minimum(np.searchsorted(values, column), max(values.size - 1, 0))
            known &= values[at] == column if values.size else False
            codes = codes * values.size + at
        return np.where(known, codes, -1)


def pose_key(row: Row, pose: PoseAngles) -> PoseKey:
    """A row's wavelength with a pose, rounded: 180 deg - sigma may differ in the last bits from the planner's sigma."""
    assert row.wavelength_nm is not None
    wavelength_nm, gamma, sigma, beta, shift = round_deg([row.wavelength_nm, *pose]).tolist()
    return (wavelength_nm, (gamma, sigma, beta, shift))


@dataclass(frozen=True)
class ReferenceSignals:
    """The signals of the etalon and of the instrument signature, one row for each wavelength and pose; None without any."""

    etalon: RowSignals | None
    signature: RowSignals | None


def reference_keys(rows: Sequence[Row], geometry: ArcGeometry) -> tuple[list[PoseKey], list[PoseKey]]:
    """Where rows were measured, and where their photodiodes need a signal of the etalon."""
    own, etalon = [], []
    for row in rows:
        assert row.pose is not None
        own.append(pose_key(row, row.pose))
        etalon += [pose_key(row, view.etalon_pose(row.pose)) for view, _ in geometry.views(row.pose)]
    return own, etalon


@dataclass(frozen=True)
class ArcViews:
    """What rows see on one arc: `view` (rows,) is the index of each row's view in `views`; arrays for these.

    `etalon_sigma_deg` is sigma of the rig at the etalon, `blocked` (views, photodiodes) what the mirror unit blocks.
    """

    views: tuple[ArcView, ...]
    view: Ints
    etalon_sigma_deg: Floats
    blocked: Flags


def arcs_of_rows(places: Floats, geometry: "ArcGeometry") -> list[tuple[Ints, ArcViews]]:
    """What rows at places (rows, 5) see on each arc, the upper one first; each pose once, however many rows have it.

    With each arc come the indices of the rows: an arc without photodiodes sees none.
    """
    poses = places[:, POSE]
    order = np.lexsort(poses.T)
    begins = np.ones(len(order), dtype=bool)
    begins[1:] = (poses[order[1:]] != poses[order[:-1]]).any(axis=1)
    which = np.empty(len(order), dtype=np.int64)
    which[order] = np.cumsum(begins) - 1
    angles = [tuple(each) for each in poses[order[begins]].tolist()]
    found: dict[bool, list[tuple[int, ArcView, Flags, float]]] = {}  # the upper arc is False
    for k, views in enumerate(geometry.views_at(angles)):
        for view, blocked in views:
            sigma = view.etalon_pose(angles[k])[1]
            found.setdefault(view.transmitted != view.back, []).append((k, view, blocked, sigma))
    arcs = []
    for _, seen in sorted(found.items(), key=lambda each: each[0]):
        of_pose = np.full(len(angles), -1)
        of_pose[[k for k, *_ in seen]] = np.arange(len(seen))
        view_of_row = of_pose[which]
        rows = np.flatnonzero(view_of_row >= 0)
        planned = ArcViews(
            tuple(each for _, each, _, _ in seen), view_of_row[rows], np.array([sigma for *_, sigma in seen]),
            np.stack([blocked for _, _, blocked, _ in seen]),
        )  # fmt: skip
        arcs.append((rows, planned))
    return arcs


def etalon_places(places: Floats, views: ArcViews) -> Floats:
    """Where the etalon is seen as rows at places (rows, 5) are seen on an arc: these places, with the etalon's sigma."""
    at_etalon = places.copy()
    at_etalon[:, SIGMA] = views.etalon_sigma_deg[views.view]
    return at_etalon


@dataclass(frozen=True)
class ArcRows:
    """Rows of one sample as one arc sees them: the dataset of the steps. Arrays (rows, photodiodes), or (rows, 1) for a row.

    `numbers`, `places` and `mirrored` are those of `RowSignals`; `view` (rows,) is the index of each row's view in `views`.
    `estimate` is the value so far: the signal of the sample, its quotient by that of the etalon, the BSDF in 1/sr. `flags` are
    those so far, by their names in files. `sample`, `etalon` and the two signatures are the signals; a signature is 0 where it
    was not measured. `etalon_rows` (rows,) are the numbers of the etalon's rows, of several of one pose the first one. `share`
    is the signature's share of the sample's signal, NaN where it was not measured. `wavelength_slope`, `band_correction` and
    `stray_contrast` are those of BsdfPoints, NaN where they are unknown.
    """

    numbers: Ints
    places: Floats
    mirrored: Flags
    etalon_rows: Ints
    views: tuple[ArcView, ...]
    view: Ints
    incidence_deg: Floats
    blocked: Flags
    estimate: Quantity
    sample: Signal
    etalon: Signal
    signature: Signal
    signature_at_etalon: Signal
    signature_measured: Flags
    share: Floats
    wavelength_slope: Floats
    band_correction: Floats
    stray_contrast: Floats
    flags: Mapping[str, Flags]

    def column(self, name: str) -> Floats:
        """An array (rows, photodiodes) of the views: `polar`, `zenith`, `azimuth`, `theta`, `phi`."""
        return np.stack([getattr(view, name) for view in self.views])[self.view]

    def of_views(self, name: str) -> Flags:
        """A property (rows, 1) of the views: `back`, `transmitted`."""
        return np.array([getattr(view, name) for view in self.views])[self.view][:, None]

    def flagged(self, flags: Mapping[str, Flags]) -> "ArcRows":
        """The rows with further flags, by their names in files."""
        return replace(self, flags={**self.flags, **flags})


def join_references(rows: RowSignals, references: ReferenceSignals, settings: ReductionSettings) -> list[tuple[Ints, ArcRows]]:
    """For each arc, the rows whose photodiodes have a signal of the etalon, with their indices and all signals they need."""
    etalon, signature = references.etalon, references.signature
    if etalon is None:
        return []
    of_etalon = PlaceIndex(etalon.places)
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
        arcs.append((index, _arc_rows(rows.at(index), seen, etalon, found, signature, own, with_etalon, settings.rig)))
    return arcs


def _arc_rows(
    rows: RowSignals, views: ArcViews, etalon: RowSignals, found: Ints, signature: RowSignals | None, own: Ints,
    with_etalon: Ints, rig: RigFile,
) -> ArcRows:  # fmt: skip
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
        etalon=comparable_signals(etalon.at(found), c, rig),
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
    for each, change in (
        (LINEARITY, decades), (MONITOR_DRIFT, -rows.hours[:, None]), (MONITOR_LINEARITY, -rows.monitor_decades[:, None]),
    ):  # fmt: skip
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
    rows = signature.at(np.where(known, index, 0))
    reading = Numbers.of(rig).reading(rows.numbers[:, None], channels)
    found = comparable_signals(rows, channels, rig).own_as(SIGNATURE_READING, reading)

    def of_measured(array: NDArray[Any]) -> NDArray[Any]:
        return np.where(known.reshape(-1, *[1] * (array.ndim - 1)), array, 0)

    return found if known.all() else found.each(of_measured)


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
    share = np.where(data.signature_measured, data.signature.value / np.where(total == 0.0, np.nan, total), np.nan)
    return replace(data, sample=sample, etalon=subtract(data.etalon, data.signature_at_etalon), estimate=sample, share=share)


def divide_by_etalon(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Divide by the signal of the etalon: what its reading has alone is an input of all values that divide by it."""
    etalon = data.etalon
    too_low = np.isfinite(etalon.value) & ~(etalon.value > ETALON_SIGNAL * np.sqrt(etalon.reading_variance))
    usable = replace(etalon, value=np.where(too_low | (etalon.value == 0.0), np.nan, etalon.value))
    reading = Numbers.of(settings.rig).reading(data.etalon_rows[:, None], data.views[0].channels)
    quotient = data.estimate / usable.own_as("etalon_reading", reading)
    return replace(data, estimate=quotient).flagged({"no-etalon": too_low})


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
        for (wavelength, sigma, of_lower), (found, _) in settings.absolute.items():
            ratio[transmitted & (lower == of_lower) & (at == [wavelength, sigma]).all(axis=1)] = found
    return ratio


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
        row=np.repeat(data.numbers, n),
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
    dead: Flags = too_low & lit & (brightness * cosine > BRIGHT * np.sqrt(etalon.reading_variance))
    return dead
