"""What a file holds as the values of its samples: the uncertainties and the mask beside it, and its parts as one list."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from goniotwin.app.data.values import SampleData
from goniotwin.app.formats import registry
from goniotwin.app.formats.content import (
    HORIZON_DEG,
    BsdfFile,
    Part,
    RegularTable,
    ScatteredBsdf,
    axes_of_nodes,
    nodes,
)
from goniotwin.app.formats.file import FormatError, read_head
from goniotwin.app.formats.registry import Format
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Floats
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import round_deg, zenith_and_azimuth


def with_files_beside(path: Path, content: BsdfFile, found: Format) -> BsdfFile:
    """A file's content with the uncertainties and the mask in the files beside it, where its format has no room for them.

    Raises FormatError for a file that has uncertainties or a mask in the place of values.
    """
    if (described := registry.described_table(content)) is not None:
        raise FormatError(path, f"it has {described}, not values", "give the table itself")
    parts, comments = list(content.parts), content.comments
    for about, beside in registry.files_beside(path, found).items():
        if not beside.is_file() or about.encode() not in read_head(beside, registry.HEAD_BYTES):
            continue
        others = found.read(beside).parts
        for k, part in enumerate(parts):
            other = next((each for each in others if _on_one_grid(part, each)), None)
            if other is None:
                comments = (*comments, f"{beside.name} is beside it, and has not the same grid: it is not used")
            elif about == registry.ABOUT_UNCERTAINTY:
                parts[k] = replace(part, u=other.values)
            elif isinstance(part, BsdfTable):
                parts[k] = replace(part, known=other.values == 0.0)
    return replace(content, parts=tuple(parts), comments=comments)


def _on_one_grid(part: Part, other: Part) -> bool:
    """Whether two parts have their values at the same places."""
    axes = {
        BsdfTable: ("psi_deg", "sigma_deg", "phi_deg", "theta_deg"),
        RegularTable: ("psi_deg", "sigma_deg"),
        ScatteredBsdf: ("sigma_deg", "psi_deg", "polar_deg", "azimuth_deg"),
    }[type(part)]
    same = ("sample", "transmitted", "back", "wavelengths_nm", "colours") if type(part) is not ScatteredBsdf else ("sample",)
    return (
        type(part) is type(other)
        and all(np.array_equal(getattr(part, name), getattr(other, name)) for name in axes)
        and all(getattr(part, name) == getattr(other, name) for name in same)
    )


def samples_of(content: BsdfFile) -> dict[str, SampleData]:
    """The values of each sample of a file."""
    return {sample: _sample_of_parts(content.of(sample)) for sample in content.samples}


def remarks_of(content: BsdfFile) -> tuple[str, ...]:
    """The comments on a file and on its parts, each once."""
    return tuple(dict.fromkeys([*content.comments, *(each for part in content.parts for each in part.comments)]))


def _sample_of_parts(content: BsdfFile) -> SampleData:
    """The parts of one sample as one list of values."""
    content = content.of_points()
    pieces = [*map(_sample_of_table, content.tables), *map(_sample_of_scattered, content.scattered)]
    joined = SampleData.join(pieces) if pieces else _sample_of_scattered(_no_values(content.regular))
    return replace(
        joined, gridded=bool(content.tables) and not content.scattered, regular=content.regular, metadata=content.metadata
    )


def _sample_of_table(table: BsdfTable) -> SampleData:
    values = nodes(table)
    _, _, sigma, phi, theta = axes_of_nodes(table)
    polar, _ = zenith_and_azimuth(from_specular(sigma, theta, phi))
    above = polar <= HORIZON_DEG
    return SampleData(values, round_deg(theta[above]), round_deg(phi[above]))


def _sample_of_scattered(values: ScatteredBsdf) -> SampleData:
    theta, phi = values.specular()
    phi = round_deg(phi)
    return SampleData(values, round_deg(theta), np.where(phi >= 360.0, 0.0, phi))


def _no_values(regular: Iterable[RegularTable]) -> ScatteredBsdf:
    some = next(iter(regular))
    none: Floats = np.zeros(0)
    return ScatteredBsdf(none, none, none, none, none, sample=some.sample, generated=some.generated)
