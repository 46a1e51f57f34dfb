"""Disturbances of the virtual rig: the same keys as the uncertainties, drawn by name, and what the light makes of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.inputs import inputs
from goniotwin.arrays import Floats
from goniotwin.twin import TwinModel
from goniotwin.twin.optics import Deviation, Instrument, apply_spectrum, arc_direction, gaussian, lambertian
from goniotwin.twin.optics.geometry.field import field_variance, scale_field
from goniotwin.twin.optics.geometry.scene import scene_at
from goniotwin.twin.optics.illumination.slit_image import slit_image
from goniotwin.twin.plant import (
    Drawn,
    Estimator,
    LightSource,
    MonitorPhotodiode,
    MonochromatorDrive,
    Photodiodes,
    Plant,
)
from goniotwin.twin.plant.motion import ramp_to_target
from goniotwin.twin.plant.view import Aspect, View
from tests.conftest import RIG, Writer
from tests.rig_tables import disturbances, stated

pytestmark = pytest.mark.xdist_group("drawn")

LOBE = Aspect("paint", 0.0, 550.0, 30.0, 20.0, 150.0, 1.0)
TWIN_ONLY = {
    "etalon",
    "etalon_years",
    "certificate_level",
    "second_standard",
    "second_years",
    "second_level",
    "turned",
}
"""Keys of the twin alone: the etalon's name, and its certificate, whose uncertainty is in the certificate's own file."""
BEAM = {"scan", "beam_hole"}
"""Uncertainties of the open beam, which the virtual rig has by its geometry."""
Changed = Callable[..., TwinModel]


@pytest.fixture(scope="module")
def changed() -> Changed:
    """The example rig with a sample `paint`, without noise, with these disturbances and other parts."""
    given = read_rig(RIG).model()
    assert given is not None
    plain = replace(given, noise=False, samples={"etalon": lambertian(), "paint": gaussian(8.0)})

    def changed_model(parts: dict[str, Any] | None = None, **keys: Any) -> TwinModel:
        return replace(plain, disturbances=disturbances(**keys), **(parts or {}))

    return changed_model


def seen(model: TwinModel, aspect: Aspect = LOBE) -> Floats:
    return View(model).throughputs_m2sr(aspect)


def currents(model: TwinModel, aspect: Aspect = LOBE, moves: int = 0) -> Floats:
    return Plant(model).steady_photocurrents_a(aspect, moves=moves)


def change(one: Floats, other: Floats) -> float:
    """Largest relative difference where both have light."""
    lit = (one > 0.0) & (other > 0.0)
    return float(np.max(np.abs(one[lit] / other[lit] - 1.0)))


def move(plant: Plant, axis: str, t: float, microsteps: float) -> None:
    """A move that ends before t + 10 s."""
    shaft = plant.shafts[axis]
    counter = shaft.drive(t).counter(t)
    shaft.follow(t, ramp_to_target(t, counter, 0.0, counter + microsteps, 1e5, 1e5, 1e5))


# ---- the table and its drawing ----


def test_each_uncertainty_of_the_rig_file_is_a_disturbance_of_the_same_distribution() -> None:
    keys = {each.name for each in fields(stated())} - BEAM
    assert {each.name for each in fields(disturbances())} - keys == TWIN_ONLY
    assert keys - {each.name for each in fields(disturbances())} == set()
    drawn = {key: each.distribution for key, (each, _) in disturbances().widths.items()}
    assert {each.key: each.distribution for each in inputs() if each.key in keys} == {key: drawn[key] for key in keys}


def test_without_disturbances_everything_is_zero() -> None:
    drawn = Drawn(disturbances(), 5, 36)
    assert not any(drawn.values())
    assert len(drawn) == len(set(drawn)) == 15 + 3 + 2 + 6 + 5 + 3 + 2 * 36 + 13
    assert drawn.mounted("paint", 1) == Deviation()
    assert drawn.signal_factor("etalon", 2, 40) == 1.0
    assert drawn.instrument(Instrument()) == Instrument()
    with pytest.raises(KeyError):
        drawn["mirror_4_tilt_x"]
    with pytest.raises(KeyError):
        drawn["mirror_2_tilt_x@paint#1"]


def test_values_have_the_width_and_the_distribution_of_their_key() -> None:
    table = disturbances(mirror_tilt_deg=0.5, field_of_view=0.12, position_deg=0.2)
    rigs = [Drawn(table, seed, 36) for seed in range(800)]
    for name, width in (("mirror_2_tilt_x", 0.5), ("position@beta#7", 0.2)):
        values = np.array([each[name] for each in rigs])
        assert np.max(np.abs(values)) <= width
        assert values.std() == pytest.approx(width / math.sqrt(3.0), rel=0.08)
        assert np.mean(np.abs(values) > 0.9 * width) == pytest.approx(0.1, abs=0.04)  # a normal law has 0.12, and beyond it
        assert values.mean() == pytest.approx(0.0, abs=0.08 * width)
    values = np.array([each["field"] for each in rigs])
    assert values.std() == pytest.approx(0.12, rel=0.08)
    assert np.mean(np.abs(values) > 0.24) == pytest.approx(0.0455, abs=0.025)
    assert len({round(each, 9) for each in values}) == len(rigs)


def test_a_further_key_changes_no_other_value() -> None:
    one = Drawn(disturbances(mirror_tilt_deg=0.1), 3, 36)
    more = Drawn(disturbances(mirror_tilt_deg=0.1, arc_tilt_deg=0.1, photodiode_angle_deg=0.1), 3, 20)
    assert {name: more[name] for name in one if "mirror" in name} == {name: one[name] for name in one if "mirror" in name}
    assert one["arc_tilt_y"] == 0.0 != more["arc_tilt_y"]
    inputs = [more[name] for name in more if more[name] != 0.0]
    assert len(set(inputs)) == len(inputs) == 6 + 3 + 20


def test_the_rig_file_has_the_table_and_names_the_etalon(write_rig: Writer) -> None:
    text = "[twin.disturbances]\ncertificate_level = 0.02\netalon_tilt_deg = 0.05\n\n[twin.samples.gaussian-5]"
    model = read_rig(write_rig(("[twin.samples.gaussian-5]", text))).model()
    assert model is not None
    assert model.disturbances == disturbances(certificate_level=0.02, etalon_tilt_deg=0.05)
    with pytest.raises(UserError, match=r"disturbances.etalon_tilt_deg: of the etalon, and there is no sample 'tile'"):
        read_rig(write_rig(("[twin.samples.gaussian-5]", text.replace("certificate_level = 0.02", 'etalon = "tile"'))))
    for key, reason in (
        ("second_level = 0.01", "is missing"),
        ('second_standard = "tile"', "no sample"),
        ('turned = "etalon"', "is the"),
    ):
        with pytest.raises(UserError, match=rf"disturbances\.(second_standard|turned): .*{reason}"):
            read_rig(write_rig(("[twin.samples.gaussian-5]", text.replace("certificate_level = 0.02", key))))


def test_the_hash_of_a_model_covers_its_disturbances(write_rig: Writer) -> None:
    def hash_with(disturbances: str = "", light: str = "") -> str | None:
        head = "[twin.samples.gaussian-5]"
        changes = ((head, f"{disturbances}\n{head}"), ("[twin.light]\n", f"[twin.light]\n{light}\n"))
        return read_rig(write_rig(*changes)).model_hash()

    plain = hash_with()
    same = "[twin.disturbances]\nsample_tilt_deg = 0.0\n[twin.monitor]\nsaturation_a = 0.0"
    assert hash_with(same, "band = 'line'") == plain
    tables = [f"[twin.{each}" for each in ("disturbances]\nsample_tilt_deg = 0.1", "monitor]\nsaturation_a = 1e-5")]
    assert len({plain, *map(hash_with, tables), hash_with(light="band = 'triangle'")}) == 4


# ---- pose ----


@pytest.mark.parametrize("kind", ["fast", "forward"])
def test_elements_are_off_by_the_drawn_values_besides_their_deviations(changed: Changed, kind: Any) -> None:
    own = Instrument(deviations={"mirror_2": Deviation(ry_deg=0.2)})
    parts = {"instrument": own, "estimator": Estimator(kind, relative_error=0.3)}
    model = changed(
        parts,
        mirror_tilt_deg=0.1,
        mirror_shift_mm=0.2,
        illumination_shift_mm=0.2,
        arc_tilt_deg=0.1,
        arc_shift_mm=0.2,
        sensor_tilt_deg=0.1,
        sensor_shift_mm=0.2,
    )
    drawn = Plant(model).drawn
    deviations = {
        f"mirror_{m}": Deviation(
            drawn[f"mirror_{m}_tilt_x"],
            drawn[f"mirror_{m}_tilt_y"] + 0.2 * (m == 2),
            x_mm=drawn[f"mirror_{m}_shift_x"],
            y_mm=drawn[f"mirror_{m}_shift_y"],
            z_mm=drawn[f"mirror_{m}_shift_z"],
        )
        for m in (1, 2, 3)
    }
    deviations["pupil"] = Deviation(**{f"{a}_mm": drawn[f"illumination_shift_{a}"] for a in "xyz"})
    deviations["arc"] = Deviation(
        **{f"r{a}_deg": drawn[f"arc_tilt_{a}"] for a in "xyz"}, **{f"{a}_mm": drawn[f"arc_shift_{a}"] for a in "xyz"}
    )
    deviations["sensor"] = Deviation(
        **{f"r{a}_deg": drawn[f"sensor_tilt_{a}"] for a in "xy"}, **{f"{a}_mm": drawn[f"sensor_shift_{a}"] for a in "xyz"}
    )
    explicit = changed({**parts, "instrument": replace(own, deviations=deviations)})
    np.testing.assert_array_equal(seen(model), seen(explicit))
    assert change(seen(model), seen(changed(parts))) > 1e-3


def test_a_tilt_of_the_beam_turns_the_light_about_the_samples_centre(changed: Changed) -> None:
    """The unit with the pupil and the slit's image: the light comes from 800 mm times the tilt aside, to the same place."""
    model = changed(beam_tilt_deg=0.3)
    drawn = Plant(model).drawn
    instrument = drawn.instrument(model.instrument)
    assert set(instrument.deviations) == {"pupil"}
    for sigma in (5.0, 60.0):
        plain, tilted = (scene_at(each, sigma) for each in (model.instrument, instrument))
        towards = [each.pupil[0] / np.linalg.norm(each.pupil[0]) for each in (plain, tilted)]
        turned = math.degrees(math.acos(float(towards[0] @ towards[1])))
        assert turned == pytest.approx(math.hypot(drawn["beam_tilt_x"], drawn["beam_tilt_z"]), rel=1e-4)
        edges = [slit_image(*each).edges[:, 0, 0] for each in ((model.instrument, plain), (instrument, tilted))]
        # In mm from each edge of the slit's image to the middle of the hole.
        assert edges[1] == pytest.approx(edges[0], abs=1e-3)


