"""The rig file: where the devices are, what the operator believes of them, and, for a virtual rig, what it is.

How high an etalon's radiance factor can be: what is higher was written in percent.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, PositiveInt, field_validator, model_validator

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

HIGHEST_RADIANCE_FACTOR, HIGHEST_NEAR_GRAZING = 1.5, 5.0
"""What is white in every direction has 1, in a broad lobe somewhat more, and only one near grazing much more."""
NEAR_GRAZING_DEG = 60.0


def refuse_percentage(radiance_factor: float, zenith_deg: float = 0.0) -> None:
    """Raises ValueError for a radiance factor that no diffuser has."""
    most = HIGHEST_NEAR_GRAZING if zenith_deg > NEAR_GRAZING_DEG else HIGHEST_RADIANCE_FACTOR
    if radiance_factor > most:
        raise ValueError(
            f"a radiance factor of {radiance_factor:g} is above {most:g}, and no diffuser's is (1 is the ideal one); "
            f"if it is in percent, write {0.01 * radiance_factor:g}"
        )


AXES = ("gamma", "sigma", "beta", "shift")
Sense = Literal[1, -1]
TINY_NM = 1e-6


class SimulatedTable(TomlTable):
    """That nothing here is real: the seed of the virtual rig.

    Where another process serves it, so that the file has no [twin]: its model's hash (`old_model`: in its first version, which
    older journals have), how fast its time passes, and the port of its back door, through which samples are mounted.
    """

    seed: int = 1
    model: str | None = None
    old_model: str | None = None
    speed: PositiveFloat = 1.0
    control_port: Annotated[int, Field(ge=1, le=65535)] | None = None


class HomingTable(TomlTable):
    """A reference search: its mode as Trinamic counts them (1 to 8, and 64 or 128 more), and the angle of the reference.

    Without `angle_deg` the reference is where the axis' microsteps are 0.
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
            raise ValueError(f"{mode} is no reference search: 1 to 8 are, 1 to 4 with 64 added and 5 to 8 with 128 added")
        return mode


class AxisTable(TomlTable):
    """An axis as the operator believes it to be; gears are motor turns a turn of the axis.

    Against backlash every move arrives from one side, which its zero is for. `switches` has the limit switches stop the
    motor, `max_deviation_deg` the encoder, `stall_speed_deg_s` a stall above that speed; 0 is off. `encoder_tolerance_deg` is
    how far counter and encoder may be apart at rest (0 is off; 0.05 deg and the backlash where it is not given).

    `power_up_at_reference`: whenever the controller is switched on or resets, the axis stands where its microsteps are 0,
    as a parking position or a brake sees to. Without it the axis then goes nowhere until it is homed or told its place.
    """

    motor: Annotated[int, Field(ge=0, le=5)]
    gear: PositiveFloat
    lower_deg: float
    upper_deg: float
    speed_deg_s: PositiveFloat
    acceleration_deg_s2: PositiveFloat
    sense: Sense = 1
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
    max_deviation_deg: Annotated[float, Field(ge=0.0)] = 0.0
    stall_speed_deg_s: Annotated[float, Field(ge=0.0)] = 0.0
    switches: bool = False
    swap_switches: bool = False
    right_polarity: Literal[0, 1] = 0
    left_polarity: Literal[0, 1] = 0
    soft_stop: bool = False
    backlash_deg: Annotated[float, Field(ge=0.0)] = 0.0
    approach_from: Literal["below", "above"] = "below"
    homing: HomingTable | None = None
    homing_required: bool = False
    power_up_at_reference: bool = False
    encoder_tolerance_deg: Annotated[float, Field(ge=0.0)] | None = None

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
            place = (axis.module, axis.motor)
            if place in wired:
                raise ValueError(f"{wired[place]} and {name} are both motor {axis.motor} of module {axis.module}")
            wired[place] = name
        return self


