"""`[twin.optics]` and `[twin.deviations]`: the virtual rig's optics, how they stand, and how they are computed."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, model_validator

from app.tables import Table
from twin.optics import Deviation, Instrument
from twin.plant import Estimator


class OpticsTable(Table):
    """Dimensions of the instrument; `obstruction` off lets light pass through the mirror unit.

    `estimator` is what the photodiodes' light is computed by: `fast`, or `forward`, which traces everything and takes its
    time: until half of the photodiodes that get light are known to `forward_error`. With `rays` the fast one takes so many
    for every photodiode in place of the few that it places itself.
    """

    pupil_radius_mm: PositiveFloat = 5.0
    mirror_distance_mm: PositiveFloat = 200.0
    mirror_side_mm: PositiveFloat = 20.0
    mirror_reflectance: Annotated[float, Field(gt=0.0, le=1.0)] = 0.95
    spot_side_mm: PositiveFloat = 5.0
    arc_radius_mm: PositiveFloat = 300.0
    detector_diameter_mm: PositiveFloat = 5.0
    field_deg: PositiveFloat = 0.5
    obstruction: bool = True
    estimator: Literal["fast", "forward"] = "fast"
    rays: Annotated[int, Field(ge=16, le=1 << 20, multiple_of=4)] | None = None
    forward_error: Annotated[float, Field(gt=1e-5, lt=0.5)] = 3.0e-3

    @model_validator(mode="after")
    def _can_be_built(self) -> "OpticsTable":
        built(self, {})
        return self

    def chosen(self) -> Estimator:
        """What computes the light."""
        return Estimator(self.estimator, self.rays, self.forward_error)


class DeviationTable(Table):
    """How far an element stands from its place: three angles, three shifts; see `twin.optics.instrument` for the frames."""

    rx_deg: float = 0.0
    ry_deg: float = 0.0
    rz_deg: float = 0.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0


def built(optics: OpticsTable, deviations: Mapping[str, DeviationTable]) -> Instrument:
    """The instrument. Raises ValueError for dimensions that make none, and for an element that there is not."""
    dimensions = optics.model_dump(exclude={"estimator", "rays", "forward_error"})
    standing = {element: Deviation(**deviation.model_dump()) for element, deviation in deviations.items()}
    return Instrument(**dimensions, deviations=standing)
