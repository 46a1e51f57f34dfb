"""Scenes: poses, deviations, samples, wavelengths and detectors in one compiled call.

A scene is the instrument with one set of deviations at one pose. The geometry comes first and is the same for every sample:
seven rays for each detector (twin.optics.fast.rays), or a bundle (twin.optics.fast.ray_bundle) where a mirror blocks some of
what it takes. Each lobe is then summed over these rays. Sample and etalon have the same rays, and so have all wavelengths.
"""

import math
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.bsdf.kinds import ANISOTROPIC, GAUSSIAN, LAMBERTIAN, REGULAR, TABLE
from goniotwin.twin.optics.bsdf.lobes import Lobe, parameters
from goniotwin.twin.optics.bsdf.models import regular_share
from goniotwin.twin.optics.bsdf.packed_lobes import ABOVE, KIND, TRANSMITS, Models, model_arrays, pack_models
from goniotwin.twin.optics.bsdf.scatterer import Scatterer
from goniotwin.twin.optics.fast.aperture import (
    BLOCK,
    DX,
    DY,
    DZ,
    POINT,
    PX,
    PY,
    PZ,
    RAY,
    ROWS,
    WIDE,
    M,
    cone_nodes,
    fill_apertures,
    fill_frames,
    fill_wide_apertures,
    hole_nodes,
    side_nodes,
    whole_lanes,
)
from goniotwin.twin.optics.fast.bundle import aperture_sizes, ray_bundle
from goniotwin.twin.optics.fast.clipped_pupil import CLIPPED, TERMS, clip_fit, clip_grid, fill_clip
from goniotwin.twin.optics.fast.lobe_sums import add_values, gaussian_values, lambertian_values, lobe_sums
from goniotwin.twin.optics.fast.obstruction import FREE, HIDDEN, PARTLY, find_shadow, mirrors_near, visible_shares
from goniotwin.twin.optics.fast.ray_bundle import (
    END_U,
    END_V,
    PUPIL_U,
    PUPIL_V,
    TILE,
    TILE_ROWS,
    fill_arrivals,
    fill_ends,
    fill_view,
    hide_ends,
)
from goniotwin.twin.optics.fast.rays import PLACES, find_offsets, place_node
from goniotwin.twin.optics.fast.regular_component import HOLE_NODES, SLOPE_NODES, image_measures, light_shares, line_nodes
from goniotwin.twin.optics.geometry.coordinates import detector_rows, direction_table, fill_detector_rows
from goniotwin.twin.optics.geometry.instrument import (
    COMPONENTS,
    ELEMENTS,
    HALF_BLOCKING,
    HALF_MIRROR,
    HALF_SPOT,
    NOMINAL_DEG,
    Instrument,
    Reflectance,
)
from goniotwin.twin.optics.geometry.scene import SceneArrays, empty_scene, fill_detectors, fill_scene, mirror_angle_deg
from goniotwin.twin.optics.illumination.slit_image import (
    ALONG_U,
    Slit,
    SlitImage,
    empty_image,
    place_slit,
    relative_radiance,
    slit_of,
    weigh_rays,
)
from goniotwin.twin.optics.kernel import kernel, thread_count

Rule = tuple[Floats, Floats, Floats, int]
"""Nodes over the cone; over a side of the hole; over it where the cone is wide; rays where a mirror blocks some of the view."""
FINE_RULE: Rule = (cone_nodes(3), side_nodes(6), hole_nodes(8), 1024)
"""For fluxes: the accepted rays are exact to 0.3 %."""
COARSE_RULE: Rule = (cone_nodes(), side_nodes(), hole_nodes(4), 256)
"""For ratios, in which the error cancels: exact to 3 %."""
FINEST_RULE: Rule = (cone_nodes(3), side_nodes(12), hole_nodes(16), 1024)
"""For fluxes where the light ends within the hole: exact to 0.3 %, and to 0.5 % where 2 % of the light are left."""
CLIP_RULE: Rule = (cone_nodes(2), side_nodes(5), hole_nodes(8), 1024)
"""For fluxes of a beam that a mirror clips, where the hole is lit everywhere."""
TABLE_KINDS, PLAIN_KINDS = (TABLE, ANISOTROPIC), (GAUSSIAN, LAMBERTIAN)
GRID = clip_grid()
LIGHT_RAYS = 8192
"""Rays from pupil to hole for the mean of what is not even, of a regular component."""
HOLE, LINE = line_nodes(HOLE_NODES), side_nodes(SLOPE_NODES)
PIECE = 4096
"""Detectors of a pose that are computed together, and readings of one task: independent of the number of threads."""
WHITE = Scatterer(
    "ideal diffuser",
    tuple(
        Lobe(LAMBERTIAN, parameters(1.0 / math.pi), incident=incident, transmits=transmits)
        for incident in (1, -1)
        for transmits in (False, True)
    ),
)
"""Ideal diffuser that scatters equally to either side and from either side."""
Result = TypeVar("Result")


