"""Lists of angles that a reader of a table needs, and the share of the light that a table scatters.

Other programs interpolate, and extrapolate linearly outside each list: a value becomes negative beyond the last angle (libbsdf,
LinearInterpolator). So the tables that they read go from sigma 0 to 90, theta 0 to 180 and round phi.
"""

import re
from collections.abc import Collection
from dataclasses import replace
from typing import TypeVar

import numpy as np

from goniotwin.app.formats.content import RegularTable
from goniotwin.app.formats.numerals import format_number
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, fold_azimuth, round_deg, wrap_azimuth

COVERED = "not in the data: "
REPEATED = re.compile(r"(psi|sigma|theta) (\S+) repeated to (0|90|180|360)")
FINE_THETA_DEG, FINE_PHI_DEG = 0.25, 1.0
"""Widest steps of an integral over the hemisphere."""
INTERPOLATED = re.compile(r"(psi|phi) interpolated at 0 and 360")
WIDEST = 1.5
WIDEST_DEG = 90.0
"""A list goes round if the step from its last angle to the first is at most so many times its widest step, and so wide."""
_Table = TypeVar("_Table", BsdfTable, RegularTable)
_AXES = {"psi_deg": 1, "sigma_deg": 2, "phi_deg": 3, "theta_deg": 4}


def covered(table: BsdfTable, *, whole_turn: bool = False, lists: Collection[str] = ("psi", "sigma", "theta")) -> BsdfTable:
    """The table with values repeated, as comments then state: of psi 0 at 360, where the list goes round; the first and the
    last of sigma and theta to 0 and 90, and to 0 and 180.

    A list that goes round without 0 gets it, interpolated; else phi is as in `closed`.
    A table that covers these ranges is returned as it is; only `lists` are looked at.
    """
    table = closed(table, whole_turn=whole_turn)
    added = []
    for word in ("psi", "phi"):
        if (word == "phi" or word in lists) and _goes_round(angles := getattr(table, f"{word}_deg")):
            table = _with_ends(table, f"{word}_deg", angles)
            added.append(f"{word} interpolated at 0 and 360")
    if "psi" in lists and table.psi_deg[0] == 0.0 and 180.0 < table.psi_deg[-1] < 360.0:
        table = _inserted(table, "psi_deg", table.psi_deg.size, 360.0, 0)
        added.append("psi 0 repeated to 360")
    for word, end in (("sigma", 90.0), ("theta", 180.0)):
        first, last = getattr(table, f"{word}_deg")[[0, -1]]
        if word in lists and first > 0.0:
            table = repeated(table, f"{word}_deg", 0.0)
            added.append(f"{word} {format_number(first)} repeated to 0")
        if word in lists and last < end:
            table = repeated(table, f"{word}_deg", end)
            added.append(f"{word} {format_number(last)} repeated to {end:g}")
    return replace(table, comments=(*table.comments, f"{COVERED}{', '.join(added)}")) if added else table


def repeated(table: BsdfTable, name: str, end_deg: float) -> BsdfTable:
    """The table with the values at the first or the last angle of a list at `end_deg`, too, if that is beyond it.

    They count as not measured.
    """
    angles = getattr(table, name)
    if angles[0] <= end_deg <= angles[-1]:
        return table
    return _inserted(table, name, 0, end_deg, 0) if end_deg < angles[0] else _inserted(table, name, angles.size, end_deg, -1)


def uncovered(table: _Table) -> _Table:
    """The table of a file without what `covered` or `covered_regular` has added, as its comments state."""
    comments = []
    for line in table.comments:
        steps = line.removeprefix(COVERED).split(", ") if line.startswith(COVERED) else []
        if not steps or not all(REPEATED.fullmatch(each) or INTERPOLATED.fullmatch(each) for each in steps):
            comments.append(line)
            continue
        for word in INTERPOLATED.findall(line):
            inner = getattr(table, f"{word}_deg", np.zeros(0))[1:-1]
            if _goes_round(inner):
                table = _taken(table, f"{word}_deg", inner, np.arange(1, inner.size + 1))
        for word, angle, end in REPEATED.findall(line):
            angles: Floats | None = getattr(table, f"{word}_deg", None)
            last = end != "0"
            if angles is None or angles.size < 2 or angles[[0, -1][last]] != float(end):
                continue
            if format_number(angles[0 if word == "psi" else [1, -2][last]]) == angle:
                columns = np.arange(angles.size)[:-1] if last else np.arange(angles.size)[1:]
                table = _taken(table, f"{word}_deg", angles[columns], columns)
    return replace(table, comments=tuple(comments))


