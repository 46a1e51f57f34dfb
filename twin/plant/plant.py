"""The instrument at a time t: angles of the axes, light, photocurrents of the photodiodes, readings of the converters."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.geometry.instrument import nominal_reflectance
from goniotwin.twin.plant import disturbances
from goniotwin.twin.plant.converter import CONVERTED, conversions, convert_channels, convert_readings, noise_v
from goniotwin.twin.plant.disturbances import Drawn
from goniotwin.twin.plant.history import Changes, ChangingQuantity, History, SlewHistory
from goniotwin.twin.plant.lamp import lamp_constants, lamp_mean
from goniotwin.twin.plant.model import TwinModel
from goniotwin.twin.plant.noise import normal
from goniotwin.twin.plant.process_key import process_key
from goniotwin.twin.plant.shaft import Shaft
from goniotwin.twin.plant.view import Aspect, View

MODULE_CHANNELS = 8
ONE_BY_ONE = tuple((channel, channel + 1) for channel in range(MODULE_CHANNELS))
MONITOR_PIECES = 16
"""Number of parts of the monitor's averaging interval, if shutter, wavelength or filter change during it."""

WHITE_NODES = 9
"""Wavelengths, evenly over the lamp's spectrum, that stand for white light."""
WAVELENGTHS_KEPT = 512
"""Settings of the monochromator whose passing wavelengths are known at a time, of poses that are expected."""
LINEAR_A, FAINTEST_A = 1e-9, 1e-18
"""Current at which a photodiode that is not linear has its stated responsivity; below the faintest one it does not change."""
SUPPLY_V = 12.0
"""An amplifier gives no more, so that no more is seen by the other channels of its module."""


TICKS_AHEAD = 3 * MODULE_CHANNELS + 2
"""Ticks of the readings that are computed in one call: those of four readings of each module, one period apart."""


@dataclass(frozen=True, slots=True)
class ComingReadings:
    """Input voltages of modules at the ticks from `first` on, V (modules, ticks, channels), after so many changes (`change`).

    Those of a module hold where its gain is `steady`. `counts` are kept for the devices, by the ranges of their channels.
    """

    change: int
    first: int
    steady: list[bool]
    volts: Floats
    counts: dict[tuple[int, ...], Ints] = field(default_factory=dict)


@dataclass(frozen=True)
class ExpectedPose:
    """A pose that is going to be measured: the sample (None: no sample) and the number of its mounting, what is set at the
    monochromator, and the counters of the axes, microsteps.
    """

    sample: str | None
    mounting: int
    wavelength_nm: float
    filter_position: int
    counters: Mapping[str, float]