class Nodes(NamedTuple):
    """Nodes over `cone`, `side` and `hole`, and rays of the `bundle`: a `Rule` as an argument of the kernels."""

    cone: Floats
    side: Floats
    hole: Floats
    bundle: Floats


class Optics(NamedTuple):
    """Everything of an instrument but the deviations of a rig, as an argument of the kernels.

    `lengths` and `exit_pupil` of the instrument, `sizes` of the aperture, the illumination unit's `slit`; `nodes`, and
    `cut_nodes` where the light ends within the hole; the nodes' `places`, those over the hole (`image_hole`) and a slope
    (`image_line`) for an image of the pupil, and the rays from it (`image_rays`). `bundles` alone, without the seven rays;
    `wide` cones; `obstruction`. `scale` makes throughputs in m^2 sr of sums.
    """

    lengths: Floats
    exit_pupil: Floats
    sizes: Floats
    slit: Slit
    clip_grid: Floats
    clip_fit: Floats
    nodes: Nodes
    cut_nodes: Nodes
    clip_nodes: Nodes
    places: Floats
    image_hole: Floats
    image_line: Floats
    image_rays: Floats
    bundles: bool
    wide: bool
    obstruction: bool
    scale: float


class Spectra(NamedTuple):
    """Weights of the lobes and the mirrors' reflectance over the wavelengths, as an argument of the kernels.

    `weights` (lobes, w); `owners` (lobes,): number of each lobe's sample; `reflectances` (w, a) at the incidences `angles_deg`
    (a,).
    """

    weights: Floats
    owners: Ints
    reflectances: Floats
    angles_deg: Floats


class Block(NamedTuple):
    """Buffers of a block of detectors.

    Rows `w` of the moments, among them those of one `node` of each detector and its `points` of pupil and hole; `rays` of a
    bundle, `values` of a lobe, one `tile` of a bundle; `sums` by lobe, of all blocks, and `lanes` of a bundle's sums; the
    aperture's share that the seven rays have `taken`, and `status`.
    """

    w: Floats
    node: Floats
    points: Floats
    rays: Floats
    values: Floats
    tile: Floats
    sums: Floats
    lanes: Floats
    clip: Floats
    taken: Floats
    status: Ints


