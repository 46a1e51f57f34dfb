"""The components by errors of angles: poses of rig and mountings, the positions of the axes, each photodiode."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.measurement_model.alignment import Alignment, known_displacement
from goniotwin.app.campaign.measurement_model.effects import Dense, Effects, Group, group_variance
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.measurement_model.light_place import light_place
from goniotwin.app.campaign.measurement_model.lit_share import RigLaw, height_effects, height_inputs
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
from goniotwin.app.campaign.reduction.optical_paths import PathOfPoints, paths_of_points
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints
from goniotwin.app.campaign.reduction.settings import ReductionSettings, mounted
from goniotwin.app.rig import nominal_instrument
from goniotwin.app.rig.inputs import PHOTODIODE_ACROSS, PHOTODIODE_ANGLE
from goniotwin.arrays import Floats
from goniotwin.twin.plant.disturbances import ETALON, SAMPLE

ANGLES = tuple(PLACE.index(f"{axis}_deg") for axis in POSITIONS)


def add_pose(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """Add the components `pose`, `position` and `photodiode_angle`; without slopes they have their diffuse part alone.

    `pose` is that of all inputs that the rig or a mounting has once, `position` that of the axes' positions after each move.
    """
    if settings.alignment is not None or settings.second is not None:
        return _add_pose_by_effects(points, settings)
    poses = [tuple(each) for each in points.places[:, ANGLES].tolist()]
    sums = settings.geometry.pose_sums(poses)[points.place, points.photodiode]
    along, across = slopes(points)
    table = settings.rig.uncertainty
    u_along, u_across = table.u(PHOTODIODE_ANGLE), table.u(PHOTODIODE_ACROSS)
    squared = points.bsdf**2
    added = {
        "pose": variance(sums[:, 0], along, across) * squared,
        "position": variance(sums[:, 1], along, across) * squared,
        "photodiode_angle": ((along * u_along) ** 2 + (across * u_across) ** 2) * squared,
    }
    return replace(points, stated={**points.stated, **added})


def _add_pose_by_effects(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """The same with the covariance of an alignment, or with two standards, from the effects themselves."""
    effects = angles(points, settings)
    relative = np.zeros(points.size)
    for part in effects.dense:
        relative += np.sum((part.sensitivity * [each.u for each in part.inputs]) ** 2, axis=1)
    of_groups = {group.name: group_variance(group) for group in effects.groups}
    added = {name: each * points.bsdf**2 for name, each in {"pose": relative, **of_groups}.items()}
    return replace(points, stated={**points.stated, **added})


def slopes(points: BsdfPoints) -> tuple[Floats, Floats]:
    """The slopes (n,) along the arc and across it, per degree; 0 where they are unknown: the noise is larger."""
    return np.nan_to_num(points.slope_along), np.nan_to_num(points.slope_across)


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
    lifted, by_image = relative(effects.lifted), height_effects(RigLaw.of(settings.rig, settings.alignment), views)
    paths = paths_of_points(points, settings)
    for path in paths:
        names, which = mounted(path.kind, path.rows, settings)
        kind = SAMPLE if path.kind == SAMPLE else ETALON
        for k, name in enumerate(names):
            weight = np.where(which == k, path.weight, 0.0)[:, None]
            if not weight.any():
                continue
            if kind == ETALON:  # its effects are those on what divides by it
                dense.append(Dense(mounting_inputs(table, kind, name), -weight * relative(effects.etalon)))
            dense.append(Dense(lifted_inputs(table, kind, name), weight * lifted))
            dense.append(Dense(height_inputs(table, kind, name), weight * by_image[kind]))
    photodiode = points.photodiode.astype(np.int64)
    own = {2 * c + k: each for c in np.unique(photodiode).tolist() for k, each in enumerate(photodiode_inputs(table, c))}
    own = {number: each for number, each in own.items() if not _is_aligned(each, settings)}
    numbers = 2 * photodiode[:, None] + np.arange(2)
    groups = [
        _positions(paths, settings, relative(effects.position), relative(effects.etalon_position)),
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
    own: list[tuple[Sequence[InputQuantity], Displacement]] = []
    if paths_of_points(points, settings)[0].kind == SAMPLE:
        names, which = mounted(SAMPLE, points.row, settings)
        own = [(mounting_inputs(table, SAMPLE, name), effects.sample.where(which == k)) for k, name in enumerate(names)]
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


def _positions(paths: Sequence[PathOfPoints], settings: ReductionSettings, at_sample: Floats, at_etalon: Floats) -> Group:
    """The axes' positions at the rows of all paths, each common to all rows until the axis' next move."""
    count = len(POSITIONS)
    history = settings.history
    moves = [np.repeat(path.rows[:, None], count, axis=1) if history is None else history.moves(path.rows) for path in paths]
    numbers = np.concatenate(moves, axis=1) * count + np.tile(np.arange(count), len(paths))
    effects = [path.weight[:, None] * (at_sample if path.kind == SAMPLE else -at_etalon) for path in paths]
    inputs = {
        number: position_input(settings.rig.uncertainty, POSITIONS[number % count], number // count)
        for number in np.unique(numbers).tolist()
    }
    return Group("position", inputs, numbers, np.concatenate(effects, axis=1))
