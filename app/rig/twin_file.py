"""`[twin]` of a rig file: mechanics, optics, noise and samples of the virtual rig, and the model that they give.

Its tables are the parts of the model. Nothing here is taken from the operator's part of the file: a wrong sign there must show
as a wrong angle.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Generic

from pydantic import Field
from typing_extensions import TypeVar

from goniotwin.app.rig.inputs import SECOND_LEVEL, inputs
from goniotwin.app.rig.samples import SampleTable, sample_scatterer
from goniotwin.app.rig.uncertainty import no_disturbances
from goniotwin.drivers.monochromator.settings import refuse_repeated_positions
from goniotwin.keys import Share, values_of
from goniotwin.twin.addresses import AXES, CONVERTER, CONVERTER_LINE, MONITOR, MONOCHROMATOR
from goniotwin.twin.devices import MODULE_KINDS
from goniotwin.twin.optics import Deviation, Instrument, RealSensor
from goniotwin.twin.optics.geometry.field import scale_field
from goniotwin.twin.optics.geometry.instrument import MIRROR_REFLECTANCE
from goniotwin.twin.plant import (
    AxisController,
    ControllerModel,
    DeviceModel,
    Estimator,
    Mechanics,
    MonochromatorDrive,
    OrderSorting,
    Parts,
    SecondOrder,
    TwinModel,
    WheelFilter,
)
from goniotwin.twin.plant.disturbances import ETALON, FIELD, SECOND, Disturbances
from goniotwin.twin.plant.model import EstimatorKind, RelativeError

NAME = re.compile(r"[A-Za-z0-9_-]+")
"""The name of a device in an address `twin://RIG/NAME`."""


@dataclass(frozen=True)
class OpticsTable(Instrument, Estimator):
    """The optics of the virtual rig. Deviations and sensor have tables of their own.

    `estimator`: how the light on the photodiodes is computed: "fast" or "forward". `forward_error`: median relative standard
    error of the photodiodes with light at which "forward" stops. With photodiodes of 0.5 deg, 3 % takes some seconds a pose,
    and 0.3 % a hundred times as long.
    """

    mirror_reflectance: Share = MIRROR_REFLECTANCE
    kind: Annotated[EstimatorKind, Field(validation_alias="estimator")] = Estimator.kind
    relative_error: Annotated[RelativeError, Field(validation_alias="forward_error")] = Estimator.relative_error
    pupil_to_mirror_mm: float = field(default=Instrument.pupil_to_mirror_mm, init=False)
    deviations: Mapping[str, Deviation] = field(default_factory=dict, init=False)
    illumination: Mapping[str, Deviation] = field(default_factory=dict, init=False)
    sensor: RealSensor | None = field(default=None, init=False)


@dataclass(frozen=True)
class AxesMechanicsTable:
    """The real properties of the four axes.

    `gamma`: turns the sample. `sigma`: turns the mirror unit. `beta`: turns the arc. `shift`: shifts the arc along itself.
    """

    gamma: Mechanics
    sigma: Mechanics
    beta: Mechanics
    shift: Mechanics


@dataclass(frozen=True)
class DriveTable(MonochromatorDrive, SecondOrder):
    """The monochromator of the virtual rig."""

    gratings: tuple[tuple[int, str], ...] = field(default=MonochromatorDrive.gratings, init=False)
    already_there_is_error: bool = field(default=False, init=False)


def check_detectors(content: Mapping[str, Any]) -> None:
    """Raise ValueError for dimensions of virtual detectors beside a sensor in a rig file's content, even the default ones."""
    twin = content.get("twin")
    optics = twin.get("optics") if isinstance(twin, dict) and "sensor" in twin else None
    if given := sorted(set(optics or ()) & {"detector_diameter_mm", "field_deg"}):
        raise ValueError(f"twin.optics.{given[0]}: is of virtual detectors, which [twin.sensor] replaces; remove one of them")


AnyController = TypeVar("AnyController", bound=ControllerModel, default=ControllerModel)
AnyDevice = TypeVar("AnyDevice", bound=DeviceModel, default=DeviceModel)
AnyDisturbances = TypeVar("AnyDisturbances", bound=Disturbances, default=Disturbances)