@kernel(nogil=True)
def score_scenes(
    optics: Optics, models: Models, spectra: Spectra, deviations: Floats, poses: Floats, starts: Ints, directions: Floats,
    first_rig: int, result: Floats, general: bool | None,
) -> bool:  # fmt: skip
    """Fill `result` (rigs, samples, w, detectors) with throughputs in m^2 sr, from `first_rig` on.

    `general` is True, or None for GAUSSIAN and LAMBERTIAN lobes, narrow cones and an even light: numba then leaves out the code
    for all others, which takes as long to compile as the rest; that of a beam which a mirror clips too. It leaves such scenes
    to a call with False, which fills these alone. Returns whether there are any of them.
    `deviations` (n, elements, 6); `poses` (p, 2): sigma and gamma, deg; the detectors of pose p are the rows of
    `directions` (detectors, 6) from starts[p] to starts[p + 1], see `detector_rows`.
    """
    lobes, scene, (edges, chords, hole) = models.heads.shape[0], empty_scene(), empty_image()
    most = 0
    for p in range(poses.shape[0]):
        most = max(most, starts[p + 1] - starts[p])
    w = np.empty(ROWS * BLOCK)
    block = Block(
        w, w[RAY : RAY + 7 * BLOCK].reshape(7, BLOCK), w[POINT : POINT + 4 * BLOCK].reshape(4, BLOCK), np.empty((7, 4 * TILE)),
        np.empty(4 * TILE), np.empty(TILE_ROWS * TILE),
        np.empty((lobes, most + BLOCK)), np.empty((lobes + 1, TILE)), np.empty((CLIPPED, TERMS)),
        np.empty(BLOCK), np.empty(BLOCK, np.int64),
    )  # fmt: skip
    centres, axes, lit = np.empty((most, 3)), np.empty((most, 3)), np.empty(most, np.int64)
    acting, mirrors = np.empty(lobes, np.int64), np.empty(spectra.weights.shape[1])
    skipped = False
    for rig in range(deviations.shape[0]):
        for p in range(poses.shape[0]):
            back = fill_scene(optics.lengths, optics.exit_pupil, deviations[rig], poses[p, 0], poses[p, 1], scene)
            clipped = scene.missed[0] + scene.missed[1] + scene.missed[2] > 0.0 and not optics.bundles
            if general is None:
                if clipped:
                    skipped = True
                    continue
            elif not (general or clipped):
                continue
            light = place_slit(optics.slit, scene.pupil, optics.lengths[HALF_SPOT], 0.0, edges, chords, hole)
            active, above, below = 0, False, False
            for k in range(lobes):
                if (models.heads[k, ABOVE] == 1) != back:
                    acting[active] = k
                    active += 1
                    if models.heads[k, TRANSMITS] == 1:
                        below = True
                    else:
                        above = True
            first, total = starts[p], starts[p + 1] - starts[p]
            for k in range(result.shape[1]):
                for j in range(mirrors.size):
                    for i in range(first, first + total):
                        result[first_rig + rig, k, j, i] = 0.0
            fill_detectors(
                optics.lengths, deviations[rig], scene.to_sample, scene.origin, directions[first : first + total], centres, axes
            )
            count = select_lit(centres, axes, total, above, below, lit)
            mirror_products(spectra, scene, mirrors)
            fitted = 0
            if general is not None and clipped and count > 0 and not optics.wide:
                half, spot = optics.lengths[HALF_MIRROR], optics.lengths[HALF_SPOT]
                fitted = CLIPPED if fill_clip(scene, half, spot, optics.clip_grid, optics.clip_fit, block.clip) else 0
            score_detectors(
                optics,
                models,
                scene,
                light,
                centres[:count],
                axes[:count],
                acting[:active],
                block,
                block.clip[:fitted],
                general,
            )
            for a in range(active):
                k = acting[a]
                for j in range(mirrors.size):
                    factor, row = spectra.weights[k, j] * mirrors[j], result[first_rig + rig, spectra.owners[k], j]
                    if count == total:
                        for i in range(count):
                            row[first + i] += factor * block.sums[k, i]
                    else:
                        for i in range(count):
                            row[first + lit[i]] += factor * block.sums[k, i]
    return skipped


@kernel()
def select_lit(centres: Floats, axes: Floats, total: int, above: bool, below: bool, lit: Ints) -> int:
    """Move the detectors above or below the sample's plane, or both, to the front; fill `lit` with their numbers.

    Returns their number: the others receive nothing.
    """
    count, all_lit = 0, True
    for k in range(total):
        all_lit = all_lit & (below if axes[k, 2] < 0.0 else above)
    if all_lit:
        for k in range(total):
            lit[k] = k
        return total
    for k in range(total):
        if below if axes[k, 2] < 0.0 else above:
            for c in range(3):
                centres[count, c], axes[count, c] = centres[k, c], axes[k, c]
            lit[count] = k
            count += 1
    return count


@kernel()
def mirror_products(spectra: Spectra, scene: SceneArrays, result: Floats) -> None:
    """Fill `result` (w,) with the product of the three mirrors' reflectances, linear between the angles of the table."""
    angles, last = spectra.angles_deg, spectra.angles_deg.size - 1
    for j in range(result.size):
        result[j] = 1.0
    for m in range(3):
        i, share = 0, 0.0
        if last > 0:
            angle = mirror_angle_deg(scene.pupil, scene.images, m)
            while i < last - 1 and angles[i + 1] <= angle:
                i += 1
            share = min(max((angle - angles[i]) / (angles[i + 1] - angles[i]), 0.0), 1.0)
        for j in range(result.size):
            low, high = spectra.reflectances[j, i], spectra.reflectances[j, min(i + 1, last)]
            result[j] *= low + share * (high - low)


