"""Which light leaves the monochromator: that of the wavelength set, and in the grating's second order that of half of it."""

from dataclasses import dataclass

SHORTEST_NM = 355.0
"""The lamp's bulb lets nothing through up to here, so that up to 710 nm there is no second order."""


@dataclass(frozen=True)
class WheelFilter:
    """A long-pass filter in a position of the wheel: `transmittance` from `cut_on_nm` on, and nothing below."""

    position: int
    cut_on_nm: float
    transmittance: float = 0.9

    def passes(self, wavelength_nm: float) -> float:
        """The share of light of a wavelength that it lets through."""
        return self.transmittance if wavelength_nm >= self.cut_on_nm else 0.0


@dataclass(frozen=True)
class OrderSorting:
    """What sorts the orders. A position of the wheel without a filter is open.

    `second_order` is the share of light of half the wavelength that passes, of what would pass were the grating set to it.
    """

    second_order: float = 0.0
    filters: tuple[WheelFilter, ...] = ()

    def passing(self, wavelength_nm: float, position: int) -> list[tuple[float, float]]:
        """Wavelengths in nm, each with the share of its light that passes, for a wavelength set and a position of the wheel."""
        orders = [(wavelength_nm, 1.0)]
        half = 0.5 * wavelength_nm
        if self.second_order > 0.0 and half > SHORTEST_NM:
            orders.append((half, self.second_order))
        for each in self.filters:
            if each.position == position:
                orders = [(nm, share * each.passes(nm)) for nm, share in orders]
        return orders
