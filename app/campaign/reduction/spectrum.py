"""Wavelength and band: what a value changes with the wavelength, and its correction for the monochromator's band.

A value is the mean of the quotient of sample and etalon over the band, weighted by the etalon's signal S. For a band with the
variance s^2 (of a triangle: its width squared over 6) that is, to second order, q + s^2 (q'' / 2 + q' S' / S). Derivatives are
those of a parabola through the same photodiode's values of the same pose at the wavelengths nearby; their departure from it is
the component `band_shape`. The steps need all rows of a pose together. Where too few wavelengths were measured, wavelength or
band are not in u, and the notes name them.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from goniotwin.app.campaign.measurement_model.effects import Dense, Effects
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity, quantity
from goniotwin.app.campaign.reduction.arc_rows import POSE, WAVELENGTH, ArcRows
from goniotwin.app.campaign.reduction.components import DETECTED, INDEPENDENT
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.reading_inputs import LONGEST_PM
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.rig import RigFile
from goniotwin.app.rig.inputs import MONOCHROMATOR_STRAY
from goniotwin.app.rig.inputs import WAVELENGTH as WAVELENGTH_ERROR
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.keys import ASSUMED, STATED
from goniotwin.twin.optics.geometry.coordinates import round_deg

ASSUMED_BAND_NM = 5.0
"""Band of a rig file that states none: its effect is then in the uncertainty, and nothing is corrected."""
BANDS = 4.0
"""Three wavelengths within so many bands give the second derivative: further apart they do not resolve what a band sees."""
FARTHEST_NM = 50.0
"""Neighbours further away have no information on the slope over wavelength."""
MOST_FITTED = 9
"""Largest number of wavelengths in a parabola: of finer ones some are omitted, evenly."""
MOST_OTHERS = 8
"""Wavelengths that stand for all others of a pose, for the monochromator's stray light."""
FEWEST_OTHERS = 3
LARGEST_EFFECT = 0.5
"""An effect of the band beyond this is not corrected: the second order does not describe it."""
LARGE_EFFECT = 0.1
"""An effect beyond this is flagged: its fourth order may be as large."""
OF_ACCOUNT = 0.02
"""Values that depart from their parabola by less of themselves are not flagged; it is in their u."""
CERTAIN = 3.0
"""Standard uncertainties beyond which a departure is one of the spectrum."""
KNOWN_HALF = 0.5
"""Relative standard uncertainty of the effect of a stated band: its shape, its width, and the third order."""


NO_SLOPE = f"they have no other wavelength within {FARTHEST_NM:g} nm, or not enough light"
NO_BAND = f"they need three wavelengths within {BANDS:g} bands, and light"


@dataclass(frozen=True)
class Stencil:
    """Derivatives at wavelengths (w,) as sums over neighbours: their indices (w, m), and weights (w, m) of both derivatives.

    Weights are NaN where a derivative is unknown. `departure` (w, m, m) gives the departures of the wavelengths `nearby` (w, m)
    from a parabola, as large as a spectrum that is none has them for the freedom that the fit leaves. Where three wavelengths
    leave none, `exact` (w,), it gives the effect of the band on a spectrum of two lines that meet at the middle one. `others`
    are the wavelengths that stand for all.
    """

    index: Ints
    first: Floats
    second: Floats
    nearby: Ints
    departure: Floats
    exact: Flags
    others: Ints

    @property
    def own(self) -> tuple[Floats, Floats]:
        """The weights (w,) of the value itself in both derivatives."""
        here = self.index == np.arange(len(self.index))[:, None]
        return np.sum(np.where(here, self.first, 0.0), axis=1), np.sum(np.where(here, self.second, 0.0), axis=1)


def band_nm(rig: RigFile) -> float:
    """Full width at half maximum of the band, as stated or as assumed."""
    return ASSUMED_BAND_NM if rig.light.bandwidth_nm is None else rig.light.bandwidth_nm