@kernel()
def score_detectors(
    optics: Optics, models: Models, scene: SceneArrays, light: SlitImage, centres: Floats, axes: Floats, acting: Ints,
    block: Block, clip: Floats, general: bool | None,
) -> None:  # fmt: skip
    """Fill `block.sums` (lobes, at least n): throughputs by the lobes `acting` alone, mirrors without loss, of n detectors.

    Block by block within one call: each array of the arguments is counted as a reference, which for a call of every block was a
    tenth of all time.
    """
    nodes = optics.nodes if light.everywhere else optics.cut_nodes
    if clip.shape[0] > 0 and light.everywhere and nodes.cone.shape[0] > optics.clip_nodes.cone.shape[0]:
        nodes = optics.clip_nodes
    for start in range(0, axes.shape[0], BLOCK):
        end = min(start + BLOCK, axes.shape[0])
        count, kept, above, below = end - start, False, False, False
        for i in range(count):
            above, below = above or axes[start + i, 2] >= 0.0, below or axes[start + i, 2] < 0.0
        for i in range(count):
            block.taken[i], block.status[i] = 0.0, PARTLY
        for k in acting:
            for i in range(whole_lanes(count)):
                block.sums[k, start + i] = 0.0
            if general is not None:
                kept = kept or models.heads[k, KIND] in TABLE_KINDS
        if not optics.bundles:
            fill_offsets(optics, nodes, scene, light, centres[start:end], axes[start:end], block, clip, general)
            uneven, lanes = general is not None and not light.slit.even, whole_lanes(count)
            heads, params, w, node, values, sums = models.heads, models.params, block.w, block.node, block.values, block.sums
            places, pupil = optics.places, scene.pupil
            for j in range(places.shape[0]):
                place_node(w, count, pupil, places[j, 0], places[j, 1], uneven)
                if general is not None and uneven:
                    weigh_rays(light, block.points[:, :count], node[0, :count])
                for k in acting:
                    kind, transmits = heads[k, KIND], heads[k, TRANSMITS] == 1
                    if not (below if transmits else above):
                        continue
                    if kind == GAUSSIAN:
                        intensity, ratio = params[k, 2] == 1.0, params[k, 4]
                        gaussian_values(params[k, 0], params[k, 1], intensity, ratio, transmits, node, lanes, values)
                        add_values(values, 0, lanes, sums, k, start)
                    elif kind == LAMBERTIAN:
                        lambertian_values(params[k, 0], transmits, node, lanes, values)
                        add_values(values, 0, lanes, sums, k, start)
                    elif general is not None and kind not in TABLE_KINDS:
                        lobe_sums(models, k, node, 1, count, values, sums, k, start, general)
                # Tables have kinks, which seven rays do not resolve: their mean is taken over a bundle, times what the seven
                # rays take, as sample and etalon must have the same accepted rays.
                if kept:
                    for i in range(count):
                        block.taken[i] += node[0, i]
        for i in range(count):
            partly = block.status[i] == PARTLY
            if partly or (kept and block.status[i] == FREE):
                add_bundle(
                    optics, nodes.bundle, models, scene, light, centres[start + i], axes[start + i], acting, partly, i,
                    start + i, block, general,
                )  # fmt: skip
        for k in acting:
            for i in range(count):
                block.sums[k, start + i] *= optics.scale
            if general is not None and models.heads[k, KIND] == REGULAR:
                regular = block.sums[k, start:end]
                fill_regular(optics, nodes.bundle, models, scene, light, centres[start:end], axes[start:end], k, regular)


@kernel()
def fill_offsets(
    optics: Optics, nodes: Nodes, scene: SceneArrays, light: SlitImage, centres: Floats, axes: Floats, block: Block,
    clip: Floats, general: bool | None,
) -> None:  # fmt: skip
    """Fill `block.w` for the seven rays of n detectors, see `place_node`, and `block.status`.

    PARTLY means that seven are not enough, because a mirror blocks some of the accepted rays; the rest is filled in all the
    same.
    """
    count, w, status, near = axes.shape[0], block.w, block.status, np.zeros(3)
    for k in range(whole_lanes(count)):
        i = min(k, count - 1)
        w[k + PX], w[k + PY], w[k + PZ] = centres[i, 0], centres[i, 1], centres[i, 2]
        w[k + DX], w[k + DY], w[k + DZ] = axes[i, 0], axes[i, 1], axes[i, 2]
    fill_frames(w, count)
    if general is None:
        fill_apertures(w, count, nodes.cone, nodes.side, optics.sizes, light.chords, None)
    elif not optics.wide:
        fill_apertures(w, count, nodes.cone, nodes.side, optics.sizes, light.chords, clip)
    else:
        fill_wide_apertures(w, count, nodes.hole, optics.sizes, light.chords)
    find_offsets(w, count, scene.pupil)
    blocking = optics.lengths[HALF_BLOCKING]
    clipped = scene.missed[0] + scene.missed[1] + scene.missed[2] > 0.0 and clip.shape[0] == 0
    for k in range(count):
        status[k] = PARTLY if clipped else FREE
        if optics.obstruction and w[k + M] > 0.0:
            mirrors_near(scene.mirrors, blocking, centres[k], optics.sizes, near)
            if near[0] + near[1] + near[2] > 0.0:
                status[k] = max(status[k], find_shadow(scene.mirrors, near, blocking, centres[k], axes[k], optics.sizes))
        if status[k] == HIDDEN:
            w[k + M] = 0.0