class OrderFilterTable(TomlTable):
    """A position of the wheel and the band for which it is put in, the lower end included, the upper where no other begins.

    `cut_on_nm` is from where on it lets light through; without it, as in a position that is empty, it is not taken to hold
    anything back.
    """

    position: FilterPosition
    name: Annotated[str, Field(min_length=1)]
    from_nm: PositiveFloat
    to_nm: PositiveFloat
    cut_on_nm: PositiveFloat | None = None

    @model_validator(mode="after")
    def _lets_its_band_through(self) -> "OrderFilterTable":
        if not self.from_nm < self.to_nm:
            raise ValueError(f"from_nm {self.from_nm:g} is not below to_nm {self.to_nm:g}; exchange them")
        if self.cut_on_nm is not None and self.cut_on_nm > self.from_nm:
            raise ValueError(
                f"cut_on_nm {self.cut_on_nm:g} is above from_nm {self.from_nm:g}, so it would hold back the very light that it "
                "is put in for; let its band begin higher, or take another filter"
            )
        return self

    def __str__(self) -> str:
        return f"{self.name!r} ({self.from_nm:g} to {self.to_nm:g} nm)"


def check_filter_bands(filters: Sequence[OrderFilterTable], lowest_nm: float, highest_nm: float) -> None:
    """Raises ValueError where bands overlap, or leave a gap between `lowest_nm` and `highest_nm`, naming the keys."""
    ordered = sorted(filters, key=lambda each: each.from_nm)
    for below, above in pairwise(ordered):
        if above.from_nm < below.to_nm - TINY_NM:
            raise ValueError(f"filters: the bands of {below} and {above} overlap; let one's to_nm be the other's from_nm")
    ends = [(0.0, ordered[0].from_nm), *((a.to_nm, b.from_nm) for a, b in pairwise(ordered)), (ordered[-1].to_nm, float("inf"))]
    for end, begin in ends:
        missing = max(end, lowest_nm), min(begin, highest_nm)
        if missing[1] - missing[0] > TINY_NM:
            raise ValueError(
                f"filters: from {missing[0]:g} to {missing[1]:g} nm there is none; widen a band with from_nm or to_nm, name "
                "the empty position that belongs there, or narrow lowest_nm and highest_nm"
            )


class MonochromatorTable(TomlTable):
    """The monochromator and its timing; `filter_s` is that of the filter wheel from a position to the next.

    With `filters` the wheel is turned with the wavelength; without any nothing turns it.
    """

    kind: Literal["cornerstone"]
    port: str
    baudrate: PositiveInt = 9600
    lowest_nm: PositiveFloat = 380.0
    highest_nm: PositiveFloat = 780.0
    slew_nm_per_s: PositiveFloat = 175.0
    slew_settle_s: Annotated[float, Field(ge=0.0)] = 0.1
    shutter_s: Annotated[float, Field(ge=0.0)] = 0.15
    filter_s: Annotated[float, Field(ge=0.0)] = 1.0
    grating_s: Annotated[float, Field(ge=0.0)] = 8.0
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
    """The converters, the amplifiers before them, and where the photodiodes sit on the two arcs.

    An ADAM-4117 has no outputs, so its amplifiers have one fixed gain. `exchange_s` is how long one question takes.
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
            raise ValueError(f"0x{code:04X} is no code of a voltage range; there are {known}")
        return code

    @field_validator("gains_v_per_a")
    @classmethod
    def _each_gain_once(cls, gains: list[float]) -> list[float]:
        if sorted(set(gains)) != gains:
            raise ValueError("the gains do not ascend; list each once, the lowest first, as the outputs number them")
        return gains

    @model_validator(mode="after")
    def _enough_units(self) -> "PhotodiodesTable":
        diodes = len(self.upper_deg) + len(self.lower_deg)
        needed = -(-diodes // adam.CHANNELS)
        if len(self.units) != needed:
            raise ValueError(f"{diodes} photodiodes take {needed} units of {adam.CHANNELS}, not {len(self.units)}")
        return self

    @model_validator(mode="after")
    def _gain_can_be_set(self) -> "PhotodiodesTable":
        model = adam.MODELS[self.kind]
        if len(self.gains_v_per_a) > 1 << model.outputs:
            raise ValueError(f"an {model.title} has no outputs that could choose between gains; list the one that is fixed")
        return self


class MonitorTable(TomlTable):
    """The monitor photodiode's instrument."""

    kind: Literal["pm100d"]
    usb: str
    dialect: Literal["pm100d", "b2980"] = "pm100d"
    wavelength_nm: PositiveFloat = 550.0
    range_a: PositiveFloat = 500e-9
    samples_per_s: PositiveFloat = 3000.0
    relative_uncertainty: Fraction = 3.0e-4


