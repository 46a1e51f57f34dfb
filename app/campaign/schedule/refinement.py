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
    """`[near_specular]`: further poses near the specular direction, for transmitted light near the direction straight through.

    `within_deg`: largest angle between this direction and the nearest photodiode in such a pose. `shift_deg`: further shifts of
    the arc for these poses. `beta_step_deg`: step of further betas for these poses, over the whole range of the schedule's
    betas.
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
    """`[symmetry_check]`: test of the symmetry that the schedule states.

    `points`: number of poses that are also measured at their mirror image. `angle_deg`: standard uncertainty of the axes'
    angles. Where a lobe is steep, it makes a difference that does not come from the sample.
    """

    points: PositiveInt
    angle_deg: Annotated[float, Field(ge=0.0, le=5.0)] = DEFAULT_ANGLE_UNCERTAINTY_DEG


class OverlapTable(TomlTable):
    """`[overlap]`: poses at which photodiodes look where their neighbours look at the first shift of the grid.

    `points`: number of such poses at each sigma. `calibrate`: whether values are multiplied by a factor for each photodiode,
    from all directions that two photodiodes measure. Without it the factors are only reported. `angle_deg`: standard
    uncertainty of a photodiode's direction. The steeper the lobe, the smaller the weight of an overlap.
    """

    points: PositiveInt
    calibrate: bool = False
    angle_deg: Annotated[float, Field(ge=0.0, le=5.0)] = DEFAULT_ANGLE_UNCERTAINTY_DEG
