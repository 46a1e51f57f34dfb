"""Schedules for tests of plan and check, and for `benchmarks/planner.py`: named examples, large ones, and ones to run."""

import json
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule, read_schedule
from goniotwin.app.rig import RigDescription
from goniotwin.protocols.clock import RealClock

EXAMPLES = Path(__file__).resolve().parents[4] / "examples"
NAMED = ("dense-lobe-spectral", "diffuse-spectral", "anisotropic", "transmission")
HEAD = 'name = "x"\nsamples = ["gaussian-5"]\netalon = "etalon"\n'
RUN = {
    "spectral": "gains_v_per_a = [1e10]\nsigma_deg = [15, 30]\nbeta_deg = { start = 0, stop = 180, step = 20 }\n"
    "wavelength_nm = { start = 400, stop = 700, step = 50 }\n",
    "near the specular direction": "gains_v_per_a = [1e8, 1e10]\nsigma_deg = [15, 30]\nwavelength_nm = [500, 600]\n"
    "beta_deg = { start = 0, stop = 180, step = 20 }\n[overlap]\npoints = 1\n[symmetry_check]\npoints = 2\n"
    "[near_specular]\nwithin_deg = 8\nshift_deg = { start = 0, stop = 4.5, step = 0.5 }\nbeta_step_deg = 5\n",
    "anisotropic": 'symmetry = "anisotropic"\ngains_v_per_a = [1e10]\nreadings = 16\nsigma_deg = [20, 60]\n'
    "gamma_deg = [0, 45, 90]\nbeta_deg = { start = 0, stop = 340, step = 20 }\nwavelength_nm = [550]\n",
    "both sides, signature, open beam": 'side = "both"\nlight = "both"\nsignature = true\nopen_beam = true\nrepeats = 2\n'
    "gains_v_per_a = [1e6, 1e10]\nsigma_deg = [0, 40]\nbeta_deg = [0, 45, 90, 135, 180]\nwavelength_nm = [450, 550]\n",
    "drift checks and warm-up": "gains_v_per_a = [1e8, 1e10]\nsigma_deg = [0, 30, 60]\nwavelength_nm = [550]\n"
    "beta_deg = { start = 0, stop = 180, step = 10 }\n[warm_up]\npercent_per_10min = 50\n"
    "[drift]\nevery_s = 50\nsigma_deg = 45\nbeta_deg = 90\nwavelength_nm = 550\nlimit = 0.5\n",
}
LARGE = {
    "100,000 rows": "gains_v_per_a = [1e10]\nsigma_deg = { start = 0, stop = 70, step = 5 }\nwavelength_nm = [450, 550, 650]\n"
    "beta_deg = { start = 0, stop = 180, step = 2.5 }\nshift_deg = { start = 0, stop = 4.2, step = 0.3 }\n",
    "a million rows": "gains_v_per_a = [1e10]\nsigma_deg = { start = 0, stop = 78, step = 2 }\nwavelength_nm = [550]\n"
    "beta_deg = { start = 0, stop = 180, step = 0.75 }\nshift_deg = { start = 0, stop = 5, step = 0.1 }\n",
}


def with_paper_order(schedule: ScheduleDescription, *, back_and_forth: bool) -> ScheduleDescription:
    """The same rows in the order of paper-order.toml."""
    order = read_schedule(EXAMPLES / "schedules" / "paper-order.toml").file.order
    text = f"order = {json.dumps(order)}\nback_and_forth = {json.dumps(back_and_forth)}\n{schedule.text}"
    return parse_schedule(text, schedule.name)


def time_checks(rig: RigDescription, schedules: dict[str, str]) -> list[dict[str, Any]]:
    """Seconds that plan and check take for each schedule, with its number of rows."""
    results, clock = [], RealClock()
    for name, text in schedules.items():
        schedule = parse_schedule(HEAD + text, name)
        start = clock.now()
        plan = make_plan(schedule, rig)
        check_plan(plan)
        results.append({"schedule": name, "rows": len(plan.rows), "check_s": clock.now() - start})
    return results
