"""What the converters of any make are to the engine, the planner and the reduction."""

from typing import Protocol

from goniotwin.arrays import Counts, Flags, Floats, Ints


class ConverterRange(Protocol):
    """The input range of all channels: how volts are counts. Counts are whole numbers, 0 to 65535 at most."""

    @property
    def lsb_v(self) -> float:
        """The step of the converter, V."""

    @property
    def zero(self) -> float:
        """The count of 0 V."""

    @property
    def highest(self) -> int:
        """The highest count."""

    def raw(self, volts: Floats) -> Ints:
        """The counts that the converter gives for voltages, shape of `volts`."""

    def saturated(self, counts: Counts) -> Flags:
        """Which counts are bounds and not readings, shape of `counts`: those at an end of the range."""


class ConverterDescription(Protocol):
    """Converters, amplifiers and photodiodes as their driver knows them without a wire: the operator's table of them.

    `upper_deg` and `lower_deg` are the polar angles at shift 0 of all `count` photodiodes, in this order.
    A module has `module_channels` of them, in this order: the next one begins with the next photodiode.
    The gains `gains_v_per_a` ascend; `gain_uncertainty` is their relative standard uncertainty. Two readings are `period_s`
    apart, and the first follows `wait_s` after a change of gain or pose; setting the gain lasts `gain_seconds`.
    """

    @property
    def upper_deg(self) -> tuple[float, ...]: ...
    @property
    def lower_deg(self) -> tuple[float, ...]: ...
    @property
    def count(self) -> int: ...
    @property
    def module_channels(self) -> int: ...
    @property
    def gains_v_per_a(self) -> tuple[float, ...]: ...
    @property
    def gain_uncertainty(self) -> float: ...
    @property
    def range(self) -> ConverterRange: ...
    @property
    def period_s(self) -> float: ...
    @property
    def wait_s(self) -> float: ...
    @property
    def gain_seconds(self) -> float: ...

    def fetching_seconds(self, *, after_change: bool) -> float:
        """Duration of the last reading and its checks, s; `after_change` of the gain it may be longer."""

    def shot_variance_a2(self, current_a: Floats) -> Floats:
        """Variance (n,) of one reading by the shot noise of photocurrents (n,), A^2."""
