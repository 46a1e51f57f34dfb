"""The rig file: its tables, which are the settings of the drivers with the addresses of the devices.

The operator's part has the addresses of the devices and their nominal properties (gears, offsets, limits, gains, geometry).
`[twin]` is the description of a virtual rig: see `twin_file`.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cache
from typing import Annotated, Any, Generic, Union, cast, get_args, get_type_hints

from annotated_types import Ge, Le
from pydantic import Discriminator, Tag, WithJsonSchema, with_config
from typing_extensions import TypeVar

from goniotwin.app.rig.addresses import TWIN, check_address
from goniotwin.app.rig.alignment import AlignmentTable
from goniotwin.app.rig.axes import AXES, AxesTable
from goniotwin.app.rig.inputs import Input, inputs
from goniotwin.app.rig.kinds import (
    ROLES,
    DeviceKind,
    Kind,
    MonitorEntry,
    MonochromatorEntry,
    MotionKind,
    PhotodiodesEntry,
    Role,
    device_kind,
    kinds,
    motion_kind,
    unknown_kind,
)
from goniotwin.app.rig.light import LightTable
from goniotwin.app.rig.makes import DEFAULT_KIND
from goniotwin.app.rig.twin_file import TwinTable
from goniotwin.app.rig.uncertainty import UncertaintyTable, disturbances_table, no_uncertainties, uncertainty_table
from goniotwin.app.toml_file import TABLE, Day
from goniotwin.drivers import (
    ArcClearance,
    AxisDescription,
)
from goniotwin.drivers.motion import AxisTiming
from goniotwin.drivers.tap import Explain
from goniotwin.keys import Fraction, Positive, Width, values_of
from goniotwin.protocols import adam
from goniotwin.twin.addresses import AXES as AXES_LINE
from goniotwin.twin.addresses import CONVERTER, MONITOR, MONOCHROMATOR
from goniotwin.twin.optics import Dimensions, Instrument

SHARED, OWN_KINDS = "that of [axes]", "those of the axes"
HIGHEST_RADIANCE_FACTOR, HIGHEST_NEAR_GRAZING = 1.5, 5.0
"""The ideal diffuser has 1 in every direction; a broad lobe has somewhat more, and a lobe near grazing much more."""
NEAR_GRAZING_DEG = 60.0
GEOMETRY = re.compile(r"(d[ie]?|h|\d+(?:\.\d+)?):(d[ie]?|h|\d+(?:\.\d+)?)")
"""Illumination and observation: an angle from the normal in degrees, or diffuse (d, di, de) or hemispherical (h)."""
SHAPE = 0.03
"""Relative standard uncertainty of an etalon's deviation from the ideal diffuser, at the normal; assumed."""
NO_TABLE = Annotated[dict[str, Any], WithJsonSchema({"not": {}})]
"""A table of which there is no kind."""


@dataclass(frozen=True)
class SimulatedTable:
    """The mark of a simulated rig. `goniotwin serve --write-rig` writes the keys, because the file of a served rig has no
    `[twin]`.

    `seed`: seed of the virtual rig's random numbers. `model`: hash of the virtual rig's model. `old_model`: first version of
    that hash, which older journals have. `speed`: simulation speed: seconds of the rig's time in one second. `server`: key of
    the process that serves the rig. `control_port`: the simulation control port, through which the program mounts samples.
    `control_token`: token that this port requires.
    """

    seed: int = 1
    model: str | None = None
    old_model: str | None = None
    speed: Positive = 1.0
    server: str | None = None
    control_port: Annotated[int, Ge(1), Le(65535)] | None = None
    control_token: str | None = None

    def __post_init__(self) -> None:
        if self.control_port is not None and not self.control_token:
            raise ValueError("control_token: is missing, and anything could answer at control_port; serve the rig again")


@dataclass(frozen=True)
class DeviceAddress:
    """An address in a rig file. `name` is that of the wire's transcript, `places` are the keys with it, as paths.

    `twin` is the device of the virtual rig that stands for it; `explain` gives bytes on its wire as text.
    """

    name: str
    address: str
    twin: str
    places: tuple[tuple[str | int, ...], ...]
    explain: Explain


