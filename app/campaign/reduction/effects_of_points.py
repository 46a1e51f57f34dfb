"""The components by errors of angles, and all components of points as effects of named inputs: which values share which error.

A component of a point (components.py) is a variance by the name of a family of inputs. `effects_of` divides it among the inputs
of that family, from pose, slopes and kept columns, for some points at a time: budgets, covariances and integrals follow. The
parts of a family sum to its variance. FAMILIES and ALONE name every component once.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.measurement_model.alignment import Alignment, known_displacement
from goniotwin.app.campaign.measurement_model.effects import Dense, Effects, Group, group_variance
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.measurement_model.light_place import light_place
from goniotwin.app.campaign.measurement_model.pose import (
    POSITIONS,
    Displacement,
    PoseEffects,
    Views,
    lifted_inputs,
    mounting_inputs,
    photodiode_inputs,
    pose_effects,
    position_input,
    position_u_deg,
    rig_inputs,
    standard_uncertainties,
    variance,
)
from goniotwin.app.campaign.reduction.etalon import ReductionSettings
from goniotwin.app.campaign.reduction.evidence import LEAST_CERTIFIED
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints
from goniotwin.app.campaign.reduction.scale import SHARED, EffectsOf, Kind, incidence_deg, mounted
from goniotwin.app.rig import RigFile, nominal_instrument
from goniotwin.arrays import Floats, Ints

ANGLES = tuple(PLACE.index(f"{axis}_deg") for axis in POSITIONS)
JOURNAL = "the journal's readings"
ALONE = frozenset({"noise", "resolution", "ray_tracing", "field_noise", "second_order", "slope_unresolved"})
"""Components of which each value has an error of its own. In a table `second_order` and `slope_unresolved` count as shared."""


def add_pose(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """Add the components `pose`, `position` and `photodiode_angle`; without slopes they have their diffuse part alone.

    `pose` is that of all inputs that the rig or a mounting has once, `position` that of the axes' positions after each move.
    """
    if settings.alignment is not None:
        return _add_aligned_pose(points, settings)
    poses = [tuple(each) for each in points.places[:, ANGLES].tolist()]
    sums = settings.geometry.pose_sums(poses)[points.place, points.photodiode]
    along, across = slopes(points)
    table = settings.rig.uncertainty
    u_along, u_across = table.standard("photodiode_angle_deg"), table.standard("photodiode_across_deg")
    squared = points.bsdf**2
    added = {
        "pose": variance(sums[:, 0], along, across) * squared,
        "position": variance(sums[:, 1], along, across) * squared,
        "photodiode_angle": ((along * u_along) ** 2 + (across * u_across) ** 2) * squared,
    }
    return replace(points, components={**points.components, **added})


def _add_aligned_pose(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """The same with the covariance of an alignment, from the effects themselves."""
    effects = angles(points, settings)
    relative = np.zeros(points.size)
    for part in effects.dense:
        relative += np.sum((part.sensitivity * [each.u for each in part.inputs]) ** 2, axis=1)
    of_groups = {group.name: group_variance(group) for group in effects.groups}
    added = {name: each * points.bsdf**2 for name, each in {"pose": relative, **of_groups}.items()}
    return replace(points, components={**points.components, **added})


def slopes(points: BsdfPoints) -> tuple[Floats, Floats]:
    """The slopes (n,) along the arc and across it, per degree; 0 where they are unknown: the noise is larger."""
    return np.nan_to_num(points.slope_along), np.nan_to_num(points.slope_across)


def effects_of(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The effects of all inputs on points with values; NaN for others. Memory: some hundred inputs a point."""
    value = _scale(points)
    independent = {name: np.maximum(each, 0.0) / value**2 for name, each in points.components.items() if name in ALONE}
    groups: list[Group] = []
    dense: list[Dense] = []
    families = [FAMILIES.get(name, _unknown(name)) for name in points.components if name not in ALONE]
    for family in dict.fromkeys(families):  # one function may have several components
        if (found := family(points, settings)) is not None:
            # A relative change leaves a value of 0 as it is.
            unit = (found.value / value)[:, None]
            groups += [replace(each, sensitivity=each.sensitivity * unit) for each in found.groups]
            dense += [replace(each, sensitivity=each.sensitivity * unit) for each in found.dense]
    return Effects(value, independent, groups, dense)


def _scale(points: BsdfPoints) -> Floats:
    """The values (n,); 1 in place of 0, which has no relative uncertainty."""
    return np.where(points.bsdf == 0.0, 1.0, points.bsdf)


