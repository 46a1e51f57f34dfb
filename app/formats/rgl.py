"""Tensor files of measured materials (RGL, EPFL; Dupuy and Jakob 2018), which Mitsuba 3 reads as its plugin `measured`.

A header names fields with their type, shape and place; numbers are little-endian. The BRDF is a grid over the half vector m of
both directions: column u = sqrt(2 theta_m / pi), row v = (phi_m - phi_i + pi) / (2 pi), both 0 to 1 with the ends included; of
an anisotropic material v has phi_m itself. The field `vndf` warps that square; `spectra` has values on the warped one, times
the cosine of the observed direction and, where `jacobian` is set, 4 sigma / ndf. Sources: Mitsuba's src/bsdfs/measured.cpp and
include/mitsuba/core/distr_2d.h, the files of https://rgl.epfl.ch/materials.

A table is written without a warp (vndf 1), with ndf = 4 and sigma = 1, so that `spectra` is f cos(theta_o) alone. Rows, columns
and incidences are as many as it takes for the linear interpolation of a reader to follow the narrowest lobe. Below the horizon
the values go on smoothly, with a negative cosine, because readers interpolate across it. `luminance` is by what a path tracer
draws directions. A file is read as Mitsuba reads it, onto specular coordinates.
"""

import heapq
import itertools
import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.file import FormatError, StrPath, name_file, open_file, quote_word, write_file
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import from_specular, light_direction, to_specular
from goniotwin.twin.optics.bsdf.lobes import slopes
from goniotwin.twin.optics.geometry.coordinates import TURN_DEG, wrap_azimuth

