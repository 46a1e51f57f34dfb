"""What each arc looks at in a pose: where its photodiodes look, and whether they see light reflected or transmitted."""

from dataclasses import dataclass

import numpy as np

from goniotwin.app.rig import RigFile
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics import arc_direction, to_specular

Pose = tuple[float, float, float, float]


@dataclass(frozen=True)
class ArcView:
    """One arc in one pose, one element a photodiode; angles in degrees.

    `channels` are the photodiodes' numbers. `zenith` and `azimuth` are of the directions in the rig's frame, `theta` and `phi`
    about the specular direction or, `transmitted`, about the direction straight on. `back`: the light comes from behind;
    then the sample is taken as turned about x, so that the angles are those of its back. `polar` and `turned` are zenith and
    azimuth from the normal of the side that the arc is on, the azimuth from the plane of incidence's half with the light.
    """

    channels: Ints
    zenith: Floats
    azimuth: Floats
    theta: Floats
    phi: Floats
    polar: Floats
    back: bool
    transmitted: bool

    def etalon_pose(self, pose: Pose) -> Pose:
        """Where this arc sees the etalon as it sees the sample, but lit from the arc's own side."""
        gamma, sigma, beta, shift = pose
        return (gamma, 180.0 - sigma, beta, shift) if self.transmitted else pose

    def incidence_deg(self, pose: Pose) -> float:
        """From the normal of the side that is lit."""
        return 180.0 - pose[1] if self.back else pose[1]


def arc_views(rig: RigFile, pose: Pose) -> list[ArcView]:
    """Of the upper and of the lower arc, those that there are."""
    table = rig.photodiodes
    upper = np.arange(len(table.upper_deg))
    lower = len(upper) + np.arange(len(table.lower_deg))
    views = [(upper, table.upper_deg, False), (lower, table.lower_deg, True)]
    return [_view(channels, np.array(polar, dtype=float), pose, low) for channels, polar, low in views if len(channels)]


def _view(channels: Ints, at_rest: Floats, pose: Pose, lower: bool) -> ArcView:
    _, sigma, beta, shift = pose
    signed = at_rest + shift
    azimuth = np.full(signed.size, beta)
    # The arc at a zenith below 0 looks at the other side of the normal.
    azimuth = np.mod(np.where(signed < 0.0, azimuth + 180.0, azimuth), 360.0)
    polar = np.abs(signed)
    back = sigma > 90.0
    transmitted = lower is not back
    seen = arc_direction(polar, azimuth, lower=lower)
    if back:
        seen = seen * np.array([1.0, -1.0, -1.0])
    if transmitted:
        seen = seen * np.array([1.0, 1.0, -1.0])
    theta, phi = to_specular(180.0 - sigma if back else sigma, seen)
    zenith = 180.0 - polar if lower else polar
    return ArcView(channels, zenith, azimuth, theta, phi, polar, back, transmitted)