@dataclass(frozen=True)
class GeometryTable(Dimensions):
    """The nominal dimensions of the instrument, in mm and degrees.

    `shadow_margin_deg`: directions within this angle of a blocked one also count as blocked by the mirror unit.
    """

    shadow_margin_deg: Annotated[float, Ge(0.0), Le(10.0)] = 0.2


@dataclass(frozen=True)
class SampleUnitTable:
    """The sample holder.

    `signature_uncertainty`: relative standard uncertainty of the instrument signature. The signature is measured with no sample
    mounted; a sample blocks a part of it, and scatters light onto the frames. The default is for frames 0.5 mm off the sample.
    Use 0.5 for 2 mm, and 0.01 for frames that lie on the sample.
    """

    signature_uncertainty: Fraction = Width(0.3)


def refuse_percentage(radiance_factor: float, zenith_deg: float = 0.0) -> None:
    """Raise ValueError for a radiance factor that is too high for a diffuser: it is probably in percent."""
    highest = HIGHEST_NEAR_GRAZING if zenith_deg > NEAR_GRAZING_DEG else HIGHEST_RADIANCE_FACTOR
    if radiance_factor > highest:
        raise ValueError(
            f"a radiance factor of {radiance_factor:g} is above {highest:g}, too high for a diffuser (1 is the ideal one); "
            f"if it is in percent, write {0.01 * radiance_factor:g}"
        )


def known_angles(geometry: str) -> list[float]:
    """The angles from the normal, in degrees, in which a geometry such as 8:d has light: those of its sides that are not d."""
    return [float(each) for each in geometry.split(":") if not each.startswith(("d", "h"))]


def check_geometry(value: str | None) -> None:
    """Raise ValueError for what is no geometry of a measurement, such as 8:d."""
    if value is not None and (not GEOMETRY.fullmatch(value) or any(each >= 90.0 for each in known_angles(value))):
        raise ValueError(
            f'{value!r} is no geometry: give illumination and observation, each an angle below 90 or d, as in "8:d"'
        )


@dataclass(frozen=True)
class EtalonTable:
    """The certificate of the etalon: one value for all wavelengths and directions.

    `radiance_factor`: its certified radiance factor; 1 is the ideal diffuser. `relative_uncertainty`: relative standard
    uncertainty of the radiance factor. `geometry`: geometry of the certificate's measurement, such as "8:d". The value is taken
    for all directions, and the uncertainty then includes `shape`. `shape`: relative standard uncertainty of the etalon's
    deviation from the ideal diffuser, at the normal. `calibrated`: day of the calibration.
    """

    radiance_factor: Positive = 1.0
    relative_uncertainty: Fraction = Width(0.0)
    geometry: str | None = None
    shape: Fraction = SHAPE
    calibrated: Day | None = None

    def __post_init__(self) -> None:
        try:
            check_geometry(self.geometry)
        except ValueError as error:
            raise ValueError(f"geometry: {error}") from None
        try:
            refuse_percentage(self.radiance_factor)
        except ValueError as error:
            raise ValueError(f"radiance_factor: {error}") from None


AnyAxes = TypeVar("AnyAxes", bound=AxesTable[Any], default=AxesTable)
AnyMonochromator = TypeVar("AnyMonochromator", bound=MonochromatorEntry, default=MonochromatorEntry)
AnyPhotodiodes = TypeVar("AnyPhotodiodes", bound=PhotodiodesEntry, default=PhotodiodesEntry)
AnyMonitor = TypeVar("AnyMonitor", bound=MonitorEntry, default=MonitorEntry)
AnyUncertainty = TypeVar("AnyUncertainty", bound=UncertaintyTable, default=UncertaintyTable)
AnyTwin = TypeVar("AnyTwin", bound=TwinTable[Any, Any, Any], default=TwinTable)


