"""The beam splitter divides the light between monitor and mirrors."""

import math

import pytest

from goniotwin.twin.optics.illumination.unit import CorrectionUnit


def test_the_monitor_receives_its_share_and_the_mirrors_the_rest_without_absorption() -> None:
    split = CorrectionUnit().split(2.0)
    assert split.monitor == pytest.approx(0.16)
    assert split.onwards == pytest.approx(1.82)
    lossless = CorrectionUnit(absorptance=0.0).split(2.0)
    assert lossless.monitor + lossless.onwards == pytest.approx(2.0)


def test_invalid_shares_and_fluxes_are_refused() -> None:
    with pytest.raises(ValueError, match="monitor_share is"):
        CorrectionUnit(monitor_share=-0.1)
    with pytest.raises(ValueError, match="absorptance is nan"):
        CorrectionUnit(absorptance=math.nan)
    with pytest.raises(ValueError, match="together: at most 1"):
        CorrectionUnit(0.6, 0.6)
    for flux in (-1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="leaving_flux"):
            CorrectionUnit().split(flux)
