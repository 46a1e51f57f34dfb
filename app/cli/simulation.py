"""The commands of `goniotwin simulate`: a sample's BSDF, the light on the sample, the paper's Table 3, the mirror's shadow."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer
import typer.core

from goniotwin.app.cli.output import CommandWithFormats, Dask, Json, Processes
from goniotwin.app.errors import UserError

RAYSET_RAYS = 100_000
WAVELENGTH_NM, INTERVAL_NM, BANDWIDTH_NM = 555.0, 0.0, 5.0
"""Defaults of the monochromator."""
Rig = Annotated[
    Path | None,
    typer.Option("--rig", metavar="RIG.toml", help="Simulate the instrument of this virtual rig.", show_default=False),
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
            help="Model of the sample: gaussian:width_deg=5, lambertian:reflectance=0.9, regular:reflectance=0.04, "
            "wide-tailed:width_deg=2, anisotropic-gaussian:along_deg=3,across_deg=12, ward:alpha_x=0.1,alpha_y=0.3, "
            "or table:FILE in a format of the list below. Add models with +. Add keys after commas: transmits=true, "
            "refraction=1.5 (for a gaussian that transmits), side=front, back or both.",
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
            help="File to write. Its suffix names a format of the list below. You can repeat the option.",
        ),
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(
            "--format",
            metavar="NAME",
            show_default=False,
            help="Format, if several formats share the suffix: FILE.bsdf is zemax, unless you give rgl here.",
        ),
    ] = None,
    estimator: Annotated[Literal["fast", "forward"], typer.Option("--estimator", help="Ray-tracing method.")] = "fast",
    rays: Annotated[
        int | None, typer.Option("--rays", help="fast: rays for each detector. The default is 7.", show_default=False)
    ] = None,
    paths: Annotated[int | None, typer.Option("--paths", help="forward: paths at each sigma.", show_default=False)] = None,
    error: Annotated[
        float | None,
        typer.Option(
            "--error", metavar="PERCENT", help="Trace until the median standard error is this small.", show_default=False
        ),
    ] = None,
    seed: Seed = 1,
    wavelength: Annotated[
        str | None, typer.Option("--wavelength", metavar="LIST", help="Wavelengths, nm. Each has a table.", show_default=False)
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
        typer.Option(
            "--theta", metavar="LIST", help="Output grid: angles from the specular direction, deg.", show_default=False
        ),
    ] = None,
    phi: Annotated[
        str | None,
        typer.Option(
            "--phi", metavar="LIST", help="Output grid: angles about the specular direction, deg.", show_default=False
        ),
    ] = None,
    psi: Annotated[
        str | None,
        typer.Option(
            "--psi",
            metavar="LIST",
            show_default=False,
            help="Azimuths of the light on an anisotropic sample, deg. The default is those of its table, or every 15.",
        ),
    ] = None,
    rig: Rig = None,
    no_obstruction: Annotated[bool, typer.Option("--no-obstruction", help="Ignore the shadow of the mirrors.")] = False,
    transmitted: Annotated[bool, typer.Option("--transmitted", help="Detect on the side that is not lit.")] = False,
    with_stray: Annotated[
        bool, typer.Option("--stray/--no-stray", help="Include light from the frames, and light scattered more than once.")
    ] = False,
    source: Annotated[
        Path | None,
        typer.Option(
            "--source", metavar="FILE.h5", help="forward: use this rayset, instead of a uniform pupil.", show_default=False
        ),
    ] = None,
    interval: Annotated[
        float | None,
        typer.Option("--interval", metavar="NM", help="Passband of full transmission of the rayset.", show_default=False),
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
            help="forward: keep finished batches of paths in this folder.",
        ),
    ] = None,
    processes: Processes = None,
    dask: Dask = None,
    as_json: Json = False,
) -> None:
    """Simulate the BSDF of a sample as the instrument measures it.

    The program measures the etalon and the sample, takes the ratio, and interpolates it on the output grid. A list has numbers
    with commas, or start:stop:step. By default, the detectors are 0.5 deg apart near the specular direction and up to 5 deg
    elsewhere. Directions that the mirrors block have no value. The comments of a table list them. FILE.u.ddr has the standard
    errors of FILE.ddr, on the same grid.

    An anisotropic sample has a table for each psi. Some formats hold a regular (mirror-like) reflection by itself: FILE.sdr,
    .sdt, .ssdd and .h5. If you write one of them, the other files have no spike for it: --out FILE.ddr --out FILE.sdr.

    Both estimators count light that the sample scattered once. With --stray they count all light that arrives.

    With --folder, you can interrupt the forward estimator. The same command then continues. --processes and --dask trace on
    several cores or other computers (page "Sweeps" of the documentation).
    """
    if sample is None or not out:
        missing = "--sample" if sample is None else "--out"
        raise UserError(
            f"simulate sample: {missing} is missing; write "
            "goniotwin simulate sample --sample gaussian:width_deg=5 --out FILE.ddr"
        )
    from goniotwin.app.cli.work.sample import SampleOptions, simulate_sample

    options = SampleOptions(
        sample=sample,
        sigma=sigma,
        lists={"wavelength": wavelength, "polar": polar, "azimuth": azimuth, "theta": theta, "phi": phi, "psi": psi},
        back=side == "back",
        transmitted=transmitted,
        stray=with_stray,
        estimator=(estimator, rays, paths, error, seed),
        instrument=(rig, no_obstruction),
        source=source,
        interval=interval,
        bandwidth=bandwidth,
        monochromator=(WAVELENGTH_NM, INTERVAL_NM, BANDWIDTH_NM),
    )
    simulate_sample(options, out, form, folder, (processes, dask), as_json)


@app.command()
def rigs(
    sample: Annotated[
        list[str],
        typer.Option(
            "--sample", metavar="MODEL", help="Model, as for goniotwin simulate sample. You can repeat it.", show_default=False
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE.csv", help="Table of all rigs to write.", show_default=False)],
    count: Annotated[int, typer.Option("--rigs", metavar="N", help="Number of random rigs.")] = 100,
    tilt: Annotated[float, typer.Option("--tilt", metavar="DEG", help="Largest tilt.")] = 0.05,
    shift: Annotated[float, typer.Option("--shift", metavar="MM", help="Largest shift.")] = 0.0,
    sigma: Annotated[str, typer.Option("--sigma", metavar="LIST", help="Angles of incidence, deg.")] = "0,30,60",
    polar: Annotated[str, typer.Option("--polar", metavar="LIST", help="Polar angles of the detectors, deg.")] = "0:85:1",
    azimuth: Annotated[str, typer.Option("--azimuth", metavar="LIST", help="Azimuths of the detectors, deg.")] = "0,180",
    seed: Seed = 1,
    folder: Annotated[
        Path | None,
        typer.Option("--folder", metavar="DIR", help="Folder for finished rigs. The default is FILE.rigs.", show_default=False),
    ] = None,
    processes: Processes = None,
    dask: Dask = None,
    rig: Rig = None,
    as_json: Json = False,
) -> None:
    """Simulate samples on random, misaligned rigs.

    For each rig, the program draws the 12 tilts and 15 shifts of mirrors, beam, sample and arc (Table 2 of the paper) evenly
    within --tilt and --shift. It compares the luminance factors with those of the aligned rig. The result is the relative RMS
    over all detectors with at least a hundredth of the largest value.

    A finished rig is not simulated again. After Ctrl-C the same command continues, and you can ask for more --rigs. With
    --dask, other computers simulate them (page "Sweeps" of the documentation).
    """
    from goniotwin.app.cli.work.rigs import RigsOptions, simulate_random_rigs

    options = RigsOptions(sample, tilt, shift, sigma, polar, azimuth, seed, rig)
    simulate_random_rigs(options, count, out, folder, (processes, dask), as_json)


@app.command()
def illumination(
    out: Annotated[
        Path,
        typer.Option("--out", metavar="FILE", help="File to write: .png with map and profile, or .csv.", show_default=False),
    ],
    wavelength: Annotated[float, typer.Option("--wavelength", metavar="NM", help="Wavelength.")] = WAVELENGTH_NM,
    interval: Annotated[
        float, typer.Option("--interval", metavar="NM", help="Passband of full transmission. 0 gives a triangle.")
    ] = INTERVAL_NM,
    bandwidth: Annotated[
        float, typer.Option("--bandwidth", metavar="NM", help="Width of each edge of the passband.")
    ] = BANDWIDTH_NM,
    error: Annotated[float, typer.Option("--error", metavar="PERCENT", help="Standard error of the forward flux.")] = 1.0,
    seed: Seed = 1,
    rayset: Annotated[
        Path | None,
        typer.Option(
            "--rayset", metavar="FILE.h5", help="Record the rays that leave the output condenser.", show_default=False
        ),
    ] = None,
    rays: Annotated[
        int | None,
        typer.Option("--rays", help=f"Number of rays in the rayset. The default is {RAYSET_RAYS}.", show_default=False),
    ] = None,
    deviation: Annotated[
        list[str] | None,
        typer.Option(
            "--deviation",
            metavar="ELEMENT.FIELD=NUMBER",
            help="Deviation of an element, deg or mm: slit.x_mm=0.02. You can repeat the option.",
            show_default=False,
        ),
    ] = None,
    rig: Rig = None,
    as_json: Json = False,
) -> None:
    """Simulate the light on the sample: uniformity and flux.

    The command also prints the divergence. Two estimators compute the flux (the paper's figure 8): forward rays from the arc
    lamp, and adjoint rays from the sample back to the lamp. Use a rayset with goniotwin simulate sample --source FILE.h5
    --estimator forward, and give the same --wavelength, --interval, --bandwidth and --rig.

    --deviation takes the elements arc, reflector, input_condenser, slit, output_condenser and unit. Their fields are rx_deg,
    ry_deg, rz_deg, x_mm, y_mm and z_mm. The deviations replace those of [twin.illumination] in the rig file. The rig that uses
    the rayset needs them too.
    """
    if rays is not None and rayset is None:
        raise UserError("--rays: is the number of rays in a rayset; give --rayset FILE.h5 too")
    from goniotwin.app.cli.work.illumination import simulate_light

    rayset_of = None if rayset is None else (rayset, RAYSET_RAYS if rays is None else rays)
    simulate_light(out, (wavelength, interval, bandwidth), error, seed, rayset_of, deviation or [], rig, as_json)


@app.command()
def table3(
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for figures 12 and 13.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Compute the paper's Table 3: relative RMS against theory.

    The columns are the paper's values, and ours without noise, with the sample tilted, and at the worst corner of all tilts.
    The command also prints the assumptions of each column, and what explains the paper's values.
    """
    from goniotwin.app.cli.work.table3 import print_deviations

    print_deviations(out, as_json)


@app.command()
def shadow(
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="File to write: .csv of all directions, or .png.", show_default=False)
    ],
    sigma: Annotated[str, typer.Option("--sigma", metavar="LIST", help="Angles of the mirror unit, deg.")] = "0,30,60",
    step: Annotated[float, typer.Option("--step", help="Step of polar angle and azimuth, deg.")] = 1.0,
    rig: Rig = None,
    as_json: Json = False,
) -> None:
    """Map the directions blocked by the mirror unit, on both arcs."""
    from goniotwin.app.cli.work.shadow import map_shadow

    map_shadow(out, sigma, step, rig, as_json)
