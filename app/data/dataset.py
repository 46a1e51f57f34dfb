"""The dataset: the values of a journal, a file or a simulation as flat arrays, sample by sample, all in memory.

A value is at a direction of light and a direction of observation. The frame is the sample's: z is the normal of the lit side,
azimuth 0 is the sample's mark. Of transmitted light the direction of observation has its own hemisphere.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.reduction.etalon import ReductionSettings
from goniotwin.app.campaign.reduction.points import FLAGS, BsdfPoints
from goniotwin.app.campaign.reduction.reduction import ReducedJournal
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import FILLED, BsdfFile, RegularTable, ScatteredBsdf, Texts
from goniotwin.app.formats.metadata import Metadata
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import TOLERANCE_DEG, TURN_DEG

UNTRUSTED = frozenset({FILLED, *(name for name, flag in FLAGS.items() if flag.untrusted)})
"""Flags of values that are not to be used as measured ones."""
ROUND = {"psi_deg": None, "phi_deg": "theta_deg", "azimuth_deg": "polar_deg"}
"""Columns whose values repeat after 360 deg, and the polar angle at whose pole, 0 or 180 deg, all of them are one direction."""
EQUAL = 1.01 * TOLERANCE_DEG
"""Numbers that differ by no more are one angle or wavelength: a rounding of the last decimal that is kept."""
MOST_LISTED = 6

Number = float | Sequence[float]
"""One number, or several."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What a journal has beyond the columns: the reduced `points`, one for each value, and the settings of their reduction."""

    points: BsdfPoints
    settings: ReductionSettings


@dataclass(frozen=True, eq=False)
class SampleData:
    """One sample: its `values`, with their specular coordinates (n,) in degrees.

    `gridded` values are the nodes of tables. `regular` factors have no place among values in 1/sr. `measured`: of a journal.
    """

    values: ScatteredBsdf
    theta_deg: Floats
    phi_deg: Floats
    gridded: bool = False
    regular: tuple[RegularTable, ...] = ()
    measured: Measured | None = None

    def where(self, chosen: Flags | Ints) -> "SampleData":
        """Some of the values, or all in another order."""
        measured = self.measured
        return replace(
            self, values=self.values.where(chosen), theta_deg=self.theta_deg[chosen], phi_deg=self.phi_deg[chosen],
            measured=None if measured is None else replace(measured, points=measured.points.where(chosen)),
        )  # fmt: skip

    def column(self, name: str) -> npt.NDArray[Any]:
        """An array (n,) by its name in `COLUMNS`."""
        if name in ("theta_deg", "phi_deg"):
            return np.asarray(getattr(self, name))
        return np.asarray(getattr(self.values, "values" if name == "bsdf" else name))


