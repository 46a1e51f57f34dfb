"""Photodiodes that the drift checks could not watch: those to which what was mounted sent too little light at their pose."""

from collections.abc import Mapping

import numpy as np

from app.campaign.journal.recorded import Committed
from app.campaign.reducing.drifting import CERTAIN
from app.campaign.reducing.points import BsdfPoints
from app.campaign.reducing.signals import Flags, Signal
from app.campaign.spoken import numbers

A_TENTH = 0.1
"""A loss of so much that would not be certain leaves a photodiode unwatched."""


def unseen(rows: list[Committed], signals: Mapping[int, Signal]) -> dict[str, Flags]:
    """By what was mounted, the photodiodes (n,) of which a drift check could not have told that a tenth of the light is lost.

    `rows` in order of time, the `signals` of drift rows by their numbers. Of campaigns without drift checks nothing.
    """
    found: dict[str, Flags] = {}
    for each in rows:
        if each.row.kind == "drift" and not each.row.added and each.row.number in signals:
            sample = each.row.sample
            # What the first check saw is what the others are compared with.
            found.setdefault(sample, ~_seen(signals[each.row.number]))
    return found


def _seen(first: Signal) -> Flags:
    light = np.nan_to_num(first.ratio)
    # A change is that of two checks of one uncertainty. One over the range shows no loss until it is below.
    uncertain = CERTAIN * np.sqrt(2.0 * np.nan_to_num(first.variance))
    return np.asarray((light > 0.0) & (uncertain < A_TENTH * light))


def unwatched(found: Mapping[str, Flags], samples: Mapping[str, BsdfPoints], etalon: str) -> dict[str, tuple[int, ...]]:
    """The same, of those photodiodes alone whose values a reader would trust: a sample's own, the etalon's for all samples."""
    own = {name: np.unique(points.photodiode[points.good & ~points.under_range]) for name, points in samples.items()}
    if own:
        own[etalon] = np.unique(np.concatenate(list(own.values())))
    told = {name: tuple(k for k in own[name].tolist() if found[name][k]) for name in found if name in own}
    return {name: photodiodes for name, photodiodes in told.items() if photodiodes}


def in_words(name: str, photodiodes: tuple[int, ...]) -> str:
    """Of one thing that was mounted."""
    return (
        f"drift checks of {name} saw no light, or too little to tell that a tenth of it is lost, on photodiodes "
        f"{numbers(photodiodes)}: a fault of theirs would pass"
    )
