"""Tensor files of measured materials (RGL, EPFL; Dupuy and Jakob 2018), which Mitsuba 3 reads as its plugin `measured`.

A header names fields with their type, shape and place; numbers are little-endian. The BRDF is a grid over the half vector m of
both directions: column u = sqrt(2 theta_m / pi), row v = (phi_m - phi_i + pi) / (2 pi), both 0 to 1 with the ends included; of
an anisotropic material v has phi_m itself. The field `vndf` warps that square; `spectra` has values on the warped one, times
the cosine of the observed direction and, where `jacobian` is set, 4 sigma / ndf. Sources: Mitsuba's src/bsdfs/measured.cpp and
include/mitsuba/core/distr_2d.h, the files of https://rgl.epfl.ch/materials.

A table is written without a warp (vndf 1), with ndf = 4 and sigma = 1, so that `spectra` is f cos(theta_o) alone. Rows, columns
and incidences are as many as it takes for the linear interpolation of a reader to follow the narrowest lobe. Below the horizon
the values go on smoothly, with a negative cosine, because readers interpolate across it. The deviation of the file from the
table is measured at random directions, and stated in the file; so is what the table's own steps leave open. `luminance` is by
what a path tracer draws directions. A file is read as Mitsuba reads it, onto specular coordinates.
"""

import heapq
import itertools
import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.coverage import is_whole_turn
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
"""Values that are written, four bytes each; of an anisotropic table half of them, if that is enough for its own incidences."""
TOLERANCE = 0.003
"""Relative deviation of a reader's linear interpolation, down to LOWEST of the largest value at a sigma."""
LOWEST = 0.01
FINEST_SIGMA_DEG = 0.7
WIDEST_PSI_DEG = 10.0
ANISOTROPIC_TOLERANCE, ANISOTROPIC_PART = 0.01, 0.99
"""Of an anisotropic table, whose nodes go to azimuths of the light, too: a wider tolerance, in this part of the directions."""
HIGHEST_SIDE_DEG, HIGHEST_PROBED_DEG = 60.0, 75.0
"""Rows and columns are chosen for sigmas up to the first, incidences up to the second: beyond, half vectors crowd."""
PROBED = 128
"""Rows and columns that are probed, of as many as there are."""
PROBED_LIGHTS, PROBED_AT_EACH = 48, 200
"""Random directions at which the deviation is measured that a file states: lights, and half vectors or nodes at each."""
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


def write(path: Path, content: BsdfFile) -> list[str]:
    """Write the table of a file. Raises FormatError for what the format does not hold.

    Returns by how much what is read from the file is off, in words.
    """
    table = _writable(path, content)
    return write_table(path, replace(table, comments=(*content.comments, *table.comments)))


