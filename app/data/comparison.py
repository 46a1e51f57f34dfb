"""Comparison of two datasets, light by light: relative RMS (paper, formula 5), deviations in their uncertainty, chi-square.

    RMS = sqrt(mean over i of ((A_i - B_i) / (0.5 (A_i + B_i)))^2)

The directions i are those of A; where B has no value in one of them it is interpolated (interpolation.py). A direction that A
has several times counts once, with the mean. The range of i is part of the result: the paper does not state its own. z is the
deviation over its combined standard uncertainty, with the covariance of the two values if both are of one journal. Of a value
of a journal whose u is above 15 % and mostly of shares of the value, the deviation is that of the logarithm (`interval_rule`).
Chi-square has the covariance of all values of a light: a common error of the scale, which moves all z together, counts once.
"""

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.campaign.geometry.directions import in_plane_of_incidence
from goniotwin.app.campaign.measurement_model.effects import Effects
from goniotwin.app.campaign.reduction.components import deviation_in_u
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.studies.theory import noisy, theoretical_bsdf, true_bsdf
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.interpolation import direction_grid, interpolated
from goniotwin.app.data.opening import open_dataset, sample_of_points
from goniotwin.app.data.values import EQUAL, LightSetting, SampleData, as_numbers, flag, quoted, with_names
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import ABSENT, UNTRUSTED, ScatteredBsdf, flagged
from goniotwin.app.formats.file import StrPath
from goniotwin.app.rig import RigDescription
from goniotwin.app.rig.samples import GaussianTable, parse_sample
from goniotwin.app.simulation.paper.gaussian_cut import HIGHEST_ZENITH_DEG, WIDTHS, relative_rms_percent
from goniotwin.arrays import Flags, Floats, Ints, ReadOnlyArrays
from goniotwin.twin.optics import Scatterer, arc_direction, evaluate, light_direction
from goniotwin.twin.optics.geometry.coordinates import (
    DECIMALS,
    TOLERANCE_DEG,
    TURN_DEG,
    aspecular_deg,
    mirror_in_sample_plane,
    round_deg,
    turn_about_x,
)

LEAST_SHARE = 0.01
"""Share of the largest value below which formula 5 does not count a direction, unless another one is asked for."""
MOST_OF_CHI_SQUARE = 500
"""Directions of one light of which chi-square is computed; of more every second, third and so on."""
LEAST_EIGENVALUE = 1e-10
SHADOWED = "shadowed"
"""Flag of a direction that the mirror unit blocks."""
MOST_LISTED = 4
"""Lights that a message names."""


THEORY = "theory"
"""The model of a virtual rig's sample."""
MODEL = re.compile(r"[a-z-]+(:|$)")
"""The beginning of a model's text, as `simulate sample` takes it; THEORY is one too."""


def is_model(name: str) -> bool:
    """Whether a name is that of a model: a text that is no file."""
    return MODEL.match(name) is not None and not Path(name).exists()


@dataclass(frozen=True)
class Range:
    """The directions of formula 5: theta and the polar angle of observation to so many degrees, in the plane of incidence
    alone or not, and the mean of both values not less than a share of the largest one in this light.
    """

    theta_deg: float = 180.0
    polar_deg: float = HIGHEST_ZENITH_DEG
    least_share: float = LEAST_SHARE
    in_plane: bool = False

    def __str__(self) -> str:
        parts = ["in the plane of incidence"] if self.in_plane else []
        parts += [f"theta to {self.theta_deg:g} deg"] if self.theta_deg < 180.0 else []
        parts += [f"polar angle to {self.polar_deg:g} deg"]
        parts += [f"values from {100.0 * self.least_share:g} % of the largest"] if self.least_share else []
        return ", ".join(parts)


