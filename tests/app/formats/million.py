"""A million values of each format: `python -m tests.app.formats.million FORMAT VALUES` prints what writing and reading take."""

import json
import math
import os
import sys
import tempfile
from pathlib import Path

import numpy as np

from goniotwin.app.data.conversion import Choice, convert_content
from goniotwin.app.formats import BsdfTable, registry
from goniotwin.app.formats.content import BsdfFile, RegularTable, ScatteredBsdf
from goniotwin.arrays import Floats
from tests import used

VALUES = 1_000_000
FORMATS = ("ddr", "ddt", "sdr", "ssdd", "zemax", "astm", "rgl", "rgl_4d", "bird", "archive", "csv")
"""Names of formats; `rgl_4d` is an anisotropic table as `rgl`."""


def lobe(theta_deg: Floats) -> Floats:
    """A Gaussian of 15 deg, and a diffuser of a tenth of its peak."""
    return np.asarray(0.1 + np.exp(-((theta_deg / 15.0) ** 2)))


def made(name: str, values: int) -> BsdfFile:
    """A content of about so many values that a format holds."""
    if name == "sdr":
        side = round(math.sqrt(values))
        sigma, wavelengths = np.linspace(0.0, 90.0, side), tuple(np.linspace(380.0, 780.0, side).tolist())
        return BsdfFile((RegularTable(sigma, np.full((side, 1, side), 0.5), wavelengths),))
    if name in ("astm", "bird", "csv"):
        random = np.random.default_rng(1)
        polar, azimuth = random.uniform([[0.0], [0.0]], [[85.0], [360.0]], (2, values))
        sigma = random.choice(np.arange(0.0, 61.0, 10.0), values)
        bsdf, zero = lobe(np.abs(polar - sigma)), np.zeros(values)
        return BsdfFile((ScatteredBsdf(sigma, zero, polar, azimuth, bsdf, 0.01 * bsdf, wavelength_nm=zero + 550.0),))
    psi, sigma = (
        (np.arange(0.0, 360.0, 15.0), np.array([0.0, 30.0, 60.0]))
        if name == "rgl_4d"
        else (np.zeros(1), np.arange(0.0, 91.0, 10.0))
    )
    phi = np.arange(0.0, 361.0, 2.0 if psi.size == 1 else 5.0)
    theta = np.linspace(0.0, 180.0, round(values / (psi.size * sigma.size * phi.size)))
    shape = (1, psi.size, sigma.size, phi.size, theta.size)
    towards = 1.0 + 0.3 * np.sin(np.radians(theta)) * np.cos(np.radians(phi))[:, None]
    grid = np.broadcast_to(lobe(theta) * towards, shape) * (1.0 + 0.1 * np.cos(np.radians(psi))[:, None, None, None])
    return BsdfFile((BsdfTable(sigma, phi, theta, grid, psi_deg=psi, transmitted=name == "ddt"),))


def measure(name: str, values: int) -> dict[str, float]:
    """Write and read a file, in this process."""
    content = made(name, values)
    form = registry.format_named(name.removesuffix("_4d"), registry.BSDF)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"million{form.suffixes[0]}"
        found = {"values": float(sum(part.values.size for part in content.parts))}
        for what, act in (("write", lambda: convert_content(content, path, form, Choice())), ("read", lambda: form.read(path))):
            before = os.times()
            act()
            after = os.times()
            spent = after.user + after.system - before.user - before.system
            found |= {f"{what}_s": spent, f"{what}_wall_s": after.elapsed - before.elapsed}
        found["file_mb"] = path.stat().st_size / 1e6
    return found


def measure_apart(name: str, values: int) -> dict[str, float]:
    """The same in a process of its own, with its greatest memory in MB."""
    done = used.run(sys.executable, "-m", "tests.app.formats.million", name, str(values))
    assert done.status == 0, done.stderr
    found: dict[str, float] = json.loads(done.stdout)
    return found | {"peak_mb": done.peak_bytes / 1e6}


if __name__ == "__main__":
    print(json.dumps(measure(sys.argv[1], int(sys.argv[2]))))
