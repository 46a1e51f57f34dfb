"""Throughputs of a few detectors in plain numpy, ray by ray: an independent computation for tests of the kernels.

Geometry as 4 x 4 matrices of homogeneous columns; mirrors as they are met on the way, with a division for each.
"""

import math

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Deviation, Instrument, Scatterer, evaluate
from goniotwin.twin.optics.fast.bundle import ray_bundle

ALONG_Y = np.array([0.0, 1.0, 0.0])


def rotation(deviation: Deviation) -> Floats:
    """Rotation (3, 3) about x, then y, then z."""
    result = np.eye(3)
    for axis, degrees in enumerate((deviation.rx_deg, deviation.ry_deg, deviation.rz_deg)):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        one = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        one[i, i], one[i, j], one[j, i], one[j, j] = c, -s, s, c
        result = one @ result
    return result


def rigid(turn: Floats, shift: Floats) -> Floats:
    """Matrix (4, 4) of a rotation followed by a shift."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = turn, shift
    return result


def within(axes: Floats, deviation: Deviation) -> tuple[Floats, Floats]:
    """Rotation and shift in the rig's frame of a deviation given along `axes`, one per row."""
    shift = np.array([deviation.x_mm, deviation.y_mm, deviation.z_mm])
    return axes.T @ rotation(deviation) @ axes, axes.T @ shift


class PlainScene:
    """The instrument at a pose: mirrors (3, 4, 3) and the exit pupil in the rig's frame, and the map to the sample's frame."""

    def __init__(self, instrument: Instrument, sigma_deg: float, gamma_deg: float) -> None:
        self.instrument = instrument
        sigma, d = math.radians(sigma_deg), instrument.mirror_distance_mm
        light, across = np.array([math.sin(sigma), 0.0, math.cos(sigma)]), np.array([-math.cos(sigma), 0.0, math.sin(sigma)])
        unit_turn, unit_shift = within(np.array([-across, ALONG_Y, light]), instrument.deviation("mirror_unit"))
        self.mirrors = []
        path = [ALONG_Y, light, ALONG_Y, -light]  # directions of the light before and after each mirror
        for k, centre in enumerate((-d * ALONG_Y, d * (light - ALONG_Y), d * light)):
            normal = (path[k + 1] - path[k]) / math.sqrt(2.0)
            # The second axis lies in the plane of the unit; of mirrors 1 and 2 it is that of a left-handed frame.
            own = np.array([across, (-1.0 if k < 2 else 1.0) * np.cross(normal, across), normal])
            turn, shift = within(own, instrument.deviation(f"mirror_{k + 1}"))
            u, v, n = own @ turn.T @ unit_turn.T
            self.mirrors.append((unit_turn @ (centre + shift) + unit_shift, n, u, v))
        deviation = instrument.deviation("pupil")
        self.pupil_axes = rotation(deviation)[:, [0, 2]].T * instrument.pupil_radius_mm
        self.pupil = np.array([deviation.x_mm, deviation.y_mm, deviation.z_mm]) - (d + instrument.pupil_to_mirror_mm) * ALONG_Y
        gamma = rotation(Deviation(rz_deg=gamma_deg))
        sample, shift = within(np.eye(3), instrument.deviation("sample"))
        self.to_rig = rigid(gamma @ sample, gamma @ shift)
        self.back = math.cos(sigma) < 0.0
        if self.back:
            self.to_rig = self.to_rig @ rigid(np.diag([1.0, -1.0, -1.0]), np.zeros(3))

    def detectors(self, directions: Floats) -> tuple[Floats, Floats]:
        """Centres and axes (n, 3) in the sample's frame."""
        turn, shift = within(np.eye(3), self.instrument.deviation("arc"))
        axes = directions @ turn.T
        centres = self.instrument.arc_radius_mm * axes + shift
        for k, d in enumerate(axes):
            level = np.cross([0.0, 0.0, 1.0], d)
            level = level / np.linalg.norm(level) if np.any(level) else ALONG_Y
            turned, moved = within(np.array([np.cross(level, d), level, d]), self.instrument.deviation("sensor"))
            axes[k], centres[k] = turned @ d, centres[k] + moved
        inverse = np.linalg.inv(self.to_rig)
        return centres @ inverse[:3, :3].T + inverse[:3, 3], axes @ inverse[:3, :3].T

    def passes(self, on_sample: Floats, at_pupil: Floats) -> tuple[Floats, Flags]:
        """Points (n, 3) of the pupil's image, and whether the rays from it to the sample's points meet all three mirrors.

        The light starts at the pupil and is reflected by one mirror after the other.
        """
        images = at_pupil.copy()
        for centre, normal, _, _ in self.mirrors:
            images -= 2.0 * ((images - centre) @ normal)[:, None] * normal
        along, place, meets = images - on_sample, on_sample, np.ones(len(images), dtype=bool)
        for centre, normal, u, v in self.mirrors[::-1]:  # backwards, from the sample
            distance = (centre - place) @ normal / (along @ normal)
            place = place + distance[:, None] * along
            half = 0.5 * self.instrument.mirror_side_mm
            meets &= (distance > 0.0) & (np.abs((place - centre) @ u) <= half) & (np.abs((place - centre) @ v) <= half)
            along = along - 2.0 * (along @ normal)[:, None] * normal
        return images, meets

    def hidden(self, on_sample: Floats, towards: Floats, length: Floats) -> Flags:
        """Whether a mirror with its mount blocks the rays from the sample's points within their length."""
        result, half = np.zeros(len(towards), dtype=bool), 0.5 * self.instrument.blocking_side_mm
        for centre, normal, u, v in self.mirrors:
            distance = (centre - on_sample) @ normal / (towards @ normal)
            place = on_sample + distance[:, None] * towards - centre
            result |= (distance > 0.0) & (distance < length) & (np.abs(place @ u) <= half) & (np.abs(place @ v) <= half)
        return result


