"""The rig file: its tables, and the drivers' settings that they give.

The operator's part has the addresses of the devices and their nominal properties (gears, offsets, limits, gains, geometry).
`[twin]` is the description of a virtual rig: see `twin_file`.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, field_validator, model_validator

from goniotwin.app.rig.addresses import TWIN
from goniotwin.app.rig.twin_file import FilterPosition, Fraction, PolarAngle, TwinTable, refuse_repeated_positions
from goniotwin.app.toml_file import TomlTable
from goniotwin.drivers import (
    ArcClearance,
    AxisSettings,
    FilterWheel,
    Homing,
    MonitorSettings,
    MonochromatorSettings,
    OrderFilter,
    PhotodiodeSettings,
)
from goniotwin.protocols import adam
from goniotwin.twin.optics import Instrument

AXES = ("gamma", "sigma", "beta", "shift")
TINY_NM = 1e-6
HIGHEST_RADIANCE_FACTOR, HIGHEST_NEAR_GRAZING = 1.5, 5.0
"""The ideal diffuser has 1 in every direction; a broad lobe has somewhat more, and a lobe near grazing much more."""
NEAR_GRAZING_DEG = 60.0


class SimulatedTable(TomlTable):
    """The mark of a simulated rig, with the seed of the virtual rig.

    A rig that another process serves has no [twin] in its file. Its table has the hash of the model (`old_model` is the hash
    in its first version, which older journals have), the simulation speed, and the simulation control port, through which
    samples are mounted.
    """

    seed: int = 1
    model: str | None = None
    old_model: str | None = None
    speed: PositiveFloat = 1.0
    control_port: Annotated[int, Field(ge=1, le=65535)] | None = None


class HomingTable(TomlTable):
    """A reference search: its mode by Trinamic's numbers (1 to 8, plus 64 or 128), and the angle of the reference.

    Without `angle_deg` the reference is at microstep 0 of the axis.
    """

    mode: Annotated[int, Field(ge=1, le=136)]
    speed_deg_s: PositiveFloat
    switch_speed_deg_s: PositiveFloat
    angle_deg: float | None = None
    longest_s: PositiveFloat = 180.0

    @field_validator("mode")
    @classmethod
    def _known_mode(cls, mode: int) -> int:
        if mode not in (*range(1, 9), *range(65, 69), *range(133, 137)):
            raise ValueError(f"{mode} is not a reference search; give 1 to 8, 65 to 68 (64 added) or 133 to 136 (128 added)")
        return mode


class AxisTable(TomlTable):
    """The nominal properties of an axis; `gear` is in motor turns per turn of the axis.

    With a backlash every move arrives from the side `approach_from`, for which the zero offset holds. The motor is stopped by
    the limit switches (`switches`), by a deviation of the encoder (`max_deviation_deg`), or by a stall above
    `stall_speed_deg_s`; 0 is off. `encoder_tolerance_deg` is the permitted difference of counter and encoder at rest (0 is
    off; the default is 0.05 deg plus the backlash).

    `power_up_at_reference`: after power-up or a reset of the controller the axis is at microstep 0, kept there by a parking
    position or a brake. Without it the axis is then unreferenced, and does not move until it is homed or its position is set.
    """

    motor: Annotated[int, Field(ge=0, le=5)]
    gear: PositiveFloat
    lower_deg: float
    upper_deg: float
    speed_deg_s: PositiveFloat
    acceleration_deg_s2: PositiveFloat
    sense: Literal[1, -1] = 1
    zero_offset_deg: float = 0.0
    module: Annotated[int, Field(ge=1, le=255)] = 1
    full_steps: PositiveInt = 200
    microsteps: Literal[1, 2, 4, 8, 16, 32, 64, 128, 256] = 256
    run_current: Annotated[int, Field(ge=0, le=255)] = 128
    standby_current: Annotated[int, Field(ge=0, le=255)] = 8
    power_down_s: Annotated[float, Field(ge=0.01, le=655.0)] = 2.0
    settling_s: Annotated[float, Field(ge=0.0, le=600.0)] = 0.1
    encoder: bool = True
    encoder_counts: PositiveInt | None = None
    max_deviation_deg: NonNegativeFloat = 0.0
    stall_speed_deg_s: NonNegativeFloat = 0.0
    switches: bool = False
    swap_switches: bool = False
    right_polarity: Literal[0, 1] = 0
    left_polarity: Literal[0, 1] = 0
    soft_stop: bool = False
    backlash_deg: NonNegativeFloat = 0.0
    approach_from: Literal["below", "above"] = "below"
    homing: HomingTable | None = None
    homing_required: bool = False
    power_up_at_reference: bool = False
    encoder_tolerance_deg: NonNegativeFloat | None = None

    @model_validator(mode="after")
    def _limits_in_order(self) -> "AxisTable":
        if not self.lower_deg < self.upper_deg:
            raise ValueError(f"lower_deg {self.lower_deg:g} is not below upper_deg {self.upper_deg:g}; exchange them")
        return self

    @model_validator(mode="after")
    def _one_way_to_the_reference(self) -> "AxisTable":
        if self.homing_required and self.power_up_at_reference:
            raise ValueError("homing_required and power_up_at_reference contradict each other; remove one")
        return self


class AxesTable(TomlTable):
    """The motion controller and its axes."""

    kind: Literal["tmcl"]
    port: str
    baudrate: PositiveInt = 115200
    heartbeat_s: Annotated[float, Field(ge=0.0, le=65.0)] = 2.0
    gamma: AxisTable
    sigma: AxisTable
    beta: AxisTable
    shift: AxisTable

    @model_validator(mode="after")
    def _one_motor_each(self) -> "AxesTable":
        wired: dict[tuple[int, int], str] = {}
        for name in AXES:
            axis: AxisTable = getattr(self, name)
            motor = (axis.module, axis.motor)
            if motor in wired:
                wrong = f"{wired[motor]} and {name} are both motor {axis.motor} of module {axis.module}"
                raise ValueError(f"{wrong}; correct one of them")
            wired[motor] = name
        return self


class OrderFilterTable(TomlTable):
    """An order-sorting filter: its position in the wheel, and the wavelengths from `from_nm` (included) to `to_nm` for it.

    `to_nm` is included if no other band begins there. The filter transmits from `cut_on_nm` on; without `cut_on_nm`, as for
    an empty position, it is assumed to block nothing.
    """

    position: FilterPosition
    name: Annotated[str, Field(min_length=1)]
    from_nm: PositiveFloat
    to_nm: PositiveFloat
    cut_on_nm: PositiveFloat | None = None

    @model_validator(mode="after")
    def _transmits_its_band(self) -> "OrderFilterTable":
        if not self.from_nm < self.to_nm:
            raise ValueError(f"from_nm {self.from_nm:g} is not below to_nm {self.to_nm:g}; exchange them")
        if self.cut_on_nm is not None and self.cut_on_nm > self.from_nm:
            raise ValueError(
                f"cut_on_nm {self.cut_on_nm:g} is above from_nm {self.from_nm:g}, so the filter blocks a part of its own band; "
                "let the band begin higher, or use another filter"
            )
        return self

    def __str__(self) -> str:
        return f"{self.name!r} ({self.from_nm:g} to {self.to_nm:g} nm)"


def check_filter_bands(filters: Sequence[OrderFilterTable], lowest_nm: float, highest_nm: float) -> None:
    """Check that the bands do not overlap and leave no gap from `lowest_nm` to `highest_nm`.

    Raises ValueError with the keys to correct.
    """
    ordered = sorted(filters, key=lambda each: each.from_nm)
    for below, above in pairwise(ordered):
        if above.from_nm < below.to_nm - TINY_NM:
            raise ValueError(f"filters: the bands of {below} and {above} overlap; make to_nm of one the from_nm of the other")
    ends = [(0.0, ordered[0].from_nm), *((a.to_nm, b.from_nm) for a, b in pairwise(ordered)), (ordered[-1].to_nm, float("inf"))]
    for end, begin in ends:
        missing = max(end, lowest_nm), min(begin, highest_nm)
        if missing[1] - missing[0] > TINY_NM:
            raise ValueError(
                f"filters: there is no filter for {missing[0]:g} to {missing[1]:g} nm; widen a band with from_nm or to_nm, "
                "give the empty position for it, or narrow lowest_nm and highest_nm"
            )


class MonochromatorTable(TomlTable):
    """The monochromator and its times; `filter_s` is the time of the filter wheel from one position to the next.

    With `filters` the wheel turns with the wavelength; without filters it does not turn.
    """

    kind: Literal["cornerstone"]
    port: str
    baudrate: PositiveInt = 9600
    lowest_nm: PositiveFloat = 380.0
    highest_nm: PositiveFloat = 780.0
    slew_nm_per_s: PositiveFloat = 175.0
    slew_settle_s: NonNegativeFloat = 0.1
    shutter_s: NonNegativeFloat = 0.15
    filter_s: NonNegativeFloat = 1.0
    grating_s: NonNegativeFloat = 8.0
    slit_um_per_s: PositiveFloat = 500.0
    tolerance_nm: PositiveFloat = 0.05
    filters: list[OrderFilterTable] = []

    @model_validator(mode="after")
    def _one_filter_at_every_wavelength(self) -> "MonochromatorTable":
        if self.filters:
            refuse_repeated_positions([each.position for each in self.filters])
            check_filter_bands(self.filters, self.lowest_nm, self.highest_nm)
        return self


class PhotodiodesTable(TomlTable):
    """The converters, their amplifiers, and the polar angles of the photodiodes on the two arcs.

    An ADAM-4117 has no outputs, so its amplifiers have one fixed gain. `exchange_s` is the duration of one request.
    """

    kind: Literal["adam-6017", "adam-4117"]
    units: Annotated[list[str], Field(min_length=1)]
    upper_deg: Annotated[list[PolarAngle], Field(min_length=1)]
    lower_deg: list[PolarAngle]
    gains_v_per_a: Annotated[list[PositiveFloat], Field(min_length=1, max_length=4)]
    gain_uncertainty: Fraction = 1.0e-3
    range_code: int = adam.PLUS_MINUS_10_V
    conversions_per_s: PositiveFloat = 100.0
    settling_s: Annotated[float, Field(gt=0.0, le=600.0)] = 0.25
    exchange_s: PositiveFloat = 4.0e-4

    @field_validator("range_code")
    @classmethod
    def _known_range(cls, code: int) -> int:
        if code not in adam.VOLTAGE_RANGES:
            known = ", ".join(f"0x{each:04X}" for each in adam.VOLTAGE_RANGES)
            raise ValueError(f"0x{code:04X} is not the code of a voltage range; give one of {known}")
        return code

    @field_validator("gains_v_per_a")
    @classmethod
    def _each_gain_once(cls, gains: list[float]) -> list[float]:
        if sorted(set(gains)) != gains:
            raise ValueError("the gains do not ascend; list each once, the lowest first, in the order of the outputs' numbers")
        return gains

    @model_validator(mode="after")
    def _enough_units(self) -> "PhotodiodesTable":
        diodes = len(self.upper_deg) + len(self.lower_deg)
        needed = -(-diodes // adam.CHANNELS)
        if len(self.units) != needed:
            wrong = f"{diodes} photodiodes need {needed} units of {adam.CHANNELS} channels, not {len(self.units)}"
            raise ValueError(f"{wrong}; correct units, upper_deg or lower_deg")
        return self

    @model_validator(mode="after")
    def _gain_can_be_set(self) -> "PhotodiodesTable":
        model = adam.MODELS[self.kind]
        if len(self.gains_v_per_a) > 1 << model.outputs:
            raise ValueError(f"an {model.title} has no outputs to select a gain; list the one fixed gain")
        return self


class MonitorTable(TomlTable):
    """The instrument of the monitor photodiode."""

    kind: Literal["pm100d"]
    usb: str
    dialect: Literal["pm100d", "b2980"] = "pm100d"
    wavelength_nm: PositiveFloat = 550.0
    range_a: PositiveFloat = 500e-9
    samples_per_s: PositiveFloat = 3000.0
    relative_uncertainty: Fraction = 3.0e-4


class GeometryTable(TomlTable):
    """The nominal dimensions that decide which directions the mirror unit blocks, and over which directions a value is a mean.

    `field_deg` is the full width of a photodiode's acceptance cone, 0.5 to 2.5 deg in the paper; `pupil_radius_mm`, the radius
    of the exit pupil, seen over the mirrors, is half of the beam's divergence (5 mm: 0.7 deg, assumed).
    """

    mirror_distance_mm: PositiveFloat = 200.0
    mirror_side_mm: PositiveFloat = 20.0
    mirror_mount_mm: NonNegativeFloat = 0.0
    spot_side_mm: PositiveFloat = 5.0
    arc_radius_mm: PositiveFloat = 300.0
    detector_diameter_mm: PositiveFloat = 5.0
    field_deg: PositiveFloat = 0.5
    pupil_radius_mm: PositiveFloat = 5.0
    shadow_margin_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.2

    @model_validator(mode="after")
    def _is_possible(self) -> "GeometryTable":
        self.instrument()
        return self

    def instrument(self) -> Instrument:
        """The instrument with these dimensions. Raises ValueError for impossible dimensions."""
        return Instrument(**self.model_dump(exclude={"shadow_margin_deg"}))


class SampleUnitTable(TomlTable):
    """The sample holder. `signature_uncertainty` is the relative standard uncertainty of the instrument signature with a sample
    mounted, because it is measured without: the sample blocks a part of it, and scatters light onto the frames. The default
    is for frames 0.5 mm off the sample (2 mm: 0.5); for frames that lie on the sample 0.01 is more than enough.
    """

    signature_uncertainty: Fraction = 0.3


def refuse_percentage(radiance_factor: float, zenith_deg: float = 0.0) -> None:
    """Raise ValueError for a radiance factor that is too high for a diffuser: it is probably in percent."""
    highest = HIGHEST_NEAR_GRAZING if zenith_deg > NEAR_GRAZING_DEG else HIGHEST_RADIANCE_FACTOR
    if radiance_factor > highest:
        raise ValueError(
            f"a radiance factor of {radiance_factor:g} is above {highest:g}, too high for a diffuser (1 is the ideal one); "
            f"if it is in percent, write {0.01 * radiance_factor:g}"
        )


class EtalonTable(TomlTable):
    """The etalon's certificate: radiance factor (1 is the ideal diffuser) and its relative standard uncertainty."""

    radiance_factor: PositiveFloat = 1.0
    relative_uncertainty: Fraction = 0.0

    @field_validator("radiance_factor")
    @classmethod
    def _no_percentage(cls, factor: float) -> float:
        refuse_percentage(factor)
        return factor


