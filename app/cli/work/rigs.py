"""The simulation of samples on random, misaligned rigs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goniotwin.app.cli.output import RunnerOptions, answer, error_console, print_note
from goniotwin.app.cli.work.progress import SweepProgress
from goniotwin.app.cli.work.sweeps import kept, runner_of
from goniotwin.app.cli.work.virtual_instrument import AZIMUTH_DEG, POLAR_DEG, incidences, instrument_and_frames
from goniotwin.app.formats.registry import Holds
from goniotwin.app.rig.samples import parse_sample
from goniotwin.app.simulation.detectors import parse_list
from goniotwin.app.simulation.files import check_suffix
from goniotwin.app.simulation.rig_sweep import RigSweep, simulate_rigs, write_rigs
from goniotwin.app.sweeps.chunk_files import ChunkFiles


@dataclass(frozen=True)
class RigsOptions:
    """Samples, rigs and detectors; `sigma`, `polar` and `azimuth` are texts of lists."""

    samples: list[str]
    tilt_deg: float
    shift_mm: float
    sigma: str
    polar: str
    azimuth: str
    seed: int
    rig: Path | None


def simulate_random_rigs(
    options: RigsOptions, count: int, out: Path, folder: Path | None, runner_options: RunnerOptions, as_json: bool
) -> None:
    """Simulate the samples on so many rigs, write a table of all and print the spreads. Raises UserError."""
    check_suffix(out, Holds.COLUMNS)
    angles = np.meshgrid(
        parse_list(options.polar, "--polar", *POLAR_DEG), parse_list(options.azimuth, "--azimuth", *AZIMUTH_DEG), indexing="ij"
    )
    sweep = RigSweep(
        tuple(parse_sample(each) for each in options.samples),
        instrument_and_frames(options.rig)[0],
        incidences(options.sigma),
        angles[0].ravel(),
        angles[1].ravel(),
        options.tilt_deg,
        options.shift_mm,
        options.seed,
    )
    place = out.with_suffix(".rigs") if folder is None else folder
    files = ChunkFiles(place, sweep.specification, "--folder", "sample, instrument, grid, tilt, shift or seed", print_note)
    chunks = sweep.chunks(count)
    with (
        runner_of(runner_options, chunks) as runner,
        kept(place, "chunks of rigs"),
        SweepProgress(error_console(), f"{count} rigs", chunks, "chunks") as progress,
    ):
        results = simulate_rigs(sweep, count, files, runner, progress)
    within = f"tilts within {options.tilt_deg:g} deg and shifts within {options.shift_mm:g} mm"
    heading = [
        "SIMULATED: computed with the virtual prototype; nothing in this file is measured",
        f"random rigs: {within}, drawn evenly; seed {options.seed}",
        "relative_rms: of the luminance factors against those of the rig without them, over the detectors with at least a "
        "hundredth of the largest",
    ]
    write_rigs(results, out, heading)
    result = {"file": out, "folder": place, **results.as_dict()}

    def show() -> None:
        print(f"SIMULATED, {count} rigs with {within}: {out}")
        for each in results.spreads:
            print(
                f"{each.sample}, sigma {each.sigma:g}: relative RMS {each.median_percent:.2f} % in the median, "
                f"{each.percentile_95_percent:.2f} % at 95 %, {each.worst_percent:.2f} % on rig {each.worst_rig}"
            )

    answer(as_json, result, show)