@dataclass(frozen=True, eq=False)
class LightComparison(ReadOnlyArrays):
    """Two BSDFs at the directions (n,) of one light: `first` and `second` in 1/sr with their standard uncertainties.

    `z` is their difference, first less second, in its standard uncertainty; NaN where none is known. `index` are the values of
    the first dataset. `in_range` are the directions of formula 5, and `count` their number, each direction once;
    `relative_rms_percent` is formula 5, NaN without any. `chi_square` is of `degrees` directions; NaN where the covariance is
    not known. `blocked_deg` are the aspecular angles of the directions of this range, in the plane of incidence, that the
    mirror unit blocks: negative on the grazing side of the specular direction.
    """

    light: LightSetting
    index: Ints
    theta_deg: Floats
    phi_deg: Floats
    polar_deg: Floats
    azimuth_deg: Floats
    first: Floats
    u_first: Floats
    second: Floats
    u_second: Floats
    z: Floats
    in_range: Flags
    relative_rms_percent: float
    count: int
    chi_square: float
    degrees: int
    blocked_deg: tuple[float, ...] = ()

    @property
    def share_within_2(self) -> float:
        """Share of the directions in range with |z| of 2 or less; NaN where no z is known."""
        known = self.in_range & np.isfinite(self.z)
        return float(np.mean(np.abs(self.z[known]) <= 2.0)) if known.any() else math.nan

    @property
    def largest_z(self) -> float:
        """The largest |z| in range; NaN where none is known."""
        known = self.in_range & np.isfinite(self.z)
        return float(np.abs(self.z[known]).max()) if known.any() else math.nan

    @property
    def formula_5(self) -> str:
        """Formula 5 and its number of directions in words."""
        if not self.count:
            return "no direction in range"
        return f"{self.relative_rms_percent:.3g} % over {self.count} direction{'s' if self.count > 1 else ''}"

    def __str__(self) -> str:
        z = f", largest |z| {self.largest_z:.3g}" if math.isfinite(self.largest_z) else ""
        known = math.isfinite(self.chi_square)
        chi_square = f", chi-square with the covariance {self.chi_square:.4g} of {self.degrees}" if known else ""
        return f"{self.light}: {'relative RMS ' if self.count else ''}{self.formula_5}{z}{chi_square}"

    def as_dict(self) -> dict[str, Any]:
        """The figures for JSON; None for those that are not known."""
        light = self.light
        numbers = {
            "relative_rms_percent": self.relative_rms_percent,
            "largest_abs_z": self.largest_z,
            "share_within_2_u": self.share_within_2,
            "chi_square": self.chi_square,
        }
        return {
            "wavelength_nm": None if math.isnan(light.wavelength_nm) else light.wavelength_nm,
            "channel": light.channel,
            "sigma_deg": light.sigma_deg,
            "psi_deg": light.psi_deg,
            "transmitted": light.transmitted,
            "back": light.back,
            "directions": self.count,
            "compared": int(np.isfinite(self.second).sum()),
            **{name: each if math.isfinite(each) else None for name, each in numbers.items()},
            "degrees_of_freedom": self.degrees,
        }


@dataclass(frozen=True, eq=False)
class DatasetComparison:
    """The comparison of two datasets, light by light.

    `first` and `second` are the datasets, `range` the directions of formula 5, and `lights` the comparison of each light.
    `notes` state what it assumes and what it leaves out.
    """

    first: Dataset
    second: Dataset
    range: Range
    lights: tuple[LightComparison, ...]
    notes: tuple[str, ...]

    @property
    def relative_rms_percent(self) -> float:
        """Formula 5 over the directions of all lights together, in %."""
        squares = [each.count * each.relative_rms_percent**2 for each in self.lights if each.count]
        count = sum(each.count for each in self.lights)
        return math.sqrt(math.fsum(squares) / count) if count else math.nan

    @property
    def by_sigma(self) -> dict[float, float]:
        """Formula 5 in % by incidence. If several lights have the same incidence, it is that of the last one."""
        return {each.light.sigma_deg: each.relative_rms_percent for each in self.lights}

    @property
    def simulated(self) -> bool:
        """Whether either of the two is simulated."""
        return self.first.simulated or self.second.simulated

    def as_dict(self) -> dict[str, Any]:
        """The comparison for JSON."""
        total = self.relative_rms_percent
        return {
            "first": {"name": self.first.name, "sample": self.first.sample, "simulated": self.first.simulated},
            "second": {"name": self.second.name, "sample": self.second.sample, "simulated": self.second.simulated},
            "formula_5": {"percent": total if math.isfinite(total) else None, "range_of_i": str(self.range)},
            "lights": [each.as_dict() for each in self.lights],
            "notes": list(self.notes),
        }

    def __str__(self) -> str:
        total = self.relative_rms_percent
        value = f"{total:.3g} %" if math.isfinite(total) else "has no direction"
        lines = [f"relative RMS (formula 5) {value}: {self.range}", *map(str, self.lights)]
        return "\n".join([*lines, *self.notes])