def closed(table: BsdfTable, *, whole_turn: bool = False) -> BsdfTable:
    """A plane-symmetric table with phi from 0 to 180, or one of the whole turn that has the values at phi 0 at 360, too.

    A plane-symmetric table of another range becomes one of the whole turn, and so does every one with `whole_turn`.
    """
    mirrored = table.phi_deg[-1] <= 180.0
    if mirrored and (whole_turn or table.phi_deg[0] > 0.0 or table.phi_deg[-1] < 180.0):
        table, mirrored = _unfolded(table), False
    if not mirrored and table.phi_deg[0] == 0.0 and table.phi_deg[-1] < 360.0:
        table = _inserted(table, "phi_deg", table.phi_deg.size, 360.0, 0)
    return table


def _goes_round(angles_deg: Floats) -> bool:
    """Whether a list without 0 and 360 goes round the whole turn."""
    if angles_deg.size < 3 or angles_deg[0] <= 0.0 or angles_deg[-1] >= 360.0:
        return False
    return is_whole_turn(angles_deg) and bool(360.0 - angles_deg[-1] + angles_deg[0] <= WIDEST_DEG)


def is_whole_turn(angles_deg: Floats) -> bool:
    """Whether azimuths (n,), at least two, go round: the step from the last to the first is hardly wider than the others."""
    return bool(360.0 - angles_deg[-1] + angles_deg[0] <= WIDEST * np.diff(angles_deg).max())


def is_one_sided(azimuth_deg: Floats) -> bool:
    """Whether azimuths (n,), from the light's, are all on one side of the plane of incidence; in it they are on both."""
    folded = round_deg(fold_azimuth(azimuth_deg))
    aside = wrap_azimuth(azimuth_deg)[(folded > 0.0) & (folded < HALF_TURN_DEG)] < HALF_TURN_DEG
    return bool(aside.all() or not aside.any())


def _with_ends(table: BsdfTable, name: str, angles_deg: Floats) -> BsdfTable:
    """The table with the values between the last and the first angle of a list at 0 and at 360."""
    axis = _AXES[name]
    share = angles_deg[0] / (360.0 - angles_deg[-1] + angles_deg[0])  # of the last angle's
    extended = _taken(
        table, name, np.concatenate([[0.0], angles_deg, [360.0]]), np.pad(np.arange(angles_deg.size), 1, mode="wrap")
    )
    for each in ("values", "u", "known"):
        array = getattr(extended, each)
        if array is None:
            continue
        along = np.moveaxis(array.copy(), axis, 0)
        last, first = along[0].copy(), along[-1].copy()
        along[0] = along[-1] = last & first if each == "known" else share * last + (1.0 - share) * first
        extended = replace(extended, **{each: np.moveaxis(along, 0, axis)})
    return extended


def held(values: Floats) -> tuple[Floats, Flags]:
    """Values (..., theta) with a number where they are NaN, and where they are not: (values, known).

    A missing value is that at the next smaller theta, else at the next larger one; a row without any is 0.
    """
    known = ~np.isnan(values)
    if known.all():
        return values, known
    places = np.broadcast_to(np.arange(values.shape[-1]), values.shape)
    before = np.maximum.accumulate(np.where(known, places, -1), axis=-1)
    first = np.argmax(known, axis=-1)[..., None]
    found = np.take_along_axis(values, np.where(before >= 0, before, first), axis=-1)
    return np.where(known.any(axis=-1, keepdims=True), found, 0.0), known


def covered_regular(table: RegularTable) -> RegularTable:
    """The same for regular factors: sigma from 0 to 90."""
    sigma, added = table.sigma_deg, []
    columns = list(range(sigma.size))
    if sigma[0] > 0.0:
        columns, added = [0, *columns], [f"sigma {format_number(sigma[0])} repeated to 0"]
    if sigma[-1] < 90.0:
        columns, added = [*columns, sigma.size - 1], [*added, f"sigma {format_number(sigma[-1])} repeated to 90"]
    if not added:
        return table
    angles = np.unique([0.0, *sigma, 90.0])
    u = None if table.u is None else table.u[:, :, columns]
    comments = (*table.comments, f"{COVERED}{', '.join(added)}")
    return replace(table, sigma_deg=angles, values=table.values[:, :, columns], u=u, comments=comments)


