"""The points of a reduction: a BSDF at the measured directions, with components of the uncertainty and flags; their counts.

Two values of one direction, or of a direction and its mirror image, differ by more than noise where the lobe is steep and the
angles have errors. `steepness` is the slope that turns an angular error into an error of the value. Without it, checks and
calibrations would find a fault in every narrow lobe.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.geometry.directions import in_plane_of_incidence, polar_from_zenith, scan_plane_deg
from goniotwin.app.campaign.measurement_model.quantity import (
    Components,
    Quantity,
    Terms,
)
from goniotwin.app.campaign.reduction.components import (
    COVERAGE,
    DRAWN_LAW,
    LINEAR_LAW,
    LOGARITHMIC_LAW,
    OTHER,
    UNLIT,
    interval,
    kinds,
    logarithmic,
    mostly_added,
    standard_uncertainty,
    total_variance,
)
from goniotwin.app.columns import (
    BitColumn,
    ColumnTable,
    Degrees,
    FlagColumn,
    IndexColumn,
    IntegerColumn,
    NumberColumn,
    PerDegree,
    PerNanometre,
    PerSteradian,
    Ratios,
)
from goniotwin.app.formats import content
from goniotwin.arrays import Flags, Floats, Ints, Texts, read_only
from goniotwin.twin.optics.geometry.coordinates import aspecular_deg, round_deg, signed_polar

SLOPE_DECIMALS = 3
"""No slope is taken between directions closer than a thousandth of a degree: noise over so short a way is no steepness."""
PLACE = ("wavelength_nm", "gamma_deg", "sigma_deg", "beta_deg", "shift_deg")
"""Wavelength and pose of a row: the columns of `BsdfPoints.places`."""
CHANCE = 1e-6
"""Probability that the largest of all differences exceeds its limit, where the uncertainties are right."""
DEVIATIONS = 5.0
"""Limit of chi-square, in standard deviations of its distribution."""
Marks = npt.NDArray[np.uint16]


@dataclass(frozen=True)
class Flag:
    """A flag of a point: its `meaning` for the header of a file; `content.UNTRUSTED` has those that take the trust away.

    `reason` and `remedy` are those of a missing value, for a warning; empty where a flag takes no value away.
    """

    meaning: str
    reason: str = ""
    remedy: str = ""


FLAGS: dict[str, Flag] = {
    # Wholly or in part, at the sample or at the etalon that scales it. A value from the remaining light may be there.
    "shadowed": Flag("blocked by the mirror unit", "blocked by the mirror unit", "choose other angles"),
    # For sample, etalon or signature.
    "clipped": Flag("saturated at every gain", "saturated at every gain", "add a lower gain"),
    "no-etalon": Flag(
        "etalon signal too low",
        "without a signal of the etalon",
        "add a higher gain, or choose an etalon that scatters to the side that the photodiodes look at",
    ),
    # No signal of the etalon where there should be one; or the photodiode has lost its dark current.
    "dead": Flag("the photodiode", "of dead photodiodes", "repair them"),
    "uncertified": Flag(
        "not covered by the etalon's certificate",
        "not covered by the etalon's certificate",
        "choose an etalon with a certificate that covers them",
    ),
    # Between drift checks one of which was beyond its limit. The value is there, and may be wrong.
    "drift": Flag("beyond its limit", "flagged for drift", "see the drift checks"),
    # In a test of all rows: a ratio of two gains, or the first reading against the later ones. Of all channels of a module.
    "module": Flag(
        "the module of the photodiode: settling or linearity, see the notes",
        "of modules that did not pass their tests",
        "see the notes on the modules",
    ),
    "monitor": Flag(
        "the monitor was at the end of its range",
        "measured with the monitor at the end of its range",
        "set a wider range of the monitor in the rig file",
    ),
    # Of the row, or of a dark reading beside it: in every attempt a count was far from the others of its photodiode.
    "contradiction": Flag(
        "readings of the row, or of its dark reading, contradict each other",
        "of rows whose readings contradict each other",
        "check the wire of the photodiodes, and measure these rows again",
    ),
    # By the scan of the open beam. All values that the etalon scales have it.
    "scale": Flag(
        "the etalon and the scan of the open beam do not agree, see the notes",
        "of an etalon that does not agree with the scan of the open beam",
        "see goniotwin closure",
    ),
    # Or in the uncertainty of the signature: the value is right, but its relative uncertainty is large.
    "under-range": Flag("below the detection limit"),
    "field": Flag("the effect of the field of view cannot be estimated: it is neither corrected nor in u_bsdf"),
    # A good value with a warning: a slope is what turns an error of an angle into one of the value.
    "steep": Flag(
        "the slope of the lobe along or across the arc, or of the spectrum, is not resolved by the measured directions or "
        "wavelengths nearby: u_bsdf may be too small",
    ),
}
"""The flags of a point by their names in files. Where a point has no value, a flag gives the reason."""
BITS = {name: np.uint16(1 << k) for k, name in enumerate(FLAGS)}
UNTRUSTED = np.uint16(sum(int(BITS[name]) for name in FLAGS if name in content.UNTRUSTED))
REASON_ORDER = (
    "shadowed",
    "uncertified",
    "no-etalon",
    "clipped",
    "dead",
    "module",
    "monitor",
    "contradiction",
    "drift",
    "scale",
)
"""Flags by which a tally counts a point: the first one that it has."""


def pack_flags(flags: Mapping[str, Flags], count: int) -> Marks:
    """Flags (count,) by name, as one number for each point."""
    marks = np.zeros(count, dtype=np.uint16)
    for name, flag in flags.items():
        marks[flag] |= BITS[name]
    return marks


@dataclass(frozen=True)
class MeasuredDirections(ColumnTable):
    """Where points were measured; arrays with an element for each point, but for `places`.

    `places` (rows, 5) are the distinct wavelengths and poses, in the order of PLACE, and `place` the index of each point's.
    Angles in degrees: `zenith` and `azimuth` of the observation in the rig's frame, `theta` and `phi` about the specular
    direction (for transmitted light: about the direction of regular transmission). `back`: the sample is lit from behind,
    sigma is beyond 90 deg. `mirrored`: measured to check the stated symmetry; a good value, but not one that the schedule's
    grid asks for.
    """

    places: Floats
    place: IndexColumn
    photodiode: IntegerColumn
    zenith_deg: Degrees
    azimuth_deg: Degrees
    theta_deg: Degrees
    phi_deg: Degrees
    back: FlagColumn
    transmitted: FlagColumn
    mirrored: FlagColumn

    @property
    def wavelength_nm(self) -> Floats:
        """The wavelengths."""
        return self._column("wavelength_nm")

    @property
    def sigma_deg(self) -> Floats:
        """Sigma of the rig."""
        return self._column("sigma_deg")

    @property
    def gamma_deg(self) -> Floats:
        """Rotation of the sample."""
        return self._column("gamma_deg")

    @property
    def beta_deg(self) -> Floats:
        """Azimuth of the arc."""
        return self._column("beta_deg")

    @property
    def shift_deg(self) -> Floats:
        """Shift of the arc."""
        return self._column("shift_deg")

    @property
    def in_plane(self) -> Flags:
        """The points in the plane of incidence."""
        return in_plane_of_incidence(self.zenith_deg, self.azimuth_deg)

    @property
    def aspecular_deg(self) -> Floats:
        """Aspecular angle: theta, positive towards the normal (phi = 0) and negative towards grazing."""
        return aspecular_deg(self.theta_deg, self.phi_deg)

    def read_only(self) -> Self:
        """The same points as arrays that cannot be written."""
        return replace(self.each(read_only), places=read_only(self.places))

    def _column(self, name: str) -> Floats:
        return np.asarray(self.places[self.place, PLACE.index(name)])


class PointSource(Protocol):
    """The points of a sample, in memory or in a file, which are read in parts."""

    @property
    def size(self) -> int:
        """Number of points."""

    def parts(self, points: int) -> Iterator["BsdfPoints"]:
        """All points in order of time, about so many at once."""

    def settings(self, wavelength_nm: float | None = None) -> Iterator["BsdfPoints"]:
        """The points of each wavelength, or of one, and sigma, in the order of these; within them in order of time."""


@dataclass(frozen=True)
class BsdfPoints(MeasuredDirections):
    """A BSDF at measured directions.

    `bsdf` is in 1/sr, NaN where there is no value; `own`, `common` and `grouped` are those of a `Quantity`: what each value has
    alone, and the effects of the inputs that came in with the readings. `stated` are the variances by the families of inputs of
    files, whose effects follow from the pose (effects_of_points.py). `marks` are its flags in bits.
    `signature` is the instrument signature's share of the sample's signal, already subtracted; NaN where it was not measured.

    `slope_along` and `slope_across` are the derivatives of ln bsdf per degree, without the field of view; NaN where unknown.
    Along: towards growing polar angle, from the pole of the direction's own arc, in the half plane of its azimuth. Across:
    towards direction x along, which on the upper arc is growing azimuth, on the lower arc falling azimuth. `field_correction`
    is what the correction of the field of view has added to ln bsdf; 0 where nothing was corrected. `coverage` (n, 2) are the
    standard uncertainties from a value down and up to the ends of its interval of 95 %.

    `row` is the number of the row in the journal, and `etalon_row` of that of the etalon's reading, of several the first one.
    `second_row` is that of the second standard's reading where this has a share in the scale, else -1. `gain` and
    `etalon_gain` are the indices of the gains of the first two readings, -1 where they are saturated.

    NaN where they are unknown: `wavelength_slope`, d ln f / d wavelength in 1/nm; `band_correction`, the effect of the band on
    ln f, added to it where the band is stated; `stray_contrast`, the relative change for a share of light of other wavelengths.
    """

    bsdf: PerSteradian
    own: Components
    common: Mapping[str, NumberColumn]
    grouped: Mapping[str, Terms]
    stated: Components
    marks: BitColumn
    signature: Ratios
    slope_along: PerDegree
    slope_across: PerDegree
    field_correction: Ratios
    coverage: Ratios
    row: IntegerColumn
    etalon_row: IntegerColumn
    second_row: IntegerColumn
    gain: IntegerColumn
    etalon_gain: IntegerColumn
    wavelength_slope: PerNanometre
    band_correction: Ratios
    stray_contrast: Ratios

    @classmethod
    def join(cls, tables: Sequence[Self]) -> Self:
        """The points of all blocks, in order; a component that a block does not have is 0 there."""
        first = np.cumsum([0, *(len(table.places) for table in tables)], dtype=np.int32)
        moved = [replace(table, place=table.place + k) for table, k in zip(tables, first[:-1], strict=True)]
        return replace(super().join(moved), places=np.concatenate([table.places for table in tables]))

    @property
    def quantity(self) -> Quantity:
        """The values with the effects of the inputs that came in with the readings."""
        return Quantity(self.bsdf, self.own, self.common, self.grouped)

    @property
    def components(self) -> Components:
        """The components of the uncertainty by name (see components.py): variances in 1/sr^2."""
        return dict(sorted({**self.quantity.components, **self.stated}.items()))

    def scaled(self, factor: Floats) -> "BsdfPoints":
        """The points with their values times exactly known factors (n,)."""
        stated = {name: variance * factor**2 for name, variance in self.stated.items()}
        return self.with_quantity(self.quantity.scaled(factor), stated=stated)

    def with_quantity(self, quantity: Quantity, **columns: Any) -> "BsdfPoints":
        """The points with other values and effects, and other columns."""
        return replace(self, **points_of_quantity(quantity), **columns)

    def parts(self, points: int) -> Iterator["BsdfPoints"]:
        """All points, in parts of so many."""
        return (self.where(np.arange(begin, min(begin + points, self.size))) for begin in range(0, self.size, points))

    def settings(self, wavelength_nm: float | None = None) -> Iterator["BsdfPoints"]:
        """The points of each wavelength, or of one, and sigma, in the order of these."""
        order, edges = order_by_light(self.wavelength_nm, self.sigma_deg, wavelength_nm)
        return (self.where(order[begin:end]) for begin, end in itertools.pairwise(edges.tolist()))

    @property
    def u_bsdf(self) -> Floats:
        """Standard uncertainty of the BSDF, 1/sr."""
        return standard_uncertainty(self.components)

    @property
    def budget(self) -> dict[str, Floats]:
        """The components of `u_bsdf` by name, as standard uncertainties in 1/sr: their squares add up to its square."""
        return {name: np.sqrt(np.maximum(variance, 0.0)) for name, variance in self.components.items()}

    def own_variance(self, common: float) -> Floats:
        """The variance of the BSDF without what points of one direction share, and a relative uncertainty of the certificate's
        that is `common` to more.
        """
        of = kinds()
        others = {name: each for name, each in self.components.items() if not of.get(name, OTHER).of_direction}
        certificate = self.components.get("certificate", np.zeros(self.bsdf.size)) - (common * self.bsdf) ** 2
        # Where the open beam is the scale, the certificate has no part in it.
        return total_variance({**others, "certificate": np.maximum(certificate, 0.0)})

    @property
    def u_field(self) -> Floats:
        """The field's components of `u_bsdf`, 1/sr; NaN where they cannot be estimated."""
        known, components = self.good & ~self.flag("field"), self.components
        none = np.full(self.bsdf.size, np.nan)
        own = components.get("field_noise", 0.0) + components.get("field_unresolved", 0.0)
        return np.where(known, np.sqrt(components.get("field", none) + own), np.nan)

    @property
    def interval(self) -> tuple[Floats, Floats, Texts]:
        """Lower and upper ends (n,) of the intervals of 95 %, in 1/sr, and the law of each; NaN and "" without a value."""
        components = self.components
        added, u = mostly_added(components), standard_uncertainty(components)
        down, up = self.coverage.T
        low, high = interval(self.bsdf, u, added, down, up)
        law = np.where(logarithmic(self.bsdf, u, added), LOGARITHMIC_LAW, LINEAR_LAW)
        law = np.where((self.coverage == COVERAGE).all(axis=1), law, DRAWN_LAW)
        return low, high, np.where(np.isfinite(low), law, "")

    @property
    def flags(self) -> dict[str, Flags]:
        """The flags (n,) by their names in files."""
        return {name: self.flag(name) for name in FLAGS}

    def flag(self, name: str) -> Flags:
        """The points (n,) with a flag, by its name in files."""
        return np.asarray((self.marks & BITS[name]) != 0)

    def flagged(self, flags: Mapping[str, Flags]) -> "BsdfPoints":
        """The points with further flags, by their names in files."""
        return replace(self, marks=self.marks | pack_flags(flags, self.bsdf.size))

    @property
    def good(self) -> Flags:
        """The points with a trusted value."""
        return np.asarray(np.isfinite(self.bsdf) & ((self.marks & UNTRUSTED) == 0))

    @property
    def front(self) -> "BsdfPoints":
        """The points of light reflected on the front."""
        return self.where(~self.back & ~self.transmitted)

    @property
    def luminance_factor(self) -> Floats:
        """pi times the BSDF: 1 for the ideal diffuser."""
        return math.pi * self.bsdf


