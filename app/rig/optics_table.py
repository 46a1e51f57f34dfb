"""`[twin.optics]`, `[twin.sensor]`, `[twin.deviations]`: the virtual rig's optics, how they stand, how they are computed."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, model_validator

from goniotwin.app.tables import Table
from goniotwin.twin.optics import Deviation, Instrument, RealSensor, SampleFrames
from goniotwin.twin.plant import Estimator


class OpticsTable(Table):
    """Dimensions of the instrument; `obstruction` off lets light pass through the mirror unit.

    `estimator` is what the photodiodes' light is computed by: `fast`, or `forward`, which traces everything and takes its
    time: until half of the photodiodes that get light are known to `forward_error`. With photodiodes of 0.5 deg that is
    some seconds a pose for 3 %, and a hundred times as long for 0.3 %; wider ones take less. With `rays` the fast one takes
    so many for every photodiode in place of the few that it places itself. `stray` adds, for either, the light of the
    frames and what met more than one thing on its way: see `[twin.frames]`.
    """

    pupil_radius_mm: PositiveFloat = 5.0
    mirror_distance_mm: PositiveFloat = 200.0
    mirror_side_mm: PositiveFloat = 20.0
    mirror_mount_mm: Annotated[float, Field(ge=0.0)] = 0.0
    mirror_reflectance: Annotated[float, Field(gt=0.0, le=1.0)] = 0.95
    spot_side_mm: PositiveFloat = 5.0
    arc_radius_mm: PositiveFloat = 300.0
    detector_diameter_mm: PositiveFloat = 5.0
    field_deg: PositiveFloat = 0.5
    obstruction: bool = True
    estimator: Literal["fast", "forward"] = "fast"
    rays: Annotated[int, Field(ge=16, le=1 << 20, multiple_of=4)] | None = None
    forward_error: Annotated[float, Field(gt=1e-5, lt=0.5)] = 0.03
    stray: bool = False

    @model_validator(mode="after")
    def _can_be_built(self) -> "OpticsTable":
        built(self, {})
        return self

    def chosen(self) -> Estimator:
        """What computes the light."""
        return Estimator(self.estimator, self.rays, self.forward_error, self.stray)


class FramesTable(Table):
    """The two sheets that hold the sample: see `twin.optics.SampleFrames`."""

    gap_mm: float = 0.0
    side_mm: float = 60.0
    reflectance: float = 0.05
    lit: float = 1.1

    @model_validator(mode="after")
    def _can_be_built(self) -> "FramesTable":
        self.frames()
        return self

    def frames(self) -> SampleFrames:
        """Raises ValueError, naming the key, for what no frame can have."""
        return SampleFrames(**self.model_dump())


class SensorTable(Table):
    """The sensor unit as it is built, in place of the virtual detectors of `[twin.optics]`: see `twin.optics.RealSensor`."""

    lens_diameter_mm: PositiveFloat = RealSensor.lens_diameter_mm
    focal_length_mm: PositiveFloat = RealSensor.focal_length_mm
    aperture_mm: PositiveFloat = RealSensor.aperture_mm
    diaphragm_mm: PositiveFloat = RealSensor.diaphragm_mm
    detector_mm: PositiveFloat = RealSensor.detector_mm
    detector_side_mm: PositiveFloat = RealSensor.detector_side_mm

    @model_validator(mode="after")
    def _can_be_built(self) -> "SensorTable":
        self.sensor()
        return self

    def sensor(self) -> RealSensor:
        """Raises ValueError, naming the key, for what cannot be built."""
        return RealSensor(**self.model_dump())


class DeviationTable(Table):
    """How far an element stands from its place: three angles, three shifts; see `twin.optics.instrument` for the frames."""

    rx_deg: float = 0.0
    ry_deg: float = 0.0
    rz_deg: float = 0.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0


def built(optics: OpticsTable, deviations: Mapping[str, DeviationTable], unit: SensorTable | None = None) -> Instrument:
    """The instrument. Raises ValueError for dimensions that make none, for an element that there is not, and for a sensor
    `unit` beside dimensions of virtual detectors, or of which the estimator knows nothing.
    """
    sensor = None if unit is None else unit.sensor()
    if sensor is not None:
        if given := sorted(optics.model_fields_set & {"detector_diameter_mm", "field_deg"}):
            raise ValueError(f"optics.{given[0]} is of virtual detectors, which [twin.sensor] replaces; leave one of them out")
        if optics.estimator == "fast" and sensor.departure is not None:
            raise ValueError(
                f"sensor: {sensor.departure}, so it is no disc with an acceptance cone, which is all that the fast estimator "
                'knows; set optics.estimator = "forward", or mend the sensor'
            )
    dimensions = optics.model_dump(exclude={"estimator", "rays", "forward_error", "stray"})
    standing = {element: Deviation(**deviation.model_dump()) for element, deviation in deviations.items()}
    return Instrument(**dimensions, deviations=standing, sensor=sensor)
