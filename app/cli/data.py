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
        help="A format of the list below, by its name; else that of the file's suffix.",
        show_default=False,
    ),
]
SampleOption = Annotated[str | None, typer.Option("--sample", help="Sample, if there are several.", show_default=False)]
LightOption = Annotated[
    Literal["reflected", "transmitted"] | None,
    typer.Option("--light", help="Light, if there are both and the format holds one.", show_default=False),
]
SideOption = Annotated[
    Literal["front", "back"] | None,
    typer.Option("--side", help="Lit side, if there are both; a table of one side is of the front.", show_default=False),
]
WavelengthOption = Annotated[
    str | None,
    typer.Option(
        "--wavelength", metavar="NM|all", help="One wavelength; with all, a file of each: NAME.550nm.bsdf.", show_default=False
    ),
]
FillOption = Annotated[
    Fill,
    typer.Option("--fill", help="How a table's holes are filled, where nothing was measured: docs/exchange/formats.md."),
]
DamagedOption = Annotated[
    bool, typer.Option("--without-damaged", help="Leave out the rows that are damaged, instead of writing nothing.")
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

    The journal is not changed. A .csv has every measured point, with its standard uncertainty. A table such as a .ddr is in
    specular coordinates and has no gaps: directions without a measurement are filled and listed at its top. The standard
    uncertainties of FILE.ddr are in FILE.u.ddr, what was not measured is marked in FILE.mask.ddr, on the same grid. An archive
    (.h5) has everything: points, tables, covariance, schedule, rig and raw counts.

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

    What the file is, is found by its content; a journal is reduced, as goniotwin export does it. What the other format does not
    hold is refused, or named. Uncertainties, and the mask of what was not measured, go along: in OUT.u and OUT.mask of the same
    format, where it has no room for them.

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

    Its format, samples, light and directions, how complete it is, and whether it is simulated.
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
            help="Where: sigma=30,zenith=35,azimuth=180, or theta and phi; also sample, wavelength, gamma, light, photodiode, "
            "as far as the journal has several.",
            show_default=False,
        ),
    ],
    reflectance: Annotated[
        bool, typer.Option("--reflectance", help="Of the directional-hemispherical reflectance, instead of one value.")
    ] = False,
    every: Annotated[
        bool, typer.Option("--all", help="Also the components below a hundredth of u; --json always has all of them.")
    ] = False,
    as_json: Json = False,
) -> None:
    """List the components of a value's uncertainty by size.

    For each: u in the unit of the value and in percent of it, its share of the square of u, which values share it, its source:
    the table and key of the rig file, or a measurement, and whether it is measured, stated or an assumed default, with degrees
    of freedom where they are finite. The squares of the components add up to the square of u.
    """
    from goniotwin.app.cli.work.budget import list_components

    list_components(journal, at, as_json, of_reflectance=reflectance, every=every)


@app.command()
def align(
    journal: Annotated[
        Path,
        typer.Argument(
            metavar="JOURNAL", help="Data file (journal) of a campaign; with --plan a schedule.", show_default=False
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            metavar="FILE",
            help="File to write: the alignment, for [alignment] of the rig file; with "
            "--plan the schedule. Only a file of its kind is replaced.",
            show_default=False,
        ),
    ] = None,
    sample: SampleOption = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="Look for a misalignment that began during the campaign, which may be running.")
    ] = False,
    plan: Annotated[
        bool, typer.Option("--plan", help="Plan a campaign for an alignment, from a schedule; with --minutes and --rig.")
    ] = False,
    minutes: Annotated[
        float | None,
        typer.Option(
            "--minutes", metavar="N", min=1.0, help="With --plan: time on the rig's clock, at most 180.", show_default=False
        ),
    ] = None,
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="RIG.toml", help="With --plan: rig file.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Estimate the rig's misalignments from a measured lobe.

    Given are the combinations of tilts, zeros and shifts that the values determine, each with its uncertainty: a single
    mirror's tilt is never among them. A scan of the open beam in the campaign distinguishes light and arc. With the file in
    [alignment] of the rig file, the reduction corrects the values of later campaigns, and the twin predicts with it.

    With --watch: the residuals of the rows so far are compared with what a misalignment from some row on would do, and it is
    named, with its size and the row. Exit status: 1 if there is one.

    With --plan: levels of sigma, gamma, beta and shift, for the least uncertainty in the time, beginning with those of a
    schedule; and the uncertainties that are expected of them, and of the schedule's own at equal time.
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

    And against each other: reciprocity, energy, symmetry, overlaps of photodiodes, drift, instrument signature, obstructed
    directions. There is one verdict each, with figures; "nothing to judge" where the schedule measures nothing for it. What the
    campaign observes of its own inputs is a table: how many combinations of them it determines (rank), and whether that
    contradicts what is stated (chi-square, chance).

    Exit status: 1 if a verdict is "fails".
    """
    from goniotwin.app.cli.work.verification import print_verification

    print_verification(journal, as_json)


@app.command()
def closure(
    journal: JournalArgument,
    without_damaged: Annotated[
        bool, typer.Option("--without-damaged", help="Leave out the rows that are damaged, instead of giving nothing.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Compare the etalon's scale with that of the open beam.

    For each sigma and wavelength the etalon's radiance factor by its certificate and by the scan of the open beam: ratio,
    combined uncertainty u, z, and a verdict. The schedule needs the table [open_beam]. With [second_standard] the two standards
    are compared as well.

    Exit status: 1 if the two scales, or the two standards, certainly do not agree.
    """
    from goniotwin.app.cli.work.closure import compare_scales

    compare_scales(journal, as_json, without_damaged=without_damaged)


@app.command()
def copy(
    journal: JournalArgument,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Copy to make; not overwritten.", show_default=False)],
    as_json: Json = False,
) -> None:
    """Copy a data file (journal), also while its campaign runs.

    The copy has every row that is committed when it begins, in one file, and is checked.

    Exit status: 1 if the journal is damaged; with damaged rows the copy is kept.
    """
    from goniotwin.app.campaign.journal.copies import copy_journal

    chain = copy_journal(journal, file)
    result = {"file": file, "chain": chain, "damaged": sorted(chain.damaged)}
    answer(as_json, result, lambda: print(f"{file}\n{chain.statement}"))
    if chain.damage:
        print_error(f"{file}: differs from what was measured, as {journal} does: {chain.damage}")
        raise typer.Exit(1)
