"""The dataset: the values of a journal, a file or a simulation as flat arrays, sample by sample, all in memory.

A value is at a direction of light and a direction of observation. The frame is the sample's: z is the normal of the lit side,
azimuth 0 is the sample's mark. Of transmitted light the direction of observation has its own hemisphere.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset, ReducedJournal
from goniotwin.app.data import hemisphere
from goniotwin.app.data.columns import content_of_columns
from goniotwin.app.data.frames import html_of, to_dataframe, to_xarray
from goniotwin.app.data.interpolation import (
    WIDEST_DEG,
    direction_grid,
    interpolated,
    lights_at,
    nearest_directions,
    own_and_shared,
)
from goniotwin.app.data.parts import remarks_of, samples_of
from goniotwin.app.data.values import (
    Number,
    SampleData,
    ValueWithU,
    as_numbers,
    flag,
    is_at,
    listed,
    neighbours,
    numbers,
    quoted,
    with_names,
)
from goniotwin.app.errors import UserError, printable
from goniotwin.app.formats.content import BsdfFile, Part
from goniotwin.app.formats.file import StrPath
from goniotwin.app.formats.metadata import Metadata, common_metadata
from goniotwin.arrays import Flags, Floats, Ints, Texts, read_only
from goniotwin.twin.optics import from_specular, to_specular
from goniotwin.twin.optics.geometry.coordinates import TOLERANCE_DEG, arc_direction, zenith_and_azimuth

if TYPE_CHECKING:
    import pandas
    import xarray

    from goniotwin.app.data.conversion import Converted

MOST_OF_COVARIANCE = 5000
"""Values of a covariance matrix: it takes 200 MB."""


@dataclass(frozen=True, eq=False)
class Dataset:
    """BSDF values with their directions, from a journal, a file or a simulation; all in memory.

    The arrays are of one sample. If there are several samples, choose one: `dataset["paper"]`. `name` is the name of the
    campaign or of the file. `origin` is "journal", "simulation", "table" or the name of a format. `notes` are remarks for the
    reader of the values. `findings` state what is wrong with the instrument.

    You cannot write to the arrays. Copy one first, or compute a new one from it. A wrong argument raises GoniotwinError.

    `file` is the content of a file, None of a journal. `data`, `only`, `reduced` and `whole` are for other parts of the
    program, and not public: `reduced` is the whole reduction of a journal, and `whole` whether all of its values are there.
    """

    name: str
    origin: str
    data: Mapping[str, SampleData] = field(repr=False)
    notes: tuple[str, ...] = field(default=(), repr=False)
    findings: tuple[str, ...] = field(default=(), repr=False)
    file: BsdfFile | None = field(default=None, repr=False)
    reduced: ReducedJournal | None = field(default=None, repr=False)
    whole: bool = field(default=True, repr=False)

    def __post_init__(self) -> None:
        """Keep the points of a reduction as arrays that cannot be written."""
        if isinstance(self.reduced, BsdfDataset):
            samples = {name: points.read_only() for name, points in self.reduced.samples.items()}
            object.__setattr__(self, "reduced", replace(self.reduced, samples=samples))

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over what a copy has."""
        vars(self).update(state)
        self.__post_init__()

    # ---- samples ----

    @property
    def samples(self) -> tuple[str, ...]:
        """The names of the samples. A file that names none has one, ""."""
        return tuple(self.data)

    def __getitem__(self, sample: str) -> "Dataset":
        """The dataset of one sample."""
        if sample not in self:
            raise UserError(f"{self.name}: there is no sample {quoted(sample)}; it has {self._listed_samples()}")
        return replace(self, data={sample: self.data[sample]})

    def __iter__(self) -> Iterator[str]:
        return iter(self.data)

    def __contains__(self, sample: object) -> bool:
        return isinstance(sample, str) and sample in self.data

    def __len__(self) -> int:
        """Number of values, of all samples together."""
        return self.size

    def __bool__(self) -> bool:
        """Always true: a dataset of regular factors alone has no values in 1/sr."""
        return True

    @property
    def sample(self) -> str:
        """The name of the only sample. Raises GoniotwinError where there are several."""
        if not self.data:
            raise UserError(f"{self.name}: no sample has values yet")
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
    def metadata(self) -> Metadata:
        """Facts about the measurement of the only sample: instrument, light, reference, operator and so on."""
        return self.only.metadata

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

    def _column(self, name: str) -> npt.NDArray[Any]:
        """A column of the only sample."""
        return self.only.column(name)

    @property
    def bsdf(self) -> Floats:
        """The BSDF (n,) in 1/sr, without the cosine; NaN where a direction has no value."""
        return self._column("bsdf")

    @property
    def u(self) -> Floats:
        """Standard uncertainty (n,) of `bsdf`, 1/sr; NaN where the file has none."""
        return self._column("u")

    @property
    def u_shared(self) -> Floats:
        """The part (n,) of `u` that neighbouring values have in common, 1/sr; 0 where it is not known."""
        return self._column("u_shared")

    @property
    def low95(self) -> Floats:
        """Lower ends (n,) of the values' intervals of 95 %, 1/sr; NaN where none is stated."""
        return self._column("low95")

    @property
    def high95(self) -> Floats:
        """Upper ends (n,) of the values' intervals of 95 %, 1/sr; NaN where none is stated."""
        return self._column("high95")

    @property
    def interval(self) -> Texts:
        """Kind (n,) of the interval of 95 %: "linear", "logarithmic" or "drawn"; "" where none is stated."""
        return self._column("interval")

    @property
    def luminance_factor(self) -> Floats:
        """pi times the BSDF (n,): 1 for the ideal diffuser."""
        return read_only(math.pi * self.bsdf)

    @property
    def flags(self) -> Texts:
        """Flags (n,) as words, with a space between several; empty for a value without any."""
        return self._column("flags")

    @property
    def good(self) -> Flags:
        """Whether a value (n,) can be trusted: there is a number, and no flag against it."""
        return self.only.good

    @property
    def sigma_deg(self) -> Floats:
        """Incidence (n,): polar angle of the light from the normal of the lit side, 0 to 90."""
        return self._column("sigma_deg")

    @property
    def psi_deg(self) -> Floats:
        """Azimuth of the light (n,) in the sample's frame; 0 for an isotropic table."""
        return self._column("psi_deg")

    @property
    def theta_deg(self) -> Floats:
        """Angle theta (n,) from the specular direction, not negative; for transmitted light from the one straight through."""
        return self._column("theta_deg")

    @property
    def phi_deg(self) -> Floats:
        """Azimuth (n,) about the specular direction: 0 in the plane of incidence towards the normal."""
        return self._column("phi_deg")

    @property
    def polar_deg(self) -> Floats:
        """Polar angle (n,) of the observed direction from the normal of its own side, 0 to 90."""
        return self._column("polar_deg")

    @property
    def azimuth_deg(self) -> Floats:
        """Azimuth (n,) of the observed direction in the sample's frame; that of the light is `psi_deg`."""
        return self._column("azimuth_deg")

    @property
    def wavelength_nm(self) -> Floats:
        """Wavelength (n,); NaN for grey values and for those of a colour."""
        return self._column("wavelength_nm")

    @property
    def channel(self) -> Texts:
        """Name (n,) of a colour, such as "red" or "X"; empty for grey and spectral values."""
        return self._column("channel")

    @property
    def transmitted(self) -> Flags:
        """Whether the light (n,) is transmitted."""
        return self._column("transmitted")

    @property
    def back(self) -> Flags:
        """Whether the sample is lit on its back (n,). The frame is then that of the sample turned about x."""
        return self._column("back")

    @property
    def photodiode(self) -> Ints:
        """Number of the photodiode (n,); -1 where there is none."""
        return self._column("photodiode")

    # ---- selection ----

    @with_names
    def where(self, chosen: Flags | Ints | Sequence[bool] | Sequence[int]) -> "Dataset":
        """The dataset of the values that a mask (n,) or a list of indices chooses."""
        data = self.only
        try:
            index: Any = np.asarray(chosen)
        except Exception:  # noqa: BLE001  (an object of any class may raise anything)
            index = np.zeros(())
        if isinstance(chosen, Sequence) and not isinstance(chosen, str | bytes) and not len(chosen):
            index = np.zeros(0, dtype=np.int64)
        if index.ndim != 1 or index.dtype.kind not in "biu" or (index.dtype.kind == "b" and index.size != self.size):
            raise UserError(f"where: give a mask of {self.size} flags, or indices")
        try:
            return self._with(data.where(index))
        except IndexError:
            raise UserError(f"where: an index is not below {self.size}") from None

    @with_names
    def select(
        self,
        *,
        wavelength_nm: Number | None = None,
        channel: str | None = None,
        sigma_deg: Number | None = None,
        psi_deg: Number | None = None,
        theta_deg: Number | None = None,
        phi_deg: Number | None = None,
        polar_deg: Number | None = None,
        azimuth_deg: Number | None = None,
        photodiode: Number | None = None,
        transmitted: bool | None = None,
        back: bool | None = None,
    ) -> "Dataset":
        """The dataset of the values at these angles and wavelengths, exact to the sixth decimal.

        A list of numbers selects each of them. At a pole (theta or polar angle 0) all azimuths are the same direction, so any
        phi or azimuth selects it. A number without a value raises GoniotwinError with the nearest numbers that are there.
        """
        wanted = {
            "transmitted": transmitted,
            "back": back,
            "channel": channel,
            "wavelength_nm": wavelength_nm,
            "sigma_deg": sigma_deg,
            "psi_deg": psi_deg,
            "theta_deg": theta_deg,
            "phi_deg": phi_deg,
            "polar_deg": polar_deg,
            "azimuth_deg": azimuth_deg,
            "photodiode": photodiode,
        }
        data = self.only
        before = ""
        for name, value in wanted.items():
            if value is not None:
                data = data.where(self._chosen(data, name, value, before))
                before += f" {'with' if not before else 'and'} {name} {quoted(value)}"
        return self._with(data)

    def _chosen(self, data: SampleData, name: str, value: object, before: str) -> Flags:
        """The values (n,) that one argument of `select` takes."""
        column = data.column(name)
        if name in ("transmitted", "back", "channel"):
            wrong = not isinstance(value, str if name == "channel" else bool | np.bool_)
            if wrong:
                what = "the name of a colour" if name == "channel" else "True or False"
                raise UserError(f"{name}: {quoted(value)}: give {what}")
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
        return replace(self, data={self.sample: data}, whole=self.whole and data is self.only)

    # ---- values between the measured ones, integrals ----

    @with_names
    def at(
        self,
        *,
        theta_deg: Number | None = None,
        phi_deg: Number | None = None,
        polar_deg: Number | None = None,
        azimuth_deg: Number | None = None,
        sigma_deg: float | None = None,
        psi_deg: float | None = None,
        wavelength_nm: Number | None = None,
        channel: str | None = None,
        transmitted: bool | None = None,
        back: bool | None = None,
    ) -> ValueWithU:
        """The BSDF in any direction, interpolated between trusted values, with u: `value, u = d.at(...)`.

        Give the direction as theta and phi about the specular direction, or as polar angle and azimuth. At theta 0 phi is not
        needed. Arrays of directions and of wavelengths are broadcast, and give arrays, with NaN where there is no value.
        Incidence and wavelength may lie between those of the dataset. You may leave out a quantity that has only one value in
        the dataset.

        u includes what the values share, and an estimate of the interpolation's error (`app/data/interpolation.py`). A
        direction raises GoniotwinError, with the nearest ones, if there are no values around it less than 30 deg apart.
        """
        light = {
            "sigma_deg": _number("sigma_deg", sigma_deg),
            "psi_deg": _number("psi_deg", psi_deg),
            "channel": _channel(channel),
            "transmitted": flag("transmitted", transmitted),
            "back": flag("back", back),
        }
        direction = theta_deg, phi_deg, polar_deg, azimuth_deg
        wavelengths = None if wavelength_nm is None else _angles("wavelength_nm", wavelength_nm)
        if wavelengths is None or not wavelengths.ndim:
            return self._at(direction, light, None if wavelengths is None else float(wavelengths))
        given = [None if each is None else _angles(name, each) for name, each in zip(DIRECTION, direction, strict=True)]
        shape = _broadcast(wavelengths, *(each for each in given if each is not None))
        every = np.broadcast_to(wavelengths, shape)
        around = [None if each is None else np.broadcast_to(each, shape) for each in given]
        value, u = np.empty(shape), np.empty(shape)
        for nm in np.unique(every).tolist():
            here = every == nm
            value[here], u[here] = self._at([None if each is None else each[here] for each in around], light, nm)
        return ValueWithU(value, u, "1/sr")

    def _at(self, direction: Sequence[object], light: Mapping[str, Any], wavelength_nm: float | None) -> ValueWithU:
        """The BSDF at one wavelength, in one direction or in several."""
        data, place = self.only, self._place()
        lights = lights_at(data, place, wavelength_nm=wavelength_nm, **light)
        sigma = float(sum(light.sigma_deg * weight for light, weight in lights))
        psi = lights[0][0].psi_deg
        theta, phi = _direction(direction, sigma, psi)
        shape = _broadcast(theta, phi)
        flat = (np.broadcast_to(each, shape).ravel() for each in (theta, phi))
        values, u = interpolated(lights, data, *flat)
        if shape:
            return ValueWithU(values.reshape(shape), u.reshape(shape), "1/sr")
        if math.isnan(values[0]):
            where = f"theta {float(theta):g}, phi {float(phi):g}"
            for each in dict.fromkeys((sigma, *(light.sigma_deg for light, _ in lights))):
                polar, _ = zenith_and_azimuth(from_specular(each, theta, phi))
                if polar > 90.0 + TOLERANCE_DEG:
                    why = "" if each == sigma else f", which the values at sigma {sigma:g} deg are interpolated from"
                    raise UserError(f"{where}: is below the horizon at sigma {each:g} deg{why}; give another direction")
            near = nearest_directions(data, [light for light, _ in lights], float(theta), float(phi))
            if all(direction_grid(data, light) is None for light, _ in lights):
                why = "its directions are neither on rings nor on a grid, so there is no interpolation between them"
                raise UserError(f"{where}: {place}: {why}; {near}: take the values themselves with select or where")
            raise UserError(f"{where}: {place} has no values around it, less than {WIDEST_DEG:g} deg apart on a grid; {near}")
        return ValueWithU(float(values[0]), float(u[0]), "1/sr")

    @with_names
    def reflectance(
        self,
        *,
        sigma_deg: float | None = None,
        psi_deg: float | None = None,
        wavelength_nm: Number | None = None,
        channel: str | None = None,
        transmitted: bool | None = None,
        back: bool | None = None,
    ) -> ValueWithU:
        """The directional-hemispherical reflectance (or transmittance) at one incidence: `value, u = d.reflectance(...)`.

        An array of wavelengths gives arrays. For a journal, u follows from the covariance of the values, by all inputs of the
        uncertainty. For a file it follows from an assumption, which `about` states. A regular part of the file is included.
        Raises GoniotwinError if the directions do not cover the hemisphere, and for an incidence without values.
        """
        light = {
            "sigma_deg": _number("sigma_deg", sigma_deg),
            "psi_deg": _number("psi_deg", psi_deg),
            "channel": _channel(channel),
            "transmitted": flag("transmitted", transmitted),
            "back": flag("back", back),
        }
        if wavelength_nm is None:
            return self._reflectance(light, None)
        wavelengths = _angles("wavelength_nm", wavelength_nm)
        found = {nm: self._reflectance(light, nm) for nm in np.unique(wavelengths).tolist()}
        if not wavelengths.ndim:
            return found[float(wavelengths)]
        value, u = (np.vectorize(lambda nm, k=k: tuple(found[nm])[k], otypes=[float])(wavelengths) for k in (0, 1))
        return ValueWithU(value, u, "1", tuple(dict.fromkeys(each for one in found.values() for each in one.about)))

    def _reflectance(self, light: Mapping[str, Any], wavelength_nm: float | None) -> ValueWithU:
        if not self.only.values.size and self.only.regular:
            return hemisphere.only_regular(self.only, self._place(), light["sigma_deg"])
        lights = lights_at(self.only, self._place(), between=False, wavelength_nm=wavelength_nm, **light)
        return hemisphere.reflectance(self.only, lights[0][0], self._place())

    # ---- uncertainty ----

    @property
    def components(self) -> dict[str, Floats]:
        """The components of `u` (n,) by name, 1/sr: their squares add up to its square. Only a journal has them."""
        measured = self.only.measured
        if measured is None:
            raise UserError(f"components: {self._place()} is no journal; a file has no components of the uncertainty")
        return {name: read_only(each) for name, each in measured.points.budget.items()}

    def covariance(self) -> Floats:
        """The covariance (n, n) of the values, 1/sr squared; NaN where there is no value.

        For a journal it is by all inputs of the uncertainty. For a file `u_shared` counts as common to all values, or all of u
        if the file does not divide it. Raises GoniotwinError for more than 5,000 values.
        """
        if self.size > MOST_OF_COVARIANCE:
            raise UserError(f"covariance: of {self.size} values is too large; select at most {MOST_OF_COVARIANCE}")
        data = self.only
        if data.measured is not None:
            every = np.arange(self.size)
            return read_only(effects_of(data.measured.points, data.measured.settings).covariance(every, every))
        own, shared = own_and_shared(self.u, self.u_shared)
        return read_only(np.diag(own**2) + np.outer(shared, shared))

    # ---- files and other libraries ----

    @staticmethod
    @with_names
    def from_table(
        table: "pandas.DataFrame | Mapping[str, Any]",
        *,
        name: str = "table",
        simulated: bool | None = None,
        isotropic: bool | None = None,
    ) -> "Dataset":
        """The dataset of a DataFrame, or of arrays by name: the columns of a dataset, or those of a CSV of the program.

        `bsdf` and `sigma_deg` are required, and `theta_deg` with `phi_deg` or `polar_deg` with `azimuth_deg`. Any other column
        may be missing; its values then count as not known, as in a CSV. `sample` names the sample of each value. The columns
        are copied. Without `simulated`, the dataset is simulated if `to_dataframe` has noted it. Without `isotropic`, values
        with light from one azimuth are isotropic. A wrong column raises GoniotwinError with its name.
        """
        if not isinstance(name, str):
            raise UserError(f"name: {quoted(name)}: give a text")
        stated = {"simulated": flag("simulated", simulated), "isotropic": flag("isotropic", isotropic)}
        content = content_of_columns(table, name=name, **stated)
        return Dataset(name, "table", samples_of(content), remarks_of(content), file=content)

    @with_names
    def save(self, path: StrPath, *, format: str | None = None) -> "Converted":
        """Write the values in any format that can be written, by the suffix of the path or by the name of the format.

        The files are those of `goniotwin export` and `convert`. Of a selection only its values are written. The result has the
        files, and notes on what the format could not hold. Raises GoniotwinError for values that cannot be written.
        """
        # The 0.2 s of HDF5 are of writing alone.
        from goniotwin.app.data.conversion import IN_PYTHON, Choice, convert_content, convert_reduced, format_to_write

        if not isinstance(path, str | Path) or not (format is None or isinstance(format, str)):
            raise UserError(f"save: {quoted(path)}, {quoted(format)}: give a path, and the name of a format or none")
        file = Path(path)
        found = format_to_write(file, format)
        if self.reduced is not None and self.whole:
            choice = Choice(self.sample if len(self.samples) == 1 else None, remedies=IN_PYTHON)
            return convert_reduced(self.reduced, file, found, choice)
        content = self._content()
        if not content.parts:
            raise UserError(f"save: {self.name} has no values; nothing is written")
        return convert_content(content, file, found, Choice(remedies=IN_PYTHON))

    def _content(self) -> BsdfFile:
        """The content of a file with the values: its own grids where all of a file is there."""
        if self.file is not None and self.whole:
            return replace(self.file, parts=tuple(each for each in self.file.parts if each.sample in self.data))
        parts: list[Part] = []
        for sample, data in self.data.items():
            parts += [replace(data.values, sample=sample)] if data.values.size else []
            parts += data.regular
        of_samples = {sample: data.metadata for sample, data in self.data.items()}
        return BsdfFile(tuple(parts), common_metadata(of_samples.values()), self.notes, of_samples)

    def to_dataframe(self) -> "pandas.DataFrame":
        """A DataFrame of pandas: a row for each value, the columns of the dataset. Needs the extra `xarray`."""
        return to_dataframe(self.only, self._attributes())

    def to_xarray(self) -> "xarray.Dataset":
        """A Dataset of xarray. `bsdf`, `u` and `flags` are tables over the axes of the grid; everything else is over `value`.

        Each has its unit and a long name. Needs the extra `xarray`.
        """
        return to_xarray(self.only, self._attributes())

    def _attributes(self) -> dict[str, Any]:
        return {"name": self.name, "origin": self.origin, "sample": self.sample, "simulated": int(self.simulated)}

    def _repr_html_(self) -> str:
        return html_of(self.name, self.origin, self.data, simulated=self.simulated)