def test_each_mounting_of_a_sample_has_its_own_deviation_in_the_frame_that_turns_with_gamma(changed: Changed) -> None:
    model = changed(sample_tilt_deg=0.3, sample_height_mm=0.5, etalon_tilt_deg=0.2)
    drawn = Plant(model).drawn
    first, second = (seen(model, LOBE._replace(mounting=number)) for number in (1, 2))
    assert change(first, second) > 1e-3
    own = Deviation(drawn["sample_tilt_x@paint#2"], drawn["sample_tilt_y@paint#2"], z_mm=drawn["sample_height@paint#2"])
    assert min(abs(own.rx_deg), abs(own.ry_deg), abs(own.z_mm)) > 0.0
    np.testing.assert_array_equal(second, seen(changed({"instrument": Instrument(deviations={"sample": own})})))
    white = LOBE._replace(sample="etalon", mounting=1)
    assert drawn.mounted("etalon", 1) == Deviation(drawn["etalon_tilt_x@etalon#1"], drawn["etalon_tilt_y@etalon#1"])
    assert change(seen(model, white), seen(changed(), white)) > 1e-4
    np.testing.assert_array_equal(seen(model), seen(changed()))  # a mounting of 0 has none


def test_mountings_of_a_sample_are_counted(changed: Changed) -> None:
    plant = Plant(changed(sample_tilt_deg=0.3))
    numbers = []
    for t, sample in enumerate(("etalon", "paint", "paint", "etalon", None, "paint")):
        plant.mount(sample, float(t))
        numbers.append(plant.mounting.at(float(t)))
    assert numbers == [1, 1, 1, 2, 0, 2]
    assert plant.mounting.at(3.5) == 2