@lru_cache(maxsize=16)
def stencil(wavelengths_nm: tuple[float, ...], band: float) -> Stencil:
    """The stencil of ascending wavelengths for a band."""
    at = np.array(wavelengths_nm)
    index = np.repeat(np.arange(at.size)[:, None], MOST_FITTED, axis=1)
    first, second, departure = np.zeros(index.shape), np.zeros(index.shape), np.zeros((*index.shape, MOST_FITTED))
    nearby, exact = index.copy(), np.zeros(at.size, dtype=bool)
    for k in range(at.size):
        near, order = _neighbours(at, k, band)
        if order == 0:
            first[k] = second[k] = np.nan
            continue
        index[k, : near.size] = near
        scale = float(np.abs(at[near] - at[k]).max())
        powers = np.vander((at[near] - at[k]) / scale, order + 1, increasing=True)
        inverse = np.linalg.pinv(powers)
        first[k, : near.size] = inverse[1] / scale
        second[k, : near.size] = 2.0 * inverse[2] / scale**2 if order == 2 else np.nan
        if order < 2:
            continue
        wider, order = _neighbours(at, k, band, (BANDS,))
        tested = wider if near.size == 3 and order == 2 else near
        nearby[k, : tested.size] = tested
        if tested.size == 3:
            exact[k] = True
            departure[k, 0] = second[k] * 0.5 * float(np.ptp(at[near])) * band / 6.0
        else:
            powers = np.vander((at[tested] - at[k]) / scale, 3, increasing=True)
            left = np.eye(tested.size) - powers @ np.linalg.pinv(powers)
            departure[k, : tested.size, : tested.size] = np.sqrt(tested.size / (tested.size - 3.0)) * left
    others = np.unique(np.round(np.linspace(0, at.size - 1, MOST_OTHERS)).astype(np.int64))
    return Stencil(index, first, second, nearby, departure, exact, others)


def _neighbours(at: Floats, k: int, band: float, widths: tuple[float, ...] = (0.5 * BANDS, BANDS)) -> tuple[Ints, int]:
    """The wavelengths that are fitted at the one with index k, and the order of the fit: 2, 1, or 0 for none.

    A parabola is that over the first one of the `widths`, in bands, that has enough of them.
    """
    apart = np.abs(at - at[k])
    for width in widths:
        within = np.flatnonzero(apart <= width * band * (1.0 + 1e-9))
        spread = at[within[-1]] - at[within[0]]
        if within.size >= 3 and spread <= BANDS * band * (1.0 + 1e-9):
            return _thinned(within, k), 2
    near = [each for each in (k - 1, k, k + 1) if 0 <= each < at.size and apart[each] <= FARTHEST_NM]
    return np.array(near), min(len(near) - 1, 1)


def _thinned(within: Ints, k: int) -> Ints:
    """At most MOST_FITTED of some indices, evenly, with k among them."""
    if within.size <= MOST_FITTED:
        return within
    kept = within[np.round(np.linspace(0, within.size - 1, MOST_FITTED)).astype(np.int64)]
    kept[np.argmin(np.abs(kept - k))] = k
    return np.unique(kept)


