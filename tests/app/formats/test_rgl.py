"""Tensor files for Mitsuba: read by Mitsuba 3 itself, and by our own reader as Mitsuba does."""

import contextlib
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from goniotwin.app.data.conversion import Choice, convert_content
from goniotwin.app.formats import BsdfTable, FormatError, rgl
from goniotwin.app.formats.content import BsdfFile, RegularTable, nodes
from goniotwin.app.formats.registry import BSDF, format_named
from goniotwin.arrays import Floats
from goniotwin.twin.optics import evaluate, from_specular, light_direction, table_sample

SIGMAS = np.arange(0.0, 91.0, 15.0)
LOWEST = math.log(100.0)


def gaussian_table(width_deg: float, sigma_deg: Floats = SIGMAS, **more: Any) -> BsdfTable:
    """A Gaussian of a peak of 1, in steps of a fortieth of its width."""
    wide = min(4.0 * width_deg, 179.0)
    theta = np.concatenate([np.arange(0.0, wide, width_deg / 40.0), np.linspace(wide, 180.0, 40)])
    phi = np.array([0.0, 90.0, 180.0])
    values = np.broadcast_to(np.exp(-((theta / width_deg) ** 2)), (1, 1, sigma_deg.size, phi.size, theta.size))
    return BsdfTable(sigma_deg, phi, theta, values, **more)


def measured(path: Path) -> Any:
    """Mitsuba's plugin for a file, as a function of two directions (3,) and a wavelength: the BRDF in 1/sr."""
    mi = pytest.importorskip("mitsuba", reason="the extra `render` is not installed: no test by Mitsuba")
    mi.set_variant("scalar_spectral")
    plugin = mi.load_dict({"type": "measured", "filename": str(path)})
    at, context = mi.SurfaceInteraction3f(), mi.BSDFContext()

    def brdf(light: Floats, out: Floats, wavelength_nm: float = rgl.GREY_NM) -> float:
        at.wi, at.wavelengths = mi.Vector3f(*light.tolist()), [wavelength_nm] * 4
        return float(np.array(plugin.eval(context, at, mi.Vector3f(*out.tolist())))[0]) / float(out[2])

    return brdf


def turned(azimuth_deg: float, vector: Floats) -> Floats:
    cos, sin = math.cos(math.radians(azimuth_deg)), math.sin(math.radians(azimuth_deg))
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ vector


@pytest.mark.long
@pytest.mark.parametrize("width_deg", [2.0, 5.0, 15.0])
def test_mitsuba_agrees_with_our_interpolation_down_to_a_hundredth_of_the_peak(width_deg: float, tmp_path: Path) -> None:
    table = gaussian_table(width_deg)
    rgl.write(tmp_path / "gauss.bsdf", BsdfFile((table,)))
    brdf = measured(tmp_path / "gauss.bsdf")
    sample = table_sample(table.sigma_deg, table.phi_deg, table.theta_deg, table.values[0, 0])
    random = np.random.default_rng(3)
    found = 0
    while found < 1000:
        sigma, azimuth, phi = random.uniform([0.0, 0.0, 0.0], [60.0, 360.0, 360.0])
        theta = width_deg * math.sqrt(random.uniform(0.0, LOWEST))
        out = from_specular(sigma, theta, phi)
        if out[2] > 0.01:
            light, out = turned(azimuth, light_direction(sigma)), turned(azimuth, out)
            assert brdf(light, out) == pytest.approx(float(evaluate(sample, light, out)), rel=0.005)
            found += 1