# Families whose component is a variance of signals: their effects divide it. In them a value of 0 is scaled to 1.


def _relative(points: BsdfPoints, name: str) -> Floats:
    """The relative standard uncertainty (n,) by a component."""
    return np.sqrt(np.maximum(points.components[name], 0.0)) / np.abs(_scale(points))


def _signed(points: BsdfPoints, name: str) -> Floats:
    """The same of what is added to a value whatever its sign."""
    return np.where(points.bsdf < 0.0, -1.0, 1.0) * _relative(points, name)


def _unknown(name: str) -> EffectsOf:
    """A component that no list has: one input that all values share, so that u of a sum is at most too large."""

    def effects(points: BsdfPoints, settings: ReductionSettings) -> Effects:
        del settings
        return _of_one(points, InputQuantity(name, "1", 1.0, "normal", "all values", JOURNAL, ""), _relative(points, name))

    return effects


def _of_one(points: BsdfPoints, source: InputQuantity, sensitivity: Floats) -> Effects:
    return Effects(_scale(points), {}, (), [Dense([source], sensitivity[:, None])])


def _of_group(points: BsdfPoints, group: Group) -> Effects:
    return Effects(_scale(points), {}, [group], ())


def dark(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The dark readings of a photodiode and a gain before and after a row: what was subtracted is between the two, by time."""
    # Its volts are one share of a bright value and another of a dark one.
    return _of_dark_readings("dark", points, settings, points.row, points.gain, -_signed(points, "dark"))


def etalon_dark(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The same before and after the etalon's row: common to the etalon's readings of a photodiode between them."""
    relative = _relative(points, "etalon_dark")
    return _of_dark_readings("etalon_dark", points, settings, points.etalon_row, points.etalon_gain, relative)


def _of_dark_readings(
    name: str, points: BsdfPoints, settings: ReductionSettings, rows: Ints, gain: Ints, signed: Floats
) -> Effects:
    history = settings.history
    before = rows if history is None else history.dark_readings(rows)
    share = np.zeros(points.size) if history is None else history.dark_share(rows)
    keys = np.concatenate([np.stack([points.photodiode, gain, before + k], axis=1) for k in (0, 1)])
    shares = np.stack([1.0 - share, share], axis=1) / np.hypot(1.0 - share, share)[:, None]
    both = _grouped(
        "dark", keys, np.ones(2 * points.size), lambda key: f"[{key[0]}, {_gain(key[1], settings.rig)}]@dark {key[2]}",
        "rows of this photodiode and gain until the next dark reading, and after the one before", scaled=True,
    )  # fmt: skip
    member = np.where(shares > 0.0, both.member.reshape(2, points.size).T, -1)
    return _of_group(points, replace(both, name=name, member=member, sensitivity=signed[:, None] * shares))


def etalon_reading(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The etalon's reading: common to all values that were divided by it."""
    del settings
    keys = np.stack([points.etalon_row, points.photodiode], axis=1)
    shared, relative = "all values that divide by it", _relative(points, "etalon_reading")
    return _of_group(points, _grouped("etalon_reading", keys, -relative, lambda key: f"[{key[1]}]@row {key[0]}", shared))


def lamp(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """What all photodiodes of a row have in common, at the row and at the etalon's row; taken as equal parts."""
    del settings
    return _of_rows(points, "lamp", 1.0, JOURNAL, "light.flicker")


def monitor(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The monitor's reading at the row, and at the etalon's row."""
    return _of_rows(
        points, "monitor", settings.rig.monitor.relative_uncertainty, "[monitor] relative_uncertainty", "monitor.noise"
    )


def monitor_drift(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The drift of the monitor against the light, from the etalon's row to the sample's."""
    change = 1.0 if settings.history is None else settings.history.hours(points.row) - settings.history.hours(points.etalon_row)
    return _of_change(points, "monitor_drift", "monitor_drift_per_hour", change, settings)


def monitor_linearity(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The linearity of the monitor, by the decades from the light at the etalon's row to that at the sample's."""
    history = settings.history
    change = 1.0 if history is None else history.monitor_decades(points.row) - history.monitor_decades(points.etalon_row)
    return _of_change(points, "monitor_linearity", "monitor_linearity_per_decade", change, settings)


def _of_change(points: BsdfPoints, name: str, key: str, change: Floats | float, settings: ReductionSettings) -> Effects:
    """One input of all values, with the sign of what has changed: where the monitor gives more, values are lower."""
    source = _of_table(name, key, settings)
    return _of_one(points, source, -np.where(np.less(change, 0.0), -1.0, 1.0) * _relative(points, name) / (source.u or 1.0))


def _of_rows(points: BsdfPoints, name: str, u: float, source: str, twin: str) -> Effects:
    numbers = np.stack([points.row, points.etalon_row], axis=1)
    inputs = {
        number: InputQuantity(f"{name}@row {number}", "1", u, "normal", "all photodiodes of the row", source, twin)
        for number in np.unique(numbers).tolist()
    }
    return _of_group(points, Group(name, inputs, numbers, _pair(_relative(points, name), u)))


def gain(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The gains of a photodiode at the row and at the etalon's row: one and the same gain cancels."""
    count = len(settings.rig.photodiodes.gains_v_per_a) + 1
    gains = np.stack([points.gain, points.etalon_gain], axis=1) % count  # none, -1, is the last one
    numbers = points.photodiode[:, None] * count + gains
    inputs = {number: gain_input(number // count, number % count, settings.rig) for number in np.unique(numbers).tolist()}
    u = next((each.u for each in inputs.values()), 0.0)
    return _of_group(points, Group("gain", inputs, numbers, _pair(_relative(points, "gain"), u)))


def gain_input(photodiode: int, gain: int, rig: RigFile) -> InputQuantity:
    """The gain of a photodiode's channel, by its place in the rig's list."""
    u = max(rig.photodiodes.gain_uncertainty, LEAST_CERTIFIED)
    return InputQuantity(
        f"gain_ratio[{photodiode}, {_gain(gain, rig)}]", "1", u, "normal", "all values of this photodiode at this gain",
        "[photodiodes] gain_uncertainty, and rows at two gains", "electronics.gain_spread",
    )  # fmt: skip


def linearity(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The photodiodes' linearity, by the decades from the etalon's current to the sample's."""
    polar = polar_from_zenith(points.zenith_deg)
    factor, _ = settings.certificate.interpolate(points.wavelength_nm, incidence_deg(points), polar, points.azimuth_deg)
    brighter = math.pi * points.bsdf * np.exp(-points.field_correction) > factor
    source = _of_table("linearity", "linearity_per_decade", settings)
    size = _relative(points, "linearity") / (source.u or 1.0)
    return _of_one(points, source, np.where(brighter, size, -size))


def crosstalk(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The share of a module's other channels, at the sample; that at the etalon is in its reading."""
    source = _of_table("crosstalk", "crosstalk", settings)
    # Where rows at two gains show more of it than is stated, values have more of this input.
    source = replace(source, u=source.u or 1.0, source=f"{source.source}, and rows at two gains")
    return _of_one(points, source, _signed(points, "crosstalk") / source.u)


def signature(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The instrument signature, which was subtracted."""
    of_rig = "[sample_unit] signature_uncertainty, and the journal's readings"
    source = InputQuantity("signature", "1", 1.0, "normal", "all values", of_rig, "")
    del settings
    return _of_one(points, source, -_signed(points, "signature"))


def calibration(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The factors of the photodiodes from their overlaps."""
    del settings
    shared, relative = "all values of this photodiode", _relative(points, "calibration")
    return _of_group(points, _grouped("calibration", points.photodiode[:, None], relative, lambda key: f"[{key[0]}]", shared))


def band_shape(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """What the parabola over the wavelengths does not resolve: the same spectrum in all directions."""
    del settings
    keys = np.round(1e3 * points.wavelength_nm).astype(np.int64)[:, None]
    relative = _relative(points, "band_shape")
    return _of_group(
        points, _grouped("band_shape", keys, relative, lambda key: f"[{1e-3 * key[0]:g} nm]", "all values of this wavelength")
    )


def field(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The logarithm of the variance of the directions in the field of view: with more of it more had to be corrected."""
    source = _of_table("field", "field_of_view", settings)
    return Effects(points.bsdf, {}, (), [Dense([source], -points.field_correction[:, None])])


def _of_table(name: str, key: str, settings: ReductionSettings) -> InputQuantity:
    """A relative input of all values, of the rig file's `[uncertainty]`."""
    table = settings.rig.uncertainty
    source, twin = f"[uncertainty] {key}", f"disturbances.{key}"
    return InputQuantity(name, "1", table.standard(key), table.distribution(key), "all values", source, twin)


def _gain(index: int, rig: RigFile) -> str:
    gains = rig.photodiodes.gains_v_per_a
    return f"{gains[index]:g} V/A" if 0 <= index < len(gains) else "no gain"


def _pair(relative: Floats, u: float) -> Floats:
    """Sensitivities (n, 2) to two inputs of one uncertainty, of which the value is the quotient."""
    size = relative / (np.sqrt(2.0) * u) if u > 0.0 else np.zeros(relative.size)
    return np.stack([-size, size], axis=1)


def _grouped(
    name: str, keys: Ints, signed: Floats, label: Callable[[Sequence[int]], str], shared_by: str, *, scaled: bool = False
) -> Group:
    """A group with one input for each of `keys` (n, k); with `scaled` its uncertainty is 1, else that of its largest value."""
    distinct, which = np.unique(keys, axis=0, return_inverse=True)
    which = which.ravel()
    u = np.ones(len(distinct))
    if not scaled:
        u = np.zeros(len(distinct))
        np.maximum.at(u, which, np.abs(np.nan_to_num(signed)))
    inputs = {
        k: InputQuantity(f"{name}{label(key)}", "1", float(u[k]), "normal", shared_by, JOURNAL, "")
        for k, key in enumerate(distinct.tolist())
    }
    sensitivity = signed / np.where(u > 0.0, u, 1.0)[which]
    return Group(name, inputs, which[:, None], sensitivity[:, None])


# Angles.


def views_of_points(points: BsdfPoints) -> Views:
    """The directions that points were measured in, by the angles of the axes."""
    lower = points.transmitted != points.back
    return Views(
        sigma_deg=points.sigma_deg,
        gamma_deg=points.gamma_deg,
        polar=np.radians(np.where(lower, 180.0 - points.zenith_deg, points.zenith_deg)),
        azimuth=np.radians(points.azimuth_deg),
        lower=lower,
        transmitted=points.transmitted,
        reverse=np.cos(np.radians(points.azimuth_deg - points.beta_deg)) < 0.0,
    )


def angles(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The components `pose`, `position` and `photodiode_angle`: rig and mountings, the axes' positions, each photodiode."""
    table = settings.rig.uncertainty
    views = views_of_points(points)
    instrument = nominal_instrument(settings.rig)
    effects = pose_effects(instrument, views)
    if settings.alignment is not None:
        place = light_place(instrument, views, effects.common, settings.alignment.values)
        effects = replace(effects, common=place.added_to(effects.common))
    along, across = slopes(points)

    def relative(part: Displacement) -> Floats:
        return part.relative(along, across)

    dense = [Dense(inputs, relative(part)) for inputs, part in pose_parts(points, settings, effects)]
    lifted = relative(effects.lifted)
    kinds: Sequence[tuple[Kind, Ints, Floats]] = (("sample", points.row, lifted), ("etalon", points.etalon_row, -lifted))
    for kind, rows, products in kinds:
        names, which = mounted(kind, rows, settings)
        for k, name in enumerate(names):
            here = (which == k)[:, None]
            if kind == "etalon":
                dense.append(Dense(mounting_inputs(table, kind, name), np.where(here, relative(effects.etalon), 0.0)))
            dense.append(Dense(lifted_inputs(table, kind, name), np.where(here, products, 0.0)))
    photodiode = points.photodiode.astype(np.int64)
    own = {2 * c + k: each for c in np.unique(photodiode).tolist() for k, each in enumerate(photodiode_inputs(table, c))}
    own = {number: each for number, each in own.items() if not _is_aligned(each, settings)}
    numbers = 2 * photodiode[:, None] + np.arange(2)
    groups = [
        _positions(points, settings, np.concatenate([relative(effects.position), relative(effects.etalon_position)], axis=1)),
        Group("photodiode_angle", own, np.where(np.isin(numbers, [*own]), numbers, -1), relative(effects.photodiode)),
    ]
    return Effects(points.bsdf, {}, groups, dense)


def _is_aligned(each: InputQuantity, settings: ReductionSettings) -> bool:
    """Whether an alignment has found an input."""
    return settings.alignment is not None and each.name in settings.alignment.values


def pose_parts(
    points: BsdfPoints, settings: ReductionSettings, effects: PoseEffects
) -> Iterator[tuple[Sequence[InputQuantity], Displacement]]:
    """The inputs of the rig and of the sample's mountings, with what they do: as they are stated, or the modes of an alignment.

    Mountings that the alignment does not have keep inputs of their own; photodiodes that it has are in its modes.
    """
    table, alignment = settings.rig.uncertainty, settings.alignment
    names, which = mounted("sample", points.row, settings)
    own = [(mounting_inputs(table, "sample", name), effects.sample.where(which == k)) for k, name in enumerate(names)]
    if alignment is None:
        yield rig_inputs(table), effects.common
        yield from own
        return
    modes, of_modes = alignment.modes
    photodiodes = (
        (photodiode_inputs(table, c), effects.photodiode.where(points.photodiode == c))
        for c in np.unique(points.photodiode).tolist()
    )
    parts = [(rig_inputs(table), effects.common), *own, *photodiodes]
    yield modes, displacement_of(alignment, parts).times(of_modes)
    yield from (each for each in own if not _is_aligned(each[0][0], settings))


def displacement_of(alignment: Alignment, parts: Iterable[tuple[Sequence[InputQuantity], Displacement]]) -> Displacement:
    """What the inputs of an alignment do, each in a column; one that is in none of the parts does nothing."""
    columns = {each.name: (part, k) for inputs, part in parts for k, each in enumerate(inputs)}
    found = [columns.get(each.name) for each in alignment.inputs]

    def stacked(name: str) -> Floats:
        some = next(getattr(part, name) for part, _ in columns.values())
        none = np.zeros(len(some))
        return np.stack([none if each is None else getattr(each[0], name)[:, each[1]] for each in found], axis=1)

    return Displacement(stacked("along"), stacked("across"), stacked("diffuse"))


def aligned_displacement(points: BsdfPoints, settings: ReductionSettings) -> tuple[Displacement, Floats]:
    """What the misalignments found by an alignment do to points, (n, 1), and the variance (n, 2) of the angle that is left.

    Along the arc and across it; in deg and deg^2.
    """
    table, alignment = settings.rig.uncertainty, settings.alignment
    assert alignment is not None
    mountings, which = mounted("sample", points.row, settings)
    known = alignment.values
    tilts = np.array([[known.get(each.name, 0.0) for each in mounting_inputs(table, "sample", name)] for name in mountings])
    found, effects = known_displacement(nominal_instrument(settings.rig), views_of_points(points), known, tilts[which])
    names = [each.name for each in photodiode_inputs(table, 0)]
    own = [[name.replace("[0]", f"[{c}]") for name in names] for c in range(settings.rig.photodiodes.count)]
    angles_deg = np.array([[known.get(name, 0.0) for name in each] for each in own])[points.photodiode]
    found = Displacement(
        found.along + np.sum(effects.photodiode.along * angles_deg, axis=1)[:, None],
        found.across + np.sum(effects.photodiode.across * angles_deg, axis=1)[:, None],
        found.diffuse,
    )
    parts = [(part, standard_uncertainties(list(inputs))) for inputs, part in pose_parts(points, settings, effects)]
    parts.append((effects.position, np.full(len(POSITIONS), position_u_deg(table))))
    unknown = np.array([[name not in known for name in each] for each in own])[points.photodiode]
    stated = standard_uncertainties(photodiode_inputs(table, 0))
    parts.append((Displacement(*(each * unknown for each in vars(effects.photodiode).values())), stated))
    variance_deg2 = [
        np.sum([np.sum((getattr(part, axis) * u) ** 2, axis=1) for part, u in parts], axis=0) for axis in ("along", "across")
    ]
    return found, np.stack(variance_deg2, axis=1)


def _positions(points: BsdfPoints, settings: ReductionSettings, sensitivity: Floats) -> Group:
    """The axes' positions at the row and at the etalon's row, each common to all rows until the axis' next move."""
    count = len(POSITIONS)
    both = points.row, points.etalon_row
    history = settings.history
    moves = [np.repeat(rows[:, None], count, axis=1) if history is None else history.moves(rows) for rows in both]
    numbers = np.concatenate(moves, axis=1) * count + np.tile(np.arange(count), 2)
    inputs = {
        number: position_input(settings.rig.uncertainty, POSITIONS[number % count], number // count)
        for number in np.unique(numbers).tolist()
    }
    return Group("position", inputs, numbers, sensitivity)


FAMILIES: Mapping[str, EffectsOf] = {
    "dark": dark,
    "etalon_dark": etalon_dark,
    "etalon_reading": etalon_reading,
    "lamp": lamp,
    "monitor": monitor,
    "monitor_drift": monitor_drift,
    "monitor_linearity": monitor_linearity,
    "gain": gain,
    "linearity": linearity,
    "crosstalk": crosstalk,
    "signature": signature,
    "calibration": calibration,
    "band_shape": band_shape,
    "field": field,
    "pose": angles,
    "position": angles,
    "photodiode_angle": angles,
    **SHARED,
}
"""The families of inputs by the names of their components: each gives the effects of its inputs on points."""
