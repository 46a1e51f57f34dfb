"""Lumicept .sdr and .sdt files: the regular reflectance, or transmittance, against the angle of incidence sigma.

The style is that of .ddr: words, `;;` comments, `Source`, `TypeColorModel`, one list `sigma`, for each channel a block `bw`,
`red`, `gre`, `blu` or `wl` with `def`, one number for each sigma, `enddef`. A number is the factor itself, 0 to 1.

No specification is public. These facts are those of libbsdf (https://github.com/KimuraRyo/libbsdf: src/Reader/SdrReader.cpp,
src/Writer/SdrWriter.cpp), which takes header keywords in exactly this spelling, no `kbdf`, and of the colours only the short
keywords. It extrapolates linearly outside the list, so a file is written with sigma 0..90.
"""

import difflib
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, RegularTable
from goniotwin.app.formats.coverage import covered_regular, uncovered
from goniotwin.app.formats.ddr import BLOCKS, RGB, SOURCES, SPELLINGS, Channel, channel_name, take_channel
from goniotwin.app.formats.file import FormatError, name_file, quote_word
from goniotwin.app.formats.notes import noted, read_notes
from goniotwin.app.formats.numerals import NUMBER, format_angles, format_number, format_row
from goniotwin.app.formats.text import Words, comment_lines, header_words, mark_comments, write_text
from goniotwin.arrays import Floats

HEADER = ("Source", "TypeColorModel", "sigma")
OF_DDR = {"typesym", "typedata", "psi", "phi", "theta", "sigmat"}
IN_BLOCK = {*BLOCKS, "def", "enddef"}


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is a .sdr or a .sdt file."""
    words = header_words(head, ";;", ("kbdf", "def"))
    return "sigma" in words and not words.isdisjoint({"source", "typecolormodel"}) and words.isdisjoint(OF_DDR)


def read(path: Path) -> BsdfFile:
    """Read a .sdr file, or a .sdt file, which is of transmitted light by its suffix alone. Raises FormatError."""
    with name_file(path):
        table = _Reader(Words(path, ";;"), transmitted=path.suffix.lower() == ".sdt").table()
    return BsdfFile((uncovered(table),))


def write(path: Path, content: BsdfFile) -> None:
    """Write the one table of regular factors of a file, completely or not at all. Raises FormatError."""
    if len(content.parts) != 1 or not content.regular:
        wrong = f"it has {len(content.parts)} parts, of which {len(content.regular)} are of regular factors; give one"
        raise FormatError(path, wrong, "write its parts in files of their own")
    table = content.regular[0]
    if table.psi_deg.tolist() != [0.0]:
        wrong = "the regular factors are of an anisotropic sample (psi), and a .sdr has sigma alone"
        raise FormatError(path, wrong, "use .ssdd")
    if table.colours not in ((), RGB):
        raise FormatError(path, f"it has the colours {', '.join(table.colours)}, and a .sdr has RGB", "use .ssdd")
    table = covered_regular(table)
    model = f"spectral {len(table.wavelengths_nm)}" if table.wavelengths_nm else "RGB" if table.colours else "BW"
    comments = comment_lines(content.heading(noted(table)), ascii_only=True)
    lines = [
        *mark_comments(comments, ";;"),
        f"Source {'Generated' if table.generated else 'Measured'}",
        f"TypeColorModel {model}",
        f"sigma {table.sigma_deg.size}",
        f" {format_angles(path, 'sigma', table.sigma_deg)}",
    ]
    if table.wavelengths_nm:
        format_angles(path, "wl", np.array(table.wavelengths_nm))
    keywords = [f"wl {format_number(nm)}" for nm in table.wavelengths_nm or ()]
    for keyword, values in zip(
        keywords or [SPELLINGS[colour][0] for colour in table.colours] or ["bw"], table.values, strict=True
    ):
        lines += [keyword, " def", f" {format_row(values[0].tolist())}", " enddef"]
    write_text(path, "\n".join(lines) + "\n")


class _Reader:
    def __init__(self, words: Words, *, transmitted: bool) -> None:
        self.words = words
        self.transmitted = transmitted
        self.seen: set[str] = set()
        self.source, self.model, self.count = "Measured", "RGB", 3

    def table(self) -> RegularTable:
        sigma = self._header()
        channels: list[Channel] = []
        values = []
        for _ in range(self.count):
            channels.append(take_channel(self.words, self.model, channels, self.count, stated="TypeColorModel" in self.seen))
            if self.words.peek() == "kbdf":
                raise self.words.error("a .sdr has no kbdf, and other programs misread it", "multiply the values by it")
            self.words.expect("def")
            values.append(self.words.block(f"def of {channel_name(channels[-1])}", 1, sigma.size, IN_BLOCK))
            self.words.expect("enddef")
        if self.words.peek() is not None:
            word = self.words.take("the end")
            wrong = f"{quote_word(word)} follows the last of the {self.count} blocks of TypeColorModel"
            raise self.words.error(wrong, "remove it, or correct TypeColorModel")
        notes = read_notes(self.words.top_comments)
        return RegularTable(
            sigma_deg=sigma,
            values=np.array(values),
            wavelengths_nm=tuple(each for each in channels if isinstance(each, float)) or None,
            colours=RGB if self.model == "RGB" else (),
            transmitted=self.transmitted,
            back=notes.back,
            sample=notes.sample,
            generated=self.source == "Generated",
            comments=notes.comments,
        )

    def _header(self) -> Floats:
        sigma = None
        while (word := self.words.peek()) is not None and word not in IN_BLOCK:
            word = self.words.take("a keyword")
            name = {known.lower(): known for known in HEADER}.get(word.lower())
            if name is None:
                near = difflib.get_close_matches(word, HEADER, 1)
                remedy = f"did you mean {near[0]}?" if near else "remove it"
                remedy = "correct the list before it, or its count" if NUMBER.fullmatch(word) else remedy
                raise self.words.error(f"{quote_word(word)} is not a keyword of a .sdr file", remedy)
            if name in self.seen:
                raise self.words.error(f"{name} is given twice", "remove one of them")
            self.seen.add(name)
            if name == "sigma":
                sigma = self.words.angles(name, 90.0)
            elif name == "Source":
                self.source = self.words.one_of(name, SOURCES)
            else:
                self.model = self.words.one_of(name, ("BW", "RGB", "spectral"))
                self.count = self.words.count("wavelengths") if self.model == "spectral" else 1 if self.model == "BW" else 3
        if sigma is None:
            raise FormatError(self.words.path, "sigma is missing", "add it before the data")
        return sigma
