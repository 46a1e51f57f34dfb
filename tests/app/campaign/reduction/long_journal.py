"""Journals of any number of rows, written without a rig: readings of a steady light, for tests of memory and time."""

from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.row import Reading, RowData
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import AXES, parse_rig
from tests.conftest import RIG, changed

FEW_PHOTODIODES = (
    ("upper_deg = [0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 85]", "upper_deg = [10, 30]"),
    ("lower_deg = [0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 85]", "lower_deg = [10, 30]"),
    (', "twin://virtual/adc-1", "twin://virtual/adc-2", "twin://virtual/adc-3", "twin://virtual/adc-4"]', "]"),
)
GAIN_V_PER_A, DARK_A, LIT_A = 1e10, 1e-12, 1e-6
SCHEDULE = """
name = "long"
samples = ["gaussian-5"]
etalon = "etalon"
sigma_deg = [15, 30]
beta_deg = { start = 0, stop = 180, step = 45 }
gains_v_per_a = [1e10]
readings = 1
dark_readings = 4
dark_every_s = 1000
order = ["shift", "beta", "sigma", "gamma", "wavelength"]
"""


def write_long_journal(
    path: Path, wavelengths: int, shifts: int, more: str = "", *, photodiodes: int = 4, step_deg: float = 0.25
) -> int:
    """Write the journal of a finished campaign with two sigmas and five betas; give the number of its rows.

    The shifts are `step_deg` apart. The rig has 4 `photodiodes`, or all 36 of the virtual rig.
    """
    last = 500.0 + 0.05 * (wavelengths - 1)
    of_arc = [step_deg * k for k in range(shifts)]
    grids = f"wavelength_nm = {{ start = 500, stop = {last:.2f}, step = 0.05 }}\nshift_deg = {of_arc}\n"
    text = RIG.read_text(encoding="utf-8")
    rig = parse_rig(changed(text, FEW_PHOTODIODES) if photodiodes == 4 else text, RIG.parent, "rig.toml")
    plan = make_plan(parse_schedule(SCHEDULE + grids + more, "long.toml"), rig)
    settings = rig.file.photodiodes
    zero = round(settings.range.zero)
    scatter = np.random.default_rng(1).integers(-3, 4, (64, 4, settings.count))
    dark, lit = (zero + scatter).astype(np.uint16), (zero + 12_000 + scatter[:, :1]).astype(np.uint16)
    with Journal.create(path, plan, software_versions(), durable=False) as journal:
        session = journal.begin_session(0.0, rig.text, software_versions())
        for t, row in enumerate(plan.rows):
            positions: dict[str, float | None] = {} if row.pose is None else dict(zip(AXES, row.pose, strict=True))
            counts, monitor_a = (dark, DARK_A) if row.kind == "dark" else (lit, LIT_A)
            readings = (Reading(GAIN_V_PER_A, t + 0.1, 0.1, monitor_a, counts[t % len(counts)]),) if row.kind != "mount" else ()
            journal.commit(row, RowData(float(t), t + 1.0, positions or None, readings))
        journal.end_session(session, float(len(plan.rows)), "done")
    return len(plan.rows)
