"""The kernels of this package, called once and as small as can be: they are loaded, or compiled, before they are needed."""

import numpy as np

from goniotwin.app.campaign.measurement_model.lit_share import LitEnsemble, LitModes
from goniotwin.app.campaign.measurement_model.slopes import Directions, slopes_of


def call_kernels() -> None:
    """Call the kernels of slopes, and of the lit share of the hole."""
    same, angles = np.zeros(5, dtype=np.int64), np.linspace(0.1, 0.2, 5)
    slopes_of(Directions(same, same, same, *[angles] * 6), angles, angles, 0.1)
    one = np.ones((1, 1))
    LitModes(LitEnsemble(one, one, one, one[0]), one).quantiles(one, one[0], (0.1, 0.9))