@kernel()
def add_bundle(
    optics: Optics, bundle: Floats, models: Models, scene: SceneArrays, light: SlitImage, centre: Floats, d: Floats,
    acting: Ints, partly: bool, i: int, column_of_sums: int, block: Block, general: bool | None,
) -> None:  # fmt: skip
    """Fill a column of the sums, of detector i of the block, from a whole bundle; unless `partly` those of tables alone."""
    lengths, sizes, lanes, t, rays = optics.lengths, optics.sizes, block.lanes, block.tile, block.rays
    first_v, last_v = light.chords[ALONG_U, -1, 0], light.chords[ALONG_U, -1, 1]
    edges = light.edges[: 0 if light.everywhere else light.edges.shape[0]]
    view, near, whole = np.empty((4, 3)), np.zeros(3), models.heads.shape[0]
    for k in range(whole + 1):
        for lane in range(TILE):
            lanes[k, lane] = 0.0
    fill_view(centre, d, view)
    if optics.obstruction:
        mirrors_near(scene.mirrors, lengths[HALF_BLOCKING], centre, sizes, near)
    share = sizes[1] * sizes[1] / bundle.shape[1]
    for first in range(0, bundle.shape[1], TILE):
        count, column = min(TILE, bundle.shape[1] - first), 0
        for sign in (1.0, -1.0):
            for other in (1.0, -1.0):
                # An edge of the slit's image is elsewhere for another point of the pupil; else both have the same ends.
                if other > 0.0 or not light.everywhere:
                    fill_ends(view, bundle, first, count, sign, sizes, first_v, last_v, edges, other, t)
                    hide_ends(scene.mirrors, near, lengths[HALF_BLOCKING], count, t)
                fill_arrivals(scene, lengths[HALF_MIRROR], other, share, count, t, rays, column)
                if general is not None and not light.slit.even:
                    weigh_tile(light, other, count, t, rays, column)
                column += count
        for k in acting:
            on_its_side = (d[2] < 0.0) == (models.heads[k, TRANSMITS] == 1)
            if on_its_side and (partly or models.heads[k, KIND] in TABLE_KINDS):
                lobe_sums(models, k, rays, 4, count, block.values, lanes, k, 0, general)
        if not partly:
            for j in range(4):
                for lane in range(count):
                    lanes[whole, lane] += rays[0, j * count + lane]
    for k in range(whole + 1):
        for lane in range(1, TILE):
            lanes[k, 0] += lanes[k, lane]
    given = lanes[whole, 0]
    for k in acting:
        if partly:
            block.sums[k, column_of_sums] = lanes[k, 0]
        elif models.heads[k, KIND] in TABLE_KINDS:
            block.sums[k, column_of_sums] = block.taken[i] / given * lanes[k, 0] if given > 0.0 else 0.0


@kernel()
def weigh_tile(light: SlitImage, other: float, count: int, t: Floats, rays: Floats, column: int) -> None:
    """Multiply the weights of `count` `rays` from `column` on, those of the tile `t`, by the relative radiance."""
    for i in range(count):
        if rays[0, column + i] > 0.0:
            a, b = other * t[i + PUPIL_U], other * t[i + PUPIL_V]
            rays[0, column + i] *= relative_radiance(light, a, b, t[i + END_U], t[i + END_V])


