"""The demonstration: satin measured over the hemisphere on the virtual rig, its uncertainty, and its deviation from theory."""

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli.work.compilation import compile_ahead
from goniotwin.app.cli.work.row_progress import RowProgress
from goniotwin.app.data.comparison import DatasetComparison, compare, theory
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds.choice import relative_u_text
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.data.plotting import plot
from goniotwin.app.data.report.report import write_report
from goniotwin.app.data.values import ValueWithU
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import COVERAGE
from goniotwin.app.formats.file import make_folder
from goniotwin.app.rig import read_rig
from goniotwin.protocols.clock import RealClock

EARLIER = "goniotwin demo --out FOLDER writes elsewhere"
FIGURE_INCHES = (12.0, 4.2)


def run_demo(
    rig_path: Path, schedule_path: Path, out: Path, transcript: Path | None, console: Console
) -> tuple[dict[str, Any], Callable[[], None]]:
    """Run the demonstration. Returns the result for JSON, and a function that prints it. Raises UserError."""
    clock = RealClock()
    rig = read_rig(rig_path)
    schedule = read_schedule(schedule_path)
    files = {name: out / f"{schedule.file.name}.{name}" for name in ("journal", "csv", "png", "html")}
    make_folder(out)
    _remove_earlier(files, schedule.text)
    compile_ahead()
    plan = make_plan(schedule, rig)
    seconds = _measure(plan, files["journal"], transcript, console)
    dataset = open_dataset(files["journal"])
    found = compare(dataset, theory(dataset))
    dataset.save(files["csv"])
    draw_demo(dataset).savefig(files["png"], dpi=150)
    write_report(files["journal"], files["html"])
    lights = [
        {
            "sigma_deg": each.light.sigma_deg,
            "reflectance": _with_u(dataset.reflectance(sigma_deg=each.light.sigma_deg)),
            "specular_per_sr": _with_u(dataset.at(sigma_deg=each.light.sigma_deg, theta_deg=0.0, phi_deg=0.0)),
            "relative_rms_percent": each.relative_rms_percent,
            "chi_square": each.chi_square,
            "directions": each.degrees,
        }
        for each in found.lights
    ]
    result = {
        "rows": len(plan.rows),
        "duration_s": seconds,
        "foretold_s": plan.seconds,
        "wall_s": clock.now(),
        "simulated": rig.simulated,
        "seed": rig.seed,
        "lights": lights,
        "files": {name: str(file) for name, file in files.items()},
    }
    return result, lambda: _print_result(Console(highlight=False), result, dataset, found)


def draw_demo(dataset: Dataset) -> Figure:
    """The picture of the demonstration: the plane of incidence, and the hemisphere at each of two incidences."""
    figure = Figure(figsize=FIGURE_INCHES, layout="constrained")
    axes = figure.subplots(1, 3)
    plot(dataset, "cuts", ax=axes[0])
    plot(dataset, "hemisphere", ax=axes[1:])
    return figure


def _remove_earlier(files: dict[str, Path], schedule: str) -> None:
    """Remove the files of an earlier demo. Raises UserError, and removes none, where they may be of something else."""
    there = [each for each in files.values() if each.exists()]
    journal = files["journal"]
    if there and not (journal.exists() and _is_of_demo(journal, schedule)):
        raise UserError(f"{there[0]}: is of no earlier demo, and is kept; {EARLIER}")
    for each in there:
        each.unlink()


def _is_of_demo(journal: Path, schedule: str) -> bool:
    """Whether a file is the simulated journal of a schedule."""
    try:
        with JournalFollower(journal).reading() as opened:
            return opened.simulated and opened.value("schedule") == schedule
    except (UserError, OSError, sqlite3.Error):
        return False


def _measure(plan: Plan, journal: Path, transcript: Path | None, console: Console) -> float:
    """Run the campaign; returns its duration on the rig, s."""
    with RowProgress(console, plan.schedule.file.name, len(plan.rows)) as progress:
        outcome = run_campaign(plan, journal, listeners=[progress], transcript=transcript)
    if outcome.state is State.IDLE:
        raise KeyboardInterrupt
    if outcome.state is not State.DONE:
        raise UserError(f"the demo ended {outcome.state} after {outcome.rows} rows: {'; '.join(outcome.faults)}")
    return outcome.seconds


def _with_u(found: ValueWithU) -> dict[str, float]:
    return {"value": found.value, "u": found.u}


def _with_expanded(found: dict[str, float], digits: int) -> str:
    return f"{found['value']:.{digits}f} ± {COVERAGE * found['u']:.{digits}f}"


def _print_result(console: Console, result: dict[str, Any], dataset: Dataset, found: DatasetComparison) -> None:
    title = f"{dataset.sample} at {dataset.wavelength_nm[0]:g} nm, SIMULATED (seed {result['seed']}); ± U (k = {COVERAGE:g})"
    table = Table(title=title, title_justify="left")
    for column in ("sigma", "reflectance", "specular BRDF, 1/sr", "RMS from theory", "chi-square of directions"):
        table.add_column(column, justify="right")
    for each in result["lights"]:
        table.add_row(
            f"{each['sigma_deg']:g} deg",
            _with_expanded(each["reflectance"], 4),
            _with_expanded(each["specular_per_sr"], 3),
            f"{each['relative_rms_percent']:.2f} %",
            f"{each['chi_square']:.0f} of {each['directions']}",
        )
    console.print()
    console.print(table)
    console.print(
        f"{relative_u_text(dataset)} of the values. Theory is the known BSDF of the virtual sample. "
        f"RMS is by formula 5, {found.range}."
    )
    console.print(
        f"{result['rows']} rows: {result['duration_s']:.0f} s on the rig (estimated {result['foretold_s']:.0f} s), "
        f"{result['wall_s']:.1f} s here."
    )
    for name, file in result["files"].items():
        console.print(f"  {name:8}{file}", markup=False, soft_wrap=True)