def correct_band(data: ArcRows, settings: ReductionSettings) -> ArcRows:
    """Correct the quotients for the band, where it is stated, and note what they change with the wavelength.

    Values have the flag `steep` where the spectrum nearby is no parabola, or the effect of the band is large.
    """
    band = band_nm(settings.rig)
    variance = band**2 / 6.0
    value = data.estimate.value
    detected = value > DETECTED * np.sqrt(data.estimate.variance)
    slope, effect, contrast = (np.full(value.shape, np.nan) for _ in range(3))
    noise, shape, steep = np.ones(value.shape), np.zeros(value.shape), np.zeros(value.shape, dtype=bool)
    for wavelengths, rows, cells in _poses(data.places):
        known = stencil(wavelengths, band)
        f = _means(np.where(detected, value, np.nan)[rows], cells, len(wavelengths))
        s = _means(np.where(data.etalon.value > 0.0, data.etalon.value, np.nan)[rows], cells, len(wavelengths))
        f1, f2 = _derivatives(f, known)
        relative = _derivatives(s, known)[0] / s
        here = -variance * (0.5 * f2 + f1 * relative) / f
        left = _departure(f, _means(data.estimate.variance[rows], cells, len(wavelengths)), known) / f
        left = np.where(known.exact[:, None] & (left <= OF_ACCOUNT), 0.0, left)  # a parabola has it too
        unresolved = (left > OF_ACCOUNT) & (left > np.abs(here))
        f1 = np.where(unresolved, _steeper_side(f, wavelengths), f1)
        steep[rows] = _of_rows(np.where(unresolved | (np.abs(here) > LARGE_EFFECT), 1.0, 0.0), cells) > 0.0
        shape[rows] = _of_rows(np.nan_to_num(left), cells)
        here = np.where(np.abs(here) <= LARGEST_EFFECT, here, np.nan)
        slope[rows], effect[rows] = _of_rows(f1 / f, cells), _of_rows(np.log1p(here), cells)
        noise[rows] = _of_rows(_amplified_noise(known, relative, variance), cells)
        contrast[rows] = _of_rows(_contrast(f, s, known), cells)
    data = replace(data, wavelength_slope=slope, band_correction=effect, stray_contrast=contrast)
    if settings.rig.light.bandwidth_nm is not None:
        noise = np.where(np.isfinite(effect), noise, 1.0)
        estimate = data.estimate.scaled(np.exp(np.nan_to_num(effect)))
        own = {name: each * noise if name in INDEPENDENT else each for name, each in estimate.own.items()}
        grouped = {
            name: each.scaled(np.sqrt(noise)) if name in INDEPENDENT else each for name, each in estimate.grouped.items()
        }
        data = replace(data, estimate=replace(estimate, own=own, grouped=grouped))
    if shape.any():
        # The same spectrum in all directions, of one sample.
        number = settings.sample_number * LONGEST_PM + np.round(1e3 * data.places[:, WAVELENGTH])
        member = number.astype(np.int32)[:, None, None]
        effect = (shape * data.estimate.value)[..., None]
        data = replace(data, estimate=data.estimate.with_grouped("band_shape", member, effect))
    return data.flagged({"steep": steep}) if steep.any() else data


def _poses(places: Floats) -> Iterator[tuple[tuple[float, ...], Ints, Ints]]:
    """The poses of several wavelengths of rows at places (rows, 5), those with the same wavelengths together.

    With the wavelengths come the rows, and each row's cell. Cells are numbered by pose, and within it by wavelength; repeats
    are in one cell.
    """
    places = round_deg(places[:, [WAVELENGTH, *POSE]])
    light = places[:, 0]
    if (light == light[0]).all():
        return
    _, pose = np.unique(places[:, 1:], axis=0, return_inverse=True)
    order = np.lexsort([light, pose.ravel()])
    new_pose = np.diff(pose.ravel()[order], prepend=-1) != 0
    cell = np.cumsum(new_pose | (np.diff(light[order], prepend=-1.0) != 0.0)) - 1
    of_pose: dict[tuple[float, ...], list[Ints]] = defaultdict(list)
    for part in np.split(np.arange(order.size), np.flatnonzero(new_pose)[1:]):
        known = np.unique(light[order[part]])
        if known.size > 1:
            of_pose[tuple(known.tolist())].append(part)
    for wavelengths, parts in of_pose.items():
        cells = [cell[part] - cell[part[0]] + k * len(wavelengths) for k, part in enumerate(parts)]
        yield wavelengths, order[np.concatenate(parts)], np.concatenate(cells)


def _means(values: Floats, cells: Ints, wavelengths: int) -> Floats:
    """Means (poses, wavelengths, n) of values (rows, n), by their cells."""
    total, count = np.zeros((cells.max() + 1, values.shape[1])), np.bincount(cells)
    np.add.at(total, cells, values)
    return (total / count[:, None]).reshape(-1, wavelengths, values.shape[1])


def _of_rows(cells_values: Floats, cells: Ints) -> Floats:
    """The values (rows, n) of cells, from those (poses, wavelengths, n)."""
    return cells_values.reshape(-1, cells_values.shape[2])[cells]


def _derivatives(values: Floats, known: Stencil) -> tuple[Floats, Floats]:
    """First and second derivative over wavelength of values (poses, wavelengths, n)."""
    first, second = np.zeros(values.shape), np.zeros(values.shape)
    for m in range(known.index.shape[1]):
        used = values[:, known.index[:, m]]
        first += known.first[:, m, None] * used
        second += known.second[:, m, None] * used
    return first, second


