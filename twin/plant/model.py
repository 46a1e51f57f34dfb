"""What the virtual rig is: its own mechanics, light and electronics, never derived from what the operator believes.

The defaults are one consistent set of assumptions; where the source says nothing, each is a setting.
"""

from dataclasses import dataclass, field

from twin.optics import Instrument, Scatterer


@dataclass(frozen=True)
class Mechanics:
    """An axis: motor `motor` turns it by `sense` * 360 deg / (`full_steps` * `gear`) a full step from `zero_deg` on."""

    motor: int
    gear: float
    sense: int = 1
    zero_deg: float = 0.0
    full_steps: int = 200
    encoder: bool = True

    @property
    def deg_per_full_step(self) -> float:
        """Signed angle of one full step."""
        return self.sense * 360.0 / (self.full_steps * self.gear)


@dataclass(frozen=True)
class Light:
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
    """Transimpedance amplifiers and the converters behind them; a module has eight channels and one gain."""

    gains_v_per_a: tuple[float, ...] = (1e6, 1e8, 1e10, 1e11)
    gain_spread: float = 1.0e-3
    offset_v: float = 1.0e-3
    noise_v: float = 1.5e-4
    settling_s: float = 0.02
    temperature_k: float = 300.0
    conversions_per_s: float = 100.0
    latency_s: float = 4.0e-4


@dataclass(frozen=True)
class Monitor:
    """The photodiode behind the beam splitter: its current for a lamp of 1 at 550 nm, and its relative noise a reading."""

    current_a: float = 1.4e-7
    dark_a: float = 1.0e-11
    noise: float = 1.0e-4
    samples_per_s: float = 3000.0
    serial_number: str = "TWIN0001"
    latency_s: float = 5.0e-4


@dataclass(frozen=True)
class MonochromatorDrive:
    """How fast the grating, the shutter and the filter wheel are, and whether the wire echoes."""

    slew_nm_per_s: float = 175.0
    settle_s: float = 0.1
    shutter_s: float = 0.15
    filter_s: float = 1.0
    start_nm: float = 550.0
    echo: bool = True
    baudrate: int = 9600


@dataclass(frozen=True)
class AxisController:
    """The motion module's wire: baud rate (no matter over USB), module address, and how long it thinks."""

    baudrate: int = 115200
    address: int = 1
    latency_s: float = 3.0e-4
    encoder_noise_microsteps: float = 1.0


@dataclass(frozen=True)
class TwinModel:
    """A whole virtual rig. `samples` are what its back door can mount; `noise` switches every random process."""

    seed: int
    axes: dict[str, Mechanics]
    samples: dict[str, Scatterer]
    instrument: Instrument = field(default_factory=Instrument)
    light: Light = field(default_factory=Light)
    photodiodes: Photodiodes = field(default_factory=Photodiodes)
    electronics: Electronics = field(default_factory=Electronics)
    monitor: Monitor = field(default_factory=Monitor)
    monochromator: MonochromatorDrive = field(default_factory=MonochromatorDrive)
    controller: AxisController = field(default_factory=AxisController)
    noise: bool = True
    rays: int = 1024