def test_the_forward_estimator_sees_mountings_each_with_its_own_random_numbers(changed: Changed) -> None:
    parts = {"estimator": Estimator("forward", relative_error=0.3)}
    tilted = changed(parts, sample_tilt_deg=2.0)
    values = [seen(tilted, LOBE._replace(mounting=number)) for number in (0, 1, 2)]
    np.testing.assert_array_equal(values[0], seen(changed(parts)))
    assert np.any(values[1] != values[0])
    assert np.any(values[1] != values[2])


def test_photodiodes_look_along_their_own_angles(changed: Changed) -> None:
    model = changed(photodiode_angle_deg=0.2)
    drawn = Plant(model).drawn
    diodes = model.photodiodes
    polar = np.array(diodes.upper_deg + diodes.lower_deg) + [drawn[f"photodiode_angle[{c}]"] for c in range(diodes.count)]
    polar = np.where(polar < 0.0, 0.2, polar)
    placed = Photodiodes(tuple(polar[:18].tolist()), tuple(polar[18:].tolist()))
    expected = seen(changed({"photodiodes": placed}))
    lit = (expected > 0.0) & (np.array(diodes.upper_deg + diodes.lower_deg) > 0.0)
    np.testing.assert_allclose(seen(model)[lit], expected[lit], rtol=1e-12)
    across = changed(photodiode_across_deg=0.2)
    directions = View(across).directions(150.0, 1.0)
    for c, nominal in ((5, 26.0), (17, 86.0), (30, 61.0)):
        aside = Plant(across).drawn[f"photodiode_across[{c}]"]
        # At this polar angle the direction moves along the circle by its angle over the sine.
        turned = 150.0 + math.degrees(math.atan(math.tan(math.radians(aside)) / math.sin(math.radians(nominal))))
        exact = arc_direction(np.array([nominal]), np.array([turned]), np.array([c >= 18]))[0]
        assert directions[c] == pytest.approx(exact, abs=1e-5)
        assert math.degrees(math.acos(directions[c] @ View(changed()).directions(150.0, 1.0)[c])) == pytest.approx(abs(aside))


