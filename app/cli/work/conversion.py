"""The conversion of a data file (journal) or another file."""

import os
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_to_files
from goniotwin.app.cli.output import answer, print_error, print_warning
from goniotwin.app.data.conversion import (
    Choice,
    Light,
    Side,
    archive_journal,
    check_samples,
    convert_file,
    convert_reduced,
    format_to_write,
    is_journal,
    parse_wavelength,
    refuse_itself,
)
from goniotwin.app.formats.fills import Fill


def convert_to_file(
    source: Path,
    out: Path,
    name: str | None,
    options: tuple[str | None, Light | None, Side | None, str | None, Fill],
    without_damaged: bool,
    as_json: bool,
    *,
    of_journal: bool,
) -> None:
    """Convert a file or a journal, and print the result. Raises UserError."""
    sample, light, side, wavelength, fill = options
    form, choice = format_to_write(out, name), Choice(sample, light, side, parse_wavelength(wavelength), fill)
    refuse_itself(source, out, form)
    result: dict[str, Any] = {}
    lines: list[str] = []
    damage, findings = "", []
    if of_journal or is_journal(source):
        folder = Path(os.path.realpath(out)).parent
        with Journal.open(source) as opened:
            check_samples(opened, out, form, choice)
            with reduce_to_files(opened, folder, without_damaged=without_damaged) as reduced:
                chain = opened.chain
                if form.name == "archive" and choice.everything:
                    converted = archive_journal(opened, reduced, out, choice, without_damaged=without_damaged)
                else:
                    converted = convert_reduced(reduced, out, form, choice)
        damage, findings = chain.damage, list(reduced.findings)
        result = {"chain": chain, "damaged": sorted(chain.without_values), "findings": findings}
        lines = [reduced.chain]
    else:
        converted = convert_file(source, out, form, choice)
    mark = "SIMULATED, " if converted.simulated else ""
    lines = [f"{mark}{converted.values} measured values: {', '.join(map(str, converted.files))}", *lines]
    if (line := converted.unmeasured_line) is not None:
        lines.append(line)
    answer(as_json, {**converted.as_dict(), **result}, lambda: print("\n".join(lines)))
    for finding in (*converted.notes, *findings):
        print_warning(finding)
    if damage:
        print_error(f"{source}: exported without what differs from what was measured: {damage}")
