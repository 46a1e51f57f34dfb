"""Model of the virtual rig: its own mechanics, light and electronics.

The values are independent of the operator's configuration. The defaults are one consistent set of assumptions. Where the paper
gives no value, it is a setting. A field that is no argument is the same in every rig; the hash of a model counts it too.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, Protocol

from annotated_types import Ge, Gt, Le, Lt, MaxLen, MinLen, MultipleOf

from goniotwin.keys import (
    LATER,
    Address,
    Count,
    Fraction,
    MotorNumber,
    NonNegative,
    PolarAngle,
    Positive,
    Share,
    TcpUnit,
    WheelPosition,
)
from goniotwin.protocols import adam
from goniotwin.twin.optics import Instrument, SampleFrames, Scatterer
from goniotwin.twin.optics.geometry.coordinates import TURN_DEG
from goniotwin.twin.plant.disturbances import Disturbances

SHORTEST_NM = 355.0
"""The lamp's bulb is opaque up to this wavelength, so that there is no second order up to 710 nm."""
LINE = ((0.0, 1.0),)
ROOT_6 = math.sqrt(6.0)
TRIANGLE = tuple(
    (sign * (4.0 - each * ROOT_6) / 10.0, (9.0 + each * ROOT_6) / 36.0) for sign in (-1.0, 1.0) for each in (1.0, -1.0)
)
"""Gauss' rule on each side of a triangle of half base 1: exact for cubics, with a kink in the middle too."""


@dataclass(frozen=True)
class Mechanics:
    """The real properties of one axis. One full step turns it by `sense * 360 deg / (full_steps * gear)`.

    `motor`: number of the motor on its module. `gear`: motor turns per turn of the axis. `sense`: +1 if positive steps turn the
    axis to greater angles, else -1. `zero_deg`: angle at step 0. `full_steps`: full steps in a turn of the motor. `encoder`:
    whether an encoder is mounted on the axis. `module`: address of the motion module with the motor. `backlash_deg`: the play:
    driven downwards, the axis is higher by this angle than driven upwards. `lower_switch_deg`: angle at and below which the
    lower limit switch is closed; without it there is none. `upper_switch_deg`: angle at and above which the upper limit switch
    is closed; without it there is none. `home_deg`: angle from which the home switch is closed upwards, in each turn; without
    it there is none. `home_width_deg`: range over which the home switch is closed. `encoder_counts`: encoder counts in a turn
    of the motor. `encoder_error_deg`: eccentricity of the encoder: the amplitude of its error over a turn.
    """

    motor: MotorNumber
    gear: Positive
    sense: Literal[1, -1] = 1
    zero_deg: float = 0.0
    full_steps: Count = 200
    encoder: bool = True
    module: Address = 1
    backlash_deg: NonNegative = 0.0
    lower_switch_deg: float | None = None
    upper_switch_deg: float | None = None
    home_deg: float | None = None
    home_width_deg: Annotated[float, Gt(0.0), Lt(TURN_DEG)] = 1.0
    encoder_counts: Count = 51_200
    encoder_error_deg: NonNegative = 0.0

    @property
    def deg_per_full_step(self) -> float:
        """Signed angle of one full step."""
        return self.sense * TURN_DEG / (self.full_steps * self.gear)


@dataclass(frozen=True)
class LightSource:
    """Light from the arc of the lamp to the sample.

    `radiance`: radiance of the arc in W m^-2 sr^-1 nm^-1. `band_nm`: width of the monochromator's band, at half its height.
    `band`: "triangle" has all wavelengths of a triangular band; "line" has only the one that is set. `throughput`: fraction of
    the light that reaches the sample. `drift_per_hour`: drift of the lamp, relative. `flicker`: relative standard deviation of
    the lamp's fast noise. `wander`: relative standard deviation of the lamp's slow noise. All detectors and the monitor see the
    same noise.

    `polarisation`: degree of linear polarisation of the monochromator's light. `azimuth_deg`: angle of the plane of
    polarisation from the vertical, towards the side of growing sigma. `mirror_s`: reflectance of a mirror across its plane of
    incidence. Only its ratio to `mirror_p` counts, beside `mirror_reflectance`. `mirror_p`: reflectance of a mirror in its
    plane of incidence.
    """

    radiance: Positive = 2.0e3
    band_nm: Annotated[float, Gt(0.0), Le(100.0)] = 5.0
    band: Literal["line", "triangle"] = field(default="line", metadata=LATER)
    throughput: Share = 0.18
    spectrum: tuple[tuple[float, float], ...] = field(
        default=((380.0, 0.75), (450.0, 0.95), (550.0, 1.0), (650.0, 0.95), (780.0, 0.9)), init=False
    )
    """Pairs of a wavelength in nm and the relative radiance there."""
    drift_per_hour: float = 0.0
    flicker: Fraction = 5.0e-4
    flicker_period_s: float = field(default=0.01, init=False)
    wander: Fraction = 2.0e-3
    wander_period_s: float = field(default=30.0, init=False)

    polarisation: Annotated[float, Ge(0.0), Le(1.0)] = field(default=0.0, metadata=LATER)
    azimuth_deg: Annotated[float, Ge(-180.0), Lt(180.0)] = field(default=0.0, metadata=LATER)
    mirror_s: Share = field(default=1.0, metadata=LATER)
    mirror_p: Share = field(default=1.0, metadata=LATER)

    def polarised(self, sigma_deg: float) -> float:
        """Share of the light in the sample's s less that in its p, over all light, with the mirror unit at sigma.

        The three mirrors turn with sigma, and all reflect in the plane of the sigma axis and the light at the sample. That is
        across the sample's plane of incidence, so what is p for the mirrors is s for the sample.
        """
        in_plane = self.polarisation * math.cos(2.0 * math.radians(self.azimuth_deg - sigma_deg))
        s, p = self.mirror_p**3 * (1.0 + in_plane), self.mirror_s**3 * (1.0 - in_plane)
        return (s - p) / (s + p)

    @property
    def nodes(self) -> tuple[tuple[float, float], ...]:
        """Pairs of an offset from the set wavelength in nm and a share of the light, 1 in all, which represent the band."""
        return tuple((self.band_nm * place, share) for place, share in TRIANGLE) if self.band == "triangle" else LINE