def write_table(path: Path, table: BsdfTable, most_nodes: int = MOST_NODES) -> list[str]:
    """Write a table; with fewer nodes than it asks for, the file is smaller and less exact. Raises FormatError.

    Returns by how much what is read from the file is off, in words.
    """
    table = _writable(path, BsdfFile((table,)))
    samples = HalfVectorSamples(table, most_nodes)
    side, sigmas = samples.grid()
    wavelengths = table.wavelengths_nm or (GREY_NM,)
    notes = [*_words("the file is off from the table by up to", samples.deviation(side, sigmas))]
    notes += _words("between its own nodes the table itself is known to about", samples.steps())
    lines = [
        f"sample: {table.sample}" if table.sample else "",
        GREY if table.wavelengths_nm is None else "",
        "SIMULATED" if table.generated else "",
        f"half vectors {side} x {side} at {sigmas.size} incidences and {samples.psi_deg.size} azimuths of the light",
        *notes,
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
    return notes


def _words(what: str, deviations: Floats) -> list[str]:
    """Relative deviations (n,) in a line; none where there are none."""
    if not deviations.size:
        return []
    usual, most = (float(f"{100.0 * each:.2g}") for each in (np.quantile(deviations, 0.95), deviations.max()))
    where = f"where the value is at least {100.0 * LOWEST:g} % of the peak"
    return [f"{what} {usual:g} % in 95 of 100 directions, {most:g} % at most, {where}"]


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
    if table.psi_deg.size > 1 and not is_whole_turn(table.psi_deg):
        wrong = f"its azimuths of the light, {table.psi_deg[0]:g} to {table.psi_deg[-1]:g} deg, are not a whole turn"
        raise FormatError(path, wrong, "write a table with all of them; an rgl file here has no symmetry")
    psi = 1 if table.psi_deg.size == 1 else _azimuths_to_write(table.psi_deg).size
    if table.values.shape[0] * psi * table.sigma_deg.size * SIDES[0] ** 2 > MOST_NODES:
        wrong = f"the {table.values.shape[0]} wavelengths at {table.sigma_deg.size} sigmas are too many for an rgl file"
        raise FormatError(path, wrong, "write fewer wavelengths")
    return table


def _parts(
    shapes: Mapping[str, tuple[str, tuple[int, ...]]],
    small: Mapping[str, npt.NDArray[np.generic]],
    samples: "HalfVectorSamples",
    sigmas: Floats,
    side: int,
) -> Iterator[bytes]:
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
    u, v = _square(side)
    theta_m, phi_m = _half_angles(u, v)
    towards = _vectors(theta_m, phi_m - math.radians(psi_deg)) @ light_direction(sigma_deg)
    wide = np.maximum(towards, 0.0) * np.sin(theta_m) * u
    found: Floats = np.maximum(values, 0.0) * wide
    return np.asarray(found + 0.05 * max(float(found.mean()), 1e-12) * (1.0 + wide))


def _square(side: int) -> tuple[Floats, Floats]:
    """u (side,) and v (side, 1) of the nodes."""
    return np.linspace(0.0, 1.0, side), np.linspace(0.0, 1.0, side)[:, None]


def _half_angles(u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """theta_m and phi_m of half vectors, in rad."""
    return 0.5 * np.pi * u**2, (2.0 * v - 1.0) * np.pi


def _missed(axis: Floats, values: Floats, at: Ints) -> Floats:
    """A quarter of the differences (channel, m) of values (channel, m, nodes), at the node of each, from the line between those
    before and after it; at an end of the axis, of the next node's. 0 where there are fewer than three."""
    if axis.size < 3:
        return np.zeros(values.shape[:2])
    here = np.clip(at, 1, axis.size - 2)
    share = (axis[here] - axis[here - 1]) / (axis[here + 1] - axis[here - 1])
    before, own, after = (np.take_along_axis(values, (here + step)[None, :, None], axis=2)[..., 0] for step in (-1, 0, 1))
    return np.asarray(0.25 * np.abs(own - (1.0 - share) * before - share * after))


def _around(axis: Floats, at: float) -> list[tuple[float, float]]:
    """The two nodes of an axis around a place, or the one at it, with their weights."""
    (k,), (share,) = _place(axis, np.array([at]))
    return [(float(axis[k + m]), float(weight)) for m, weight in ((0, 1.0 - share), (1, share)) if weight > 0.0]


def _without_bend(exact: Floats, bend: Floats) -> Floats:
    """Nodes for a reader that interpolates linearly, of exact values and their second differences.

    Between nodes such a reader is off by an eighth of the second differences. With half of that subtracted at the nodes it is
    off by as much there, with the other sign, and nowhere by more.
    """
    most = 0.1 * np.abs(exact)
    return np.asarray(exact - np.clip(bend / 16.0, -most, most))


def _vectors(theta: Floats, phi: Floats) -> Floats:
    """Unit vectors (rows, columns, 3) of polar angles (columns,) and azimuths (rows, 1)."""
    sine = np.sin(theta)
    x, y = sine * np.cos(phi), sine * np.sin(phi)
    return np.stack([x, y, np.broadcast_to(np.cos(theta), x.shape)], axis=-1)


def _whole_turn(psi_deg: Floats) -> Floats:
    """Azimuths of the light, with the first again at the end of the turn."""
    return psi_deg if psi_deg[-1] - psi_deg[0] == TURN_DEG else np.append(psi_deg, psi_deg[0] + TURN_DEG)


def _azimuths_to_write(psi_deg: Floats) -> Floats:
    """Those of the table and others between them, from -180 to 180."""
    pairs = itertools.pairwise(_whole_turn(psi_deg).tolist())
    parts = [np.linspace(a, b, math.ceil((b - a) / WIDEST_PSI_DEG), endpoint=False) for a, b in pairs]
    turned = wrap_azimuth(np.concatenate(parts) + 180.0) - 180.0
    return np.unique(np.round(np.concatenate([[-180.0], turned, [180.0]]), 9))


class HalfVectorSamples:
    """A table, evaluated at half vectors as a sample of the twin is: linear in phi and theta, a monotone cubic in sigma.

    Between azimuths of the light it is another interpolation: a lobe of brushed metal stays at its half vectors while the light
    turns, and one that is linear in psi at a theta and a phi shows it twice.

    `psi_deg` are the azimuths of the light that are written: 0 alone, or from -180 to 180.
    """

    def __init__(self, table: BsdfTable, most_nodes: int = MOST_NODES) -> None:
        self.table, self._most = table, most_nodes if table.psi_deg.size == 1 else most_nodes // 2
        self._tolerance, self._part = (TOLERANCE, 1.0) if table.psi_deg.size == 1 else (ANISOTROPIC_TOLERANCE, ANISOTROPIC_PART)
        phi, psi = table.phi_deg, table.psi_deg
        # The tail of a lobe can be so small that its slopes overflow.
        values = np.where(np.abs(table.values) < 1e-30 * np.abs(table.values).max(), 0.0, table.values)
        if phi.size > 1 and phi[0] == 0.0 and 180.0 < phi[-1] < TURN_DEG:
            values, phi = np.concatenate([values, values[:, :, :, :1]], axis=3), np.append(phi, TURN_DEG)
        self.psi_deg = np.zeros(1)
        if psi.size > 1:
            if psi[-1] - psi[0] < TURN_DEG:
                values = np.concatenate([values, values[:, :1]], axis=1)
            psi = _whole_turn(psi)
            self.psi_deg = _azimuths_to_write(psi)
            values = np.concatenate([values, np.abs(values[:, :-1]).mean(axis=1, keepdims=True)], axis=1)
        self._phi, self._psi, self._values = phi, psi, values
        self._slopes = np.stack([[slopes(table.sigma_deg, block) for block in channel] for channel in values])
        # Three channels show what the others need.
        self._probed = sorted({0, values.shape[0] // 2, values.shape[0] - 1})
        self._at_probes: dict[float, tuple[Floats, Flags]] = {}

    @property
    def _mirrored(self) -> bool:
        """Whether the half vectors on both sides of the plane of incidence have the same values."""
        return self._psi.size == 1 and bool(self._phi[-1] <= 180.0)

    def _at_sigma(self, psi: int, sigma_deg: float, channels: Sequence[int]) -> Floats:
        """Values (channel, phi, theta) at an azimuth of the table; at the last of `_values`, their mean over all azimuths."""
        axis, chosen = self.table.sigma_deg, list(channels)
        (k,), (a,) = _place(axis, np.array([sigma_deg]))
        near, slope_near = self._values[chosen, psi, k], self._slopes[chosen, psi, k]
        if a == 0.0:
            return np.asarray(near)
        far, slope_far = self._values[chosen, psi, k + 1], self._slopes[chosen, psi, k + 1]
        step, rest = axis[k + 1] - axis[k], 1.0 - a
        total = rest**2 * (1.0 + 2.0 * a) * near + a**2 * (3.0 - 2.0 * a) * far
        return np.asarray(total + step * a * rest**2 * slope_near - step * a**2 * rest * slope_far)

    def at(
        self, psi_deg: float, sigma_deg: float, theta_m: Floats, phi_m: Floats, channels: Sequence[int] | None = None
    ) -> tuple[Floats, Flags]:
        """f cos(theta_o) (channel, ...) at half vectors, and whether (...) the observed direction is well above the horizon.

        The azimuth of the half vectors is counted from the light's, or that of the sample for an anisotropic one; rad. What an
        anisotropic sample has of its own stays at a half vector while the light turns; what it has of an isotropic one, the
        mean over all azimuths, turns with the light. So the ratio of the two is linear between azimuths, at the half vector.
        """
        wanted = range(self.table.values.shape[0]) if channels is None else channels
        if self._psi.size == 1:
            around = [(0, 1.0)]
        else:
            (n,), (share,) = _place(self._psi, np.array([self._psi[0] + (psi_deg - self._psi[0]) % TURN_DEG]))
            around = [(each, weight) for each, weight in ((int(n), 1.0 - share), (int(n) + 1, share)) if weight > 0.0]
        return self._of_azimuths(around, psi_deg, sigma_deg, theta_m, phi_m, wanted)

    def _of_azimuths(
        self,
        around: Sequence[tuple[int, float]],
        psi_deg: float,
        sigma_deg: float,
        theta_m: Floats,
        phi_m: Floats,
        channels: Sequence[int],
    ) -> tuple[Floats, Flags]:
        """As `at`, from azimuths of the table with their weights."""
        out, place = self._directions(psi_deg, sigma_deg, theta_m, phi_m)
        if len(around) == 1:
            found = self._looked_up(self._at_sigma(around[0][0], sigma_deg, channels), place)
        else:
            mean, found = self._at_sigma(-1, sigma_deg, channels), np.zeros(())
            for n, weight in around:
                cut = self._at_sigma(n, sigma_deg, channels)
                both = self._looked_up(
                    np.concatenate([cut, mean]), self._directions(float(self._psi[n]), sigma_deg, theta_m, phi_m)[1]
                )
                own, of_mean = np.split(both, 2)
                found = found + weight * np.divide(own, of_mean, out=np.zeros_like(own), where=of_mean > 0.0)
            found = found * self._looked_up(mean, place)
        return found * out[..., 2], np.asarray(out[..., 2] > NEAR_HORIZON)

    def _directions(self, psi_deg: float, sigma_deg: float, theta_m: Floats, phi_m: Floats) -> tuple[Floats, Floats]:
        """The observed directions (..., 3) of half vectors, the light at azimuth 0; and their theta and phi (2, ...), deg."""
        half = _vectors(theta_m, phi_m - math.radians(psi_deg))
        light = light_direction(sigma_deg)
        out = 2.0 * (half @ light)[..., None] * half - light
        return out, np.stack(to_specular(sigma_deg, out))

    def _looked_up(self, cut: Floats, place: Floats) -> Floats:
        """Cuts (channel, phi, theta) at theta and phi (2, ...)."""
        theta, phi = place
        if self._phi[-1] <= 180.0:
            phi = np.minimum(phi, TURN_DEG - phi)
        (j, b), (k, c) = _place(self._phi, phi), _place(self.table.theta_deg, theta)
        rows, columns = cut.shape[1:]
        flat = cut.reshape(cut.shape[0], rows * columns)
        j, j1, k1 = j * columns, np.minimum(j + 1, rows - 1) * columns, np.minimum(k + 1, columns - 1)
        near = (1.0 - c) * flat[:, j + k] + c * flat[:, j + k1]
        far = (1.0 - c) * flat[:, j1 + k] + c * flat[:, j1 + k1]
        return np.asarray((1.0 - b) * near + b * far)

    def nodes(self, psi_deg: float, sigma_deg: float, side: int, channels: list[int] | None = None) -> Floats:
        """f cos(theta_o) (channel, side, side) on the grid of the half vector, for a reader that interpolates linearly."""
        theta_m, phi_m = _half_angles(*_square(side))
        if self._mirrored:
            half, _ = self.at(psi_deg, sigma_deg, theta_m, phi_m[: (side + 1) // 2], channels)
            exact = np.concatenate([half, half[:, side // 2 - 1 :: -1]], axis=1)
        else:
            exact, _ = self.at(psi_deg, sigma_deg, theta_m, phi_m, channels)
        bend = np.zeros_like(exact)
        bend[:, :, 1:-1] = np.diff(exact, n=2, axis=2)
        bend[:, 1:-1] += np.diff(exact, n=2, axis=1)
        return _without_bend(exact, bend)

    def grid(self) -> tuple[int, Floats]:
        """Rows and columns of the half vector, and the sigmas: those of the table, and others between them.

        The least of SIDES that suffices, with as many sigmas; where there is no room for both, those that are off by the least.
        """
        slices = self.table.values.shape[0] * self.psi_deg.size
        sides = [each for each in SIDES if slices * self.table.sigma_deg.size * each**2 <= self._most] or [SIDES[0]]
        best, least = (sides[0], self.table.sigma_deg), math.inf
        for side in sides:
            of_half_vectors = self._worst_between_half_vectors(side)
            sigmas, of_sigmas = self._sigmas(self._most // (slices * side**2))
            if of_half_vectors + of_sigmas < least:
                best, least = (side, sigmas), of_half_vectors + of_sigmas
            if max(of_half_vectors, of_sigmas) <= self._tolerance:
                break
        return best

    def _sigmas(self, most: int) -> tuple[Floats, float]:
        """At most so many sigmas, one after another where the interpolation needs it most; and how much it is still off."""
        found = self.table.sigma_deg.tolist()
        split = [(-self._worst_between_sigmas(a, b), a, b) for a, b in itertools.pairwise(found)]
        heapq.heapify(split)
        worst = 0.0
        while split and -split[0][0] > self._tolerance:
            off, first, last = heapq.heappop(split)
            if len(found) >= most or last - first <= FINEST_SIGMA_DEG:
                worst = max(worst, -off)
                continue
            middle = 0.5 * (first + last)
            found.append(middle)
            for a, b in ((first, middle), (middle, last)):
                heapq.heappush(split, (-self._worst_between_sigmas(a, b), a, b))
        return np.array(sorted(found)), max(worst, -split[0][0] if split else 0.0)

    def deviation(self, side: int, sigmas: Floats) -> Floats:
        """Relative deviations (n,) of the file, as it is read, from the table at random directions, light up to 75 deg."""
        random = np.random.default_rng(1)
        highest, found = min(float(sigmas[-1]), HIGHEST_PROBED_DEG), []
        for at in random.random((PROBED_LIGHTS, 2)).tolist():
            sigma = float(sigmas[0]) + at[0] * max(highest - float(sigmas[0]), 0.0)
            psi = float(self.psi_deg[0]) + at[1] * float(self.psi_deg[-1] - self.psi_deg[0])
            v, u = random.random((2, PROBED_AT_EACH, 1, 1))
            exact, above = self.at(psi, sigma, *_half_angles(u, v), self._probed)
            found.append(_deviations(self._read(psi, sigma, side, sigmas, u, v), exact, above))
        return np.concatenate(found)

    def _read(self, psi_deg: float, sigma_deg: float, side: int, sigmas: Floats, u: Floats, v: Floats) -> Floats:
        """f cos(theta_o) (channel, n, 1, 1), as a reader has it, at places u and v (n, 1, 1) of the half vector."""
        (column, a), (row, b) = (_place(np.arange(side, dtype=np.float64), each * (side - 1)) for each in (u, v))
        # The four nodes of the cell and those around them.
        x, y = column + np.arange(-1, 3), row + np.arange(-1, 3)[:, None]
        theta_m, phi_m = _half_angles(*(np.clip(each, 0, side - 1) / (side - 1) for each in (x, y)))
        between = [(each[..., 1:-1] > 0) & (each[..., 1:-1] < side - 1) for each in (x, y.swapaxes(1, 2))]
        weights = np.concatenate([1.0 - b, b], axis=1) * np.concatenate([1.0 - a, a], axis=2)
        total = np.zeros(())
        for psi, of_psi in _around(self.psi_deg, psi_deg):
            for sigma, of_sigma in _around(sigmas, sigma_deg):
                exact, _ = self.at(psi, sigma, theta_m, phi_m, self._probed)
                bend = np.where(between[0], np.diff(exact[..., 1:-1, :], n=2, axis=-1), 0.0)
                bend += np.where(between[1].swapaxes(1, 2), np.diff(exact[..., 1:-1], n=2, axis=-2), 0.0)
                nodes = _without_bend(exact[..., 1:-1, 1:-1], bend)
                total = total + of_psi * of_sigma * (weights * nodes).sum(axis=(2, 3))
        return total[..., None, None]

    def steps(self) -> Floats:
        """Relative deviations (n,) that the interpolation between the table's own nodes may have, at nodes at random.

        The deviation of a value from an interpolation without it, of twice the step, is four times that between two nodes. It
        is computed for each axis; their squares are added up.
        """
        random, table, found = np.random.default_rng(1), self.table, []
        lit = np.flatnonzero(table.sigma_deg <= HIGHEST_PROBED_DEG)
        turns = max(self._psi.size - 1, 1)
        for _ in range(PROBED_LIGHTS if lit.size else 0):
            n, s = int(random.integers(turns)), int(random.choice(lit))
            sigma, psi, block = float(table.sigma_deg[s]), float(self._psi[n]), self._values[self._probed, n]
            j, k = random.integers([[self._phi.size], [table.theta_deg.size]], size=(2, PROBED_AT_EACH))
            exact, total = block[:, s, j, k], np.zeros((len(self._probed), PROBED_AT_EACH))
            for axis, values, at in (
                (table.sigma_deg, block[:, :, j, k].swapaxes(1, 2), np.full(j.size, s)),
                (self._phi, block[:, s, :, k].swapaxes(0, 1), j),
                (table.theta_deg, block[:, s, j], k),
            ):
                total = np.hypot(total, _missed(axis, values, at))
            out = from_specular(sigma, table.theta_deg[k], self._phi[j])
            if turns > 1:
                half = out + light_direction(sigma)
                theta_m = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
                before, after = (n - 1) % turns, n + 1
                apart = [(psi - self._psi[before]) % TURN_DEG, float(self._psi[after]) - psi]
                around = [(before, apart[1] / sum(apart)), (after, apart[0] / sum(apart))]
                phi_m = np.arctan2(half[:, 1], half[:, 0])[:, None] + math.radians(psi)
                without, _ = self._of_azimuths(around, psi, sigma, theta_m[:, None], phi_m, self._probed)
                total = np.hypot(total, 0.25 * (exact - without[..., 0] / np.maximum(out[:, 2], NEAR_HORIZON)))
            counted = (out[:, 2] > NEAR_HORIZON) & (exact >= LOWEST * block[:, s].max(axis=(1, 2))[:, None]) & (exact > 0.0)
            if table.known is not None:
                counted &= table.known[self._probed, n % table.psi_deg.size, s][:, j % table.phi_deg.size, k]
            found.append(total[counted] / exact[counted])
        return np.concatenate(found) if found else np.zeros(0)

    def _worst_between_half_vectors(self, side: int) -> float:
        """The largest relative deviation in the middle between four nodes, at some of the table's sigmas."""
        probed = [sigma for sigma in self.table.sigma_deg.tolist() if sigma <= HIGHEST_SIDE_DEG] or [self.table.sigma_deg[0]]
        u = np.linspace(0.0, 1.0, side)
        middle = 0.5 * (u[1:] + u[:-1])
        rows = side // 2 if self._mirrored else side
        theta_m, phi_m = _half_angles(middle, middle[:, None])
        psi, worst = float(self.psi_deg[self.psi_deg.size // 2]), 0.0
        for sigma in {probed[0], probed[len(probed) // 2], probed[-1]}:
            nodes = self.nodes(psi, sigma, side, self._probed)[:, :rows]
            read = 0.25 * (nodes[:, 1:, 1:] + nodes[:, 1:, :-1] + nodes[:, :-1, 1:] + nodes[:, :-1, :-1])
            worst = max(worst, self._of_most(_deviations(read, *self._at_probe(sigma, theta_m, phi_m, rows - 1))))
        return worst

    def _worst_between_sigmas(self, first: float, last: float) -> float:
        """The largest relative deviation half way between two sigmas."""
        if first >= HIGHEST_PROBED_DEG:
            return 0.0
        middle = 0.5 * (first + last)
        for sigma in (first, middle, last):
            if sigma not in self._at_probes:
                rows = PROBED // 2 if self._mirrored else PROBED
                self._at_probes[sigma] = self._at_probe(sigma, *_half_angles(*_square(PROBED)), rows)
        read = 0.5 * (self._at_probes[first][0] + self._at_probes[last][0])
        return self._of_most(_deviations(read, *self._at_probes[middle]))

    def _of_most(self, deviations: Floats) -> float:
        """The largest deviation (n,) in the part of the directions that counts; 0 where there are none."""
        return float(np.quantile(deviations, self._part)) if deviations.size else 0.0

    def _at_probe(self, sigma_deg: float, theta_m: Floats, phi_m: Floats, rows: int) -> tuple[Floats, Flags]:
        """As `at`, of some channels at the middle azimuth of the light, for the first rows."""
        return self.at(float(self.psi_deg[self.psi_deg.size // 2]), sigma_deg, theta_m, phi_m[:rows], self._probed)


def _deviations(read: Floats, exact: Floats, above: Flags) -> Floats:
    """Relative deviations (n,) above the horizon, of values (channel, ...) of at least LOWEST of the largest."""
    highest = np.abs(exact).max(axis=tuple(range(1, exact.ndim)), keepdims=True)
    counted = above & (exact >= LOWEST * highest) & (highest > 0.0)
    return np.asarray(np.abs(read - exact)[counted] / exact[counted])


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
    "description": 1,
    "theta_i": 1,
    "phi_i": 1,
    "wavelengths": 1,
    "ndf": 2,
    "sigma": 2,
    "vndf": 4,
    "spectra": 5,
    "rgb": 5,
    "jacobian": 1,
}
"""The number of axes of each field that is read."""


def _material(path: StrPath, fields: Mapping[str, npt.NDArray[np.generic]]) -> tuple[_Material, tuple[float, ...] | None, str]:
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
        sigma,
        phi,
        theta,
        values,
        None if grey or wavelengths is None else wavelengths,
        psi,
        generated=simulated,
        comments=(*lines, about),
        known=known,
        sample=sample,
        colours=() if wavelengths is not None else COLOURS,
    )


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
) -> tuple[Floats, Flags]:
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
