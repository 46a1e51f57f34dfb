"""What a file of a BSDF holds, whatever its format: grids, scattered points and regular factors, with what is known about them.

The frame of all directions is the sample's: z is the normal of the lit side, and the azimuth 0 is the sample's mark. The light
comes from the polar angle sigma and the azimuth psi; without psi it comes from azimuth 0, as on an isotropic sample.
"""

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from goniotwin.app.columns import (
    ColumnTable,
    Degrees,
    FlagColumn,
    KnownPerSteradian,
    Nanometres,
    NumberedColumn,
    PerSteradian,
    TextColumn,
)
from goniotwin.app.formats.metadata import Metadata
from goniotwin.app.formats.numerals import finite_array
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Flags, Floats, Ints, ReadOnlyArrays, Texts
from goniotwin.twin.optics import from_specular, to_specular
from goniotwin.twin.optics.geometry.coordinates import TOLERANCE_DEG, arc_direction, wrap_azimuth, zenith_and_azimuth

ABSENT: Any = None
"""A column that is not given; it is filled in when the values are made, so that it is an array for whatever reads it."""
FILLED = "filled"
"""Flag of a value that a table has where none was measured."""
CHECK = "mirrored"
"""Flag of a direction that was measured only to check the stated symmetry."""
UNTRUSTED = frozenset(
    {
        FILLED,
        "shadowed",
        "clipped",
        "no-etalon",
        "dead",
        "uncertified",
        "drift",
        "module",
        "monitor",
        "contradiction",
        "scale",
        "hidden",
        "no-hits",
    }
)
"""Flags of values that are not to be trusted."""
ISOTROPIC = "taken as isotropic: both sides of the plane of incidence are one, and every azimuth of the light"
"""Comment where the values of an isotropic sample are folded."""
HORIZON_DEG = 90.0 + TOLERANCE_DEG
SAME = 1e-9
"""Relative difference of values that are equal in a text of nine digits."""


@dataclass(frozen=True, eq=False)
class ScatteredBsdf(ReadOnlyArrays, ColumnTable):
    """Values of one sample at any directions; arrays (n,), angles in degrees. They cannot be written, once they are here.

    `sigma_deg`, `psi_deg`: polar angle, 0 to 90, and azimuth of the light. `polar_deg`, `azimuth_deg`: those of the observed
    direction; polar from the normal of its own side, 0 to 90, so that `transmitted` light has its own hemisphere. `values` in
    1/sr, NaN where a direction was measured without a value; `u` their standard uncertainty, NaN where unknown, and `u_shared`
    the part of it that neighbouring values share. `low95`, `high95`: the ends of their intervals of 95 %, and `interval` the
    law, "linear", "logarithmic" or "drawn"; NaN and "" where they are not stated.

    `wavelength_nm` is NaN for grey values and for those of a colour, whose name
    ("red", "X") is in `channel`. `flags` are words separated by a space. `back`: lit on the back; the frame is then that of the
    sample turned about x. `photodiode` is -1 where there is none. `generated` values are simulated. `widest_gap_deg`: a table
    of them has holes between directions further apart; None: how far follows from the values. Raises ValueError where these do
    not fit together.
    """

    sigma_deg: Degrees
    psi_deg: Degrees
    polar_deg: Degrees
    azimuth_deg: Degrees
    values: PerSteradian
    u: KnownPerSteradian = ABSENT
    u_shared: PerSteradian = ABSENT
    low95: KnownPerSteradian = ABSENT
    high95: KnownPerSteradian = ABSENT
    interval: TextColumn = ABSENT
    wavelength_nm: Nanometres = ABSENT
    channel: TextColumn = ABSENT
    transmitted: FlagColumn = ABSENT
    back: FlagColumn = ABSENT
    flags: TextColumn = ABSENT
    photodiode: NumberedColumn = ABSENT
    sample: str = ""
    isotropic: bool = True
    generated: bool = False
    comments: tuple[str, ...] = ()
    widest_gap_deg: float | None = None

    def __post_init__(self) -> None:
        """Fill in the optional columns, and check all of them."""
        keep = object.__setattr__
        n = np.asarray(self.values).size
        for each, declared in self.declared().items():
            given = getattr(self, each)
            column = np.full(n, declared.absent) if given is None else np.asarray(given)
            if column.shape != (n,):
                raise ValueError(f"{each} has the shape {column.shape}, and there are {n} values")
            if column.dtype.kind in "iuf" and each != "photodiode":
                column = column.astype(np.float64)
                if np.isinf(column).any() or (each in ANGLES and np.isnan(column).any()):
                    raise ValueError(f"{each} has values that are not finite")
            keep(self, each, column)
        for each in ("sigma_deg", "polar_deg"):
            outside = (getattr(self, each) < 0.0) | (getattr(self, each) > 90.0)
            if outside.any():
                raise ValueError(f"{each} goes from 0 to 90, and has {getattr(self, each)[outside][0]:g}")
        super().__post_init__()

    @classmethod
    def join(cls, tables: Sequence[Self]) -> Self:
        """The values of one sample in one list."""
        return replace(
            super().join(tables),
            comments=tuple(dict.fromkeys(comment for table in tables for comment in table.comments)),
            isotropic=all(table.isotropic for table in tables),
            generated=any(table.generated for table in tables),
        )

    def separate(self) -> Iterator[Self]:
        """The values of each light and side."""
        for transmitted in np.unique(self.transmitted):
            for back in np.unique(self.back):
                here = (self.transmitted == transmitted) & (self.back == back)
                if here.any():
                    yield self if here.all() else self.where(here)

    def specular(self) -> tuple[Floats, Floats]:
        """theta (n,) and phi (n,) about the specular direction; for transmitted light about that of regular transmission."""
        return to_specular_deg(self.sigma_deg, self.polar_deg, self.azimuth_deg - self.psi_deg)


