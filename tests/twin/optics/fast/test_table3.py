"""Without noise and deviations the instrument blurs a Gaussian by its apertures alone (part of table 3 of the paper)."""

import numpy as np
import pytest

from goniotwin.twin.optics import Instrument, from_specular, gaussian, luminance_factor

# Percent, by sigma, for widths of 2, 5, 15, 30 deg: from an independent prototype without common code.
PROTOTYPE = {0.0: (4.32, 0.66, 0.07, 0.02), 30.0: (4.05, 0.62, 0.07, 0.02), 60.0: (3.47, 0.53, 0.06, 0.01)}


def relative_rms_percent(sigma_deg: float, width_deg: float, rays: int | None) -> float:
    """Formula 5 in the plane of incidence, steps of 0.5 deg, theta <= 2 widths, zenith angle < 85 deg, without obstruction."""
    theta = np.arange(-2.0 * width_deg, 2.0 * width_deg + 0.01, 0.5)
    directions = from_specular(sigma_deg, np.abs(theta), np.where(theta < 0.0, 180.0, 0.0))
    high = directions[:, 2] > np.cos(np.radians(85.0))
    # A peak luminance factor of 1, form one_over_e.
    sample = gaussian(width_deg, peak=1.0 / np.pi)
    simulated = luminance_factor(Instrument(obstruction=False), sigma_deg, directions[high], sample, rays=rays)
    theory = np.exp(-((theta[high] / width_deg) ** 2))
    relative = (simulated - theory) / (0.5 * (simulated + theory))
    return float(100.0 * np.sqrt(np.mean(relative**2)))


@pytest.mark.parametrize("sigma_deg", list(PROTOTYPE))
@pytest.mark.parametrize("column", range(4))
@pytest.mark.parametrize("rays", [None, 1024, pytest.param(1 << 15, marks=pytest.mark.long)])
def test_the_noise_free_rms_agrees_with_an_independent_prototype(sigma_deg: float, column: int, rays: int | None) -> None:
    width_deg = (2.0, 5.0, 15.0, 30.0)[column]
    assert relative_rms_percent(sigma_deg, width_deg, rays) == pytest.approx(PROTOTYPE[sigma_deg][column], abs=0.1)
