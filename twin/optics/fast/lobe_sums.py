"""Sums of each lobe over the rays of the detectors: the core of the fast estimator.

Geometry comes first and is the same for every sample: the rays of each detector (twin.optics.fast.rays). Each lobe is then
summed over these rays.

The values of a Gaussian lobe are `analytic_value` of twin.optics.bsdf.models as one plain loop, which LLVM vectorises. The
angle follows from the chord between lobe axis and observer, which does not cancel near the axis. Arcsine and exponential are
minimax polynomials with errors of 1e-12 or less.
"""

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.bsdf.lobes import Lobe
from goniotwin.twin.optics.bsdf.models import ANISOTROPIC, GAUSSIAN, LAMBERTIAN, REGULAR, TABLE, bsdf, regular_share
from goniotwin.twin.optics.fast.aperture import WIDE, aperture_sizes, cone_nodes, hole_nodes, side_nodes
from goniotwin.twin.optics.fast.obstruction import FREE, PARTLY, visible_shares
from goniotwin.twin.optics.fast.ray_bundle import cone_slopes, ray_bundle
from goniotwin.twin.optics.fast.rays import HEXAGON, NODES, fill_nodes, fill_rays
from goniotwin.twin.optics.fast.regular_component import HOLE_NODES, SLOPE_NODES, image_measures, light_shares, line_nodes
from goniotwin.twin.optics.geometry.instrument import Instrument, Reflectance
from goniotwin.twin.optics.geometry.scene import Scene, scene_at
from goniotwin.twin.optics.illumination.slit_image import ALONG_U, slit_image, weigh_rays
from goniotwin.twin.optics.kernel import kernel

LOG2_E = 1.0 / math.log(2.0)
FARTHEST = -1000.0
"""Least exponent of a power of two: smaller ones are replaced by it (1e-301), which avoids denormal numbers."""
BIAS, MANTISSA_BITS = np.int64(1023), np.int64(52)
A0, A1, A2, A3, A4 = 0.999999999999943, 0.16666666671090202, 0.07499999428106169, 0.044643143181678384, 0.030374710191438888
A5, A6, A7, A8, A9 = 0.0224765358692889, 0.0164461237675982, 0.018744129431705087, -0.0030822990518015654, 0.03214532705777029
E0, E1, E2, E3, E4 = 0.9999999999997623, 0.6931471805465146, 0.24022650698880404, 0.05550410939341342, 0.00961812854285181
E5, E6, E7, E8 = 0.001333345206273817, 0.00015403851761890063, 1.5309737273786115e-05, 1.3175854503915213e-06
CHUNK = 8192
Rule = tuple[Floats, Floats, Floats, int]
"""Nodes over the cone; over a side of the hole; over it where the cone is wide; rays where a mirror blocks some of the view."""
FINE_RULE: Rule = (cone_nodes(3), side_nodes(6), hole_nodes(8), 1024)
"""For fluxes: the accepted rays are exact to 0.3 %."""
COARSE_RULE: Rule = (cone_nodes(), side_nodes(), hole_nodes(4), 256)
"""For ratios, in which the error cancels: exact to 3 %."""
FINEST_RULE: Rule = (cone_nodes(3), side_nodes(12), hole_nodes(16), 1024)
"""For fluxes where the light ends within the hole: exact to 0.3 %, and to 0.5 % where 2 % of the light are left."""
TABLE_KINDS = (TABLE, ANISOTROPIC)
LIGHT_RAYS = 8192
"""Rays from pupil to hole for the mean of what is not even, of a regular component."""
HOLE, LINE = line_nodes(HOLE_NODES), side_nodes(SLOPE_NODES)


@kernel(inline="always")
def arcsine(x: float, square: float) -> float:
    """asin(x) for x from 0 to 0.5, with the square of x given too."""
    low = A0 + square * (A1 + square * (A2 + square * (A3 + square * A4)))
    high = A5 + square * (A6 + square * (A7 + square * (A8 + square * A9)))
    return x * (low + square**5 * high)