@with_names
def compare(
    first: Dataset | StrPath,
    second: Dataset | StrPath,
    *,
    theta_deg: float = 180.0,
    polar_deg: float = HIGHEST_ZENITH_DEG,
    least_share: float = LEAST_SHARE,
    in_plane: bool = False,
) -> DatasetComparison:
    """Compare two datasets, or files, of one sample each: formula 5, z and chi-square at the directions of the first.

    Four arguments limit the directions of formula 5: `theta_deg` and `polar_deg` are their largest angles, `least_share` the
    least value over the largest one, and `in_plane` restricts them to the plane of incidence. In the paper's figure 13, theta
    goes to twice the width of the lobe, in the plane of incidence. Raises GoniotwinError for a file that cannot be opened, for
    several samples, and if the two have no light or no direction in common.
    """
    for each in (first, second):
        if isinstance(each, str) and is_model(each):
            model = "" if each == THEORY else f", {each!r}"
            raise UserError(f"{each}: there is no such file; for the BSDF of a model give goniotwin.theory(d{model})")
    a, b = (each if isinstance(each, Dataset) else open_dataset(each) for each in (first, second))
    limits = _range(theta_deg, polar_deg, least_share, in_plane)
    one, other = a.only, b.only
    found, left_out = [], []
    grey = _one_channel(one) and _one_channel(other)
    for light in one.lights:
        matching = _matching(light, other, grey=grey, free=one.values.isotropic)
        if matching and (result := _compare_light(one, light, other, matching, limits)) is not None:
            found.append(result)
        else:
            left_out.append(str(light))
    if not found:
        raise UserError(f"{a.name} and {b.name}: {_nothing_in_common(one, other, grey=grey)}")
    notes = [
        *_untrusted(one, other),
        *_notes(one, other, found),
        *([f"not compared, because the second has no values there: {'; '.join(left_out)}"] if left_out else []),
    ]
    return DatasetComparison(a, b, limits, tuple(found), tuple(notes))


def compare_figure_13(rig: RigDescription, sample: str, points: BsdfPoints) -> DatasetComparison:
    """Compare points of a Gaussian sample with theory as the paper's figure 13 does, at each sigma.

    Its range is the plane of incidence, theta to 2 widths and the polar angle to 85 deg, without the directions that the mirror
    unit blocks. Raises UserError for any other sample.
    """
    table = rig.file.twin.samples.get(sample) if rig.file.twin is not None else None
    if not isinstance(table, GaussianTable):
        raise UserError(f"{rig.name}: {sample!r} is not a Gaussian sample of a virtual rig, so formula 5 has no range")
    points = points.front
    measured = sample_of_points(points, sample, isotropic=True, generated=rig.simulated)
    exact = replace(measured, values=_exact(measured.values, theoretical_bsdf(rig, sample, points)))
    one, other = (Dataset(rig.name, "journal", {sample: each}) for each in (measured, exact))
    return compare(one, other, theta_deg=WIDTHS * table.width_deg, least_share=0.0, in_plane=True)


