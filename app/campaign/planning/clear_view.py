"""Directions in which a photodiode certainly sees the whole spot, found without tracing a ray."""

import math
from itertools import product

import numpy as np

from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Instrument
from goniotwin.twin.optics.mirrors import mirrors_at

TINY = 1e-9


def certainly_clear(instrument: Instrument, margin_deg: float, sigma_deg: float, directions: Floats) -> Flags:
    """Of unit vectors (n, 3): no mirror is in the way, nor would be a `margin_deg` further on, however the sample is turned.

    In the sample's own plane a photodiode sees nothing, so that it is not clear there.
    """
    spot = math.sqrt(0.5) * instrument.spot_side_mm
    disc = 0.5 * instrument.detector_diameter_mm + instrument.arc_radius_mm * math.radians(margin_deg)
    mirrors = mirrors_at(instrument, sigma_deg)
    clear = np.abs(directions[:, 2]) > math.sin(math.radians(margin_deg)) + TINY
    for centre, normal, u, v in mirrors.packed:
        # A sphere round the mirror and a tube round the light first: most directions are far from both.
        near = np.flatnonzero(clear & _near(instrument, max(spot, disc), centre, directions))
        frame = normal, u, v
        clear[near] = _passes(instrument, centre, frame, directions[near], spot, disc)
    return np.asarray(clear)


def _near(instrument: Instrument, light_mm: float, centre: Floats, directions: Floats) -> Flags:
    along = directions @ centre
    nearest = np.clip(along, 0.0, instrument.arc_radius_mm)
    reach = light_mm + math.sqrt(0.5) * instrument.blocking_side_mm
    return np.asarray(float(centre @ centre) - 2.0 * nearest * along + nearest * nearest <= reach * reach)


def _passes(
    instrument: Instrument, centre: Floats, frame: tuple[Floats, Floats, Floats], directions: Floats, spot: float, disc: float
) -> Flags:
    """Whether all light of each direction passes a mirror on one side, or ends before it.

    Spot and photodiode are convex: what passes between them meets the mirror's plane within the hull of where the lines
    between the corners of squares round both meet it. All of these beyond one edge of the mirror means all of the light.
    """
    normal, u, v = frame
    across = np.cross(directions, np.where(np.abs(directions[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    beside = np.cross(directions, across)
    low, high = np.full((3, len(directions)), np.inf), np.full((3, len(directions)), -np.inf)
    for px, py, s, t in product((-1.0, 1.0), repeat=4):
        begin = np.array([spot * px, spot * py, 0.0])
        way = instrument.arc_radius_mm * directions + disc * (s * across + t * beside) - begin
        with np.errstate(divide="ignore", invalid="ignore"):
            share = float((centre - begin) @ normal) / (way @ normal)
            met = np.stack(
                [share, share * (way @ u) - float((centre - begin) @ u), share * (way @ v) - float((centre - begin) @ v)]
            )
        low, high = np.minimum(low, met), np.maximum(high, met)
    half = 0.5 * instrument.blocking_side_mm
    beyond_an_edge = (low[1:] > half).any(axis=0) | (high[1:] < -half).any(axis=0)
    between = (low[0] > 0.0) & (high[0] < 1.0)
    return np.asarray((between & beyond_an_edge) | (high[0] < 0.0) | (low[0] > 1.0))
