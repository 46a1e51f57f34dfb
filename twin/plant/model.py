"""What the virtual rig is: its own mechanics, light and electronics, never derived from what the operator believes.

The defaults are one consistent set of assumptions; where the source says nothing, each is a setting.

Which light leaves the monochromator: that of the wavelength set, and in the grating's second order that of half of it.
"""

from dataclasses import dataclass, field
from typing import Literal

from goniotwin.twin.optics import Instrument, SampleFrames, Scatterer

SHORTEST_NM = 355.0
"""The lamp's bulb lets nothing through up to here, so that up to 710 nm there is no second order."""


@dataclass(frozen=True)
class WheelFilter:
    """A long-pass filter in a position of the wheel: `transmittance` from `cut_on_nm` on, and nothing below."""

    position: int
    cut_on_nm: float
    transmittance: float = 0.9

    def passes(self, wavelength_nm: float) -> float:
        """The share of light of a wavelength that it lets through."""
        return self.transmittance if wavelength_nm >= self.cut_on_nm else 0.0


@dataclass(frozen=True)
class OrderSorting:
    """What sorts the orders. A position of the wheel without a filter is open.

    `second_order` is the share of light of half the wavelength that passes, of what would pass were the grating set to it.
    """

    second_order: float = 0.0
    filters: tuple[WheelFilter, ...] = ()

    def passing(self, wavelength_nm: float, position: int) -> list[tuple[float, float]]:
        """Wavelengths in nm, each with the share of its light that passes, for a wavelength set and a position of the wheel."""
        orders = [(wavelength_nm, 1.0)]
        half = 0.5 * wavelength_nm
        if self.second_order > 0.0 and half > SHORTEST_NM:
            orders.append((half, self.second_order))
        for each in self.filters:
            if each.position == position:
                orders = [(nm, share * each.passes(nm)) for nm, share in orders]
        return orders


@dataclass(frozen=True)
class Mechanics:
    """An axis: motor `motor` turns it by `sense` * 360 deg / (`full_steps` * `gear`) a full step from `zero_deg` on.

    `module` is the address of the motion module whose motor it is. The axis follows with `backlash_deg` of play: driven
    downwards it is so much higher than driven upwards. A limit switch is closed at and beyond its angle, the home switch
    over `home_width_deg` upwards from `home_deg` in each turn; None: there is no such switch. The encoder sits on the
    axis, has `encoder_counts` a turn of the motor, and an eccentricity of `encoder_error_deg`.
    """

    motor: int
    gear: float
    sense: int = 1
    zero_deg: float = 0.0
    full_steps: int = 200
    encoder: bool = True
    module: int = 1
    backlash_deg: float = 0.0
    lower_switch_deg: float | None = None
    upper_switch_deg: float | None = None
    home_deg: float | None = None
    home_width_deg: float = 1.0
    encoder_counts: int = 51_200
    encoder_error_deg: float = 0.0

    @property
    def deg_per_full_step(self) -> float:
        """Signed angle of one full step."""
        return self.sense * 360.0 / (self.full_steps * self.gear)


@dataclass(frozen=True)
class LightSource:
    """From the arc to the sample: `radiance` (W m^-2 sr^-1 nm^-1) in `band_nm`, of which `throughput` reaches the sample.

    `spectrum` has (wavelength in nm, relative radiance); drift and flicker are of the lamp, so that every detector and the
    monitor see the same.
    """

    radiance: float = 2.0e3
    band_nm: float = 5.0
    throughput: float = 0.18
    spectrum: tuple[tuple[float, float], ...] = (
        (380.0, 0.75),
        (450.0, 0.95),
        (550.0, 1.0),
        (650.0, 0.95),
        (780.0, 0.9),
    )
    drift_per_hour: float = 0.0
    flicker: float = 5.0e-4
    flicker_period_s: float = 0.01
    wander: float = 2.0e-3
    wander_period_s: float = 30.0


@dataclass(frozen=True)
class Photodiodes:
    """The arc: polar angles of the photodiodes at shift 0, upper arc first, then the lower one; and their currents."""

    upper_deg: tuple[float, ...] = tuple(5.0 * k for k in range(18))
    lower_deg: tuple[float, ...] = tuple(5.0 * k for k in range(18))
    responsivity: tuple[tuple[float, float], ...] = (
        (380.0, 0.10),
        (450.0, 0.22),
        (550.0, 0.30),
        (650.0, 0.38),
        (780.0, 0.48),
    )
    dark_a: float = 2.0e-12
    dark_spread: float = 0.05
    dark_wander: float = 2.0e-3
    dark_wander_period_s: float = 600.0

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.upper_deg) + len(self.lower_deg)


