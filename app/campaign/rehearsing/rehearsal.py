"""The rehearsal: a whole campaign through the real drivers against the twin, on the virtual clock, before anyone measures.

Nothing of a real rig is opened: no port, and no lock. For its file a twin is built that the file describes; what that can find
and what not is said in app.rig.described_twin. A mounting takes no time here; at the rig a person takes some.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.campaign.journal.provenance import versions
from app.campaign.journal.writing import Journal
from app.campaign.planning.check import checked_plan
from app.campaign.planning.plan import Plan, make_plan
from app.campaign.reducing.reduction import BsdfPoints, Reduced, reduce_journal
from app.campaign.rehearsing.warnings import heeded, warnings_of
from app.campaign.rehearsing.watch import Watch
from app.campaign.running.engine import Engine
from app.campaign.running.events import Listener, State
from app.campaign.running.operator import BackDoor
from app.campaign.schedule.file import ScheduleDescription
from app.errors import UserError
from app.formats import FormatError, write_points_csv
from app.rig import OpenRig, RigDescription, open_rig, photodiode_settings
from app.rig.described_twin import described_twin
from protocols.clock import VirtualClock

Floats = npt.NDArray[np.float64]
PERCENTILES = (5, 50, 95)
WELL_KNOWN = 0.1
OF_POINTS = (
    "wavelength_nm", "sigma_deg", "gamma_deg", "beta_deg", "shift_deg", "photodiode", "zenith_deg", "azimuth_deg", "theta_deg",
    "phi_deg",
)  # fmt: skip


@dataclass(frozen=True)
class Rehearsal:
    """What it has shown. `result` is what `goniotwin rehearse --json` prints; `points` are by sample, where there are any."""

    plan: Plan
    result: dict[str, Any]
    points: dict[str, BsdfPoints]

    @property
    def done(self) -> bool:
        """Whether it came to its end."""
        return bool(self.result["state"] != State.FAILED)


@dataclass(frozen=True)
class Run:
    """How it ended, how many of the rig's seconds it took, what went wrong, and what was assumed of the axes."""

    state: State
    seconds: float
    faults: tuple[str, ...]
    assumed: tuple[str, ...]


def prepared(schedule: ScheduleDescription, rig: RigDescription, samples: Mapping[str, str]) -> tuple[Plan, tuple[str, ...]]:
    """The plan on a virtual rig, the one that the file is or describes, and what was assumed. Raises UserError."""
    file = schedule.file
    unknown = [name for name in samples if name not in (file.etalon, *file.samples)]
    if unknown:
        named = ", ".join((file.etalon, *file.samples))
        raise UserError(f"--sample {unknown[0]}: {schedule.name} has no such sample; it has {named}")
    described = described_twin(rig, file.etalon, file.samples, samples)
    return make_plan(schedule, described.rig), described.assumed


def rehearse(
    plan: Plan, assumed: tuple[str, ...] = (), *, out: Path | None = None, listeners: list[Listener] | None = None
) -> Rehearsal:
    """Runs a plan of `prepared`; its journal is thrown away, or `out`. Raises UserError, KeyboardInterrupt for a Ctrl-C."""
    watch = Watch(photodiode_settings(plan.rig.file), partial(heeded, plan))
    with tempfile.TemporaryDirectory(prefix="goniotwin-rehearsal-") as folder:
        path = out if out is not None else Path(folder) / "rehearsal.journal"
        run = performed(plan, path, watch, listeners or [])
        warnings = [*checked_plan(plan)["warnings"], *warnings_of(plan, watch)]
        reduced, trouble = _reduced(path)
        if trouble:
            warnings.append(f"nothing can be foretold of the uncertainty: {trouble}")
        if run.state is State.IDLE:
            warnings.append(f"it ends before all rows are measured: {watch.ended}")
        points = {} if reduced is None else reduced.samples
        result = {
            "simulated": True,
            "state": "failed" if run.state is State.FAILED else "done",
            "faults": list(run.faults),
            "rows": sum(block.rows for block in watch.blocks),
            "planned": len(plan.rows),
            "duration_s": run.seconds,
            "foretold_s": plan.seconds,
            "blocks": [vars(block) for block in watch.blocks],
            "axes_deg": watch.axes_deg,
            "counts": {
                "largest": max(watch.largest.values(), default=None),
                "share_of_range": {f"{gain:g}": share for gain, share in watch.share_of_range.items()},
            },
            "saturated": watch.saturated,
            "relative_uncertainty": {name: _spread(each) for name, each in points.items()},
            "lamp_hours": run.seconds / 3600.0,
            "journal_bytes": path.stat().st_size,
            "warnings": warnings,
            "assumed": [*assumed, *run.assumed],
        }
    return Rehearsal(plan, result, points)