COLUMNS = tuple(ScatteredBsdf.declared())
"""The arrays of scattered values."""
INTERVAL_COLUMNS = ("low95", "high95", "interval")
"""Those of the intervals of 95 %, which older files do not have."""
ANGLES = ("sigma_deg", "psi_deg", "polar_deg", "azimuth_deg")


def flagged(flags: Texts, words: Collection[str]) -> Flags:
    """The values (n,) that have one of these flags."""
    distinct, which = np.unique(flags, return_inverse=True)
    return np.array([not set(words).isdisjoint(each.split()) for each in distinct.tolist()], dtype=bool)[which.ravel()]


def has_one_psi(psi_deg: Floats, flags: Texts) -> bool:
    """Whether values that were not measured only to check a symmetry have one azimuth of the light: they count as isotropic."""
    return bool(np.unique(psi_deg[~flagged(flags, {CHECK})]).size <= 1)


def psi_of_gamma(gamma_deg: Floats | float, back: Flags | bool) -> Floats:
    """The azimuth of the light in the sample's frame, 0 to below 360, of the sample's rotation in the rig; its own inverse.

    The frame of a sample that is lit on the back is turned about x.
    """
    return wrap_azimuth(np.where(back, gamma_deg, -gamma_deg))


def to_specular_deg(sigma_deg: Floats, polar_deg: Floats, azimuth_deg: Floats) -> tuple[Floats, Floats]:
    """theta and phi, deg, of directions whose azimuth is counted from the light's."""
    return to_specular(sigma_deg, arc_direction(polar_deg, azimuth_deg))


