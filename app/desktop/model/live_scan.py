"""The cut that a run is measuring, as far as it has come: what the live plot shows. Plain numbers, no Qt.

A cut is one half plane and its opposite, at one sample, sigma, gamma and wavelength. What is shown is reduced as the
journal will be, but with the darks taken so far, so that the last digit is still open until the run is over.
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
DARKS_KEPT = 8
CUTS_KEPT = 512
GRID_DEG = 0.5


@dataclass(frozen=True)
class Points:
    """Points of a cut: `x_deg`, values with their standard uncertainty, and which the mirror unit hides. One length."""

    x_deg: Floats
    values: Floats
    u_values: Floats
    hidden: Flags


@dataclass(frozen=True)
class Cut:
    """What a plot of a cut needs. `spans_deg` are the stretches of the abscissa that the mirror unit hides."""

    title: str
    x_label: str
    y_label: str
    range_deg: tuple[float, float]
    spans_deg: tuple[tuple[float, float], ...]
    points: Points


@dataclass
class LiveCut:
    """Follows a run's events; `cut()` says what there is to be seen now."""

    plan: Plan
    _key: Key | None = None
    _row: Row | None = None
    _cuts: dict[Key, list[Points]] = field(default_factory=dict)
    _spans: tuple[tuple[float, float], ...] = ()
    _darks: deque[CommittedRow] = field(default_factory=lambda: deque(maxlen=DARKS_KEPT))
    _etalon: dict[tuple[object, ...], Signal] = field(default_factory=dict)

    def heed(self, event: RowStarted | RowCommitted) -> None:
        """Takes a row in. Raises UserError where it cannot be reduced."""
        row = event.row
        if row.kind == "measure" and _key(row) != self._key:
            self._key, self._row = _key(row), row
            self._spans = _hidden_spans(self.plan.rig, row)
            # A plan may come back to a cut after others: what has been seen of it is shown again.
            self._cuts[self._key] = self._cuts.pop(self._key, [])
            if len(self._cuts) > CUTS_KEPT:
                del self._cuts[next(iter(self._cuts))]
        if isinstance(event, RowCommitted):
            committed = CommittedRow(row, event.data)
            if row.kind == "dark":
                self._darks.append(committed)
            elif row.kind == "measure" and event.data.readings and self._has_etalon(row):
                self._cuts[_key(row)].append(self._reduced(committed))

    def _has_etalon(self, row: Row) -> bool:
        return row.sample == self.plan.schedule.file.etalon or (row.wavelength_nm, row.pose) in self._etalon

    def cut(self) -> Cut | None:
        """The cut as it is now; None before its first row."""
        row = self._row
        if row is None:
            return None
        assert row.pose is not None
        gamma, sigma, beta, _shift = row.pose
        in_plane = _in_plane(beta)
        etalon = row.sample == self.plan.schedule.file.etalon
        place = "plane of incidence" if in_plane else f"β {beta % 180.0:g}°"
        turned = f", γ {gamma:g}°" if gamma else ""
        reach = max(self.plan.rig.file.photodiodes.upper_deg) + 5.0
        ends = _abscissa(sigma, np.array([-reach, reach]), beta % 180.0)
        return Cut(
            title=f"{row.sample}: σ {sigma:g}°{turned}, {place}, {row.wavelength_nm:g} nm",
            x_label="θ from specular, positive towards the normal (°)" if in_plane else "polar angle (°)",
            y_label="photocurrent / monitor" if etalon else "BSDF (1/sr)",
            range_deg=(float(np.min(ends)), float(np.max(ends))),
            spans_deg=self._spans,
            points=_sorted(self._cuts[_key(row)]),
        )

    def _reduced(self, committed: CommittedRow) -> Points:
        row, rig = committed.row, self.plan.rig
        assert row.pose is not None
        settings = photodiode_settings(rig.file)
        found = signal(committed.data, dark_readings_by_gain(list(self._darks), settings), settings)
        place = (row.wavelength_nm, row.pose)
        upper = len(settings.upper_deg)
        if row.sample == self.plan.schedule.file.etalon:
            self._etalon[place] = found
            points = live_points(rig, row, found, found)
            values, u_values = found.ratio[:upper], np.sqrt(found.variance[:upper])
        else:
            points = live_points(rig, row, found, self._etalon[place])
            values, u_values = points.bsdf, points.u_bsdf
        return Points(_x_deg(points), values, u_values, points.shadowed)


def _key(row: Row) -> Key:
    assert row.pose is not None
    gamma, sigma, beta, _shift = row.pose
    return (row.sample, row.wavelength_nm, sigma, gamma, beta % 180.0)


def _in_plane(beta_deg: float) -> bool:
    return min(beta_deg % 180.0, 180.0 - beta_deg % 180.0) < 1e-6


def _x_deg(points: BsdfPoints) -> Floats:
    """Of a row's points, whose half plane may be either of the cut's."""
    plane = float(points.beta_deg[0]) % 180.0
    opposite = np.cos(np.radians(points.azimuth_deg - plane)) < 0.0
    return _abscissa(float(points.sigma_deg[0]), np.where(opposite, -points.zenith_deg, points.zenith_deg), plane)


def _abscissa(sigma_deg: float, polar_deg: Floats, plane_deg: float) -> Floats:
    """From signed polar angles, positive at the azimuth `plane_deg`: in the plane of incidence to the aspecular angle
    as `BsdfPoints.aspecular_deg` has it, elsewhere they stay."""
    if not _in_plane(plane_deg):
        return polar_deg
    theta, phi = to_specular(sigma_deg, arc_direction(np.abs(polar_deg), _azimuths(polar_deg, plane_deg)))
    signed: Floats = np.where(np.cos(np.radians(phi)) > 0.0, theta, -theta)
    return signed


def _azimuths(polar_deg: Floats, plane_deg: float) -> Floats:
    return np.mod(np.where(polar_deg < 0.0, plane_deg + 180.0, plane_deg), 360.0)


def _hidden_spans(rig: RigDescription, row: Row) -> tuple[tuple[float, float], ...]:
    """The stretches of a row's cut that the mirror unit hides, to half a step of a grid."""
    assert row.pose is not None
    _gamma, sigma, beta, _shift = row.pose
    plane = beta % 180.0
    polar = np.arange(-90.0, 90.0 + GRID_DEG, GRID_DEG)
    hidden = blocked_by_mirrors(rig.file, sigma, np.abs(polar), _azimuths(polar, plane))
    x = _abscissa(sigma, polar, plane)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], hidden, [False]]).astype(np.int8)))
    spans = []
    for first, after in zip(edges[::2], edges[1::2], strict=True):
        ends = sorted((float(x[first]), float(x[after - 1])))
        spans.append((ends[0] - 0.5 * GRID_DEG, ends[1] + 0.5 * GRID_DEG))
    return tuple(spans)


def _sorted(blocks: list[Points]) -> Points:
    if not blocks:
        nothing = np.empty(0)
        return Points(nothing, nothing, nothing, np.empty(0, dtype=bool))
    x = np.concatenate([each.x_deg for each in blocks])
    order = np.argsort(x, kind="stable")
    return Points(
        x[order],
        np.concatenate([each.values for each in blocks])[order],
        np.concatenate([each.u_values for each in blocks])[order],
        np.concatenate([each.hidden for each in blocks])[order],
    )