@pytest.mark.long
def test_mitsuba_reads_values_azimuths_and_wavelengths(tmp_path: Path) -> None:
    """An anisotropic material of two wavelengths: the lobe is where psi and phi, counter-clockwise, put it."""
    sigma, phi, theta = np.array([29.0, 30.0]), np.arange(0.0, 361.0, 15.0), np.arange(0.0, 181.0, 3.0)
    psi = np.arange(0.0, 360.0, 30.0)
    shape = (psi.size, sigma.size, phi.size, theta.size)
    p, _, f, t = (np.broadcast_to(each, shape) for each in np.meshgrid(psi, sigma, phi, theta, indexing="ij"))
    towards = 1.0 + 0.2 * np.sin(np.radians(f)) * np.sin(np.radians(t)) + 0.3 * np.cos(np.radians(p - 60.0))
    table = BsdfTable(sigma, phi, theta, np.stack([towards, 2.0 * towards]), (450.0, 650.0), psi)
    rgl.write(tmp_path / "turned.bsdf", BsdfFile((table,)))
    brdf = measured(tmp_path / "turned.bsdf")
    for psi_deg, phi_deg, wavelength_nm in (
        (60.0, 90.0, 450.0),
        (60.0, 270.0, 650.0),
        (240.0, 90.0, 550.0),
        (330.0, 45.0, 650.0),
    ):
        theta_deg = 30.0
        expected = 1.0 + 0.1 * math.sin(math.radians(phi_deg)) + 0.3 * math.cos(math.radians(psi_deg - 60.0))
        light = turned(psi_deg, light_direction(30.0))
        out = turned(psi_deg, from_specular(30.0, theta_deg, phi_deg))
        factor = 1.0 + (wavelength_nm - 450.0) / 200.0
        assert brdf(light, out, wavelength_nm) == pytest.approx(factor * expected, rel=0.003)
    (read,) = rgl.read(tmp_path / "turned.bsdf").tables
    assert read.wavelengths_nm == (450.0, 650.0)
    assert read.psi_deg.tolist() == np.arange(0.0, 360.0, 10.0).tolist()
    k, j = int(np.argmin(np.abs(read.theta_deg - 30.0))), int(np.searchsorted(read.phi_deg, 90.0))
    at_60 = read.values[:, 6, read.sigma_deg.tolist().index(30.0), j, k]
    expected = 1.3 + 0.2 * math.sin(math.radians(read.theta_deg[k]))
    np.testing.assert_allclose(at_60, [expected, 2.0 * expected], rtol=0.003)


def brushed(light: Floats, out: Floats) -> Floats:
    """Brushed metal: a lobe over the half vector that is 2.5 times as wide along x as along y, and a diffuse part."""
    half = light + out
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    return np.asarray(0.1 + 2.0 * np.exp(-((half[..., 0] / 0.5) ** 2 + (half[..., 1] / 0.2) ** 2) / half[..., 2] ** 2))


def brushed_table() -> BsdfTable:
    """Of one sigma, at azimuths of the light in steps of 30 deg."""
    psi, phi, theta = np.arange(0.0, 360.0, 30.0), np.arange(0.0, 361.0, 10.0), np.arange(0.0, 181.0, 5.0)
    out = np.maximum(from_specular(40.0, theta, phi[:, None]), [-1.0, -1.0, 0.0])
    turns = [np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) for c, s in zip(*arc(psi), strict=True)]
    values = np.stack([brushed(turn @ light_direction(40.0), out @ turn.T) for turn in turns])
    return BsdfTable(np.array([40.0]), phi, theta, values[None, :, None], psi_deg=psi)


def half_angles(light: Floats, out: Floats) -> tuple[Floats, Floats]:
    """theta_m and phi_m, in the sample's frame."""
    half = light + out
    return np.arctan2(np.hypot(half[..., 0], half[..., 1]), half[..., 2]), np.arctan2(half[..., 1], half[..., 0])


def test_between_azimuths_of_the_light_a_lobe_stays_at_its_half_vectors() -> None:
    """Linear in psi at a theta and a phi, values between the azimuths would be off by up to 70 %."""
    samples = rgl.HalfVectorSamples(brushed_table())
    light = turned(15.0, light_direction(40.0))
    out = from_specular(0.0, np.linspace(0.0, 75.0, 30)[:, None], np.linspace(0.0, 350.0, 36))
    found, _ = samples.at(15.0, 40.0, *half_angles(light, out), [0])
    off = np.abs(found[0] / out[..., 2] / brushed(light, out) - 1.0)
    assert np.quantile(off, 0.95) < 0.06
    # What the steps of 5, 10 and 30 deg leave open is estimated from the table alone.
    assert np.quantile(samples.steps(), 0.95) == pytest.approx(np.quantile(off, 0.95), rel=0.3)


def test_a_conversion_reports_by_how_much_the_file_is_off(tmp_path: Path) -> None:
    done = convert_content(BsdfFile((constant(1.0),)), tmp_path / "white.bsdf", format_named("rgl", BSDF), Choice())
    assert [note.split(" up to ")[0].split(" about ")[0] for note in done.notes] == [
        "the file is off from the table by",
        "between its own nodes the table itself is known to",
    ]


@pytest.mark.long
def test_mitsuba_confirms_the_deviation_that_a_file_states(tmp_path: Path) -> None:
    table = brushed_table()
    notes = rgl.write(tmp_path / "brushed.bsdf", BsdfFile((table,)))
    assert set(notes) <= set(rgl.read(tmp_path / "brushed.bsdf").tables[0].comments)
    brdf, samples, random = measured(tmp_path / "brushed.bsdf"), rgl.HalfVectorSamples(table), np.random.default_rng(2)
    off = []
    for psi, polar, azimuth in random.uniform([0.0, 0.0, 0.0], [360.0, 75.0, 360.0], (1000, 3)).tolist():
        light, out = turned(psi, light_direction(40.0)), from_specular(0.0, polar, azimuth)
        theta_m, phi_m = half_angles(light, out[None])
        exact, _ = samples.at(psi, 40.0, theta_m[None], phi_m[None])
        off.append(abs(brdf(light, out) * float(out[2]) / float(exact.item()) - 1.0))
    (stated,) = (float(line.split(" up to ")[1].split()[0]) for line in notes if " up to " in line)
    assert 100.0 * np.quantile(off, 0.95) == pytest.approx(stated, rel=0.5)


