"""The commands of `goniotwin simulate`: a sample's BSDF, the light on the sample, the paper's Table 3, the mirror's shadow."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
import typer.core

from goniotwin.app.cli.output import CommandWithFormats, Json, answer, error_console, print_note
from goniotwin.app.cli.sweeps import Dask, Processes, kept, runner_of
from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # the optics are compiled code, which a command's help does not need
    from goniotwin.app.simulation.simulate import Simulation, Task
    from goniotwin.app.simulation.source import Source
    from goniotwin.arrays import Floats
    from goniotwin.twin.optics import Instrument, SampleFrames

SIGMA_END_DEG = 89.0
RAYSET_RAYS = 100_000
WAVELENGTH_NM, INTERVAL_NM, BANDWIDTH_NM = 555.0, 0.0, 5.0
"""Defaults of the monochromator."""
Rig = Annotated[
    Path | None,
    typer.Option("--rig", metavar="RIG.toml", help="Take the instrument of this virtual rig.", show_default=False),
]
Seed = Annotated[int, typer.Option("--seed", help="Seed of the random numbers.")]


class SimulateGroup(typer.core.TyperGroup):
    """The commands of `simulate`. Without a command its options are those of `sample`, as in earlier versions."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments (the command-line library calls this)."""
        without = not args or (args[0].startswith("-") and args[0] not in self.get_help_option_names(ctx))
        if without and not ctx.resilient_parsing:  # a shell that completes needs the names of the commands
            args = ["sample", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(cls=SimulateGroup, help="Simulate samples, their light, and the paper's Table 3.")


@app.command("sample", cls=CommandWithFormats)
def simulate_sample(
    sample: Annotated[
        str | None,
        typer.Option(
            "--sample",
            metavar="MODEL",
            show_default=False,
            help="gaussian:width_deg=5, lambertian:reflectance=0.9, regular:reflectance=0.04, wide-tailed:width_deg=2, "
            "anisotropic-gaussian:along_deg=3,across_deg=12, ward:alpha_x=0.1,alpha_y=0.3, table:FILE (a table in a format "
            "of the list below), or a sum of these with +. More keys after commas: transmits=true, "
            "refraction=1.5 (a gaussian that transmits), side=front, back or both.",
        ),
    ] = None,
    sigma: Annotated[
        str, typer.Option("--sigma", metavar="LIST", help="Angles of incidence on the lit side, deg: 0,30,60 or 0:85:5.")
    ] = "0,30,60",
    side: Annotated[Literal["front", "back"], typer.Option("--side", help="Lit side of the sample.")] = "front",
    out: Annotated[
        list[Path] | None,
        typer.Option(
            "--out",
            metavar="FILE",
            show_default=False,
            help="The suffix names a format of the list below: a table, or the points of all detectors; may be repeated.",
        ),
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="NAME",
            show_default=False,
            help="Format of the files whose suffix several formats have: rgl for FILE.bsdf, which is zemax otherwise.",
        ),
    ] = None,
    estimator: Annotated[Literal["fast", "forward"], typer.Option("--estimator", help="Ray-tracing method.")] = "fast",
    rays: Annotated[
        int | None, typer.Option("--rays", help="fast: rays for each detector; default 7.", show_default=False)
    ] = None,
    paths: Annotated[int | None, typer.Option("--paths", help="forward: paths at each sigma.", show_default=False)] = None,
    error: Annotated[
        float | None,
        typer.Option("--error", metavar="PERCENT", help="Trace until the median standard error is this.", show_default=False),
    ] = None,
    seed: Seed = 1,
    wavelength: Annotated[
        str | None, typer.Option("--wavelength", metavar="LIST", help="Wavelengths, nm; a table for each.", show_default=False)
    ] = None,
    polar: Annotated[
        str | None,
        typer.Option("--polar", metavar="LIST", help="Polar angles of the detectors, deg.", show_default=False),
    ] = None,
    azimuth: Annotated[
        str | None, typer.Option("--azimuth", metavar="LIST", help="Azimuths of the detectors, deg.", show_default=False)
    ] = None,
    theta: Annotated[
        str | None,
        typer.Option("--theta", metavar="LIST", help="Output grid: from the specular direction, deg.", show_default=False),
    ] = None,
    phi: Annotated[
        str | None,
        typer.Option("--phi", metavar="LIST", help="Output grid: about the specular direction, deg.", show_default=False),
    ] = None,
    psi: Annotated[
        str | None,
        typer.Option(
            "--psi",
            metavar="LIST",
            show_default=False,
            help="Azimuths of the light in the frame of an anisotropic sample, deg; default: those of its table, or every 15.",
        ),
    ] = None,
    rig: Rig = None,
    no_obstruction: Annotated[bool, typer.Option("--no-obstruction", help="Without the shadow of the mirrors.")] = False,
    transmitted: Annotated[bool, typer.Option("--transmitted", help="Detect on the side that is not lit.")] = False,
    with_stray: Annotated[
        bool, typer.Option("--stray/--no-stray", help="With light from the frames and light scattered more than once.")
    ] = False,
    source: Annotated[
        Path | None,
        typer.Option("--source", metavar="FILE.h5", help="forward: rayset instead of a uniform pupil.", show_default=False),
    ] = None,
    interval: Annotated[
        float | None, typer.Option("--interval", metavar="NM", help="Passband of the rayset.", show_default=False)
    ] = None,
    bandwidth: Annotated[
        float | None, typer.Option("--bandwidth", metavar="NM", help="Edge width of the rayset's passband.", show_default=False)
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(
            "--folder",
            metavar="DIR",
            show_default=False,
            help="forward: keep finished batches of paths here; the same command continues.",
        ),
    ] = None,
    processes: Processes = None,
    dask: Dask = None,
    as_json: Json = False,
) -> None:
    """Simulate the BSDF of a sample as the instrument measures it.

    Steps: etalon, sample, ratio, output grid, file. Lists are numbers with commas, or start:stop:step. By default the
    detectors are 0.5 deg apart near the specular direction and up to 5 deg elsewhere. Directions that the mirrors block have
    no value; the comments of a table list them. The standard errors of FILE.ddr are in FILE.u.ddr, on the same grid.

    An anisotropic sample has a table for each psi. What a sample reflects like a mirror is no spike in the files if one of them
    has room for it (FILE.sdr, .sdt, .ssdd, .h5): give --out FILE.ddr --out FILE.sdr.

    Both estimators count light that was scattered once, by the sample; with --stray all light that arrives.

    With --folder a simulation with the forward estimator can be interrupted, and --processes and --dask trace it elsewhere
    (docs/sweeps.md).
    """
    if sample is None or not out:
        missing = "--sample" if sample is None else "--out"
        raise UserError(
            f"simulate sample: {missing} is missing; write "
            "goniotwin simulate sample --sample gaussian:width_deg=5 --out FILE.ddr"
        )
    # Loads 651 modules, numba and rich among them: 0.6 s, which help does without.
    from goniotwin.app.cli.progress import ShareProgress
    from goniotwin.app.rig.samples import parse_sample, table_files
    from goniotwin.app.simulation.detectors import parse_list
    from goniotwin.app.simulation.estimate import EstimatorSettings
    from goniotwin.app.simulation.files import check_file_names, summary, task_of_files, write_simulation
    from goniotwin.app.simulation.simulate import WAVELENGTH_LIMITS_NM, Task
    from goniotwin.app.simulation.simulate import simulate as simulate_task

    def parse(text: str | None, name: str, low: float, high: float) -> "Floats | None":
        return None if text is None else parse_list(text, name, low, high)

    instrument, frames = _instrument_and_frames(rig, no_obstruction)
    wavelengths = parse(wavelength, "--wavelength", *WAVELENGTH_LIMITS_NM)
    read = table_files(sample) + ([] if source is None else [source])
    task = Task(
        sample=parse_sample(sample),
        sigma_deg=parse_list(sigma, "--sigma", 0.0, SIGMA_END_DEG),
        instrument=instrument,
        estimator=EstimatorSettings(estimator, rays, paths, error, seed),
        wavelengths_nm=wavelengths,
        back=side == "back",
        transmitted=check_file_names(out, read, transmitted, form),
        stray=with_stray,
        frames=frames,
        source=_read_source(source, wavelengths, interval, bandwidth, instrument),
        polar_deg=parse(polar, "--polar", 0.0, 89.5),
        azimuth_deg=parse(azimuth, "--azimuth", 0.0, 360.0),
        theta_deg=parse(theta, "--theta", 0.0, 180.0),
        phi_deg=parse(phi, "--phi", 0.0, 360.0),
        psi_deg=parse(psi, "--psi", 0.0, 360.0),
    )
    task = task_of_files(task, out, form)
    if folder is not None:
        simulation = _simulate_in_chunks(task, folder, processes, dask)
    else:
        given = [name for name, value in (("--processes", processes), ("--dask", dask)) if value is not None]
        if given:
            raise UserError(f"{given[0]}: computes batches of paths that are kept; give --folder DIR too, or leave it out")
        with ShareProgress("simulating") as progress:
            simulation = simulate_task(task, progress)
    files = [file for path in out for file in write_simulation(simulation, path, form)]
    result = summary(simulation, files)
    answer(as_json, result, lambda: _print_summary(result))


