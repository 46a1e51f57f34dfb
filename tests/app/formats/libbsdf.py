"""How libbsdf (https://github.com/KimuraRyo/libbsdf, its master branch of 2026) takes the words of a file, faults included.

Written from the behaviour of src/Reader/{DdrReader,SdrReader,SsddReader,ZemaxBsdfReader,ReaderUtility}.cpp, as an independent
reader of what this program writes: it skips unknown words, takes comments only where these readers look for them, and checks
almost nothing, so that a misplaced comment or a wrong count gives wrong values here, too.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from goniotwin.arrays import Floats

BLOCKS = ("wl", "bw", "red", "gre", "blu", "green", "blue")


class Refused(Exception):
    """The reader returns nothing."""


class Stream:
    """A C++ stream of a file in binary mode."""

    def __init__(self, path: Path, mark: str) -> None:
        self.text = path.read_bytes().decode("latin-1")
        self.place = 0
        self.mark = mark

    def word(self) -> str:
        """The next word, or "" at the end."""
        while self.place < len(self.text) and self.text[self.place].isspace():
            self.place += 1
        start = self.place
        while self.place < len(self.text) and not self.text[self.place].isspace():
            self.place += 1
        return self.text[start : self.place]

    def rest_of_line(self) -> None:
        found = self.text.find("\n", self.place)
        self.place = len(self.text) if found < 0 else found + 1

    def comments(self) -> None:
        """ignoreCommentLines."""
        place = self.place
        while (word := self.word()).startswith(self.mark) and word:
            self.rest_of_line()
            place = self.place
        self.place = place

    def line(self) -> str | None:
        """safeGetline; None at the end."""
        start = self.place
        if start >= len(self.text):
            return None
        self.rest_of_line()
        return self.text[start : self.place].rstrip("\r\n")

    def number(self) -> float:
        return float(self.word())

    def numbers(self, count: int) -> list[float]:
        return [self.number() for _ in range(count)]


@dataclass
class Read:
    """What was read: lists in degrees, `values` [psi, sigma, phi, theta, channel] in 1/sr."""

    sigma: list[float] = field(default_factory=list)
    psi: list[float] = field(default_factory=list)
    theta: list[float] = field(default_factory=list)
    phi: list[float] = field(default_factory=list)
    wavelengths: list[float] = field(default_factory=list)
    symmetry: str = ""
    colours: str = ""
    source: str = ""
    scatter_type: str = ""
    values: Floats = field(default_factory=lambda: np.zeros(0))

    def mirrored(self) -> "Read":
        """Of plane-symmetric data, with the other half of phi."""
        partners = range(len(self.phi) - 2, -1, -1)
        self.phi += [360.0 - self.phi[n] for n in partners]
        self.values = np.concatenate([self.values, self.values[:, :, list(partners)]], axis=2)
        return self


def read_ddr(path: Path) -> Read:
    """A .ddr of Luminance Absolute."""
    stream, found, count, data = Stream(path, ";;"), Read(symmetry="planesymmetrical", colours="rgb"), 1, "luminance absolute"
    stream.comments()
    place = stream.place
    while word := stream.word().lower():
        stream.comments()
        if word == "source":
            found.source = stream.word().lower()
        elif word == "typesym":
            found.symmetry, after = stream.word().lower(), stream.place
            if found.symmetry == "asymmetrical" and stream.word() == "4D":
                found.symmetry += " 4d"
            else:
                stream.place = after
            if found.symmetry not in ("planesymmetrical", "asymmetrical", "asymmetrical 4d"):
                raise Refused(found.symmetry)
        elif word == "typecolormodel":
            found.colours = stream.word().lower()
            count = {"rgb": 3, "bw": 1}.get(found.colours) or int(stream.word())
        elif word == "typedata":
            data = f"{stream.word()} {stream.word()}".lower()
        elif word in ("psi", "sigma", "phi", "theta"):
            setattr(found, word, stream.numbers(int(stream.word())))
        elif word in BLOCKS:
            stream.place = place
            break
        place = stream.place
    assert data == "luminance absolute"
    if not (found.sigma and found.theta and found.phi):
        raise Refused("a list is missing")
    found.psi = found.psi or [0.0]
    shape = len(found.psi), len(found.sigma), len(found.phi), len(found.theta)
    found.values = np.zeros((*shape, count))
    n = 0
    while word := stream.word().lower():
        stream.comments()
        if word not in BLOCKS:
            continue
        if found.colours == "spectral":
            found.wavelengths.append(stream.number())
        stream.comments()
        factors = np.ones(shape[:2])
        if stream.word().lower() == "kbdf":
            factors = np.array(stream.numbers(shape[0] * shape[1])).reshape(shape[:2])
            stream.comments()
            stream.word()
        for place_of_row in np.ndindex(shape[:3]):
            stream.comments()
            found.values[(*place_of_row, slice(None), n)] = stream.numbers(shape[3])
        found.values[..., n] *= factors[:, :, None, None] / np.pi
        n += 1
    return found.mirrored() if found.symmetry == "planesymmetrical" else found


def read_sdr(path: Path) -> Read:
    """A .sdr: `values` [sigma, channel]; keywords of the header in their exact spelling."""
    stream, found, count = Stream(path, ";;"), Read(colours="rgb"), 1
    blocks = BLOCKS[:5]
    stream.comments()
    place = stream.place
    while word := stream.word():
        stream.comments()
        if word == "Source":
            found.source = stream.word()
        elif word == "TypeColorModel":
            found.colours = stream.word().lower()
            count = {"rgb": 3, "bw": 1}.get(found.colours) or int(stream.word())
        elif word == "sigma":
            found.sigma = stream.numbers(int(stream.word()))
        elif word.lower() in blocks:
            stream.place = place
            break
        place = stream.place
    found.values = np.zeros((len(found.sigma), count))
    n = 0
    while word := stream.word():
        stream.comments()
        if word.lower() in blocks:
            if found.colours == "spectral":
                found.wavelengths.append(stream.number())
            stream.comments()
            stream.word()
            found.values[:, n] = stream.numbers(len(found.sigma))
            n += 1
    return found


def read_zemax(path: Path) -> Read:
    """A Zemax .bsdf; keywords and the types of symmetry in their exact spelling."""
    stream, found = Stream(path, "#"), Read()
    lists = {"SampleRotation": "psi", "AngleOfIncidence": "sigma", "ScatterAzimuth": "phi", "ScatterRadial": "theta"}
    channels = {"Monochrome": 0, "TristimulusX": 0, "TristimulusY": 1, "TristimulusZ": 2}
    stream.comments()
    place = stream.place
    while word := stream.word():
        stream.comments()
        if word == "Symmetry":
            found.symmetry = stream.word()
            if found.symmetry not in ("PlaneSymmetrical", "Asymmetrical", "ASymmetrical4D"):
                raise Refused(found.symmetry)
        elif word == "SpectralContent":
            found.colours = stream.word()
        elif word == "ScatterType":
            found.scatter_type = stream.word()
        elif word in lists:
            setattr(found, lists[word], stream.numbers(int(stream.word())))
        elif word in channels:
            stream.place = place
            break
        place = stream.place
    shape = len(found.psi), len(found.sigma), len(found.phi), len(found.theta)
    found.values = np.zeros((*shape, 3 if found.colours == "XYZ" else 1))
    n = blocks = 0
    while word := stream.word():
        stream.comments()
        if word in channels:
            n, blocks = channels[word], 0
        elif word == "TIS":
            stream.rest_of_line()
            numbers = np.array(stream.numbers(shape[2] * shape[3])).reshape(shape[2:])
            found.values[blocks // shape[1], blocks % shape[1], :, :, n] = numbers
            blocks += 1
    return found.mirrored() if found.symmetry == "PlaneSymmetrical" else found


def read_ssdd(path: Path) -> dict[str, Read]:
    """The blocks of a .ssdd in text; of regular factors `values` are [psi, sigma, channel]."""
    stream = Stream(path, "#")
    stream.comments()
    blocks: dict[str, dict[str, list[str]]] = {}
    found: dict[str, Read] = {}
    block: dict[str, list[str]] | None = None
    while (line := stream.line()) is not None:
        if not line:
            continue
        stream.comments()
        word, *values = line.split()
        if word in ("VERSION", "SOFTWARE", "API", "DATE"):
            continue
        if word == "DATA_TYPE":
            block = blocks.setdefault(values[0], {})
            block[word] = values
        elif block is None:
            raise Refused("Data type not found")
        elif word == "DATA":
            assert values == ["ascii"]
            found[block["DATA_TYPE"][0]] = _ssdd_data(stream, block)
        else:
            block[word] = values
    return found


def _ssdd_data(stream: Stream, block: dict[str, list[str]]) -> Read:
    lists = [[float(each) for each in block.get(f"PARAM{n}_LIST", ["0"] if n == 1 else [])] for n in range(4)]
    model = block["COLOR_MODEL"][0]
    wavelengths = [float(each) for each in block.get("WAVELENGTH_LIST", [])]
    channels = {"monochrome": 1, "rgb": 3, "xyz": 3}.get(model) or len(wavelengths)
    regular = block["DATA_TYPE"][0].startswith("specular")
    size = int(np.prod([len(each) for each in lists[: 2 if regular else 4]]))
    rows: list[list[float]] = []
    while len(rows) < size:
        line = stream.line()
        if line is None:
            raise Refused("the data end early")
        if not line:
            continue
        stream.comments()
        row = [float(each) for each in line.split()]
        if len(row) != channels:
            raise Refused(line)
        rows.append(row)
    sigma, psi, theta, phi = lists
    found = Read(sigma, psi, theta, phi, wavelengths, colours=model, source=block.get("SOURCE_TYPE", [""])[0])
    if regular:
        found.values = np.array(rows).reshape(len(psi), len(sigma), channels)
        return found
    assert block["PARAM_TYPE"] == ["specular_coordinate_system"]
    found.values = np.array(rows).reshape(len(phi), len(theta), len(psi), len(sigma), channels).transpose(2, 3, 0, 1, 4)
    return found.mirrored() if block.get("REDUCTION_TYPE") == ["bilateral_symmetry"] else found