def arc(azimuth_deg: Floats) -> tuple[Floats, Floats]:
    return np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))


def test_mitsuba_draws_directions_without_bias(tmp_path: Path) -> None:
    """Mean of value over density of drawn directions: the reflectance, here of a diffuser of 0.8, within four of its errors."""
    rgl.write(
        tmp_path / "white.bsdf",
        BsdfFile(
            (
                BsdfTable(
                    np.array([30.0]), np.array([0.0, 180.0]), np.array([0.0, 180.0]), np.full((1, 1, 1, 2, 2), 0.8 / math.pi)
                ),
            )
        ),
    )
    measured(tmp_path / "white.bsdf")
    import mitsuba as mi  # pyright: ignore[reportMissingImports]

    plugin: Any = mi.load_dict({"type": "measured", "filename": str(tmp_path / "white.bsdf")})
    at: Any = mi.SurfaceInteraction3f()
    context, random = mi.BSDFContext(), np.random.default_rng(1)
    at.wi, at.wavelengths = mi.Vector3f(0.5, 0.0, math.sqrt(0.75)), [rgl.GREY_NM] * 4
    weights = [np.array(plugin.sample(context, at, 0.5, mi.Point2f(*random.random(2).tolist()))[1])[0] for _ in range(1000)]
    assert np.mean(weights) == pytest.approx(0.8, abs=4.0 * float(np.std(weights)) / math.sqrt(len(weights)))


def constant(value: float, **more: Any) -> BsdfTable:
    sigma, phi, theta = np.array([0.0, 45.0, 90.0]), np.array([0.0, 180.0]), np.linspace(0.0, 180.0, 19)
    return BsdfTable(sigma, phi, theta, np.full((1, 1, 3, 2, 19), value), **more)


