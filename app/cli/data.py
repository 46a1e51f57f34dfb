"""Commands on data: `goniotwin export`, `convert`, `info`, `align`, `budget`, `verify`, `closure` and `copy`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from goniotwin.app.cli.output import CommandWithFormats, Json, answer, print_error
from goniotwin.app.errors import UserError
from goniotwin.app.formats.fills import Fill

JournalArgument = Annotated[
    Path, typer.Argument(metavar="JOURNAL", help="Data file (journal) of a campaign.", show_default=False)
]

app = typer.Typer()


FormatOption = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="FORMAT",
        help="File format, from the list below. By default the suffix of the file decides.",
        show_default=False,
    ),
]
SampleOption = Annotated[str | None, typer.Option("--sample", help="Which sample, if there are several.", show_default=False)]
LightOption = Annotated[
    Literal["reflected", "transmitted"] | None,
    typer.Option("--light", help="Which light, if the data have both and the format holds one.", show_default=False),
]
SideOption = Annotated[
    Literal["front", "back"] | None,
    typer.Option("--side", help="Which lit side, if there are both. A format for one side gets the front.", show_default=False),
]
WavelengthOption = Annotated[
    str | None,
    typer.Option(
        "--wavelength", metavar="NM|all", help="One wavelength. With all, one file each: NAME.550nm.bsdf.", show_default=False
    ),
]
FillOption = Annotated[
    Fill,
    typer.Option("--fill", help='How to fill directions that were not measured: see "Formats" in the documentation.'),
]
DamagedOption = Annotated[
    bool, typer.Option("--without-damaged", help="Leave out damaged rows. Otherwise they prevent the output.")
]


@app.command(cls=CommandWithFormats)
def export(
    journal: JournalArgument,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="File to write.", show_default=False)],
    file_format: FormatOption = None,
    sample: SampleOption = None,
    light: LightOption = None,
    side: SideOption = None,
    wavelength: WavelengthOption = None,
    fill: FillOption = "hold",
    without_damaged: DamagedOption = False,
    as_json: Json = False,
) -> None:
    """Reduce a data file (journal) and write the BSDF.

    The journal is not changed. A .csv file has every measured point, with its standard uncertainty.

    A table such as FILE.ddr is in specular coordinates and has no gaps. The program fills directions without a measurement,
    and lists them at the top of the table. FILE.u.ddr has the standard uncertainties on the same grid. FILE.mask.ddr marks what
    was not measured.

    An archive (.h5) has everything: points, tables, covariance, schedule, rig and raw counts.

    Exit status: 1 if the journal differs from what was measured, row by row or as a whole.
    """
    from goniotwin.app.cli.work.conversion import convert_to_file

    choice = (sample, light, side, wavelength, fill)
    convert_to_file(journal, out, file_format, choice, without_damaged, as_json, of_journal=True)


@app.command(cls=CommandWithFormats)
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="File of any format, or a journal.", show_default=False)],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="File to write.", show_default=False)],
    file_format: FormatOption = None,
    sample: SampleOption = None,
    light: LightOption = None,
    side: SideOption = None,
    wavelength: WavelengthOption = None,
    fill: FillOption = "hold",
    without_damaged: DamagedOption = False,
    as_json: Json = False,
) -> None:
    """Convert a BSDF from one file format to another.

    The program recognises the format of IN by its content. It reduces a journal as goniotwin export does. It refuses or names
    what the other format cannot hold. It also writes the uncertainties, and the mask of what was not measured. If the format
    has no room for them, they go to OUT.u and OUT.mask.

    Exit status: 1 if a journal differs from what was measured, row by row or as a whole.
    """
    from goniotwin.app.cli.work.conversion import convert_to_file

    choice = (sample, light, side, wavelength, fill)
    convert_to_file(source, out, file_format, choice, without_damaged, as_json, of_journal=False)


@app.command()
def info(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File of any format, or a journal.", show_default=False)],
    as_json: Json = False,
) -> None:
    """State what a file is.

    The command prints the format, the samples, the light and the directions. It states how complete the data are, and whether
    they are simulated.
    """
    from goniotwin.app.data.information import information

    found = information(file)
    answer(as_json, found, lambda: print("\n".join(found.lines())))


@app.command()
def budget(
    journal: JournalArgument,
    at: Annotated[
        str,
        typer.Option(
            "--at",
            metavar="PLACE",
            help="Direction: sigma=30,zenith=35,azimuth=180, or theta and phi. With --reflectance: sigma=30. Add sample, "
            "wavelength, gamma, light or photodiode if the journal has several.",
            show_default=False,
        ),
    ],
    reflectance: Annotated[
        bool, typer.Option("--reflectance", help="List them for the directional-hemispherical reflectance.")
    ] = False,
    every: Annotated[
        bool, typer.Option("--all", help="Include components below a hundredth of u. --json always has all.")
    ] = False,
    as_json: Json = False,
) -> None:
    """List the components of a value's uncertainty by size.

    Each component has its u in the unit of the value and in percent of the value. It has its fraction of the square of u, and
    states which values share it. Its source is a measurement, or a table and key of the rig file. The list tells whether the
    component is measured, stated or an assumed default, and its degrees of freedom where they are finite. The squares of all
    components add up to the square of u.
    """
    from goniotwin.app.cli.work.budget import list_components

    list_components(journal, at, as_json, of_reflectance=reflectance, every=every)


@app.command()
def align(
    journal: Annotated[
        Path,
        typer.Argument(metavar="JOURNAL", help="Data file (journal). With --plan: a schedule file.", show_default=False),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="FILE",
            help="File to write: the alignment, for [alignment] of the rig file. With --plan: the schedule. Only a file of the "
            "same kind is replaced.",
            show_default=False,
        ),
    ] = None,
    sample: SampleOption = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Look for a misalignment that began during the campaign. It may still run.")
    ] = False,
    plan: Annotated[bool, typer.Option("--plan", help="Plan a campaign for an alignment. Needs --minutes and --rig.")] = False,
    minutes: Annotated[
        float | None,
        typer.Option(
            "--minutes", metavar="N", min=1.0, help="With --plan: duration on the rig, at most 180 minutes.", show_default=False
        ),
    ] = None,
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="RIG.toml", help="With --plan: rig file.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Estimate the rig's misalignments from a measured lobe.

    The command prints the combinations of tilts, zeros and shifts that the values determine, each with its uncertainty. The
    values never determine the tilt of a single mirror. A scan of the open beam separates errors of the light from errors of
    the arc. Name the file in [alignment] of the rig file: the reduction then corrects the values of later campaigns, and the
    twin uses it for predictions.

    With --watch, the command compares the residuals of the rows so far with the effect of a misalignment that begins at one
    row. It names the misalignment, its size and the row. Exit status: 1 if there is one.

    With --plan, the command starts from the schedule and chooses levels of sigma, gamma, beta and shift. They give the smallest
    uncertainty in the given time. It prints the expected uncertainties, and those of the given schedule in the same time.
    """
    check_alignment_options(watch=watch, plan=plan, minutes=minutes, rig=rig, output=output)
    if plan and minutes is not None and rig is not None:
        from goniotwin.app.cli.work.alignment_plan import plan_alignment

        plan_alignment(journal, rig, minutes, sample, output, as_json)
    elif watch:
        _watch(journal, sample, as_json)
    else:
        from goniotwin.app.cli.work.alignment import estimate_alignment

        estimate_alignment(journal, sample, output, as_json)