Singles = npt.NDArray[np.float32]
MAGIC = b"tensor_file\0"
VERSION = bytes([1, 0])
TYPES = dict(enumerate(("u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"), 1))
"""NumPy's types by the number that a field has."""
MOST_FIELDS, MOST_AXES = 100, 8
MOST_BYTES = 700_000_000
"""Bytes of a file: those of the RGL have up to 0.6 GB."""
MOST_VALUES = 12_000_000
"""Values of a table that is read."""
SIDES = (64, 96, 128, 192, 256, 384, 512)
"""Rows and columns of the half vector, of which the first that suffices is written."""
MOST_NODES = 28_000_000
"""Values that are written, four bytes each."""
TOLERANCE = 0.003
"""Relative deviation of a reader's linear interpolation, down to LOWEST of the largest value at a sigma."""
LOWEST = 0.01
FINEST_SIGMA_DEG = 0.7
WIDEST_PSI_DEG = 15.0
HIGHEST_SIDE_DEG, HIGHEST_PROBED_DEG = 60.0, 75.0
"""Rows and columns are chosen for sigmas up to the first, incidences up to the second: beyond, half vectors crowd."""
PROBED = 128
"""Rows and columns that are probed, of as many as there are."""
GREY_NM = 550.0
"""The wavelength of a grey table: a file has at least one, whose values hold for all others."""
GREY = "grey; the wavelength has no meaning"
NEAR_HORIZON = 0.03
"""Cosine of directions whose deviation does not count: the cosine itself has a kink for a reader there."""
LEAST_COSINE = 0.005
"""A value is the quotient by the cosine of the observed direction: nearer to the horizon it is not known."""
COPY_AGAIN = "it is damaged or cut short: copy it again"


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is a tensor file with a material."""
    return head.startswith(MAGIC) and b"theta_i" in head and b"vndf" in head


# ---- writing ----


def write(path: Path, content: BsdfFile) -> None:
    """Write the table of a file. Raises FormatError for what the format does not hold."""
    table = _writable(path, content)
    write_table(path, replace(table, comments=(*content.comments, *table.comments)))


def write_table(path: Path, table: BsdfTable, most_nodes: int = MOST_NODES) -> None:
    """Write a table; with fewer nodes than it asks for, the file is smaller and less exact. Raises FormatError."""
    table = _writable(path, BsdfFile((table,)))
    samples = _Samples(table, most_nodes)
    side = samples.side()
    sigmas = samples.sigmas(side)
    wavelengths = table.wavelengths_nm or (GREY_NM,)
    lines = [
        f"sample: {table.sample}" if table.sample else "",
        GREY if table.wavelengths_nm is None else "",
        "SIMULATED" if table.generated else "",
        f"half vectors {side} x {side} at {sigmas.size} incidences; linear between them, a value of at least "
        f"{100.0 * LOWEST:g} % of the peak is off by up to {100.0 * samples.worst(side, sigmas):.2g} %",
        *table.comments,
    ]
    description = "\n".join(line for line in lines if line).encode() or b" "
    psi = samples.psi_deg
    small = {
        "description": np.frombuffer(description, dtype=np.uint8),
        "theta_i": np.radians(sigmas).astype("<f4"),
        "phi_i": np.radians(psi).astype("<f4"),
        "wavelengths": np.array(wavelengths, dtype="<f4"),
        "ndf": np.full((2, 2), 4.0, dtype="<f4"),
        "sigma": np.ones((2, 2), dtype="<f4"),
        "vndf": np.ones((psi.size, sigmas.size, 2, 2), dtype="<f4"),
        "jacobian": np.ones(1, dtype=np.uint8),
    }
    shapes: dict[str, tuple[str, tuple[int, ...]]] = {
        name: (each.dtype.str.lstrip("|"), each.shape) for name, each in small.items()
    }
    shapes["spectra"] = ("<f4", (psi.size, sigmas.size, len(wavelengths), side, side))
    shapes["luminance"] = ("<f4", (psi.size, sigmas.size, side, side))
    write_file(path, _parts(shapes, small, samples, sigmas, side))


def _writable(path: Path, content: BsdfFile) -> BsdfTable:
    """The one table of a content. Raises FormatError."""
    if len(content.parts) != 1 or not content.tables:
        wrong = f"an rgl file holds one table on specular coordinates, and there are {len(content.parts)} parts"
        if len(content.parts) == 1:
            wrong = "an rgl file holds a table on specular coordinates, not scattered values or a regular factor"
        raise FormatError(path, wrong, "choose one sample, or resample it to a grid first")
    table = content.tables[0]
    if table.transmitted or table.back:
        what = "transmitted light" if table.transmitted else "light on the back"
        raise FormatError(path, f"an rgl file does not hold {what}", "write reflected light of the front")
    if table.colours:
        wrong = f"an rgl file holds wavelengths, not the colours {', '.join(table.colours)}"
        raise FormatError(path, wrong, "write a spectral or a grey table")
    if table.psi_deg.size > 1:
        inner, outer = float(np.diff(table.psi_deg).max()), TURN_DEG - float(table.psi_deg[-1] - table.psi_deg[0])
        if outer > 1.5 * inner:
            wrong = f"its azimuths of the light, {table.psi_deg[0]:g} to {table.psi_deg[-1]:g} deg, are not a whole turn"
            raise FormatError(path, wrong, "write a table with all of them; an rgl file here has no symmetry")
    psi = 1 if table.psi_deg.size == 1 else table.psi_deg.size + math.ceil(TURN_DEG / WIDEST_PSI_DEG)
    if table.values.shape[0] * psi * table.sigma_deg.size * SIDES[0] ** 2 > MOST_NODES:
        wrong = f"the {table.values.shape[0]} wavelengths at {table.sigma_deg.size} sigmas are too many for an rgl file"
        raise FormatError(path, wrong, "write fewer wavelengths")
    return table


def _parts(
    shapes: Mapping[str, tuple[str, tuple[int, ...]]], small: Mapping[str, npt.NDArray[np.generic]], samples: "_Samples",
    sigmas: Floats, side: int,
) -> Iterator[bytes]:  # fmt: skip
    """The bytes of a file in parts: header and small fields, the spectra of one incidence after another, the luminance."""
    numbers = {kind: number for number, kind in TYPES.items()}
    header = MAGIC + VERSION + struct.pack("<I", len(shapes))
    start = len(header) + sum(13 + len(name) + 8 * len(shape) for name, (_, shape) in shapes.items())
    end = start
    for name, (kind, shape) in shapes.items():
        end += -end % 8
        title = struct.pack("<H", len(name)) + name.encode() + struct.pack("<HBQ", len(shape), numbers[kind], end)
        header += title + struct.pack(f"<{len(shape)}Q", *shape)
        end += np.dtype(kind).itemsize * math.prod(shape)
    yield header
    end = len(header)
    for each in small.values():
        yield bytes(-end % 8) + each.tobytes()
        end += -end % 8 + each.nbytes
    yield bytes(-end % 8)
    luminance = np.empty(shapes["luminance"][1], dtype="<f4")
    for n, psi in enumerate(samples.psi_deg.tolist()):
        for k, sigma in enumerate(sigmas.tolist()):
            values = samples.nodes(psi, sigma, side)
            yield values.astype("<f4").tobytes()
            luminance[n, k] = _density(values.mean(axis=0), psi, sigma, side)
    yield bytes(-(4 * math.prod(shapes["spectra"][1])) % 8)
    yield luminance.tobytes()


def _density(values: Floats, psi_deg: float, sigma_deg: float, side: int) -> Floats:
    """What a path tracer draws (side, side): the light over u and v, and some everywhere, so that no direction is missed."""
    u, theta_m, phi_m = _half_angles(side)
    towards = _vectors(theta_m, phi_m - math.radians(psi_deg)) @ light_direction(sigma_deg)
    wide = np.maximum(towards, 0.0) * np.sin(theta_m) * u
    found: Floats = np.maximum(values, 0.0) * wide
    return np.asarray(found + 0.05 * max(float(found.mean()), 1e-12) * (1.0 + wide))


def _half_angles(side: int) -> tuple[Floats, Floats, Floats]:
    """u (side,), theta_m (side,) and phi_m (side, 1) of the half vectors, in rad."""
    u = np.linspace(0.0, 1.0, side)
    return u, 0.5 * np.pi * u**2, (2.0 * np.linspace(0.0, 1.0, side)[:, None] - 1.0) * np.pi


def _vectors(theta: Floats, phi: Floats) -> Floats:
    """Unit vectors (rows, columns, 3) of polar angles (columns,) and azimuths (rows, 1)."""
    sine = np.sin(theta)
    x, y = sine * np.cos(phi), sine * np.sin(phi)
    return np.stack([x, y, np.broadcast_to(np.cos(theta), x.shape)], axis=-1)


class _Samples:
    """A table, evaluated at half vectors as a sample of the twin is: linear in psi, phi and theta, a monotone cubic in sigma.

    `psi_deg` are the azimuths of the light that are written: 0 alone, or from -180 to 180.
    """

    def __init__(self, table: BsdfTable, most_nodes: int = MOST_NODES) -> None:
        self.table, self._most = table, most_nodes
        phi, psi = table.phi_deg, table.psi_deg
        # The tail of a lobe can be so small that its slopes overflow.
        values = np.where(np.abs(table.values) < 1e-30 * np.abs(table.values).max(), 0.0, table.values)
        if phi.size > 1 and phi[0] == 0.0 and 180.0 < phi[-1] < TURN_DEG:
            values, phi = np.concatenate([values, values[:, :, :, :1]], axis=3), np.append(phi, TURN_DEG)
        self.psi_deg = np.zeros(1)
        if psi.size > 1:
            if psi[-1] - psi[0] < TURN_DEG:
                values, psi = np.concatenate([values, values[:, :1]], axis=1), np.append(psi, psi[0] + TURN_DEG)
            turned = wrap_azimuth(psi + 180.0) - 180.0
            steps = np.linspace(-180.0, 180.0, 1 + math.ceil(TURN_DEG / WIDEST_PSI_DEG))
            self.psi_deg = np.unique(np.concatenate([turned, steps]))
        self._phi, self._psi, self._values = phi, psi, values
        self._slopes = np.stack([[slopes(table.sigma_deg, block) for block in channel] for channel in values])
        # Three channels show what the others need.
        self._probed = sorted({0, values.shape[0] // 2, values.shape[0] - 1})
        self._at_probes: dict[float, tuple[Floats, Flags]] = {}

    @property
    def _mirrored(self) -> bool:
        """Whether the half vectors on both sides of the plane of incidence have the same values."""
        return self._psi.size == 1 and bool(self._phi[-1] <= 180.0)

    def cut(self, psi_deg: float, sigma_deg: float) -> Floats:
        """The table (channel, phi, theta) at one azimuth and one sigma of the light."""
        if self._psi.size == 1:
            return self._at_sigma(0, sigma_deg)
        (n,), (share,) = _place(self._psi, np.array([self._psi[0] + (psi_deg - self._psi[0]) % TURN_DEG]))
        return np.asarray((1.0 - share) * self._at_sigma(n, sigma_deg) + share * self._at_sigma(n + 1, sigma_deg))

    def _at_sigma(self, psi: int, sigma_deg: float) -> Floats:
        axis = self.table.sigma_deg
        (k,), (a,) = _place(axis, np.array([sigma_deg]))
        near, slope_near = self._values[:, psi, k], self._slopes[:, psi, k]
        if a == 0.0:
            return np.asarray(near)
        far, slope_far, step, rest = self._values[:, psi, k + 1], self._slopes[:, psi, k + 1], axis[k + 1] - axis[k], 1.0 - a
        total = rest**2 * (1.0 + 2.0 * a) * near + a**2 * (3.0 - 2.0 * a) * far
        return np.asarray(total + step * a * rest**2 * slope_near - step * a**2 * rest * slope_far)

    def at(
        self, psi_deg: float, sigma_deg: float, theta_m: Floats, phi_m: Floats, channels: list[int] | None = None
    ) -> tuple[Floats, Flags]:
        """f cos(theta_o) (channel, ...) at half vectors, and whether (...) the observed direction is well above the horizon.

        The azimuth of the half vectors is counted from the light's, or that of the sample for an anisotropic one; rad.
        """
        half = _vectors(theta_m, phi_m - math.radians(psi_deg))
        shape = half.shape[:-1]
        half = half.reshape(-1, 3)
        light = light_direction(sigma_deg)
        out = 2.0 * (half @ light)[:, None] * half - light
        theta, phi = to_specular(sigma_deg, out)
        if self._phi[-1] <= 180.0:
            phi = np.minimum(phi, TURN_DEG - phi)
        cut = self.cut(psi_deg, sigma_deg)
        cut = cut if channels is None else cut[channels]
        (j, b), (k, c) = _place(self._phi, phi), _place(self.table.theta_deg, theta)
        rows, columns = cut.shape[1:]
        flat = cut.reshape(cut.shape[0], rows * columns)
        j, j1, k1 = j * columns, np.minimum(j + 1, rows - 1) * columns, np.minimum(k + 1, columns - 1)
        near = (1.0 - c) * flat[:, j + k] + c * flat[:, j + k1]
        far = (1.0 - c) * flat[:, j1 + k] + c * flat[:, j1 + k1]
        values = ((1.0 - b) * near + b * far) * out[:, 2]
        return values.reshape(-1, *shape), (out[:, 2] > NEAR_HORIZON).reshape(shape)

    def nodes(self, psi_deg: float, sigma_deg: float, side: int, channels: list[int] | None = None) -> Floats:
        """f cos(theta_o) (channel, side, side) on the grid of the half vector, for a reader that interpolates linearly.

        Between nodes such a reader is off by an eighth of the second differences. With half of that subtracted at the nodes it
        is off by as much there, with the other sign, and nowhere by more.
        """
        _, theta_m, phi_m = _half_angles(side)
        if self._mirrored:
            half, _ = self.at(psi_deg, sigma_deg, theta_m, phi_m[: (side + 1) // 2], channels)
            exact = np.concatenate([half, half[:, side // 2 - 1 :: -1]], axis=1)
        else:
            exact, _ = self.at(psi_deg, sigma_deg, theta_m, phi_m, channels)
        bend = np.zeros_like(exact)
        bend[:, :, 1:-1] = np.diff(exact, n=2, axis=2)
        bend[:, 1:-1] += np.diff(exact, n=2, axis=1)
        most = 0.1 * np.abs(exact)
        return np.asarray(exact - np.clip(bend / 16.0, -most, most))

    def side(self) -> int:
        """The least of SIDES at which the interpolation between half vectors is within TOLERANCE, if there is room for it."""
        slices = self.table.values.shape[0] * self.psi_deg.size * self.table.sigma_deg.size
        possible = [each for each in SIDES if slices * each**2 <= self._most] or [SIDES[0]]
        return next((each for each in possible if self._worst_between_half_vectors(each) <= TOLERANCE), possible[-1])

    def sigmas(self, side: int) -> Floats:
        """The sigmas of the table, and others between them where the interpolation needs them, if there is room for them."""
        most = self._most // (self.table.values.shape[0] * self.psi_deg.size * side**2)
        found = self.table.sigma_deg.tolist()
        split = [(-self._worst_between_sigmas(a, b), a, b) for a, b in itertools.pairwise(found)]
        heapq.heapify(split)
        while split and len(found) < most and -split[0][0] > TOLERANCE:
            _, first, last = heapq.heappop(split)
            if last - first > FINEST_SIGMA_DEG:
                middle = 0.5 * (first + last)
                found.append(middle)
                for a, b in ((first, middle), (middle, last)):
                    heapq.heappush(split, (-self._worst_between_sigmas(a, b), a, b))
        return np.array(sorted(found))

    def worst(self, side: int, sigmas: Floats) -> float:
        """The largest relative deviation that was found, of half vectors and of sigmas together."""
        between = (self._worst_between_sigmas(a, b) for a, b in itertools.pairwise(sigmas.tolist()))
        return self._worst_between_half_vectors(side) + max(between, default=0.0)

    def _worst_between_half_vectors(self, side: int) -> float:
        """The largest relative deviation in the middle between four nodes, at some of the table's sigmas."""
        probed = [sigma for sigma in self.table.sigma_deg.tolist() if sigma <= HIGHEST_SIDE_DEG] or [self.table.sigma_deg[0]]
        u = np.linspace(0.0, 1.0, side)
        middle = 0.5 * (u[1:] + u[:-1])
        rows = side // 2 if self._mirrored else side
        theta_m, phi_m = 0.5 * np.pi * middle**2, (2.0 * middle[:, None] - 1.0) * np.pi
        psi, worst = float(self.psi_deg[self.psi_deg.size // 2]), 0.0
        for sigma in {probed[0], probed[len(probed) // 2], probed[-1]}:
            nodes = self.nodes(psi, sigma, side, self._probed)[:, :rows]
            read = 0.25 * (nodes[:, 1:, 1:] + nodes[:, 1:, :-1] + nodes[:, :-1, 1:] + nodes[:, :-1, :-1])
            worst = max(worst, _deviation(read, *self._at_probe(sigma, theta_m, phi_m, rows - 1)))
        return worst

    def _worst_between_sigmas(self, first: float, last: float) -> float:
        """The largest relative deviation half way between two sigmas."""
        if first >= HIGHEST_PROBED_DEG:
            return 0.0
        middle = 0.5 * (first + last)
        for sigma in (first, middle, last):
            if sigma not in self._at_probes:
                rows = PROBED // 2 if self._mirrored else PROBED
                self._at_probes[sigma] = self._at_probe(sigma, *_half_angles(PROBED)[1:], rows)
        read = 0.5 * (self._at_probes[first][0] + self._at_probes[last][0])
        return _deviation(read, *self._at_probes[middle])

    def _at_probe(self, sigma_deg: float, theta_m: Floats, phi_m: Floats, rows: int) -> tuple[Floats, Flags]:
        """As `at`, of some channels at the middle azimuth of the light, for the first rows."""
        return self.at(float(self.psi_deg[self.psi_deg.size // 2]), sigma_deg, theta_m, phi_m[:rows], self._probed)


def _deviation(read: Floats, exact: Floats, above: Flags) -> float:
    """The largest relative deviation (channel, ...) above the horizon, of values of at least LOWEST of the largest."""
    highest = np.abs(exact).max(axis=tuple(range(1, exact.ndim)), keepdims=True)
    counted = above & (exact >= LOWEST * highest) & (highest > 0.0)
    return float(np.max(np.abs(read - exact)[counted] / exact[counted], initial=0.0))


def _place(axis: Floats, at: Floats) -> tuple[Ints, Floats]:
    """The interval of an axis with each place, and the position in it, 0 to 1; the ends hold beyond it."""
    if axis.size == 1:
        return np.zeros(at.shape, dtype=np.int64), np.zeros(at.shape)
    k = np.clip(np.searchsorted(axis, at, side="right") - 1, 0, axis.size - 2)
    return k, np.clip((at - axis[k]) / (axis[k + 1] - axis[k]), 0.0, 1.0)


# ---- reading ----


@dataclass(frozen=True, eq=False)
class _Material:
    """The fields of a file: values (psi, theta, channel, rows, columns), warp (psi, theta, rows, columns), angles in rad."""

    theta_i: Floats
    phi_i: Floats
    values: Singles
    warp: Singles
    ndf: Floats
    sigma: Floats
    jacobian: bool

    @property
    def isotropic(self) -> bool:
        """As in Mitsuba: one or two azimuths of the light."""
        return self.phi_i.size <= 2

    @property
    def repeats(self) -> int:
        """How many times the azimuths of the light go into a turn: 1, 2 (the half turn repeats) or 4 (two mirror planes)."""
        return 1 if self.isotropic else round(2.0 * math.pi / float(self.phi_i[-1] - self.phi_i[0]))


def read(path: StrPath) -> BsdfFile:
    """Read a tensor file onto specular coordinates. Raises FormatError.

    The incidences are those of the file. theta is as dense as the grid of the file, phi every 5 deg.
    """
    fields = _fields(path)
    # An overflow becomes inf, which the table refuses.
    with name_file(path, COPY_AGAIN), np.errstate(over="ignore", invalid="ignore", divide="ignore", under="ignore"):
        material, wavelengths, description = _material(path, fields)
        return BsdfFile((_table(path, material, wavelengths, description),))


def _fields(path: StrPath) -> dict[str, npt.NDArray[np.generic]]:
    """The fields of a tensor file by name, mapped from the file. Raises FormatError."""
    with open_file(path, MOST_BYTES) as content:
        size = content.seek(0, 2)
        content.seek(0)
        if content.read(len(MAGIC)) != MAGIC:
            raise FormatError(path, "is not a tensor file", "give a material of the RGL, or one that was written here")
        version = content.read(2)
        if version != VERSION:
            wrong = f"is a tensor file of version {'.'.join(map(str, version))}, not 1.0"
            raise FormatError(path, wrong, "convert it to version 1.0")

        def take(form: str) -> tuple[int, ...]:
            raw = content.read(struct.calcsize(form))
            if len(raw) != struct.calcsize(form):
                raise FormatError(path, "ends within its header", COPY_AGAIN)
            return struct.unpack(form, raw)

        (count,) = take("<I")
        if not 0 < count <= MOST_FIELDS:
            raise FormatError(path, f"has {count} fields", COPY_AGAIN)
        places: dict[str, tuple[int, str, tuple[int, ...]]] = {}
        for _ in range(count):
            (length,) = take("<H")
            name = content.read(length).decode("latin-1")
            axes, kind, offset = take("<HBQ")
            if kind not in TYPES or axes > MOST_AXES:
                raise FormatError(path, f"the field {quote_word(name)} has the type {kind} and {axes} axes", COPY_AGAIN)
            shape = take(f"<{axes}Q")
            if offset + math.prod(shape) * np.dtype(TYPES[kind]).itemsize > size:
                raise FormatError(path, f"the field {quote_word(name)} goes beyond the end of the file", COPY_AGAIN)
            places[name] = (offset, TYPES[kind], shape)
        found: dict[str, npt.NDArray[np.generic]] = {}
        for name, (offset, form, shape) in places.items():
            if name in FIELDS:
                content.seek(offset)
                raw = content.read(math.prod(shape) * np.dtype(form).itemsize)
                found[name] = np.frombuffer(raw, dtype=form).reshape(shape)
        return found


FIELDS = {
    "description": 1, "theta_i": 1, "phi_i": 1, "wavelengths": 1, "ndf": 2, "sigma": 2, "vndf": 4, "spectra": 5, "rgb": 5,
    "jacobian": 1,
}  # fmt: skip
"""The number of axes of each field that is read."""


def _material(
    path: StrPath, fields: Mapping[str, npt.NDArray[np.generic]]
) -> tuple[_Material, tuple[float, ...] | None, str]:  # fmt: skip
    """The checked fields, the wavelengths (None for red, green and blue), and the description. Raises FormatError."""
    grid = "spectra" if "spectra" in fields or "rgb" not in fields else "rgb"
    needed = ["theta_i", "phi_i", "vndf", "ndf", "sigma", grid, *(["wavelengths"] if grid == "spectra" else [])]
    for name in needed:
        if name not in fields:
            remedy = "give a material for Mitsuba's plugin measured; measured_polarized is not read"
            raise FormatError(path, f"is a tensor file without the field {name}", remedy)
    for name, each in fields.items():
        if each.ndim != FIELDS[name] or each.size == 0:
            raise FormatError(path, f"the field {name} has the shape {each.shape}", COPY_AGAIN)
        if name != "description" and (each.dtype.kind not in "fu" or not np.isfinite(each).all()):
            raise FormatError(path, f"the field {name} has values that are not finite numbers", COPY_AGAIN)
    theta, phi, values, warp = (fields[name] for name in ("theta_i", "phi_i", grid, "vndf"))
    channels = fields["wavelengths"].size if grid == "spectra" else 3
    if values.shape[:3] != (phi.size, theta.size, channels) or warp.shape[:2] != (phi.size, theta.size):
        wrong = f"{grid} has the shape {values.shape} and vndf {warp.shape}, for {phi.size} phi_i and {theta.size} theta_i"
        raise FormatError(path, wrong, COPY_AGAIN)
    if min(*values.shape[3:], *warp.shape[2:], *fields["ndf"].shape, *fields["sigma"].shape) < 2:
        raise FormatError(path, "a grid has fewer than two rows or columns", COPY_AGAIN)
    if (np.asarray(warp, dtype=np.float64) < 0.0).any() or (np.asarray(fields["sigma"], dtype=np.float64) <= 0.0).any():
        raise FormatError(path, "vndf or sigma has negative values", COPY_AGAIN)
    angles = [np.asarray(each, dtype=np.float64) for each in (theta, phi)]
    if any(np.any(np.diff(each) <= 0.0) for each in angles) or angles[0][0] < 0.0 or angles[0][-1] > 0.5 * math.pi + 1e-6:
        raise FormatError(path, "theta_i or phi_i does not ascend, or theta_i is outside 0 to pi / 2", COPY_AGAIN)
    if angles[1].size > 2 and not 0.24 * math.pi < angles[1][-1] - angles[1][0] < 2.001 * math.pi:
        raise FormatError(path, "phi_i is neither a turn nor a half or a quarter of one", COPY_AGAIN)
    given = fields.get("description", np.zeros(0, np.uint8))
    description = given.astype(np.uint8).tobytes().decode("utf-8", "replace").rstrip("\0 ")
    wavelengths = None
    if grid == "spectra":
        wavelengths = tuple(np.asarray(fields["wavelengths"], dtype=np.float64).tolist())
    jacobian = bool(np.any(fields.get("jacobian", np.zeros(1, np.uint8)).astype(bool)))
    ndf, sigma = (np.asarray(fields[name], dtype=np.float64) for name in ("ndf", "sigma"))
    values32, warp32 = (np.asarray(each, dtype=np.float32) for each in (values, warp))
    return _Material(angles[0], angles[1], values32, warp32, ndf, sigma, jacobian), wavelengths, description


def _table(path: StrPath, material: _Material, wavelengths: tuple[float, ...] | None, description: str) -> BsdfTable:
    """A material on specular coordinates."""
    sigma = np.minimum(np.round(np.degrees(material.theta_i), DECIMALS), 90.0)
    psi, light = _azimuths(material)
    mirrored = material.isotropic and _is_mirrored(material.values)
    phi = np.arange(0.0, (180.0 if mirrored else TURN_DEG) + 1.0, 5.0)
    side = max(material.values.shape[-1], material.values.shape[-2], LEAST_THETAS)
    others = material.values.shape[2] * psi.size * sigma.size * phi.size
    thetas = min(side, MOST_VALUES // others)
    if thetas < FEWEST_THETAS:
        wrong = f"has {material.values.shape[2]} channels at {psi.size} azimuths and {sigma.size} polar angles of the light"
        raise FormatError(path, f"{wrong}, too many for a table", "leave out wavelengths")
    theta = 180.0 * np.linspace(0.0, 1.0, thetas) ** 2
    shape = (material.values.shape[2], psi.size, sigma.size, phi.size, theta.size)
    values, known = np.empty(shape), np.empty(shape, dtype=bool)
    for n, azimuth in enumerate(light):
        for k in range(sigma.size):
            values[:, n, k], known[:, n, k] = _cut(material, azimuth, k, float(sigma[k]), phi, theta)
    lines = tuple(line for line in description.splitlines() if line.strip())
    grey = wavelengths is not None and len(wavelengths) == 1 and GREY in lines
    simulated = "SIMULATED" in lines
    sample = next((line.removeprefix("sample: ") for line in lines if line.startswith("sample: ")), "")
    about = "values near and below the horizon go on those above it along theta, and are marked as not measured"
    return BsdfTable(
        sigma, phi, theta, values, None if grey or wavelengths is None else wavelengths, psi, generated=simulated,
        comments=(*lines, about), known=known, sample=sample, colours=() if wavelengths is not None else COLOURS,
    )  # fmt: skip


COLOURS = ("red", "green", "blue")
LEAST_THETAS, FEWEST_THETAS = 181, 31
DECIMALS = 4
"""Of degrees, which a file has in rad and 32 bits."""


def _is_mirrored(values: Singles) -> bool:
    """Whether an isotropic material is the same on both sides of the plane of incidence: its rows, with the ends included."""
    limit = 1e-5 * float(np.abs(values).max())
    return values.shape[-2] > 2 and bool(np.all(np.abs(values - values[..., ::-1, :]) <= limit))


def _azimuths(material: _Material) -> tuple[Floats, list[float]]:
    """The azimuths of the light in degrees, ascending from 0 on, and the same in rad as Mitsuba has them."""
    if material.isotropic:
        return np.zeros(1), [0.0]
    own = np.degrees(material.phi_i)
    found = own
    if material.repeats == 2:
        found = np.concatenate([own, own + 180.0])
    elif material.repeats == 4:
        found = np.concatenate([own, -own, own + 180.0, 180.0 - own])
    psi = np.unique(wrap_azimuth(np.round(found, DECIMALS)))
    return psi, np.radians(np.where(psi > 180.0, psi - TURN_DEG, psi)).tolist()


def _cut(
    material: _Material, phi_i: float, k: int, sigma_deg: float, phi_deg: Floats, theta_deg: Floats
) -> tuple[Floats, Flags]:  # fmt: skip
    """Values (channel, phi, theta) in 1/sr at one incidence, and whether they are those of the file."""
    out = from_specular(sigma_deg, theta_deg[None, :], phi_deg[:, None]).reshape(-1, 3)
    light = light_direction(sigma_deg)
    if not material.isotropic:
        cos, sin = math.cos(phi_i), math.sin(phi_i)
        turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        out, light = out @ turn, light @ turn
    above: Flags = np.asarray(out[:, 2] > LEAST_COSINE)
    if material.repeats >= 2:  # as Mitsuba turns or mirrors both directions to where the file has them
        y = -1.0 if light[1] >= 0.0 else 1.0
        x = y if material.repeats == 2 else (-1.0 if light[0] >= 0.0 else 1.0)
        out, light = out * [x, y, 1.0], light * [x, y, 1.0]
    azimuth = math.atan2(light[1], light[0])
    half = out + light
    half /= np.maximum(np.linalg.norm(half, axis=1), 1e-300)[:, None]
    theta_m = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(half - [0.0, 0.0, 1.0], axis=1), 1.0))
    phi_m = np.arctan2(half[:, 1], half[:, 0]) - (azimuth if material.isotropic else 0.0)
    u = np.stack([np.sqrt(np.clip(theta_m / (0.5 * np.pi), 0.0, 1.0)), ((phi_m + np.pi) / (2.0 * np.pi)) % 1.0], axis=1)
    n, share = (0, 0.0) if material.isotropic else _azimuth_place(material.phi_i, azimuth)
    found = _warped(material, n, k, u)
    if share > 0.0:
        found = (1.0 - share) * found + share * _warped(material, n + 1, k, u)
    if material.jacobian:
        at_light = np.array([[math.sqrt(math.radians(sigma_deg) * 2.0 / math.pi), (azimuth + math.pi) / (2.0 * math.pi)]])
        found *= _bilinear(material.ndf[None], u) / (4.0 * _bilinear(material.sigma[None], at_light))
    values = (found / np.maximum(out[:, 2], LEAST_COSINE)).reshape(-1, phi_deg.size, theta_deg.size)
    known: Flags = np.asarray(above).reshape(phi_deg.size, theta_deg.size)
    for j in range(phi_deg.size):
        if known[j].any() and not known[j].all():
            for channel in values:
                channel[j, ~known[j]] = np.interp(theta_deg[~known[j]], theta_deg[known[j]], channel[j, known[j]])
    return np.where(np.asarray(known.any(axis=1))[:, None], values, 0.0), known


def _azimuth_place(phi_i: Floats, azimuth: float) -> tuple[int, float]:
    (n,), (share,) = _place(phi_i, np.array([azimuth]))
    return int(n), 0.0 if share < 1e-5 else float(share)


def _warped(material: _Material, n: int, k: int, u: Floats) -> Floats:
    """Values (channel, m) of one slice at places u (m, 2) before the warp: the inverse of the warp, then bilinear."""
    return _bilinear(material.values[n, k].astype(np.float64), _inverse_warp(material.warp[n, k].astype(np.float64), u))


def _inverse_warp(density: Floats, u: Floats) -> Floats:
    """The random numbers (m, 2) from which a density (rows, columns), linear between its nodes, gives the places u (m, 2).

    First the share of the light in all rows below, then that in the row's columns before.
    """
    rows, columns = density.shape
    of_row = np.concatenate([np.zeros((rows, 1)), np.cumsum(0.5 * (density[:, 1:] + density[:, :-1]), axis=1)], axis=1)
    whole = of_row[:, -1]
    of_all = np.concatenate([[0.0], np.cumsum(0.5 * (whole[1:] + whole[:-1]))])
    x, y = np.clip(u, 0.0, 1.0).T * np.array([[columns - 1], [rows - 1]])
    i, j = np.minimum(x.astype(np.int64), columns - 2), np.minimum(y.astype(np.int64), rows - 2)
    a, b = x - i, y - j
    first = (1.0 - b) * density[j, i] + b * density[j + 1, i]
    second = (1.0 - b) * density[j, i + 1] + b * density[j + 1, i + 1]
    before = (1.0 - b) * of_row[j, i] + b * of_row[j + 1, i] + a * (first + 0.5 * a * (second - first))
    total = (1.0 - b) * whole[j] + b * whole[j + 1]
    below = of_all[j] + b * (whole[j] + 0.5 * b * (whole[j + 1] - whole[j]))
    return np.stack([before / np.maximum(total, 1e-300), below / max(float(of_all[-1]), 1e-300)], axis=1)


def _bilinear(grids: Floats, u: Floats) -> Floats:
    """Grids (channel, rows, columns) at places u (m, 2), column first."""
    _, rows, columns = grids.shape
    x, y = np.clip(u, 0.0, 1.0).T * np.array([[columns - 1], [rows - 1]])
    i, j = np.minimum(x.astype(np.int64), columns - 2), np.minimum(y.astype(np.int64), rows - 2)
    a, b = x - i, y - j
    near = (1.0 - a) * grids[:, j, i] + a * grids[:, j, i + 1]
    far = (1.0 - a) * grids[:, j + 1, i] + a * grids[:, j + 1, i + 1]
    return np.asarray((1.0 - b) * near + b * far)
