"""`goniotwin simulate`: its options, output and files."""

from pathlib import Path

import pytest

from goniotwin.app.formats import read_ddr
from tests.conftest import RIG
from tests.system.command import CALLS, Call, goniotwin, in_one_thread, invoke, json_result, process_in_one_thread


@pytest.mark.parametrize(
    ("call", "again", "options", "sigmas", "minimum"),
    [
        pytest.param(invoke, in_one_thread, ["--sigma", "0"], [0.0], 1300, id="one sigma", marks=pytest.mark.long),
        pytest.param(goniotwin, process_in_one_thread, [], [0.0, 30.0, 60.0], 8000, id="three sigmas", marks=pytest.mark.long),
    ],
)
def test_simulate_reports_its_file_and_the_standard_errors(
    call: Call, again: Call, options: list[str], sigmas: list[float], minimum: int, tmp_path: Path
) -> None:
    out = tmp_path / "a.ddr"
    sigma = ["--sigma", ",".join(map(str, sigmas))]
    done = call("simulate", "sample", "--sample", "gaussian:width_deg=5", *sigma, "--out", out, "--json")
    result = json_result(done)
    assert result["file"] == str(out)
    assert result["sigma"] == sigmas
    assert (result["estimator"], result["rays"]) == ("fast", 7)
    assert result["values"] > minimum
    assert 0.0 < result["median_relative_standard_error_percent"] <= result["largest_relative_standard_error_percent"] < 0.5
    assert result["hidden_directions"]["0"] > 0
    assert result["simulated"] is True
    assert len(result["assumptions"]) >= 8
    assert "simulating" in done.stderr  # progress
    assert read_ddr(out).values.max() > 1.0
    same = again("simulate", "sample", "--sample", "gaussian:width_deg=5", *options, "--out", out, "--json")
    assert same.stdout == done.stdout


@pytest.mark.parametrize("call", CALLS)
def test_simulate_traces_forward_and_takes_the_instrument_of_a_rig(call: Call, tmp_path: Path) -> None:
    out = tmp_path / "a.csv"
    grid = ["--polar", "20:40:5", "--azimuth", "150:180:10", "--rig", RIG, "--no-obstruction"]
    paths = ["--estimator", "forward", "--paths", 200_000, "--seed", 4]
    result = json_result(
        call("simulate", "sample", "--sample", "lambertian", "--sigma", 30, "--out", out, *grid, *paths, "--json")
    )
    assert (result["estimator"], result["seed"]) == ("forward", 4)
    assert 200_000 <= result["paths"] < 210_000  # whole blocks of paths
    assert result["obstruction"] is False
    assert result["hidden_directions"] == {"30": 0}
    assert result["detectors"] == {"30": 20}
    text = call("simulate", "sample", "--sample", "lambertian", "--sigma", 30, "--out", out, *grid, *paths)
    assert text.stdout.startswith("SIMULATED")
    assert "obstruction is off" in text.stdout


def test_batches_in_a_folder_give_the_file_of_one_run_and_another_command_is_refused(tmp_path: Path) -> None:
    grid = ["--polar", "20:40:10", "--azimuth", "170,180", "--no-obstruction", "--sigma", 30]
    forward = ["simulate", "sample", "--sample", "lambertian", *grid, "--estimator", "forward", "--paths", 100_000]
    folder = ["--folder", tmp_path / "batches"]
    for name, options in (("one.csv", []), ("kept.csv", folder), ("again.csv", folder)):
        result = json_result(invoke(*forward, "--out", tmp_path / name, *options, "--json"))
        assert result["file"] == str(tmp_path / name)
    one, kept, again = ((tmp_path / name).read_bytes() for name in ("one.csv", "kept.csv", "again.csv"))
    assert one == kept == again
    assert sorted(each.name for each in (tmp_path / "batches").iterdir()) == ["chunk-000000.npz", "sweep.json"]
    for options, wrong in (
        ([*folder, "--seed", 2], "batches: has results of another simulation; choose another folder with --folder, or delete"),
        (["--processes", 2], "--processes: computes batches of paths that are kept; give --folder DIR too"),
        ([*folder, "--processes", 0], "--processes: 0 is not possible; give 1 to 1024"),
    ):
        refused = invoke(*forward, "--out", tmp_path / "one.csv", *options)
        assert refused.returncode == 2
        assert wrong in refused.stderr
        assert len(refused.stderr.splitlines()) == 1


