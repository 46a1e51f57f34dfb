"""`[twin]` of a rig file: mechanics, optics, noise and samples of the virtual rig, and the model that they give.

Nothing here is taken from the operator's part of the file: a wrong sign there must show as a wrong angle.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from goniotwin.app.rig.samples import SampleTable, sample_scatterer
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

PolarAngle = Annotated[float, Field(ge=0.0, le=90.0)]
FilterPosition = Annotated[int, Field(ge=1, le=6)]


class OpticsTable(TomlTable):
    """Dimensions of the instrument; with `obstruction` off the mirror unit blocks no light on its way to the photodiodes.

    `estimator` computes the light of the photodiodes. `forward` traces all light until the median relative standard error of
    the photodiodes with light is `forward_error`: with photodiodes of 0.5 deg that takes some seconds a pose for 3 %, and a
    hundred times as long for 0.3 %; wider ones take less. `rays` is the number of rays per photodiode of `fast`, in place of
    the few that it places itself. `stray` adds, with either estimator, the light of the frames and the light that was
    scattered more than once: see `[twin.frames]`.
    """

    pupil_radius_mm: PositiveFloat = 5.0
    mirror_distance_mm: PositiveFloat = 200.0
    mirror_side_mm: PositiveFloat = 20.0
    mirror_mount_mm: NonNegativeFloat = 0.0
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
    def _is_possible(self) -> "OpticsTable":
        twin_instrument(self, {})
        return self

    def estimator_settings(self) -> Estimator:
        """The estimator and its settings, for the model."""
        return Estimator(self.estimator, self.rays, self.forward_error, self.stray)


class FramesTable(TomlTable):
    """The two sheets (frames) that hold the sample: see `twin.optics.SampleFrames`."""

    gap_mm: float = 0.0
    side_mm: float = 60.0
    reflectance: float = 0.05
    lit: float = 1.1

    @model_validator(mode="after")
    def _is_possible(self) -> "FramesTable":
        self.frames()
        return self

    def frames(self) -> SampleFrames:
        """The frames, for the model. Raises ValueError with the key of an impossible value."""
        return SampleFrames(**self.model_dump())


class SensorTable(TomlTable):
    """The real sensor unit, in place of the virtual detectors of `[twin.optics]`: see `twin.optics.RealSensor`."""

    lens_diameter_mm: PositiveFloat = RealSensor.lens_diameter_mm
    focal_length_mm: PositiveFloat = RealSensor.focal_length_mm
    aperture_mm: PositiveFloat = RealSensor.aperture_mm
    diaphragm_mm: PositiveFloat = RealSensor.diaphragm_mm
    detector_mm: PositiveFloat = RealSensor.detector_mm
    detector_side_mm: PositiveFloat = RealSensor.detector_side_mm

    @model_validator(mode="after")
    def _is_possible(self) -> "SensorTable":
        self.sensor()
        return self

    def sensor(self) -> RealSensor:
        """The sensor, for the model. Raises ValueError with the key of an impossible value."""
        return RealSensor(**self.model_dump())


class DeviationTable(TomlTable):
    """Deviation of an element from its nominal pose: three angles, three shifts; axes: twin.optics.geometry.instrument."""

    rx_deg: float = 0.0
    ry_deg: float = 0.0
    rz_deg: float = 0.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0


def twin_instrument(
    optics: OpticsTable, deviations: Mapping[str, DeviationTable], sensor_table: SensorTable | None = None
) -> Instrument:
    """The instrument of the virtual rig.

    Raises ValueError for impossible dimensions, for a deviation of an unknown element, for a sensor table beside dimensions
    of virtual detectors, and for a sensor that the estimator cannot compute.
    """
    sensor = None if sensor_table is None else sensor_table.sensor()
    if sensor is not None:
        if given := sorted(optics.model_fields_set & {"detector_diameter_mm", "field_deg"}):
            raise ValueError(f"optics.{given[0]} is of virtual detectors, which [twin.sensor] replaces; remove one of them")
        if optics.estimator == "fast" and sensor.departure is not None:
            raise ValueError(
                f"sensor: {sensor.departure}, so it is not a disc with an acceptance cone, and the fast estimator computes "
                'only such discs; set optics.estimator = "forward", or correct the sensor'
            )
    dimensions = optics.model_dump(exclude={"estimator", "rays", "forward_error", "stray"})
    given_deviations = {element: Deviation(**deviation.model_dump()) for element, deviation in deviations.items()}
    return Instrument(**dimensions, deviations=given_deviations, sensor=sensor)


class MechanicsTable(TomlTable):
    """The real properties of an axis."""

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
    """The motion modules and their wire: one module for each address that the axes have as `module`."""

    kind: Literal["tmcm-6214", "tmcm-1240"] = "tmcm-6214"
    wire: Literal["usb", "rs485"] = "usb"
    baudrate: PositiveInt = 115200
    latency_s: NonNegativeFloat = 3.0e-4
    encoder_noise_microsteps: NonNegativeFloat = 1.0


class AxesMechanicsTable(TomlTable):
    """The real properties of all four axes."""

    gamma: MechanicsTable
    sigma: MechanicsTable
    beta: MechanicsTable
    shift: MechanicsTable

    @model_validator(mode="after")
    def _one_motor_each(self) -> "AxesMechanicsTable":
        motors = [(each.module, each.motor) for each in (self.gamma, self.sigma, self.beta, self.shift)]
        for module, motor in motors:
            if (count := motors.count((module, motor))) > 1:
                raise ValueError(f"motor {motor} turns {count} axes of module {module}; give each axis its own motor")
        return self


class LightTable(TomlTable):
    """The lamp: radiance, throughput to the sample, drift and noise."""

    radiance: PositiveFloat = 2.0e3
    throughput: Annotated[float, Field(gt=0.0, le=1.0)] = 0.18
    drift_per_hour: float = 0.0
    flicker: Fraction = 5.0e-4
    wander: Fraction = 2.0e-3


class DiodesTable(TomlTable):
    """The polar angles of the photodiodes, and their dark currents."""

    upper_deg: Annotated[list[PolarAngle], Field(min_length=1)] = [5.0 * k for k in range(18)]
    lower_deg: list[PolarAngle] = [5.0 * k for k in range(18)]
    dark_a: NonNegativeFloat = 2.0e-12
    dark_spread: Fraction = 0.05
    dark_wander: Fraction = 2.0e-3


class ElectronicsTable(TomlTable):
    """Amplifiers and converters; `gain_spread` is the relative deviation of the real gains from the nominal ones."""

    gains_v_per_a: Annotated[list[PositiveFloat], Field(min_length=1, max_length=4)] = [1e6, 1e8, 1e10, 1e11]
    gain_spread: Fraction = 1.0e-3
    offset_v: float = 1.0e-3
    noise_v: NonNegativeFloat = 1.5e-4
    settling_s: PositiveFloat = 0.02
    module: Literal["adam-6017", "adam-4117"] = "adam-6017"
    baudrate: PositiveInt = 9600
    conversions_per_s: Literal[10, 100] = 100


class DriveTable(TomlTable):
    """The monochromator: its times, whether its line echoes, whether it has the handshake mode.

    `filters` is the number of positions of its filter wheel, `filter_s` the time from one to the next. `second_order` is the
    fraction of light of half the wavelength that passes as well (second order); the lamp has no such light up to 710 nm.
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
    """A filter in the wheel of the virtual rig: see `twin.plant.WheelFilter`. A position without a filter is open."""

    position: FilterPosition
    cut_on_nm: PositiveFloat
    transmittance: Annotated[float, Field(gt=0.0, le=1.0)] = WheelFilter.transmittance

    def filter(self) -> WheelFilter:
        """The filter, for the model."""
        return WheelFilter(**self.model_dump())