@kernel(inline="always")
def power_of_two(y: float) -> float:
    """2^y for y from -1000 to 1000."""
    whole = np.int32(np.floor(y + 0.5))
    x = y - whole
    power = np.int64((np.int64(whole) + BIAS) << MANTISSA_BITS).view(np.float64)
    return power * (E0 + x * (E1 + x * (E2 + x * (E3 + x * (E4 + x * (E5 + x * (E6 + x * (E7 + x * E8))))))))


@kernel(nogil=True, fastmath={"contract"})
def gaussian_values(
    peak: float, exponent: float, intensity: bool, ratio: float, transmits: bool, rays: Floats, values: Floats
) -> None:
    """Fill `values` (n,) with weight times value of the first n `rays` (7, at least n), as in `lobe_sums`."""
    sign, inverse, scale = -1.0 if transmits else 1.0, 1.0 / ratio, -exponent * LOG2_E
    for i in range(values.size):
        lx, ly, lz = rays[1, i] * inverse, rays[2, i] * inverse, rays[3, i]
        lit = lz > 0.0
        if ratio != 1.0:
            lz = math.sqrt(max(0.0, 1.0 - lx * lx - ly * ly))
        dx, dy, dz = rays[4, i], rays[5, i], sign * rays[6, i]
        x, y, z = dx + lx, dy + ly, dz - lz
        half2 = 0.25 * (x * x + y * y + z * z)
        half = math.sqrt(half2)
        steep = half > 0.5
        square = 0.5 * (1.0 - min(half, 1.0)) if steep else half2
        root = math.sqrt(square) if steep else half
        angle = 2.0 * arcsine(root, square)
        theta = math.pi - 2.0 * angle if steep else angle
        value = rays[0, i] * peak * power_of_two(max(scale * theta * theta, FARTHEST))
        value = value / dz if intensity else value
        values[i] = value if lit & (lz > 0.0) & (dz > 0.0) else 0.0


@kernel(nogil=True)
def lobe_sums(
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, psi: Floats, table: Floats,
    transmits: bool, rays: Floats, each: int, result: Floats,
) -> None:  # fmt: skip
    """Fill `result` (n,): sums of weight times value over `each` rays of n detectors.

    `rays` (7, n each) has the first ray of every detector, then the second of every one, and so on.
    """
    count = result.size
    result[:] = 0.0
    if kind == GAUSSIAN:
        values = np.empty(each * count)
        gaussian_values(params[0], params[1], params[2] == 1.0, params[4], transmits, rays, values)
        for i in range(each):
            for k in range(count):
                result[k] += values[i * count + k]
    elif kind == LAMBERTIAN:
        for i in range(each):
            for k in range(count):
                lit = (rays[6, i * count + k] < 0.0) == transmits
                result[k] += rays[0, i * count + k] * params[0] if lit else 0.0
    else:
        for i in range(each * count):
            if (rays[6, i] < 0.0) == transmits and rays[0, i] > 0.0:
                result[i % count] += rays[0, i] * bsdf(
                    kind, params, sig, ph, th, psi, table,
                    rays[1, i], rays[2, i], rays[3, i], rays[4, i], rays[5, i], abs(rays[6, i]),
                )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Pose:
    """Detectors at one position of mirror unit and sample unit: `directions` (n, 3) in the rig's frame."""

    sigma_deg: float
    directions: npt.ArrayLike
    gamma_deg: float = 0.0


@dataclass(frozen=True, eq=False)
class LobeSums:
    """`lobes` (lobes, n): throughputs in m^2 sr with perfectly reflecting mirrors, in a scene."""

    lobes: Floats
    scene: Scene

    def mirrors(self, instrument: Instrument, wavelength_nm: float | None) -> float:
        """Product of the three mirrors' reflectances."""
        if not isinstance(instrument.mirror_reflectance, Reflectance):
            return instrument.mirror_reflectance**3
        return float(instrument.mirror_reflectance.at(wavelength_nm, self.scene.mirror_angles_deg).prod())


