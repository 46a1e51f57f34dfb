"""Mountings: the passes that are measured of each mounted sample, and the identities of their rows."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from goniotwin.app.campaign.geometry.open_beam import beam_scans, scan_wavelength_nm
from goniotwin.app.campaign.planning.poses import Poses, etalon_poses, open_beam_poses, sample_poses
from goniotwin.app.campaign.planning.scan_grid import ScanGrid
from goniotwin.app.campaign.row import MIRRORED_MARK, NO_SAMPLE
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Flags, Floats, Ints


@dataclass(frozen=True)
class Pass:
    """All points of a grid once, with one sample.

    `purpose` and `suffix` distinguish its rows from rows of other passes at the same pose.
    """

    sample: str
    poses: Poses
    grid: ScanGrid
    purpose: str = ""
    suffix: str = ""

    @cached_property
    def _names(self) -> tuple[list[str], list[str], list[str]]:
        """The three parts of an identity: by pose, by wavelength, by pose."""
        poses = [
            f"{self.sample}{self.purpose}/sigma {sigma:.9g}/gamma {gamma:.9g}/beta {beta:.9g}/shift {shift:.9g}/"
            for gamma, sigma, beta, shift in self.poses.angles.tolist()
        ]
        suffixes = [f" nm{MIRRORED_MARK if mirrored else ''}{self.suffix}" for mirrored in self.poses.mirrored.tolist()]
        return poses, [f"{wavelength:.9g}" for wavelength in self.grid.wavelengths_nm.tolist()], suffixes

    def identities(self, points: Ints) -> list[str]:
        """Identities of the rows of points, given by number: they do not depend on the order."""
        poses, wavelengths, suffixes = self._names
        pairs = zip(*(each.tolist() for each in np.divmod(points, len(wavelengths))), strict=True)
        return [poses[pose] + wavelengths[wavelength] + suffixes[pose] for pose, wavelength in pairs]


def mountings(file: ScheduleFile, rig: RigFile) -> list[list[Pass]]:
    """The passes of each mounting: the standards first, the empty sample unit last. Raises ValueError with the key."""
    wavelengths = np.array(grid_values(file.wavelength_nm))
    of_samples = sample_poses(file, rig)
    scans = beam_scans(file, rig)
    of_etalon = etalon_poses(file, of_samples, [each.etalon_pose for each in scans])
    filters = rig.monochromator.wheel.numbers(wavelengths)
    grid = ScanGrid(of_samples.angles, wavelengths, filters)
    etalon_grid = grid if of_etalon is of_samples else ScanGrid(of_etalon.angles, wavelengths, filters)
    suffixes = ["", *(f"/repeat {k}" for k in range(2, file.repeats + 1))]
    mounted = [[Pass(name, of_etalon, etalon_grid, suffix=suffix) for suffix in suffixes] for name in file.standards]
    mounted += [[Pass(sample, of_samples, grid, suffix=suffix) for suffix in suffixes] for sample in file.samples]
    # The poses of the etalon include those of reflected light; in transmitted light a photodiode would see the beam itself.
    empty = [Pass(NO_SAMPLE, of_etalon, etalon_grid, suffix=suffix) for suffix in suffixes] if file.signature else []
    beams: list[tuple[Floats, Flags]] = []
    if scans:
        scanned = wavelengths == scan_wavelength_nm(file)
        beams.append((np.concatenate([each.poses for each in scans]), scanned))
        beams.append((np.stack([each.poses[each.middle] for each in scans]), ~scanned))
    elif file.open_beam:
        beams.append((open_beam_poses(file, rig), np.ones(len(wavelengths), dtype=bool)))
    for angles, at in beams:
        if at.any():
            poses = Poses(angles, np.zeros(len(angles), dtype=bool), 0)
            empty.append(Pass(NO_SAMPLE, poses, ScanGrid(angles, wavelengths[at], filters[at]), purpose="/open beam"))
    return [*mounted, empty] if empty else mounted


def drift_point(file: ScheduleFile) -> Floats | None:
    """Pose and wavelength (5,) of the drift checks; None without drift checks."""
    drift = file.drift
    if drift is None:
        return None
    return np.array([drift.gamma_deg, drift.sigma_deg, drift.beta_deg, drift.shift_deg, drift.wavelength_nm])
