"""Holes of a table: nodes where nothing was measured, how they are filled, and which share of the light is in them.

A table needs a number at every node. By the name of the way:

- hold: between known nodes along theta linear, beyond them the nearest one; so a lobe whose peak was hidden becomes a stump;
- neighbour: the shape that the nearest other sigma has there, about its specular direction, at the height of the hole's rim;
- fit: at the peak a Gaussian or a wide-tailed lobe (1 + (theta / width)^2)^-2, whichever is nearer to the values around the
  hole, through the rim; elsewhere, between known nodes, a Gaussian through both; beyond the last of them as hold;
- refuse: an error for a hole within the measured polar angles; beyond the last of these as hold.

Whatever the way, the uncertainty of a filled value is at least the value itself: nothing is known of it.
"""

import math

import numpy as np

from goniotwin.app.formats.fills import FILLS as FILLS
from goniotwin.app.formats.fills import Fill as Fill
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import TOLERANCE_DEG, zenith_and_azimuth

FEWEST = 4
"""Values around a peak that a lobe is fitted to."""
ABOUT_FILL: dict[Fill, tuple[str, ...]] = {
    "hold": (
        "interpolated along theta, or have the value of the nearest, or, in a row without any, the mean of the other rows;",
    ),
    "neighbour": (
        "filled with the shape of the nearest other sigma about its specular direction, at the height of the gap's rim;",
        "where no sigma has one, interpolated along theta, or with the value of the nearest;",
    ),
    "fit": (
        "filled, at a peak, by the Gaussian or the lobe with wide tails that is fitted to the values around the gap,",
        "between known values by a Gaussian through both, and beyond the last ones with the value of the nearest;",
    ),
}
ABOUT_FILL["refuse"] = ABOUT_FILL["hold"]


def fill_holes(theta_deg: Floats, sigma_deg: Floats, values: Floats, known: Flags, fill: Fill) -> Floats:
    """The values [channel, psi, sigma, phi, theta], filled where they are not `known`; given are those of the way "hold"."""
    filled: Floats = values.copy()
    if fill in ("hold", "refuse"):
        return filled
    for c, p, s in np.argwhere(~known.all(axis=(3, 4))).tolist():
        if fill == "fit":
            filled[c, p, s] = _fitted(theta_deg, values[c, p, s], known[c, p, s])
        else:
            order = np.argsort(np.abs(sigma_deg - sigma_deg[s]), kind="stable")
            filled[c, p, s] = _of_neighbours(values[c, p, order], known[c, p, order])
    return filled


def _of_neighbours(values: Floats, known: Flags) -> Floats:
    """The first cut (phi, theta) with holes filled from the others, the nearest first."""
    filled, missing = values[0].copy(), ~known[0]
    for other, there in zip(values[1:], known[1:], strict=True):
        usable = missing & there
        if not usable.any():
            continue
        rim = _around(usable) & known[0] & there
        own, others = float(values[0][rim].sum()), float(other[rim].sum())
        filled[usable] = other[usable] * (own / others if own > 0.0 and others > 0.0 else 1.0)
        missing &= ~usable
    result: Floats = filled
    return result


def _around(marked: Flags) -> Flags:
    """Nodes beside those that are marked, along phi or theta."""
    near = np.zeros_like(marked)
    near[:, 1:] |= marked[:, :-1]
    near[:, :-1] |= marked[:, 1:]
    near[1:] |= marked[:-1]
    near[:-1] |= marked[1:]
    return np.asarray(near & ~marked)