def test_zeros_and_positions_turn_the_axes_unseen_by_their_encoders(changed: Changed) -> None:
    plant = Plant(changed(sigma_zero_deg=0.3, position_deg=0.05))
    start = plant.shafts["sigma"].angle_deg(0.0)
    errors = [plant.angle_deg("sigma", 0.0) - start]
    for t in (10.0, 20.0, 30.0):
        move(plant, "sigma", t, 20_000.0)
        errors += [plant.angle_deg("sigma", t + each) - plant.shafts["sigma"].angle_deg(t + each) for each in (5.0, 9.0)]
        shaft = plant.shafts["sigma"]
        shaft.follow(
            t + 9.5,
            ramp_to_target(
                t + 9.5, shaft.drive(t + 9.5).counter(t + 9.5), 0.0, shaft.drive(t + 9.5).counter(t + 9.5), 1e5, 1e5, 1e5
            ),
        )
    drawn = plant.drawn
    numbers = [0, 1, 1, 2, 2, 3, 3]
    expected = [drawn["sigma_zero"] + drawn[f"position@sigma#{n}"] for n in numbers]
    assert errors == pytest.approx(expected, abs=1e-12)
    assert len(set(expected)) == 4
    assert plant.angle_deg("beta", 39.0) == pytest.approx(drawn["position@beta#0"], abs=1e-12)


def test_backlash_is_play_of_every_axis(changed: Changed) -> None:
    plant = Plant(changed(backlash_deg=0.1))
    assert {each.mechanics.backlash_deg for each in plant.shafts.values()} == {0.1}
    assert Plant(changed()).shafts["beta"].mechanics is changed().axes["beta"]


