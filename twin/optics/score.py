"""The sums of the fast estimator: lobes over the rays of detectors.

Geometry comes first, and is the same for every sample: the rays of each detector, few or many (twin.optics.fill). Then each
lobe is summed over them.
"""

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.aperture import aperture_sizes, cone_nodes, side_nodes
from goniotwin.twin.optics.bsdf import ANISOTROPIC, GAUSSIAN, LAMBERTIAN, REGULAR, TABLE, bsdf, regular_share
from goniotwin.twin.optics.bundle import cone, ray_bundle
from goniotwin.twin.optics.fill import fill_nodes, fill_rays
from goniotwin.twin.optics.gaussian_rays import gaussian_values
from goniotwin.twin.optics.instrument import Instrument
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.lobes import Lobe
from goniotwin.twin.optics.nodes import HEXAGON, NODES
from goniotwin.twin.optics.obstruction import FREE, PARTLY, visible
from goniotwin.twin.optics.reflectance import Reflectance
from goniotwin.twin.optics.regular import HOLE_NODES, SLOPE_NODES, image_measures, line_nodes
from goniotwin.twin.optics.scene import Scene, scene_at
from goniotwin.twin.optics.wide_aperture import WIDE, hole_nodes

CHUNK = 8192
Rule = tuple[Floats, Floats, Floats, int]
"""Nodes over the cone, over a side of the hole, and over it where the cone is wide; rays where a mirror cuts into the view."""
FINE: Rule = (cone_nodes(3), side_nodes(6), hole_nodes(8), 1024)
"""For fluxes: what the aperture takes is exact to 0.3 %."""
COARSE: Rule = (cone_nodes(), side_nodes(), hole_nodes(4), 256)
"""For ratios, in which it cancels: exact to 3 %."""
TABULATED = (TABLE, ANISOTROPIC)
HOLE, LINE = line_nodes(HOLE_NODES), side_nodes(SLOPE_NODES)


@kernel(nogil=True)
def lobe_sums(
    kind: int, params: Floats, sig: Floats, ph: Floats, th: Floats, psi: Floats, table: Floats,
    transmits: bool, rays: Floats, each: int, result: Floats,
) -> None:  # fmt: skip
    """Fills `result` (n,): sums of weight times value over `each` rays of n detectors.

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
    """Detectors that are asked at one place of mirror unit and sample unit: `directions` (n, 3) in the rig's frame."""

    sigma_deg: float
    directions: npt.ArrayLike
    gamma_deg: float = 0.0


@dataclass(frozen=True, eq=False)
class LobeSums:
    """`lobes` (lobes, n): throughputs in m^2 sr with mirrors that reflect everything, in a scene."""

    lobes: Floats
    scene: Scene

    def mirrors(self, instrument: Instrument, wavelength_nm: float | None) -> float:
        """Share of the light that the three of them pass on."""
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
    """Throughput of each lobe alone, a pose each: see `throughput`. All lobes have the same rays.

    With `ratios` only ratios of lobes are wanted: the aperture is told by fewer points, to 3 % instead of 0.3 %, and the
    same for all. Raises ValueError for a sensor that is no simple detector: see `Instrument.simplified`.
    """
    instrument = instrument.simplified()
    results, tasks = [], []
    for pose in poses:
        scene = scene_at(instrument, pose.sigma_deg, pose.gamma_deg)
        centres, axes = scene.detectors(instrument, pose.directions)
        active = [k for k, lobe in enumerate(lobes) if lobe.incident == scene.incident]
        result = np.zeros((len(lobes), axes.shape[0]))
        results.append(LobeSums(result, scene))
        score = _Score(instrument, scene, [lobes[k] for k in active], rays, COARSE if ratios else FINE)
        for first in range(0, axes.shape[0] if active else 0, CHUNK):
            piece = slice(first, first + CHUNK)
            tasks.append((score, centres[piece], axes[piece], result, active, piece))

    def run(task: tuple[_Score, Floats, Floats, Floats, list[int], slice]) -> None:
        score, centres, axes, result, active, piece = task
        result[active, piece] = score(centres, axes)

    if len(tasks) > 1:
        # Plain threads, for the kernels hold no lock: numba's own would add seconds of compilation, and one of its
        # threading layers ends the process when two threads call at once.
        with ThreadPoolExecutor(numba.get_num_threads()) as pool:
            list(pool.map(run, tasks))
    else:
        for task in tasks:
            run(task)
    return results


