"""What is measured of what is mounted: passes through poses and wavelengths, one after the other, and a row's name in each."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from goniotwin.app.campaign.planning.poses import Poses, etalon_poses, open_beam_poses, sample_poses
from goniotwin.app.campaign.planning.scan_grid import ScanGrid
from goniotwin.app.campaign.row import MIRRORED_MARK, NO_SAMPLE
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.rig import RigFile, monochromator_settings
from goniotwin.arrays import Floats, Ints


@dataclass(frozen=True)
class Pass:
    """Once through all points of a grid with one sample. `purpose` and `ending` tell its rows from others of that pose."""

    sample: str
    poses: Poses
    grid: ScanGrid
    purpose: str = ""
    ending: str = ""

    @cached_property
    def _names(self) -> tuple[list[str], list[str], list[str]]:
        poses = [
            f"{self.sample}{self.purpose}/sigma {sigma:.9g}/gamma {gamma:.9g}/beta {beta:.9g}/shift {shift:.9g}/"
            for gamma, sigma, beta, shift in self.poses.angles.tolist()
        ]
        endings = [f" nm{MIRRORED_MARK if mirrored else ''}{self.ending}" for mirrored in self.poses.mirrored.tolist()]
        return poses, [f"{wavelength:.9g}" for wavelength in self.grid.wavelengths_nm.tolist()], endings

    def identities(self, points: Ints) -> list[str]:
        """Of points by their numbers: stable, whatever the order."""
        poses, wavelengths, endings = self._names
        pairs = zip(*(each.tolist() for each in np.divmod(points, len(wavelengths))), strict=True)
        return [poses[pose] + wavelengths[wavelength] + endings[pose] for pose, wavelength in pairs]


def mountings(file: ScheduleFile, rig: RigFile) -> list[list[Pass]]:
    """The passes by what is mounted, the etalon first, nothing last. Raises ValueError, naming the key."""
    wavelengths = np.array(grid_values(file.wavelength_nm))
    of_samples = sample_poses(file, rig)
    of_etalon = etalon_poses(file, of_samples)
    filters = monochromator_settings(rig).wheel.numbers(wavelengths)
    grid = ScanGrid(of_samples.angles, wavelengths, filters)
    etalon_grid = grid if of_etalon is of_samples else ScanGrid(of_etalon.angles, wavelengths, filters)
    endings = ["", *(f"/repeat {k}" for k in range(2, file.repeats + 1))]
    found = [[Pass(file.etalon, of_etalon, etalon_grid, ending=ending) for ending in endings]]
    found += [[Pass(sample, of_samples, grid, ending=ending) for ending in endings] for sample in file.samples]
    # The poses of the etalon hold those at which reflected light is measured; in transmitted light the beam itself is seen.
    empty = [Pass(NO_SAMPLE, of_etalon, etalon_grid, ending=ending) for ending in endings] if file.signature else []
    if file.open_beam:
        beam = open_beam_poses(file, rig)
        poses = Poses(beam, np.zeros(len(beam), dtype=bool), 0)
        empty.append(Pass(NO_SAMPLE, poses, ScanGrid(beam, wavelengths, filters), purpose="/open beam"))
    return [*found, empty] if empty else found


def drift_point(file: ScheduleFile) -> Floats | None:
    """Pose and wavelength (5,) of the drift checks; None where there are none."""
    drift = file.drift
    if drift is None:
        return None
    return np.array([drift.gamma_deg, drift.sigma_deg, drift.beta_deg, drift.shift_deg, drift.wavelength_nm])
