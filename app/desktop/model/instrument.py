"""The instrument as a drawing: its parts in mm in the rig's frame, at one pose. Plain numbers, no Qt.

The frame is that of `twin.optics`: the sample's centre is the origin, z its front normal, y the illumination axis. The side
view looks along y, with the light in the plane of the paper; the top view looks down along z.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from goniotwin.app.campaign.geometry.arcs import arc_channels, arc_view, polar_deg
from goniotwin.app.campaign.geometry.directions import ARCS, Arc, PoseAngles
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.rig import AXES, RigFile, arc_clearance, nominal_instrument
from goniotwin.arrays import Floats
from goniotwin.twin.optics import arc_direction
from goniotwin.twin.optics.geometry.coordinates import specular_direction
from goniotwin.twin.optics.geometry.instrument import SampleFrames
from goniotwin.twin.optics.geometry.mirrors import mirrors_at, pupil

View = Literal["side", "top"]
ACROSS: dict[View, tuple[int, int]] = {"side": (0, 2), "top": (0, 1)}
"""The coordinates that a view shows to the right and upwards."""
ZENITH_STEP_DEG, AZIMUTH_STEP_DEG = 1.5, 3.0
"""Cells of the obstructed zone."""
ZONE_STEP_DEG = 0.5
"""Sigma and gamma are rounded to this for the zone, so that noise of a position does not move it."""
CORNERS = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
LINE_POINTS = 36


@dataclass(frozen=True, eq=False)
class Obstruction:
    """What the mirror unit blocks in a pose: `cells` (k, 4, 3) of the arcs' sphere, in mm, and photodiodes by number."""

    cells: Floats
    photodiodes: frozenset[int]


@dataclass(frozen=True, eq=False)
class ArcDrawing:
    """One arc: its `line` (m, 3) and its photodiodes (n, 3) in mm, with their numbers and signed polar angles."""

    arc: Arc
    line: Floats
    photodiodes: Floats
    channels: tuple[int, ...]
    polar_deg: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class InstrumentDrawing:
    """The parts at one pose, points in mm. `beam` (5, 3) runs from the exit pupil over the `mirrors` (3, 4, 3) to the sample.

    The `sample` (4, 3) has the `mark` (2, 3) of its turn; `specular` (2, 3) is the specular direction.

    `clearance` (k, 3) is the sector at the incoming beam that the arc must not enter while it is `too_high`: while its highest
    carrier would collide there. `reach_mm` is the radius of all that is drawn, the exit pupil apart.
    """

    pose: PoseAngles
    beam: Floats
    mirrors: Floats
    sample: Floats
    mark: Floats
    specular: Floats
    arcs: tuple[ArcDrawing, ...]
    clearance: Floats
    too_high: bool
    reach_mm: float