@pytest.mark.parametrize("log_variance", [-0.3, 0.25])
@pytest.mark.parametrize("field_deg", [0.5, 1.5])
def test_the_field_is_scaled_to_the_drawn_variance(field_deg: float, log_variance: float) -> None:
    given = Instrument(field_deg=field_deg)
    scaled = scale_field(given, log_variance)
    assert math.log(field_variance(scaled) / field_variance(given)) == pytest.approx(log_variance, abs=5e-3)
    # A disc of 5 mm at 300 mm, a spot of 5 mm, a pupil of 5 mm at 800 mm: drawn rays.
    random = np.random.default_rng(1)
    hole, count = random.uniform(-2.5, 2.5, (200_000, 2)), 200_000
    turn, radius = random.uniform(0.0, 2.0 * math.pi, (2, count)), np.sqrt(random.random((2, count)))
    circles = radius[:, :, None] * np.stack([np.cos(turn), np.sin(turn)], axis=2)
    cone = math.tan(math.radians(0.5 * field_deg)) * circles[0]
    offset = cone + (5.0 * circles[1] - hole) / 800.0
    counted = np.hypot(*(hole + 300.0 * cone).T) <= 2.5
    assert field_variance(given) == pytest.approx(0.5 * np.mean(np.sum(offset[counted] ** 2, axis=1)), rel=0.01)


def test_a_wider_field_lowers_the_peak_of_a_lobe_and_not_the_ratio_for_a_diffuser(changed: Changed) -> None:
    model = changed({"samples": {"etalon": lambertian(), "paint": gaussian(2.0)}}, field_of_view=0.3)
    plain = replace(model, disturbances=disturbances())
    assert (wider := Plant(model).drawn["field"]) != 0.0
    peak = Aspect("paint", 0.0, 550.0, 30.0, 0.0, 180.0, 0.0)
    at = int(np.argmax(seen(plain, peak)))
    ratio = [float(seen(each, peak)[at] / seen(each, peak._replace(sample="etalon"))[at]) for each in (model, plain)]
    lost = field_variance(model.instrument) / math.radians(2.0) ** 2 * 2.0
    assert math.log(ratio[0] / ratio[1]) == pytest.approx(-lost * (math.exp(wider) - 1.0) / (1.0 + lost), rel=0.15)


# ---- light, electronics, monitor ----


def test_the_light_has_the_wavelength_set_and_the_drawn_error(changed: Changed) -> None:
    colours = apply_spectrum([400.0, 700.0], [0.1, 0.9], gaussian(8.0))
    parts = {"samples": {"paint": colours}}
    model = changed(parts, wavelength_nm=3.0)
    error = Plant(model).drawn["wavelength"]
    assert abs(error) > 0.01
    shifted = currents(changed(parts), LOBE._replace(wavelength_nm=550.0 + error))
    np.testing.assert_allclose(currents(model), shifted, rtol=1e-12)
    plant = Plant(model)
    plant.mount("paint", 0.0)
    plant.shutter_open.set(0.0, True)
    sigma, gamma, beta, shift = (plant.angle_deg(axis, 1.0) for axis in ("sigma", "gamma", "beta", "shift"))
    start = MonochromatorDrive.start_nm
    steady = plant.steady_photocurrents_a(Aspect("paint", 0.0, start, sigma, gamma, beta, shift, mounting=1))
    np.testing.assert_allclose(plant.photocurrents_a(1.0)[: steady.size], steady, rtol=1e-12)
    assert plant.wavelength_nm.at(1.0) == start


@dataclass(frozen=True)
class WhiteLight(LightSource):
    spectrum: tuple[tuple[float, float], ...] = field(default=((300.0, 1.0), (800.0, 1.0)), init=False)


@dataclass(frozen=True)
class GreyPhotodiodes(Photodiodes):
    responsivity: tuple[tuple[float, float], ...] = field(default=((300.0, 0.3), (800.0, 0.3)), init=False)