@app.command()
def rigs(
    sample: Annotated[
        list[str],
        typer.Option("--sample", metavar="MODEL", help="As of goniotwin simulate sample; may be repeated.", show_default=False),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE.csv", help="Table of all rigs.", show_default=False)],
    count: Annotated[int, typer.Option("--rigs", metavar="N", help="Number of random rigs.")] = 100,
    tilt: Annotated[float, typer.Option("--tilt", metavar="DEG", help="Largest tilt.")] = 0.05,
    shift: Annotated[float, typer.Option("--shift", metavar="MM", help="Largest shift.")] = 0.0,
    sigma: Annotated[str, typer.Option("--sigma", metavar="LIST", help="Angles of incidence, deg.")] = "0,30,60",
    polar: Annotated[str, typer.Option("--polar", metavar="LIST", help="Polar angles of the detectors, deg.")] = "0:85:1",
    azimuth: Annotated[str, typer.Option("--azimuth", metavar="LIST", help="Their azimuths, deg.")] = "0,180",
    seed: Seed = 1,
    folder: Annotated[
        Path | None,
        typer.Option("--folder", metavar="DIR", help="Folder for finished rigs; default FILE.rigs.", show_default=False),
    ] = None,
    processes: Processes = None,
    dask: Dask = None,
    rig: Rig = None,
    as_json: Json = False,
) -> None:
    """Simulate samples on random, misaligned rigs.

    The 12 tilts and 15 shifts of mirrors, beam, sample and arc (Table 2 of the paper) are drawn evenly within --tilt and
    --shift, for each rig anew. Given is by how much the luminance factors differ from those of the rig without them:
    the relative RMS over all detectors with at least a hundredth of the largest value.

    Rigs that are done are not simulated again: after Ctrl-C the same command continues, more --rigs are added to those that are
    done, and with --dask other computers simulate them (docs/sweeps.md).
    """
    # Loads 688 modules, numba and rich among them: 0.7 s, which help does without.
    import numpy as np

    from goniotwin.app.cli.progress import SweepProgress
    from goniotwin.app.formats.registry import Holds
    from goniotwin.app.rig.samples import parse_sample
    from goniotwin.app.simulation.detectors import parse_list
    from goniotwin.app.simulation.files import check_suffix
    from goniotwin.app.simulation.rig_sweep import RigSweep, simulate_rigs, write_rigs
    from goniotwin.app.sweeps.chunk_files import ChunkFiles

    check_suffix(out, Holds.COLUMNS)
    angles = np.meshgrid(parse_list(polar, "--polar", 0.0, 89.5), parse_list(azimuth, "--azimuth", 0.0, 360.0), indexing="ij")
    sweep = RigSweep(
        tuple(parse_sample(each) for each in sample),
        _instrument_and_frames(rig)[0],
        parse_list(sigma, "--sigma", 0.0, SIGMA_END_DEG),
        angles[0].ravel(),
        angles[1].ravel(),
        tilt,
        shift,
        seed,
    )
    place = out.with_suffix(".rigs") if folder is None else folder
    files = ChunkFiles(place, sweep.specification, "--folder", "sample, instrument, grid, tilt, shift or seed", print_note)
    chunks = sweep.chunks(count)
    with (
        runner_of(processes, dask, chunks) as runner,
        kept(place, "chunks of rigs"),
        SweepProgress(error_console(), f"{count} rigs", chunks, "chunks") as progress,
    ):
        results = simulate_rigs(sweep, count, files, runner, progress)
    heading = [
        "SIMULATED: computed with the virtual prototype; nothing in this file is measured",
        f"random rigs: tilts within {tilt:g} deg and shifts within {shift:g} mm, drawn evenly; seed {seed}",
        "relative_rms: of the luminance factors against those of the rig without them, over the detectors with at least a "
        "hundredth of the largest",
    ]
    write_rigs(results, out, heading)
    result = {"file": out, "folder": place, **results.as_dict()}

    def show() -> None:
        print(f"SIMULATED, {count} rigs with tilts within {tilt:g} deg and shifts within {shift:g} mm: {out}")
        for each in results.spreads:
            print(
                f"{each.sample}, sigma {each.sigma:g}: relative RMS {each.median_percent:.2f} % in the median, "
                f"{each.percentile_95_percent:.2f} % at 95 %, {each.worst_percent:.2f} % on rig {each.worst_rig}"
            )

    answer(as_json, result, show)


@app.command()
def illumination(
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=".png of map and profile, or .csv.", show_default=False)],
    wavelength: Annotated[float, typer.Option("--wavelength", metavar="NM", help="Wavelength.")] = WAVELENGTH_NM,
    interval: Annotated[
        float, typer.Option("--interval", metavar="NM", help="Passband of full transmission; 0 is a triangle.")
    ] = INTERVAL_NM,
    bandwidth: Annotated[
        float, typer.Option("--bandwidth", metavar="NM", help="Width of each edge of the passband.")
    ] = BANDWIDTH_NM,
    error: Annotated[float, typer.Option("--error", metavar="PERCENT", help="Standard error of the forward flux.")] = 1.0,
    seed: Seed = 1,
    rayset: Annotated[
        Path | None,
        typer.Option("--rayset", metavar="FILE.h5", help="Record the rays that leave the unit.", show_default=False),
    ] = None,
    rays: Annotated[
        int | None,
        typer.Option("--rays", help=f"Rays in the rayset; default {RAYSET_RAYS}.", show_default=False),
    ] = None,
    deviation: Annotated[
        list[str] | None,
        typer.Option(
            "--deviation",
            metavar="ELEMENT.FIELD=NUMBER",
            help="Deviation of an element, deg or mm: slit.x_mm=0.02; as often as needed.",
            show_default=False,
        ),
    ] = None,
    rig: Rig = None,
    as_json: Json = False,
) -> None:
    """Simulate the light on the sample: uniformity and flux.

    Also its divergence. The flux comes from two estimators (the paper's figure 8): forward rays from the arc lamp, adjoint
    rays from the sample back to it. A rayset is a source for goniotwin simulate sample --source FILE.h5 --estimator forward,
    with the same --wavelength, --interval, --bandwidth and --rig.

    Elements with deviations are arc, reflector, input_condenser, slit, output_condenser and unit; fields are rx_deg, ry_deg,
    rz_deg, x_mm, y_mm, z_mm. They replace those of [twin.illumination] in the file of --rig, which a rayset's rig needs too.
    """
    if rays is not None and rayset is None:
        raise UserError("--rays: is the number of rays in a rayset; give --rayset FILE.h5 too")

    # Loads 709 modules, numba and matplotlib among them: 0.8 s, which help does without.
    from goniotwin.app.cli.progress import ShareProgress
    from goniotwin.app.formats.registry import Holds
    from goniotwin.app.simulation.files import write_content
    from goniotwin.app.simulation.illumination import (
        check_file_names,
        format_estimate,
        parse_deviations,
        simulate_illumination,
        summary,
        write_illumination,
    )
    from goniotwin.app.simulation.source import illumination_unit

    check_file_names(out, rayset)
    own = parse_deviations(deviation or [])
    instrument, _ = _instrument_and_frames(rig)
    instrument = replace(instrument, illumination={**instrument.illumination, **own})
    unit = illumination_unit(instrument, wavelength, interval, bandwidth)
    count = None if rayset is None else (RAYSET_RAYS if rays is None else rays)
    with ShareProgress("illumination") as progress:
        light = simulate_illumination(unit, error, seed, count, progress)
    write_illumination(light, out)
    if rayset is not None and light.rayset is not None:
        write_content(rayset, Holds.RAYS, light.rayset)
    result = {"file": out, "rayset_file": rayset, **summary(light)}

    def show() -> None:
        side = f"{unit.field_side_mm:g} x {unit.field_side_mm:g} mm"
        fluxes = ", ".join(format_estimate(*each) for each in (("forward", light.forward), ("adjoint", light.adjoint)))
        print(f"SIMULATED, the illumination of the sample: {out}")
        print(f"flux into {side}: {fluxes}; they differ by {abs(light.difference_over_error):.1f} standard errors")
        width, width_error = light.adjoint.full_width_deg
        print(f"minimum over mean irradiance {light.adjoint.uniformity:.3f}; full width {width:.3f} +- {width_error:.3f} deg")
        if light.rayset is not None:
            recorded = light.rayset
            print(f"rayset: {rayset}, {recorded.flux.size} rays that carry {recorded.total_flux:.4g} {recorded.unit}")

    answer(as_json, result, show)