@dataclass(frozen=True, eq=False)
class RegularTable(ReadOnlyArrays):
    """Regular reflectance, or transmittance, of one sample: `values` [channel, psi, sigma], 0 to 1, at angles in degrees.

    Channels are as in `BsdfTable`; `u` are standard uncertainties, if known.
    """

    sigma_deg: Floats
    values: Floats
    wavelengths_nm: tuple[float, ...] | None = None
    colours: tuple[str, ...] = ()
    psi_deg: Floats = field(default_factory=lambda: np.zeros(1))
    transmitted: bool = False
    back: bool = False
    sample: str = ""
    u: Floats | None = None
    generated: bool = False
    comments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the fields. Raises ValueError."""
        channels = len(self.wavelengths_nm or self.colours or (None,))
        shape = (channels, np.size(self.psi_deg), np.size(self.sigma_deg))
        object.__setattr__(self, "values", finite_array("values", self.values, shape))
        if self.u is not None:
            object.__setattr__(self, "u", finite_array("uncertainties", self.u, shape))
        super().__post_init__()


Part = BsdfTable | ScatteredBsdf | RegularTable


@dataclass(frozen=True, eq=False)
class BsdfFile:
    """The content of a file: its `parts`, each of one sample, what is known about them, and comments on all of them.

    `of_samples` are the metadata of each sample where they are known one by one; `metadata` those of all.
    A grid and a table of regular factors are of one side and of reflected or transmitted light; scattered values may be mixed.
    """

    parts: tuple[Part, ...]
    metadata: Metadata = field(default_factory=Metadata)
    comments: tuple[str, ...] = ()
    of_samples: Mapping[str, Metadata] = field(default_factory=dict)

    @property
    def simulated(self) -> bool:
        """Whether any part is simulated."""
        return any(part.generated for part in self.parts)

    def heading(self, comments: Iterable[str]) -> list[str]:
        """The lines at the top of a text file: metadata, comments on the file, and those of its parts.

        What the metadata state is omitted from the comments, but for the name of the sample, which readers take from there.
        """
        stated = self.metadata.texts()
        rest = (*self.comments, *comments)
        kept = [line for line in rest if line.startswith("sample: ") or stated.isdisjoint({line, line.partition(": ")[2]})]
        return [*self.metadata.lines(), *kept]

    @property
    def samples(self) -> tuple[str, ...]:
        """The names of the samples, each once, in the order of the file."""
        return tuple(dict.fromkeys(part.sample for part in self.parts))

    @property
    def tables(self) -> tuple[BsdfTable, ...]:
        """The grids among the parts."""
        return tuple(part for part in self.parts if isinstance(part, BsdfTable))

    @property
    def scattered(self) -> tuple[ScatteredBsdf, ...]:
        """The scattered values among the parts."""
        return tuple(part for part in self.parts if isinstance(part, ScatteredBsdf))

    @property
    def regular(self) -> tuple[RegularTable, ...]:
        """The regular factors among the parts."""
        return tuple(part for part in self.parts if isinstance(part, RegularTable))

    def only_table(self) -> BsdfTable:
        """The grid of a file that has nothing else, for formats that hold one. Raises ValueError."""
        if len(self.parts) != 1 or not self.tables:
            raise ValueError(f"it has {len(self.parts)} parts, of which {len(self.tables)} are tables; give one table")
        return self.tables[0]

    def of(self, sample: str) -> "BsdfFile":
        """The parts of one sample, with its metadata."""
        metadata = self.of_samples.get(sample, self.metadata)
        return replace(
            self, parts=tuple(part for part in self.parts if part.sample == sample), metadata=metadata, of_samples={}
        )

    def of_points(self) -> "BsdfFile":
        """Without the tables of which the scattered values are there, by sample, light and side: an archive has both, and the
        tables are made of the others."""
        own = {(each.sample, bool(one.transmitted[0]), bool(one.back[0])) for each in self.scattered for one in each.separate()}
        kept = (
            each
            for each in self.parts
            if not (isinstance(each, BsdfTable) and (each.sample, each.transmitted, each.back) in own)
        )
        return replace(self, parts=tuple(kept))


ABOUT_GAP = "a table of these points has holes between directions more than "
GAP = re.compile(re.escape(ABOUT_GAP) + r"([0-9]{1,3}(?:\.[0-9]{1,6})?) deg apart")


def gap_line(widest_gap_deg: float) -> str:
    """The comment by which scattered values keep their `widest_gap_deg` in a file."""
    return f"{ABOUT_GAP}{widest_gap_deg:g} deg apart"


def write_gaps(content: BsdfFile) -> BsdfFile:
    """The content of a file to write: with a comment for the `widest_gap_deg` of scattered values."""
    return replace(
        content,
        parts=tuple(
            replace(each, comments=(*each.comments, gap_line(each.widest_gap_deg)))
            if isinstance(each, ScatteredBsdf) and each.widest_gap_deg is not None
            else each
            for each in content.parts
        ),
    )


def read_gaps(content: BsdfFile) -> BsdfFile:
    """The content of a file that was read: with the `widest_gap_deg` that its comments state, and without these."""
    parts: list[Part] = []
    for each in content.parts:
        stated = [found[1] for line in (*each.comments, *content.comments) if (found := GAP.fullmatch(line))]
        if isinstance(each, ScatteredBsdf) and stated:
            rest = tuple(line for line in each.comments if not GAP.fullmatch(line))
            parts.append(replace(each, widest_gap_deg=float(stated[0]), comments=rest))
        else:
            parts.append(each)
    return replace(content, parts=tuple(parts), comments=tuple(line for line in content.comments if not GAP.fullmatch(line)))


def nodes(table: BsdfTable, *, once: bool = False) -> ScatteredBsdf:
    """The values of a grid above the horizon, in the order of its axes; those that were not measured have the flag "filled".

    With `once` a direction that several nodes have, with one value, is there once.
    """
    channel, psi, sigma, phi, theta = axes_of_nodes(table)
    polar, azimuth = zenith_and_azimuth(from_specular(sigma, theta, phi))
    above = polar <= HORIZON_DEG
    if once:
        above &= ~_again(table).ravel()
    count = table.values.shape[0]
    names = np.array(table.colours or ("",) * count)
    wavelengths = np.array(table.wavelengths_nm or (math.nan,) * count)
    columns: dict[str, Any] = {
        "sigma_deg": sigma,
        "psi_deg": psi,
        "polar_deg": np.minimum(polar, 90.0),
        "azimuth_deg": wrap_azimuth(azimuth + psi),
        "values": table.values.ravel(),
        "wavelength_nm": wavelengths[channel],
        "channel": names[channel],
        "transmitted": np.full(sigma.size, table.transmitted),
        "back": np.full(sigma.size, table.back),
    }
    if table.u is not None:
        columns["u"] = table.u.ravel()
    if table.known is not None:
        columns["flags"] = np.where(table.known.ravel(), "", FILLED)
    found = ScatteredBsdf(**{name: each[above] for name, each in columns.items()}, sample=table.sample)
    return replace(found, isotropic=table.psi_deg.size == 1, comments=table.comments, generated=table.generated)


def _again(table: BsdfTable) -> Flags:
    """The nodes whose direction an earlier one has with the same value: theta 0 or 180 at any phi, phi 360, and psi 360."""
    again = np.zeros(table.values.shape, dtype=np.bool_)
    pairs: list[tuple[tuple[slice | int, ...], tuple[slice | int, ...]]] = []
    rest = (slice(None),) * 2
    for place, pole in ((0, 0.0), (-1, 180.0)):
        if table.theta_deg[place] == pole:
            pairs.append(((*rest, slice(None), slice(1, None), place), (*rest, slice(None), slice(0, 1), place)))
    if table.phi_deg[0] == 0.0 and table.phi_deg[-1] == 360.0:
        pairs.append(((*rest, slice(None), -1), (*rest, slice(None), 0)))
    if table.psi_deg[0] == 0.0 and table.psi_deg[-1] == 360.0:
        pairs.append(((slice(None), -1), (slice(None), 0)))
    arrays = [each for each in (table.values, table.u, table.known) if each is not None]
    for later, first in pairs:
        same = [np.isclose(each[later], each[first], rtol=SAME, atol=0.0) for each in arrays]
        again[later] |= np.logical_and.reduce(same).all(axis=0)
    return again


def axes_of_nodes(table: BsdfTable) -> tuple[Ints, Floats, Floats, Floats, Floats]:
    """Index of the channel, psi, sigma, phi and theta of all nodes of a grid, each (values.size,), in the order of its axes."""
    axes = (np.arange(table.values.shape[0]), table.psi_deg, table.sigma_deg, table.phi_deg, table.theta_deg)
    channel, *angles = (each.ravel() for each in np.meshgrid(*axes, indexing="ij"))
    psi, sigma, phi, theta = (each.astype(np.float64) for each in angles)
    return channel.astype(np.int64), psi, sigma, phi, theta