def refuse_repeated_positions(positions: Sequence[int]) -> None:
    """Raise ValueError if a position of a filter wheel is given twice."""
    for position in positions:
        if (count := positions.count(position)) > 1:
            raise ValueError(f"filters: position {position} is given {count} times; keep one, a position has one filter")


class TwinTable(TomlTable):
    """The virtual rig. With `noise` off there are no random processes; the quantisation remains."""

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
    def _is_possible(self) -> "TwinTable":
        twin_instrument(self.optics, self.deviations, self.sensor)
        return self

    @model_validator(mode="after")
    def _filters_fit_the_wheel(self) -> "TwinTable":
        refuse_repeated_positions([each.position for each in self.filters])
        for each in self.filters:
            if each.position > self.monochromator.filters:
                raise ValueError(
                    f"filters: a wheel of {self.monochromator.filters} positions has no position {each.position}; choose "
                    "another, or correct monochromator.filters"
                )
        return self

    @model_validator(mode="after")
    def _motors_exist(self) -> "TwinTable":
        motors = {"tmcm-6214": 6, "tmcm-1240": 1}[self.controller.kind]
        for name in type(self.axes).model_fields:
            axis: MechanicsTable = getattr(self.axes, name)
            if axis.motor >= motors:
                wrong = f"axes.{name}: a {self.controller.kind} has {motors} motors, so there is no motor {axis.motor}"
                raise ValueError(f"{wrong}; correct the motor, or controller.kind")
        return self


def twin_model(table: TwinTable, seed: int, folder: Path, name: str) -> TwinModel:
    """The model of the virtual rig; the paths of sample files are relative to `folder`.

    Raises UserError with `name`, the sample and its file for a file that cannot be read.
    """
    return TwinModel(
        seed=seed,
        axes={axis: Mechanics(**mechanics) for axis, mechanics in table.axes.model_dump().items()},
        samples={key: sample_scatterer(sample, folder, f"{name}: twin.samples.{key}") for key, sample in table.samples.items()},
        instrument=twin_instrument(table.optics, table.deviations, table.sensor),
        frames=table.frames.frames(),
        light=LightSource(**table.light.model_dump()),
        photodiodes=Photodiodes(**_tuples(table.photodiodes)),
        electronics=Electronics(**_tuples(table.electronics)),
        monitor=MonitorPhotodiode(),
        monochromator=MonochromatorDrive(**table.monochromator.model_dump(exclude={"second_order"})),
        controller=AxisController(**table.controller.model_dump()),
        noise=table.noise,
        estimator=table.optics.estimator_settings(),
        order_sorting=OrderSorting(table.monochromator.second_order, tuple(each.filter() for each in table.filters)),
    )


def _tuples(table: TomlTable) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.model_dump().items()}