def points_of_quantity(quantity: Quantity) -> dict[str, Any]:
    """The fields of points that a quantity has."""
    return {"bsdf" if name == "value" else name: each for name, each in vars(quantity).items() if name != "gain"}


def order_by_light(wavelength_nm: Floats, sigma_deg: Floats, only_nm: float | None = None) -> tuple[Ints, Ints]:
    """Indices in the order of wavelength (or of `only_nm` alone) and sigma, else unchanged; and the edges of these sets."""
    chosen = np.arange(wavelength_nm.size) if only_nm is None else np.flatnonzero(wavelength_nm == only_nm)
    order = chosen[np.lexsort([sigma_deg[chosen], wavelength_nm[chosen]])]
    changes = (np.diff(wavelength_nm[order]) != 0.0) | (np.diff(sigma_deg[order]) != 0.0)
    ends = [order.size] if order.size else []
    return order, np.concatenate([[0], 1 + np.flatnonzero(changes), ends]).astype(np.int64)


@dataclass
class Tally:
    """Streaming counts of a sample's points by flag.

    `under_range` counts good points that are lost in their noise, `without_slope` and `without_band` those above it whose
    slope over wavelength, or effect of the band, is unknown; `flagged` all points by their first flag. `trusted` are the
    photodiodes of good values above their noise; `signature_subtracted` is true if the signature was subtracted anywhere.
    `gains` are the indices of the gains of good values, and `noise` the medians, one for each block of points, of the standard
    uncertainty in 1/sr that values at the block's highest gain have of what is there without light.
    """

    directions: int = 0
    good: int = 0
    under_range: int = 0
    flagged: dict[str, int] = field(default_factory=dict)
    trusted: set[int] = field(default_factory=set)
    transmitted: bool = False
    signature_subtracted: bool = False
    without_slope: int = 0
    without_band: int = 0
    gains: set[int] = field(default_factory=set)
    noise: list[float] = field(default_factory=list)

    @property
    def noise_floor(self) -> float | None:
        """Median over the blocks of `noise`, 1/sr; None without a good value."""
        return float(np.median(self.noise)) if self.noise else None

    @property
    def missing(self) -> dict[str, int]:
        """Counts of the points without a trusted value by their first flag; "" has those without a flag."""
        by_flag = {name: count for name in REASON_ORDER if (count := self.flagged.get(name, 0))}
        left = self.directions - self.good - sum(by_flag.values())
        return by_flag | ({"": left} if left else {})

    @property
    def missing_in_words(self) -> str:
        """The counts of `missing`, such as "4 are blocked by the mirror unit, 1 is saturated at every gain"."""
        return ", ".join(
            f"{count} {'is' if count == 1 else 'are'} {FLAGS[name].reason if name else 'without a value for another reason'}"
            for name, count in self.missing.items()
        )

    def add(self, points: BsdfPoints) -> None:
        """Count more points."""
        good, above_noise = points.good, ~points.flag("under-range")
        self.directions += points.bsdf.size
        self.good += int(good.sum())
        self.under_range += int((good & ~above_noise).sum())
        self.trusted.update(np.unique(points.photodiode[good & above_noise]).tolist())
        self.without_slope += int((good & above_noise & np.isnan(points.wavelength_slope)).sum())
        self.without_band += int((good & above_noise & np.isnan(points.band_correction)).sum())
        self.transmitted |= bool(points.transmitted.any())
        self.signature_subtracted |= bool(np.isfinite(points.signature).any())
        if good.any():
            gain = np.where(good, points.gain, -1)
            self.gains.update(np.unique(gain[good]).tolist())
            dim = gain == gain.max()
            variance = total_variance({name: each[dim] for name, each in points.components.items() if name in UNLIT})
            self.noise.append(float(np.median(np.sqrt(variance))))
        left = np.ones(points.bsdf.size, dtype=bool)
        for name in REASON_ORDER:
            here = left & points.flag(name)
            self.flagged[name] = self.flagged.get(name, 0) + int(here.sum())
            left &= ~here


