"""Settings of the photodiodes: their converters, amplifiers and angles, and the durations of readings that follow."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from annotated_types import Gt, Le, MaxLen, MinLen

from goniotwin.arrays import Floats
from goniotwin.keys import Fraction, PolarAngle, Positive, Width
from goniotwin.protocols import adam

PERIOD_MARGIN = 1.01
ELEMENTARY_CHARGE_C = 1.602176634e-19
TCP_EXCHANGE_S = 4.0e-4


@dataclass(frozen=True)
class PhotodiodeSettings:
    """The converters, their amplifiers, and the angles of the photodiodes on the two arcs. Channels are numbered through the
    upper arc first.

    `upper_deg`: polar angles of the photodiodes on the upper arc, at shift 0, in the order of their channels. `lower_deg`:
    polar angles of the photodiodes on the lower arc, at shift 0. `gains_v_per_a`: nominal gains of the amplifiers, the lowest
    first. An ADAM-4117 has no outputs to select a gain, and so has one. `kind`: model of the converters. `gain_uncertainty`:
    relative standard uncertainty of each gain. `range_code`: input range of the converters, by the code of this model or of the
    6000 series. `conversions_per_s`: conversions that a module makes in a second, for all of its channels together.
    `settling_s`: time in which the amplifiers settle after a change of gain or pose. `exchange_s`: duration of one request;
    without it that of the model. `raw_format`: number format of the registers, as it is configured on the module. Only an
    ADAM-4117 may have "twos-complement".

    Raises ValueError for an unknown range, gains that do not ascend, and gains that the model cannot select.
    """

    upper_deg: Annotated[tuple[PolarAngle, ...], MinLen(1)]
    lower_deg: tuple[PolarAngle, ...]
    gains_v_per_a: Annotated[tuple[Positive, ...], MinLen(1), MaxLen(4)]
    kind: adam.ModelName
    gain_uncertainty: Fraction = Width(1.0e-3)
    range_code: int = adam.PLUS_MINUS_10_V
    conversions_per_s: Positive = 100.0
    settling_s: Annotated[float, Gt(0.0), Le(600.0)] = 0.25
    exchange_s: Positive | None = None
    raw_format: adam.RawFormat = "unsigned"

    def __post_init__(self) -> None:
        chosen = self.model.range(self.range_code)
        if chosen is None or chosen.current:
            known = ", ".join(adam.code_text(each) for each in sorted(self.model.ranges) if not adam.RANGES[each].current)
            wrong = f"range_code: {adam.code_text(self.range_code)} is not the code of a voltage range of an {self.model.title}"
            raise ValueError(f"{wrong}; give one of {known}")
        self.model.check_raw_format(self.raw_format)
        if tuple(sorted(set(self.gains_v_per_a))) != self.gains_v_per_a:
            raise ValueError(
                "gains_v_per_a: the gains do not ascend; list each once, the lowest first, in the order of the outputs' numbers"
            )
        if len(self.gains_v_per_a) > 1 << self.model.outputs:
            raise ValueError(f"an {self.model.title} has no outputs to select a gain; list the one fixed gain")

    @property
    def request_s(self) -> float:
        """Duration of one request, s."""
        if self.exchange_s is not None:
            return self.exchange_s
        return adam.RTU_EXCHANGE_S if self.model.serial else TCP_EXCHANGE_S

    @cached_property
    def count(self) -> int:
        """Number of photodiodes."""
        return len(self.upper_deg) + len(self.lower_deg)

    @property
    def module_channels(self) -> int:
        """Number of photodiodes behind one module."""
        return adam.CHANNELS

    @property
    def modules(self) -> int:
        """Number of modules of eight channels."""
        return -(-self.count // adam.CHANNELS)

    @property
    def model(self) -> adam.Model:
        """Model of the modules."""
        return adam.MODELS[self.kind]

    @cached_property
    def period_s(self) -> float:
        """Interval of two readings, s: slightly longer than a round of conversions, so that no conversion is read twice.

        On a slow line it is the time to read all modules.
        """
        return PERIOD_MARGIN * max(adam.CHANNELS / self.conversions_per_s, self.modules * self.request_s)

    @cached_property
    def wait_s(self) -> float:
        """From a change of gain or pose to the first reading, s: its conversion must begin after the settling time.

        A value that is read was converted up to one round and one channel before; a change of range loses one round.
        """
        conversion_s = PERIOD_MARGIN * adam.CHANNELS / self.conversions_per_s
        return max(self.settling_s + (1.0 + 1.0 / adam.CHANNELS) * conversion_s, 2.0 * conversion_s)

    @property
    def gain_seconds(self) -> float:
        """Duration of setting the gain of all modules, s; 0 for a fixed gain."""
        return self.modules * self.request_s if self.model.outputs else 0.0

    def fetching_seconds(self, *, after_change: bool) -> float:
        """Duration of the last reading and its checks, of all modules, s; one exchange more after a change of gain."""
        return (3 if after_change and self.model.outputs else 2) * self.modules * self.request_s

    def shot_variance_a2(self, current_a: Floats) -> Floats:
        """Variance (n,) of one reading by the shot noise of photocurrents (n,), A^2."""
        return 2.0 * ELEMENTARY_CHARGE_C * np.abs(current_a) * (0.5 / self.period_s)

    @cached_property
    def range(self) -> adam.Range:
        """Input range of all channels, with the code of the model."""
        chosen = self.model.range(self.range_code)
        assert chosen is not None
        return chosen
