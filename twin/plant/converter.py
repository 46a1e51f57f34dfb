"""From photocurrents to counts: transimpedance amplifier, settling after a change of gain, noise, quantisation."""

import math

import numpy as np

from goniotwin.arrays import Floats, Ints, Keys
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.plant.lamp import lamp_level
from goniotwin.twin.plant.noise import normal, wandering

ELEMENTARY_CHARGE_C = 1.602176634e-19
BOLTZMANN_J_PER_K = 1.380649e-23
CONVERTED = 1e-9
"""Part of a period by which a conversion may be read before its end."""
SETTLED = 12.0
"""Time constants after which an amplifier is at rest. Its exponential tail is then a fifth of a count at full scale and is cut
off there, so that later readings do not depend on the time.
"""


def noise_v(
    current_a: Floats | float, gain: float, bandwidth_hz: float, temperature_k: float, amplifier_v: float
) -> Floats | float:
    """Standard deviation of a conversion, V: shot noise of the current, Johnson noise of the resistor, amplifier noise."""
    shot = 2.0 * ELEMENTARY_CHARGE_C * np.abs(current_a) * bandwidth_hz
    johnson = 4.0 * BOLTZMANN_J_PER_K * temperature_k * bandwidth_hz / gain
    return np.sqrt((shot + johnson) * gain * gain + amplifier_v * amplifier_v)


_noise_v = kernel()(noise_v)


@kernel()
def conversions(t: float, period: float, channels: int) -> tuple[Ints, float, float]:
    """Last finished conversions of a module's channels at the time `t`, s.

    The channels are converted one after the other within each `period`, s. Returns the number of each channel's conversion, and
    the start times of the earliest and of the latest of these, s.
    """
    numbers = np.empty(channels, dtype=np.int64)
    earliest, latest = np.inf, -np.inf
    for c in range(channels):
        # A conversion takes one tick of the module and can be read after it.
        numbers[c] = math.floor(t / period + CONVERTED - (c + 1) / channels)
        start = (numbers[c] + c / channels) * period
        earliest, latest = min(earliest, start), max(latest, start)
    return numbers, earliest, latest


@kernel()
def _channel_v(
    k: int,
    number: np.int64,
    t: float,
    level: float,
    signal_a: Floats,
    dark_a: Floats,
    gains: Floats,
    deviations: Floats,
    gain: int,
    old_gain: int,
    changed: float,
    constants: Floats,
    dark_keys: Keys,
    noise_keys: Keys,
) -> float:
    """Input voltage of channel `k` of the rig in its conversion `number`, which begins at `t`, s, at a lamp level, V.

    The rest is as in `convert_channels`.
    """
    bandwidth, temperature, amplifier_v, offset_v = constants[:4]
    settling, dark_wander, dark_period, noisy = constants[4:]
    dark = dark_a[k]
    if noisy > 0.0 and dark_wander > 0.0:
        dark *= 1.0 + dark_wander * wandering(dark_keys[k], t, dark_period)
    current = signal_a[k] * level + dark
    new = current * gains[gain] * (1.0 + deviations[gain, k])
    v = new
    if t - changed < SETTLED * settling:
        left = math.exp(-(t - changed) / settling) - math.exp(-SETTLED)
        v += (current * gains[old_gain] * (1.0 + deviations[old_gain, k]) - new) * left
    if noisy > 0.0:
        spread = _noise_v(current, gains[gain], bandwidth, temperature, amplifier_v)
        v += spread * normal(noise_keys[k], number)
    result: float = v + offset_v
    return result


@kernel()
def convert_channels(
    volts: Floats,
    begin: int,
    end: int,
    first: int,
    numbers: Ints,
    period: float,
    signal_a: Floats,
    dark_a: Floats,
    gains: Floats,
    deviations: Floats,
    gain: int,
    old_gain: int,
    changed: float,
    constants: Floats,
    lamp: Floats,
    lamp_keys: Keys,
    dark_keys: Keys,
    noise_keys: Keys,
) -> None:
    """Fill `volts` with the input voltages of a module's channels `begin` to `end`, before quantisation, V.

    `numbers` are the channels' conversions from `conversions`. Channel 0 of the module is element `first` of the arrays over
    the rig's channels: `signal_a`, photocurrent at a lamp level of 1; `dark_a`, dark current; and the keys. `gains` in V/A,
    with relative `deviations` (gains, channels of the rig), are chosen by index: `gain` since the time `changed`, `old_gain`
    before. `constants`: bandwidth Hz, temperature K, amplifier noise V, offset V, settling time constant s, relative dark
    wander, its period s, noise on (1) or off (0).
    """
    for c in range(begin, end):
        t = (numbers[c] + c / volts.size) * period
        volts[c] = _channel_v(
            first + c,
            numbers[c],
            t,
            lamp_level(t, lamp, lamp_keys),
            signal_a,
            dark_a,
            gains,
            deviations,
            gain,
            old_gain,
            changed,
            constants,
            dark_keys,
            noise_keys,
        )


@kernel()
def convert_readings(
    volts: Floats,
    first_tick: int,
    period: float,
    signal_a: Floats,
    dark_a: Floats,
    gains: Floats,
    deviations: Floats,
    gain: Ints,
    old_gain: Ints,
    changed: Floats,
    constants: Floats,
    lamp: Floats,
    lamp_keys: Keys,
    dark_keys: Keys,
    noise_keys: Keys,
) -> None:
    """Fill `volts` (modules, ticks, channels) with what each module has at consecutive ticks, from `first_tick` on.

    A tick is the end of a channel's conversion: number n of channel c is tick n * channels + c. `gain`, `old_gain` and
    `changed` are those of each module, the rest as in `convert_channels`.
    """
    modules, ticks, channels = volts.shape
    now = np.empty((modules, channels))
    for tick in range(1 - channels, ticks):
        number, c = np.int64((first_tick + tick) // channels), (first_tick + tick) % channels
        t = (number + c / channels) * period
        level = lamp_level(t, lamp, lamp_keys)
        for module in range(modules):
            now[module, c] = _channel_v(
                module * channels + c,
                number,
                t,
                level,
                signal_a,
                dark_a,
                gains,
                deviations,
                gain[module],
                old_gain[module],
                changed[module],
                constants,
                dark_keys,
                noise_keys,
            )
        if tick >= 0:
            for module in range(modules):  # numba takes three seconds to compile an assignment of arrays
                for channel in range(channels):
                    volts[module, tick, channel] = now[module, channel]
