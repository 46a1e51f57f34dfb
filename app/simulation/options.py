"""Options that several commands of `goniotwin simulate` have, and the rig that one of them names."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
