"""Formula 1's ratio: a sample's signals over the etalon's, by photodiode, each without the instrument's own light."""

from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.reducing.signals import Signal
from goniotwin.app.rig import RigDescription
from goniotwin.arrays import Flags, Floats, Ints


@dataclass(frozen=True)
class Ratio:
    """Sample over etalon, both without the signature: `value` with the `variance` of noise and what is relative to it."""

    value: Floats
    variance: Floats
    relative_variance: Floats
    sample: Floats
    var_sample: Floats
    etalon: Floats
    var_etalon: Floats
    clipped: Flags
    signature: Floats

    @classmethod
    def of(
        cls, rig: RigDescription, sample: Signal, etalon: Signal, own: Signal | None, at_etalon: Signal | None, *, c: Ints
    ) -> "Ratio":
        """Of the photodiodes `c`."""
        g, var_g, cut_g = _taken(own, c)
        h, var_h, cut_h = _taken(at_etalon, c)
        total = sample.ratio[c]
        # With a sample in its place the instrument's own light is not quite what it is without.
        other = rig.file.sample_unit.signature_uncertainty
        s, var_s = total - g, sample.variance[c] + var_g + (other * g) ** 2
        e, var_e = etalon.ratio[c] - h, etalon.variance[c] + var_h + (other * h) ** 2
        value = s / np.where(e == 0.0, np.nan, e)
        # What is subtracted from both is one and the same error.
        shared = 2.0 * value * var_g if own is at_etalon else 0.0
        variance = (var_s + value**2 * var_e - shared) / e**2
        monitor = 2.0 * rig.file.monitor.relative_uncertainty**2
        other_gain = sample.gain[c] != etalon.gain[c]
        gain = np.where(other_gain, 2.0 * rig.file.photodiodes.gain_uncertainty**2, 0.0)
        clipped = sample.clipped[c] | etalon.clipped[c] | cut_g | cut_h
        share = np.full(len(c), np.nan) if own is None else g / np.where(total == 0.0, np.nan, total)
        return cls(value, variance, monitor + gain, s, var_s, e, var_e, clipped, share)


def _taken(signature: Signal | None, c: Ints) -> tuple[Floats, Floats, Flags]:
    if signature is None:
        return np.zeros(len(c)), np.zeros(len(c)), np.zeros(len(c), dtype=bool)
    return signature.ratio[c], signature.variance[c], signature.clipped[c]
