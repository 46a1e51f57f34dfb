"""The points of a run beside the twin's prediction: cuts, planes through the specular direction, the hemisphere. No Qt."""

from dataclasses import dataclass, field, replace

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.reduction.components import deviation_in_u
from goniotwin.app.desktop.model.live_scan import NO_POINTS, ScanData, ScanKey, ScanPoints, Setting
from goniotwin.app.figures.curves import ANGLE_LIMITS, PLANE_AXIS, plane_angle
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, incidence_deg

ALARM_U = 4.0
"""A residual beyond so many u is marked, and is an event."""
PLANE_HALF_WIDTH_DEG = 2.5
"""Points so near a plane through the specular direction are shown in it."""
X_TOLERANCE_DEG = 1e-5


@dataclass(frozen=True)
class Cut:
    """Points of a cut in the order of the abscissa, with the prediction and the residual, (measured - predicted) / u, of each.

    NaN where there is none: a signal has no residual, because the absolute scale of photocurrents is no fact of the rig file.
    `line` has all points of the prediction; None without one.
    """

    scan: ScanData
    expected: Floats
    u_expected: Floats
    residual: Floats
    line: ScanPoints | None = None

    @property
    def alarms(self) -> Flags:
        """The points whose residual is beyond ALARM_U."""
        return np.asarray(np.abs(np.nan_to_num(self.residual)) > ALARM_U)


@dataclass(frozen=True)
class MapPoints:
    """Points of a hemisphere (n,): zenith and azimuth from the normal in degrees, values with u, and which are flagged."""

    zenith_deg: Floats
    azimuth_deg: Floats
    values: Floats
    u_values: Floats
    untrusted: Flags
    alarms: Flags

    def where(self, chosen: Flags) -> "MapPoints":
        """Some of the points."""
        return MapPoints(*(each[chosen] for each in vars(self).values()))

    def with_more(self, parts: list["MapPoints"]) -> "MapPoints":
        """These points, and then those of other parts."""
        columns = zip(*(vars(part).values() for part in (self, *parts)), strict=True)
        return MapPoints(*(np.concatenate(each) for each in columns)) if parts else self

    @classmethod
    def none(cls) -> "MapPoints":
        """No points."""
        empty, none = np.zeros(0), np.zeros(0, dtype=bool)
        return cls(empty, empty, empty, empty, none, none)


@dataclass
class RunPoints:
    """The scans of a run so far, and the predicted ones."""

    cuts: dict[ScanKey, Cut] = field(default_factory=dict)
    predicted: dict[ScanKey, ScanData] = field(default_factory=dict)
    _mapped: dict[tuple[ScanKey, bool], MapPoints] = field(default_factory=dict)
    """The points of cuts in the map, by the side of the sample: of 120,000 only those of the scan in progress change."""
    _joined: dict[tuple[Setting, bool], tuple[list[MapPoints], MapPoints]] = field(default_factory=dict)
    """The points of all cuts of a setting but the last, one after the other, with these cuts."""

    def add(self, scan: ScanData) -> Cut:
        """Add a scan, or replace it by what is known now."""
        assert scan.key is not None
        cut = self.cuts[scan.key] = match(scan, self.predicted.get(scan.key))
        for transmitted in (False, True):
            self._mapped[scan.key, transmitted] = map_points([cut], transmitted)
        return cut

    def predict(self, scan: ScanData) -> Cut | None:
        """Add a predicted scan; return the measured one beside it, if there is one."""
        assert scan.key is not None
        self.predicted[scan.key] = scan
        known = self.cuts.get(scan.key)
        return None if known is None else self.add(known.scan)

    def begin_run(self) -> None:
        """Forget the measured scans, and keep the predicted ones."""
        self.cuts.clear()
        self._mapped.clear()
        self._joined.clear()

    def begin_prediction(self) -> None:
        """Forget the predicted scans."""
        self.predicted.clear()

    def planes(self, setting: Setting) -> list[Cut]:
        """The measured cuts of a setting, with values of the kind (BSDF or signal) of the latest plane."""
        cuts = [cut for key, cut in self.cuts.items() if key[0] == setting]
        return [cut for cut in cuts if cut.scan.y_label == cuts[-1].scan.y_label]

    def plane(self, setting: Setting, phi_deg: float) -> Cut | None:
        """The points near the plane through the specular direction at the azimuth `phi_deg` about it; None without any.

        Phi 0 is the plane of incidence.
        """
        cuts = self.planes(setting)
        if not cuts:
            return None
        latest = cuts[-1].scan
        points = ScanPoints.join([NO_POINTS, *(each.scan.points for each in cuts)])
        x, near = _in_plane(points, phi_deg)
        order = np.flatnonzero(near)[np.argsort(x[near], kind="stable")]
        expected, u, residual = (np.concatenate([getattr(each, name) for each in cuts])[order] for name in MATCHED)
        lines = [each.line for each in cuts if each.line is not None]
        planned = [each.points for key, each in self.predicted.items() if key[0] == setting and each.is_bsdf == latest.is_bsdf]
        line = None
        if lines:
            every = ScanPoints.join([NO_POINTS, *planned])
            at, close = _in_plane(every, phi_deg)
            line = _take(every, np.flatnonzero(close)[np.argsort(at[close], kind="stable")], at)
        sample, wavelength, sigma, gamma = setting
        rotation = f", γ {gamma:g}°" if gamma else ""
        title = f"{sample}: σ {sigma:g}°{rotation}, plane φ {phi_deg:g}° (± {PLANE_HALF_WIDTH_DEG:g}°), {wavelength:g} nm"
        scan = ScanData(
            title,
            PLANE_AXIS.label if _is_of_incidence(phi_deg) else "aspecular angle θ, deg; positive at φ",
            latest.y_label,
            ANGLE_LIMITS,
            (),
            _take(points, order, x),
            findings=latest.findings,
            key=latest.key,
            specular_deg=(incidence_deg(sigma),) if _is_of_incidence(phi_deg) else (0.0,),
        )
        shown = scan.points.x_deg if line is None else np.concatenate([scan.points.x_deg, line.x_deg])
        if shown.size and not _is_of_incidence(phi_deg):
            low, high = float(shown.min()), float(shown.max())
            scan = replace(scan, range_deg=(low, max(high, low + 1.0)))
        return Cut(scan, expected, u, residual, line)

    def hemisphere(self, setting: Setting, transmitted: bool) -> MapPoints:
        """The measured points of a setting on one side of the sample."""
        parts = [self._mapped[key, transmitted] for cut in self.planes(setting) if (key := cut.scan.key) is not None]
        parts, last = parts[:-1], parts[-1:]
        known, joined = self._joined.get((setting, transmitted), ([], MapPoints.none()))
        if len(known) > len(parts) or any(one is not other for one, other in zip(known, parts, strict=False)):
            known, joined = [], MapPoints.none()
        joined = joined.with_more(parts[len(known) :])
        self._joined[setting, transmitted] = parts, joined
        return joined.with_more(last)

    def predicted_scans(self, setting: Setting) -> int:
        """The number of predicted scans of a setting."""
        return sum(key[0] == setting for key in self.predicted)

    def planned(self, setting: Setting, transmitted: bool) -> MapPoints:
        """The predicted points of a setting on one side of the sample."""
        return map_points([match(each, None) for key, each in self.predicted.items() if key[0] == setting], transmitted)