@pytest.mark.parametrize("width_nm", [4.0, 30.0])
def test_a_triangular_band_takes_the_mean_over_its_wavelengths(changed: Changed, width_nm: float) -> None:
    """Also with a kink at the set wavelength, and not with the light of a line."""
    nm = np.linspace(300.0, 800.0, 6)
    kink = apply_spectrum(nm, [0.1, 0.1, 0.1, 0.9, 0.2, 0.2], gaussian(8.0))
    light, diodes = WhiteLight(band_nm=width_nm, band="triangle"), GreyPhotodiodes()
    parts = {"samples": {"paint": kink}, "light": light, "photodiodes": diodes}
    for set_nm in (600.0, 560.0):
        aspect = LOBE._replace(wavelength_nm=set_nm)
        line = currents(changed({**parts, "light": replace(light, band="line")}), aspect)
        band = currents(changed(parts), aspect)
        places = np.linspace(-width_nm, width_nm, 20_001)
        factor = np.interp(set_nm + places, nm, [0.1, 0.1, 0.1, 0.9, 0.2, 0.2])
        mean = np.average(factor, weights=1.0 - np.abs(places) / width_nm)
        expected = mean / np.interp(set_nm, nm, [0.1, 0.1, 0.1, 0.9, 0.2, 0.2])
        lit = line > 0.0
        np.testing.assert_allclose(band[lit] / line[lit], expected, rtol=1e-4)
    assert expected == pytest.approx(1.0, abs=1e-6)  # away from the kink, on a straight line


def test_white_light_strays_through_the_monochromator(changed: Changed) -> None:
    red = apply_spectrum([599.0, 601.0], [0.0, 1.0], lambertian())
    model = changed({"samples": {"etalon": lambertian(), "paint": red}}, monochromator_stray=1e-3)
    share = Plant(model).drawn["monochromator_stray"]
    green = LOBE._replace(wavelength_nm=550.0)
    stray, full = currents(model, green), currents(model, green._replace(sample="etalon"))
    lit = full > 0.0
    ratio = stray[lit] / full[lit]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
    # Of the lamp's white light about 0.44 is beyond 600 nm, where the photodiodes are more sensitive.
    assert ratio[0] == pytest.approx(0.6 * share, rel=0.15)
    assert not currents(replace(model, disturbances=disturbances()), green).any()


def test_polarised_light_counts_for_a_sample_with_diattenuation(changed: Changed) -> None:
    """Against Jones vectors that follow the light over the three mirrors, with what each turns s and p into."""
    light = LightSource(polarisation=0.4, azimuth_deg=25.0, mirror_s=0.95, mirror_p=0.85)
    model, plain = changed({"light": light, "diattenuation": {"paint": 0.3}}), changed({"light": light})
    for sigma in (0.0, 30.0, 70.0, 150.0):
        turn, azimuth = math.radians(sigma), math.radians(25.0)
        towards = np.array([math.sin(turn), 0.0, math.cos(turn)])  # the light at the sample comes from here, and y is s
        total = np.zeros(2)
        for share, plane in ((0.7, azimuth), (0.3, azimuth + 0.5 * math.pi)):
            way, vector = np.array([0.0, 1.0, 0.0]), np.array([math.sin(plane), 0.0, math.cos(plane)])
            for after in (towards, np.array([0.0, 1.0, 0.0]), -towards):
                across = np.cross(way, after)
                s_part = vector @ across
                p_part = vector @ np.cross(across, way)
                way, vector = after, math.sqrt(0.95) * s_part * across + math.sqrt(0.85) * p_part * np.cross(across, after)
            s_sample = vector @ np.array([0.0, 1.0, 0.0])
            total += share * np.array([s_sample**2, vector @ vector - s_sample**2])
        q = (total[0] - total[1]) / total.sum()
        assert light.polarised(sigma) == pytest.approx(q, abs=1e-12)
        aspect = LOBE._replace(sigma_deg=sigma)
        np.testing.assert_allclose(currents(model, aspect), currents(plain, aspect) * (1.0 + 0.3 * q), rtol=1e-12)
    assert LightSource().polarised(30.0) == 0.0


def test_photodiodes_that_are_not_linear(changed: Changed) -> None:
    model = changed(linearity_per_decade=0.01)
    per_decade = Plant(model).drawn["linearity"]
    true, read = currents(changed()), currents(model)
    lit = true > 1e-18  # below that the responsivity stays as it is
    decades = np.log10(true[lit] / 1e-9)
    assert decades.max() - decades.min() > 2.0
    np.testing.assert_allclose(read[lit] / true[lit] - 1.0, per_decade * decades, rtol=1e-9)