class Plant:
    """One virtual instrument. Devices drive and read it; `mount` belongs to simulation control and has no wire."""

    def __init__(self, model: TwinModel) -> None:
        self.model = model
        self.drawn = Drawn(model.disturbances, model.seed, model.photodiodes.count)
        play = model.disturbances.width(disturbances.PLAY)
        self.changes = changes = Changes()
        self.shafts = {
            name: Shaft(replace(each, backlash_deg=each.backlash_deg + play) if play else each, changes)
            for name, each in model.axes.items()
        }
        self.wavelength_nm = SlewHistory(model.monochromator.start_nm, changes)
        self.wheel = SlewHistory(1.0, changes)
        self.shutter_open: History[bool] = History(False, changes=changes)
        self.sample: History[str | None] = History(None, changes=changes)
        self.mounting: History[int] = History(0, changes=changes)
        self._mountings: Counter[str] = Counter()
        self._axis_errors_deg: dict[str, float] = {}
        self.tilt_deg: History[float] = History(0.0, changes=changes)
        diodes = model.photodiodes
        self.modules = math.ceil(diodes.count / MODULE_CHANNELS)
        self.gain: list[History[int]] = [History(0, changes=changes) for _ in range(self.modules)]
        self._coming: ComingReadings | None = None
        self.view = View(model, self.drawn)
        self._lamp = lamp_constants(model.light, model.seed, model.noise)
        self._make_light()
        self._make_electronics()

    def _make_light(self) -> None:
        light = self.model.light
        # The three mirrors are in `LightSource.throughput` and in the optics' throughput too: divide by them once.
        mirrors = nominal_reflectance(self.model.instrument.mirror_reflectance) ** 3
        self._radiance = light.radiance * light.band_nm * light.throughput / mirrors
        self._lamp_spectrum = np.transpose(light.spectrum)
        self._passed: tuple[tuple[float, int], list[tuple[float, float]]] = ((0.0, 0), [])
        self._monitor_key = process_key(self.model.seed, "monitor")
        self._white_nm = np.linspace(self._lamp_spectrum[0, 0], self._lamp_spectrum[0, -1], WHITE_NODES).tolist()
        self._responsivity = np.transpose(self.model.photodiodes.responsivity)
        light_path = (self.wavelength_nm, self.wheel, self.shutter_open, self.sample, self.mounting, self.tilt_deg)
        self._light_path: tuple[ChangingQuantity, ...] = (*light_path, *self.shafts.values())
        # Photocurrents of the last settled state. A change of the light without a history (`fade`) has to reset them.
        self._settled_currents: tuple[tuple[object, ...], Floats] = ((), np.zeros(0))

    def _make_electronics(self) -> None:
        seed, electronics, diodes = self.model.seed, self.model.electronics, self.model.photodiodes
        channels = self.modules * MODULE_CHANNELS
        spread = process_key(seed, "dark currents")
        wired = np.arange(channels) < diodes.count  # spare inputs have no photodiode and no dark current
        self._dark_a = np.where(
            wired,
            [diodes.dark_a * (1.0 + diodes.dark_spread * normal(spread, np.int64(c))) for c in range(channels)],
            0.0,
        )
        self._sensitivity = np.ones(channels)
        self._gains = np.array(electronics.gains_v_per_a)
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
        """Mount a sample of the model in the sample unit, or remove it (None). Raises KeyError for an unknown sample.

        Each mounting of a sample has a number, from 1. To mount the one that is mounted changes nothing.
        """
        if sample is not None and sample not in self.model.samples:
            known = ", ".join(sorted(self.model.samples)) or "none"
            raise KeyError(f"the virtual rig has no sample {sample!r}; it has: {known}")
        if sample is None:
            self.mounting.set(t, 0)
        elif sample != self.sample.at(t):
            self._mountings[sample] += 1
            self.mounting.set(t, self._mountings[sample])
        self.sample.set(t, sample)

    def set_lamp(self, t: float, *, drift_per_hour: float | None = None, level: float | None = None) -> None:
        """Change the lamp's drift from `t` on, or let it jump to another level (1 is the nominal one)."""
        constants, keys = self._lamp
        now = constants[6] + constants[0] * (t - constants[5]) / 3600.0
        changed = constants.copy()
        changed[5], changed[6] = t, now if level is None else level
        if drift_per_hour is not None:
            changed[0] = drift_per_hour
        self._lamp = (changed, keys)
        self.changes.number += 1

    def count_mountings(self, earlier: Mapping[str, int]) -> None:
        """Count mountings of samples before those that follow."""
        self._mountings.update(earlier)

    def tilt_sample(self, tilt_deg: float, t: float) -> None:
        """Tilt the sample's normal in the plane of incidence, towards the light for positive angles."""
        self.tilt_deg.set(t, tilt_deg)

    def fade(self, photodiode: int, share: float) -> None:
        """Reduce a photodiode's photocurrent to a share from now on. With 0 it is dead, without dark current too."""
        self._sensitivity[photodiode] *= share
        if share == 0.0:
            self._dark_a[photodiode] = 0.0
        self._settled_currents = ((), np.zeros(0))
        self.changes.number += 1

    def angle_deg(self, axis: str, t: float) -> float:
        """True angle of an axis at `t`, with its zero and position as drawn; 0 for an axis that this rig does not have."""
        shaft = self.shafts.get(axis)
        if shaft is None:
            return 0.0
        error = self._axis_error_deg(axis, shaft, t)
        return shaft.angle_deg(t) + error if error else shaft.angle_deg(t)

    def _axis_error_deg(self, axis: str, shaft: Shaft, t: float) -> float:
        """`Drawn.axis_error_deg`, once for each axis where its moves make no difference."""
        if self.drawn.counts_moves:
            return self.drawn.axis_error_deg(axis, shaft.drive(t).moves)
        known = self._axis_errors_deg.get(axis)
        if known is None:
            known = self._axis_errors_deg[axis] = self.drawn.axis_error_deg(axis, 0)
        return known

    def filter_position(self, t: float) -> int:
        """Position of the filter wheel in the beam at `t`; the nearest one while the wheel turns."""
        return round(self.wheel.at(t))

    def throughputs_m2sr(self, t: float, wavelength_nm: float | None = None) -> Floats:
        """Throughput of each photodiode at the pose of `t`, m^2 sr: shape (photodiodes,).

        At the wavelength that is set then, or at another one.
        """
        sigma, gamma, beta, shift = (self.angle_deg(axis, t) for axis in ("sigma", "gamma", "beta", "shift"))
        wavelength = self._true_nm(self.wavelength_nm.at(t)) if wavelength_nm is None else wavelength_nm
        aspect = Aspect(self.sample.at(t), self.tilt_deg.at(t), wavelength, sigma, gamma, beta, shift, self.mounting.at(t))
        return self.view.throughputs_m2sr(aspect)

    def expect(self, poses: Iterable[ExpectedPose]) -> None:
        """Poses that follow, in their order: their throughputs are then computed many at once. Nothing else depends on it."""
        self.view.expect(self._aspects(poses))

    def _aspects(self, poses: Iterable[ExpectedPose]) -> Iterator[Aspect]:
        """The aspects at expected poses, one for each wavelength that passes; none of a pose where the way there decides."""
        if self.drawn.counts_moves:
            return
        axes = ("sigma", "gamma", "beta", "shift")
        shafts = [(name, self.shafts.get(name)) for name in axes]
        errors = [self.drawn.axis_error_deg(name, 0) if shaft is not None else 0.0 for name, shaft in shafts]
        passing: dict[tuple[float, int], list[float]] = {}
        for pose in poses:
            angles: list[float] = []
            for (name, shaft), error in zip(shafts, errors, strict=True):
                angle = shaft.newest.resting_deg(pose.counters[name]) if shaft is not None else 0.0
                if angle is None:
                    break
                angles.append(angle + error if error else angle)
            else:
                set_at = pose.wavelength_nm, pose.filter_position
                if set_at not in passing:
                    if len(passing) >= WAVELENGTHS_KEPT:
                        passing.clear()
                    passing[set_at] = [nm for nm, light in self._passing(*set_at) if light != 0.0]
                sigma, gamma, beta, shift = angles
                for wavelength in passing[set_at]:
                    yield Aspect(pose.sample, self.tilt_deg.newest, wavelength, sigma, gamma, beta, shift, pose.mounting)

    def warm_up(self) -> None:
        """Compute everything once: kernels compile at their first use, and a device must not wait for that.

        Nothing is changed, and no random number is used up.
        """
        for sample in (*self.model.samples, None):
            self.view.throughputs_m2sr(Aspect(sample, 0.0, self.wavelength_nm.at(0.0), 0.0, 0.0, 0.0, 0.0))
        for module in range(self.modules):
            self.volts(module, 0.0)
        lamp_mean(0.0, self.conversion_period_s, *self._lamp)

    def pupil_radiance(self, t: float) -> float:
        """Radiance of the exit pupil at a lamp level of 1, W m^-2 sr^-1; 0 with the shutter closed."""
        return self._radiance * sum(light for _, light in self._light(t)) if self.shutter_open.at(t) else 0.0

    def photocurrents_a(self, t: float) -> Floats:
        """Photocurrents of all channels at a lamp level of 1, without dark current, at the pose and wavelength of `t`."""
        currents = np.zeros(self.modules * MODULE_CHANNELS)
        for wavelength, light in self._light(t) if self.shutter_open.at(t) else ():
            if light != 0.0:
                responsivity = float(np.interp(wavelength, *self._responsivity))
                seen = self.throughputs_m2sr(t, wavelength)
                currents[: self.model.photodiodes.count] += responsivity * (self._radiance * light) * seen
        moves = sum([shaft.drive(t).moves for shaft in self.shafts.values()])
        pose = self.sample.at(t), self.mounting.at(t), self.angle_deg("sigma", t)
        return self._disturbed(currents, *pose, moves) * self._sensitivity

    def steady_photocurrents_a(self, aspect: Aspect, filter_position: int = 1, moves: int = 0) -> Floats:
        """Photocurrents of the photodiodes in an aspect, with the filter wheel at some position, at a set wavelength.

        At a lamp level of 1, with the shutter open, without dark current. `moves` is the number of all axes' moves before.
        """
        currents = np.zeros(self.model.photodiodes.count)
        for wavelength, share in self._passing(aspect.wavelength_nm, filter_position):
            light = self._radiance * share
            if light != 0.0:
                responsivity = float(np.interp(wavelength, *self._responsivity))
                currents += responsivity * light * self.view.throughputs_m2sr(aspect._replace(wavelength_nm=wavelength))
        return self._disturbed(currents, aspect.sample, aspect.mounting, aspect.sigma_deg, moves)

    def _disturbed(self, currents: Floats, sample: str | None, mounting: int, sigma_deg: float, moves: int) -> Floats:
        """Photocurrents with what sample and photodiodes are off by, and with the effect of the light's polarisation."""
        factor, per_decade = self.drawn.signal_factor(sample, mounting, moves), self.drawn.of(disturbances.LINEARITY)
        if sample is not None and (diattenuation := self.model.diattenuation.get(sample, 0.0)):
            factor *= 1.0 + diattenuation * self.model.light.polarised(sigma_deg)
        if factor != 1.0:
            currents = factor * currents
        if per_decade != 0.0:
            decades = np.log10(np.maximum(currents, FAINTEST_A) / LINEAR_A)
            currents = currents * (1.0 + per_decade * decades)
        return currents

    def drawn_volts(self, signal_a: Floats, gain: int, drawn: Floats) -> Floats:
        """Input voltages (n, photodiodes) of conversions of photocurrents (photodiodes,) without dark current, V.

        `drawn` (n, 1 + photodiodes) are standard normal numbers for the lamp's flicker and the noise of each photodiode. Gains
        and dark currents are the nominal ones.
        """
        noisy, electronics, gain_v_per_a = float(self.model.noise), self.model.electronics, self._gains[gain]
        current = signal_a * (1.0 + noisy * self.model.light.flicker * drawn[:, :1]) + self.model.photodiodes.dark_a
        spread = noise_v(current, gain_v_per_a, *self._constants[:3])
        return self.with_crosstalk(np.asarray(current * gain_v_per_a + noisy * spread * drawn[:, 1:] + electronics.offset_v))

    def with_crosstalk(self, volts: Floats) -> Floats:
        """Input voltages (..., channels), V, each with its share of those of its module's other channels."""
        share = self.drawn.of(disturbances.CROSSTALK)
        if share == 0.0:
            return volts
        result = volts.copy()
        for first in range(0, volts.shape[-1], MODULE_CHANNELS):
            module = slice(first, first + MODULE_CHANNELS)
            held = np.clip(volts[..., module], -SUPPLY_V, SUPPLY_V)
            result[..., module] += share * (held.sum(axis=-1, keepdims=True) - held)
        return result

    def volts(self, module: int, t: float) -> Floats:
        """Input voltages of the last finished conversion of each channel of a module, V (8,). Constant until the next one."""
        period, gain = self.conversion_period_s, self.gain[module]
        numbers, earliest, latest = conversions(t, period, MODULE_CHANNELS)
        volts = np.empty(MODULE_CHANNELS)
        light = self._settled(earliest, latest)
        steady = light and gain.last_change <= earliest
        for begin, end in ((0, MODULE_CHANNELS),) if steady else ONE_BY_ONE:
            at = latest if steady else (numbers[begin] + begin / MODULE_CHANNELS) * period
            signal_a = self._settled_currents[1] if light else self.photocurrents_a(at)
            before, _ = gain.before(at)
            convert_channels(
                volts,
                begin,
                end,
                module * MODULE_CHANNELS,
                numbers,
                period,
                signal_a,
                self._dark_a,
                self._gains,
                self._deviation,
                gain.at(at),
                before,
                gain.held_since(at),
                self._constants,
                *self._lamp,
                self._dark_keys,
                self._noise_keys,
            )
        return self.with_crosstalk(volts)

    def tick(self, t: float) -> int:
        """The number of the last finished conversion at a time, over all channels of a module: see `convert_readings`."""
        return math.floor(MODULE_CHANNELS * (t / self.conversion_period_s + CONVERTED)) - 1

    def coming_readings(self, tick: int) -> ComingReadings | None:
        """`volts` of all modules from a tick on, as long as nothing changes; None where light may change at that tick."""
        coming = self._coming
        if coming is not None and coming.change == self.changes.number and 0 <= tick - coming.first < len(coming.volts[0]):
            return coming
        tick_s = self.conversion_period_s / MODULE_CHANNELS
        earliest = (tick - MODULE_CHANNELS) * tick_s
        if not self._settled(earliest, tick * tick_s):
            return None
        volts = np.empty((self.modules, TICKS_AHEAD, MODULE_CHANNELS))
        changed = [each.last_change for each in self.gain]
        convert_readings(
            volts,
            tick,
            self.conversion_period_s,
            self._settled_currents[1],
            self._dark_a,
            self._gains,
            self._deviation,
            np.array([each.newest for each in self.gain]),
            np.array([each.before(each.last_change)[0] for each in self.gain]),
            np.array(changed),
            self._constants,
            *self._lamp,
            self._dark_keys,
            self._noise_keys,
        )
        steady = [each <= earliest for each in changed]
        self._coming = ComingReadings(self.changes.number, tick, steady, self.with_crosstalk(volts))
        return self._coming

    def monitor_a(self, start: float, end: float) -> float:
        """Mean current of the monitor photodiode over [start, end], A."""
        monitor, drawn = self.model.monitor, self.drawn
        drift, linearity = drawn.of(disturbances.MONITOR_DRIFT), drawn.of(disturbances.MONITOR_LINEARITY)
        current = monitor.dark_a
        changing = max(self.wavelength_nm.last_change, self.wheel.last_change, self.shutter_open.last_change) > start
        pieces = MONITOR_PIECES if changing else 1
        for k in range(pieces):
            first, last = (start + (end - start) * each / pieces for each in (k, k + 1))
            middle = 0.5 * (first + last)
            if self.shutter_open.at(middle):
                level = lamp_mean(first, last, *self._lamp)
                light_a = monitor.current_a * sum([light for _, light in self._light(middle)]) * level
                current += monitor.measured_a(light_a, middle, drift, linearity) / pieces
        if self.model.noise:
            current *= 1.0 + monitor.noise * normal(self._monitor_key, np.int64(math.floor(end * monitor.samples_per_s)))
        return current

    def _light(self, t: float) -> list[tuple[float, float]]:
        """Wavelengths in nm that pass the monochromator at `t`, each with the lamp's relative radiance that passes."""
        return self._passing(self.wavelength_nm.at(t), self.filter_position(t))

    def _passing(self, set_nm: float, position: int) -> list[tuple[float, float]]:
        """`_light` for a set wavelength and a position of the filter wheel."""
        known, passing = self._passed
        if known == (set_nm, position) and passing:
            return passing
        sorting, true_nm = self.model.order_sorting, self._true_nm(set_nm)
        result: list[tuple[float, float]] = []
        for offset_nm, part in self.model.light.nodes:
            for nm, share in sorting.passing(true_nm + offset_nm, position):
                result.append((nm, part * share * float(np.interp(nm, *self._lamp_spectrum))))
        if (stray := self.drawn.of(disturbances.STRAY_LIGHT)) != 0.0:
            stray *= sum(light for _, light in result)
            white = [(nm, float(np.interp(nm, *self._lamp_spectrum))) for nm in self._white_nm]
            total = sum(light for _, light in white)
            result += [(nm, stray * light / total * sorting.transmittance(nm, position)) for nm, light in white]
        self._passed = ((set_nm, position), result)
        return result

    def _true_nm(self, set_nm: float) -> float:
        """The wavelength that passes the monochromator where it is set to another."""
        return set_nm + self.drawn.of(disturbances.WAVELENGTH)

    def _settled(self, earliest: float, latest: float) -> bool:
        """Whether nothing that determines the photocurrents changed after `earliest`.

        `_settled_currents` then are those of `latest`, which is not before it.
        """
        for line in self._light_path:
            if line.last_change > earliest:
                return False
        light = tuple([line.newest for line in self._light_path])
        if light != self._settled_currents[0]:
            self._settled_currents = (light, self.photocurrents_a(latest))
        return True