class _Score:
    """Scores detectors of one scene with lobes."""

    def __init__(self, instrument: Instrument, scene: Scene, lobes: Sequence[Lobe], rays: int | None, rule: Rule) -> None:
        self._scene, self._lobes, self._rays = scene, lobes, rays
        self._cone, self._side, self._hole_nodes, partly = rule
        self._sizes = aperture_sizes(instrument)
        self._wide = bool(self._sizes[2] * instrument.arc_radius_mm > WIDE * self._sizes[0])
        self._half, self._blocking = 0.5 * instrument.mirror_side_mm, 0.5 * instrument.blocking_side_mm
        self._obstruction = instrument.obstruction
        self._bundle = ray_bundle(partly if rays is None else rays)
        self._slopes = cone(self._bundle, self._sizes)
        seen_sr = math.pi * self._sizes[2] ** 2
        self._scale = seen_sr * math.pi * instrument.pupil_radius_mm**2 * 1e-6

    def __call__(self, centres: Floats, axes: Floats) -> Floats:
        """Throughputs (lobes, n), m^2 sr."""
        sides = {lobe.transmits for lobe in self._lobes}
        if len(sides) == 1:  # detectors on the other side get nothing, and are not asked
            there = (axes[:, 2] < 0.0) == sides.pop()
            if not there.all():
                sums = np.zeros((len(self._lobes), axes.shape[0]))
                sums[:, there] = self._scored(centres[there], axes[there])
                return sums
        return self._scored(centres, axes)

    def _scored(self, centres: Floats, axes: Floats) -> Floats:
        count, scene = axes.shape[0], self._scene
        sums = np.zeros((len(self._lobes), count))
        if self._rays is None:
            rays, status = np.empty((7, NODES * count)), np.empty(count, dtype=np.int64)
            fill_nodes(
                centres, axes, self._sizes, self._wide, self._cone, self._side, self._hole_nodes, HEXAGON, scene.pupil,
                scene.mirrors, self._blocking, self._obstruction, scene.clipped, rays, status,
            )  # fmt: skip
            for lobe, row in zip(self._lobes, sums, strict=True):
                if lobe.kind not in TABULATED:
                    lobe_sums(*lobe.kernel_arguments, lobe.transmits, rays, NODES, row)
            rest = np.flatnonzero(status == PARTLY)
            tabulated = [k for k, lobe in enumerate(self._lobes) if lobe.kind in TABULATED]
            if tabulated:
                taken = rays[0].reshape(NODES, count).sum(axis=0)
                self._with_bundles(centres, axes, np.flatnonzero(status == FREE), tabulated, sums, taken)
        else:
            rest = np.arange(count)
        self._with_bundles(centres, axes, rest, range(len(self._lobes)), sums)
        sums *= self._scale
        for lobe, row in zip(self._lobes, sums, strict=True):
            if lobe.kind == REGULAR:
                image_measures(centres, axes, self._sizes, scene.pupil, lobe.transmits, HOLE, LINE, row)
                _, params, sig, *_, table = lobe.kernel_arguments
                row *= 1e-6 * regular_share(params, sig, table, *scene.towards_light) * self._seen(centres, axes, row)
        return sums

    def _with_bundles(
        self, centres: Floats, axes: Floats, rest: Ints, lobes: Iterable[int], sums: Floats,
        taken: Floats | None = None,
    ) -> None:  # fmt: skip
        """Fills sums[lobes, rest] by a whole bundle each; with `taken` (n,) as means over it, times what was taken.

        Tables have kinks, of which seven rays know nothing; but sample and etalon must agree on what the aperture takes.
        """
        scene, rays, one = self._scene, np.empty((7, self._bundle.shape[0])), np.empty(1)
        for k in rest:
            fill_rays(
                centres[k], axes[k], self._bundle, self._slopes, self._sizes, scene.pupil, scene.mirrors, scene.images,
                self._half, self._blocking, self._obstruction, scene.clipped, rays,
            )  # fmt: skip
            whole = rays[0].sum()
            share = 1.0 if taken is None else taken[k] / whole if whole > 0.0 else 0.0
            for each in lobes:
                lobe = self._lobes[each]
                lobe_sums(*lobe.kernel_arguments, lobe.transmits, rays, rays.shape[1], one)
                sums[each, k] = share * one[0]

    def _seen(self, centres: Floats, axes: Floats, row: Floats) -> Floats:
        """Share of each detector's rays that no mirror cuts; only of those that get any."""
        seen = np.ones_like(row)
        lit = np.flatnonzero(row) if self._obstruction else np.empty(0, dtype=np.int64)
        if lit.size:
            seen[lit] = visible(centres[lit], axes[lit], self._bundle, self._sizes, self._scene.mirrors, self._blocking)
        return seen
