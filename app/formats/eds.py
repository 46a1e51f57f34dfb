"""Text files of engineered diffusers by VIAVI (RPC Photonics): EDS10 and the like. Read; a folder of files is one table.

    !!EDS10 10-345  RPC Photonics 10/29/2014
    !!BSDF Data
    10 345
    0 0 2.153

Lines that begin with !! are comments. Then come polar angle and azimuth of the incidence, and lines of polar angle, azimuth and
value in 1/sr; the direction along the normal is there for every azimuth. A file has one incidence. None states from where
azimuths count: it follows from where the light goes, and a comment states what was found. None states that the light is
transmitted either, but that is what these diffusers do. No public reader was found: the layout is that of the files.
"""

import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.file import name_file
from goniotwin.app.formats.lists import Lines, files_of, incidences, opposite, turned
from goniotwin.arrays import Floats

FIRST_LINE = re.compile(rb"\A(?:\xef\xbb\xbf)?\s*!!(?:[^\r\n]*[\r\n]\s*!!)*[^\r\n]*(?:BSDF|RPC Photonics|VIAVI)", re.IGNORECASE)
ASSUMED_TRANSMITTED = "the file does not state whether the light is reflected or transmitted: these diffusers transmit"


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` begins with comments of !! that name the BSDF or the maker."""
    return bool(FIRST_LINE.match(head))


def read(path: Path) -> BsdfFile:
    """Read a file, or all files of a folder: one part for each diffuser. Raises FormatError."""
    found: dict[str, list[tuple[Floats, Floats, Floats]]] = {}
    comments: dict[str, list[str]] = {}
    for file in files_of(path, recognise):
        lines = Lines(file)
        is_comment = np.fromiter((line.lstrip().startswith("!!") for line in lines.lines), np.bool_, len(lines.lines))
        texts = [lines.lines[at].strip().removeprefix("!!").strip() for at in np.flatnonzero(is_comment)]
        name = next((word for text in texts for word in text.split()[:1]), "")
        found.setdefault(name, []).append(incidences(lines, np.flatnonzero(~is_comment & (lines.counts > 0))))
        comments.setdefault(name, []).extend(texts)
    with name_file(path):
        return BsdfFile(tuple(_list(name, blocks, comments[name]) for name, blocks in found.items()))


def _list(name: str, blocks: Iterable[tuple[Floats, Floats, Floats]], comments: list[str]) -> ScatteredBsdf:
    light, out, values = (np.concatenate(each) for each in zip(*blocks, strict=True))
    forward = _goes_to_azimuth_of_incidence(light, out, values)
    psi, azimuth, isotropic = turned(opposite(light[:, 1]) if forward else light[:, 1], out[:, 1])
    whose = "the direction in which the light goes on" if forward else "the light"
    comments = [*comments, f"the azimuth of the incidence is that of {whose}, as the values show", ASSUMED_TRANSMITTED]
    return ScatteredBsdf(
        light[:, 0],
        psi,
        out[:, 0],
        azimuth,
        values,
        transmitted=np.full(values.size, True),
        sample=name,
        isotropic=isotropic,
        comments=tuple(dict.fromkeys(comments)),
    )


def _goes_to_azimuth_of_incidence(light: Floats, out: Floats, values: Floats) -> bool:
    """Whether most light leaves in the half space of the azimuth of the incidence."""
    polar, azimuth = np.radians(out[:, 0]), np.radians(out[:, 1] - light[:, 1])
    towards = values * np.sin(np.radians(light[:, 0])) * np.sin(polar) ** 2 * np.cos(polar) * np.cos(azimuth)
    return bool(towards.sum() >= 0.0)
