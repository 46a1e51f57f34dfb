"""What a campaign was to measure and has no values of, and angles that are in doubt, for whoever reads the rest."""

from collections import Counter
from collections.abc import Iterator, Mapping

from goniotwin.app.campaign.journal.reading import Recorded

GO_ON = "goniotwin run --resume measures them"


def missing(journal: Recorded, without_etalon: Mapping[str, int]) -> Iterator[str]:
    """Notes: whether it is finished, rows that were skipped, axes whose encoders stood off, and rows `without_etalon`, by
    sample, that nothing scales.
    """
    done, of = journal.counted()
    skipped = journal.skipped()
    if done + len(skipped) < of:
        yield f"the campaign is not finished: {done} of {of} rows are done"
    if skipped:
        samples = Counter(row.sample for row in journal.planned() if row.number in skipped)
        told = ", ".join(f"{count} of {sample}" for sample, count in samples.items())
        yield f"rows that were skipped for faults and have no values: {told}; {GO_ON}"
    yield from journal.told("encoder")
    for sample, rows in without_etalon.items():
        yield f"{sample}: no values, or not all, in rows at whose poses the etalon was not measured: {rows}"
