"""The command `goniotwin simulate illumination`: the light on the sample, and the rays that make it."""

import json
from pathlib import Path
from typing import Annotated

import typer

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.options import BANDWIDTH_NM, INTERVAL_NM, WAVELENGTH_NM, Json, Rig, Seed, instrument_and_frames

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

    from goniotwin.app.formats import FormatError, write_rayset
    from goniotwin.app.simulation.illumination import estimate_in_words, illuminated, summary
    from goniotwin.app.simulation.illumination_shown import check_names, write_illumination
    from goniotwin.app.simulation.progress import ShareProgress
    from goniotwin.app.simulation.source import unit_for

    check_names(out, rayset)
    instrument, _ = instrument_and_frames(rig)
    unit = unit_for(instrument, wavelength, interval, bandwidth)
    wanted = None if rayset is None else (RAYSET_RAYS if rays is None else rays)
    with ShareProgress(Console(stderr=True), "illumination") as progress:
        found = illuminated(unit, error, seed, wanted, progress)
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
    told = ", ".join(estimate_in_words(*each) for each in (("forward", found.forward), ("adjoint", found.adjoint)))
    print(f"SIMULATED, the illumination of the sample: {out}")
    print(f"flux into {side}: {told}; they differ by {abs(found.difference_over_error):.1f} standard errors")
    width, width_error = found.adjoint.full_width_deg
    print(f"least over mean irradiance {found.adjoint.uniformity:.3f}; full width {width:.3f} +- {width_error:.3f} deg")
    if found.rayset is not None:
        count = found.rayset.flux.size
        print(f"rayset: {rayset}, {count} rays that carry {found.rayset.total_flux:.4g} {found.rayset.unit}")
