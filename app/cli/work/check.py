"""The check of a schedule against a rig."""

from pathlib import Path

from goniotwin.app.campaign.planning.check import check_plan, describe_check
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli.output import answer
from goniotwin.app.rig import read_rig


def check_schedule(schedule: Path, rig: Path, as_json: bool) -> None:
    """Print what a rig makes of a schedule. Raises UserError."""
    plan = make_plan(read_schedule(schedule), read_rig(rig))
    plan.rig.model()  # reads the files of the samples, so that an error in them shows now
    result, standards = check_plan(plan), ""
    document: object = result
    if plan.schedule.file.second_standard is not None:
        # Loads 311 modules more, numba and sqlite3 among them: 0.4 s, which a schedule with one standard does without.
        from goniotwin.app.campaign.studies.standards import expected_comparison

        expected = expected_comparison(plan)
        document = {**vars(result), "standards": expected}
        words = "no photodiode sees both standards" if expected is None else str(expected)
        standards = f"\n  standards   {' and '.join(plan.schedule.file.standards)}: {words}"
    answer(as_json, document, lambda: print(f"{describe_check(plan, result)}{standards}"))