@given(st.floats(15.0, 60.0), st.floats(1e-6, 1e3), st.floats(0.0, 0.5))
@settings(deadline=None, max_examples=4, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_table_is_read_as_it_was_written(tmp_path: Path, width_deg: float, peak: float, asymmetry: float) -> None:
    table = gaussian_table(width_deg, np.array([39.0, 40.0]), generated=True, sample="paint")

    def factor(phi: Floats, theta: Floats) -> Floats:
        """Towards grazing the lobe is higher; at theta = 0 all phi are one direction."""
        return 1.0 + asymmetry * (phi[:, None] / 180.0) * np.minimum(theta / width_deg, 1.0)

    table = replace(table, values=peak * table.values * factor(table.phi_deg, table.theta_deg))
    path = tmp_path / "lobe.bsdf"
    rgl.write(path, BsdfFile((table,)))
    (read,) = rgl.read(path).tables
    assert (read.generated, read.sample, read.wavelengths_nm) == (True, "paint", None)
    assert rgl.recognise(path.read_bytes()[:4096])
    for sigma in (39.0, 40.0):
        k = read.sigma_deg.tolist().index(sigma)
        expected = peak * np.exp(-((read.theta_deg / width_deg) ** 2)) * factor(read.phi_deg, read.theta_deg)
        known = read.known is not None and read.known[0, 0, k] & (read.theta_deg < 3.0 * width_deg)
        assert np.abs(read.values[0, 0, k] - expected)[known].max() < 0.01 * peak


def test_a_warp_and_a_jacobian_are_read_as_mitsuba_reads_them(tmp_path: Path) -> None:
    """A file like those of the RGL: a warp that changes over half vector and sigma, ndf and sigma with a shape."""
    random = np.random.default_rng(5)
    theta_i, side = np.radians([5.0, 25.0, 70.0]), 9  # at normal incidence the azimuth of the light is none
    small: dict[str, Any] = {
        "description": np.frombuffer(b"made up", np.uint8),
        "theta_i": theta_i.astype("<f4"),
        "phi_i": np.zeros(1, "<f4"),
        "wavelengths": np.array([400.0, 600.0], "<f4"),
        "ndf": random.uniform(1.0, 4.0, (1, 7)).repeat(3, 0).astype("<f4"),
        "sigma": random.uniform(0.5, 1.0, (1, 6)).repeat(2, 0).astype("<f4"),
        "vndf": random.uniform(0.1, 2.0, (1, 3, 8, 11)).astype("<f4"),
        "jacobian": np.ones(1, np.uint8),
        "spectra": random.uniform(0.1, 1.0, (1, 3, 2, side, side)).astype("<f4"),
        "luminance": np.ones((1, 3, side, side), "<f4"),
    }
    write_fields(tmp_path / "rgl.bsdf", small)
    brdf = measured(tmp_path / "rgl.bsdf")
    (read,) = rgl.read(tmp_path / "rgl.bsdf").tables
    assert read.comments[0] == "made up"
    assert read.known is not None
    for k, sigma in enumerate(read.sigma_deg.tolist()):
        for j, i in random.integers([0, 5], [read.phi_deg.size, 120], (40, 2)).tolist():
            out = from_specular(sigma, read.theta_deg[i], read.phi_deg[j])
            # In the plane of incidence rounding decides between the first and the last row, which differ in this made-up file.
            if read.known[0, 0, k, j, i] and abs(out[1]) > 1e-6:
                expected = [brdf(light_direction(sigma), out, nm) for nm in (400.0, 600.0)]
                # Mitsuba computes in 32 bits: a step of its random numbers is 1e-4 of such a rough grid.
                np.testing.assert_allclose(read.values[:, 0, k, j, i], expected, rtol=2e-3)


def write_fields(path: Path, fields: dict[str, Any]) -> None:
    shapes = {name: (each.dtype.str.lstrip("|"), each.shape) for name, each in fields.items()}
    numbers = {kind: number for number, kind in rgl.TYPES.items()}
    header = rgl.MAGIC + rgl.VERSION + len(shapes).to_bytes(4, "little")
    at = len(header) + sum(13 + len(name) + 8 * len(shape) for name, (_, shape) in shapes.items())
    for name, (kind, shape) in shapes.items():
        header += len(name).to_bytes(2, "little") + name.encode() + len(shape).to_bytes(2, "little") + bytes([numbers[kind]])
        header += at.to_bytes(8, "little") + b"".join(each.to_bytes(8, "little") for each in shape)
        at += fields[name].nbytes
    path.write_bytes(header + b"".join(each.tobytes() for each in fields.values()))


@pytest.mark.parametrize(
    ("content", "wrong"),
    [
        (BsdfFile((constant(1.0, transmitted=True),)), "does not hold transmitted light"),
        (BsdfFile((constant(1.0, back=True),)), "does not hold light on the back"),
        (BsdfFile((constant(1.0), constant(2.0))), "one table on specular coordinates, and there are 2 parts"),
        (BsdfFile((nodes(constant(1.0)),)), "not scattered values"),
        (BsdfFile((RegularTable(np.zeros(1), np.ones((1, 1, 1))),)), "not scattered values or a regular factor"),
        (BsdfFile((replace(constant(1.0), colours=("X",)),)), "wavelengths, not the colours X"),
    ],
)
def test_what_the_format_does_not_hold_is_refused(content: BsdfFile, wrong: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=wrong):
        rgl.write(tmp_path / "no.bsdf", content)
    assert not list(tmp_path.iterdir())


def test_a_part_of_a_turn_is_refused(tmp_path: Path) -> None:
    table = constant(1.0)
    quarter = BsdfTable(
        table.sigma_deg, table.phi_deg, table.theta_deg, np.ones((1, 4, 3, 2, 19)), psi_deg=np.array([0.0, 30.0, 60.0, 90.0])
    )
    with pytest.raises(FormatError, match="0 to 90 deg, are not a whole turn"):
        rgl.write(tmp_path / "no.bsdf", BsdfFile((quarter,)))


@given(st.data())
@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_file_is_read_or_refused(tmp_path: Path, data: st.DataObject) -> None:
    source = tmp_path / "sound.bsdf"
    if not source.exists():
        small: dict[str, Any] = {
            "theta_i": np.zeros(1, "<f4"),
            "phi_i": np.zeros(1, "<f4"),
            "wavelengths": np.array([400.0], "<f4"),
            "ndf": np.ones((2, 2), "<f4"),
            "sigma": np.ones((2, 2), "<f4"),
            "vndf": np.ones((1, 1, 2, 2), "<f4"),
            "spectra": np.ones((1, 1, 1, 2, 2), "<f4"),
            "jacobian": np.ones(1, np.uint8),
        }
        write_fields(source, small)
        rgl.read(source)
    raw = bytearray(source.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    damaged = tmp_path / "damaged.bsdf"
    damaged.write_bytes(bytes(raw[: data.draw(st.integers(0, len(raw)))]))
    with contextlib.suppress(FormatError):
        rgl.read(damaged)
