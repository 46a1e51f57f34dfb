"""The command `goniotwin simulate`: a sample's BSDF by the paper's scheme, the paper's Table 3, and shadows.

Options that several commands of `goniotwin simulate` have, and the rig that one of them names.

The command `goniotwin simulate illumination`: the light on the sample, and the rays that make it.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # the optics are compiled code, which a command's help has no need of
    from goniotwin.twin.optics import Instrument, SampleFrames

Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, everything else on standard error.")]
Rig = Annotated[
    Path | None,
    typer.Option("--rig", metavar="RIG.toml", help="The instrument of this virtual rig.", show_default=False),
]
Seed = Annotated[int, typer.Option("--seed", help="Of the random numbers, where there are any.")]
WAVELENGTH_NM, INTERVAL_NM, BANDWIDTH_NM = 555.0, 0.0, 5.0
"""Of the monochromator, unless told."""


def instrument_and_frames(rig: Path | None, no_obstruction: bool = False) -> "tuple[Instrument, SampleFrames]":
    """The defaults, or those of a virtual rig. Raises UserError for a rig that is real."""
    from goniotwin.app.rig import read_rig
    from goniotwin.twin.optics import Instrument, SampleFrames

    instrument, frames = Instrument(), SampleFrames()
    if rig is not None:
        model = read_rig(rig).model()
        if model is None:
            raise UserError(f"{rig}: is a real rig, whose optics nobody has written down; give a virtual one")
        instrument, frames = model.instrument, model.frames
    return (replace(instrument, obstruction=False) if no_obstruction else instrument), frames


RAYSET_RAYS = 100_000


def illumination(
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="A .png of map and profile, or a .csv.", show_default=False)
    ],
    wavelength: Annotated[float, typer.Option("--wavelength", metavar="NM", help="Of the monochromator.")] = WAVELENGTH_NM,
    interval: Annotated[
        float, typer.Option("--interval", metavar="NM", help="That passes whole; 0 is a triangle.")
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
        typer.Option("--rays", help=f"Of the rayset, instead of {RAYSET_RAYS}.", show_default=False),
    ] = None,
    rig: Rig = None,
    as_json: Json = False,
) -> None:
    """The light on the sample: how even it is, how far it diverges, and its flux by two estimators (the paper's figure 8).

    The forward one traces rays from the arc, the adjoint one from the sample back to it. A rayset is a source for
    goniotwin simulate --source FILE.h5 --estimator forward, with the same --wavelength, --interval, --bandwidth and --rig.
    """
    if rays is not None and rayset is None:
        raise UserError("--rays: is how many rays a rayset has; give --rayset FILE.h5 too")

    from rich.console import Console

    from goniotwin.app.cli.progress import ShareProgress
    from goniotwin.app.formats import FormatError, write_rayset
    from goniotwin.app.simulation.illumination import (
        check_file_names,
        format_estimate,
        simulate_illumination,
        summary,
        write_illumination,
    )
    from goniotwin.app.simulation.source import illumination_unit

    check_file_names(out, rayset)
    instrument, _ = instrument_and_frames(rig)
    unit = illumination_unit(instrument, wavelength, interval, bandwidth)
    wanted = None if rayset is None else (RAYSET_RAYS if rays is None else rays)
    with ShareProgress(Console(stderr=True), "illumination") as progress:
        found = simulate_illumination(unit, error, seed, wanted, progress)
    write_illumination(found, out)
    if rayset is not None and found.rayset is not None:
        try:
            write_rayset(rayset, found.rayset)
        except FormatError as fault:
            raise UserError(str(fault)) from None
    result = {"file": str(out), "rayset_file": None if rayset is None else str(rayset), **summary(found)}
    if as_json:
        print(json.dumps(result, indent=2, allow_nan=False))
        return
    side = f"{unit.field_side_mm:g} x {unit.field_side_mm:g} mm"
    told = ", ".join(format_estimate(*each) for each in (("forward", found.forward), ("adjoint", found.adjoint)))
    print(f"SIMULATED, the illumination of the sample: {out}")
    print(f"flux into {side}: {told}; they differ by {abs(found.difference_over_error):.1f} standard errors")
    width, width_error = found.adjoint.full_width_deg
    print(f"least over mean irradiance {found.adjoint.uniformity:.3f}; full width {width:.3f} +- {width_error:.3f} deg")
    if found.rayset is not None:
        count = found.rayset.flux.size
        print(f"rayset: {rayset}, {count} rays that carry {found.rayset.total_flux:.4g} {found.rayset.unit}")


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
app.command()(illumination)
SIGMA_END_DEG = 89.0


@app.callback(invoke_without_command=True)
def simulate(
    context: typer.Context,
    sample: Annotated[
        str | None,
        typer.Option(
            "--sample",
            metavar="MODEL",
            show_default=False,
            help="gaussian:width_deg=5, lambertian:reflectance=0.9, regular:reflectance=0.04, table:FILE (.bsdf, .ddr), or a "
            "sum of these with +. Keys follow commas: transmits=true (a gaussian, regular), refraction=1.5 (a gaussian "
            "that transmits), side=back or both.",
        ),
    ] = None,
    sigma: Annotated[
        str, typer.Option("--sigma", metavar="LIST", help="Angles of incidence on the lit side, deg: 0,30,60 or 0:85:5.")
    ] = "0,30,60",
    side: Annotated[Literal["front", "back"], typer.Option("--side", help="Of the sample, that is lit.")] = "front",
    out: Annotated[
        list[Path] | None,
        typer.Option(
            "--out",
            metavar="FILE",
            show_default=False,
            help="A .ddr (reflected) or .ddt (transmitted light), or a .csv of all detectors; may be repeated.",
        ),
    ] = None,
    estimator: Annotated[Literal["fast", "forward"], typer.Option("--estimator", help="How light is traced.")] = "fast",
    rays: Annotated[int | None, typer.Option("--rays", help="Fast: rays a detector, instead of 7.", show_default=False)] = None,
    paths: Annotated[int | None, typer.Option("--paths", help="Forward: paths at each sigma.", show_default=False)] = None,
    error: Annotated[
        float | None,
        typer.Option("--error", metavar="PERCENT", help="As much effort as the median error takes.", show_default=False),
    ] = None,
    seed: Seed = 1,
    wavelength: Annotated[
        str | None, typer.Option("--wavelength", metavar="LIST", help="Nanometres; a table for each.", show_default=False)
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
        typer.Option("--theta", metavar="LIST", help="Output grid: from the specular direction.", show_default=False),
    ] = None,
    phi: Annotated[
        str | None, typer.Option("--phi", metavar="LIST", help="Output grid: about the specular direction.", show_default=False)
    ] = None,
    rig: Rig = None,
    no_obstruction: Annotated[bool, typer.Option("--no-obstruction", help="Let light pass through the mirrors.")] = False,
    transmitted: Annotated[bool, typer.Option("--transmitted", help="Look at the side that is not lit.")] = False,
    with_stray: Annotated[
        bool, typer.Option("--stray/--no-stray", help="Light of the frames, and what met more than the sample, too.")
    ] = False,
    source: Annotated[
        Path | None,
        typer.Option("--source", metavar="FILE.h5", help="Forward: a rayset in place of a uniform pupil.", show_default=False),
    ] = None,
    interval: Annotated[
        float | None, typer.Option("--interval", metavar="NM", help="Of the rayset's monochromator.", show_default=False)
    ] = None,
    bandwidth: Annotated[
        float | None, typer.Option("--bandwidth", metavar="NM", help="Of the rayset's monochromator.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Simulate a sample's BSDF as the instrument measures it: etalon, sample, ratio, output grid, file.

    Lists are numbers with commas between, or start:stop:step. Without a grid the detectors stand 0.5 deg apart near the
    specular direction and up to 5 deg elsewhere. Directions that the mirrors hide have no value; a .ddr lists them.

    Both estimators count light that was scattered once, by the sample, and with --stray all that arrives.
    """
    if context.invoked_subcommand is not None:
        if sample is not None or out:
            raise UserError(
                f"simulate {context.invoked_subcommand}: takes neither --sample nor a file before its name; leave them out"
            )
        return
    if sample is None or not out:
        missing = "--sample" if sample is None else "--out"
        raise UserError(
            f"simulate: {missing} is missing; write goniotwin simulate --sample gaussian:width_deg=5 --out FILE.ddr"
        )
    from rich.console import Console

    from goniotwin.app.cli.progress import ShareProgress
    from goniotwin.app.rig.samples import parse_sample, table_files
    from goniotwin.app.simulation.detectors import parse_list
    from goniotwin.app.simulation.estimate import EstimatorSettings
    from goniotwin.app.simulation.files import check_file_names, summary, write_simulation
    from goniotwin.app.simulation.simulate import Task
    from goniotwin.app.simulation.simulate import simulate as simulated

    def given(text: str | None, name: str, low: float, high: float) -> Any:
        return None if text is None else parse_list(text, name, low, high)

    instrument, frames = instrument_and_frames(rig, no_obstruction)
    wavelengths = given(wavelength, "--wavelength", 200.0, 2500.0)
    read = table_files(sample) + ([] if source is None else [source])
    task = Task(
        sample=parse_sample(sample),
        sigma_deg=parse_list(sigma, "--sigma", 0.0, SIGMA_END_DEG),
        instrument=instrument,
        estimator=EstimatorSettings(estimator, rays, paths, error, seed),
        wavelengths_nm=wavelengths,
        back=side == "back",
        transmitted=check_file_names(out, read, transmitted),
        stray=with_stray,
        frames=frames,
        source=_source(source, wavelengths, interval, bandwidth, instrument),
        polar_deg=given(polar, "--polar", 0.0, 89.5),
        azimuth_deg=given(azimuth, "--azimuth", 0.0, 360.0),
        theta_deg=given(theta, "--theta", 0.0, 180.0),
        phi_deg=given(phi, "--phi", 0.0, 360.0),
    )
    with ShareProgress(Console(stderr=True), "simulating") as progress:
        found = simulated(task, progress)
    for path in out:
        write_simulation(found, path)
    result = summary(found, out)
    if as_json:
        print(json.dumps(result, indent=2, allow_nan=False))
        return
    _tell(result)


def _tell(result: dict[str, Any]) -> None:
    with_or_without = "with" if result["stray"] else "without"
    way = f"{'transmitted' if result['transmitted'] else 'reflected'} light, the {result['side']} lit"
    print(f"SIMULATED, {result['values']} values: {', '.join(result['files'])}")
    print(f"{way}, {with_or_without} stray light")
    if result["median_relative_standard_error_percent"] is not None:
        median, most = (result[f"{name}_relative_standard_error_percent"] for name in ("median", "largest"))
        print(f"relative standard error: median {median:.2g} %, largest {most:.2g} %")
    for peak in result["regular"]:
        largest = peak["largest_luminance_factor"]
        seen = "hidden or between the detectors" if largest is None else f"luminance factor up to {largest:.4g} here"
        within = f"within {peak['seen_within_deg']:.2f} deg of theta 0"
        print(f"regular component at sigma {peak['sigma']:g}: {peak['share']:.4g} of the light {within}, {seen}")
    for key, words in (("hidden_directions", "hidden by the mirrors"), ("directions_without_hits", "met by no path")):
        told = ", ".join(f"{count} at sigma {each}" for each, count in result[key].items() if count)
        if told:
            print(f"directions {words}: {told}")
    if not result["obstruction"]:
        print("obstruction is off: no direction is hidden")


def _source(path: Path | None, wavelengths: Any, interval: float | None, bandwidth: float | None, instrument: Any) -> Any:
    """The rayset that is to be the source, if any. Raises UserError."""
    from goniotwin.app.simulation.source import illumination_unit, read_source

    if path is None:
        given = [name for name, value in (("--interval", interval), ("--bandwidth", bandwidth)) if value is not None]
        if given:
            raise UserError(f"{given[0]}: is of a rayset's monochromator; give --source FILE.h5 too, or leave it out")
        return None
    if wavelengths is not None and wavelengths.size != 1:
        raise UserError(f"--source: a rayset is of one wavelength, --wavelength has {wavelengths.size}; give that one")
    unit = illumination_unit(
        instrument,
        WAVELENGTH_NM if wavelengths is None else float(wavelengths[0]),
        INTERVAL_NM if interval is None else interval,
        BANDWIDTH_NM if bandwidth is None else bandwidth,
    )
    return read_source(path, unit, instrument)


@app.command()
def table3(
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="A folder for figures 12 and 13.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """The paper's Table 3 beside ours: relative RMS against theory, noise-free, tilted, and at the worst corner.

    With the assumptions of each column, and what explains the paper's numbers and what does not.
    """
    from rich.console import Console

    from goniotwin.app.cli.progress import ShareProgress
    from goniotwin.app.simulation.paper.table3 import STEPS
    from goniotwin.app.simulation.paper.table3 import table3 as computed
    from goniotwin.app.simulation.paper.table3_report import as_dict, print_table3, write_figures

    done = 0

    def step(text: str) -> None:
        nonlocal done
        progress(done / STEPS, text)
        done += 1

    with ShareProgress(Console(stderr=True), "table 3") as progress:
        found = computed(step)
        progress(1.0, "done")
    files = {name: str(path) for name, path in write_figures(found, out).items()} if out is not None else {}
    if as_json:
        print(json.dumps({**as_dict(found), "files": files}, indent=2, allow_nan=False))
        return
    print_table3(Console(highlight=False), found)
    for name, path in files.items():
        print(f"{name}: {path}")


@app.command()
def shadow(
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="A .csv of all directions, or a .png.", show_default=False)
    ],
    sigma: Annotated[str, typer.Option("--sigma", metavar="LIST", help="Angles of the mirror unit, deg.")] = "0,30,60",
    step: Annotated[float, typer.Option("--step", help="Of polar angle and azimuth, deg.")] = 1.0,
    rig: Rig = None,
    as_json: Json = False,
) -> None:
    """Which directions the mirror unit hides from the photodiodes, on both arcs."""
    from goniotwin.app.simulation.detectors import parse_list
    from goniotwin.app.simulation.shadow import shadow_maps, write_shadows

    maps = shadow_maps(instrument_and_frames(rig)[0], [float(each) for each in parse_list(sigma, "--sigma", 0.0, 180.0)], step)
    write_shadows(maps, out)
    hidden = {
        f"{each.sigma_deg:g} {'lower' if each.lower else 'upper'}": int((each.visible[:, :-1] < 1.0).sum()) for each in maps
    }
    result = {
        "file": str(out), "simulated": True, "obstruction": maps[0].obstruction, "step_deg": step, "hidden_in_part": hidden,
    }  # fmt: skip
    if as_json:
        print(json.dumps(result, indent=2))
    else:
        told = "; ".join(f"sigma {name}: {count}" for name, count in hidden.items())
        print(f"SIMULATED, the shadow of the mirror unit: {out}\ndirections hidden in part at least: {told}")