@with_names
def theory(dataset: Dataset | StrPath, sample: str | None = None) -> Dataset:
    """The known BSDF of a model at the directions of a dataset, exact: u is 0.

    `sample` is a model as in `goniotwin simulate sample`. Without it, it is the sample of the virtual rig on which the journal
    was measured. Raises GoniotwinError for a text that is no model and, without `sample`, for a dataset of a real rig or of a
    file.
    """
    like = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    data = like.only
    if sample is not None:
        if not isinstance(sample, str):
            raise UserError(f"sample: {quoted(sample)} is not a text; give a model such as 'gaussian:width_deg=5'")
        truth = _model_values(parse_sample(sample), data)
        name = sample
    else:
        model = None if like.reduced is None else like.reduced.rig.model()
        if model is None or data.measured is None or like.sample not in model.samples:
            raise UserError(
                f"{like.name}: its sample is not one of a virtual rig; give its model, such as gaussian:width_deg=5"
            )
        truth = true_bsdf(model.samples[like.sample], data.measured.points)
        name = f"{like.sample} of the virtual rig"
    made = replace(data, values=_exact(data.values, truth), regular=(), measured=None)
    return Dataset(f"theory: {name}", "theory", {like.sample: made}, ("a model's BSDF, without an instrument",))


def _exact(values: ScatteredBsdf, truth: Floats) -> ScatteredBsdf:
    """Values that are known, in the directions of others."""
    return replace(
        values,
        values=truth,
        u=np.zeros(truth.size),
        u_shared=np.zeros(truth.size),
        flags=np.full(truth.size, ""),
        low95=ABSENT,
        high95=ABSENT,
        interval=ABSENT,
        generated=True,
    )


def _model_values(scatterer: Scatterer, data: SampleData) -> Floats:
    """The BSDF (n,) of a model at the values' lights and directions."""
    values = data.values
    result = np.empty(values.size)
    for light in data.lights:
        index = light.index
        nm = None if math.isnan(light.wavelength_nm) else light.wavelength_nm
        directions = arc_direction(values.polar_deg[index], values.azimuth_deg[index] - light.psi_deg)
        lamp = light_direction(light.sigma_deg)
        if light.transmitted:
            directions = mirror_in_sample_plane(directions)
        if light.back:  # the frame of the values is that of the sample turned about x
            directions, lamp = turn_about_x(directions), turn_about_x(lamp)
        gamma = light.psi_deg if light.back else -light.psi_deg
        result[index] = evaluate(scatterer, np.broadcast_to(lamp, directions.shape), directions, nm, gamma)
    return result


def _range(theta_deg: object, polar_deg: object, least_share: object, in_plane: object) -> Range:
    limits: list[float] = []
    for name, value, most in (
        ("theta_deg", theta_deg, 180.0),
        ("polar_deg", polar_deg, 90.0),
        ("least_share", least_share, 1.0),
    ):
        number = as_numbers(value)
        if number is None or number.ndim or not 0.0 <= number <= most:
            raise UserError(f"{name}: {quoted(value)}: give a number from 0 to {most:g}")
        limits.append(float(number))
    theta, polar, least = limits
    return Range(theta, polar, least, bool(flag("in_plane", in_plane)))


def _one_channel(data: SampleData) -> bool:
    return len({(each.channel, str(each.wavelength_nm)) for each in data.lights}) == 1


def _matching(light: LightSetting, other: SampleData, *, grey: bool, free: bool = False) -> list[tuple[LightSetting, float]]:
    """The lights of the other dataset that are this one, or the two incidences around it, with weights; none if it has none.

    `grey`: both have one channel, which are the same if one of them has no wavelength. `free`: the azimuth of the light does
    not count, because this one's sample is isotropic.
    """
    lights = [each for each in other.lights if (each.transmitted, each.back) == (light.transmitted, light.back)]
    if not (grey and any(math.isnan(each.wavelength_nm) for each in [light, *lights])):
        lights = [each for each in lights if each.channel == light.channel and _equal(each.wavelength_nm, light.wavelength_nm)]
    psis = {each.psi_deg for each in lights}
    if len(psis) > 1 or not (other.values.isotropic or free):
        lights = [each for each in lights if _turn_apart(each.psi_deg, light.psi_deg) <= EQUAL]
    lights.sort(key=lambda each: each.sigma_deg)
    if exact := [each for each in lights if abs(each.sigma_deg - light.sigma_deg) <= EQUAL]:
        return [(exact[0], 1.0)]
    below = [each for each in lights if each.sigma_deg < light.sigma_deg]
    above = [each for each in lights if each.sigma_deg > light.sigma_deg]
    if not below or not above:
        return []
    share = (light.sigma_deg - below[-1].sigma_deg) / (above[0].sigma_deg - below[-1].sigma_deg)
    return [(below[-1], 1.0 - share), (above[0], share)]


