"""Light on the front or the back of a sheet, reflected or transmitted: each case has its own values and its own file."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.formats import DdrTable, read_ddr, read_points_csv, write_ddr
from goniotwin.app.rig.samples import parse_sample
from goniotwin.app.simulation.estimate import EstimatorSettings
from goniotwin.app.simulation.files import summary, write_simulation
from goniotwin.app.simulation.simulate import Simulation, Task, simulate
from goniotwin.twin.optics import Instrument, arc_direction, evaluate, light_direction
from tests.twin.optics.agreement import agree

pytestmark = pytest.mark.usefixtures("quick_errors")
OPEN = Instrument(obstruction=False)
WIDE = Instrument(detector_diameter_mm=30.0, field_deg=6.0)
WAYS = [(False, False), (False, True), (True, False), (True, True)]
"""Whether the light is on the back, and whether the detectors are on the other side."""
MODELS = (
    "gaussian:width_deg=8,reflectance=0.6",
    "gaussian:width_deg=25,reflectance=0.2,transmits=true,side=front",
    "lambertian:reflectance=0.3,side=back",
    "gaussian:width_deg=12,reflectance=0.5,transmits=true,refraction=1.3,side=back",
)
SHEET = "+".join(MODELS)
SIGMAS = pytest.mark.parametrize(
    "sigmas", [pytest.param((20.0,), id="20"), pytest.param((20.0, 50.0), id="20 and 50", marks=pytest.mark.long)]
)


def simulate_sheet(
    sample: str, back: bool = False, transmitted: bool = False, sigmas: tuple[float, ...] = (20.0, 50.0), **settings: Any
) -> Simulation:
    few = {"polar_deg": np.arange(0.0, 86.0, 5.0), "azimuth_deg": np.arange(0.0, 181.0, 10.0)}
    settings = {"instrument": OPEN, **few, **settings}
    return simulate(Task(parse_sample(sample), np.array(sigmas), back=back, transmitted=transmitted, **settings))


@SIGMAS
@pytest.mark.parametrize(("back", "transmitted"), WAYS)
def test_each_side_and_direction_gives_the_values_of_its_own_model(
    back: bool, transmitted: bool, sigmas: tuple[float, ...]
) -> None:
    sheet = simulate_sheet(SHEET, back, transmitted, sigmas)
    # The same model alone on the front: the models of other sides have no influence.
    alone = simulate_sheet(MODELS[2 * back + transmitted].replace(",side=back", ""), False, transmitted, sigmas)
    assert np.array_equal(sheet.known, alone.known)
    np.testing.assert_allclose(sheet.table, alone.table, rtol=1e-6, atol=1e-12)


@SIGMAS
@pytest.mark.parametrize("transmitted", [False, True])
def test_front_and_back_agree_for_a_symmetric_sheet(transmitted: bool, sigmas: tuple[float, ...]) -> None:
    sheet = "lambertian:reflectance=0.2,transmittance=0.2,side=both+gaussian:width_deg=10,reflectance=0.3,side=both"
    sheet += "+gaussian:width_deg=6,reflectance=0.2,transmits=true,side=both"
    front, back = (simulate_sheet(sheet, side, transmitted, sigmas, instrument=Instrument()) for side in (False, True))
    np.testing.assert_allclose(back.table, front.table, rtol=1e-6)
    assert np.array_equal(back.known, front.known)
    for here, there in zip(front.at, back.at, strict=True):
        assert np.array_equal(here.obstructed, there.obstructed)
        assert here.obstructed.any() == (not transmitted)  # mirror 3 is on the side of the light


@SIGMAS
@pytest.mark.parametrize(("back", "transmitted"), WAYS)
def test_a_detector_measures_the_bsdf_in_its_direction(
    back: bool, transmitted: bool, sigmas: tuple[float, ...], tmp_path: Path
) -> None:
    # An isotropic table that is not symmetric about the plane of incidence, so that the sense of phi matters.
    phi, turn = np.array([0.0, 90.0, 180.0, 270.0, 360.0]), np.array([1.0, 2.0, 1.0, 0.5, 1.0])
    values = np.ones((1, 1, 2, 5, 3)) * turn[:, None] * np.array([0.5, 0.3, 0.1])
    values[..., 0] = 0.5
    path = tmp_path / f"uneven.{'ddt' if transmitted else 'ddr'}"
    ends = np.array([0.0, 90.0])
    write_ddr(path, DdrTable("Measured", "ASymmetrical", np.zeros(1), ends, phi, np.array([0.0, 60.0, 180.0]), (None,), values))
    sheet = f"table:{path},side={'back' if back else 'front'}"
    out = tmp_path / "a.csv"
    grid = {"polar_deg": np.arange(5.0, 80.0, 15.0), "azimuth_deg": np.arange(0.0, 361.0, 45.0)}
    write_simulation(simulate_sheet(sheet, back, transmitted, sigmas, **grid), out)
    columns = read_points_csv(out).columns
    azimuth = columns["azimuth_deg"] * (-1.0 if back else 1.0)  # the sample that is lit on the back is turned about x
    directions = arc_direction(columns["polar_deg"], azimuth, back != transmitted)
    for sigma in sigmas:
        here = columns["sigma_deg"] == sigma
        light = light_direction(180.0 - sigma if back else sigma)
        expected = np.pi * evaluate(parse_sample(sheet), light, directions[here])
        # The aperture blurs the table's kinks.
        np.testing.assert_allclose(columns["luminance_factor"][here], expected, rtol=0.02)
        theta, phi_there = columns["theta_deg"][here], columns["phi_deg"][here]
        np.testing.assert_allclose(
            np.interp(theta, [0.0, 60.0, 180.0], [0.5, 0.3, 0.1])[phi_there == 0.0], expected[phi_there == 0.0], rtol=1e-6
        )
    # On the output grid, in the sample's specular coordinates: half way from 0.5 to 0.3, times 2 and 0.5.
    nodes = {"theta_deg": np.array([30.0]), "phi_deg": np.array([90.0, 270.0])}
    grid = {"polar_deg": np.arange(0.0, 81.0, 5.0), "azimuth_deg": np.arange(0.0, 361.0, 10.0)}
    table = simulate_sheet(sheet, back, transmitted, sigmas, **grid, **nodes).table[0, 0, 1:3, 1]
    assert table == pytest.approx([0.55, 0.325], rel=0.02)


@pytest.mark.parametrize(("back", "transmitted"), WAYS[2:])
def test_the_forward_estimator_agrees_for_light_on_the_back(back: bool, transmitted: bool) -> None:
    grid: dict[str, Any] = {
        "polar_deg": np.arange(5.0, 80.0, 12.0),
        "azimuth_deg": np.array([0.0, 60.0, 120.0, 180.0]),
        "instrument": WIDE,
    }
    fast = simulate_sheet(SHEET, back, transmitted, (20.0,), **grid).at[0].ratio
    settings = EstimatorSettings("forward", paths=200_000, seed=3)
    forward = simulate_sheet(SHEET, back, transmitted, (20.0,), **grid, estimator=settings).at[0].ratio
    many = (forward.standard_error < 0.15 * forward.factor)[0] & np.isfinite(fast.factor[0])
    assert np.count_nonzero(many) >= 10
    agree(forward.factor[0, many], forward.standard_error[0, many], fast.factor[0, many], 0.0)


def test_files_and_summary_state_the_side(tmp_path: Path) -> None:
    for back, transmitted in WAYS:
        sheet = simulate_sheet(SHEET, back, transmitted)
        path = tmp_path / f"{back}.{'ddt' if transmitted else 'ddr'}"
        write_simulation(sheet, path)
        text = "\n".join(read_ddr(path).comments)
        assert f"side: light on the {'back' if back else 'front'}" in text
        assert f"luminance factor of {'transmitted' if transmitted else 'reflected'} light" in text
        result = summary(sheet, [path])
        assert (result["side"], result["transmitted"]) == ("back" if back else "front", transmitted)
        assert result["sigma"] == [20.0, 50.0]


@pytest.mark.parametrize(
    ("sample", "back", "transmitted", "message"),
    [
        ("gaussian:width_deg=5", True, False, r"no light from its back; give its models side=back or side=both"),
        ("gaussian:width_deg=5,side=back", False, False, r"from its front; give its models side=front or .* with --side back"),
        ("gaussian:width_deg=5,side=back", True, True, r"transmits no light from its back; write a .ddr"),
    ],
)
def test_a_side_without_a_model_is_refused(sample: str, back: bool, transmitted: bool, message: str) -> None:
    with pytest.raises(UserError, match=message):
        simulate_sheet(sample, back, transmitted)