class RigFile(TomlTable):
    """All tables of a rig file."""

    name: str
    simulated: SimulatedTable | None = None
    axes: AxesTable
    monochromator: MonochromatorTable
    photodiodes: PhotodiodesTable
    monitor: MonitorTable
    geometry: GeometryTable = GeometryTable()
    sample_unit: SampleUnitTable = SampleUnitTable()
    etalon: EtalonTable = EtalonTable()
    twin: TwinTable | None = None

    @property
    def addresses(self) -> list[str]:
        """Addresses of all devices."""
        return [self.axes.port, self.monochromator.port, *self.photodiodes.units, self.monitor.usb]

    @model_validator(mode="after")
    def _virtual_rig_is_complete(self) -> "RigFile":
        virtual = [address for address in self.addresses if address.startswith(TWIN)]
        if virtual and self.simulated is None:
            raise ValueError(f"{virtual[0]} is a virtual device, so the file needs a [simulated] table; add it")
        if virtual and self.twin is None:
            raise ValueError(f"{virtual[0]} is a virtual device, so the file needs a [twin] table that describes it; add it")
        names = {address.split("/")[2] for address in virtual}
        if len(names) > 1:
            raise ValueError(f"its twin:// addresses have several virtual rigs: {', '.join(sorted(names))}; use one name")
        return self