def performed(plan: Plan, path: Path, watch: Watch, listeners: list[Listener]) -> Run:
    """The plan on its virtual rig, with `watch` and others listening; the journal is there afterwards. Raises as `rehearse`."""
    with open_rig(plan.rig, VirtualClock()) as opened:
        opened.connect()
        referenced = _referenced(opened)
        assert opened.virtual is not None
        with Journal.create(path, plan, versions(), durable=False) as journal:
            engine = Engine(opened.rig, plan, journal, BackDoor(opened.virtual), [watch, *listeners])
            state = engine.run()
            if state is State.IDLE and watch.ended == "stopped":
                raise KeyboardInterrupt
            return Run(state, journal.seconds, tuple(engine.faults), tuple(referenced))


def write_points(rehearsal: Rehearsal, path: Path) -> int:
    """Each direction with the uncertainty foretold for it, as CSV; returns how many. Raises UserError."""
    chosen = rehearsal.points
    if not chosen:
        raise UserError(f"{path}: no sample has come to a value, so there is nothing to write")
    columns: dict[str, npt.NDArray[Any]] = {
        "sample": np.concatenate([np.full(points.bsdf.size, name) for name, points in chosen.items()])
    }
    for column in OF_POINTS:
        columns[column] = np.concatenate([getattr(points, column) for points in chosen.values()])
    columns["bsdf_per_sr"] = np.concatenate([points.bsdf for points in chosen.values()])
    columns["relative_uncertainty"] = np.concatenate([_relative(points) for points in chosen.values()])
    columns["trusted"] = np.concatenate([points.good for points in chosen.values()])
    about = [
        f"SIMULATED: {rehearsal.plan.schedule.file.name} rehearsed on {rehearsal.plan.rig.file.name}; nothing here is real",
        "relative_uncertainty: the standard uncertainty foretold for a value, over the value; nothing where there is no value",
        "trusted: 0 where a direction is hidden, or its value otherwise not to be trusted",
        *(f"assumed: {each}" for each in rehearsal.result["assumed"]),
    ]
    try:
        write_points_csv(path, about, columns)
    except FormatError as error:
        raise UserError(str(error)) from None
    return int(columns["sample"].size)


def _referenced(opened: OpenRig) -> list[str]:
    """Axes of which nobody would know where they are after a power-up stand where the twin has them."""
    doubtful = [name for name, axis in opened.rig.axes.items() if axis.doubt]
    for name in doubtful:
        opened.rig.axes[name].assume_referenced()
    return [f"{name} has been referenced before the campaign begins (goniotwin home, goniotwin here)" for name in doubtful]


def _reduced(path: Path) -> tuple[Reduced | None, str]:
    """What the journal comes to, or why to nothing."""
    try:
        with Journal.open(path) as journal:
            return reduce_journal(journal), ""
    except UserError as error:
        return None, str(error).removeprefix(f"{path}: ")


def _relative(points: BsdfPoints) -> Floats:
    """Relative standard uncertainties; NaN where there is no value above zero."""
    value = np.where(points.bsdf > 0.0, points.bsdf, np.nan)
    relative: Floats = points.u_bsdf / value
    return relative


def _spread(points: BsdfPoints) -> dict[str, Any]:
    """Percentiles of the relative uncertainty over the directions that may be trusted, and how many there are of them,
    have a value above zero, and are known to a tenth of it."""
    relative = _relative(points)[points.good]
    known = relative[np.isfinite(relative)]
    spread: dict[str, Any] = {f"p{each:02d}": float(np.percentile(known, each)) if known.size else None for each in PERCENTILES}
    return {
        **spread,
        "directions": int(points.bsdf.size),
        "trusted": int(points.good.sum()),
        "above_zero": int(known.size),
        "to_a_tenth": int(np.sum(known <= WELL_KNOWN)),
    }
