"""The export of a reduced journal, as the command does it."""

from pathlib import Path

from goniotwin.app.campaign.studies.reduced_journal import ReducedJournal
from goniotwin.app.data.conversion import Choice, Converted, Light, convert_reduced
from goniotwin.app.formats import registry


def export(reduced: ReducedJournal, sample: str | None, path: Path, name: str, light: Light | None = None) -> Converted:
    """Write one sample, or all, in the format of this name."""
    return convert_reduced(reduced, path, registry.format_named(name, registry.BSDF), Choice(sample, light))
