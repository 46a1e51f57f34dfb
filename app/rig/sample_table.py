"""`[twin.samples]`: what the virtual rig's back door can mount, as people write it, and the scattering model it makes."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from goniotwin.app.errors import UserError
from goniotwin.app.formats.errors import FormatError
from goniotwin.app.formats.zemax import ZemaxBsdf, read_zemax
from goniotwin.app.tables import Table
from goniotwin.twin.optics import Scatterer, gaussian, lambertian, regular, summed, tabulated

Side = Literal["front", "back", "both"]


class LambertianTable(Table):
    """A perfect diffuser of some reflectance, and of some transmittance."""

    model: Literal["lambertian"]
    reflectance: float = 1.0
    transmittance: float = 0.0
    side: Side = "front"

    @model_validator(mode="after")
    def _makes_a_diffuser(self) -> "LambertianTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The diffuser. Raises ValueError for shares of the light that are none."""
        return lambertian(self.reflectance, self.transmittance, self.side)


class GaussianTable(Table):
    """A Gaussian lobe round the specular direction (the paper's formula 6), or round the transmitted one."""

    model: Literal["gaussian"]
    width_deg: float
    form: Literal["one_over_e", "half_width"] = "one_over_e"
    quantity: Literal["luminance", "intensity"] = "luminance"
    peak: float | None = None
    reflectance: float | None = None
    transmits: bool = False
    refraction: float = 1.0
    side: Side = "front"

    @model_validator(mode="after")
    def _makes_a_lobe(self) -> "GaussianTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The lobe. Raises ValueError for a width or a height that is none."""
        return gaussian(
            self.width_deg, self.form, self.quantity, self.peak, self.reflectance, self.transmits, self.refraction, self.side
        )


class RegularTable(Table):
    """A mirror or a clear sheet: a share of the light, or a list of shares over the incidences `sigma_deg`."""

    model: Literal["regular"]
    reflectance: float | list[float] = 1.0
    sigma_deg: list[float] | None = None
    transmits: bool = False
    side: Side = "front"

    @model_validator(mode="after")
    def _makes_a_mirror(self) -> "RegularTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The mirror. Raises ValueError for shares that are none, or a list that does not fit."""
        return regular(self.reflectance, self.transmits, self.side, self.sigma_deg)


class MeasuredTable(Table):
    """A table of a Zemax `.bsdf` file, named from where the rig file is; a BTDF transmits."""

    model: Literal["zemax"]
    file: str
    side: Side = "front"


LobeTable = Annotated[LambertianTable | GaussianTable | RegularTable | MeasuredTable, Field(discriminator="model")]


class SumTable(Table):
    """Several models at once, each scattering its share."""

    model: Literal["sum"]
    lobes: Annotated[list[LobeTable], Field(min_length=1)]


SampleTable = Annotated[LambertianTable | GaussianTable | RegularTable | MeasuredTable | SumTable, Field(discriminator="model")]


def scatterer(sample: SampleTable, folder: Path, place: str) -> Scatterer:
    """The model; files are looked for from `folder`. Raises UserError that begins with `place`, the sample's in its file."""
    if isinstance(sample, SumTable):
        return summed(*[scatterer(lobe, folder, f"{place}.lobes.{i}") for i, lobe in enumerate(sample.lobes)])
    if not isinstance(sample, MeasuredTable):
        return sample.scatterer()
    try:
        return _from_zemax(read_zemax(folder / sample.file), sample.side)
    except (FormatError, ValueError) as error:
        raise UserError(f"{place}: {error}") from None


def _from_zemax(table: ZemaxBsdf, side: Side) -> Scatterer:
    """An isotropic sample from a Zemax table. Raises ValueError for one that is not."""
    if len(table.sample_rotation_deg) != 1:
        raise ValueError(f"it has {len(table.sample_rotation_deg)} sample rotations; a sample here needs exactly one")
    transmits = table.scatter_type.upper() == "BTDF"
    axes = (table.incidence_deg, table.azimuth_deg, table.radial_deg)
    return tabulated(*axes, table.values[0], side=side, transmits=transmits)