@dataclass(frozen=True)
class Photodiodes:
    """Photodiodes on the arc, those of the upper arc first: angles, responsivity and dark currents.

    `upper_deg`: polar angles on the upper arc, at shift 0. `lower_deg`: polar angles on the lower arc, at shift 0. `dark_a`:
    mean dark current. `dark_spread`: relative standard deviation of the dark currents over the photodiodes. `dark_wander`:
    relative standard deviation of the slow noise of each dark current.
    """

    upper_deg: Annotated[tuple[PolarAngle, ...], MinLen(1)] = tuple(5.0 * k for k in range(18))
    lower_deg: tuple[PolarAngle, ...] = tuple(5.0 * k for k in range(18))
    responsivity: tuple[tuple[float, float], ...] = field(
        default=((380.0, 0.10), (450.0, 0.22), (550.0, 0.30), (650.0, 0.38), (780.0, 0.48)), init=False
    )
    dark_a: NonNegative = 2.0e-12
    dark_spread: Fraction = 0.05
    dark_wander: Fraction = 2.0e-3
    dark_wander_period_s: float = field(default=600.0, init=False)

    @property
    def count(self) -> int:
        """Number of photodiodes."""
        return len(self.upper_deg) + len(self.lower_deg)


@dataclass(frozen=True)
class Electronics:
    """Transimpedance amplifiers and the converters behind them. A module has eight channels and one gain.

    `gains_v_per_a`: nominal gains. `gain_spread`: relative standard deviation of the real gains from the nominal ones.
    `offset_v`: offset of amplifier and converter. `noise_v`: noise of amplifier and converter in one conversion, as a standard
    deviation. `settling_s`: time constant with which the amplifiers settle. `conversions_per_s`: conversions that a module
    makes in a second, for all of its channels together. `module`: model of the converters. An ADAM-4117 has no outputs, so its
    gain is always the first. `baudrate`: speed of the serial line of an ADAM-4117.

    Modules of one model differ in three properties. `tcp_units`: units to which a module on Ethernet responds; the driver takes
    the first. `raw_format`: number format of the values of a module with a serial line. `multiple_writes`: whether the module
    has function 16; otherwise it refuses it.
    """

    gains_v_per_a: Annotated[tuple[Positive, ...], MinLen(1), MaxLen(4)] = (1e6, 1e8, 1e10, 1e11)
    gain_spread: Fraction = 1.0e-3
    offset_v: float = 1.0e-3
    noise_v: NonNegative = 1.5e-4
    settling_s: Positive = 0.02
    temperature_k: float = field(default=300.0, init=False)
    conversions_per_s: Literal[10, 100] = 100
    latency_s: float = field(default=4.0e-4, init=False)
    module: adam.ModelName = "adam-6017"
    baudrate: Count = 9600
    tcp_units: Annotated[tuple[TcpUnit, ...], MinLen(1)] = field(default=adam.TCP_UNITS, metadata=LATER)
    raw_format: adam.RawFormat = field(default="unsigned", metadata=LATER)
    multiple_writes: bool = field(default=True, metadata=LATER)

    def __post_init__(self) -> None:
        if self.raw_format != "unsigned" and not adam.MODELS[self.module].serial:
            raise ValueError(
                f"raw_format: the registers of an {adam.MODELS[self.module].title} are unsigned; remove raw_format"
            )


