"""The light source: the illumination unit of an instrument, and a recorded rayset of it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from goniotwin.app.errors import UserError
from goniotwin.app.formats import FormatError, registry
from goniotwin.app.formats.registry import Holds
from goniotwin.twin.optics import IlluminationUnit, Instrument, RaySource, replay
from goniotwin.twin.optics.geometry.mirrors import illumination_place
from goniotwin.twin.optics.illumination.rayset import Rayset
from goniotwin.twin.optics.illumination.unit import unit_of


@dataclass(frozen=True, eq=False)
class Source:
    """Rays of a file, which replace the uniform exit pupil.

    `name` is the file, `geometry` the fingerprint of the illumination unit, `wavelength_nm` that of its monochromator.
    """

    name: str
    rays: RaySource
    geometry: str
    wavelength_nm: float

    def as_dict(self) -> dict[str, Any]:
        """The source for JSON."""
        return {
            "file": self.name,
            "rays": int(self.rays.flux.size),
            "geometry": self.geometry,
            "wavelength_nm": self.wavelength_nm,
        }


def illumination_unit(
    instrument: Instrument, wavelength_nm: float, interval_nm: float, bandwidth_nm: float
) -> IlluminationUnit:
    """The illumination unit with the exit pupil, distance, field and deviations of the instrument. Raises UserError."""
    try:
        return unit_of(instrument, wavelength_nm, interval_nm, bandwidth_nm)
    except ValueError as error:
        # The message begins with the name of a field of the unit, which is the option's name with a unit.
        raise UserError(f"--{str(error).replace('_nm', '', 1)}") from None


def read_source(path: Path, unit: IlluminationUnit, instrument: Instrument) -> Source:
    """Read a rayset of this unit, at the instrument's exit pupil.

    Raises UserError for a file that is not a rayset, is damaged, or was recorded with another unit.
    """
    rotation, origin = illumination_place(instrument)
    x, y, z = (float(each) for each in origin)
    try:
        rayset: Rayset = registry.recognise(path, {Holds.RAYS}).read(path)
    except FormatError as error:
        raise UserError(f"--source: {error}") from None
    try:
        rays = replay(rayset, unit, (x, y, z), rotation)
    except ValueError as error:
        given = f"{unit.wavelength_nm:g} nm, interval {unit.interval_nm:g} nm, bandwidth {unit.bandwidth_nm:g} nm"
        raise UserError(
            f"--source: {path}: {error}, or give its --wavelength, --interval, --bandwidth (now {given}), and the --rig "
            "with the deviations of its illumination unit"
        ) from None
    return Source(str(path), rays, rayset.geometry, unit.wavelength_nm)