DIRECTION = ("theta_deg", "phi_deg", "polar_deg", "azimuth_deg")


def _number(name: str, value: float | None) -> float | None:
    return None if value is None else _single(name, value)


def _single(name: str, value: object) -> float:
    """The number of an argument. Raises UserError for several."""
    found = numbers(name, value)
    if len(found) > 1:
        raise UserError(f"{name}: {quoted(value)}: give one number")
    return found[0]


def _channel(value: object) -> str | None:
    if value is None or isinstance(value, str):
        return value
    raise UserError(f"channel: {quoted(value)}: give the name of a colour")


def _direction(direction: Sequence[object], sigma_deg: float, psi_deg: float) -> tuple[Floats, Floats]:
    """The specular coordinates of a direction that is given in one way or the other, scalars or arrays. Raises UserError."""
    theta_deg, phi_deg, polar_deg, azimuth_deg = direction
    specular, own = (theta_deg, phi_deg), (polar_deg, azimuth_deg)
    if all(each is None for each in own) and theta_deg is not None:
        theta = _angles("theta_deg", theta_deg, 180.0)
        if phi_deg is None and (theta > TOLERANCE_DEG).any():
            raise UserError("phi_deg: is missing; give theta_deg and phi_deg")
        return theta, _angles("phi_deg", 0.0 if phi_deg is None else phi_deg)
    if all(each is None for each in specular) and polar_deg is not None:
        polar = _angles("polar_deg", polar_deg, 90.0)
        if azimuth_deg is None and (polar > TOLERANCE_DEG).any():
            raise UserError("azimuth_deg: is missing; give polar_deg and azimuth_deg")
        azimuth = _angles("azimuth_deg", 0.0 if azimuth_deg is None else azimuth_deg)
        _broadcast(polar, azimuth)
        return to_specular(sigma_deg, arc_direction(polar, azimuth - psi_deg))
    raise UserError("at: give the direction by theta_deg and phi_deg, or by polar_deg and azimuth_deg")


def _broadcast(*given: Floats) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*(each.shape for each in given))
    except ValueError:
        shapes = " and ".join(str(each.shape) for each in given)
        raise UserError(f"at: the arguments have the shapes {shapes}, which do not fit") from None


def _angles(name: str, value: object, most: float | None = None) -> Floats:
    found = as_numbers(value)
    if found is None:
        raise UserError(f"{name}: {quoted(value)}: give a number, or an array of numbers")
    if most is not None and ((found < 0.0) | (found > most)).any():
        raise UserError(f"{name}: {quoted(value)}: give angles from 0 to {most:g}")
    return found


def _named(sample: str) -> str:
    return printable(sample) or "a sample without a name"


def _extent(data: SampleData) -> str:
    sigma = listed(data.values.sigma_deg, "deg")
    wavelength = listed(np.asarray(data.values.wavelength_nm), "nm")
    parts = [f"{data.values.size} values", *([f"sigma {sigma}"] if sigma else []), *([wavelength] if wavelength else [])]
    return ", ".join([*parts, *(["regular factors"] if data.regular else [])])
