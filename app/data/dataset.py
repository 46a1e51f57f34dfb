"""The dataset: the values of a journal, a file or a simulation as flat arrays, sample by sample, all in memory.

A value is at a direction of light and a direction of observation. The frame is the sample's: z is the normal of the lit side,
azimuth 0 is the sample's mark. Of transmitted light the direction of observation has its own hemisphere.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.studies.reduced_journal import ReducedJournal
from goniotwin.app.data import hemisphere
from goniotwin.app.data.frames import to_dataframe, to_xarray
from goniotwin.app.data.interpolation import (
    WIDEST_DEG,
    direction_grid,
    interpolated,
    lights_at,
    nearest_directions,
    own_and_shared,
)
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
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.metadata import Metadata
from goniotwin.arrays import Flags, Floats, Ints, Texts
from goniotwin.twin.optics import from_specular, to_specular
from goniotwin.twin.optics.geometry.coordinates import TOLERANCE_DEG, arc_direction, zenith_and_azimuth

if TYPE_CHECKING:
    import pandas
    import xarray

MOST_OF_COVARIANCE = 5000
"""Values of a covariance matrix: it takes 200 MB."""


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
        """What is known about the measurement of the only sample: instrument, light, reference, operator and so on."""
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
    def low95(self) -> Floats:
        """Lower ends (n,) of the values' intervals of 95 %, 1/sr; NaN where none is stated."""
        return np.asarray(self.only.values.low95)

    @property
    def high95(self) -> Floats:
        """Upper ends (n,) of the values' intervals of 95 %, 1/sr; NaN where none is stated."""
        return np.asarray(self.only.values.high95)

    @property
    def interval(self) -> Texts:
        """The law (n,) of the interval: "linear", "logarithmic", "drawn", or "" where none is stated."""
        return np.asarray(self.only.values.interval)

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
        """The values (n,) to be trusted: there is a number, and no flag against it."""
        return self.only.good

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

    @with_names
    def where(self, chosen: Flags | Ints | Sequence[bool] | Sequence[int]) -> "Dataset":
        """The values that a mask (n,) or a list of indices chooses."""
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
        """The values at these angles and wavelengths, exact to the sixth decimal; a list of numbers takes each of them.

        At a pole (theta, or polar, 0) every azimuth is the same direction, so any phi (azimuth) selects it. Raises
        GoniotwinError, with the nearest numbers that are there, for a number without a value.
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
        return replace(self, data={self.sample: data})

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
        wavelength_nm: float | None = None,
        channel: str | None = None,
        transmitted: bool | None = None,
        back: bool | None = None,
    ) -> ValueWithU:
        """The BSDF in any direction, interpolated between trusted values, with u: `value, u = d.at(...)`.

        The direction is theta and phi, about the specular direction (phi need not be given at theta 0), or polar angle and
        azimuth; arrays, which broadcast, give arrays, with NaN where there is no value. Incidence and wavelength may be between
        those that are there; whatever has one value in the dataset need not be given. u has what the values share, and an
        estimate of the interpolation's error (`app/data/interpolation.py`). Raises GoniotwinError where there are no values
        around, further than 30 deg apart, with the nearest directions.
        """
        data, place = self.only, self._place()
        lights = lights_at(
            data,
            place,
            sigma_deg=_number("sigma_deg", sigma_deg),
            psi_deg=_number("psi_deg", psi_deg),
            wavelength_nm=_number("wavelength_nm", wavelength_nm),
            channel=_channel(channel),
            transmitted=flag("transmitted", transmitted),
            back=flag("back", back),
        )
        sigma = float(sum(light.sigma_deg * weight for light, weight in lights))
        psi = lights[0][0].psi_deg
        theta, phi = _direction(theta_deg, phi_deg, polar_deg, azimuth_deg, sigma, psi)
        shape = _broadcast(theta, phi)
        flat = (np.broadcast_to(each, shape).ravel() for each in (theta, phi))
        values, u = interpolated(lights, data, *flat)
        if shape:
            return ValueWithU(values.reshape(shape), u.reshape(shape), "1/sr")
        if math.isnan(values[0]):
            polar, _ = zenith_and_azimuth(from_specular(sigma, theta, phi))
            where = f"theta {float(theta):g}, phi {float(phi):g}"
            if polar > 90.0 + TOLERANCE_DEG:
                raise UserError(f"{where}: is below the horizon at sigma {sigma:g} deg; give another direction")
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
        wavelength_nm: float | None = None,
        channel: str | None = None,
        transmitted: bool | None = None,
        back: bool | None = None,
    ) -> ValueWithU:
        """The directional-hemispherical reflectance (or transmittance) at one incidence: `value, u = d.reflectance(...)`.

        u is by the covariance of the values: of a journal from all inputs of its uncertainty, of a file by an assumption that
        `about` states. A regular part of the file is included. Raises GoniotwinError where the directions do not cover the half
        sphere, and for an incidence without values.
        """
        sigma = _number("sigma_deg", sigma_deg)
        if not self.only.values.size and self.only.regular:
            return hemisphere.only_regular(self.only, self._place(), sigma)
        lights = lights_at(
            self.only,
            self._place(),
            sigma_deg=sigma,
            psi_deg=_number("psi_deg", psi_deg),
            between=False,
            wavelength_nm=_number("wavelength_nm", wavelength_nm),
            channel=_channel(channel),
            transmitted=flag("transmitted", transmitted),
            back=flag("back", back),
        )
        return hemisphere.reflectance(self.only, lights[0][0], self._place())

    # ---- uncertainty ----

    @property
    def components(self) -> dict[str, Floats]:
        """The components of `u` (n,) by name, 1/sr: their squares add up to its square. Only a journal has them."""
        measured = self.only.measured
        if measured is None:
            raise UserError(f"components: {self._place()} is no journal; a file has no components of the uncertainty")
        return measured.points.budget

    def covariance(self) -> Floats:
        """The covariance (n, n) of the values, 1/sr squared; NaN where there is no value.

        Of a journal it is by all inputs of the uncertainty. Of a file `u_shared` counts as common to all values, or all of u
        where the file does not divide it. Raises GoniotwinError for more than 5,000 values.
        """
        if self.size > MOST_OF_COVARIANCE:
            raise UserError(f"covariance: of {self.size} values is too large; select at most {MOST_OF_COVARIANCE}")
        data = self.only
        if data.measured is not None:
            every = np.arange(self.size)
            return effects_of(data.measured.points, data.measured.settings).covariance(every, every)
        own, shared = own_and_shared(self.u, self.u_shared)
        return np.asarray(np.diag(own**2) + np.outer(shared, shared))

    # ---- other libraries ----

    def to_dataframe(self) -> "pandas.DataFrame":
        """A DataFrame of pandas: a row for each value, the columns of the dataset. Needs the extra `xarray`."""
        return to_dataframe(self.only)

    def to_xarray(self) -> "xarray.Dataset":
        """A Dataset of xarray: `bsdf`, `u` and `flags`, a table over the axes of its grid, all else over `value`.

        Needs the extra `xarray`.
        """
        attributes = {"name": self.name, "origin": self.origin, "sample": self.sample, "simulated": int(self.simulated)}
        return to_xarray(self.only, attributes)


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


def _direction(
    theta_deg: object, phi_deg: object, polar_deg: object, azimuth_deg: object, sigma_deg: float, psi_deg: float
) -> tuple[Floats, Floats]:
    """The specular coordinates of a direction that is given in one way or the other, scalars or arrays. Raises UserError."""
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


def _broadcast(one: Floats, other: Floats) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(one.shape, other.shape)
    except ValueError:
        raise UserError(f"at: the two angles have the shapes {one.shape} and {other.shape}, which do not fit") from None


def _angles(name: str, value: object, most: float | None = None) -> Floats:
    found = as_numbers(value)
    if found is None:
        raise UserError(f"{name}: {quoted(value)}: give a number, or an array of numbers")
    if most is not None and ((found < 0.0) | (found > most)).any():
        raise UserError(f"{name}: {quoted(value)}: give angles from 0 to {most:g}")
    return found


def _named(sample: str) -> str:
    return sample or "a sample without a name"


def _extent(data: SampleData) -> str:
    sigma = listed(data.values.sigma_deg, "deg")
    wavelength = listed(np.asarray(data.values.wavelength_nm), "nm")
    parts = [f"{data.values.size} values", *([f"sigma {sigma}"] if sigma else []), *([wavelength] if wavelength else [])]
    return ", ".join([*parts, *(["regular factors"] if data.regular else [])])
