"""Rows of one sample as one arc sees them: the dataset of the steps between signals and points."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.geometry.arcs import ArcView
from goniotwin.app.campaign.measurement_model.quantity import Quantity
from goniotwin.app.campaign.reduction.arc_geometry import ArcGeometry
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.points import PLACE
from goniotwin.app.columns import (
    ColumnTable,
    Degrees,
    FlagColumn,
    IntegerColumn,
    NumberColumn,
    PerNanometre,
    Ratios,
)
from goniotwin.arrays import Flags, Floats, Ints

WAVELENGTH, SIGMA = PLACE.index("wavelength_nm"), PLACE.index("sigma_deg")
POSE = [PLACE.index(f"{axis}_deg") for axis in ("gamma", "sigma", "beta", "shift")]


@dataclass(frozen=True)
class ArcViews:
    """What rows see on one arc: `view` (rows,) is the index of each row's view in `views`; arrays for these.

    `etalon_sigma_deg` is sigma of the rig at the etalon, `blocked` (views, photodiodes) what the mirror unit blocks.
    """

    views: tuple[ArcView, ...]
    view: Ints
    etalon_sigma_deg: Floats
    blocked: Flags


def arcs_of_rows(places: Floats, geometry: ArcGeometry) -> list[tuple[Ints, ArcViews]]:
    """What rows at places (rows, 5) see on each arc, the upper one first; each pose once, however many rows have it.

    With each arc come the indices of the rows: an arc without photodiodes sees none.
    """
    poses = places[:, POSE]
    order = np.lexsort(poses.T)
    begins = np.ones(len(order), dtype=bool)
    begins[1:] = (poses[order[1:]] != poses[order[:-1]]).any(axis=1)
    which = np.empty(len(order), dtype=np.int64)
    which[order] = np.cumsum(begins) - 1
    angles = [tuple(each) for each in poses[order[begins]].tolist()]
    found: dict[bool, list[tuple[int, ArcView, Flags, float]]] = {}  # the upper arc is False
    for k, views in enumerate(geometry.views_at(angles)):
        for view, blocked in views:
            sigma = view.etalon_pose(angles[k])[1]
            found.setdefault(view.transmitted != view.back, []).append((k, view, blocked, sigma))
    arcs = []
    for _, seen in sorted(found.items(), key=lambda each: each[0]):
        of_pose = np.full(len(angles), -1)
        of_pose[[k for k, *_ in seen]] = np.arange(len(seen))
        view_of_row = of_pose[which]
        rows = np.flatnonzero(view_of_row >= 0)
        planned = ArcViews(
            tuple(each for _, each, _, _ in seen),
            view_of_row[rows],
            np.array([sigma for *_, sigma in seen]),
            np.stack([blocked for _, _, blocked, _ in seen]),
        )
        arcs.append((rows, planned))
    return arcs


def etalon_places(places: Floats, views: ArcViews) -> Floats:
    """Where the etalon is seen as rows at places (rows, 5) are seen on an arc: these places, with the etalon's sigma."""
    at_etalon = places.copy()
    at_etalon[:, SIGMA] = views.etalon_sigma_deg[views.view]
    return at_etalon


@dataclass(frozen=True)
class ArcRows(ColumnTable):
    """Rows of one sample as one arc sees them: the dataset of the steps. Arrays (rows, photodiodes), or (rows, 1) for a row.

    `numbers`, `places` and `mirrored` are those of `RowSignals`; `view` (rows,) is the index of each row's view in `views`.
    `estimate` is the value so far: the signal of the sample, its quotient by that of the etalon, the BSDF in 1/sr. `flags` are
    those so far, by their names in files. `sample`, `etalon` and the two signatures are the signals; a signature is 0 where it
    was not measured. `etalon_rows` (rows,) are the numbers of the etalon's rows, of several of one pose the first one. `share`
    is the signature's share of the sample's signal, NaN where it was not measured. `wavelength_slope`, `band_correction` and
    `stray_contrast` are those of BsdfPoints, NaN where they are unknown. `second` is the signal of the second standard, if
    there is one; `second_rows` (rows, photodiodes) are the numbers of its rows, -1 where it has no share in the scale.
    """

    numbers: IntegerColumn
    places: NumberColumn
    mirrored: FlagColumn
    etalon_rows: IntegerColumn
    views: tuple[ArcView, ...]
    view: IntegerColumn
    incidence_deg: Degrees
    blocked: FlagColumn
    estimate: Quantity
    sample: Signal
    etalon: Signal
    signature: Signal
    signature_at_etalon: Signal
    signature_measured: FlagColumn
    share: Ratios
    wavelength_slope: PerNanometre
    band_correction: Ratios
    stray_contrast: Ratios
    flags: Mapping[str, FlagColumn]
    second: Signal | None = None
    second_rows: IntegerColumn | None = None

    def column(self, name: str) -> Floats:
        """An array (rows, photodiodes) of the views: `polar`, `zenith`, `azimuth`, `theta`, `phi`."""
        return np.stack([getattr(view, name) for view in self.views])[self.view]

    def of_views(self, name: str) -> Flags:
        """A property (rows, 1) of the views: `back`, `transmitted`."""
        return np.array([getattr(view, name) for view in self.views])[self.view][:, None]

    def flagged(self, flags: Mapping[str, Flags]) -> "ArcRows":
        """The rows with further flags, by their names in files."""
        return replace(self, flags={**self.flags, **flags})
