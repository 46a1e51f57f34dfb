"""What a rehearsal finds in its own points: samples that get no value, and why, and photodiodes that nothing watches."""

from collections.abc import Iterator

import numpy as np

from app.campaign.reducing.points import BsdfPoints
from app.campaign.reducing.reduction import Reduced
from app.campaign.reducing.watching import in_words
from app.campaign.schedule.file import ScheduleFile

REASONS = {
    "shadowed": ("hidden by the mirror unit", "take other angles"),
    "uncertified": ("not in the etalon's certificate", "take one that holds for them"),
    "no-etalon": ("without a signal of the etalon", "take one that scatters on the side that the photodiodes look at"),
    "clipped": ("over the range at every gain", "add a lower gain"),
    "dead": ("of dead photodiodes", "mend them"),
    "drift": ("flagged for drift", "see the drift checks"),
}
"""By the flags of points, in words, with what to do; the first that holds for a point is told."""


def worthless(file: ScheduleFile, reduced: Reduced) -> Iterator[str]:
    """A warning for each."""
    for name in file.samples:
        points = reduced.samples.get(name)
        if points is None:
            yield f"{name} gets no value at all: there is no row of the etalon that it could be compared with"
        elif not points.good.any():
            yield f"{name} gets no value at all: of {points.bsdf.size} directions {_why(points)}"
        elif points.under_range[points.good].all():
            yield (
                f"{name} gets no value that is more than its noise in any of {points.good.sum()} directions: it sends too "
                "little light there; take a higher gain or more readings, or see that sample, side and light are right"
            )
    for name, photodiodes in reduced.unwatched.items():
        yield (
            f"{in_words(name, photodiodes)}; take a [drift] pose at which more of them have light, or end with the etalon once "
            "more as a last sample under another name, whose values have to be the certificate's"
        )


def _why(points: BsdfPoints) -> str:
    left = np.ones(points.bsdf.size, dtype=bool)
    told, remedies = [], []
    for flag, (words, remedy) in REASONS.items():
        here = left & points.flags[flag]
        if here.any():
            told.append(f"{here.sum()} are {words}")
            remedies.append(remedy)
            left &= ~here
    if left.any():
        told.append(f"{left.sum()} have none for another reason")
    return f"{', '.join(told)}; {', '.join(remedies) or 'look at the journal'}"
