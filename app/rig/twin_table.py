"""`[twin]`: the virtual rig's own mechanics, optics, noise and samples, as people write them, and the model they make.

Nothing here is taken from the operator's part of the file: a wrong sign there has to show as a wrong angle.
"""

import hashlib
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from app.errors import UserError
from app.formats.errors import FormatError
from app.formats.zemax import ZemaxBsdf, read_zemax
from app.tables import Table
from twin.optics import Instrument, Scatterer, gaussian, lambertian, tabulated
from twin.plant import (
    AxisController,
    Electronics,
    Light,
    Mechanics,
    Monitor,
    MonochromatorDrive,
    Photodiodes,
    TwinModel,
)

Share = Annotated[float, Field(ge=0.0, lt=1.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Polar = Annotated[float, Field(ge=0.0, le=90.0)]


class MechanicsTable(Table):
    """An axis as it is."""

    motor: Annotated[int, Field(ge=0, le=5)]
    gear: PositiveFloat
    sense: Literal[1, -1] = 1
    zero_deg: float = 0.0
    full_steps: PositiveInt = 200
    encoder: bool = True
    module: Annotated[int, Field(ge=1, le=255)] = 1
    backlash_deg: NotNegative = 0.0
    lower_switch_deg: float | None = None
    upper_switch_deg: float | None = None
    home_deg: float | None = None
    home_width_deg: Annotated[float, Field(gt=0.0, lt=360.0)] = 1.0
    encoder_counts: PositiveInt = 51_200
    encoder_error_deg: NotNegative = 0.0


class ControllerTable(Table):
    """The motion modules and their wire: one module for each address among the axes' `module`."""

    kind: Literal["tmcm-6214", "tmcm-1240"] = "tmcm-6214"
    wire: Literal["usb", "rs485"] = "usb"
    baudrate: PositiveInt = 115200
    latency_s: NotNegative = 3.0e-4
    encoder_noise_microsteps: NotNegative = 1.0


class AxesMechanicsTable(Table):
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


class OpticsTable(Table):
    """Dimensions of the instrument; `obstruction` off lets light pass through the mirror unit."""

    pupil_radius_mm: PositiveFloat = 5.0
    mirror_distance_mm: PositiveFloat = 200.0
    mirror_side_mm: PositiveFloat = 20.0
    mirror_reflectance: Annotated[float, Field(gt=0.0, le=1.0)] = 0.95
    spot_side_mm: PositiveFloat = 5.0
    arc_radius_mm: PositiveFloat = 300.0
    detector_diameter_mm: PositiveFloat = 5.0
    field_deg: PositiveFloat = 0.5
    obstruction: bool = True
    rays: Annotated[int, Field(ge=16, le=1 << 20, multiple_of=4)] = 1024

    @model_validator(mode="after")
    def _can_be_built(self) -> "OpticsTable":
        self.instrument()
        return self

    def instrument(self) -> Instrument:
        """The instrument. Raises ValueError for dimensions that make none."""
        return Instrument(**self.model_dump(exclude={"rays"}))


class LightTable(Table):
    """The lamp: its radiance, what of it arrives, and how steady it is."""

    radiance: PositiveFloat = 2.0e3
    throughput: Annotated[float, Field(gt=0.0, le=1.0)] = 0.18
    drift_per_hour: float = 0.0
    flicker: Share = 5.0e-4
    wander: Share = 2.0e-3


class DiodesTable(Table):
    """Where the photodiodes sit, and their dark currents."""

    upper_deg: Annotated[list[Polar], Field(min_length=1)] = [5.0 * k for k in range(18)]
    lower_deg: list[Polar] = [5.0 * k for k in range(18)]
    dark_a: NotNegative = 2.0e-12
    dark_spread: Share = 0.05
    dark_wander: Share = 2.0e-3


class ElectronicsTable(Table):
    """Amplifiers and converters; `gain_spread` is how far the gains are from what is printed on them."""

    gains_v_per_a: Annotated[list[PositiveFloat], Field(min_length=1, max_length=4)] = [1e6, 1e8, 1e10, 1e11]
    gain_spread: Share = 1.0e-3
    offset_v: float = 1.0e-3
    noise_v: NotNegative = 1.5e-4
    settling_s: PositiveFloat = 0.02
    module: Literal["adam-6017", "adam-4117"] = "adam-6017"
    baudrate: PositiveInt = 9600
    conversions_per_s: Literal[10, 100] = 100


class DriveTable(Table):
    """The monochromator as it is: its speeds, whether its line echoes, whether it knows handshake mode."""

    echo: bool = True
    handshake: bool = True
    slew_nm_per_s: PositiveFloat = 175.0
    settle_s: NotNegative = 0.1
    shutter_s: NotNegative = 0.15
    filter_s: NotNegative = 1.0
    filters: Annotated[int, Field(ge=0, le=6)] = 6
    grating_s: NotNegative = 8.0


class LambertianTable(Table):
    """A perfect diffuser of some reflectance."""

    model: Literal["lambertian"]
    reflectance: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0


class GaussianTable(Table):
    """A Gaussian lobe round the specular direction (the paper's formula 6)."""

    model: Literal["gaussian"]
    width_deg: float
    form: Literal["one_over_e", "half_width"] = "one_over_e"
    quantity: Literal["luminance", "intensity"] = "luminance"
    peak: float | None = None
    reflectance: float | None = None

    @model_validator(mode="after")
    def _makes_a_lobe(self) -> "GaussianTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The lobe. Raises ValueError for a width or a height that is none."""
        return gaussian(self.width_deg, self.form, self.quantity, self.peak, self.reflectance)


class MeasuredTable(Table):
    """A table of a Zemax `.bsdf` file, named from where the rig file is."""

    model: Literal["zemax"]
    file: str


SampleTable = Annotated[LambertianTable | GaussianTable | MeasuredTable, Field(discriminator="model")]


class TwinTable(Table):
    """The virtual rig. `noise` off silences every random process and leaves the quantisation."""

    axes: AxesMechanicsTable
    samples: dict[str, SampleTable]
    noise: bool = True
    optics: OpticsTable = OpticsTable()
    light: LightTable = LightTable()
    photodiodes: DiodesTable = DiodesTable()
    electronics: ElectronicsTable = ElectronicsTable()
    monochromator: DriveTable = DriveTable()
    controller: ControllerTable = ControllerTable()

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
    rays = table.optics.rays
    return TwinModel(
        seed=seed,
        axes={axis: Mechanics(**mechanics) for axis, mechanics in table.axes.model_dump().items()},
        samples={key: _scatterer(sample, folder, f"{name}: twin.samples.{key}") for key, sample in table.samples.items()},
        instrument=table.optics.instrument(),
        light=Light(**table.light.model_dump()),
        photodiodes=Photodiodes(**_tuples(table.photodiodes)),
        electronics=Electronics(**_tuples(table.electronics)),
        monitor=Monitor(),
        monochromator=MonochromatorDrive(**table.monochromator.model_dump()),
        controller=AxisController(**table.controller.model_dump()),
        noise=table.noise,
        rays=rays,
    )


def model_hash(model: TwinModel) -> str:
    """A fingerprint of a model without its seed: everything that decides what the virtual rig does, samples' tables too."""
    digest = hashlib.sha256()
    for part in (model.axes, model.instrument, model.light, model.photodiodes, model.electronics, model.monitor):
        digest.update(repr(part).encode())
    digest.update(repr((model.monochromator, model.controller, model.noise, model.rays)).encode())
    for key, sample in sorted(model.samples.items()):
        digest.update(f"{key} {sample.kind}".encode())
        for values in (sample.params, sample.sigma_deg, sample.phi_deg, sample.theta_deg, sample.values):
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]


def _tuples(table: Table) -> dict[str, Any]:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.model_dump().items()}


def _scatterer(sample: LambertianTable | GaussianTable | MeasuredTable, folder: Path, place: str) -> Scatterer:
    if isinstance(sample, LambertianTable):
        return lambertian(sample.reflectance)
    if isinstance(sample, GaussianTable):
        return sample.scatterer()
    try:
        return _from_zemax(read_zemax(folder / sample.file))
    except (FormatError, ValueError) as error:
        raise UserError(f"{place}: {error}") from None


def _from_zemax(table: ZemaxBsdf) -> Scatterer:
    """An isotropic reflecting sample from a Zemax table. Raises ValueError for one that is not."""
    if table.scatter_type.upper() != "BRDF":
        raise ValueError(f"its ScatterType is {table.scatter_type}; a sample here needs a BRDF")
    if len(table.sample_rotation_deg) != 1:
        raise ValueError(f"it has {len(table.sample_rotation_deg)} sample rotations; a sample here needs exactly one")
    return tabulated(table.incidence_deg, table.azimuth_deg, table.radial_deg, table.values[0])
