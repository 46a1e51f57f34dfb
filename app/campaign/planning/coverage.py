"""What of a plan the etalon's certificate says nothing of: told before the start, and refused where that is everything."""

from collections.abc import Iterator

import numpy as np

from goniotwin.app.campaign.planning.directions import Seen, directions_seen
from goniotwin.app.campaign.planning.sides import incidence_deg
from goniotwin.app.campaign.schedule.certificate import Certificate, parse_certificate
from goniotwin.app.campaign.schedule.file import ScheduleDescription
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Floats


def uncovered(schedule: ScheduleDescription, seen: list[Seen]) -> Iterator[str]:
    """A warning where some of the directions, at some of the wavelengths, will have no value for want of a certificate."""
    file = schedule.file
    if schedule.certificate is None or file.certificate is None:
        return
    certificate = parse_certificate(schedule.certificate, file.certificate.file)
    wavelengths = np.array(grid_values(file.wavelength_nm))
    within = certificate.covers("wavelength_nm", wavelengths)
    directions, total = _covered(certificate, seen), sum(each.directions for each in seen)
    outside = [
        *([f"{(~within).sum()} of {within.size} wavelengths"] if not within.all() else []),
        *([f"{total - directions} of {total} directions"] if directions < total else []),
    ]
    if outside:
        yield (
            f"the etalon's certificate {file.certificate.file} says nothing of {' and '.join(outside)}, which will have no "
            f"value (uncertified): it holds for {certificate}; take one that holds for all, or measure less"
        )


def refuse_uncertified(schedule: ScheduleDescription, rig: RigFile, poses: Floats) -> None:
    """Raises UserError where the certificate says nothing of any direction, or wavelength; `poses` (n, 4) of the samples."""
    file = schedule.file
    if schedule.certificate is None or file.certificate is None:
        return
    certificate = parse_certificate(schedule.certificate, file.certificate.file)
    within = certificate.covers("wavelength_nm", np.array(grid_values(file.wavelength_nm)))
    what = "wavelengths"
    if within.any():
        what = "directions"
        if _covered(certificate, directions_seen(file, rig, poses)):
            return
    raise UserError(
        f"{schedule.name}: certificate.file: {file.certificate.file} says nothing of any of the schedule's {what}, so that "
        f"nothing would have a value: it holds for {certificate}; name one that holds for what is measured"
    )


def _covered(certificate: Certificate, seen: list[Seen]) -> int:
    """How many directions it says something of, at the wavelengths that it has."""
    count = 0
    for each in seen:
        if certificate.covers("incidence_deg", np.array([incidence_deg(each.sigma_deg)])).all():
            zenith, azimuth = each.angles_deg.T
            count += int((certificate.covers("zenith_deg", zenith) & certificate.covers("azimuth_deg", azimuth)).sum())
    return count
