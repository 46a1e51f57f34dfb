"""The scan in progress: the data of the live plot. Plain numbers, no Qt.

A scan is one half plane and the opposite one, at one sample, sigma, gamma and wavelength. Its values are reduced in the same
way as the journal after the run, but with the dark readings so far, so that the last digit may still change.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.journal.record import CommittedRow
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.row_points import live_points
from goniotwin.app.campaign.reduction.signals import Signal, dark_readings_by_gain, signal
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.events import RowCommitted, RowStarted
from goniotwin.app.rig import RigDescription, photodiode_settings
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import arc_direction, to_specular

Key = tuple[str, float | None, float, float, float]
DARK_READINGS_KEPT = 8
SCANS_KEPT = 512
GRID_DEG = 0.5


@dataclass(frozen=True)
class ScanPoints:
    """Points of a scan (n,): `x_deg`, values with their standard uncertainty, and which are blocked by the mirror unit."""

    x_deg: Floats
    values: Floats
    u_values: Floats
    blocked: Flags


@dataclass(frozen=True)
class ScanData:
    """Data of the plot of a scan. `blocked_deg` are the intervals of the abscissa that are blocked by the mirror unit."""

    title: str
    x_label: str
    y_label: str
    range_deg: tuple[float, float]
    blocked_deg: tuple[tuple[float, float], ...]
    points: ScanPoints


@dataclass
class LiveScan:
    """The scan in progress, from the events of a run."""

    plan: Plan
    _key: Key | None = None
    _row: Row | None = None
    _scans: dict[Key, list[ScanPoints]] = field(default_factory=dict)
    _blocked: tuple[tuple[float, float], ...] = ()
    _dark_readings: deque[CommittedRow] = field(default_factory=lambda: deque(maxlen=DARK_READINGS_KEPT))
    _etalon: dict[tuple[object, ...], Signal] = field(default_factory=dict)

    def add_row(self, event: RowStarted | RowCommitted) -> None:
        """Add a row. Raises UserError if it cannot be reduced."""
        row = event.row
        if row.kind == "measure" and _key(row) != self._key:
            self._key, self._row = _key(row), row
            self._blocked = _blocked_intervals(self.plan.rig, row)
            # A plan may return to a scan after others: its earlier points are shown again.
            self._scans[self._key] = self._scans.pop(self._key, [])
            if len(self._scans) > SCANS_KEPT:
                del self._scans[next(iter(self._scans))]
        if isinstance(event, RowCommitted):
            committed = CommittedRow(row, event.data)
            if row.kind == "dark":
                self._dark_readings.append(committed)
            elif row.kind == "measure" and event.data.readings and self._has_etalon(row):
                self._scans[_key(row)].append(self._reduce(committed))

    def data(self) -> ScanData | None:
        """The scan as it is now; None before its first row."""
        row = self._row
        if row is None:
            return None
        assert row.pose is not None
        gamma, sigma, beta, _shift = row.pose
        in_plane = _in_plane(beta)
        etalon = row.sample == self.plan.schedule.file.etalon
        place = "plane of incidence" if in_plane else f"β {beta % 180.0:g}°"
        rotation = f", γ {gamma:g}°" if gamma else ""
        reach = max(self.plan.rig.file.photodiodes.upper_deg) + 5.0
        ends = _abscissa(sigma, np.array([-reach, reach]), beta % 180.0)
        return ScanData(
            title=f"{row.sample}: σ {sigma:g}°{rotation}, {place}, {row.wavelength_nm:g} nm",
            x_label="aspecular angle θ (°), positive towards the normal" if in_plane else "polar angle (°)",
            y_label="photocurrent / monitor" if etalon else "BSDF (1/sr)",
            range_deg=(float(np.min(ends)), float(np.max(ends))),
            blocked_deg=self._blocked,
            points=_sort(self._scans[_key(row)]),
        )

    def _has_etalon(self, row: Row) -> bool:
        return row.sample == self.plan.schedule.file.etalon or (row.wavelength_nm, row.pose) in self._etalon

    def _reduce(self, committed: CommittedRow) -> ScanPoints:
        row, rig = committed.row, self.plan.rig
        assert row.pose is not None
        settings = photodiode_settings(rig.file)
        reduced = signal(committed.data, dark_readings_by_gain(list(self._dark_readings), settings), settings)
        place = (row.wavelength_nm, row.pose)
        upper = len(settings.upper_deg)
        if row.sample == self.plan.schedule.file.etalon:
            self._etalon[place] = reduced
            points = live_points(rig, row, reduced, reduced)
            values, u_values = reduced.ratio[:upper], np.sqrt(reduced.variance[:upper])
        else:
            points = live_points(rig, row, reduced, self._etalon[place])
            values, u_values = points.bsdf, points.u_bsdf
        return ScanPoints(_x_deg(points), values, u_values, points.shadowed)


def _key(row: Row) -> Key:
    assert row.pose is not None
    gamma, sigma, beta, _shift = row.pose
    return (row.sample, row.wavelength_nm, sigma, gamma, beta % 180.0)


def _in_plane(beta_deg: float) -> bool:
    return min(beta_deg % 180.0, 180.0 - beta_deg % 180.0) < 1e-6


def _x_deg(points: BsdfPoints) -> Floats:
    """The abscissa of the points of a row, which may be in either half plane of the scan."""
    plane = float(points.beta_deg[0]) % 180.0
    opposite = np.cos(np.radians(points.azimuth_deg - plane)) < 0.0
    return _abscissa(float(points.sigma_deg[0]), np.where(opposite, -points.zenith_deg, points.zenith_deg), plane)


def _abscissa(sigma_deg: float, polar_deg: Floats, plane_deg: float) -> Floats:
    """The abscissa of signed polar angles, positive at the azimuth `plane_deg`.

    In the plane of incidence it is the aspecular angle (as `BsdfPoints.aspecular_deg`), elsewhere the polar angle.
    """
    if not _in_plane(plane_deg):
        return polar_deg
    theta, phi = to_specular(sigma_deg, arc_direction(np.abs(polar_deg), _azimuths(polar_deg, plane_deg)))
    signed: Floats = np.where(np.cos(np.radians(phi)) > 0.0, theta, -theta)
    return signed


def _azimuths(polar_deg: Floats, plane_deg: float) -> Floats:
    return np.mod(np.where(polar_deg < 0.0, plane_deg + 180.0, plane_deg), 360.0)


def _blocked_intervals(rig: RigDescription, row: Row) -> tuple[tuple[float, float], ...]:
    """The intervals of a row's scan that are blocked by the mirror unit, to half a step of a grid of GRID_DEG."""
    assert row.pose is not None
    _gamma, sigma, beta, _shift = row.pose
    plane = beta % 180.0
    polar = np.arange(-90.0, 90.0 + GRID_DEG, GRID_DEG)
    blocked = blocked_by_mirrors(rig.file, sigma, np.abs(polar), _azimuths(polar, plane))
    x = _abscissa(sigma, polar, plane)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], blocked, [False]]).astype(np.int8)))
    intervals = []
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        ends = sorted((float(x[first]), float(x[after - 1])))
        intervals.append((ends[0] - 0.5 * GRID_DEG, ends[1] + 0.5 * GRID_DEG))
    return tuple(intervals)


def _sort(blocks: list[ScanPoints]) -> ScanPoints:
    if not blocks:
        empty = np.empty(0)
        return ScanPoints(empty, empty, empty, np.empty(0, dtype=bool))
    x = np.concatenate([each.x_deg for each in blocks])
    order = np.argsort(x, kind="stable")
    return ScanPoints(
        x[order],
        np.concatenate([each.values for each in blocks])[order],
        np.concatenate([each.u_values for each in blocks])[order],
        np.concatenate([each.blocked for each in blocks])[order],
    )
