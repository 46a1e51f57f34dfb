"""What the planner is worth, and what it takes.

    python -m benchmarks.planner [--run] [--json]

Four schedules of examples/schedules: how long their plan is, how long it is in the nesting of paper-order.toml (each loop
always the same way, as there, and back and forth), and the bound that no order can beat (docs/decisions/0013). Then how long
`check` takes for a hundred thousand rows and for nearly a million. With --run five schedules are run on the twin, and their
foretold duration is held against that of the run.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.planning.check import checked_plan
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.planning.plan_lower_bound import least_seconds
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule, read_schedule
from goniotwin.app.campaign.wording import clock_time
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.protocols.clock import RealClock

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
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
GREAT = {
    "100,000 rows": "gains_v_per_a = [1e10]\nsigma_deg = { start = 0, stop = 70, step = 5 }\nwavelength_nm = [450, 550, 650]\n"
    "beta_deg = { start = 0, stop = 180, step = 2.5 }\nshift_deg = { start = 0, stop = 4.2, step = 0.3 }\n",
    "a million rows": "gains_v_per_a = [1e10]\nsigma_deg = { start = 0, stop = 78, step = 2 }\nwavelength_nm = [550]\n"
    "beta_deg = { start = 0, stop = 180, step = 0.75 }\nshift_deg = { start = 0, stop = 5, step = 0.1 }\n",
}


def nested_like_the_paper(schedule: ScheduleDescription, *, back_and_forth: bool) -> ScheduleDescription:
    """The same rows in the order of paper-order.toml."""
    order = read_schedule(EXAMPLES / "schedules" / "paper-order.toml").file.order
    text = f"order = {json.dumps(order)}\nback_and_forth = {json.dumps(back_and_forth)}\n{schedule.text}"
    return parse_schedule(text, schedule.name)


def orders(rig: RigDescription) -> list[dict[str, Any]]:
    """The four named schedules."""
    found = []
    for name in NAMED:
        schedule = read_schedule(EXAMPLES / "schedules" / f"{name}.toml")
        plan = make_plan(schedule, rig)
        rows = {row.identity for row in plan.rows if row.kind == "measure"}
        paper = {both: make_plan(nested_like_the_paper(schedule, back_and_forth=both), rig) for both in (False, True)}
        assert all({row.identity for row in each.rows if row.kind == "measure"} == rows for each in paper.values())
        found.append(
            {
                "schedule": name,
                "rows": len(plan.rows),
                "plan_s": plan.seconds,
                "over_bound": plan.seconds / least_seconds(plan),
                "paper_s": paper[False].seconds,
                "paper_ratio": paper[False].seconds / plan.seconds,
                "paper_back_and_forth_ratio": paper[True].seconds / plan.seconds,
            }
        )
    return found


def checking(rig: RigDescription, schedules: dict[str, str]) -> list[dict[str, Any]]:
    """How long a check takes, by its size."""
    found, clock = [], RealClock()
    for name, text in schedules.items():
        schedule = parse_schedule(HEAD + text, name)
        begun = clock.now()
        plan = make_plan(schedule, rig)
        checked_plan(plan)
        found.append({"schedule": name, "rows": len(plan.rows), "check_s": clock.now() - begun})
    return found


def runs(rig: RigDescription) -> list[dict[str, Any]]:
    """Foretold and run, on the twin."""
    found = []
    for name, text in RUN.items():
        plan = make_plan(parse_schedule(HEAD + text, name), rig)
        with tempfile.TemporaryDirectory() as folder:
            outcome = run_campaign(plan, Path(folder) / "run.journal")
        found.append({"schedule": name, "rows": len(plan.rows), "foretold_s": plan.seconds, "run_s": outcome.seconds})
    return found


def main() -> None:
    """Prints it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="store_true")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    rig = read_rig(EXAMPLES / "rigs" / "virtual.toml")
    found = {"orders": orders(rig), "checks": checking(rig, GREAT), "runs": runs(rig) if chosen.run else []}
    if chosen.json:
        print(json.dumps(found))
        return
    for each in found["orders"]:
        plan, paper = (clock_time(each[key]) for key in ("plan_s", "paper_s"))
        print(
            f"{each['schedule']:20} {each['rows']:7} rows {plan:>16}, {each['over_bound']:.4f} of the bound; the paper's order "
            f"{paper:>16}, {each['paper_ratio']:.2f} times as long ({each['paper_back_and_forth_ratio']:.2f} back and forth)"
        )
    for each in found["checks"]:
        print(f"{each['schedule']:20} {each['rows']:7} rows checked in {each['check_s']:.2f} s")
    for each in found["runs"]:
        error = each["foretold_s"] / each["run_s"] - 1.0
        print(f"{each['schedule']:34} foretold {each['foretold_s']:8.1f} s, run {each['run_s']:8.1f} s: {100 * error:+.2f} %")


if __name__ == "__main__":
    main()