def _unfolded(table: BsdfTable) -> BsdfTable:
    """The table with its mirror image in the plane of incidence."""
    turn = np.unique(np.concatenate([table.phi_deg, 360.0 - table.phi_deg]))
    folded = np.abs(table.phi_deg[:, None] - np.minimum(turn, 360.0 - turn)).argmin(axis=0)
    return _taken(table, "phi_deg", turn, folded)


def _inserted(table: BsdfTable, name: str, place: int, angle: float, source: int) -> BsdfTable:
    angles = getattr(table, name)
    columns = np.insert(np.arange(angles.size), place, source % angles.size)
    found = _taken(table, name, np.insert(angles, place, angle), columns)
    if name in ("psi_deg", "phi_deg"):  # measured there, too
        return found
    known = np.ones(found.values.shape, dtype=np.bool_) if found.known is None else found.known.copy()
    np.moveaxis(known, _AXES[name], 0)[place] = False
    return replace(found, known=known)


def _taken(table: _Table, name: str, angles: Floats, columns: Ints) -> _Table:
    arrays = {each: getattr(table, each, None) for each in ("values", "u", "known")}
    taken = {each: np.take(array, columns, _AXES[name]) for each, array in arrays.items() if array is not None}
    return replace(table, **{name: angles}, **taken)  # type: ignore[arg-type]  # fields by name


def scattered_share(table: BsdfTable) -> Floats:
    """Share of the light (channel, psi, sigma) that is scattered into the hemisphere, up to the last theta of the table.

    The values are linear between the nodes, as readers take them.
    """
    shares = np.empty(table.values.shape[:3])
    for n, sigma in enumerate(table.sigma_deg):
        weights = share_weights(float(sigma), table.phi_deg, table.theta_deg)
        shares[:, :, n] = np.einsum("cpft,ft->cp", table.values[:, :, n], weights)
    return shares


def share_weights(axis_deg: float, phi_deg: Floats, theta_deg: Floats, turn_deg: float | None = None) -> Floats:
    """Weights (phi, theta) of the values in their integral times the cosine of the observed direction, over the solid angle.

    `axis_deg` is the polar angle of the specular direction. Where the other half is the mirror image, the turn is 180 deg;
    without `turn_deg` that is where phi ends at 180.
    """
    turn = turn_deg or (180.0 if phi_deg[-1] <= 180.0 else 360.0)
    phi_edges = np.radians(np.linspace(0.0, turn, round(turn / FINE_PHI_DEG) + 1))
    steps = np.maximum(np.ceil(np.diff(theta_deg, prepend=0.0) / FINE_THETA_DEG).astype(int), 0)
    pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip([0.0, *theta_deg], theta_deg, steps, strict=False)]
    theta_edges = np.radians(np.concatenate([*pieces, theta_deg[-1:]]))
    if theta_edges.size < 2:
        return np.zeros((phi_deg.size, theta_deg.size))
    phi, theta = (0.5 * (edges[1:] + edges[:-1]) for edges in (phi_edges, theta_edges))
    axis = np.radians(axis_deg)
    cosine = np.cos(axis) * np.cos(theta) + np.sin(axis) * np.outer(np.cos(phi), np.sin(theta))
    area = np.outer(np.diff(phi_edges), -np.diff(np.cos(theta_edges))) * (360.0 / turn)
    by_phi, by_theta = _hats(np.degrees(phi), phi_deg, round_trip=turn == 360.0), _hats(np.degrees(theta), theta_deg)
    weights: Floats = by_phi.T @ (np.maximum(cosine, 0.0) * area) @ by_theta
    return weights


def _hats(at: Floats, nodes: Floats, *, round_trip: bool = False) -> Floats:
    """Weights (at, nodes) of a linear interpolation, held outside the nodes, or going round 360 deg."""
    weights = np.zeros((at.size, nodes.size))
    columns = np.arange(nodes.size)
    if round_trip and nodes[-1] - nodes[0] < 360.0:
        nodes, columns = np.concatenate([nodes[-1:] - 360.0, nodes, nodes[:1] + 360.0]), np.pad(columns, 1, mode="wrap")
    right = np.clip(np.searchsorted(nodes, at), 1, max(nodes.size - 1, 1))
    if nodes.size == 1:
        return weights + 1.0
    share = np.clip((at - nodes[right - 1]) / (nodes[right] - nodes[right - 1]), 0.0, 1.0)
    np.add.at(weights, (np.arange(at.size), columns[right - 1]), 1.0 - share)
    np.add.at(weights, (np.arange(at.size), columns[right]), share)
    return weights
