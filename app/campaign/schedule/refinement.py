"""Tables of the schedule for poses beside the grids: finer near the specular direction, mirror images, overlaps."""

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from goniotwin.app.campaign.schedule.grids import Grid
from goniotwin.app.toml_file import TomlTable
from goniotwin.drivers.motion.settings import ENCODER_TOLERANCE_DEG

DEFAULT_ANGLE_UNCERTAINTY_DEG = ENCODER_TOLERANCE_DEG
"""Default of `angle_deg`: the difference that counter and encoder of an axis at rest may have where no value is given."""
StatedSymmetry = Literal["isotropic", "plane-symmetric", "anisotropic"]


class NearSpecularTable(TomlTable):
    """`[near_specular]`: more poses wherever a photodiode then looks within `within_deg` of the specular direction or, for
    transmitted light, of the direction straight through.

    They are at the arc shifts `shift_deg`, and at betas every `beta_step_deg` over the whole range of `beta_deg`.
    """

    within_deg: Annotated[float, Field(gt=0.0, le=90.0)]
    shift_deg: Grid | None = None
    beta_step_deg: PositiveFloat | None = None

    @model_validator(mode="after")
    def _check_refinement(self) -> "NearSpecularTable":
        if self.shift_deg is None and self.beta_step_deg is None:
            raise ValueError("has neither shift_deg nor beta_step_deg, so that it adds no poses; give one of them")
        return self


class SymmetryCheckTable(TomlTable):
    """`[symmetry_check]`: `points` poses are also measured at their mirror image by the stated symmetry.

    `angle_deg` is the standard uncertainty of the axes' angles: where a lobe is steep it makes a difference that does not come
    from the sample.
    """

    points: PositiveInt
    angle_deg: Annotated[float, Field(ge=0.0, le=5.0)] = DEFAULT_ANGLE_UNCERTAINTY_DEG


class OverlapTable(TomlTable):
    """`[overlap]`: at each sigma `points` poses at which photodiodes look where their neighbours look at the first shift of the
    grid.

    `calibrate`: multiply the values by a factor for each photodiode, from all directions that two photodiodes measure; without
    it the factors are only reported. `angle_deg` is the standard uncertainty of a photodiode's direction: the steeper the lobe,
    the smaller the weight of an overlap.
    """

    points: PositiveInt
    calibrate: bool = False
    angle_deg: Annotated[float, Field(ge=0.0, le=5.0)] = DEFAULT_ANGLE_UNCERTAINTY_DEG
