"""All lobes of a sample as one set of arrays, so that one compiled kernel takes any number of them, from either side."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.bsdf.lobes import ALBEDO_SIGMA_DEG, KernelArguments, Lobe, freeze
from goniotwin.twin.optics.bsdf.models import from_canonical, to_canonical
from goniotwin.twin.optics.bsdf.sampling import scatter
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.montecarlo import uniform

KIND, ABOVE, TRANSMITS, FIRST = range(4)
"""Columns of `Models.heads`; from FIRST on the sizes of sigma, phi, theta, psi, the table's first axis and the cells' three."""


class Models(NamedTuple):
    """Packed models of lobes: `heads` (lobes, 12), see above; ABOVE is 1 for lobes that take light from z > 0 of the frame.

    `params` (lobes, 8), and all arrays of all lobes, `flat`; these start at `starts` (lobes, 6). `params` and `flat` are
    read-only as a lobe's own arrays are, so that the kernels of one lobe are compiled once for both.
    """

    heads: Ints
    params: Floats
    flat: Floats
    starts: Ints


class Lobes(NamedTuple):
    """Packed lobes for drawing: their models, `weights` (lobes,), and `albedos` (lobes, 6) at `sines` of incidence (6,)."""

    models: Models
    weights: Floats
    albedos: Floats
    sines: Floats


NO_CELLS = freeze([[[0.0]]])


def pack_models(lobes: Sequence[Lobe], incident: int = 1, *, cells: bool = False) -> Models:
    """Pack the models of lobes, for light from the side `incident` above (z > 0 of the frame).

    `cells` are for drawing alone: without them a table of one zero takes their place.
    """
    heads, starts, flat, used = [], [], [], 0  # an array ends where the next one starts
    for lobe in lobes:
        kind, _, *arrays = lobe.kernel_arguments
        arrays.append(lobe.cells if cells else NO_CELLS)
        sizes = [each.size for each in arrays[:4]] + [arrays[4].shape[0], *arrays[5].shape]
        heads.append([kind, int(lobe.incident == incident), int(lobe.transmits), *sizes])
        begins = used + np.cumsum([0, *(each.size for each in arrays)])
        starts.append(begins[:-1])
        used = int(begins[-1])
        flat += [each.ravel() for each in arrays]
    return Models(
        np.array(heads, dtype=np.int64),
        freeze([lobe.params for lobe in lobes]),
        freeze(np.concatenate(flat)),
        np.array(starts, dtype=np.int64),
    )


def pack_lobes(lobes: tuple[Lobe, ...], weights: Floats, incident: int) -> Lobes:
    """Pack lobes and their weights, for light from the side `incident` above (z > 0 of the scene's frame)."""
    return Lobes(
        pack_models(lobes, incident, cells=True),
        np.array(weights, dtype=np.float64),
        np.array([lobe.albedos for lobe in lobes]),
        np.sin(np.radians(ALBEDO_SIGMA_DEG)),
    )


@kernel()
def model_arrays(models: Models, k: int) -> KernelArguments:
    """Arguments of `bsdf` for lobe k."""
    heads, starts, flat = models.heads, models.starts, models.flat
    sigmas, phis, thetas = heads[k, FIRST], heads[k, FIRST + 1], heads[k, FIRST + 2]
    sig, ph = flat[starts[k, 0] : starts[k, 0] + sigmas], flat[starts[k, 1] : starts[k, 1] + phis]
    th, psi = flat[starts[k, 2] : starts[k, 2] + thetas], flat[starts[k, 3] : starts[k, 3] + heads[k, FIRST + 3]]
    table = flat[starts[k, 4] : starts[k, 5]].reshape(heads[k, FIRST + 4], sigmas, phis, thetas)
    return KernelArguments(
        heads[k, KIND],
        models.params[k],
        sig,
        ph,
        th,
        psi,
        table,
    )


@kernel()
def cells_of(models: Models, k: int) -> Floats:
    """The cells of lobe k, which `scatter` takes after the arguments of `bsdf`."""
    heads, start = models.heads, models.starts[k, 5]
    size = heads[k, FIRST + 5] * heads[k, FIRST + 6] * heads[k, FIRST + 7]
    return models.flat[start : start + size].reshape(heads[k, FIRST + 5], heads[k, FIRST + 6], heads[k, FIRST + 7])


@kernel()
def lobe_share(lobes: Lobes, k: int, above: bool, sine: float) -> float:
    """Relative probability of lobe k: its weight times its approximate albedo, for light from above or from below."""
    if (lobes.models.heads[k, ABOVE] == 1) != above:
        return 0.0
    here, total, last = 0.0, 0.0, lobes.sines.size - 1
    for i in range(last + 1):
        total += lobes.albedos[k, i]
    if sine >= lobes.sines[last]:
        here = lobes.albedos[k, last]
    else:
        i = 0
        while lobes.sines[i + 1] <= sine:
            i += 1
        a = (sine - lobes.sines[i]) / (lobes.sines[i + 1] - lobes.sines[i])
        here = (1.0 - a) * lobes.albedos[k, i] + a * lobes.albedos[k, i + 1]
    return lobes.weights[k] * max(here, 0.05 * total / (last + 1))  # type: ignore[no-any-return]


@kernel()
def scatter_at_sample(
    lobes: Lobes, wx: float, wy: float, wz: float, key: np.uint64, counter: int
) -> tuple[float, float, float, float]:
    """Scattered direction, in the scene's frame, of light along w, and the factor on its weight; 0 where nothing is scattered.

    One lobe is drawn, by `lobe_share`, with the numbers `counter` to `counter` + 3 of the path; the factor is divided by its
    probability.
    """
    above = wz < 0.0
    sine, count, total = np.sqrt(wx * wx + wy * wy), lobes.weights.size, 0.0
    for k in range(count):
        total += lobe_share(lobes, k, above, sine)
    if total == 0.0:
        return 0.0, 0.0, 1.0, 0.0
    rest, which, share = uniform(key, counter) * total, -1, 0.0
    for k in range(count):
        probability = lobe_share(lobes, k, above, sine)
        if probability > 0.0:
            which, share = k, probability
        rest -= probability
        if rest < 0.0:
            break
    transmits, side = lobes.models.heads[which, TRANSMITS] == 1, 1 if above else -1
    (lx, ly, lz), _ = to_canonical(side, transmits, -wx, -wy, -wz, 0.0, 0.0, 0.0)
    model = model_arrays(lobes.models, which)
    dx, dy, dz, factor = scatter(
        model.kind,
        model.params,
        model.sigma_deg,
        model.phi_deg,
        model.theta_deg,
        model.psi_deg,
        model.table,
        cells_of(lobes.models, which),
        lx,
        ly,
        lz,
        uniform(key, counter + 1),
        uniform(key, counter + 2),
        uniform(key, counter + 3),
    )
    dx, dy, dz = from_canonical(side, transmits, dx, dy, dz)
    return dx, dy, dz, factor * lobes.weights[which] * total / share
