"""Whether differences are as great as their uncertainties allow: one rule for all checks of a campaign against itself."""

import math

CHANCE = 1e-6
"""Of the worst of all differences, where the uncertainties are right."""
DEVIATIONS = 5.0
"""Of the chi-square distribution."""


def plausible(pairs: int, chi_square: float, worst: float) -> bool:
    """Whether `chi_square` of so many `pairs` is within five standard deviations of its distribution, and the `worst` of
    them, in its standard uncertainties, no worse than chance allows.
    """
    if not pairs:
        return True
    most = math.sqrt(2.0 * math.log(pairs / CHANCE))
    return chi_square <= pairs + DEVIATIONS * math.sqrt(2.0 * pairs) and worst <= most