def axis_settings(file: RigFile) -> dict[str, AxisSettings]:
    """The settings of each axis, by its name."""
    return {name: _axis_settings(name, getattr(file.axes, name)) for name in AXES}


def monochromator_settings(file: RigFile) -> MonochromatorSettings:
    """The settings of the monochromator."""
    table = file.monochromator
    return MonochromatorSettings(**table.model_dump(exclude={"kind", "port", "filters"}), wheel=filter_wheel(table.filters))


def photodiode_settings(file: RigFile) -> PhotodiodeSettings:
    """The settings of the photodiodes and their converters."""
    table = file.photodiodes
    values = table.model_dump(exclude={"units", "upper_deg", "lower_deg", "gains_v_per_a"})
    if adam.MODELS[table.kind].serial and "exchange_s" not in table.model_fields_set:
        values["exchange_s"] = adam.RTU_EXCHANGE_S
    return PhotodiodeSettings(
        upper_deg=tuple(table.upper_deg),
        lower_deg=tuple(table.lower_deg),
        gains_v_per_a=tuple(table.gains_v_per_a),
        **values,
    )


def monitor_settings(file: RigFile) -> MonitorSettings:
    """The settings of the monitor."""
    return MonitorSettings(**file.monitor.model_dump(exclude={"kind", "usb"}))


