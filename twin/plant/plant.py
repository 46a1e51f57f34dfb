"""The instrument at a time t: where each axis is, what light passes, what each photodiode gives and each converter reads."""

import math

import numpy as np
import numpy.typing as npt

from twin.optics.reflectance import nominal
from twin.plant.converter import converted
from twin.plant.lamp import lamp_constants, lamp_mean
from twin.plant.model import TwinModel
from twin.plant.noise import normal, process_key
from twin.plant.shaft import Shaft
from twin.plant.slew import Slewing
from twin.plant.timeline import Timeline
from twin.plant.view import Aspect, View

Floats = npt.NDArray[np.float64]
MODULE_CHANNELS = 8
MONITOR_PIECES = 16
"""Into so many a mean of the monitor is cut where shutter or wavelength change during it."""


class Plant:
    """One virtual instrument. Devices drive it and ask it; `mount` is its back door and not a wire."""

    def __init__(self, model: TwinModel) -> None:
        self.model = model
        self.shafts = {name: Shaft(mechanics) for name, mechanics in model.axes.items()}
        self.wavelength_nm = Slewing(model.monochromator.start_nm)
        self.shutter_open: Timeline[bool] = Timeline(False)
        self.sample: Timeline[str | None] = Timeline(None)
        self.tilt_deg: Timeline[float] = Timeline(0.0)
        diodes = model.photodiodes
        self.modules = math.ceil(diodes.count / MODULE_CHANNELS)
        self.gain: list[Timeline[int]] = [Timeline(0) for _ in range(self.modules)]
        self.view = View(model)
        self._lamp = lamp_constants(model.light, model.seed, model.noise)
        self._make_electronics()

    def _make_electronics(self) -> None:
        seed, electronics, diodes = self.model.seed, self.model.electronics, self.model.photodiodes
        channels = self.modules * MODULE_CHANNELS
        spread = process_key(seed, "dark currents")
        wired = np.arange(channels) < diodes.count  # spare inputs have no photodiode, so no dark current either
        self._dark_a = np.where(
            wired,
            [diodes.dark_a * (1.0 + diodes.dark_spread * normal(spread, np.int64(c))) for c in range(channels)],
            0.0,
        )
        gains = len(electronics.gains_v_per_a)
        deviates = process_key(seed, "gains")
        self._deviation = np.array(
            [
                [electronics.gain_spread * normal(deviates, np.int64(c * gains + g)) for c in range(channels)]
                for g in range(gains)
            ]
        )
        self._dark_keys = np.array([process_key(seed, f"dark {c}") for c in range(channels)], dtype=np.uint64)
        self._noise_keys = np.array([process_key(seed, f"converter {c}") for c in range(channels)], dtype=np.uint64)
        self.conversion_period_s = MODULE_CHANNELS / electronics.conversions_per_s
        self._constants = np.array(
            [
                0.5 / self.conversion_period_s,
                electronics.temperature_k,
                electronics.noise_v,
                electronics.offset_v,
                electronics.settling_s,
                diodes.dark_wander,
                diodes.dark_wander_period_s,
                float(self.model.noise),
            ]
        )

    def mount(self, sample: str | None, t: float) -> None:
        """Puts a sample of the model into the sample unit, or takes it out (None). Raises KeyError for an unknown one."""
        if sample is not None and sample not in self.model.samples:
            known = ", ".join(sorted(self.model.samples)) or "none"
            raise KeyError(f"the virtual rig has no sample {sample!r}; it has: {known}")
        self.sample.set(t, sample)

    def set_lamp(self, t: float, *, drift_per_hour: float | None = None, level: float | None = None) -> None:
        """The lamp drifts otherwise from `t` on, or jumps to another level (1 is the nominal one)."""
        constants, keys = self._lamp
        now = constants[6] + constants[0] * (t - constants[5]) / 3600.0
        changed = constants.copy()
        changed[5], changed[6] = t, now if level is None else level
        if drift_per_hour is not None:
            changed[0] = drift_per_hour
        self._lamp = (changed, keys)

    def tilt_sample(self, tilt_deg: float, t: float) -> None:
        """The sample's normal leans by so much in the plane of incidence, towards the light for positive angles."""
        self.tilt_deg.set(t, tilt_deg)

    def angle_deg(self, axis: str, t: float) -> float:
        """The true angle of an axis at `t`; 0 for one that this rig does not have."""
        shaft = self.shafts.get(axis)
        return shaft.angle_deg(t) if shaft is not None else 0.0

    def throughputs_m2sr(self, t: float) -> Floats:
        """What each photodiode would get of the exit pupil's radiance at the pose of `t`: shape (photodiodes,)."""
        axes = (self.angle_deg(axis, t) for axis in ("sigma", "gamma", "beta", "shift"))
        return self.view.throughputs_m2sr(Aspect(self.sample.at(t), self.tilt_deg.at(t), self.wavelength_nm.at(t), *axes))

    def warm_up(self) -> None:
        """Computes everything once, for the kernels compile when they are first used, and a device must not wait for that.

        Nothing is changed by it, and no number is drawn.
        """
        for sample in (*self.model.samples, None):
            self.view.throughputs_m2sr(Aspect(sample, 0.0, self.wavelength_nm.at(0.0), 0.0, 0.0, 0.0, 0.0))
        for module in range(self.modules):
            self.volts(module, 0.0)
        lamp_mean(0.0, self.conversion_period_s, *self._lamp)

    def pupil_radiance(self, t: float) -> float:
        """Of the exit pupil for a lamp of level 1, W m^-2 sr^-1; 0 behind the closed shutter."""
        if not self.shutter_open.at(t):
            return 0.0
        light, instrument = self.model.light, self.model.instrument
        mirrors = nominal(instrument.mirror_reflectance) ** 3  # the optics count them, and `throughput` has them too
        return light.radiance * light.band_nm * light.throughput / mirrors * self._spectrum(t)

    def photocurrents_a(self, t: float) -> Floats:
        """Of all channels for a lamp of level 1, without dark current, at the pose and wavelength of `t`."""
        currents = np.zeros(self.modules * MODULE_CHANNELS)
        radiance = self.pupil_radiance(t)
        if radiance > 0.0:
            wavelength = self.wavelength_nm.at(t)
            responsivity = float(np.interp(wavelength, *np.transpose(self.model.photodiodes.responsivity)))
            currents[: self.model.photodiodes.count] = responsivity * radiance * self.throughputs_m2sr(t)
        return currents

    def volts(self, module: int, t: float) -> Floats:
        """What the last finished conversion of each channel of a module saw, V (8,): the same number until the next."""
        period = self.conversion_period_s
        channels = np.arange(MODULE_CHANNELS)
        # A conversion takes one tick of the module and can be read when it is over.
        conversion = np.floor(t / period + 1e-9 - (channels + 1) / MODULE_CHANNELS).astype(np.int64)
        times = (conversion + channels / MODULE_CHANNELS) * period
        earliest, latest = float(times.min()), float(times.max())
        block = slice(module * MODULE_CHANNELS, (module + 1) * MODULE_CHANNELS)
        if self._steady_since(earliest):
            signal = self.photocurrents_a(latest)[block]
        else:
            signal = np.array([self.photocurrents_a(float(time))[block][c] for c, time in enumerate(times)])
        gains = np.array(self.model.electronics.gains_v_per_a)
        line = self.gain[module]
        now = np.array([line.at(float(time)) for time in times])
        before, since = zip(*(line.before(float(time)) for time in times), strict=True)
        deviation = self._deviation[:, block]
        result: Floats = converted(
            conversion, period, signal, self._dark_a[block], gains[now], gains[list(before)], np.array(since),
            deviation[now, channels], deviation[list(before), channels], self._constants, *self._lamp,
            self._dark_keys[block], self._noise_keys[block],
        )  # fmt: skip
        return result

    def monitor_a(self, start: float, end: float) -> float:
        """Mean current of the monitor photodiode over [start, end], A."""
        monitor = self.model.monitor
        current = monitor.dark_a
        changing = max(self.wavelength_nm.last_change, self.shutter_open.last_change) > start
        pieces = MONITOR_PIECES if changing else 1
        for k in range(pieces):
            begun, ended = (start + (end - start) * each / pieces for each in (k, k + 1))
            middle = 0.5 * (begun + ended)
            if self.shutter_open.at(middle):
                level = lamp_mean(begun, ended, *self._lamp)
                current += monitor.current_a * self._spectrum(middle) * level / pieces
        if self.model.noise:
            key = process_key(self.model.seed, "monitor")
            current *= 1.0 + monitor.noise * normal(key, np.int64(math.floor(end * monitor.samples_per_s)))
        return current

    def _spectrum(self, t: float) -> float:
        return float(np.interp(self.wavelength_nm.at(t), *np.transpose(self.model.light.spectrum)))

    def _steady_since(self, t: float) -> bool:
        """Whether nothing that decides on the photocurrents has changed after `t`."""
        lines = (self.wavelength_nm, self.shutter_open, self.sample, self.tilt_deg)
        return all(line.last_change <= t for line in lines) and not any(shaft.moved_since(t) for shaft in self.shafts.values())