@with_config(TABLE)
@dataclass(frozen=True, kw_only=True)
class RigFile(Generic[AnyAxes, AnyMonochromator, AnyPhotodiodes, AnyMonitor, AnyUncertainty, AnyTwin]):
    """A rig file: devices, nominal dimensions, certificate and uncertainties of a rig. The key `kind` of a device decides which
    other keys its table has.

    `name`: name of the rig, as journals and reports show it. `axes`: the axes and their motion controllers.
    """

    name: str
    simulated: SimulatedTable | None = None
    axes: AnyAxes
    monochromator: AnyMonochromator
    photodiodes: AnyPhotodiodes
    monitor: AnyMonitor
    geometry: GeometryTable = field(default_factory=GeometryTable)
    sample_unit: SampleUnitTable = field(default_factory=SampleUnitTable)
    etalon: EtalonTable = field(default_factory=EtalonTable)
    light: LightTable = field(default_factory=LightTable)
    uncertainty: AnyUncertainty = field(default_factory=no_uncertainties)
    alignment: AlignmentTable | None = None
    twin: AnyTwin | None = None

    @property
    def devices(self) -> tuple[DeviceAddress, ...]:
        """The addresses of all devices, in the order in which they are listed: those of photodiodes one for each module."""
        twins = {} if self.twin is None else {axis: name for name, each in self.twin.controllers.items() for axis in each.axes}
        found: list[DeviceAddress] = []
        for controller in self.axes.controllers:
            at = twins.get(next(iter(controller.axes)), controller.name if self.twin is None else AXES_LINE)
            places = tuple((*place, "port") for place in controller.places)
            found.append(DeviceAddress(controller.name, controller.port, at, places, controller.kind.explain))

        def add(role: Role, name: str, address: str, at: str, *key: str | int) -> None:
            explain = device_kind(role, getattr(self, role).kind).explain
            found.append(DeviceAddress(name, address, at, ((role, *key),), explain))

        add("monochromator", "monochromator", self.monochromator.port, MONOCHROMATOR, "port")
        for k, unit in enumerate(self.photodiodes.units):
            add("photodiodes", f"photodiodes-{k}", unit, CONVERTER.format(k), "units", k)
        add("monitor", "monitor", self.monitor.usb, MONITOR, "usb")
        return tuple(
            replace(each, twin=each.address.rsplit("/", 1)[1]) if each.address.startswith(TWIN) else each for each in found
        )

    @property
    def addresses(self) -> list[str]:
        """Addresses of all devices."""
        return [each.address for each in self.devices]

    @property
    def in_process(self) -> bool:
        """Whether all devices are those of a virtual rig in this process."""
        return all(address.startswith(TWIN) for address in self.addresses)

    @property
    def speed(self) -> float:
        """Seconds of the rig's time per second: the simulation speed of a served rig."""
        return 1.0 if self.simulated is None else self.simulated.speed

    def __post_init__(self) -> None:
        for device in self.devices:
            try:
                check_address(device.address)
            except ValueError as error:
                raise ValueError(f"{'.'.join(map(str, device.places[0]))}: {error}") from None
        virtual = [address for address in self.addresses if address.startswith(TWIN)]
        if virtual and self.simulated is None:
            raise ValueError(f"{virtual[0]} is a virtual device: give the address of the real one, or add a [simulated] table")
        if virtual and self.twin is None:
            raise ValueError(
                f"{virtual[0]} is a virtual device: give the address of the real one, or add a [twin] table that describes it"
            )
        names = {address.split("/")[2] for address in virtual}
        if len(names) > 1:
            raise ValueError(f"its twin:// addresses have several virtual rigs: {', '.join(sorted(names))}; use one name")
        self._check_converters()
        known = {each.twin: None for each in self.devices[len(self.axes.controllers) :]}
        for name in self.twin.devices if self.twin is not None else ():
            if name not in known:
                raise ValueError(f"twin.devices: no device has the address {name!r}; give {' or '.join(known)}, or remove it")

    def _check_converters(self) -> None:
        """Raise ValueError for the address of a converter that the virtual rig does not have."""
        if self.twin is None:
            return
        own = self.twin.photodiodes
        converters = [CONVERTER.format(k) for k in range(-(-own.count // adam.CHANNELS))]
        for k, unit in enumerate(self.photodiodes.units):
            name = unit.rpartition("/")[2]
            if unit.startswith(TWIN) and name not in (*converters, *self.twin.devices):
                believed, has = self.photodiodes.count, f"{own.count} ({len(own.upper_deg)} on the upper arc)"
                raise ValueError(
                    f"photodiodes.units.{k}: the virtual rig has no converter {name}: [photodiodes] has {believed} angles, "
                    f"[twin.photodiodes] {has} on {', '.join(converters)}; give both tables the photodiodes of the rig, or "
                    "correct units"
                )


def set_addresses(document: Any, file: RigFile, address_of: Callable[[DeviceAddress], str]) -> None:
    """Set the address of each device in the tables of a rig file, or in the document of its text."""
    for device in file.devices:
        for *path, key in device.places:
            table = document
            for part in path:
                table = table[part]
            table[key] = address_of(device)


def rig_file_table() -> type[RigFile]:
    """The tables of a rig file: each device is one of the tables of the registered kinds, chosen by its `kind`."""
    return cast(type[RigFile], _rig_file_table(kinds(), inputs()))


@cache
def _rig_file_table(known: tuple[Kind, ...], uncertain: tuple[Input, ...]) -> Any:
    makes = [kind for kind in known if isinstance(kind, MotionKind)]
    own = {kind.name: kind.own_axis for kind in makes}
    generic: Any = AxesTable
    axes: dict[str, Any] = {kind.name: _axes_table(kind, own) for kind in makes}
    axes[OWN_KINDS] = generic[_choice(own, _kind)]
    devices = [kind for kind in known if isinstance(kind, DeviceKind)]
    tables = [_choice({kind.name: kind.table for kind in devices if kind.role == role}, _kind) for role in ROLES[1:]]
    twin: Any = TwinTable
    twin = twin[_choice(_twins(makes), _kind), _choice(_twins(devices), _kind), disturbances_table(uncertain)]
    file: Any = RigFile
    return file[_choice(axes, _axes_kind), *tables, uncertainty_table(uncertain), twin]


def _axes_table(kind: MotionKind, own: Mapping[str, Any]) -> Any:
    """`[axes]` with a controller of a kind; axes with one of their own have any."""
    table: Any = kind.axes
    return table[_choice({SHARED: kind.axis, **own}, lambda value: value.get("kind", SHARED))]


def _twins(known: Iterable[Kind]) -> dict[str, Any]:
    """The tables of the twin's devices of some kinds, by the kind that they have there."""
    return {name: model for kind in known for model in kind.twins for name in get_args(get_type_hints(model)["kind"])}


def _choice(tables: Mapping[str, Any], kind_of: Callable[[Any], Any]) -> Any:
    """One of several tables, by the kind of a value that is a table."""
    distinct = dict.fromkeys(tables.values())
    if len(distinct) < 2:
        return next(iter(distinct), NO_TABLE)
    choices = tuple(Annotated[table, Tag(kind)] for kind, table in tables.items())
    return Annotated[Union[choices], Discriminator(lambda value: kind_of(value) if isinstance(value, dict) else None)]  # noqa: UP007


def _kind(value: Any) -> Any:
    return value.get("kind") if isinstance(value, dict) else None


def _axes_kind(value: Any) -> Any:
    """The kind of the controller of `[axes]`; without one, whether each axis has its own."""
    if not isinstance(value, dict) or "kind" in value:
        return _kind(value)
    return OWN_KINDS if all(_kind(value.get(name)) for name in AXES) else DEFAULT_KIND


def check_kinds(content: Mapping[str, Any]) -> None:
    """Raise ValueError, with the key, for a kind in a rig file's content that is missing or unknown."""
    makes = [kind for kind in kinds() if isinstance(kind, MotionKind)]
    devices = [kind for kind in kinds() if isinstance(kind, DeviceKind)]
    if isinstance(axes := content.get("axes"), dict):
        _check_controllers(axes, makes)
    for role in ROLES[1:]:
        if isinstance(table := content.get(role), dict):
            _check_kind(role, table.get("kind"), role, [kind.name for kind in devices if kind.role == role])
    twin = content.get("twin")
    for part, known in (("controllers", _twins(makes)), ("devices", _twins(devices))):
        tables = twin.get(part) if isinstance(twin, dict) else None
        for name, table in tables.items() if isinstance(tables, dict) else ():
            if isinstance(table, dict):
                _check_kind(f"twin.{part}.{name}", table.get("kind"), None, known)


def _check_controllers(axes: Mapping[str, Any], makes: Iterable[MotionKind]) -> None:
    """Check the kinds in `[axes]`. Raises ValueError also for a key of a controller where there is none."""
    names = [kind.name for kind in makes]
    of_controllers = {"port", *(key.name for kind in makes for key in fields(kind.controller))}
    kind = _axes_kind(axes)
    if kind == OWN_KINDS:
        if key := next(filter(of_controllers.__contains__, axes), None):
            wrong = "every axis has a controller of its own, so there is none of [axes]"
            raise ValueError(f"axes.{key}: {wrong}; remove {key}")
        return _check_own_kinds(axes, names, set())
    _check_kind("axes", kind, "axes", names)
    return _check_own_kinds(axes, names, of_controllers - {key.name for key in fields(motion_kind(kind).axis)})


def _check_own_kinds(axes: Mapping[str, Any], names: Iterable[str], of_own: set[str]) -> None:
    for name in AXES:
        axis = axes.get(name)
        if isinstance(axis, dict) and "kind" in axis:
            _check_kind(f"axes.{name}", axis["kind"], "axes", names)
        elif isinstance(axis, dict) and (key := next(filter(of_own.__contains__, axis), None)):
            wrong = f"is missing; add it, because {key} is a key of an axis with a controller of its own"
            raise ValueError(f"axes.{name}.kind: {wrong}")


def _check_kind(place: str, kind: Any, role: Role | None, known: Iterable[str]) -> None:
    if kind not in [*known]:
        raise ValueError(f"{place}.kind: {'is missing; add it' if kind is None else unknown_kind(kind, role, known)}")


def axis_settings(file: RigFile) -> dict[str, AxisDescription]:
    """The settings of each axis, by its name."""
    return file.axes.by_name


def axis_timings(file: RigFile) -> dict[str, AxisTiming]:
    """The durations of the moves of each axis, by its name."""
    timings = {
        name: controller.kind.timing(controller.table, axis)
        for controller in file.axes.controllers
        for name, axis in controller.axes.items()
    }
    return {name: timings[name] for name in AXES}


def nominal_instrument(file: RigFile) -> Instrument:
    """The instrument with the operator's nominal dimensions, for the directions blocked by the mirror unit."""
    return Instrument(**values_of(file.geometry, Dimensions))


def tables_without_ports(file: RigFile) -> dict[str, Any]:
    """The tables of a rig file by name, as dictionaries, without its virtual rig and without addresses.

    Only addresses may change during an interruption of a campaign.
    """
    tables = {key: value for key, value in vars(file).items() if value is not None and key not in ("twin", "simulated")}
    content: dict[str, Any] = {key: value if isinstance(value, str) else asdict(value) for key, value in tables.items()}
    for place in {place for device in file.devices for place in device.places}:
        *path, key = (part for part in place if isinstance(part, str))
        table = content
        for part in path:
            table = table[part]
        table.pop(key, None)
    return content


def arc_clearance(file: RigFile) -> ArcClearance:
    """The clearance of the arc for this rig's photodiodes."""
    return ArcClearance(top_polar_deg=max(*file.photodiodes.upper_deg, *file.photodiodes.lower_deg, 0.0))