def _departure(values: Floats, variance: Floats, known: Stencil) -> Floats:
    """Largest departure of values (poses, wavelengths, n) near each one from its parabola, beyond noise; 0 where unknown."""
    result = np.zeros(values.shape)
    some = np.flatnonzero(known.departure.any(axis=(1, 2)))
    near, weights = known.nearby[some], known.departure[some]
    of_noise = CERTAIN**2 * (weights**2 @ variance[:, near])
    squared = np.max((weights @ values[:, near]) ** 2 - of_noise, axis=2)
    result[:, some] = np.sqrt(np.maximum(np.nan_to_num(squared), 0.0))
    return result


def _steeper_side(values: Floats, wavelengths_nm: Sequence[float]) -> Floats:
    """The steeper one of the slopes to both neighbours, of values (poses, wavelengths, n)."""
    steps = np.diff(values, axis=1) / np.diff(wavelengths_nm)[:, None]
    before, after = (np.concatenate(each, axis=1) for each in ((steps[:, :1], steps), (steps, steps[:, -1:])))
    return np.where(np.abs(after) >= np.abs(before), after, before)


def _amplified_noise(known: Stencil, relative: Floats, variance: float) -> Floats:
    """The factor on the variance of independent noise, the same at all wavelengths: the correction is a sum of noisy values."""
    first, second = known.own
    own = variance * (0.5 * second[:, None] + first[:, None] * relative)
    squares = [np.sum(a * b, axis=1)[:, None] for a, b in ((known.second, known.second), (known.first, known.second))]
    of_first = np.sum(known.first**2, axis=1)[:, None]
    total = 0.25 * squares[0] + squares[1] * relative + of_first * relative**2
    return np.asarray(1.0 - 2.0 * own + variance**2 * total)


def _contrast(f: Floats, s: Floats, known: Stencil) -> Floats:
    """What a share of light of all wavelengths adds to values, less what it adds to the etalon's: 0 for grey samples."""
    if known.others.size < FEWEST_OTHERS:
        return np.full(f.shape, np.nan)
    some_f, some_s = f[:, known.others], s[:, known.others]
    both = np.isfinite(some_f) & np.isfinite(some_s)
    weight = np.where(both, some_s, 0.0)
    total = weight.sum(axis=1, keepdims=True)
    mean = (weight * np.where(both, some_f, 0.0)).sum(axis=1, keepdims=True) / np.where(total > 0.0, total, np.nan)
    return np.asarray(mean / f - 1.0)


def wavelength_effects(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """The error of the monochromator's wavelength; 0 where the slope over wavelength is unknown."""
    return _known_effects(points, quantity(WAVELENGTH_ERROR, settings.rig.uncertainty), points.wavelength_slope)


def bandwidth_effects(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """The band: half of what was corrected, or all of the effect where the rig file states no band; 0 where it is unknown."""
    stated = settings.rig.light.bandwidth_nm is not None
    words = "[light] bandwidth_nm" if stated else f"no band is stated; {ASSUMED_BAND_NM:g} nm are assumed"
    source = InputQuantity(
        "bandwidth", "1", KNOWN_HALF if stated else 1.0, "normal", "all values", words, "", origin=STATED if stated else ASSUMED
    )
    return _known_effects(points, source, points.band_correction)


def stray_effects(points: BsdfPoints, settings: ReductionSettings) -> Effects | None:
    """The monochromator's light of other wavelengths; where these were not measured the sample may be twice as bright there."""
    source = quantity(MONOCHROMATOR_STRAY, settings.rig.uncertainty)
    return _known_effects(points, source, np.where(np.isnan(points.stray_contrast), 1.0, points.stray_contrast))


def _known_effects(points: BsdfPoints, source: InputQuantity, sensitivity: Floats) -> Effects | None:
    if not source.u or np.isnan(sensitivity).all():
        return None
    return Effects(points.bsdf, {}, (), [Dense([source], np.nan_to_num(sensitivity)[:, None])])
