"""`[twin]`: the virtual rig's own mechanics, optics, noise and samples, as people write them, and the model they make.

Nothing here is taken from the operator's part of the file: a wrong sign there has to show as a wrong angle.

`[twin.optics]`, `[twin.sensor]`, `[twin.deviations]`: the virtual rig's optics, how they stand, how they are computed.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from goniotwin.app.rig.samples import SampleTable, scatterer
from goniotwin.app.toml_file import TomlTable
from goniotwin.twin.optics import Deviation, Instrument, RealSensor, SampleFrames
from goniotwin.twin.plant import (
    AxisController,
    Electronics,
    Estimator,
    LightSource,
    Mechanics,
    MonitorPhotodiode,
    MonochromatorDrive,
    OrderSorting,
    Photodiodes,
    TwinModel,
    WheelFilter,
)

Fraction = Annotated[float, Field(ge=0.0, lt=1.0)]
NonNegativeFloat = Annotated[float, Field(ge=0.0)]
PolarAngle = Annotated[float, Field(ge=0.0, le=90.0)]
FilterPosition = Annotated[int, Field(ge=1, le=6)]


class OpticsTable(TomlTable):
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
        twin_instrument(self, {})
        return self

    def chosen(self) -> Estimator:
        """What computes the light."""
        return Estimator(self.estimator, self.rays, self.forward_error, self.stray)


class FramesTable(TomlTable):
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


class SensorTable(TomlTable):
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


class DeviationTable(TomlTable):
    """How far an element stands from its place: three angles, three shifts; frames: twin.optics.geometry.instrument."""

    rx_deg: float = 0.0
    ry_deg: float = 0.0
    rz_deg: float = 0.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0


def twin_instrument(
    optics: OpticsTable, deviations: Mapping[str, DeviationTable], unit: SensorTable | None = None
) -> Instrument:
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


class MechanicsTable(TomlTable):
    """An axis as it is."""

    motor: Annotated[int, Field(ge=0, le=5)]
    gear: PositiveFloat
    sense: Literal[1, -1] = 1
    zero_deg: float = 0.0
    full_steps: PositiveInt = 200
    encoder: bool = True
    module: Annotated[int, Field(ge=1, le=255)] = 1
    backlash_deg: NonNegativeFloat = 0.0
    lower_switch_deg: float | None = None
    upper_switch_deg: float | None = None
    home_deg: float | None = None
    home_width_deg: Annotated[float, Field(gt=0.0, lt=360.0)] = 1.0
    encoder_counts: PositiveInt = 51_200
    encoder_error_deg: NonNegativeFloat = 0.0


class ControllerTable(TomlTable):
    """The motion modules and their wire: one module for each address among the axes' `module`."""

    kind: Literal["tmcm-6214", "tmcm-1240"] = "tmcm-6214"
    wire: Literal["usb", "rs485"] = "usb"
    baudrate: PositiveInt = 115200
    latency_s: NonNegativeFloat = 3.0e-4
    encoder_noise_microsteps: NonNegativeFloat = 1.0


class AxesMechanicsTable(TomlTable):
    """All four axes as they are."""

    gamma: MechanicsTable
    sigma: MechanicsTable
    beta: MechanicsTable
    shift: MechanicsTable

    @model_validator(mode="after")
    def _one_motor_each(self) -> "AxesMechanicsTable":
        motors = [(each.module, each.motor) for each in (self.gamma, self.sigma, self.beta, self.shift)]
        for module, motor in motors:
            if (count := motors.count((module, motor))) > 1:
                raise ValueError(f"motor {motor} turns {count} axes of module {module}; give each its own")
        return self


class LightTable(TomlTable):
    """The lamp: its radiance, what of it arrives, and how steady it is."""

    radiance: PositiveFloat = 2.0e3
    throughput: Annotated[float, Field(gt=0.0, le=1.0)] = 0.18
    drift_per_hour: float = 0.0
    flicker: Fraction = 5.0e-4
    wander: Fraction = 2.0e-3


class DiodesTable(TomlTable):
    """Where the photodiodes sit, and their dark currents."""

    upper_deg: Annotated[list[PolarAngle], Field(min_length=1)] = [5.0 * k for k in range(18)]
    lower_deg: list[PolarAngle] = [5.0 * k for k in range(18)]
    dark_a: NonNegativeFloat = 2.0e-12
    dark_spread: Fraction = 0.05
    dark_wander: Fraction = 2.0e-3


