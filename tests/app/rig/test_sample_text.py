"""Samples in one line: the scattering models they give, and error messages of one line."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.errors import UserError
from goniotwin.app.formats import DdrTable, ZemaxBsdf, write_ddr, write_zemax
from goniotwin.app.rig.samples import parse_sample, table_files
from goniotwin.twin.optics import albedo, evaluate, from_specular, gaussian, lambertian, light_direction, sum_samples

SIGMA, PHI, THETA = np.array([0.0, 60.0]), np.array([0.0, 180.0]), np.array([0.0, 20.0, 180.0])
VALUES = np.array([0.3, 0.2, 0.1]) * np.ones((1, 2, 2, 3))
LIGHT = light_direction(30.0)
OBSERVERS = from_specular(30.0, np.array([0.0, 5.0, 20.0]), np.array([0.0, 90.0, 180.0]))


def _error_message(text: str) -> str | None:
    """The error message for a text; None for a valid sample, whose values must be finite."""
    try:
        sample = parse_sample(text)
    except UserError as error:
        return str(error)
    return None if np.all(np.isfinite(evaluate(sample, LIGHT, OBSERVERS))) else "not finite\n"


shares = st.floats(0.01, 0.45)
widths = st.floats(0.5, 40.0)


@settings(deadline=None)
@given(widths, st.sampled_from(["one_over_e", "half_width"]), st.sampled_from(["luminance", "intensity"]), shares)
def test_a_gaussian_has_the_properties_of_its_keys(width: float, form: str, quantity: str, share: float) -> None:
    text = f"gaussian:width_deg={width!r},form={form},quantity={quantity},reflectance={share!r}"
    made = parse_sample(text)
    meant = gaussian(width, form, quantity, reflectance=share)  # type: ignore[arg-type]
    assert made.name == text
    np.testing.assert_array_equal(evaluate(made, LIGHT, OBSERVERS), evaluate(meant, LIGHT, OBSERVERS))


@settings(deadline=None)
@given(shares, widths, shares)
def test_a_sum_does_not_depend_on_order_and_white_space(white: float, width: float, share: float) -> None:
    parts = [f"lambertian:reflectance={white!r}", f"gaussian:width_deg={width!r},reflectance={share!r}"]
    meant = evaluate(sum_samples(lambertian(white), gaussian(width, reflectance=share)), LIGHT, OBSERVERS)
    for text in ("+".join(parts), " + ".join(reversed(parts)), f" {parts[0]} +{parts[1]} "):
        np.testing.assert_allclose(evaluate(parse_sample(text), LIGHT, OBSERVERS), meant, rtol=1e-12)


@settings(deadline=None)
@given(st.text(max_size=40))
def test_any_text_is_a_sample_or_an_error_of_one_line(text: str) -> None:
    message = _error_message(text)
    assert message is None or message.isprintable()


@settings(deadline=None)
@given(
    st.sampled_from(["gaussian", "lambertian", "regular", "phong"]),
    st.lists(
        st.tuples(st.sampled_from(["width_deg", "reflectance", "peak", "form", "x"]), st.text("0123456789.-+einfa", max_size=6))
    ),
)
def test_any_keys_and_numbers_make_a_sample_or_an_error_of_one_line(model: str, keys: list[tuple[str, str]]) -> None:
    message = _error_message(f"{model}:" + ",".join(f"{key}={value}" for key, value in keys))
    assert message is None or (message.startswith("sample") and message.isprintable())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "phong:n=3",
            "no model 'phong'; give gaussian:width_deg=5, lambertian:reflectance=0.9, regular:reflectance=0.04, wide-tailed:",
        ),
        ("gaussian:width_deg=5+phong:n=3", "no model 'phong'"),
        ("gaussian", "width_deg: is missing"),
        ("gaussian:width=5", "no key 'width'; keys are width_deg, form, quantity, peak, reflectance"),
        ("gaussian:width_deg=5,side=left", "'front', 'back' or 'both'"),
        ("gaussian:width_deg=5,refraction=1.5", "only a transmitted lobe is refracted"),
        ("gaussian:width_deg=5,transmits=perhaps", "transmits: input should be a valid boolean"),
        ("lambertian:reflectance=0.9,side=back+gaussian:width_deg=5,side=both", "1.8 times the light"),
        ("regular:reflectance=1.1", "give a share of the light, 0 to 1"),
        ("regular:reflectance=0", "give a share above 0"),
        ("regular:sigma_deg=3", "no key 'sigma_deg'; keys are reflectance, transmits, side"),
        ("regular:reflectance=0.5+lambertian:reflectance=0.6", "1.1 times the light"),
        ("table:/absent.bsdf,side=left", "sample table: side: input should be 'front', 'back' or 'both', not 'left'"),
        ("table:/absent.bsdf,side=back", "/absent.bsdf: there is no such file"),
        ("gaussian:width_deg=-2", "width_deg is -2"),
        ("gaussian:width_deg=0", "width_deg is 0"),
        ("gaussian:width_deg=nan", "width_deg: input should be a finite number"),
        ("gaussian:width_deg=inf", "width_deg: input should be a finite number"),
        ("gaussian:width_deg=wide", "width_deg: input should be a valid number, not 'wide'"),
        ("gaussian:width_deg=5,width_deg=6", "width_deg is given twice"),
        ("gaussian:width_deg", "is not key=value"),
        ("gaussian:width_deg=5,form=wide", "'one_over_e' or 'half_width'"),
        ("lambertian:reflectance=1.2", "at most 1"),
        ("lambertian:", "keys are reflectance, transmittance"),
        ("lambertian:reflectance=0.9+gaussian:width_deg=5", "1.8 times the light"),
        ("gaussian:width_deg=5,peak=100", "times the light"),
        ("table:", "write table:FILE"),
        ("table:/absent.csv,sample=a,sample=b", "sample is given twice"),
        ("table:/absent.bsdf", "/absent.bsdf: there is no such file"),
        ("table:/absent.ddr", "/absent.ddr: there is no such file"),
        ("", "no model ''"),
    ],
)
def test_an_invalid_sample_is_refused_with_its_model(text: str, message: str) -> None:
    with pytest.raises(UserError, match=r"^sample") as caught:
        parse_sample(text)
    assert message in str(caught.value)


def test_a_measured_table_gives_the_values_of_its_file(tmp_path: Path) -> None:
    zemax, ddr = tmp_path / "paint+1.bsdf", tmp_path / "paint.ddr"
    write_zemax(
        zemax,
        ZemaxBsdf("Measured", "PlaneSymmetrical", "BRDF", np.zeros(1), SIGMA, PHI, THETA, VALUES[None], np.ones((1, 1, 2))),
    )
    write_ddr(ddr, DdrTable("Measured", "PlaneSymmetrical", np.zeros(1), SIGMA, PHI, THETA, (None,), np.pi * VALUES[None]))
    # Linear in theta, the same at every sigma and phi.
    expected = np.interp([0.0, 5.0, 20.0], THETA, VALUES[0, 0, 0])
    for path in (zemax, ddr):
        np.testing.assert_allclose(evaluate(parse_sample(f"table:{path}"), LIGHT, OBSERVERS), expected, rtol=1e-7)
    both = parse_sample(f"table:{zemax}+lambertian:reflectance=0.1")
    np.testing.assert_allclose(evaluate(both, LIGHT, OBSERVERS), expected + 0.1 / np.pi, rtol=1e-7)
    assert table_files(f"table:{zemax}+lambertian:reflectance=0.1") == [zemax]


def test_a_spectral_table_keeps_its_wavelengths(tmp_path: Path) -> None:
    path = tmp_path / "colour.ddr"
    values = np.array([0.5, 1.0])[:, None, None, None, None] * VALUES
    write_ddr(path, DdrTable("Measured", "PlaneSymmetrical", np.zeros(1), SIGMA, PHI, THETA, (450.0, 650.0), values))
    sample = parse_sample(f"table:{path}")
    ratio = evaluate(sample, LIGHT, OBSERVERS, 550.0) / evaluate(sample, LIGHT, OBSERVERS, 650.0)
    np.testing.assert_allclose(ratio, 0.75, rtol=1e-9)


@pytest.mark.parametrize("side", ["front", "back", "both"])
def test_each_model_acts_on_its_given_sides(side: str, tmp_path: Path) -> None:
    path = tmp_path / "a,b.ddr"
    write_ddr(path, DdrTable("Measured", "PlaneSymmetrical", np.zeros(1), SIGMA, PHI, THETA, (None,), VALUES[None]))
    texts = "regular:reflectance=0.04", "lambertian:reflectance=0.5", "gaussian:width_deg=5", f"table:{path}"
    for text in texts:
        made = parse_sample(f"{text},side={side}")
        shares = [albedo(made, sigma) for sigma in (20.0, 160.0)]
        assert [each > 0.0 for each in shares] == [side in ("front", "both"), side in ("back", "both")]
    assert table_files(f"table:{path},side={side}+lambertian:reflectance=0.1") == [path]
    mirror = parse_sample(f"lambertian:reflectance=0.5,transmittance=0.1+regular:reflectance=0.3,transmits=true,side={side}")
    transmittances = [albedo(mirror, sigma, transmitted=True) for sigma in (20.0, 160.0)]
    front, back = side in ("front", "both"), side in ("back", "both")
    assert transmittances == pytest.approx([0.1 + 0.3 * front, 0.1 + 0.3 * back], rel=1e-6)


def test_a_sample_of_a_file_may_have_commas_in_its_name(tmp_path: Path) -> None:
    path = tmp_path / "a,b.csv"
    at = "30,0,40,180"
    rows = [f'"paint, red, 2",{at},0.1', f"glass,{at},0.2"]
    path.write_text("\n".join(["sample,sigma_deg,psi_deg,polar_deg,azimuth_deg,bsdf_per_sr", *rows, ""]), encoding="utf-8")
    for text in (f"table:{path},sample=paint, red, 2,side=both", f"table:{path},fill=fit, sample=paint, red, 2"):
        assert evaluate(parse_sample(text), LIGHT, OBSERVERS)[0] == pytest.approx(0.1)


def test_a_table_with_a_missing_value_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "hole.ddr"
    write_ddr(path, DdrTable("Measured", "PlaneSymmetrical", np.zeros(1), SIGMA, PHI, THETA, (None,), VALUES[None]))
    path.write_text(path.read_text(encoding="utf-8").replace("0.3", "nan", 1), encoding="utf-8")
    with pytest.raises(UserError, match=r"hole.ddr"):
        parse_sample(f"table:{path}")
