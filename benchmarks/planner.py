"""Benchmark of the planner.

    python -m benchmarks.planner [--run] [--json]

For four schedules of examples/schedules: the duration of the plan, its duration in the loop order of paper-order.toml (each
loop always in the same direction, as there, and back and forth), and the lower bound (docs/decisions/0013). Then the time that
`check` takes for a hundred thousand rows and for nearly a million. With --run five schedules are run on the twin, and their
estimated duration is compared with that of the run.
"""

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.rig import RigDescription, read_rig
from tests.app.campaign.planning.planner_bench import EXAMPLES, HEAD, LARGE, NAMED, RUN, time_checks, with_paper_order


def orders(rig: RigDescription) -> list[dict[str, Any]]:
    """Durations of the four named schedules."""
    results = []
    for name in NAMED:
        schedule = read_schedule(EXAMPLES / "schedules" / f"{name}.toml")
        plan = make_plan(schedule, rig)
        rows = {row.identity for row in plan.rows if row.kind == "measure"}
        paper = {both: make_plan(with_paper_order(schedule, back_and_forth=both), rig) for both in (False, True)}
        assert all({row.identity for row in each.rows if row.kind == "measure"} == rows for each in paper.values())
        results.append(
            {
                "schedule": name,
                "rows": len(plan.rows),
                "plan_s": plan.seconds,
                "over_bound": plan.seconds / plan.lower_bound_s,
                "paper_s": paper[False].seconds,
                "paper_ratio": paper[False].seconds / plan.seconds,
                "paper_back_and_forth_ratio": paper[True].seconds / plan.seconds,
            }
        )
    return results


def runs(rig: RigDescription) -> list[dict[str, Any]]:
    """Estimated durations and those of runs on the twin."""
    results = []
    for name, text in RUN.items():
        plan = make_plan(parse_schedule(HEAD + text, name), rig)
        with tempfile.TemporaryDirectory() as folder:
            outcome = run_campaign(plan, Path(folder) / "run.journal")
        results.append({"schedule": name, "rows": len(plan.rows), "foretold_s": plan.seconds, "run_s": outcome.seconds})
    return results


def main() -> None:
    """Run the benchmark and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rig = read_rig(EXAMPLES / "rigs" / "virtual.toml")
    results = {"orders": orders(rig), "checks": time_checks(rig, LARGE), "runs": runs(rig) if arguments.run else []}
    if arguments.json:
        print(json.dumps(results))
        return
    for each in results["orders"]:
        plan, paper = (duration_text(each[key]) for key in ("plan_s", "paper_s"))
        back_and_forth = f"{each['paper_back_and_forth_ratio']:.2f} back and forth"
        print(
            f"{each['schedule']:20} {each['rows']:7} rows {plan:>16}, {each['over_bound']:.4f} of the lower bound; "
            f"the paper's order {paper:>16}, {each['paper_ratio']:.2f} times as long ({back_and_forth})"
        )
    for each in results["checks"]:
        print(f"{each['schedule']:20} {each['rows']:7} rows checked in {each['check_s']:.2f} s")
    for each in results["runs"]:
        error = each["foretold_s"] / each["run_s"] - 1.0
        print(f"{each['schedule']:34} estimated {each['foretold_s']:8.1f} s, run {each['run_s']:8.1f} s: {100 * error:+.2f} %")


if __name__ == "__main__":
    main()
