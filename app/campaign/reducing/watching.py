"""Photodiodes that the drift checks could not watch: those to which what was mounted sent too little light at their pose."""

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from goniotwin.app.campaign.journal.recorded import Committed
from goniotwin.app.campaign.reducing.drifting import CERTAIN
from goniotwin.app.campaign.reducing.signals import Signal
from goniotwin.app.campaign.spoken import numbers
from goniotwin.arrays import Flags

A_TENTH = 0.1
"""A loss of so much that would not be certain leaves a photodiode unwatched."""


def unseen(rows: Iterable[Committed], signal_of: Callable[[Committed], Signal]) -> dict[str, Flags]:
    """By what was mounted, the photodiodes (n,) of which a drift check could not have told that a tenth of the light is lost.

    `rows` in order of time, of which only drift checks count. Of campaigns without drift checks nothing.
    """
    found: dict[str, Flags] = {}
    for each in rows:
        # What the first check saw is what the others are compared with.
        if each.row.kind == "drift" and not each.row.added and each.data.readings and each.row.sample not in found:
            found[each.row.sample] = ~_seen(signal_of(each))
    return found


def _seen(first: Signal) -> Flags:
    light = np.nan_to_num(first.ratio)
    # A change is that of two checks of one uncertainty. One over the range shows no loss until it is below.
    uncertain = CERTAIN * np.sqrt(2.0 * np.nan_to_num(first.variance))
    return np.asarray((light > 0.0) & (uncertain < A_TENTH * light))


def unwatched(found: Mapping[str, Flags], trusted: Mapping[str, set[int]], etalon: str) -> dict[str, tuple[int, ...]]:
    """The same, of those photodiodes alone whose values a reader would trust: a sample's own, the etalon's for all samples."""
    own = {**trusted, etalon: set().union(*trusted.values())} if trusted else {}
    told = {name: tuple(k for k in sorted(own[name]) if found[name][k]) for name in found if name in own}
    return {name: photodiodes for name, photodiodes in told.items() if photodiodes}


def in_words(name: str, photodiodes: tuple[int, ...]) -> str:
    """Of one thing that was mounted."""
    return (
        f"drift checks of {name} saw no light, or too little to tell that a tenth of it is lost, on photodiodes "
        f"{numbers(photodiodes)}: a fault of theirs would pass"
    )