def test_random_rigs_are_a_table_and_a_summary(tmp_path: Path) -> None:
    out = tmp_path / "rigs.csv"
    command = ["simulate", "rigs", "--sample", "gaussian:width_deg=5", "--sample", "gaussian:width_deg=15", "--sigma", 30]
    command += ["--polar", "20:40:5", "--azimuth", 180, "--out", out, "--processes", 1]
    result = json_result(invoke(*command, "--rigs", 6, "--json"))
    assert [(each["sample"], each["sigma"]) for each in result["samples"]] == [
        ("gaussian:width_deg=5", 30.0),
        ("gaussian:width_deg=15", 30.0),
    ]
    lines = [line for line in out.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    assert lines[0].startswith("sample,sigma_deg,rig,relative_rms,mirror_1_rx_deg,")
    assert len(lines) == 1 + 2 * 6
    rms = [float(line.split(",")[3]) for line in lines[1:7]]
    assert max(rms) == pytest.approx(0.01 * result["samples"][0]["worst_percent"], rel=1e-6)
    assert rms.index(max(rms)) + 1 == result["samples"][0]["worst_rig"]
    assert (tmp_path / "rigs.rigs" / "chunk-000000.npz").exists()
    text = invoke(*command, "--rigs", 6)
    assert text.stdout.startswith("SIMULATED, 6 rigs with tilts within 0.05 deg and shifts within 0 mm")


def check_table3(call: Call, folder: Path) -> None:
    """Checks the output of `goniotwin simulate table3`."""
    result = json_result(call("simulate", "table3", "--out", folder, "--json"))
    for name in ("paper", "noise_free", "tilted", "worst"):
        assert set(result[name]) == {"0", "30", "60"}
        assert all(len(row) == 4 for row in result[name].values())
        assert result["assumptions"][name]
    assert result["noise_free"]["0"] == pytest.approx([4.32, 0.66, 0.07, 0.02], abs=0.1)
    for file in result["files"].values():
        assert Path(file).stat().st_size > 20_000


@pytest.mark.long
def test_table3_has_the_values_of_the_paper_and_of_the_simulation(tmp_path: Path) -> None:
    """In a process of its own. In process, with the table already computed: `tests/app/simulation/test_table3.py`."""
    check_table3(goniotwin, tmp_path)


@pytest.mark.long
def test_table3_is_shown_to_a_person() -> None:
    text = goniotwin("simulate", "table3")
    assert text.returncode == 0
    assert "SIMULATED" in text.stdout
    assert "explanations of the paper's values" in text.stdout


@pytest.mark.long
@pytest.mark.parametrize("call", CALLS)
def test_the_illumination_is_plotted_and_its_rays_are_a_source(call: Call, tmp_path: Path) -> None:
    beam, monochromator = tmp_path / "beam.h5", ["--wavelength", 600, "--interval", 10, "--bandwidth", 10]
    recorded = ["--rayset", beam, "--rays", 20_000, "--error", 3]
    done = call("simulate", "illumination", "--out", tmp_path / "a.png", *monochromator, *recorded)
    assert done.stdout.startswith("SIMULATED")
    for text in ("forward (", "adjoint (", f"rayset: {beam}, 20000 rays"):
        assert text in done.stdout
    assert "illumination" in done.stderr  # progress
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    grid = ["--polar", "20:40:5", "--azimuth", "150:180:10", "--sigma", 30, "--out", tmp_path / "a.csv"]
    replayed = ["--sample", "lambertian:reflectance=0.5", "--source", beam, "--estimator", "forward", "--paths", 50_000, *grid]
    result = json_result(call("simulate", "sample", *replayed, *monochromator, "--json"))
    assert (result["source"]["file"], result["source"]["rays"]) == (str(beam), 20_000)
    refused = call("simulate", "sample", *replayed)
    assert refused.returncode == 2
    assert "another geometry" in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize("call", CALLS)
def test_the_output_has_the_lit_side_stray_light_and_the_regular_component(call: Call, tmp_path: Path) -> None:
    sample = "lambertian:reflectance=0.5,side=both+regular:reflectance=0.04,side=back"
    grid = ["--polar", "20:40:1", "--azimuth", "150:180:2", "--sigma", 30, "--out", tmp_path / "a.ddr"]
    text = call("simulate", "sample", "--sample", sample, "--side", "back", "--stray", *grid).stdout
    assert "reflected light, the back lit, with stray light" in text
    assert "regular component at sigma 30: 0.04 of the light" in text
    plain = json_result(call("simulate", "sample", "--sample", sample, *grid, "--json"))
    assert (plain["side"], plain["stray"], plain["regular"]) == ("front", False, [])


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ([], "--sample is missing"),
        (["--sample", "gaussian:width_deg=5"], "--out is missing"),
        (["--sample", "gaussian:width_deg=-5", "--out", "a.ddr"], "width_deg is -5"),
        (["--sample", "gaussian:width_deg=nan", "--out", "a.ddr"], "width_deg"),
        (["--sample", "gaussian:wide=5", "--out", "a.ddr"], "no key 'wide'"),
        (["--sample", "gaussian:width_deg=5", "--sigma", "95", "--out", "a.ddr"], "--sigma: 95 is out of range"),
        (["--sample", "gaussian:width_deg=5", "--sigma", "30,nan", "--out", "a.ddr"], "--sigma: nan"),
        (["--sample", "gaussian:width_deg=5", "--theta", "0,200", "--out", "a.ddr"], "--theta: 200"),
        (["--sample", "gaussian:width_deg=5", "--paths", "10000", "--out", "a.ddr"], "--paths"),
        (["--sample", "gaussian:width_deg=5", "--out", "a.xyz"], "a.xyz"),
        (["--sample", "table:absent.bsdf", "--out", "a.ddr"], "absent.bsdf"),
        (["--sample", "gaussian:width_deg=5", "table3"], "table3"),
        (["--sample", "gaussian:width_deg=5", "--side", "back", "--out", "a.ddr"], "reflects no light from its back"),
        (["--sample", "lambertian", "--source", "absent.h5", "--out", "a.ddr"], "absent.h5"),
        (["--sample", "lambertian", "--bandwidth", "5", "--out", "a.ddr"], "--bandwidth"),
        (["illumination", "--out", "a.png", "--rays", "100"], "--rayset"),
    ],
)
def test_bad_input_is_one_line_and_leaves_no_file(arguments: list[str], named: str, call: Call, tmp_path: Path) -> None:
    given = [str(tmp_path / each) if each.startswith("a.") else each for each in arguments]
    done = call("simulate", *given, "--json")
    assert done.returncode == 2
    assert named in done.stderr
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize(
    "command", [["simulate"], ["simulate", "sample"], ["simulate", "table3"], ["simulate", "illumination"]]
)
def test_help_is_worth_reading(command: list[str], call: Call) -> None:
    done = call(*command, "--help")
    assert done.returncode == 0
    assert "Usage" in done.stdout
    assert len(done.stdout.splitlines()) > 8
