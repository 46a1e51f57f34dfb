"""The state of the light at the sample: degree and azimuth of its linear polarisation at each sigma, for this rig's mirrors.

The monochromator's light is fixed in the rig, and has its azimuth about the axis of sigma. All three mirrors have one plane of
incidence, through that axis and the light's direction at the sample, at right angles to the sample's. So their s is the
sample's p, and their p the sample's s, at every sigma; they turn against the monochromator with sigma. The phase between both
that metal adds is neglected: it takes from the linear polarisation at 45 deg, U, and leaves Q.
"""

import numpy as np

from goniotwin.app.rig.light import LightTable
from goniotwin.arrays import Floats

MIRRORS = 3


def light_state(light: LightTable, sigma_deg: Floats) -> tuple[Floats, Floats]:
    """Q and U (n,) of the light at the sample over its intensity, at sigmas (n,) of the rig.

    Q is the share in the sample's s less that in its p; U that at 45 deg from s towards p less that at -45 deg.
    """
    turned = 2.0 * np.radians(light.azimuth_deg - sigma_deg)
    of_s, of_p = light.mirror_p**MIRRORS, light.mirror_s**MIRRORS
    s = of_s * (1.0 + light.polarisation * np.cos(turned))
    p = of_p * (1.0 - light.polarisation * np.cos(turned))
    # Each reflection turns the sense of an azimuth round.
    cross = (-1.0) ** MIRRORS * 2.0 * np.sqrt(of_s * of_p) * light.polarisation * np.sin(turned)
    return np.asarray((s - p) / (s + p)), np.asarray(cross / (s + p))


def light_words(light: LightTable, sigma_deg: Floats) -> str:
    """Degree and azimuth at each of some sigmas, for a reader of values."""
    q, u = light_state(light, sigma_deg)
    degree, azimuth = np.hypot(q, u), np.degrees(0.5 * np.arctan2(u, q)) % 180.0
    states = [
        f"{100.0 * each:.1f} % at {angle:.0f} deg for sigma {sigma:g}"
        for sigma, each, angle in zip(sigma_deg.tolist(), degree.tolist(), azimuth.tolist(), strict=True)
    ]
    before = "" if light.polarisation else ", with unpolarised light before the mirrors"
    return f"the light at the sample is linearly polarised{before} (azimuth from the sample's s): {', '.join(states)}"
