"""Directional-hemispherical reflectance (or transmittance) of a sample's values, with its uncertainty.

Of a journal it is that of `goniotwin budget --reflectance`, with the covariance of the values. Of a file the covariance is not
known: what a value shares with its neighbours (`u_shared`) is taken as shared by all values, the rest as independent; where
the file does not divide u, all of it counts as shared, so that u is at most too large.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.studies.budget import Budget
from goniotwin.app.campaign.studies.budget import reflectance as measured_reflectance
from goniotwin.app.campaign.studies.reflectance import Setting, covers_half_sphere, quadrature
from goniotwin.app.data.interpolation import RECTANGULAR, direction_grid, nodes_of, own_and_shared
from goniotwin.app.data.values import EQUAL, LightSetting, Measured, SampleData, ValueWithU, neighbours
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import RegularTable
from goniotwin.app.formats.coverage import share_weights
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, TURN_DEG, round_deg


@dataclass(frozen=True, eq=False)
class Rings:
    """Directions of values for `quadrature`; the azimuth is counted from the light's."""

    zenith_deg: Floats
    azimuth_deg: Floats
    good: Flags


def reflectance(data: SampleData, light: LightSetting, place: str) -> ValueWithU:
    """The reflectance (or transmittance) in one light. Raises UserError where the directions do not cover the half sphere."""
    if data.measured is not None:
        found = _of_journal(data.measured, light, place)
        return ValueWithU(
            found.value, found.u, "1", (f"covariance: of all inputs of the journal's values; {found.title}", *found.about)
        )
    grid = direction_grid(data, light)
    result = None
    if grid is None or grid.frame == "rings" or light.sigma_deg == 0.0:  # at normal incidence both frames are one
        folded = data.values.isotropic or (grid is not None and grid.grid.mirrored)
        result = _of_rings(data, light, folded=folded)
    if result is None and grid is not None and grid.frame == "specular":
        result = _of_grid(data, light, place)
    if result is None:
        raise UserError(
            f"{place}, {light}: the directions do not cover the half sphere on rings of one polar angle, so there is no "
            "reflectance"
        )
    for part in data.regular:
        if part.transmitted == light.transmitted and part.back == light.back:
            result = _with_regular(result, part, light, place)
    return result


def regular_factor(part: RegularTable, light: LightSetting, place: str) -> tuple[float, float]:
    """The regular factor and its standard uncertainty at a light, linear between incidences. Raises UserError."""
    names: tuple[str | float, ...] = part.colours or part.wavelengths_nm or (math.nan,)
    channel = [k for k, each in enumerate(names) if _is_channel(each, light)]
    psi = np.flatnonzero(np.abs(part.psi_deg - light.psi_deg) <= EQUAL) if part.psi_deg.size > 1 else np.zeros(1, dtype=int)
    sigma = part.sigma_deg
    if not channel or not psi.size or not sigma[0] - EQUAL <= light.sigma_deg <= sigma[-1] + EQUAL:
        raise UserError(f"{place} has no regular factor at {light}; {neighbours(sigma, light.sigma_deg)} deg")
    row = part.values[channel[0], psi[0]]
    u = np.full(sigma.size, np.nan) if part.u is None else part.u[channel[0], psi[0]]
    return float(np.interp(light.sigma_deg, sigma, row)), float(np.interp(light.sigma_deg, sigma, u))


def _is_channel(name: str | float, light: LightSetting) -> bool:
    if isinstance(name, str):
        return name == light.channel
    return math.isnan(name) or math.isnan(light.wavelength_nm) or abs(name - light.wavelength_nm) <= EQUAL


def _of_journal(measured: Measured, light: LightSetting, place: str) -> Budget:
    points, k = measured.points, int(light.index[0])
    setting = Setting(
        float(points.wavelength_nm[k]), float(points.sigma_deg[k]), float(points.gamma_deg[k]), light.transmitted, light.index
    )
    return measured_reflectance(measured.settings, place, points, setting)


def _of_rings(data: SampleData, light: LightSetting, *, folded: bool) -> ValueWithU | None:
    """Of directions on rings, `folded` where mirror images count; None where they do not cover the half sphere."""
    values, index = data.values, light.index
    rings = Rings(values.polar_deg[index], values.azimuth_deg[index] - values.psi_deg[index], data.good[index])
    rule = quadrature(rings, "isotropic" if folded else "anisotropic")
    if not rule.hemisphere:
        return None
    bsdf = np.where(rule.weight != 0.0, values.values[index], 0.0)
    filled = float(np.sum((rule.obstructed + rule.extrapolated) * np.abs(bsdf)))
    return _sum(data, light, rule.weight, [rule.interpolation_error(values.values[index]), filled / RECTANGULAR], filled)


