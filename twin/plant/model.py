"""Model of the virtual rig: its own mechanics, light and electronics.

The values are independent of the operator's configuration. The defaults are one consistent set of assumptions. Where the paper
gives no value, it is a setting.
"""

from dataclasses import dataclass, field
from typing import Literal

from goniotwin.twin.optics import Instrument, SampleFrames, Scatterer

SHORTEST_NM = 355.0
"""The lamp's bulb is opaque up to this wavelength, so that there is no second order up to 710 nm."""


@dataclass(frozen=True)
class Mechanics:
    """One axis: motor `motor` turns it by `sense` * 360 deg / (`full_steps` * `gear`) per full step, starting at `zero_deg`.

    `module` is the address of the motion module with that motor. `backlash_deg` is the play: driven downwards, the axis is
    higher by this angle than driven upwards. A limit switch is closed at and beyond its angle. The home switch is closed from
    `home_deg` over `home_width_deg` upwards in each turn. None: there is no such switch. The encoder is mounted on the axis; it
    has `encoder_counts` per turn of the motor and an eccentricity of `encoder_error_deg`.
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
    """Light from the arc to the sample: `radiance` (W m^-2 sr^-1 nm^-1) in `band_nm`; `throughput` of it reaches the sample.

    `spectrum` has pairs (wavelength in nm, relative radiance). Drift and flicker belong to the lamp: all detectors and the
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
    """Photodiodes on the arc: polar angles at shift 0, upper arc first, then the lower one; responsivity and dark currents."""

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
        """Number of photodiodes."""
        return len(self.upper_deg) + len(self.lower_deg)


@dataclass(frozen=True)
class Electronics:
    """Transimpedance amplifiers and the converters behind them. A module has eight channels and one gain.

    `module` is the kind of converter. One with a serial line (`adam-4117`, at `baudrate`) has no outputs, so its gain is always
    the first. `conversions_per_s` counts those of all channels of a module: 10 or 100.
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
    """Photodiode behind the beam splitter: current at a lamp level of 1 and 550 nm, dark current, noise.

    `noise` is relative, per reading.
    """

    current_a: float = 1.4e-7
    dark_a: float = 1.0e-11
    noise: float = 1.0e-4
    samples_per_s: float = 3000.0
    serial_number: str = "TWIN0001"
    latency_s: float = 5.0e-4


@dataclass(frozen=True)
class MonochromatorDrive:
    """Speeds of grating, shutter, filter wheel (per position) and slits; echo and handshake mode of the serial line.

    `nm_per_step` is for a grating of 1200 lines per mm. `gratings` are pairs (lines per mm, label). `filters` of 0: no wheel.
    `already_there_is_error`: a filter wheel sent to its present position reports error 7 (to be confirmed on hardware).
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
class WheelFilter:
    """Long-pass filter in a position of the wheel: `transmittance` from `cut_on_nm` on, and zero below."""

    position: int
    cut_on_nm: float
    transmittance: float = 0.9

    def passes(self, wavelength_nm: float) -> float:
        """Share of the light of a wavelength that passes."""
        return self.transmittance if wavelength_nm >= self.cut_on_nm else 0.0


@dataclass(frozen=True)
class OrderSorting:
    """Sorting of the grating's orders: which light leaves the monochromator.

    That is light of the wavelength set and, in the second order, of half that wavelength. `second_order` is the share of the
    latter that passes, relative to what would pass with the grating set to it. A position of the wheel without a filter is
    open.
    """

    second_order: float = 0.0
    filters: tuple[WheelFilter, ...] = ()

    def passing(self, wavelength_nm: float, position: int) -> list[tuple[float, float]]:
        """Wavelengths in nm and, for each, the share of its light that passes, at a set wavelength and wheel position."""
        orders = [(wavelength_nm, 1.0)]
        half = 0.5 * wavelength_nm
        if self.second_order > 0.0 and half > SHORTEST_NM:
            orders.append((half, self.second_order))
        for each in self.filters:
            if each.position == position:
                orders = [(nm, share * each.passes(nm)) for nm, share in orders]
        return orders


@dataclass(frozen=True)
class AxisController:
    """Line of the motion modules: bits per second (without effect over USB) and response time of a module.

    `kind` applies to every module; there is one module for each address among the axes' `module`. On `rs485` a module does not
    respond to another address; over `usb` it responds to any.
    """

    kind: Literal["tmcm-6214", "tmcm-1240"] = "tmcm-6214"
    wire: Literal["usb", "rs485"] = "usb"
    baudrate: int = 115200
    latency_s: float = 3.0e-4
    encoder_noise_microsteps: float = 1.0


@dataclass(frozen=True)
class Estimator:
    """Estimator of the light on the photodiodes.

    `fast`: with its seven rays per detector, or with `rays`. `forward`: until half of the photodiodes that receive light have a
    relative error below `relative_error`.

    `stray` includes light of the frames and light that met another surface. The forward estimator traces it. For the fast one a
    map from the forward estimator is added.
    """

    kind: Literal["fast", "forward"] = "fast"
    rays: int | None = None
    relative_error: float = 0.03
    stray: bool = False


@dataclass(frozen=True)
class TwinModel:
    """Complete virtual rig. `samples` can be mounted by simulation control; `noise` switches every random process on or off."""

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
