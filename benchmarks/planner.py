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
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.rig import RigDescription, read_rig
from tests.app.campaign.planning.planner_bench import EXAMPLES, GREAT, HEAD, NAMED, RUN, checking, nested_like_the_paper


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
                "over_bound": plan.seconds / plan.lower_bound_s,
                "paper_s": paper[False].seconds,
                "paper_ratio": paper[False].seconds / plan.seconds,
                "paper_back_and_forth_ratio": paper[True].seconds / plan.seconds,
            }
        )
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
        plan, paper = (duration_text(each[key]) for key in ("plan_s", "paper_s"))
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
