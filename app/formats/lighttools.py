"""LightTools tabular .bsdf files, which are only read: front and back, reflection and transmission in one file.

A header (`Symmetry`, `SpectralContent`, `ScatterAzimuth` and `ScatterRadial` with count and list), `DataBegin`; then blocks of
`AOI`, `POI`, `Side`, `Wavelength`, `ScatterType`, of tristimulus data `TristimulusValue`, `TIS x`, and a row of radial values
for each azimuth; `DataEnd`. Azimuth and radial are ordinary spherical angles about the normal, values BSDF in 1/sr.

The description of the vendor is not public. These facts are those of libbsdf (https://github.com/KimuraRyo/libbsdf:
src/Reader/LightToolsBsdfReader.cpp), as a comment of what is read states: the light comes from azimuth 90 of the file, an AOI
above 90 is 0, and plane-symmetric data of half the azimuths have their mirror image in the plane of incidence.
"""

import difflib
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.file import FormatError, name_file, quote_word
from goniotwin.app.formats.text import Words, header_words
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, TOLERANCE_DEG, wrap_azimuth

LIGHT_DEG = 90.0
"""The azimuth of the light, by libbsdf."""
SYMMETRIES = ("PlaneSymmetrical", "Asymmetric")
CONTENTS = ("Monochrome", "XYZ")
TRISTIMULUS = ("TrisX", "TrisY", "TrisZ")
HEADER = ("Symmetry", "SpectralContent", "ScatterAzimuth", "ScatterRadial")
OTHER_HEADER = ("Source", "ScatterType", "SampleRotation")
OF_BLOCK = ("AOI", "POI", "Side", "Wavelength", "ScatterType", "TristimulusValue", "TIS")
CONVENTION = (
    "LightTools .bsdf read by libbsdf's convention, which no description of the vendor confirms: the light is at azimuth 90"
)


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is LightTools: it states the incidence in its blocks, Zemax in its header."""
    words = header_words(head, "#", ("databegin",))
    return {"scatterazimuth", "scatterradial"} <= words and "angleofincidence" not in words and "aoi" in header_words(head, "#")


@dataclass
class _Block:
    """What a block of data states; `incidence_deg` and the words may be missing."""

    aoi: float | None = None
    poi: float = 0.0
    side: str = "Front"
    wavelength_nm: float = math.nan
    scatter_type: str = "BRDF"
    tristimulus: str = ""


def read(path: Path) -> BsdfFile:
    """Read a .bsdf file of LightTools. Raises FormatError."""
    with name_file(path):
        return BsdfFile((_Reader(Words(path, "#")).scattered(),))


class _Reader:
    def __init__(self, words: Words) -> None:
        self.words = words
        self.word_of: dict[str, str] = {}
        self.angles_of: dict[str, Floats] = {}

    def scattered(self) -> ScatteredBsdf:
        self._header()
        blocks: list[tuple[_Block, Floats]] = []
        while self.words.peek() != "dataend":
            blocks.append(self._block(blocks))
        self.words.take("DataEnd")
        if self.words.peek() is not None:
            word = self.words.take("the end")
            raise self.words.error(f"{quote_word(word)} follows DataEnd", "remove everything after DataEnd")
        if not blocks:
            raise FormatError(self.words.path, "there is no block of data", "it is cut short: copy it again")
        planes = {block.poi for block, _ in blocks}
        if len(planes) > 1:
            wrong = f"it has {len(planes)} planes of incidence (POI), and which way the sample is turned is not public"
            raise FormatError(self.words.path, wrong, "give a file with one of them")
        return self._joined(blocks)

    def _joined(self, blocks: list[tuple[_Block, Floats]]) -> ScatteredBsdf:
        azimuth, polar = self.angles_of["ScatterAzimuth"], self.angles_of["ScatterRadial"]
        relative = wrap_azimuth(azimuth - LIGHT_DEG)
        rows = np.arange(azimuth.size)
        if self.word_of["Symmetry"] == SYMMETRIES[0] and azimuth[-1] - azimuth[0] <= HALF_TURN_DEG + TOLERANCE_DEG:
            image = wrap_azimuth(-relative)
            new = ~np.isclose(image[:, None], relative, rtol=0.0, atol=TOLERANCE_DEG).any(axis=1)
            relative, rows = np.concatenate([relative, image[new]]), np.concatenate([rows, rows[new]])
        size = relative.size * polar.size
        channels = dict(zip(("", *TRISTIMULUS), ("", "X", "Y", "Z"), strict=True))

        def repeated(values: list[float] | list[bool] | list[str]) -> np.ndarray:
            return np.repeat(np.array(values), size)

        stated = [block for block, _ in blocks]
        return ScatteredBsdf(
            sigma_deg=repeated([block.aoi or 0.0 for block in stated]),
            psi_deg=np.zeros(size * len(blocks)),
            polar_deg=np.tile(polar, relative.size * len(blocks)),
            azimuth_deg=np.tile(np.repeat(relative, polar.size), len(blocks)),
            values=np.concatenate([values[rows].ravel() for _, values in blocks]),
            wavelength_nm=repeated([block.wavelength_nm for block in stated]),
            channel=repeated([channels[block.tristimulus] for block in stated]),
            transmitted=repeated([block.scatter_type == "BTDF" for block in stated]),
            back=repeated([block.side == "Back" for block in stated]),
            comments=(*self.words.comments, CONVENTION),
        )

    def _header(self) -> None:
        while (word := self.words.peek()) != "databegin":
            word = self.words.take("DataBegin")
            name = {known.lower(): known for known in (*HEADER, *OTHER_HEADER)}.get(word.lower())
            if word.lower() in ("monochrome", *(f"tristimulus{axis}" for axis in "xyz")):
                continue  # as in Zemax's files, before DataBegin
            if name is None:
                near = difflib.get_close_matches(word, HEADER, 1)
                remedy = f"did you mean {near[0]}?" if near else "remove it, or make it a comment with #"
                raise self.words.error(f"{quote_word(word)} is not a keyword of a LightTools file", remedy)
            if name in self.word_of or name in self.angles_of:
                raise self.words.error(f"{name} is given twice", "remove one of them")
            if name.startswith("Scatter") and name != "ScatterType":
                low, high = (-360.0, 360.0) if name == "ScatterAzimuth" else (0.0, 90.0)
                self.angles_of[name] = self.words.angles(name, high, low)
            elif name in ("Symmetry", "SpectralContent"):
                self.word_of[name] = self.words.one_of(name, SYMMETRIES if name == "Symmetry" else CONTENTS)
            else:
                self.word_of[name] = self.words.take_line(f"the value of {name}")
        self.words.take("DataBegin")
        missing = [name for name in HEADER if name not in self.word_of and name not in self.angles_of]
        if missing:
            wrong = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
            raise FormatError(self.words.path, wrong, "add it before the data")

    def _block(self, before: list[tuple[_Block, Floats]]) -> tuple[_Block, Floats]:
        block = _Block()
        while True:
            word = self.words.take("DataEnd")
            name = {known.lower(): known for known in OF_BLOCK}.get(word.lower())
            if name is None:
                raise self.words.error(f"{quote_word(word)} is not a keyword of a block", f"write one of {', '.join(OF_BLOCK)}")
            if name == "TIS":
                break
            self._state(block, name)
        self.words.number("TIS")
        if block.aoi is None:
            raise self.words.error("a block has no AOI", "add its angle of incidence")
        if (block.tristimulus != "") != (self.word_of["SpectralContent"] == "XYZ"):
            raise self.words.error("TristimulusValue is of SpectralContent XYZ, and of every block of it", "correct the file")
        if any(block == other for other, _ in before):
            raise self.words.error(f"there are two blocks of AOI {block.aoi:g} with the same words", "remove one of them")
        ends = {*map(str.lower, OF_BLOCK), "dataend"}
        azimuth, polar = self.angles_of["ScatterAzimuth"], self.angles_of["ScatterRadial"]
        return block, self.words.block(f"BSDF at AOI {block.aoi:g}", azimuth.size, polar.size, ends)

    def _state(self, block: _Block, name: str) -> None:
        if name == "AOI":
            angle = self.words.number(name)
            if angle < 0.0:
                raise self.words.error(f"AOI {angle:g} is below 0", "correct it")
            block.aoi = angle if angle <= 90.0 else 0.0
        elif name == "POI":
            block.poi = self.words.number(name)
        elif name == "Side":
            block.side = self.words.one_of(name, ("Front", "Back"))
        elif name == "Wavelength":
            nanometres = self.words.number(name)
            block.wavelength_nm = nanometres if nanometres > 0.0 else math.nan
        elif name == "ScatterType":
            block.scatter_type = self.words.one_of(name, ("BRDF", "BTDF"))
        else:
            block.tristimulus = self.words.one_of(name, TRISTIMULUS)
