"""Writing a content in a format of the registry: what the format has to hold, and the files beside the one that has no room."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import ABSENT, BsdfFile, Part, RegularTable, ScatteredBsdf, write_gaps
from goniotwin.app.formats.file import replace_files
from goniotwin.app.formats.registry import (
    ABOUT_MASK,
    ABOUT_UNCERTAINTY,
    PRIMARIES,
    Format,
    Holds,
    check_files,
    check_holds,
    files_beside,
)
from goniotwin.app.formats.table import BsdfTable


def write(path: Path, content: BsdfFile, found: Format, reported: list[str] | None = None) -> tuple[Path, ...]:
    """Write a file; what it cannot hold of uncertainties and mask goes to files of the same grid beside it.

    Returns the files; `reported` gets what the codec reports. Raises FormatError, before anything is written, for what the
    format does not hold.
    """
    check_holds(path, found, content_needs(content))
    check_files(path, found)
    content = write_gaps(content)
    places = files_beside(path, found)
    files, notes = [path], []
    with replace_files(path, *places.values()) as (spare, *spares):
        for (about, beside), other in zip(places.items(), spares, strict=True):
            mark = f"{about}{path.name}, in the place of the values: same unit, same grid"
            mark += "; 0 where measured, 1 where not" if about is ABOUT_MASK else ""
            parts = tuple(made for part in content.parts if (made := _beside(part, about, mark)) is not None)
            if not parts:
                continue
            found.write(other, replace(content, parts=parts))
            files.append(beside)
            what = "standard uncertainties of the values" if about is ABOUT_UNCERTAINTY else "mask of what was not measured"
            notes.append(f"{what}: in {beside.name}, on the same grid")
        written = found.write(spare, replace(content, parts=tuple(_with_notes(part, notes) for part in content.parts)))
    if reported is not None:
        reported += written
    return tuple(files)


def _beside(part: Part, about: str, mark: str) -> Part | None:
    """A part with its uncertainties, or its mask, in the place of the values; None where it has none."""
    comments = (mark, *part.comments)
    if about is ABOUT_MASK:
        if not isinstance(part, BsdfTable) or part.known is None or part.known.all():
            return None
        return replace(part, values=np.where(part.known, 0.0, 1.0), u=None, known=None, comments=comments)
    if part.u is None:
        return None
    if isinstance(part, ScatteredBsdf):
        if np.isnan(part.u).all():
            return None
        u = np.where(np.isnan(part.u), np.abs(part.values), part.u)  # of such a value nothing is known
        return replace(
            part, values=u, u=ABSENT, u_shared=ABSENT, low95=ABSENT, high95=ABSENT, interval=ABSENT, comments=comments
        )
    return replace(part, values=part.u, u=None, comments=comments)


def _with_notes(part: Part, notes: list[str]) -> Part:
    return replace(part, comments=(*part.comments, *notes)) if notes else part


def content_needs(content: BsdfFile) -> frozenset[Holds]:
    """What a format has to hold for a content; its uncertainties and its mask may go to files beside it."""
    needs, sides = set[Holds](), set[bool]()
    for part in content.parts:
        of_part, back = _part_needs(part)
        needs |= of_part
        sides |= back
    if needs.issuperset({Holds.REFLECTED, Holds.TRANSMITTED}):
        needs.add(Holds.LIGHTS)
    if len(sides) > 1:
        needs.add(Holds.SIDES)
    if len(content.samples) > 1:
        needs.add(Holds.SAMPLES)
    return frozenset(needs)


def _part_needs(part: Part) -> tuple[set[Holds], set[bool]]:
    """What a format has to hold for a part, and whether it is lit on the back."""
    if isinstance(part, ScatteredBsdf):
        channels = np.unique(part.wavelength_nm[np.isfinite(part.wavelength_nm)]).size
        kind, colours = Holds.POINTS, set(np.unique(part.channel).tolist()) - {""}
        psi = 1 if part.isotropic else np.unique(part.psi_deg).size
        sigmas, lights, sides = np.unique(part.sigma_deg).size, set(part.transmitted.tolist()), set(part.back.tolist())
    else:
        kind = Holds.REGULAR if isinstance(part, RegularTable) else Holds.GRID
        channels, colours = len(part.wavelengths_nm or (0.0,)), set(part.colours)
        sigmas, psi, lights, sides = part.sigma_deg.size, part.psi_deg.size, {part.transmitted}, {part.back}
    several = {Holds.SIGMAS: sigmas, Holds.WAVELENGTHS: channels, Holds.PSI: psi}
    of_colours = {PRIMARIES.get(frozenset(colours), Holds.COLOURS)} if colours else set[Holds]()
    of_light = {Holds.TRANSMITTED if transmitted else Holds.REFLECTED for transmitted in lights}
    return {kind, *of_light, *of_colours, *(each for each, count in several.items() if count > 1)}, sides
