"""The instrument of the simulations: the default one, or that of a virtual rig."""

from dataclasses import replace
from pathlib import Path

from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.simulation.detectors import parse_list
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, SampleFrames

SIGMA_END_DEG = 89.0
"""Largest incidence of a simulation: all of the beam, with half a divergence of up to 0.5 deg, still meets the lit side.

At 90 deg no light falls on a flat sample, and formula 1 is 0/0. A simulation has no errors of pose, so it may go further than
a campaign (`HIGHEST_SIGMA_DEG` of a schedule).
"""
POLAR_DEG, AZIMUTH_DEG = (0.0, 89.5), (0.0, 360.0)
"""Limits of the angles of detectors."""


def instrument_and_frames(rig: Path | None, no_obstruction: bool = False) -> tuple[Instrument, SampleFrames]:
    """The default instrument and sample frames, or those of a virtual rig. Raises UserError for the file of a real rig."""
    instrument, frames = Instrument(), SampleFrames()
    if rig is not None:
        model = read_rig(rig).model()
        if model is None:
            raise UserError(f"{rig}: is a real rig, whose optics are not described; give the file of a virtual rig")
        instrument, frames = model.instrument, model.frames
    return (replace(instrument, obstruction=False) if no_obstruction else instrument), frames


def incidences(text: str) -> Floats:
    """Incidences (n,), deg, of the option --sigma. Raises UserError."""
    reason = "nearer to 90 a part of the beam would pass the sample or light its other side"
    return parse_list(text, "--sigma", 0.0, SIGMA_END_DEG, reason)
