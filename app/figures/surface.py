"""The surface of a map: triangles between its directions, for every back end; and as an image, and as a lobe in space."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from matplotlib.tri import Triangulation

from goniotwin.app.figures.description import Map
from goniotwin.app.figures.hemisphere import EDGE_DEG, GAPS, WIDEST_DEG
from goniotwin.arrays import Flags, Floats, Ints


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles between places (n,), their corners (m, 3) counted in these; `values` (n,) are finite at each corner."""

    x: Floats
    y: Floats
    values: Floats
    triangles: Ints

    @property
    def mesh(self) -> Triangulation:
        """The triangles as matplotlib takes them."""
        return Triangulation(self.x, self.y, self.triangles)


def coloured_places(drawn: Map) -> tuple[Floats, Floats, Floats, Flags]:
    """Places, values and whether they have a colour (n,), with their images on the other half where the map has these."""
    shown = drawn.trusted if drawn.filled is None else drawn.trusted | drawn.filled
    if not drawn.mirrored:
        return drawn.x, drawn.y, drawn.values, shown
    return np.tile(drawn.x, 2), np.concatenate([drawn.y, -drawn.y]), np.tile(drawn.values, 2), np.tile(shown, 2)


def surface(drawn: Map) -> Surface | None:
    """The surface between directions that are near each other; None where they span no area."""
    x, y, values, shown = coloured_places(drawn)
    _, first = np.unique(np.round(np.stack([x, y]), 4), axis=1, return_index=True)
    order = first[np.argsort(~shown[first], kind="stable")]
    (x, y, values), shown = (each[order] for each in (x, y, values)), shown[order]
    if order.size <= 3 or min(np.ptp(x), np.ptp(y)) <= 1.0:
        return None
    corners = _triangulated(np.stack([x, y]).tobytes())
    sides = [np.hypot(*(each[corners[:, k]] - each[corners[:, k - 1]] for each in (x, y))) for k in range(3)]
    longest = np.max(sides, axis=0)
    limit = max(WIDEST_DEG, GAPS * float(np.quantile(longest, 0.95)))
    kept = (longest <= limit) & shown[corners].all(axis=1)
    return Surface(x, y, np.where(shown, values, 0.0), corners[kept]) if kept.any() else None


def image_of(found: Surface, shares: Floats, pixels: int) -> Floats:
    """Shares (n,) of the bar over the surface, (pixels, pixels) from below to above, linear in a triangle; NaN beside it."""
    places, triangles = np.stack([found.x, found.y]).tobytes(), found.triangles.astype(np.int32).tobytes()
    there, corners, weights = _pixels_of(places, triangles, pixels)
    image = np.full(pixels * pixels, math.nan)
    image[there] = (shares[corners] * weights).sum(axis=1)
    return image.reshape(pixels, pixels)


# All wavelengths have the same directions: their triangles are found once.


@lru_cache(maxsize=8)
def _triangulated(places: bytes) -> Ints:
    """The triangles between places (2, n)."""
    corners: Ints = Triangulation(*_places(places)).triangles
    return corners


@lru_cache(maxsize=4)
def _pixels_of(places: bytes, triangles: bytes, pixels: int) -> tuple[Ints, Ints, Floats]:
    """The pixels within triangles: their indices (k,), the corners (k, 3) of the triangle of each, and weights of these."""
    x, y = _places(places)
    corners = np.frombuffer(triangles, dtype=np.int32).reshape(-1, 3)
    middle = EDGE_DEG * ((np.arange(pixels) + 0.5) * 2.0 / pixels - 1.0)
    across, up = (np.tile(middle, pixels), np.repeat(middle, pixels))
    which = np.asarray(Triangulation(x, y, corners).get_trifinder()(across, up), dtype=np.int64)
    there = np.flatnonzero(which >= 0)
    of: Ints = corners[which[there]].astype(np.int64)
    (x0, x1, x2), (y0, y1, y2) = x[of].T, y[of].T
    double = (y1 - y2) * (x0 - x2) + (x2 - x1) * (y0 - y2)
    right, above = across[there] - x2, up[there] - y2
    first, second = ((y1 - y2) * right + (x2 - x1) * above) / double, ((y2 - y0) * right + (x0 - x2) * above) / double
    return there, of, np.stack([first, second, 1.0 - first - second], axis=1)


def _places(places: bytes) -> Floats:
    return np.frombuffer(places).reshape(2, -1)
