"""What a rehearsal finds in its own points: samples that get no value, and why, and photodiodes that nothing watches."""

from collections.abc import Iterator, Mapping

from goniotwin.app.campaign.reducing.tally import FIRST, Tally
from goniotwin.app.campaign.reducing.watching import in_words
from goniotwin.app.campaign.schedule.file import ScheduleFile

REASONS = {
    "shadowed": ("hidden by the mirror unit", "take other angles"),
    "uncertified": ("not in the etalon's certificate", "take one that holds for them"),
    "no-etalon": ("without a signal of the etalon", "take one that scatters on the side that the photodiodes look at"),
    "clipped": ("over the range at every gain", "add a lower gain"),
    "dead": ("of dead photodiodes", "mend them"),
    "drift": ("flagged for drift", "see the drift checks"),
}
"""By the flags of points, in words, with what to do."""


def worthless(file: ScheduleFile, tallies: Mapping[str, Tally], unwatched: Mapping[str, tuple[int, ...]]) -> Iterator[str]:
    """A warning for each."""
    for name in file.samples:
        tally = tallies.get(name)
        if tally is None:
            yield f"{name} gets no value at all: there is no row of the etalon that it could be compared with"
        elif not tally.good:
            yield f"{name} gets no value at all: of {tally.directions} directions {_why(tally)}"
        elif tally.under_range == tally.good:
            yield (
                f"{name} gets no value that is more than its noise in any of {tally.good} directions: it sends too "
                "little light there; take a higher gain or more readings, or see that sample, side and light are right"
            )
    for name, photodiodes in unwatched.items():
        yield (
            f"{in_words(name, photodiodes)}; take a [drift] pose at which more of them have light, or end with the etalon once "
            "more as a last sample under another name, whose values have to be the certificate's"
        )


def _why(tally: Tally) -> str:
    found = {flag: tally.flagged[flag] for flag in FIRST if tally.flagged[flag]}
    told = [f"{count} are {REASONS[flag][0]}" for flag, count in found.items()]
    left = tally.directions - sum(found.values())
    if left:
        told.append(f"{left} have none for another reason")
    return f"{', '.join(told)}; {', '.join(REASONS[flag][1] for flag in found) or 'look at the journal'}"