@dataclass(frozen=True)
class Electronics:
    """Transimpedance amplifiers and the converters behind them; a module has eight channels and one gain.

    `module` is the kind of converter; one with a serial line (`adam-4117`, at `baudrate`) has no outputs, so the gain stays
    the first. `conversions_per_s` of all channels of a module: 10 or 100.
    """

    gains_v_per_a: tuple[float, ...] = (1e6, 1e8, 1e10, 1e11)
    gain_spread: float = 1.0e-3
    offset_v: float = 1.0e-3
    noise_v: float = 1.5e-4
    settling_s: float = 0.02
    temperature_k: float = 300.0
    conversions_per_s: float = 100.0
    latency_s: float = 4.0e-4
    module: str = "adam-6017"
    baudrate: int = 9600


@dataclass(frozen=True)
class MonitorPhotodiode:
    """The photodiode behind the beam splitter: its current for a lamp of 1 at 550 nm, and its relative noise a reading."""

    current_a: float = 1.4e-7
    dark_a: float = 1.0e-11
    noise: float = 1.0e-4
    samples_per_s: float = 3000.0
    serial_number: str = "TWIN0001"
    latency_s: float = 5.0e-4


@dataclass(frozen=True)
class MonochromatorDrive:
    """How fast grating, shutter, filter wheel (a position) and slits are, whether the wire echoes and knows handshake mode.

    `nm_per_step` is that of a grating of 1200 lines a mm; `gratings` are (lines a mm, label); 0 `filters` is no wheel.
    `already_there_is_error`: whether a filter wheel sent to where it is reports error 7 (to be confirmed on hardware).
    """

    slew_nm_per_s: float = 175.0
    settle_s: float = 0.1
    shutter_s: float = 0.15
    filter_s: float = 1.0
    start_nm: float = 550.0
    echo: bool = True
    baudrate: int = 9600
    handshake: bool = True
    grating_s: float = 8.0
    slit_um_per_s: float = 500.0
    nm_per_step: float = 0.01
    gratings: tuple[tuple[int, str], ...] = ((1200, "VIS"), (600, "NIR"))
    filters: int = 6
    already_there_is_error: bool = False


@dataclass(frozen=True)
class AxisController:
    """The motion modules' wire: how many bits a second (no matter over USB), and how long a module thinks.

    `kind` is that of every module; there is one for each address among the axes' `module`. On `rs485` a module is silent
    where another's address is called, over `usb` it answers any.
    """

    kind: Literal["tmcm-6214", "tmcm-1240"] = "tmcm-6214"
    wire: Literal["usb", "rs485"] = "usb"
    baudrate: int = 115200
    latency_s: float = 3.0e-4
    encoder_noise_microsteps: float = 1.0


@dataclass(frozen=True)
class Estimator:
    """What computes the photodiodes' light: the fast estimator, with its own few rays or with `rays` of them, or the forward
    one until half of the photodiodes that get light are known to `relative_error`.

    `stray_map` is whether light of the frames, and light that met something between, counts: traced by the forward one, and for
    the fast one added from a map that the forward one makes.
    """

    kind: Literal["fast", "forward"] = "fast"
    rays: int | None = None
    relative_error: float = 0.03
    stray: bool = False


@dataclass(frozen=True)
class TwinModel:
    """A whole virtual rig. `samples` are what its back door can mount; `noise` switches every random process."""

    seed: int
    axes: dict[str, Mechanics]
    samples: dict[str, Scatterer]
    instrument: Instrument = field(default_factory=Instrument)
    frames: SampleFrames = field(default_factory=SampleFrames)
    light: LightSource = field(default_factory=LightSource)
    photodiodes: Photodiodes = field(default_factory=Photodiodes)
    electronics: Electronics = field(default_factory=Electronics)
    monitor: MonitorPhotodiode = field(default_factory=MonitorPhotodiode)
    monochromator: MonochromatorDrive = field(default_factory=MonochromatorDrive)
    controller: AxisController = field(default_factory=AxisController)
    noise: bool = True
    estimator: Estimator = field(default_factory=Estimator)
    order_sorting: OrderSorting = field(default_factory=OrderSorting)