def plain_throughput(
    instrument: Instrument,
    sigma_deg: float,
    directions: npt.ArrayLike,
    scatterer: Scatterer,
    rays: int,
    gamma_deg: float = 0.0,
) -> Floats:
    """What `throughput` gives with as many `rays`, of the same rays, (n,) in m^2 sr."""
    scene, unit = PlainScene(instrument, sigma_deg, gamma_deg), np.asarray(directions, float)
    centres, axes = scene.detectors(unit / np.linalg.norm(unit, axis=1)[:, None])
    sine, half = math.sin(math.radians(0.5 * instrument.field_deg)), 0.5 * instrument.spot_side_mm
    radius, result = 0.5 * instrument.detector_diameter_mm, np.zeros(len(unit))
    _, u0, v0, a0, b0, p0, q0 = ray_bundle(rays, sine)
    ends = [(s * u0, s * v0, s * p0, s * q0, t * a0, t * b0) for s in (1.0, -1.0) for t in (1.0, -1.0)]
    hole_u, hole_v, p, q, pupil_a, pupil_b = np.concatenate(ends, axis=1)
    for n, (centre, d) in enumerate(zip(centres, axes, strict=True)):
        level = np.cross([0.0, 0.0, 1.0], d)
        level = level / np.linalg.norm(level) if np.any(level) else ALONG_Y
        away = np.cross(level, d)
        towards = d + p[:, None] * away + q[:, None] * level

        # Where a ray from the point (x, y) of the sample crosses the disc's plane, along its two axes: linear in x and y.
        def crossing(x: Floats, y: Floats, centre: Floats = centre, d: Floats = d) -> tuple[Floats, Floats]:
            from_hole = centre - np.stack([x, y, np.zeros_like(x)], axis=1)
            return p * (from_hole @ d) - from_hole @ away, q * (from_hole @ d) - from_hole @ level  # noqa: B023

        zero, one = np.zeros_like(p), np.ones_like(p)
        a, b = crossing(zero, zero)
        au, bu = crossing(one, zero)[0] - a, crossing(one, zero)[1] - b
        av, bv = crossing(zero, one)[0] - a, crossing(zero, one)[1] - b
        square, area = au**2 + bu**2, au * bv - av * bu
        middle, reach = (bu * a - au * b) / area, radius * np.sqrt(square) / np.abs(area)
        low, high = np.maximum(-half, middle - reach), np.minimum(half, middle + reach)
        v, share = 0.5 * (low + high + (high - low) * hole_v), high - low
        beside = (a + av * v) * bu - (b + bv * v) * au
        middle = -((a + av * v) * au + (b + bv * v) * bu) / square
        reach = np.sqrt(np.maximum(radius**2 * square - beside**2, 0.0)) / square
        low, high = np.maximum(-half, middle - reach), np.minimum(half, middle + reach)
        u = 0.5 * (low + high + (high - low) * hole_u)
        weight = np.abs(area) * np.where((share > 0.0) & (high > low), share * (high - low), 0.0) / rays
        point = np.stack([u, v, np.zeros_like(u)], axis=1)
        length = (centre - point) @ d
        turn, shift = scene.to_rig[:3, :3], scene.to_rig[:3, 3]
        images, meets = scene.passes(
            point @ turn.T + shift,
            scene.pupil + pupil_a[:, None] * scene.pupil_axes[0] + pupil_b[:, None] * scene.pupil_axes[1],
        )
        normal = np.cross(*scene.pupil_axes) / instrument.pupil_radius_mm**2
        for _, mirror, _, _ in scene.mirrors:
            normal = normal - 2.0 * (normal @ mirror) * mirror
        light = (images - shift) @ turn - point
        distance = np.linalg.norm(light, axis=1)
        light /= distance[:, None]
        weight = weight * np.maximum(light[:, 2], 0.0) * np.abs(light @ (normal @ turn)) / distance**2 * meets
        if instrument.obstruction:
            weight = weight * ~scene.hidden(point @ turn.T + shift, towards @ turn.T, length)
        observer = towards / np.linalg.norm(towards, axis=1)[:, None]
        if scene.back:
            light, observer = light * [1.0, -1.0, -1.0], observer * [1.0, -1.0, -1.0]
        result[n] = np.sum(weight * evaluate(scatterer, light, observer))
    assert isinstance(instrument.mirror_reflectance, float)
    seen_sr, pupil_mm2 = math.pi * sine**2, math.pi * instrument.pupil_radius_mm**2
    return result * seen_sr * pupil_mm2 * 1e-6 * instrument.mirror_reflectance**3
