"""The simulation of the light on the sample."""

from dataclasses import replace
from pathlib import Path

from goniotwin.app.cli.output import answer
from goniotwin.app.cli.work.progress import ShareProgress
from goniotwin.app.cli.work.virtual_instrument import instrument_and_frames
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


def simulate_light(
    out: Path,
    passband: tuple[float, float, float],
    error: float,
    seed: int,
    rayset: tuple[Path, int] | None,
    deviations: list[str],
    rig: Path | None,
    as_json: bool,
) -> None:
    """Simulate the illumination unit, write the file `out` and a rayset of so many rays, and print a summary.

    `passband` is wavelength, interval and bandwidth. Raises UserError.
    """
    rayset_file, count = (None, None) if rayset is None else rayset
    check_file_names(out, rayset_file)
    own = parse_deviations(deviations)
    instrument, _ = instrument_and_frames(rig)
    instrument = replace(instrument, illumination={**instrument.illumination, **own})
    unit = illumination_unit(instrument, *passband)
    with ShareProgress("illumination") as progress:
        light = simulate_illumination(unit, error, seed, count, progress)
    write_illumination(light, out)
    if rayset_file is not None and light.rayset is not None:
        write_content(rayset_file, Holds.RAYS, light.rayset)
    result = {"file": out, "rayset_file": rayset_file, **summary(light)}

    def show() -> None:
        side = f"{unit.field_side_mm:g} x {unit.field_side_mm:g} mm"
        fluxes = ", ".join(format_estimate(*each) for each in (("forward", light.forward), ("adjoint", light.adjoint)))
        print(f"SIMULATED, the illumination of the sample: {out}")
        print(f"flux into {side}: {fluxes}; they differ by {abs(light.difference_over_error):.1f} standard errors")
        width, width_error = light.adjoint.full_width_deg
        print(f"minimum over mean irradiance {light.adjoint.uniformity:.3f}; full width {width:.3f} +- {width_error:.3f} deg")
        if light.rayset is not None:
            recorded = light.rayset
            print(f"rayset: {rayset_file}, {recorded.flux.size} rays that carry {recorded.total_flux:.4g} {recorded.unit}")

    answer(as_json, result, show)
