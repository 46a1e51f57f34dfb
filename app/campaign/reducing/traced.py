"""What a virtual rig adds to its readings that no instrument has: the Monte Carlo error of light that was traced."""

from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.reducing.signals import Signal
from goniotwin.app.rig import RigFile

DETECTED = 5.0


def tracing_error(rig: RigFile) -> float | None:
    """Relative standard error to which half of the photodiodes are known; None where nothing is traced, or nobody says so."""
    if rig.twin is None or rig.twin.optics.estimator != "forward":
        return None
    return rig.twin.optics.forward_error


def with_tracing_error(found: Signal, rig: RigFile) -> Signal:
    """A row's signal with the variance of the paths: these are counted as photons are, so it goes as the signal.

    That of the median of the photodiodes that get light is stated in the rig file. Where a lobe is drawn in several ways its
    tails are known better than this says.
    """
    error = tracing_error(rig)
    lit = found.ratio > DETECTED * np.sqrt(found.variance)
    if error is None or not lit.any():
        return found
    paths = error**2 * float(np.median(found.ratio[lit])) * np.abs(found.ratio)
    return replace(found, variance=found.variance + paths)
