"""The scan of the open beam: the poses at which one photodiode scans the beam in the direction in which a mirror would send it.

With no sample mounted and the mirror unit at 180 deg - sigma the light goes straight on into the specular direction of sigma.
The photodiode there sees the etalon (unit at sigma) and the beam (unit at 180 deg - sigma) with the same cone, disc and spot:
the quotient of the two is a radiance factor without aperture, distance or responsivity.

The grid of directions is turned by a few degrees, so that hardly two poses have the same shift or beta: where an axis stops is
then another error in each pose. On a straight grid a whole line would have the error of one stop of the shift.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.geometry.arcs import arc_channels, etalon_sigmas_deg, lit_arc, lit_sides, polar_deg
from goniotwin.app.campaign.geometry.directions import Arc, PoseAngles, rig_sigma_deg, zenith_deg
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.schedule.file import OpenBeamTable, ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import AxisDescription
from goniotwin.drivers.motion import within_limits
from goniotwin.twin.optics.geometry.coordinates import (
    SPECULAR_AZIMUTH_DEG,
    TOLERANCE_DEG,
    incidence_deg,
    opposite_sigma_deg,
    round_deg,
)

LEAST_SIGMA_DEG = 10.0
"""Below this incidence a turn of beta moves a photodiode too little to scan the beam."""
MOST_ASIDE_DEG = 2.0
"""How far from the schedule's sigma a scan may be, where the arc's shift does not reach further."""
MAX_POSES = 1_000_000
"""Limit of the poses of all scans: a campaign has no more rows."""


@dataclass(frozen=True)
class BeamScan:
    """One scan. Angles in degrees; arrays have one element for each pose.

    `sigma_deg` is the incidence of the schedule, `at_deg` that of the scan and of the etalon: it differs where the arc's shift
    cannot scan about the photodiode at sigma. `photodiode` is its number, on the arc `arc`; it sees the etalon in
    `etalon_pose` as it sees the beam in the middle pose, number `middle` of `poses` (n, 4). `polar_deg` and `azimuth_deg` are
    the directions of the photodiode, on a square grid with steps of `step_deg`, turned so that a step along one side goes by
    `turned` of a step along the other.
    """

    sigma_deg: float
    at_deg: float
    arc: Arc
    photodiode: int
    etalon_pose: PoseAngles
    poses: Floats
    polar_deg: Floats
    azimuth_deg: Floats
    step_deg: float
    turned: float

    @property
    def middle(self) -> int:
        """The number of the middle pose."""
        return len(self.poses) // 2

    @property
    def solid_angle_sr(self) -> Floats:
        """The solid angle (n,) of each pose: sin(polar) dpolar dazimuth."""
        of_middle = np.radians(self.step_deg) ** 2 * (1.0 + self.turned**2)
        return np.asarray(np.sin(np.radians(self.polar_deg)) / np.sin(np.radians(self.at_deg)) * of_middle)

    @property
    def offset_deg(self) -> Floats:
        """Offsets (n, 2) from the nominal direction of the beam: along the arc, and across it towards growing azimuth."""
        along = self.polar_deg - self.at_deg
        across = (self.azimuth_deg - SPECULAR_AZIMUTH_DEG) * np.sin(np.radians(self.polar_deg))
        return np.stack([along, across], axis=1)

    def slopes(self, values: Floats) -> Floats:
        """Derivatives (n, 2) of values (n,) at the poses, per degree, along the arc and across it; none beyond the grid.

        By differences over two and four steps: of a beam nearly as narrow as a step they are right to a tenth.
        """
        grid = np.pad(values.reshape(self.side, self.side), 2)
        near, far = grid[1:-1, 2:-2], grid[:, 2:-2]
        down = (8.0 * (near[2:] - near[:-2]) - (far[4:] - far[:-4])) / 12.0
        near, far = grid[2:-2, 1:-1], grid[2:-2]
        right = (8.0 * (near[:, 2:] - near[:, :-2]) - (far[:, 4:] - far[:, :-4])) / 12.0
        step = self.step_deg * np.array([[1.0, -self.turned], [self.turned, 1.0]])  # along and across, of a step down, right
        return np.asarray(np.stack([down.ravel(), right.ravel()], axis=1) @ np.linalg.inv(step).T)

    @property
    def side(self) -> int:
        """Number of poses along a side of the grid."""
        return math.isqrt(len(self.poses))

    @property
    def edge(self) -> Ints:
        """Indices of the poses on the edge of the grid."""
        rows = np.divmod(np.arange(len(self.poses)), self.side)
        return np.flatnonzero(np.any([each % (self.side - 1) == 0 for each in rows], axis=0))


def beam_scans(file: ScheduleFile, rig: RigFile) -> list[BeamScan]:
    """The scans of a schedule, one for each sigma and arc that the etalon scales; none without `[open_beam]`.

    Two sigmas that the limits of the shift bring to one scan have it once, for the nearer one.
    Raises ValueError, with the key, where the rig cannot scan the beam of a sigma.
    """
    table = file.open_beam_scan
    if table is None:
        return []
    sigmas = {
        each: sigma
        for side in lit_sides(file)
        for sigma in file.scanned_sigmas_deg
        for each in etalon_sigmas_deg(file, rig_sigma_deg(sigma, side))
        if sigma >= LEAST_SIGMA_DEG
    }
    if not sigmas:
        raise ValueError(
            f"open_beam: no sigma_deg is {LEAST_SIGMA_DEG:g} deg or more, and below beta cannot scan the beam; "
            "remove [open_beam]"
        )
    if len(sigmas) * table.poses**2 > MAX_POSES:
        raise ValueError(
            f"open_beam: {len(sigmas)} scans x {table.poses} x {table.poses} poses are more than {MAX_POSES} rows; take fewer"
        )
    gamma = grid_values(file.gamma_deg)[0]
    scans = [_scan(rig, table, sigma, etalon_sigma, gamma) for etalon_sigma, sigma in sigmas.items()]
    nearest: dict[PoseAngles, BeamScan] = {}
    for each in sorted(scans, key=lambda scan: abs(scan.at_deg - scan.sigma_deg)):
        nearest.setdefault(each.etalon_pose, each)
    return [each for each in scans if nearest[each.etalon_pose] is each]


def scan_notes(file: ScheduleFile, rig: RigFile) -> Iterator[str]:
    """What a person should know of the scans: sigmas without one, and those that are scanned beside their sigma."""
    if file.open_beam_scan is None:
        return
    sigmas, scans = file.scanned_sigmas_deg, beam_scans(file, rig)
    low = [sigma for sigma in sigmas if sigma < LEAST_SIGMA_DEG]
    if low:
        listed = ", ".join(f"{sigma:g}" for sigma in low)
        yield (
            f"the open beam is not scanned at sigma {listed} deg: below {LEAST_SIGMA_DEG:g} deg beta cannot scan it, so that "
            "there is no closure"
        )
    scanned = {each.sigma_deg for each in scans}
    if shared := [sigma for sigma in sigmas if sigma >= LEAST_SIGMA_DEG and sigma not in scanned]:
        listed = ", ".join(f"{sigma:g}" for sigma in shared)
        yield (
            f"sigma {listed} deg has no scan of the open beam of its own: the limits of the arc's shift leave it that of "
            "another sigma"
        )
    aside = {each.sigma_deg: each.at_deg for each in scans if abs(each.at_deg - each.sigma_deg) > TOLERANCE_DEG}
    if aside:
        listed = ", ".join(f"{at:g} in place of {sigma:g}" for sigma, at in aside.items())
        yield (
            f"etalon and open beam are compared at sigma {listed} deg: there the limits of the arc's shift let one photodiode "
            "scan the whole beam"
        )


def scan_wavelength_nm(file: ScheduleFile) -> float:
    """The wavelength of the scans: the table's, or the middle one of the schedule."""
    table = file.open_beam_scan
    wavelengths = sorted(grid_values(file.wavelength_nm))
    if table is not None and table.wavelength_nm is not None:
        return table.wavelength_nm
    return wavelengths[(len(wavelengths) - 1) // 2]


def _scan(rig: RigFile, table: OpenBeamTable, sigma: float, etalon_sigma: float, gamma: float) -> BeamScan:
    """The scan of one incidence with the photodiode whose shift is nearest to it. Raises ValueError."""
    arc, half = lit_arc(etalon_sigma), 0.5 * (table.poses - 1)
    turned = 1.0 / (table.poses - 1)
    reach = half * table.step_deg * (1.0 + turned)
    low, high = _free_range(rig.axes.shift)
    if low + reach > high - reach + TOLERANCE_DEG:
        raise ValueError(
            f"open_beam: a scan of {table.poses} poses {table.step_deg:g} deg apart needs {2.0 * reach:g} deg of the shift, "
            f"and axes.shift has {high - low:g}; take fewer poses or a smaller step_deg"
        )
    needed = np.subtract(incidence_deg(etalon_sigma), polar_deg(rig, arc))
    shifts = np.clip(needed, low + reach, high - reach)
    aside = np.abs(round_deg(shifts - needed))
    if not aside.size or aside.min() > MOST_ASIDE_DEG:
        raise ValueError(
            f"open_beam: at sigma {sigma:g} deg no photodiode of the {arc} arc reaches the beam with all poses of its scan, "
            f"within {low:g} to {high:g} deg of axes.shift; remove that sigma, or [open_beam]"
        )
    best = int(np.lexsort([shifts, np.abs(shifts), aside])[0])
    shift = float(round_deg(shifts[best]))
    at = float(round_deg(polar_deg(rig, arc)[best] + shift))
    at_etalon = at if arc == "upper" else opposite_sigma_deg(at)
    step = table.step_deg / float(np.sin(np.radians(at)))
    down, right = (each.ravel() - half for each in np.indices((table.poses, table.poses)))
    poses = np.zeros((table.poses**2, 4))
    poses[:, 0], poses[:, 1] = gamma, opposite_sigma_deg(at_etalon)
    poses[:, 2] = round_deg(SPECULAR_AZIMUTH_DEG + step * (right - turned * down))
    poses[:, 3] = round_deg(shift + table.step_deg * (down + turned * right))
    for axis, column in ((rig.axes.sigma, 1), (rig.axes.beta, 2), (rig.axes.shift, 3)):
        if not np.all(within_limits(axis, poses[:, column])):
            first, last = poses[:, column].min(), poses[:, column].max()
            name = ("gamma", "sigma", "beta", "shift")[column]
            reach_deg = f"{first:g}" if first == last else f"{first:g} to {last:g}"
            raise ValueError(
                f"open_beam: at sigma {sigma:g} deg the scan needs {name} {reach_deg} deg, beyond the limits of axes.{name}; "
                "take fewer poses, remove that sigma, or remove [open_beam]"
            )
    polar = poses[:, 3] + polar_deg(rig, arc)[best]
    middle = len(poses) // 2
    zenith = zenith_deg(polar[middle : middle + 1], arc)
    if blocked_by_mirrors(rig, float(poses[middle, 1]), zenith, poses[middle : middle + 1, 2], gamma)[0]:
        raise ValueError(f"open_beam: at sigma {sigma:g} deg the mirror unit blocks the open beam; remove that sigma")
    etalon_pose = (gamma, at_etalon, SPECULAR_AZIMUTH_DEG, shift)
    photodiode = int(arc_channels(rig, arc)[best])
    return BeamScan(sigma, at, arc, photodiode, etalon_pose, poses, polar, poses[:, 2], table.step_deg, turned)


def _free_range(axis: AxisDescription) -> tuple[float, float]:
    """Lowest and highest target of an axis, with room for its approach against backlash."""
    return axis.lower_deg + max(0.0, -axis.overshoot_deg), axis.upper_deg - max(0.0, axis.overshoot_deg)