def map_points(cuts: list[Cut], transmitted: bool) -> MapPoints:
    """The points of cuts on one side of the sample, without those that are blocked or have no value."""
    points = ScanPoints.join([NO_POINTS, *(each.scan.points for each in cuts)])
    alarms = np.concatenate([np.zeros(0, dtype=bool), *(each.alarms for each in cuts)])
    chosen = (points.transmitted == transmitted) & ~points.blocked & np.isfinite(points.values)
    columns = *points.directions[:, :2].T, points.values, points.u_values, points.untrusted, alarms
    return MapPoints(*(each[chosen] for each in columns))


MATCHED = ("expected", "u_expected", "residual")


def match(scan: ScanData, predicted: ScanData | None) -> Cut:
    """A measured scan beside the predicted one, if that has values of the same kind: matched by the abscissa and the side."""
    points = scan.points
    expected, u = (np.full(points.x_deg.size, np.nan) for _ in range(2))
    if predicted is None or predicted.is_bsdf != scan.is_bsdf:
        return Cut(scan, expected, u, np.full(points.x_deg.size, np.nan))
    line = predicted.points
    for side in (False, True):
        here, there = np.flatnonzero(points.transmitted == side), np.flatnonzero(line.transmitted == side)
        if here.size and there.size:
            at = np.searchsorted(line.x_deg[there], points.x_deg[here] - X_TOLERANCE_DEG)
            at = np.minimum(at, there.size - 1)
            found = np.abs(line.x_deg[there][at] - points.x_deg[here]) <= 2.0 * X_TOLERANCE_DEG
            expected[here[found]], u[here[found]] = line.values[there][at[found]], line.u_values[there][at[found]]
    trusted = ~points.blocked & ~points.untrusted & np.isfinite(points.values) & (points.u_values > 0.0) & scan.is_bsdf
    with np.errstate(all="ignore"):
        deviation = deviation_in_u(points.values, points.u_values, points.added, expected)
    return Cut(scan, expected, u, np.where(trusted, deviation, np.nan), line)


def _take(points: ScanPoints, chosen: Ints, x_deg: Floats) -> ScanPoints:
    return replace(points.where(chosen), x_deg=x_deg[chosen])


def _in_plane(points: ScanPoints, phi_deg: float) -> tuple[Floats, Flags]:
    """The abscissa (n,) of a plane through the specular direction, and which points are near that plane.

    In the plane of incidence it is that of every cut, elsewhere the signed angle from the specular direction, positive at
    `phi_deg`.
    """
    theta, turn = np.radians(points.directions[:, 2]), np.radians(points.directions[:, 3] - phi_deg)
    away = np.degrees(np.arcsin(np.clip(np.sin(theta) * np.sin(turn), -1.0, 1.0)))
    if _is_of_incidence(phi_deg):
        x = plane_angle(polar_from_zenith(points.directions[:, 0]), points.directions[:, 1])
    else:
        x = np.where(np.cos(turn) >= 0.0, 1.0, -1.0) * points.directions[:, 2]
    return x, np.asarray(np.abs(away) <= PLANE_HALF_WIDTH_DEG)


def _is_of_incidence(phi_deg: float) -> bool:
    return phi_deg % HALF_TURN_DEG == 0.0