COLUMNS = (
    "wavelength_nm", "channel", "sigma_deg", "psi_deg", "theta_deg", "phi_deg", "polar_deg", "azimuth_deg", "transmitted",
    "back", "photodiode", "bsdf", "u", "u_shared", "flags",
)  # fmt: skip
"""The arrays of a dataset, all of one length."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """BSDF values with their directions, from a journal, a file or a simulation; all in memory.

    The arrays are of one sample: where there are several, choose one, `dataset["paper"]`. `name` is that of the campaign or of
    the file, `origin` what it was: "journal", "simulation" or the name of a format. `notes` are remarks for the reader of the
    values, `findings` those that state what is wrong with the instrument. `file` is the content of the file; of a journal
    `reduced` is the whole reduction. Whatever an argument can do wrong raises GoniotwinError.
    """

    name: str
    origin: str
    data: Mapping[str, SampleData] = field(repr=False)
    metadata: Metadata = field(default_factory=Metadata, repr=False)
    notes: tuple[str, ...] = field(default=(), repr=False)
    findings: tuple[str, ...] = field(default=(), repr=False)
    file: BsdfFile | None = field(default=None, repr=False)
    reduced: ReducedJournal | None = field(default=None, repr=False)

    # ---- samples ----

    @property
    def samples(self) -> tuple[str, ...]:
        """The names of the samples. A file that names none has one, ""."""
        return tuple(self.data)

    def __getitem__(self, sample: str) -> "Dataset":
        """The dataset of one sample."""
        if sample not in self.data:
            raise UserError(f"{self.name}: there is no sample {sample!r}; it has {self._listed_samples()}")
        return replace(self, data={sample: self.data[sample]})

    def __iter__(self) -> Iterator[str]:
        return iter(self.data)

    def __contains__(self, sample: object) -> bool:
        return sample in self.data

    @property
    def sample(self) -> str:
        """The name of the only sample. Raises GoniotwinError where there are several."""
        if len(self.data) != 1:
            has = self._listed_samples()
            raise UserError(f"{self.name}: values of several samples are not mixed; choose one with d[NAME]: it has {has}")
        return next(iter(self.data))

    @property
    def only(self) -> SampleData:
        """The data of the only sample. Raises GoniotwinError where there are several."""
        return self.data[self.sample]

    @property
    def size(self) -> int:
        """Number of values, of all samples together."""
        return sum(each.values.size for each in self.data.values())

    @property
    def simulated(self) -> bool:
        """Whether any value comes from a simulation and not from an instrument."""
        regular = (each.generated for data in self.data.values() for each in data.regular)
        return any(data.values.generated for data in self.data.values()) or any(regular)

    def __repr__(self) -> str:
        about = "; ".join(f"{_named(name)}: {_extent(data)}" for name, data in self.data.items()) or "no sample"
        return f"<Dataset {self.name!r}, {'SIMULATED, ' if self.simulated else ''}{self.origin}: {about}>"

    def _listed_samples(self) -> str:
        return ", ".join(map(repr, self.data)) or "none"

    # ---- columns ----

    @property
    def bsdf(self) -> Floats:
        """The BSDF (n,) in 1/sr, without the cosine; NaN where a direction has no value."""
        return self.only.values.values

    @property
    def u(self) -> Floats:
        """Standard uncertainty (n,) of `bsdf`, 1/sr; NaN where the file has none."""
        return np.asarray(self.only.values.u)

    @property
    def u_shared(self) -> Floats:
        """The part (n,) of `u` that neighbouring values have in common, 1/sr; 0 where it is not known."""
        return np.asarray(self.only.values.u_shared)

    @property
    def luminance_factor(self) -> Floats:
        """pi times the BSDF (n,): 1 for the ideal diffuser."""
        return math.pi * self.bsdf

    @property
    def flags(self) -> Texts:
        """Flags (n,) as words, with a space between several; empty for a value without any."""
        return np.asarray(self.only.values.flags)

    @property
    def good(self) -> Flags:
        """The values (n,) to be trusted: there is a number, and no flag that says otherwise."""
        return np.isfinite(self.bsdf) & ~flagged(self.flags, UNTRUSTED)

    @property
    def sigma_deg(self) -> Floats:
        """Incidence (n,): polar angle of the light from the normal of the lit side, 0 to 90."""
        return self.only.values.sigma_deg

    @property
    def psi_deg(self) -> Floats:
        """Azimuth of the light (n,) in the sample's frame; 0 of an isotropic table."""
        return self.only.values.psi_deg

    @property
    def theta_deg(self) -> Floats:
        """Aspecular angle (n,): from the specular direction; of transmitted light from the direction straight through."""
        return self.only.theta_deg

    @property
    def phi_deg(self) -> Floats:
        """Azimuth (n,) about that direction: 0 in the plane of incidence towards the normal."""
        return self.only.phi_deg

    @property
    def polar_deg(self) -> Floats:
        """Polar angle (n,) of the observed direction from the normal of its own side, 0 to 90."""
        return self.only.values.polar_deg

    @property
    def azimuth_deg(self) -> Floats:
        """Azimuth (n,) of the observed direction in the sample's frame; that of the light is `psi_deg`."""
        return self.only.values.azimuth_deg

    @property
    def wavelength_nm(self) -> Floats:
        """Wavelength (n,); NaN for grey values and for those of a colour."""
        return np.asarray(self.only.values.wavelength_nm)

    @property
    def channel(self) -> Texts:
        """Name (n,) of a colour, such as "red" or "X"; empty for grey and spectral values."""
        return np.asarray(self.only.values.channel)

    @property
    def transmitted(self) -> Flags:
        """Whether the light (n,) is transmitted."""
        return np.asarray(self.only.values.transmitted)

    @property
    def back(self) -> Flags:
        """Whether the sample is lit on its back (n,); the frame is then that of the sample turned about x."""
        return np.asarray(self.only.values.back)

    @property
    def photodiode(self) -> Ints:
        """Number of the photodiode (n,); -1 where there is none."""
        return np.asarray(self.only.values.photodiode)

    # ---- selection ----

    def where(self, chosen: Flags | Ints) -> "Dataset":
        """The values that a mask (n,) or a list of indices chooses."""
        index = np.asarray(chosen)
        if index.ndim != 1 or index.dtype.kind not in "bi" or (index.dtype.kind == "b" and index.size != self.size):
            raise UserError(f"where: give a mask of {self.size} flags, or indices")
        try:
            return self._with(self.only.where(index))
        except IndexError:
            raise UserError(f"where: an index is not below {self.size}") from None

    def select(
        self, *, wavelength_nm: Number | None = None, channel: str | None = None, sigma_deg: Number | None = None,
        psi_deg: Number | None = None, theta_deg: Number | None = None, phi_deg: Number | None = None,
        polar_deg: Number | None = None, azimuth_deg: Number | None = None, photodiode: Number | None = None,
        transmitted: bool | None = None, back: bool | None = None,
    ) -> "Dataset":  # fmt: skip
        """The values at these angles and wavelengths, exact to the sixth decimal; a list of numbers takes each of them.

        At a pole (theta, or polar, 0) every azimuth is the same direction, so any phi (azimuth) selects it. Raises
        GoniotwinError, with the nearest numbers that are there, for a number without a value.
        """
        wanted = {
            "transmitted": transmitted, "back": back, "channel": channel, "wavelength_nm": wavelength_nm,
            "sigma_deg": sigma_deg, "psi_deg": psi_deg, "theta_deg": theta_deg, "phi_deg": phi_deg, "polar_deg": polar_deg,
            "azimuth_deg": azimuth_deg, "photodiode": photodiode,
        }  # fmt: skip
        data = self.only
        before = ""
        for name, value in wanted.items():
            if value is not None:
                data = data.where(self._chosen(data, name, value, before))
                before += f" {'with' if not before else 'and'} {name} {value!r}"
        return self._with(data)

    def _chosen(self, data: SampleData, name: str, value: object, before: str) -> Flags:
        """The values (n,) that one argument of `select` takes."""
        column = data.column(name)
        if name in ("transmitted", "back", "channel"):
            wrong = not isinstance(value, str if name == "channel" else bool | np.bool_)
            if wrong:
                raise UserError(f"{name}: {value!r}: give {'the name of a colour' if name == 'channel' else 'True or False'}")
            chosen = np.asarray(column == value)
            if not chosen.any():
                has = ", ".join(repr(each) for each in np.unique(column).tolist()) or "no values"
                raise UserError(f"{name} {value!r}: {self._place()} has no such values{before}; it has {has}")
            return chosen
        chosen = np.zeros(column.size, dtype=bool)
        for number in numbers(name, value):
            here = is_at(data, name, number)
            if not here.any():
                there = neighbours(column, number)
                raise UserError(f"{name} {number:g}: {self._place()} has no values there{before}; {there}")
            chosen |= here
        return chosen

    def _place(self) -> str:
        return f"{self.name}{f' ({self.sample})' if self.sample else ''}"

    def _with(self, data: SampleData) -> "Dataset":
        return replace(self, data={self.sample: data})


