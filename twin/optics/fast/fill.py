"""The rays of many detectors: seven nodes each, a whole bundle where a mirror hides some of them, none where it hides all."""

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.aperture import apertures, detector_frames
from goniotwin.twin.optics.fast.detector_block import BLOCK, DX, PX, ROWS, M
from goniotwin.twin.optics.fast.nodes import NODES, place_nodes
from goniotwin.twin.optics.fast.obstruction import FREE, HIDDEN, PARTLY, hidden, mirrors_near, shadow
from goniotwin.twin.optics.fast.ray_bundle import arrival, detector_ray, view
from goniotwin.twin.optics.fast.wide_aperture import wide_apertures
from goniotwin.twin.optics.kernel import kernel


@kernel(nogil=True)
def fill_nodes(
    centres: Floats, axes: Floats, sizes: Floats, wide: bool, cone: Floats, side: Floats, hole: Floats, hexagon: Floats,
    pupil: Floats, mirrors: Floats, blocking: float, obstruction: bool, clipped: bool, rays: Floats, status: np.ndarray,
) -> None:  # fmt: skip
    """Fills `rays` (7, 7 n) with the nodes of n detectors, see `place_nodes`, and `status` (n,).

    PARTLY says that seven nodes are not enough, since a mirror cuts into what the detector takes; they are there all the same.
    """
    count, near, w = centres.shape[0], np.zeros(3), np.empty(ROWS * BLOCK)
    for first in range(0, count, BLOCK):
        last = min(first + BLOCK, count)
        for k in range(first, last):
            for c in range(3):
                w[k - first + PX + c * BLOCK], w[k - first + DX + c * BLOCK] = centres[k, c], axes[k, c]
        detector_frames(w, last - first)
        if wide:
            wide_apertures(w, last - first, hole, sizes)
        else:
            apertures(w, last - first, cone, side, sizes)
        place_nodes(w, last - first, pupil, hexagon, rays, first, count)
        for k in range(first, last):
            status[k] = PARTLY if clipped else FREE
            if obstruction and w[k - first + M] > 0.0:
                mirrors_near(mirrors, blocking, centres[k], sizes, near)
                if near[0] + near[1] + near[2] > 0.0:
                    status[k] = max(status[k], shadow(mirrors, near, blocking, centres[k], axes[k], sizes))
            if status[k] == HIDDEN:
                for j in range(NODES):
                    rays[0, j * count + k] = 0.0


@kernel(nogil=True)
def fill_rays(
    centre: Floats, d: Floats, bundle: Floats, slopes: Floats, sizes: Floats, pupil: Floats, mirrors: Floats, images: Floats,
    half: float, blocking: float, obstruction: bool, clipped: bool, rays: Floats,
) -> None:  # fmt: skip
    """Fills `rays` (7, bundle) with a whole bundle of one detector, those that a mirror cuts weighing nothing.

    `half` is a mirror's half side, mm, and `blocking` that with its mount.
    """
    axes, near = np.zeros((4, 3)), np.zeros(3)
    view(centre, d, axes)
    if obstruction:
        mirrors_near(mirrors, blocking, centre, sizes, near)
    crowded = near[0] + near[1] + near[2] > 0.0
    share = 4.0 * sizes[1] * sizes[1] / bundle.shape[0]
    for j in range(bundle.shape[0]):
        weight, px, py, wx, wy, wz, length = detector_ray(axes, bundle, slopes, j, sizes)
        if weight > 0.0 and crowded and hidden(mirrors, near, blocking, length, px, py, wx, wy, wz):
            weight = 0.0
        lx, ly, lz, gain = arrival(px, py, bundle[j, 4], bundle[j, 5], pupil, images, half, clipped)
        rays[0, j] = share * weight * gain
        rays[1, j], rays[2, j], rays[3, j] = lx, ly, lz
        rays[4, j], rays[5, j], rays[6, j] = wx, wy, wz