@kernel()
def fill_regular(
    optics: Optics, bundle: Floats, models: Models, scene: SceneArrays, light: SlitImage, centres: Floats, axes: Floats, k: int,
    result: Floats,
) -> None:  # fmt: skip
    """Fill `result` (n,) with throughputs in m^2 sr by the REGULAR lobe k."""
    transmits, pupil = models.heads[k, TRANSMITS] == 1, scene.pupil
    image_measures(
        centres, axes, optics.sizes, pupil, light.chords, transmits, optics.image_hole, optics.image_line, result
    )  # fmt: skip
    if scene.missed[0] + scene.missed[1] + scene.missed[2] > 0.0 or not light.slit.even:
        half = optics.lengths[HALF_MIRROR]
        light_shares(centres, axes, optics.sizes, scene, half, light, transmits, optics.image_rays, result)
    _, params, sig, _, _, _, table = model_arrays(models, k)
    length = math.sqrt(pupil[0, 0] ** 2 + pupil[0, 1] ** 2 + pupil[0, 2] ** 2)
    share = regular_share(params, sig, table, pupil[0, 0] / length, pupil[0, 1] / length, pupil[0, 2] / length)
    for i in range(result.size):
        if result[i] != 0.0:
            result[i] *= 1e-6 * share
            if optics.obstruction:
                one, blocking = slice(i, i + 1), optics.lengths[HALF_BLOCKING]
                result[i] *= visible_shares(centres[one], axes[one], bundle, optics.sizes, scene.mirrors, blocking)[0]


@dataclass(frozen=True, eq=False)
class Pose:
    """Detectors at one position of mirror unit and sample unit: `directions` in the rig's frame, as in `Scene.detectors`."""

    sigma_deg: float
    directions: npt.ArrayLike
    gamma_deg: float = 0.0


@dataclass(frozen=True, eq=False)
class Poses:
    """Many poses with as many detectors each, as arrays: a list of `Pose` costs 10 microseconds more for each of them.

    `sigma_deg` (p,); `directions` (p, n, 3), or (p, n, 6) with axes, as in `Scene.detectors`; `gamma_deg` (p,) or one for all.
    Such as the poses of a plan that are ahead: `Scenes(instrument, Poses(...), [sample]).throughputs()[0, 0, 0].reshape(p, n)`.
    """

    sigma_deg: npt.ArrayLike
    directions: npt.ArrayLike
    gamma_deg: npt.ArrayLike = 0.0


class Scenes:
    """Poses, samples and wavelengths of one instrument, for any number of rigs: the same instrument with other deviations.

    Deviations are an array (rigs, elements, 6), see `deviation_array`; they replace the instrument's own, which are used where
    none are given. Results (rigs, samples, w, detectors) have the detectors of all poses one after the other, see `pieces`;
    without wavelengths w is 1. With `Poses` of p poses, result.reshape(rigs, samples, w, p, -1) has those of each in the last
    axis. Every reading is independent of all others: results are bit-identical for any number of threads, and for any other
    rigs and poses beside it. `rays` as in `twin.optics.throughput`.

    Raises ValueError for a wrong shape, a direction of length zero, angles that are not finite, a number of rays that is not a
    multiple of 4, a sample with a spectrum without wavelengths, or a sensor that is not a simple detector, a disc with an
    acceptance cone: the forward estimator alone traces such a sensor.
    """

    def __init__(
        self,
        instrument: Instrument,
        poses: Sequence[Pose] | Poses,
        samples: Sequence[Scatterer],
        wavelengths_nm: npt.ArrayLike | None = None,
        rays: int | None = None,
        *,
        etalon: Scatterer = WHITE,
    ) -> None:
        self._instrument, self._rays = instrument.simplified(), rays
        self._samples, self._etalon = tuple(samples), etalon
        wavelengths = None if wavelengths_nm is None else np.atleast_1d(np.asarray(wavelengths_nm, dtype=np.float64))
        self._wavelengths_nm = wavelengths
        packed = _pack_arrays(poses) if isinstance(poses, Poses) else _pack_poses(poses)
        self._poses, self._starts, self._directions, self.pieces = packed

    @property
    def detectors(self) -> int:
        """Number of detectors of all poses."""
        return len(self._directions)

    def throughputs(self, deviations: Floats | None = None) -> Floats:
        """Throughputs (rigs, samples, w, detectors), m^2 sr: see `twin.optics.throughput`."""
        return self._compute(self._samples, deviations, ratios=False)

    def ratios(self, deviations: Floats | None = None) -> Floats:
        """Throughputs of the samples over those of the etalon (rigs, samples, w, detectors); NaN where it gives no signal.

        Fewer points than for a throughput represent the aperture, to 3 % instead of 0.3 %, the same for sample and etalon.
        """
        flux = self._compute((*self._samples, self._etalon), deviations, ratios=True)
        sample, etalon = flux[:, :-1], flux[:, -1:]
        etalon[etalon <= 0.0] = np.nan
        return np.asarray(sample / etalon)

    def map(self, function: Callable[[Floats], Result], blocks: Iterable[Floats], *, ratios: bool = False) -> Iterator[Result]:
        """Results of `function`, in order, of throughputs or `ratios` of each block of deviations.

        Blocks are computed on all threads, and few are in memory at a time. `function` is called in these threads.
        """
        compute = self.ratios if ratios else self.throughputs

        def run(block: Floats) -> Result:
            with _one_thread():
                return function(compute(block))

        threads = thread_count()
        with ThreadPoolExecutor(threads) as pool:
            waiting: list[Future[Result]] = []
            for block in blocks:
                waiting.append(pool.submit(run, block))
                if len(waiting) > 2 * threads:
                    yield waiting.pop(0).result()
            for each in waiting:
                yield each.result()

    def _compute(self, samples: tuple[Scatterer, ...], deviations: Floats | None, *, ratios: bool) -> Floats:
        instrument = self._instrument
        rigs = instrument.deviation_rows[None] if deviations is None else _check_deviations(deviations)
        optics, (models, owners, plain) = _optics(instrument, self._rays, ratios), _pack_samples(samples)
        spectra = _spectra(instrument, samples, owners, self._wavelengths_nm)
        result = np.empty((len(rigs), len(samples), spectra.weights.shape[1], self.detectors))
        tasks = list(_tasks(len(rigs), self._starts))
        general = None if plain and optics.slit.even and not optics.wide else True

        def run(task: tuple[int, int, int, int]) -> None:
            first, last, begin, end = task
            some = rigs[first:last], self._poses[begin:end], self._starts[begin : end + 1]
            if score_scenes(optics, models, spectra, *some, self._directions, first, result, general):
                score_scenes(optics, models, spectra, *some, self._directions, first, result, False)

        threads = 1 if _ALONE.threads else min(thread_count(), len(tasks))
        waiting = iter(tasks)

        def work() -> None:
            for task in waiting:
                run(task)

        if threads > 1:
            # Plain threads: the kernels hold no lock. numba's own threads would add seconds of compilation, and one of its
            # threading layers ends the process if two threads call at the same time. This thread is one of them.
            with ThreadPoolExecutor(threads - 1) as pool:
                others = [pool.submit(work) for _ in range(threads - 1)]
                work()
                for each in others:
                    each.result()
        else:
            work()
        return result