def lobe_throughputs(
    instrument: Instrument,
    poses: Sequence[Pose],
    lobes: Sequence[Lobe],
    rays: int | None = None,
    *,
    ratios: bool = False,
) -> list[LobeSums]:
    """Throughput of each lobe alone, for each pose: see `throughput`. All lobes have the same rays.

    With `ratios` the results are for ratios of lobes only: fewer points represent the aperture, to 3 % instead of 0.3 %, and
    the same for all lobes. Raises ValueError for a sensor that is not a simple detector: see `Instrument.simplified`.
    """
    instrument = instrument.simplified()
    results, tasks = [], []
    rules = (COARSE_RULE, FINE_RULE) if ratios else (FINE_RULE, FINEST_RULE)
    for pose in poses:
        scene = scene_at(instrument, pose.sigma_deg, pose.gamma_deg)
        centres, axes = scene.detectors(instrument, pose.directions)
        active = [k for k, lobe in enumerate(lobes) if lobe.incident == scene.incident]
        result = np.zeros((len(lobes), axes.shape[0]))
        results.append(LobeSums(result, scene))
        score = _Score(instrument, scene, [lobes[k] for k in active], rays, rules)
        for first in range(0, axes.shape[0] if active else 0, CHUNK):
            piece = slice(first, first + CHUNK)
            tasks.append((score, centres[piece], axes[piece], result, active, piece))

    def run(task: tuple[_Score, Floats, Floats, Floats, list[int], slice]) -> None:
        score, centres, axes, result, active, piece = task
        result[active, piece] = score(centres, axes)

    if len(tasks) > 1:
        # Plain threads: the kernels hold no lock. numba's own threads would add seconds of compilation, and one of its
        # threading layers ends the process if two threads call at the same time.
        with ThreadPoolExecutor(numba.get_num_threads()) as pool:
            list(pool.map(run, tasks))
    else:
        for task in tasks:
            run(task)
    return results


