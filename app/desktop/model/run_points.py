"""The points of a run beside the twin's prediction: cuts, planes through the specular direction, the hemisphere. No Qt."""

from dataclasses import dataclass, field

import numpy as np

from goniotwin.app.campaign.reduction.components import deviation_in_u
from goniotwin.app.desktop.model.live_scan import ScanData, ScanKey, ScanPoints, Setting, join_points
from goniotwin.arrays import Flags, Floats, Ints

ALARM_U = 4.0
"""A residual beyond so many u is marked, and is an event."""
PLANE_HALF_WIDTH_DEG = 2.5
"""Points so near a plane through the specular direction are shown in it."""
GAP_STEPS = 3.0
"""A line of predicted points has a gap where they are farther apart than so many steps."""
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
    """Points of a hemisphere (n,): zenith and azimuth from the normal in degrees, values, and whether one is in alarm."""

    zenith_deg: Floats
    azimuth_deg: Floats
    values: Floats
    alarms: Flags


@dataclass
class RunPoints:
    """The scans of a run so far, and the predicted ones."""

    cuts: dict[ScanKey, Cut] = field(default_factory=dict)
    predicted: dict[ScanKey, ScanData] = field(default_factory=dict)
    _mapped: dict[tuple[ScanKey, bool], MapPoints] = field(default_factory=dict)
    """The points of cuts in the map, by the side of the sample: of 120,000 only those of the scan in progress change."""

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
        points = join_points(*(each.scan.points for each in cuts))
        x, near = _in_plane(points, phi_deg)
        order = np.flatnonzero(near)[np.argsort(x[near], kind="stable")]
        expected, u, residual = (np.concatenate([getattr(each, name) for each in cuts])[order] for name in MATCHED)
        lines = [each.line for each in cuts if each.line is not None]
        planned = [each.points for key, each in self.predicted.items() if key[0] == setting and each.is_bsdf == latest.is_bsdf]
        line = None
        if lines:
            every = join_points(*planned)
            at, close = _in_plane(every, phi_deg)
            line = _take(every, np.flatnonzero(close)[np.argsort(at[close], kind="stable")], at)
        sample, wavelength, sigma, gamma = setting
        rotation = f", γ {gamma:g}°" if gamma else ""
        title = f"{sample}: σ {sigma:g}°{rotation}, plane φ {phi_deg:g}° (± {PLANE_HALF_WIDTH_DEG:g}°), {wavelength:g} nm"
        scan = ScanData(
            title,
            "aspecular angle θ (°), positive at φ",
            latest.y_label,
            (-180.0, 180.0),
            (),
            _take(points, order, x),
            findings=latest.findings,
            key=latest.key,
        )
        shown = scan.points.x_deg if line is None else np.concatenate([scan.points.x_deg, line.x_deg])
        if shown.size:
            low, high = float(shown.min()), float(shown.max())
            scan = ScanData(**{**vars(scan), "range_deg": (low, max(high, low + 1.0))})
        return Cut(scan, expected, u, residual, line)

    def hemisphere(self, setting: Setting, transmitted: bool) -> MapPoints:
        """The measured points of a setting on one side of the sample."""
        parts = [self._mapped[key, transmitted] for cut in self.planes(setting) if (key := cut.scan.key) is not None]
        none = MapPoints(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0, dtype=bool))
        return MapPoints(
            *(np.concatenate(each) for each in zip(*(vars(part).values() for part in (none, *parts)), strict=True))
        )

    def predicted_scans(self, setting: Setting) -> int:
        """The number of predicted scans of a setting."""
        return sum(key[0] == setting for key in self.predicted)

    def planned(self, setting: Setting, transmitted: bool) -> MapPoints:
        """The predicted points of a setting on one side of the sample."""
        return map_points([match(each, None) for key, each in self.predicted.items() if key[0] == setting], transmitted)


def map_points(cuts: list[Cut], transmitted: bool) -> MapPoints:
    """The points of cuts on one side of the sample, without those that are blocked or have no value."""
    points = join_points(*(each.scan.points for each in cuts))
    alarms = np.concatenate([np.zeros(0, dtype=bool), *(each.alarms for each in cuts)])
    chosen = (points.transmitted == transmitted) & ~points.blocked & np.isfinite(points.values)
    return MapPoints(points.directions[chosen, 0], points.directions[chosen, 1], points.values[chosen], alarms[chosen])


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


def gaps(x_deg: Floats) -> Ints:
    """The indices before which points (n,) in ascending order have a gap of more than GAP_STEPS steps, where none is known."""
    steps = np.diff(x_deg)
    if not steps.size:
        return np.empty(0, dtype=np.int64)
    # Points of several cuts lie beside each other at a distance that is no step: hence no median.
    widest = max(GAP_STEPS * float(np.percentile(steps, 75.0)), 2.0 * PLANE_HALF_WIDTH_DEG)
    return np.flatnonzero(steps > widest) + 1


def _take(points: ScanPoints, chosen: np.ndarray, x_deg: Floats) -> ScanPoints:
    columns = {name: each[chosen] for name, each in vars(points).items()}
    return ScanPoints(**{**columns, "x_deg": x_deg[chosen]})


def _in_plane(points: ScanPoints, phi_deg: float) -> tuple[Floats, Flags]:
    """The signed angles (n,) from the specular direction, positive at `phi_deg`, and which points are near that plane."""
    theta, turn = np.radians(points.directions[:, 2]), np.radians(points.directions[:, 3] - phi_deg)
    away = np.degrees(np.arcsin(np.clip(np.sin(theta) * np.sin(turn), -1.0, 1.0)))
    x = np.where(np.cos(turn) >= 0.0, 1.0, -1.0) * points.directions[:, 2]
    return x, np.asarray(np.abs(away) <= PLANE_HALF_WIDTH_DEG)
