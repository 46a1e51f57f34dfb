"""What the program does is what it did: rows, plans, points and tables against the golden files (see `make.py`)."""

from pathlib import Path

import pytest

from tests.golden import contents, files, product
from tests.golden.compare import check_numbers, check_plan, check_points, check_rows, check_table


@pytest.mark.parametrize("name", ["quick", "traced"])
def test_the_rows_and_points_of_a_campaign_are_the_golden_ones(name: str, tmp_path: Path) -> None:
    journal = contents.JOURNALS[name](tmp_path)
    check_rows(files.as_written(product.measured_rows(journal)), files.read(f"rows-{name}"))
    check_points(files.as_written(contents.points_record(journal)), files.read(f"points-{name}"))


@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=pytest.mark.long) for each in ("transmission-small", "everything", "transmission")]
)
def test_the_points_of_a_campaign_are_the_golden_ones(name: str, tmp_path: Path) -> None:
    journal = contents.JOURNALS[name](tmp_path)
    check_points(files.as_written(contents.points_record(journal)), files.read(f"points-{name}"))


SLOW_PLANS = ("anisotropic", "dense-lobe-spectral", "diffuse-spectral")


@pytest.mark.parametrize(
    "schedule", [pytest.param(each, marks=[pytest.mark.long] if each in SLOW_PLANS else []) for each in contents.PLANS]
)
def test_the_plans_of_a_schedule_are_the_golden_ones(schedule: str) -> None:
    golden = files.read("plans")[schedule]
    assert tuple(golden) == tuple(sorted(contents.PLANS[schedule]))
    for rig, plan in contents.plans_record(schedule).items():
        check_plan(files.as_written(plan), golden[rig], f"{schedule} on {rig}")


def test_every_schedule_of_the_examples_has_golden_plans() -> None:
    assert {path.stem for path in contents.SCHEDULES.glob("*.toml")} == contents.PLANS.keys() == files.read("plans").keys()


@pytest.mark.parametrize("name", contents.SIMULATIONS)
def test_a_simulated_table_is_the_golden_one(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    if not name.endswith(".csv"):  # the golden lines have no standard errors
        request.getfixturevalue("quick_errors")
    check_table(contents.simulation_record(name, tmp_path), files.read("simulations")[name], name, simulated=True)


def test_the_noise_free_cells_of_table_3_are_the_golden_ones() -> None:
    for k, (found, golden) in enumerate(zip(product.table3_noise_free().tolist(), files.read("table3"), strict=True)):
        check_numbers(found, golden, f"row {k}")