def _nothing_in_common(one: SampleData, other: SampleData, *, grey: bool) -> str:
    """Why two samples cannot be compared: no light of the first is one of the second, or no direction."""
    if not any(_matching(light, other, grey=grey, free=one.values.isotropic) for light in one.lights):
        has = " and ".join(f"the {title} has {_listed(data)}" for title, data in (("first", one), ("second", other)))
        swapped = any(_matching(light, one, grey=grey, free=other.values.isotropic) for light in other.lights)
        remedy = "give them in the other order" if swapped else "wavelength, side and azimuth of the light have to be equal"
        return f"no light of the first is one of the second, or between two of its incidences: {has}; {remedy}"
    why = (
        "the directions of the second are on no grid, so there is no interpolation between them"
        if any(light.index.size > 1 and direction_grid(other, light) is None for light in other.lights)
        else "the second has no trusted values around those of the first"
    )
    swapped = any(direction_grid(one, light) is not None for light in one.lights)
    return f"no direction in common: {why}{'; give them in the other order' if swapped else ''}"


def _listed(data: SampleData) -> str:
    lights = [str(each) for each in data.lights]
    more = f"; and {len(lights) - MOST_LISTED} more" if len(lights) > MOST_LISTED else ""
    return f"{'; '.join(lights[:MOST_LISTED]) or 'no values'}{more}"


def _turn_apart(one: float, other: float) -> float:
    apart = math.fmod(abs(one - other), TURN_DEG)
    return min(apart, TURN_DEG - apart)


def _equal(one: float, other: float) -> bool:
    return abs(one - other) <= EQUAL or (math.isnan(one) and math.isnan(other))


def _compare_light(
    one: SampleData, light: LightSetting, other: SampleData, matching: list[tuple[LightSetting, float]], limits: Range
) -> LightComparison | None:
    """The comparison in one light; None where no direction has two values."""
    index = light.index[one.good[light.index]]
    theta, phi = one.theta_deg[index], one.phi_deg[index]
    there = _direct(other, matching, theta, phi)
    second, u_second = other.values.values[there], np.asarray(other.values.u)[there]
    if (absent := there < 0).any():
        second[absent], u_second[absent] = interpolated(matching, other, theta[absent], phi[absent])
    known = np.isfinite(second)
    index, there, theta, phi = index[known], there[known], theta[known], phi[known]
    second, u_second = second[known], u_second[known]
    if not index.size:
        return None
    values = one.values
    first, u_first = values.values[index], np.asarray(values.u)[index]
    polar, azimuth = values.polar_deg[index], values.azimuth_deg[index]
    chosen = _in_range(one, index, limits)
    mean = 0.5 * (first + second)
    chosen &= (mean >= limits.least_share * np.max(mean, initial=0.0)) & (mean > 0.0)
    once_first, once_second = _direction_means(theta[chosen], phi[chosen], first[chosen], second[chosen])
    z = _deviations((one, index, first, u_first), (other, there, second, u_second))
    chi_square, degrees = _chi_square((one, index, first, u_first), (other, there, second, u_second), chosen)
    return LightComparison(
        light,
        index,
        theta,
        phi,
        polar,
        azimuth,
        first,
        u_first,
        second,
        u_second,
        z,
        chosen,
        relative_rms_percent(once_first, once_second),
        once_first.size,
        chi_square,
        degrees,
        _blocked(one, light, limits),
    )


def _in_range(data: SampleData, index: Ints, limits: Range) -> Flags:
    """Whether the directions of some values are in range."""
    polar = data.values.polar_deg[index]
    chosen = (data.theta_deg[index] <= limits.theta_deg + TOLERANCE_DEG) & (polar <= limits.polar_deg + TOLERANCE_DEG)
    if limits.in_plane:
        chosen &= in_plane_of_incidence(polar, data.values.azimuth_deg[index] - data.values.psi_deg[index])
    return np.asarray(chosen)