def _fitted(theta_deg: Floats, values: Floats, known: Flags) -> Floats:
    """A cut (phi, theta) with its peak fitted, and Gaussians between known nodes."""
    filled, square = values.copy(), theta_deg**2
    for row, there in zip(filled, known, strict=True):
        inner = ~there
        inner[: int(np.argmax(there))] = False
        inner[theta_deg.size - int(np.argmax(there[::-1])) :] = False
        positive = there & (row > 0.0)
        if inner.any() and positive.any():
            row[inner] = np.exp(np.interp(square[inner], square[positive], np.log(row[positive])))
    first = np.where(known.any(axis=1), np.argmax(known, axis=1), 0)
    rows = np.flatnonzero(first > 0)
    if not rows.size:
        return filled
    reach = np.maximum(2.0 * theta_deg[first], theta_deg[np.minimum(first + FEWEST, theta_deg.size - 1)])
    ring = known & (values > 0.0) & (theta_deg <= reach[:, None]) & (first > 0)[:, None]
    x, y = np.broadcast_to(square, values.shape)[ring], values[ring]
    if x.size < FEWEST or np.unique(x).size < 2:
        return filled
    lobe = _lobe(x, y)
    for k in rows.tolist():
        hidden, rim = slice(0, first[k]), first[k]
        at_rim = float(_height(lobe, square[rim : rim + 1])[0])
        off = values[k, rim] / at_rim if values[k, rim] > 0.0 else 1.0  # through the rim, and one value at the peak
        filled[k, hidden] = _height(lobe, square[hidden]) * off ** (theta_deg[hidden] / theta_deg[rim])
    return filled


Lobe = tuple[bool, float, float]
"""Whether wide-tailed, and the line in the square of theta of 1 / sqrt(value), or of the value's logarithm."""


def _lobe(square: Floats, values: Floats) -> Lobe:
    """The lobe nearest to values (n,) > 0; those count by their height, because lower ones are nearer to the noise."""
    logarithms = np.log(values)
    found: list[tuple[float, Lobe]] = []
    for wide, y, weights in ((False, logarithms, values), (True, values**-0.5, values**1.5)):
        slope, start = np.polyfit(square, y, 1, w=weights / weights.max())
        if wide and (start <= 0.0 or slope < 0.0):
            continue
        lobe = (wide, float(start), float(slope))
        off = np.log(_height(lobe, square)) - logarithms
        found.append((float(np.sum((values * off) ** 2)), lobe))
    return min(found, key=lambda each: each[0])[1]


def _height(lobe: Lobe, square: Floats) -> Floats:
    wide, start, slope = lobe
    line = start + slope * square
    height: Floats = line**-2 if wide else np.exp(np.minimum(line, math.log(np.finfo(np.float64).max)))
    return height


def unmeasured_share(sigma_deg: Floats, phi_deg: Floats, theta_deg: Floats, values: Floats, known: Flags) -> Floats:
    """Share of the scattered light, 0 to 1, [channel, psi, sigma], that is in nodes that are not known."""
    step = np.gradient(theta_deg) if theta_deg.size > 1 else np.ones(1)
    turn = np.gradient(phi_deg) if phi_deg.size > 1 else np.ones(1)
    if phi_deg.size > 1:
        turn[[0, -1]] *= 0.5
    cosine = np.maximum(from_specular(sigma_deg[:, None, None], theta_deg, phi_deg[:, None])[..., 2], 0.0)
    light = np.maximum(values, 0.0) * cosine * turn[:, None] * np.sin(np.radians(theta_deg)) * step
    total = light.sum(axis=(3, 4))
    share: Floats = np.where(known, 0.0, light).sum(axis=(3, 4)) / np.where(total > 0.0, total, 1.0)
    return share


def refuse_holes(sigma_deg: Floats, phi_deg: Floats, theta_deg: Floats, values: Floats, known: Flags) -> None:
    """Raise ValueError for nodes that are not known, at polar angles up to the last that is known at the same sigma."""
    shares = unmeasured_share(sigma_deg, phi_deg, theta_deg, values, known)
    for s, sigma in enumerate(sigma_deg.tolist()):
        polar, _ = zenith_and_azimuth(from_specular(sigma, theta_deg, phi_deg[:, None]))
        for c, p in np.ndindex(*known.shape[:2]):
            there = known[c, p, s]
            holes = ~there & (polar < np.max(polar, where=there, initial=0.0) - TOLERANCE_DEG)
            if holes.any():
                at = np.broadcast_to(theta_deg, holes.shape)[holes]
                raise ValueError(
                    f"at sigma {sigma:g} {100.0 * shares[c, p, s]:.3g} % of the light was not measured, with gaps from theta "
                    f"{at.min():g} to {at.max():g}"
                )
