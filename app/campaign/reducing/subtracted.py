"""What is said of the instrument's own light, its signature: what it has been subtracted from."""

from collections.abc import Collection, Iterable, Mapping

import numpy as np

from app.campaign.reducing.arcs import Pose
from app.campaign.reducing.points import BsdfPoints

Key = tuple[float | None, Pose]


def subtracted(samples: Mapping[str, BsdfPoints], etalon: Iterable[Key], signature: Collection[Key]) -> list[str]:
    """A note, where it has been subtracted from anything; `etalon` and `signature` are wavelengths and poses of both.

    Transmitted light itself is never freed of it: without a sample there is the beam.
    """
    reflected = any(np.isfinite(points.signature).any() for points in samples.values())
    scale = any(points.transmitted.any() for points in samples.values()) and any(key in signature for key in etalon)
    light = [
        *(["reflected light"] if reflected else []),
        *(["the etalon's light that transmitted light is scaled by"] if scale else []),
    ]
    told = "the instrument's own light was measured without a sample and has been subtracted from"
    return [f"{told} {' and from '.join(light)}"] if light else []