@dataclass(frozen=True)
class MonitorPhotodiode:
    """The monitor: a photodiode behind the beam splitter.

    `current_a`: current at a lamp level of 1 and 550 nm. `dark_a`: dark current. `noise`: relative standard deviation of one
    reading. `drift_per_hour`: relative change of the responsivity in an hour. `linearity_per_decade`: relative change of the
    responsivity for each decade of current above `current_a`. `saturation_a`: current at which the responsivity has fallen to
    one half; 0: it does not fall.
    """

    current_a: Positive = 1.4e-7
    dark_a: NonNegative = 1.0e-11
    noise: Fraction = 1.0e-4
    samples_per_s: float = field(default=3000.0, init=False)
    serial_number: str = field(default="TWIN0001", init=False)
    latency_s: float = field(default=5.0e-4, init=False)
    drift_per_hour: float = field(default=0.0, metadata=LATER)
    linearity_per_decade: Annotated[float, Gt(-1.0), Lt(1.0)] = field(default=0.0, metadata=LATER)
    saturation_a: NonNegative = field(default=0.0, metadata=LATER)

    def measured_a(self, current_a: float, t: float, drift_per_hour: float = 0.0, linearity_per_decade: float = 0.0) -> float:
        """The current that it gives at the time `t` for the light of `current_a`, with what is drawn beside its own errors."""
        if current_a <= 0.0:
            return current_a
        result = current_a
        if (drift := self.drift_per_hour + drift_per_hour) != 0.0:
            result *= 1.0 + drift * t / 3600.0
        if (linearity := self.linearity_per_decade + linearity_per_decade) != 0.0:
            result *= 1.0 + linearity * math.log10(current_a / self.current_a)
        if self.saturation_a > 0.0:
            result /= 1.0 + result / self.saturation_a
        return result


@dataclass(frozen=True)
class MonochromatorDrive:
    """The monochromator's drive: the speeds of its parts, and the properties of its serial line. The defaults are those of the
    manual.

    `slew_nm_per_s`: speed of the grating. `settle_s`: time until the grating rests after its motion. `shutter_s`: duration of
    opening or closing the shutter. `filter_s`: time in which the filter wheel turns by one position. `echo`: whether the unit
    repeats each statement on the line. `handshake`: whether the unit has the statement HANDSHAKE. `grating_s`: duration of a
    change of the grating. `filters`: positions of the filter wheel; 0: there is no wheel.

    Units differ in their replies. `status_digits`: least number of digits of the status byte. `status_decimal`: whether the
    status byte is a decimal number, and not hexadecimal. `zero_is_no_error`: whether the reply to `ERROR?` without an error is
    0, and not an empty line. `gpib_address`: the reply to `ADDRESS?`.
    """

    slew_nm_per_s: Positive = 175.0
    settle_s: NonNegative = 0.1
    shutter_s: NonNegative = 0.15
    filter_s: NonNegative = 1.0
    start_nm: float = field(default=550.0, init=False)
    echo: bool = True
    baudrate: int = field(default=9600, init=False)
    handshake: bool = True
    grating_s: NonNegative = 8.0
    slit_um_per_s: float = field(default=500.0, init=False)
    nm_per_step: float = field(default=0.01, init=False)
    """Of a grating of 1200 lines per mm."""
    gratings: tuple[tuple[int, str], ...] = ((1200, "VIS"), (600, "NIR"))
    """Lines per mm and label of each."""
    filters: Annotated[int, Ge(0), Le(6)] = 6
    already_there_is_error: bool = False
    """Whether a filter wheel that is sent to its present position reports error 7 (to be confirmed on hardware)."""
    status_digits: Literal[1, 2] = field(default=2, metadata=LATER)
    status_decimal: bool = field(default=False, metadata=LATER)
    zero_is_no_error: bool = field(default=False, metadata=LATER)
    gpib_address: Annotated[int, Ge(0), Le(30)] = field(default=4, metadata=LATER)


@dataclass(frozen=True)
class WheelFilter:
    """A long-pass filter in the wheel.

    `position`: its position in the wheel. `cut_on_nm`: wavelength from which on it transmits; below it blocks. `transmittance`:
    its transmittance from this wavelength on.
    """

    position: WheelPosition
    cut_on_nm: Positive
    transmittance: Share = 0.9

    def passes(self, wavelength_nm: float) -> float:
        """Share of the light of a wavelength that passes."""
        return self.transmittance if wavelength_nm >= self.cut_on_nm else 0.0


@dataclass(frozen=True)
class SecondOrder:
    """Light of half the wavelength that the grating passes as well, in its second order.

    `second_order`: fraction of the light of half the wavelength that passes, relative to what would pass with the grating set
    to it. The lamp has no such light up to 710 nm.
    """

    second_order: Fraction = 0.0


