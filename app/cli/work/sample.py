"""The simulation of a sample's BSDF."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from goniotwin.app.cli.output import RunnerOptions, answer, error_console, print_note
from goniotwin.app.cli.work.progress import ShareProgress, SweepProgress
from goniotwin.app.cli.work.sweeps import kept, runner_of
from goniotwin.app.cli.work.virtual_instrument import AZIMUTH_DEG, POLAR_DEG, incidences, instrument_and_frames
from goniotwin.app.errors import UserError
from goniotwin.app.rig.samples import parse_sample, table_files
from goniotwin.app.simulation.detectors import parse_list
from goniotwin.app.simulation.estimate import EstimatorSettings
from goniotwin.app.simulation.files import check_file_names, summary, task_of_files, write_simulation
from goniotwin.app.simulation.forward_sweep import ForwardSweep, simulate_in_chunks
from goniotwin.app.simulation.simulate import WAVELENGTH_LIMITS_NM, Simulation, Task, simulate
from goniotwin.app.simulation.source import Source, illumination_unit, read_source
from goniotwin.app.sweeps.chunk_files import ChunkFiles
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument

LIMITS = {
    "wavelength": WAVELENGTH_LIMITS_NM,
    "polar": POLAR_DEG,
    "azimuth": AZIMUTH_DEG,
    "theta": (0.0, 180.0),
    "phi": AZIMUTH_DEG,
    "psi": AZIMUTH_DEG,
}
"""Limits of the numbers of an option that is a list; nm, deg."""


@dataclass(frozen=True)
class SampleOptions:
    """Options of the simulation.

    `lists` are the texts of the options in LIMITS, `estimator` the fields of EstimatorSettings, `instrument` the rig file and
    whether the mirrors block no direction, `monochromator` the wavelength, interval and bandwidth of a rayset by default.
    """

    sample: str
    sigma: str
    lists: dict[str, str | None]
    back: bool
    transmitted: bool
    stray: bool
    estimator: tuple[Literal["fast", "forward"], int | None, int | None, float | None, int]
    instrument: tuple[Path | None, bool]
    source: Path | None
    interval: float | None
    bandwidth: float | None
    monochromator: tuple[float, float, float]

    def numbers(self, name: str) -> Floats | None:
        """The numbers of a list, None where it is not given. Raises UserError."""
        text = self.lists[name]
        return None if text is None else parse_list(text, f"--{name}", *LIMITS[name])


def simulate_sample(
    options: SampleOptions, out: list[Path], form: str | None, folder: Path | None, runner_options: RunnerOptions, as_json: bool
) -> None:
    """Simulate a sample, write its files and print a summary. Raises UserError."""
    instrument, frames = instrument_and_frames(*options.instrument)
    wavelengths = options.numbers("wavelength")
    read = table_files(options.sample) + ([] if options.source is None else [options.source])
    task = Task(
        sample=parse_sample(options.sample),
        sigma_deg=incidences(options.sigma),
        instrument=instrument,
        estimator=EstimatorSettings(*options.estimator),
        wavelengths_nm=wavelengths,
        back=options.back,
        transmitted=check_file_names(out, read, options.transmitted, form),
        stray=options.stray,
        frames=frames,
        source=_read_source(options, wavelengths, instrument),
        polar_deg=options.numbers("polar"),
        azimuth_deg=options.numbers("azimuth"),
        theta_deg=options.numbers("theta"),
        phi_deg=options.numbers("phi"),
        psi_deg=options.numbers("psi"),
    )
    task = task_of_files(task, out, form)
    if folder is not None:
        simulation = _simulate_batches(task, folder, runner_options)
    else:
        given = [name for name, value in zip(("--processes", "--dask"), runner_options, strict=True) if value is not None]
        if given:
            raise UserError(f"{given[0]}: computes batches of paths that are kept; give --folder DIR too, or leave it out")
        with ShareProgress("simulating") as progress:
            simulation = simulate(task, progress)
    files = [file for path in out for file in write_simulation(simulation, path, form)]
    result = summary(simulation, files)
    answer(as_json, result, lambda: _print_summary(result))


def _simulate_batches(task: Task, folder: Path, runner_options: RunnerOptions) -> Simulation:
    """Simulate the batches that the folder does not have. Raises UserError."""
    sweep = ForwardSweep(task)
    files = ChunkFiles(folder, sweep.specification, "--folder", "simulation", print_note)
    # A batch takes all cores of a computer: several processes trace no faster.
    with (
        runner_of((1, None) if runner_options == (None, None) else runner_options, sweep.chunks) as runner,
        kept(folder, "batches"),
        SweepProgress(error_console(), "simulating", sweep.chunks, "batches") as progress,
    ):
        return simulate_in_chunks(sweep, files, runner, progress)


def _read_source(options: SampleOptions, wavelengths: Floats | None, instrument: Instrument) -> Source | None:
    """Read the rayset of --source. Raises UserError."""
    if options.source is None:
        passband = (("--interval", options.interval), ("--bandwidth", options.bandwidth))
        given = [name for name, value in passband if value is not None]
        if given:
            raise UserError(f"{given[0]}: describes a rayset; give --source FILE.h5 too, or leave it out")
        return None
    if wavelengths is not None and wavelengths.size != 1:
        raise UserError(f"--source: a rayset has one wavelength, --wavelength has {wavelengths.size}; give that one")
    usual = options.monochromator
    unit = illumination_unit(
        instrument,
        usual[0] if wavelengths is None else float(wavelengths[0]),
        usual[1] if options.interval is None else options.interval,
        usual[2] if options.bandwidth is None else options.bandwidth,
    )
    return read_source(options.source, unit, instrument)


def _share(regular: dict[str, Any]) -> str:
    """The share of the light, or its range over the wavelengths, in words."""
    shares = regular["share"] if isinstance(regular["share"], list) else [regular["share"]]
    ends = dict.fromkeys(f"{each:.4g}" for each in (min(shares), max(shares)))
    return " to ".join(ends)


def _print_summary(result: dict[str, Any]) -> None:
    """Print the result of a simulation as text."""
    with_or_without = "with" if result["stray"] else "without"
    if psi := result["psi"]:
        several = f"{len(psi)} azimuths of the light, psi {psi[0]:g} to {psi[-1]:g}"
        print(f"anisotropic: {several if len(psi) > 1 else f'psi {psi[0]:g} alone, which a table states for every psi'}")
    light = f"{'transmitted' if result['transmitted'] else 'reflected'} light, the {result['side']} lit"
    values = f"{result['values']} values" if result["detectors"] else "the regular component alone"
    print(f"SIMULATED, {values}: {', '.join(result['files'])}")
    print(f"{light}, {with_or_without} stray light")
    if result["median_relative_standard_error_percent"] is not None:
        median, largest = (result[f"{name}_relative_standard_error_percent"] for name in ("median", "largest"))
        print(f"relative standard error: median {median:.2g} %, largest {largest:.2g} %")
    for peak in result["regular"]:
        factor = peak["largest_luminance_factor"]
        place = "blocked or between the detectors" if factor is None else f"luminance factor up to {factor:.4g} here"
        within = f"within {peak['seen_within_deg']:.2f} deg of theta 0"
        print(f"regular component at sigma {peak['sigma']:g}: {_share(peak)} of the light {within}, {place}")
    if result["regular"]:
        print("the values contain what the detectors see of it; a second --out FILE.sdr (.sdt, .ssdd) takes it apart")
    if result["regular_apart"]:
        shares = "; ".join(f"{_share(each)} of the light at sigma {each['sigma']:g}" for each in result["regular_apart"])
        print(f"regular component, apart: {shares}")
    for note in result["notes"]:
        print(note)
    for key, words in (("hidden_directions", "blocked by the mirrors"), ("directions_without_hits", "without a path")):
        counts = ", ".join(f"{count} at sigma {each}" for each, count in result[key].items() if count)
        if counts:
            print(f"directions {words}: {counts}")
    if not result["obstruction"]:
        print("obstruction is off: no direction is blocked")