def steepness(points: BsdfPoints) -> Floats:
    """Relative change of the BSDF per degree along the arc (n,): the larger of the slopes on either side, 0 where unknown.

    Neighbours are the nearest directions of the same half planes with a value above zero, from any photodiode and shift.
    """
    result = np.zeros(points.bsdf.size)
    usable = np.isfinite(points.bsdf) & (points.bsdf > 0.0) & ~points.flag("shadowed")
    if not usable.any():
        return result
    here = points.where(usable)
    plane = scan_plane_deg(here.beta_deg)
    signed = np.round(signed_polar(polar_from_zenith(here.zenith_deg), here.azimuth_deg, plane), SLOPE_DECIMALS)
    keys = [here.wavelength_nm, here.sigma_deg, here.gamma_deg, plane, here.transmitted, signed]
    places, which = np.unique(round_deg(np.stack(keys, axis=1)), axis=0, return_inverse=True)
    which = which.ravel()
    logs = np.bincount(which, weights=np.log(here.bsdf)) / np.bincount(which)
    same = np.all(places[1:, :-1] == places[:-1, :-1], axis=1)
    slope = np.abs(np.diff(logs)) / np.where(same, np.diff(places[:, -1]), np.inf)
    result[usable] = np.maximum(np.append(slope, 0.0), np.insert(slope, 0, 0.0))[which]
    return result


def plausible(pairs: int, chi_square: float, worst: float) -> bool:
    """Whether differences of pairs of values are as their uncertainties allow: one rule for all consistency checks.

    `chi_square` has to be within five standard deviations of its distribution for so many `pairs`, and `worst`, the largest
    difference in its standard uncertainties, below a limit that it exceeds with a probability of 1e-6.
    """
    if not pairs:
        return True
    most = math.sqrt(2.0 * math.log(pairs / CHANCE))
    return chi_square <= pairs + DEVIATIONS * math.sqrt(2.0 * pairs) and worst <= most
