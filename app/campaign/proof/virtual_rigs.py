"""Virtual rigs that are off by what a rig file states, and their campaigns through the wires."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from goniotwin.app.campaign.planning.plan import NewPlan
from goniotwin.app.campaign.reduction.settings import SecondStandard
from goniotwin.app.campaign.rehearsal.rehearsal import run_on_twin
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.running.events import State
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.app.rig.inputs import CERTIFICATE_LEVEL, SECOND_LEVEL, inputs


class DrawnRigs:
    """The virtual rigs of a file: each off by what the file states as uncertain, with everything drawn from its seed.

    Keys that `[twin.disturbances]` has already are kept: a fault of which the rest of the file knows nothing. `etalon`: the
    name of that sample, with the uncertainty of its level by its certificate, and the years since its calibration; `second` has
    those of a second standard. Raises UserError where the file has no twin.
    """

    def __init__(
        self, rig: RigDescription, etalon: str, *, level: float, years: float, second: SecondStandard | None = None
    ) -> None:
        self._document = tomlkit.parse(rig.text)
        drawn = [each for each in inputs() if each.targets and each.u is not None]
        stated: dict[str, Any] = {each.key: rig.file.uncertainty.width(each) for each in drawn}
        stated |= {"etalon": etalon, CERTIFICATE_LEVEL.key: level, "etalon_years": years}
        if second is not None and second.turned:
            stated["turned"] = second.name
        elif second is not None:
            stated |= {"second_standard": second.name, SECOND_LEVEL.key: second.certificate.level, "second_years": second.years}
        twin = _table(self._document, "twin")
        _add(_table(twin, "disturbances"), stated)
        _add(_table(twin, "electronics"), {"gain_spread": rig.file.photodiodes.gain_uncertainty})
        _add(_table(twin, "monitor"), {"noise": rig.file.monitor.relative_uncertainty})
        self._simulated = _table(self._document, "simulated")
        self._first = parse_rig(tomlkit.dumps(self._document), rig.folder, rig.name, rig.alignment)

    def rig(self, seed: int) -> RigDescription:
        """The rig of a seed: its file differs from that of the others in the seed alone."""
        self._simulated["seed"] = seed
        file = self._first.file
        assert file.simulated is not None
        own = replace(file, simulated=replace(file.simulated, seed=seed))
        return replace(self._first, text=tomlkit.dumps(self._document), file=own)


def _table(table: Any, name: str) -> Any:
    if name not in table:
        table[name] = tomlkit.table()
    return table[name]


def _add(table: Any, values: dict[str, Any]) -> None:
    for key, value in values.items():
        if key not in table:
            table[key] = value


def run_with_wires(plan: NewPlan, path: Path) -> None:
    """Run the whole campaign of a plan on its virtual rig, on the virtual clock; the journal is left at `path`.

    Raises UserError where it does not come to its end.
    """
    photodiodes = plan.rig.file.photodiodes
    statistics = RowStatistics(photodiodes, lambda _: np.zeros(photodiodes.count, dtype=bool))
    run = run_on_twin(plan, path, statistics, [])
    if run.state is not State.DONE:
        reason = "; ".join(run.faults) or run.ended_by_schedule
        raise UserError(f"seed {plan.rig.seed}: the campaign ended after {run.rows} of {len(plan.rows)} rows: {reason}")