def _blocked(data: SampleData, light: LightSetting, limits: Range) -> tuple[float, ...]:
    index = light.index[flagged(np.asarray(data.values.flags)[light.index], {SHADOWED})]
    index = index[_in_range(data, index, replace(limits, in_plane=True))]
    return tuple(np.unique(round_deg(aspecular_deg(data.theta_deg[index], data.phi_deg[index]))).tolist())


def _direction_means(theta: Floats, phi: Floats, *values: Floats) -> list[Floats]:
    """Means of `values` over those of one direction; at theta 0 all phi are one."""
    keys = round_deg(np.stack([theta, np.where(theta <= EQUAL, 0.0, phi)], axis=1))
    _, which, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    return [np.bincount(which.ravel(), weights=each, minlength=counts.size) / counts for each in values]


def _direct(data: SampleData, matching: list[tuple[LightSetting, float]], theta: Floats, phi: Floats) -> Ints:
    """The trusted value (n,) that a dataset has in each direction; -1 where it has none.

    A direction that both have several times is compared value by value, in their order.
    """
    if len(matching) > 1:
        return np.full(theta.size, -1, dtype=np.int64)
    index = matching[0][0].index[data.good[matching[0][0].index]]
    places: dict[tuple[float, ...], list[int]] = {}
    for key, k in zip(_keys(data.theta_deg[index], data.phi_deg[index]), index.tolist(), strict=True):
        places.setdefault(key, []).append(k)
    found, times = [], Counter[tuple[float, ...]]()
    for key in _keys(theta, phi):
        there = places.get(key, [-1])
        found.append(there[min(times[key], len(there) - 1)])
        times[key] += 1
    return np.array(found, dtype=np.int64)


def _keys(theta: Floats, phi: Floats) -> Iterator[tuple[float, ...]]:
    """Directions that are equal to five decimals have equal keys."""
    keys = np.round(np.stack([theta, np.where(theta <= EQUAL, 0.0, phi)], axis=1), DECIMALS - 1)
    return map(tuple, np.where(keys == TURN_DEG, 0.0, keys).tolist())


Values = tuple[SampleData, Ints, Floats, Floats]
"""Values (n,) in 1/sr with their u, and which values of a sample they are; -1 for one that is interpolated."""


def _of_one_journal(one: SampleData, other: SampleData) -> bool:
    """Whether two samples have errors in common, because they are of one journal."""
    return one.measured is not None and other.measured is not None and one.measured.settings is other.measured.settings


def _joined(one: SampleData, index: Ints, other: SampleData, there: Ints) -> Effects:
    """The effects of all inputs of a journal on values of two samples, first those of one, then those of the other."""
    assert one.measured is not None
    assert other.measured is not None
    points = [one.measured.points.where(index), other.measured.points.where(there)]
    return effects_of(BsdfPoints.join(points), one.measured.settings)


def _deviations(first: Values, second: Values) -> Floats:
    """z (n,) by the rule of intervals; an uncertainty that is not known counts as 0, and z is NaN where none is known."""
    (one, index, a, u_a), (other, there, b, u_b) = first, second
    variance: Floats = np.nan_to_num(u_a) ** 2 + np.nan_to_num(u_b) ** 2
    if _of_one_journal(one, other):
        both = np.flatnonzero(there >= 0)
        pairs = np.arange(both.size)
        common = _joined(one, index[both], other, there[both]).paired_covariance(pairs, both.size + pairs)
        variance[both] -= 2.0 * common
    known = (np.isfinite(u_a) | np.isfinite(u_b)) & (variance > 0.0)
    linear = np.ones(a.size, dtype=bool) if one.measured is None else noisy(one.measured.points.where(index))
    return deviation_in_u(a, np.sqrt(np.where(known, variance, np.nan)), linear, b)