def check_alignment_options(*, watch: bool, plan: bool, minutes: float | None, rig: Path | None, output: Path | None) -> None:
    """Refuse options of `align` that do not belong together. Raises UserError."""
    if plan and watch:
        raise UserError("--plan and --watch: give one of them")
    if plan and (minutes is None or rig is None):
        raise UserError("--plan needs --minutes N and --rig RIG.toml")
    if not plan and (minutes is not None or rig is not None):
        raise UserError("--minutes and --rig belong to --plan; a journal has its rig in it")
    if watch and output is not None:
        raise UserError("--watch writes no file; leave out --output")


def _watch(journal: Path, sample: str | None, as_json: bool) -> None:
    from goniotwin.app.campaign.studies.journals import watch_journal

    found = watch_journal(journal, sample)
    mark = "SIMULATED, " if found.simulated else ""
    lines = [f"{mark}{each.sample}: {each.text}" for each in found.misalignments]
    lines += [f"{mark}{name}: the residuals show no misalignment" for name in found.clear]
    lines += [f"{mark}{name}: has no lobe that could be watched so far" for name in found.without]
    answer(as_json, found, lambda: print("\n".join(lines)))
    if found.misalignments:
        raise typer.Exit(1)


@app.command()
def verify(
    journal: JournalArgument,
    as_json: Json = False,
) -> None:
    """Check the values of a data file against physics.

    The checks are reciprocity, energy, symmetry, overlaps of photodiodes, drift, instrument signature and missing
    directions. Each has a verdict with figures. It is "nothing to judge" if the schedule measures nothing for the check.

    A table shows what the campaign finds out about the inputs of the uncertainty. It lists how many combinations of them the
    values determine (rank), and whether the values contradict the stated uncertainties (chi-square, chance).

    Exit status: 1 if a verdict is "fails".
    """
    from goniotwin.app.cli.work.verification import print_verification

    print_verification(journal, as_json)


@app.command()
def closure(
    journal: JournalArgument,
    without_damaged: Annotated[
        bool, typer.Option("--without-damaged", help="Leave out damaged rows. Otherwise they prevent the output.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Compare the etalon's scale with that of the open beam.

    The etalon's radiance factor follows from its certificate and from the scan of the open beam. For each sigma and wavelength
    the command prints the ratio of the two, its combined uncertainty u, z, and a verdict. The schedule needs the table
    [open_beam]. With [second_standard], the command also compares the two standards.

    Exit status: 1 if the two scales, or the two standards, certainly do not agree.
    """
    from goniotwin.app.cli.work.closure import compare_scales

    compare_scales(journal, as_json, without_damaged=without_damaged)


@app.command()
def copy(
    journal: JournalArgument,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Copy to write. It must not exist yet.", show_default=False)],
    as_json: Json = False,
) -> None:
    """Copy a data file (journal), also while its campaign runs.

    The copy is one file, with every row that is saved when the copy begins. The program checks the copy.

    Exit status: 1 if the journal is damaged. If only rows are damaged, the copy is kept.
    """
    from goniotwin.app.campaign.journal.copies import copy_journal

    chain = copy_journal(journal, file)
    result = {"file": file, "chain": chain, "damaged": sorted(chain.damaged)}
    answer(as_json, result, lambda: print(f"{file}\n{chain.statement}"))
    if chain.damage:
        print_error(f"{file}: differs from what was measured, as {journal} does: {chain.damage}")
        raise typer.Exit(1)