@dataclass(frozen=True, kw_only=True)
class TwinTable(Parts, Generic[AnyController, AnyDevice, AnyDisturbances]):
    """The virtual rig, as it really is. The operator's part of the file states what the operator believes.

    `samples`: models of the samples, by name. `deviations`: position errors of the instrument's elements, by the name of the
    element: see `[twin.optics]`. `illumination`: position errors of the illumination unit's own elements, by name: arc,
    reflector, input_condenser, slit, output_condenser, and unit for all of them. `filters`: order-sorting filters in the
    monochromator's wheel. `controllers`: further motion controllers, by the name in their address. `devices`: devices in place
    of the program's own ones, by the name in their address.
    """

    axes: AxesMechanicsTable
    samples: dict[str, SampleTable]
    optics: OpticsTable = field(default_factory=OpticsTable)
    sensor: RealSensor | None = None
    deviations: dict[str, Deviation] = field(default_factory=dict)
    illumination: dict[str, Deviation] = field(default_factory=dict)
    monochromator: DriveTable = field(default_factory=DriveTable)
    filters: tuple[WheelFilter, ...] = ()
    controllers: dict[str, AnyController] = field(default_factory=dict)
    devices: dict[str, AnyDevice] = field(default_factory=dict)
    disturbances: AnyDisturbances = field(default_factory=no_disturbances)

    def __post_init__(self) -> None:
        if self.sensor is not None and self.optics.kind == "fast" and self.sensor.departure is not None:
            raise ValueError(
                f"sensor: {self.sensor.departure}, so it is not a disc with an acceptance cone, and the fast estimator "
                'computes only such discs; set optics.estimator = "forward", or correct the sensor'
            )
        scale_field(self.instrument(), self.disturbances.width(FIELD))
        self._check_samples()
        refuse_repeated_positions([each.position for each in self.filters])
        for each in self.filters:
            if each.position > self.monochromator.filters:
                raise ValueError(
                    f"filters: a wheel of {self.monochromator.filters} positions has no position {each.position}; choose "
                    "another, or correct monochromator.filters"
                )
        self._check_controllers()

    @property
    def further_devices(self) -> dict[str, DeviceModel]:
        """The devices at addresses of their own, or in place of the usual ones, by address."""
        return {**self.controllers, **self.devices}

    def _check_samples(self) -> None:
        """Raise ValueError for the properties of a sample that is not there, or of an etalon that is not."""
        if unknown := sorted(set(self.diattenuation) - set(self.samples)):
            raise ValueError(f"diattenuation.{unknown[0]}: there is no such sample; give one of [twin.samples], or remove it")
        table = self.disturbances
        for key in ("second_standard", "turned"):
            if (name := getattr(table, key)) and (name == table.etalon or name not in self.samples):
                raise ValueError(
                    f"disturbances.{key}: {name!r} is the etalon, or no sample of [twin.samples]; give one of them"
                )
        if (table.second_years or getattr(table, SECOND_LEVEL.key, 0.0)) and not table.second_standard:
            raise ValueError("disturbances.second_standard: is missing; give the name of that sample")
        parts = {each.key: {at.part for targets in each.targets.values() for at in targets} for each in inputs()}
        keys = [key for key, of_key in parts.items() if ETALON in of_key and of_key <= {ETALON, SECOND}]
        of_etalon = [key for key in ("etalon_years", *keys) if getattr(table, key, 0.0)]
        if of_etalon and table.etalon not in self.samples:
            raise ValueError(
                f"disturbances.{of_etalon[0]}: of the etalon, and there is no sample {table.etalon!r}; set disturbances.etalon "
                f"to its name ({', '.join(sorted(self.samples)) or 'none is given'})"
            )

    def _check_controllers(self) -> None:
        """Raise ValueError for a name of another device, and axes with several controllers or a motor that is not there."""
        axes, left = vars(self.axes), list(vars(self.axes))
        for name, controller in self.controllers.items():
            if not NAME.fullmatch(name):
                raise ValueError(f"controllers: {name!r} is no name of a device; give one of letters, digits, - and _")
            if name in (MONOCHROMATOR, MONITOR, CONVERTER_LINE) or name.startswith(CONVERTER.format("")):
                raise ValueError(f"controllers: {name} is the name of another device; give the controller another one")
            if not controller.axes:
                raise ValueError(f"controllers.{name}.axes: a controller needs an axis; name one, or remove this table")
            for axis in controller.axes:
                if axis not in left:
                    happened = f"has a second controller, {name}" if axis in axes else "is no axis"
                    raise ValueError(f"controllers.{name}.axes: {axis} {happened}; correct axes")
                left.remove(axis)
        if left and AXES in self.controllers:
            raise ValueError(f"controllers: {AXES} is the controller of {', '.join(left)}; give this one another name")
        self._check_motors(self.controller, left, "controller")
        further: Mapping[str, ControllerModel] = self.controllers
        for name, line in further.items():
            if isinstance(line, AxisController):
                self._check_motors(line, line.axes, f"controllers.{name}")

    def _check_motors(self, controller: AxisController, names: Sequence[str], place: str) -> None:
        """Raise ValueError for a motor of several axes, or one that a module of this line does not have."""
        axes = vars(self.axes)
        used: list[tuple[int, int]] = [(axes[name].module, axes[name].motor) for name in names]
        for module, motor in used:
            if (count := used.count((module, motor))) > 1:
                raise ValueError(f"axes: motor {motor} turns {count} axes of module {module}; give each axis its own motor")
        motors = MODULE_KINDS[controller.kind].motors
        for name in names:
            if axes[name].motor >= motors:
                having = f"{motors} motor" if motors == 1 else f"{motors} motors"
                wrong = f"axes.{name}: a {controller.kind} has {having}, so there is no motor {axes[name].motor}"
                raise ValueError(f"{wrong}; correct the motor, or {place}.kind")

    def instrument(self) -> Instrument:
        """The instrument, with sensor and deviations. Raises ValueError for a deviation of an unknown element."""
        return replace(
            Instrument(**values_of(self.optics, Instrument)),
            deviations=self.deviations,
            illumination=self.illumination,
            sensor=self.sensor,
        )

    def estimator(self) -> Estimator:
        """The estimator of the light on the photodiodes."""
        return Estimator(**values_of(self.optics, Estimator))


def twin_model(table: TwinTable, seed: int, folder: Path, name: str) -> TwinModel:
    """The model of the virtual rig; the paths of sample files are relative to `folder`.

    Raises UserError with `name`, the sample and its file for a file that cannot be read.
    """
    return TwinModel(
        seed=seed,
        axes=dict(vars(table.axes)),
        samples={key: sample_scatterer(sample, folder, f"{name}: twin.samples.{key}") for key, sample in table.samples.items()},
        instrument=table.instrument(),
        monochromator=MonochromatorDrive(**values_of(table.monochromator, MonochromatorDrive)),
        estimator=table.estimator(),
        order_sorting=OrderSorting(table.monochromator.second_order, table.filters),
        devices=table.further_devices,
        **values_of(table, Parts),
    )