def _chi_square(first: Values, second: Values, chosen: Flags) -> tuple[float, int]:
    """Chi-square of the directions in range by the covariance, and their number; NaN and 0 where the covariance is not known.

    Two samples of one journal have the covariance with each other; else those of both add.
    """
    (one, index, a, _), (other, there, b, u_b) = first, second
    together = _of_one_journal(one, other)
    at = np.flatnonzero(chosen & (there >= 0) if together else chosen)
    at = at[:: max(1, math.ceil(at.size / MOST_OF_CHI_SQUARE))]
    if not at.size:
        return math.nan, 0
    if together:
        n, every = at.size, np.arange(2 * at.size)
        both = _joined(one, index[at], other, there[at]).covariance(every, every)
        covariance: Floats | None = both[:n, :n] + both[n:, n:] - both[:n, n:] - both[n:, :n]
    else:
        of_first = _covariance(one, index[at])
        of_second = _covariance(other, there[at]) if (there[at] >= 0).all() else _no_covariance(u_b[at])
        covariance = None if of_first is None or of_second is None else of_first + of_second
    return (math.nan, 0) if covariance is None else _quadratic(covariance, (a - b)[at])


def _covariance(data: SampleData, index: Ints) -> Floats | None:
    """The covariance of some values of a dataset, 1/sr squared; None where it is not known.

    A file states it by `u_shared`, which is common to all of them.
    """
    if data.measured is not None:
        every = np.arange(index.size)
        return effects_of(data.measured.points.where(index), data.measured.settings).covariance(every, every)
    u, u_shared = np.asarray(data.values.u)[index], np.asarray(data.values.u_shared)[index]
    if np.isnan(u).any() or not (u_shared > 0.0).any():
        return _no_covariance(u)
    return np.diag(np.maximum(u**2 - u_shared**2, 0.0)) + np.outer(u_shared, u_shared)


def _no_covariance(u: Floats) -> Floats | None:
    """That of exact values; None, unknown, for others."""
    return np.zeros((u.size, u.size)) if (u == 0.0).all() else None


def _quadratic(covariance: Floats, difference: Floats) -> tuple[float, int]:
    """d C^-1 d and the rank of C: combinations of values that have no uncertainty of their own do not count."""
    scale = np.sqrt(np.diag(covariance))
    if not (scale > 0.0).all():
        return math.nan, 0
    eigenvalues, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    kept = eigenvalues > LEAST_EIGENVALUE * eigenvalues[-1]
    along = vectors[:, kept].T @ (difference / scale)
    return float(np.sum(along**2 / eigenvalues[kept])), int(kept.sum())


def _untrusted(one: SampleData, other: SampleData) -> Iterator[str]:
    """The numbers of directions that are flagged as not to be trusted: the peak of a lobe may be among them."""
    for title, data in (("first", one), ("second", other)):
        texts = np.asarray(data.values.flags).tolist()
        counts = Counter(name for text in texts if (name := next((each for each in text.split() if each in UNTRUSTED), "")))
        if counts:
            by_flag = ", ".join(f"{count} {name}" for name, count in counts.most_common())
            total = f"{counts.total()} of {len(texts)} directions"
            yield f"the {title}: {total} are left out, because they are not trusted: {by_flag}"


def _notes(one: SampleData, other: SampleData, found: Sequence[LightComparison]) -> Iterator[str]:
    """What is not known of the uncertainties, in words that do not contradict each other."""
    both = (("first", "second", one), ("second", "first", other))
    absent = {title: np.isnan(np.asarray(data.values.u)[data.good]) for title, _, data in both}
    if all(each.all() for each in absent.values()):
        yield "neither of the two has uncertainties: there is no z and no chi-square"
        return
    no_chi_square = any(math.isnan(each.chi_square) for each in found if each.count)
    reasons, shares = [], []
    for title, rest, data in both:
        if absent[title].any():
            has = "has no uncertainties" if absent[title].all() else "has no uncertainty of some values"
            yield f"the {title} {has}: z is there in that of the {rest} alone"
            reasons.append(f"the {title} {has}")
        elif _covariance(data, np.arange(min(data.values.size, 2))) is None:
            shares.append(f"the {title}")
    if shares:
        reasons.append(f"what values of {' and '.join(shares)} share of their u is not known")
    if no_chi_square:
        yield f"there is no chi-square where the covariance is not known: {'; '.join(reasons) or 'of interpolated values'}"
    if _of_one_journal(one, other):
        yield "both are of one journal: z and chi-square have the covariance of the two"