class InstrumentModel:
    """The drawings of one rig."""

    def __init__(self, rig: RigFile) -> None:
        self.rig = rig
        self._instrument = nominal_instrument(rig)
        self._clearance = arc_clearance(rig)
        self._side_mm = SampleFrames().side_mm
        self._cells: tuple[tuple[float, float], Floats] | None = None

    def drawing(self, positions: Mapping[str, float]) -> InstrumentDrawing:
        """The drawing at the positions of the axes, deg; an axis without one is drawn at 0."""
        pose = pose_of(positions)
        gamma, sigma, _, shift = pose
        instrument, clearance = self._instrument, self._clearance
        unit = mirrors_at(instrument, sigma)
        sides = np.stack([unit.axes_u, unit.axes_v], axis=1)
        mirrors = unit.centres[:, None, :] + 0.5 * instrument.blocking_side_mm * np.einsum("ij,kjl->kil", CORNERS, sides)
        turn = np.radians(gamma)
        turned = np.array([[np.cos(turn), np.sin(turn), 0.0], [-np.sin(turn), np.cos(turn), 0.0]])
        radius = instrument.arc_radius_mm
        azimuth = np.linspace(-clearance.half_width_deg, clearance.half_width_deg, 7) + clearance.beam_azimuth_deg
        return InstrumentDrawing(
            pose=pose,
            beam=np.array([pupil(instrument)[0], *unit.centres, np.zeros(3)]),
            mirrors=mirrors,
            sample=0.5 * self._side_mm * CORNERS @ turned,
            mark=0.5 * self._side_mm * np.array([np.zeros(3), turned[0]]),
            specular=radius * np.array([np.zeros(3), specular_direction(sigma)]),
            arcs=tuple(self._arc(arc, pose) for arc in ARCS if polar_deg(self.rig, arc)),
            clearance=radius * np.array([np.zeros(3), *arc_direction(np.full(len(azimuth), 90.0), azimuth)]),
            too_high=bool(clearance.top_polar_deg + shift > clearance.highest_deg),
            reach_mm=max(radius, 1.5 * instrument.mirror_distance_mm),
        )

    def obstruction(self, positions: Mapping[str, float]) -> Obstruction:
        """What is blocked at the positions of the axes.

        It takes some 50 ms, at first some seconds: not for a window's thread.
        """
        pose = pose_of(positions)
        gamma, sigma, _, _ = pose
        key = (_rounded(sigma), _rounded(gamma))
        if self._cells is None or self._cells[0] != key:
            self._cells = key, self._blocked_cells(*key)
        hidden: set[int] = set()
        for arc in ARCS:
            if polar_deg(self.rig, arc):
                view = arc_view(self.rig, pose, arc)
                flags = blocked_by_mirrors(self.rig, sigma, view.zenith, view.azimuth, gamma)
                hidden |= set(view.channels[flags].tolist())
        return Obstruction(self._cells[1], frozenset(hidden))

    def _blocked_cells(self, sigma_deg: float, gamma_deg: float) -> Floats:
        zenith, azimuth = np.arange(0.0, 180.0, ZENITH_STEP_DEG), np.arange(0.0, 360.0, AZIMUTH_STEP_DEG)
        low, first = (each.ravel() for each in np.meshgrid(zenith, azimuth, indexing="ij"))
        hidden = blocked_by_mirrors(self.rig, sigma_deg, low + 0.5 * ZENITH_STEP_DEG, first + 0.5 * AZIMUTH_STEP_DEG, gamma_deg)
        low, first = low[hidden], first[hidden]
        corners = [
            arc_direction(low + down * ZENITH_STEP_DEG, first + right * AZIMUTH_STEP_DEG)
            for down, right in ((0, 0), (1, 0), (1, 1), (0, 1))
        ]
        return self._instrument.arc_radius_mm * np.stack(corners, axis=1)

    def _arc(self, arc: Arc, pose: PoseAngles) -> ArcDrawing:
        _, _, beta, shift = pose
        radius, lower = self._instrument.arc_radius_mm, arc == "lower"
        signed = np.array(polar_deg(self.rig, arc), dtype=float) + shift
        line = np.linspace(float(signed.min()), float(signed.max()), LINE_POINTS)
        return ArcDrawing(
            arc=arc,
            line=radius * arc_direction(line, beta, lower),
            photodiodes=radius * arc_direction(signed, beta, lower),
            channels=tuple(arc_channels(self.rig, arc).tolist()),
            polar_deg=tuple(signed.tolist()),
        )


def pose_of(positions: Mapping[str, float]) -> PoseAngles:
    """The pose at positions; an axis without one is at 0."""
    gamma, sigma, beta, shift = (positions.get(axis, 0.0) for axis in AXES)
    return gamma, sigma, beta, shift


def _rounded(angle_deg: float) -> float:
    return round(angle_deg / ZONE_STEP_DEG) * ZONE_STEP_DEG


def project(points: Floats, view: View) -> Floats:
    """Points (..., 3) in a view: (..., 2) to the right and upwards, mm."""
    return points[..., list(ACROSS[view])]


def pose_text(positions: Mapping[str, float]) -> str:
    """The positions of the axes as a line of text."""
    known = [f"{GREEK[axis]} {round(positions[axis], 2) + 0.0:.2f}°".replace("-", "−") for axis in AXES if axis in positions]
    return ", ".join(known) if known else "positions unknown"