def nominal_instrument(file: RigFile) -> Instrument:
    """The instrument with the operator's nominal dimensions, for the directions blocked by the mirror unit."""
    return file.geometry.instrument()


def arc_clearance(file: RigFile) -> ArcClearance:
    """The clearance of the arc for this rig's photodiodes."""
    return ArcClearance(top_polar_deg=max(*file.photodiodes.upper_deg, *file.photodiodes.lower_deg, 0.0))


def _axis_settings(name: str, table: AxisTable) -> AxisSettings:
    homing = table.homing
    return AxisSettings(
        name=name,
        speed=table.speed_deg_s,
        acceleration=table.acceleration_deg_s2,
        microstep_exponent=table.microsteps.bit_length() - 1,
        stall_speed=table.stall_speed_deg_s,
        homing=None
        if homing is None
        else Homing(homing.mode, homing.speed_deg_s, homing.switch_speed_deg_s, homing.angle_deg, homing.longest_s),
        **table.model_dump(exclude={"speed_deg_s", "acceleration_deg_s2", "microsteps", "stall_speed_deg_s", "homing"}),
    )


def filter_wheel(filters: Sequence[OrderFilterTable]) -> FilterWheel:
    """The filter wheel for the driver, its filters by ascending wavelength."""
    ordered = sorted(filters, key=lambda each: each.from_nm)
    return FilterWheel(tuple(OrderFilter(each.position, each.name, each.from_nm, each.cut_on_nm) for each in ordered))
