"""What a schedule says of its poses beyond the grids: finer near the specular direction, mirrored, overlapping."""

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from goniotwin.app.campaign.schedule.grids import Grid
from goniotwin.app.toml_file import TomlTable

DEFAULT_ANGLE_UNCERTAINTY_DEG = 0.05
"""As far as counter and encoder of an axis may be apart at rest where nobody has said otherwise."""
Symmetry = Literal["isotropic", "plane-symmetric", "anisotropic"]


class NearSpecularTable(TomlTable):
    """Further poses wherever some photodiode then looks within `within_deg` of the specular direction, or, for transmitted
    light, of the one straight through: at the arc shifts `shift_deg`, and at betas every `beta_step_deg` over the whole grid.
    """

    within_deg: Annotated[float, Field(gt=0.0, le=90.0)]
    shift_deg: Grid | None = None
    beta_step_deg: PositiveFloat | None = None

    @model_validator(mode="after")
    def _finer_somehow(self) -> "NearSpecularTable":
        if self.shift_deg is None and self.beta_step_deg is None:
            raise ValueError("says neither shift_deg nor beta_step_deg, so nothing would be finer; add one")
        return self


class SymmetryCheckTable(TomlTable):
    """So many poses are measured at their mirror image by the stated symmetry as well. `angle_deg` is how well the axes know
    where they are (standard): where a lobe is steep, so much makes a difference that is none of the sample's.
    """

    points: PositiveInt
    angle_deg: Annotated[float, Field(ge=0.0, le=5.0)] = DEFAULT_ANGLE_UNCERTAINTY_DEG


class OverlapTable(TomlTable):
    """At each sigma so many poses at which photodiodes look where their neighbours look at the first shift of the grid.

    `calibrate`: the values are brought together by a factor for each photodiode, from all directions that two have seen; else
    the factors are only told. `angle_deg` is how well it is known where a photodiode looks (standard): a steep lobe says the
    less of a ratio.
    """

    points: PositiveInt
    calibrate: bool = False
    angle_deg: Annotated[float, Field(ge=0.0, le=5.0)] = DEFAULT_ANGLE_UNCERTAINTY_DEG
