"""The demonstration: a campaign on the virtual rig, and the deviation of its BSDF from theory."""

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.cut_figure import cut_figure
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset, reduce_journal
from goniotwin.app.cli.work.compilation import compile_ahead
from goniotwin.app.cli.work.row_progress import RowProgress
from goniotwin.app.data.comparison import DatasetComparison, compare_figure_13
from goniotwin.app.data.conversion import Choice, convert_reduced, format_to_write
from goniotwin.app.data.report.report import write_report
from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import make_folder
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.protocols.clock import RealClock

SAMPLE = "gaussian-5"


def run_demo(
    rig_path: Path, schedule_path: Path, out: Path, transcript: Path | None, console: Console
) -> tuple[dict[str, Any], Callable[[], None]]:
    """Run the demonstration. Returns the result for JSON, and a function that prints it. Raises UserError."""
    clock = RealClock()
    rig = read_rig(rig_path)
    schedule = read_schedule(schedule_path)
    files = {name: out / f"quick.{name}" for name in ("journal", "ddr", "csv", "png", "html")}
    make_folder(out)
    for file in files.values():
        file.unlink(missing_ok=True)
    compile_ahead()
    plan = make_plan(schedule, rig)
    reduced, seconds = _measure(plan, files["journal"], transcript, console, "with noise")
    with tempfile.TemporaryDirectory() as folder:
        quiet_plan = make_plan(schedule, _without_noise(rig))
        ideal, _ = _measure(quiet_plan, Path(folder) / "noise-free.journal", None, console, "noise-free")
    measured = compare_figure_13(rig, SAMPLE, reduced.samples[SAMPLE])
    noise_free = compare_figure_13(rig, SAMPLE, ideal.samples[SAMPLE])
    for name in ("ddr", "csv"):
        convert_reduced(reduced, files[name], format_to_write(files[name]), Choice(SAMPLE))
    cut_figure(reduced, SAMPLE, measured.by_sigma, files["png"])
    write_report(files["journal"], files["html"])
    result = {
        "rows": len(plan.rows),
        "duration_s": seconds,
        "foretold_s": plan.seconds,
        "wall_s": clock.now(),
        "relative_rms_percent": _by_sigma(measured),
        "noise_free_percent": _by_sigma(noise_free),
        "directions": {f"{each.light.sigma_deg:g}": each.count for each in measured.lights},
        "hidden_theta_deg": {f"{each.light.sigma_deg:g}": list(each.blocked_deg) for each in measured.lights},
        "simulated": rig.simulated,
        "seed": rig.seed,
        "findings": list(reduced.findings),
        "files": {name: str(file) for name, file in files.items()},
    }
    return result, lambda: _print_result(Console(highlight=False), result, measured, noise_free)


def _measure(plan: Plan, journal: Path, transcript: Path | None, console: Console, title: str) -> tuple[BsdfDataset, float]:
    with RowProgress(console, f"{plan.schedule.file.name}, {title}", len(plan.rows)) as progress:
        outcome = run_campaign(plan, journal, listeners=[progress], transcript=transcript)
    if outcome.state is State.IDLE:
        raise KeyboardInterrupt
    if outcome.state is not State.DONE:
        raise UserError(f"the demo ended {outcome.state} after {outcome.rows} rows: {'; '.join(outcome.faults)}")
    with Journal.open(journal) as opened:
        return reduce_journal(opened), outcome.seconds


def _without_noise(rig: RigDescription) -> RigDescription:
    """The same virtual rig without random processes."""
    assert rig.file.twin is not None
    return replace(rig, file=replace(rig.file, twin=replace(rig.file.twin, noise=False)))


def _by_sigma(found: DatasetComparison) -> dict[str, float]:
    return {f"{sigma:g}": percent for sigma, percent in found.by_sigma.items()}


def _print_result(console: Console, result: dict[str, Any], measured: DatasetComparison, noise_free: DatasetComparison) -> None:
    table = Table(title="Relative RMS against theory (formula 5), Gaussian of 5 deg", title_justify="left")
    for column in ("sigma", "measured", "noise-free", "directions", "blocked by the mirror unit"):
        table.add_column(column, justify="right" if column != "blocked by the mirror unit" else "left")
    for noisy, ideal in zip(measured.lights, noise_free.lights, strict=True):
        blocked = f"theta {noisy.blocked_deg[0]:g} to {noisy.blocked_deg[-1]:g} deg" if noisy.blocked_deg else ""
        table.add_row(
            f"{noisy.light.sigma_deg:g} deg",
            f"{noisy.relative_rms_percent:.2f} %",
            f"{ideal.relative_rms_percent:.2f} %",
            str(noisy.count),
            blocked,
        )
    console.print()
    console.print(table)
    console.print(
        "Plane of incidence, steps of 0.5 deg, theta <= 2 widths, zenith <= 85 deg; both sides of the specular direction.",
    )
    console.print(
        f"SIMULATED (seed {result['seed']}): {result['rows']} rows, {result['duration_s']:.0f} s simulated "
        f"(estimated {result['foretold_s']:.0f} s), {result['wall_s']:.1f} s elapsed."
    )
    for finding in result["findings"]:
        console.print(finding, style="yellow", markup=False, soft_wrap=True)
    for name, file in result["files"].items():
        console.print(f"  {name:8}{file}", markup=False, soft_wrap=True)
