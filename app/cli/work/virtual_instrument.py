"""The instrument of the simulations: the default one, or that of a virtual rig."""

from dataclasses import replace
from pathlib import Path

from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.twin.optics import Instrument, SampleFrames

SIGMA_END_DEG = 89.0
POLAR_DEG, AZIMUTH_DEG = (0.0, 89.5), (0.0, 360.0)
"""Limits of the angles of detectors; of sigma the upper one."""


def instrument_and_frames(rig: Path | None, no_obstruction: bool = False) -> tuple[Instrument, SampleFrames]:
    """The default instrument and sample frames, or those of a virtual rig. Raises UserError for the file of a real rig."""
    instrument, frames = Instrument(), SampleFrames()
    if rig is not None:
        model = read_rig(rig).model()
        if model is None:
            raise UserError(f"{rig}: is a real rig, whose optics are not described; give the file of a virtual rig")
        instrument, frames = model.instrument, model.frames
    return (replace(instrument, obstruction=False) if no_obstruction else instrument), frames