class GeometryTable(TomlTable):
    """The geometry that decides which directions the mirror unit hides, and which a value is a mean of.

    `field_deg` is the full width of a photodiode's acceptance cone, 0.5 to 2.5 deg in the paper; `pupil_radius_mm` of the exit
    pupil, seen over the mirrors, is half of the beam's divergence (5 mm: 0.7 deg, assumed).
    """

    mirror_distance_mm: PositiveFloat = 200.0
    mirror_side_mm: PositiveFloat = 20.0
    mirror_mount_mm: Annotated[float, Field(ge=0.0)] = 0.0
    spot_side_mm: PositiveFloat = 5.0
    arc_radius_mm: PositiveFloat = 300.0
    detector_diameter_mm: PositiveFloat = 5.0
    field_deg: PositiveFloat = 0.5
    pupil_radius_mm: PositiveFloat = 5.0
    shadow_margin_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.2

    @model_validator(mode="after")
    def _can_be_built(self) -> "GeometryTable":
        self.instrument()
        return self

    def instrument(self) -> Instrument:
        """The instrument that the operator believes in. Raises ValueError for dimensions that make none."""
        return Instrument(**self.model_dump(exclude={"shadow_margin_deg"}))


class SampleUnitTable(TomlTable):
    """What holds the sample. `signature_uncertainty` is the share (standard uncertainty) by which the instrument's own light is
    otherwise with a sample in its place than without: the sample hides some of it, and sends its own light to the frames. The
    default is that of frames 0.5 mm off the sample (2 mm: 0.5); of frames that lie on it 0.01 is more than enough.
    """

    signature_uncertainty: Fraction = 0.3


class EtalonTable(TomlTable):
    """The etalon's certificate: its radiance factor (1 is the ideal diffuser), with its relative standard uncertainty."""

    radiance_factor: PositiveFloat = 1.0
    relative_uncertainty: Fraction = 0.0

    @field_validator("radiance_factor")
    @classmethod
    def _no_percentage(cls, factor: float) -> float:
        refuse_percentage(factor)
        return factor


class RigFile(TomlTable):
    """The whole file."""

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
        """Where the devices are."""
        return [self.axes.port, self.monochromator.port, *self.photodiodes.units, self.monitor.usb]

    @model_validator(mode="after")
    def _says_what_it_is(self) -> "RigFile":
        virtual = [address for address in self.addresses if address.startswith("twin://")]
        if virtual and self.simulated is None:
            raise ValueError(f"{virtual[0]} is a virtual device, so the file needs a [simulated] table")
        if virtual and self.twin is None:
            raise ValueError(f"{virtual[0]} is a virtual device, so the file needs a [twin] table that says what it is")
        names = {address.split("/")[2] for address in virtual}
        if len(names) > 1:
            raise ValueError(f"its twin:// addresses name several virtual rigs: {', '.join(sorted(names))}; name one")
        return self


def axis_settings(file: RigFile) -> dict[str, AxisSettings]:
    """By axis."""
    return {name: _axis(name, getattr(file.axes, name)) for name in AXES}


def monochromator_settings(file: RigFile) -> MonochromatorSettings:
    """Of the monochromator."""
    table = file.monochromator
    return MonochromatorSettings(**table.model_dump(exclude={"kind", "port", "filters"}), wheel=filter_wheel(table.filters))


def photodiode_settings(file: RigFile) -> PhotodiodeSettings:
    """Of the photodiodes and their modules."""
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
    """Of the monitor."""
    return MonitorSettings(**file.monitor.model_dump(exclude={"kind", "usb"}))


def nominal_instrument(file: RigFile) -> Instrument:
    """The instrument as the operator believes it to be: for the directions that the mirror unit hides."""
    return file.geometry.instrument()


def arc_clearance(file: RigFile) -> ArcClearance:
    """What the arc must keep clear of."""
    return ArcClearance(top_polar_deg=max(*file.photodiodes.upper_deg, *file.photodiodes.lower_deg, 0.0))


def _axis(name: str, table: AxisTable) -> AxisSettings:
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
    """For the driver."""
    ordered = sorted(filters, key=lambda each: each.from_nm)
    return FilterWheel(tuple(OrderFilter(each.position, each.name, each.from_nm, each.cut_on_nm) for each in ordered))
