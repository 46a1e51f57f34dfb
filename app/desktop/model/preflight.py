"""The preflight list: what is looked at before a run, as far as it is known. A plain function of facts; no Qt, no device.

Each check has a state, what is found, and what to do. Ages are on the rig's clock where they are of data (a simulation at speed
60 ages a dark reading by a minute in a second), and of the calendar where they are of certificates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from enum import StrEnum

from goniotwin.app.campaign.readout import WarmUpTrace
from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.station.messages import DeviceStatus

WARM_PERCENT = 0.5
"""Change of the monitor in ten minutes that a warm lamp does not exceed, where the schedule states none."""
DARK_S = 60.0
"""Age of a dark reading that is old, where no schedule states one."""
SOON_DAYS = 30
LOW_BYTES, LEAST_BYTES = 2_000_000_000, 200_000_000
LIMIT_TOLERANCE_DEG = 0.05
"""An axis that was stopped at a soft limit may rest beyond it by as much."""


SILENT_REMEDY = "check power and cable of their controller"


class Outcome(StrEnum):
    """State of a check. Unknown: nothing has been measured yet that would show it."""

    GOOD = "good"
    LOOK = "check it"
    BAD = "not ready"
    UNKNOWN = "unknown"


MARKS = {Outcome.GOOD: "✓", Outcome.LOOK: "!", Outcome.BAD: "✗", Outcome.UNKNOWN: "?"}


@dataclass(frozen=True)
class Check:
    """One line of the list: its name, its state, what is found, and what to do (empty if nothing)."""

    name: str
    outcome: Outcome
    found: str
    remedy: str = ""

    @property
    def text(self) -> str:
        """The line as text."""
        return f"{self.name}: {self.outcome}: {self.found}" + (f"; {self.remedy}" if self.remedy else "")


@dataclass(frozen=True)
class Facts:
    """What is known before a run; None or empty is unknown.

    `devices` has the state of each, by name; `silent_axes` are those whose controller does not respond. `limits_deg` and
    `positions_deg` are by axis, `unreferenced` has reasons, by axis; `homes` are the axes that can home. `monitor` is the
    monitor's trace and `monitor_age_s` the age of its last reading; `warm_percent` the change in ten minutes that is accepted.
    `dark_age_s` is the age of the last dark reading, `dark_every_s` the greatest one of the schedule; `speed` the simulation
    speed. `drift` is what the last drift check found, `drift_beyond` whether that is beyond its limit, `drift_planned` whether
    the schedule has any. `certificate` is the name of the etalon's certificate, `expires` its last day, `accepted_by` the
    person for the time after; `calibrated` the day of the calibration; `virtual` whether the etalon is that of a virtual rig.
    `free_bytes` is the room in the `folder` of data files, `needed_bytes` what the run takes.
    """

    today: date
    devices: Mapping[str, DeviceStatus] = field(default_factory=dict)
    silent_axes: Sequence[str] = ()
    limits_deg: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    positions_deg: Mapping[str, float] = field(default_factory=dict)
    unreferenced: Mapping[str, str] = field(default_factory=dict)
    homes: Sequence[str] = ()
    monitor: WarmUpTrace | None = None
    monitor_age_s: float | None = None
    warm_percent: float | None = None
    dark_age_s: float | None = None
    dark_every_s: float | None = None
    speed: float = 1.0
    drift: str = ""
    drift_beyond: bool = False
    drift_planned: bool | None = None
    certificate: str = ""
    expires: date | None = None
    accepted_by: str = ""
    calibrated: date | None = None
    virtual: bool = False
    folder: str = ""
    free_bytes: int | None = None
    needed_bytes: int = 0


def preflight_checks(facts: Facts) -> tuple[Check, ...]:
    """The list, always with the same checks in the same order."""
    return tuple(check(facts) for check in (_ports, _homed, _limits, _lamp, _dark, _drift, _certificate, _disk))


def preflight_summary(checks: Sequence[Check]) -> str:
    """The list in one line."""
    counts = {outcome: sum(check.outcome is outcome for check in checks) for outcome in Outcome}
    if counts[Outcome.BAD]:
        names = ", ".join(check.name.lower() for check in checks if check.outcome is Outcome.BAD)
        return f"Not ready: {names}"
    if counts[Outcome.LOOK]:
        names = ", ".join(check.name.lower() for check in checks if check.outcome is Outcome.LOOK)
        return f"Look at: {names}"
    if counts[Outcome.UNKNOWN]:
        return f"Ready, {counts[Outcome.UNKNOWN]} not measured yet"
    return "Ready"


def _ports(facts: Facts) -> Check:
    name = "Ports"
    if not facts.devices:
        return Check(name, Outcome.BAD, "no rig is open", "open a rig file and connect")
    silent = [device for device, status in facts.devices.items() if not status.connected]
    if silent:
        found = f"not responding: {' and '.join(silent)}"
        return Check(name, Outcome.BAD, found, "check power and cable, then Reconnect")
    return Check(name, Outcome.GOOD, f"all {len(facts.devices)} devices respond")


def _homed(facts: Facts) -> Check:
    name = "Homed"
    if not facts.devices:
        return Check(name, Outcome.UNKNOWN, "no rig is open")
    if facts.silent_axes:
        return Check(name, Outcome.UNKNOWN, _silent(facts), SILENT_REMEDY)
    if not facts.unreferenced:
        return Check(name, Outcome.GOOD, "all axes are referenced")
    found = "; ".join(f"{axis} is unreferenced: {reason}" for axis, reason in facts.unreferenced.items())
    by_home = [axis for axis in facts.unreferenced if axis in facts.homes]
    by_hand = [axis for axis in facts.unreferenced if axis not in facts.homes]
    ways = [f"home {' and '.join(by_home)}"] if by_home else []
    ways += [f"set the position of {' and '.join(by_hand)}"] if by_hand else []
    return Check(name, Outcome.BAD, found, f"on the bench, {' and '.join(ways)}")


def _limits(facts: Facts) -> Check:
    name = "Limits"
    known = [axis for axis in facts.limits_deg if axis in facts.positions_deg]
    if facts.silent_axes:
        return Check(name, Outcome.UNKNOWN, _silent(facts), SILENT_REMEDY)
    if not known:
        return Check(name, Outcome.UNKNOWN, "the axes report no positions")
    outside = []
    for axis in known:
        (low, high), here = facts.limits_deg[axis], facts.positions_deg[axis]
        if not low - LIMIT_TOLERANCE_DEG <= here <= high + LIMIT_TOLERANCE_DEG:
            outside.append(f"{axis} is at {here:.2f}°, outside {low:g} to {high:g}°".replace("-", "−"))
    if outside:
        return Check(name, Outcome.BAD, "; ".join(outside), "move it back within its soft limits, or correct its position")
    if doubtful := [axis for axis in known if axis in facts.unreferenced]:
        return Check(name, Outcome.UNKNOWN, f"unknown where an axis is unreferenced: {', '.join(doubtful)}")
    return Check(name, Outcome.GOOD, "all axes are within their soft limits")


def _silent(facts: Facts) -> str:
    return f"not responding: {', '.join(facts.silent_axes)}"


def _lamp(facts: Facts) -> Check:
    name = "Lamp"
    accepted = WARM_PERCENT if facts.warm_percent is None else facts.warm_percent
    trace = facts.monitor
    if trace is None or not trace.times_s:
        return Check(name, Outcome.UNKNOWN, "monitor not read with light yet", "on the bench open the shutter and read Live")
    slope = trace.slope()
    if slope is None:
        return Check(name, Outcome.UNKNOWN, "too few readings of the monitor for its change", "read Live for a minute or more")
    change, u = 100.0 * slope[0], 100.0 * slope[1]
    found = f"monitor {change:+.2f} % in 10 min (u {u:.2f} %), accepted {accepted:g} %".replace("-", "−")
    if facts.monitor_age_s is not None and facts.monitor_age_s > 600.0:
        found += f", {rounded_duration_text(facts.monitor_age_s)} ago"
        return Check(name, Outcome.LOOK, found, "read the monitor again")
    if trace.is_steady(0.01 * accepted):
        return Check(name, Outcome.GOOD, found)
    if abs(change) > accepted:
        return Check(name, Outcome.LOOK, found, "wait; a [warm_up] table in the schedule waits by itself")
    return Check(name, Outcome.LOOK, found, "read Live for longer: the uncertainty is too high")


def _dark(facts: Facts) -> Check:
    name = "Dark reading"
    oldest = DARK_S if facts.dark_every_s is None else facts.dark_every_s
    if facts.dark_age_s is None:
        return Check(name, Outcome.UNKNOWN, "none taken yet", "a run begins with one")
    found = f"{rounded_duration_text(facts.dark_age_s)} old, renewed after {rounded_duration_text(oldest)}"
    if facts.speed != 1.0:
        found += f" (simulated time, at {facts.speed:g}x)"
    if facts.dark_age_s > oldest:
        return Check(name, Outcome.LOOK, found, "a run begins with a new one")
    return Check(name, Outcome.GOOD, found)


def _drift(facts: Facts) -> Check:
    name = "Drift"
    if facts.drift:
        outcome = Outcome.LOOK if facts.drift_beyond else Outcome.GOOD
        return Check(name, outcome, facts.drift, "find the cause before the next run" if facts.drift_beyond else "")
    if facts.drift_planned is False:
        return Check(
            name, Outcome.LOOK, "the schedule has no drift checks", "a [drift] table would find a change of the instrument"
        )
    return Check(name, Outcome.UNKNOWN, "no drift check yet")


def _certificate(facts: Facts) -> Check:
    name = "Certificate"
    if facts.expires is None:
        if facts.calibrated is None and facts.virtual:
            return Check(name, Outcome.GOOD, "the etalon is that of a virtual rig: it needs no date")
        if facts.calibrated is None:
            found = "no date of calibration and no expiry date"
            remedy = "add calibrated to [etalon] in the rig file, or [certificate] to the schedule"
            return Check(name, Outcome.LOOK, found, remedy)
        age = (facts.today - facts.calibrated).days
        return Check(name, Outcome.GOOD, f"calibrated on {facts.calibrated}, {_days(age)} ago, without an expiry date")
    left = (facts.expires - facts.today).days
    which = f"{facts.certificate} " if facts.certificate else ""
    if left < 0:
        found = f"{which}expired on {facts.expires}, {_days(-left)} ago"
        if facts.accepted_by:
            return Check(name, Outcome.LOOK, f"{found}; accepted by {facts.accepted_by}", "have it calibrated again")
        return Check(name, Outcome.BAD, found, "have it calibrated again, or name a responsible person in [certificate]")
    found = f"{which}valid until {facts.expires}, {_days(left)} from now"
    return Check(name, Outcome.LOOK if left < SOON_DAYS else Outcome.GOOD, found, "have it renewed" if left < SOON_DAYS else "")


def _disk(facts: Facts) -> Check:
    name = "Disk"
    if facts.free_bytes is None:
        found = f"{facts.folder}: cannot be read" if facts.folder else "no folder for data files"
        return Check(name, Outcome.BAD, found, "choose another folder for the data files")
    found = f"{_size(facts.free_bytes)} free in {facts.folder}"
    needed = facts.needed_bytes
    if needed:
        found += f", the run takes about {_size(needed)}"
    if facts.free_bytes < max(LEAST_BYTES, 2 * needed):
        return Check(name, Outcome.BAD, found, "free some room, or choose another folder")
    if facts.free_bytes < max(LOW_BYTES, 10 * needed):
        return Check(name, Outcome.LOOK, found, "free some room soon")
    return Check(name, Outcome.GOOD, found)


def _days(count: int) -> str:
    return f"{count} day{'' if count == 1 else 's'}"


def _size(count: int) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= size:
            return f"{count / size:.3g} {unit}"
    return f"{count} bytes"