class _Score:
    """Throughputs of the detectors of one scene, for several lobes."""

    def __init__(
        self, instrument: Instrument, scene: Scene, lobes: Sequence[Lobe], rays: int | None, rules: tuple[Rule, Rule]
    ) -> None:
        """`rules` are that for a hole that is lit everywhere, and that for another one."""
        self._scene, self._lobes, self._rays = scene, lobes, rays
        self._light = slit_image(instrument, scene)
        self._cone, self._side, self._hole_nodes, partly = rules[0 if self._light.everywhere else 1]
        self._sizes = aperture_sizes(instrument)
        self._wide = bool(self._sizes[2] * instrument.arc_radius_mm > WIDE * self._sizes[0])
        self._half, self._blocking = 0.5 * instrument.mirror_side_mm, 0.5 * instrument.blocking_side_mm
        self._obstruction = instrument.obstruction
        self._bundle = ray_bundle(partly if rays is None else rays)
        self._slopes = cone_slopes(self._bundle, self._sizes)
        seen_sr = math.pi * self._sizes[2] ** 2
        self._scale = seen_sr * math.pi * instrument.pupil_radius_mm**2 * 1e-6

    def __call__(self, centres: Floats, axes: Floats) -> Floats:
        """Throughputs (lobes, n), m^2 sr."""
        sides = {lobe.transmits for lobe in self._lobes}
        if len(sides) == 1:  # detectors on the other side receive nothing: skip them
            lit = (axes[:, 2] < 0.0) == sides.pop()
            if not lit.all():
                sums = np.zeros((len(self._lobes), axes.shape[0]))
                sums[:, lit] = self._sum_lobes(centres[lit], axes[lit])
                return sums
        return self._sum_lobes(centres, axes)

    def _sum_lobes(self, centres: Floats, axes: Floats) -> Floats:
        count, scene, light = axes.shape[0], self._scene, self._light
        sums = np.zeros((len(self._lobes), count))
        if self._rays is None:
            rays, status = np.empty((7, NODES * count)), np.empty(count, dtype=np.int64)
            points = np.empty((4, 0 if light.even else NODES * count))
            fill_nodes(
                centres, axes, self._sizes, self._wide, self._cone, self._side, self._hole_nodes, HEXAGON, scene.pupil,
                light.chords, scene.mirrors, self._blocking, self._obstruction, scene.clipped, rays, points, status,
            )  # fmt: skip
            if not light.even:
                weigh_rays(light, points, rays[0])
            for lobe, row in zip(self._lobes, sums, strict=True):
                if lobe.kind not in TABLE_KINDS:
                    lobe_sums(*lobe.kernel_arguments, lobe.transmits, rays, NODES, row)
            rest = np.flatnonzero(status == PARTLY)
            tabulated = [k for k, lobe in enumerate(self._lobes) if lobe.kind in TABLE_KINDS]
            if tabulated:
                taken = rays[0].reshape(NODES, count).sum(axis=0)
                self._add_bundles(centres, axes, np.flatnonzero(status == FREE), tabulated, sums, taken)
        else:
            rest = np.arange(count)
        self._add_bundles(centres, axes, rest, range(len(self._lobes)), sums)
        sums *= self._scale
        for lobe, row in zip(self._lobes, sums, strict=True):
            if lobe.kind == REGULAR:
                image_measures(centres, axes, self._sizes, scene.pupil, light.chords, lobe.transmits, HOLE, LINE, row)
                if scene.clipped or not light.even:
                    light_shares(
                        centres, axes, self._sizes, scene.pupil, scene.images, self._half, scene.clipped, light,
                        lobe.transmits, ray_bundle(LIGHT_RAYS), row,
                    )  # fmt: skip
                _, params, sig, *_, table = lobe.kernel_arguments
                row *= 1e-6 * regular_share(params, sig, table, *scene.towards_light) * self._visible_shares(centres, axes, row)
        return sums

    def _add_bundles(
        self, centres: Floats, axes: Floats, rest: Ints, lobes: Iterable[int], sums: Floats,
        taken: Floats | None = None,
    ) -> None:  # fmt: skip
        """Fill sums[lobes, rest] from a whole bundle each; with `taken` (n,) as means over the bundle, times `taken`.

        Tables have kinks, which seven rays do not resolve; but sample and etalon must have the same accepted rays.
        """
        scene, light, rays, one = self._scene, self._light, np.empty((7, self._bundle.shape[0])), np.empty(1)
        points, edges = np.empty((4, self._bundle.shape[0])), light.edges[:0] if light.everywhere else light.edges
        first, last = (float(each) for each in light.chords[ALONG_U, -1])
        for k in rest:
            fill_rays(
                centres[k], axes[k], self._bundle, self._slopes, self._sizes, scene.pupil, first, last, edges,
                scene.mirrors, scene.images, self._half, self._blocking, self._obstruction, scene.clipped, rays, points,
            )  # fmt: skip
            if not light.even:
                weigh_rays(light, points, rays[0])
            whole = rays[0].sum()
            share = 1.0 if taken is None else taken[k] / whole if whole > 0.0 else 0.0
            for each in lobes:
                lobe = self._lobes[each]
                lobe_sums(*lobe.kernel_arguments, lobe.transmits, rays, rays.shape[1], one)
                sums[each, k] = share * one[0]

    def _visible_shares(self, centres: Floats, axes: Floats, row: Floats) -> Floats:
        """Share of each detector's rays that no mirror blocks; only for those that receive light."""
        shares = np.ones_like(row)
        lit = np.flatnonzero(row) if self._obstruction else np.empty(0, dtype=np.int64)
        if lit.size:
            shares[lit] = visible_shares(
                centres[lit], axes[lit], self._bundle, self._sizes, self._scene.mirrors, self._blocking
            )
        return shares