class _Alone(threading.local):
    """Whether this thread is one of those of `Scenes.map`, which start no others."""

    threads = False


_ALONE = _Alone()


@contextmanager
def _one_thread() -> Iterator[None]:
    _ALONE.threads = True
    try:
        yield
    finally:
        _ALONE.threads = False


def _pack_poses(poses: Sequence[Pose]) -> tuple[Floats, Ints, Floats, tuple[slice, ...]]:
    """Angles (p, 2), starts (p + 1,) and `detector_rows` (n, 6) of pieces of poses, and the range of each pose's detectors."""
    angles, starts, given, pieces = [], [0], [], []
    for pose in poses:
        if not (math.isfinite(pose.sigma_deg) and math.isfinite(pose.gamma_deg)):
            raise ValueError(f"sigma_deg is {pose.sigma_deg!r}, gamma_deg {pose.gamma_deg!r}: give both in degrees")
        given.append(direction_table(pose.directions))
        first, last = starts[-1], starts[-1] + len(given[-1])
        for start in range(first, last, PIECE):
            angles.append((pose.sigma_deg, pose.gamma_deg))
            starts.append(min(start + PIECE, last))
        pieces.append(slice(first, last))
    directions = np.empty((starts[-1], 6))
    for rows, piece in zip(given, pieces, strict=True):
        fill_detector_rows(rows, directions[piece])
    return np.array(angles, dtype=np.float64).reshape(-1, 2), np.array(starts), directions, tuple(pieces)


