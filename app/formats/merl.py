"""Binary files of the MERL database (Matusik and others 2003): a BRDF in red, green and blue over half and difference angles.

Three 32-bit counts, 90, 90 and 180, then doubles: the red plane, green, blue, each [theta_h, theta_d, phi_d]. theta_h is
90 (i / 90)^2 deg at the index i, theta_d and phi_d are in steps of 1 deg; phi_d ends before 180 by reciprocity. A number times
1/1500, 1.15/1500 and 1.66/1500 is the BRDF in 1/sr; a negative one is a direction without a value. Source: the database's own
reader, BRDFRead.cpp, which takes the cell's number as it is; here values are linear between the cells, as at their lower edge.
(Public readers that give a cell an angle differ: its lower edge, or its middle, half a cell on.) Those that interpret negative
numbers, as dj_brdf, take all three colours as 0 where one is negative; here each colour has its own mask.

Only read: no independent program reads this format without the same source.
"""

import math
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.file import FormatError, StrPath, open_file
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import from_specular, light_direction

COUNTS = (90, 90, 180)
HEADER = np.array(COUNTS, dtype="<i4").tobytes()
COLOURS = ("red", "green", "blue")
SCALES = np.array([1.0, 1.15, 1.66]) / 1500.0
SIZE = len(HEADER) + 8 * len(COLOURS) * math.prod(COUNTS)
SIGMA_DEG = np.arange(0.0, 86.0, 5.0)
PHI_DEG = np.arange(0.0, 361.0, 5.0)
THETA_DEG = 180.0 * (np.arange(91) / 90.0) ** 2
"""In the plane of incidence theta is twice theta_h: the nodes of the file."""


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is one of MERL."""
    return head.startswith(HEADER)


def read(path: StrPath) -> BsdfFile:
    """Read a file onto specular coordinates. Raises FormatError."""
    with open_file(path, SIZE) as content:
        raw = content.read()
    if not raw.startswith(HEADER):
        counts = " x ".join(str(each) for each in np.frombuffer(raw[: len(raw[:12]) // 4 * 4], dtype="<i4").tolist())
        wrong = f"is not a file of MERL: its counts are {counts or 'missing'}, not 90 x 90 x 180"
        raise FormatError(path, wrong, "give one of the database's .binary files")
    if len(raw) != SIZE:
        raise FormatError(path, f"has {len(raw)} bytes, not {SIZE}", "it is cut short: copy it again")
    cells = np.frombuffer(raw, dtype="<f8", offset=len(HEADER)).reshape(len(COLOURS), *COUNTS)
    if not np.isfinite(cells).all():
        raise FormatError(path, "has numbers that are not finite", "it is damaged: copy it again")
    values = np.zeros((len(COLOURS), 1, SIGMA_DEG.size, PHI_DEG.size, THETA_DEG.size))
    known = np.zeros(values.shape, dtype=bool)
    for k, sigma in enumerate(SIGMA_DEG.tolist()):
        out = from_specular(sigma, THETA_DEG[None, :], PHI_DEG[:, None]).reshape(-1, 3)
        found, valid = _interpolate(cells, *half_difference(light_direction(sigma), out))
        valid = valid & (out[:, 2] > 0.0)
        shape = (len(COLOURS), PHI_DEG.size, THETA_DEG.size)
        values[:, 0, k] = np.where(valid, found * SCALES[:, None], 0.0).reshape(shape)
        known[:, 0, k] = valid.reshape(shape)
    comments = (
        f"MERL: {Path(path).name}; isotropic and reciprocal by its format, in red, green and blue",
        "0 in the place of a direction without a value, and below the horizon; these are marked as not measured",
    )
    return BsdfFile(
        (
            BsdfTable(
                SIGMA_DEG,
                PHI_DEG,
                THETA_DEG,
                values,
                colours=COLOURS,
                known=known,
                comments=comments,
                sample=Path(path).stem,
            ),
        )
    )


def half_difference(light: Floats, out: Floats) -> tuple[Floats, Floats, Floats]:
    """theta_h, theta_d and phi_d (n,) in deg, phi_d from 0 to 360, of a direction of light (3,) and others (n, 3)."""
    half = light + out
    half = half / np.maximum(np.linalg.norm(half, axis=1), 1e-300)[:, None]
    theta_h = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
    phi_h = np.arctan2(half[:, 1], half[:, 0])
    # The light, turned by -phi_h about the normal and by -theta_h about the y axis.
    x = np.cos(phi_h) * light[0] + np.sin(phi_h) * light[1]
    y = np.cos(phi_h) * light[1] - np.sin(phi_h) * light[0]
    x, z = np.cos(theta_h) * x - np.sin(theta_h) * light[2], np.sin(theta_h) * x + np.cos(theta_h) * light[2]
    return np.degrees(theta_h), np.degrees(np.arctan2(np.hypot(x, y), z)), np.degrees(np.arctan2(y, x)) % 360.0


def _interpolate(cells: Floats, theta_h: Floats, theta_d: Floats, phi_d: Floats) -> tuple[Floats, Flags]:
    """Numbers (3, n), linear between the cells, and whether (3, n) all of them have a value."""
    places = (90.0 * np.sqrt(np.clip(theta_h / 90.0, 0.0, 1.0)), theta_d, phi_d % 180.0)
    total = np.zeros((cells.shape[0], theta_h.size))
    valid = np.ones(total.shape, dtype=bool)
    for corner in range(8):
        weight = np.ones(theta_h.size)
        index = []
        for axis, (place, count) in enumerate(zip(places, COUNTS, strict=True)):
            low = np.minimum(place.astype(np.int64), count - 1)
            share, upper = place - low, corner >> axis & 1
            weight = weight * (share if upper else 1.0 - share)
            index.append((low + upper) % count if axis == 2 else np.minimum(low + upper, count - 1))
        at = cells[:, index[0], index[1], index[2]]
        valid &= (at >= 0.0) | (weight == 0.0)
        total += weight * at
    return total, valid
