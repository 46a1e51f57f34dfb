"""From photocurrents to counts: transimpedance amplifier, its settling after a change of gain, noise, quantisation."""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from twin.plant.lamp import lamp_level
from twin.plant.noise import normal, wandering

ELEMENTARY_CHARGE_C = 1.602176634e-19
BOLTZMANN_J_PER_K = 1.380649e-23
SETTLED = 12.0
"""Time constants after which an amplifier is at rest: its tail, a fifth of a count at full scale, ends there, so that what
is read afterwards does not depend on when."""
Floats = npt.NDArray[np.float64]
Keys = npt.NDArray[np.uint64]


@njit(cache=True, error_model="numpy")
def converted(
    conversion: npt.NDArray[np.int64],
    period: float,
    signal_a: Floats,
    dark_a: Floats,
    gain: Floats,
    old_gain: Floats,
    since_change: Floats,
    deviation: Floats,
    old_deviation: Floats,
    constants: Floats,
    lamp: Floats,
    lamp_keys: Keys,
    dark_keys: Keys,
    noise_keys: Keys,
) -> Floats:
    """Input voltages of a module's channels at their conversion times, V, before quantisation.

    Shapes: one element a channel. `conversion` counts a channel's conversions, one each `period` s, the channels one
    after the other within it. `signal_a` is the photocurrent of a lamp of level 1, `dark_a` the dark current; `gain`
    in V/A with its relative `deviation`. `constants`: bandwidth Hz, temperature K, amplifier noise V, offset V, settling
    time constant s, relative dark wander, its period s, noise on (1) or off (0).
    """
    bandwidth, temperature, noise_v, offset_v, settling, dark_wander, dark_period, noisy = constants
    channels = conversion.size
    volts = np.empty(channels)
    for c in range(channels):
        t = (conversion[c] + c / channels) * period
        dark = dark_a[c]
        if noisy > 0.0 and dark_wander > 0.0:
            dark *= 1.0 + dark_wander * wandering(dark_keys[c], t, dark_period)
        current = signal_a[c] * lamp_level(t, lamp, lamp_keys) + dark
        new = current * gain[c] * (1.0 + deviation[c])
        v = new
        if since_change[c] < SETTLED * settling:
            left = math.exp(-since_change[c] / settling) - math.exp(-SETTLED)
            v += (current * old_gain[c] * (1.0 + old_deviation[c]) - new) * left
        if noisy > 0.0:
            shot = 2.0 * ELEMENTARY_CHARGE_C * abs(current) * bandwidth
            johnson = 4.0 * BOLTZMANN_J_PER_K * temperature * bandwidth / gain[c]
            spread = math.sqrt((shot + johnson) * gain[c] * gain[c] + noise_v * noise_v)
            v += spread * normal(noise_keys[c], conversion[c])
        volts[c] = v + offset_v
    return volts
