"""The inputs that come in with the readings: their numbers in a `Quantity`, and what a budget calls them.

A number is made of what shares the input: a dark reading, a row, a gain, a photodiode. Effects are those of one standard
uncertainty, so that an input that the readings themselves show has an uncertainty of 1.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.measurement_model.inputs import InputQuantity, quantity
from goniotwin.app.rig import RigFile
from goniotwin.app.rig.inputs import Input
from goniotwin.arrays import Indices, Ints
from goniotwin.keys import MEASURED, origin_of

JOURNAL = "the journal's readings"
LONGEST_PM = 10_000_000
"""Wavelengths are below; a number of wavelength and sample has 32 bits."""
LEAST_CERTIFIED = 1e-5
"""Least relative uncertainty of a gain."""


@dataclass(frozen=True)
class Numbers:
    """The numbers of inputs, for a rig of so many photodiodes and gains: of a million rows they need 32 bits."""

    photodiodes: int
    gains: int

    @classmethod
    def of(cls, rig: RigFile) -> "Numbers":
        """Those of a rig."""
        return cls(rig.photodiodes.count, len(rig.photodiodes.gains_v_per_a))

    def dark(self, dark_readings: Ints, gain: int) -> Indices:
        """Dark readings at a gain: numbers (..., photodiodes)."""
        of_gain = (dark_readings[..., None] * self.gains + gain) * self.photodiodes
        return np.asarray(of_gain + np.arange(self.photodiodes), dtype=np.int32)

    def gain_of_dark(self, numbers: Indices) -> Ints:
        """The gains (...) of dark readings by their numbers."""
        return np.asarray(numbers // self.photodiodes % self.gains)

    def row(self, rows: Ints, gain: Ints) -> Indices:
        """What all photodiodes share that are read at a gain in a row."""
        return np.asarray(rows * self.gains + gain, dtype=np.int32)

    def reading(self, rows: Ints, photodiode: Ints) -> Indices:
        """What a photodiode was read as in a row."""
        return np.asarray(rows * self.photodiodes + photodiode, dtype=np.int32)

    def gain(self, photodiode: Ints, mode: Ints) -> Indices:
        """An uncorrelated mode of the gains of a photodiode."""
        return np.asarray(photodiode * self.gains + mode, dtype=np.int32)


Describe = Callable[[int, RigFile], InputQuantity]


def dark_input(number: int, rig: RigFile) -> InputQuantity:
    """The dark reading of a photodiode at a gain."""
    numbers = Numbers.of(rig)
    rest, photodiode = divmod(number, numbers.photodiodes)
    dark_reading, gain = divmod(rest, numbers.gains)
    return _of_readings(
        f"dark[{photodiode}, {_volts(gain, rig)}]@dark {dark_reading}",
        "rows of this photodiode and gain until the next dark reading, and after the one before",
    )


def lamp_input(number: int, rig: RigFile) -> InputQuantity:
    """What the light of a row's readings at a gain has in common."""
    return _of_readings(f"lamp@{_row(number, rig)}", "all photodiodes of the row at this gain", twin="light.flicker")


def monitor_input(number: int, rig: RigFile) -> InputQuantity:
    """The monitor's reading beside a row's readings at a gain."""
    return InputQuantity(
        f"monitor@{_row(number, rig)}",
        "1",
        rig.monitor.relative_uncertainty,
        "normal",
        "all photodiodes of the row at this gain",
        "[monitor] relative_uncertainty",
        "monitor.noise",
        origin=origin_of(rig.monitor.relative_uncertainty),
    )


def gain_input(number: int, rig: RigFile) -> InputQuantity:
    """The gain of a photodiode's channel, by its place in the rig's list: of two that were compared, what is left of it."""
    photodiode, gain = divmod(number, Numbers.of(rig).gains)
    return InputQuantity(
        f"gain_ratio[{photodiode}, {_volts(gain, rig)}]",
        "1",
        certified_gain(rig),
        "normal",
        "all values of this photodiode at this gain",
        "[photodiodes] gain_uncertainty, and rows at two gains",
        "electronics.gain_spread",
        origin=origin_of(rig.photodiodes.gain_uncertainty),
    )


def etalon_input(number: int, rig: RigFile) -> InputQuantity:
    """The reading of the etalon by a photodiode."""
    row, photodiode = divmod(number, Numbers.of(rig).photodiodes)
    return _of_readings(f"etalon_reading[{photodiode}]@row {row}", "all values that divide by it")


def signature_input(number: int, rig: RigFile) -> InputQuantity:
    """The reading without a sample by a photodiode."""
    row, photodiode = divmod(number, Numbers.of(rig).photodiodes)
    return _of_readings(f"signature_reading[{photodiode}]@row {row}", "all values from which it is subtracted")


def calibration_input(number: int, rig: RigFile) -> InputQuantity:
    """The factor of a photodiode from the overlaps of a sample."""
    sample, photodiode = divmod(number, rig.photodiodes.count)
    return _of_readings(f"calibration[{photodiode}]@sample {sample}", "all values of the sample by this photodiode")


def band_shape_input(number: int, rig: RigFile) -> InputQuantity:
    """What the parabola over the wavelengths does not resolve of a sample's spectrum, at a wavelength in pm."""
    del rig
    sample, wavelength = divmod(number, LONGEST_PM)
    return _of_readings(f"band_shape[{1e-3 * wavelength:g} nm]@sample {sample}", "all values of the sample at this wavelength")


def certified_gain(rig: RigFile) -> float:
    """The relative standard uncertainty of a gain by its certificate; 0 would be a missing one."""
    return max(rig.photodiodes.gain_uncertainty, LEAST_CERTIFIED)


def monitor_variance(rig: RigFile) -> float:
    """Relative variance of a quotient of two rows by the monitor's reading in each."""
    return 2.0 * rig.monitor.relative_uncertainty**2


def _of_readings(name: str, shared_by: str, twin: str = "") -> InputQuantity:
    return InputQuantity(name, "1", 1.0, "normal", shared_by, JOURNAL, twin, origin=MEASURED)


def _row(number: int, rig: RigFile) -> str:
    row, gain = divmod(number, Numbers.of(rig).gains)
    return f"row {row}, {_volts(gain, rig)}"


def _volts(gain: int, rig: RigFile) -> str:
    return f"{rig.photodiodes.gains_v_per_a[gain]:g} V/A"


def signature_common(number: int, rig: RigFile) -> InputQuantity:
    """What the signature is with a sample mounted, over what it is without one."""
    del number
    origin = origin_of(rig.sample_unit.signature_uncertainty)
    return InputQuantity(
        "signature", "1", 1.0, "normal", "all values", "[sample_unit] signature_uncertainty", "", origin=origin
    )


def declared_input(each: Input) -> Describe:
    """A declared input that all values have in common by their readings."""

    def describe(number: int, rig: RigFile) -> InputQuantity:
        del number
        source = quantity(each, rig.uncertainty)
        return replace(source, u=source.u or 1.0)  # of one without an uncertainty values have nothing

    return describe
