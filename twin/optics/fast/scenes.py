"""Scenes: poses, deviations, samples, wavelengths and detectors in one compiled call.

A scene is the instrument with one set of deviations at one pose. The geometry comes first and is the same for every sample:
seven rays for each detector (twin.optics.fast.rays), or a bundle (twin.optics.fast.ray_bundle) where a mirror blocks some of
what it takes. Each lobe is then summed over these rays. Sample and etalon have the same rays, and so have all wavelengths
(optics.md, section 6).
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
from goniotwin.twin.optics.bsdf.kinds import ANISOTROPIC, LAMBERTIAN, REGULAR, TABLE
from goniotwin.twin.optics.bsdf.lobes import Lobe, parameters
from goniotwin.twin.optics.bsdf.models import regular_share
from goniotwin.twin.optics.bsdf.packed_lobes import ABOVE, KIND, TRANSMITS, Models, model_arrays, pack_models
from goniotwin.twin.optics.bsdf.scatterer import Scatterer
from goniotwin.twin.optics.fast.aperture import (
    WIDE,
    cone_nodes,
    fill_apertures,
    fill_wide_apertures,
    hole_nodes,
    place_detectors,
    side_nodes,
)
from goniotwin.twin.optics.fast.bundle import aperture_sizes, ray_bundle
from goniotwin.twin.optics.fast.clipped_pupil import fill_clip
from goniotwin.twin.optics.fast.detector_block import (
    HOLE_U,
    HOLE_V,
    LANES,
    ONE,
    PUPIL_A,
    PUPIL_B,
    VIEW,
    WEIGHT,
    Block,
    Z,
    empty_block,
    whole_lanes,
)
from goniotwin.twin.optics.fast.lobe_sums import add_lobe
from goniotwin.twin.optics.fast.obstruction import FREE, HIDDEN, PARTLY, find_shadow, mirrors_near, visible_shares
from goniotwin.twin.optics.fast.ray_bundle import fill_arrivals, fill_ends, hide_ends
from goniotwin.twin.optics.fast.rays import PLACES, fill_covariance, fill_factors, fill_shifts, fill_slopes, place_node
from goniotwin.twin.optics.fast.regular_component import image_measures, light_shares
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
LIT, CUT, CLIP = range(3)
"""Rules of `Nodes`: where the hole is lit everywhere, where the light ends within it, and where a mirror clips the beam."""
TABLE_KINDS = (TABLE, ANISOTROPIC)
LIGHT_RAYS = 8192
"""Rays from pupil to hole for the mean of what is not even, of a regular component."""
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
    """Nodes of the three rules LIT, CUT and CLIP, as an argument of the kernels.

    The first counts[rule] = (cone, side, hole, quarter) of `cone`, `side` and `hole` (3, most, ...), and of `bundle` (7, most).
    """

    counts: Ints
    cone: Floats
    side: Floats
    hole: Floats
    bundle: Floats


class Optics(NamedTuple):
    """Everything of an instrument but the deviations of a rig, as an argument of the kernels.

    `lengths` and `exit_pupil` of the instrument, `sizes` of the aperture, the illumination unit's `slit`, the `nodes`, and the
    rays from an image of the pupil (`image_rays`). `bundles` alone, without the seven rays; `wide` cones; `obstruction`.
    `scale` makes throughputs in m^2 sr of sums.
    """

    lengths: Floats
    exit_pupil: Floats
    sizes: Floats
    slit: Slit
    nodes: Nodes
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


@kernel(nogil=True)
def score_scenes(
    block: Block,
    optics: Optics,
    models: Models,
    spectra: Spectra,
    deviations: Floats,
    poses: Floats,
    starts: Ints,
    directions: Floats,
    first_rig: int,
    result: Floats,
) -> None:
    """Fill `result` (rigs, samples, w, detectors) with throughputs in m^2 sr, from `first_rig` on.

    `deviations` (n, elements, 6); `poses` (p, 2): sigma and gamma, deg; the detectors of pose p are the rows of
    `directions` (detectors, 6) from starts[p] to starts[p + 1], see `detector_rows`.
    """
    lobes, scene, (edges, chords, hole) = models.heads.shape[0], empty_scene(), empty_image()
    most = 0
    for p in range(poses.shape[0]):
        most = max(most, starts[p + 1] - starts[p])
    centres, views, lit = np.empty((most, 3)), np.empty((most, 3)), np.empty(most, np.int64)
    acting, mirrors, sums = np.empty(lobes, np.int64), np.empty(spectra.weights.shape[1]), np.empty((lobes, most))
    for rig in range(deviations.shape[0]):
        for p in range(poses.shape[0]):
            back = fill_scene(optics.lengths, optics.exit_pupil, deviations[rig], poses[p, 0], poses[p, 1], scene)
            light = place_slit(optics.slit, scene.pupil, optics.lengths[HALF_SPOT], 0.0, edges, chords, hole)
            active, above, below = select_lobes(models, back, acting)
            first, total = starts[p], starts[p + 1] - starts[p]
            own = directions[first : first + total]
            fill_detectors(optics.lengths, deviations[rig], scene.to_sample, scene.origin, own, centres, views)
            count = select_lit(centres, views, total, above, below, lit)
            score_detectors(block, optics, models, scene, light, centres[:count], views[:count], acting[:active], sums)
            mirror_products(spectra, scene, mirrors)
            add_wavelengths(
                spectra, mirrors, acting[:active], sums, lit[:count], result[first_rig + rig, :, :, first : first + total]
            )


@kernel()
def select_lobes(models: Models, back: bool, acting: Ints) -> tuple[int, bool, bool]:
    """Fill `acting` with the lobes for light from that side; their number, and whether some scatter above, and below."""
    active, above, below = 0, False, False
    for k in range(acting.size):
        if (models.heads[k, ABOVE] == 1) != back:
            acting[active] = k
            active += 1
            below, above = below or models.heads[k, TRANSMITS] == 1, above or models.heads[k, TRANSMITS] != 1
    return active, above, below


@kernel()
def select_lit(centres: Floats, views: Floats, total: int, above: bool, below: bool, lit: Ints) -> int:
    """Move the detectors above or below the sample's plane, or both, to the front; fill `lit` with their numbers.

    Returns their number: the others receive nothing.
    """
    count = 0
    for k in range(total):
        if below if views[k, 2] < 0.0 else above:
            for c in range(3):
                centres[count, c], views[count, c] = centres[k, c], views[k, c]
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
def add_wavelengths(spectra: Spectra, mirrors: Floats, acting: Ints, sums: Floats, lit: Ints, result: Floats) -> None:
    """Fill `result` (samples, w, detectors) with the sums of the lobes `acting` for the detectors `lit`, else 0."""
    for k in range(result.shape[0]):
        for j in range(mirrors.size):
            for i in range(result.shape[2]):
                result[k, j, i] = 0.0
    for k in acting:
        for j in range(mirrors.size):
            factor, owner = spectra.weights[k, j] * mirrors[j], spectra.owners[k]
            for i in range(lit.size):
                result[owner, j, lit[i]] += factor * sums[k, i]


@kernel()
def score_detectors(
    block: Block,
    optics: Optics,
    models: Models,
    scene: SceneArrays,
    light: SlitImage,
    centres: Floats,
    views: Floats,
    acting: Ints,
    sums: Floats,
) -> None:
    """Fill `sums` (lobes, at least n): throughputs by the lobes `acting` alone, mirrors without loss, of n detectors."""
    nodes, counts, clipped = optics.nodes, optics.nodes.counts, scene.missed[0] + scene.missed[1] + scene.missed[2] > 0.0
    rule, fitted = LIT if light.everywhere else CUT, False
    if clipped and not (optics.bundles or optics.wide):
        fitted = fill_clip(scene, optics.lengths[HALF_MIRROR], optics.lengths[HALF_SPOT], block.clip)
        if fitted and light.everywhere and counts[LIT, 0] > counts[CLIP, 0]:
            rule = CLIP
    quarter, tables, status = counts[rule, 3], False, np.empty(LANES, np.int64)
    for k in acting:
        tables = tables or models.heads[k, KIND] in TABLE_KINDS
    for start in range(0, views.shape[0], LANES):
        end = min(start + LANES, views.shape[0])
        for k in acting:
            for i in range(start, end):
                sums[k, i] = 0.0
        place_detectors(block, centres[start:end], views[start:end])
        if optics.bundles:
            for i in range(end - start):
                block.taken[i], status[i] = 0.0, PARTLY
        else:
            lanes = whole_lanes(end - start)
            if optics.wide:
                fill_wide_apertures(block, lanes, nodes.hole[rule, : counts[rule, 2]], optics.sizes, light.chords)
            else:
                cone, side = nodes.cone[rule, : counts[rule, 0]], nodes.side[rule, : counts[rule, 1]]
                fill_apertures(block, lanes, cone, side, optics.sizes, light.chords, fitted)
            fill_covariance(block, lanes)
            fill_slopes(block, lanes, scene.pupil)
            fill_shifts(block, lanes)
            fill_factors(block, lanes)
            find_shadows(block, optics, scene, clipped and not fitted, end - start, status)
            add_seven_rays(block, models, scene, light, acting, end - start, sums, start)
        for i in range(end - start):
            if status[i] == PARTLY or (tables and status[i] == FREE):
                add_bundle(block, i, optics, quarter, models, scene, light, acting, status[i] == PARTLY, sums, start + i)
    for k in acting:
        for i in range(views.shape[0]):
            sums[k, i] *= optics.scale
        if models.heads[k, KIND] == REGULAR:
            fill_regular(block, optics, quarter, models, scene, light, centres, views, k, sums[k, : views.shape[0]])


@kernel()
def find_shadows(block: Block, optics: Optics, scene: SceneArrays, clipped: bool, count: int, status: Ints) -> None:
    """Fill `status`, and set the moments of hidden detectors to 0.

    PARTLY means that seven rays are not enough: a mirror blocks some of the accepted ones, or the beam is `clipped`.
    """
    near, half = np.zeros(3), optics.lengths[HALF_BLOCKING]
    for k in range(count):
        status[k] = PARTLY if clipped else FREE
        lit = optics.obstruction and block.moments[ONE, ONE, k] > 0.0
        if lit and mirrors_near(block, k, scene.mirrors, half, optics.sizes, near):
            status[k] = max(status[k], find_shadow(block, k, scene.mirrors, near, half, optics.sizes))
        if status[k] == HIDDEN:
            block.moments[ONE, ONE, k] = 0.0


@kernel()
def add_seven_rays(
    block: Block, models: Models, scene: SceneArrays, light: SlitImage, acting: Ints, count: int, sums: Floats, start: int
) -> None:
    """Add the seven rays of the detectors in `block` to `sums` from `start` on, for all lobes but tables.

    Tables have kinks, which seven rays do not resolve: their mean is taken over a bundle, times what the seven rays take
    (`block.taken`), as sample and etalon must have the same accepted rays.
    """
    above, below = False, False
    for i in range(count):
        block.taken[i] = 0.0
        above, below = above or block.axes[VIEW, Z, i] >= 0.0, below or block.axes[VIEW, Z, i] < 0.0
    for j in range(PLACES.shape[0]):
        place_node(block, whole_lanes(count), scene.pupil, PLACES[j, 0], PLACES[j, 1])
        if not light.slit.even:
            weigh_rays(block, light, count)
        for k in acting:
            kind, seen = models.heads[k, KIND], below if models.heads[k, TRANSMITS] == 1 else above
            if seen and kind != REGULAR and kind not in TABLE_KINDS:
                add_lobe(models, k, block, sums[k, start : start + count])
        for i in range(count):
            block.taken[i] += block.ray[WEIGHT, i]


@kernel()
def weigh_rays(block: Block, light: SlitImage, count: int) -> None:
    """Multiply the weights of `count` rays in `block` by the relative radiance along them."""
    for i in range(count):
        if block.ray[WEIGHT, i] > 0.0:
            a, b, u, v = block.point[PUPIL_A, i], block.point[PUPIL_B, i], block.point[HOLE_U, i], block.point[HOLE_V, i]
            block.ray[WEIGHT, i] *= relative_radiance(light, a, b, u, v)


@kernel()
def add_bundle(
    block: Block,
    i: int,
    optics: Optics,
    quarter: int,
    models: Models,
    scene: SceneArrays,
    light: SlitImage,
    acting: Ints,
    partly: bool,
    sums: Floats,
    column: int,
) -> None:
    """Fill a column of `sums`, of detector i of the block, from a whole bundle; unless `partly` those of tables alone."""
    first_v, last_v, share = light.chords[ALONG_U, -1, 0], light.chords[ALONG_U, -1, 1], optics.sizes[1] ** 2 / quarter
    edges = light.edges[: 0 if light.everywhere else light.edges.shape[0]]
    lanes, near, blocking, given = np.zeros((models.heads.shape[0], LANES)), np.zeros(3), optics.lengths[HALF_BLOCKING], 0.0
    below = block.axes[VIEW, Z, i] < 0.0
    if optics.obstruction:
        mirrors_near(block, i, scene.mirrors, blocking, optics.sizes, near)
    for first in range(0, quarter, LANES):
        count = min(LANES, quarter - first)
        for sign in (1.0, -1.0):
            for other in (1.0, -1.0):
                # An edge of the slit's image is elsewhere for another point of the pupil; else both have the same ends.
                if other > 0.0 or not light.everywhere:
                    fill_ends(block, i, optics.nodes.bundle, first, count, sign, optics.sizes, first_v, last_v, edges, other)
                    hide_ends(block, scene.mirrors, near, blocking, count)
                fill_arrivals(block, scene, optics.lengths[HALF_MIRROR], other, share, count)
                if not light.slit.even:
                    weigh_rays(block, light, count)
                for lane in range(count):
                    given += block.ray[WEIGHT, lane]
                for k in acting:
                    if below == (models.heads[k, TRANSMITS] == 1) and (partly or models.heads[k, KIND] in TABLE_KINDS):
                        add_lobe(models, k, block, lanes[k, :count])
    for k in acting:
        if partly or models.heads[k, KIND] in TABLE_KINDS:
            total = 0.0
            for lane in range(LANES):
                total += lanes[k, lane]
            sums[k, column] = total if partly else block.taken[i] / given * total if given > 0.0 else 0.0


@kernel()
def fill_regular(
    block: Block,
    optics: Optics,
    quarter: int,
    models: Models,
    scene: SceneArrays,
    light: SlitImage,
    centres: Floats,
    views: Floats,
    k: int,
    result: Floats,
) -> None:
    """Fill `result` (n,) with throughputs in m^2 sr by the REGULAR lobe k."""
    transmits, pupil = models.heads[k, TRANSMITS] == 1, scene.pupil
    image_measures(centres, views, optics.sizes, pupil, light.chords, transmits, result)
    if scene.missed[0] + scene.missed[1] + scene.missed[2] > 0.0 or not light.slit.even:
        half = optics.lengths[HALF_MIRROR]
        light_shares(centres, views, optics.sizes, scene, half, light, transmits, optics.image_rays, result)
    model = model_arrays(models, k)
    length = math.sqrt(pupil[0, 0] ** 2 + pupil[0, 1] ** 2 + pupil[0, 2] ** 2)
    share = regular_share(
        model.params, model.sigma_deg, model.table, pupil[0, 0] / length, pupil[0, 1] / length, pupil[0, 2] / length
    )
    for i in range(result.size):
        if result[i] != 0.0:
            result[i] *= 1e-6 * share
            if optics.obstruction:
                one, blocking, bundle = slice(i, i + 1), optics.lengths[HALF_BLOCKING], optics.nodes.bundle
                seen = visible_shares(block, centres[one], views[one], bundle, quarter, optics.sizes, scene.mirrors, blocking)
                result[i] *= seen[0]


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
        optics, (models, owners) = _optics(instrument, self._rays, ratios), _pack_samples(samples)
        spectra = _spectra(instrument, samples, owners, self._wavelengths_nm)
        result = np.empty((len(rigs), len(samples), spectra.weights.shape[1], self.detectors))
        tasks = list(_tasks(len(rigs), self._starts))
        threads = 1 if _ALONE.threads else min(thread_count(), len(tasks))
        waiting = iter(tasks)

        def work() -> None:
            block = empty_block()
            for first, last, begin, end in waiting:
                some = rigs[first:last], self._poses[begin:end], self._starts[begin : end + 1]
                score_scenes(block, optics, models, spectra, *some, self._directions, first, result)

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
    rules = (COARSE_RULE, FINE_RULE, CLIP_RULE) if ratios else (FINE_RULE, FINEST_RULE, CLIP_RULE)
    return Optics(
        instrument.lengths,
        instrument.exit_pupil,
        sizes,
        slit_of(instrument),
        _nodes(rules, rays, sine),
        ray_bundle(LIGHT_RAYS, sine),
        rays is not None,
        bool(sine * instrument.arc_radius_mm > WIDE * sizes[0]),
        instrument.obstruction,
        float(seen_sr * math.pi * instrument.pupil_radius_mm**2 * 1e-6),
    )


def _nodes(rules: tuple[Rule, ...], rays: int | None, sine: float) -> Nodes:
    """Nodes of the rules; `rays` in place of theirs. A bundle begins as every longer one."""
    numbers = [partly if rays is None else rays for *_, partly in rules]
    counts = np.array([(len(c), len(s), len(h), each // 4) for (c, s, h, _), each in zip(rules, numbers, strict=True)])
    cone, side, hole = (
        np.zeros((len(rules), most, width)) for most, width in zip(counts.max(axis=0)[:3], (3, 2, 2), strict=True)
    )
    for k, rule in enumerate(rules):
        for room, nodes in zip((cone, side, hole), rule[:3], strict=True):
            room[k, : len(nodes)] = nodes
    return Nodes(counts, cone, side, hole, ray_bundle(max(numbers), sine))


@lru_cache(maxsize=16)
def _pack_samples(samples: tuple[Scatterer, ...]) -> tuple[Models, Ints]:
    """Models of all lobes, and the number of each one's sample."""
    owners = np.repeat(np.arange(len(samples)), [len(each.lobes) for each in samples])
    lobes = [lobe for each in samples for lobe in each.lobes]
    return pack_models(lobes), owners


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