@app.command()
def table3(
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for figures 12 and 13.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Compute the paper's Table 3: relative RMS against theory.

    Noise-free, tilted, and at the worst corner, beside the paper's values; with the assumptions of each column, and what
    explains the paper's values and what does not.
    """
    # Loads 714 modules, numba and matplotlib among them: 0.8 s, which help does without.
    from rich.console import Console

    from goniotwin.app.cli.progress import ShareProgress
    from goniotwin.app.formats.file import make_folder
    from goniotwin.app.simulation.paper.table3 import STEPS, compute_table3
    from goniotwin.app.simulation.paper.table3_report import as_dict, print_table3, write_figures

    if out is not None:
        make_folder(out)
    done = 0

    def step(text: str) -> None:
        nonlocal done
        progress(done / STEPS, text)
        done += 1

    with ShareProgress("table 3") as progress:
        table = compute_table3(step)
        progress(1.0, "done")
    files = {name: str(path) for name, path in write_figures(table, out).items()} if out is not None else {}

    def show_all() -> None:
        print_table3(Console(highlight=False), table)
        for name, path in files.items():
            print(f"{name}: {path}")

    answer(as_json, {**as_dict(table), "files": files}, show_all)


@app.command()
def shadow(
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help=".csv of all directions, or .png.", show_default=False)],
    sigma: Annotated[str, typer.Option("--sigma", metavar="LIST", help="Angles of the mirror unit, deg.")] = "0,30,60",
    step: Annotated[float, typer.Option("--step", help="Step of polar angle and azimuth, deg.")] = 1.0,
    rig: Rig = None,
    as_json: Json = False,
) -> None:
    """Map the directions blocked by the mirror unit, on both arcs."""
    # Loads 651 modules, numba and matplotlib among them: 0.8 s, which help does without.
    from goniotwin.app.simulation.detectors import parse_list
    from goniotwin.app.simulation.shadow import shadow_maps, write_shadows

    maps = shadow_maps(_instrument_and_frames(rig)[0], [float(each) for each in parse_list(sigma, "--sigma", 0.0, 180.0)], step)
    write_shadows(maps, out)
    blocked = {
        f"{each.sigma_deg:g} {'lower' if each.lower else 'upper'}": int((each.visible[:, :-1] < 1.0).sum()) for each in maps
    }
    result = {
        "file": out,
        "simulated": True,
        "obstruction": maps[0].obstruction,
        "step_deg": step,
        "hidden_in_part": blocked,
    }
    counts = "; ".join(f"sigma {name}: {count}" for name, count in blocked.items())
    text = f"SIMULATED, the shadow of the mirror unit: {out}\ndirections blocked, at least in part: {counts}"
    answer(as_json, result, lambda: print(text))


def _simulate_in_chunks(task: "Task", folder: Path, processes: int | None, dask: str | None) -> "Simulation":
    """Simulate by batches of paths that are kept in a folder. Raises UserError."""
    # Loads 679 modules, numba and rich among them: 0.7 s, which help does without.
    from goniotwin.app.cli.progress import SweepProgress
    from goniotwin.app.simulation.forward_sweep import ForwardSweep, simulate_in_chunks
    from goniotwin.app.sweeps.chunk_files import ChunkFiles

    sweep = ForwardSweep(task)
    files = ChunkFiles(folder, sweep.specification, "--folder", "simulation", print_note)
    # A batch takes all cores of a computer: several processes trace no faster.
    with (
        runner_of(1 if processes is None and dask is None else processes, dask, sweep.chunks) as runner,
        kept(folder, "batches"),
        SweepProgress(error_console(), "simulating", sweep.chunks, "batches") as progress,
    ):
        return simulate_in_chunks(sweep, files, runner, progress)


def _instrument_and_frames(rig: Path | None, no_obstruction: bool = False) -> "tuple[Instrument, SampleFrames]":
    """The default instrument and sample frames, or those of a virtual rig. Raises UserError for the file of a real rig."""
    # Loads 281 modules, numpy and pydantic among them: 0.3 s, which help does without.
    from goniotwin.app.rig import read_rig
    from goniotwin.twin.optics import Instrument, SampleFrames

    instrument, frames = Instrument(), SampleFrames()
    if rig is not None:
        model = read_rig(rig).model()
        if model is None:
            raise UserError(f"{rig}: is a real rig, whose optics are not described; give the file of a virtual rig")
        instrument, frames = model.instrument, model.frames
    return (replace(instrument, obstruction=False) if no_obstruction else instrument), frames


def _read_source(
    path: Path | None,
    wavelengths: "Floats | None",
    interval: float | None,
    bandwidth: float | None,
    instrument: "Instrument",
) -> "Source | None":
    """Read the rayset of --source. Raises UserError."""
    # Loads 416 modules, numba and numpy among them: 0.3 s, which help does without.
    from goniotwin.app.simulation.source import illumination_unit, read_source

    if path is None:
        given = [name for name, value in (("--interval", interval), ("--bandwidth", bandwidth)) if value is not None]
        if given:
            raise UserError(f"{given[0]}: describes a rayset; give --source FILE.h5 too, or leave it out")
        return None
    if wavelengths is not None and wavelengths.size != 1:
        raise UserError(f"--source: a rayset has one wavelength, --wavelength has {wavelengths.size}; give that one")
    unit = illumination_unit(
        instrument,
        WAVELENGTH_NM if wavelengths is None else float(wavelengths[0]),
        INTERVAL_NM if interval is None else interval,
        BANDWIDTH_NM if bandwidth is None else bandwidth,
    )
    return read_source(path, unit, instrument)


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