def flagged(flags: Texts, words: frozenset[str]) -> Flags:
    """Whether flags (n,) have any of the words."""
    distinct, which = np.unique(flags, return_inverse=True)
    having = np.array([bool(words.intersection(each.split())) for each in distinct.tolist()], dtype=bool)
    return np.asarray(having[which.ravel()]) if flags.size else np.zeros(0, dtype=bool)


def numbers(name: str, value: object) -> list[float]:
    """The numbers of an argument. Raises UserError."""
    try:
        found = np.atleast_1d(np.asarray(value, dtype=np.float64))
    except (TypeError, ValueError):
        found = np.zeros(0)
    if isinstance(value, str | bool) or found.ndim != 1 or not found.size or not np.isfinite(found).all():
        raise UserError(f"{name}: {value!r}: give a number, or a list of numbers")
    return [float(each) for each in found]


def is_at(data: SampleData, name: str, number: float) -> Flags:
    """Whether values (n,) are at an angle or a wavelength."""
    column = data.column(name)
    if name not in ROUND:
        return np.asarray(np.abs(column - number) <= EQUAL)
    apart = np.mod(column - number, TURN_DEG)
    chosen = np.minimum(apart, TURN_DEG - apart) <= EQUAL
    pole = ROUND[name]
    if pole is not None:
        polar = data.column(pole)
        chosen |= (polar <= EQUAL) | (polar >= 180.0 - EQUAL)
    return np.asarray(chosen)


def neighbours(column: npt.NDArray[Any], number: float) -> str:
    """The nearest numbers below and above, in words."""
    there = np.unique(np.round(column[np.isfinite(column)].astype(np.float64), 6))
    if not there.size:
        return "its values have none"
    place = int(np.searchsorted(there, number))
    near = [f"{each:.9g}" for each in there[max(place - 1, 0) : place + 1].tolist()]
    return f"the nearest {'are' if len(near) > 1 else 'is'} {' and '.join(near)}"


def listed(values: Floats, unit: str) -> str:
    """Distinct numbers in words; the first and the last of many."""
    there = np.unique(np.round(values[np.isfinite(values)], 6)).tolist()
    if not there:
        return ""
    if len(there) > MOST_LISTED:
        return f"{len(there)} from {there[0]:g} to {there[-1]:g} {unit}"
    return f"{', '.join(f'{each:g}' for each in there)} {unit}"


def _named(sample: str) -> str:
    return sample or "a sample without a name"


def _extent(data: SampleData) -> str:
    sigma = listed(data.values.sigma_deg, "deg")
    wavelength = listed(np.asarray(data.values.wavelength_nm), "nm")
    parts = [f"{data.values.size} values", *([f"sigma {sigma}"] if sigma else []), *([wavelength] if wavelength else [])]
    return ", ".join([*parts, *(["regular factors"] if data.regular else [])])