def test_channels_of_a_module_have_a_share_of_each_other_s_volts(changed: Changed) -> None:
    plants = [Plant(changed(crosstalk=share)) for share in (0.0, 1e-3)]
    for plant in plants:
        plant.mount("paint", 0.0)
        plant.shutter_open.set(0.0, True)
        move(plant, "sigma", 0.0, 10_000.0)
        for module in range(plant.modules):
            plant.gain[module].set(20.0, 2)
    share = plants[1].drawn["crosstalk"]
    found = 0.0
    for module in range(plants[0].modules):
        plain, mixed = (plant.volts(module, 60.0) for plant in plants)
        held = np.clip(plain, -12.0, 12.0)
        np.testing.assert_allclose(mixed - plain, share * (held.sum() - held), atol=1e-12)
        found = max(found, float(np.abs(mixed - plain).max()))
    assert found > 1e-6
    volts = np.arange(36.0).reshape(1, 36) / 100.0
    assert plants[1].with_crosstalk(volts)[0, 35] == pytest.approx(0.35 + share * (0.32 + 0.33 + 0.34))


def test_the_etalon_and_each_mounting_have_factors(changed: Changed) -> None:
    keys = {"certificate_level": 0.05, "etalon_age_per_year": 0.01, "etalon_years": 3.0, "etalon_edge": 0.02}
    model = changed(None, **keys, uniformity=0.03, mounting=0.04, repeatability=0.005)
    drawn = Plant(model).drawn

    def factor(sample: str, mounting: int, moves: int) -> float:
        aspect = LOBE._replace(sample=sample, mounting=mounting)
        return float(np.max(currents(model, aspect, moves)) / np.max(currents(changed(), aspect)))

    at = "@paint#2"
    again = (1.0 + drawn["uniformity" + at]) * (1.0 + drawn["mounting" + at])
    assert factor("paint", 2, 7) == pytest.approx(again * (1.0 + drawn["repeatability@#7"]), rel=1e-12)
    assert factor("paint", 2, 8) != factor("paint", 2, 7)
    level = (1.0 + drawn["certificate[level]"]) * (1.0 + 3.0 * drawn["etalon_age"]) * (1.0 + drawn["etalon_edge"])
    again = (1.0 + drawn["uniformity@etalon#1"]) * (1.0 + drawn["mounting@etalon#1"])
    assert factor("etalon", 1, 7) == pytest.approx(level * again * (1.0 + drawn["repeatability@#7"]), rel=1e-12)
    assert factor("etalon", 0, 7) == 1.0


def test_the_monitor_drifts_saturates_and_is_not_linear(changed: Changed) -> None:
    def reading(monitor: MonitorPhotodiode, level: float = 1.0) -> float:
        plant = Plant(changed({"monitor": monitor}))
        plant.shutter_open.set(0.0, True)
        plant.set_lamp(0.0, drift_per_hour=0.0, level=level)
        return plant.monitor_a(3600.0, 3600.1) - monitor.dark_a

    plain = [reading(MonitorPhotodiode(), level) for level in (1.0, 0.1)]
    assert plain[0] / plain[1] == pytest.approx(10.0)
    assert reading(MonitorPhotodiode(drift_per_hour=0.02)) == pytest.approx(1.02 * plain[0], rel=1e-6)
    assert reading(MonitorPhotodiode(saturation_a=plain[0])) == pytest.approx(0.5 * plain[0], rel=1e-6)
    curved = [reading(MonitorPhotodiode(linearity_per_decade=0.03), level) for level in (1.0, 0.1)]
    assert curved[0] / curved[1] == pytest.approx(10.0 / 0.97, rel=1e-3)


def test_the_monitors_errors_can_be_drawn(changed: Changed) -> None:
    model = changed(monitor_drift_per_hour=0.02, monitor_linearity_per_decade=0.03)
    drawn, readings = Plant(model).drawn, []
    for plant in (Plant(changed()), Plant(model)):
        plant.shutter_open.set(0.0, True)
        plant.set_lamp(0.0, drift_per_hour=0.0, level=0.1)
        readings.append(plant.monitor_a(3600.0, 3600.1) - plant.model.monitor.dark_a)
    factor = (1.0 + drawn["monitor_drift"]) * (1.0 - drawn["monitor_linearity"])
    assert abs(factor - 1.0) > 1e-3
    assert readings[1] / readings[0] == pytest.approx(factor, rel=1e-4)
