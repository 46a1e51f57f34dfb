"""Drift checks: comparison of the signals at one reference pose with those right after the mounting.

A signal is a photocurrent over the monitor's current, so that it does not change with the lamp. A change of it comes from what
the monitor does not see: the light path after the beam splitter, the photodiodes, the amplifiers, the sample.

A photodiode that gets too little light at the reference pose is not covered by the drift checks; `unchecked_photodiodes`
lists those.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from goniotwin.app.campaign.measurement_model.pose import position_u_deg
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.signals import LIGHT
from goniotwin.app.campaign.row import CommittedRow, Row
from goniotwin.app.campaign.wording import number_list
from goniotwin.app.rig import RigFile
from goniotwin.app.rig.inputs import LINEARITY
from goniotwin.arrays import Flags, Floats

CERTAIN = 4.0
"""A single photodiode has to be beyond the limit by so many standard uncertainties: there are many photodiodes."""
LIKELY = 2.0
"""The mean of all photodiodes has to be beyond the limit by so many standard uncertainties."""
RESUME_LIMIT = 0.005
"""Limit of the relative change at a resume, for a schedule without drift checks."""
DETECTABLE_LOSS = 0.1
"""A photodiode is covered by the drift checks if a relative loss of this size would be certain."""
SignalOf = Callable[[], Signal]


@dataclass(frozen=True)
class DriftCheck:
    """Comparison of a drift check with the first one since the mounting.

    `change` is the mean relative change of the photodiodes that have light, with its standard uncertainty; `beyond` whether it
    is beyond the limit. `outliers` (n,) are the photodiodes that are beyond the limit by themselves. The mean leaves them out,
    unless they are the majority.
    """

    change: float
    u_change: float
    beyond: bool
    outliers: Flags

    @property
    def beyond_limit(self) -> bool:
        """Whether the mean or any photodiode is beyond the limit."""
        return self.beyond or bool(self.outliers.any())

    @property
    def untrusted(self) -> Flags:
        """The photodiodes (n,) whose values are flagged: the outliers, or all if the mean is beyond the limit."""
        return self.outliers | self.beyond

    def __str__(self) -> str:
        if math.isnan(self.change):
            return "no photodiode has light at the pose of the drift checks"
        outliers = ", ".join(str(k) for k in np.flatnonzero(self.outliers))
        change = f"the light has changed by {100 * self.change:+.3f} % (u {100 * self.u_change:.3f} %)"
        return f"{change}, beyond the limit by themselves are photodiodes {outliers}" if outliers else change


def compare_signals(first: Signal, now: Signal, rig: RigFile, limit: float) -> DriftCheck:
    """Compare `now` with `first`, signals of one pose and one sample; `limit` is a relative change.

    A photodiode is an outlier if it is beyond the limit by four standard uncertainties, or is saturated now and was not before.
    In these is that sigma and shift stop elsewhere each time, where the light is steep along the arc.
    """
    # Saturated now and not before: it gets more light.
    outliers = (now.gain < 0) & (first.gain >= 0)
    light = np.isfinite(first.value) & np.isfinite(now.value)
    light &= np.nan_to_num(first.value) > LIGHT * np.sqrt(np.nan_to_num(first.reading_variance))
    if not light.any():
        return DriftCheck(math.nan, math.nan, beyond=True, outliers=outliers)
    quotient = now.each(lambda array: array[light]) / first.each(lambda array: array[light])
    ratio, components = quotient.value, quotient.components
    shared = [components.pop(name) / ratio**2 for name in ("lamp", "monitor") if name in components]
    common = float(np.min(sum(shared)))  # to all photodiodes of a row
    decades = np.log10(np.maximum(np.abs(ratio), np.finfo(float).tiny))
    moved = 2.0 * position_u_deg(rig.uncertainty) * _steepness(first, rig)[light]  # two axes, each at both checks
    variance = np.sum([*components.values(), (rig.uncertainty.u(LINEARITY) * decades * ratio) ** 2], axis=0)
    own = np.abs(ratio - 1.0) - CERTAIN * np.sqrt(variance + moved**2 + common) > limit
    outliers[light] |= own
    weight = 1.0 / (variance + moved**2)
    weight = np.where(own, 0.0, weight) if own.sum() <= own.size / 2 else weight
    share = weight / np.sum(weight)
    change = float(share @ (ratio - 1.0))
    u_change = math.sqrt(float(share**2 @ variance) + float(share @ moved) ** 2 + common)
    return DriftCheck(change, u_change, abs(change) - LIKELY * u_change > limit, outliers)


def _steepness(signal: Signal, rig: RigFile) -> Floats:
    """The largest change (n,) of the logarithm of a signal (n,) for a degree, to the photodiodes beside each on its arc."""
    known = np.maximum(signal.value, np.sqrt(signal.reading_variance))  # one that is saturated has no number
    logarithm = np.log(np.where(known > 0.0, known, np.nan))
    found, begin = np.zeros(logarithm.size), 0
    for angles in (rig.photodiodes.upper_deg, rig.photodiodes.lower_deg):
        here = slice(begin, begin + len(angles))
        between = np.nan_to_num(np.abs(np.diff(logarithm[here]) / np.diff(angles)))
        found[here] = np.maximum(np.append(between, 0.0), np.append(0.0, between))
        begin = here.stop
    return found


class DriftReference:
    """The signal that drift checks are compared with: the first drift check since the mounting.

    After a resume the reference is still that of the mounting before the interruption. A schedule without drift checks
    (`limit` None) repeats the last measured row at a resume, and compares it with that row.
    """

    def __init__(self, rig: RigFile, limit: float | None) -> None:
        self._rig = rig
        self._limit = limit
        self._first: Signal | None = None
        self._last: tuple[Row, SignalOf] | None = None

    def check(self, row: Row, signal_of: SignalOf) -> DriftCheck | None:
        """Take a mounting or a row with readings, in order of time; give the comparison for a drift row after the first."""
        if row.kind == "mount" and not row.unplanned:
            self._first = self._last = None
        elif row.kind == "measure":
            self._last = (row, signal_of)
        elif row.kind == "drift":
            return self._compare(row, signal_of)
        return None

    def _compare(self, row: Row, signal_of: SignalOf) -> DriftCheck | None:
        if self._limit is None:
            # This pose was not chosen for a drift check. It may be dark there, and noise is not drift: a higher threshold.
            if self._last is None or (self._last[0].pose, self._last[0].wavelength_nm) != (row.pose, row.wavelength_nm):
                return None
            result = compare_signals(self._last[1](), signal_of(), self._rig, RESUME_LIMIT)
            return replace(result, beyond=abs(result.change) - CERTAIN * result.u_change > RESUME_LIMIT)
        now = signal_of()
        if self._first is not None:
            return compare_signals(self._first, now, self._rig, self._limit)
        self._first = now
        return None


@dataclass(frozen=True)
class DriftInterval:
    """Time between two drift checks of which at least one is beyond the limit; s on the rig's clock.

    `reason` names that check; `photodiodes` (n,) are those whose values are flagged.
    """

    begin_s: float
    end_s: float
    photodiodes: Flags
    reason: str

    def flagged_at(self, t: Floats) -> Flags:
        """The photodiodes (rows, n) that are flagged in rows that started at `t` (rows,)."""
        return np.asarray(self.photodiodes & ((self.begin_s <= t) & (t < self.end_s))[:, None])

    def __str__(self) -> str:
        until = "the end" if math.isinf(self.end_s) else f"{self.end_s:.0f} s"
        return f"flagged for drift: all readings from {self.begin_s:.0f} s to {until}; {self.reason}"


def drift_intervals(
    rows: Iterable[CommittedRow], signal_of: Callable[[CommittedRow], Signal], rig: RigFile, limit: float | None
) -> list[DriftInterval]:
    """All drift intervals of a campaign.

    `rows` are mountings, drift checks and measurements in order of time; few of them are kept in memory. `signal_of` gives the
    signal of a row with readings. `limit` is that of the schedule's drift checks, None if it has none.
    """
    intervals: list[DriftInterval] = []
    reference = DriftReference(rig, limit)
    before, last = -math.inf, ("", np.zeros(len(rig.photodiodes.upper_deg) + len(rig.photodiodes.lower_deg), dtype=bool))
    within = last

    def close(end: float, then: tuple[str, Flags]) -> None:
        if last[0] or then[0]:
            intervals.append(DriftInterval(before, end, last[1] | then[1], last[0] or then[0]))

    for each in rows:
        now, row = each.data.started_s, each.row
        mounted = row.kind == "mount"
        if not mounted and not (row.kind in ("measure", "drift") and each.data.readings):
            continue
        check = reference.check(row, partial(signal_of, each))
        if mounted and not row.unplanned:
            close(now, within)
            before, last = now, within
        elif row.kind == "drift":
            result = within if check is None or not check.beyond_limit else (f"{row.identity}: {check}", check.untrusted)
            close(now, result)
            before, last = now, result
    close(math.inf, within)
    return intervals


@dataclass(frozen=True)
class DriftChange:
    """A drift check, so many `hours` after the first one of the `mounting`, which has a number."""

    mounting: int
    hours: float
    check: DriftCheck


def drift_changes(
    rows: Iterable[CommittedRow], signal_of: Callable[[CommittedRow], Signal], rig: RigFile, limit: float
) -> list[DriftChange]:
    """The drift checks that see light, but the first of each mounting; `rows` as those of `drift_intervals`."""
    found: list[DriftChange] = []
    first, began_s, mounting = None, 0.0, 0
    for each in rows:
        if each.row.kind == "mount" and not each.row.unplanned:
            first, mounting = None, mounting + 1
        elif each.row.kind == "drift" and each.data.readings:
            now, at_s = signal_of(each), each.data.started_s
            if first is None:
                first, began_s = now, at_s
            elif not math.isnan((check := compare_signals(first, now, rig, limit)).change):
                found.append(DriftChange(mounting, (at_s - began_s) / 3600.0, check))
    return found


def insensitive_photodiodes(rows: Iterable[CommittedRow], signal_of: Callable[[CommittedRow], Signal]) -> dict[str, Flags]:
    """By the mounted sample, the photodiodes (n,) for which a drift check could not detect a loss of a tenth of the light.

    `rows` are in order of time; only drift checks count. Empty for a campaign without drift checks.
    """
    result: dict[str, Flags] = {}
    for each in rows:
        # The first check after a mounting is the reference of all others.
        if each.row.kind == "drift" and not each.row.unplanned and each.data.readings and each.row.sample not in result:
            result[each.row.sample] = ~_sensitive(signal_of(each))
    return result


def _sensitive(first: Signal) -> Flags:
    light = np.nan_to_num(first.value)
    # A change has the uncertainty of two checks. A saturated photodiode shows no loss until it is below its range.
    u_change = CERTAIN * np.sqrt(2.0 * np.nan_to_num(first.reading_variance))
    return np.asarray((light > 0.0) & (u_change < DETECTABLE_LOSS * light))


def unchecked_photodiodes(
    insensitive: Mapping[str, Flags], trusted: Mapping[str, set[int]], standards: Sequence[str]
) -> dict[str, tuple[int, ...]]:
    """The insensitive photodiodes among those with trusted values, by the mounted sample.

    `trusted` are the photodiodes of each sample; the standards count for the photodiodes of all samples.
    """
    own = {**trusted, **dict.fromkeys(standards, set().union(*trusted.values()))} if trusted else {}
    unchecked = {name: tuple(k for k in sorted(own[name]) if insensitive[name][k]) for name in insensitive if name in own}
    return {name: photodiodes for name, photodiodes in unchecked.items() if photodiodes}


def unchecked_note(name: str, photodiodes: tuple[int, ...]) -> str:
    """The note on the unchecked photodiodes of one mounted sample."""
    return (
        f"drift checks of {name} cannot detect a loss of a tenth of the light on photodiodes {number_list(photodiodes)}, "
        "because these have too little light at the pose of the drift checks"
    )