@dataclass(frozen=True)
class OrderSorting(SecondOrder):
    """Sorting of the grating's orders: which light leaves the monochromator.

    That is light of the wavelength set and, in the second order, of half that wavelength. A position of the wheel without a
    filter is open.
    """

    filters: tuple[WheelFilter, ...] = ()

    def transmittance(self, wavelength_nm: float, position: int) -> float:
        """Share of the light of a wavelength that passes the wheel."""
        return math.prod(each.passes(wavelength_nm) for each in self.filters if each.position == position)

    def passing(self, wavelength_nm: float, position: int) -> list[tuple[float, float]]:
        """Wavelengths in nm and, for each, the share of its light that passes, at a set wavelength and wheel position."""
        orders = [(wavelength_nm, 1.0)]
        half = 0.5 * wavelength_nm
        if self.second_order > 0.0 and half > SHORTEST_NM:
            orders.append((half, self.second_order))
        return [(nm, share * self.transmittance(nm, position)) for nm, share in orders]


ModuleKind = Literal["tmcm-6214", "tmcm-1240"]


@dataclass(frozen=True)
class AxisController:
    """A line of motion modules, one for each address among the axes' `module`.

    `kind`: model of every module on it. `wire`: over "usb" a module responds to any address, on "rs485" only to its own.
    `baudrate`: speed of the line; without effect over USB. `latency_s`: time in which a module responds.
    `encoder_noise_microsteps`: noise of the encoder's positions, in microsteps.
    """

    kind: ModuleKind = "tmcm-6214"
    wire: Literal["usb", "rs485"] = "usb"
    baudrate: Count = 115200
    latency_s: NonNegative = 3.0e-4
    encoder_noise_microsteps: NonNegative = 1.0


class DeviceModel(Protocol):
    """A device at an address of its own, or in place of another one: a frozen dataclass of numbers and texts."""

    @property
    def kind(self) -> str: ...

    def build(self, plant: Any) -> Any:
        """The device on a plant: a serial device, a converter module or a USB device."""


class ControllerModel(DeviceModel, Protocol):
    """A motion controller; `axes` are those that it turns."""

    @property
    def axes(self) -> tuple[str, ...]: ...


EstimatorKind = Literal["fast", "forward"]
RelativeError = Annotated[float, Gt(1e-5), Lt(0.5)]


@dataclass(frozen=True)
class Estimator:
    """Estimator of the light on the photodiodes.

    The fast one places a few rays per photodiode. The forward one traces all light, to a given precision.

    `rays`: number of rays per photodiode of the fast estimator; without it seven, which it places itself. `stray`: whether the
    light of the frames and the light that was scattered more than once is included. The forward estimator traces it; for the
    fast one a map from the forward one is added.
    """

    kind: EstimatorKind = "fast"
    rays: Annotated[int, Ge(16), Le(1 << 20), MultipleOf(4)] | None = None
    relative_error: RelativeError = 0.03
    """The forward one stops at this median relative standard error of the photodiodes with light; see `OpticsTable`."""
    stray: bool = False


@dataclass(frozen=True, kw_only=True)
class Parts:
    """Parts of a virtual rig.

    `diattenuation`: for each sample, the difference of its values for light in s and in p, over their sum; 0 for a sample that
    is not named. `noise`: whether there is noise. Without it there are no random processes; quantisation remains.
    """

    frames: SampleFrames = field(default_factory=SampleFrames)
    light: LightSource = field(default_factory=LightSource)
    photodiodes: Photodiodes = field(default_factory=Photodiodes)
    electronics: Electronics = field(default_factory=Electronics)
    controller: AxisController = field(default_factory=AxisController)
    monitor: MonitorPhotodiode = field(default_factory=MonitorPhotodiode)
    disturbances: Disturbances = field(default=Disturbances(), metadata=LATER)
    diattenuation: dict[str, Annotated[float, Ge(-1.0), Le(1.0)]] = field(default_factory=dict)
    noise: bool = True


@dataclass(frozen=True)
class TwinModel(Parts):
    """Complete virtual rig. `samples` can be mounted by simulation control.

    `controller` turns the axes that none of the further `devices` (by address) turns.
    """

    seed: int
    axes: dict[str, Mechanics]
    samples: dict[str, Scatterer]
    instrument: Instrument = field(default_factory=Instrument)
    monochromator: MonochromatorDrive = field(default_factory=MonochromatorDrive)
    estimator: Estimator = field(default_factory=Estimator)
    order_sorting: OrderSorting = field(default_factory=OrderSorting)
    devices: Mapping[str, DeviceModel] = field(default_factory=dict)

    @property
    def controller_axes(self) -> tuple[str, ...]:
        """The axes of `controller`."""
        others = {axis for device in self.devices.values() for axis in getattr(device, "axes", ())}
        return tuple(axis for axis in self.axes if axis not in others)