def _pack_arrays(poses: Poses) -> tuple[Floats, Ints, Floats, tuple[slice, ...]]:
    """`_pack_poses` of arrays."""
    directions = np.asarray(poses.directions, dtype=np.float64)
    if directions.ndim != 3 or directions.shape[2] not in (3, 6):
        raise ValueError(f"directions has the shape {directions.shape}: give (poses, detectors, 3)")
    count, each = directions.shape[:2]
    angles = np.empty((count, 2))
    for column, name in enumerate(("sigma_deg", "gamma_deg")):
        given = np.asarray(getattr(poses, name), dtype=np.float64)
        if given.shape not in ((), (count,)):
            raise ValueError(f"{name} has the shape {given.shape}: give ({count},), an angle for each pose")
        angles[:, column] = given
    if not np.all(np.isfinite(angles)):
        raise ValueError("sigma_deg or gamma_deg has an entry that is not finite: give both in degrees")
    pieces = tuple(slice(first, first + each) for first in range(0, count * each, each)) if each else (slice(0, 0),) * count
    steps = range(0, each, PIECE) if each > PIECE else (0,)
    starts = np.append((np.arange(count)[:, None] * each + np.array(steps)).ravel(), count * each)
    return np.repeat(angles, len(steps), axis=0), starts, detector_rows(directions.reshape(-1, directions.shape[2])), pieces


def _tasks(rigs: int, starts: Ints) -> Iterator[tuple[int, int, int, int]]:
    """Ranges of rigs and of poses of at most about PIECE readings each."""
    begin, poses = 0, len(starts) - 1
    if rigs * int(starts[-1]) <= PIECE:
        if poses:
            yield 0, rigs, 0, poses
        return
    while begin < poses:
        end = max(begin + 1, int(np.searchsorted(starts, starts[begin] + PIECE, side="right")) - 1)
        step = max(1, PIECE // max(1, int(starts[end] - starts[begin])))
        for first in range(0, rigs, step):
            yield first, min(first + step, rigs), begin, end
        begin = end


def _check_deviations(deviations: Floats) -> Floats:
    rigs = np.require(deviations, np.float64, ["C", "W"])  # the kernel is compiled for arrays that can be written to
    if rigs.ndim != 3 or rigs.shape[1:] != (len(ELEMENTS), len(COMPONENTS)):
        raise ValueError(f"deviations has the shape {rigs.shape}: give (rigs, {len(ELEMENTS)}, {len(COMPONENTS)})")
    if not np.all(np.isfinite(rigs)):
        raise ValueError("deviations has an entry that is not finite: give angles in degrees and shifts in mm")
    return rigs


@lru_cache(maxsize=16)
def _optics(instrument: Instrument, rays: int | None, ratios: bool) -> Optics:
    sizes = aperture_sizes(instrument)
    sine, seen_sr = float(sizes[2]), math.pi * sizes[2] ** 2
    nodes, cut_nodes, clip_nodes = (
        Nodes(cone, side, hole, ray_bundle(partly if rays is None else rays, sine))
        for cone, side, hole, partly in ((COARSE_RULE, FINE_RULE, CLIP_RULE) if ratios else (FINE_RULE, FINEST_RULE, CLIP_RULE))
    )
    return Optics(
        instrument.lengths, instrument.exit_pupil, sizes, slit_of(instrument), GRID, clip_fit(GRID), nodes, cut_nodes,
        clip_nodes, PLACES, HOLE, LINE,
        ray_bundle(LIGHT_RAYS, sine), rays is not None, bool(sine * instrument.arc_radius_mm > WIDE * sizes[0]),
        instrument.obstruction, float(seen_sr * math.pi * instrument.pupil_radius_mm**2 * 1e-6),
    )  # fmt: skip


@lru_cache(maxsize=16)
def _pack_samples(samples: tuple[Scatterer, ...]) -> tuple[Models, Ints, bool]:
    """Models of all lobes, the number of each one's sample, and whether all are of PLAIN_KINDS."""
    owners = np.repeat(np.arange(len(samples)), [len(each.lobes) for each in samples])
    lobes = [lobe for each in samples for lobe in each.lobes]
    return pack_models(lobes), owners, all(lobe.kind in PLAIN_KINDS for lobe in lobes)


def _spectra(instrument: Instrument, samples: tuple[Scatterer, ...], owners: Ints, wavelengths_nm: Floats | None) -> Spectra:
    mirrors = instrument.mirror_reflectance
    if wavelengths_nm is None:
        weights = np.concatenate([each.weights(None) for each in samples])[:, None]
    else:
        weights = np.concatenate([each.weights(wavelengths_nm) for each in samples])
    if not isinstance(mirrors, Reflectance):
        return Spectra(weights, owners, np.full((weights.shape[1], 1), mirrors), np.array([NOMINAL_DEG]))
    wavelengths = [None] if wavelengths_nm is None else wavelengths_nm.tolist()
    table = np.array([mirrors.at(each, mirrors.angle_deg) for each in wavelengths])
    return Spectra(weights, owners, table, np.array(mirrors.angle_deg))
