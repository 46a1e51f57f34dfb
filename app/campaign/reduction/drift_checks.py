"""Drift checks: whether the light at one pose, over the monitor's, is still what it was when the sample was mounted.

The monitor sees what the lamp does, and the ratio does not change with it. What is left is what the monitor cannot see: the
way of the light after the beam splitter, photodiodes, amplifiers, the sample.

Photodiodes that the drift checks could not watch: those to which what was mounted sent too little light at their pose.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from goniotwin.app.campaign.journal.record import CommittedRow, RowData
from goniotwin.app.campaign.reduction.signals import Signal, darks_by_gain, signal
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import DriftTable
from goniotwin.app.campaign.wording import number_list
from goniotwin.app.rig import RigFile, photodiode_settings
from goniotwin.arrays import Flags

LIGHT = 5.0
"""A photodiode whose signal is below so many standard uncertainties says nothing about the light."""
CERTAIN = 4.0
LIKELY = 2.0
"""By so many standard uncertainties a photodiode alone (there are many), and the mean of all, have to be beyond a limit."""
AT_RESUME = 0.005
"""The limit, a share, where a campaign without drift checks is gone on with."""
SignalOf = Callable[[], Signal]


@dataclass(frozen=True)
class Check:
    """One check against the first since the mounting: the mean relative `change` of the photodiodes that have light, its
    standard uncertainty, whether that is beyond the limit, and the photodiodes (n,) that are beyond it by themselves.

    Those are not in the mean, unless they are the most.
    """

    change: float
    u_change: float
    beyond: bool
    alone: Flags

    @property
    def excess(self) -> bool:
        """Whether anything is beyond the limit."""
        return self.beyond or bool(self.alone.any())

    @property
    def spoiled(self) -> Flags:
        """The photodiodes (n,) whose values are not to be trusted: all, where the mean is beyond the limit."""
        return self.alone | self.beyond

    def __str__(self) -> str:
        if math.isnan(self.change):
            return "no photodiode has light at the pose of the drift checks"
        alone = ", ".join(str(k) for k in np.flatnonzero(self.alone))
        told = f"the light has changed by {100 * self.change:+.3f} % (u {100 * self.u_change:.3f} %)"
        return f"{told}, beyond the limit by themselves are photodiodes {alone}" if alone else told


def compared(first: Signal, now: Signal, rig: RigFile, limit: float) -> Check:
    """`now` against `first`, signals of one pose and sample.

    A photodiode alone is beyond the `limit`, a share, where it is by four standard uncertainties, or has come over the range.
    """
    # One that is over the range now, and was not, has more light.
    alone = now.clipped & ~first.clipped
    light = np.isfinite(first.ratio) & np.isfinite(now.ratio)
    light &= np.nan_to_num(first.ratio) > LIGHT * np.sqrt(np.nan_to_num(first.variance))
    if not light.any():
        return Check(math.nan, math.nan, beyond=True, alone=alone)
    ratio = now.ratio[light] / first.ratio[light]
    gain = 2.0 * rig.photodiodes.gain_uncertainty**2 * (now.gain != first.gain)[light]
    variance = (now.variance[light] + ratio**2 * first.variance[light]) / first.ratio[light] ** 2 + gain
    monitor = 2.0 * rig.monitor.relative_uncertainty**2
    own = np.abs(ratio - 1.0) - CERTAIN * np.sqrt(variance + monitor) > limit
    alone[light] |= own
    weight = np.where(own, 0.0, 1.0 / variance) if own.sum() <= own.size / 2 else 1.0 / variance
    change = float(np.sum(weight * (ratio - 1.0)) / np.sum(weight))
    u_change = math.sqrt(1.0 / float(np.sum(weight)) + monitor)
    return Check(change, u_change, abs(change) - LIKELY * u_change > limit, alone)


class Reference:
    """What drift checks are compared with: the first since a mounting. Where a campaign was gone on with, the mounting before
    counts, and where it has no drift checks what was measured last is measured again.
    """

    def __init__(self, rig: RigFile, limit: float | None) -> None:
        self._rig = rig
        self._limit = limit
        self._first: Signal | None = None
        self._last: tuple[Row, SignalOf] | None = None

    def check(self, row: Row, signal_of: SignalOf) -> Check | None:
        """A row with readings, or a mounting, in order of time; for a drift row after the first what it says."""
        if row.kind == "mount" and not row.unplanned:
            self._first = self._last = None
        elif row.kind == "measure":
            self._last = (row, signal_of)
        elif row.kind == "drift":
            return self._compared(row, signal_of)
        return None

    def _compared(self, row: Row, signal_of: SignalOf) -> Check | None:
        if self._limit is None:
            # A pose that nobody chose for it: it may be dark there, and what noise does is no drift.
            if self._last is None or (self._last[0].pose, self._last[0].wavelength_nm) != (row.pose, row.wavelength_nm):
                return None
            found = compared(self._last[1](), signal_of(), self._rig, AT_RESUME)
            return replace(found, beyond=abs(found.change) - CERTAIN * found.u_change > AT_RESUME)
        now = signal_of()
        if self._first is not None:
            return compared(self._first, now, self._rig, self._limit)
        self._first = now
        return None


class DriftWatch:
    """Compares while the run goes on, with the darks that there are by then."""

    def __init__(self, table: DriftTable | None, rig: RigFile) -> None:
        self._reference = Reference(rig, None if table is None else table.limit)
        self._settings = photodiode_settings(rig)
        self._darks: list[CommittedRow] = []

    def add(self, row: Row, data: RowData) -> Check | None:
        """A row that has been committed; for a drift row that has something to be compared with, what it says.

        Raises UserError.
        """
        if row.kind == "dark":
            self._darks.append(CommittedRow(row, data))
        if row.kind == "mount" or data.readings:
            return self._reference.check(row, lambda: signal(data, darks_by_gain(self._darks, self._settings), self._settings))
        return None


@dataclass(frozen=True)
class Drift:
    """A stretch of time, s on the rig's clock, between drift checks one of which was beyond the limit; `told` says which.
    `photodiodes` (n,) are those whose values it spoils.
    """

    begin_s: float
    end_s: float
    photodiodes: Flags
    told: str

    def of(self, t: float) -> Flags:
        """The photodiodes (n,) that are flagged in a row that began at `t`."""
        return self.photodiodes & (self.begin_s <= t < self.end_s)

    def __str__(self) -> str:
        until = "the end" if math.isinf(self.end_s) else f"{self.end_s:.0f} s"
        return f"flagged for drift: what was measured from {self.begin_s:.0f} s to {until}; {self.told}"


def drifts(
    rows: Iterable[CommittedRow], signal_of: Callable[[CommittedRow], Signal], rig: RigFile, limit: float | None
) -> list[Drift]:
    """All of a campaign: mountings, drift checks and measurements in order of time, of which few are kept. `signal_of` one with
    readings; the `limit` of the schedule's drift checks, None where it has none.
    """
    found: list[Drift] = []
    reference = Reference(rig, limit)
    before, last = -math.inf, ("", np.zeros(len(rig.photodiodes.upper_deg) + len(rig.photodiodes.lower_deg), dtype=bool))
    well = last

    def between(end: float, then: tuple[str, Flags]) -> None:
        if last[0] or then[0]:
            found.append(Drift(before, end, last[1] | then[1], last[0] or then[0]))

    for each in rows:
        now, row = each.data.started_s, each.row
        mounted = row.kind == "mount"
        if not mounted and not (row.kind in ("measure", "drift") and each.data.readings):
            continue
        check = reference.check(row, partial(signal_of, each))
        if mounted and not row.unplanned:
            between(now, well)
            before, last = now, well
        elif row.kind == "drift":
            said = well if check is None or not check.excess else (f"{row.identity}: {check}", check.spoiled)
            between(now, said)
            before, last = now, said
    between(math.inf, well)
    return found


A_TENTH = 0.1
"""A loss of so much that would not be certain leaves a photodiode unwatched."""


def unseen(rows: Iterable[CommittedRow], signal_of: Callable[[CommittedRow], Signal]) -> dict[str, Flags]:
    """By what was mounted, the photodiodes (n,) of which a drift check could not have told that a tenth of the light is lost.

    `rows` in order of time, of which only drift checks count. Of campaigns without drift checks nothing.
    """
    found: dict[str, Flags] = {}
    for each in rows:
        # What the first check saw is what the others are compared with.
        if each.row.kind == "drift" and not each.row.unplanned and each.data.readings and each.row.sample not in found:
            found[each.row.sample] = ~_seen(signal_of(each))
    return found


def _seen(first: Signal) -> Flags:
    light = np.nan_to_num(first.ratio)
    # A change is that of two checks of one uncertainty. One over the range shows no loss until it is below.
    uncertain = CERTAIN * np.sqrt(2.0 * np.nan_to_num(first.variance))
    return np.asarray((light > 0.0) & (uncertain < A_TENTH * light))


def unwatched(found: Mapping[str, Flags], trusted: Mapping[str, set[int]], etalon: str) -> dict[str, tuple[int, ...]]:
    """The same, of those photodiodes alone whose values a reader would trust: a sample's own, the etalon's for all samples."""
    own = {**trusted, etalon: set().union(*trusted.values())} if trusted else {}
    told = {name: tuple(k for k in sorted(own[name]) if found[name][k]) for name in found if name in own}
    return {name: photodiodes for name, photodiodes in told.items() if photodiodes}


def in_words(name: str, photodiodes: tuple[int, ...]) -> str:
    """Of one thing that was mounted."""
    return (
        f"drift checks of {name} saw no light, or too little to tell that a tenth of it is lost, on photodiodes "
        f"{number_list(photodiodes)}: a fault of theirs would pass"
    )