def _of_grid(data: SampleData, light: LightSetting, place: str) -> ValueWithU:
    """Of the nodes of a table, linear between them; a node without a value has that of the nearest in its row."""
    index = light.index[np.isfinite(data.values.values[light.index])]
    nodes = nodes_of("specular", light.sigma_deg, data.theta_deg[index], data.phi_deg[index], data.values.isotropic)
    theta, column = np.unique(nodes.polar_deg, return_inverse=True)
    phi, row = np.unique(nodes.azimuth_deg, return_inverse=True)
    node = np.full((phi.size, theta.size), -1)
    node[row, column] = np.arange(index.size)
    if theta[0] == 0.0:
        node[:, 0] = node[0, 0]
    for each in node:  # below the horizon a table has no value
        if (each >= 0).any():
            there = np.flatnonzero(each >= 0)
            each[:] = each[there[np.argmin(np.abs(theta[:, None] - theta[there]), axis=1)]]
    whole = node[(node >= 0).all(axis=1)]
    if whole.shape != node.shape or theta[0] > 0.0:
        raise UserError(f"{place}, {light}: the table does not begin at theta 0 in all half planes, so there is no reflectance")
    fine, beyond = grid_weights(theta, phi, light.sigma_deg, mirrored=nodes.mirrored)
    step = float(np.diff(theta)[theta[:-1] < 90.0 + light.sigma_deg].max(initial=0.0))
    if not covers_half_sphere(step, nodes.azimuth_step_deg, beyond):
        raise UserError(
            f"{place}, {light}: the table ends at theta {theta[-1]:g} deg, and {100.0 * beyond:.0f} % of the half sphere is "
            f"beyond it; its nodes are up to {step:g} deg apart in theta and {nodes.azimuth_step_deg:g} deg in phi: they do "
            "not cover the half sphere, so there is no reflectance"
        )
    coarse = np.zeros(fine.shape)
    keep = np.unique([*range(0, theta.size, 2), theta.size - 1])
    coarse[:, keep] = grid_weights(theta[keep], phi, light.sigma_deg, mirrored=nodes.mirrored)[0]
    weight: Floats = np.bincount(node.ravel(), weights=fine.ravel(), minlength=index.size).astype(np.float64)
    values = data.values.values[index]
    of_coarse = float(np.sum(coarse * values[node]))
    total = float(np.sum(fine * values[node]))
    outside = beyond * math.pi * float(np.mean(np.abs(values[node[:, -1]])))
    not_measured = ~data.good[index]
    filled = outside + float(np.sum(np.abs((weight * values)[not_measured])))
    return _sum(data, replace(light, index=index), weight, [abs(total - of_coarse) / 3.0, filled / RECTANGULAR], filled)


def grid_weights(theta_deg: Floats, phi_deg: Floats, sigma_deg: float, *, mirrored: bool) -> tuple[Floats, float]:
    """Integrals (phi, theta) in sr over the half sphere, with the cosine, of functions that are 1 at one node of a grid.

    They are linear in theta and phi. Second: the share of the half sphere that is beyond the last theta; its weight is that of
    the last node.
    """
    turn = HALF_TURN_DEG if mirrored or phi_deg.size == 1 else TURN_DEG
    weights = share_weights(sigma_deg, phi_deg, theta_deg, turn)
    if theta_deg[-1] >= HALF_TURN_DEG:
        return weights, 0.0
    beyond = 1.0 - float(weights.sum()) / math.pi
    weights = share_weights(sigma_deg, phi_deg, np.append(theta_deg, HALF_TURN_DEG), turn)
    weights[:, -2] += weights[:, -1]
    return weights[:, :-1], beyond


def _sum(data: SampleData, light: LightSetting, weight: Floats, errors: list[float], filled: float) -> ValueWithU:
    """The weighted sum of the values of a light, with `errors` besides those of the values; `filled` is of none of them."""
    used = weight != 0.0
    values = data.values.values[light.index][used]
    u, of_all = (np.asarray(each)[light.index][used] for each in (data.values.u, data.values.u_shared))
    total = float(np.sum(weight[used] * values))
    own, shared = own_and_shared(u, of_all)
    variance = float(np.sum((weight[used] * own) ** 2) + np.sum(weight[used] * shared) ** 2)
    return ValueWithU(
        total, math.sqrt(variance + math.fsum(each**2 for each in errors)), "1", tuple(_about(u, of_all, total, filled))
    )


def _about(u: Floats, u_shared: Floats, total: float, filled: float) -> Iterator[str]:
    if np.isnan(u).any():
        yield "u is not known: the file has no uncertainty for some of the values"
    elif (u_shared > 0.0).any():
        yield "covariance assumed: u_shared is common to all values, the rest of u is independent"
    else:
        yield "covariance assumed: u is common to all values, so that u is at most too large"
    if filled and total:
        yield f"{100.0 * abs(filled / total):.2f} % of it is of directions without a measured value"


def _with_regular(found: ValueWithU, part: RegularTable, light: LightSetting, place: str) -> ValueWithU:
    factor, u = regular_factor(part, light, place)
    about = f"{factor:.6g} of it is the regular part{'' if math.isfinite(u) else ', whose u is not known'}"
    total = math.hypot(found.u, 0.0 if math.isnan(u) else u)
    return ValueWithU(found.value + factor, total, found.unit, (*found.about, about))


def only_regular(data: SampleData, place: str, sigma_deg: float | None) -> ValueWithU:
    """The regular factor of a sample that has no values in 1/sr. Raises UserError."""
    if len(data.regular) != 1:
        raise UserError(
            f"{place} has {len(data.regular)} tables of regular factors and no values in 1/sr, so there is no one reflectance"
        )
    part = data.regular[0]
    if sigma_deg is None:
        raise UserError(f"sigma_deg: is missing; {place} has {', '.join(f'{each:g}' for each in part.sigma_deg[:8].tolist())}")
    if len(part.wavelengths_nm or part.colours or (None,)) > 1:
        raise UserError(
            f"{place} has regular factors of several wavelengths or colours and no values in 1/sr: take them from d.file"
        )
    light = LightSetting(
        math.nan,
        (part.colours or ("",))[0],
        float(round_deg(sigma_deg)),
        0.0,
        part.transmitted,
        part.back,
        np.zeros(0, dtype=np.int64),
    )
    factor, u = regular_factor(part, light, place)
    return ValueWithU(factor, u, "1", ("the regular part alone: the file has no values in 1/sr",))