class ElectronicsTable(TomlTable):
    """Amplifiers and converters; `gain_spread` is how far the gains are from what is printed on them."""

    gains_v_per_a: Annotated[list[PositiveFloat], Field(min_length=1, max_length=4)] = [1e6, 1e8, 1e10, 1e11]
    gain_spread: Fraction = 1.0e-3
    offset_v: float = 1.0e-3
    noise_v: NonNegativeFloat = 1.5e-4
    settling_s: PositiveFloat = 0.02
    module: Literal["adam-6017", "adam-4117"] = "adam-6017"
    baudrate: PositiveInt = 9600
    conversions_per_s: Literal[10, 100] = 100


class DriveTable(TomlTable):
    """The monochromator as it is: its speeds, whether its line echoes, whether it knows handshake mode.

    `filters` is how many positions its wheel has, `filter_s` the time from one to the next. `second_order` is the share of
    light of half the wavelength set that passes as well; up to 710 nm the lamp has none.
    """

    echo: bool = True
    handshake: bool = True
    slew_nm_per_s: PositiveFloat = 175.0
    settle_s: NonNegativeFloat = 0.1
    shutter_s: NonNegativeFloat = 0.15
    filter_s: NonNegativeFloat = 1.0
    filters: Annotated[int, Field(ge=0, le=6)] = 6
    grating_s: NonNegativeFloat = 8.0
    second_order: Fraction = 0.0


class WheelFilterTable(TomlTable):
    """A filter in the virtual rig's wheel: see `twin.plant.WheelFilter`. A position without one is open."""

    position: FilterPosition
    cut_on_nm: PositiveFloat
    transmittance: Annotated[float, Field(gt=0.0, le=1.0)] = WheelFilter.transmittance

    def filter(self) -> WheelFilter:
        """For the model."""
        return WheelFilter(**self.model_dump())


def refuse_repeated_positions(positions: Sequence[int]) -> None:
    """Raises ValueError, naming the position."""
    for position in positions:
        if (count := positions.count(position)) > 1:
            raise ValueError(f"filters: position {position} is given {count} times; there is one filter in each, so leave one")


class TwinTable(TomlTable):
    """The virtual rig. `noise` off silences every random process and leaves the quantisation."""

    axes: AxesMechanicsTable
    samples: dict[str, SampleTable]
    noise: bool = True
    optics: OpticsTable = OpticsTable()
    sensor: SensorTable | None = None
    deviations: dict[str, DeviationTable] = {}
    frames: FramesTable = FramesTable()
    light: LightTable = LightTable()
    photodiodes: DiodesTable = DiodesTable()
    electronics: ElectronicsTable = ElectronicsTable()
    monochromator: DriveTable = DriveTable()
    filters: list[WheelFilterTable] = []
    controller: ControllerTable = ControllerTable()

    @model_validator(mode="after")
    def _can_be_built(self) -> "TwinTable":
        twin_instrument(self.optics, self.deviations, self.sensor)
        return self

    @model_validator(mode="after")
    def _filters_have_their_places(self) -> "TwinTable":
        refuse_repeated_positions([each.position for each in self.filters])
        for each in self.filters:
            if each.position > self.monochromator.filters:
                raise ValueError(
                    f"filters: there is no position {each.position} in a wheel of {self.monochromator.filters}; take another, "
                    "or mend monochromator.filters"
                )
        return self

    @model_validator(mode="after")
    def _motors_are_there(self) -> "TwinTable":
        motors = {"tmcm-6214": 6, "tmcm-1240": 1}[self.controller.kind]
        for name in type(self.axes).model_fields:
            axis: MechanicsTable = getattr(self.axes, name)
            if axis.motor >= motors:
                raise ValueError(f"axes.{name}: a {self.controller.kind} has {motors} motors, so none with number {axis.motor}")
        return self


def twin_model(table: TwinTable, seed: int, folder: Path, name: str) -> TwinModel:
    """The model; sample files are looked for from `folder`. Raises UserError naming `name`, the sample and its file."""
    return TwinModel(
        seed=seed,
        axes={axis: Mechanics(**mechanics) for axis, mechanics in table.axes.model_dump().items()},
        samples={key: scatterer(sample, folder, f"{name}: twin.samples.{key}") for key, sample in table.samples.items()},
        instrument=twin_instrument(table.optics, table.deviations, table.sensor),
        frames=table.frames.frames(),
        light=LightSource(**table.light.model_dump()),
        photodiodes=Photodiodes(**_tuples(table.photodiodes)),
        electronics=Electronics(**_tuples(table.electronics)),
        monitor=MonitorPhotodiode(),
        monochromator=MonochromatorDrive(**table.monochromator.model_dump(exclude={"second_order"})),
        controller=AxisController(**table.controller.model_dump()),
        noise=table.noise,
        estimator=table.optics.chosen(),
        order_sorting=OrderSorting(table.monochromator.second_order, tuple(each.filter() for each in table.filters)),
    )


def _tuples(table: TomlTable) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.model_dump().items()}
